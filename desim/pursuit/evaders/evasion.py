"""Evasion strategies: a strategy maps what an evader observes of the pursuit to a heading.

A strategy is an immutable object without memory: the observation contains the previous heading and the time since it
was chosen. No parameter refers to the motion step, so a strategy needs no change if the step changes.
"""

from cmath import rect
from functools import lru_cache
from math import inf, pi, sqrt
from typing import Annotated, ClassVar, Literal, Protocol

import numpy as np
from pydantic import AfterValidator, Field

from desim.config.arrays import Floats, Points
from desim.config.choice import OneOf
from desim.config.model import Coordinate, Length, Limit, Period, Unsigned, Value
from desim.kernel.core.portable_math import power
from desim.pursuit.core.geometry import SMALLEST
from desim.pursuit.core.state import State, lengths
from desim.pursuit.core.traits import StrategyTraits
from desim.pursuit.evaders.observation import EvaderObservation
from desim.pursuit.evaders.recorded import RecordedMotion
from desim.pursuit.motion.capture import intercept_times


def _increasing(bounds: tuple[float, float]) -> tuple[float, float]:
    if not bounds[0] < bounds[1]:
        raise ValueError(f"should be [lower, upper] with lower < upper (got {bounds[0]:g} and {bounds[1]:g})")
    return bounds


class Strategy(Protocol):
    """An evader's strategy: `strategy(state, rng)` returns a heading, a complex number of length at most 1.

    The velocity is the heading times the speed; with a heading of 0 the evader stands still.

    A strategy that reads `state.handover` must declare `listens = True`; see
    `desim.pursuit.core.traits.StrategyTraits`.
    """

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex: ...  # noqa: D102


class Fleeing(Value):
    """Base of the strategies that flee from pursuers; without a pursuer to flee from, the evader stands still."""

    flees_from: Literal["all", "active"] = "all"
    """The pursuers from which it flees. all: all that it senses; active: the sensed pursuers that chase this evader."""

    def fled_from(self, state: EvaderObservation) -> EvaderObservation:
        """Return an observation restricted to the pursuers from which the evader flees."""
        return state if self.flees_from == "all" else state.only(state.active)


class PureEvasion(Fleeing):
    """Flee straight from the nearest pursuer (Lee & Bakolas, section "Pure evasion")."""

    kind: Literal["pure_evasion"] = "pure_evasion"

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return u_e = (x_e - x_k) / |x_e - x_k| for the nearest pursuer k; 0 if it is at the evader's position."""
        return away(self.fled_from(state))


ROUNDING = 1e-12
"""A sum of n vectors of length at most 1 counts as 0 if its length is at most n times this value. Values that differ
less, as a share, count as equal."""


class WeightedFlee(Fleeing):
    """Flee from all pursuers at once, weighted by distance."""

    kind: Literal["weighted_flee"] = "weighted_flee"
    power: Limit = 2.0
    """Exponent p of the weights 1 / distance^p; inf: only the nearest counts."""

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the direction of sum_i xi_i / |xi_i|^(p + 1), where xi_i = x_e - x_i; 0 if the sum or an xi_i is 0."""
        fled_from = self.fled_from(state)
        if not away(fled_from):
            return 0j
        distances = fled_from.distances
        weights = power(distances[fled_from.nearest] / distances, self.power)  # at most 1, so that nothing overflows
        push = complex((fled_from.offsets / distances * weights).sum())
        return unit(push) if abs(push) > ROUNDING * len(distances) else 0j


class MaxMin(Fleeing):
    """Flee on the straight line that maximises the least intercept time over all pursuers."""

    assumes_plane: ClassVar[bool] = True
    kind: Literal["max_min"] = "max_min"
    candidates: Annotated[int, Field(ge=1, le=3600, strict=True)] = 72
    """Number of candidate headings, evenly spaced and including that of pure evasion.

    If in doubt, use 72, which is 5 degrees apart; the time of a run grows with it.
    """

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the candidate heading u with the greatest min_i phi_i(u).

        phi_i(u) is the least time in which pursuer i can intercept an evader that keeps the heading u. Of equally good
        candidates, the first counter-clockwise from the heading of pure evasion is chosen.
        """
        fled_from = self.fled_from(state)
        straight = away(fled_from)
        if not straight:
            return 0j
        turns = _turns(self.candidates)
        headings = straight.real * turns + straight.imag * (1j * turns)  # numpy's complex product varies by processor
        return complex(headings[first_of_greatest(first_captures(fled_from, headings))])


