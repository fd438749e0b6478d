"""Graphs of the links: those of networkx, and those of files."""

import json
from random import Random

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from desim.kernel.models.graphs import Complete, Edge, Edges, Grid, Link, Ring, Star, as_model, graph_of
from desim.kernel.models.latency import Constant, Gamma
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli, GilbertElliott

pytestmark = pytest.mark.filterwarnings("ignore:.*all edges are one-way")

SIZES = [1, 2, 3, 4, 7, 12]


def same(ours, theirs):
    return set(ours) == set(theirs) and set(map(frozenset, ours.edges)) == set(map(frozenset, theirs.edges))


@pytest.mark.parametrize("size", SIZES)
def test_complete_ring_and_star_are_those_of_networkx(size):
    assert same(Complete()(size), nx.complete_graph(size))
    assert same(Ring()(size), nx.cycle_graph(size) if size > 2 else nx.path_graph(size))
    assert same(Star()(size), nx.star_graph(size - 1))


def test_a_complete_graph_is_not_listed():
    assert Complete()(10**9).degree(7) == 10**9 - 1


def test_a_star_has_the_given_centre():
    star = Star(centre=3)(5)
    assert sorted(star.adj[3]) == [0, 1, 2, 4]
    assert [sorted(star.adj[node]) for node in (0, 1, 2, 4)] == [[3]] * 4
    with pytest.raises(ValueError, match=r"no node 5: the nodes are 0 \.\. 4"):
        Star(centre=5)(5)


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (1, 5), (5, 1), (3, 4), (4, 3)])
def test_a_full_grid_is_that_of_networkx(rows, columns):
    theirs = nx.relabel_nodes(nx.grid_2d_graph(rows, columns), lambda at: at[0] * columns + at[1])
    assert same(Grid(columns=columns)(rows * columns), theirs)


