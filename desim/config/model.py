"""`Value`, the base class of all models, which are immutable and validated; the types of fields: lengths, times, ..."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set, Sized
from functools import cache, cached_property
from operator import attrgetter
from pathlib import PurePath
from types import FunctionType, MappingProxyType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, TypeVar, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    FailFast,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    PydanticUserError,
    ValidationError,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from desim.config.arguments import missing_attribute, with_article
from desim.config.errors import WORDINGS, KeyedError, KeyPath, Problem, cause_in
from desim.config.field_docs import annotated, fields_of
from desim.config.interrupts import deferred
from desim.config.json_numbers import from_json
from desim.config.parameters import are_equal, in_json
from desim.config.python_numbers import NUMBERS, as_python, why_no_text
from desim.config.suggestion import did_you_mean

Model = TypeVar("Model", bound=BaseModel)

# Numbers and booleans are strict: the string "60" is not 60, and true is not 1.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
MAX_COORDINATE = 1e9
"""Largest length or absolute coordinate, m; also the largest speed, m/s."""
Coordinate = Annotated[float, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE, allow_inf_nan=False, strict=True)]
"""m"""


def _ordered(bounds: tuple[float, float]) -> tuple[float, float]:
    if bounds[0] > bounds[1]:
        raise ValueError(f"should be [lower, upper] (got {bounds[0]:g} and {bounds[1]:g})")
    return bounds[0] + 0.0, bounds[1] + 0.0  # numpy draws none between 0 and -0


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
    """Return the discriminator of a union whose members have the forms of their values as tags.

    Args:
        forms: the tags, such as "list", "table", "number". "text", "list" and "table" are recognised; a value that has
            none of the forms before the last has the last one.
    """
    types: dict[str, Any] = {"text": str, "list": list | tuple, "table": dict | BaseModel}

    def form_of(value: Any) -> str:
        value = from_json(value) if isinstance(value, str) else value  # in JSON, infinity is a text
        return next((form for form in forms[:-1] if isinstance(value, types[form])), forms[-1])

    return Discriminator(form_of)


class FirstError(FailFast):
    """Marks a list of numbers: of the items that are wrong, only the first is reported."""

    def __hash__(self) -> int:  # a type in a union has to have one
        return hash(type(self))


class NotEmpty:
    """Marks a list that has at least one item; `min_length` counts valid items only, and so reports a second error."""

    min_length = 1

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


DEPRECATED = frozenset(
    name for name, method in vars(BaseModel).items() if hasattr(getattr(method, "__func__", method), "__deprecated__")
)
"""The methods of pydantic that it keeps for programs of its first version, and that warn."""

MAX_KEYS_IN_CALL = 3
"""The largest number of keys with which a message shows a call of a model; of more it lists the names."""


def _by_name(model: type[BaseModel], args: Sequence[Any]) -> str:
    """Return the message for a call of a model by position."""
    names = [name for name in model.model_fields if name != "kind"]
    if not names:
        return f"{model.__name__} has no keys: {model.__name__}()"
    shown = names if len(names) <= MAX_KEYS_IN_CALL else names[:1]
    call = ", ".join(f"{name}=..." for name in shown)
    keys = f"{model.__name__} takes its keys by name: {model.__name__}({call})"
    other_names = f"; others: {', '.join(names[1:])}" if shown != names else ""
    is_file = isinstance(args[0], str | PurePath) and str(args[0]).endswith(".toml")
    return keys + other_names + (f"; a scenario file is read by load({str(args[0])!r})" if is_file else "")


if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass as _ValueType
else:

    class _ValueType(type(BaseModel)):
        """The type of the classes of values: a call of one raises the errors of a scenario file, not pydantic's.

        Only a call goes this way. Validation inside of pydantic, of a table in a table, does not come here, and so is
        as fast as it is.
        """

        def __call__(cls, *args: Any, **values: Any) -> Any:
            """Return a value with the given fields; raise KeyedError if there is no such field, or it is not valid."""
            if args and cls.__init__ is BaseModel.__init__:
                raise TypeError(_by_name(cls, args))
            try:
                return super().__call__(*args, **values)
            except ValidationError as error:
                problems, cause = WORDINGS["call"](error, cls, values), cause_in(error)
            raise KeyedError(*problems) from cause

        def __setattr__(cls, name: str, value: Any) -> None:
            """Raise KeyedError for a key: its default is part of the schema, and a new one would have no effect."""
            if name[:1] != "_" and name in cls.__dict__.get("__pydantic_fields__", ()):
                call = f"{cls.__name__}({name}=...)"
                raise KeyedError(Problem(f"the default of a key cannot be set: give the value, {call}", name))
            super().__setattr__(name, value)

        def __dir__(cls) -> list[str]:
            """Return the names of the attributes without pydantic's deprecated methods, for tab completion."""
            return [name for name in super().__dir__() if name not in DEPRECATED]


