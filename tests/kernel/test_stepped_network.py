"""The network in the loop of another simulator: it is the network of desim, whatever the steps."""

import copy
import gc
import pickle
import subprocess
import sys
from contextlib import redirect_stdout
from functools import partial
from io import StringIO
from math import inf, nan, pi, sqrt
from threading import Thread

import networkx as nx
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import (
    BestEffort,
    Bitrate,
    ClockSkew,
    Crash,
    CsmaCa,
    Edges,
    GilbertElliott,
    Jamming,
    Links,
    Lognormal,
    MessageFault,
    Partition,
    Propagation,
    RandomCrashes,
    Reliable,
    SteppedNetwork,
    SteppedNetworks,
    Tdma,
    Uniform,
    Wall,
    load,
    run,
)
from desim.config.model import MAX_TIME
from desim.kernel.core.clock import GC_THRESHOLDS, Clock, Instant, Phase
from desim.kernel.core.events import Broadcast, Delivered, Lost, MessageCounts, Sent, Trace
from desim.kernel.core.seeds import run_seed
from desim.kernel.core.units import SECOND
from desim.kernel.fault_injection import inject
from desim.kernel.network import Network
from desim.kernel.state.fault_state import FaultState
from desim.testing.messages import Conservation, DeliveredOnce
from scenarios.studies.study import SCENARIOS

LINKS = {
    "ideal": Links(),
    "lognormal": Links(latency=Lognormal(mean=0.05, cv=0.5), loss=0.1),
    "range": Links(latency=Uniform(low=0.0, high=0.3), range=6.0, range_check="both"),
    "checked late": Links(latency=0.07, range=6.0, range_check="delivery"),
    "by distance": Links(latency=Propagation(fixed=0.01, speed=30.0), range=8.0),
    "bursts": Links(latency=0.05, loss=GilbertElliott(), order="fifo"),
    "twice": Links(latency=Lognormal(mean=0.05, cv=0.5), duplicate=0.3),
    "half duplex": Links(medium=Bitrate(bitrate=20_000.0, half_duplex=True), latency=Uniform(low=0.0, high=0.05)),
    "contention": Links(medium=Bitrate(bitrate=1e5, access=CsmaCa()), range=9.0),
    "slots": Links(medium=Bitrate(bitrate=1e5, access=Tdma())),
    "reliable": Links(latency=Lognormal(mean=0.02, cv=0.5), loss=0.3, transport=Reliable()),
}
FAULTS = {
    "none": (),
    "all": (
        Crash(start=0.25, end=0.62, node=1, memory=False),
        Partition(start=0.4, end=0.9, groups=((0, 1), (2, 3))),
        Jamming(start=0.5, end=1.3, centre=(0.0, 0.0), radius=3.0),
    ),
}
SIZE, PERIOD, ROUNDS = 4, 0.2, 8
START = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 3.0], [4.0, 4.0]])
VELOCITY = np.array([[0.5, 0.0], [4.0, 0.0], [0.0, -1.0], [-2.0, -3.0]])


