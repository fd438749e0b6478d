"""Fields that hold one of several models, selected by the `kind` of a table."""

import re
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from importlib.metadata import EntryPoint
from inspect import signature
from types import FunctionType, MappingProxyType
from typing import Any, ClassVar

from pydantic import (
    BaseModel,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    SerializationInfo,
    ValidationError,
    ValidationInfo,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, SchemaValidator, core_schema

from desim.config.answers import name_and_place
from desim.config.arguments import value_text
from desim.config.calls import check_at_once, check_call, check_method
from desim.config.error_texts import text_of
from desim.config.interrupts import deferred
from desim.config.model_parts import markers_of
from desim.config.named_code import (
    IMPORTED,
    entry_points_of,
    imported,
    is_unlisted_import,
    load_named,
    refusal,
)
from desim.config.number_texts import number_instead_of
from desim.config.parameters import table_of
from desim.config.python_numbers import as_python
from desim.config.traits import Traits, attributes, is_ours, name_of, positions
from desim.config.trust import is_trusted

FILE_NAME = re.compile(r"^(?![\w.]+:[\w.]+$).*[^:]\.(?!py$)\w{2,8}(\.gz)?$")
"""Matches the name of a file with an ending, but not that of a module, nor "module:Outer.Inner"."""


def kind_of(model: type[BaseModel]) -> str:
    """Return the `kind` that selects a model in a file."""
    return str(model.model_fields["kind"].default)


class OneOf:
    """Annotation of a field that holds one of several models, selected by their `kind`.

    A field accepts `models`, and the models that `KINDS_OF` and the entry points of other distributions list
    under `group`. A table with a known kind imports only the model of this kind. A table with an unknown kind, or
    without one, imports all models, because the error message lists them.

    A callable object is accepted unchanged, so a script can pass its own function or model. A file selects such a
    callable by the kind "module:name"; the module is installed or lies beside the file. Importing a module runs its
    code, so the file must be trusted (`is_trusted`), unless `KINDS_OF` or an entry point of a group `desim.*`
    refers to the same "module:name".

    Args:
        models: the models that are accepted in addition to those of `group`.
        group: the group in `KINDS_OF`, and the entry point group.
        needs: attributes that a callable object must have; for a method also the names of its arguments, for instance
            "mean_slot(me)".
        takes: names of the arguments with which a callable object is called.
        traits: the class that declares and checks the optional attributes of a model or callable object.
        number: the kind and the key for a bare number. With ("constant", "value"), 0.1 stands for
            {kind = "constant", value = 0.1}. A bare string always stands for a kind.
        called: the name of the method by which models are called, if it is not `__call__`.
        is_closed: whether a callable object must derive from one of `models`, because these are not called.
    """

    families: ClassVar["list[OneOf]"] = []
    """All annotations, for messages that say which other models have a key."""

    def __init__(
        self,
        *models: type[BaseModel],
        group: str | None = None,
        needs: tuple[str, ...] = (),
        takes: tuple[str, ...] = (),
        traits: type[Traits] = Traits,
        number: tuple[str, str] | None = None,
        called: str = "__call__",
        is_closed: bool = False,
    ):
        self.models = models
        self.group = group
        parts = [name.partition("(") for name in needs]
        self.needs = tuple(name for name, _, _ in parts)
        self.needed_calls = {
            name: tuple(arguments.rstrip(")").split(", ")) for name, bracket, arguments in parts if bracket
        }
        self.takes = takes
        self.traits = traits
        self.number = number
        self.called = called
        self.is_closed = is_closed
        self.families.append(self)

    def choices(self) -> Mapping[str, type[BaseModel]]:
        """Return all models by kind: first `models`, then those of `group`, sorted by kind; imports all of them."""
        return MappingProxyType(
            self._builtin | {kind: imported(point.value, point.load) for kind, point in self._installed.items()}
        )

    def choice(self, kind: str) -> type[BaseModel] | None:
        """Return the model of a kind; None if the kind is unknown."""
        if kind not in self._installed:
            return self._builtin.get(kind)
        point = self._installed[kind]
        model: type[BaseModel] = imported(point.value, point.load)
        return model

    def has(self, model: type[BaseModel]) -> bool:
        """Return whether a class is one of the models."""
        return self.choice(kind_of(model)) is model

    def holds(self, value: Any) -> bool:
        """Return whether a value is an instance of one of the models."""
        return isinstance(value, BaseModel) and type(value) is self.choice(str(dict(value).get("kind")))

    @cached_property
    def _builtin(self) -> dict[str, type[BaseModel]]:
        return {kind_of(model): model for model in self.models}

    @cached_property
    def _installed(self) -> dict[str, EntryPoint]:
        points = entry_points_of(self.group) if self.group else []
        return {point.name: point for point in sorted(points, key=lambda point: point.name)}

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        serialization = core_schema.wrap_serializer_function_ser_schema(
            self._serialize, schema=core_schema.any_schema(), info_arg=True
        )
        return core_schema.with_info_plain_validator_function(self._accept, serialization=serialization)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        named = {"type": "string", "pattern": IMPORTED}
        of_named_code = {"type": "object", "properties": {"kind": named}, "required": ["kind"]}
        other_forms: list[JsonSchemaValue] = [{"type": "string", "enum": list(self.choices())}, named, of_named_code]
        if self.number is not None:
            other_forms.append({"type": "number"})
        return {"anyOf": [handler(_union(self.choices())), *other_forms]}

    def _serialize(self, value: Any, write: Callable[[Any], Any], info: SerializationInfo) -> Any:
        if self.holds(value):
            return write(value)
        return table_of(value, exclude_none=bool(info.exclude_none))

    def _from_table(self, table: Any, info: ValidationInfo) -> Any:
        """Return the model that a table describes, or validate and return a value that already is a model.

        Raises:
            ValueError: if the table or the model is invalid; errors of pydantic are subclasses.
        """
        if not (isinstance(table, dict) or attributes(table, ["kind"])):
            text = "should be a table with a kind, a built-in model or an object that can be called"
            raise PydanticCustomError("union_tag_not_found", text)
        kind = table.get("kind") if isinstance(table, dict) else None
        model = self.choice(kind) if isinstance(kind, str) else None
        if model is None:  # a model in place of a table, or an unknown kind, whose error lists all kinds
            with deferred():  # see `Value.model_rebuild`
                validator = SchemaValidator(_union(self.choices()))
            made = validator.validate_python(table, context=info.context)
        else:
            made = model.model_validate(table, context=info.context)
        self.traits.check(made)
        return made

    def _accept(self, value: Any, info: ValidationInfo) -> Any:
        """Return the model, or the callable object, that a value in any accepted form stands for."""
        if isinstance(value, type):
            raise ValueError(f"should be an instance: {value.__name__}() instead of {value.__name__}")
        if self.number is not None and isinstance(value, str) and (reason := number_instead_of(str(value))):
            raise ValueError(reason)
        self._check_file(value)
        value = self.as_table(value)
        if isinstance(value, dict) and isinstance(kind := value.get("kind"), str) and ":" in kind:
            value = self._imported(value, info)
        if not isinstance(value, dict):
            self._check_base(value)
        if not callable(self._function(value)):
            return self._from_table(value, info)
        self.check(value)
        return value

    def _check_file(self, value: Any) -> None:
        """Raise ValueError if a value names a file without the kind that reads it."""
        file = value.get("file") if isinstance(value, dict) and "kind" not in value else value
        if isinstance(file, str) and FILE_NAME.search(file):
            kinds = [kind for kind, model in self.choices().items() if "file" in getattr(model, "model_fields", ())]
            if kinds:
                others = f"; kinds that read a file: {', '.join(kinds)}" if len(kinds) > 1 else ""
                raise ValueError(f'a file needs a kind: {{ kind = "{kinds[0]}", file = "{file}" }}{others}')

    def check(self, value: Any) -> None:
        """Raise ValueError if a value cannot be called as a model is, or has invalid traits."""
        if not callable(self._function(value)):
            how = "can be called" if self.called == "__call__" else f"has a method {self.called}"
            raise ValueError(f"should be a model, which {how} (got {name_and_place(value)})")
        if missing := [name for name in self.needs if name not in attributes(value, self.needs)]:
            raise ValueError(f"should have {', '.join(self.needs)}; {name_and_place(value)} lacks {', '.join(missing)}")
        self._check_called(self._function(value), value)
        for name, takes in self.needed_calls.items():
            check_method(value, name, takes)
            check_at_once(getattr(value, name), f"{name} ")
        self.traits.check(value)
        methods = {} if is_ours(type(value)) else self.traits.calls()
        for name in attributes(value, methods):
            if getattr(value, name) is not None:
                check_method(value, name, methods[name])

    def _function(self, value: Any) -> Any:
        """Return what a run calls: the model itself, or its method named by `called`; None if it lacks the method."""
        return value if self.called == "__call__" else getattr(value, self.called, None)

    def _check_base(self, value: Any) -> None:
        """Raise ValueError if a value defines a method that is never called.

        A model that is not called, such as `desim.kernel.models.access.Ideal`, stands for code of the simulator. A
        class that derives from it inherits this code, and cannot replace it by a method that the model lacks.
        """
        base = next((model for model in self.models if isinstance(value, model)), None)
        if base is None:
            if callable(value) and self.is_closed:
                raise ValueError(f"should be derived from {_or(self.models)} (got {name_and_place(value)})")
            return
        if type(value) is base or positions(base, "__call__"):
            return
        users_names = (name for ancestor in type(value).__mro__ if not is_ours(ancestor) for name in vars(ancestor))
        for name in dict.fromkeys(name for name in users_names if name == "__call__" or name[0] != "_"):
            models_with_it = [
                model for model in self.models if positions(model, name) and callable(getattr(model, name, None))
            ]
            if (name == "__call__" or models_with_it) and not positions(base, name):
                hint = f": derive it from {_or(models_with_it)}" if models_with_it else ""
                raise ValueError(f"{name_of(value)} has a method {name}, which a {base.__name__} never calls{hint}")

    def as_table(self, value: Any) -> Any:
        """Return the table that a bare string or number stands for; return any other value unchanged."""
        if isinstance(value, str):
            return {"kind": value}
        if self.number is None or isinstance(value, dict):
            return value
        number = as_python(value)
        if type(number) is int or type(number) is float:
            kind, key = self.number
            return {"kind": kind, key: number}
        return value

    def _check_called(self, function: Callable[..., Any], value: Any, *first: Any) -> None:
        """Raise ValueError if a function cannot be called with the arguments `first` and one for each name in `takes`.

        The message names `value`: the function, object or class that the user gave.
        """
        if self.takes:
            check_call(function, self.takes, value, *first)

    def _imported(self, table: dict[str, Any], info: ValidationInfo) -> Any:
        """Return the function, or create the model, that a table of the kind "module:name" selects.

        A "module:name" that `KINDS_OF` and the entry points do not list is imported only if the file is trusted.
        A class is instantiated only if its instances are callable, or derive from a model of a closed family.
        """
        kind = table["kind"]
        if is_unlisted_import(kind) and not is_trusted(info):
            raise PydanticCustomError("import_refused", "{why}", {"why": refusal(kind)})
        model = load_named(kind, (info.context or {}).get("folder"))
        parameters = {key: value for key, value in table.items() if key != "kind"}
        if not isinstance(model, type):
            if not callable(model):
                raise ValueError(f"{kind!r} should be callable (got {value_text(model)})")
            if parameters:
                raise ValueError(f"{kind!r} is not a class and takes no parameters, got {', '.join(parameters)}")
            return model
        method = next((vars(base)[self.called] for base in model.__mro__ if self.called in vars(base)), None)
        if method is None and not self.is_closed:
            what = "be callable" if self.called == "__call__" else f"have a method {self.called}"
            raise ValueError(f"{kind!r} is not a model: its instances should {what}")
        if method is None and not issubclass(model, self.models):
            raise ValueError(f"{kind!r} should be derived from {_or(self.models)}")
        if isinstance(method, FunctionType):
            self._check_called(method, model, None)  # None stands for self
        return _constructed(model, kind, parameters, info.context)


def _or(models: Sequence[type]) -> str:
    """Return the names of some classes, at least one, as a list in words."""
    *names, last = (model.__name__ for model in models)
    return f"{', '.join(names)} or {last}" if names else last


def _union(models: Mapping[Any, type[BaseModel]]) -> CoreSchema:
    """Return the schema of a table that is one of several models, selected by `kind`."""
    for model in models.values():
        model.model_rebuild()  # the schema of a `Value` is built at its first use
    schemas = {kind: model.__pydantic_core_schema__ for kind, model in models.items()}
    return core_schema.tagged_union_schema(schemas, discriminator="kind")


def _constructed(model: type, kind: str, parameters: dict[str, Any], context: Any) -> Any:
    """Return an instance of a class.

    Raises:
        PydanticCustomError: of the type "user_model" if parameters are invalid, with the class and the list of errors.
        ValueError: if the class cannot be instantiated with these parameters.
    """
    allowed = _parameters_of(model)
    if unknown := [key for key in parameters if allowed is not None and key not in allowed]:
        detail = {"type": "extra_forbidden", "msg": "Extra inputs are not permitted", "ctx": {"allowed": allowed}}
        raise _model_error(model, kind, [detail | {"loc": (key,), "input": parameters[key]} for key in unknown])
    try:
        return (
            model.model_validate(parameters, context=context) if issubclass(model, BaseModel) else model(**parameters)
        )
    except ValidationError as error:
        raise _model_error(model, kind, error.errors(include_url=False)) from error
    except TypeError as error:
        raise ValueError(f"{kind!r}: {error}") from error


def _parameters_of(model: type) -> list[str] | None:
    """Return the names of the parameters of a class, sorted; None if it accepts any name, or checks names itself."""
    if issubclass(model, BaseModel):
        names = {*model.model_fields, *(field.alias for field in model.model_fields.values() if field.alias)}
        return sorted(names) if model.model_config.get("extra", "ignore") == "ignore" else None
    signature_parameters = signature(model).parameters.values()
    return (
        None
        if any(parameter.kind is parameter.VAR_KEYWORD for parameter in signature_parameters)
        else sorted(parameter.name for parameter in signature_parameters)
    )


def _model_error(model: type, kind: str, errors: Sequence[Mapping[str, Any]]) -> PydanticCustomError:
    problems = "; ".join(f"{'.'.join(map(str, problem['loc']))}: {text_of(problem)}" for problem in errors)
    return PydanticCustomError(
        "user_model", "{why}", {"why": f"{kind!r}: {problems}", "model": model, "errors": errors}
    )


def choices_of(field: FieldInfo) -> list[OneOf]:
    """Return the `OneOf` annotations of a field or of its items."""
    return [marker for marker in markers_of(field) if isinstance(marker, OneOf)]
