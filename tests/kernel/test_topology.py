"""Who can hear whom."""

import networkx as nx
import numpy as np
import pytest

from desim.kernel.topology import Topology


def test_without_a_range_the_graph_decides():
    topology = Topology(nx.star_graph(3))
    assert topology.neighbours(0).tolist() == [1, 2, 3]
    assert topology.neighbours(2).tolist() == [0]


def test_the_range_is_inclusive_and_follows_the_positions():
    """Nodes at 0, 3 and 7 m; 3 m apart is within a range of 3 m, 4 m is not until node 2 comes nearer."""
    at = np.array([[0.0, 0.0], [3.0, 0.0], [7.0, 0.0]])
    topology = Topology(nx.complete_graph(3), 3.0, lambda: at)
    assert [topology.neighbours(node).tolist() for node in range(3)] == [[1], [0], []]
    at[2] = [5.0, 0.0]
    assert [topology.neighbours(node).tolist() for node in range(3)] == [[1], [0, 2], [1]]
    assert set(topology.graph().edges) == {(0, 1), (1, 0), (1, 2), (2, 1)}


def test_a_link_needs_the_graph_and_the_range():
    at = np.zeros((3, 2))
    assert Topology(nx.path_graph(3), 1.0, lambda: at).neighbours(0).tolist() == [1]


def test_the_disk_graph_is_that_of_networkx():
    rng = np.random.default_rng(3)
    at = rng.random((60, 2))
    ours = Topology(nx.complete_graph(60), 0.2, lambda: at).graph().to_undirected()
    theirs = nx.random_geometric_graph(60, 0.2, pos=dict(enumerate(at.tolist())))
    assert set(map(frozenset, ours.edges)) == set(map(frozenset, theirs.edges))


def test_nodes_must_be_numbered_from_0():
    with pytest.raises(ValueError, match=r"0 \.\. 2"):
        Topology(nx.Graph([(1, 2), (2, 3)]))


def test_no_node_is_linked_to_itself():
    with pytest.raises(ValueError, match=r"linked to itself, got \[1\]"):
        Topology(nx.Graph([(0, 1), (1, 1)]))


def test_a_finite_range_needs_positions():
    with pytest.raises(ValueError, match="needs positions"):
        Topology(nx.complete_graph(2), 1.0)
