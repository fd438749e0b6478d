"""Geometric rules: the pursuer that is first by a measure everybody can work out chases, without any negotiation.

Paper: Voronoi: Bakolas & Tsiotras 2012, "Relay pursuit of a maneuvering target using dynamic Voronoi diagrams",
    Automatica 48 (from memory): the active pursuer is the one in whose Voronoi cell the evader is. Argmin: the same by
    time of capture, for unequal speeds, or by the time of an intercept at the evader's velocity.
Parameters: slot (time between two decisions), hysteresis; for Argmin the measure, and the time constant with which the
    evader's velocity is estimated.
Time: everybody works out who is first at the same instants k * slot of its clock. Ties go to the lowest id. With a
    hysteresis of, say, 0.1, who is first takes over only if it is better than the present owner by more than a tenth.
    Who cannot capture in time (phi >= r) is never the owner. Of several evaders each has an owner of its own, found one
    by one: of all first ones the one with the least measure owns, and is left out of what remains.
Assumes: that everybody knows where everybody is, or its time of capture; that nobody breaks down, for where positions
    are sensed nobody notices that the owner does not move. With a hysteresis the choice has a memory, which must be the
    same everywhere: equal clocks. Voronoi: equal speeds, for who is nearest to be who is fastest.
Messages: none with the payload "action", where positions are sensed. Else announcements as the scenario's `announce`
    says, and the present owner is the first of those that say they are active, so that different opinions about it
    pass.
Robust to loss: needs no word if positions are sensed; else with heartbeats.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from math import exp, inf, isnan
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from desim.config.model import Period, Time, Value
from desim.pursuit.agent import Agent, Process
from desim.pursuit.beliefs import TeamEstimate
from desim.pursuit.capture import intercept_time
from desim.pursuit.state import Floats, coordinates, lengths
from protocols.schedules import ticks

Distances = Callable[[TeamEstimate], Floats]
"""By what pursuers are compared, the (n,) of them whose whereabouts are known: the least is first."""


class Geometric(Value):
    """What the geometric rules share: at every slot the owner of an evader chases it, and nobody else."""

    announces: ClassVar[Literal["unseen"]] = "unseen"
    """Word is needed only where positions are not sensed."""
    slot: Period = 0.01
    """Time between two decisions, s."""
    hysteresis: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.0
    """By which share a challenger must be better than the present owner to take over, in [0, 1)."""

    @property
    def assumes(self) -> tuple[str, ...]:
        """What it needs to do what it promises; see `desim.scenario.assumptions`."""
        return ("no_crashes", "equal_clocks") if self.hysteresis else ("no_crashes",)

    def measure(self, me: Agent, evader: int) -> Distances:
        """Return by what pursuers are compared; it is asked once a slot."""
        raise NotImplementedError

    def __call__(self, me: Agent) -> Process:
        """Chase whenever one is the owner."""
        of = {evader: self.measure(me, evader) for evader in me.evaders()}
        owner = dict[int, int]()
        for tick in ticks(me, self.slot):
            yield me.at(tick)
            measures, present = dict[int, Floats](), dict[int, Collection[int | None]]()
            for evader in me.evaders():
                known = me.team_estimate(evader)
                found = of[evader](known)
                measures[evader] = np.where((known.capture_times < me.time_left()) & ~np.isnan(found), found, inf)
                present[evader] = [owner.get(evader)] if me.senses_others else said_active(me, evader)
            owner = owners(known.ids, measures, present, self.hysteresis)
            action = next((evader for evader, pursuer in owner.items() if pursuer == me.id), 0)
            if me.action != action:
                me.assign(action)
            if not me.senses_others:
                me.announce()


class Voronoi(Geometric):
    """The pursuer in whose Voronoi cell the evader is chases: the nearest."""

    kind: Literal["voronoi"] = "voronoi"

    @property
    def assumes(self) -> tuple[str, ...]:
        """What it needs to do what it promises; see `desim.scenario.assumptions`."""
        return (*super().assumes, "places_known", "equal_speeds")

    def measure(self, me: Agent, evader: int) -> Distances:
        """Return the measure of distance, m."""
        return lambda known: lengths(me.evader(evader) - known.places)


class Argmin(Geometric):
    """The pursuer chases that would capture first, should the evader flee from it or keep its velocity."""

    kind: Literal["argmin"] = "argmin"
    by: Literal["capture_time", "intercept_time"] = "capture_time"
    """capture_time: an evader that flees straight from each (phi); intercept_time: one that keeps the velocity it is
    seen to have."""
    time_constant: Time = 0.2
    """Of the low-pass filter by which the velocity of the evader is estimated from its positions at the slots, s; 0:
    the mean velocity in the last slot."""

    @property
    def assumes(self) -> tuple[str, ...]:
        """What it needs to do what it promises; see `desim.scenario.assumptions`."""
        return (*super().assumes, "times_known" if self.by == "capture_time" else "places_known")

    def measure(self, me: Agent, evader: int) -> Distances:
        """Return the measure of time, s."""
        if self.by == "capture_time":
            return lambda known: known.capture_times
        velocity = Velocity(self.time_constant)

        def intercept(known: TeamEstimate) -> Floats:
            place = me.evader(evader)
            x_e, w = (coordinates(np.array([each]))[0] for each in (place, velocity(me.now, place)))
            return intercept_time(x_e, w, coordinates(known.places), known.speeds, me.radius)

        return intercept


class Velocity:
    """The velocity of something that is seen from time to time, by a low-pass filter: dw/dt = (dx/dt - w) / T.

    It begins with the mean velocity between the first two sights, and is 0 before the second. While nobody knows where
    it is (nan) it stays as it is.
    """

    def __init__(self, time_constant: float):
        self._time_constant = time_constant
        self._seen: tuple[float, complex] | None = None
        self._velocity: complex | None = None

    def __call__(self, now: float, place: complex) -> complex:
        """Return the estimate after a sight at a time (s) and a place (m), m/s."""
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
    """Return who is to be the owner of each evader, of which a pursuer has one at most; see `first`.

    Args:
        ids: (n,) of the pursuers, ascending.
        measures: of each evader, (n,) of them.
        present: of each evader, who is its owner now.
        hysteresis: by which share a pursuer must be better than the present owner.
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
    """Return who is to be the owner, or None if nobody can.

    Args:
        ids: (n,) of the pursuers, ascending.
        measures: (n,) of them; inf for who cannot be the owner.
        present: who is the owner now, or several of whom the first counts.
        hysteresis: by which share the first of all must be better to take over.
    """
    best = int(measures.argmin())  # of equals the lowest id
    if measures[best] == inf:
        return None
    if hysteresis:
        owners = [row for row, pursuer in enumerate(ids) if pursuer in present]
        owner = min(owners, key=measures.__getitem__, default=best)
        best = best if measures[best] < (1.0 - hysteresis) * measures[owner] else owner
    return ids[best]


def said_active(me: Agent, evader: int) -> list[int]:
    """Return who chases an evader, itself included, as far as it has heard."""
    return [*me.believed_active(evader), *([me.id] if me.action == evader else [])]
