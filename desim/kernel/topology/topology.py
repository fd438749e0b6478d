"""The current topology: a static graph, restricted to the pairs of nodes that are within range of each other."""

from bisect import bisect_left
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from math import inf

import networkx as nx
import numpy as np

from desim.config.arrays import Bools, Floats, Integers
from desim.kernel.core.positions import Nodes, PositionFunction, PositionSource, as_position_source, distances_from
from desim.kernel.core.seeds import ROOM
from desim.kernel.core.units import SECOND
from desim.kernel.models.graphs import node_names
from desim.kernel.models.implicit_complete import complete_digraph, is_complete, is_implicit
from desim.kernel.models.reception import ReceptionModel
from desim.kernel.topology.correlated_channel import CorrelatedChannel, Ends
from desim.kernel.topology.kept_receivers import KeptReceivers
from desim.kernel.topology.radio_walls import RadioWalls
from desim.kernel.topology.range_check import RangeCheck, WalledRangeCheck
from desim.kernel.topology.spatial_hash import CellList
from desim.kernel.walls.wall import Wall

FEW = 4
"""Number of receivers up to which it is faster to compute their distances one by one than with arrays."""
SMALL_NETWORK = 400
"""Number of nodes up to which a search computes all distances, faster than with a cell list, and its result is kept."""


