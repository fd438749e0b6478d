"""Complete graphs that take no room: networkx graphs whose nodes and edges are worked out when somebody looks."""

from collections.abc import Iterator, Mapping
from itertools import chain
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    import networkx as nx


class _Nothing(dict[str, Any]):
    """The attributes of what has none, and cannot have any; a copy can."""

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError("what is worked out has no attributes: copy the graph to give it some")

    __setitem__ = __ior__ = update = setdefault = _refuse


_NOTHING = _Nothing()


class _Range(Mapping[int, Any]):
    """The nodes 0 .. n - 1, one of them perhaps left out, and what belongs to each."""

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
        except (TypeError, ValueError):  # it is no number
            return False

    def __getitem__(self, node: int) -> Any:
        if node not in self:
            raise KeyError(node)
        return self._of(node)

    def _of(self, node: int) -> Any:
        return _NOTHING


class _Everybody(_Range):
    """Each of the nodes 0 .. n - 1 and its neighbours, all others."""

    def _of(self, node: int) -> _Range:
        return _Range(self.size, int(node))


def complete_graph(size: int) -> "nx.Graph[int]":
    """Return the complete graph of the nodes 0 .. size - 1, for reading only; O(1) in time and memory."""
    import networkx as nx

    graph: nx.Graph[int] = nx.Graph()
    _materialise(graph, size)
    return graph


def complete_digraph(size: int) -> "nx.DiGraph[int]":
    """Return the complete directed graph of the nodes 0 .. size - 1, for reading only; O(1) in time and memory."""
    import networkx as nx

    graph: nx.DiGraph[int] = nx.DiGraph()
    _materialise(graph, size)
    return graph


def _materialise(graph: Any, size: int) -> None:
    """Let a graph have nodes and edges as the views of networkx have theirs: worked out, and not to be changed."""
    import networkx as nx

    graph._node, graph._adj = _Range(size), _Everybody(size)
    if graph.is_directed():
        graph._pred = graph._adj
    nx.freeze(graph)


def is_implicit(graph: "nx.Graph[int]") -> bool:
    """Return whether a graph is made here, so that no edge has attributes."""
    return isinstance(getattr(graph, "_adj", None), _Everybody)


def is_complete(graph: "nx.Graph[int]") -> bool:
    """Return whether a graph links all of its nodes to each other; O(nodes) if it is not made here."""
    size = len(graph)
    pairs = size * (size - 1) // (1 if graph.is_directed() else 2)
    return is_implicit(graph) or (graph.number_of_edges() == pairs and not graph.is_multigraph())
