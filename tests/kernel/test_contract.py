"""What becomes of a message, record or mail alike, when something happens while it is on its way.

The outcome of a message is determined at transmission and at arrival. In between nothing can happen to it. Faults come
first at an instant, then arrivals, then decisions: what begins as a message leaves or arrives concerns it, what ends
then does not.

| what happens                                                  | what becomes of the message                      |
|---------------------------------------------------------------|--------------------------------------------------|
| the receiver leaves the range while it flies                  | `range_check = "send"`: delivered;               |
|                                                               | `"delivery"` and `"both"`: lost, "out_of_range"  |
| the receiver enters the range while it flies                  | `"send"` and `"both"`: a broadcast is not sent   |
|                                                               | to it, a message to it alone is lost,            |
|                                                               | "out_of_range";                                  |
|                                                               | `"delivery"`: delivered                          |
| the receiver leaves the range and returns while it flies      | delivered                                        |
| a partition is open as it leaves                              | lost as it leaves, "partition", even if it heals |
| a partition begins while it flies and is open as it arrives   | lost as it arrives, "partition"                  |
| a partition begins and heals while it flies                   | delivered                                        |
| the receiver is in a jamming disc as it arrives               | lost as it arrives, "jamming"                    |
| the receiver passes through a jamming disc while it flies     | delivered                                        |
| the sender is down when it wants to send                      | nothing is sent or counted                       |
| the sender crashes while it flies                             | delivered                                        |
| the sender crashes while it is on the air, half transmitted   | lost as it would arrive, "crash"                 |
| the sender crashes while it waits to be put on the air        | lost at once, "crash"                            |
| the receiver is down as it arrives                            | lost as it arrives, "crash"                      |
| the receiver is down as it leaves, up as it arrives           | delivered                                        |
| the receiver crashes and recovers while it flies              | delivered, with memory or without                |
| the receiver crashes after it arrived, and recovers           | with memory it is still there, without it is not |
| the run ends while it flies, or waits to be put on the air    | counted as in flight                             |
"""

from math import inf
from typing import NamedTuple
from unittest.mock import patch

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import Broadcast, Lost, MessageCounts, Sent, Trace
from desim.kernel.core.positions import PositionSource
from desim.kernel.core.units import SECOND, nanoseconds, seconds
from desim.kernel.fault_injection import inject
from desim.kernel.link_layer.arrivals import Arrivals
from desim.kernel.link_layer.delivery import MessageDelivery
from desim.kernel.link_layer.link_layer import LinkLayer
from desim.kernel.link_layer.propagation import LinkSampler
from desim.kernel.models.access import CsmaCa
from desim.kernel.models.coherence import Coherence
from desim.kernel.models.faults import Crash, Jamming, MessageFault, Partition
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links, Processing
from desim.kernel.models.loss import Bernoulli, GilbertElliott
from desim.kernel.models.medium import Bitrate, Unlimited
from desim.kernel.models.reception import Disk, QuasiUnitDisk, Rice
from desim.kernel.network import Network
from desim.kernel.state.fault_state import FaultState
from desim.kernel.stepped_network import SteppedNetwork
from desim.kernel.topology.kept_receivers import KeptReceivers
from tests.kernel.layers import network_over
from tests.kernel.test_network import Uniform

WAYS = ("publish", "send", "send to all")
SENT, ARRIVAL = 1.0, 1.5
"""When the message is sent, and when it arrives, s."""
ONE_SECOND_EACH = Bitrate(bitrate=160.0)
"""A message has 20 bytes."""


class Outcome(NamedTuple):
    """The outcome of a message."""

    fate: str
    tally: tuple[int, int, int, int, dict[str, int]]
    """Sent, delivered, lost, in flight, lost by cause."""
    lost_at: list[int]


