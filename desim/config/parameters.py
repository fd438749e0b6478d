"""Parameters of users' models, which may be any objects: what stands for them in JSON, and when they are equal."""

import json
from collections import UserList, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from datetime import datetime
from enum import Enum
from inspect import signature
from operator import is_
from pathlib import PurePath
from types import BuiltinFunctionType
from typing import Any

from pydantic import BaseModel
from pydantic_core import to_jsonable_python

from desim.config.named_code import definition_of, import_name
from desim.config.python_numbers import ATOMS, DATES, as_python

CONVERTED = frozenset({bool, int, float, complex, str, list, tuple})
"""The types of what `as_python` makes of numbers and arrays."""


def parameters_of(value: Any) -> dict[str, Any] | None:
    """Return the arguments that made an object of a dataclass or an attrs class, by name; None for any other object."""
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: getattr(value, field.name) for field in fields(value) if field.init}
    of_attrs: Any = getattr(type(value), "__attrs_attrs__", None)
    return None if of_attrs is None else {field.alias: getattr(value, field.name) for field in of_attrs if field.init}


def not_kept(value: Any) -> list[str]:
    """Return the names of the arguments that made an object of a dataclass and that it does not keep (`InitVar`)."""
    if not is_dataclass(value) or isinstance(value, type):
        return []
    kept = {field.name for field in fields(value)}
    others = value.__dataclass_fields__.keys() - kept  # each `InitVar`, and class variables, which are no arguments
    return sorted(others & signature(type(value)).parameters.keys())


def table_columns(value: Any) -> list[tuple[Any, Any]] | None:
    """Return the columns of a table, such as one of pandas, polars or Arrow, with their names; None if it is none."""
    kind = type(value)
    if hasattr(kind, "to_pydict"):  # of Arrow
        return list(zip(value.schema.names, (column.to_pylist() for column in value.columns), strict=True))
    if hasattr(kind, "columns") and hasattr(kind, "to_dict"):
        return list(value.items() if hasattr(kind, "items") else ((name, value[name]) for name in value.columns))
    return None


def in_json(value: Any) -> Any:
    """Return what stands in JSON for an object that JSON and pydantic lack, such as a parameter of a user's model.

    A number, an array, a series or a range becomes a number or a list. A table becomes a dict of its columns, or a list
    of names and columns if two columns have the same name; the labels of the rows of pandas are a column, too, unless
    they are 0 .. n-1. Any other object becomes { "kind": the name of its class }, a function or a class
    { "kind": its name }; see `is_named_only`.
    """
    plain = _content_in_json(value)
    if plain is not None:
        return plain
    is_definition = isinstance(value, type | BuiltinFunctionType)
    return {"kind": import_name(value if is_definition else definition_of(value))}


def _content_in_json(value: Any) -> Any:
    """Return what stands in JSON for the content of an object; None if only its name can stand there."""
    if isinstance(value, Mapping):
        return dict(sorted_sets(value))
    if hasattr(value, "iloc") and hasattr(value, "index") and list(value.index) != list(range(len(value))):
        value = value.reset_index(allow_duplicates=True)  # of pandas
    names = getattr(getattr(value, "dtype", None), "names", None)  # of a structured array
    columns = [(name, value[name]) for name in names] if names else table_columns(value)
    if columns is not None:
        by_name = {as_key(name): column for name, column in columns}
        return by_name if len(by_name) == len(columns) else columns
    if isinstance(value, PurePath):
        return value.as_posix()
    if getattr(getattr(value, "dtype", None), "kind", "") in DATES and not getattr(value, "ndim", 0):
        return str(value)
    if isinstance(value, Iterator):  # to read it would advance it
        return None
    if getattr(getattr(value, "dtype", None), "kind", "") == "O" and hasattr(value, "tolist"):  # it may hold sets
        return sorted_sets(value.tolist())
    plain = as_python(value)
    return plain if type(plain) in CONVERTED and plain is not value else None


def dumped(model: BaseModel, *, exclude_none: bool = False) -> dict[str, Any]:
    """Return the fields of a model of pydantic by name, as its serializers have them."""
    try:
        return model.model_dump(exclude_none=exclude_none)
    except TypeError:  # pydantic makes dicts of dataclasses, which cannot be keys or members of sets
        return {name: member for name, member in model if not (exclude_none and member is None)}


