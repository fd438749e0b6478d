"""Geometric rules: each pursuer computes the owner of an evader from a measure known to all, without negotiation.

Paper: Voronoi: Bakolas & Tsiotras 2012, "Relay pursuit of a maneuvering target using dynamic Voronoi diagrams",
    Automatica 48 (cited from memory): the active pursuer is the one whose Voronoi cell contains the evader. Argmin: the
    active pursuer has the least capture time, for unequal speeds, or the least time to intercept an evader of constant
    velocity.
Parameters: slot (time between two decisions), hysteresis; for Argmin the measure, and the time constant with which the
    evader's velocity is estimated.
Time: all pursuers compute the owner of an evader, the pursuer of least measure, at the instants k * slot of their
    clocks. Ties go to the lowest id. With a hysteresis of 0.1, another pursuer takes over only if its measure is more
    than 10 % below the present owner's. A pursuer that would be late (phi >= r) is never an owner.
    With several evaders, owners are assigned greedily: first the pair (pursuer, evader) of least measure, then the pair
    of least measure among the other pursuers and evaders, and so on.
Assumes: positions or capture times known to all. No crashes: where positions are sensed, no pursuer notices that the
    owner has stopped. With hysteresis all pursuers must store the same present owner, which requires equal clocks.
    Voronoi: equal speeds, so that the nearest pursuer is the fastest to capture.
Messages: none with the payload "action", where positions are sensed. Otherwise announcements, see `announce` in the
    scenario; the present owner is then the best among the pursuers that announce a chase, so that disagreement
    about the owner is resolved.
Robust to loss: yes if positions are sensed, because no messages are needed; otherwise with heartbeats.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from math import exp, inf, isnan
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from desim.config.arrays import Floats
from desim.config.model import Period, Time, Value
from desim.pursuit.agent import Agent, Process
from desim.pursuit.beliefs import TeamEstimate
from desim.pursuit.capture import intercept_time
from desim.pursuit.state import coordinates, lengths
from protocols.schedules import ticks

Measure = Callable[[TeamEstimate], Floats]
"""The measure of the n pursuers in an estimate, (n,); the pursuer of least measure becomes the owner."""


class Geometric(Value):
    """The common part of the geometric rules: in every slot only the owner of an evader chases it."""

    announces: ClassVar[Literal["unseen"]] = "unseen"
    """Announcements are needed only where positions are not sensed."""
    slot: Period = 0.01
    """Time between two decisions, s."""
    hysteresis: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.0
    """Share by which a challenger must be better than the present owner to take over, in [0, 1)."""

    @property
    def assumes(self) -> tuple[str, ...]:
        """The assumptions of the rule about the scenario; see `desim.scenario.assumptions`."""
        return ("no_crashes", "equal_clocks") if self.hysteresis else ("no_crashes",)

    def measure(self, me: Agent, evader: int) -> Measure:
        """Return the function that measures the pursuers for an evader; the function is called once per slot."""
        raise NotImplementedError

    def __call__(self, me: Agent) -> Process:
        """Chase an evader while the pursuer is its owner."""
        of = {evader: self.measure(me, evader) for evader in me.evaders()}
        owner = dict[int, int]()
        for tick in ticks(me, self.slot):
            yield me.at(tick)
            measures, present = dict[int, Floats](), dict[int, Collection[int | None]]()
            for evader in me.evaders():
                known = me.team_estimate(evader)
                found = of[evader](known)
                measures[evader] = np.where((known.capture_times < me.time_left()) & ~np.isnan(found), found, inf)
                present[evader] = [owner.get(evader)] if me.senses_others else announced_chasers(me, evader)
            owner = owners(known.ids, measures, present, self.hysteresis)
            action = next((evader for evader, pursuer in owner.items() if pursuer == me.id), 0)
            if me.action != action:
                me.assign(action)
            if not me.senses_others:
                me.announce()


class Voronoi(Geometric):
    """The pursuer whose Voronoi cell contains the evader, so the nearest one, chases it."""

    kind: Literal["voronoi"] = "voronoi"

    @property
    def assumes(self) -> tuple[str, ...]:
        """The assumptions of the rule about the scenario; see `desim.scenario.assumptions`."""
        return (*super().assumes, "positions_known", "equal_speeds")

    def measure(self, me: Agent, evader: int) -> Measure:
        """Return the distance to the evader as the measure, m."""
        return lambda known: lengths(me.evader(evader) - known.positions)


class Argmin(Geometric):
    """The pursuer with the least capture or intercept time chases the evader."""

    kind: Literal["argmin"] = "argmin"
    by: Literal["capture_time", "intercept_time"] = "capture_time"
    """capture_time: for an evader that flees straight from each pursuer (phi); intercept_time: for one that keeps its
    estimated velocity."""
    time_constant: Time = 0.2
    """Time constant of the low-pass filter that estimates the evader's velocity from its positions at the slots, s; 0:
    the mean velocity in the last slot."""

    @property
    def assumes(self) -> tuple[str, ...]:
        """The assumptions of the rule about the scenario; see `desim.scenario.assumptions`."""
        return (*super().assumes, "times_known" if self.by == "capture_time" else "positions_known")

    def measure(self, me: Agent, evader: int) -> Measure:
        """Return the capture or intercept time as the measure, s."""
        if self.by == "capture_time":
            return lambda known: known.capture_times
        velocity = Velocity(self.time_constant)

        def intercept(known: TeamEstimate) -> Floats:
            place = me.evader(evader)
            x_e, w = (coordinates(np.array([each]))[0] for each in (place, velocity(me.now, place)))
            return intercept_time(x_e, w, coordinates(known.positions), known.speeds, me.radius)

        return intercept


class Velocity:
    """A velocity estimated from positions at irregular times by a low-pass filter: dw/dt = (dx/dt - w) / T.

    The estimate is 0 until two successive positions are known, then starts at the mean velocity between them. It is
    constant while the position is unknown (nan).
    """

    def __init__(self, time_constant: float):
        self._time_constant = time_constant
        self._seen: tuple[float, complex] | None = None
        self._velocity: complex | None = None

    def __call__(self, now: float, place: complex) -> complex:
        """Return the velocity estimate, m/s, updated with the position of the evader (m) at time now (s)."""
        if isnan(place.real):
            self._seen = None
            return self._velocity or 0j
        if self._seen is not None:
            elapsed = now - self._seen[0]
            mean = (place - self._seen[1]) / elapsed
            known = mean if self._velocity is None else self._velocity
            remains = exp(-elapsed / self._time_constant) if self._time_constant else 0.0
            self._velocity = mean + (known - mean) * remains
        self._seen = now, place
        return self._velocity or 0j


def owners(
    ids: Sequence[int],
    measures: Mapping[int, Floats],
    present: Mapping[int, Collection[int | None]],
    hysteresis: float,
) -> dict[int, int]:
    """Return the owner of each evader that has one; a pursuer owns at most one evader (see `first`).

    Args:
        ids: (n,) ids of the pursuers, ascending.
        measures: for each evader, (n,) measures of the pursuers.
        present: for each evader, its present owner or owners.
        hysteresis: share by which the measure of a pursuer must be below that of the present owner to take over.
    """
    found: dict[int, int] = {}
    while measures:
        firsts = {evader: first(ids, each, present[evader], hysteresis) for evader, each in measures.items()}
        ranked = [(measures[evader][ids.index(i)], i, evader) for evader, i in firsts.items() if i is not None]
        if not ranked:
            break
        _, pursuer, evader = min(ranked)
        found[evader] = pursuer
        measures = {k: np.where(np.equal(ids, pursuer), inf, each) for k, each in measures.items() if k != evader}
    return found


def first(ids: Sequence[int], measures: Floats, present: Collection[int | None], hysteresis: float) -> int | None:
    """Return the owner of an evader, or None if no pursuer can own it.

    Args:
        ids: (n,) ids of the pursuers, ascending.
        measures: (n,) measures of the pursuers; inf for a pursuer that cannot be the owner.
        present: the present owners; if there are several, the one of least measure counts.
        hysteresis: share by which the least measure must be below that of the present owner to take over.
    """
    best = int(measures.argmin())  # ties: the lowest id
    if measures[best] == inf:
        return None
    if hysteresis:
        owners = [row for row, pursuer in enumerate(ids) if pursuer in present]
        owner = min(owners, key=measures.__getitem__, default=best)
        best = best if measures[best] < (1.0 - hysteresis) * measures[owner] else owner
    return ids[best]


def announced_chasers(me: Agent, evader: int) -> list[int]:
    """Return the pursuers that chase an evader according to their announcements, the agent itself included."""
    return [*me.believed_active(evader), *([me.id] if me.action == evader else [])]
