"""Geometric rules: each pursuer computes for itself the owner of an evader, the pursuer that is to chase it.

The owner is the pursuer with the least value of a measure that all know, such as the distance to the evader. The
pursuers do not negotiate.

Paper: Voronoi: Bakolas & Tsiotras 2012, "Relay pursuit of a maneuvering target using dynamic Voronoi diagrams",
    Automatica 48 (cited from memory): the active pursuer is the one whose Voronoi cell contains the evader. Argmin
    (also for unequal speeds): the active pursuer has the least capture time, or the least time to intercept an evader
    of constant velocity.
Parameters: slot (time between two decisions), hysteresis; for Argmin the measure, and the time constant with which the
    evader's velocity is estimated.
Time: all pursuers compute the owner of each evader at the instants k * slot of their clocks. Ties go to the lowest id.
    With a hysteresis of 0.1, another pursuer takes over only if its measure is more than 10 % below that of the present
    owner. A pursuer that would be late, with a capture time phi of at least the time left r, is never an owner.
    With several evaders, owners are assigned greedily: first the pair (pursuer, evader) of least measure, then the pair
    of least measure among the other pursuers and evaders, and so on.
Assumes: positions or capture times known to all. No crashes: where positions are sensed, no pursuer notices that the
    owner has stopped. With hysteresis all pursuers must store the same present owner; this requires equal clocks.
    Voronoi: equal speeds, so that the nearest pursuer is the fastest to capture.
Messages: none if positions are sensed (`announce.payload = "action"`). Otherwise announcements, see `announce` in the
    scenario. The present owner is then the pursuer of least measure among those that announce a chase, so that
    disagreement about the owner is resolved.
Robust to loss: yes if positions are sensed, because no messages are needed; otherwise with heartbeats.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from math import exp, inf, isnan
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from desim.config.arrays import Floats
from desim.config.model import Period, Time, Value
from desim.kernel.core.units import nanoseconds
from desim.pursuit.core.state import lengths
from desim.pursuit.motion.capture import intercept_times
from desim.pursuit.motion.environment import Environment
from desim.pursuit.team.agent import Agent, Process
from desim.pursuit.team.beliefs import TeamEstimate
from protocols.schedules.periodic import ticks

Measure = Callable[[TeamEstimate], Floats]
"""A function that returns the (n,) measures of the n pursuers in an estimate of the team."""


class Geometric(Value):
    """The common part of the geometric rules: in every slot only the owner of an evader chases it."""

    announces: ClassVar[Literal["unseen"]] = "unseen"
    """Announcements are needed only where positions are not sensed."""
    at_once: ClassVar[bool] = True
    """All pursuers decide at the same instants."""
    slot: Period = 0.01
    """Time between two decisions, s.

    Velocities change once a motion step, so shorter slots gain nothing; long ones delay each takeover.

    If in doubt, use the motion step.
    """
    hysteresis: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.0
    """Share by which the measure of a challenger must be below that of the present owner to take over, in [0, 1).

    With 0, two pursuers with nearly equal measures may alternate; with a large share, a pursuer keeps an evader that
    another would capture much earlier.

    If in doubt, use 0.1 with noisy or delayed positions, and else 0.
    """

    @property
    def assumes(self) -> tuple[str, ...]:
        """The assumptions of the rule about the scenario; see `desim.scenario.assumptions`."""
        return ("no_crashes", "equal_clocks") if self.hysteresis else ("no_crashes",)

    def measure(self, me: Agent, evader: int) -> Measure:
        """Return a function that computes the measures of the pursuers for an evader.

        The returned function is called once per slot, so it may have a memory.
        """
        raise NotImplementedError

    def __call__(self, me: Agent) -> Process:
        """Chase an evader while the pursuer is its owner."""
        measure_of = {evader: self.measure(me, evader) for evader in me.evaders()}
        owner_of: dict[int, int] = {}
        for tick in ticks(me, self.slot):
            yield me.at(tick)
            measures: dict[int, list[float]] = {}
            present: dict[int, Collection[int | None]] = {}
            time_left = me.time_left()
            for evader in me.evaders():
                team = me.team_estimate(evader)
                values = zip(measure_of[evader](team).tolist(), team.capture_times.tolist(), strict=True)
                # The second comparison is false for nan, the measure of an unknown position.
                measures[evader] = [value if phi < time_left and value < inf else inf for value, phi in values]
                present[evader] = [owner_of.get(evader)] if me.senses_others else announced_chasers(me, evader)
            owner_of = owners(team.ids, measures, present, self.hysteresis)  # the ids are the same for each evader
            action = next((evader for evader, pursuer in owner_of.items() if pursuer == me.id), 0)
            if me.action != action:
                me.assign(action)
            if not me.senses_others:
                me.announce()


class Voronoi(Geometric):
    """The nearest pursuer, the one whose Voronoi cell contains the evader, chases the evader."""

    assumes_plane: ClassVar[bool] = True
    kind: Literal["voronoi"] = "voronoi"

    @property
    def assumes(self) -> tuple[str, ...]:
        """The assumptions of the rule about the scenario; see `desim.scenario.assumptions`."""
        return (*super().assumes, "positions_known", "equal_speeds")

    def measure(self, me: Agent, evader: int) -> Measure:
        """Return the function that computes the distance, m, of each pursuer to the evader."""
        return lambda team: lengths(me.evader(evader) - team.positions)


class Argmin(Geometric):
    """The pursuer with the least capture or intercept time chases the evader."""

    kind: Literal["argmin"] = "argmin"
    by: Literal["capture_time", "intercept_time"] = "capture_time"
    """capture_time: phi, the time to capture an evader that flees straight from the pursuer; intercept_time: the time
    to intercept an evader that keeps its estimated velocity."""
    time_constant: Time = 0.2
    """Time constant, s, of the low-pass filter that estimates the evader's velocity from its position in each slot; 0:
    the mean velocity in the last slot.

    A short one follows each zigzag of the evader, a long one lags behind its turns.

    If in doubt, use 20 slots.
    """

    @property
    def assumes_plane(self) -> bool:
        """Whether straight lines are taken for shortest paths: the intercept time is that on a straight line."""
        return self.by == "intercept_time"

    @property
    def assumes(self) -> tuple[str, ...]:
        """The assumptions of the rule about the scenario; see `desim.scenario.assumptions`."""
        return (*super().assumes, "times_known" if self.by == "capture_time" else "positions_known")

    def measure(self, me: Agent, evader: int) -> Measure:
        """Return the function that computes the capture or intercept time, s, of each pursuer."""
        if self.by == "capture_time":
            return lambda team: team.capture_times
        velocity = VelocityFilter(self.time_constant, me.environment)

        def intercept(team: TeamEstimate) -> Floats:
            place, now = me.evader(evader), me.now
            relative = np.array([velocity(now, place)])
            if not me.environment.is_still:
                relative = relative + me.environment.relative(place, team.positions, now)
            return intercept_times(place - team.positions, relative, team.speeds, me.radius)

        return intercept


class VelocityFilter:
    """A velocity estimated from positions at irregular times by a low-pass filter: dw/dt = (dx/dt - w) / T.

    w is the estimate, x the position and T the time constant. The estimate is 0 until two successive positions are
    known, then starts at the mean velocity between them. It does not change while the position is unknown (nan), or in
    a call that is not later than the last position. The velocity of an evader that the flow carries is relative to the
    flow.
    """

    def __init__(self, time_constant: float, environment: Environment):
        self._time_constant, self._environment = time_constant, environment
        self._last: tuple[float, complex] | None = None  # time, s, and position, m, at the last call; None if unknown
        self._velocity: complex | None = None

    def __call__(self, now: float, place: complex) -> complex:
        """Return the velocity estimate, m/s, updated with the position of the evader (m) at time now (s)."""
        if isnan(place.real):
            self._last = None
            return self._velocity or 0j
        if self._last is not None and now <= self._last[0]:  # a crash ended in this slot, or the clock was set back
            return self._velocity or 0j
        if self._last is not None:
            (before, start), environment = self._last, self._environment
            if environment.on == "all" and not environment.is_still:
                start = environment.carried(start, nanoseconds(before), nanoseconds(now))
            elapsed = now - before
            mean = (place - start) / elapsed
            estimate = mean if self._velocity is None else self._velocity
            decay = exp(-elapsed / self._time_constant) if self._time_constant else 0.0
            self._velocity = mean + (estimate - mean) * decay
        self._last = now, place
        return self._velocity or 0j


def owners(
    ids: Sequence[int],
    measures: Mapping[int, Sequence[float]],
    present: Mapping[int, Collection[int | None]],
    hysteresis: float,
) -> dict[int, int]:
    """Assign owners to evaders greedily; return the owner of each evader that has one.

    A pursuer owns at most one evader. A single evader is owned by the pursuer that `first` returns.

    Args:
        ids: (n,) ids of the pursuers, ascending.
        measures: for each evader, (n,) measures of the pursuers.
        present: for each evader, its present owner or owners; None stands for no owner.
        hysteresis: share by which the measure of a challenger must be below that of the present owner to take over.
    """
    owner_of: dict[int, int] = {}
    while measures:
        firsts = {evader: first(ids, column, present[evader], hysteresis) for evader, column in measures.items()}
        ranked = [(measures[evader][ids.index(i)], i, evader) for evader, i in firsts.items() if i is not None]
        if not ranked:
            break
        _, pursuer, evader = min(ranked)
        owner_of[evader] = pursuer
        measures = {
            k: [inf if j == pursuer else value for j, value in zip(ids, column, strict=True)]
            for k, column in measures.items()
            if k != evader
        }
    return owner_of


def first(
    ids: Sequence[int], measures: Sequence[float], present: Collection[int | None], hysteresis: float
) -> int | None:
    """Return the owner of an evader, or None if no pursuer can own it.

    Args:
        ids: (n,) ids of the pursuers, ascending.
        measures: (n,) measures of the pursuers; inf for a pursuer that cannot be the owner.
        present: the present owners; if there are several, the one of least measure counts.
        hysteresis: share by which the least measure must be below that of the present owner to take over.
    """
    least = min(measures)
    if least == inf:
        return None
    best = measures.index(least)  # ties: the lowest id
    if hysteresis:
        present_indices = sorted(ids.index(pursuer) for pursuer in present if pursuer in ids)
        owner_index = min(present_indices, key=measures.__getitem__, default=best)
        best = best if least < (1.0 - hysteresis) * measures[owner_index] else owner_index
    return ids[best]


def announced_chasers(me: Agent, evader: int) -> list[int]:
    """Return the pursuers that chase an evader according to their announcements, the agent itself included."""
    return [*me.believed_active(evader), *([me.id] if me.action == evader else [])]
