"""Tables of measurements over time, of all links together or of each link by itself.

A table (`desim.kernel.measured.csv_tables`) has a row per measurement: a time, the sender and the receiver if links
differ, and a value.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from decimal import Decimal, InvalidOperation
from functools import lru_cache, partial
from itertools import chain
from math import isfinite, nan
from pathlib import Path
from statistics import median
from typing import Literal, NamedTuple, cast

import numpy as np

from desim.config.arrays import Bools, Floats, Integers
from desim.config.model import MAX_TIME
from desim.config.number_files import hint_of, integer_of, is_plain, not_a_number, number_of
from desim.kernel.core.units import SECOND
from desim.kernel.measured.csv_tables import CACHED_TABLES, Cells, cells_of, csv_text, select

Unit = Literal["s", "ms", "us", "ns"]
PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
"""The number of each unit in a second."""
MISSING = frozenset({"", "-", "--", "*", "na", "n/a", "#n/a", "null", "none"})
"""The cells, in lower case, that stand for a missing value, besides nan."""
MAX_NODE = 2**31 - 1
LIKE_NUMBER = re.compile(r"[+-]?[\d_,' ]*\.?[\d_,' ]*(?:e[+-]?\d+)?|[+-]?(?:nan|inf)", re.IGNORECASE)
"""Matches a number, also in a wrong form, and an empty cell."""
NODE = "the number of a node, 0 or more"
"""What a cell of a sender or receiver should be, for error messages."""
LAST_TIME = Decimal(10**8)
"""Time, s, from which on a number does not count from the start of a simulation: three years."""
FIRST_CLOCK = Decimal(10**9)
"""Time, s, from which on a number counts from 1970: the year 2001."""
LAST_CLOCK = Decimal(5 * 10**9)
"""Time, s, above which a number is in a smaller unit: since 1970, it would be after the year 2128."""
DATE = re.compile(
    r"(\d{4})[-/.](\d\d)[-/.](\d\d)(?:[T _](\d\d)[:.](\d\d)(?:[:.](\d\d)(?:[.,](\d+))?)?"
    r" ?(?:(Z|UTC)|([+-]\d\d):?(\d\d)?)?)?",
    re.ASCII | re.IGNORECASE,
)
DATE_FORM = "2024-05-17T12:30:00.25Z"
COMPACT_DATE = re.compile(r"(?:19|20)\d\d(?:0[1-9]|1[0-2])(?:0[1-9]|[12]\d|3[01])", re.ASCII)
"""Matches a date that is written as one number."""
COMPACT_TIME = re.compile(
    r"((?:19|20)\d\d)(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])([01]\d|2[0-3])([0-5]\d)([0-5]\d)?", re.ASCII
)
"""Matches a date with a time of day that is written as one number."""
YEAR_1, YEAR_1970 = datetime(1, 1, 1), datetime(1970, 1, 1)


class DateTime(Decimal):
    """A time, s, that was written as a date."""


class Columns(NamedTuple):
    """The names of the columns of a table."""

    time: str
    src: str | None
    """The sender. None: the measurements hold for all links, and `dst` is None, too."""
    dst: str | None
    value: str

    def used(self) -> tuple[str, ...]:
        """Return the names of the columns that the table has."""
        return tuple(name for name in self if name is not None)


class Meaning(NamedTuple):
    """The meaning of the cells of a table."""

    noun: str
    """A value, with its article, for error messages."""
    low: float
    """Smallest value that is allowed."""
    high: float
    """Largest value that is allowed."""
    time_unit: Unit
    both_ways: bool
    """Whether a row also holds for the link from its receiver to its sender."""
    nodes: tuple[str, ...] | None = None
    """The names of the nodes in the cells, in the order of their numbers; None: see `Measurements.names`."""


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
    """(R,) the values. A missing value is replaced by the value before it on its link. Before the first value, it is
    replaced by the last value of the link; on a link without values, by 0."""
    is_missing: Bools
    """(R,) whether the row has no value."""
    names: tuple[str, ...] | None = None
    """The names of the nodes in the order of their numbers, if the cells have names and no order was given. The order
    is then that of the rows, in each row the sender first."""

    @property
    def end(self) -> int:
        """The end of the trace, ns: if all times are equal, 1 s.

        A link with n rows lasts from its first row to its last plus a mean interval between rows. The trace lasts as
        long as the median of its links, but at least to its last time plus a mean interval between times.
        """
        last = int(self.times[-1])
        if not last:
            return SECOND
        counts = np.diff(self.first)
        spans = self.times[self.rank[self.first[1:] - 1]] - self.times[self.rank[self.first[:-1]]]
        durations = [span + span // (n - 1) for span, n in zip(spans.tolist(), counts.tolist(), strict=True) if n > 1]
        return max(last + max(last // (len(self.times) - 1), 1), int(median(durations or [0])))


def time_of(text: str, unit: Unit = "s") -> Decimal:
    """Return the exact time, s, in a text: a number in a unit, or a date as in ISO 8601.

    A date with a time zone counts from 1970 (UTC), as most clocks do. A date without one counts from the year 1, so
    that a mixture of both, or of dates and numbers, spans thousands of years, and is refused.

    Raises:
        ValueError: if the text is neither a number nor a date, or the number is beyond `LAST_CLOCK`, or probably a
            date.
    """
    try:
        number = Decimal(text)
        seconds = number if unit == "s" else number / PER_SECOND[unit]
        is_late = not -LAST_CLOCK <= seconds <= LAST_CLOCK  # with nan, this is an invalid operation
    except InvalidOperation:
        return _seconds_of_date(text.strip())
    if not is_plain(text):
        raise not_a_number(text)
    # Shorter times may have as many digits: 200 s in ns have 12.
    if abs(seconds) >= LAST_TIME and (match := COMPACT_TIME.fullmatch(text)):
        year, month, day, hour, minute, second = match.groups()
        date = f"{year}-{month}-{day}T{hour}:{minute}:{second or '00'}"
        raise ValueError(f"{text!r} is probably a date: write {date} instead")
    if is_late:
        raise ValueError(f"{text!r} is too great for a time in {unit}; numbers since 1970 may be in ms, us or ns")
    return seconds


def clock_unit(text: str) -> Unit:
    """Return the unit of a number that counts from 1970, which follows from its size; s for any other text.

    A number is a time between the years 2001 and 2128 in at most one of the units.
    """
    try:
        number = number_of(text)
    except ValueError:
        return "s"
    units = (unit for unit, count in PER_SECOND.items() if FIRST_CLOCK <= number / count <= LAST_CLOCK)
    return cast("Unit", next(units, "s"))


def _seconds_of_date(text: str) -> Decimal:
    match = DATE.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is neither a number nor a date such as {DATE_FORM}{hint_of(text)}")
    *parts, fraction, utc, hours, minutes = match.groups()
    try:
        date = datetime(*(int(part or 0) for part in parts))  # type: ignore[arg-type]
    except ValueError as error:
        raise ValueError(f"{text!r} is not a date: {error}") from error
    utc_offset = timedelta(hours=int(hours or 0), minutes=int(f"{(hours or '+')[0]}{minutes or 0}"))
    elapsed = date - (YEAR_1970 if utc or hours else YEAR_1) - utc_offset
    return DateTime(Decimal(elapsed // timedelta(seconds=1)) + Decimal(f"0.{fraction or 0}"))


def start_of(times: Iterable[Decimal], file: Path | str) -> Decimal:
    """Return the time (s) that is the start of the simulation: the earliest, if the times count from a date, else 0.

    Apply it to all times of a file, so that its nodes keep their common clock: `float(time - start)` is then the time
    of the simulation.

    Raises:
        ValueError: if the times are probably not in s; the message names the file.
    """
    times = list(times)
    earliest = min(times, default=Decimal(0))
    if reason := _why_no_seconds(times, earliest):
        raise ValueError(f"{file}: {reason}")
    return earliest if isinstance(earliest, DateTime) or earliest >= FIRST_CLOCK else Decimal(0)


def _why_no_seconds(times: Sequence[Decimal], earliest: Decimal) -> str | None:
    """Return why numbers are probably not times in s; None if they may be."""
    if isinstance(earliest, DateTime):
        return None
    if LAST_TIME <= earliest < FIRST_CLOCK:
        return (
            f"the times begin at {earliest:g} s, which is too late for a simulation and, as a date, before 2001: they"
            " are probably in ms, us or ns"
        )
    if all(COMPACT_DATE.fullmatch(str(time)) for time in times) and times:
        text = str(earliest)
        return f"the times are probably dates: write {text[:4]}-{text[4:6]}-{text[6:]} instead of {text}"
    return None


def timed_rows(file: Path, columns: Sequence[str], unit: Unit = "s") -> tuple[list[tuple[float, ...]], list[str]]:
    """Return the rows of a table of numbers over time in a CSV or Parquet file, and the place of each.

    Args:
        file: the file.
        columns: the names of the columns; the first is that of the times.
        unit: the unit of the times.

    Returns:
        Rows that begin with the time (s) of the simulation, see `start_of`, and places, for error messages.

    Raises:
        ValueError: if the file cannot be read, lacks a column, or has a cell that is not a finite number.
    """
    names, time = tuple(columns), columns[0]
    units = ("m", "s") if unit == "s" else ("m",)  # comments may explain another unit of the times
    cells = cells_of(select(csv_text(file, names, units=units), names, str(file)), str(file))
    times = cells.numbers(time, partial(time_of, unit=unit))
    start = start_of(times, f"{file}, column {time}")
    numbers = [cells.numbers(name, _finite) for name in names[1:]]
    for row, seconds in enumerate(times):
        if not 0 <= seconds - start <= MAX_TIME:
            where = f"from 0 to {MAX_TIME:g} s, or at most {MAX_TIME:g} s after a date"
            raise cells.error(row, f"{time} should be {where} (got {cells.columns[time][row]})")
    rows = [*zip((float(seconds - start) for seconds in times), *numbers, strict=True)]
    return rows, [f"{file}, {cells.place(row)}" for row in range(len(rows))]


def _finite(cell: str) -> float:
    number = number_of(cell)
    if not isfinite(number):
        raise ValueError(f"{cell!r} is not a finite number")
    return number


@lru_cache(maxsize=CACHED_TABLES)
def measurements_of(table: str, columns: Columns, meaning: Meaning, name: str) -> Measurements:
    """Return the measurements in a table, a text that `select` returned.

    Raises:
        ValueError: if the table has no rows, a cell is invalid, the times of a link do not increase, or both directions
            of a link have rows although a row holds for both.
    """
    cells = cells_of(table, name)
    times, values = _times(cells, columns.time, meaning.time_unit), _values(cells, columns.value, meaning)
    names = _names(cells, columns) if meaning.nodes is None else None
    src, dst = _links(cells, columns, names or meaning.nodes, both_ways=meaning.both_ways)
    row = np.tile(np.arange(len(times)), len(src) // len(times))  # twice if `_links` adds the opposite links
    order = np.lexsort((row, dst, src))  # by link, and then as in the table
    src, dst, row = src[order], dst[order], row[order]
    is_first = np.concatenate(([True], (np.diff(src) != 0) | (np.diff(dst) != 0)))
    is_late = ~is_first[1:] & (np.diff(times[row]) <= 0)
    if is_late.any():
        # The error names the first such row in the order of the file, not of the links, for a reader of the file.
        late_row = int(row[1:][is_late].min())
        row_before = cells.place(int(row[:-1][is_late & (row[1:] == late_row)][0]))
        hint = "" if columns.src else "; if the rows are of several links, src and dst should name their columns"
        reason = f"{columns.time} should increase; it is not later than in {row_before}, of the same link{hint}"
        raise cells.error(late_row, reason)
    distinct_times, rank = np.unique(times, return_inverse=True)
    first = np.append(np.flatnonzero(is_first), len(row))
    lines = np.array(cells.lines)[row[first[:-1]]]
    filled, is_missing = _filled(values[row], first)
    links = src[is_first], dst[is_first]
    return Measurements(*links, lines, first, distinct_times, rank[row], filled, is_missing, names)


def _times(cells: Cells, column: str, unit: Unit) -> Integers:
    """Return the (R,) times after the earliest, ns; they are exact, also for times since 1970."""
    times = cells.numbers(column, partial(time_of, unit=unit))
    start = min(times)
    if reason := _why_no_seconds(times, start):
        hint = " (time_unit)" if "probably in" in reason else ""
        raise cells.error(times.index(start), f"{column}: {reason}{hint}")
    if (end := max(times)) - start > MAX_TIME:
        reason = f"{column} should be at most {MAX_TIME:g} s after the earliest time"
        raise cells.error(times.index(end), reason + hint_of_zones(cells.columns[column]))
    return np.array([round((time - start) * SECOND) for time in times], dtype=np.int64)


def hint_of_zones(texts: Iterable[str]) -> str:
    """Return what may be wrong with times that are too late: dates with and without a zone; "" if none is a date."""
    return "; dates should all have a time zone, or none" if any(DATE.fullmatch(text.strip()) for text in texts) else ""


def _values(cells: Cells, column: str, meaning: Meaning) -> Floats:
    """Return the (R,) values, nan where a cell is empty or nan."""
    is_probability = (meaning.low, meaning.high) == (0.0, 1.0)
    read = _probability_or_nan if is_probability else number_or_nan
    values = np.array(cells.numbers(column, read, _float_or_nan))
    is_wrong = (values < meaning.low) | (values > meaning.high)
    if is_wrong.any():
        row = int(is_wrong.argmax())
        bound = f"at least {meaning.low:g}" if values[row] < meaning.low else f"at most {meaning.high:g}"
        got = f"got {cells.columns[column][row]}"
        raise cells.error(row, f"{meaning.noun} should be {bound} ({got}); if it is missing, leave its cell empty")
    return values


def _probability_or_nan(cell: str) -> float:
    """Return the probability in a cell, see `number_or_nan`; a truth value, as pandas writes it, is 0 or 1."""
    truth = {"true": 1.0, "false": 0.0}.get(cell.strip().lower())
    return number_or_nan(cell) if truth is None else truth


def _float_or_nan(cell: str) -> float:
    return float(cell or "nan")


def number_or_nan(cell: str) -> float:
    """Return the number in a cell; nan if the cell is empty or one of `MISSING`."""
    try:
        return number_of(cell or "nan")
    except ValueError:
        if cell.strip().lower() in MISSING:
            return nan
        raise


def _links(
    cells: Cells, columns: Columns, names: tuple[str, ...] | None, *, both_ways: bool
) -> tuple[Integers, Integers]:
    """Return the (R,) senders and receivers of the rows; with `both_ways`, those of the opposite links follow."""
    if columns.src is None or columns.dst is None:
        return np.zeros(len(cells.lines), dtype=np.int64), np.zeros(len(cells.lines), dtype=np.int64)
    src, dst = (_nodes(cells, column, names) for column in (columns.src, columns.dst))
    if (src == dst).any():
        row = int((src == dst).argmax())
        node, other = (cells.columns[column][row].strip() for column in (columns.src, columns.dst))
        raise cells.error(row, f"a link should join two nodes (got {node} and {other})")
    if not both_ways:
        return src, dst
    last_rows = dict(zip(zip(src.tolist(), dst.tolist(), strict=True), range(len(src)), strict=True))
    for node, other in last_rows:
        if (other, node) in last_rows:
            row = max(last_rows[node, other], last_rows[other, node])
            raise cells.error(row, f"with both_ways, only one direction should have rows; {node} and {other} have both")
    return np.concatenate((src, dst)), np.concatenate((dst, src))


def _nodes(cells: Cells, column: str, names: tuple[str, ...] | None) -> Integers:
    """Return the (R,) nodes in a column of numbers or names."""
    if names is not None:
        numbers = {name: number for number, name in enumerate(names)}

        def node_of(cell: str) -> int:
            if (node := numbers.get(cell.strip())) is None:
                raise ValueError(f"{cell!r} is not in nodes")
            return node

        return np.array(cells.numbers(column, node_of), dtype=np.int64)
    nodes = cells.numbers(column, _node_of, int)
    if min(nodes) < 0 or max(nodes) > MAX_NODE:
        row = next(row for row, node in enumerate(nodes) if not 0 <= node <= MAX_NODE)
        raise cells.error(row, f"{column} should be {NODE} (got {cells.columns[column][row]!r})")
    return np.array(nodes, dtype=np.int64)


def _node_of(cell: str) -> int:
    try:
        return integer_of(cell)
    except ValueError as error:
        raise ValueError(f"{error}; give the names of nodes in `nodes`, where some look like numbers") from error


def _names(cells: Cells, columns: Columns) -> tuple[str, ...] | None:
    """Return the names of the nodes in a table; None if a cell is a number, or looks like one."""
    if columns.src is None or columns.dst is None:
        return None
    src, dst = cells.columns[columns.src], cells.columns[columns.dst]
    if LIKE_NUMBER.fullmatch(src[0].strip()) or LIKE_NUMBER.fullmatch(dst[0].strip()):
        return None
    names = tuple(
        dict.fromkeys(cell.strip() for cell in dict.fromkeys(chain.from_iterable(zip(src, dst, strict=True))))
    )
    return None if any(map(LIKE_NUMBER.fullmatch, names)) else names


def _filled(values: Floats, first: Integers) -> tuple[Floats, Bools]:
    """Return the (R,) values with the missing ones filled in, and which were missing; see `Measurements.values`."""
    is_missing, rows = np.isnan(values), np.arange(len(values))
    start, counts = first[:-1], np.diff(first)
    # One running maximum serves all links. Before the first value of a link, the maximum is a row of an earlier link,
    # less than `start`, and is replaced by the row of the last value of the link.
    last_known = np.maximum.accumulate(np.where(is_missing, -1, rows))
    of_last_row = np.repeat(last_known[first[1:] - 1], counts)
    source = np.where(last_known < np.repeat(start, counts), of_last_row, last_known)
    has_any = source >= np.repeat(start, counts)
    return np.where(has_any, values[source], 0.0), is_missing