class MaxGeodesic(Fleeing):
    """Flee in the direction that maximises the least length of the paths from all pursuers after the look-ahead time.

    Use it among walls: where a straight flight ends in a corner, another direction keeps pursuers farther away. Without
    walls, paths are straight.
    """

    kind: Literal["max_geodesic"] = "max_geodesic"
    candidates: Annotated[int, Field(ge=1, le=3600, strict=True)] = 16
    """Number of candidate headings, evenly spaced and including that of pure evasion.

    If in doubt, use 16; the time of a run grows with it.
    """
    look_ahead: Period = 1.0
    """Time for which the evader assumes to keep a heading, s.

    With a short time it flees as pure evasion does, into dead ends. With a long time it underestimates pursuers: it
    assumes that they stand still.

    If in doubt, use the time in which the evader passes a wall.
    """

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the candidate heading that leads to the place farthest from its nearest pursuer, by lengths of paths.

        The evader assumes that it slides along walls in its way. Of equally good candidates, the first
        counter-clockwise from the heading of pure evasion is chosen.
        """
        fled_from = self.fled_from(state)
        straight = away(fled_from)
        if not straight:
            return 0j
        headings: list[complex] = [straight * turn for turn in _turns(self.candidates).tolist()]
        length, space = state.speed * self.look_ahead, state.space
        ends = np.array([state.evader + space.slide(state.evader, heading * length) for heading in headings])
        # The way changes each path by at most `length`, so only these pursuers can be the nearest at its end.
        near = fled_from.distances <= fled_from.distances[fled_from.nearest] + 2.0 * length
        distances = [space.distances(ends, place) for place in fled_from.pursuers[near].tolist()]
        return headings[first_of_greatest(np.min(distances, axis=0))]


class Hide(Fleeing):
    """Go by the shortest path to the nearest place that no pursuer sees, behind a wall that blocks sight.

    A hiding place counts only if the evader comes first, even if pursuers could go straight through walls. A hidden
    evader stands still; an evader without such a place flees straight from the nearest pursuer.
    """

    kind: Literal["hide"] = "hide"
    distance: Length = 0.5
    """Distance of hiding places from the corners of walls, m; eight places surround each corner.

    If in doubt, use a few capture radii.
    """

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the heading to the nearest hiding place: 0 if hidden, that of pure evasion without a place."""
        fled_from, space = self.fled_from(state), state.space
        if not len(fled_from.pursuers):
            return 0j
        pursuers, evader = fled_from.pursuers, state.evader
        if space.hidden(np.array([evader]), pursuers)[0]:
            return 0j
        places = space.hiding_places(self.distance)
        nearest = lengths(places - evader).argsort(kind="stable")[:MAX_HIDING_PLACES]
        places = places[nearest][space.hidden(places[nearest], pursuers)]
        path_lengths = space.distances(places, evader)
        has_path = path_lengths < inf
        places, times = places[has_path], path_lengths[has_path] / max(state.speed, SMALLEST)
        for pursuer, speed in zip(pursuers.tolist(), fled_from.speeds.tolist(), strict=True):
            times[lengths(places - pursuer) <= speed * times] = inf
        if not len(times) or times.min() == inf:
            return away(fled_from)
        return unit(space.leg(evader, complex(places[times.argmin()]), state.speed)[0])


MAX_HIDING_PLACES = 64
"""Maximum number of hiding places that an evader considers: the nearest ones."""


