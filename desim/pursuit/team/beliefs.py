"""Beliefs of a pursuer about its teammates: their last announcements, until they expire, and dead reckoning."""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from math import inf, nan
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from desim.config.arrays import Floats, Points
from desim.config.model import MAX_TIME
from desim.kernel.core.clock import NodeClock
from desim.kernel.core.records import Record
from desim.kernel.core.units import SECOND
from desim.kernel.network import Network
from desim.pursuit.motion.dead_reckoning import MotionState
from desim.pursuit.sensing.views import View
from desim.pursuit.team.announcements import Announcements, Located, TimedAssignment
from desim.pursuit.team.trust import Judge, ignored_by

Orders = Mapping[int, Sequence[tuple[int, int]]]
"""The orders that a pursuer, as a server, has sent to each teammate: [(t, action)], ascending. An action holds from the
time t on (ns, by the clock of the server)."""
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


class Beliefs:
    """The beliefs of one pursuer.

    Args:
        pursuer: the id of the pursuer.
        clock: its local clock.
        view: its view of the world.
        network: the network that delivers announcements.
        announcements: the content of announcements, and how long they are believed.
        announcement: returns an announcement of the pursuer, from which the airtime is computed.
        judge: decides which announcements the pursuer believes; None: it believes all.
    """

    def __init__(
        self,
        pursuer: int,
        clock: NodeClock,
        view: View,
        network: Network,
        announcements: Announcements,
        announcement: Callable[[], Any],
        judge: Judge | None = None,
    ):
        self._id, self._clock, self._view, self._network = pursuer, clock, view, network
        self._announcements, self._announcement, self._judge = announcements, announcement, judge
        self.senses_others = announcements.payload == "action"

    def latest_records(self) -> dict[int, Record]:
        """Return the newest announcement received from each teammate, however old."""
        return {j: record for j, (_, record) in self._network.latest_records(self._id).items()}

    def trusted(self, period: float | None = None) -> dict[int, Record]:
        """Return the newest announcement of each teammate, if it arrived at most `belief_timeout` ago.

        Args:
            period: time between two announcements of a teammate, s; if None, the heartbeat, or inf without heartbeats.
                It is used only if `belief_timeout` is "auto".
        """
        oldest = self._clock.true - (self._timeout if period is None else self._timeout_for(period))
        received = self._network.latest_records(self._id)
        fresh = {j: record for j, (arrival, record) in received.items() if arrival >= oldest}
        if self._judge is None:
            return fresh
        return {j: record for j, record in fresh.items() if self._judge.believes(record)}

    def rivals(self, evader: int) -> tuple[float, list[int], list[float]]:
        """Return for an evader the pursuer's own capture time, and the ids and capture times of the believed chasers.

        The believed chasers are teammates. Capture times are in s; nan if unknown.
        """
        oldest, matching = self._clock.true - self._timeout, self._network.matching(self._id)
        chasing = [j for j in sorted(matching) if matching[j][1].body.active == evader and matching[j][0] >= oldest]
        if self._judge is not None:
            chasing = [j for j in chasing if self._judge.believes(matching[j][1])]
        if self.senses_others:
            own, *times = self._view.capture_times_of([self._id, *chasing], evader)
        else:
            (own,) = self._view.capture_times_of([self._id], evader)
            times = [self._capture_time(matching[j][1], evader) for j in chasing]
        if self._judge is not None:
            claims = dict(zip(chasing, times, strict=True))
            ignored = ignored_by(self._judge, own, claims)
            chasing = [j for j in chasing if j not in ignored]
            times = [claims[j] for j in chasing]
        return own, chasing, times

    def about_teammates(self, period: float | None, evader: int, orders: Orders = UNORDERED) -> dict[int, Belief]:
        """Return the belief about each teammate whose announcement has not expired; see `Agent.beliefs`.

        The capture time of a belief is that of the teammate for the given evader.
        """
        now = self._clock.stamp
        beliefs = {
            j: Belief(record.body.active, self._capture_time(record, evader, orders), (now - record.stamp) / SECOND)
            for j, record in self.trusted(period).items()
        }
        if self._judge is None:
            return beliefs
        (own,) = self._view.capture_times_of([self._id], evader)
        ignored = ignored_by(self._judge, own, {j: belief.capture_time for j, belief in beliefs.items()})
        return {j: belief for j, belief in beliefs.items() if j not in ignored}

    def team_estimate(self, evader: int) -> TeamEstimate:
        """Return the estimated positions and speeds of the team, and the capture times for an evader.

        Positions are sensed, or dead-reckoned from announcements that have not expired.
        """
        view, state = self._view, self._view.state
        if self.senses_others:
            return TeamEstimate(self._everyone, state.positions(), state.speeds, np.array(view.capture_times(evader)))
        records = self.trusted()
        ids = sorted({*records, self._id})
        motions = [self._motion(records[j]) if j in records else state.motion(j) for j in ids]
        phi = [
            self._capture_time(records[j], evader)
            if j in records and isinstance(records[j].body, TimedAssignment)
            else view.capture_time_from(j, motion, evader)
            for j, motion in zip(ids, motions, strict=True)
        ]
        return TeamEstimate(ids, np.array([each.position for each in motions]), state.speeds[ids], np.array(phi))

    @cached_property
    def _everyone(self) -> list[int]:
        """The ids of the team."""
        return list(range(self._view.state.size))

    @cached_property
    def _timeout(self) -> float:
        """The time for which an announcement is believed, ns of true time."""
        return self._timeout_for(self._announcements.heartbeat if self._announcements.has_heartbeats else inf)

    def _timeout_for(self, period: float) -> float:
        """Return the time, ns of true time, for which an announcement that is repeated every period (s) is believed."""
        limit = self._announcements.belief_timeout
        if limit == "auto":
            estimates, announcement = self._network.estimates, self._announcement()
            delay = estimates.latency + estimates.airtime(announcement)
            period = max(period, estimates.interval(announcement))
            limit = 3.0 * period + 2.0 * delay if period < inf else inf
        return inf if limit > MAX_TIME else self._clock.span(limit)  # no run lasts longer than MAX_TIME

    def _capture_time(self, record: Record, evader: int, orders: Orders = UNORDERED) -> float:
        """Return the capture time, s, of a teammate for an evader, from its record or its sensed position.

        The capture time is nan if it is unknown.
        """
        body = record.body
        if isinstance(body, TimedAssignment):
            return body.capture_time if body.active == evader or self._view.state.evader_count == 1 else nan
        if not isinstance(body, Located):
            return self._view.capture_times_of([record.src], evader)[0] if self.senses_others else nan
        return self._view.capture_time_from(record.src, self._motion(record, orders), evader)

    def _motion(self, record: Record, orders: Orders = UNORDERED) -> MotionState:
        """Return the motion of a teammate: extrapolated from its record, or sensed; nan if neither is possible.

        The teammate is assumed to continue its announced action until an order changes it.
        """
        body = record.body
        if not isinstance(body, Located):
            return self._view.state.motion(record.src) if self.senses_others else MotionState(complex(nan, nan))
        motion = body.motion
        ordered = orders.get(record.src, ())
        now = self._clock.stamp
        since = min(record.stamp, now)
        if not body.active and not any(action for _, action in ordered):
            return self._view.idle(motion, now - since)
        segments = [(since, body.active), *((max(begun, since), action) for begun, action in ordered)]
        exact = self._announcements.reckoning == "exact"
        for (begun, action), (end, _) in pairwise([*segments, (now, 0)]):
            if begun >= now:
                continue
            ended = max(now - end, 0)
            if action:
                motion = self._view.reckoned(motion, body.speed, now - begun, action, exact=exact, ended=ended)
            else:
                motion = self._view.idle(motion, now - begun, ended)
        return motion
