"""The network: records, messages, inboxes; publish against one event per record."""

import re
from itertools import pairwise
from math import inf, sqrt

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import LOST, Broadcast, Lost, Sent, Trace
from desim.kernel.core.link_context import LinkContext
from desim.kernel.core.message_size import size_of
from desim.kernel.core.records import Record
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import SECOND
from desim.kernel.models.access import Csma
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.medium import Bitrate, Unlimited
from desim.kernel.network import Network
from desim.kernel.state.fault_state import FaultState
from desim.kernel.state.inbox import Inboxes, Message
from desim.kernel.topology.topology import Topology

CONTENDED = Bitrate(bitrate=8.0 * size_of(0), access=Csma())


class Uniform:
    """Latencies that overtake each other, drawn per hop, per broadcast, or now this and now that."""

    def __init__(self, longest, per_hop=1.0):
        self.longest, self.per_hop = longest, per_hop

    def __call__(self, context: LinkContext, rng):
        alike = self.per_hop < 1.0 and rng.random() >= self.per_hop
        return np.round(rng.uniform(0.0, self.longest, None if alike else len(context.dst)), 3)


class EagerNetwork:
    """The same network with one SimPy event per record and receiver, written without any of its tricks."""

    def __init__(self, clock, graph, links, *, seed, positions):
        self.clock, self.links = clock, links
        self.topology = Topology(graph, links.range, positions)
        self.rng = {name: stream(seed, name) for name in ("latency", "loss", "duplicate")}
        self.seq = dict.fromkeys(graph, 0)
        self.tables = {node: {} for node in graph}

    def set_initial_belief(self, src, body):
        for node in self.tables:
            if node != src:
                self.tables[node][src] = (0, Record(src, 0, 0, body))

    def publish(self, src, body):
        record, context = self.next_record(src, body), LinkContext(src, self.topology.neighbours(src))
        self.transmit(record, context)
        twice = np.broadcast_to(self.links.duplicate(context, self.rng["duplicate"]), len(context.dst))
        if twice.any():
            self.transmit(record, LinkContext(src, context.dst[twice]))

    def transmit(self, record, context):
        lost = np.broadcast_to(self.links.loss(context, self.rng["loss"]), len(context.dst))
        delay = np.broadcast_to(self.links.latency(context, self.rng["latency"]), len(context.dst))
        for node, gone, wait in zip(context.dst.tolist(), lost, delay, strict=True):
            if not gone:
                arrival = self.clock.now + round(float(wait) * SECOND)
                event = Instant(self.clock, arrival, Phase.DELIVERY)
                event.callbacks.append(lambda _, n=node, a=arrival: self.deliver(n, a, record))

    def deliver(self, node, arrival, record):
        known = self.tables[node].get(record.src)
        if known is None or known[1].seq < record.seq:  # so of two copies the first counts
            self.tables[node][record.src] = (arrival, record)

    def next_record(self, src, body):
        self.seq[src] += 1
        return Record(src, self.seq[src], self.clock.now, body)

    def insert(self, node, record):
        if record.src != node:
            self.deliver(node, self.clock.now, record)

    def latest_records(self, node):
        return dict(self.tables[node])


