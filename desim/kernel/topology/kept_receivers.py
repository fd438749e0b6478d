"""Receivers that are kept: while no node can have crossed the border of its range, a query need not be repeated.

The distance of two nodes changes at most at twice the top speed. The border of a link is the distance at which
reception begins or ends. So the receivers of a node stay the same until the link nearest to its border can have reached
it. This is the margin of a Verlet list, for each node by itself.

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

    If nodes are many or fast, kept receivers are seldom used, and keeping them costs a tenth of a search. So each time
    that receivers are kept, a longer pause without keeping follows. A use of kept receivers ends the pause, for example
    by the second query of a broadcast whose range is checked at both ends.

    Args:
        size: number of nodes.
        max_speed: upper bound of the speed of all nodes, m/s.
        now: returns the time, s.
    """

    def __init__(self, size: int, max_speed: float, now: Callable[[], float]):
        self._change_rate, self._now = ROUNDING * 2.0 * max_speed, now
        self._receivers: list[list[int]] = [[] for _ in range(size)]
        self._until = [-inf] * size
        """By node, the time, s, before which its receivers are certain."""
        self._pause = self._left = 0
        """Number of queries for which nothing is kept, and how many of them are left."""
        self._counted: tuple[int, float] | None = None
        """The node and the time, s, of the last query that was counted."""

    def of(self, node: int) -> list[int] | None:
        """Return the nodes that receive from a node now, read-only; None: a search is needed."""
        if self._now() >= self._until[node]:
            return None
        self._pause = self._left = 0
        return self._receivers[node]

    def until(self, node: int) -> float:
        """Return the time, s, before which the kept receivers of a node are certain."""
        return self._until[node]

    def is_worthwhile(self, node: int) -> bool:
        """Count a query, and return whether to search for its answer and keep it.

        Queries about one node at one instant count once, and only the first is worthwhile: a broadcast whose range is
        checked at both ends makes two, for its receivers and for the time until which they stay the same.
        """
        query = node, self._now()
        if query == self._counted:
            return False
        self._counted = query
        self._left -= 1
        return self._left < 0

    def keep(self, node: int, receivers: list[int], margin: float) -> None:
        """Keep the receivers that a search has found now, given the least distance, m, of a link from its border."""
        self._receivers[node] = receivers
        self._until[node] = self._now() + (margin - MIN_SIDE) / self._change_rate if self._change_rate else inf
        self._pause = self._left = min(2 * self._pause + 1, MAX_PAUSE)
