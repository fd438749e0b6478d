"""The playback of measurements of links in one run; see `desim.kernel.measured.base`."""

from bisect import bisect_right
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from desim.config.arrays import Bools, Floats
from desim.kernel.core.link_context import LinkContext
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import SECOND
from desim.kernel.measured.base import LinkTrace
from desim.kernel.measured.measurements import MAX_NODE

if TYPE_CHECKING:
    from numpy.typing import NDArray


class TraceEndError(ValueError):
    """Raised when a message is sent after the end of a trace with after = "error"."""


class Playback:
    """A trace in one run.

    Its rows are those of the table and two more for each link, at time 0 and at the end of the trace, so that every
    message is sent between two rows of its link. With T distinct times in the table, the key of a row is (T + 1) *
    (number of its link) + (rank of its time). One binary search for keys finds the rows of all receivers.

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
        """Seed, time and sender of the last transmission, its receivers, and the result of `_rows`."""
        self._starts: dict[int, int] = {}
        """By seed, the time in the trace at which the simulation starts, ns."""
        first, last = measured.first[:-1], measured.first[1:] - 1
        links, counts = np.arange(len(first)), last - first + 1
        values, is_missing = trace.scaled(measured.values), measured.is_missing
        at_zero = last if repeats else first
        begin_values = values[at_zero]
        if repeats and self._is_linear:  # interpolated from the last row, through the end of the trace, to the first
            first_time = measured.times[measured.rank[first]]
            gap = self._end - measured.times[measured.rank[last]] + first_time
            begin_values = begin_values + (values[first] - begin_values) * ((gap - first_time) / gap)
        end_values = begin_values if repeats else values[last]
        # The added rows at time 0, the rows of the table, and the added rows at the end.
        keys = [links * self._width, np.repeat(links, counts) * self._width + measured.rank]
        keys += [(links + 1) * self._width - 1]
        # Stable, so that a row of the table at time 0 comes after the added row with the same key, and replaces it.
        order = np.argsort(np.concatenate(keys), kind="stable")
        self._keys = np.concatenate(keys)[order]
        self._values = np.concatenate((begin_values, values, end_values))[order]
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
        row_times = self._row_times[rows]
        share = (time - row_times) / (self._row_times[rows + 1] - row_times)
        return values + share * (self._values[rows + 1] - values)

    def is_missing(self, context: LinkContext) -> Any:
        """Return whether the values at the time of a transmission are missing; see `values`."""
        return self._is_missing[self._rows(context)[1]]

    def _rows(self, context: LinkContext) -> tuple[int, Any]:
        """Return the time of a transmission in the trace, ns, and the last row of each link up to then.

        The result is kept, because a network draws both losses and latencies of a transmission.
        """
        transmission, dst = (context.seed, context.now, context.src), context.dst
        if self._last is not None and transmission == self._last[0] and dst is self._last[1]:
            return self._last[2]
        time = self._time(context)
        rows = self._keys.searchsorted(self._link_keys(context) + bisect_right(self._times, time)) - 1
        if not dst.flags.writeable:
            self._last = transmission, dst, (time, rows)
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
            fixed = self._trace.start
            drawn = fixed if fixed != "random" else stream(seed, "start of traces").random() * self._end / SECOND
            start = self._starts[seed] = round(drawn * SECOND)
        return start

    def _link_keys(self, context: LinkContext) -> Any:
        """Return (k,) the key of the first row of each link; 0 if the rows hold for all links."""
        if self._codes is None:
            return 0
        src, dst = context.src, context.dst
        codes = _code(src, dst)
        links = self._codes.searchsorted(codes)
        is_known = self._codes.take(links, mode="clip") == codes
        if not is_known.all():
            raise ValueError(f"{self._trace.name} has no row for the link from {src} to {dst[~is_known][0]}")
        return links * self._width


def _code(src: Any, dst: Any) -> Any:
    """Return one number for each link, ascending by sender and receiver."""
    return src * (MAX_NODE + 1) + dst
