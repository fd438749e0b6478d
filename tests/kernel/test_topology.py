"""Who can hear whom."""

import networkx as nx
import numpy as np
import pytest

from desim.kernel.reach import LogDistance
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


def test_a_broadcast_reaches_the_neighbours_and_a_single_message_each_of_them():
    at = np.array([[0.0, 0.0], [3.0, 0.0], [7.0, 0.0]])
    topology = Topology(nx.complete_graph(3), 4.0, lambda: at)
    assert [topology.hearers(node) for node in range(3)] == [[1], [0, 2], [1]]
    assert [[topology.reaches(src, dst) for dst in range(3) if dst != src] for src in range(3)] == [
        [True, False],
        [True, True],
        [False, True],
    ]


def test_the_linked_are_those_of_the_graph_near_or_far():
    at = np.array([[0.0, 0.0], [1e6, 0.0], [2.0, 0.0]])
    topology = Topology(nx.star_graph(2), 1.0, lambda: at)
    assert topology.linked(0) == [1, 2]
    assert topology.hearers(0) == []


def test_arcs_of_a_directed_graph_are_heard_one_way():
    topology = Topology(nx.DiGraph([(0, 1), (1, 2), (2, 0)]))
    assert [topology.hearers(node) for node in range(3)] == [[1], [2], [0]]
    assert set(topology.graph().edges) == {(0, 1), (1, 2), (2, 0)}


@pytest.mark.parametrize("ask", [Topology.neighbours, Topology.hearers])
@pytest.mark.parametrize("node", [-1, 3])
def test_nobody_asks_for_a_node_that_does_not_exist(ask, node):
    with pytest.raises(IndexError):
        ask(Topology(nx.complete_graph(3)), node)


def test_a_frozen_link_is_there_while_its_pair_is_near_enough_and_comes_back():
    """The luck of a pair is fixed: with P(d) falling from 1 to 0 a link holds up to one distance, there and back."""
    at = np.zeros((2, 2))
    topology = Topology(
        nx.complete_graph(2), 10.0, lambda: at, lambda d, reach: np.clip(1 - d / 20.0, 0.0, 1.0), seed=4
    )
    heard = []
    for x in [*range(21), *reversed(range(21))]:
        at[1, 0] = x
        heard.append(topology.hearers(0) == [1])
    assert heard[:21] == heard[:20:-1] == sorted(heard[:21], reverse=True)
    assert heard[0]
    assert not heard[20]


def test_each_message_has_a_chance_of_its_own_that_follows_from_the_seed():
    """With fading per message, messages 0 to 4 are heard by different nodes, and each by the same again."""
    at = np.column_stack([np.arange(50.0), np.zeros(50)])

    def heard(seed):
        topology = Topology(nx.complete_graph(50), 10.0, lambda: at, LogDistance(), frozen=False, seed=seed)
        return [topology.hearers(0, message) for message in range(5)]

    assert heard(1) == heard(1)
    assert heard(1) != heard(2)
    assert len(set(map(tuple, heard(1)))) == 5
