"""Topology: links between nodes."""

from contextlib import contextmanager
from math import inf
from unittest.mock import patch

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desim.kernel.core.clock import Clock
from desim.kernel.core.positions import PositionSource
from desim.kernel.core.units import SECOND
from desim.kernel.models.graphs import Complete
from desim.kernel.models.links import Links
from desim.kernel.models.reception import Disk, LogDistance, QuasiUnitDisk
from desim.kernel.network import Network
from desim.kernel.topology import topology as topology_module
from desim.kernel.topology.kept_receivers import KeptReceivers
from desim.kernel.topology.topology import FEW, Topology


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


@pytest.mark.parametrize(
    ("graph", "reach", "why"),
    [
        (nx.Graph([(1, 2), (2, 3)]), inf, r"0 \.\. 2, got \[1, 2, 3\]$"),
        (nx.path_graph(["b", "a"]), inf, r"0 \.\. 1, got \['a', 'b'\]$"),
        (nx.path_graph(["x" * 30, "y"]), inf, r"got \['x{19}, 'y'\]$"),
        (nx.path_graph(range(10, 21)), inf, r"got \[10, 11, 12, 13, 14, 15, 16, 17, 18, 19, \.\.\.\]$"),
        (nx.path_graph(range(10, 20)), inf, r"got \[10, 11, 12, 13, 14, 15, 16, 17, 18, 19\]$"),
        (nx.Graph([(0, 1), (1, 1)]), inf, r"linked to itself, got \[1\]"),
        (nx.complete_graph(2), 1.0, "needs positions"),
        (nx.Graph(), inf, "at least 1 node"),
    ],
)
def test_a_graph_has_nodes_from_0_on_none_linked_to_itself_and_for_a_range_positions(graph, reach, why):
    with pytest.raises(ValueError, match=why):
        Topology(graph, reach)


def test_a_broadcast_reaches_the_neighbours_and_a_single_message_each_of_them():
    at = np.array([[0.0, 0.0], [3.0, 0.0], [7.0, 0.0]])
    topology = Topology(nx.complete_graph(3), 4.0, lambda: at)
    assert [topology.hearers(node) for node in range(3)] == [[1], [0, 2], [1]]
    assert [topology.reaches(src, [dst for dst in range(3) if dst != src]) for src in range(3)] == [
        [True, False],
        [True, True],
        [False, True],
    ]


def test_linked_nodes_are_those_of_the_graph_at_any_distance():
    at = np.array([[0.0, 0.0], [1e6, 0.0], [2.0, 0.0]])
    topology = Topology(nx.star_graph(2), 1.0, lambda: at)
    assert topology.linked(0) == [1, 2]
    assert topology.hearers(0) == []


def test_arcs_of_a_directed_graph_carry_messages_one_way():
    topology = Topology(nx.DiGraph([(0, 1), (1, 2), (2, 0)]))
    assert [topology.hearers(node) for node in range(3)] == [[1], [2], [0]]
    assert set(topology.graph().edges) == {(0, 1), (1, 2), (2, 0)}


@pytest.mark.parametrize("ask", [Topology.neighbours, Topology.hearers, Topology.audible, Topology.component])
@pytest.mark.parametrize("node", [-1, 3])
def test_a_query_about_a_node_that_does_not_exist_is_refused(ask, node):
    for graph in (nx.complete_graph(3), nx.DiGraph([(0, 1), (1, 2), (2, 0)])):
        with pytest.raises(IndexError):
            ask(Topology(graph), node)


def test_a_per_link_faded_link_exists_while_its_pair_is_near_enough():
    """The uniform of a pair is fixed: with P(d) falling from 1 to 0 a link holds up to one distance, there and back."""
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
    """With fading per message, messages 0 to 4 reach different nodes, and each the same ones again."""
    at = np.column_stack([np.arange(50.0), np.zeros(50)])

    def receivers_of_each(seed):
        topology = Topology(nx.complete_graph(50), 10.0, lambda: at, LogDistance(), per_link=False, seed=seed)
        return [topology.hearers(0, message) for message in range(5)]

    assert receivers_of_each(1) == receivers_of_each(1)
    assert receivers_of_each(1) != receivers_of_each(2)
    assert len(set(map(tuple, receivers_of_each(1)))) == 5


