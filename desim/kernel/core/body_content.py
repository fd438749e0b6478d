"""The content of message bodies: what an object contains, in JSON types.

A trace records a body by its content (`content`), never by its `repr`, which may have addresses, cut arrays, or depend
on settings. An object of another library takes part with `content.register`, and with
`desim.kernel.core.message_size.size`. Functions are registered in `desim.kernel.core.message_body`.
"""

import array
import copyreg
import dataclasses
import datetime
import functools
import json
import struct
import types
import uuid
import weakref
from collections import ChainMap, UserDict, UserList, UserString, deque
from collections.abc import Iterator, Mapping, Sequence, Set
from decimal import Decimal
from enum import Enum
from fractions import Fraction
from itertools import chain
from math import isnan
from pathlib import PurePath
from typing import Any

import numpy as np
from pydantic import BaseModel

from desim.config.json_numbers import field_names, has_plain
from desim.config.parameters import table_columns

MAX_DEPTH = 100
"""Largest number of nested levels in a body; Python cannot read a JSON text with ten times as many."""
JSON_ATOMS = frozenset({type(None), bool, int, float, str})
"""The types of JSON without parts."""


WRAPPERS = (UserDict, UserList, UserString)
"""The types whose objects keep their content in the attribute `data`."""
WITH_VALUE = (
    *(list, dict, tuple, set, frozenset, deque, np.ndarray, *WRAPPERS),
    *(int, float, complex, str, bytes, bytearray, Decimal),
)
"""The types whose content is not their attributes, so that an object of a derived class may have attributes beside."""


class Fields(dict[str, Any]):
    """Objects by their names, such as the fields of a dataclass."""


def in_json_types(value: Any, depth: int = 0) -> Any:
    """Return the whole content of an object: None, a bool, int, float (also infinite or NaN), str, list or dict.

    Raises:
        ValueError: if it contains itself, or is nested more than `MAX_DEPTH` levels deep.
    """
    check_depth(depth)
    value = content(value)
    if type(value) in JSON_ATOMS:
        return value
    if type(value) is list:
        return [in_json_types(item, depth + 1) for item in value]
    if type(value) is Fields:
        return {name: in_json_types(item, depth + 1) for name, item in value.items()}
    return in_json_types(value, depth + 1)


@functools.singledispatch
def content(value: Any) -> Any:
    """Return the content of an object: a number, text, list, `Fields`, or another object, whose content it is.

    The items of a list and of `Fields` are any objects.

    The fields of a dataclass, a named tuple, a pydantic or an attrs model by name; an array, a series, a deque or a
    range as a list; a set as a sorted list; a table by columns; bytes in hexadecimal digits; a complex number as its
    real and imaginary part; an enumeration by its value; a date in ISO 8601; a duration in seconds; a fraction, decimal
    number, path, time zone or UUID as text; a function or a class by its name; a missing number (`pandas.NA`) as None;
    a quantity as its value and its unit. Public attributes beside the fields, the items or the value of an object of a
    derived class are added. Any other object, also a collection that keeps its items in public attributes, is a dict of
    its attributes with its class as `class_name`. If it holds more (`is_opaque`), the dict has the
    arguments and the state from which pickle would create it again.

    Raises:
        ValueError: if the content is not known, or can be read only once.
    """
    if (fields := content_fields(value)) is not None:
        return fields
    kind: Any = type(value)
    if converts_itself(kind):
        return value.plain()
    if (parts := quantity_of(value)) is not None:
        return parts
    if (columns := table_columns(value)) is not None:
        by_name = dict(columns)
        if len(by_name) < len(columns):
            raise ValueError("it has several columns of one name")
        return by_name
    if callable(getattr(kind, "tolist", None)):
        return value.tolist()
    if hasattr(kind, "__array__"):
        return np.asarray(value)
    if is_missing(value):
        return None
    return _pickled(value) if is_opaque(kind) else _as_object(value)


