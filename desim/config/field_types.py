"""The types of fields of models: lengths, times, probabilities, ... with their units, bounds and markers."""

from collections.abc import Sized
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Discriminator,
    FailFast,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from desim.config.json_numbers import from_json

# Numbers and booleans are strict: the string "60" is not 60, and true is not 1.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
MAX_COORDINATE = 1e9
"""Largest length or absolute coordinate, m; also the largest speed, m/s."""
Coordinate = Annotated[float, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE, allow_inf_nan=False, strict=True)]
"""m"""


def _ordered(bounds: tuple[float, float]) -> tuple[float, float]:
    if bounds[0] > bounds[1]:
        raise ValueError(f"should be [lower, upper] (got {bounds[0]:g} and {bounds[1]:g})")
    return bounds[0] + 0.0, bounds[1] + 0.0  # -0 becomes 0: numpy refuses to draw from 0 to -0


Box = Annotated[tuple[Coordinate, Coordinate], AfterValidator(_ordered)]
"""Lower and upper bound of both coordinates, m."""
Length = Annotated[float, Field(gt=0, le=MAX_COORDINATE, allow_inf_nan=False, strict=True)]
"""m"""
Speed = Annotated[float, Field(ge=0, le=MAX_COORDINATE, allow_inf_nan=False, strict=True)]
"""m/s"""
Probability = Annotated[float, Field(ge=0, le=1, strict=True)]


Extent = Annotated[float, Field(gt=0, strict=True), BeforeValidator(from_json)]
"""A positive number or infinity; in JSON, infinity is the string "Infinity"."""
Limit = Annotated[float, Field(ge=0, strict=True), BeforeValidator(from_json)]
"""An upper bound >= 0, possibly infinite; in JSON, infinity is the string "Infinity"."""
MAX_TIME = 1e9
"""Longest time, s: about thirty years."""
RESOLUTION = 1e-9
"""Resolution of the clock, s. Times up to half of it are rounded to 0."""
MIN_PERIOD = 1e-6
"""Shortest period of recurring events, s. With a shorter one a run would take too long."""
Unsigned = AfterValidator(lambda number: number + 0.0)
"""Replaces -0 by 0, because numpy rejects -0 as a negative scale."""


def in_forms(*forms: str) -> Discriminator:
    """Return the discriminator of a union that selects a member by the form of a value: a list, a table, a number, ...

    Args:
        forms: the tags of the members. All but the last are "text", "list" or "table"; the last stands for any other
            form, whatever its name.
    """
    types: dict[str, Any] = {"text": str, "list": list | tuple, "table": dict | BaseModel}

    def form_of(value: Any) -> str:
        value = from_json(value) if isinstance(value, str) else value  # in JSON, infinity is a text
        return next((form for form in forms[:-1] if isinstance(value, types[form])), forms[-1])

    return Discriminator(form_of)


class FirstError(FailFast):
    """Marks a list of numbers: of the items that are wrong, only the first is reported."""

    def __hash__(self) -> int:  # `typing` hashes the members of a union
        return hash(type(self))


class AnyOrder:
    """Marks a list of integers whose order has no effect: a set is accepted, too, and sorted."""


class NotEmpty:
    """Marks a list that has at least one item.

    pydantic's own `min_length` counts valid items only, so it would report a second error beside that of an item.
    """

    min_length = 1  # the name of pydantic's bound, for readers of markers

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(_not_empty, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return handler(schema) | {"minItems": 1}


def _not_empty(items: Sized) -> Sized:
    if not items:
        context = {"min_length": 1, "actual_length": 0}
        raise PydanticCustomError("too_short", "should have at least 1 item, has none", context)
    return items


class Counted:
    """Marks a field that is a time, which the clock rounds to whole nanoseconds."""


class Recurring:
    """Marks a field that is the time between successive events."""


Time = Annotated[float, Field(ge=0, le=MAX_TIME, allow_inf_nan=False, strict=True), Unsigned, Counted]
"""A time or a delay, s."""
Horizon = Annotated[float, Field(gt=0, le=MAX_TIME, allow_inf_nan=False, strict=True)]
"""An end time, s."""
Timeout = Annotated[Extent, Counted]
"""A time-out, s; inf = never."""
Duration = Annotated[float, Field(ge=MIN_PERIOD, le=MAX_TIME, allow_inf_nan=False, strict=True)]
"""A duration of at least `MIN_PERIOD`, s."""
Period = Annotated[Duration, Recurring]
"""Time between successive events, s."""
Rate = Annotated[float, Field(ge=1 / MAX_TIME, le=1 / MIN_PERIOD, allow_inf_nan=False, strict=True)]
"""Events per second, 1/s."""
Flag = Annotated[bool, Field(strict=True)]
