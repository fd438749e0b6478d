"""What becomes of a message, record or mail alike, when something happens while it is on its way.

A message is judged twice: as it leaves and as it arrives. In between nothing can happen to it. Faults come first at an
instant, then arrivals, then decisions: what begins as a message leaves or arrives concerns it, what ends then does not.

| what happens                                                  | what becomes of the message                      |
|---------------------------------------------------------------|--------------------------------------------------|
| the receiver leaves the range while it flies                  | `range_check = "send"`: delivered;               |
|                                                               | `"delivery"` and `"both"`: lost, "reach"         |
| the receiver enters the range while it flies                  | `"send"` and `"both"`: a broadcast is not sent   |
|                                                               | to it, a message to it alone is lost, "reach";   |
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

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desim.kernel.clock import SECOND, Clock, Instant, Phase, nanoseconds, seconds
from desim.kernel.conditions import Conditions
from desim.kernel.events import Lost, Trace
from desim.kernel.faults import Crash, Jamming, Partition
from desim.kernel.hops import Hops
from desim.kernel.injection import inject
from desim.kernel.latency import Constant
from desim.kernel.links import Links
from desim.kernel.loss import Bernoulli
from desim.kernel.medium import Bitrate, Unlimited
from desim.kernel.network import Network

WAYS = ("publish", "send", "send to all")
SPOKEN, ARRIVAL = 1.0, 1.5
"""When the word is spoken, and when it arrives, s."""
ONE_SECOND_EACH = Bitrate(bitrate=160.0)
"""A word has 20 bytes."""


class Outcome(NamedTuple):
    """What became of a word."""

    fate: str
    tally: tuple[int, int, int, int, dict[str, int]]
    """Sent, delivered, lost, in flight, lost by cause."""
    lost_at: list[int]


def tell(way, *faults, away=(), check="send", latency=0.5, end=9.0, medium=None, times=(SPOKEN,)):
    """Let node 0 say a word to node 1 and return what became of it.

    Args:
        way: how it is said.
        faults: what happens.
        away: pairs (from, until) in s during which node 1 is 9 m away, out of a range of 2 m; else it is at 1 m.
        check: when the range is judged.
        latency: s.
        end: when the run ends, s.
        medium: what the air is like.
        times: when the word is spoken, s.
    """
    clock, trace = Clock(), Trace()

    def positions():
        far = any(start <= seconds(clock.now) < stop for start, stop in away)
        return np.array([[0.0, 0.0], [9.0 if far else 1.0, 0.0]])

    links = Links(latency=Constant(value=latency), range=2.0, range_check=check, medium=medium or Unlimited())
    network = Network(
        clock, nx.complete_graph(2), links, positions=positions, trace=trace, conditions=Conditions(positions)
    )
    inject(faults, clock, network, trace)
    for time in times:
        Instant(clock, nanoseconds(time), Phase.DECISION).callbacks.append(lambda _: say(network, way))
    Instant(clock, nanoseconds(end), Phase.SAMPLE).callbacks.append(lambda _: trace.append(network.tally()))
    clock.run(until=nanoseconds(end) + 1)
    tally = network.tally()
    read = 0 in network.heard(1) if way == "publish" else bool(network.inbox(1).drain())
    return Outcome(fate_of(tally, read), tally[1:6], [event.t for event in trace.of(Lost)])


def say(network, way):
    if way == "publish":
        network.publish(0, "word")
    else:
        network.send(0, 1 if way == "send" else None, "word")


def fate_of(tally, read):
    """Return what a tally says of a single word: delivered, the cause of its loss, in flight, or not sent."""
    assert read == (tally.delivered > 0)
    if read:
        return "delivered"
    return next(iter(tally.lost_by), None) or ("in flight" if tally.in_flight else "not sent")


def crash(node, at, until=inf, **options):
    return Crash(node=node, at=at, until=until, **options)


def parted(at, until=inf):
    return Partition(groups=((0,),), at=at, until=until)


def jammed(at, until=inf):
    """Return a disc around node 1 alone."""
    return Jamming(centre=(1.0, 0.0), radius=0.5, at=at, until=until)


@pytest.mark.parametrize("way", WAYS)
class TestRange:
    """The range is judged as a message leaves, as it arrives, or both; the positions are those of that instant."""

    @pytest.mark.parametrize(("check", "fate"), [("send", "delivered"), ("delivery", "reach"), ("both", "reach")])
    @pytest.mark.parametrize("since", [1.000000001, 1.2, ARRIVAL])
    def test_the_receiver_leaves_while_it_flies(self, way, check, fate, since):
        assert tell(way, away=[(since, inf)], check=check).fate == fate

    @pytest.mark.parametrize("check", ["send", "delivery", "both"])
    @pytest.mark.parametrize("until", [1.2, ARRIVAL])
    def test_the_receiver_enters_while_it_flies(self, way, check, until):
        outcome = tell(way, away=[(0.0, until)], check=check)
        if check == "delivery":
            assert outcome.fate == "delivered"
        elif way == "send":
            assert outcome == ("reach", (1, 0, 1, 0, {"reach": 1}), [nanoseconds(SPOKEN)])
        else:
            assert outcome == ("not sent", (0, 0, 0, 0, {}), [])

    @pytest.mark.parametrize("check", ["send", "delivery", "both"])
    def test_the_receiver_leaves_and_returns_while_it_flies(self, way, check):
        assert tell(way, away=[(1.1, 1.4)], check=check).fate == "delivered"

    @pytest.mark.parametrize("check", ["send", "delivery", "both"])
    def test_the_receiver_is_never_within_range(self, way, check):
        fate = "not sent" if check != "delivery" and way != "send" else "reach"
        assert tell(way, away=[(0.0, inf)], check=check).fate == fate

    @pytest.mark.parametrize("check", ["send", "delivery", "both"])
    def test_a_word_that_takes_no_time_is_judged_at_one_instant(self, way, check):
        assert tell(way, away=[(0.5, SPOKEN)], check=check, latency=0.0).fate == "delivered"
        far = tell(way, away=[(SPOKEN, 1.1)], check=check, latency=0.0)
        assert far.fate == ("not sent" if check != "delivery" and way != "send" else "reach")


@pytest.mark.parametrize("way", WAYS)
class TestPartition:
    def test_it_begins_while_the_message_flies(self, way):
        expected = ("partition", (1, 0, 1, 0, {"partition": 1}), [nanoseconds(ARRIVAL)])
        assert tell(way, parted(1.2)) == expected
        assert tell(way, parted(ARRIVAL)) == expected

    def test_it_begins_just_after_the_arrival(self, way):
        assert tell(way, parted(ARRIVAL + 1e-9)).fate == "delivered"

    def test_it_begins_and_heals_while_the_message_flies(self, way):
        assert tell(way, parted(1.1, 1.2)).fate == "delivered"
        assert tell(way, parted(1.1, ARRIVAL)).fate == "delivered"

    @pytest.mark.parametrize("start", [0.5, SPOKEN])
    @pytest.mark.parametrize("stop", [1.000000001, 1.2, ARRIVAL, 2.0])
    def test_it_is_open_as_the_message_leaves_and_heals_before_or_after_the_arrival(self, way, start, stop):
        assert tell(way, parted(start, stop)) == (
            "partition",
            (1, 0, 1, 0, {"partition": 1}),
            [nanoseconds(SPOKEN)],
        )

    def test_it_heals_as_the_message_leaves(self, way):
        assert tell(way, parted(0.5, SPOKEN)).fate == "delivered"

    def test_a_word_that_takes_no_time_meets_what_is_open_at_its_instant(self, way):
        assert tell(way, parted(SPOKEN), latency=0.0).fate == "partition"
        assert tell(way, parted(0.5, SPOKEN), latency=0.0).fate == "delivered"
        assert tell(way, parted(SPOKEN + 1e-9), latency=0.0).fate == "delivered"

    def test_it_counts_when_the_message_leaves_the_transmitter_not_when_it_was_spoken(self, way):
        """The second of two words waits from 1 s to 2 s; it leaves as the partition heals, or begins."""
        twice = {"medium": ONE_SECOND_EACH, "times": (SPOKEN, SPOKEN), "latency": 0.0}
        assert tell(way, parted(1.5, 2.0), **twice).tally == (2, 2, 0, 0, {})
        assert tell(way, parted(2.0, 2.5), **twice).tally == (2, 0, 2, 0, {"partition": 2})


@pytest.mark.parametrize("way", WAYS)
class TestJamming:
    def test_the_receiver_is_in_the_disc_as_the_message_arrives(self, way):
        expected = ("jamming", (1, 0, 1, 0, {"jamming": 1}), [nanoseconds(ARRIVAL)])
        assert tell(way, jammed(1.2)) == expected
        assert tell(way, jammed(ARRIVAL)) == expected
        assert tell(way, jammed(0.5)) == expected

    def test_the_disc_is_gone_as_the_message_arrives(self, way):
        assert tell(way, jammed(0.5, ARRIVAL)).fate == "delivered"
        assert tell(way, jammed(1.1, 1.2)).fate == "delivered"

    def test_the_receiver_passes_through_the_disc_while_the_message_flies(self, way):
        disc = Jamming(centre=(9.0, 0.0), radius=0.5, at=0.0)
        assert tell(way, disc, away=[(1.1, 1.4)]).fate == "delivered"
        assert tell(way, disc, away=[(1.1, 1.6)]).fate == "jamming"

    def test_a_word_that_takes_no_time_meets_what_is_open_at_its_instant(self, way):
        assert tell(way, jammed(SPOKEN), latency=0.0).fate == "jamming"
        assert tell(way, jammed(0.5, SPOKEN), latency=0.0).fate == "delivered"


@pytest.mark.parametrize("way", WAYS)
class TestSender:
    @pytest.mark.parametrize("window", [(0.5, 2.0), (SPOKEN, 1.2), (0.5, 1.000000001)])
    @pytest.mark.parametrize("latency", [0.0, 0.5])
    def test_it_is_down_when_it_wants_to_send(self, way, window, latency):
        assert tell(way, crash(0, *window), latency=latency) == ("not sent", (0, 0, 0, 0, {}), [])

    @pytest.mark.parametrize("latency", [0.0, 0.5])
    def test_it_recovers_as_it_wants_to_send(self, way, latency):
        assert tell(way, crash(0, 0.5, SPOKEN), latency=latency).fate == "delivered"

    @pytest.mark.parametrize("at", [1.000000001, 1.2, ARRIVAL])
    def test_it_crashes_while_the_message_flies(self, way, at):
        assert tell(way, crash(0, at)).fate == "delivered"

    @pytest.mark.parametrize("window", [(SPOKEN + 1e-9, 1.2), (1.5, inf), (1.999999999, inf)])
    def test_it_crashes_while_the_message_is_on_the_air(self, way, window):
        """Half transmitted it is worth nothing, though the transmitter may be repaired before it would be over."""
        assert tell(way, crash(0, *window), medium=ONE_SECOND_EACH) == (
            "crash",
            (1, 0, 1, 0, {"crash": 1}),
            [nanoseconds(2.5)],
        )

    def test_it_crashes_as_the_message_has_been_transmitted(self, way):
        assert tell(way, crash(0, 2.0), medium=ONE_SECOND_EACH).fate == "delivered"

    def test_it_crashes_while_messages_wait(self, way):
        """Of three words said at 1 s one has been transmitted at 2 s and arrives; two wait, and are lost at once."""
        outcome = tell(way, crash(0, 2.0), medium=ONE_SECOND_EACH, times=(SPOKEN,) * 3)
        assert outcome == ("delivered", (3, 1, 2, 0, {"crash": 2}), [nanoseconds(2.0)] * 2)

    def test_it_crashes_as_the_next_message_would_leave(self, way):
        """Faults come first: at 2 s the transmitter is free, and the node down."""
        outcome = tell(way, crash(0, 2.0), medium=ONE_SECOND_EACH, times=(SPOKEN,) * 2)
        assert outcome.tally == (2, 1, 1, 0, {"crash": 1})

    def test_what_it_says_after_its_recovery_is_not_held_up_by_what_was_lost(self, way):
        """Spoken at 1 s, 1 s, 3 s: the first two are lost at 1.2 s, the third leaves at 3 s and arrives at 4.5 s."""
        story = {"medium": ONE_SECOND_EACH, "times": (SPOKEN, SPOKEN, 3.0)}
        assert tell(way, crash(0, 1.2, 2.5), **story, end=4.5).tally == (3, 1, 2, 0, {"crash": 2})
        assert tell(way, crash(0, 1.2, 2.5), **story, end=4.4).tally == (3, 0, 2, 1, {"crash": 2})


@pytest.mark.parametrize("way", WAYS)
class TestReceiver:
    @pytest.mark.parametrize("window", [(1.2, inf), (ARRIVAL, inf), (0.5, 2.0), (ARRIVAL, 1.500000001)])
    def test_it_is_down_as_the_message_arrives(self, way, window):
        assert tell(way, crash(1, *window)) == ("crash", (1, 0, 1, 0, {"crash": 1}), [nanoseconds(ARRIVAL)])

    @pytest.mark.parametrize("until", [1.2, ARRIVAL])
    @pytest.mark.parametrize("memory", [True, False])
    def test_it_is_down_as_the_message_leaves_and_up_as_it_arrives(self, way, until, memory):
        assert tell(way, crash(1, 0.5, until, memory=memory)).fate == "delivered"

    @pytest.mark.parametrize("memory", [True, False])
    def test_it_crashes_and_recovers_while_the_message_flies(self, way, memory):
        assert tell(way, crash(1, 1.1, 1.2, memory=memory)).fate == "delivered"

    def test_a_word_that_takes_no_time_meets_what_is_open_at_its_instant(self, way):
        assert tell(way, crash(1, SPOKEN), latency=0.0).fate == "crash"
        assert tell(way, crash(1, 0.5, SPOKEN), latency=0.0).fate == "delivered"
        assert tell(way, crash(1, SPOKEN + 1e-9), latency=0.0).fate == "delivered"

    @pytest.mark.parametrize("memory", [True, False])
    def test_it_crashes_after_the_arrival(self, way, memory):
        """It has been delivered in any case; whether it is remembered is another matter."""
        clock, conditions = Clock(), Conditions()
        network = Network(clock, nx.complete_graph(2), conditions=conditions)
        say(network, way)
        inject([crash(1, 1.0, 2.0, memory=memory)], clock, network)
        clock.run()
        assert network.tally()[1:5] == (1, 1, 0, 0)
        assert (0 in network.heard(1) if way == "publish" else bool(network.inbox(1).drain())) == memory


@pytest.mark.parametrize("way", WAYS)
class TestEnd:
    def test_the_run_ends_while_the_message_flies(self, way):
        assert tell(way, end=1.2) == ("in flight", (1, 0, 0, 1, {}), [])
        assert tell(way, end=ARRIVAL).fate == "delivered"

    def test_the_run_ends_while_messages_wait(self, way):
        story = {"medium": ONE_SECOND_EACH, "times": (SPOKEN,) * 3, "latency": 0.0}
        assert tell(way, end=1.5, **story).tally == (3, 0, 0, 3, {})
        assert tell(way, end=2.5, **story).tally == (3, 1, 0, 2, {})


def test_several_causes_at_one_arrival_count_as_the_first_of_crash_partition_jamming_and_reach():
    def cause(*faults):
        return tell("send", *faults, away=[(1.1, inf)], check="delivery").fate

    everything = [crash(1, 1.2), parted(1.2), Jamming(centre=(9.0, 0.0), radius=0.5, at=1.2)]
    assert [cause(*everything[k:]) for k in range(4)] == ["crash", "partition", "jamming", "reach"]


@pytest.mark.parametrize("conditions", [None, Conditions()])
def test_mail_that_arrives_at_one_instant_is_read_in_the_order_in_which_it_was_sent(conditions):
    """Node 1 speaks at 0 s and its mail takes 2 s; node 0 speaks at 1 s and its mail takes 1 s."""
    clock = Clock()
    links = Links(latency=lambda hops, rng: 2.0 if hops.src else 1.0)
    network = Network(clock, nx.complete_graph(3), links, conditions=conditions)
    network.send(1, 2, "first")
    Instant(clock, SECOND, Phase.DECISION).callbacks.append(lambda _: network.send(0, 2, "second"))
    Instant(clock, 2 * SECOND, Phase.SAMPLE)
    clock.run()
    assert [message.body for message in network.inbox(2).drain()] == ["first", "second"]


# A network whose messages land by events is the same as one whose messages need none.


class Overtaking:
    """Latencies that overtake each other, drawn per hop."""

    def __init__(self, longest):
        self.longest = longest

    def __call__(self, hops: Hops, rng):
        return rng.uniform(0.0, self.longest, len(hops.dst)).round(3)


class Alike(Overtaking):
    """Latencies that overtake each other between transmissions only."""

    def __call__(self, hops: Hops, rng):
        return round(rng.uniform(0.0, self.longest), 3)


ACTS = ("publish", "send", "send to all", "read", "drain", "tally")


@st.composite
def histories(draw):
    """A random graph, its links, and a random order of speaking and reading with many ties in time."""
    size, seed = draw(st.integers(2, 5)), draw(st.integers(0, 2**32))
    graph = nx.gnp_random_graph(size, draw(st.sampled_from([0.5, 1.0])), seed=seed, directed=draw(st.booleans()))
    latencies = [Constant(), Constant(value=0.02), Overtaking(0.05), Overtaking(0.002), Alike(0.05)]
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


def observe(make, graph, links, acts, seed, **options):
    """Return all that is read in a history, when a listener is woken, what is counted and what is traced."""
    clock, trace = Clock(), Trace()
    places = np.random.default_rng(seed).random((len(graph), 2))
    network = make(
        clock, graph, links, seed=seed, positions=lambda: places * np.cos(clock.now / 1e7), trace=trace, **options
    )
    network.presume(0, "presumed")
    seen = []

    def act(node, other, what, number):
        if what == "publish":
            network.publish(node, number)
        elif what in ("send", "send to all"):
            dst = None if what == "send to all" or other == node else other
            network.send(node, dst, number, port=("", "bell")[number % 2])
        elif what == "read":
            seen.append((clock.now, node, network.heard(node)))
        elif what == "drain":
            seen.append((clock.now, node, network.inbox(node).drain()))
        else:
            seen.append(network.tally())

    def listen(node):
        while True:
            yield network.inbox(node, "bell").arrival()
            seen.append((clock.now, node, "woken", network.inbox(node, "bell").drain()))

    for node in graph:
        clock.process(listen(node))
    for number, (when, *what) in enumerate(acts):
        event = Instant(clock, when, Phase.DECISION + what[0])
        event.callbacks.append(lambda _, w=what, k=number: act(*w, k))
    Instant(clock, SECOND, Phase.SAMPLE)
    clock.run()
    trace.append(network.tally())
    left = [(network.heard(node), network.inbox(node).drain()) for node in graph]
    return seen, left, list(trace)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(histories())
def test_landing_by_events_is_observationally_equal_to_arriving_without(history):
    """Conditions in which nothing is ever broken change nothing that can be read, counted or traced."""
    assert observe(Network, *history) == observe(Network, *history, conditions=Conditions())


def test_the_comparison_notices_a_landing_that_is_a_nanosecond_late():
    """The control of the property above, for records and for mail."""

    class Late(Network):
        def _land(self, flight, nodes, airtime, event):
            later = Instant(self._env, self._env.now + 1, Phase.DELIVERY)
            later.callbacks.append(lambda _: super(Late, self)._land(flight, nodes, airtime, event))

    for speak, read in [("publish", "read"), ("send", "drain"), ("send to all", "tally")]:
        acts = [(0, 1, 1, "tally"), (0, 1, 1, "tally"), (0, 0, 1, speak), (0, 1, 1, read)]
        history = (nx.complete_graph(2), Links(), acts, 0)
        assert observe(Network, *history) == observe(Network, *history, conditions=Conditions())
        assert observe(Network, *history) != observe(Late, *history, conditions=Conditions())