@given(size=st.integers(1, 40), columns=st.integers(1, 12))
def test_any_grid_is_the_first_nodes_of_a_full_one(size, columns):
    rows = -(-size // columns)
    full = nx.relabel_nodes(nx.grid_2d_graph(rows, columns), lambda at: at[0] * columns + at[1])
    assert same(Grid(columns=columns)(size), full.subgraph(range(size)))


def test_edges_are_the_graph_they_list_one_way_if_directed():
    """Nodes without edges included."""
    edges = (Edge(src=0, dst=1), Edge(src=1, dst=3, latency=Constant(value=0.5)))
    graph = Edges(edges=edges)(5)
    assert set(graph) == {0, 1, 2, 3, 4}
    assert set(graph.edges) == set(Edges(edges=edges, directed=True)(5).edges) == {(0, 1), (1, 3)}
    assert graph.edges[3, 1]["latency"] == Constant(value=0.5)


def test_a_graph_for_another_number_of_nodes_is_refused():
    with pytest.raises(ValueError, match="the graph has 4 nodes, the network 5"):
        Edges(nodes=4)(5)
    with pytest.raises(ValueError, match=r"edge 1 to 5: the nodes should be 0 \.\. 4"):
        Edges(edges=(Edge(src=1, dst=5),))(5)
    assert len(Edges(nodes=4)(4)) == 4


# From networkx and from files.


def net(directed=False):
    """Return a small graph with numbers as attributes of some of its edges."""
    graph = nx.DiGraph() if directed else nx.Graph()
    graph.add_nodes_from(range(4))
    graph.add_edge(0, 1, latency=0.25, loss=0.5)
    graph.add_edge(1, 2, latency=1)
    graph.add_edge(2, 3, loss=0, colour="red")
    return graph


def write(graph, tmp_path, kind):
    file = tmp_path / f"net.{kind}"
    if kind == "graphml":
        nx.write_graphml(graph, file)
    else:
        file.write_text(json.dumps(nx.node_link_data(graph, edges="edges")))
    return file


def from_file(file):
    return Edges.model_validate({"file": file.name}, context={"folder": file.parent})


@pytest.mark.parametrize("directed", [False, True])
@pytest.mark.parametrize("kind", ["json", "graphml", "of"])
def test_a_graph_is_the_same_from_networkx_from_json_and_from_graphml(tmp_path, kind, directed):
    graph = net(directed)
    edges = Edges.of(graph) if kind == "of" else from_file(write(graph, tmp_path, kind))
    assert (edges.nodes, edges.directed) == (4, directed)
    made = edges(4)
    assert type(made) is type(graph)
    assert same(made, graph)
    assert (set(made.edges) == set(graph.edges)) or not directed
    assert made.edges[0, 1] == {"latency": Constant(value=0.25), "loss": Bernoulli(p=0.5)}
    assert made.edges[1, 2] == {"latency": Constant(value=1.0)}
    assert made.edges[2, 3] == {"loss": Bernoulli(p=0.0)}
    assert Edges.model_validate(edges.plain()) == edges


def test_an_edge_in_json_may_have_a_whole_model(tmp_path):
    graph = nx.path_graph(2)
    graph.edges[0, 1].update(latency={"kind": "gamma", "scale": 0.02}, loss={"kind": "gilbert_elliott", "share": 0.3})
    edge = from_file(write(graph, tmp_path, "json"))(2).edges[0, 1]
    assert edge == {"latency": Gamma(scale=0.02), "loss": GilbertElliott(share=0.3)}


def test_an_edge_of_networkx_may_have_a_model_or_a_function():
    graph = nx.path_graph(2)
    graph.edges[0, 1].update(latency=Gamma(), loss=lambda context, rng: True)
    edge = Edges.of(graph)(2).edges[0, 1]
    assert edge == graph.edges[0, 1]


@given(st.integers(1, 12), st.floats(0.0, 1.0), st.integers(0, 99), st.booleans())
def test_any_graph_comes_back(size, density, seed, directed):
    graph = nx.gnp_random_graph(size, density, seed=Random(seed), directed=directed)
    back = Edges.of(graph)(size)
    assert nx.utils.graphs_equal(back, graph)


@pytest.mark.parametrize("kind", ["json", "graphml", "of", "simple json"])
def test_parallel_edges_are_refused_and_two_ways_are_not_parallel(tmp_path, kind):
    """Of parallel edges the last would win; JSON that calls itself simple is read as such by networkx."""
    two_ways, parallel = (nx.MultiDiGraph([(0, 1, {"latency": 1.0}), other]) for other in [(1, 0), (0, 1)])
    assert set(Edges.of(two_ways)(2).edges) == {(0, 1), (1, 0)}
    file = write(parallel, tmp_path, kind.split()[-1])
    if kind == "simple json":
        file.write_text(file.read_text().replace('"multigraph": true', '"multigraph": false'))
    with pytest.raises(ValueError, match="edges 0 and 1 are parallel: both join nodes 0 and 1"):
        Edges.of(parallel) if kind == "of" else from_file(file)


def test_nodes_may_be_numbers_of_numpy():
    graph = nx.Graph([(np.int64(0), np.int64(1)), (np.int64(1), np.int64(2))])
    assert same(Edges.of(graph)(3), nx.path_graph(3))


def test_a_file_is_read_beside_the_scenario(tmp_path):
    write(net(), tmp_path, "json")
    links = Links.model_validate({"graph": {"kind": "edges", "file": "net.json"}}, context={"folder": tmp_path})
    assert links.graph == Edges.of(net())


@pytest.mark.parametrize(
    ("beside", "named"),
    [({"edges": []}, "edges"), ({"nodes": 4}, "nodes"), ({"nodes": 4, "names": []}, "nodes and names")],
)
def test_keys_that_a_file_gives_are_refused_beside_it(tmp_path, beside, named):
    file = write(net(), tmp_path, "json")
    with pytest.raises(ValidationError, match=f"should have either a file or {named}: a file gives all of them"):
        Edges.model_validate({"file": file.name} | beside, context={"folder": file.parent})


def test_an_empty_graph_is_refused(tmp_path):
    with pytest.raises(ValueError, match="greater than or equal to 1"):
        from_file(write(nx.Graph(), tmp_path, "json"))


@pytest.mark.parametrize(("name", "value"), [("latency", -0.5), ("latency", "fast"), ("loss", 1.5), ("loss", True)])
def test_attributes_that_make_no_sense_are_refused(tmp_path, name, value):
    graph = nx.path_graph(2)
    graph.edges[0, 1][name] = value
    with pytest.raises(ValueError):
        Edges.of(graph)
    with pytest.raises(ValueError):
        from_file(write(graph, tmp_path, "json"))


def test_a_number_is_a_constant_latency_or_a_probability_of_loss():
    assert as_model("latency", 2) == Constant(value=2.0)
    assert as_model("latency", np.float64(0.5)) == Constant(value=0.5)
    assert as_model("loss", 0.25) == Bernoulli(p=0.25)
    assert as_model("loss", Bernoulli(p=1.0)) == Bernoulli(p=1.0)
    assert as_model("order", "fifo") == "fifo"
    with pytest.raises(ValueError, match=r"order of an edge should be overtaking or fifo \(got 1\)"):
        as_model("order", 1)


def test_a_link_has_its_directions():
    lossy = {"loss": Bernoulli(p=0.5)}
    assert Link(src=2, dst=0, **lossy).ways() == [(2, 0)]
    assert Link(src=2, dst=0, both_ways=True, **lossy).ways() == [(2, 0), (0, 2)]


@pytest.mark.parametrize("made", [None, 3, [0, 1, 2], {0: [1], 1: [0], 2: []}])
def test_what_is_no_graph_of_networkx_is_refused(made):
    with pytest.raises(ValueError, match=f"simple graph of 3 nodes, got {type(made).__name__}, not a networkx.Graph"):
        graph_of(lambda size: made, 3)
