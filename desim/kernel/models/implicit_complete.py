"""Implicit complete graphs: networkx graphs whose nodes and edges are computed on access instead of stored.

Kept equal to a complete graph of networkx by
`tests/kernel/test_implicit_complete.py::test_networkx_functions_give_the_same_results_as_for_its_own_complete_graph`.
"""

from collections.abc import Iterator, Mapping
from itertools import chain
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

if TYPE_CHECKING:
    import networkx as nx

Graph = TypeVar("Graph")


class _NoAttributes(dict[str, Any]):
    """The empty, read-only attributes of a node or an edge of an implicit graph."""

    def _raise_read_only(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError("an implicit graph is read-only: copy the graph to set attributes")

    __setitem__ = __ior__ = update = setdefault = _raise_read_only


_NO_ATTRIBUTES = _NoAttributes()


class _NodeRange(Mapping[int, Any]):
    """A mapping from the nodes 0 .. n - 1, possibly without one of them, to their attributes."""

    def __init__(self, size: int, without: int | None = None):
        self.size, self._without = size, without

    def __len__(self) -> int:
        return self.size - (self._without is not None)

    def __iter__(self) -> Iterator[int]:
        if self._without is None:
            return iter(range(self.size))
        return chain(range(self._without), range(self._without + 1, self.size))

    def __contains__(self, node: Any) -> bool:
        try:
            return bool(0 <= node < self.size and node != self._without and node == int(node))
        except (TypeError, ValueError):  # not a number
            return False

    def __getitem__(self, node: int) -> Any:
        if node not in self:
            raise KeyError(node)
        return self._value(node)

    def _value(self, node: int) -> Any:
        return _NO_ATTRIBUTES


class _CompleteAdjacency(_NodeRange):
    """The adjacency of a complete graph: a mapping from each node 0 .. n - 1 to all other nodes."""

    def _value(self, node: int) -> _NodeRange:
        return _NodeRange(self.size, int(node))


def complete_graph(size: int) -> "nx.Graph[int]":
    """Return the read-only complete graph of the nodes 0 .. size - 1; O(1) in time and memory."""
    import networkx as nx

    return _implicit(nx.Graph(), size)


def complete_digraph(size: int) -> "nx.DiGraph[int]":
    """Return the read-only complete directed graph of the nodes 0 .. size - 1; O(1) in time and memory."""
    import networkx as nx

    return _implicit(nx.DiGraph(), size)


def _implicit(graph: Graph, size: int) -> Graph:
    """Return a graph whose node and adjacency dictionaries are replaced by computed, read-only mappings."""
    import networkx as nx

    implicit: Any = graph
    implicit._node, implicit._adj = _NodeRange(size), _CompleteAdjacency(size)
    if implicit.is_directed():
        implicit._pred = implicit._adj
    nx.freeze(implicit)
    return graph


def is_implicit(graph: "nx.Graph[int]") -> bool:
    """Return whether a graph is an implicit complete graph, whose edges have no attributes."""
    return isinstance(getattr(graph, "_adj", None), _CompleteAdjacency)


def is_complete(graph: "nx.Graph[int]") -> bool:
    """Return whether a graph without self-loops is complete; O(1) for an implicit graph, else O(nodes).

    A multigraph does not count as complete.
    """
    size = len(graph)
    pairs = size * (size - 1) // (1 if graph.is_directed() else 2)
    return is_implicit(graph) or (graph.number_of_edges() == pairs and not graph.is_multigraph())