class Value(BaseModel, metaclass=_ValueType):
    """An immutable model that rejects unknown keys; the string below a field is the description of the field.

    A call of a class, `model_copy` and an attempt to set a field raise KeyedError, whose sentences are those of a
    scenario file. The methods of pydantic, such as `model_validate`, raise its ValidationError. Both are ValueErrors.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        ser_json_inf_nan="strings",
        ser_json_bytes="hex",
        defer_build=True,  # a run uses few models, and building all of them takes longer than a short run
    )

    _replaced: ClassVar[Mapping[str, str]] = MappingProxyType({})
    """For keys of older versions: the part of the error message that says what replaces them."""

    @property
    def unused_fields(self) -> Mapping[str, str]:
        """By name of each field without effect: the value of another field because of which it has none."""
        return MappingProxyType({})

    @classmethod
    def __pydantic_init_subclass__(cls, **options: Any) -> None:
        """Raise PydanticUserError if a class defines a method or property in the place of a field.

        pydantic takes it for the default of the field.
        """
        super().__pydantic_init_subclass__(**options)
        if _is_built_in(cls):  # hundreds, at each import
            return
        for name in cls.model_fields.keys() - annotated(cls):
            kind: type = type(cls.model_fields[name].default)
            if issubclass(kind, ACCESSORS) and cls.model_fields[name].default is not _inherited_default(cls, name):
                raise PydanticUserError(
                    f"{cls.__name__}.{name} is a {kind.__name__} in the place of a key: give the key another default"
                    f" ({name}: ... = value), or override the method that reads it",
                    code="model-field-overridden",
                )

    @model_validator(mode="wrap")  # outside of all validators of mode "before", which then see Python's numbers only
    @classmethod
    def _with_python_numbers(cls, fields: Any, make: ModelWrapValidatorHandler[Self]) -> Self:
        """Convert the numbers and lists given for fields, see `as_python`."""
        if not isinstance(fields, dict):
            return make(fields)
        plain, converted = _plain_fields(cls), dict(fields)
        for name in plain & fields.keys():
            if type(fields[name]) in NUMBERS:
                continue
            why = _why_no_list(cls, name, fields[name])
            try:
                is_set = isinstance(fields[name], SET_TYPES)
                takes_set = is_set and get_origin(cls.model_fields[name].annotation) in SET_TYPES
                converted[name] = as_python([*fields[name]] if takes_set else fields[name])
            except UnicodeEncodeError as error:
                why = why_no_text(error)
            if why:
                detail = InitErrorDetails(
                    type=PydanticCustomError("text", "{why}", {"why": why}), loc=(name,), input=fields[name]
                )
                raise ValidationError.from_exception_data(cls.__name__, [detail])
        return make(converted)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        json_schema = handler(schema)
        properties = handler.resolve_ref_schema(json_schema).get("properties", {})
        for name in properties:
            if text := fields_of(cls)[name].description:
                properties[name]["description"] = text
        return json_schema

    def __str__(self) -> str:
        return repr(self)

    def __eq__(self, other: object) -> bool:
        """Return whether the other object is of this class and has equal fields; a user's may be arrays."""
        try:
            return super().__eq__(other)
        except (TypeError, ValueError):
            names = type(self).model_fields
            return type(self) is type(other) and all(
                are_equal(getattr(self, name), getattr(other, name)) for name in names
            )

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values of some fields, validated like a new model; `copy.replace` does the same.

        A field whose value followed from another one, for instance from a preset, follows anew. To change a key deep
        inside a scenario use `Scenario.with_`.

        Args:
            update: the new values by field; a table replaces a whole table, it is not merged.
            deep: whether the values that stay are copied deeply.

        Raises:
            KeyedError: if there is no such field, or the values are not valid together.
        """
        copy = super().model_copy(deep=deep)
        if not update:
            return copy
        kept = {name: getattr(copy, name) for name in self.own_fields()}
        values = kept | dict(update)
        model: Any = type(self)
        try:
            if model.__init__ is BaseModel.__init__:
                return type(self).model_validate(values, by_name=True)
            return _made_by_own_init(type(self), values, update.keys())
        except ValidationError as error:
            problems, cause = WORDINGS["call"](error, type(self), values), cause_in(error)
        raise KeyedError(*problems) from cause

    def copy(self, **options: Any) -> Self:
        """Do what `model_copy` does: pydantic's method of this name would not validate."""
        return self.model_copy(**options)

    def __getstate__(self) -> dict[Any, Any]:
        """Return what a pickle holds: the fields, and attributes that a user's class has set besides."""
        state = super().__getstate__()
        if len(self.__dict__) > len(type(self).model_fields) and not _is_built_in(type(self)):
            state["beside"] = [*(self.__dict__.keys() - type(self).model_fields.keys())]
        return state

    def __setstate__(self, state: dict[Any, Any]) -> None:
        """Restore a pickled value; keys that another version did not have get their defaults.

        Raises:
            ValueError: if that version had a key that does not exist.
        """
        super().__setstate__(state)
        fields, values = type(self).model_fields, self.__dict__
        if values.keys() == fields.keys():
            return
        allowed = {*fields, *state.get("beside", ())}
        if unknown := [
            name for name in values if name not in allowed and name[0] != "_" and not hasattr(type(self), name)
        ]:
            raise ValueError(
                f"{with_article(type(self).__name__)} cannot be unpickled: it has no key {unknown[0]} any more, so the"
                " pickle is of another version of desim; keep scenarios as files, or as run.json"
            )
        for name, field in fields.items():
            if name not in values and not field.is_required():
                values[name] = field.get_default(call_default_factory=True)

    def __setattr__(self, name: str, value: Any) -> None:
        """Raise KeyedError, because a value is immutable; private attributes can be set."""
        try:
            super().__setattr__(name, value)
        except ValidationError:
            is_key = name in type(self).model_fields
        else:
            return
        how = f"with_({{{name!r}: ...}}) returns a changed copy"
        if not hasattr(type(self), "with_"):
            how = f"model_copy(update={{{name!r}: ...}}) returns a changed copy; to change a scenario, write"
            how += f" scenario.with_({{'...{name}': ...}}) with the dotted key, network.latency.value for instance"
        hint = how if is_key else "it has no such key"
        hint += "" if is_key else did_you_mean(name, type(self).model_fields)
        raise KeyedError(Problem(f"cannot be set: {with_article(type(self).__name__)} is immutable; {hint}", name))

    def _instead_of(self, name: str) -> str:
        """Return what to write instead of an attribute that the value does not have, as the end of a message."""
        keys = ", ".join(type(self).model_fields)
        return f"its keys are {keys}" if keys else "it has no keys"

    if not TYPE_CHECKING:  # a type checker reports missing attributes itself

        def __getattr__(self, name: str) -> object:
            """Raise AttributeError with what to write; called only if there is no such attribute."""
            try:
                return super().__getattr__(name)
            except AttributeError:
                if name.startswith("_") or hasattr(type(self), name):
                    raise
            raise missing_attribute(self, name)

    def __dir__(self) -> list[str]:
        """Return the names of the attributes without pydantic's deprecated methods, for tab completion."""
        return [name for name in super().__dir__() if name not in DEPRECATED]

    def own_fields(self) -> Set[str]:
        """Return the names of the fields that were given, without those whose values follow from others."""
        return self.model_fields_set - self._derived()

    def _derived(self) -> Set[str]:
        """Return the names of the fields that were not given, but follow from others."""
        return frozenset()

    def given(self) -> dict[str, Any]:
        """Return the fields without a default, and those that differ from their defaults, by name."""
        return {
            name: getattr(self, name)
            for name, field in type(self).model_fields.items()
            if field.is_required() or not are_equal(getattr(self, name), field.get_default(call_default_factory=True))
        }

    def __repr_args__(self) -> Iterator[tuple[str, Any]]:
        """Yield the fields that `repr` shows; see `given`."""
        yield from self.given().items()

    # pydantic swallows or wraps an exception that a signal raises in a serializer written in Python.

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """Return the fields, see `pydantic.BaseModel.model_dump`; interrupts are deferred."""
        with deferred():
            return super().model_dump(**options)

    def model_dump_json(self, **options: Any) -> str:
        """Return the fields as JSON text, see `pydantic.BaseModel.model_dump_json`; interrupts are deferred.

        What JSON lacks is written as `in_json` says.
        """
        with deferred():
            return super().model_dump_json(**({"fallback": in_json} | options))

    def plain(self) -> dict[str, Any]:
        """Return the fields as JSON values; infinity is the string "Infinity"."""
        return dict(json.loads(self.model_dump_json()))