def table_of(model: Any, *, exclude_none: bool = False) -> dict[str, Any]:
    """Return the table that selects a user's object or function: its parameters, and its kind "module:name"."""
    if isinstance(model, BaseModel):
        parameters = dumped(model, exclude_none=exclude_none)
    else:
        made_from = parameters_of(model) or {}
        parameters = {key: entry for key, entry in made_from.items() if not (exclude_none and entry is None)}
    return {**sorted_sets(parameters), "kind": import_name(definition_of(model))}


def sorted_sets(value: Any) -> Any:
    """Return a value in which sets are sorted lists: their own order differs from process to process.

    Keys of dicts are converted by `as_key`. An object, such as one of a dataclass, is returned unchanged if it holds no
    set, else as a dict of what it holds.
    """
    return _sorted_sets(value, in_json)


def _sorted_sets(value: Any, fallback: Callable[[Any], Any]) -> Any:
    def inner(part: Any) -> Any:
        return _sorted_sets(part, fallback)

    if type(value) in ATOMS or isinstance(value, type):
        return value
    if isinstance(value, set | frozenset):
        return sorted(map(inner, value), key=_order)
    if isinstance(value, list | tuple):
        items = [*map(inner, value)]
        return value if all(map(is_, items, value)) else items if isinstance(value, list) else tuple(items)
    if isinstance(value, Mapping):
        entries = {as_key(key, fallback): inner(member) for key, member in value.items()}
        is_same = all(map(is_, entries, value)) and all(map(is_, entries.values(), value.values()))
        return value if is_same else entries
    if isinstance(value, BaseModel):
        content = dumped(value)
    elif is_dataclass(value):
        content = {field.name: getattr(value, field.name) for field in fields(value) if hasattr(value, field.name)}
    elif isinstance(value, Enum):
        content = value.value
    elif isinstance(value, Iterator):
        return fallback(value)
    elif isinstance(value, datetime) and value != value:  # NaT of pandas, at which the serialiser of pydantic fails
        return str(value)
    elif isinstance(value, deque | UserList) and not callable(value):  # a callable one is a model
        return [*map(inner, value)]
    else:
        return value
    plain = inner(content)
    return value if plain is content else plain


def as_key(key: Any, fallback: Callable[[Any], Any] = in_json) -> Any:
    """Return the key of a dict unchanged, or as JSON in a text if its JSON is a list or an object, as that of a set is.

    A tuple of keys that stay unchanged stays unchanged, too.
    """
    return key if _is_key(key, fallback) else json.dumps(as_jsonable(key, fallback), sort_keys=True)


def _is_key(key: Any, fallback: Callable[[Any], Any]) -> bool:
    if isinstance(key, tuple):
        return all(_is_key(part, fallback) for part in key)
    return type(key) in ATOMS or not isinstance(as_jsonable(key, fallback), list | dict)


def _order(member: Any) -> tuple[str, str]:
    return type(member).__name__, repr(member)


def as_jsonable(value: Any, fallback: Callable[[Any], Any] = in_json) -> Any:
    """Return a value in JSON types, where infinity and NaN stay numbers, and bytes are hexadecimal digits."""
    return to_jsonable_python(_sorted_sets(value, fallback), fallback=fallback, bytes_mode="hex")


def is_named_only(value: Any) -> bool:
    """Return whether JSON has only the name, and not the content, of a value or of an object inside it."""
    named: list[Any] = []

    def fallback(part: Any) -> Any:
        if _content_in_json(part) is None:
            named.append(part)
        return in_json(part)

    as_jsonable(value, fallback)
    return bool(named)


def are_equal(value: Any, other: Any) -> bool:
    """Return whether two values are equal; if `==` cannot tell, as for arrays, their content in JSON decides."""
    try:
        return bool(value == other)
    except (TypeError, ValueError):
        parameters, others = parameters_of(value), parameters_of(other)
        if type(value) is type(other) and parameters and others:
            return all(are_equal(parameters[name], others[name]) for name in parameters)
        if value is other or type(value) is not type(other) or is_named_only([value, other]):
            return value is other
        return bool(as_jsonable(value) == as_jsonable(other))
