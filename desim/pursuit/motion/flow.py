"""Flow: a moving medium, such as air or water, that carries the players.

A player in the flow moves over ground with the sum of its own velocity and that of the flow. Its speed, its commanded
velocity and its course are relative to the flow. Points and velocities are complex numbers, as in
`desim.pursuit.core.state`.
"""

from bisect import bisect_right
from cmath import isfinite
from collections.abc import Mapping, Sequence
from functools import cache, cached_property
from itertools import accumulate, pairwise
from math import inf, pi, sin
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, Protocol, Self, TypeGuard, cast

import numpy as np
from pydantic import Field, ModelWrapValidatorHandler, ValidationInfo, model_validator

from desim.config.answers import wrong_answer
from desim.config.arrays import Floats, Points
from desim.config.choice import OneOf
from desim.config.model import MAX_COORDINATE, Coordinate, Duration, FirstError, Length, Limit, Speed, Time, Value
from desim.config.number_files import is_fill
from desim.config.python_numbers import as_complex, check_times
from desim.config.traits import Follows, Traits
from desim.config.trust import resolve_path
from desim.kernel.core import portable_math
from desim.kernel.measured.measurements import PER_SECOND, Unit, timed_rows

VelocityComponent = Annotated[float, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE, allow_inf_nan=False, strict=True)]
"""A component of a velocity, m/s."""
FlowVelocity = tuple[VelocityComponent, VelocityComponent]


class FlowTraits(Traits):
    """The optional attributes of a flow, in addition to `__call__`."""

    twins: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType(
        dict.fromkeys(("displacement", "trend", "top_acceleration"), ("velocity_at", "__call__"))
    )
    top_speed: Annotated[Limit, Follows("__call__", "velocity_at")] = inf
    """Upper bound of its speed everywhere and at all times, m/s."""


class Flow(Protocol):
    """A flow: `flow(places, t)` returns the (k,) velocities, m/s, at (k,) places, m, at a time, s."""

    def __call__(self, places: Points, t: float) -> Points: ...  # noqa: D102


class UniformFlow(Value):
    """Base of the flows that are the same everywhere."""

    def __call__(self, places: Points, t: float) -> Points:
        """Return the (k,) velocities, m/s."""
        return np.full(len(places), self.velocity_at(t))

    def velocity_at(self, t: float) -> complex:
        """Return the velocity at a time (s), m/s."""
        raise NotImplementedError

    def displacement(self, begin: float, end: float) -> complex:
        """Return the integral of the velocity between two times (s), m."""
        raise NotImplementedError

    def trend(self, begin: float) -> tuple[complex, float]:
        """Return a mean velocity, m/s, and an upper bound, m.

        From `begin` (s) on, the displacement differs from that at the mean velocity by at most this bound.
        """
        raise NotImplementedError

    @property
    def top_speed(self) -> float:
        """The greatest speed, m/s."""
        raise NotImplementedError

    @property
    def top_acceleration(self) -> float:
        """The greatest rate of change of the velocity, m/s^2."""
        raise NotImplementedError


class NoFlow(UniformFlow):
    """The medium is at rest."""

    kind: Literal["none"] = "none"
    top_speed: ClassVar[float] = 0.0
    top_acceleration: ClassVar[float] = 0.0

    def velocity_at(self, t: float) -> complex:
        """Return 0."""
        return 0j

    def displacement(self, begin: float, end: float) -> complex:
        """Return 0."""
        return 0j

    def trend(self, begin: float) -> tuple[complex, float]:
        """Return a velocity of 0 and a bound of 0."""
        return 0j, 0.0


class SteadyFlow(UniformFlow):
    """A flow of constant velocity."""

    kind: Literal["uniform"] = "uniform"
    velocity: FlowVelocity
    """Velocity [x, y], m/s."""
    top_acceleration: ClassVar[float] = 0.0

    def velocity_at(self, t: float) -> complex:
        """Return the velocity, m/s."""
        return complex(*self.velocity)

    def displacement(self, begin: float, end: float) -> complex:
        """Return the displacement between two times, m."""
        return complex(*self.velocity) * (end - begin)

    def trend(self, begin: float) -> tuple[complex, float]:
        """Return the velocity, m/s, and 0."""
        return complex(*self.velocity), 0.0

    @property
    def top_speed(self) -> float:
        """The speed, m/s."""
        return abs(complex(*self.velocity))


