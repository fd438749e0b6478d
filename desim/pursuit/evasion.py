"""How an evader flees: a strategy maps what the evader knows to a heading.

A strategy is a frozen value that remembers nothing: of the past it is told the heading it chose last, and how long ago.
No parameter depends on the motion step, so that a strategy obeys the same law however often it is asked.
"""

from cmath import rect
from functools import lru_cache
from math import pi, sqrt
from typing import Annotated, ClassVar, Literal, Protocol

import numpy as np
from pydantic import AfterValidator, Field

from desim.config.choice import OneOf
from desim.config.model import Coordinate, Limit, Period, Unsigned, Value
from desim.kernel.portable_math import power
from desim.pursuit.capture import intercept_time
from desim.pursuit.observation import EvaderObservation
from desim.pursuit.state import Floats, Points, State, coordinates


def _with_area(bounds: tuple[float, float]) -> tuple[float, float]:
    if not bounds[0] < bounds[1]:
        raise ValueError(f"should be [lower, upper] with lower < upper (got {bounds[0]:g} and {bounds[1]:g})")
    return bounds


class Strategy(Protocol):
    """An evader's strategy: `strategy(state, rng)` is a unit heading (a complex number), or 0 to stand still.

    One that reads `state.handover` has an attribute `listens` that is true.
    """

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex: ...  # noqa: D102


class Fleeing(Value):
    """What strategies share that flee from pursuers: while there are none to flee from, the evader stands still."""

    flees_from: Literal["all", "active"] = "all"
    """Whom it flees: all pursuers that it sees, or only those of them that chase."""

    def fled_from(self, state: EvaderObservation) -> EvaderObservation:
        """Return what is left of an outlook without those that do not matter."""
        return state if self.flees_from == "all" else state.only(state.active)


class PureEvasion(Fleeing):
    """Flee straight from the nearest pursuer (Lee & Bakolas, "Pure evasion")."""

    kind: Literal["pure_evasion"] = "pure_evasion"

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return u_e = (x_e - x_k) / |x_e - x_k| for the nearest pursuer k; 0 if it is right here."""
        return away(self.fled_from(state))


ROUNDING = 1e-12
"""Unit vectors that add up to less than this each cancel."""


class WeightedFlee(Fleeing):
    """Flee from all pursuers at once, the more from each the nearer it is."""

    kind: Literal["weighted_flee"] = "weighted_flee"
    power: Limit = 2.0
    """How much more the nearer count, p: as 1 / distance^p; inf: only the nearest."""

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the direction of sum_i xi_i / |xi_i|^(p + 1), xi_i = x_e - x_i; 0 if it cancels or one is here."""
        fled_from = self.fled_from(state)
        if not away(fled_from):
            return 0j
        distances = fled_from.distances
        weights = power(distances[fled_from.nearest] / distances, self.power)  # at most 1, so that nothing overflows
        push = complex((fled_from.offsets / distances * weights).sum())
        return unit(push) if abs(push) > ROUNDING * len(distances) else 0j


class MaxMin(Fleeing):
    """Flee on the straight line on which the first capture is latest, if all pursuers head it off."""

    kind: Literal["max_min"] = "max_min"
    candidates: Annotated[int, Field(ge=1, le=3600, strict=True)] = 72
    """Number of headings that are compared, evenly spaced; one is that of pure evasion."""

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the u among the candidates with the greatest min_i phi_i(u), the first from pure evasion on."""
        fled_from = self.fled_from(state)
        straight = away(fled_from)
        if not straight:
            return 0j
        turns = _turns(self.candidates)
        headings = straight.real * turns + straight.imag * (1j * turns)  # numpy rounds a complex product by processor
        return complex(headings[first_captures(fled_from, headings).argmax()])


class Zigzag(Fleeing):
    """Flee from the nearest pursuer, half a period to the left of straight away, and half a period to the right."""

    kind: Literal["zigzag"] = "zigzag"
    period: Period = 2.0
    """Time of a turn to the left and one to the right, s; the first begins at 0."""
    amplitude: Annotated[float, Field(ge=0, le=pi, strict=True)] = 0.7
    """Angle from straight away, rad."""

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the heading of pure evasion, turned."""
        halves = 2 * state.t // round(self.period * 1e9)  # ns
        return away(self.fled_from(state)) * rect(1.0, -self.amplitude if halves % 2 else self.amplitude)


