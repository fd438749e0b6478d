"""Conversion of the numbers and lists that people have to those of Python: of numpy, pandas, fractions, ranges, ...

A number is an `int` if it counts (`operator.index`), and a `float` if it measures. A float that is whole stays a float,
a boolean stays a boolean, and a text stays a text, so strict types refuse the same values as before the conversion. A
value that is neither a number nor a list is returned unchanged, for the field that receives it to judge.

A set is refused by any field that is a list. A text that no file can hold is refused, with UnicodeEncodeError: one with
half of a surrogate pair, such as names with undecodable bytes on a command line have.
"""

from collections.abc import ItemsView, Iterator, KeysView, Sequence, Set, ValuesView
from decimal import Decimal
from itertools import chain
from math import isinf
from numbers import Complex, Integral, Real
from operator import index
from typing import Any

ATOMS = frozenset({int, float, bool, str, type(None)})
"""Types of values that need no conversion."""
NUMBERS = ATOMS - {str}
ROWS = frozenset({list, tuple})
LISTS = (list, tuple, Sequence, Iterator, KeysView, ValuesView, ItemsView)
"""Types with an order: lists, ranges, generators, `zip`, views of dicts, deques. A set has none."""
TEXTS = (str, bytes, bytearray)
DATES = frozenset("mM")
"""The `kind` of the dtypes of times and dates, which numpy takes for integers of an arbitrary unit."""


def as_python(value: Any) -> Any:
    """Return a value with all numbers in it as `int` or `float`, and what is in order, such as an array, as a list.

    The values of dicts and the items of lists are converted, too; lists of Python's numbers are not copied.

    Raises:
        UnicodeEncodeError: if a text cannot be encoded; see `why_no_text`.
    """
    # Exact types come first: nearly all values have one, and `isinstance` of an abstract class is slow.
    kind = type(value)
    if kind is str:
        if not value.isascii():
            value.encode()
        return value
    if kind in ATOMS:
        return value
    if kind is list or kind is tuple:
        return value if _is_plain(value) else _items(value)
    if kind is dict:
        return {as_python(key) if type(key) is str else key: as_python(item) for key, item in value.items()}
    if callable(value):  # a model of a user, which may be a list, too
        return value
    if getattr(getattr(value, "dtype", None), "kind", "") in DATES:
        return list(value) if getattr(value, "ndim", 0) else value
    if isinstance(value, Complex | Decimal):
        return _number(value)
    if hasattr(kind, "__float__") and (hasattr(value, "units") or hasattr(value, "unit")):
        return _Quantity(value)
    if hasattr(kind, "tolist") or hasattr(kind, "__array__"):
        return _of_array(value)
    if isinstance(value, LISTS):
        return value if isinstance(value, TEXTS) else _items(value)
    return _Unordered(value) if isinstance(value, Set) else value


class _Quantity:
    """A number with a unit, which is refused: a field would take its number, whatever the unit is."""

    def __init__(self, value: Any):
        self._value = value

    def __repr__(self) -> str:
        return f"{self._value!r}, with a unit: give a number in the unit of the key"


class _Unordered:
    """A set, which is refused: a field would take its items in an arbitrary order, and equal ones once."""

    def __init__(self, value: Any):
        self._value = value

    def __repr__(self) -> str:
        return f"the set {self._value!r}, which has no order: give a list"


def why_no_text(error: UnicodeEncodeError) -> str:
    """Return why a text is refused that cannot be encoded."""
    return f"should be a text that a file can hold: {error.object[error.start]!r} is half of a character"


def whole(value: Any, name: str) -> int:
    """Return an integer of any kind, such as numpy's, as an `int`.

    Raises:
        ValueError: if the value is not an integer: a boolean, a text, or a float, even one that is whole.
    """
    number = as_python(value)
    if type(number) is not int:
        raise ValueError(f"{name} should be an integer (got {value!r})")
    return number


def real(value: Any, name: str) -> float:
    """Return a number of any kind as a `float`.

    Raises:
        ValueError: if the value is not a number: for example a boolean or a text.
    """
    number = as_python(value)
    if type(number) is not float and type(number) is not int:
        raise ValueError(f"{name} should be a number (got {value!r})")
    return float(number)


def _is_plain(values: list[Any] | tuple[Any, ...]) -> bool:
    """Return whether a list, or a list of rows, needs no conversion: a check of types takes a tenth of the time."""
    kinds = set(map(type, values))
    return kinds <= NUMBERS or (kinds <= ROWS and NUMBERS.issuperset(map(type, chain.from_iterable(values))))


def _items(values: Any) -> Any:
    """Return the converted items of values in order as a list, or as a tuple if they are one."""
    items = [as_python(item) for item in values]
    if isinstance(values, tuple):
        return tuple(items)
    return items


def _number(value: Any) -> Any:
    """Return a number as an `int` or a `float`; one that neither can represent is returned unchanged."""
    try:
        if isinstance(value, Integral):
            return index(value)
        if not isinstance(value, Real | Decimal):
            return complex(value)  # numpy's would become a real number
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return value
    return value if isinf(number) and value != number else number  # too large: not infinite


def _of_array(value: Any) -> Any:
    """Return an array as nested lists, and one without dimensions as a number.

    A masked number, and a quantity with a unit, which cannot be converted without it, are returned unchanged.
    """
    value = _in_order(value)
    try:
        converted = value.tolist() if hasattr(type(value), "tolist") else _asarray(value).tolist()
    except (AttributeError, TypeError, ValueError, NotImplementedError):
        return value
    return value if converted is None or type(converted) is type(value) else as_python(converted)


def _in_order(value: Any) -> Any:
    """Return a table with its named columns in the order t, x, y, or in that of its rows of the same names."""
    names = getattr(getattr(value, "dtype", None), "names", None)
    labels = list(getattr(value, "columns", ()) if names is None else names)
    if {"x", "y"} <= set(labels) <= {"t", "x", "y"}:
        return value[sorted(labels)]
    rows = list(value.index) if hasattr(value, "index") and labels else []
    is_permuted = len(set(labels)) == len(labels) == len(rows) and set(labels) == set(rows) and labels != rows
    return value[rows] if is_permuted else value


def _asarray(value: Any) -> Any:
    import numpy as np

    return np.asarray(value)