def _as_object(value: Any) -> Fields:
    if (fields := content_fields(value)) is not None:
        return fields
    attributes = attributes_of(value)
    name = "class_name"
    while name in attributes:
        name += "_"
    return Fields({name: type(value).__name__} | attributes)


def is_object(value: Any) -> bool:
    """Return whether the content of a collection of its own class is its attributes, because it has public ones.

    These may be its items, or something beside them.
    """
    kind: type = type(value)
    if not kind.__dictoffset__ or isinstance(value, (*WITH_VALUE, ChainMap)):
        return False
    return any(is_public(name, part) for name, part in attributes_of(value).items())


def quantity_of(value: Any) -> Fields | None:
    """Return the value and the unit of a quantity of a library of units; None for any other object."""
    kind: Any = type(value)
    if not hasattr(kind, "__float__"):
        return None
    unit = getattr(value, "units", getattr(value, "unit", None))
    number = getattr(value, "magnitude", getattr(value, "value", None))
    return None if unit is None or number is None or callable(number) else Fields(value=number, unit=str(unit))


def public_attributes(items: Any) -> Fields:
    """Return the public attributes of an object that are beside its value or its items, by name; see `WITH_VALUE`."""
    kind: Any = type(items)
    if not _has_value(kind):
        return Fields()
    attributes = {} if vars(items) is items else vars(items)  # a dict may be its own attributes
    left_out = computed_names(kind) | ({"data"} if isinstance(items, WRAPPERS) else set())
    return Fields({name: part for name, part in attributes.items() if name not in left_out and is_public(name, part)})


@functools.cache
def _has_value(kind: type) -> bool:
    """Return whether objects of a class may have attributes beside a value or items; see `WITH_VALUE`."""
    return kind.__dictoffset__ != 0 and issubclass(kind, WITH_VALUE) and not issubclass(kind, Enum)


def is_public(name: str, part: Any) -> bool:
    """Return whether an attribute of an object is public data, given its name: no method, and not private."""
    return name[0] != "_" and not callable(part)


def _with_attributes(parts: Any, items: Any) -> Any:
    attributes = public_attributes(items)
    name = "value" if type(parts) in JSON_ATOMS else "items"
    return Fields({"class_name": type(items).__name__, name: parts} | attributes) if attributes else parts


def is_missing(value: Any) -> bool:
    """Return whether an object stands for a missing number, as `pandas.NA` and `numpy.ma.masked` do."""
    kind: type = type(value)
    return value is np.ma.masked or (kind.__name__ == "NAType" and kind.__module__.startswith("pandas."))


@functools.cache
def is_opaque(kind: Any) -> bool:
    """Return whether the objects of a type hold more than their attributes, as those of most types written in C do.

    Python decides by the same rule whether their attributes suffice to copy them.
    """
    slots = copyreg._slotnames(kind)  # type: ignore[attr-defined]
    pointers = (kind.__dictoffset__ > 0) + (kind.__weakrefoffset__ > 0) + len(slots)
    return bool(kind.__itemsize__) or kind.__basicsize__ > object.__basicsize__ + pointers * struct.calcsize("P")


def _pickled(value: Any) -> Any:
    """Return the content of an object as the arguments and the state from which pickle would create it again."""
    kind: type = type(value)
    if isinstance(value, Iterator):
        raise ValueError(f"an object of type {kind.__name__} can be read only once: send a list of its items")
    try:
        registered = copyreg.dispatch_table.get(kind)
        reduced = value.__reduce_ex__(4) if registered is None else registered(value)
    except TypeError as error:
        raise ValueError(f"the content of an object of type {kind.__name__} is not known") from error
    if isinstance(reduced, str):
        return reduced
    function, args, *rest = reduced
    is_new = function is copyreg.__newobj__  # type: ignore[attr-defined]
    state = {"state": rest[0]} if rest and rest[0] is not None else {}
    return Fields({"class_name": kind.__name__, "args": args[1:] if is_new else args} | state)


