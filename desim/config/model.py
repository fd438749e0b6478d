"""The base of every model, a frozen and validated value, and the types of its fields: lengths, times, probabilities."""

import ast
import json
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from inspect import cleandoc, get_annotations, getsource
from itertools import pairwise
from math import inf
from types import MappingProxyType
from typing import Annotated, Any, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

# Numbers and truths are taken strictly: a file's "60" is not 60, and true is not 1.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
MAX_COORDINATE = 1e9
"""The plane ends here, so that no square overflows, m or m/s."""
Coordinate = Annotated[float, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE, allow_inf_nan=False, strict=True)]
"""m"""


def _ordered(bounds: tuple[float, float]) -> tuple[float, float]:
    if bounds[0] > bounds[1]:
        raise ValueError(f"should be [lower, upper] (got {bounds[0]:g} and {bounds[1]:g})")
    return bounds


Box = Annotated[tuple[Coordinate, Coordinate], AfterValidator(_ordered)]
"""Lower and upper bound of both coordinates, m."""
Length = Annotated[float, Field(gt=0, le=MAX_COORDINATE, allow_inf_nan=False, strict=True)]
"""m"""
Speed = Annotated[float, Field(ge=0, le=MAX_COORDINATE, allow_inf_nan=False, strict=True)]
"""m/s"""
Probability = Annotated[float, Field(ge=0, le=1, strict=True)]


def _infinity(value: Any) -> Any:
    return inf if value == "Infinity" else value


Extent = Annotated[float, Field(gt=0, strict=True), BeforeValidator(_infinity)]
"""Positive, and possibly infinite; in JSON, which has no infinity, it is the string "Infinity"."""
Limit = Annotated[float, Field(ge=0, strict=True), BeforeValidator(_infinity)]
"""A number that something does not exceed, possibly infinite."""
MAX_TIME = 1e9
"""Thirty years: no time is longer, s."""
RESOLUTION = 1e-9
"""Time is counted in whole nanoseconds: up to half of one rounds to 0, s."""
MIN_PERIOD = 1e-6
"""What recurs more often than every microsecond would never end, s."""
Unsigned = AfterValidator(lambda number: number + 0.0)
"""Makes 0 of -0, which numpy takes for a negative scale."""


class Counted:
    """Marks a field that is a time, of which the clock counts whole nanoseconds."""


class Recurring:
    """Marks a field that is the time between two of many events."""


Time = Annotated[float, Field(ge=0, le=MAX_TIME, allow_inf_nan=False, strict=True), Unsigned, Counted]
"""A time or a delay, s."""
Horizon = Annotated[float, Field(gt=0, le=MAX_TIME, allow_inf_nan=False, strict=True)]
"""A time at which something ends, s."""
Timeout = Annotated[Extent, Counted]
"""A time after which something is given up or forgotten, s; inf = never."""
Duration = Annotated[float, Field(ge=MIN_PERIOD, le=MAX_TIME, allow_inf_nan=False, strict=True)]
"""How long something lasts that happens many times, s."""
Period = Annotated[Duration, Recurring]
"""A time between two of many events, s."""
Rate = Annotated[float, Field(ge=1 / MAX_TIME, le=1 / MIN_PERIOD, allow_inf_nan=False, strict=True)]
"""Events per second, 1/s."""
Flag = Annotated[bool, Field(strict=True)]


class Value(BaseModel):
    """A frozen value whose unknown keys are errors and whose fields are described by the string below them."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        ser_json_inf_nan="strings",
        defer_build=True,  # most are never used in a run, and to build all takes longer than a short one
    )

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        found = handler(schema)
        properties = handler.resolve_ref_schema(found).get("properties", {})
        for name in properties:
            if text := fields_of(cls)[name].description:
                properties[name]["description"] = text
        return found

    def plain(self) -> dict[str, Any]:
        """Return it as what JSON has: infinity is the string "Infinity"."""
        return dict(json.loads(self.model_dump_json()))


def fields_of(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of a model by name, with their descriptions."""
    docs = docs_of(model)
    for name, field in model.model_fields.items():
        field.description = field.description or docs.get(name)
    return model.model_fields


def markers_of(field: FieldInfo) -> list[Any]:
    """Return the metadata of a field and of what its annotation holds."""
    return [*field.metadata, *_metadata(field.annotation)]


def _metadata(annotation: Any) -> Iterator[Any]:
    yield from getattr(annotation, "__metadata__", ())
    for inner in get_args(annotation):
        yield from _metadata(inner)


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models that an annotation names."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from models_in(inner)


# The strings below fields describe them. They are read from the source of a module on demand: pydantic's
# `use_attribute_docstrings` reads them as each model is made, which takes longer than a short run.

Docs = Mapping[str, str]
"""What each name in a class is, if a string below it says so."""


def docs_of(model: type) -> Docs:
    """Return the string below each annotated name of a class, or of one it derives from, if there is one."""
    found: dict[str, str] = {}
    for each in reversed(model.__mro__):
        own = _docs(each.__module__).get(each.__qualname__, {})
        found = {**{name: text for name, text in found.items() if name not in get_annotations(each)}, **own}
    return found


@cache
def _docs(module: str) -> Mapping[str, Docs]:
    """Return the strings below names in each class of a module; none if its source is not at hand."""
    try:
        tree = ast.parse(getsource(sys.modules[module]))
    except (KeyError, OSError, TypeError):
        return MappingProxyType({})
    return MappingProxyType(dict(_classes(tree, "")))


def _classes(node: ast.AST, above: str) -> Iterator[tuple[str, Docs]]:
    """Yield the qualified name of each class within a node of a syntax tree, and the strings below names in it."""
    for inner in ast.iter_child_nodes(node):
        if isinstance(inner, ast.ClassDef):
            yield above + inner.name, dict(_strings(inner))
            yield from _classes(inner, f"{above}{inner.name}.")
        else:
            within = f"{above}{inner.name}.<locals>." if isinstance(inner, ast.FunctionDef) else above
            yield from _classes(inner, within)


def _strings(node: ast.ClassDef) -> Iterator[tuple[str, str]]:
    for field, below in pairwise(node.body):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                yield name, cleandoc(text)