def played(links, faults=(), seed=5, parts=1, trace=None, **options):
    """Return all that arrives and all that is lost; each period is stepped in parts."""
    network = SteppedNetwork(SIZE, links, faults=faults, seed=seed, positions=START, trace=trace, **options)
    arrived, lost = [], []
    for k in range(ROUNDS * parts):
        if k % parts == 0:
            for node in range(SIZE):
                network.send(node, None, (node, k // parts))
            network.send(0, 3, "to one", port="other")
        messages = network.step(PERIOD / parts, START + VELOCITY * (k + 1) * PERIOD / parts)
        assert all(network.now - PERIOD / parts - 1e-12 <= message.arrived <= network.now for message in messages)
        arrived += messages
        lost += network.lost()
    counts = network.counts()
    network.close()
    assert len(lost) + (counts.lost - sum(counts.lost_by.values())) <= counts.lost
    return arrived, sorted(lost, key=lambda message: (message.sent, message.src, message.dst, message.port)), counts


def in_its_own_process(links, faults, seed=5):
    """Return what arrives in a plain `Network` whose senders are processes, one event per arrival."""
    clock, trace = Clock(), Trace()
    now = lambda: START + VELOCITY * clock.now / SECOND  # noqa: E731
    state = FaultState(now) if faults else None
    graph = nx.complete_graph(SIZE)
    network = Network(clock, graph, links, seed=seed, positions=now, trace=trace, fault_state=state)
    inject(faults, clock, network)

    def talk():
        for k in range(ROUNDS):
            yield Instant(clock, round(k * PERIOD * SECOND), Phase.DECISION + 1)
            for node in range(SIZE):
                network.send(node, None, (node, k))
            network.send(0, 3, "to one", port="other")

    clock.process(talk())
    clock.run(until=round(ROUNDS * PERIOD * SECOND) + 1)
    return fates(trace, clock.now), network.message_counts()


def fates(trace, until):
    """Return sender, receiver, body, time of sending and of arrival of all messages of a trace that arrive in time."""
    lost = {(event.transmission, event.dst) for event in trace.of(Lost)}
    arrived = [
        (event.src, event.dst, event.body, event.created / SECOND, event.arrival / SECOND)
        for event in trace.of(Sent)
        if (event.transmission, event.dst) not in lost and event.arrival < until
    ]
    if delivered := trace.of(Delivered):
        arrived = [(event.src, event.dst, event.body, event.created / SECOND, event.t / SECOND) for event in delivered]
    return sorted(arrived, key=repr)


CASES = pytest.mark.parametrize(
    ("links", "faults"),
    [(links, faults) for links in LINKS.values() for faults in FAULTS.values()],
    ids=[f"{links}, {faults}" for links in LINKS for faults in FAULTS],
)


def plain(messages):
    return sorted((message[:5] for message in messages), key=repr)


@pytest.mark.slow
@CASES
def test_a_stepped_network_is_the_network_of_a_process(links, faults):
    expected, counts = in_its_own_process(links, faults)
    arrived, _, same = played(links, faults)
    assert plain(arrived) == expected
    assert len(expected) > 2
    assert counts._replace(t=0, utilisation=0, in_flight=0) == same._replace(t=0, utilisation=0, in_flight=0)


def ages_of(network):
    """Return the ages by the states that each node has received."""
    ages = np.where(np.eye(SIZE, dtype=bool), 0.0, inf)
    for node in range(SIZE):
        for src, message in network.latest(node).items():
            ages[node, src] = network.now - message.sent
    return ages


@CASES
def test_ages_are_those_of_the_newest_states_whichever_is_read_first(links, faults):
    """Two equal networks: one is asked for ages, the other for states, and for the counts before them."""
    asked, other = (SteppedNetwork(SIZE, links, faults=faults, seed=5, positions=START) for _ in range(2))
    for k in range(4 * ROUNDS):
        for network in (asked, other):
            network.publish(k % SIZE, k)
            network.step(PERIOD / 4, START + VELOCITY * (k + 1) * PERIOD / 4)
        counts = other.counts()
        assert asked.ages() == pytest.approx(ages_of(other), abs=1e-9)
        assert asked.counts() == counts
    assert np.isfinite(asked.ages()).sum() > SIZE + 2
    asked.close()
    other.close()


def test_the_comparison_detects_another_seed():
    links = LINKS["lognormal"]
    assert plain(played(links)[0]) != in_its_own_process(links, (), seed=6)[0]


@pytest.mark.whole_but_one
@pytest.mark.slow
@CASES
def test_arrivals_do_not_depend_on_the_step_nor_on_a_trace(links, faults):
    arrived, lost, counts = played(links, faults)
    for parts in (2, 5):
        assert played(links, faults, parts=parts) == (arrived, lost, counts)
    watchers = [Conservation(), DeliveredOnce()]
    trace = Trace(watchers)
    assert played(links, faults, parts=4, trace=trace)[0] == arrived
    assert trace.of(MessageCounts)[-1].delivered == counts.delivered
    again = played(links, faults, can_leave=True)
    assert (again[0], again[2]) == (arrived, counts)


@given(st.lists(st.floats(1e-6, 0.2), min_size=1, max_size=30), st.sampled_from(sorted(LINKS)))
def test_each_message_is_reported_once_by_the_step_in_which_it_arrives(durations, name):
    network = SteppedNetwork(SIZE, LINKS[name], faults=FAULTS["all"], positions=START)
    bodies = 0
    seen = set()
    for dt in durations:
        before = network.now
        for node in range(SIZE):
            network.send(node, None, bodies)
            bodies += 1
        messages = network.step(dt)
        assert [message.arrived for message in messages] == sorted(message.arrived for message in messages)
        for message in messages:
            assert message.sent <= message.arrived
            assert before <= message.arrived <= network.now
            identity = message.body, message.dst, *([message.arrived] if name == "twice" else [])
            assert identity not in seen
            seen.add(identity)


@pytest.mark.parametrize(
    ("file", "changes"),
    [("relay", ["horizon=2.0"]), pytest.param("imperfect", ["motion.static=true"], marks=pytest.mark.slow)],
)
def test_what_a_pursuit_sends_arrives_as_in_the_pursuit(file, changes):
    """A loop publishes at the instants of the announcements of a run; the control has another seed."""
    scenario = load(SCENARIOS / f"{file}.toml", ["record.messages=true", *changes])
    trace = run(scenario, 3).trace
    sent = sorted(trace.of(Broadcast), key=lambda event: event.transmission)
    assert len(sent) > 50
    assert repeated(scenario, sent, 3) == kept(trace)
    assert repeated(scenario, sent, 4) != kept(trace)


def kept(trace):
    """Return all that a trace has about messages, up to the last transmission: later, the run has ended.

    Sequence numbers also count what a node publishes while it is down, and which is not transmitted.
    """
    events = [event._replace(seq=0) if type(event) is Broadcast else event for event in trace]
    last = max(event.t for event in events if type(event) is Broadcast)
    return [event for event in events if type(event) in {Broadcast, Lost} and event.t <= last]


def repeated(scenario, sent, seed):
    """Publish some announcements at their times, and return what the trace has about them."""
    trace, start = Trace(), scenario.team.start(3)
    count, faults = scenario.team.count, scenario.network_faults
    options = {"faults": faults, "seed": seed, "positions": start, "horizon": scenario.horizon, "trace": trace}
    with SteppedNetwork(count, scenario.network, **options) as network:
        for event in sent:
            if wait := event.created - round(network.now * SECOND):
                network.step(wait / SECOND)
            network.publish(event.src, event.body, size=event.size)
        network.step(1.0)
    return kept(trace)


@pytest.mark.slow
def test_a_loop_sees_the_mean_latency_and_half_a_step():
    """A message waits for the end of its step; the control is the exact time of its arrival."""
    dt, mean = 0.02, 0.1
    network = SteppedNetwork(2, Links(latency=Lognormal(mean=mean, cv=0.5)), seed=1)
    seen, exact = [], []
    for _ in range(4000):
        network.send(0, 1, None)
        for message in network.step(dt):
            seen.append(network.now - message.sent)
            exact.append(message.arrived - message.sent)
    error = np.std(seen) / sqrt(len(seen))
    assert abs(np.mean(seen) - (mean + dt / 2)) < 3 * error
    assert abs(np.mean(exact) - mean) < 3 * error
    assert abs(np.mean(exact) - (mean + dt / 2)) > 3 * error


# Positions.


@pytest.mark.parametrize("check", ["send", "delivery", "both"])
def test_a_pair_that_moves_apart_is_not_heard_unless_its_positions_are_frozen(check):
    def heard(moves):
        network = SteppedNetwork(2, Links(latency=0.01, range=5.0, range_check=check), positions=START[:2])
        messages = []
        for k in range(20):
            network.send(0, 1, k)
            messages += network.step(0.1, START[:2] + VELOCITY[:2] * 0.1 * (k + 1) * moves)
        return [message.body for message in messages], network.neighbours(0)

    last = 8  # apart 2 + 3.5 t: 5 m at 0.857 s
    assert heard(1) == ([*range(last + 1)], [])
    assert heard(0) == ([*range(20)], [1])


def test_an_array_that_is_changed_in_place_is_read_at_each_step():
    x = np.zeros((2, 2))
    network = SteppedNetwork(2, Links(range=5.0), positions=x)
    x[1] = 100.0, 0.0
    network.send(0, 1, "while it is there")
    assert [message.body for message in network.step(0.1)] == ["while it is there"]
    network.send(0, 1, "when it has gone")
    assert network.step(0.1) == []
    assert network.lost() == [(0, 1, "when it has gone", 0.1, "out_of_range", "")]
    assert x.flags.writeable


def test_a_node_passes_through_the_range_within_a_step():
    """Apart -10 .. 10 m in one step of 2 s: within 5 m from 0.5 s to 1.5 s."""
    heard = []
    for latency in (0.4, 0.6, 1.4, 1.6):
        links = Links(latency=latency, range=5.0, range_check="delivery")
        network = SteppedNetwork(2, links, positions=[[0, 0], [-10, 0]])
        network.send(0, 1, None)
        heard += [len(network.step(2.0, [[0, 0], [10, 0]]))]
    assert heard == [0, 1, 1, 0]


def test_the_place_at_the_end_of_a_step_is_not_rounded():
    """A node ends its step just within the range, where start + (end - start) is beyond it."""
    end = 0.7
    start = next(x for x in (k / 977.0 for k in range(1, 2000)) if -x + (end + x) > end)
    network = SteppedNetwork(
        2, Links(latency=0.1, range=end, range_check="delivery"), positions=[[0, 0], [-start, 0]], trace=Trace()
    )
    network.send(0, 1, None)
    assert len(network.step(0.1, [[0, 0], [end, 0]])) == 1


# What arrives, and what does not.


@pytest.mark.parametrize("check", ["send", "delivery"])
def test_the_end_of_a_step_belongs_to_it(check):
    network = SteppedNetwork(2, Links(latency=0.1, range=9.0, range_check=check), positions=START[:2])
    network.send(0, 1, "due at the end")
    assert [message.arrived for message in network.step(0.1)] == [network.now]
    assert network.step(0.1) == []


def test_everything_at_once_and_nothing_ever_are_links():
    best, worst = SteppedNetwork(5, Links()), SteppedNetwork(5, Links(loss=1.0))
    for network in (best, worst):
        network.send(2, None, "x")
        network.publish(2, "state")
    assert [message[:5] for message in best.step(0.01)] == [(2, dst, "x", 0.0, 0.0) for dst in (0, 1, 3, 4)]
    assert worst.step(0.01) == []
    assert best.ages()[:, 2].tolist() == [0.01, 0.01, 0.0, 0.01, 0.01]
    assert worst.ages()[:, 2].tolist() == [inf, inf, 0.0, inf, inf]
    assert len(worst.lost()) == worst.counts().lost == 8
    assert best.latest(0) == {2: (2, 0, "state", 0.0, 0.0, "")}
    assert worst.latest(0) == {}


def test_losses_are_listed_once_with_their_causes():
    links = Links(latency=Lognormal(mean=0.3, cv=0.5), loss=0.2, range=6.0, range_check="both")
    network = SteppedNetwork(SIZE, links, faults=FAULTS["all"], positions=START)
    causes = {}
    for k in range(10):
        for node in range(SIZE):
            network.send(node, None, k)
            network.publish(node, k)
        network.step(0.2, START + VELOCITY * 0.1 * (k + 1))
        for lost in network.lost():
            causes[lost.cause] = causes.get(lost.cause, 0) + 1
    assert causes == network.counts().lost_by
    assert len(causes) >= 4


def test_frames_that_a_transport_repeats_are_not_among_the_lost():
    network = SteppedNetwork(2, Links(loss=0.8, transport=Reliable()), seed=1)
    network.send(0, 1, "x")
    assert [message.body for message in network.step(10.0)] == ["x"]
    assert network.counts().lost > 0
    assert network.lost() == []


def test_any_labels_name_the_nodes():
    graph = nx.Graph([("base", ("drone", 1)), (("drone", 1), 7)])
    graph.add_edge("base", 7, latency=0.5)
    network = SteppedNetwork(graph, Links(latency=0.1))
    assert set(network.nodes) == set(graph)
    network.send(7, None, "hello")
    network.publish("base", 3)
    assert [message[:5] for message in network.step(0.2)] == [(7, ("drone", 1), "hello", 0.0, 0.1)]
    assert network.latest(("drone", 1))["base"][:3] == ("base", ("drone", 1), 3)
    assert sorted(map(str, network.neighbours("base"))) == ["('drone', 1)", "7"]
    row = network.nodes.index(7)
    assert network.ages()[row, network.nodes.index("base")] == inf
    assert [message[:2] for message in network.step(0.4)] == [(7, "base")]
    with pytest.raises(ValueError, match="there is no node 'nobody': the nodes are"):
        network.send("nobody", None, "")
    with pytest.raises(ValueError, match="there is no node"):
        network.send(["unhashable"], None, "")


def test_positions_may_be_a_dict_by_node_and_are_read_at_each_step():
    graph = nx.complete_graph(["c", "a", "b"])
    places = {"a": (0.0, 0.0), "b": (1.0, 0.0), "c": np.array([2.0, 0.0])}
    network = SteppedNetwork(graph, Links(range=1.5), positions=places)
    assert network.neighbours("a") == ["b"]
    places["b"] = (9.0, 0.0)
    places["c"][0] = 1.0
    network.step(0.1)
    assert network.neighbours("a") == ["c"]
    assert len(network.step(0.1, {"a": (0.0, 0.0), "b": (1.0, 0.0), "c": (9.0, 0.0), "other": None})) == 0
    assert network.neighbours("a") == ["b"]
    with pytest.raises(ValueError, match="a place for each node: there is none for 'b'"):
        network.step(0.1, {"a": (0.0, 0.0), "c": (9.0, 0.0)})


class Centimetres(np.ndarray):
    unit = "cm"

    def tolist(self):
        raise NotImplementedError


def test_positions_may_be_in_tables_whose_columns_and_rows_have_names():
    """Columns by the names of coordinates, and rows of pandas by the labels of nodes; b is next to a, and c is far."""
    places = np.array([[0.0, 3.0], [0.0, 1.0], [0.0, 99.0]])
    table = pd.DataFrame(places[:, ::-1], columns=["y", "x"], index=["a", "b", "c"])
    for positions in (places, table, table.loc[["c", "a", "b"]], table[["x", "y"]], iter(places.tolist())):
        network = SteppedNetwork(nx.complete_graph(["a", "b", "c"]), Links(range=5.0), positions=positions)
        network.step(0.1)
        network.send("a", None, "hi")
        assert [message.dst for message in network.step(0.1)] == ["b"]


@pytest.mark.parametrize(
    "hide", [lambda places: places.view(Centimetres), lambda places: np.ma.array(places, mask=True)]
)
def test_numbers_with_units_and_masked_ones_are_no_positions_and_no_bodies(hide):
    with pytest.raises(ValueError, match="positions should be an array of numbers"):
        SteppedNetwork(3, positions=hide(np.zeros((3, 2))))
    network = SteppedNetwork(3, positions=np.zeros((3, 2)))
    with pytest.raises(ValueError, match="positions should be an array of numbers"):
        network.step(0.1, hide(np.zeros((3, 2))))
    with pytest.raises(ValueError, match="positions should be an array of numbers"):
        SteppedNetworks(2, 3, positions=hide(np.zeros((2, 3, 2))))
    with pytest.raises(ValueError, match="bodies should be numbers"):
        SteppedNetworks(2, 3).publish(hide(np.zeros((2, 3))))


def test_attributes_of_edges_that_are_not_read_are_warned_of():
    graph = nx.path_graph(3)
    for place in ("pos", "lat", "lon"):
        nx.set_node_attributes(graph, 0.0, place)
    SteppedNetwork(graph)
    nx.set_edge_attributes(graph, 0.2, "delay")
    with pytest.warns(
        UserWarning, match=r"edges have attributes that are not read: delay \(did you mean latency, in s"
    ):
        SteppedNetwork(graph)


def edge_of(latency):
    graph = nx.path_graph(["ann", "bob", "eve"])
    graph["bob"]["eve"]["latency"] = latency
    return graph


@pytest.mark.parametrize(
    ("nodes", "links", "told"),
    [
        (3, {"latency": 50.0}, "network.latency"),
        (3, {"latency": {"kind": "lognormal", "mean": 40.0}}, "network.latency"),
        (3, {"link": [{"src": 0, "dst": 1, "latency": 20.0}]}, "network.link.0.latency"),
        (3, {"processing": {"sender": 15.0}}, "network.processing.sender"),
        (3, {"graph": nx.complete_graph(3), "link": [{"src": 0, "dst": 2, "latency": 20.0}]}, "network.link.0.latency"),
        (edge_of(50.0), {}, "the edge from bob to eve"),
        (edge_of({"kind": "uniform", "low": 5.0, "high": 30.0}), {"latency": 0.1}, "the edge from bob to eve"),
    ],
)
def test_latencies_that_seem_to_be_in_milliseconds_are_warned_of(nodes, links, told):
    for network in (SteppedNetwork, partial(SteppedNetworks, 1)):
        with pytest.warns(UserWarning, match=rf"^{told}: a mean latency of .* s: times are in s, not ms$") as warned:
            network(nodes, links)
        assert len(warned) == 1
    for plausible in (edge_of(5.0), 3):
        SteppedNetwork(plausible, {"latency": 9.0})  # a warning would be an error


def test_links_described_at_the_nodes_or_the_graph_give_a_warning():
    """An access link has its bandwidth and its loss at the node in the graphs of Shadow."""
    graph = nx.Graph([(0, 1), (1, 2)], latency=0.05, title="three")
    nx.set_node_attributes(graph, {0: {"packet_loss": 0.5, "pos": (1.0, 2.0), "robot": object()}})
    with pytest.warns(UserWarning, match="attributes that are not read") as caught:
        SteppedNetwork(graph)
    of_nodes, of_graph = (str(warning.message) for warning in caught)
    assert (
        of_nodes == "nodes have attributes that are not read: packet_loss (did you mean loss, from 0 to 1?); "
        "no attribute of a node is read"
    )
    assert "the graph has attributes that are not read: latency" in of_graph


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            {"nodes": nx.MultiGraph([(0, 1, {"latency": 0.1}), (0, 1, {"latency": 0.2})])},
            "edges 0 and 1 are parallel: both join nodes 0 and 1",
        ),
        ({"nodes": 3, "walls": [{"line": [[0, 0]]}]}, "wall.0: a line should have at least 2 corners"),
        ({"nodes": 3, "walls": ["LINESTRING (0 0, 1 1)"]}, "wall.0: should be a Wall or a table of its keys"),
        ({"nodes": 3, "faults": [{"kind": "crash"}]}, "fault.0.start: is missing"),
    ],
)
def test_an_argument_is_refused_in_the_words_of_a_scenario_file(arguments, told):
    with pytest.raises(ValueError, match=told) as refused:
        SteppedNetwork(**arguments)
    assert "validation error" not in str(refused.value)
    assert not str(refused.value).startswith("_")