@st.composite
def histories(draw):
    """A random graph, its links, and a random order of publishing and reading with many ties in time."""
    size, seed = draw(st.integers(2, 6)), draw(st.integers(0, 2**32))
    density = draw(st.sampled_from([0.0, 0.5, 1.0, 1.0]))
    graph = nx.gnp_random_graph(size, density, seed=seed, directed=draw(st.booleans()))
    latency = draw(
        st.sampled_from(
            [
                Constant(),
                Constant(value=0.02),
                Uniform(0.05),
                Uniform(0.05, per_hop=0.0),
                Uniform(0.002),
                Uniform(0.05, per_hop=0.5),
            ]
        )
    )
    loss = Bernoulli(p=draw(st.sampled_from([0.0, 0.3, 1.0])))
    duplicate = Bernoulli(p=draw(st.sampled_from([0.0, 0.0, 0.5, 1.0])))
    times = st.integers(0, 40).map(lambda k: k * SECOND // 1000)
    nodes = st.integers(0, len(graph) - 1)
    kinds = st.sampled_from(["publish", "read", "both", "publish", "read", "both", "whisper", "pass on"])
    acts = draw(st.lists(st.tuples(times, nodes, kinds), max_size=60))
    reach = draw(st.sampled_from([inf, inf, 0.5]))
    return graph, Links(latency=latency, loss=loss, duplicate=duplicate, range=reach), acts, seed


def is_even(body):
    """Mark about half of the numbers, and not what was presumed."""
    return isinstance(body, int) and body % 2 == 0


class Marked(Network):
    """A network that marks even numbers, and whose nodes look for these at every read."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, predicate=is_even, **kwargs)

    def latest_records(self, node):
        marked, table = self.matching(node), super().latest_records(node)
        assert marked == {src: heard for src, heard in table.items() if is_even(heard[1].body)}
        return table


class Glancer(Marked):
    """The same, but its nodes look all the time."""

    def publish(self, src, body):
        self.latest_records(src)
        super().publish(src, body)


def observe(make, graph, links, acts, seed):
    """Return what every read of a history sees."""
    clock = Clock()
    places = np.random.default_rng(seed).random((len(graph), 2))
    network = make(clock, graph, links, seed=seed, positions=lambda: places * np.cos(clock.now / 1e7))
    network.set_initial_belief(0, "presumed")
    seen = []

    def act(node, what, number):
        other = (node + 1) % len(graph)
        if what in {"publish", "both"}:
            network.publish(node, number)
        elif what == "whisper":
            network.insert(other, network.next_record(node, number))
        elif what == "pass on":
            for _, record in network.latest_records(node).values():
                network.insert(other, record)
        if what in {"read", "both"}:
            seen.append((clock.now, node, network.latest_records(node)))

    for number, (when, node, what) in enumerate(acts):
        event = Instant(clock, when, Phase.DECISION + node)
        event.callbacks.append(lambda _, n=node, w=what, k=number: act(n, w, k))
    Instant(clock, SECOND, Phase.SAMPLE)
    clock.run()
    return seen + [(SECOND, node, network.latest_records(node)) for node in graph]


@pytest.mark.whole
@settings(max_examples=100, deadline=None)
@given(histories())
def test_publish_is_observationally_equal_to_one_event_per_record(history):
    """Every read sees the same records with the same times of arrival, and none of its own; and so with marks."""
    lazy = observe(Network, *history)
    assert lazy == observe(EagerNetwork, *history)
    assert all(node not in table for _, node, table in lazy)
    assert lazy == observe(Marked, *history) == observe(Glancer, *history)


def test_the_comparison_detects_a_network_one_nanosecond_late():
    """The control of the property above: records that arrive 1 ns late are detected."""

    class Late(EagerNetwork):
        def deliver(self, node, arrival, record):
            super().deliver(node, arrival + 1, record)

    history = (nx.complete_graph(2), Links(), [(0, 0, "publish"), (5, 1, "read")], 0)
    assert observe(EagerNetwork, *history) != observe(Late, *history)


def test_an_initial_belief_is_replaced_by_the_first_record_that_arrives():
    clock = Clock()
    network = Network(clock, nx.complete_graph(3), Links(latency=Constant(value=1e-9)))
    network.set_initial_belief(0, "presumed")
    network.publish(0, "told")
    assert network.latest_records(1)[0][1].body == "presumed"
    assert 0 not in network.latest_records(0)
    Instant(clock, 1, Phase.MOTION)
    clock.run()
    assert network.latest_records(1)[0] == (1, Record(0, 1, 0, "told"))


@pytest.mark.parametrize("latency", [Constant(), Uniform(0.0)], ids=["alike", "per receiver"])
def test_reading_returns_a_copy_of_the_networks_table(latency):
    network = Network(Clock(), nx.complete_graph(3), Links(latency=latency), predicate="a".__eq__)
    network.set_initial_belief(2, "presumed")
    network.publish(0, "a")
    network.latest_records(1).clear()
    network.matching(1).clear()
    assert [record.body for _, record in network.latest_records(1).values()] == ["presumed", "a"]
    assert [record.body for _, record in network.matching(1).values()] == ["a"]


def test_a_node_without_memory_forgets_matching_records_and_initial_beliefs():
    network = Network(Clock(), nx.complete_graph(3), fault_state=FaultState(), predicate=bool)
    network.set_initial_belief(0, "presumed")
    network.insert(1, network.next_record(0, "told"))
    network.insert(1, network.next_record(2, "more"))
    assert network.matching(1).keys() == {0, 2}
    for again in (network.latest_records(2)[0][1], network.next_record(0, "again")):
        network.crash(1)
        network.recover(1, memory=False)
        assert network.latest_records(1) == network.matching(1) == {}
        network.insert(1, again)
        assert network.latest_records(1) == network.matching(1) == {0: (0, again)}
        assert network.latest_records(2)[0][1].body == network.matching(2)[0][1].body == "presumed"


def test_a_record_arrives_when_it_first_does():
    """Whispered to one while it is on its way to all, and to both once more when it has arrived."""
    clock = Clock()
    network = Network(clock, nx.complete_graph(3), Links(latency=Constant(value=1.0)), predicate=bool)
    network.publish(0, "x")
    record = Record(0, 1, 0, "x")
    network.insert(1, record)
    clock.run(until=2 * SECOND)
    for node in (1, 2):
        network.insert(node, record)
    assert [network.latest_records(node)[0] for node in (1, 2)] == [(0, record), (SECOND, record)]
    assert [network.matching(node)[0] for node in (1, 2)] == [(0, record), (SECOND, record)]


def test_a_queued_record_does_not_replace_a_newer_unicast_record():
    """The second record leaves and arrives after the third was inserted directly."""
    clock = Clock()
    network = Network(clock, nx.path_graph(3), Links(medium=Bitrate(bitrate=8 * size_of("slow"))))
    network.publish(0, "slow")
    network.publish(0, "slow")
    whispered = network.next_record(0, "whispered")
    network.insert(1, whispered)
    clock.run(until=3 * SECOND)
    assert network.message_counts().delivered == 2
    assert network.latest_records(1) == {0: (0, whispered)}


def run_process(clock, process):
    clock.process(process)
    clock.run()


def listening(clock, network, node, seen, times=1, port=""):
    """Note when a node is woken, and what lies in its box by then."""
    for _ in range(times):
        yield network.inbox(node, port).arrival()
        seen.append((clock.now, [message.body for message in network.inbox(node, port).drain()]))


@pytest.mark.parametrize("senders", [(1,), (3, 1, 2)])
def test_a_message_wakes_its_receiver_once_all_messages_of_that_instant_have_arrived(senders):
    """So it does at once if it is there already: 7 ns later."""
    clock = Clock()
    network = Network(clock, nx.complete_graph(4), Links(latency=Constant(value=0.5)))
    seen = []

    def receive():
        yield from listening(clock, network, 0, seen)
        yield clock.timeout(SECOND // 2 + 7)
        yield from listening(clock, network, 0, seen)

    for node in senders:
        network.send(node, 0, node)
    Instant(clock, SECOND // 2, Phase.SAMPLE).callbacks.append(lambda _: network.send(1, 0, "early"))
    run_process(clock, receive())
    assert seen == [(SECOND // 2, [*senders]), (SECOND + 7, ["early"])]


def test_a_timeout_never_swallows_a_message():
    """`store.get() | timeout` loses what arrives after the time-out in SimPy 4.1; waiting here does not consume."""
    clock = Clock()
    network = Network(clock, nx.complete_graph(2), Links(latency=Constant(value=2.0)))
    seen = []

    def receive():
        inbox = network.inbox(1)
        yield inbox.arrival() | clock.timeout(SECOND)
        seen.append((clock.now, inbox.drain()))
        yield clock.timeout(2 * SECOND)
        seen.append((clock.now, [m.body for m in inbox.drain()]))
        yield inbox.arrival() | clock.timeout(SECOND)
        seen.append((clock.now, inbox.drain()))

    network.send(0, 1, "late")
    run_process(clock, receive())
    assert seen == [(SECOND, []), (3 * SECOND, ["late"]), (4 * SECOND, [])]


def test_a_link_carries_any_number_of_messages_at_once():
    """The classic bug is a delay line that serves one message at a time: 5 sent 0.1 s apart with 1 s latency."""
    clock = Clock()
    trace = Trace()
    network = Network(clock, nx.complete_graph(2), Links(latency=Constant(value=1.0)), trace=trace)

    def transmit():
        for k in range(5):
            network.send(0, 1, k)
            yield clock.timeout(SECOND // 10)

    run_process(clock, transmit())
    arrivals = [event.arrival for event in trace.of(Sent)]
    assert [b - a for a, b in pairwise(arrivals)] == [SECOND // 10] * 4
    assert arrivals[0] == SECOND


def test_a_message_to_a_node_out_of_reach_is_lost_and_counted():
    clock = Clock()
    trace = Trace()
    network = Network(clock, nx.path_graph(3), trace=trace)
    network.send(0, 2, "far")
    clock.run()
    assert trace.of(Sent) == [Sent(0, 0, 0, 2, LOST, 0, 19, "far")]
    assert trace.of(Lost) == [Lost(0, 0, 0, 2, "out_of_range")]
    assert network.message_counts()[1:6] == (1, 0, 1, 0, {"out_of_range": 1})
    assert network.inbox(2).drain() == []


@pytest.mark.parametrize("latency", [Constant(value=0.02), Uniform(0.05), Uniform(0.05, per_hop=0.0)])
@pytest.mark.parametrize(("p", "twice"), [(0.0, 0.0), (0.25, 0.0), (0.25, 0.5), (1.0, 1.0)])
def test_every_sent_message_is_delivered_lost_or_in_flight_at_any_time(latency, p, twice):
    """The tally of the running network equals the count over its trace, for records and messages together."""
    clock = Clock()
    trace = Trace()
    links = Links(latency=latency, loss=Bernoulli(p=p), duplicate=Bernoulli(p=twice))
    network = Network(clock, nx.complete_graph(5), links, trace=trace)

    def transmit():
        for k in range(60):
            network.publish(k % 5, k)
            network.send((k + 1) % 5, None if k % 2 else (k + 2) % 5, k)
            yield Instant(clock, clock.now + SECOND // 1000, Phase.SAMPLE)
            network.latest_records((k + 3) % 5)
            now = clock.now
            arrivals = [a for e in trace.of(Sent) for a in [e.arrival]]
            for e in trace.of(Broadcast):
                arrivals += e.arrival if len(e.arrival) == len(e.dst) else e.arrival * len(e.dst)
            lost = sum(a == LOST for a in arrivals)
            flying = sum(a > now for a in arrivals)
            assert network.message_counts()[:5] == (now, len(arrivals), len(arrivals) - lost - flying, lost, flying)

    run_process(clock, transmit())


@pytest.mark.parametrize("medium", [Unlimited(), Bitrate(bitrate=8.0 * size_of(0)), CONTENDED])
def test_a_duplicate_is_a_message_of_its_own(medium):
    """All are transmitted twice, one after the other if it takes time: the inbox has two, the table one record.

    Each broadcast to two counts as four messages, each of which takes no time or 1 s.
    """
    clock = Clock()
    network = Network(clock, nx.complete_graph(3), Links(duplicate=Bernoulli(p=1.0), medium=medium))
    network.send(0, None, 1)
    network.publish(0, 1)
    clock.run(until=9 * SECOND)
    for node in (1, 2):
        assert [message.body for message in network.inbox(node).drain()] == [1, 1]
        assert network.latest_records(node)[0][1].seq == 1
    counts = network.message_counts()
    assert (counts.sent, counts.delivered, counts.transmissions) == (8, 8, 4)
    assert counts.bytes_sent == 4 * size_of(0)


@pytest.mark.slow
def test_the_copy_has_a_loss_and_a_latency_of_its_own():
    """Half of the messages to 1000 nodes are lost, so 3/4 of the nodes get the message or its copy. Of the nodes that
    get both, half get the copy first. Within 3 standard errors of a binomial; the control has no copies.
    """
    clock, count = Clock(), 1_000

    def arrivals(twice):
        links = Links(latency=Uniform(1.0), loss=Bernoulli(p=0.5), duplicate=Bernoulli(p=twice))
        network = Network(clock, nx.star_graph(count), links, trace=(trace := Trace()))
        network.send(0, None, "x")
        found = np.array([event.arrival for event in trace.of(Sent)]).reshape(-1, count)
        return found[:, (found != LOST).any(axis=0)]

    either = arrivals(1.0)
    both = either[:, (either != LOST).all(axis=0)]
    assert abs(either.shape[1] - 0.75 * count) < 3 * sqrt(count * 0.75 * 0.25)
    assert abs((both[1] < both[0]).mean() - 0.5) < 3 * 0.5 / sqrt(both.shape[1])
    assert abs(arrivals(0.0).shape[1] - 0.75 * count) > 3 * sqrt(count * 0.75 * 0.25)


@pytest.mark.parametrize("bad", [-1e-9, -1.0, float("nan"), float("inf")])
@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize("p", [0.0, 0.5])
def test_a_latency_that_is_not_a_time_is_refused(bad, many, p):
    """Converted without a check, each of them would be an instant in the past, and be read at once."""

    def latency(context, rng):
        return np.full(len(context.dst), bad) if many else bad

    network = Network(Clock(), nx.complete_graph(40), Links(latency=latency, loss=Bernoulli(p=p)))
    for tell in (network.publish, lambda src, body: network.send(src, None, body)):
        with pytest.raises(ValueError, match="latenc"):
            tell(0, "x")


def test_a_latency_beyond_the_longest_run_is_as_long_as_that():
    network = Network(Clock(), nx.complete_graph(3), Links(latency=lambda context, rng: np.array([0.5, 1e300])))
    network.publish(0, "x")
    assert [network._records.in_flight(), network._link_layer._sampler.arrivals(0, [1, 2], 7, 0, 0)] == [
        2,
        [SECOND // 2 + 7, 10**18 + 7],
    ]


@pytest.mark.parametrize("latency", [0, 1, np.float32(0.5), np.int64(1), np.array(0.5), 0.5])
def test_a_latency_may_be_any_kind_of_number(latency):
    clock = Clock()
    network = Network(clock, nx.complete_graph(3), Links(latency=lambda context, rng: latency))
    network.publish(0, "x")
    Instant(clock, round(float(latency) * SECOND), Phase.SAMPLE)
    clock.run()
    assert network.latest_records(1)[0] == (clock.now, Record(0, 1, 0, "x"))


@pytest.mark.slow
def test_a_node_that_never_reads_does_not_cost_ever_more_memory():
    clock = Clock()
    network = Network(clock, nx.complete_graph(5), Links(latency=Uniform(0.01)))

    def transmit():
        for k in range(12_000):
            network.publish(k % 4, k)
            yield Instant(clock, clock.now + SECOND // 1000, Phase.DECISION)

    run_process(clock, transmit())
    Instant(clock, clock.now + SECOND, Phase.SAMPLE)
    clock.run()
    assert len(network._records._own.unread[4]) < 10_000
    assert sorted(record.body for _, record in network.latest_records(4).values()) == [11_996, 11_997, 11_998, 11_999]


def test_arrivals_at_a_node_that_never_reads_are_decided_now_and_then(monkeypatch):
    """Half duplex decides arrivals at reads; node 0 reads after each of 1,000 broadcasts, node 4 never."""
    monkeypatch.setattr("desim.kernel.link_layer.arrivals.MAX_KEPT", 100)
    clock, medium = Clock(), Bitrate(bitrate=1e6, half_duplex=True)
    network = Network(clock, nx.complete_graph(5), Links(latency=Uniform(0.01), medium=medium))

    def transmit():
        for k in range(1_000):
            network.publish(k % 4, k)
            network.latest_records(0)
            yield Instant(clock, clock.now + SECOND // 1000, Phase.DECISION)

    run_process(clock, transmit())
    assert len(network._arrivals.kept) < 300


def test_arrivals_that_nobody_has_read_are_counted():
    """Half duplex decides arrivals at reads, and at the question how many there were."""
    clock, medium = Clock(), Bitrate(bitrate=1e6, half_duplex=True)
    network = Network(clock, nx.complete_graph(3), Links(latency=Uniform(0.01), medium=medium))
    network.publish(0, "x")
    clock.run(until=SECOND)
    counts = network.message_counts()
    assert (counts.sent, counts.delivered, counts.in_flight) == (2, 2, 0)


def test_messages_that_arrive_at_one_instant_arrive_in_the_order_in_which_they_were_sent():
    """The first message of node 0 flies on to node 2 after it has reached node 1; it is still before the second."""

    class Longer:
        def __call__(self, context, rng):
            return context.dst * 0.1 if context.src == 0 else np.full(len(context.dst), 0.2)

    clock = Clock()
    network = Network(clock, nx.complete_graph(4), Links(latency=Longer()))
    network.send(0, None, "first")
    network.send(3, 2, "second")
    Instant(clock, SECOND, Phase.SAMPLE)
    clock.run()
    assert [message.body for message in network.inbox(2).drain()] == ["first", "second"]


@pytest.mark.slow
@given(st.lists(st.tuples(st.integers(0, 5), st.lists(st.integers(0, 9), max_size=5)), max_size=20))
def test_messages_are_read_in_order_of_arrival_however_late_they_are_read(steps):
    """In each step so many ns pass, the box is emptied, and messages leave that arrive so many ns later."""
    clock = Clock()
    boxes, number, waiting = Inboxes(clock, 1), 0, []
    (box,) = boxes.at("")
    for pause, delays in [*steps, (20, [])]:
        clock.run(until=clock.now + pause + 1)
        arrived = sorted(letter for letter in waiting if letter[0] <= clock.now)
        assert [message.body for message in box.drain()] == [body for _, body in arrived]
        waiting = [letter for letter in waiting if letter not in arrived]
        assert box.in_flight() == len(waiting)
        for delay in delays:
            boxes.deliver(Message(0, clock.now, number), "", [0], clock.now + delay, number)
            waiting.append((clock.now + delay, number))
            number += 1
    assert not waiting


def test_a_message_that_overtakes_another_wakes_its_receiver_first():
    clock = Clock()
    network = Network(clock, nx.complete_graph(3), Links(latency=lambda context, rng: (0.0, 3.0, 1.0)[context.src]))
    seen = []
    clock.process(listening(clock, network, 0, seen, times=2))
    Instant(clock, 5, Phase.SAMPLE).callbacks.append(lambda _: network.send(1, 0, "slow"))
    Instant(clock, 6, Phase.SAMPLE).callbacks.append(lambda _: network.send(2, None, "fast"))
    clock.run()
    assert seen == [(SECOND + 6, ["fast"]), (3 * SECOND + 5, ["slow"])]


@pytest.mark.parametrize("latency", [Constant(value=1.0), Uniform(1.0)], ids=["alike", "per receiver"])
def test_a_broadcast_wakes_all_waiting_receivers_in_id_order_and_reaches_every_inbox(latency):
    clock = Clock()
    network = Network(clock, nx.complete_graph(4), Links(latency=latency))
    woken = {node: [] for node in (2, 3, 1)}
    order = []

    def receive(node):
        yield network.inbox(node, "port").arrival()
        order.append(node)
        woken[node] = [message.body for message in network.inbox(node, "port").drain()]

    for node in woken:
        clock.process(receive(node))
    Instant(clock, 1, Phase.SAMPLE).callbacks.append(lambda _: network.send(0, None, "all", port="port"))
    clock.run(until=3 * SECOND)
    assert woken == {node: ["all"] for node in (1, 2, 3)}
    assert order == [1, 2, 3] or not isinstance(latency, Constant)
    assert not any(network.inbox(node).drain() for node in range(4))


@pytest.mark.parametrize("node", [-1, 3])
@pytest.mark.parametrize(
    "use",
    [
        lambda network, node: network.send(0, node, "x"),
        lambda network, node: network.send(node, 0, "x"),
        lambda network, node: network.send(node, None, "x"),
        lambda network, node: network.publish(node, "x"),
        lambda network, node: network.set_initial_belief(node, "x"),
        lambda network, node: network.insert(node, network.next_record(0, "x")),
        lambda network, node: network.latest_records(node),
        lambda network, node: network.matching(node),
        lambda network, node: network.inbox(node),
        lambda network, node: network.crash(node),
    ],
)
def test_an_unknown_node_is_refused(use, node):
    with pytest.raises(ValueError, match=rf"there is no node {node}: the nodes are 0 \.\. 2"):
        use(Network(Clock(), nx.complete_graph(3)), node)


@pytest.mark.parametrize(
    ("transmit", "why"),
    [
        (lambda network: network.send(1, 1, "x"), "node 1 should not send messages to itself"),
        (lambda network: network.send(0, 1, "x", size=-8), r"at least 0 bytes \(got -8\)"),
        (lambda network: network.publish(0, "x", size=-8), r"at least 0 bytes \(got -8\)"),
        (lambda network: network.send(0, 1, "x", 40), r"send: a port should be a text.*\(got 40\)"),
        (lambda network: network.send(0, 1, "x", transport="reliable"), "transport should be BestEffort"),
        (lambda network: network.inbox(1, ["a"]), r"node 1: a port should be a text.*\(got \['a'\]\)"),
    ],
)
def test_a_message_to_oneself_or_of_negative_size_is_refused(transmit, why):
    with pytest.raises(ValueError, match=why):
        transmit(Network(Clock(), nx.complete_graph(3)))


@pytest.mark.parametrize(("loss", "last"), [((), 3 * SECOND), ((2,), SECOND), ((1, 2), LOST)])
def test_a_listener_is_told_of_the_last_arrival_that_is_not_lost(loss, last):
    """The latency to node j is 1 s for j = 1 and 3 s for j = 2."""
    links = Links(
        latency=lambda context, rng: 2.0 * context.dst - 1.0, loss=lambda context, rng: np.isin(context.dst, loss)
    )
    network, heard = Network(Clock(), nx.complete_graph(3), links), []
    network.overhear(lambda content, arrival: heard.append((content.body, arrival)))
    network.publish(0, "x")
    assert heard == [("x", last)]


def test_a_broadcast_without_receivers_is_recorded_as_such():
    trace = Trace()
    Network(Clock(), nx.empty_graph(2), trace=trace).publish(0, "x")
    assert trace.of(Broadcast) == [Broadcast(0, 0, 0, 1, (), (), 0, 17, "x")]


@pytest.mark.parametrize("fault_state", [None, FaultState()], ids=["noted at sending", "settled on arrival"])
@pytest.mark.parametrize("count", [1, 2, 4])
@pytest.mark.parametrize("transmit", [lambda net: net.publish(0, "x"), lambda net: net.send(0, None, "x")])
def test_no_receiver_is_forgotten_or_invented_by_a_latency_model_that_miscounts(transmit, count, fault_state):
    """A transmission to 3 whose model answers for 1, 2 or 4 is refused as it leaves; nothing of it arrives."""
    clock = Clock()
    links = Links(latency=lambda context, rng: [0.5] * count)
    network = Network(clock, nx.complete_graph(4), links, fault_state=fault_state)
    with pytest.raises(ValueError, match=rf"each of 3 links, got {re.escape(str([0.5] * count))} from <lambda>"):
        transmit(network)
    clock.run(until=SECOND)
    assert not any(network.latest_records(node) or network.inbox(node).drain() for node in range(4))


def test_a_record_that_overtakes_another_in_the_queue_of_its_source_stays_the_newest():
    """Record 1 waits 1 s for the transmitter; record 2 reaches node 1 by other means before, and is read."""
    clock = Clock()
    network = Network(clock, nx.complete_graph(3), Links(medium=Bitrate(bitrate=8.0), latency=Uniform(0.05)))
    network.send(0, 2, None, size=1)
    network.publish(0, "first", size=1)
    network.insert(1, network.next_record(0, "second"))
    assert network.latest_records(1)[0][1].body == "second"
    Instant(clock, 5 * SECOND, Phase.SAMPLE)
    clock.run()
    assert network.message_counts().delivered == 3
    assert network.latest_records(1)[0][1].body == "second"
    assert network.latest_records(2)[0][1].body == "first"
