"""A central server with its round trip: states go up, orders come down, over the same links as any other word.

Paper: the decision is that of the centralised benchmark (`centralised`), Algorithm 3 of Lee & Bakolas, "Relay Pursuit
    of an Evader by a Heterogeneous Group of Pursuers Using Potential Games", by a centre that has to be told, and whose
    orders take their time.
Parameters: host (which pursuer carries the server), period (time between two reports).
Time: every pursuer reports at once, and then every period from a random phase on. (Reports at the same ticks of an even
    number of motion steps would always meet the evader's chatter between two pursuers in the same state.) The server
    decides as reports arrive, once for all that arrive at one instant. The host obeys at once, the others as they get
    an order. A changed order is sent at once; every period it is repeated.
Prediction: with a round trip of m reports, m orders are under way. A server that forgets them takes a pursuer that it
    has sent for one that stays, and orders go to and fro for ever. So it reckons each pursuer on from its last report
    by the orders that it has given since, each from when it takes effect, `me.latency` and an airtime after sending;
    then an order of now takes effect, too, and whoever is not under way by then loses the time until then: it is
    compared by phi plus that time. With a constant latency and no loss this is an omniscient centre whose orders are
    late by L. At L = 0 it is the centralised benchmark, deciding at the instants of the reports.
Assumes: that the host reaches everybody and everybody reaches the host in one hop, and that nobody breaks down. While
    the host is down nobody leads: everybody goes on with what it was ordered last. A host that lost its memory has
    forgotten its orders, too, and goes by what is reported until it gives new ones. Reports are reckoned on by their
    time stamps, so clocks that differ mislead the server a little.
Messages: a first report of each and, per period, N - 1 reports of 72 bytes and an order to each of N - 1, of 24 bytes
    and 8 for each evader that is chased; an order to each per change.
Robust to loss: yes. Reports and orders are repeated every period, and an order that was overtaken by a newer one is not
    obeyed. The server takes its orders for obeyed: one that is lost or late misplaces its pursuer by the way of the
    time since its last report at most, and only until the repetition. Who has not been heard for long
    (`announce.belief_timeout`, where "auto" goes by the period of the reports) is left out, and the server decides
    without any report only if none has come for 3 periods and a round trip.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from desim.config.model import Period, Value
from desim.kernel.clock import nanoseconds, seconds
from desim.pursuit.agent import Agent, Process
from desim.pursuit.announcements import Forwarded
from desim.pursuit.beliefs import Orders
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
        for tick in self._ticks(me):
            alarm = me.at(tick)
            while not alarm.processed:
                yield me.arrival(PORT) | alarm
                for message in me.mail(PORT):
                    if message.body.number >= newest:
                        newest = message.body.number
                        apply_order(me, message.body)
            me.send(self.host, Forwarded((me.record(me.located()),)), PORT)

    def _lead(self, me: Agent) -> Process:
        """Decide on what has arrived, obey oneself, and tell the others."""
        told = Order(-1, None)
        orders: dict[int, list[tuple[int, int]]] = {}
        flight = me.latency + me.airtime(me.located())
        silence = 3.0 * self.period + 2.0 * flight if me.team_size > 1 else 0.0
        last_word = me.now
        for tick in self._ticks(me):
            alarm = me.at(tick)
            due = False
            while not due:
                yield me.arrival(PORT) | alarm
                yield me.after_decisions()  # when all reports of this instant are in
                due = alarm.processed
                reports = [record for message in me.mail(PORT) for record in message.body.records]
                me.merge_records(reports)
                for src, _, sent, _ in reports:
                    orders[src] = since(sent, orders.get(src, []))
                if reports:
                    last_word = me.now
                changed = False
                if reports or me.now >= last_word + silence:
                    chaser = self._chaser(me, orders, flight)
                    changed = told.number < 0 or chaser != told.chaser
                    # By the clock, for it may have lost its memory; and a time is never earlier than the one before.
                    told = Order(max(nanoseconds(me.now), told.number + 1, 0), chaser) if changed else told
                    apply_order(me, told)
                if changed or (due and told.number >= 0):
                    me.send(None, told, PORT)
                    for j, ordered in orders.items():
                        if not ordered or ordered[-1][1] != told.action(j):
                            ordered.append((nanoseconds(me.now + flight), told.action(j)))

    def _ticks(self, me: Agent) -> Iterator[float]:
        """Yield when to report or to repeat the order: at once and then every period from a random phase on, s."""
        yield me.now
        yield from ticks(me, self.period, phase=me.stream("reports").uniform(0.0, self.period))

    def _chaser(self, me: Agent, orders: Orders, flight: float) -> int | tuple[int | None, ...] | None:
        """Return the best chaser of each evader among the host and the pursuers with a recent report; see `Order`.

        Args:
            me: the host.
            orders: for each pursuer that has reported, the orders since its report as (time of effect in ns, action),
                by ascending time.
            flight: how long an order takes, s.
        """
        now = nanoseconds(me.now)
        static = (
            me.time_left(flight) == me.time_left()
        )  # then no time to the horizon passes while an order is in flight
        effect = now if static else nanoseconds(me.now + flight)
        phi = []
        for evader in range(1, me.evader_count + 1):
            known = me.beliefs(self.period, evader, orders)
            times = {me.id: me.capture_time(evader)}
            for j in orders.keys() & known.keys():
                times[j] = known[j].capture_time + seconds(idle(known[j].active, orders[j], evader, now, effect))
            ids = sorted(times)
            phi.append([times[j] for j in ids])
        chasers = {evader: ids[row] for row, evader in matching(phi, me.time_left()).items()}
        return tuple(map(chasers.get, range(1, me.evader_count + 1))) if me.evader_count > 1 else chasers.get(1)


def since(sent: int, orders: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the order that a pursuer was under at a time (ns), and those that it gets later."""
    return orders[max(sum(begun <= sent for begun, _ in orders) - 1, 0) :]


def idle(reported: int, ordered: Sequence[tuple[int, int]], evader: int, now: int, effect: int) -> int:
    """Return the time that a pursuer does not chase an evader before an order sent now takes effect, ns.

    Args:
        reported: its action as it reported it.
        ordered: the orders after its report as (time of effect in ns, action), by ascending time.
        evader: its number.
        now: the present time, ns.
        effect: the time at which an order sent now takes effect, ns.
    """
    legs = [(now, reported), *((max(begun, now), action) for begun, action in ordered), (effect, 0)]
    return sum(max(end - begun, 0) for (begun, action), (end, _) in pairwise(legs) if action != evader)


def apply_order(me: Agent, order: Order) -> None:
    """Chase what the order says, unless that has been captured meanwhile, else stay."""
    action = order.action(me.id)
    action = action if action in me.evaders() else 0
    if me.action != action:
        me.assign(action)
