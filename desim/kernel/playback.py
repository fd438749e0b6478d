"""The replay of measurements of links: the base of the models that follow a table, and its playback in one run.

A message that is sent at time t has the value of the measurement at time t + `start`.
"""

from bisect import bisect_right
from collections.abc import Collection, Iterable, Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, ValidationInfo, model_validator

from desim.config.arrays import Bools, Floats, Integers
from desim.config.model import Flag, Time, Value
from desim.config.trust import resolve_path
from desim.kernel.link_context import LinkContext
from desim.kernel.measurements import (
    MAX_NODE,
    SECOND,
    Columns,
    Meaning,
    Measurements,
    Unit,
    header_of,
    measurements_of,
    place_of,
    select,
    text_of,
)
from desim.kernel.seeds import stream

if TYPE_CHECKING:
    from numpy.typing import NDArray

Name = Annotated[str, Field(min_length=1)]
TABLE = "the table"
"""The name of a table that was not read from a file, in error messages."""


class TraceEndError(ValueError):
    """Raised when a message is sent after the end of a trace with after = "error"."""


def _form_of_start(value: Any) -> str:
    return "text" if isinstance(value, str) else "number"


class LinkTrace(Value):
    """Base of the models that follow measurements: the table, its columns, and how it is replayed."""

    NOUN: ClassVar[str] = "a value"
    """A value of the table, for error messages."""

    kind: str = "trace"
    file: str | None = None
    """Path of a CSV file with a header, or of a Parquet file (*.parquet), relative to the scenario file. The file is
    read once, when the model is created; `table` then has its columns in use."""
    time: Name = "t"
    """Column of the times; the earliest is time 0 of the simulation."""
    time_unit: Unit = "s"
    """Unit of the times: s, ms, us or ns."""
    src: Name | None = "src"
    """Column of the senders. Without this column and that of the receivers, the measurements hold for all links."""
    dst: Name | None = "dst"
    """Column of the receivers."""
    value: Name = "value"
    """Column of the values. A message that is sent while the value is missing (empty or nan) is lost."""
    both_ways: Flag = False
    """Whether a row also holds for the link from its receiver to its sender."""
    between: Literal["hold", "linear"] = "hold"
    """The value between two measurements: hold, that of the earlier one; linear, interpolated."""
    after: Literal["repeat", "hold", "error"] = "repeat"
    """What follows the last measurement. repeat: the first one, so that the trace is periodic; hold: its value; error:
    a message that is sent then ends the run with an error."""
    start: Annotated[
        Annotated[Time, Tag("number")] | Annotated[Literal["random"], Tag("text")], Discriminator(_form_of_start)
    ] = 0.0
    """Time in the trace at which the simulation starts, s; "random": drawn once per seed for all links, which requires
    after = "repeat"."""
    table: str | None = None
    """Instead of a file: its content as CSV text."""
    read_from: Name | None = None
    """Name of the file that the table was read from, for error messages."""

    @model_validator(mode="before")
    @classmethod
    def _read(cls, given: Any, info: ValidationInfo) -> Any:
        """Replace a file by the table in it, and reduce the table to the columns in use."""
        if not isinstance(given, dict) or not _has_table(cls, given):
            return given
        names = Columns(*(given.get(key, cls.model_fields[key].default) for key in Columns._fields))
        text, read_from = given.get("table"), given.get("read_from")
        if given.get("file") is not None:
            if text is not None:
                raise ValueError("should have a file or a table, not both")
            path = resolve_path(given["file"], info)
            text, read_from = text_of(path, names), path.name
        name = read_from or TABLE
        columns = _columns_in(header_of(str(text), name), names, given, name)
        read = {"table": select(str(text), columns, name), "src": columns.src, "dst": columns.dst}
        rest = {key: value for key, value in given.items() if key not in {"file", "read_from"}}
        return rest | read | ({"read_from": read_from} if read_from else {})

    @model_validator(mode="after")
    def _is_valid(self) -> Self:
        if self.table is None:
            raise ValueError("should have a file, or a table")
        end = self.measurements.end / SECOND
        if self.start == "random" and self.after != "repeat":
            raise ValueError(f'start = "random" requires after = "repeat" (got {self.after!r})')
        if self.after == "error" and self.start != "random" and self.start >= end:
            raise ValueError(f"start should be before the end of the trace at {end:g} s (got {self.start:g})")
        return self

    def given(self) -> dict[str, Any]:
        """Return the fields that differ from their defaults, see `Value.given`; only the length of the table."""
        rows = len(self.measurements.values) // (2 if self.both_ways else 1)
        return super().given() | {"table": f"{rows} rows"}

    @property
    def name(self) -> str:
        """The name of the table, for error messages."""
        return self.read_from or TABLE

    @property
    def limits(self) -> tuple[float, float]:
        """The smallest and the largest value in the table."""
        raise NotImplementedError

    @property
    def measurements(self) -> Measurements:
        """The measurements.

        Raises:
            ValueError: if the table is not valid.
        """
        columns = Columns(self.time, self.src, self.dst, self.value)
        meaning = Meaning(self.NOUN, *self.limits, self.time_unit, self.both_ways)
        return measurements_of(self.table or "", columns, meaning, self.name)

    @property
    def span(self) -> float:
        """The time from the start of the simulation to the end of the trace, or the period of a repeated trace, s."""
        end = self.measurements.end / SECOND
        return end if self.start == "random" or self.after == "repeat" else max(end - self.start, 0.0)

    def scaled(self, values: Floats) -> Floats:
        """Return values of the table in the unit of the model."""
        return values

    def check_links(self, size: int, links: Iterable[tuple[int, int]]) -> None:
        """Check that the table has a row for each of some links (sender, receiver) of a network of `size` nodes.

        Raises:
            ValueError: if a link has no row, or a row is about a node that does not exist.
        """
        if self.src is None:
            return
        measured = self.measurements
        nodes = np.maximum(measured.src, measured.dst)
        if nodes.max() >= size:
            link = int((nodes >= size).argmax())
            where = f"{self.name}, {place_of(int(measured.line[link]), self.name)}"
            raise ValueError(f"{where}: there is no node {nodes[link]}: the nodes are 0 .. {size - 1}")
        known = set(zip(measured.src.tolist(), measured.dst.tolist(), strict=True))
        for src, dst in links:
            if (src, dst) not in known:
                hint = "; with both_ways = true, a row also holds for the way back" if (dst, src) in known else ""
                raise ValueError(f"{self.name} has no row for the link from {src} to {dst}{hint}")


