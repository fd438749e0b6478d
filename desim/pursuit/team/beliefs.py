"""Beliefs of a pursuer about its teammates: their last announcements, until they expire, and dead reckoning.

From these beliefs a pursuer computes its gain from an action.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import pairwise
from math import inf, nan
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from desim.config.answers import wrong_answer
from desim.config.arguments import value_text
from desim.config.arrays import Floats, Points
from desim.config.model import MAX_TIME
from desim.config.python_numbers import as_real, real
from desim.kernel.core.clock import NodeClock
from desim.kernel.core.records import Record
from desim.kernel.core.units import SECOND
from desim.kernel.network import Network
from desim.pursuit.game.utility import Mean, Scope, Utility
from desim.pursuit.motion.dead_reckoning import MotionState
from desim.pursuit.sensing.views import ReckonedTeam, View
from desim.pursuit.team.announcements import Announcements, Located, TimedAssignment
from desim.pursuit.team.judges import Judge, ignored_by, is_believed
from desim.pursuit.team.knowledge import Knowledge

Orders = Mapping[int, Sequence[tuple[int, int]]]
"""The orders that a pursuer, as a server, has sent to each teammate: [(t, action)], ascending. An action holds from the
time t on (ns, by the clock of the server)."""
PAPER = Mean()
"""The utility of Lee & Bakolas."""
UNORDERED: Orders = MappingProxyType({})
"""No orders: every teammate continues its announced action."""


class Belief(NamedTuple):
    """The belief of a pursuer about a teammate whose announcement has not expired."""

    active: int
    """The evader that it chases, or 0."""
    capture_time: float
    """s; nan if unknown."""
    age: float = 0.0
    """Time since the announcement was sent, s; may be negative, because sender and receiver read different clocks."""


_new = tuple.__new__  # creates a belief in half of the time of `Belief(...)`


class TeamEstimate(NamedTuple):
    """A pursuer's estimate of the team: itself, and the teammates that it senses or about which it has a belief."""

    ids: list[int]
    """(n,) ids, ascending, its own included."""
    positions: Points
    """(n,) positions, m; nan if unknown."""
    speeds: Floats
    """(n,) speeds while chasing, m/s"""
    capture_times: Floats
    """(n,) capture times, s; nan if unknown."""


