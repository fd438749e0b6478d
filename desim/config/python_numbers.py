"""Conversion of numbers and lists of any origin to those of Python: of numpy, pandas, fractions, ranges, ...

A number is an `int` if it counts (`operator.index`), and a `float` if it measures. A float that is whole stays a float,
a boolean stays a boolean, and a text stays a text, so strict types refuse the same values as before the conversion. A
value that is neither a number nor a list is returned unchanged, for the field that receives it to judge.

A field that is a list refuses a set, which has no order, unless the order has no effect (`AnyOrder`), and an iterator
without an end, such as `itertools.cycle`.
Columns and fields with the names of coordinates (`desim.config.column_names`) are brought into the order t, x, y. A
text with half of a surrogate pair raises UnicodeEncodeError, because no file can hold it; a name with undecodable bytes
on a command line is such a text.
"""

import re
from collections.abc import ItemsView, Iterator, KeysView, Sequence, Set, Sized, ValuesView
from decimal import Decimal
from io import IOBase
from itertools import chain, count, cycle, islice, repeat
from math import isinf, nan
from numbers import Complex, Integral, Real
from operator import index, length_hint
from types import GeneratorType
from typing import Any

from desim.config.arguments import abridged, value_text
from desim.config.column_names import COLUMNS, OtherColumnError, coordinate_columns

ATOMS = frozenset({int, float, bool, str, type(None)})
"""Types of values that need no conversion."""
NUMBERS = ATOMS - {str}
ROWS = frozenset({list, tuple})
LISTS = (list, tuple, Sequence, Iterator, KeysView, ValuesView, ItemsView)
"""Types with an order: lists, ranges, generators, `zip`, views of dicts, deques. A set has none."""
TEXTS = (str, bytes, bytearray)
MAX_ITEMS = 10_000_000
"""Largest number of items of a list; an iterator may have no end, and a range more than the memory holds."""
DATES = frozenset("mM")
"""The kinds of numpy's dtypes of durations and dates, which would become integers of an arbitrary unit."""