def _is_built_in(model: type) -> bool:
    return model.__module__.startswith(("desim.", "protocols."))


def _made_by_own_init(model: type[Model], values: Mapping[str, Any], updated: Set[str]) -> Model:
    """Return a value of a class with an `__init__` of its own, which should take the values of its keys as they are.

    Raises:
        KeyedError: about an updated key, if it does not.
    """
    try:
        made = model.model_validate(values, by_name=True)
    except TypeError as error:
        why = f"takes other arguments ({error})"
    else:
        changed = [
            name
            for name, value in values.items()
            if not are_equal(getattr(made, name), value) and (name not in updated or type(value) in {int, float})
        ]
        if not changed or all(isinstance(getattr(made, name), BaseModel) for name in changed):
            return made
        why = f"changes {changed[0]}"
    text = f"cannot be set: {model.__name__} has its own __init__, which {why}: give another {model.__name__}(...)"
    raise KeyedError(Problem(text, min(updated)))


def _why_no_list(model: type[Value], name: str, value: Any) -> str:
    """Return the message for a model in place of a list of models, which pydantic reads as a list of fields; or ""."""
    is_lone = isinstance(value, BaseModel) and get_origin(model.model_fields[name].annotation) is tuple
    return f"should be a list: [{type(value).__name__}(...)]" if is_lone else ""


