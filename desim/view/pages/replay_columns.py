"""Numbers in the data of a replay: times in whole ticks, and columns in base64."""

from base64 import b64encode
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from desim.config.arrays import Integers

MAX_REPLAY_TIME = 2**32 - 1
"""The largest tick that a column can hold."""
ReplayData = dict[str, Any]
"""A JSON object."""
DIFFERENCES, RUNS = 1, 2
"""The bits of the first byte of a column; see `packed_column`."""


class Ticks(NamedTuple):
    """The tick, the unit of time in the page: the shortest one of 1, 10, ... ns with fewer than 2^31 ticks in a run."""

    length: int
    """Duration of a tick, ns."""
    end: int
    """End of the run, ns."""

    @classmethod
    def fit(cls, end: int, other_end: int = 0, shortest: int = 1) -> "Ticks":
        """Return the ticks of a run, such that another run has fewer than 2^31 of them, too; all arguments in ns."""
        length = shortest
        while max(end, other_end) // length >= 2**31:
            length *= 10
        return cls(length, end)

    @property
    def last(self) -> int:
        """The tick at which the run ends."""
        return self.nearest(self.end)

    def nearest(self, t: int) -> int:
        """Return the tick nearest to a time (ns)."""
        return (t + self.length // 2) // self.length

    def __call__(self, times: ArrayLike) -> str:
        """Return times (ns) as a column of ticks; times after the end of the run map to ticks after `last`."""
        instants = np.asarray(times, np.int64)
        ticks = (instants + self.length // 2) // self.length
        ticks = np.where(instants > self.end, np.maximum(ticks, self.last + 1), ticks)
        return packed_column(np.minimum(ticks, MAX_REPLAY_TIME), "<u4")


def raw(values: ArrayLike, kind: str) -> str:
    """Return floating-point numbers as a little-endian column of a NumPy dtype, in base64."""
    return b64encode(np.asarray(values).astype(kind).tobytes()).decode()


def packed_column(values: ArrayLike, kind: str) -> str:
    """Return integers as a column in base64, short where neighbours are alike.

    The first byte is the sum of `DIFFERENCES`, if each number is the difference from the one before, and of `RUNS`, if
    each number is followed by how often it is repeated. Then come the numbers, each in groups of 7 bits, the lowest
    first; the highest bit of a byte says whether another one follows. Even codes are 0, 1, 2, ..., odd ones -1, -2, ...

    Args:
        values: the integers, of any shape.
        kind: the NumPy dtype in which the page keeps them, of at most 32 bits.

    Raises:
        ValueError: if a number does not fit the dtype.
    """
    numbers = np.asarray(values)
    column = numbers.astype(kind)
    if not np.array_equal(column, numbers):
        raise ValueError(f"a replay cannot store {np.abs(numbers).max()} in a column of {np.dtype(kind).name}")
    plain = column.ravel().astype(np.int64)
    # Receivers of a broadcast ascend by ones, and arrival times may be equal: a run of equal differences, however long,
    # takes two bytes. Random latencies have no runs, and angles no small differences. So the shortest form is taken.
    candidates = []
    for form, integers in ((0, plain), (DIFFERENCES, np.diff(plain, prepend=0))):
        codes = (integers << 1) ^ (integers >> 63)  # zigzag: 0, -1, 1, -2, ... become 0, 1, 2, 3, ...
        starts = np.flatnonzero(np.diff(codes, prepend=-1))
        lengths = np.diff(starts, append=len(codes))
        candidates += [(form, codes), (form | RUNS, np.column_stack([codes[starts], lengths]).ravel())]
    form, codes = min(candidates, key=lambda candidate: int(_widths(candidate[1]).sum()))
    return b64encode(bytes([form]) + _varints(codes)).decode()


def _widths(codes: Integers) -> Integers:
    """Return the number of bytes of each number below 2^35 in groups of 7 bits."""
    widths: Integers = np.ones_like(codes)
    for bits in (7, 14, 21, 28):
        widths += codes >= 1 << bits
    return widths


def _varints(codes: Integers) -> bytes:
    """Return numbers below 2^35 in groups of 7 bits."""
    widths = _widths(codes)
    ends = np.cumsum(widths)
    content = np.zeros(int(ends[-1]) if len(ends) else 0, np.uint8)
    for k in range(int(widths.max(initial=0))):  # the k-th groups of all numbers
        has_group = widths > k
        groups = (codes[has_group] >> 7 * k) & 127
        content[(ends - widths)[has_group] + k] = groups | np.where(widths[has_group] > k + 1, 128, 0)
    return content.tobytes()