def test_a_plan_without_an_end_is_refused(monkeypatch):
    monkeypatch.setattr("desim.kernel.models.fault_plans.MAX_FAULTS", 100)

    def plan(size, horizon, rng):
        while True:
            yield Crash(node=0, start=1.0, end=2.0)

    with pytest.raises(ValueError, match="a plan should end, with no fault after the horizon"):
        SteppedNetwork(3, faults=[plan], horizon=1.0)


def test_a_body_is_anything_where_its_size_does_not_matter():
    network = SteppedNetwork(2)
    network.send(0, 1, len)
    network.publish(0, len)
    assert [message.body for message in network.step(0.1)] == [len]
    assert network.latest(1)[0].body is len
    assert network.counts().bytes_sent == 2 * 16


def test_a_receiver_may_change_what_it_gets():
    network = SteppedNetwork(3)
    body = {"path": [1]}
    network.send(0, None, body)
    body["path"].append(2)
    first, second = network.step(0.1)
    first.body["path"].clear()
    assert second.body == {"path": [1]}


@pytest.mark.parametrize("call", ["send", "publish"])
def test_what_is_done_to_a_lost_message_changes_none_that_arrives(call):
    network = SteppedNetwork(6, Links(loss=0.5, latency=1.0), seed=1)
    getattr(network, call)(0, *([None] * (call == "send")), [1])
    network.step(0.1)
    for lost in (*network.lost(), *network.lost()):
        assert lost.body == [1]
        lost.body.append(2)
    arrived = [*network.step(1.0), *(network.latest(node)[0] for node in range(1, 6) if network.latest(node))]
    assert [message.body for message in arrived] == [[1], [1]]