class Zigzag(Fleeing):
    """Flee from the nearest pursuer at an angle, to the left for half a period and to the right for the other half."""

    kind: Literal["zigzag"] = "zigzag"
    period: Period = 2.0
    """Period of the zigzag, s: half of it to the left, then half of it to the right. A period begins at time 0."""
    amplitude: Annotated[float, Field(ge=0, le=pi, strict=True)] = 0.7
    """Angle from the heading of pure evasion, rad."""

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the heading of pure evasion, rotated by the amplitude to the left or right."""
        half_periods = 2 * state.stamp // round(self.period * 1e9)  # that have passed; both times are in ns
        return away(self.fled_from(state)) * rect(1.0, -self.amplitude if half_periods % 2 else self.amplitude)


class VoronoiVertex(Fleeing):
    """Go to the farthest point of an arena that the evader would reach before any pursuer if all had equal speeds.

    This point is a vertex of the Voronoi cell of the evader. On the way another vertex may become the farthest; the
    hysteresis delays the turn to it. An evader outside the arena goes to the nearest point of the arena.
    """

    assumes_plane: ClassVar[bool] = True
    kind: Literal["voronoi_vertex"] = "voronoi_vertex"
    arena: Annotated[tuple[Coordinate, Coordinate], AfterValidator(_increasing)]
    """Lower and upper bound of both coordinates of the arena, m."""
    hysteresis: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.1
    """Share by which another vertex must be farther than the vertex ahead before the evader turns to it. The vertex
    ahead is the one closest to the present heading.

    With 0 the evader may turn back and forth between two vertices at each motion step; with values near 1 it goes on to
    a vertex that has become worse.

    If in doubt, use 0.1.
    """

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the heading to the farthest vertex, or to the vertex ahead if it is almost as far."""
        fled_from = self.fled_from(state)
        if not len(fled_from.pursuers):
            return 0j
        x, y = (
            min(max(coordinate, self.arena[0]), self.arena[1]) for coordinate in (state.evader.real, state.evader.imag)
        )
        if complex(x, y) != state.evader:
            return unit(complex(x, y) - state.evader)
        vertices = voronoi_cell(fled_from, self.arena)
        goal = max(vertices, key=abs)
        ahead = max(vertices, key=lambda vertex: (unit(vertex) * state.heading.conjugate()).real)
        near_enough = state.heading and abs(goal) <= (1.0 + self.hysteresis) * abs(ahead)
        return unit(ahead if near_enough else goal)


class Diffusion(Value):
    """Move randomly, independently of the pursuers: the initial angle is uniform and then follows a Brownian motion."""

    turns_at_once: ClassVar[bool] = False
    kind: Literal["diffusion"] = "diffusion"
    sigma: Annotated[float, Field(ge=0, le=1e6, strict=True), Unsigned] = 0.5
    """Diffusion of the angle, rad/sqrt(s): after a time t the standard deviation of the angle is sigma sqrt(t).

    The evader keeps its direction for about 2 / sigma^2.

    If in doubt, use 0.5: the evader keeps its direction for about 8 s.
    """

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the present heading, rotated by a normal angle of variance sigma^2 times the elapsed time."""
        if not state.heading:
            return random_heading(rng)
        return unit(state.heading * rect(1.0, rng.normal(0.0, self.sigma * sqrt(state.elapsed))))


class ConstantHeading(Value):
    """Move straight, independently of the pursuers."""

    turns_at_once: ClassVar[bool] = False
    kind: Literal["constant_heading"] = "constant_heading"
    angle: Annotated[float, Field(ge=-2 * pi, le=2 * pi, strict=True)] | None = None
    """Angle from the x axis, rad; if absent, a uniform random draw per seed."""

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the heading at the given angle; without one, the present heading, which is random at first."""
        return rect(1.0, self.angle) if self.angle is not None else unit(state.heading) or random_heading(rng)


