"""False capture times and positions, as functions of the true ones: what a liar (`lies`) announces."""

from math import inf
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from desim.config.choice import OneOf
from desim.config.model import MAX_TIME, Box, Coordinate, Limit, Value


class ConstantTime(Value):
    """The same capture time in each announcement."""

    kind: Literal["constant"] = "constant"
    value: Limit = 0.0
    """s"""

    def __call__(self, truth: float, least: float, rng: np.random.Generator) -> float:
        """Return the announced capture time, s."""
        return self.value


class ScaledTime(Value):
    """The true capture time times a factor."""

    kind: Literal["scaled"] = "scaled"
    factor: Limit = 0.5

    def __call__(self, truth: float, least: float, rng: np.random.Generator) -> float:
        """Return the announced capture time, s."""
        return truth * self.factor if truth < inf else inf


class RandomTime(Value):
    """A uniform random capture time, drawn for each announcement."""

    kind: Literal["random"] = "random"
    low: Annotated[float, Field(ge=0, le=MAX_TIME, strict=True)] = 0.0
    """s"""
    high: Annotated[float, Field(ge=0, le=MAX_TIME, strict=True)] = 10.0
    """s"""

    @model_validator(mode="after")
    def _is_ordered(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low should be at most high (got {self.low:g} and {self.high:g})")
        return self

    def __call__(self, truth: float, least: float, rng: np.random.Generator) -> float:
        """Return the announced capture time, s."""
        return rng.uniform(self.low, self.high)


class PlausibleTime(Value):
    """The least capture time that a pursuer at this place could have: no observer of its position can refute it."""

    kind: Literal["plausible"] = "plausible"

    def __call__(self, truth: float, least: float, rng: np.random.Generator) -> float:
        """Return the announced capture time, s."""
        return min(truth, least)


FALSE_TIMES = OneOf(
    *(ConstantTime, ScaledTime, RandomTime, PlausibleTime),
    takes=("truth", "least", "rng"),
    number=("constant", "value"),
)


class ConstantPosition(Value):
    """The same position in each announcement."""

    kind: Literal["constant"] = "constant"
    value: tuple[Coordinate, Coordinate]
    """[x, y], m."""

    def __call__(self, truth: complex, rng: np.random.Generator) -> complex:
        """Return the announced position, m."""
        return complex(*self.value)


class ShiftedPosition(Value):
    """The true position plus a constant vector."""

    kind: Literal["shifted"] = "shifted"
    by: tuple[Coordinate, Coordinate] = (5.0, 0.0)
    """[x, y], m."""

    def __call__(self, truth: complex, rng: np.random.Generator) -> complex:
        """Return the announced position, m."""
        return truth + complex(*self.by)


class RandomPosition(Value):
    """A uniform random position, drawn for each announcement."""

    kind: Literal["random"] = "random"
    box: Box = (0.0, 20.0)
    """Lower and upper bound of both coordinates, m."""

    def __call__(self, truth: complex, rng: np.random.Generator) -> complex:
        """Return the announced position, m."""
        return complex(rng.uniform(*self.box), rng.uniform(*self.box))


FALSE_POSITIONS = OneOf(ConstantPosition, ShiftedPosition, RandomPosition, takes=("truth", "rng"))
