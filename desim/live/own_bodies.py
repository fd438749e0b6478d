"""Bodies of users in datagrams, as MessagePack: numbers, texts, collections, named tuples and dataclasses.

A datagram names a class by the name that it has in the module of the protocol, so that a receiver creates an instance
of no other class.
"""

import sys
from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from functools import cached_property, partial
from struct import Struct
from types import FunctionType
from typing import Any

import numpy as np

from desim.config.extras import naming_extras
from desim.config.number_texts import counted
from desim.config.traits import is_ours, module_of
from desim.kernel.core.records import Record
from desim.live.layouts import WireError
from desim.pursuit.team.announcements import Forwarded

_LENGTH = Struct(">I")
PLAIN = (type(None), bool, int, float, str, bytes)


class OwnBodies:
    """Packs and unpacks the bodies that users define.

    Args:
        models: the models that send them, such as the protocol.
    """

    def __init__(self, *models: Any):
        named = [item for model in models for item in _names_around(model).items()]
        bodies = {name: value for name, value in named if _is_body(value)}
        self._classes: dict[str, type[Any]] = bodies | {"Record": Record, "Forwarded": Forwarded}
        self._names = {kind: name for name, kind in self._classes.items()}
        # If a class has several names in the module, such as an alias, its `__name__` is sent.
        self._names |= {kind: kind.__name__ for name, kind in self._classes.items() if kind.__name__ == name}

    def pack(self, port: str, body: Any) -> bytes:
        """Return a port and a body as bytes, preceded by their number in four bytes."""
        with naming_extras():
            from msgspec import msgpack
        try:
            data: bytes = msgpack.encode([str(port), self._tagged(body)])
        except (OverflowError, RecursionError, UnicodeEncodeError) as problem:
            reason = "it is nested too deeply" if isinstance(problem, RecursionError) else str(problem)
            raise WireError(f"a body of type {type(body).__name__} cannot be sent live: {reason}") from problem
        return _LENGTH.pack(len(data)) + data

    def unpack(self, data: bytes) -> tuple[str, Any]:
        """Return a port and a body, the inverse of `pack`; raise ValueError if the bytes are not those of a body."""
        try:
            from msgspec import MsgspecError, msgpack
        except ModuleNotFoundError as problem:
            raise ValueError("a body of a user, without msgspec") from problem
        (length,) = _LENGTH.unpack_from(data)
        try:
            port, body = msgpack.decode(data[_LENGTH.size : _LENGTH.size + length])
            if not isinstance(port, str):
                raise ValueError("not a port")
            return port, self._untagged(body)
        except (MsgspecError, TypeError, KeyError, RecursionError) as problem:  # a datagram may nest without end
            raise ValueError(str(problem)) from problem

    def _tagged(self, value: Any) -> Any:
        """Return a value of plain types, in which each collection has its tag."""
        if type(value) in PLAIN:
            return value
        if isinstance(value, np.generic) and type(plain := value.item()) in PLAIN:
            return plain  # a number of numpy arrives as one of Python
        if type(value) in self._names:
            return ["o", self._names[type(value)], *map(self._tagged, self._parts(value))]
        if type(value) in {tuple, list}:
            return ["t" if type(value) is tuple else "l", *map(self._tagged, value)]
        if type(value) is dict:
            return ["d", *([self._tagged(key), self._tagged(item)] for key, item in value.items())]
        if type(value) is complex:
            return ["c", value.real, value.imag]
        raise WireError(
            f"a body of type {type(value).__name__} cannot be sent live: send numbers, texts, tuples, lists, dicts, or"
            " named tuples and dataclasses of the module of the protocol"
        )

    def _parts(self, value: Any) -> Iterable[Any]:
        """Return the fields of a named tuple or a dataclass.

        Raise WireError if a field has no value, or an attribute is no field.
        """
        names = [field.name for field in fields(value)] if is_dataclass(value) else value._fields
        others = [
            name
            for name in getattr(value, "__dict__", ())
            if name not in names and not isinstance(getattr(type(value), name, None), cached_property)
        ]
        if missing := [name for name in names if not hasattr(value, name)]:
            why = f"its field {missing[0]} has no value"
        elif others:
            why = f"it has the attribute {others[0]}, which is no field"
        else:
            return [getattr(value, name) for name in names]
        raise WireError(f"a body of type {type(value).__name__} cannot be sent live: {why}")

    def _untagged(self, value: Any) -> Any:
        if not isinstance(value, list):
            return value
        tag, *items = value
        if tag == "d":
            return {self._untagged(key): self._untagged(item) for key, item in items}
        if tag == "c":
            return complex(*items)
        parts = [self._untagged(item) for item in items]
        if tag in {"t", "l"}:
            return tuple(parts) if tag == "t" else parts
        if tag != "o" or not parts or not isinstance(parts[0], str) or parts[0] not in self._classes:
            raise ValueError("no collection, and no class of the protocol")
        return _restored(self._classes[parts[0]], parts[1:])


def _names_around(protocol: Any) -> dict[str, Any]:
    """Return the objects in the module of a protocol, by name; empty if the protocol is a built-in one.

    A process that has received the protocol has no such module. The functions of the protocol have the names they use.
    """
    while isinstance(protocol, partial):
        protocol = protocol.func
    function = getattr(protocol, "__func__", protocol)
    owners: Iterable[Any] = [function] if isinstance(function, FunctionType) else type(protocol).__mro__
    names: dict[str, Any] = {}
    for owner in owners:
        if is_ours(owner):
            continue
        if (module := sys.modules.get(module_of(owner))) is not None:
            names = vars(module) | names
        for item in vars(owner).values() if isinstance(owner, type) else [owner]:
            names |= item.__globals__ if isinstance(item, FunctionType) else {}
    return names


def _restored(kind: Any, parts: list[Any]) -> Any:
    """Return a named tuple or a dataclass as it was sent, without its `__init__`, which might change it once more.

    Raise ValueError if the class has another number of fields.
    """
    names = kind._fields if issubclass(kind, tuple) else [field.name for field in fields(kind)]
    if len(names) != len(parts):
        raise ValueError(f"{kind.__name__} has {counted(len(names), 'field')}, not {len(parts)}")
    if issubclass(kind, tuple):
        return kind._make(parts)
    body = object.__new__(kind)
    for name, part in zip(names, parts, strict=True):
        object.__setattr__(body, name, part)
    return body


def _is_body(kind: Any) -> bool:
    """Return whether a value is a named tuple or a dataclass."""
    return isinstance(kind, type) and ((issubclass(kind, tuple) and hasattr(kind, "_fields")) or is_dataclass(kind))