def outcome_of(way, *faults, away=(), check="send", latency=0.5, end=9.0, medium=None, times=(SENT,)):
    """Let node 0 send a message to node 1 and return its outcome.

    Args:
        way: how it is sent.
        faults: the faults to inject.
        away: pairs (from, until) in s during which node 1 is 9 m away, out of a range of 2 m; else it is at 1 m.
        check: when the range is checked.
        latency: s.
        end: when the run ends, s.
        medium: the medium of the links.
        times: when the message is sent, s.
    """
    clock, trace = Clock(), Trace()

    def positions():
        far = any(start <= seconds(clock.now) < stop for start, stop in away)
        return np.array([[0.0, 0.0], [9.0 if far else 1.0, 0.0]])

    links = Links(latency=Constant(value=latency), range=2.0, range_check=check, medium=medium or Unlimited())
    network = Network(
        clock, nx.complete_graph(2), links, positions=positions, trace=trace, fault_state=FaultState(positions)
    )
    inject(faults, clock, network, trace)
    for time in times:
        Instant(clock, nanoseconds(time), Phase.DECISION).callbacks.append(lambda _: transmit(network, way))
    Instant(clock, nanoseconds(end), Phase.SAMPLE).callbacks.append(lambda _: trace.append(network.message_counts()))
    clock.run(until=nanoseconds(end) + 1)
    tally = network.message_counts()
    read = 0 in network.latest_records(1) if way == "publish" else bool(network.inbox(1).drain())
    return Outcome(fate_of(tally, read), tally[1:6], [event.t for event in trace.of(Lost)])


def transmit(network, way):
    if way == "publish":
        network.publish(0, "word")
    else:
        network.send(0, 1 if way == "send" else None, "word")


def fate_of(tally, read):
    """Return the fate of a single message by its counts: delivered, the cause of its loss, in flight, or not sent."""
    assert read == (tally.delivered > 0)
    if read:
        return "delivered"
    return next(iter(tally.lost_by), None) or ("in flight" if tally.in_flight else "not sent")


def crash(node, at, until=inf, **options):
    return Crash(node=node, start=at, end=until, **options)


def partitioned(at, until=inf):
    return Partition(groups=((0,),), start=at, end=until)


def jammed(at, until=inf):
    """Return a disc around node 1 alone."""
    return Jamming(centre=(1.0, 0.0), radius=0.5, start=at, end=until)


def lost(cause, at):
    """Return the outcome of a message that is lost at a time, s."""
    return cause, (1, 0, 1, 0, {cause: 1}), [nanoseconds(at)]


def case(expected, *faults, **options):
    """Return a case: its fate, tally or whole outcome, perhaps by the way in which it is sent; and the faults and
    options.
    """
    return expected, faults, options


