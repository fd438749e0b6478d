"""A central server over the network: pursuers report their states, and the server sends orders.

Paper: the decision is that of the centralised benchmark (`protocols.centralised`), Algorithm 3 of Lee & Bakolas, "Relay
    Pursuit of an Evader by a Heterogeneous Group of Pursuers Using Potential Games"; reports and orders have latency
    and loss.
Parameters: host (the pursuer that carries the server), period (time between two reports).
Time: every pursuer but the host reports at the start, and then every period with a random phase. (If all reported at
    once, a period of an even number of motion steps would always sample a chattering evader in the same state; see
    `schedules.Periodic`.) The server decides when reports arrive, once for all reports of one instant. The host obeys
    at once, the others when an order arrives. A changed order is sent at once; the current order is repeated every
    period.
Prediction: if a round trip lasts m periods, the reports do not yet show the effect of the last m decisions. A server
    that ignored these decisions would assume that a pursuer just ordered to chase is still inactive, and its orders
    would oscillate for ever. The server therefore extrapolates each pursuer's last report, using the orders sent since.
    It assumes that each order, the present one included, takes effect after a delay L, which is `me.latency` plus an
    airtime. A pursuer that does not chase the evader loses the time until the present order takes effect. This lost
    time is added to its capture time phi, except in a static world. With constant latency and no loss the server
    acts as an omniscient planner whose orders are delayed by L. At L = 0 it acts as the centralised benchmark, deciding
    at the instants of the reports.
Assumes: links in both directions between the host and every other pursuer, and without `takeover` no crashes. While
    the host is down, each pursuer continues with its last order. A host that has lost its memory has lost its orders,
    too, and extrapolates the reported actions until it sends new ones. Reports are extrapolated from their time stamps,
    so differences between the clocks cause errors of the predicted positions.
Takeover: with `takeover`, a pursuer that has had no new order for 3 periods and a round trip reports to the pursuer of
    the next id, and becomes the server itself if that id is its own. Of several servers, all obey the first one that is
    not silent, in order of ids from the host on; a server that hears of an earlier one follows it. The host is
    therefore the server again as soon as it is up. Each side of a partition has a server of its own.
Messages: a first report of each pursuer but the host; per period, N - 1 reports of 72 bytes and N - 1 orders of 24
    bytes plus 8 for each evader that is chased; N - 1 orders per change.
Robust to loss: yes. Reports and orders are repeated every period, and an order older than the newest received is
    discarded. The server assumes that its orders are obeyed. If an order is lost or late, the predicted position is
    wrong by at most the distance covered since the last report, and only until the order is repeated. A pursuer without
    a recent report (`announce.belief_timeout`, where "auto" uses the period of the reports) is left out. If fewer
    evaders than now would then be chased, a silent chaser keeps its evader unless another pursuer can take its place.
    If no reports arrive for 3 periods and a round trip, the server decides without them.
"""

from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from math import inf
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import Field

from desim.config.model import Flag, Period, Value
from desim.kernel.core.clock import FirstOf
from desim.kernel.core.ports import ReservedPort
from desim.kernel.core.units import nanoseconds, seconds
from desim.kernel.state.inbox import Message
from desim.pursuit.team.agent import Agent, Process
from desim.pursuit.team.announcements import Forwarded
from desim.pursuit.team.beliefs import Orders
from protocols.centralised import matching
from protocols.schedules.periodic import ticks

PORT = ReservedPort("server", __name__)
"""The port at which reports and orders arrive."""

NewestOrders = dict[int, tuple[int, int]]
"""The newest order received from each server, as (time of sending in ns, number)."""


class TeamOrder(NamedTuple):
    """The assignment of pursuers to evaders."""

    number: int
    """Number of the decision, greater for a newer one."""
    chasers: tuple[int | None, ...]
    """(M,) the pursuer that is to chase each evader, or None."""

    def action(self, pursuer: int) -> int:
        """Return the evader that a pursuer is to chase, or 0."""
        return self.chasers.index(pursuer) + 1 if pursuer in self.chasers else 0


