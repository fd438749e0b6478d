"""The correlated random numbers of Linux's network emulator netem, for each link."""

from collections import defaultdict
from functools import partial
from math import nan

import numpy as np
from numpy.typing import NDArray

from desim.kernel.core.link_context import LinkContext
from desim.kernel.models.link_memory import LinkMemory

RANGE = 2**32
"""The numbers are 0 .. RANGE - 1."""


class CorrelatedNumbers:
    """Random numbers of the messages of a run, each a moving average with the last one of its link.

    number = ((RANGE - rho) new + rho last) / RANGE, rounded down, with rho = correlation (RANGE - 1) + 1. The last
    number of a link that has not been used is uniform (init_crandom and get_crandom in Linux, net/sched/sch_netem.c).
    The mean is that of uniform numbers, the variance tends to (1 - c) / (1 + c) times theirs.

    Args:
        correlation: the correlation c of successive numbers, in [0, 1]; 0: the numbers are independent.
    """

    def __init__(self, correlation: float):
        rho = round(correlation * (RANGE - 1))
        self._rho = np.uint64(rho + 1 if rho else 0)
        self._rows: defaultdict[int, LinkMemory] = defaultdict(partial(LinkMemory, nan))

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> NDArray[np.uint64]:
        """Return the (k,) numbers of a message, one per receiver."""
        new = _uniform(len(context.dst), rng)
        if not self._rho:
            return new
        row = self._rows[context.src]
        row.select(context.dst)
        unused = np.isnan(row.value)
        if unused.any():
            row.value[unused] = _uniform(int(unused.sum()), rng)
        last = row.value.astype(np.uint64)  # a float holds such a number exactly
        numbers = (new * (np.uint64(RANGE) - self._rho) + last * self._rho) >> np.uint64(32)
        row.value[:] = numbers
        return numbers


def _uniform(count: int, rng: np.random.Generator) -> NDArray[np.uint64]:
    return rng.integers(RANGE, size=count, dtype=np.uint64)