class Topology:
    """The neighbourhoods of nodes 0 .. n - 1.

    The static graph is read once. With a range, the neighbourhoods follow the positions: a query computes distances,
    unless the receivers of the last search are certainly still the same (`KeptReceivers`). In a large complete graph,
    if reception has a maximum distance, a query uses a cell list and computes only the distances of nearby nodes.

    Kept equal to a search among all nodes by
    `tests/kernel/test_topology.py::test_queries_with_many_nodes_equal_those_with_few`.

    Args:
        graph: the communication graph.
        range: the communication range of every node, m; inf: there is no range.
        positions: the current positions of the nodes; required if the range is finite.
        reception: the probability of reception as a function of distance; a disk if None.
        per_link: whether random reception is drawn once per pair of nodes (fading per link); if not, it is drawn for
            every message (fading per message).
        seed: the seed of the random draws.
        channel: the states of the channels, if random reception is correlated in time and place; None: it is not.
        now: returns the time, s; None: it is always 0. With it and a bounded speed of the nodes, a query of the cell
            list need not compare all positions.
        walls: walls; those that block radio shorten the range of the lines that cross them.

    Attributes:
        size: number of nodes.
        channel: see above.
        per_link: see above.
        walls: the walls that block radio; None if there are none.

    Raises:
        ValueError: if there are no nodes, they are not 0 .. n - 1, one has a self-loop, or, without positions, the
            range is finite or a wall blocks radio.
    """

    def __init__(
        self,
        graph: "nx.Graph[int]",
        range: float = inf,  # noqa: A002
        positions: PositionFunction | None = None,
        reception: ReceptionModel | None = None,
        *,
        per_link: bool = True,
        seed: int = 0,
        channel: CorrelatedChannel | None = None,
        now: Callable[[], float] | None = None,
        walls: Sequence[Wall] = (),
    ):
        self.size = size = len(graph)
        _check(graph)
        has_walls = any("radio" in wall.blocks for wall in walls)
        if positions is None and (range < inf or has_walls):
            needs = f"a range of {range} m needs" if range < inf else "walls that block radio need"
            raise ValueError(f"{needs} positions")
        self._complete = is_complete(graph)
        self._directed = graph.is_directed() and not self._complete
        self._linked_nodes: list[list[int]] | _AllOthers = (
            _AllOthers(size) if self._complete else [sorted(graph.adj[node]) for node in sorted(graph)]
        )
        self._range, self._now = range, now
        self.channel, self.per_link = channel, per_link
        self.walls: RadioWalls | None = None
        self._range_check = (WalledRangeCheck if has_walls else RangeCheck)(reception, range, per_link, seed, size)
        self._positions = (
            as_position_source(positions) if positions is not None and (range < inf or has_walls) else None
        )
        if has_walls:
            self.walls = RadioWalls(walls, size, self._range_check.exponent)
            self._max_distance = self._range_check.bound
        self._few = 1
        """Number of receivers that `reaches` checks one by one: `FEW` if the source has a fast `distance`, else 1."""
        self._kept: KeptReceivers | None = None
        """The receivers of the last searches.

        None: links have no certain border, the speed of the nodes is unbounded, or there are too many nodes.
        """
        if self._positions is not None:
            if type(self._positions).distance is not PositionSource.distance:
                self._few = FEW
            self._candidates = _candidate_finder(
                self._linked_nodes, size, self._positions, self._range_check.bound, now
            )
            have_borders = self._range_check.has_border and channel is None and self.walls is None
            if have_borders and size <= SMALL_NETWORK and now is not None and self._positions.max_speed < inf:
                self._kept = KeptReceivers(size, self._positions.max_speed, now)

    def linked(self, node: int) -> list[int]:
        """Return the nodes that the graph links `node` to, ascending, regardless of range; read-only."""
        return self._linked_nodes[node]

    def are_linked(self, src: int, dst: int) -> bool:
        """Return whether the graph links `src` to `dst`, regardless of range."""
        if self._complete:
            return src != dst
        linked = self._linked_nodes[src]
        index = bisect_left(linked, dst)
        return index < len(linked) and linked[index] == dst

    def links_to(self, src: int, nodes: Nodes) -> Bools:
        """Return (k,) whether the graph links `src` to each of some nodes, regardless of range."""
        return nodes != src if self._complete else np.isin(nodes, self._linked_nodes[src])

    def hearers(self, node: int, message: int = 0) -> list[int]:
        """Return the nodes that a message of `node` reaches now, ascending; read-only.

        With fading per message, each message has its own draws; `message` is the number of the message.

        Raises:
            IndexError: if the node does not exist.
        """
        if node < 0:
            raise IndexError(f"there is no node {node}")
        if self._positions is None:
            return self._linked_nodes[node]
        if self._kept is not None:
            return self._within_border(node, self._kept)
        receivers: list[int] = self._receivers_among(node, self._candidates(node), message).tolist()
        return receivers

    def reaches(
        self,
        src: int | Integers,
        dst: list[int] | Integers,
        message: int | Integers = 0,
        times: int | Integers | None = None,
    ) -> list[bool]:
        """Return whether each of k messages reaches its receiver, regardless of the graph.

        Args:
            src: the sender, one for all or (k,).
            dst: (k,) the receivers, which are other nodes.
            message: the number of the message, one for all or (k,).
            times: ns, one for all or (k,), see `PositionSource.at`; None: now.
        """
        source = self._positions
        if source is None or not len(dst):
            return [True] * len(dst)
        if isinstance(src, int) and times is None:
            # In a complete graph, the receivers of the last search are all other nodes in range.
            if self._kept is not None and self._complete:
                if len(dst) > self._few:  # a search is faster than one check for each receiver
                    return list(map({src, *self._within_border(src, self._kept)}.__contains__, dst))
                if (receivers := self._kept.of(src)) is not None:  # no search is needed
                    return list(map(receivers.__contains__, dst))
            # A few receivers are checked one by one.
            if self.channel is None and self.walls is None and len(dst) <= self._few and isinstance(message, int):
                one, distance = self._range_check.one, source.distance
                return [one(src, node, distance(src, node), message) for node in map(int, dst)]
        # The plain way, for all receivers at once.
        positions_of = source.of if times is None else partial(source.at, times=times)
        nodes = np.asarray(dst)
        if isinstance(src, int):
            at = positions_of(np.append(src, nodes))
            distances, starts, ends = distances_from(at, 0)[1:], at[:1], at[1:]
        else:
            starts, ends = positions_of(src), positions_of(nodes)
            x, y = (ends - starts).T
            distances = np.hypot(x, y)
        if self.walls is not None:
            distances = self.walls.stretched(src, nodes, starts, ends, distances, self._max_distance)
        if self.channel is None:
            received: list[bool] = self._range_check(src, nodes, distances, message).tolist()
        else:
            pairs = Ends(src, nodes, starts[0] if isinstance(src, int) else starts, ends, self._seconds(times))
            received = self._range_check.through(self.channel.between(pairs), distances).tolist()
        return received

    def steady_receivers(self, node: int) -> tuple[set[int], float]:
        """Return the nodes that receive from a node now, and the time, ns, before which they certainly stay the same.

        The result is an empty set and 0 if they are not known, and a search is not `KeptReceivers.is_worthwhile`.
        """
        kept = self._kept
        if kept is None:
            return set(), 0.0
        receivers = kept.of(node)
        if receivers is None:
            if not kept.is_worthwhile(node):
                return set(), 0.0
            receivers = self._search(node, kept)
        return set(receivers), kept.until(node) * SECOND

    def _seconds(self, times: int | Integers | None = None) -> float | Floats:
        """Return times in s, given in ns; None: now."""
        if times is None:
            return self._now() if self._now is not None else 0.0
        return np.asarray(times) / SECOND

    @property
    def is_static(self) -> bool:
        """Whether there is no range, so that neighbourhoods do not depend on positions."""
        return self._positions is None

    @property
    def looks_back(self) -> bool:
        """Whether `reaches` is valid for times of the past."""
        return self._positions is None or self._positions.looks_back

    def before_change(self, act: Callable[[], object]) -> None:
        """Register a function to call before the motion of a node changes."""
        if self._positions is not None:
            self._positions.before_change(act)

    def neighbours(self, node: int) -> Nodes:
        """Return the nodes that receive from `node` now, ascending.

        If fading changes, these are the nodes with a probability of reception of at least 1/2. They are the nodes whose
        acknowledgements a sender waits for, and it does not know which of them are in a fade now.

        Raises:
            IndexError: if the node does not exist.
        """
        if node < 0:
            raise IndexError(f"there is no node {node}")
        if self._positions is None:
            return np.array(self._linked_nodes[node], dtype=np.intp)
        if self._kept is not None:
            return np.array(self.hearers(node), dtype=np.intp)
        return self._receivers_among(node, self._candidates(node))

    def audible(self, node: int) -> list[int]:
        """Return the nodes that `node` receives from now, ascending; see `neighbours`, also for errors."""
        senders: list[int]
        if node < 0:
            raise IndexError(f"there is no node {node}")
        if not self._directed:
            senders = self.neighbours(node).tolist() if self._kept is None else self.hearers(node)
        elif self._positions is None:
            senders = self._senders[node]
        else:  # reception is the same in both directions
            senders = self._receivers_among(node, _with_linked(node, self._senders[node])).tolist()
        return senders

    def component(self, node: int) -> set[int]:
        """Return `node` and all nodes whose messages can reach it now in any number of hops; cost O(nodes + links)."""
        members, unexplored = {node}, [node]
        while unexplored and len(members) < self.size:
            new = set(self.audible(unexplored.pop())) - members
            members |= new
            unexplored += new
        return members

    @property
    def mean_degree(self) -> float:
        """The current mean number of neighbours of a node."""
        if self._complete and self._positions is None:
            return self.size - 1.0
        return sum(len(self.neighbours(node)) for node in range(self.size)) / self.size

    def graph(self) -> "nx.DiGraph[int]":
        """Return the current topology as a networkx graph with an arc from each sender to each receiver."""
        if self._complete and self._positions is None:
            return complete_digraph(self.size)
        current: nx.DiGraph[int] = nx.DiGraph()
        current.add_nodes_from(range(self.size))
        current.add_edges_from((node, other) for node in current.nodes for other in self.neighbours(node).tolist())
        return current

    @cached_property
    def _senders(self) -> list[list[int]]:
        """For each node, the nodes that the graph links to it, ascending."""
        senders: list[list[int]] = [[] for _ in range(self.size)]
        for node in range(self.size):
            for other in self._linked_nodes[node]:
                senders[other].append(node)
        return senders

    def _within_border(self, node: int, kept: KeptReceivers) -> list[int]:
        """Return the nodes that receive from a node now, ascending; read-only."""
        if (receivers := kept.of(node)) is not None:
            return receivers
        if kept.is_worthwhile(node):
            return self._search(node, kept)
        nodes: list[int] = self._receivers_among(node, self._candidates(node)).tolist()
        return nodes

    def _search(self, node: int, kept: KeptReceivers) -> list[int]:
        """Search for the nodes that receive from a node now, and keep them."""
        candidates = self._candidates(node)
        index, _, distances = self._distances(node, candidates)
        excess = distances - self._range_check.border(node, candidates)
        excess[index] = inf  # the node does not receive from itself
        receivers: list[int] = candidates[excess <= 0.0].tolist()
        kept.keep(node, receivers, np.abs(excess).min().item())
        return receivers

    def _receivers_among(self, node: int, candidates: Nodes, message: int | None = None) -> Nodes:
        """Return the candidates that receive from a node; the candidates must include the node, the result does not."""
        index, places, distances = self._distances(node, candidates)
        distances[index] = self._range  # in place of 0, the distance of the node from itself: a model may divide by it
        if self.walls is not None:
            distances = self.walls.stretched(
                node, candidates, places[index : index + 1], places, distances, self._max_distance
            )
        if self.channel is None or message is None:
            received = self._range_check(node, candidates, distances, message)
        else:
            state = self.channel.between(Ends(node, candidates, places[index], places, self._seconds()))
            received = self._range_check.through(state, distances)
        received[index] = False
        return candidates[received]

    def _distances(self, node: int, candidates: Nodes) -> tuple[int, Floats, Floats]:
        """Return the index of a node among the (k,) candidates, their (k, 2) positions, and their distances from it."""
        assert self._positions is not None
        if self._complete and len(candidates) == self.size:  # `of` would copy them, and a source may have them stored
            index, places = node, self._positions()
        else:
            index, places = int(candidates.searchsorted(node)), self._positions.of(candidates)
        return index, places, distances_from(places, index)