NOT_SENT = ("not sent", (0, 0, 0, 0, {}), [])
OUT_OF_RANGE = {"publish": NOT_SENT, "send": lost("out_of_range", SENT), "send to all": NOT_SENT}
CHECKS = ("send", "delivery", "both")
MEMORY = ({"memory": True}, {"memory": False})
AT_ONCE = {"latency": 0.0}
ON_THE_AIR = {"medium": ONE_SECOND_EACH}
TWICE = {**ON_THE_AIR, **AT_ONCE, "times": (SENT,) * 2}
AGAIN = {**ON_THE_AIR, "times": (SENT, SENT, 3.0)}
QUEUED = {**ON_THE_AIR, **AT_ONCE, "times": (SENT,) * 3}
PASSED = Jamming(centre=(9.0, 0.0), radius=0.5, start=0.0)
"""A disc that node 1 is in while it is away."""
CASES = {
    "the receiver leaves the range while it flies": [
        case("delivered" if check == "send" else "out_of_range", away=[(since, inf)], check=check)
        for check in CHECKS
        for since in (1.000000001, 1.2, ARRIVAL)
    ],
    "the receiver enters the range while it flies": [
        case("delivered" if check == "delivery" else OUT_OF_RANGE, away=[(0.0, until)], check=check)
        for check in CHECKS
        for until in (1.2, ARRIVAL)
    ],
    "the receiver leaves and returns while it flies": [
        case("delivered", away=[(1.1, 1.4)], check=check) for check in CHECKS
    ],
    "the receiver is never within range": [
        case("out_of_range" if check == "delivery" else OUT_OF_RANGE, away=[(0.0, inf)], check=check)
        for check in CHECKS
    ],
    "the range of a word that takes no time is judged at one instant": [
        *(case("delivered", away=[(0.5, SENT)], check=check, **AT_ONCE) for check in CHECKS),
        *(
            case("out_of_range" if check == "delivery" else OUT_OF_RANGE, away=[(SENT, 1.1)], check=check, **AT_ONCE)
            for check in CHECKS
        ),
    ],
    "a partition begins while it flies": [case(lost("partition", ARRIVAL), partitioned(at)) for at in (1.2, ARRIVAL)],
    "a partition begins just after the arrival": [case("delivered", partitioned(ARRIVAL + 1e-9))],
    "a partition begins and heals while it flies": [case("delivered", partitioned(1.1, end)) for end in (1.2, ARRIVAL)],
    "a partition is open as it leaves": [
        case(lost("partition", SENT), partitioned(start, stop))
        for start in (0.5, SENT)
        for stop in (1.000000001, 1.2, ARRIVAL, 2.0)
    ],
    "a partition heals as it leaves": [case("delivered", partitioned(0.5, SENT))],
    "a word that takes no time meets the partition of its instant": [
        case("partition", partitioned(SENT), **AT_ONCE),
        case("delivered", partitioned(0.5, SENT), **AT_ONCE),
        case("delivered", partitioned(SENT + 1e-9), **AT_ONCE),
    ],
    # The second of two messages waits from 1 s to 2 s; it leaves as the partition heals, or begins.
    "a partition counts as a message leaves the transmitter, not as it is spoken": [
        case((2, 2, 0, 0, {}), partitioned(1.5, 2.0), **TWICE),
        case((2, 0, 2, 0, {"partition": 2}), partitioned(2.0, 2.5), **TWICE),
    ],
    "the receiver is in a jamming disc as it arrives": [
        case(lost("jamming", ARRIVAL), jammed(at)) for at in (0.5, 1.2, ARRIVAL)
    ],
    "a jamming disc is gone as it arrives": [
        case("delivered", jammed(*window)) for window in ((0.5, ARRIVAL), (1.1, 1.2))
    ],
    "the receiver passes through a jamming disc": [
        case("delivered", PASSED, away=[(1.1, 1.4)]),
        case("jamming", PASSED, away=[(1.1, 1.6)]),
    ],
    "a word that takes no time meets the jamming of its instant": [
        case("jamming", jammed(SENT), **AT_ONCE),
        case("delivered", jammed(0.5, SENT), **AT_ONCE),
    ],
    "the sender is down when it wants to send": [
        case(NOT_SENT, crash(0, *window), latency=latency)
        for window in ((0.5, 2.0), (SENT, 1.2), (0.5, 1.000000001))
        for latency in (0.0, 0.5)
    ],
    "the sender recovers as it wants to send": [
        case("delivered", crash(0, 0.5, SENT), latency=latency) for latency in (0.0, 0.5)
    ],
    "the sender crashes while it flies": [case("delivered", crash(0, at)) for at in (1.000000001, 1.2, ARRIVAL)],
    # Half transmitted it is worth nothing, though the transmitter may be repaired before it would be over.
    "the sender crashes while it is on the air": [
        case(lost("crash", 2.5), crash(0, *window), **ON_THE_AIR)
        for window in ((SENT + 1e-9, 1.2), (1.5, inf), (1.999999999, inf))
    ],
    "the sender crashes as it has been transmitted": [case("delivered", crash(0, 2.0), **ON_THE_AIR)],
    # One has been transmitted at 2 s and arrives; two wait, and are lost at once.
    "the sender crashes while messages wait": [
        case(
            ("delivered", (3, 1, 2, 0, {"crash": 2}), [nanoseconds(2.0)] * 2),
            crash(0, 2.0),
            **ON_THE_AIR,
            times=(SENT,) * 3,
        )
    ],
    # Faults come first: at 2 s the transmitter is free, and the node down.
    "the sender crashes as the next would leave": [
        case((2, 1, 1, 0, {"crash": 1}), crash(0, 2.0), **ON_THE_AIR, times=(SENT,) * 2)
    ],
    # Spoken at 1 s, 1 s, 3 s: the first two are lost at 1.2 s, the third leaves at 3 s and arrives at 4.5 s.
    "what it says after its recovery is not held up by what was lost": [
        case((3, 1, 2, 0, {"crash": 2}), crash(0, 1.2, 2.5), **AGAIN, end=4.5),
        case((3, 0, 2, 1, {"crash": 2}), crash(0, 1.2, 2.5), **AGAIN, end=4.4),
    ],
    "the receiver is down as it arrives": [
        case(lost("crash", ARRIVAL), crash(1, *window))
        for window in ((1.2, inf), (ARRIVAL, inf), (0.5, 2.0), (ARRIVAL, 1.500000001))
    ],
    "the receiver is down as it leaves and up as it arrives": [
        case("delivered", crash(1, 0.5, until, **memory)) for until in (1.2, ARRIVAL) for memory in MEMORY
    ],
    "the receiver crashes and recovers while it flies": [
        case("delivered", crash(1, 1.1, 1.2, **memory)) for memory in MEMORY
    ],
    "a word that takes no time meets the crash of its instant": [
        case("crash", crash(1, SENT), **AT_ONCE),
        case("delivered", crash(1, 0.5, SENT), **AT_ONCE),
        case("delivered", crash(1, SENT + 1e-9), **AT_ONCE),
    ],
    "the run ends while it flies": [case(("in flight", (1, 0, 0, 1, {}), []), end=1.2), case("delivered", end=ARRIVAL)],
    "the run ends while messages wait": [
        case((3, 0, 0, 3, {}), end=1.5, **QUEUED),
        case((3, 1, 0, 2, {}), end=2.5, **QUEUED),
    ],
}