@pytest.mark.parametrize("kind", [partial(Crash, node=0), partial(MessageFault, messages=[1])])
def test_a_fault_from_the_start_concerns_what_is_sent_before_the_first_step(kind):
    def arrived(start):
        network = SteppedNetwork(2, Links(latency=0.1), faults=[kind(start=start)])
        network.send(0, 1, "hi")
        return len(network.step(1.0))

    assert [arrived(0.0), arrived(0.05)] == [0, 1]


def test_nodes_leave_and_join():
    trace = Trace([Conservation()])
    network = SteppedNetwork(3, Links(latency=0.1), can_leave=True, trace=trace, faults=[Crash(start=0.5, node=0)])
    network.send(0, None, "in flight")
    network.publish(0, "state")
    network.leave(2)
    with pytest.raises(ValueError, match="node 2 is away already"):
        network.leave(2)
    assert [message.dst for message in network.step(0.15)] == [1]
    assert {(lost.dst, lost.cause) for lost in network.lost()} == {(2, "crash")}
    network.send(2, None, "from nowhere")
    network.join(2)
    assert network.latest(2) == {}
    network.send(1, None, "welcome")
    assert [message[:3] for message in network.step(0.15)] == [(1, 0, "welcome"), (1, 2, "welcome")]
    with pytest.raises(ValueError, match="is not away"):
        network.join(0)
    network.close()
    with pytest.raises(ValueError, match="can_leave=True"):
        SteppedNetwork(3).leave(0)


