"""Who can hear whom: a static graph, cut down to the pairs that are within reach of each other now."""

from math import inf

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from desim.kernel.hops import Positions, distances
from desim.kernel.reach import Disk, Reach
from desim.kernel.seeds import pair_luck

Nodes = NDArray[np.intp]
Truths = NDArray[np.bool_]


class Topology:
    """The neighbourhoods of nodes 0 .. n - 1.

    A static graph that is not limited by range is read once; with a range, distances are taken at every question,
    so the neighbourhoods follow the positions.

    Args:
        graph: who is linked to whom.
        range: of every node, m.
        positions: where the nodes are now; needed if the range is finite.
        reach: the probability of reception at a distance.
        frozen: whether its chance is drawn once per pair of nodes; if not, for every message.
        seed: of that chance.

    Raises:
        ValueError: if the nodes are not 0 .. n - 1, one is linked to itself, or a finite range comes without positions.
    """

    def __init__(
        self,
        graph: "nx.Graph[int]",
        range: float = inf,  # noqa: A002
        positions: Positions | None = None,
        reach: Reach | None = None,
        *,
        frozen: bool = True,
        seed: int = 0,
    ):
        self.size = size = len(graph)
        nodes = np.arange(size)
        if set(graph) != set(nodes.tolist()):
            raise ValueError(f"the nodes of the graph should be 0 .. {size - 1}, got {sorted(graph, key=str)}")
        if any(node in graph.adj[node] for node in graph):
            raise ValueError(f"no node should be linked to itself, got {[n for n in graph if n in graph.adj[n]]}")
        if range < inf and positions is None:
            raise ValueError(f"a range of {range} m needs positions")
        self._lists = [sorted(graph.adj[node]) for node in nodes.tolist()]
        self._linked: list[Nodes] = [np.array(each, dtype=np.intp) for each in self._lists]
        self._directed = graph.is_directed()
        self._range, self._reach = range, reach or Disk()
        self._positions = positions if range < inf else None
        self._certain = isinstance(self._reach, Disk)
        self._frozen, self._seed = frozen, seed
        self._luck: dict[int, NDArray[np.float64]] = {}  # by sender, that of its pairs with all nodes

    def linked(self, node: int) -> list[int]:
        """Return the nodes that the graph links `node` to, ascending, near or far; not to be changed."""
        return self._lists[node]

    def hearers(self, node: int, message: int = 0) -> list[int]:
        """Return the nodes that a message of `node` reaches now, ascending; each message has a number, for its luck."""
        if node < 0:
            raise IndexError(f"there is no node {node}")
        if self._positions is None:
            return self._lists[node]
        near: list[int] = self._linked[node][self._received(node, self._linked[node], message)].tolist()
        return near

    def reaches(self, src: int, dst: int, message: int = 0) -> bool:
        """Return whether a message of one node reaches another now."""
        return self._positions is None or bool(self._received(src, np.array([dst]), message)[0])

    def neighbours(self, node: int) -> Nodes:
        """Return the nodes that hear `node` now, ascending; with fading per message, those with even chance or more."""
        if node < 0:
            raise IndexError(f"there is no node {node}")
        linked = self._linked[node]
        return linked if self._positions is None else linked[self._received(node, linked)]

    def audible(self, node: int) -> list[int]:
        """Return the nodes that `node` hears now, ascending; see `neighbours`."""
        if not self._directed:
            found: list[int] = self.neighbours(node).tolist()  # reach is the same both ways
            return found
        return [other for other in range(self.size) if node in self.neighbours(other)]

    def graph(self) -> "nx.DiGraph[int]":
        """Return who hears whom now, as a networkx graph with an arc from speaker to hearer."""
        now: nx.DiGraph[int] = nx.DiGraph()
        now.add_nodes_from(np.arange(self.size).tolist())
        now.add_edges_from((node, other) for node in now.nodes for other in self.neighbours(node).tolist())
        return now

    def _received(self, src: int, dst: Nodes, message: int | None = None) -> Truths:
        """Return which of the nodes `dst` are within reach of a message, or with even chance or more of any."""
        assert self._positions is not None
        apart = distances(self._positions(), src, dst)
        if self._certain:
            return apart <= self._range
        probability = self._reach(apart, self._range)
        if self._frozen:
            if src not in self._luck:
                self._luck[src] = pair_luck(self._seed, "fading", src, np.arange(self.size))
            luck = self._luck[src][dst]
        elif message is None:
            luck = np.full(len(dst), 0.5)
        else:
            luck = pair_luck(self._seed, "fading", src, dst, message, symmetric=False)
        received: Truths = luck <= probability
        return received & (probability > 0.0)