@pytest.mark.slow_but_one
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("cases", CASES.values(), ids=CASES)
def test_the_outcome_of_a_message(cases, way):
    for expected, faults, options in cases:
        outcome = outcome_of(way, *faults, **options)
        wanted = expected[way] if isinstance(expected, dict) else expected
        found = outcome.fate if isinstance(wanted, str) else outcome.tally if len(wanted) == 5 else outcome
        assert found == wanted, (faults, options)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("memory", [True, False])
def test_the_receiver_crashes_after_the_arrival(way, memory):
    """It has been delivered in any case; whether it is remembered is another matter."""
    clock, fault_state = Clock(), FaultState()
    network = Network(clock, nx.complete_graph(2), fault_state=fault_state)
    transmit(network, way)
    inject([crash(1, 1.0, 2.0, memory=memory)], clock, network)
    clock.run()
    assert network.message_counts()[1:5] == (1, 1, 0, 0)
    assert (0 in network.latest_records(1) if way == "publish" else bool(network.inbox(1).drain())) == memory


def test_several_causes_at_one_arrival_count_as_the_first_of_crash_partition_jamming_and_reach():
    def cause(*faults):
        return outcome_of("send", *faults, away=[(1.1, inf)], check="delivery").fate

    everything = [crash(1, 1.2), partitioned(1.2), Jamming(centre=(9.0, 0.0), radius=0.5, start=1.2)]
    assert [cause(*everything[k:]) for k in range(4)] == ["crash", "partition", "jamming", "out_of_range"]


@pytest.mark.parametrize("fault_state", [None, FaultState()])
def test_messages_arriving_at_one_instant_are_read_in_sending_order(fault_state):
    """Node 1 transmits at 0 s with 2 s of latency; node 0 transmits at 1 s with 1 s."""
    clock = Clock()
    links = Links(latency=lambda context, rng: 2.0 if context.src else 1.0)
    network = Network(clock, nx.complete_graph(3), links, fault_state=fault_state)
    network.send(1, 2, "first")
    Instant(clock, SECOND, Phase.DECISION).callbacks.append(lambda _: network.send(0, 2, "second"))
    Instant(clock, 2 * SECOND, Phase.SAMPLE)
    clock.run()
    assert [message.body for message in network.inbox(2).drain()] == ["first", "second"]


# A network whose messages land by events is the same as one whose messages need none.


ACTS = ("publish", "send", "send to all", "read", "drain", "tally")