def content_fields(value: Any) -> Fields | None:
    """Return the fields of a dataclass, a named tuple, or a pydantic, attrs or msgspec model; None for others.

    Public attributes beside the fields are among them.
    """
    kind: Any = type(value)
    names = _field_names(kind)
    if names is None:
        return None
    fields = Fields({name: getattr(value, name) for name in names if hasattr(value, name)})
    if isinstance(value, BaseModel):
        return Fields(fields | (value.model_extra or {}))
    if kind.__dictoffset__ and (_slot_names(kind) or not vars(value).keys() <= fields.keys()):
        beside = attributes_of(value).items()
        fields |= {name: part for name, part in beside if name not in fields and is_public(name, part)}
    return fields


@functools.cache
def converts_itself(kind: Any) -> bool:
    """Return whether the objects of a type have a method (not a field) `plain` that returns their content."""
    return has_plain(kind) and callable(kind.plain) and not issubclass(kind, BaseModel)


@functools.cache
def _field_names(kind: Any) -> tuple[str, ...] | None:
    if dataclasses.is_dataclass(kind):
        return tuple(field.name for field in dataclasses.fields(kind))
    if issubclass(kind, BaseModel):
        return tuple(kind.model_fields)
    if hasattr(kind, "__attrs_attrs__"):
        return tuple(field.name for field in kind.__attrs_attrs__)
    return field_names(kind) or getattr(kind, "__struct_fields__", None)


def attributes_of(value: Any) -> Fields:
    """Return the attributes of which the content of an object consists, by name; those in slots are last, sorted.

    Attributes that the class does not pickle, such as a lock, are left out, and so are cached properties: they follow
    from others, and are stored only once they have been read.
    """
    kind: Any = type(value)
    stored, slots = _stored(value)
    if stored and kind.__getstate__ is not object.__getstate__:
        pickled = value.__getstate__()
        if isinstance(pickled, dict) and pickled.keys() < stored.keys():
            stored = {name: stored[name] for name in pickled}
    if computed := computed_names(kind) & stored.keys():
        stored = {name: part for name, part in stored.items() if name not in computed}
    return Fields(stored | dict(sorted(slots.items())))


def stored_parts(value: Any) -> list[Any]:
    """Return all objects that are stored in an object."""
    return [part for attributes in _stored(value) for part in attributes.values()]