class Still(Value):
    """Stand still."""

    turns_at_once: ClassVar[bool] = False
    kind: Literal["still"] = "still"

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return 0."""
        return 0j


SIMPLE = (
    *(PureEvasion, WeightedFlee, MaxMin, MaxGeodesic, Hide, Zigzag, VoronoiVertex, Diffusion, ConstantHeading, Still),
)
CALLED_WITH = ("state", "rng")


class Listener(Value):
    """Eavesdrop on the pursuers' radio: follow one strategy during a handover, and another otherwise.

    A handover lasts while an announcement of a change of action is in flight. Each strategy continues from the heading
    of the other.
    """

    listens: ClassVar[bool] = True

    @property
    def assumes_plane(self) -> bool:
        """Whether one of the strategies takes straight lines for shortest paths."""
        return any(StrategyTraits.of(strategy).assumes_plane for strategy in (self.during_handover, self.normally))

    kind: Literal["listener"] = "listener"
    during_handover: Annotated[Strategy, OneOf(*SIMPLE, takes=CALLED_WITH, traits=StrategyTraits)] = PureEvasion()
    """The strategy during a handover."""
    normally: Annotated[Strategy, OneOf(*SIMPLE, takes=CALLED_WITH, traits=StrategyTraits)] = Still()
    """The strategy at all other times."""

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the heading of `during_handover` during a handover, else that of `normally`."""
        return (self.during_handover if state.handover else self.normally)(state, rng)


STRATEGIES = OneOf(*SIMPLE, RecordedMotion, Listener, takes=CALLED_WITH, traits=StrategyTraits)
"""The strategies of an evader."""


def unit(vector: complex) -> complex:
    """Return the direction of a vector; 0 if it is 0."""
    return vector / abs(vector) if vector else 0j


def random_heading(rng: np.random.Generator) -> complex:
    """Return a heading in a uniformly distributed random direction."""
    return rect(1.0, rng.uniform(0.0, 2.0 * pi))


@lru_cache(maxsize=256)
def _turns(count: int) -> Points:
    """Return (count,) evenly spaced unit vectors, counter-clockwise from the x axis."""
    return np.array([rect(1.0, 2.0 * pi * k / count) for k in range(count)])


def away(state: State) -> complex:
    """Return the heading straight away from the nearest pursuer; 0 at distance 0 or without pursuers."""
    return unit(state.offsets.item(state.nearest)) if state.nearest >= 0 else 0j


def first_of_greatest(values: Floats) -> int:
    """Return the index of the first of (K,) values, at least 0, that is the greatest up to rounding.

    Two headings at equal angles to the line of sight of the nearest pursuer are often equally good; the last digit of
    their values depends on where in the plane the pursuit is.
    """
    return int((values >= values.max() * (1.0 - ROUNDING)).argmax())


def first_captures(state: EvaderObservation, headings: Points) -> Floats:
    """Return the (K,) least intercept times, s, over all pursuers, one for each of (K,) constant headings."""
    velocities = state.speed * headings[:, np.newaxis]
    times: Floats = intercept_times(state.offsets, velocities, state.speeds, state.radius).min(axis=1)
    return times


def voronoi_cell(state: State, arena: tuple[float, float]) -> list[complex]:
    """Return the vertices, m, of the evader's Voronoi cell in an arena, relative to the evader."""
    (low, high), evader = arena, state.evader
    cell = [complex(x, y) - evader for x, y in ((low, low), (high, low), (high, high), (low, high))]
    for pursuer in state.distances.argsort(kind="stable"):
        middle = complex(state.offsets[pursuer]) / -2.0
        if abs(middle) >= max(map(abs, cell)):
            break  # neither this pursuer nor a farther one cuts the cell
        cell = _clipped(cell, middle)
    return cell


def _clipped(polygon: list[complex], middle: complex) -> list[complex]:
    """Return the part of a convex polygon that is nearer to the origin than to the point `2 * middle`."""
    beyond = [((z - middle) * middle.conjugate()).real for z in polygon]
    clipped = []
    for k, z in enumerate(polygon):
        if (beyond[k - 1] > 0.0) != (beyond[k] > 0.0):  # the edge to this vertex crosses the bisector
            share = beyond[k - 1] / (beyond[k - 1] - beyond[k])
            clipped.append(polygon[k - 1] + share * (z - polygon[k - 1]))
        if beyond[k] <= 0.0:
            clipped.append(z)
    return clipped