class Beliefs(Knowledge):
    """The beliefs of one pursuer about its teammates, and its gain from an action, which depends on them.

    Args:
        pursuer: the id of the pursuer.
        view: its view of the world.
        network: the network that delivers announcements.
        clock: its local clock.
        announcements: the content of announcements, and how long they are believed.
        announcement: returns an announcement of the pursuer, from which the airtime is computed.
        judge: decides which announcements the pursuer believes; None: it believes all.
    """

    def __init__(
        self,
        pursuer: int,
        view: View,
        network: Network,
        clock: NodeClock,
        announcements: Announcements,
        announcement: Callable[[], Any],
        judge: Judge | None = None,
    ):
        super().__init__(pursuer, view, network, clock)
        self._announcements, self._announcement, self._judge = announcements, announcement, judge
        self._constant_timeouts: dict[float | None, float] = {}
        """By the period of `trusted`: for how long an announcement is believed, ns of true time, if constant."""
        self.senses_others = announcements.payload == "action"
        """Whether it senses the positions of its teammates, so that announcements need not contain them."""

    def latest_records(self) -> dict[int, Record]:
        """Return the newest announcement received from each teammate, however old."""
        return {j: record for j, (_, record) in self._network.latest_records(self.id).items()}

    def trusted(self, period: float | None = None) -> dict[int, Record]:
        """Return the newest announcement of each teammate, if it arrived at most `belief_timeout` ago and is believed.

        Which announcements are believed is determined by `announce.trust`.

        Args:
            period: time between two announcements of a teammate, s; if None, the heartbeat, or inf without heartbeats.
                A `belief_timeout` in s does not depend on it.
        """
        oldest = self._clock.true - self._timeout(period)
        received = self._network.latest_records(self.id)
        fresh = {j: record for j, (arrival, record) in received.items() if arrival >= oldest}
        if self._judge is None:
            return fresh
        return {j: record for j, record in fresh.items() if is_believed(self._judge, record)}

    def believed_chasers(self, evader: int = 1) -> dict[int, float]:
        """Return the believed capture time, s, of each teammate that it believes to chase an evader.

        A teammate whose last announcement arrived more than `belief_timeout` ago is not believed active, nor is one
        that the pursuer does not trust (`announce.trust`). The capture time is nan if it is neither announced nor
        follows from a position of the teammate, announced or sensed.
        """
        _, rivals, times = self._rivals(evader)
        return dict(zip(rivals, times, strict=True))

    def believed_active(self, evader: int = 1) -> list[int]:
        """Return the teammates that it believes to chase an evader; see `believed_chasers`."""
        return [j for j, _ in self._chasing_records(evader)] if self._judge is None else self._rivals(evader)[1]

    def _chasing_records(self, evader: int) -> list[tuple[int, Record]]:
        """Return (id, announcement), by ascending id, of the teammates that chase an evader by fresh announcements."""
        oldest = self._clock.true - self._timeout()
        # The network keeps records in the order of arrival. They are sorted, because the gain sums capture times, and
        # the last bit of a sum depends on the order.
        chasing = [
            (j, record)
            for j, (arrival, record) in self._network.matching(self.id).items()
            if record.body.active == evader and arrival >= oldest
        ]
        return sorted(chasing)

    def _rivals(self, evader: int) -> tuple[float, list[int], list[float]]:
        """Return for an evader the pursuer's own capture time, and the ids and capture times of the believed chasers.

        The believed chasers are teammates. Capture times are in s; nan if unknown.
        """
        announced = self._chasing_records(evader)
        if self._judge is not None:
            announced = [(j, record) for j, record in announced if is_believed(self._judge, record)]
        chasing = [j for j, _ in announced]
        if self.senses_others:
            own_time, *times = self._view.capture_times_of([self.id, *chasing], evader)
        else:
            (own_time,) = self._view.capture_times_of([self.id], evader)
            times = [self._capture_time(record, evader) for _, record in announced]
        if self._judge is not None:
            claims = dict(zip(chasing, times, strict=True))
            # A judge compares the claims with each other, so claims that are not believed are removed first.
            ignored = ignored_by(self._judge, own_time, claims)
            chasing = [j for j in chasing if j not in ignored]
            times = [claims[j] for j in chasing]
        return own_time, chasing, times

    def beliefs(self, period: float | None = None, evader: int = 1, orders: Orders = UNORDERED) -> dict[int, Belief]:
        """Return the belief about each teammate whose last announcement arrived at most `belief_timeout` ago.

        Args:
            period: see `trusted`.
            evader: the evader to which the capture times refer.
            orders: the orders that this pursuer, as a server, has sent to each teammate; see `Orders`. An announced
                position is extrapolated with the announced action until the first order to the teammate takes effect,
                and then with the ordered actions.
        """
        now, records = self._clock.stamp, self.trusted(period)
        located = {j: record for j, record in records.items() if isinstance(record.body, Located)}
        motions = self._motions(located, orders)
        reckoned = self._view.capture_times_from(list(motions), list(motions.values()), evader)
        times = dict(zip(motions, reckoned, strict=True))
        for j in records.keys() - times.keys():
            times[j] = self._capture_time(records[j], evader)
        beliefs = {
            j: _new(Belief, (body.active, times[j], (now - stamp) / SECOND))
            for j, (_, _, stamp, body) in records.items()
        }
        if self._judge is None:
            return beliefs
        (own_time,) = self._view.capture_times_of([self.id], evader)
        ignored = ignored_by(self._judge, own_time, {j: belief.capture_time for j, belief in beliefs.items()})
        return {j: belief for j, belief in beliefs.items() if j not in ignored}

    def sensed_positions(self) -> list[complex] | None:
        """Return the (N,) positions of all pursuers, m; None if it does not sense those of its teammates."""
        positions: list[complex] = self._view.state.positions().tolist()
        return positions if self.senses_others else None

    def team_estimate(self, evader: int = 1) -> TeamEstimate:
        """Return its estimate of the positions, speeds and capture times of itself and its teammates.

        Positions are sensed, or extrapolated from `trusted` announcements (`announce.reckoning`). Capture times refer
        to the given evader. The speeds, and positions that are sensed, are read-only arrays.
        """
        view, state = self._view, self._view.state
        if self.senses_others:
            everyone = list(range(state.size))
            return TeamEstimate(everyone, state.positions(), state.speeds, np.array(view.capture_times(evader)))
        records = self.trusted()
        team = self._reckoned_team(records, evader)
        positions, times = team.positions.copy(), team.capture_times.copy()
        positions[self.id], times[self.id] = state.position(self.id), self.capture_time(evader)
        if len(records) == state.size - 1:  # the usual case: all rows
            return TeamEstimate(list(range(state.size)), positions, state.speeds, times)
        ids = sorted([self.id, *records])
        return TeamEstimate(ids, positions[ids], state.speeds[ids], times[ids])

    def _reckoned_team(self, records: Mapping[int, Record], evader: int) -> ReckonedTeam:
        """Return the positions and capture times that follow from records now; only rows of their sources are valid.

        Pursuers that share a view share the rows that follow from the same records at the same instant.

        Kept equal to an estimate by each pursuer by
        `tests/pursuit/test_agent.py::test_estimates_that_are_shared_are_those_of_each_pursuer`.
        """
        view, state = self._view, self._view.state
        instant = self._clock.true, self._clock.stamp, state.body(evader).captured
        team = view.reckoned_teams.get(evader)
        if team is None or team.instant != instant or not view.unlimited:
            no_records: list[Record | None] = [None] * state.size
            team = ReckonedTeam(instant, no_records, np.zeros(state.size, dtype=complex), np.zeros(state.size))
            view.reckoned_teams[evader] = team
        new = {j: record for j, record in records.items() if team.records[j] is not record}
        if new:
            rows, motions = list(new), list(self._motions(new).values())
            team.positions[rows] = [motion.position for motion in motions]
            team.capture_times[rows] = view.capture_times_from(rows, motions, evader)
            for j, record in new.items():
                team.records[j] = record
                if isinstance(record.body, TimedAssignment):
                    team.capture_times[j] = self._capture_time(record, evader)
        return team

    def gain(self, utility: Utility = PAPER, evader: int = 1) -> float:
        """Return its believed gain, s, from chasing an evader rather than being inactive; see `Utility`.

        Raises:
            ValueError: if `utility` is no utility, or a user's utility returns no number, or nan.
        """
        try:
            scope = utility.scope
        except AttributeError as error:
            raise ValueError(
                f"gain(utility) takes a utility, such as desim.pursuit.game.utility.Mean() (got {value_text(utility)})"
            ) from error
        own_time, rivals, times = self._rivals(evader)
        if scope != "heard":
            counted = self.counted_teammates(scope)
            times = [phi for j, phi in zip(rivals, times, strict=True) if j in counted]
        other_times = [phi for phi in times if phi < inf]
        answer: Any = utility(own_time, other_times, self._state.time_left(self._clock.stamp))
        gain = answer if type(answer) is float else as_real(answer)
        if gain != gain:
            raise wrong_answer("a utility should return a gain, a number in s", answer, utility)
        return gain

    def counted_teammates(self, scope: Scope) -> Collection[int]:
        """Return the pursuers whose actions count in its utility, given the scope of the utility.

        They are all pursuers ("heard"), the pursuers that it now hears directly ("neighbours"), or the pursuers whose
        messages can reach it now over any number of hops ("component"). If this pursuer does not sense the positions of
        teammates, the scope is ignored and all pursuers count.

        Raises:
            ValueError: if there is no such scope.
        """
        if scope == "heard" or not self.senses_others:
            return range(self.team_size)
        if scope not in ("neighbours", "component"):
            raise ValueError(f"a scope should be 'heard', 'neighbours' or 'component' (got {value_text(scope)})")
        topology = self._network.topology
        return [*topology.audible(self.id)] if scope == "neighbours" else topology.component(self.id)

    def _timeout(self, period: float | None = None) -> float:
        """Return the time for which an announcement is believed now, ns of true time; see `trusted`."""
        if period is not None and type(period) is not float:
            period = real(period, f"pursuer {self.id}: the period")
        timeout = self._constant_timeouts.get(period)
        if timeout is None:
            heartbeat = self._announcements.heartbeat if self._announcements.has_heartbeats else inf
            timeout = self._timeout_for(heartbeat if period is None else period)
            if self._announcements.belief_timeout != "affordable" and not self._clock.wanders:
                self._constant_timeouts[period] = timeout
        return timeout

    def _timeout_for(self, period: float) -> float:
        """Return the time, ns of true time, for which an announcement that is repeated every period (s) is believed."""
        limit = self._announcements.belief_timeout
        if not period > 0.0:
            raise ValueError(
                f"pursuer {self.id}: the period between two announcements should be above 0 s (got {period})"
            )
        if isinstance(limit, str):
            estimates, announcement = self._network.estimates, self._announcement()
            delay = estimates.latency + estimates.airtime(announcement)
            period = max(period, estimates.interval(announcement))
            # Two announcements in a row may be lost before the belief about a teammate expires.
            auto = 3.0 * period + 2.0 * delay if period < inf else inf
            limit = auto if limit == "auto" else self._affordable(period + 2.0 * delay, auto)
        return inf if limit > MAX_TIME else self._clock.span(limit)  # no run lasts longer than MAX_TIME

    def _affordable(self, least: float, most: float) -> float:
        """Return the time, s, from `least` to `most`, for which it can wait for news and still capture in time.

        If it cannot capture in time even without waiting, this is `most`.
        """
        at_large = self._view.state.at_large
        soonest = min((self._view.capture_times_of([self.id], evader)[0] for evader in at_large), default=inf)
        slack = self.time_left() - soonest
        return min(max(slack, least), most) if slack >= 0.0 else most

    def _capture_time(self, record: Record, evader: int) -> float:
        """Return the capture time, s, of a teammate for an evader, from its record or its sensed position.

        The capture time is nan if it is unknown.
        """
        body = record.body
        if isinstance(body, TimedAssignment):
            return body.capture_time if body.active == evader or self._view.state.evader_count == 1 else nan
        if not isinstance(body, Located):
            return self._view.capture_times_of([record.src], evader)[0] if self.senses_others else nan
        return self._view.capture_times_from([record.src], [*self._motions({record.src: record}).values()], evader)[0]

    def _motions(self, records: Mapping[int, Record], orders: Orders = UNORDERED) -> dict[int, MotionState]:
        """Return the motions of teammates: extrapolated from their records, or sensed; nan if neither is possible.

        Each teammate is assumed to continue its announced action until an order changes it. Pursuers that share a view
        share the motion that follows from the same record at the same instant, or at any instant if the teammate stands
        still.

        Kept equal to an extrapolation by each pursuer by
        `tests/pursuit/test_agent.py::test_motions_that_are_shared_are_those_that_each_pursuer_extrapolates`.
        """
        now, reckonings = self._clock.stamp, self._view.reckonings
        instant = self._clock.true, now  # a wrong clock may show one time at several instants
        motions: dict[int, MotionState] = {}
        for j, record in records.items():
            cached, ordered = reckonings.get(j), orders.get(j)
            if ordered and len(ordered) == 1 and not ordered[0][1] and not record.body.active:
                ordered = None  # an order to be inactive changes nothing for an inactive teammate
            if cached and cached[0] is record and (cached[1] is None or cached[1] == instant) and not ordered:
                motions[j] = cached[2]
            elif isinstance(record.body, Located):
                motions[j] = motion = self._reckoned(record, ordered or (), now)
                if self._view.unlimited and not ordered:
                    stands = not record.body.active and self._view.stands(motion)
                    reckonings[j] = record, None if stands else instant, motion
            else:
                motions[j] = self._view.state.motion(j) if self.senses_others else MotionState(complex(nan, nan))
        return motions

    def _reckoned(self, record: Record, ordered: Sequence[tuple[int, int]], now: int) -> MotionState:
        """Return the motion of a teammate at `now` (ns, local clock), extrapolated from its record; see `_motions`."""
        body: Located = record.body
        motion = body.motion
        # The clock of the sender may be ahead of this one.
        since = min(record.stamp, now)
        if not body.active and not any(action for _, action in ordered):
            return self._view.idle(motion, now - since)
        # The announced motion contains the effect of earlier orders, so these count only from the announcement on.
        segments = [(since, body.active), *((max(begin, since), action) for begin, action in ordered)]
        exact = self._announcements.reckoning == "exact"
        for (begin, action), (end, _) in pairwise([*segments, (now, 0)]):
            if begin >= now:
                continue
            ended = max(now - end, 0)  # time since the end of the segment
            if action:
                motion = self._view.reckoned(motion, body.speed, now - begin, action, exact=exact, ended=ended)
            else:
                motion = self._view.idle(motion, now - begin, ended)
        return motion
