"""Transmitters: queues against their theory, half duplex, what is dropped, what is counted."""

from math import inf, sqrt
from typing import NamedTuple

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.kernel.channel.transmitter import Transmitter
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import Broadcast, Lost, Queued, Sent, Trace
from desim.kernel.core.units import SECOND
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links, Processing
from desim.kernel.models.medium import Bitrate
from desim.kernel.network import Network
from desim.kernel.state.fault_state import FaultState

SEEDS = range(6)
BYTE = Bitrate(bitrate=8.0)
"""A second for a byte."""


def medium(**rest):
    return Bitrate(bitrate=8.0, **rest)


def network(size, medium, **rest):
    """Return a clock, a network that is complete, and its trace."""
    clock, trace = Clock(), Trace()
    return clock, Network(clock, nx.complete_graph(size), Links(medium=medium, **rest), trace=trace), trace


def later(clock, t, act, *arguments, **named):
    """Let something happen at a time, s."""
    Instant(clock, round(t * SECOND), Phase.DECISION).callbacks.append(lambda _: act(*arguments, **named))


def run_until(clock, t):
    clock.run(until=round(t * SECOND))


# One transmitter.


def test_a_message_is_readable_after_its_airtime_and_the_next_waits_for_it():
    """3 bytes, 2 bytes and 1 byte at 0, 1 and 10 s leave at 0, 3 and 10 s and arrive at 3, 5 and 11 s."""
    clock, net, trace = network(2, BYTE)
    for t, size in ((0.0, 3), (1.0, 2), (10.0, 1)):
        later(clock, t, net.send, 0, 1, None, size=size)
    run_until(clock, 20.0)
    sent = trace.of(Sent)
    assert [each.created // SECOND for each in sent] == [0, 1, 10]
    assert [each.t // SECOND for each in sent] == [0, 3, 10]
    assert [each.arrival // SECOND for each in sent] == [3, 5, 11]
    assert [(each.t // SECOND, each.size) for each in trace.of(Queued)] == [(1, 2)]


def test_a_record_is_readable_after_its_airtime_latency_and_processing():
    """0.5 s to send, 3 s on the air, 2 s on the way, 1 s to read; readable at 6.5 s and not a nanosecond before."""
    clock, net, trace = network(2, BYTE, latency=Constant(value=2.0), processing=Processing(sender=0.5, receiver=1.0))
    net.publish(0, "word", size=3)
    run_until(clock, 6.499999999)
    assert net.latest_records(1) == {}
    run_until(clock, 6.500000001)
    assert net.latest_records(1)[0][0] == 6.5 * SECOND
    assert trace.of(Broadcast)[0].arrival == (6_500_000_000,)


def lindley(times, airtimes):
    """Return how long each of the customers of one server waits: W' = max(0, W + S - A)."""
    waits = [0]
    for gap, service in zip(np.diff(times).tolist(), airtimes, strict=False):
        waits.append(max(0, waits[-1] + service - gap))
    return waits


@pytest.mark.slow
@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 3), st.integers(0, 4)), max_size=40), st.booleans())
def test_every_wait_is_that_of_lindley_s_recursion(traffic, shared):
    """For any arrivals (s) at any nodes, ties and messages of no length included, alone or on one shared channel."""
    clock, net, trace = network(4, medium(shared=shared))
    traffic.sort(key=lambda each: each[0])
    for t, node, size in traffic:
        later(clock, t, net.publish, node, None, size=size)
    run_until(clock, 1000.0)
    for nodes in [{0, 1, 2, 3}] if shared else [{0}, {1}, {2}, {3}]:
        mine = [(t * SECOND, size * SECOND) for t, node, size in traffic if node in nodes]
        theory = lindley(*zip(*mine, strict=True)) if mine else []
        assert [each.t - each.created for each in trace.of(Broadcast) if each.src in nodes] == theory


def poisson_traffic(rate, sizes, seed, nodes=1, limit=inf, count=4000):
    """Return the trace of Poisson arrivals (1/s) of messages with sizes(rng, count) bytes at 8 kbit/s."""
    radio = Bitrate(bitrate=8000.0, shared=nodes > 1, queue_limit=limit)
    clock, net, trace = network(nodes + 1, radio)
    rng = np.random.default_rng(seed)
    times, speakers = np.cumsum(rng.exponential(1.0 / rate, count)), rng.integers(nodes, size=count)
    for t, src, size in zip(times.tolist(), speakers.tolist(), sizes(rng, count), strict=True):
        later(clock, t, net.send, src, nodes, None, size=size)
    clock.run(until=round((times[-1] + 1e5) * SECOND))
    return trace, net


def mean_waits(rate, sizes, nodes=1, count=2400):
    """Return the mean wait of each of the seeds, s; the first 400 messages find a queue that is too short."""
    traces = [poisson_traffic(rate, sizes, seed, nodes, count=count)[0] for seed in SEEDS]
    return np.array([np.mean([each.t - each.created for each in trace.of(Sent)[400:]]) for trace in traces]) / SECOND


def fixed(rng, count):
    return [1000] * count


def exponential(rng, count):
    """Mean 1000 bytes, so that a byte more or less does not matter."""
    return np.rint(rng.exponential(1000.0, count)).astype(int).tolist()


def mixed(rng, count):
    """Return sizes with a mean of 1000 bytes and a mean square of 1.75e6."""
    return rng.choice([500, 2500], p=[0.75, 0.25], size=count).tolist()


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(
    ("sizes", "nodes", "theory", "other"),
    [
        (fixed, 3, lambda rho: rho / (2 * (1 - rho)), lambda rho: rho / (1 - rho)),
        (exponential, 1, lambda rho: rho / (1 - rho), lambda rho: rho / (2 * (1 - rho))),
        (mixed, 1, lambda rho: 1.75 * rho / (2 * (1 - rho)), lambda rho: rho / (2 * (1 - rho))),
    ],
)
def test_the_mean_wait_is_that_of_the_queue(sizes, nodes, theory, other):
    """M/D/1: rho S / (2 (1 - rho)); M/M/1: rho S / (1 - rho), with S = 1 s and rho = 0.5; also on a shared channel.

    M/G/1: rho E[S^2] / (2 S (1 - rho)), Pollaczek and Khinchin (Kleinrock 1975, section 5.7).

    The standard error is that of the mean over 6 seeds of 2000 messages, 4 to 7 %. The controls are the other queue,
    and a load 20 % higher.
    """
    waits = mean_waits(0.5, sizes, nodes)
    error = waits.std(ddof=1) / sqrt(waits.size)
    assert error < 0.07 * theory(0.5)
    assert abs(waits.mean() - theory(0.5)) < 5 * error
    assert abs(waits.mean() - other(0.5)) > 5 * error
    assert abs(waits.mean() - theory(0.6)) > 5 * error


# A full queue.


@pytest.mark.parametrize(("limit", "dropped"), [(0, "BCDE"), (1, "BCD"), (3, "B"), (4, ""), (inf, "")])
def test_of_a_full_queue_the_oldest_is_dropped(limit, dropped):
    """A takes 10 s; B, C, D, E come while it is on the air, a second apart, and wait."""
    clock, net, trace = network(3, medium(queue_limit=limit))
    for t, name in enumerate("ABCDE"):
        later(clock, t, net.send, 0, 1, name, size=10)
    run_until(clock, 100.0)
    assert "".join(each.body for each in trace.of(Sent)) == "".join(sorted(set("ABCDE") - set(dropped)))
    assert [(each.transmission, each.cause) for each in trace.of(Lost)] == [
        ("ABCDE".index(name), "queue") for name in dropped
    ]
    tally = net.message_counts()
    assert (tally.sent, tally.delivered, tally.lost, tally.in_flight) == (5, 5 - len(dropped), len(dropped), 0)
    assert tally.lost_by == ({"queue": len(dropped)} if dropped else {})
    assert (tally.transmissions, tally.bytes_sent) == (5 - len(dropped), 10 * (5 - len(dropped)))


def test_a_dropped_message_counts_for_each_of_its_receivers():
    clock, net, trace = network(4, medium(queue_limit=0))
    net.publish(0, "on the air", size=5)
    net.publish(0, "dropped", size=5)
    run_until(clock, 10.0)
    assert net.message_counts().lost_by == {"queue": 3}
    assert [each.dst for each in trace.of(Lost)] == [1, 2, 3]


def test_the_limit_of_a_shared_channel_is_for_each_node():
    """Node 0 is on the air; 1, 2 and 1 again wait, and only the second message of 1 drops its first."""
    clock, net, trace = network(3, medium(shared=True, queue_limit=1))
    for number, node in enumerate((0, 1, 2, 1)):
        later(clock, 0.0, net.publish, node, number, size=1)
    run_until(clock, 10.0)
    assert [(each.src, each.body) for each in trace.of(Broadcast)] == [(0, 0), (2, 2), (1, 3)]


def test_no_node_misses_messages_on_a_shared_channel_however_long_they_travel():
    """The next node transmits as soon as the channel is free, while the last message is still on its way."""
    clock, net, _ = network(3, medium(shared=True, half_duplex=True), latency=Constant(value=0.5))
    for node in (0, 1, 2):
        later(clock, 0.0, net.publish, node, None, size=1)
    run_until(clock, 10.0)
    assert net.message_counts()[1:4] == (6, 6, 0)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("limit", [0, 1, 3])
def test_the_share_that_a_full_queue_drops_is_that_of_m_m_1_k(limit):
    """(1 - rho) rho^K / (1 - rho^(K + 1)), K = limit + 1, whichever message is dropped, as sizes are exponential; rho =
    0.8.

    The standard error is that of the mean over 6 seeds of 1500 messages; the control is a queue of one more.
    """

    def theory(k, rho=0.8):
        return (1 - rho) * rho**k / (1 - rho ** (k + 1))

    shares = [poisson_traffic(0.8, exponential, seed, limit=limit, count=1500)[1].message_counts() for seed in SEEDS]
    shares = np.array([each.lost_by["queue"] / each.sent for each in shares])
    error = shares.std(ddof=1) / sqrt(shares.size)
    assert error < 0.02
    assert abs(shares.mean() - theory(limit + 1)) < 5 * error
    assert abs(shares.mean() - theory(limit + 2)) > 5 * error


# Shared and separate channels.


@pytest.mark.parametrize(("shared", "departures"), [(True, [0, 1, 2]), (False, [0, 0, 0])])
def test_nodes_wait_for_each_other_only_on_a_shared_channel(shared, departures):
    clock, net, trace = network(3, medium(shared=shared))
    for node in (2, 0, 1):
        net.publish(node, None, size=1)
    run_until(clock, 5.0)
    assert [each.t // SECOND for each in trace.of(Broadcast)] == departures
    assert [each.src for each in trace.of(Broadcast)] == [2, 0, 1]


# Half duplex.


def received_by(net, clock, nodes=(0, 1, 2)):
    return [[each.src for each in net.inbox(node).drain()] for node in nodes]


@pytest.mark.parametrize("half_duplex", [True, False])
def test_a_transmitting_node_cannot_receive_on_half_duplex(half_duplex):
    """0 transmits from 0 to 2 s, 1 from 1 to 3 s: neither receives from the other, 2 receives both."""
    clock, net, trace = network(3, medium(half_duplex=half_duplex))
    later(clock, 0.0, net.send, 0, None, None, size=2)
    later(clock, 1.0, net.send, 1, None, None, size=2)
    run_until(clock, 5.0)
    assert received_by(net, clock) == ([[], [], [0, 1]] if half_duplex else [[1], [0], [0, 1]])
    lost = [(each.t // SECOND, each.src, each.dst, each.cause) for each in trace.of(Lost)]
    assert lost == ([(2, 0, 1, "half_duplex"), (3, 1, 0, "half_duplex")] if half_duplex else [])
    assert net.message_counts().lost_by == ({"half_duplex": 2} if half_duplex else {})


@pytest.mark.parametrize("reading", [0.0, 1.0])
def test_nodes_that_transmit_in_turn_lose_nothing_on_half_duplex(reading):
    """A reception that ends as a transmission begins, or begins as one ends, succeeds; 1 ns of overlap is too much."""
    for shift, heard in ((0.0, [[1], [0]]), (-1e-9, [[], []]), (1e-9, [[1], [0]])):
        clock, net, _ = network(2, medium(half_duplex=True), processing=Processing(receiver=reading))
        later(clock, 1.0, net.send, 0, 1, None, size=2)
        later(clock, 3.0 + shift, net.send, 1, 0, None, size=2)
        run_until(clock, 9.0)
        assert received_by(net, clock, (0, 1)) == heard


def test_half_duplex_is_evaluated_at_the_reception_not_the_transmission():
    """Sound with 10 s of latency: 1 may transmit while 0 does, not from 10 to 12 s, as the message of 0 comes in."""
    for begins, heard in ((0.0, [0]), (8.0, [0]), (9.5, []), (11.5, []), (12.0, [0])):
        clock, net, _ = network(3, medium(half_duplex=True), latency=Constant(value=10.0))
        later(clock, 0.0, net.send, 0, 1, None, size=2)
        later(clock, begins, net.send, 1, 2, None, size=2)
        run_until(clock, 40.0)
        assert received_by(net, clock, (1,)) == [heard]


def test_a_message_is_still_judged_by_when_it_came_in_if_reading_takes_long():
    """It comes in from 0 to 2 s and is readable at 102 s; 1 has transmitted from 1 to 3 s, and often since."""
    clock, net, _ = network(2, medium(half_duplex=True), processing=Processing(receiver=100.0))
    later(clock, 0.0, net.send, 0, 1, "unheard", size=2)
    later(clock, 10.0, net.send, 0, 1, "heard", size=2)
    for t in (1.0, *range(20, 90, 5)):
        later(clock, t, net.send, 1, 0, None, size=2)
    run_until(clock, 300.0)
    assert [each.body for each in net.inbox(1).drain()] == ["heard"]


def test_a_long_message_is_lost_to_an_earlier_short_transmission():
    """It comes in from 0 to 50 s and is readable at 150 s; 1 transmitted at 5 s, and at 120 s, when it must remember
    that.
    """
    clock, net, _ = network(3, medium(half_duplex=True), processing=Processing(receiver=100.0))
    later(clock, 0.0, net.send, 0, 1, None, size=50)
    later(clock, 5.0, net.send, 1, 2, None, size=1)
    later(clock, 120.0, net.send, 1, 2, None, size=1)
    run_until(clock, 300.0)
    assert received_by(net, clock, (1,)) == [[]]


@pytest.mark.slow
@given(st.lists(st.tuples(st.integers(0, 15), st.integers(0, 2), st.integers(1, 4)), max_size=15), st.integers(0, 3))
def test_half_duplex_losses_are_the_overlaps_of_receptions_and_transmissions(traffic, latency):
    """Against all pairs of intervals, without any bookkeeping: [leave, leave + airtime), moved by the latency."""
    clock, net, trace = network(3, medium(half_duplex=True), latency=Constant(value=float(latency)))
    for t, node, size in traffic:
        later(clock, t, net.publish, node, None, size=size)
    run_until(clock, 500.0)
    spoke = [
        (each.src, each.t // SECOND, each.t // SECOND + each.size, each.transmission) for each in trace.of(Broadcast)
    ]
    deaf = {
        (transmission, dst)
        for src, begin, end, transmission in spoke
        for dst in {0, 1, 2} - {src}
        for own, since, until, _ in spoke
        if own == dst and since < end + latency and until > begin + latency
    }
    assert {(each.transmission, each.dst) for each in trace.of(Lost)} == deaf


# What is counted.


@pytest.mark.parametrize("shared", [True, False])
def test_utilisation_is_the_share_of_the_time_in_which_the_channels_are_busy(shared):
    """Node 0 transmits from 0 to 4 s, node 1 for 2 s, at once or after it; 2 nodes have 2 channels or share one."""
    clock, net, _ = network(2, medium(shared=shared))
    assert net.message_counts().utilisation == 0.0
    net.publish(0, None, size=4)
    net.publish(1, None, size=2)
    # Busy until 1, 3, 5, 10 s: of two channels 2, 5, 6, 6 s, of one 1, 3, 5, 6 s.
    for t, busy in ((1, 1), (3, 3), (5, 5), (10, 6)) if shared else ((1, 2), (3, 5), (5, 6), (10, 6)):
        run_until(clock, t)
        assert net.message_counts().utilisation == pytest.approx(busy / (t * (1 if shared else 2)))


def test_bytes_and_transmissions_count_once_and_messages_per_receiver():
    """At 1 s the first 3 bytes are on the air to 3 nodes, and 2 more wait; at 5 s all are delivered."""
    clock, net, _ = network(4, medium())
    net.publish(0, None, size=3)
    net.publish(0, None, size=2)
    run_until(clock, 1.0)
    tally = net.message_counts()
    assert (tally.sent, tally.delivered, tally.in_flight) == (6, 0, 6)
    assert (tally.transmissions, tally.bytes_sent) == (1, 3)
    run_until(clock, 5.5)
    tally = net.message_counts()
    assert (tally.sent, tally.delivered, tally.in_flight) == (6, 6, 0)
    assert (tally.transmissions, tally.bytes_sent) == (2, 5)


# The transmitters alone.


class Item(NamedTuple):
    src: int
    size: int
    name: str = "A"

    @property
    def number(self):
        """Names differ by their letter."""
        return ord(self.name)


def leaving(medium, given, until=20.0):
    """Return when what leaves transmitters alone, as a list of (s, name); `given` does things with them at once."""
    clock, left = Clock(), []
    radio = Transmitter(
        clock, medium, 2, lambda item, *_: left.append((clock.now // SECOND, item.name)), *[lambda *_: None] * 2
    )
    given(clock, radio)
    run_until(clock, until)
    return left


@pytest.mark.parametrize(("breakdown", "heard"), [(1.999, 0), (2.0, 1)])
def test_a_fully_transmitted_message_survives_a_crash_of_its_transmitter(breakdown, heard):
    """Two bytes are on the air until 2 s, and arrive a second later."""
    clock, links = Clock(), Links(medium=BYTE, latency=Constant(value=1.0))
    radio = Network(clock, nx.complete_graph(2), links, fault_state=FaultState())
    radio.send(0, 1, "A", size=2)
    later(clock, breakdown, radio.crash, 0)
    run_until(clock, 4.0)
    assert len(radio.inbox(1).drain()) == heard


def test_a_queued_message_to_a_node_that_is_not_linked_is_lost():
    clock = Clock()
    radio = Network(clock, nx.path_graph(3), Links(medium=BYTE))
    for dst in (1, 2):
        radio.send(0, dst, None, size=2)
    clock.run()
    counts = radio.message_counts()
    assert (counts.delivered, counts.lost_by) == (1, {"out_of_range": 1})


def test_a_node_that_leaves_the_range_while_a_message_is_queued_does_not_receive_it():
    """While A is on the air for 2 s the receiver leaves the range; B, which waits, is lost to it."""
    clock = Clock()

    def places():
        return np.array([[0.0, 0.0], [1.0 if clock.now < SECOND else 9.0, 0.0]])

    links = Links(medium=BYTE, range=5.0, range_check="send")
    radio = Network(clock, nx.complete_graph(2), links, positions=places)
    for body in "AB":
        radio.send(0, None, body, size=2)
    run_until(clock, 5.0)
    assert [message.body for message in radio.inbox(1).drain()] == ["A"]
    assert radio.message_counts().lost_by == {"out_of_range": 1}


def test_the_queued_messages_of_a_node_are_withdrawn_and_the_others_remain():
    """On a shared channel of messages of 2 s: A and C are of node 0, B and D of node 1, whose radio fails at 1 s."""

    def given(clock, radio):
        for src, name in enumerate("ABCD"):
            radio.enqueue(Item(src % 2, 2, name))
        run_until(clock, 1.0)
        assert [item.name for item in radio.waiting()] == ["B", "C", "D"]
        assert [item.name for item in radio.flush(1)] == ["B", "D"]
        run_until(clock, 10.0)
        assert list(radio.waiting()) == []
        assert radio.busy_time() == 4 * SECOND

    assert leaving(medium(shared=True), given) == [(0, "A"), (2, "C")]


def test_after_the_queue_is_withdrawn_the_next_message_waits_for_the_ongoing_transmission():
    def given(clock, radio):
        radio.enqueue(Item(0, 5, "A"))
        radio.enqueue(Item(0, 1, "B"))
        run_until(clock, 1.0)
        radio.flush(0)
        radio.enqueue(Item(0, 2, "C"))
        radio.enqueue(Item(0, 2, "D"))

    assert leaving(medium(), given) == [(0, "A"), (5, "C"), (7, "D")]


def test_no_message_overtakes_the_queue_at_the_instant_the_transmitter_becomes_free():
    """A takes 2 s and B waits; C comes at 2 s, in a phase before that in which B leaves."""

    def given(clock, radio):
        for name in "AB":
            radio.enqueue(Item(0, 2, name))
        Instant(clock, 2 * SECOND, Phase.FAULT).callbacks.append(lambda _: radio.enqueue(Item(0, 2, "C")))

    assert leaving(medium(), given) == [(0, "A"), (2, "B"), (4, "C")]


def test_messages_of_no_length_leave_at_once_and_in_order():
    def given(clock, radio):
        for name in "ABCDE":
            radio.enqueue(Item(0, 3 if name == "C" else 0, name))

    assert leaving(medium(), given) == [(0, "A"), (0, "B"), (0, "C"), (3, "D"), (3, "E")]


# The cost of a queue.


class Counted(NamedTuple):
    """A transmission that counts how often its sender is looked at."""

    number: int
    sender: int
    looks: list[int]
    size: int = 1
    receivers: tuple[int, ...] = ()
    to_one: bool = False

    @property
    def src(self):
        self.looks[0] += 1
        return self.sender


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("limit", [0.0, 1.0, 50.0, inf])
def test_a_message_that_waits_costs_the_same_whatever_the_queue_holds(shared, limit):
    """Two nodes send 200 messages each at once; a walk through the queue for each would look at 40,000."""
    clock, looks, left, dropped = Clock(), [0], [], []
    transmitter = Transmitter(
        clock,
        medium(shared=shared, queue_limit=limit),
        2,
        leave=lambda item, airtime: left.append(item.number),
        wait=lambda item: None,
        drop=lambda item: dropped.append(item.number),
    )
    for number in range(400):
        transmitter.enqueue(Counted(number, number % 2, looks))
    clock.run()
    assert looks[0] <= 4 * 400
    assert sorted(left + dropped) == list(range(400))
    assert left == sorted(left)
    assert len(dropped) == (0 if limit == inf else 400 - len(left))


@pytest.mark.slow
@given(st.data(), st.booleans(), st.sampled_from([0.0, 1.0, 3.0, inf]))
def test_queues_are_those_of_lists(data, shared, limit):
    """The plain way: each channel has a list, and a full node removes its first transmission in it."""
    clock, events = Clock(), []
    transmitter = Transmitter(
        clock,
        medium(shared=shared, queue_limit=limit),
        3,
        leave=lambda item, airtime: events.append(("leave", item.number)),
        wait=lambda item: None,
        drop=lambda item: events.append(("drop", item.number)),
    )
    expected, queues, on_air = [], [[] for _ in range(3)], [None] * 3
    actions = st.one_of(st.tuples(st.just("send"), st.integers(0, 2)), st.tuples(st.just("flush"), st.integers(0, 2)))
    for number, (action, node) in enumerate(data.draw(st.lists(actions, max_size=30))):
        queue, channel = queues[0 if shared else node], 0 if shared else node
        if action == "flush":
            flushed = [item for item in queue if item.src == node]
            assert transmitter.flush(node) == flushed
            queue[:] = [item for item in queue if item.src != node]
            continue
        item = Counted(number, node, [0])
        transmitter.enqueue(item)
        if on_air[channel] is None:
            on_air[channel] = number
            expected.append(("leave", number))
            continue
        queue.append(item)
        of_node = [waiting for waiting in queue if waiting.src == node]
        if len(of_node) > limit:
            queue.remove(of_node[0])
            expected.append(("drop", of_node[0].number))
    assert events == expected
    assert list(transmitter.waiting()) == [item for queue in queues for item in queue]
    clock.run()
    left = [number for what, number in events[len(expected) :]]
    assert sorted(left) == sorted(item.number for queue in queues for item in queue)
    if shared:
        assert left == [item.number for item in queues[0]]