class Server(Value):
    """A server on one pursuer receives the states of all pursuers and assigns at most one of them to each evader."""

    announces: ClassVar[bool] = False
    """Reports take the place of announcements."""
    reckons: ClassVar[bool] = True
    """Reported states are extrapolated, whatever the payload of announcements."""
    kind: Literal["server"] = "server"
    host: Annotated[int, Field(ge=0, strict=True)] = 0
    """The pursuer that carries the server."""
    period: Period = 0.1
    """Time between two reports of a pursuer, and between two repetitions of an order, s.

    A long period delays decisions and the repetition of lost orders; a short one loads the channel at the host with
    N - 1 reports per period.

    If in doubt, use 0.1 for speeds of about 1 m/s.
    """
    takeover: Flag = False
    """Whether another pursuer becomes the server when no new order has come for 3 periods and a round trip.

    If in doubt, use true where pursuers may crash.
    """

    @property
    def assumes(self) -> tuple[str, ...]:
        """The assumptions that a scenario may violate."""
        return ("host_in_range",) if self.takeover else ("host_in_range", "no_crashes")

    def __call__(self, me: Agent) -> Process:
        """Run the server on the host; report and obey on the other pursuers."""
        server = self.host
        newest: NewestOrders = {}
        while True:
            server = yield from self._lead(me, newest) if me.id == server else self._follow(me, server, newest)

    def _follow(self, me: Agent, server: int, newest: NewestOrders) -> Generator[Any, Any, int]:
        """Report at every tick, obey the newest order received, and return its id when its turn as the server comes."""
        last_order = me.now
        timeout = self._timeout(me)
        for tick in self._ticks(me):
            alarm = me.at(tick)
            while not alarm.processed:
                yield FirstOf(me.arrival(PORT), alarm)
                for src, order in new_orders(me.mail(PORT), newest):
                    if self._turn(me, src) < self._turn(me, server) or me.now > last_order + timeout:
                        server = src
                    if src == server:
                        last_order = me.now
                        apply_order(me, order)
            if self.takeover and me.now > last_order + timeout:
                server, last_order = (server + 1) % me.team_size, me.now
                if server == me.id:
                    break
            me.send(server, Forwarded((me.record(me.located()),)), PORT)
        return server

    def _lead(self, me: Agent, newest: NewestOrders) -> Generator[Any, Any, int]:
        """Decide when reports have arrived, obey the decision, and send it to the others.

        End if an order arrives from a pursuer whose turn as the server is before its own; return that pursuer.
        """
        current = TeamOrder(-1, ())
        orders: dict[int, list[tuple[int, int]]] = {}  # see `_chasers`
        delay = self._delay(me)
        report_timeout = self._timeout(me) if me.team_size > 1 else 0.0  # a pursuer without teammates gets no reports
        last_report = me.now
        for tick in self._ticks(me):
            alarm = me.at(tick)
            due = False
            while not due:
                yield FirstOf(me.arrival(PORT), alarm)
                yield me.after_decisions()  # all reports of this instant have arrived
                due = alarm.processed
                mail = me.mail(PORT)
                for src, order in new_orders(mail, newest):
                    if self._turn(me, src) < self._turn(me, me.id):
                        apply_order(me, order)
                        return src
                reports = [
                    record for message in mail if isinstance(message.body, Forwarded) for record in message.body.records
                ]
                me.merge_records(reports)
                for report in reports:
                    orders[report.src] = orders_since(report.stamp, orders.get(report.src, []))
                if reports:
                    last_report = me.now
                changed = False
                if reports or me.now >= last_report + report_timeout:
                    chasers = self._chasers(me, orders, delay, current.chasers)
                    if changed := current.number < 0 or chasers != current.chasers:
                        # Receivers compare numbers only of orders sent at the same instant. Numbers are from the clock
                        # so that no two decisions in a trace share one, also after a loss of memory.
                        current = TeamOrder(max(nanoseconds(me.now), current.number + 1, 0), chasers)
                    apply_order(me, current)
                if changed or (due and current.number >= 0):
                    me.send(None, current, PORT)
                    for j, ordered in orders.items():
                        if not ordered or ordered[-1][1] != current.action(j):
                            ordered.append((nanoseconds(me.now + delay), current.action(j)))
        return me.id

    def _turn(self, me: Agent, pursuer: int) -> int:
        """Return the place of a pursuer in the order in which pursuers become the server: 0 for the host."""
        return (pursuer - self.host) % me.team_size

    def _delay(self, me: Agent) -> float:
        """Return the nominal delay of an order from sending to effect, s."""
        return me.latency + me.airtime(me.located())

    def _timeout(self, me: Agent) -> float:
        """Return the time, s, without a message after which its sender counts as silent.

        Two reports in a row may be lost.
        """
        return 3.0 * max(self.period, me.interval(me.located())) + 2.0 * self._delay(me)

    def _ticks(self, me: Agent) -> Iterator[float]:
        """Yield the times to report or to repeat the order, s: now, and then every period with a random phase."""
        yield me.now
        yield from ticks(me, self.period, phase=me.stream("reports").uniform(0.0, self.period))

    def _chasers(
        self, me: Agent, orders: Orders, delay: float, present: Sequence[int | None]
    ) -> tuple[int | None, ...]:
        """Return the (M,) best chasers, or None, among the host and the pursuers with a recent report.

        If fewer evaders than now would be chased, silent chasers may keep theirs: their reports may be lost while they
        chase, and stopping them gains nothing (see `most_chasers`). A chaser whose reports are not believed
        (`announce.trust`) counts as silent.

        Args:
            me: the host.
            orders: for each pursuer that has reported, the order in effect at its last report, if any, and the later
                ones, as (time of effect in ns, action), by ascending time.
            delay: delay of an order from sending to effect, s.
            present: (M,) the present chasers; empty before the first order.
        """
        now, reward = nanoseconds(me.now), me.time_left()
        effect = nanoseconds(me.now + delay)
        loses_time = me.time_left(delay) < reward  # false in a static world, where the time left is constant
        phi: list[dict[int, float]] = []
        for evader in range(1, me.evader_count + 1):
            beliefs = me.beliefs(self.period, evader, orders)
            times = {me.id: me.capture_time(evader)}
            for j, (active, capture_time, _) in beliefs.items():
                if j in orders:
                    lost_time = time_not_chasing(active, orders[j], evader, now, effect) if loses_time else 0
                    times[j] = capture_time + seconds(lost_time)
            phi.append(times)
        chasers = best_chasers(phi, reward)
        chased = {evader: j for evader, j in enumerate(present, start=1) if j is not None and evader in me.evaders()}
        if len(chasers) < len(chased):
            reporting = {me.id, *me.trusted(self.period)}
            silent = {evader: j for evader, j in chased.items() if j not in reporting}
            if silent:
                chasers = most_chasers(phi, silent, reward)
        return tuple(map(chasers.get, range(1, me.evader_count + 1)))


