"""What every model is: a frozen, validated value that a script constructs and a file validates into.

`Value` is the base of them all. `OneOf` lets a field hold any of several models: a table is told by its `kind`, and
from Python any callable will do.
"""

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache, cached_property
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from inspect import signature
from math import inf, isfinite, isnan
from pathlib import Path
from types import FunctionType, MappingProxyType
from typing import Annotated, Any, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationError,
    ValidationInfo,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, SchemaValidator, core_schema

from desim.field_docs import docs_of
from desim.guards import regular

# Numbers and truths are taken strictly: a file's "60" is not 60, and true is not 1.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
FARTHEST = 1e9
"""The plane ends here, so that no square overflows, m or m/s."""
Coordinate = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST, allow_inf_nan=False, strict=True)]
"""m"""


def _ordered(bounds: tuple[float, float]) -> tuple[float, float]:
    if bounds[0] > bounds[1]:
        raise ValueError(f"should be [lower, upper] (got {bounds[0]:g} and {bounds[1]:g})")
    return bounds


Box = Annotated[tuple[Coordinate, Coordinate], AfterValidator(_ordered)]
"""Lower and upper bound of both coordinates, m."""
Length = Annotated[float, Field(gt=0, le=FARTHEST, allow_inf_nan=False, strict=True)]
"""m"""
Speed = Annotated[float, Field(ge=0, le=FARTHEST, allow_inf_nan=False, strict=True)]
"""m/s"""
Probability = Annotated[float, Field(ge=0, le=1, strict=True)]


def _infinity(value: Any) -> Any:
    return inf if value == "Infinity" else value


def plain_number(number: float) -> float | str:
    """Return a number as JSON has it: one that it has no number for as "Infinity", "-Infinity" or "NaN"."""
    if isfinite(number):
        return number
    return "NaN" if isnan(number) else "Infinity" if number > 0.0 else "-Infinity"


Extent = Annotated[float, Field(gt=0, strict=True), BeforeValidator(_infinity)]
"""Positive, and possibly infinite; in JSON, which has no infinity, it is the string "Infinity"."""
Limit = Annotated[float, Field(ge=0, strict=True), BeforeValidator(_infinity)]
"""A number that something does not exceed, possibly infinite."""
LONGEST = 1e9
"""Thirty years: no time is longer, s."""
RESOLUTION = 1e-9
"""Time is counted in whole nanoseconds: up to half of one rounds to 0, s."""
SHORTEST = 1e-6
"""What recurs more often than every microsecond would never end, s."""
Unsigned = AfterValidator(lambda number: number + 0.0)
"""Makes 0 of -0, which numpy takes for a negative scale."""


class Counted:
    """Marks a field that is a time, of which the clock counts whole nanoseconds."""


class Recurring:
    """Marks a field that is the time between two of many events."""


Time = Annotated[float, Field(ge=0, le=LONGEST, allow_inf_nan=False, strict=True), Unsigned, Counted]
"""A time or a delay, s."""
Horizon = Annotated[float, Field(gt=0, le=LONGEST, allow_inf_nan=False, strict=True)]
"""A time at which something ends, s."""
Timeout = Annotated[Extent, Counted]
"""A time after which something is given up or forgotten, s; inf = never."""
Duration = Annotated[float, Field(ge=SHORTEST, le=LONGEST, allow_inf_nan=False, strict=True)]
"""How long something lasts that happens many times, s."""
Period = Annotated[Duration, Recurring]
"""A time between two of many events, s."""
Rate = Annotated[float, Field(ge=1 / LONGEST, le=1 / SHORTEST, allow_inf_nan=False, strict=True)]
"""Events per second, 1/s."""
Truth = Annotated[bool, Field(strict=True)]
ALLOW = "if you trust that file, say --allow-import (in Python, allow_import=True)"
"""How to let a file do what those of strangers may not."""


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


def is_trusted(info: ValidationInfo) -> bool:
    """Return whether what is validated may run code and read any file: it is Python's, or a file that is allowed to."""
    return info.context is None or bool(info.context.get("allow_import"))