# Many nodes: near candidates are looked up, and the answers are those of all distances.


@contextmanager
def many(few=0):
    """Let more nodes than so few be many."""
    with patch.object(topology_module, "SMALL_NETWORK", few):
        yield


class Flying(PositionSource):
    """Every node moves straight at 3 m/s, the maximum; counts the positions queried."""

    max_speed = 3.0

    def __init__(self, at, seed=0):
        angles = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(at))
        self.at, self.velocities = at, 3.0 * np.column_stack([np.cos(angles), np.sin(angles)])
        self.now, self.asked = 0.0, []

    def __call__(self):
        self.asked.append(len(self.at))
        return self.at + self.velocities * self.now

    def of(self, nodes):
        self.asked.append(len(nodes))
        return self.at[nodes] + self.velocities[nodes] * self.now


def scattered(size, seed=0, side=40.0):
    return np.random.default_rng(seed).uniform(-side / 2, side / 2, (size, 2))


def answers(topology, message):
    """Return the answers of a topology to all queries."""
    nodes = range(topology.size)
    return (
        [topology.hearers(node, message) for node in nodes],
        [topology.neighbours(node).tolist() for node in nodes],
        [topology.audible(node) for node in nodes],
        topology.reaches(0, list(nodes), message),
        topology.mean_degree,
        sorted(topology.graph().edges),
    )


@pytest.mark.slow_but_one
@pytest.mark.parametrize("per_link", [True, False])
@pytest.mark.parametrize("model", [Disk(), QuasiUnitDisk(), LogDistance(), lambda d, r: np.exp(-d / r)])
@pytest.mark.parametrize("knows", ["speed", "all", "in place"])
def test_queries_with_many_nodes_equal_those_with_few(model, per_link, knows):
    flying, shown = Flying(scattered(60)), scattered(60)
    tell = {"speed": flying, "all": flying.__call__, "in place": lambda: shown}[knows]
    given = {"per_link": per_link, "seed": 3, "now": lambda: flying.now}
    few = Topology(nx.complete_graph(60), 6.0, tell, model, **given)
    with many():
        lots = Topology(Complete()(60), 6.0, tell, model, **given)
    for message, flying.now in enumerate([0.0, 0.2, 0.3, 2.0, 2.0, 9.0]):
        shown[:] = flying()
        assert answers(lots, message) == answers(few, message)
    assert answers(few, 0) != answers(Topology(nx.complete_graph(60), 6.5, tell, model, **given), 0)


@pytest.mark.slow
@settings(max_examples=50)
@given(st.data(), st.integers(1, 7), st.sampled_from([0.0, 1e-9, 1.0, 5.0, 1e9]))
def test_a_disk_holds_just_those_whose_distance_is_at_most_the_range(data, size, reach):
    """On a grid of the range, on both sides of its lines, at one place, 1e9 m away; the graph is complete or not."""
    unit = reach if 0.0 < reach < 1e9 else 1.0
    near = st.integers(-3, 3).map(lambda k: k * unit)
    random_heading = st.one_of(near, near.map(lambda x: np.nextafter(x, 9.0)), st.floats(-3.0, 3.0), st.just(-1e9))
    at = np.zeros((size, 2))
    graph = nx.gnp_random_graph(size, data.draw(st.sampled_from([0.5, 1.0])), seed=1)
    with many():
        topology = Topology(graph, reach, lambda: at)
    for _ in range(3):
        at[:] = np.array(data.draw(st.lists(random_heading, min_size=2 * size, max_size=2 * size))).reshape(size, 2)
        for node in range(size):
            apart = np.hypot(*(at - at[node]).T)
            theory = [other for other in range(size) if other in graph.adj[node] and apart[other] <= reach]
            assert topology.hearers(node) == topology.audible(node) == theory


@pytest.mark.parametrize("size", [1000, 4000])
def test_a_question_costs_the_same_whatever_the_number_of_nodes(size):
    """At one density, with 20 in reach: all are looked at once, at the start, then those in nine cells, 90 or so."""
    flying = Flying(scattered(size, side=10.0 * (np.pi * size / 20) ** 0.5))
    topology = Topology(Complete()(size), 10.0, flying, now=lambda: flying.now)
    assert flying.asked == [size]
    for node in range(size):
        topology.hearers(node)
    assert max(flying.asked[1:]) < 200


