"""Who can hear whom: a static graph, cut down to the pairs that are within range of each other now."""

from collections.abc import Callable
from math import inf

import networkx as nx
import numpy as np
from numpy.typing import NDArray

Positions = Callable[[], NDArray[np.float64]]
"""Where the nodes are now, (n, 2) m."""


class Topology:
    """The neighbourhoods of nodes 0 .. n - 1.

    A static graph that is not limited by range is read once; with a range, distances are taken at every question,
    so the neighbourhoods follow the positions.

    Raises:
        ValueError: if the nodes are not 0 .. n - 1, one is linked to itself, or a finite range comes without positions.
    """

    def __init__(self, graph: "nx.Graph[int]", reach: float = inf, positions: Positions | None = None):
        size = len(graph)
        if set(graph) != set(range(size)):
            raise ValueError(f"the nodes of the graph should be 0 .. {size - 1}, got {sorted(graph, key=str)}")
        if any(node in graph.adj[node] for node in graph):
            raise ValueError(f"no node should be linked to itself, got {[n for n in graph if n in graph.adj[n]]}")
        if reach < inf and positions is None:
            raise ValueError(f"a range of {reach} m needs positions")
        self.size = size
        self._linked = [np.array(sorted(graph.adj[node]), dtype=np.intp) for node in range(size)]
        self._reach = reach
        self._positions = positions if reach < inf else None

    def neighbours(self, node: int) -> NDArray[np.intp]:
        """Return the nodes that hear `node` now, ascending."""
        if node < 0:
            raise IndexError(f"there is no node {node}")
        linked = self._linked[node]
        if self._positions is None:
            return linked
        at = self._positions()
        apart = at[linked] - at[node]
        near: NDArray[np.intp] = linked[np.hypot(apart[:, 0], apart[:, 1]) <= self._reach]
        return near

    def graph(self) -> "nx.DiGraph[int]":
        """Return who hears whom now, as a networkx graph with an arc from speaker to hearer."""
        now: nx.DiGraph[int] = nx.DiGraph()
        now.add_nodes_from(range(self.size))
        now.add_edges_from((node, int(other)) for node in range(self.size) for other in self.neighbours(node))
        return now
