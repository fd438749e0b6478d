"""Positions: of all nodes or of some, from a position source and from a plain function."""

from math import inf

import networkx as nx
import numpy as np
import pytest

from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import Trace
from desim.kernel.core.link_context import LinkContext
from desim.kernel.core.positions import PositionSource, as_position_source, distances_from
from desim.kernel.core.units import nanoseconds
from desim.kernel.models.latency import Uniform
from desim.kernel.models.links import Links
from desim.kernel.network import Network
from desim.kernel.state.fault_state import FaultState
from desim.kernel.topology.topology import Topology

AT = np.array([[0.0, 0.0], [3.0, 4.0], [-6.0, 8.0], [0.0, 1.0]])


class OfSome(PositionSource):
    """Positions that are never asked for all together, and note for how many."""

    max_speed = 0.0

    def __init__(self):
        self.asked = []

    def __call__(self):
        raise AssertionError("nobody should be asked for everybody's position")

    def of(self, nodes):
        self.asked.append(len(nodes))
        return AT[nodes]


def test_a_position_source_with_subset_queries_is_used_directly():
    some = OfSome()
    assert as_position_source(some) is some


def test_a_position_function_is_called_each_time_and_may_reuse_its_array_or_return_a_list():
    at = AT.copy()
    positions = as_position_source(lambda: at)
    assert positions.max_speed == inf
    assert positions.of(np.array([2, 0])).tolist() == [[-6.0, 8.0], [0.0, 0.0]]
    at[2] = [7.0, 7.0]
    assert positions.of(np.array([2])).tolist() == [[7.0, 7.0]]
    assert positions().tolist() == at.tolist()
    assert as_position_source(AT.tolist).of(np.array([1])).tolist() == [[3.0, 4.0]]


@pytest.mark.parametrize("trace", [None, Trace()], ids=["untraced", "traced"])
def test_a_position_function_is_asked_as_a_record_arrives_with_and_without_a_trace(trace):
    """A receiver of the first record leaves before it arrives, and is back when the record is read."""
    clock, at = Clock(), np.zeros((3, 2))
    links = Links(latency=Uniform(low=0.9, high=1.1), range=5.0, range_check="both")
    net = Network(clock, nx.complete_graph(3), links, positions=lambda: at, trace=trace)
    for t, x in ((0.5, 9.0), (1.5, 0.0)):
        Instant(clock, nanoseconds(t), Phase.DECISION).callbacks.append(lambda _, x=x: at[1].fill(x))
    net.publish(0, "first")
    clock.run(until=nanoseconds(2.0))
    net.publish(0, "second")
    assert not net.latest_records(1)
    assert net.message_counts().lost_by == {"out_of_range": 1}
    clock.run(until=nanoseconds(4.0))
    assert net.latest_records(1)[0][1].body == "second"


def test_distances_are_relative_to_one_node():
    """3-4-5 and 6-8-10 triangles."""
    assert distances_from(AT, 0).tolist() == [0.0, 5.0, 10.0, 1.0]
    assert distances_from(AT, -1).tolist() == [1.0, np.hypot(3.0, 3.0), np.hypot(6.0, 7.0), 0.0]


def test_a_transmission_asks_only_for_the_positions_of_its_ends():
    some = OfSome()
    assert LinkContext(0, np.array([1, 2]), positions=some).distances.tolist() == [5.0, 10.0]
    assert some.asked == [3]


def test_a_jamming_disc_asks_only_for_the_position_of_the_receiver():
    some = OfSome()
    fault_state = FaultState(some)
    fault_state.jam(((3.0, 3.0), 1.0))
    now = 0
    assert [fault_state.jammed(np.array([node]), now)[0] for node in range(4)] == [None, "jamming", None, None]
    assert fault_state.jammed(np.array([3, 1]), now) == [None, "jamming"]
    assert some.asked == [1, 1, 1, 1, 2]


@pytest.mark.parametrize("graph", [nx.star_graph(3), nx.DiGraph(nx.star_graph(3))])
def test_a_sparse_graph_asks_only_for_the_positions_of_linked_nodes(graph):
    some = OfSome()
    topology = Topology(graph, 5.0, some)
    assert topology.hearers(0) == [1, 3]
    assert topology.hearers(3) == [0]
    assert topology.audible(1) == [0]
    assert topology.reaches(1, [3, 0]) == [True, True]
    assert some.asked == [4, 2, 2, 3]
