"""Bodies of users in datagrams, as MessagePack: numbers, texts, collections, named tuples and dataclasses.

A datagram names a class by the number that it has among those of the module of the protocol, so that a receiver creates
an instance of no other class.
"""

import sys
from dataclasses import fields, is_dataclass
from struct import Struct
from typing import Any

from desim.config.extras import naming_extras
from desim.kernel.core.records import Record
from desim.live.layouts import WireError
from desim.pursuit.team.announcements import Forwarded

_LENGTH = Struct(">I")
PLAIN = (type(None), bool, int, float, str, bytes)


class OwnBodies:
    """Packs and unpacks the bodies that a protocol defines itself.

    Args:
        protocol: the protocol.
    """

    def __init__(self, protocol: Any):
        module = sys.modules.get(getattr(protocol, "__module__", type(protocol).__module__))
        defined = vars(module).values() if module is not None and not module.__name__.startswith("protocols") else ()
        self._classes: list[type[Any]] = [Record, Forwarded, *filter(_is_body, defined)]

    def pack(self, port: str, body: Any) -> bytes:
        """Return a port and a body as bytes, which begin with their number."""
        with naming_extras():
            from msgspec import msgpack
        data: bytes = msgpack.encode([str(port), self._tagged(body)])
        return _LENGTH.pack(len(data)) + data

    def unpack(self, data: bytes) -> tuple[str, Any]:
        """Return a port and a body, the inverse of `pack`."""
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
        except (MsgspecError, TypeError, KeyError) as problem:
            raise ValueError(str(problem)) from problem

    def _tagged(self, value: Any) -> Any:
        """Return a value of plain types, in which each collection has its tag."""
        if type(value) in PLAIN:
            return value
        if type(value) in self._classes:
            parts = value if isinstance(value, tuple) else [getattr(value, field.name) for field in fields(value)]
            return [self._classes.index(type(value)), *map(self._tagged, parts)]
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
        return self._classes[tag](*parts) if type(tag) is int and 0 <= tag < len(self._classes) else _wrong_tag(tag)


def _wrong_tag(tag: Any) -> Any:
    raise ValueError(f"no class has the number {tag}")


def _is_body(kind: Any) -> bool:
    """Return whether a value is a named tuple or a dataclass."""
    return isinstance(kind, type) and ((issubclass(kind, tuple) and hasattr(kind, "_fields")) or is_dataclass(kind))