def best_chasers(phi: Sequence[Mapping[int, float]], reward: float) -> dict[int, int]:
    """Return the chasers, by evader (1 .. M), of the centralised benchmark; see `matching`.

    Args:
        phi: for each of the M evaders the capture times, s, of the pursuers that may chase it.
        reward: the time left to the horizon, s.
    """
    # Trust judges a claim per evader, so the capture time of a pursuer may be known for some evaders only.
    ids = sorted(set().union(*phi))
    rows = [[times.get(j, inf) for j in ids] for times in phi]
    return {evader: ids[row] for row, evader in matching(rows, reward).items()}


def most_chasers(phi: Sequence[Mapping[int, float]], silent: Mapping[int, int], reward: float) -> dict[int, int]:
    """Return the chasers, by evader (1 .. M), if silent ones may go on: as many as possible, in the best assignment.

    A silent chaser may be down, so it is replaced if another pursuer can take its place. It counts as one that would
    just be in time for its evader, and late for all others.

    Args:
        phi: for each of the M evaders the capture times, s, of the pursuers that may chase it, without silent chasers.
        silent: the silent chasers, by evader.
        reward: the time left to the horizon, s.
    """
    # Each pair gets a bonus greater than the worth of M pairs, so that the number of pairs decides first.
    bonus = len(phi) * abs(reward) + 1.0
    pairs = [{j: time - bonus for j, time in times.items() if time < reward} for times in phi]
    for evader, j in silent.items():
        pairs[evader - 1][j] = reward - bonus
    return best_chasers(pairs, reward)


def new_orders(messages: Iterable[Message], newest: NewestOrders) -> Iterator[tuple[int, TeamOrder]]:
    """Yield, as (sender, order), the orders among the messages that are newer than all earlier ones of their sender.

    An older order that arrives late, or an order that arrives twice, is no sign that its sender is still up (Chen,
    Toueg & Aguilera 2002).

    Args:
        messages: in the order of their arrival.
        newest: the newest order received before from each sender; updated.
    """
    for message in messages:
        src, order = message.src, message.body
        if isinstance(order, TeamOrder) and (message.stamp, order.number) > newest.get(src, (-1, -1)):
            newest[src] = message.stamp, order.number
            yield src, order


def orders_since(sent: int, orders: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the order in effect for a pursuer at the time `sent` (ns), if any, and the later ones."""
    return orders[max(sum(start <= sent for start, _ in orders) - 1, 0) :]


def time_not_chasing(reported: int, ordered: Sequence[tuple[int, int]], evader: int, now: int, effect: int) -> int:
    """Return the time, ns, for which a pursuer does not chase an evader from now until an order sent now takes effect.

    Args:
        reported: the action that the pursuer reported.
        ordered: the order in effect at its report, if any, and the later ones, as (time of effect in ns, action), by
            ascending time.
        evader: the number of the evader.
        now: the present time, ns.
        effect: the time at which an order sent now takes effect, ns.
    """
    total, counted_until, action = 0, now, reported
    for start, next_action in ordered:
        if start > counted_until:
            total += start - counted_until if action != evader else 0
            counted_until = start
        action = next_action
    return total + effect - counted_until if action != evader and effect > counted_until else total


def apply_order(me: Agent, order: TeamOrder) -> None:
    """Chase the evader that the order assigns to the pursuer; be inactive if it assigns none, or a captured one."""
    action = order.action(me.id)
    action = action if action in me.evaders() else 0
    if me.action != action:
        me.assign(action)