def test_a_reception_model_without_a_maximum_range_is_queried_for_all_nodes():
    flying = Flying(scattered(60))
    with many():
        topology = Topology(Complete()(60), 1.0, flying, lambda d, r: np.ones_like(d), now=lambda: flying.now)
    assert topology.hearers(7) == [node for node in range(60) if node != 7]
    assert flying.asked == [60]


def test_no_reception_model_is_evaluated_for_a_node_and_itself():
    """A probability of (R / d)^2 has no value at d = 0."""
    at = np.array([[0.0, 0.0], [1.0, 0.0], [4.0, 0.0]])
    topology = Topology(
        nx.complete_graph(3), 2.0, lambda: at, lambda d, r: np.minimum((r / d) ** 2, 1.0), per_link=False
    )
    assert topology.neighbours(0).tolist() == [1]


# Few nodes that move slowly: receivers are kept while no link can have crossed its border.


class Wandering(PositionSource):
    """Nodes that move at 2 m/s, which they claim as their maximum, or less, and turn at times."""

    def __init__(self, size, claimed=2.0):
        self._rng, self.max_speed, self.now = np.random.default_rng(0), claimed, 0.0
        self.at, self._velocity = self._rng.uniform(0.0, 15.0, (size, 2)), np.zeros((size, 2))

    def step(self, duration):
        if self._rng.random() < 0.2:
            turns = self._rng.uniform(0.0, 2.0 * np.pi, len(self.at))
            self._velocity = 2.0 * np.column_stack([np.cos(turns), np.sin(turns)])
        self.now += duration
        self.at = (self.at + self._velocity * duration).clip(0.0, 15.0)

    def __call__(self):
        return self.at


def differences(wandering, graph, model, steps=400):
    """Return the number of steps at which a topology that may keep receivers answers otherwise than one that does not.

    Also return how many searches it made, per query.
    """
    given = {"reception": model, "seed": 3}
    keeps = Topology(graph, 6.0, wandering, **given, now=lambda: wandering.now)
    searches = Topology(graph, 6.0, wandering, **given)
    size, wrong, rng = len(graph), 0, np.random.default_rng(1)
    with patch.object(Topology, "_distances", autospec=True, side_effect=Topology._distances) as search:
        for _ in range(steps):
            node, other = rng.integers([3, size]).tolist()
            answers = [
                (
                    topology.hearers(node),
                    topology.neighbours(node).tolist(),
                    topology.audible(node),
                    topology.reaches(node, [other]) if other in graph.adj[node] else None,
                    topology.reaches(node, others := sorted(graph.adj[node])),
                    topology.reaches(node, others[::-1]),
                )
                for topology in (keeps, searches)
            ]
            wrong += answers[0] != answers[1]
            wandering.step(rng.choice([0.0, 0.01, 0.05]))
    return wrong, (sum(call.args[0] is keeps for call in search.call_args_list)) / (3 * steps)


@pytest.mark.parametrize("graph", [nx.complete_graph(8), nx.cycle_graph(8), Complete()(8)])
@pytest.mark.parametrize("model", [None, QuasiUnitDisk(certain=0.6), QuasiUnitDisk(certain=1.0), QuasiUnitDisk(p=1.0)])
@pytest.mark.slow_but_one
def test_receivers_that_are_kept_are_those_of_a_search_at_each_query(graph, model):
    wrong, share = differences(Wandering(8), graph, model)
    assert wrong == 0
    assert share < 0.6


def test_receivers_are_wrong_after_a_time_if_nodes_are_faster_than_they_claim():
    """The control of the test above."""
    assert differences(Wandering(8, claimed=0.2), Complete()(8), None, steps=200)[0] > 10