@st.composite
def histories(draw):
    """A random graph, its links, and a random order of speaking and reading with many ties in time."""
    size, seed = draw(st.integers(2, 5)), draw(st.integers(0, 2**32))
    graph = nx.gnp_random_graph(size, draw(st.sampled_from([0.5, 1.0])), seed=seed, directed=draw(st.booleans()))
    latencies = [Constant(), Constant(value=0.02), Uniform(0.05), Uniform(0.002), Uniform(0.05, per_hop=0.0)]
    links = Links(
        latency=draw(st.sampled_from(latencies)),
        loss=Bernoulli(p=draw(st.sampled_from([0.0, 0.3, 1.0]))),
        range=draw(st.sampled_from([inf, 0.5])),
        order=draw(st.sampled_from(["overtaking", "fifo"])),
        medium=draw(st.sampled_from([Unlimited(), Bitrate(bitrate=24 * 8 * 500.0), Bitrate(bitrate=1e5, shared=True)])),
    )
    times = st.integers(0, 40).map(lambda k: k * SECOND // 1000)
    node = st.integers(0, size - 1)
    acts = draw(st.lists(st.tuples(times, node, node, st.sampled_from(ACTS)), max_size=60))
    return graph, links, acts, seed


class Swinging(PositionSource):
    """Nodes swing about the origin; every 7 ms they go on with another amplitude, so that no position jumps."""

    looks_back = True

    def __init__(self, clock, places):
        self.clock, self.places, self.since, self.acts = clock, places, 0, []
        for k in range(1, 30):
            Instant(clock, k * 7 * SECOND // 1000, Phase.MOTION).callbacks.append(self.turn)

    def turn(self, _):
        for act in self.acts:
            act()
        self.places, self.since = self(), self.clock.now

    def __call__(self):
        return self.at(np.arange(len(self.places)), np.array(self.clock.now))

    def at(self, nodes, times):
        return self.places[nodes] * np.cos(np.atleast_1d(times - self.since) / 1e7)[:, np.newaxis]

    def before_change(self, act):
        self.acts.append(act)


class Turning(Swinging):
    """Nodes go straight at one speed, m/s; every 7 ms each goes on in another direction."""

    def __init__(self, clock, places, speed):
        self.max_speed = speed
        self._turn(0)
        super().__init__(clock, places)

    def _turn(self, now):
        angles = 2.4 * (now // 7_000_000) + 1.7 * np.arange(5)
        self.velocity = self.max_speed * np.column_stack([np.cos(angles), np.sin(angles)])

    def turn(self, _):
        super().turn(_)
        self._turn(self.clock.now)

    def at(self, nodes, times):
        return self.places[nodes] + self.velocity[nodes] * (np.atleast_1d(times - self.since) / SECOND)[:, np.newaxis]


def observe(make, graph, links, acts, seed, faults=None, traced=True, reads_early=False, speed=None, **options):
    """Return all that is read in a history, when a listener is woken, what is counted and what is traced."""
    clock, trace = Clock(), Trace(messages=traced)
    places = np.random.default_rng(seed).random((len(graph), 2))
    positions = Swinging(clock, places) if speed is None else Turning(clock, places, speed)
    if faults is not None:
        options["fault_state"] = FaultState(positions)
    network = make(clock, graph, links, seed=seed, positions=positions, trace=trace, **options)
    if faults is not None:
        inject(faults, clock, network, trace)
    network.set_initial_belief(0, "presumed")
    seen = []

    def act(node, other, what, number):
        if what == "publish":
            network.publish(node, number)
        elif what in ("send", "send to all"):
            dst = None if what == "send to all" or other == node else other
            network.send(node, dst, number, port=("", "bell")[number % 2])
        elif what == "read":
            seen.append((clock.now, node, network.latest_records(node)))
        elif what == "drain":
            seen.append((clock.now, node, network.inbox(node).drain()))
        else:
            seen.append(network.message_counts())

    def listen(node):
        while True:
            yield network.inbox(node, "bell").arrival()
            seen.append((clock.now, node, "woken", network.inbox(node, "bell").drain()))

    for node in graph:
        clock.process(listen(node))
    if reads_early:  # before the faults of the instant: what is read then may differ, and not what is read later
        for when, node, *_ in acts:
            glance = Instant(clock, when, 0)
            glance.callbacks.append(lambda _, k=node: (network.latest_records(k), network.message_counts()))
    for number, (when, *what) in enumerate(acts):
        event = Instant(clock, when, Phase.DECISION + what[0])
        event.callbacks.append(lambda _, w=what, k=number: act(*w, k))
    Instant(clock, SECOND, Phase.SAMPLE)
    clock.run()
    trace.append(network.message_counts())
    left = [(network.latest_records(node), network.inbox(node).drain()) for node in graph]
    return seen, left, list(trace)


@pytest.mark.slow
@settings(max_examples=70, deadline=None)
@given(histories())
def test_delivery_by_events_is_observationally_equal_to_delivery_without_events(history):
    """Conditions in which nothing is ever broken change nothing that can be read, counted or traced."""
    assert observe(Network, *history) == observe(Network, *history, fault_state=FaultState())


class General(LinkLayer):
    """A link layer that asks of a message to one node all that it asks of any transmission."""

    def __init__(self, *given):
        super().__init__(*given)
        self._is_plain = False


def overheard(history, link_layer, **options):
    """Return what is observed in a history, and what a listener overhears."""
    heard = []

    def make(*given, **named):
        network = Network(*given, link_layer=link_layer, **named)
        network.overhear(lambda content, last: heard.append((content, last)))
        return network

    return observe(make, *history, **options), heard


@pytest.mark.slow
@settings(max_examples=70, deadline=None)
@given(histories(), st.booleans(), st.booleans())
def test_a_message_to_one_node_starts_as_any_transmission(history, in_bursts, traced):
    graph, links, *more = history
    if in_bursts:
        links = links.model_copy(update={"loss": GilbertElliott(share=0.4, burst=0.01, advance="time")})
    history = graph, links, *more
    assert overheard(history, LinkLayer, traced=traced) == overheard(history, General, traced=traced)


def test_the_comparison_detects_a_loss_of_another_cause():
    """The control of the property above."""
    history = nx.complete_graph(2), Links(loss=Bernoulli(p=1.0)), [(0, 0, 1, "send")], 0
    with patch.object(LinkSampler, "cause", lambda *_: "fading"):
        other = overheard(history, LinkLayer)
    assert overheard(history, LinkLayer) == overheard(history, General) != other


def test_the_comparison_detects_a_delivery_one_nanosecond_late():
    """The control of the property above, for records and for mail."""

    class Late(Arrivals):
        def _land(self, *given, **options):
            later = Instant(self._env, self._env.now + 1, Phase.DELIVERY)
            later.callbacks.append(lambda _: super(Late, self)._land(*given, **options))

    for speak, read in [("publish", "read"), ("send", "drain"), ("send to all", "tally")]:
        acts = [(0, 1, 1, "tally"), (0, 1, 1, "tally"), (0, 0, 1, speak), (0, 1, 1, read)]
        history = (nx.complete_graph(2), Links(), acts, 0)
        assert observe(Network, *history) == observe(Network, *history, fault_state=FaultState())
        assert observe(Network, *history) != observe(network_over(Late), *history, fault_state=FaultState())


# What the planned faults cannot change is settled at transmission, and the rest on arrival. Without a trace, the
# arrivals of records are decided together, later.


class OnArrival(MessageDelivery):
    """Every outcome is decided on arrival."""

    def _not_blocked(self, transmission, reached, arrival, airtime):
        self.arrivals.schedule(transmission, reached, arrival, airtime)
        return [], [], []


class Tidy(Arrivals):
    """It looks for what is no longer needed at every transmission."""

    def schedule(self, *given):
        self._forget_at = self._count_at = 1
        super().schedule(*given)
        self.settle()


class ByEvents(Arrivals):
    """Every outcome is decided by an event at the time of the arrival."""

    def _can_wait(self, transmission):
        return False


@st.composite
def plans(draw, size):
    """Draw faults that begin and end at the times at which messages are sent and arrive, or between them."""
    found = []
    for _ in range(draw(st.integers(0, 4))):
        start = draw(st.integers(0, 80)) / 2000
        span = {"start": start, "end": start + draw(st.integers(1, 40)) / 2000}
        kind = draw(st.sampled_from(["crash", "crash", "partition", "jamming"]))
        if kind == "crash":
            found.append(Crash(node=draw(st.integers(0, size - 1)), memory=draw(st.booleans()), **span))
        elif kind == "partition":
            found.append(Partition(groups=((0,),), **span))
        else:
            found.append(Jamming(centre=(0.3, 0.3), radius=0.3, **span))
    return found


@pytest.mark.whole
@settings(max_examples=70, deadline=None)
@given(st.data(), histories())
def test_planned_faults_are_observationally_equal_to_decisions_on_arrival(data, history):
    faults = data.draw(plans(len(history[0])))
    assert observe(Network, *history, faults=faults) == observe(network_over(OnArrival), *history, faults=faults)


def with_losses_on_arrival(data, history):
    """Return a history in which the range or half duplex may prevent arrivals."""
    graph, links, acts, seed = history
    medium = data.draw(st.sampled_from([links.medium, Bitrate(bitrate=24 * 8 * 500.0, half_duplex=True)]))
    changes = {
        "medium": medium,
        "range": data.draw(st.sampled_from([0.5, inf])),
        "range_check": data.draw(st.sampled_from(["send", "delivery", "both"])),
        "processing": Processing(receiver=data.draw(st.sampled_from([0.0, 0.003]))),
        "reception": data.draw(st.sampled_from([Disk(), QuasiUnitDisk()])),
        "fading": data.draw(st.sampled_from(["per_link", "message"])),
    }
    if data.draw(st.booleans()):
        coherence = Coherence(doppler=50.0, frequency=3e8, waves=8)
        changes |= {"reception": Rice(), "fading": "correlated", "coherence": coherence}
    return graph, links.model_copy(update=changes), acts, seed


@pytest.mark.whole
@settings(max_examples=70, deadline=None)
@given(st.data(), histories())
def test_arrivals_decided_together_are_observationally_equal_to_one_event_each(data, history):
    history, faults = with_losses_on_arrival(data, history), data.draw(st.one_of(st.none(), plans(len(history[0]))))
    expected = observe(network_over(ByEvents), *history, faults=faults, traced=False)
    for layer in (Arrivals, OnArrival, Tidy):
        options = {"faults": faults, "traced": False, "reads_early": data.draw(st.booleans())}
        assert observe(network_over(layer), *history, **options) == expected


class Unsure(MessageDelivery):
    """Whether a receiver is within range is always decided on arrival."""

    def _in_range(self, transmission, reached, arrival, airtime):
        self.arrivals.schedule(transmission, reached, arrival, airtime)
        return [], []


class Hasty(MessageDelivery):
    """Who is within range when a message is sent is taken to stay there."""

    def _in_range(self, transmission, reached, arrival, airtime):
        with patch.object(KeptReceivers, "until", lambda *_: inf):
            return super()._in_range(transmission, reached, arrival, airtime)


@pytest.mark.whole
@settings(max_examples=100, deadline=None)
@given(st.data(), histories(), st.sampled_from([0.0, 1.0, 10.0, 100.0]), st.booleans())
def test_arrivals_certain_to_be_in_range_are_observationally_equal_to_decisions(data, history, speed, traced):
    """The longest latency is 50 ms."""
    graph, links, *more = with_losses_on_arrival(data, history)
    links = links.model_copy(update={"range": data.draw(st.sampled_from([0.5, 2.0]))})
    faults = data.draw(st.one_of(st.none(), plans(len(graph))))
    given = {"faults": faults, "traced": traced, "speed": speed}
    history = graph, links, *more
    assert observe(Network, *history, **given) == observe(network_over(Unsure), *history, **given)


@pytest.mark.slow
@pytest.mark.parametrize("latency", [Constant(value=0.004), Uniform(0.008)])
@pytest.mark.parametrize("check", ["delivery", "both"])
def test_the_comparison_detects_a_node_that_leaves_the_range_while_a_message_flies(latency, check):
    """The control: at 5 m/s some arrivals are certain, some are not, and some are too late."""
    links = Links(latency=latency, range=0.4, range_check=check, order="fifo")
    acts = [(k * SECOND // 1000, k % 5, 0, ACTS[k % 3 * (k % 5 > 0)]) for k in range(100)]
    acts += [(k * SECOND // 1000, k % 5, 0, ("read", "drain")[k % 2]) for k in range(120)]
    history, asked = (nx.complete_graph(5), links, acts, 3), []

    class Counting(MessageDelivery):
        def _in_range(self, transmission, reached, arrival, airtime):
            certain = super()._in_range(transmission, reached, arrival, airtime)
            asked.append((len(certain[0]), len(reached)))
            return certain

    layers = (Counting, Unsure, Hasty)
    first, second, wrong = [observe(network_over(layer), *history, speed=5.0) for layer in layers]
    assert first == second != wrong
    certain, reached = map(sum, zip(*asked, strict=True))
    assert 0 < certain < 0.5 * reached


class Parting(PositionSource):
    """Node 1 stays 1 m from node 0; node 2 goes away from it at 1 m/s, from 1.7 m on."""

    looks_back, max_speed = True, 1.0

    def __init__(self, clock):
        self._clock = clock

    def __call__(self):
        return self.at(np.arange(3), np.array(self._clock.now))

    def at(self, nodes, times):
        here = np.array([[0.0, 0.0], [1.0, 0.0], [1.7, 0.0]])[nodes]
        return here + np.outer(np.atleast_1d(times) / SECOND, [1.0, 0.0]) * (np.asarray(nodes) == 2)[:, np.newaxis]


def parted(layer, latency, check):
    """Return what nodes 1 and 2 have got of node 0 up to each time, and what is counted, if the range is 2 m."""
    clock, trace, seen = Clock(), Trace(), []
    links = Links(latency=latency, range=2.0, range_check=check)
    network = network_over(layer)(clock, nx.complete_graph(3), links, positions=Parting(clock), trace=trace)
    for k in range(19):  # node 2 is within range up to 0.3 s
        now = k * SECOND // 20
        Instant(clock, now, Phase.DECISION).callbacks.append(lambda _, k=k: transmit(network, WAYS[k % 3]))
        Instant(clock, now, Phase.SAMPLE).callbacks.append(
            lambda _: seen.append([(network.latest_records(node), network.inbox(node).drain()) for node in (1, 2)])
        )
    clock.run(until=2 * SECOND)
    return seen, network.message_counts(), list(trace)


def late_at_node_2(context, rng):
    """Return latencies of 0.2 s to node 2 and 0.05 s to others."""
    return np.where(np.asarray(context.dst) == 2, 0.2, 0.05)


@pytest.mark.parametrize("latency", [late_at_node_2, Constant(value=0.1)])
@pytest.mark.parametrize("check", ["delivery", "both"])
def test_a_node_that_leaves_the_range_gets_what_decisions_on_arrival_give_it(latency, check):
    """The control takes all who are within range when a message is sent for certain."""
    certain = []

    class Counting(MessageDelivery):
        def _in_range(self, transmission, reached, arrival, airtime):
            sure = super()._in_range(transmission, reached, arrival, airtime)
            certain.append(len(sure[0]) / len(reached))
            return sure

    first, second, wrong = (parted(layer, latency, check) for layer in (Counting, Unsure, Hasty))
    assert first == second != wrong
    assert first[1].lost_by == {"out_of_range": first[1].lost}
    assert first[1].lost > 0
    assert {0.0, 1.0} <= {*certain}


class Careless(OnArrival):
    """It takes every arrival for certain."""

    def _not_blocked(self, transmission, reached, arrival, airtime):
        return reached, arrival, []


class Forgetful(Arrivals):
    """It decides nothing before a change."""

    def settle(self):
        pass


@pytest.mark.own_trace
@pytest.mark.parametrize("broken", [Careless, Forgetful])
def test_the_comparisons_detect_a_crash_that_is_overlooked(broken):
    """The control: the record leaves before a crash, arrives during it, and is read after it."""
    links, crash_in_flight = Links(latency=Uniform(0.02)), [Crash(node=1, start=0.0001, end=0.03)]
    history = (nx.complete_graph(3), links, [(0, 0, 1, "publish"), (SECOND // 25, 1, 1, "read")], 0)
    layers = (Arrivals, OnArrival, ByEvents, broken)
    *right, wrong = [observe(network_over(each), *history, faults=crash_in_flight, traced=False) for each in layers]
    assert right[0] == right[1] == right[2] != wrong


UNEQUAL = {
    "what neighbours hear": (nx.complete_graph(3), {}, 0),
    "what nobody hears": (nx.empty_graph(3), {}, 1),
    "a copy that a fault makes": (nx.complete_graph(3), {"messages": (1,), "delay": 0.1, "duplicate": True}, -1),
}


@pytest.mark.parametrize("name", UNEQUAL)
def test_transmissions_are_those_of_the_trace_but_for_what_nobody_hears_and_copies(name):
    graph, fault, without_event = UNEQUAL[name]
    trace = Trace()
    network = SteppedNetwork(graph, faults=[MessageFault(**fault)] if fault else (), trace=trace)
    network.step(0.1)
    network.send(0, None, "x")
    network.publish(1, "y")
    network.step(1.0)
    network.close()
    (counts,) = trace.of(MessageCounts)
    in_trace = {event.transmission for event in [*trace.of(Broadcast), *trace.of(Sent)]}
    assert counts.transmissions - len(in_trace) == without_event


def test_each_attempt_on_a_channel_is_a_transmission():
    trace = Trace()
    medium = Bitrate(bitrate=1e4, access=CsmaCa(window=2))
    network = SteppedNetwork(3, Links(medium=medium), trace=trace)
    for node in range(3):
        network.send(node, (node + 1) % 3, "x")
    network.step(2.0)
    network.close()
    (counts,) = trace.of(MessageCounts)
    assert counts.transmissions > len({event.transmission for event in trace.of(Sent)}) == 3
