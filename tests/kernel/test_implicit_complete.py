"""Complete graphs that take no room are those of networkx, but for that they cannot be changed."""

import pickle
import tracemalloc
from copy import deepcopy

import networkx as nx
import numpy as np
import pytest

from desim.kernel.models.implicit_complete import complete_digraph, complete_graph, is_complete, is_implicit

PAIRS = [(complete_graph, nx.Graph), (complete_digraph, nx.DiGraph)]
SIZES = [0, 1, 2, 3, 7]


def items(graph):
    """Return nodes, neighbours and edges, in their order."""
    adjacency = [(node, list(linked.items())) for node, linked in graph.adjacency()]
    return list(graph.nodes(data=True)), adjacency, list(graph.edges(data=True)), list(graph.degree())


@pytest.mark.parametrize(("ours", "kind"), PAIRS)
@pytest.mark.parametrize("size", SIZES)
def test_a_complete_graph_is_that_of_networkx(ours, kind, size):
    graph, theirs = ours(size), nx.complete_graph(size, kind)
    assert type(graph) is kind
    assert items(graph) == items(theirs)
    assert (graph.adj, len(graph), graph.order()) == (theirs.adj, size, size)
    assert (graph.size(), graph.number_of_edges(), nx.density(graph)) == (
        theirs.size(),
        theirs.size(),
        nx.density(theirs),
    )
    if kind is nx.DiGraph:
        assert (graph.pred, graph.succ) == (theirs.pred, theirs.succ)
        assert list(graph.in_edges) == list(theirs.in_edges)


@pytest.mark.parametrize(("ours", "kind"), PAIRS)
def test_networkx_functions_give_the_same_results_as_for_its_own_complete_graph(ours, kind):
    graph, theirs = ours(5), nx.complete_graph(5, kind)
    for make in (
        nx.Graph.copy,
        nx.Graph.to_directed,
        nx.Graph.to_undirected,
        lambda g: g.subgraph([0, 2, 3]),
        lambda g: g.edge_subgraph([(0, 1), (1, 2)]),
        lambda g: nx.relabel_nodes(g, {0: "a"}),
        nx.complement,
        nx.Graph,
        deepcopy,
        lambda g: pickle.loads(pickle.dumps(g)),
    ):
        assert items(make(graph)) == items(make(theirs))
    assert (nx.to_numpy_array(graph) == nx.to_numpy_array(theirs)).all()
    assert dict(nx.all_pairs_shortest_path(graph)) == dict(nx.all_pairs_shortest_path(theirs))
    assert nx.node_link_data(graph, edges="edges") == nx.node_link_data(theirs, edges="edges")


@pytest.mark.parametrize(
    "node", [0, 2, 2.0, np.int64(2), True, -1, 3, 2.5, np.int64(3), "a", None, (1, 2), [1], np.nan]
)
def test_any_key_is_a_node_if_it_is_one_of_networkx(node):
    graph, theirs = complete_graph(3), nx.complete_graph(3)
    assert (node in graph) == (node in theirs)
    if not isinstance(node, list):
        assert graph.has_edge(node, 0) == theirs.has_edge(node, 0)
        assert graph.has_edge(0, node) == theirs.has_edge(0, node)


def test_a_key_that_is_not_a_node_has_no_neighbours():
    graph = complete_graph(3)
    for node in (3, -1, "a"):
        with pytest.raises(KeyError):
            graph.adj[node]
        with pytest.raises(KeyError):
            graph.adj[1][node]
    with pytest.raises(KeyError):
        graph.adj[1][1]
    assert sorted(graph.adj[np.int64(1)]) == [0, 2]


@pytest.mark.parametrize(
    "change",
    [
        lambda g: g.add_node(9),
        lambda g: g.remove_edge(0, 1),
        lambda g: g.clear(),
        lambda g: nx.set_edge_attributes(g, {(0, 1): {"latency": 0.1}}),
        lambda g: nx.set_node_attributes(g, 1.0, "x"),
        lambda g: g.edges[0, 1].update(latency=0.1),
        lambda g: g.edges[0, 1].setdefault("latency", 0.1),
    ],
)
def test_it_is_immutable_and_attempts_to_change_it_raise(change):
    graph = complete_graph(3)
    assert nx.is_frozen(graph)
    with pytest.raises((nx.NetworkXError, TypeError)):
        change(graph)
    assert items(graph) == items(nx.complete_graph(3))


@pytest.mark.parametrize("make", [nx.Graph.copy, nx.Graph, nx.Graph.to_undirected, nx.Graph.to_directed])
def test_a_copy_can_be_changed(make):
    copy = make(complete_graph(3))
    copy.edges[0, 1]["latency"] = 0.1
    copy.nodes[0]["x"] = 1.0
    copy.remove_edge(1, 2)
    assert copy.edges[0, 1] == {"latency": 0.1}
    assert not is_implicit(copy)
    assert items(complete_graph(3)) == items(nx.complete_graph(3))


def test_it_takes_no_room():
    tracemalloc.start()
    graph = complete_graph(10**9)
    assert tracemalloc.get_traced_memory()[1] < 20_000
    tracemalloc.stop()
    assert len(graph) == 10**9
    assert len(graph.adj[5]) == 10**9 - 1
    assert graph.has_edge(3, 10**9 - 1)
    assert is_complete(graph)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kind", [nx.Graph, nx.DiGraph])
def test_whether_a_graph_is_complete(kind, size):
    graph = nx.complete_graph(size, kind)
    assert is_complete(graph)
    assert not is_implicit(graph)
    assert is_complete(complete_graph(size))
    assert is_implicit(complete_graph(size))
    if size > 1:
        graph.remove_edge(0, 1)
        assert not is_complete(graph)


def test_as_many_edges_do_not_make_a_multigraph_complete():
    assert not is_complete(nx.MultiGraph([(0, 1), (0, 1), (0, 2)]))