def early_changes(wandering, steps=400):
    """Return how often receivers changed before the time that was told, and how often there was such a time."""
    topology, wrong, certain = Topology(Complete()(8), 6.0, wandering, now=lambda: wandering.now), 0, 0
    searches = Topology(Complete()(8), 6.0, wandering)
    since = [(set(), 0.0)] * 8
    for step in range(steps):
        for node, (receivers, until) in enumerate(since):
            wrong += wandering.now * SECOND < until and set(searches.hearers(node)) != receivers
        node = step % 8
        since[node] = topology.steady_receivers(node)
        certain += since[node][1] > wandering.now * SECOND
        wandering.step(0.01)
    return wrong, certain


def test_receivers_stay_the_same_until_the_time_that_is_told():
    """The control: nodes that are ten times as fast as they claim."""
    wrong, certain = early_changes(Wandering(8))
    assert wrong == 0
    assert certain > 200
    assert early_changes(Wandering(8, claimed=0.2))[0] > 10


@pytest.mark.parametrize(
    "given", [{"max_speed": inf}, {"reception": LogDistance()}, {"per_link": False, "reception": QuasiUnitDisk()}, {}]
)
def test_nothing_is_kept_if_links_may_change_at_any_time_or_have_no_border(given):
    """Without a bound of the speed, without a border, with draws for each message, and without the time."""
    wandering = Wandering(4, given.pop("max_speed", 2.0))
    knows_time = bool(given) or wandering.max_speed == inf
    topology = Topology(Complete()(4), 6.0, wandering, **given, now=(lambda: 0.0) if knows_time else None)
    assert topology._kept is None
    assert topology.steady_receivers(0) == (set(), 0.0)


@pytest.mark.parametrize("queries", [1, 2])
def test_queries_of_one_broadcast_count_once_in_the_pause_between_two_searches(queries):
    """Receivers that change at once: after 1, 2, 4, ..., 64 broadcasts those of the next are kept."""
    now, found = 0.0, []
    kept = KeptReceivers(8, 2.0, lambda: now)
    for broadcast in range(300):
        now = float(broadcast)
        for _ in range(queries):
            assert kept.of(0) is None
            if kept.is_worthwhile(0):
                kept.keep(0, [1], 0.0)
                found.append(broadcast)
    assert found == [0, 2, 6, 14, 30, 62, 126, 190, 254]


def test_receivers_of_nodes_that_stand_still_are_searched_for_once():
    standing = Wandering(8, claimed=0.0)
    topology = Topology(Complete()(8), 6.0, standing, now=lambda: standing.now)
    for _ in range(200):
        topology.hearers(3)
    standing.now = 1e9
    assert topology.hearers(3) is topology.hearers(3)


# Graphs without a range.


def test_all_other_nodes_are_linked_in_a_complete_graph_of_any_size():
    for graph in (nx.complete_graph(5), Complete()(5), nx.complete_graph(5, nx.DiGraph)):
        topology = Topology(graph)
        for node in range(5):
            others = [other for other in range(5) if other != node]
            assert topology.linked(node) == topology.hearers(node) == topology.audible(node) == others
            assert topology.neighbours(node).tolist() == others
        assert set(topology.graph().edges) == set(nx.complete_graph(5, nx.DiGraph).edges)
        assert topology.mean_degree == 4.0


def test_neighbour_lists_are_cached_for_few_nodes_and_up_to_a_limit_for_many():
    few = Topology(Complete()(5))
    assert all(few.linked(node) is few.linked(node) for node in range(5))
    with patch.object(topology_module, "ROOM", 12):
        many = Topology(Complete()(5))
        assert [many.linked(node) is many.linked(node) for node in range(5)] == [True, True, False, False, False]
        assert many.linked(3) == [0, 1, 2, 4]


def test_pair_uniforms_are_the_same_with_and_without_caching():
    at = scattered(40)
    kept = Topology(nx.complete_graph(40), 10.0, lambda: at, LogDistance(), seed=2)
    with patch("desim.kernel.topology.range_check.ROOM", 100):
        scarce = Topology(nx.complete_graph(40), 10.0, lambda: at, LogDistance(), seed=2)
        assert [scarce.hearers(node) for node in range(40)] == [kept.hearers(node) for node in range(40)]
        assert len(scarce._range_check._drawn) == 2