class VoronoiVertex(Fleeing):
    """Go to the farthest point of an arena that it could reach before any pursuer, were all equally fast.

    That is a vertex of its Voronoi cell. As it goes there others become farther; the hysteresis lets it go on for a
    while before it turns. From outside the arena it goes to the nearest point of it.
    """

    kind: Literal["voronoi_vertex"] = "voronoi_vertex"
    arena: Annotated[tuple[Coordinate, Coordinate], AfterValidator(_with_area)]
    """Lower and upper bound of both coordinates, m."""
    hysteresis: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.1
    """By which share another vertex must be farther than the one ahead for it to turn."""

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the heading of the farthest vertex, or of the one ahead if that is almost as far."""
        fled_from = self.fled_from(state)
        if not len(fled_from.pursuers):
            return 0j
        x, y = (min(max(each, self.arena[0]), self.arena[1]) for each in (state.evader.real, state.evader.imag))
        if complex(x, y) != state.evader:
            return unit(complex(x, y) - state.evader)
        vertices = voronoi_cell(fled_from, self.arena)
        goal = max(vertices, key=abs)
        ahead = max(vertices, key=lambda vertex: (unit(vertex) * state.heading.conjugate()).real)
        near_enough = state.heading and abs(goal) <= (1.0 + self.hysteresis) * abs(ahead)
        return unit(ahead if near_enough else goal)


class Diffusion(Value):
    """Wander: the heading is anything at first, and then a Brownian motion, whatever the pursuers do."""

    kind: Literal["diffusion"] = "diffusion"
    sigma: Annotated[float, Field(ge=0, le=1e6, strict=True), Unsigned] = 0.5
    """After a time t the heading has turned by an angle of standard deviation sigma sqrt(t), rad/sqrt(s)."""

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the present heading, turned by a normal angle of variance sigma^2 times the time that has passed."""
        if not state.heading:
            return random_heading(rng)
        return unit(state.heading * rect(1.0, rng.normal(0.0, self.sigma * sqrt(state.elapsed))))


class ConstantHeading(Value):
    """Go straight on, whatever the pursuers do."""

    kind: Literal["constant_heading"] = "constant_heading"
    angle: Annotated[float, Field(ge=-2 * pi, le=2 * pi, strict=True)] | None = None
    """Angle from the x axis, rad; if absent it is drawn as the evader sets off, anew for every seed."""

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the heading."""
        return rect(1.0, self.angle) if self.angle is not None else unit(state.heading) or random_heading(rng)


class Still(Value):
    """Stand still."""

    kind: Literal["still"] = "still"

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return 0."""
        return 0j


SIMPLE = (PureEvasion, WeightedFlee, MaxMin, Zigzag, VoronoiVertex, Diffusion, ConstantHeading, Still)
CALLED_WITH = ("state", "rng")


class Listener(Value):
    """Listen to the pursuers' radio: one strategy while a hand-over is in flight, another else.

    A hand-over is in flight while word of a change of action is. Each strategy goes on from the heading of the other.
    """

    listens: ClassVar[bool] = True
    kind: Literal["listener"] = "listener"
    during_handover: Annotated[Strategy, OneOf(*SIMPLE, takes=CALLED_WITH)] = PureEvasion()
    """What it does while a hand-over is in flight."""
    normally: Annotated[Strategy, OneOf(*SIMPLE, takes=CALLED_WITH)] = Still()
    """What it does else."""

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the heading of the strategy whose turn it is."""
        return (self.during_handover if state.handover else self.normally)(state, rng)


STRATEGIES = OneOf(*SIMPLE, Listener, takes=CALLED_WITH)
"""What an evader may do."""


def unit(vector: complex) -> complex:
    """Return the direction of a vector; 0 if it is 0."""
    return vector / abs(vector) if vector else 0j


def random_heading(rng: np.random.Generator) -> complex:
    """Return a heading in any direction."""
    return rect(1.0, rng.uniform(0.0, 2.0 * pi))


@lru_cache(maxsize=256)
def _turns(count: int) -> Points:
    """Return the (count,) unit vectors that are evenly spaced, counter-clockwise from the x axis."""
    return np.array([rect(1.0, 2.0 * pi * k / count) for k in range(count)])


def away(state: State) -> complex:
    """Return the heading straight away from the nearest pursuer; 0 if it is right here or there is none."""
    return unit(complex(state.offsets[state.nearest])) if state.nearest >= 0 else 0j


def first_captures(state: EvaderObservation, headings: Points) -> Floats:
    """Return when the first pursuer could capture an evader that keeps to each of (K,) headings, s."""
    evader, pursuers = coordinates(np.array([state.evader]))[0], coordinates(state.pursuers)
    velocities = state.speed * coordinates(headings)
    times: Floats = intercept_time(evader, velocities, pursuers, state.speeds, state.radius).min(axis=1)
    return times


def voronoi_cell(state: State, arena: tuple[float, float]) -> list[complex]:
    """Return the vertices of what is nearer to the evader than to all pursuers in an arena, seen from the evader, m."""
    (low, high), evader = arena, state.evader
    cell = [complex(x, y) - evader for x, y in ((low, low), (high, low), (high, high), (low, high))]
    for pursuer in state.distances.argsort():
        middle = complex(state.offsets[pursuer]) / -2.0
        if abs(middle) >= max(map(abs, cell)):
            break  # nobody from here on is near enough
        cell = _clipped(cell, middle)
    return cell


def _clipped(polygon: list[complex], middle: complex) -> list[complex]:
    """Return what of a convex polygon is on the near side of the line that is perpendicular to `middle` there."""
    beyond = [((z - middle) * middle.conjugate()).real for z in polygon]
    kept = []
    for k, z in enumerate(polygon):
        if (beyond[k - 1] > 0.0) != (beyond[k] > 0.0):
            share = beyond[k - 1] / (beyond[k - 1] - beyond[k])
            kept.append(polygon[k - 1] + share * (z - polygon[k - 1]))
        if beyond[k] <= 0.0:
            kept.append(z)
    return kept