def beside(path: Any, info: ValidationInfo) -> Path:
    """Return a path that a file names: relative to the folder of that file, if it is known, and not outside of it.

    Raises:
        ValueError: if it is not a text, is no regular file, or leads out of the folder and the file is not trusted.
    """
    if not isinstance(path, str | Path):
        raise ValueError(f"file should be a path (got {path!r})")
    folder = Path((info.context or {}).get("folder", "."))
    try:
        is_within = (folder / path).resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError) as error:  # links that lead to each other
        raise ValueError(f"{path} cannot be read: {error}") from error
    if not (is_within or is_trusted(info)):
        raise ValueError(f"{path} leads out of the folder of the file that names it; {ALLOW}")
    try:
        return regular(folder / path)
    except OSError as error:
        raise ValueError(f"{folder / path} cannot be read: {error.strerror}") from error


def fields_of(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of a model by name, with their descriptions."""
    docs = docs_of(model)
    for name, field in model.model_fields.items():
        field.description = field.description or docs.get(name)
    return model.model_fields


def kind_of(model: type[BaseModel]) -> str:
    """Return the `kind` by which a table in a file asks for this model."""
    return str(model.model_fields["kind"].default)


def home_of(value: Any) -> Any:
    """Return where the code of a value is: the function that it is, or the class of an object."""
    return value if isinstance(value, FunctionType) else type(value)


def import_name(home: Any) -> str:
    """Return the `kind` by which a table asks for a function or a class that is no entry point: "module:name"."""
    return f"{home.__module__}:{home.__qualname__}"


class OneOf:
    """Annotation of a field that holds one of several models, told apart by their `kind`.

    Models that other distributions install under the entry point group `group` are accepted too. A model is loaded and
    built when a table asks for it; the others are not. An object that can be called is taken as it is, so that a script
    may pass a function or a model of its own; a file names such a one by the kind "module:name", of a module that is
    installed or lies beside the file. Because that runs the code of the module, the file must be trusted
    (`is_trusted`), or the name be that of an entry point in one of the groups `desim.*`.

    Args:
        models: of this distribution.
        group: of entry points.
        needs: attributes that whatever is taken as it is must have.
        takes: names of the arguments with which it is called.
    """

    def __init__(
        self,
        *models: type[BaseModel],
        group: str | None = None,
        needs: tuple[str, ...] = (),
        takes: tuple[str, ...] = (),
    ):
        self.models = models
        self.group = group
        self.needs = needs
        self.takes = takes

    def choices(self) -> Mapping[str, type[BaseModel]]:
        """Return the models by kind, those of this distribution first; all of them are loaded."""
        return MappingProxyType(self._own | {kind: point.load() for kind, point in self._installed.items()})

    def choice(self, kind: str) -> type[BaseModel] | None:
        """Return the model of a kind, if there is one."""
        if kind not in self._installed:
            return self._own.get(kind)
        model: type[BaseModel] = self._installed[kind].load()
        return model

    def holds(self, value: Any) -> bool:
        """Return whether a value is of one of the models."""
        kind = getattr(value, "kind", None)
        return isinstance(kind, str) and type(value) is self.choice(kind)

    @cached_property
    def _own(self) -> dict[str, type[BaseModel]]:
        return {kind_of(model): model for model in self.models}

    @cached_property
    def _installed(self) -> dict[str, EntryPoint]:
        points = sorted(entry_points(group=self.group), key=lambda point: point.name) if self.group else []
        return {point.name: point for point in points}

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        writes = core_schema.wrap_serializer_function_ser_schema(self._written, schema=core_schema.any_schema())
        return core_schema.with_info_plain_validator_function(self._accept, serialization=writes)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return handler(_union(self.choices()))

    def _written(self, value: Any, write: Callable[[Any], Any]) -> Any:
        if self.holds(value):
            return write(value)
        parameters = {}
        if isinstance(value, BaseModel):
            parameters = value.model_dump()
        elif is_dataclass(value):
            parameters = {each.name: getattr(value, each.name) for each in fields(value) if each.init}
        return parameters | {"kind": import_name(home_of(value))}

    def _table(self, table: Any, info: ValidationInfo) -> Any:
        """Return the model that a table describes; raise ValidationError if it is none of them."""
        kind = table.get("kind") if isinstance(table, dict) else None
        model = self.choice(kind) if isinstance(kind, str) else None
        judge = SchemaValidator(_union(self.choices())) if model is None else _judge(kind, model)
        return judge.validate_python(table, context=info.context)

    def _accept(self, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, type):
            raise ValueError(f"should be an instance: {value.__name__}() instead of {value.__name__}")
        if isinstance(value, dict) and isinstance(kind := value.get("kind"), str) and ":" in kind:
            value = self._imported(value, info)
        if not callable(value):
            return self._table(value, info)
        if missing := [name for name in self.needs if not hasattr(value, name)]:
            raise ValueError(f"should have {', '.join(self.needs)}; {value!r} lacks {', '.join(missing)}")
        self._check_called(value, value)
        return value

    def _check_called(self, function: Callable[..., Any], value: Any, *first: Any) -> None:
        """Raise ValueError if what calls a value cannot take the arguments, after those that come first."""
        if not self.takes:
            return
        try:
            signature(function).bind(*first, *self.takes)
        except TypeError as error:
            raise ValueError(f"should be called with ({', '.join(self.takes)}); {value!r}: {error}") from error

    def _imported(self, table: dict[str, Any], info: ValidationInfo) -> Any:
        """Return what a table of the kind "module:name" stands for: a function, or a model with its parameters.

        Nothing is imported unless that is allowed, and no class is called whose instances cannot be.
        """
        kind = table["kind"]
        if names_code(kind) and not is_trusted(info):
            raise PydanticCustomError("import_refused", "{why}", {"why": refusal(kind)})
        point = _named_by_entry_points().get(kind)
        found = _load(kind, (info.context or {}).get("folder")) if point is None else point.load()
        parameters = {key: each for key, each in table.items() if key != "kind"}
        if not isinstance(found, type):
            if not callable(found):
                raise ValueError(f"{kind!r} is nothing that can be called, but {found!r}")
            if parameters:
                raise ValueError(f"{kind!r} is no model and takes no parameters, got {', '.join(parameters)}")
            return found
        calls = next((vars(base)["__call__"] for base in found.__mro__ if "__call__" in vars(base)), None)
        if calls is None:
            raise ValueError(f"{kind!r} is no model: its instances cannot be called")
        if isinstance(calls, FunctionType):
            self._check_called(calls, found, None)
        return _constructed(found, kind, parameters, info.context)


def _union(models: Mapping[Any, type[BaseModel]]) -> CoreSchema:
    """Return the schema of tables of one of several models, told apart by their `kind`."""
    for model in models.values():
        model.model_rebuild()
    schemas = {kind: model.__pydantic_core_schema__ for kind, model in models.items()}
    return core_schema.tagged_union_schema(schemas, discriminator="kind")


@cache
def _judge(kind: Any, model: type[BaseModel]) -> SchemaValidator:
    """Return what validates tables of one kind."""
    return SchemaValidator(_union({kind: model}))


def names_code(kind: Any) -> bool:
    """Return whether what stands for a kind names code that is not installed as an entry point of desim."""
    return isinstance(kind, str) and ":" in kind and kind not in _named_by_entry_points()


def refusal(kind: str) -> str:
    """Return why a file may not name code."""
    return f"{kind!r} names code to be run; {ALLOW}"


@cache
def _named_by_entry_points() -> Mapping[str, EntryPoint]:
    """Return the entry points of the groups `desim.*` by the names "module:name" of what they are of."""
    points = (
        each for group in entry_points().groups if group.startswith("desim.") for each in entry_points(group=group)
    )
    return MappingProxyType({f"{each.module}:{each.attr}": each for each in points})


def _load(kind: str, folder: Path | None) -> Any:
    """Return what "module:name" names; the module may lie in a folder, where worker processes find it, too."""
    module, _, name = kind.partition(":")
    if folder is not None and str(folder.absolute()) not in sys.path:
        sys.path.append(str(folder.absolute()))
    try:
        return getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        where = "" if folder is None else f" beside the file, in {folder.absolute()}"
        raise ValueError(f"{kind!r} cannot be imported: {error}{where}") from error
    except SystemExit as error:
        raise ValueError(f"{kind!r} cannot be imported: {module} calls exit({error.code!r})") from error


def _constructed(model: type, kind: str, parameters: dict[str, Any], context: Any) -> Any:
    try:
        return (
            model.model_validate(parameters, context=context) if issubclass(model, BaseModel) else model(**parameters)
        )
    except ValidationError as error:
        faults = [f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors()]
        raise ValueError(f"{kind!r}: {'; '.join(faults)}") from error
    except TypeError as error:
        raise ValueError(f"{kind!r}: {error}") from error


def choices_of(field: FieldInfo) -> list[OneOf]:
    """Return what marks a field, or the items of a field, as one of several models."""
    return [each for each in markers_of(field) if isinstance(each, OneOf)]


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