def _inherited_default(model: type[BaseModel], name: str) -> Any:
    """Return the default of a field in the first base class that has it."""
    bases = (base for base in model.__mro__[1:] if issubclass(base, BaseModel) and name in base.model_fields)
    return next((base.model_fields[name].default for base in bases), None)


ACCESSORS = (property, cached_property, FunctionType, classmethod, staticmethod)
"""The types of methods and properties in a class."""


@cache
def _plain_fields(model: type[Value]) -> frozenset[str]:
    """Return the names of the fields that hold numbers, texts, or lists and tables of anything."""
    return frozenset(name for name, field in model.model_fields.items() if _is_plain(field.annotation))


def _is_plain(annotation: Any) -> bool:
    """Return whether an annotation takes a number, a text, a list or a table.

    A field that takes anything, for example an array of a user's model, keeps what it is given.
    """
    origin = get_origin(annotation)
    if origin is Annotated:
        return _is_plain(annotation.__origin__)
    if origin in {Union, UnionType}:
        return any(map(_is_plain, get_args(annotation)))
    return (origin or annotation) in PLAIN_TYPES


PLAIN_TYPES = frozenset({int, float, bool, str, tuple, list, dict, set, frozenset, Sequence, Mapping, Literal})
"""The types of fields whose values are converted to Python numbers and lists."""
SET_TYPES = (set, frozenset)


def markers_of(field: FieldInfo) -> list[Any]:
    """Return the metadata of a field and of all types inside its annotation, including the bounds in a `Field(...)`."""
    return [*field.metadata, *_metadata(field.annotation)]


def _metadata(annotation: Any) -> Iterator[Any]:
    if get_origin(annotation) is Annotated:
        for part in annotation.__metadata__:
            yield part
            yield from part.metadata if isinstance(part, FieldInfo) else ()
    for inner in get_args(annotation):
        yield from _metadata(inner)


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models inside an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from models_in(inner)


def models_within(
    model: BaseModel,
    place: KeyPath = (),
    fields: Callable[[type[BaseModel]], Iterable[str]] = attrgetter("model_fields"),
) -> Iterator[tuple[KeyPath, BaseModel]]:
    """Yield a model and all models in its fields, or in those that a function names, with the place of each."""
    yield place, model
    for name in fields(type(model)):
        for inner, part in indexed_parts(getattr(model, name)):
            if isinstance(part, BaseModel):
                yield from models_within(part, (*place, name, *inner), fields)


def indexed_parts(value: Any) -> Iterator[tuple[KeyPath, Any]]:
    """Yield the value of a field or, if it is a list, each item with its index."""
    if isinstance(value, tuple):
        yield from (((index,), item) for index, item in enumerate(value))
    else:
        yield (), value
