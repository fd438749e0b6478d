"""Tables of measurements over time, of all links together or of each link by itself.

A table (`desim.kernel.csv_tables`) has a row per measurement: a time, the sender and the receiver if links differ, and
a value.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from functools import lru_cache
from statistics import median
from typing import Any, Literal, NamedTuple

import numpy as np

from desim.config.arrays import Bools, Floats, Integers
from desim.config.model import MAX_TIME
from desim.kernel.csv_tables import KEPT, Columns, place_of, rows_of
from desim.kernel.units import SECOND

Unit = Literal["s", "ms", "us", "ns"]
PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
"""The number of each unit in a second."""
MAX_NODE = 2**31 - 1
NODE = "the number of a node, 0 or more"
MAX_DIGITS = 30
"""A number with more digits before its decimal point is no time."""


class Meaning(NamedTuple):
    """The meaning of the cells of a table."""

    noun: str
    """A value, with its article, for error messages."""
    low: float
    """Smallest value."""
    high: float
    """Largest value."""
    time_unit: Unit
    both_ways: bool
    """Whether a row also holds for the link from its receiver to its sender."""


@dataclass(frozen=True)
class Measurements:
    """The rows of a table by link and time: R rows of L links at T distinct times."""

    src: Integers
    """(L,) the senders; the links ascend by sender and receiver. Without links, there is one from 0 to 0."""
    dst: Integers
    """(L,) the receivers."""
    line: Integers
    """(L,) the line of the first row of each link."""
    first: Integers
    """(L + 1,) the index of the first row of each link; the last is R."""
    times: Integers
    """(T,) the distinct times, ns; the first is 0."""
    rank: Integers
    """(R,) the index in `times` of the time of each row."""
    values: Floats
    """(R,) the values; if one is missing, that of the row before of its link, and before the first row, of the last."""
    is_missing: Bools
    """(R,) whether the row has no value."""

    @property
    def end(self) -> int:
        """The end of the trace, ns: if all times are equal, 1 s.

        A link with n rows lasts from its first row to its last, and a mean interval more. The trace lasts as long as
        the median of its links, or, if that is longer, to its last time and a mean interval between times more.
        """
        last = int(self.times[-1])
        if not last:
            return SECOND
        count = np.diff(self.first)
        spans = self.times[self.rank[self.first[1:] - 1]] - self.times[self.rank[self.first[:-1]]]
        lasting = [span + span // (n - 1) for span, n in zip(spans.tolist(), count.tolist(), strict=True) if n > 1]
        return max(last + max(last // (len(self.times) - 1), 1), int(median(lasting or [0])))


class _Cells(NamedTuple):
    """The column of a table, or several."""

    table: str
    """The name of the table."""
    lines: list[int]
    """The line of each row."""
    columns: dict[str, Sequence[str]]
    """The cells of each column, without the header."""

    def numbers(self, column: str, convert: Callable[[str], Any], what: str = "a number") -> list[Any]:
        """Return the converted cells of a column; raise ValueError, with the line, at a cell that is not `what`."""
        cells = self.columns[column]
        try:
            return list(map(convert, cells))
        except (ValueError, InvalidOperation):
            row = next(row for row, cell in enumerate(cells) if not _converts(convert, cell))
            raise self.error(row, f"{column} should be {what} (got {cells[row]!r})") from None

    def place(self, row: int) -> str:
        """Return the place of a row in the file."""
        return place_of(self.lines[row], self.table)

    def error(self, row: int, text: str) -> ValueError:
        """Return an error about a row."""
        return ValueError(f"{self.table}, {self.place(row)}: {text}")


def _converts(convert: Callable[[str], Any], cell: str) -> bool:
    try:
        convert(cell)
    except (ValueError, InvalidOperation):
        return False
    return True


@lru_cache(maxsize=KEPT)
def measurements_of(table: str, columns: Columns, meaning: Meaning, name: str) -> Measurements:
    """Return the measurements in a table, the text of which is made by `select`.

    Raises:
        ValueError: if the table has no rows, a cell is invalid, the times of a link do not increase, or both directions
            of a link have rows although a row holds for both.
    """
    lines, flat, names = list[int](), list[str](), columns.used()
    for line, row_cells in rows_of(table, name):  # without keeping a list per row, which takes twice as long
        lines.append(line)
        flat += row_cells
    if len(lines) < 2:
        raise ValueError(f"{name} has no rows")
    width = len(names)
    cells = _Cells(name, lines[1:], {each: flat[width + k :: width] for k, each in enumerate(names)})
    times, values = _times(cells, columns.time, meaning.time_unit), _values(cells, columns.value, meaning)
    src, dst = _links(cells, columns, both_ways=meaning.both_ways)
    row = np.tile(np.arange(len(times)), len(src) // len(times))
    order = np.lexsort((row, dst, src))  # by link, and then as in the table
    src, dst, row = src[order], dst[order], row[order]
    is_first = np.concatenate(([True], (np.diff(src) != 0) | (np.diff(dst) != 0)))
    is_late = ~is_first[1:] & (np.diff(times[row]) <= 0)
    if is_late.any():
        late = int(row[1:][is_late].min())
        before = cells.place(int(row[:-1][is_late & (row[1:] == late)][0]))
        raise cells.error(late, f"{columns.time} should increase; it is not later than in {before}, of the same link")
    distinct, rank = np.unique(times, return_inverse=True)
    first = np.append(np.flatnonzero(is_first), len(row))
    lines = np.array(cells.lines)[row[first[:-1]]]
    filled, is_missing = _filled(values[row], first)
    return Measurements(src[is_first], dst[is_first], lines, first, distinct, rank[row], filled, is_missing)


def _times(cells: _Cells, column: str, unit: Unit) -> Integers:
    """Return the (R,) times after the earliest, ns; they are exact, also for times since 1970."""
    times = cells.numbers(column, Decimal)
    for row, time in enumerate(times):
        if not time.is_finite() or time.adjusted() > MAX_DIGITS:
            raise cells.error(row, f"{column} should be a number (got {cells.columns[column][row]!r})")
    start, limit = min(times), MAX_TIME * PER_SECOND[unit]
    if (most := max(times)) - start > limit:
        raise cells.error(times.index(most), f"{column} should be at most {MAX_TIME:g} s after the earliest time")
    scale = SECOND // PER_SECOND[unit]
    return np.array([round((time - start) * scale) for time in times], dtype=np.int64)


def _values(cells: _Cells, column: str, meaning: Meaning) -> Floats:
    """Return the (R,) values, nan where a cell is empty or nan."""
    values = np.array(cells.numbers(column, _number_or_nan))
    is_wrong = (values < meaning.low) | (values > meaning.high)
    if is_wrong.any():
        row = int(is_wrong.argmax())
        bound = f"at least {meaning.low:g}" if values[row] < meaning.low else f"at most {meaning.high:g}"
        raise cells.error(row, f"{meaning.noun} should be {bound} (got {cells.columns[column][row]})")
    return values


def _number_or_nan(cell: str) -> float:
    return float(cell or "nan")


def _links(cells: _Cells, columns: Columns, *, both_ways: bool) -> tuple[Integers, Integers]:
    """Return the (R,) senders and receivers of the rows; if they hold both ways, followed by those of the way back."""
    if columns.src is None or columns.dst is None:
        return np.zeros(len(cells.lines), dtype=np.int64), np.zeros(len(cells.lines), dtype=np.int64)
    src, dst = _nodes(cells, columns.src), _nodes(cells, columns.dst)
    if (src == dst).any():
        row = int((src == dst).argmax())
        raise cells.error(row, f"a link should join two nodes (got {src[row]} and {dst[row]})")
    if not both_ways:
        return src, dst
    seen = dict(zip(zip(src.tolist(), dst.tolist(), strict=True), range(len(src)), strict=True))
    for one, other in seen:
        if (other, one) in seen:
            row = max(seen[one, other], seen[other, one])
            raise cells.error(row, f"with both_ways, only one direction should have rows; {one} and {other} have both")
    return np.concatenate((src, dst)), np.concatenate((dst, src))


def _nodes(cells: _Cells, column: str) -> Integers:
    """Return the (R,) nodes in a column."""
    nodes = cells.numbers(column, int, NODE)
    if min(nodes) < 0 or max(nodes) > MAX_NODE:
        row = next(row for row, node in enumerate(nodes) if not 0 <= node <= MAX_NODE)
        raise cells.error(row, f"{column} should be {NODE} (got {cells.columns[column][row]!r})")
    return np.array(nodes, dtype=np.int64)


def _filled(values: Floats, first: Integers) -> tuple[Floats, Bools]:
    """Return the (R,) values with the missing ones filled in, and which were missing; see `Measurements.values`."""
    is_missing, rows = np.isnan(values), np.arange(len(values))
    start, counts = first[:-1], np.diff(first)
    last_known = np.maximum.accumulate(np.where(is_missing, -1, rows))
    of_last_row = np.repeat(last_known[first[1:] - 1], counts)
    source = np.where(last_known < np.repeat(start, counts), of_last_row, last_known)
    has_any = source >= np.repeat(start, counts)
    return np.where(has_any, values[source], 0.0), is_missing
