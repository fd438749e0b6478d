"""Layouts: the numbers of a body in a datagram, from the annotations of its fields; see `desim.live.wire`."""

from collections.abc import Callable, Iterator, Sequence
from struct import Struct, error
from types import MappingProxyType
from typing import Any, get_args, get_origin, get_type_hints

from desim.kernel.core.message_size import NUMBER
from desim.kernel.core.records import Record

MAX_COUNT = 1 << 40
"""Largest number of hops, or of events by a logical clock."""
PLACE = 48
"""Bits of an item of a list with missing items; the bits above are its place."""
_NUMBER = Struct(">q")


class WireError(ValueError):
    """A datagram is malformed, or a message cannot be one."""


class Layout:
    """The layout of a body: numbers of a fixed count, then maybe a list of numbers, then maybe a list of records.

    Args:
        body: the class of the body, a named tuple.
        lengths: the lengths of lists, by the name of the field; any other list varies in length.
        limits: the least and the greatest number in a field, by its name.
        nodes: number of nodes, N.

    Attributes:
        size: bytes of the numbers of a fixed count.
        has_rest: whether the length of a body varies.
    """

    def __init__(self, body: type[Any], lengths: dict[str, int], limits: dict[str, tuple[int, int]], nodes: int):
        self.body, self._limits, self._nodes = body, limits, nodes
        hints = get_type_hints(body)
        self._fields = [(name, hints[name], lengths.get(name)) for name in body._fields]
        fixed = [_format(hint, length) for _, hint, length in self._fields]
        self._struct = Struct(">" + "".join(part for part in fixed if part is not None))
        self.size = self._struct.size
        self._missing = [name for name, hint, _ in self._fields if _may_miss(hint)]
        self.has_rest = None in fixed or bool(self._missing)
        self._is_plain = all(hint in _FORMATS for _, hint, _ in self._fields)
        self._floats = [k for k, (_, hint, _) in enumerate(self._fields) if hint is float]
        self._limited = [(k, *limits[name]) for k, (name, _, _) in enumerate(self._fields) if name in limits]

    def flat(self, body: Any) -> tuple[list[Any], Sequence[Record]]:
        """Return the numbers of a body, those of a fixed count first, and its records."""
        if self._is_plain:
            return list(body), ()
        numbers, rest, records = list[Any](), list[Any](), ()
        for (name, hint, length), value in zip(self._fields, body, strict=True):
            if name in self._missing:
                rest += [place << PLACE | item for place, item in enumerate(value) if item is not None]
            elif _format(hint, length) is not None:
                numbers += _numbers(value)
            elif value and isinstance(value[0], Record):
                records = value
            else:
                rest += value
        return numbers + rest, records

    def pack(self, numbers: list[Any]) -> bytes:
        """Return the bytes of numbers."""
        fixed = len(self._struct.format) - 1
        try:
            return self._struct.pack(*numbers[:fixed]) + b"".join(map(_NUMBER.pack, numbers[fixed:]))
        except error as problem:
            raise WireError(f"{self.body.__name__} {numbers} cannot be sent: {problem}") from problem

    def read(self, data: bytes, records: Callable[[bytes], Iterator[Record]]) -> Any:
        """Return the body in some bytes."""
        numbers = self._struct.unpack_from(data)
        rest = data[self.size :]
        if rest and not self.has_rest:
            raise ValueError("bytes after the end")
        if self._is_plain:  # most datagrams
            for k in self._floats:
                if numbers[k] != numbers[k]:
                    raise ValueError("not a number")
            for k, low, high in self._limited:
                if not low <= numbers[k] <= high:
                    raise ValueError(f"{self.body._fields[k]} is out of range")
            return self.body._make(numbers)
        if any(number != number for number in numbers):
            raise ValueError("not a number")
        items = list[int]()
        while rest and not rest[0] & 0x80:
            (item,) = _NUMBER.unpack_from(rest)
            items.append(item)
            rest = rest[NUMBER:]
        within = tuple(records(rest))
        return self._made(iter(numbers), items, within)

    def _made(self, numbers: Iterator[Any], items: list[int], records: tuple[Record, ...]) -> Any:
        values = list[Any]()
        for name, hint, length in self._fields:
            if name in self._missing:
                value: Any = [None] * (length or 0)
                for item in items:
                    value[item >> PLACE] = item & ((1 << PLACE) - 1)
                value = tuple(value)
                items = []
            elif _format(hint, length) is not None:
                value = _shaped(hint, length, numbers)
            elif Record in get_args(hint) or Any in get_args(hint):
                value, records = records, ()
            else:
                value, items = tuple(items), []
            self._check(name, value)
            values.append(value)
        if items or records:
            raise ValueError("bytes after the end")
        return self.body(*values)

    def _check(self, name: str, value: Any) -> None:
        """Raise ValueError if an entry of a field is out of its range."""
        if name in {"epoch", "stamp"} and not (0 <= value[0] <= MAX_COUNT and -1 <= value[1] < self._nodes):
            raise ValueError(f"{name} is out of range")
        low, high = self._limits.get(name, (0, 0))
        entries = value if isinstance(value, tuple) else (value,)
        if name in self._limits and not all(low <= entry <= high for entry in entries if entry is not None):
            raise ValueError(f"{name} is out of range")


_FORMATS = MappingProxyType({int: "q", bool: "q", float: "d"})


def _may_miss(hint: Any) -> bool:
    return any(type(None) in get_args(item) for item in get_args(hint))


def _format(hint: Any, length: int | None) -> str | None:
    """Return the format of the numbers of a field, one character each; None if their count varies."""
    if hint in _FORMATS:
        return _FORMATS[hint]
    if get_origin(hint) is tuple:
        items = get_args(hint)
        if _may_miss(hint) or (items[-1] is Ellipsis and length is None):
            return None
        kinds = [items[0]] * (length or 0) if items[-1] is Ellipsis else items
        return "".join(_FORMATS[kind] for kind in kinds)
    raise TypeError(f"no layout for {hint}")


def _numbers(value: Any) -> list[Any]:
    return list(value) if isinstance(value, tuple) else [value]


def _as(hint: Any, number: Any) -> Any:
    return bool(number) if hint is bool else number


def _shaped(hint: Any, length: int | None, numbers: Iterator[Any]) -> Any:
    """Return the value of a field from the next numbers."""
    if get_origin(hint) is not tuple:
        return _as(hint, next(numbers))
    items = get_args(hint)
    return tuple(next(numbers) for _ in range(length or 0 if items[-1] is Ellipsis else len(items)))
