"""Layouts of message bodies: fields as numbers of a datagram, by their annotations; see `desim.live.wire`."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum, auto
from math import isnan
from struct import Struct, error
from types import MappingProxyType
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

from desim.kernel.core.message_size import NUMBER
from desim.kernel.core.records import Record

MAX_COUNT = 1 << 40
"""Largest number of hops, or of events by a logical clock."""
PLACE = 48
"""Bits of an item of a list with missing items; the bits above are its place."""
_new = tuple.__new__  # creates a named tuple in a third of the time
_NUMBER = Struct(">q")
_FORMATS = MappingProxyType({int: "q", bool: "q", float: "d"})
NumberRange = tuple[int, int]
"""The least and the greatest number."""


class WireError(ValueError):
    """A datagram is malformed, or a message cannot be encoded as a datagram."""


class FieldForm(Enum):
    """How the value of a field is made of numbers."""

    NUMBER = auto()
    FLAG = auto()
    TUPLE = auto()
    """Numbers of a fixed count."""
    LIST = auto()
    """Numbers whose count varies."""
    PLACES = auto()
    """A list of a fixed length, of which items may be missing; each number has its place."""
    RECORDS = auto()


class FieldLayout(NamedTuple):
    """A field of a body."""

    form: FieldForm
    begin: int
    """Index of its first number among those of a fixed count."""
    end: int
    """Index after its last number; for `FieldForm.PLACES`, the length of the list."""
    limits: NumberRange | None
    """The limits of the items of a list or of places; `Layout` has those of numbers of a fixed count."""


class Layout:
    """The layout of a body: numbers of a fixed count, then maybe a list of numbers, then maybe a list of records.

    Args:
        body: the class of the body, a named tuple.
        lengths: the lengths of lists, by the name of the field; any other list varies in length.
        limits: by name of a field, the limits of its numbers: one pair for all, or one for each of the first few.

    Attributes:
        size: bytes of the numbers of a fixed count.
        has_rest: whether the length of a body varies.
    """

    def __init__(self, body: type[Any], lengths: Mapping[str, int], limits: Mapping[str, Sequence[NumberRange]]):
        self.body, format_, hints = body, "", get_type_hints(body)
        self._parts: list[FieldLayout] = []
        self._bounds: list[tuple[int, int, int]] = []
        """Index, least and greatest value of numbers of a fixed count."""
        for name in body._fields:
            form, field_format = _form_of(hints[name], lengths.get(name))
            begin, end, bounds = len(format_), len(format_) + len(field_format), limits.get(name, ())
            format_ += field_format
            number_limits = bounds if len(bounds) > 1 else [*bounds] * len(field_format)
            self._bounds += [(begin + k, *limits) for k, limits in enumerate(number_limits)]
            item_limits = bounds[0] if bounds and not field_format else None
            end = lengths[name] if form is FieldForm.PLACES else end
            self._parts.append(FieldLayout(form, begin, end, item_limits))
        self._struct, self._fixed = Struct(">" + format_), len(format_)
        self.size = self._struct.size
        forms = {part.form for part in self._parts}
        self.has_rest = not forms <= {FieldForm.NUMBER, FieldForm.FLAG, FieldForm.TUPLE}
        self._is_plain = forms == {FieldForm.NUMBER}
        self._has_floats = "d" in format_

    def flat(self, body: Any) -> tuple[list[Any], Sequence[Record]]:
        """Return the numbers of a body, those of a fixed count first, and its records."""
        if self._is_plain:
            return list(body), ()
        numbers, items, records = list[Any](), list[Any](), ()
        for (form, *_), value in zip(self._parts, body, strict=True):
            if form is FieldForm.TUPLE:
                numbers += value
            elif form is FieldForm.LIST:
                items += value
            elif form is FieldForm.PLACES:
                items += [place << PLACE | item for place, item in enumerate(value) if item is not None]
            elif form is FieldForm.RECORDS:
                records = value
            else:
                numbers.append(value)
        return numbers + items, records

    def pack(self, numbers: list[Any]) -> bytes:
        """Return the bytes of numbers."""
        fixed = self._fixed
        try:
            return self._struct.pack(*numbers[:fixed]) + b"".join(map(_NUMBER.pack, numbers[fixed:]))
        except error as problem:
            raise WireError(f"{self.body.__name__} {numbers} cannot be sent: {problem}") from problem

    def read(self, data: bytes, at: int, records: Callable[[bytes], Iterator[Record]]) -> Any:
        """Return the body in some bytes.

        Args:
            data: the bytes.
            at: the index at which the body begins.
            records: reads the records at the end of the data.

        Raises:
            ValueError: if the bytes are not those of such a body.
        """
        numbers = self._struct.unpack_from(data, at)
        if self._has_floats and any(map(isnan, numbers)):
            raise ValueError("not a number")
        for index, low, high in self._bounds:
            if not low <= numbers[index] <= high:
                raise ValueError("a number is out of range")
        if len(data) > at + self.size:
            if not self.has_rest:
                raise ValueError("bytes after the end")
            return self._made(numbers, *_rest(data[at + self.size :], records))
        return _new(self.body, numbers) if self._is_plain else self._made(numbers, [], ())

    def _made(self, numbers: Sequence[Any], items: list[int], records: tuple[Record, ...]) -> Any:
        """Return the body with some fixed numbers, listed items and records."""
        values = list[Any]()
        for form, begin, end, limits in self._parts:
            if form is FieldForm.NUMBER:
                values.append(numbers[begin])
            elif form is FieldForm.TUPLE:
                values.append(numbers[begin:end])
            elif form is FieldForm.FLAG:
                values.append(bool(numbers[begin]))
            elif form is FieldForm.RECORDS:
                values.append(records)
                records = ()
            else:
                values.append(tuple(items) if form is FieldForm.LIST else _placed(items, end))
                _check([item for item in values[-1] if item is not None], limits)
                items = []
        if items or records:
            raise ValueError("bytes after the end")
        return self.body(*values)


def _form_of(hint: Any, length: int | None) -> tuple[FieldForm, str]:
    """Return the form of a field, and the format of its numbers of a fixed count, one character each."""
    if hint in _FORMATS:
        return FieldForm.FLAG if hint is bool else FieldForm.NUMBER, _FORMATS[hint]
    items = get_args(hint)
    if get_origin(hint) is not tuple or not items:
        raise TypeError(f"no layout for {hint}")
    if any(type(None) in get_args(item) for item in items):
        return FieldForm.PLACES, ""
    if items[0] is Record or items[0] is Any:
        return FieldForm.RECORDS, ""
    if items[-1] is not Ellipsis:
        return FieldForm.TUPLE, "".join(_FORMATS[item] for item in items)
    return (FieldForm.LIST, "") if length is None else (FieldForm.TUPLE, _FORMATS[items[0]] * length)


def _rest(data: bytes, records: Callable[[bytes], Iterator[Record]]) -> tuple[list[int], tuple[Record, ...]]:
    """Return the listed items and the records in the rest of a datagram; a record begins with a set bit."""
    items, at = list[int](), 0
    while at < len(data) and not data[at] & 0x80:
        (item,) = _NUMBER.unpack_from(data, at)
        items.append(item)
        at += NUMBER
    return items, tuple(records(data[at:]))


def _placed(items: list[int], length: int) -> tuple[int | None, ...]:
    """Return a list in which each item is at its place; the other places hold None."""
    places: list[int | None] = [None] * length
    for item in items:
        places[item >> PLACE] = item & ((1 << PLACE) - 1)
    return tuple(places)


def _check(numbers: Sequence[int], limits: NumberRange | None) -> None:
    """Raise ValueError if a number is not within limits."""
    if limits is not None and numbers and not (limits[0] <= min(numbers) and max(numbers) <= limits[1]):
        raise ValueError("a number is out of range")