class _AllOthers(dict[int, list[int]]):
    """A mapping from each node to the list of all others, computed on access; at most `ROOM` list items are cached."""

    def __init__(self, size: int):
        super().__init__()
        self._size = size

    def __missing__(self, node: int) -> list[int]:
        if not 0 <= node < self._size:
            raise IndexError(f"there is no node {node}")
        others = self._all[:node] + self._all[node + 1 :]
        if (len(self) + 1) * self._size <= ROOM:
            self[node] = others
        return others

    @cached_property
    def _all(self) -> list[int]:
        """All nodes, created on access, because it takes 40 B per node and is not needed with a range."""
        return list(range(self._size))


def _check(graph: "nx.Graph[int]") -> None:
    """Raise ValueError if there are no nodes, they are not 0 .. n - 1, or one has a self-loop."""
    if not len(graph):
        raise ValueError("a network should have at least 1 node (got an empty graph)")
    if is_implicit(graph):
        return
    if set(graph) != set(range(len(graph))):
        raise ValueError(f"the nodes of the graph should be 0 .. {len(graph) - 1}, got {node_names(graph)}")
    if loops := [node for node in graph if graph.has_edge(node, node)]:
        raise ValueError(f"no node should be linked to itself, got {loops}")


def _candidate_finder(
    linked_nodes: "list[list[int]] | _AllOthers",
    size: int,
    positions: PositionSource,
    bound: float,
    now: Callable[[], float] | None,
) -> Callable[[int], Nodes]:
    """Return a function from a node to the nodes that may receive from it now, and the node itself, ascending.

    `linked_nodes` has the nodes that the graph links each node to, and `bound` is the distance, m, beyond which nothing
    is received. The other arguments are as in `Topology`.
    """
    if isinstance(linked_nodes, list):
        return [_with_linked(node, linked) for node, linked in enumerate(linked_nodes)].__getitem__
    if size > SMALL_NETWORK and bound < inf:
        return CellList(positions, bound, now).around
    all_nodes = np.arange(size)
    return lambda _: all_nodes


def _with_linked(node: int, linked: list[int]) -> Nodes:
    """Return a node and its linked nodes, ascending."""
    return np.array(sorted([*linked, node]), dtype=np.intp)
