"""A central server with its round trip: states go up, orders come down, over the same links as any other word.

Paper: the decision is that of the centralised benchmark (`centralised`), Algorithm 3 of Lee & Bakolas, "Relay Pursuit
    of an Evader by a Heterogeneous Group of Pursuers Using Potential Games", by a centre that has to be told, and whose
    orders take their time.
Parameters: host (which pursuer carries the server), period (time between two reports).
Time: every pursuer reports at the ticks k * period of its clock. The server decides as reports arrive, once for all
    that arrive at one instant, and whoever gets an order obeys it as it arrives. So an order takes effect exactly one
    round trip, 2 L, after the states on which it rests, and what happens between two ticks waits for the next tick
    before that. (A server that decided at ticks would add its own wait: nothing at L = 0, but a whole period as soon as
    L is a nanosecond.) A changed order is sent at once; every tick repeats it.
Assumes: that the host reaches everybody and everybody reaches the host in one hop, and that nobody breaks down. While
    the host is down nobody leads: everybody goes on with what it was ordered last. Reports of who chases are reckoned
    on by their time stamps, so clocks that differ mislead the server a little.
Messages: per period N - 1 reports of 72 bytes and an order to each of N - 1, of 24 bytes and 8 for each evader that is
    chased; an order to each per change.
Robust to loss: yes. Reports and orders are repeated every period, and an order that was overtaken by a newer one is not
    obeyed. Who has not been heard for long (`announce.forget_after`, where "auto" goes by the period of the reports) is
    left out, and the server decides without any report only if none has come for 3 periods and a round trip.
"""

from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from desim.kernel.clock import nanoseconds
from desim.pursuit.agent import Agent, Process
from desim.pursuit.word import Relayed
from desim.value import Period, Value
from protocols.centralised import matching
from protocols.schedules import ticks

PORT = "server"
"""Where reports and orders come in."""


class Order(NamedTuple):
    """Who is to chase what."""

    number: int
    """Of the decision: the greater is the newer."""
    chaser: int | tuple[int | None, ...] | None
    """Who is to chase the evader or, if there are several, each of the (M,) evaders; nobody if None."""

    def action(self, pursuer: int) -> int:
        """Return which evader a pursuer is to chase, or 0."""
        chasers = self.chaser if isinstance(self.chaser, tuple) else (self.chaser,)
        return chasers.index(pursuer) + 1 if pursuer in chasers else 0


class Server(Value):
    """One pursuer carries a server, which hears from all where they are and sends whom it deems best."""

    assumes: ClassVar[tuple[str, ...]] = ("host_in_reach", "no_crashes")
    announces: ClassVar[bool] = False
    """Reports take the place of heartbeats."""
    reckons: ClassVar[bool] = True
    """What is reported is reckoned on, whatever the payload of announcements."""
    kind: Literal["server"] = "server"
    host: Annotated[int, Field(ge=0, strict=True)] = 0
    """The pursuer that carries the server."""
    period: Period = 0.1
    """Time between two reports of a pursuer, and between two repetitions of an order, s."""

    def __call__(self, me: Agent) -> Process:
        """Lead, or report and obey."""
        yield from self._lead(me) if me.id == self.host else self._follow(me)

    def _follow(self, me: Agent) -> Process:
        """Report at every tick, and obey the newest order."""
        newest = -1
        for tick in ticks(me, self.period):
            alarm = me.at(tick)
            while not alarm.processed:
                yield me.arrival(PORT) | alarm
                for message in me.mail(PORT):
                    if message.body.number >= newest:
                        newest = message.body.number
                        obey(me, message.body)
            me.send(self.host, Relayed((me.record(me.located()),)), PORT)

    def _lead(self, me: Agent) -> Process:
        """Decide on what has arrived, obey oneself, and tell the others."""
        told = Order(-1, None)
        reporters: set[int] = set()
        silence = 3.0 * self.period + 2.0 * (me.latency + me.airtime(me.located())) if me.team_size > 1 else 0.0
        last_word = me.now
        for tick in ticks(me, self.period):
            alarm = me.at(tick)
            due = False
            while not due:
                yield me.arrival(PORT) | alarm
                yield me.after_decisions()  # when all reports of this instant are in
                due = alarm.processed
                reports = me.mail(PORT)
                for message in reports:
                    me.learn(message.body.records)
                    reporters.add(message.src)
                if reports:
                    last_word = me.now
                changed = False
                if reports or me.now >= last_word + silence:
                    chaser = self._chaser(me, reporters)
                    changed = told.number < 0 or chaser != told.chaser
                    # By the clock, for it may have lost its memory; and a time is never earlier than the one before.
                    told = Order(max(nanoseconds(me.now), told.number + 1, 0), chaser) if changed else told
                    obey(me, told)
                if changed or (due and told.number >= 0):
                    me.send(None, told, PORT)

    def _chaser(self, me: Agent, reporters: set[int]) -> int | tuple[int | None, ...] | None:
        """Return who is to chase, of the host and those of whom it has word; see `Order`."""
        beliefs = [me.beliefs(self.period, evader) for evader in range(1, me.evader_count + 1)]
        ids = sorted({me.id, *(reporters & beliefs[0].keys())})
        phi = [
            [me.capture_time(evader) if j == me.id else known[j].capture_time for j in ids]
            for evader, known in enumerate(beliefs, start=1)
        ]
        chasers = {evader: ids[row] for row, evader in matching(phi, me.time_left()).items()}
        return tuple(map(chasers.get, range(1, me.evader_count + 1))) if me.evader_count > 1 else chasers.get(1)


def obey(me: Agent, order: Order) -> None:
    """Chase what the order says, unless that has been captured meanwhile, else stay."""
    action = order.action(me.id)
    action = action if action in me.evaders() else 0
    if me.action != action:
        me.assign(action)