def test_a_node_that_joins_while_a_fault_has_it_down_is_up_after_the_fault():
    crash = Crash(start=0.5, end=1.0, node=1)
    network = SteppedNetwork(2, can_leave=True, faults=[crash])
    network.leave(1)
    network.step(0.7)
    network.join(1)
    heard = []
    for _ in range(2):
        network.send(0, 1, "hi")
        heard.append(len(network.step(0.4)))
    assert heard == [0, 1]


def test_clocks_wander_on_after_the_horizon_of_plans():
    """Messages that are older than their lifespan by the clock of the receiver do not arrive."""

    def arrived(horizon):
        skew, links = ClockSkew(offset_walk=1.0), Links(transport=BestEffort(lifespan=1.0))
        network = SteppedNetwork(2, links, faults=[skew], horizon=horizon)
        messages = []
        for k in range(40):
            network.send(0, 1, k)
            messages += network.step(0.1)
        return messages

    assert arrived(0.1) == arrived(None)
    assert 0 < len(arrived(None)) < 40


# Seeds and copies.


def test_many_networks_step_together_or_not_at_all():
    places = np.zeros((2, 3, 2))
    many = SteppedNetworks(2, 3, Links(range=5.0), positions=places)
    for wrong, why in (
        (np.zeros((2, 4, 2)), r"shape \(2, 3, 2\), one row .* per node, m \(got shape \(2, 4, 2\)"),
        (np.zeros((2, 3)), r"shape \(2, 3, 2\)"),
        (np.array([places[0], places[1] + nan]), r"got \[nan, nan\] in row 0 of network 1"),
    ):
        with pytest.raises(ValueError, match=why):
            many.step(0.1, wrong)
    many.step(0.1)  # at the last places that were right
    places[1, 2, 0] = nan
    with pytest.raises(ValueError, match="in row 2 of network 1"):
        many.step(0.1)
    assert [network.now for network in many] == [0.1, 0.1]
    places[1, 2, 0] = 9.0
    many.step(0.1)
    assert [network.neighbours(2) for network in many] == [[0, 1], []]


def episode(network):
    messages = []
    for k in range(20):
        for node in network.nodes:
            network.send(node, None, k)
            network.publish(node, k)
        messages += network.step(0.05)
    return messages, network.lost(), network.ages().tolist(), network.counts()


@pytest.mark.slow
def test_a_network_that_is_reset_is_a_new_one():
    arguments = {"links": LINKS["range"], "faults": [RandomCrashes(rate=1.0)], "horizon": 5.0, "positions": START}
    network = SteppedNetwork(SIZE, seed=1, **arguments)
    first = episode(network)
    assert first == episode(SteppedNetwork(SIZE, seed=1, **arguments))
    network.reset(2)
    assert network.now == 0.0
    other = episode(network)
    assert other == episode(SteppedNetwork(SIZE, seed=2, **arguments)) != first
    network.reset(1)
    assert episode(network) == first


def test_a_network_is_copied_and_pickled_before_it_is_used():
    network = SteppedNetwork(nx.path_graph(["a", "b", "c"]), LINKS["lognormal"], seed=3)
    copies = [pickle.loads(pickle.dumps(network)), copy.deepcopy(network)]
    assert [episode(other) for other in copies] == [episode(network)] * 2
    with pytest.raises(TypeError, match="before its first message and step"):
        pickle.dumps(network)
    left = SteppedNetwork(2, can_leave=True)
    left.leave(0)
    with pytest.raises(TypeError, match="before its first message and step"):
        copy.copy(left)
    network.reset(3)
    assert episode(pickle.loads(pickle.dumps(network))) == episode(network)


