"""`Value`, the base class of all models: immutable, validated, and with errors that name the key and what is allowed.

Models import the types of their fields from here, too; `desim.config.field_types` defines these types.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence, Set
from functools import cache, cached_property
from pathlib import PurePath
from types import FunctionType, MappingProxyType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, TypeVar, Union, get_args, get_origin

from pydantic import (
    BaseModel,
    ConfigDict,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    PydanticUserError,
    ValidationError,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError

from desim.config.arguments import missing_attribute, with_article
from desim.config.column_names import OTHER_UNITS, unit_in_label
from desim.config.errors import WORDINGS, KeyedError, Problem, cause_in
from desim.config.field_docs import annotated, fields_of, unit_in
from desim.config.field_types import MAX_COORDINATE as MAX_COORDINATE
from desim.config.field_types import MAX_TIME as MAX_TIME
from desim.config.field_types import MIN_PERIOD as MIN_PERIOD
from desim.config.field_types import RESOLUTION as RESOLUTION
from desim.config.field_types import AnyOrder as AnyOrder
from desim.config.field_types import Box as Box
from desim.config.field_types import Coordinate as Coordinate
from desim.config.field_types import Counted as Counted
from desim.config.field_types import Duration as Duration
from desim.config.field_types import Extent as Extent
from desim.config.field_types import FirstError as FirstError
from desim.config.field_types import Flag as Flag
from desim.config.field_types import Horizon as Horizon
from desim.config.field_types import Length as Length
from desim.config.field_types import Limit as Limit
from desim.config.field_types import NotEmpty as NotEmpty
from desim.config.field_types import Period as Period
from desim.config.field_types import Positive as Positive
from desim.config.field_types import Probability as Probability
from desim.config.field_types import Rate as Rate
from desim.config.field_types import Recurring as Recurring
from desim.config.field_types import Speed as Speed
from desim.config.field_types import Time as Time
from desim.config.field_types import Timeout as Timeout
from desim.config.field_types import Unsigned as Unsigned
from desim.config.field_types import in_forms as in_forms
from desim.config.interrupts import deferred
from desim.config.parameters import are_equal, in_json
from desim.config.python_numbers import NUMBERS, as_python, sets_as_lists, why_no_text
from desim.config.suggestion import did_you_mean

Model = TypeVar("Model", bound=BaseModel)


DEPRECATED = frozenset(
    name for name, method in vars(BaseModel).items() if hasattr(getattr(method, "__func__", method), "__deprecated__")
)
"""The methods that pydantic keeps for programs of its first version; each gives a warning."""

MAX_KEYS_IN_CALL = 3
"""If a model has at most this many keys, a message shows its call with all of them, otherwise with the first alone."""


def _how_to_call(model: type[BaseModel], args: Sequence[Any]) -> str:
    """Return the message for a call of a model with values by position: the call with keys by name."""
    names = [name for name in model.model_fields if name != "kind"]
    if not names:
        return f"{model.__name__} has no keys: {model.__name__}()"
    shown = names if len(names) <= MAX_KEYS_IN_CALL else names[:1]
    call = ", ".join(f"{name}=..." for name in shown)
    others = f"; others: {', '.join(names[1:])}" if shown != names else ""
    is_file = isinstance(args[0], str | PurePath) and str(args[0]).endswith(".toml")
    load = f"; a scenario file is read by load({str(args[0])!r})" if is_file else ""
    return f"{model.__name__} takes its keys by name: {model.__name__}({call}){others}{load}"


if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass as _ValueType
else:

    class _ValueType(type(BaseModel)):
        """The metaclass of `Value`: a call of a class raises KeyedError in place of pydantic's ValidationError.

        Only calls from Python pass through here. pydantic validates the tables inside a table itself, without this
        class, so files are read as fast as with plain models of pydantic.
        """

        def __call__(cls, *args: Any, **values: Any) -> Any:
            """Return a value with the given fields; raise KeyedError if a field does not exist or is not valid."""
            if args and cls.__init__ is BaseModel.__init__:  # an __init__ of a user may take values by position
                raise TypeError(_how_to_call(cls, args))
            try:
                return super().__call__(*args, **values)
            except ValidationError as error:
                problems, cause = WORDINGS["call"](error, cls, values), cause_in(error)
            raise KeyedError(*problems) from cause

        def __setattr__(cls, name: str, value: Any) -> None:
            """Raise KeyedError if the name is a key: pydantic reads defaults in the schema, not in attributes."""
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
        """The fields without effect, by name, each with the value of another field that disables it, as a text."""
        return MappingProxyType({})

    @classmethod
    def __pydantic_init_subclass__(cls, **options: Any) -> None:
        """Raise PydanticUserError if a class defines a method or property in the place of a field.

        pydantic would take the method or property for the default of the field.
        """
        super().__pydantic_init_subclass__(**options)
        if _is_built_in(cls):  # desim has hundreds of models, and its import should be fast
            return
        for name in cls.model_fields.keys() - annotated(cls):
            default = cls.model_fields[name].default
            if isinstance(default, ACCESSORS) and default is not _inherited_default(cls, name):
                raise PydanticUserError(
                    f"{cls.__name__}.{name} is a {type(default).__name__} in the place of a key: give the key another"
                    f" default ({name}: ... = value), or override the method that reads it",
                    code="model-field-overridden",
                )

    @classmethod
    def model_rebuild(cls, *, _parent_namespace_depth: int = 2, **options: Any) -> bool | None:
        """Build the schema, see `pydantic.BaseModel.model_rebuild`, which pydantic calls at the first use of a class.

        Interrupts are deferred: pydantic drops one that is raised while it compiles a pattern, or wraps it in another
        exception.
        """
        with deferred():
            return super().model_rebuild(_parent_namespace_depth=_parent_namespace_depth + 1, **options)

    @model_validator(mode="wrap")  # outside of all validators of mode "before", which then see Python's numbers only
    @classmethod
    def _with_python_numbers(cls, fields: Any, make: ModelWrapValidatorHandler[Self]) -> Self:
        """Convert the numbers and lists given for fields, see `as_python`."""
        if not isinstance(fields, dict):
            return make(fields)
        converted = dict(fields)
        for name in _plain_fields(cls) & fields.keys():
            value = fields[name]
            if type(value) in NUMBERS:
                continue
            why = _why_no_list(cls, name, value) or _why_other_unit(cls, name, value)
            if any(isinstance(marker, AnyOrder) for marker in cls.model_fields[name].metadata):
                value = sets_as_lists(value)
            is_set_for_set = isinstance(value, SET_TYPES) and get_origin(cls.model_fields[name].annotation) in SET_TYPES
            try:
                converted[name] = as_python([*value] if is_set_for_set else value)  # `as_python` refuses a set
            except UnicodeEncodeError as error:
                why = why_no_text(error)
            if why:
                problem = PydanticCustomError("text", "{why}", {"why": why})
                detail = InitErrorDetails(type=problem, loc=(name,), input=value)
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
        """Return whether the other object is of this class and has equal fields; those of a user may be arrays."""
        try:
            return super().__eq__(other)
        except (TypeError, ValueError):
            names = type(self).model_fields
            return type(self) is type(other) and all(
                are_equal(getattr(self, name), getattr(other, name)) for name in names
            )

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values of some fields, validated like a new model; `copy.replace` does the same.

        A field whose value was derived from another field, for instance from a preset, is derived anew. To change a key
        deep inside a scenario use `Scenario.with_`.

        Args:
            update: the new values by field; a table replaces a whole table and is not merged.
            deep: whether values that are not updated are copied deeply.

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
        """Return what a pickle holds: all attributes, and the names of those that a user's class has beside fields."""
        state = super().__getstate__()
        if len(self.__dict__) > len(type(self).model_fields) and not _is_built_in(type(self)):
            state["beside"] = [*(self.__dict__.keys() - type(self).model_fields.keys())]
        return state

    def __setstate__(self, state: dict[Any, Any]) -> None:
        """Restore a pickled value; keys that the pickle of another version lacks get their defaults.

        Raises:
            ValueError: if the pickle has a key that this version lacks.
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
        fields = type(self).model_fields
        try:
            super().__setattr__(name, value)
        except ValidationError:
            if name not in fields:
                hint = f"it has no such key{did_you_mean(name, fields)}"
            elif hasattr(type(self), "with_"):
                hint = f"with_({{{name!r}: ...}}) returns a changed copy"
            else:
                hint = f"model_copy(update={{{name!r}: ...}}) returns a changed copy; to change a scenario, write"
                hint += f" scenario.with_({{'...{name}': ...}}) with the dotted key, network.latency.value for instance"
        else:
            return
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
        """Return the names of the fields that were given, without those whose values follow from other fields."""
        return self.model_fields_set - self._derived()

    def _derived(self) -> Set[str]:
        """Return the names of fields that pydantic takes for given, although their values follow from other fields."""
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

    # Both dumps defer interrupts: pydantic swallows or wraps what a signal raises in a serializer written in Python.

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
        KeyedError: about the first updated key, if `__init__` takes other arguments or changes a value.
    """
    try:
        made = model.model_validate(values, by_name=True)
    except TypeError as error:
        why = f"takes other arguments ({error})"
    else:  # updated lists and tables become tuples and models, so only updated numbers are compared
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
    """Return the message about one model in place of a list of models, else ""; its fields would become the list."""
    is_lone = isinstance(value, BaseModel) and get_origin(model.model_fields[name].annotation) is tuple
    return f"should be a list: [{type(value).__name__}(...)]" if is_lone else ""


def _why_other_unit(model: type[Value], name: str, value: Any) -> str:
    """Return the message about a series of pandas whose name has another unit than its field, else ""."""
    label = getattr(value, "name", None)
    if not isinstance(label, str) or not hasattr(value, "dtype"):
        return ""
    unit, unit_of_field = unit_in_label(label), unit_in(fields_of(model)[name])
    is_other = unit_of_field in OTHER_UNITS and re.fullmatch(OTHER_UNITS[unit_of_field], unit, re.IGNORECASE)
    return f"should be in {unit_of_field}: the name {label!r} says {unit}" if is_other else ""


def _inherited_default(model: type[BaseModel], name: str) -> Any:
    """Return the default of a field in the first base class with this field; None if no base class has it."""
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

    A field of any type (`Any`), for example an array of a user's model, is not plain, and keeps the value unconverted.
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