class HarmonicFlow(UniformFlow):
    """A flow that oscillates: velocity + amplitude sin(2 pi t / period + phase)."""

    kind: Literal["harmonic"] = "harmonic"
    velocity: FlowVelocity = (0.0, 0.0)
    """Mean velocity [x, y], m/s."""
    amplitude: FlowVelocity
    """Amplitude [x, y], m/s."""
    period: Duration
    """Period, s."""
    phase: Annotated[float, Field(ge=-2 * pi, le=2 * pi, allow_inf_nan=False, strict=True)] = 0.0
    """Phase at time 0, rad."""

    def velocity_at(self, t: float) -> complex:
        """Return the velocity at a time (s), m/s."""
        return complex(*self.velocity) + complex(*self.amplitude) * sin(self._rate * t + self.phase)

    def displacement(self, begin: float, end: float) -> complex:
        """Return the displacement between two times (s), m."""
        middle, half = self._rate * (begin + end) / 2.0 + self.phase, self._rate * (end - begin) / 2.0
        swing = 2.0 / self._rate * sin(middle) * sin(half)  # the difference of two cosines, without cancellation
        return complex(*self.velocity) * (end - begin) + complex(*self.amplitude) * swing

    def trend(self, begin: float) -> tuple[complex, float]:
        """Return the mean velocity, m/s, and the greatest displacement by the oscillation, m."""
        return complex(*self.velocity), 2.0 * abs(complex(*self.amplitude)) / self._rate

    @property
    def top_speed(self) -> float:
        """An upper bound of the speed, m/s."""
        return abs(complex(*self.velocity)) + abs(complex(*self.amplitude))

    @property
    def top_acceleration(self) -> float:
        """The greatest rate of change of the velocity, m/s^2."""
        return abs(complex(*self.amplitude)) * self._rate

    @property
    def _rate(self) -> float:
        """The angular frequency, rad/s."""
        return 2.0 * pi / self.period


class RecordedFlow(UniformFlow):
    """A measured flow, the same everywhere: linear in time between the measurements, and constant outside of them."""

    kind: Literal["recorded"] = "recorded"
    velocities: Annotated[
        tuple[Annotated[tuple[Time, VelocityComponent, VelocityComponent], FirstError()], ...], FirstError()
    ] = ()
    """Measurements [t, x, y] (s, m/s, m/s), in order of time."""
    file: str | None = None
    """Instead of measurements: path of a CSV file with the columns t, x and y, relative to the scenario file. The file
    is read once, when the model is created. If its times are dates, or count from a date, the earliest is time 0."""
    time_unit: Unit = "s"
    """Unit of the times of the file: s, ms, us or ns; if in doubt, s."""

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, data: Any, make: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        if not isinstance(data, dict) or data.get("file") is None:
            check_times(data.get("velocities") if isinstance(data, dict) else None, "velocities")
            return make(data)
        if "velocities" in data:
            raise ValueError("should have velocities or a file of velocities, not both")
        unit = data.get("time_unit", "s")
        if not isinstance(unit, str) or unit not in PER_SECOND:
            return make(data)  # which raises the error
        rows, places = timed_rows(resolve_path(data["file"], info), ("t", "x", "y"), cast("Unit", unit))
        _check_measurements(rows, places)
        return make(data | {"file": None, "time_unit": "s", "velocities": rows})

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if not self.velocities:
            raise ValueError("should have velocities, or a file of velocities")
        _check_measurements(self.velocities, [f"velocities.{k}" for k in range(len(self.velocities))])
        return self

    def velocity_at(self, t: float) -> complex:
        """Return the velocity at a time (s), m/s."""
        k = bisect_right(self._times, t)
        if k in {0, len(self._times)}:
            return self._values[min(k, len(self._times) - 1)]
        share = (t - self._times[k - 1]) / (self._times[k] - self._times[k - 1])
        return self._values[k - 1] + share * (self._values[k] - self._values[k - 1])

    def displacement(self, begin: float, end: float) -> complex:
        """Return the displacement between two times (s), m."""
        return self._position(end) - self._position(begin)

    def trend(self, begin: float) -> tuple[complex, float]:
        """Return the last velocity, m/s, and a bound, m, of the displacement relative to this velocity."""
        last, first = self._values[-1], self._times[0]
        difference = abs(self.velocity_at(begin) - last)
        bound = difference * max(first - begin, 0.0)
        k = max(bisect_right(self._times, begin), 1)
        terms = self._bounds[k - 1 :].copy()
        if len(terms):
            terms[0] = max(difference, abs(self._values[k] - last)) * (self._times[k] - max(begin, first))
            bound += float(np.add.accumulate(terms)[-1])
        return last, bound

    @cached_property
    def top_speed(self) -> float:
        """The greatest speed, m/s."""
        return max(map(abs, self._values))

    @cached_property
    def top_acceleration(self) -> float:
        """The greatest rate of change of the velocity, m/s^2."""
        changes = zip(pairwise(self._times), pairwise(self._values), strict=True)
        return max((abs(w - v) / (t - s) for (s, t), (v, w) in changes), default=0.0)

    def _position(self, t: float) -> complex:
        """Return the displacement from the first measurement to a time (s), which may be earlier, m."""
        k = max(bisect_right(self._times, t) - 1, 0)
        elapsed = t - self._times[k]
        # The velocity is linear between two measurements, so the trapezoid is its integral.
        return self._integrals[k] + (self._values[k] + self.velocity_at(t)) * (elapsed / 2.0)

    @cached_property
    def _times(self) -> list[float]:
        return [t for t, _, _ in self.velocities]

    @cached_property
    def _values(self) -> list[complex]:
        return [complex(x, y) for _, x, y in self.velocities]

    @cached_property
    def _integrals(self) -> list[complex]:
        """The displacement from the first measurement to each, m."""
        pieces = zip(pairwise(self._times), pairwise(self._values), strict=True)
        return [*accumulate(((v + w) * ((t - s) / 2.0) for (s, t), (v, w) in pieces), initial=0j)]

    @cached_property
    def _bounds(self) -> Floats:
        """A bound of the displacement between two measurements relative to the last velocity, m."""
        differences = [abs(value - self._values[-1]) for value in self._values]
        pieces = zip(pairwise(self._times), pairwise(differences), strict=True)
        return np.array([max(v, w) * (t - s) for (s, t), (v, w) in pieces])


