"""Receivers that are kept: while no node can have crossed the border of its range, a query need not be repeated.

Two nodes approach each other, or part, at twice the top speed at most. The nearest of the links to its border, where
reception begins or ends, thus tells until when the receivers of a node stay the same. This is the margin of a Verlet
list, for each node by itself.

Kept equal to a search at each query by
`tests/kernel/test_topology.py::test_receivers_that_are_kept_are_those_of_a_search_at_each_query`.
"""

from collections.abc import Callable
from math import inf

from desim.kernel.topology.spatial_hash import MIN_SIDE, ROUNDING

MAX_PAUSE = 63
"""Largest number of successive queries for which nothing is kept."""


class KeptReceivers:
    """The receivers of the last search for each node.

    Where nodes are many or fast, kept receivers are seldom used, and keeping them costs a tenth of a search. So each
    time that receivers are kept, the next pause without keeping is longer; once kept receivers are used, as by the
    second query of a broadcast whose range is checked at both ends, there is no pause.

    Args:
        size: number of nodes.
        max_speed: upper bound of the speed of all nodes, m/s.
        now: returns the time, s.
    """

    def __init__(self, size: int, max_speed: float, now: Callable[[], float]):
        self._closing, self._now = ROUNDING * 2.0 * max_speed, now
        self._receivers: list[list[int]] = [[] for _ in range(size)]
        self._until = [-inf] * size
        """By node, the time, s, before which its receivers are certain."""
        self._pause = self._left = 0
        """Number of queries for which nothing is kept, and how many of them are left."""
        self._asked: tuple[int, float] | None = None
        """The node and the time, s, of the last query that was counted."""

    def of(self, node: int) -> list[int] | None:
        """Return the nodes that receive from a node now, read-only; None: they have to be searched for."""
        if self._now() >= self._until[node]:
            return None
        self._pause = self._left = 0
        return self._receivers[node]

    def until(self, node: int) -> float:
        """Return the time, s, before which the receivers of a node that are kept are certain."""
        return self._until[node]

    def is_worthwhile(self, node: int) -> bool:
        """Count a query, and return whether to search for its answer and keep it.

        Queries about one node at one instant count once, and only the first is worthwhile: a broadcast whose range is
        checked at both ends asks which nodes receive it, and until when they stay the same.
        """
        asked = node, self._now()
        if asked == self._asked:
            return False
        self._asked = asked
        self._left -= 1
        return self._left < 0

    def keep(self, node: int, receivers: list[int], margin: float) -> None:
        """Keep what a search has found now, given the least distance, m, of a link from its border."""
        self._receivers[node] = receivers
        self._until[node] = self._now() + (margin - MIN_SIDE) / self._closing if self._closing else inf
        self._pause = self._left = min(2 * self._pause + 1, MAX_PAUSE)
