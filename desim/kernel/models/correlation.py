"""Models with a memory for each link: numbers of messages that depend on the last one, as in Linux's emulator netem."""

from collections import defaultdict
from functools import partial
from math import nan
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from desim.kernel.core.link_context import LinkContext

if TYPE_CHECKING:
    from desim.config.arrays import Floats

NO_LINKS: "NDArray[np.intp]" = np.array([], dtype=np.intp)
"""The receivers of a `LinkMemory` whose numbers are all put aside."""


class LinkMemory:
    """The numbers of the links of one sender, one per link.

    The numbers of the links to the receivers of the last broadcast are in `value`, those of links that later messages
    to one node have used in `ones`. All others are put aside, in an array of all links. So a broadcast to the same
    receivers as the last one needs no look-up, which would take a third of its time, and a message to one node needs no
    array.

    Args:
        initial: the number of a link that has not been used.

    Attributes:
        dst: the (k,) receivers of the last broadcast; None if their array is writeable, because it may hold other
            receivers later.
        value: the (k,) numbers of these links.
        since: the times (s) of the last messages of these links, if the model sets them, (k,) or one for all; -inf:
            none.
        ones: by node, the number and the time of each link that a message to one node has used since the last
            broadcast; the model sets them.
    """

    def __init__(self, initial: float) -> None:
        self._initial = initial
        # The receivers of the links used so far, in ascending order, and their numbers and times. -1 is no node: it is
        # there because `take` rejects an empty array.
        self._nodes, self._value, self._since = np.array([-1]), np.array([initial]), np.array([-np.inf])
        self._selected = np.array([0])
        self.ones: dict[int, tuple[float, float]] = {}
        self.dst: NDArray[np.intp] | None = None
        self.value: Floats = self._value
        self.since: float | Floats = self._since

    def select(self, dst: "NDArray[np.intp]") -> None:
        """Put the present numbers aside, and load those of the links to the (k,) nodes `dst` into `value`."""
        if dst is self.dst:
            return
        # The present numbers are put aside before the look-up, because `_add` replaces the arrays.
        self._put_aside()
        links = self._nodes.searchsorted(dst)
        if (self._nodes.take(links, mode="clip") != dst).any():
            self._add(dst)
            links = self._nodes.searchsorted(dst)
        self._selected, self.dst = links, None if dst.flags.writeable else dst
        self.value, self.since = self._value[links], self._since[links]

    def one(self, node: int) -> tuple[float, float]:
        """Return the number of one link that is not in `ones`, and the time (s) of its last message.

        The numbers in `value` are put aside.
        """
        if self.dst is not NO_LINKS:
            self._put_aside()
            self._selected, self.dst = NO_LINKS, NO_LINKS
            self.value, self.since = self._value[:0], self._since[:0]
        link = int(self._nodes.searchsorted(node))
        if link == len(self._nodes) or self._nodes.item(link) != node:
            self._add(np.array([node]))
        return self._value.item(link), self._since.item(link)

    def _put_aside(self) -> None:
        self._value[self._selected], self._since[self._selected] = self.value, self.since
        if self.ones:
            links = self._nodes.searchsorted(list(self.ones))
            self._value[links], self._since[links] = zip(*self.ones.values(), strict=True)
            self.ones.clear()

    def _add(self, dst: "NDArray[np.intp]") -> None:
        """Add links that have not been used to the arrays of all links."""
        old, value, since = self._nodes, self._value, self._since
        self._nodes = np.union1d(old, dst)
        self._value, self._since = np.full(len(self._nodes), self._initial), np.full(len(self._nodes), -np.inf)
        old_links = self._nodes.searchsorted(old)
        self._value[old_links], self._since[old_links] = value, since


RANGE = 2**32
"""The numbers are 0 .. RANGE - 1."""


class CorrelatedNumbers:
    """Random numbers of the messages of a run, each a moving average with the last one of its link.

    number = ((RANGE - rho) new + rho last) / RANGE, rounded down, with rho = correlation (RANGE - 1) + 1. The last
    number of a link that has not been used is uniform (init_crandom and get_crandom in Linux, net/sched/sch_netem.c).
    The mean is that of uniform numbers; the variance tends to theirs times (1 - c) / (1 + c).

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
        last = row.value.astype(np.uint64)  # a float holds an integer below 2^53 exactly
        # No overflow: the weights add up to 2^32, and both numbers are less than 2^32.
        numbers = (new * (np.uint64(RANGE) - self._rho) + last * self._rho) >> np.uint64(32)
        row.value[:] = numbers
        return numbers


def _uniform(count: int, rng: np.random.Generator) -> NDArray[np.uint64]:
    return rng.integers(RANGE, size=count, dtype=np.uint64)