def _check_measurements(rows: Sequence[Sequence[float]], places: Sequence[str]) -> None:
    """Raise ValueError, with the place of a row, unless rows (t, x, y) are in order of time and none is missing."""
    for (before, *_), (t, *_), place in zip(rows, rows[1:], places[1:], strict=False):
        if not before < t:
            raise ValueError(f"{place}: t should increase; after {before:g} s comes {t:g} s")
    for (_, *components), place in zip(rows, places, strict=True):
        for component in components:
            if is_fill(component) or abs(component) > MAX_COORDINATE:
                text = f"{component:g} m/s probably stands for a missing value: leave the measurement out"
                raise ValueError(f"{place}: {text}")


class AffineFlow(Value):
    """A flow that expands or contracts, and rotates, about a centre: velocity + (a + i omega) (place - centre).

    The distance d of two players in this flow changes at the rate a d in addition to their own motion. The rotation
    does not change it.
    """

    kind: Literal["affine"] = "affine"
    velocity: FlowVelocity = (0.0, 0.0)
    """Velocity [x, y] at the centre, m/s."""
    expansion: Annotated[float, Field(ge=-100.0, le=100.0, allow_inf_nan=False, strict=True)] = 0.0
    """Rate of expansion a, 1/s; negative for a contraction."""
    rotation: Annotated[float, Field(ge=-100.0, le=100.0, allow_inf_nan=False, strict=True)] = 0.0
    """Rate of rotation omega, rad/s, positive to the left."""
    centre: tuple[Coordinate, Coordinate] = (0.0, 0.0)
    """Centre [x, y], m."""

    def __call__(self, places: Points, t: float) -> Points:
        """Return the (k,) velocities, m/s."""
        return complex(*self.velocity) + complex(self.expansion, self.rotation) * (places - complex(*self.centre))


class GyreFlow(Value):
    """A flow of square cells that rotate alternately to the left and to the right (Solomon & Gollub 1988).

    Its stream function is (U L / pi) sin(pi (x - s) / L) sin(pi y / L), where s = shift sin(2 pi t / period).
    """

    kind: Literal["gyre"] = "gyre"
    speed: Speed
    """Greatest speed U, m/s."""
    size: Length
    """Edge of a cell L, m."""
    shift: Annotated[float, Field(ge=0, le=MAX_COORDINATE, allow_inf_nan=False, strict=True)] = 0.0
    """Greatest shift of the cells along x, m; 0 = the flow is constant in time."""
    period: Duration = 10.0
    """Period of the shift, s."""

    def __call__(self, places: Points, t: float) -> Points:
        """Return the (k,) velocities, m/s."""
        scale, shift = pi / self.size, self.shift * sin(2.0 * pi * t / self.period)
        x, y = (places.real - shift) * scale, places.imag * scale
        sin_x, cos_x, sin_y, cos_y = (f(z) for z in (x, y) for f in (portable_math.sin, portable_math.cos))
        return complex(-self.speed) * (sin_x * cos_y) + 1j * self.speed * (cos_x * sin_y)

    @property
    def top_speed(self) -> float:
        """The greatest speed, m/s."""
        return self.speed


def is_uniform(flow: Flow) -> TypeGuard[UniformFlow]:
    """Return whether a flow is the same everywhere, and its displacement is known in closed form."""
    return isinstance(flow, UniformFlow) and _is_closed(type(flow))


@cache
def _is_closed(flow: type[UniformFlow]) -> bool:
    """Return whether the closed forms of a class belong to its `velocity_at`, and it has no `__call__` of its own."""
    follows = Follows("velocity_at", "displacement")
    closed = ("displacement", "trend", "top_acceleration")
    return flow.__call__ is UniformFlow.__call__ and not any(follows.is_outdated(name, flow) for name in closed)


def displacement(flow: UniformFlow, begin: float, end: float) -> complex:
    """Return the displacement by a flow between two times (s), m; see `UniformFlow.displacement`.

    Raises:
        ValueError: if a user's flow returns no finite number.
    """
    answer: Any = flow.displacement(begin, end)
    vector = as_complex(answer)
    if not isfinite(vector):
        raise wrong_answer("displacement of a flow should return a finite complex number, in m", answer, flow)
    return vector


FLOWS = OneOf(
    *(NoFlow, SteadyFlow, HarmonicFlow, RecordedFlow, AffineFlow, GyreFlow), takes=("places", "t"), traits=FlowTraits
)
"""The kinds of flow."""