def _has_table(model: type[LinkTrace], given: dict[str, Any]) -> bool:
    """Return whether the arguments of a model name a table and its columns; a wrong type is left to the validation."""
    texts = [given.get("table"), given.get("read_from"), given.get("src"), given.get("dst")]
    texts += [given.get(key, model.model_fields[key].default) for key in ("time", "value")]
    has_texts = all(each is None or isinstance(each, str) for each in texts) and None not in texts[-2:]
    return has_texts and (given.get("file") is not None or given.get("table") is not None)


def _columns_in(header: Collection[str], names: Columns, given: Collection[str], table: str) -> Columns:
    """Return the columns that a table has; those of senders and receivers may be absent unless they are given."""
    ends = {key: getattr(names, key) for key in ("src", "dst")}
    used = [key for key, name in ends.items() if name is not None and (key in given or name in header)]
    if not used:
        return names._replace(src=None, dst=None)
    if len(used) == 2:
        return names
    raise ValueError(f"src and dst should both be columns of {table}, or neither; its columns are {', '.join(header)}")


class Playback:
    """A trace in one run.

    Its rows are those of the table and two more for each link, at time 0 and at the end of the trace. So every message
    is sent between two rows of its link. With T distinct times in the table, the key of a row is the number of its link
    times T + 1, plus the rank of its time. So one binary search finds the rows of all receivers.

    Args:
        trace: the trace.

    Attributes:
        loses: whether some value is missing.
    """

    def __init__(self, trace: LinkTrace):
        measured, repeats = trace.measurements, trace.after == "repeat"
        self._trace, self._end, self._times = trace, measured.end, measured.times.tolist()
        self._width = len(self._times) + 1
        self._codes = None if trace.src is None else _code(measured.src, measured.dst)
        self._is_linear = trace.between == "linear"
        self._last: tuple[tuple[int, float, int], NDArray[np.intp], tuple[int, Any]] | None = None
        """Seed, time and sender of the last transmission, its receivers, and the answer of `_rows`."""
        self._starts: dict[int, int] = {}
        """By seed, the time in the trace at which the simulation starts, ns."""
        self._kept: dict[int, tuple[NDArray[np.intp], Integers]] = {}
        """By sender, receivers that do not change, and the keys of the links to them."""
        first, last = measured.first[:-1], measured.first[1:] - 1
        links, counts = np.arange(len(first)), last - first + 1
        values, is_missing = trace.scaled(measured.values), measured.is_missing
        at_zero = last if repeats else first
        begin = values[at_zero]
        if repeats and self._is_linear:  # from the last row, through the end of the trace, to the first row
            wait = measured.times[measured.rank[first]]
            gap = self._end - measured.times[measured.rank[last]] + wait
            begin = begin + (values[first] - begin) * ((gap - wait) / gap)
        finish = begin if repeats else values[last]
        keys = [links * self._width, np.repeat(links, counts) * self._width + measured.rank]
        keys += [(links + 1) * self._width - 1]
        order = np.argsort(np.concatenate(keys), kind="stable")
        self._keys = np.concatenate(keys)[order]
        self._values = np.concatenate((begin, values, finish))[order]
        self._is_missing = np.concatenate((is_missing[at_zero], is_missing, is_missing[last]))[order]
        self._row_times = np.append(measured.times, self._end)[self._keys % self._width]
        self.loses = bool(is_missing.any())

    def lines(self) -> Iterator[tuple[Floats, Floats, Bools]]:
        """Yield for each link the times of its rows, s, their values and whether these are missing; see `Playback`.

        The row at time 0 is left out if the table has one.
        """
        ends = np.flatnonzero(self._keys % self._width == self._width - 1) + 1
        for begin, end in pairwise([0, *ends.tolist()]):
            has_first = self._row_times[begin + 1] == 0
            rows = slice(begin + 1 if has_first else begin, end)
            yield self._row_times[rows] / SECOND, self._values[rows], self._is_missing[rows]

    def mean(self) -> float:
        """Return the mean of the values over time and links, without the times at which they are missing."""
        weights = np.where(self._is_missing[:-1], 0, np.diff(self._row_times)).clip(min=0)
        values = self._values[:-1]
        if self._is_linear:
            values = (values + self._values[1:]) / 2
        total = int(weights.sum())
        return float((weights * values).sum()) / total if total else 0.0

    def values(self, context: LinkContext) -> Any:
        """Return the values at the time of a transmission: (k,) of them, one per receiver, or one for all.

        Raises:
            TraceEndError: if the trace has ended, with after = "error".
            ValueError: if a link has no row.
        """
        time, rows = self._rows(context)
        values = self._values[rows]
        if not self._is_linear:
            return values
        begin = self._row_times[rows]
        return values + (time - begin) / (self._row_times[rows + 1] - begin) * (self._values[rows + 1] - values)

    def is_missing(self, context: LinkContext) -> Any:
        """Return whether the values at the time of a transmission are missing; see `values`."""
        return self._is_missing[self._rows(context)[1]]

    def _rows(self, context: LinkContext) -> tuple[int, Any]:
        """Return the time of a transmission in the trace, ns, and the last row of each link up to then.

        The answer is kept, because a network asks for losses and latencies of the same transmission.
        """
        asked, dst = (context.seed, context.now, context.src), context.dst
        if self._last is not None and asked == self._last[0] and dst is self._last[1]:
            return self._last[2]
        time = self._time(context)
        rows = self._keys.searchsorted(self._link_keys(context) + bisect_right(self._times, time)) - 1
        if not dst.flags.writeable:
            self._last = asked, dst, (time, rows)
        return time, rows

    def _time(self, context: LinkContext) -> int:
        """Return the time of a transmission in the trace, ns."""
        time = round(context.now * SECOND) + self._start(context.seed)
        if time < self._end:
            return time
        if self._trace.after == "error":
            raise TraceEndError(
                f"{self._trace.name} ends at {self._end / SECOND:g} s, but a message on the link from {context.src} to"
                f" {context.dst[0]} is sent at {context.now:g} s, at {time / SECOND:g} s of the trace"
            )
        return time % self._end if self._trace.after == "repeat" else self._end

    def _start(self, seed: int) -> int:
        start = self._starts.get(seed)
        if start is None:
            given = self._trace.start
            drawn = given if given != "random" else stream(seed, "start of traces").random() * self._end / SECOND
            start = self._starts[seed] = round(drawn * SECOND)
        return start

    def _link_keys(self, context: LinkContext) -> Any:
        """Return the key of the first row of each link, (k,); 0 if the rows hold for all links."""
        if self._codes is None:
            return 0
        src, dst = context.src, context.dst
        kept = self._kept.get(src)
        if kept is not None and kept[0] is dst:
            return kept[1]
        codes = _code(src, dst)
        links = self._codes.searchsorted(codes)
        is_known = self._codes.take(links, mode="clip") == codes
        if not is_known.all():
            raise ValueError(f"{self._trace.name} has no row for the link from {src} to {dst[~is_known][0]}")
        keys = links * self._width
        if not dst.flags.writeable:
            self._kept[src] = dst, keys
        return keys


def _code(src: Any, dst: Any) -> Any:
    """Return links as numbers, which ascend by sender and receiver."""
    return src * (MAX_NODE + 1) + dst