def as_python(value: Any) -> Any:
    """Return a value in which all numbers are Python's, and ordered collections such as arrays are lists or tuples.

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
        return list(value) if getattr(value, "ndim", 0) else value  # unconverted, for the field to refuse
    if isinstance(value, Complex | Decimal):
        return _number(value)
    if hasattr(kind, "__float__") and (hasattr(value, "units") or hasattr(value, "unit")):
        return Refused(f"{abridged(repr(value))}, with a unit: give a number in the unit of the key")
    if hasattr(kind, "toarray"):  # of scipy
        return Refused("a sparse matrix, whose absent numbers may be 0 or missing: give an array")
    if hasattr(kind, "tolist") or hasattr(kind, "__array__"):
        return _of_array(value)
    if isinstance(value, IOBase):  # its lines would be a list, and would be used up
        return Refused("an open file: give its path")
    if isinstance(value, LISTS):
        return value if isinstance(value, TEXTS) else _items(value)
    return _RefusedSet(value) if isinstance(value, Set) else value


def sets_as_lists(value: Any) -> Any:
    """Return a value in which each set of integers is a sorted list, also in a list of sets.

    It is for fields whose order has no effect, such as the groups of a partition, which networkx returns as sets. A set
    with other items stays as it is, so that `as_python` refuses it.
    """
    if isinstance(value, _RefusedSet):  # the set was in a table, whose own conversion does not know the field
        value = value.value
    if isinstance(value, Set):
        return sorted(value) if all(isinstance(item, Integral) for item in value) else value
    if isinstance(value, GeneratorType):
        return (sets_as_lists(item) for item in value)  # not a list, because it may have no end
    return [sets_as_lists(item) for item in value] if type(value) in ROWS else value


class Refused:
    """Stands for a value that every field should refuse, although it could be converted without its unit or its order.

    The whole text of this object is shown in the error message as the value.
    """

    def __init__(self, text: str):
        self._text = text

    def __repr__(self) -> str:
        return self._text


class _RefusedSet(Refused):
    """Stands for a set, which fields whose order has no effect accept all the same: see `sets_as_lists`."""

    def __init__(self, value: Set[Any]):
        super().__init__(f"the set {abridged(repr(value))}, which has no order: give a list")
        self.value = value


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
        raise ValueError(f"{name} should be an integer (got {value_text(value)})")
    return number


def real(value: Any, name: str) -> float:
    """Return a number of any kind as a `float`.

    Raises:
        ValueError: if the value is not a number: for example a boolean or a text.
    """
    number = as_python(value)
    if type(number) is not float and type(number) is not int:
        raise ValueError(f"{name} should be a number (got {value_text(value)})")
    try:
        return float(number)
    except OverflowError as error:
        raise ValueError(f"{name} should be a number up to 1.8e308 (got one of {len(str(number))} digits)") from error


def as_real(value: Any) -> float:
    """Return a number of any kind as a `float`; nan if the value is no number, or too large.

    Use it for what functions of users return. For arguments of a caller use `real`, whose error says what to give.
    """
    try:
        return value if type(value) is float else real(value, "")
    except ValueError:
        return nan


def as_complex(value: Any) -> complex:
    """Return a number of any kind as a `complex`; nan if the value is no number, as `as_real` does."""
    number = value if type(value) is complex else as_python(value)
    return number if type(number) is complex else complex(as_real(number))


def _is_plain(values: list[Any] | tuple[Any, ...]) -> bool:
    """Return whether a list, or a list of rows, needs no conversion: a check of types takes a tenth of the time."""
    kinds = set(map(type, values))
    return kinds <= NUMBERS or (kinds <= ROWS and NUMBERS.issuperset(map(type, chain.from_iterable(values))))


def _items(values: Any, *, is_row: bool = False) -> Any:
    """Return the converted items of an ordered collection as a list; those of a tuple as a tuple.

    A named tuple that is no row of a table, such as a place (x, y, z) of a user's model, may have any names.
    """
    if isinstance(values, Sized) and _length(values) > MAX_ITEMS:
        return Refused(f"a list of more than {MAX_ITEMS:,} items")
    if isinstance(values, Iterator):
        if _is_endless(values) or len(values := list(islice(values, MAX_ITEMS + 1))) > MAX_ITEMS:
            return Refused("an iterator without an end: give a list")
    elif _is_named(values):
        fields = values._fields
        try:
            values = tuple(values[k] for k in coordinate_columns(fields) or range(len(fields)))
        except ValueError as error:
            if is_row or not isinstance(error, OtherColumnError):
                return Refused(f"a row: {error}")
    items = [_items(item, is_row=True) if _is_named(item) else as_python(item) for item in values]
    return tuple(items) if isinstance(values, tuple) else items


def _is_named(value: Any) -> bool:
    return isinstance(value, tuple) and hasattr(value, "_fields") and not callable(value)


def _length(values: Sized) -> int:
    """Return the number of items; if it is too large for `len`, as that of a long range, return `MAX_ITEMS` + 1."""
    try:
        return len(values)
    except OverflowError:
        return MAX_ITEMS + 1


def _is_endless(values: Iterator[Any]) -> bool:
    """Return whether an iterator of `itertools` has no end; `repeat` may have one."""
    if not isinstance(values, repeat):
        return isinstance(values, cycle | count)
    try:
        return length_hint(values) < 0
    except TypeError:
        return True


def _number(value: Any) -> Any:
    """Return a number as an `int`, a `float` or a `complex`; one that none can represent is returned unchanged."""
    try:
        if isinstance(value, Integral):
            return index(value)
        if not isinstance(value, Real | Decimal):
            return complex(value)  # `float` drops the imaginary part of a complex number of numpy
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return value
    return value if isinf(number) and value != number else number  # a number that is too large is not infinite


def _of_array(value: Any) -> Any:
    """Return an array as nested lists, and one without dimensions as a number.

    A masked number is returned unchanged, and so is a quantity whose unit would be lost.
    """
    try:
        value = _in_order(value)
    except ValueError as error:
        return Refused(f"a table: {error}")
    try:
        converted = value.tolist() if hasattr(type(value), "tolist") else _asarray(value).tolist()
    except (AttributeError, TypeError, ValueError, NotImplementedError):
        return value
    return value if converted is None or type(converted) is type(value) else as_python(converted)


def _in_order(value: Any) -> Any:
    """Return a table with the columns t, x and y in this order.

    A series, and a table of places without times, have one row for each player. If the labels of their rows are the
    numbers of the players, the rows are sorted by them. If rows and columns have the same labels, as those of a matrix
    of distances, the columns are sorted as the rows are.

    Raises:
        ValueError: if a column is in another unit than that of desim.
    """
    if hasattr(value, "data_vars"):
        raise ValueError("a dataset of xarray has several arrays: give one")
    if hasattr(value, "isel"):  # of xarray, whose last dimension may have labels
        labels = _labels(value, -1)
        orders = _orders_of_matrix(_labels(value, 0), labels) if len(value.dims) == 2 else None
        if orders is not None and len(labels) > 2:
            return value.isel(dict(zip(value.dims, orders, strict=True)))
        order = coordinate_columns(labels)
        if order is not None:
            value = value.isel({value.dims[-1]: order})
        elif orders is not None:
            return value.isel(dict(zip(value.dims, orders, strict=True)))
        rows = _by_player(_labels(value, 0)) if value.dims and (order is None or len(order) == 2) else None
        return value if rows is None else value.isel({value.dims[0]: rows})
    if hasattr(value, "struct") and getattr(value.dtype, "fields", None):  # a series of polars
        value = value.struct.unnest()
    value = _with_times(value)
    labels = _columns(value)
    rows = list(value.index) if hasattr(value, "iloc") and labels else []
    orders = _orders_of_matrix(rows, labels)
    if orders is not None and len(rows) > 2:  # also if its nodes have the names of coordinates
        return value.iloc[orders]
    if (order := coordinate_columns(labels)) is not None:
        names = [labels[k] for k in order]
        columns = value.select(names) if hasattr(value, "select") else value[names]
        return columns if len(order) > 2 else _by_number(columns)
    if orders is not None:
        return value.iloc[orders]
    return value if labels else _by_number(value)


def _with_times(value: Any) -> Any:
    """Return a table of pandas with its times, which may be its index, as numbers: s, or s after the earliest date."""
    if not hasattr(value, "reset_index") or not hasattr(value, "columns"):
        return value
    names = [name for name in value.columns if isinstance(name, str) and name.strip().lower() in COLUMNS["t"]]
    is_named = isinstance(value.index.name, str) and value.index.name.strip().lower() in COLUMNS["t"]
    if not names and (is_named or getattr(value.index.dtype, "kind", "") in {"M", "m"}):
        names, value = ["t"], value.rename_axis("t").reset_index()
    for name in names[:1]:
        if (kind := getattr(getattr(value[name], "dtype", None), "kind", "")) in {"M", "m"}:
            durations = value[name] - value[name].min() if kind == "M" else value[name]
            value = value.assign(**{name: durations.dt.total_seconds()})
    return value


def _columns(value: Any) -> list[Any]:
    """Return the labels of the columns of a table; an empty list if it has none.

    Raises:
        ValueError: if the table or a column has a unit.
    """
    attributes = getattr(value, "attrs", None)
    if isinstance(attributes, dict) and (unit := attributes.get("units") or attributes.get("unit")):
        raise ValueError(f"its attributes say that it is in {unit}: give numbers without a unit")
    if hasattr(value, "colnames"):  # of astropy
        units = {name: str(value[name].unit) for name in value.colnames if value[name].unit is not None}
        if units:
            raise ValueError(
                f"column {next(iter(units))!r} is in {next(iter(units.values()))}: give numbers without a unit"
            )
    names = getattr(getattr(value, "dtype", None), "names", None) or getattr(value, "column_names", None)  # of Arrow
    return list(getattr(value, "columns", ()) if names is None else names)


def _labels(value: Any, dimension: int) -> list[Any]:
    """Return the labels along a dimension of an array of xarray; an empty list if it has none."""
    coordinates, dims = getattr(value, "coords", {}), value.dims
    return coordinates[dims[dimension]].values.tolist() if dims and dims[dimension] in coordinates else []


def _by_number(value: Any) -> Any:
    """Return a series or a table of pandas in the order of its labels, if these number its rows.

    When pandas sorts or shuffles rows, each row keeps its label.
    """
    if not hasattr(value, "iloc") or not hasattr(value, "index"):
        return value
    order = _by_player(list(value.index))
    return value if order is None else value.iloc[order]


def _orders_of_matrix(rows: list[Any], columns: list[Any]) -> tuple[list[int], list[int]] | None:
    """Return the orders in which the rows and the columns of a matrix have the same labels, by the numbers of players.

    Return None if their labels differ, so that the table is no such matrix.
    """
    index = {label: k for k, label in enumerate(columns)}
    if not rows or not len(index) == len(columns) == len(rows) or index.keys() != set(rows):
        return None
    order = _by_player(rows) or list(range(len(rows)))
    return order, [index[rows[k]] for k in order]


def names_in_matrix(value: Any) -> tuple[str, ...]:
    """Return the names of the nodes in a square table, in the order of its rows; empty if they have none.

    In a table without labels of rows, as those of polars, the columns have the names. Integers are no names.

    Raises:
        ValueError: if the rows have other names than the columns.
    """
    if hasattr(value, "isel"):
        rows, columns = (_labels(value, k) for k in (0, -1)) if len(value.dims) == 2 else ([], [])
    else:
        rows, columns = list(value.index) if hasattr(value, "iloc") else [], _columns(value)
    are_numbered = not rows or rows == list(range(len(rows)))
    if not columns or not all(map(_is_name, columns if are_numbered else [*rows, *columns])):
        return ()
    if not are_numbered and {*rows} != {*columns}:
        shown = abridged(", ".join(rows)), abridged(", ".join(columns))
        raise ValueError("the rows and the columns should have the same names (got {} and {})".format(*shown))
    return tuple(columns if are_numbered else rows)


def check_times(value: Any, name: str) -> None:
    """Check the names of the columns of a table over time; a table without names is in the order t, x, y.

    Args:
        value: the table, or anything else that `as_python` converts.
        name: what it is called in the error.

    Raises:
        ValueError: if the columns have names that are not t, x and y, such as speed and direction.
    """
    try:
        if hasattr(value, "isel"):
            labels = _labels(value, -1)
        else:
            labels = _columns(_with_times(value)) if hasattr(value, "columns") or hasattr(value, "dtype") else []
        is_known = not all(map(_is_name, labels)) or len(coordinate_columns(labels) or ()) == 3
    except ValueError:
        return  # `as_python` refuses the table with the same words
    names = [str(label).lower() for label in labels]
    if names and not is_known and (names[0] not in COLUMNS["t"] or names[1:] != ["u", "v"]):
        raise ValueError(f"the columns of {name} should be t, x and y (got {abridged(', '.join(map(str, labels)))})")


def _is_name(label: Any) -> bool:
    """Return whether a label is the name of a node, and neither a number nor made by polars or numpy."""
    return isinstance(label, str) and not re.fullmatch(r"\d*|column_\d+|f\d+", label)


def _by_player(labels: list[Any]) -> list[int] | None:
    """Return the order of rows in which their labels are the numbers 0 .. n - 1, or 1 .. n.

    The labels may be texts, as in rows from JSON. Return None if they are not these numbers, or are in order already.
    """
    try:
        numbers = [int(label) for label in labels]
    except (TypeError, ValueError):
        return None
    if numbers != labels and list(map(str, numbers)) != labels:  # such as 0.5, or the time "01"
        return None
    first, count_of_rows = min(numbers, default=0), len(numbers)
    if first not in {0, 1} or sorted(numbers) != list(range(first, first + count_of_rows)):
        return None
    order = sorted(range(count_of_rows), key=numbers.__getitem__)
    return None if order == list(range(count_of_rows)) else order


def _asarray(value: Any) -> Any:
    import numpy as np

    return np.asarray(value)