@pytest.mark.parametrize(
    "graph", [nx.complete_graph(6), nx.path_graph(6), nx.DiGraph([(0, 1), (1, 2), (2, 0), (0, 2)])]
)
def test_two_nodes_are_linked_if_the_graph_says_so(graph):
    topology, nodes = Topology(graph), range(len(graph))
    assert all(topology.are_linked(src, dst) == graph.has_edge(src, dst) for src in nodes for dst in nodes)


@pytest.mark.parametrize("reach", [inf, 15.0])
@pytest.mark.parametrize("model", [Disk(), LogDistance()])
def test_on_a_directed_graph_the_audible_nodes_are_those_with_an_arc_to_the_receiver(reach, model):
    at, graph = scattered(30), nx.gnp_random_graph(30, 0.4, seed=2, directed=True)
    topology = Topology(graph, reach, lambda: at, model, seed=1)
    now = topology.graph()
    assert 0 < now.number_of_edges() < (graph.number_of_edges() if reach < inf else inf)
    assert [topology.audible(node) for node in range(30)] == [sorted(now.pred[node]) for node in range(30)]
    assert topology.mean_degree == now.number_of_edges() / 30


def test_later_changes_to_a_given_graph_have_no_effect():
    graph = nx.path_graph(3)
    topology = Topology(graph)
    graph.add_edge(0, 2)
    assert topology.hearers(0) == [1]
    assert not topology.are_linked(0, 2)


@pytest.mark.slow
def test_the_setup_cost_of_a_network_does_not_grow_with_the_number_of_pairs():
    """A hundred thousand nodes: no query iterates over the edges, or over more nodes than the audible ones."""
    with patch.object(nx.Graph, "edges", property(lambda graph: pytest.fail("somebody walks along all edges"))):
        network = Network(Clock(), Complete()(10**5))
        assert network.estimates.mean_degree == 10**5 - 1
        assert len(network.topology.component(5)) == 10**5


def test_in_a_network_of_many_nodes_time_passes():
    """Node 1 comes at 3 m/s from 30 m away and is within 6 m between 8 s and 12 s."""
    clock, flying = Clock(), Flying(np.array([[0.0, 0.0], [30.0, 0.0]]))
    flying.velocities = np.array([[0.0, 0.0], [-3.0, 0.0]])
    with many():
        network = Network(clock, Complete()(2), Links(range=6.0), positions=flying)
    heard = []
    for second in range(14):
        clock.run(until=second * SECOND + 1)
        flying.now = second
        heard.append(network.topology.neighbours(0).tolist() == [1])
    assert heard == [8 <= second <= 12 for second in range(14)]


class Counting(PositionSource):
    """Nodes that stand, whose distances are asked for one by one."""

    def __init__(self, places):
        self._places, self.distances = places, 0

    def __call__(self):
        return self._places

    def distance(self, node, other):
        self.distances += 1
        return super().distance(node, other)


@pytest.mark.parametrize("per_link", [True, False])
@pytest.mark.parametrize("model", [Disk(), QuasiUnitDisk(), LogDistance()])
def test_several_messages_reach_what_each_of_them_reaches(model, per_link):
    """(k,) senders, receivers and numbers at once, one sender at once, and one pair after the other."""
    places, rng = scattered(12, side=20.0), np.random.default_rng(1)
    topology = Topology(nx.complete_graph(12), 8.0, lambda: places, model, per_link=per_link, seed=5)
    src, dst, number = rng.integers(12, size=(3, 200))
    of_each = [
        topology.reaches(s, [d], k)[0] for s, d, k in zip(src.tolist(), dst.tolist(), number.tolist(), strict=True)
    ]
    assert topology.reaches(src, dst, number, 0) == of_each
    several = topology.reaches(3, dst, 7, 0)
    assert topology.reaches(3, dst.tolist(), 7) == several
    counted = Counting(places)
    topology = Topology(nx.complete_graph(12), 8.0, counted, model, per_link=per_link, seed=5)
    for count in range(1, FEW + 2):
        for receivers in (dst[:count], dst[:count].tolist()):
            assert topology.reaches(3, receivers, 7) == several[:count]
    assert counted.distances == 2 * sum(range(1, FEW + 1))
    assert 0 < sum(of_each) < 200