@pytest.mark.whole
def test_the_bytes_of_a_network_depend_neither_on_the_hash_seed_nor_on_the_pursuit():
    """Nor does a network alone import anything of the pursuit."""
    program = (
        "from desim import Links, Lognormal, SteppedNetwork, SteppedNetworks\n"
        "n = SteppedNetwork(6, Links(latency=Lognormal(mean=.1, cv=1.), loss=.1), seed=2)\n"
        "for k in range(9): [n.send(i, None, {'k': k}) for i in range(6)]; print(n.step(.05))\n"
    )
    modules = (
        "import sys; print([name for name in sys.modules if name.startswith(('desim.', 'protocols'))"
        " and name.split('.')[1] not in ('config', 'kernel')])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program + modules],
        env={"PYTHONHASHSEED": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    *other, imported = done.stdout.splitlines()
    assert imported == "[]"
    with redirect_stdout(StringIO()) as one:
        exec(program, {})
    assert one.getvalue().splitlines() == other
    assert len(other) == 9


def test_one_network_among_many_is_all():
    one = SteppedNetworks(1, 2)
    one.publish([[3.0, 4.0]])
    one.step(0.1)
    assert np.array_equal(one.latest(), [[[nan, 4.0], [3.0, nan]]], equal_nan=True)


def test_the_time_of_a_network_is_limited():
    network = SteppedNetwork(2)
    network.step(MAX_TIME)
    with pytest.raises(ValueError, match=r"the time should be at most 1e\+09 s \(got 1e\+09 s and dt = 1 s\)"):
        network.step(1.0)


def test_many_networks_are_each_as_a_single_one():
    links = LINKS["range"]
    many = SteppedNetworks(3, SIZE, links, seed=4, positions=np.stack([START] * 3))
    single = [SteppedNetwork(SIZE, links, seed=run_seed(4, e), positions=START) for e in range(3)]
    for k in range(6):
        bodies = np.arange(3 * SIZE * 2, dtype=float).reshape(3, SIZE, 2) + k
        many.publish(bodies)
        many.send(bodies)
        place = np.stack([START + (k + 1) * 0.1 * VELOCITY] * 3)
        arrived = many.step(0.1, place)
        for e, network in enumerate(single):
            for node in range(SIZE):
                network.publish(node, tuple(bodies[e, node].tolist()))
            for node in range(SIZE):
                network.send(node, None, tuple(bodies[e, node].tolist()))
            assert repr(network.step(0.1, place[e])) == repr(arrived[e])
    assert many.ages().tolist() == [network.ages().tolist() for network in single]
    latest = many.latest()
    assert latest.shape == (3, SIZE, SIZE, 2)
    for e, network in enumerate(single):
        for dst in range(SIZE):
            table = network.latest(dst)
            for src in range(SIZE):
                expected = table[src].body if src in table else (nan, nan)
                assert np.array_equal(latest[e, dst, src], expected, equal_nan=True)
    assert many[0].counts() != many[1].counts() or many.ages()[0].tolist() != many.ages()[1].tolist()
    many.reset(4, positions=np.stack([START] * 3))
    assert many.now == 0.0
    late = SteppedNetworks(2, 3, Links(latency=1.0))
    assert late.latest().shape == (2, 3, 3)
    late.publish(np.zeros((2, 3, 5)))
    late.step(0.1)
    assert late.latest().shape == (2, 3, 3, 5)  # also while nothing has arrived
    assert np.isnan(late.latest()).all()
    with pytest.raises(ValueError, match=r"one shape, first \(5,\), now \(\)"):
        late.publish(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="a trace is of one network"):
        SteppedNetworks(2, 3, trace=Trace())


# Bad use.


@pytest.mark.parametrize(
    ("positions", "why"),
    [
        (np.zeros((3, 2)), r"shape \(2, 2\).*got shape \(3, 2\)"),
        (np.zeros((2, 3)), "got shape"),
        ([[0.0, 0.0], [nan, 0.0]], "finite.*row 1"),
        ([[inf, 0.0], [0.0, 0.0]], "finite.*row 0"),
        ([["a", "b"], ["c", "d"]], "array of numbers"),
        ([[0.0], [0.0, 1.0]], "array of numbers"),
        (np.zeros((2, 2), dtype=complex), "array of numbers"),
    ],
)
def test_wrong_positions_are_refused_and_the_step_is_not_made(positions, why):
    with pytest.raises(ValueError, match=why):
        SteppedNetwork(2, positions=positions)
    network = SteppedNetwork(2, Links(range=5.0), positions=np.zeros((2, 2)))
    network.send(0, 1, "still in flight")
    with pytest.raises(ValueError, match=why):
        network.step(0.1, positions)
    assert network.now == 0.0
    assert [message.body for message in network.step(0.1)] == ["still in flight"]


@pytest.mark.parametrize("wrong", [{"seed": -1}, {"positions": np.zeros((3, 2))}, {"trace": True}])
def test_a_reset_that_is_refused_leaves_the_episode_as_it_is(wrong):
    trace = Trace()
    network = SteppedNetwork(2, Links(latency=0.1), positions=np.zeros((2, 2)), trace=trace)
    network.step(0.5)
    network.send(0, 1, "still in flight")
    with pytest.raises(ValueError, match=next(iter(wrong))):
        network.reset(**{"seed": 1} | wrong)
    assert not trace.of(MessageCounts)  # it is not closed
    assert [message.arrived for message in network.step(0.1)] == [0.6]
    network.reset(1)
    assert (network.now, len(trace.of(MessageCounts))) == (0.0, 1)


@pytest.mark.parametrize("dt", [0, 0.0, -0.1, nan, inf, -inf, 1e-10, 1e300, "0.1", None, True])
def test_a_step_takes_a_finite_time(dt):
    network = SteppedNetwork(2)
    with pytest.raises(ValueError, match=r"dt should be|time should be at most"):
        network.step(dt)
    assert network.now == 0.0
    assert network.step(0.1) == []


@pytest.mark.parametrize("traced", [False, True])
def test_what_arrives_at_this_instant_is_counted_and_known_whether_or_not_a_trace_needs_it(traced):
    """Without a trace, arrivals whose range is checked on arrival wait until someone asks."""
    links = Links(latency=Propagation(fixed=0.0, speed=50.0), range=6.0, range_check="delivery")
    counted, read = (SteppedNetwork(3, links, trace=Trace() if traced else None) for _ in range(2))
    for network in (counted, read):
        network.step(0.05, [(0.0, 0.0), (5.0, 0.0), (0.0, 2.5)])
        network.publish(0, "x")
        network.step(0.1)
    counts = counted.counts()
    assert (counts.sent, counts.delivered, counts.in_flight) == (2, 2, 0)
    assert [record.body for node in (1, 2) for record in read.latest(node).values()] == ["x", "x"]


def test_a_loss_that_is_certain_at_sending_is_counted_once_however_often_counts_are_read_at_its_instant():
    network = SteppedNetwork(3, Links(latency=0.1), faults=[Crash(node=1, start=0.0, end=5.0)])
    network.step(0.01)
    network.send(0, None, "x")
    network.step(0.1)
    counts = network.counts()
    assert (counts.sent, counts.delivered, counts.lost_by, counts.in_flight) == (2, 1, {"crash": 1}, 0)
    assert network.counts() == counts
    network.step(0.1)
    assert network.counts().lost_by == {"crash": 1}


@pytest.mark.parametrize(("count", "end"), [(10, "8, 9"), (11, r"8, 9, \.\.\.")])
def test_up_to_ten_nodes_are_named_where_there_is_no_such_node(count, end):
    with pytest.raises(ValueError, match=f"there is no node 11: the nodes are 0, 1, 2, 3, 4, 5, 6, 7, {end}$"):
        SteppedNetwork(count).neighbours(11)


def test_the_garbage_collector_looks_rarely_while_a_network_is_open_and_in_each_step():
    usual, seen = gc.get_threshold(), []
    trace = Trace([lambda _: seen.append(gc.get_threshold())])
    SteppedNetwork(2, trace=trace, faults=[Crash(node=0, start=0.05)]).step(0.1)
    assert seen == [GC_THRESHOLDS]
    assert gc.get_threshold() == usual != GC_THRESHOLDS
    with SteppedNetwork(2):
        assert gc.get_threshold() == GC_THRESHOLDS
    assert gc.get_threshold() == usual


@pytest.mark.parametrize(
    "use",
    [
        lambda network: network.send(0, 1, "x"),
        lambda network: network.publish(0, "x"),
        lambda network: network.step(0.1),
        lambda network: network.leave(0),
    ],
    ids=["send", "publish", "step", "leave"],
)
def test_a_network_is_copied_before_its_first_use_and_after_a_reset_only(use):
    network = SteppedNetwork(2, can_leave=True)
    copy.copy(network)
    use(network)
    with pytest.raises(TypeError, match="before its first message and step only"):
        copy.copy(network)
    network.reset(1)
    copy.copy(network)


def test_what_a_network_cannot_do_is_said():
    with pytest.raises(ValueError, match="depends on the positions"):
        SteppedNetwork(3, Links(range=5.0)).send(0, None, 1)
    network = SteppedNetwork(3)
    for node in (3, -1):
        with pytest.raises(ValueError, match=f"there is no node {node}"):
            network.send(node, None, 1)
    for node in (0.0, True, "0"):
        with pytest.raises(ValueError, match="a node should be an integer"):
            network.latest(node)
    with pytest.raises(ValueError, match="to itself"):
        network.send(1, 1, 1)
    with pytest.raises(ValueError, match="has no size: send it with size="):
        SteppedNetwork(2, Links(medium=Bitrate(bitrate=1e6))).send(0, 1, len)
    with pytest.raises(ValueError, match="at least 1 node"):
        SteppedNetwork(0)
    with pytest.raises(ValueError, match="nodes should be their number"):
        SteppedNetwork("radio.toml")
    with pytest.raises(ValueError, match="one graph"):
        SteppedNetwork(nx.path_graph(3), Links(graph=nx.path_graph(3)))
    with pytest.raises(ValueError, match="horizon="):
        SteppedNetwork(3, faults=[RandomCrashes()])
    for faults in ("crash", {"kind": "crash", "node": 1, "start": 0.5}, 3):
        with pytest.raises(ValueError, match="faults should be a list of faults"):
            SteppedNetwork(3, faults=faults)
    with pytest.raises(ValueError, match="should be an integer"):
        SteppedNetwork(3, faults=[{"kind": "crash", "node": "b", "start": 0.5}])
    for links in (0.1, "radio.toml", [0.1]):
        with pytest.raises(ValueError, match=r"links should be Links\(\.\.\.\), or a table"):
            SteppedNetwork(3, links)
    with pytest.raises(ValueError, match="trace should be"):
        SteppedNetwork(3, trace=True)
    with pytest.raises(ValueError, match="there is no node 7"):
        SteppedNetwork(3, faults=[Crash(start=0.0, node=7)])
    with pytest.raises(ValueError, match=r"link\.1: the link from 1 to 0 is also in link\.0"):
        SteppedNetwork(
            2, {"link": [{"src": 1, "dst": 0, "loss": 1.0}, {"src": 0, "dst": 1, "both_ways": True, "loss": 0.0}]}
        )
    with pytest.raises(ValueError, match="latencyy"):
        SteppedNetwork(3, {"latencyy": 0.1})
    with pytest.raises(ValueError, match="seed"):
        SteppedNetwork(3, seed=-1)
    with pytest.raises(ValueError, match=r"shape \(2, 3\)"):
        SteppedNetworks(2, 3).publish(np.zeros((3, 3)))


def test_a_closed_network_says_so():
    with SteppedNetwork(2) as network:
        network.send(0, 1, "x")
    network.close()
    for call in (
        lambda: network.step(0.1),
        lambda: network.send(0, 1, "x"),
        lambda: network.publish(0, "x"),
        lambda: network.latest(0),
        network.ages,
        network.lost,
        network.counts,
        lambda: network.neighbours(0),
        network.transport_counts,
        lambda: network.leave(0),
        lambda: network.reset(1),
    ):
        with pytest.raises(RuntimeError, match="closed"):
            call()
    assert "closed" in repr(network)


def test_a_network_belongs_to_one_thread_and_a_failed_step_is_not_continued():
    errors = []

    def watch(event):
        def call():
            try:
                network.step(0.1)
            except RuntimeError as error:
                errors.append(str(error))

        thread = Thread(target=call)
        thread.start()
        thread.join()
        if event.body == "bad":
            raise ArithmeticError("of a watcher")

    links = Links(medium=Bitrate(bitrate=1e3))
    network = SteppedNetwork(2, links, trace=Trace([lambda event: isinstance(event, Sent) and watch(event)]))
    network.send(0, 1, "good", size=100)
    network.send(0, 1, "bad", size=100)
    with pytest.raises(ArithmeticError):
        network.step(5.0)
    assert errors
    assert all("one thread" in text for text in errors)
    with pytest.raises(RuntimeError, match="has failed"):
        network.step(0.1)
    network.reset(0)
    assert network.step(0.1) == []


def test_a_watcher_of_the_first_fault_cannot_call_a_network_that_is_reset():
    network = SteppedNetwork(2, faults=[Crash(start=0.0, node=0)])
    with pytest.raises(RuntimeError, match="a call is under way"):
        network.reset(1, trace=Trace([lambda _: network.step(0.1)]))
    network.step(0.1)  # the episode goes on


@pytest.mark.parametrize("call", ["send", "publish"])
def test_a_message_whose_sending_failed_is_not_counted_as_delivered(call):
    def watch(event):
        if isinstance(event, Sent | Broadcast):
            raise ArithmeticError("of a watcher")

    network = SteppedNetwork(2, trace=Trace([watch]))
    arguments = [1] if call == "publish" else [None, 1]
    with pytest.raises(ValueError, match="there is no node 5"):
        getattr(network, call)(5, *arguments)
    network.step(0.1)  # a wrong argument has changed nothing
    with pytest.raises(ArithmeticError):
        getattr(network, call)(0, *arguments)
    for after in (network.counts, lambda: network.step(0.1), lambda: getattr(network, call)(0, *arguments)):
        with pytest.raises(RuntimeError, match="has failed"):
            after()
    network.reset(0)
    getattr(network, call)(0, *arguments)
    network.step(0.1)
    assert network.counts().delivered == 1


def test_a_table_of_a_scenario_file_is_enough(tmp_path):
    file = tmp_path / "net.toml"
    file.write_text('[network]\nlatency = 0.1\nloss = 0.2\n\n[[fault]]\nkind = "crash"\nnode = 1\nstart = 0.5\n')
    scenario = load(file)
    network = SteppedNetwork(4, scenario.network, faults=scenario.network_faults)
    same = SteppedNetwork(4, {"latency": 0.1, "loss": 0.2}, faults=[{"kind": "crash", "start": 0.5, "node": 1}])
    assert episode(network) == episode(same)
    assert network.counts().lost_by.keys() == {"loss", "crash"}


@pytest.mark.slow
@pytest.mark.parametrize(("share", "agrees"), [(0.8, True), (1.2, False)])
def test_consensus_bears_delays_below_the_bound(share, agrees):
    """Equal delays below pi / (2 lambda_n) are borne, longer ones not (Olfati-Saber & Murray 2004, theorem 10)."""
    graph, dt = nx.cycle_graph(4), 0.01
    bound = pi / (2 * max(nx.laplacian_spectrum(graph)))  # lambda_n = 4
    latency = round(share * bound, 2)
    network, history = SteppedNetwork(graph, Links(latency=latency)), [np.array([1.0, -2.0, 4.0, 0.0])]
    for step in range(2000):
        x = history[-1]
        for node in graph:
            network.publish(node, float(x[node]))
        network.step(dt)
        own = history[max(step + 1 - round(latency / dt), 0)]
        heard = [network.latest(node).values() for node in graph]
        history.append(x + dt * np.array([sum(other.body - own[node] for other in heard[node]) for node in graph]))
    spread = max(history[-1]) - min(history[-1])
    assert spread < 0.1 if agrees else spread > 100.0


@pytest.mark.parametrize("port", [40, 0.5, None, ["a"], b"a"])
def test_a_port_that_is_no_text_is_refused(port):
    with pytest.raises(ValueError, match="send: a port should be a text"):
        SteppedNetwork(2).send(0, 1, "x", port)


@pytest.mark.parametrize("transport", ["reliable", Reliable, {"kind": "reliable"}, 3])
def test_a_transport_that_is_none_is_refused(transport):
    with pytest.raises(ValueError, match="transport should be BestEffort"):
        SteppedNetwork(2).send(0, 1, "x", transport=transport)


@pytest.mark.parametrize("size", [10**7, 10**12, 2**63, 10**30])
def test_numbers_of_nodes_and_networks_that_no_memory_holds_are_refused(size):
    with pytest.raises(ValueError, match="at least 1 node and at most 1,000,000"):
        SteppedNetwork(size)
    with pytest.raises(ValueError, match="at least 1 network and at most 100,000"):
        SteppedNetworks(size, 2)


def test_faults_and_walls_of_an_iterator_are_those_of_each_network():
    wall = Wall(line=[[1.0, -5.0], [1.0, 5.0]])
    crashes, places = (
        (Crash(start=0.0, node=node) for node in (1,)),
        np.tile([[0.0, 0.0], [0.5, 0.0], [2.0, 0.0]], (3, 1, 1)),
    )
    networks = SteppedNetworks(3, 3, Links(range=4.0), faults=crashes, walls=iter([wall]), positions=places)
    networks.send(np.zeros((3, 3)))
    networks.step(0.1)
    causes = [sorted((lost.src, lost.dst, lost.cause) for lost in network.lost()) for network in networks]
    assert causes[0] == causes[1] == causes[2]
    assert {cause for *_, cause in causes[0]} >= {"crash"}


def test_more_nodes_in_all_networks_than_memory_holds_are_refused():
    told = r"^all networks together should have at most 1,000,000 nodes \(got 90,000 of 12: 1,080,000\)$"
    with pytest.raises(ValueError, match=told):
        SteppedNetworks(90_000, 12)


@pytest.mark.parametrize("labels", [[0.0, 1.0, 2.0], [False, True, 2], np.arange(3), [2.0, 0.0, 1.0]])
def test_nodes_that_are_equal_to_numbers_are_named_by_their_labels(labels):
    graph = nx.Graph()
    graph.add_edge(labels[0], labels[1], latency=0.25)
    graph.add_node(labels[2])
    network = SteppedNetwork(graph)
    network.send(labels[0], labels[1], "x")
    assert [(message.src, message.dst, message.arrived) for message in network.step(1.0)] == [(*labels[:2], 0.25)]


class Robot:
    """A robot of another program."""


def test_objects_may_be_nodes_and_have_names_without_addresses():
    first, second = Robot(), Robot()
    network = SteppedNetwork(nx.Graph([(first, second)]))
    network.send(first, second, "x")
    assert [message.dst is second for message in network.step(1.0)] == [True]
    assert Edges.of(nx.Graph([(first, second)])).names == ("Robot 0", "Robot 1")


@pytest.mark.parametrize("nodes", [["a", "b"], "ab", {"a": (0.0, 0.0)}, range(3), [("a", "b")], 2.0, True, None])
def test_what_is_neither_a_number_of_nodes_nor_a_graph_is_told_how_to_give_names(nodes):
    with pytest.raises(
        ValueError, match=r"such as networkx\.complete_graph\(\['a', 'b'\]\) for nodes with names"
    ) as told:
        SteppedNetwork(nodes)
    assert repr(nodes) in str(told.value)
    assert SteppedNetwork(nx.complete_graph(["a", "b"])).nodes == ("a", "b")


def test_the_class_of_graphs_is_no_graph():
    with pytest.raises(ValueError, match="nodes should be their number, or a networkx graph"):
        SteppedNetwork(nx.Graph)
    with pytest.raises(ValueError, match="graph: should"):
        Links(graph=nx.Graph)


def test_a_trace_of_an_episode_is_not_taken_for_the_next():
    trace = Trace()
    network = SteppedNetwork(2, trace=trace)
    network.send(0, 1, "x")
    network.step(0.1)
    with pytest.raises(ValueError, match=r"trace has \d+ events? of another episode: give a new Trace"):
        network.reset(1, trace=trace)


def test_a_node_that_joins_again_has_received_nothing():
    network = SteppedNetwork(2, Links(latency=0.01), can_leave=True)
    network.publish(0, "old", size=10)
    network.step(0.1)
    assert network.latest(1)[0].body == "old"
    network.leave(1)
    network.publish(0, "lost", size=10)
    network.step(0.1)
    network.join(1)
    assert dict(network.latest(1)) == {}
    network.publish(0, "new", size=10)
    network.step(0.1)
    assert network.latest(1)[0].body == "new"


@pytest.mark.parametrize("nodes", [3, nx.complete_graph(["a", "c", "b"])])
def test_the_columns_of_bodies_may_have_the_labels_of_nodes_in_any_order(nodes):
    latest = []
    for order in ((0, 1, 2), (2, 0, 1)):
        networks = SteppedNetworks(2, nodes)
        frame = pd.DataFrame([[10.0, 11.0, 12.0], [20.0, 21.0, 22.0]], columns=networks[0].nodes)
        networks.publish(frame.iloc[:, [*order]])
        networks.step(0.1)
        latest.append(networks.latest())
    assert latest[0][1, 0, 1:].tolist() == [21.0, 22.0]
    np.testing.assert_array_equal(*latest)


def test_the_rows_of_positions_may_have_the_labels_of_nodes_in_any_order():
    table = pd.DataFrame({"x": [0.0, 1.0, 99.0], "y": 0.0}, index=["a", "c", "b"])
    network = SteppedNetwork(nx.Graph([("c", "a"), ("a", "b")]), Links(range=5.0), positions=table)
    network.send("a", None, "hi")
    assert [message.dst for message in network.step(0.1)] == ["c"]