def _stored(value: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the attributes that are stored in an object, and those in its slots, by name."""
    state = object.__getstate__(value)
    stored, slots = state if isinstance(state, tuple) else (state, None)
    return stored or {}, slots or {}


@functools.cache
def _slot_names(kind: type) -> frozenset[str]:
    """Return the names in the `__slots__` of a class and its bases."""
    slots = (vars(base).get("__slots__", ()) for base in kind.__mro__)
    return frozenset(chain.from_iterable([names] if isinstance(names, str) else names for names in slots))


@functools.cache
def computed_names(kind: type) -> frozenset[str]:
    """Return the names of the cached properties of a class."""
    cached = (name for base in kind.__mro__ for name, member in vars(base).items() if _is_cached(member))
    return frozenset(cached)


def _is_cached(member: Any) -> bool:
    return isinstance(member, functools.cached_property)


def check_depth(depth: int) -> None:
    """Raise ValueError if a part of a body is nested more than `MAX_DEPTH` levels deep."""
    if depth > MAX_DEPTH:
        raise ValueError(f"it is nested more than {MAX_DEPTH} levels deep, or contains itself")


content.register(type(None), lambda value: value)
content.register(bool, lambda value: value)
content.register(int, lambda number: _with_attributes(int(number), number))
content.register(float, lambda number: _with_attributes(float(number), number))
content.register(str, lambda text: _with_attributes(str.__str__(text), text))
content.register(complex, lambda number: _with_attributes([number.real, number.imag], number))
for _octets in (bytes, bytearray):
    content.register(_octets, lambda octets: _with_attributes(octets.hex(), octets))
content.register(memoryview, lambda octets: octets.tobytes().hex())
content.register(array.array, lambda items: items.tolist())
content.register(Enum, lambda member: member.value)
content.register(datetime.date, lambda date: date.isoformat())
content.register(datetime.time, lambda time: time.isoformat())
content.register(datetime.timedelta, lambda duration: duration.total_seconds())
content.register(PurePath, lambda path: path.as_posix())
content.register(types.ModuleType, lambda module: str(module.__name__))
for _text in (UserString, Decimal, Fraction, uuid.UUID, datetime.tzinfo):
    content.register(_text, lambda value: _with_attributes(str(value), value))
content.register(
    functools.partial, lambda call: Fields(class_name="partial", func=call.func, args=call.args, keywords=call.keywords)
)
content.register(
    BaseException,
    lambda error: Fields({"class_name": type(error).__name__, "args": list(error.args)} | attributes_of(error)),
)
for _code in (type, types.MethodType):
    content.register(_code, lambda code: str(code.__qualname__))


@content.register(list)
@content.register(tuple)
@content.register(Sequence)
def _items(items: Sequence[Any]) -> Any:
    fields = None if isinstance(items, list) else content_fields(items)
    if fields is None:
        return _as_object(items) if is_object(items) else _with_attributes(list(items), items)
    return fields


@content.register(Mapping)
def _mapping(items: Mapping[Any, Any]) -> Any:
    """Return a mapping with JSON texts as keys, or as a list of pairs if two keys have the same text."""
    if is_object(items):
        return _as_object(items)
    keys = map(in_json_types, items)
    texts = [key if type(key) is str else json.dumps(key) for key in keys]
    if len(set(texts)) < len(texts):
        return _with_attributes(list(map(list, items.items())), items)
    return _with_attributes(Fields(zip(texts, items.values(), strict=True)), items)


@content.register
def _set(items: Set) -> Any:  # type: ignore[type-arg]
    if is_object(items):
        return _as_object(items)
    return _with_attributes(sorted(map(in_json_types, items), key=_order), items)


def _order(value: Any) -> tuple[Any, ...]:
    """Return the key by which the items of a set, in JSON types, are sorted: None, numbers, texts, lists, dicts."""
    if isinstance(value, int | float):
        return (2,) if isnan(value) else (1, value, type(value).__name__)
    if isinstance(value, str):
        return 3, value
    if isinstance(value, list):
        return 4, list(map(_order, value))
    return (0,) if value is None else (5, [(name, _order(item)) for name, item in value.items()])


@content.register
def _reference(_: weakref.ref) -> Any:  # type: ignore[type-arg]
    raise ValueError("a weak reference refers to an object that may change")


@content.register
def _scalar(scalar: np.generic) -> Any:
    if isinstance(scalar, np.void):
        names = scalar.dtype.names
        return scalar.tobytes().hex() if names is None else Fields({name: scalar[name] for name in names})
    if isinstance(scalar, np.timedelta64) and np.datetime_data(scalar.dtype)[0] not in {"Y", "M", "generic"}:
        return float(scalar / np.timedelta64(1, "s"))
    if isinstance(scalar, np.datetime64 | np.timedelta64):
        return str(scalar)
    if isinstance(scalar, np.floating):
        return float(scalar)
    return complex(scalar) if isinstance(scalar, np.complexfloating) else scalar.item()


@content.register
def _array(array: np.ndarray) -> Any:
    if is_missing(array):
        return None
    if type(array) is not np.ndarray and (parts := quantity_of(array)) is not None:
        return parts
    if array.ndim == 0 and not public_attributes(array):
        return array[()]
    return _with_attributes(array.tolist() if array.dtype.kind in "biufcSUO" else list(np.asarray(array)), array)
