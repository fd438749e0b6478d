"""The watcher of the invariants: it lets right histories pass and notices each kind of wrong one."""

from contextlib import nullcontext
from math import inf
from typing import NamedTuple

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import LOST, Broadcast, Lost, MessageCounts, Queued, Sent, Trace
from desim.kernel.core.units import SECOND
from desim.kernel.fault_injection import inject
from desim.kernel.link_layer.arrival_losses import ArrivalLosses
from desim.kernel.link_layer.arrivals import Arrivals
from desim.kernel.link_layer.link_layer import LinkLayer, MessageLog
from desim.kernel.models.fault_plans import RandomFaults, draw_faults
from desim.kernel.models.faults import Crash, Jamming, Partition
from desim.kernel.models.latency import Constant, Uniform
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.medium import Bitrate, Unlimited
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.kernel.network import Network
from desim.kernel.state.fault_state import FaultState
from desim.testing.messages import Conservation, OneToken
from tests.kernel.layers import network_over

pytestmark = pytest.mark.own_trace


def sent(t, arrival, *, transmission=0, src=0, dst=1, created=None):
    return Sent(t, transmission, src, dst, arrival, t if created is None else created, 24, None)


def broadcast(t, arrival, *, dst=(1, 2), transmission=0, created=None):
    return Broadcast(t, transmission, 0, 1, dst, arrival, t if created is None else created, 24, None)


def lost(t, cause="loss", *, transmission=0, dst=1):
    return Lost(t, transmission, 0, dst, cause)


def queued(t, *, transmission=0, dst=(1,)):
    return Queued(t, transmission, 0, dst, 24)


def message_counts(t, delivered=0, in_flight=0, **lost_by):
    total = sum(lost_by.values())
    return MessageCounts(t, delivered + total + in_flight, delivered, total, in_flight, lost_by, 1, 24, 0.0)


CRASH, PARTITION = Crash(node=1, start=0.0), Partition(groups=((0,),), start=0.0)

RIGHT = {
    "delivered": [sent(1, 5), message_counts(5, 1)],
    "delivered at once": [sent(5, 5), message_counts(5, 1)],
    "in flight": [sent(1, 5), message_counts(4, 0, 1)],
    "lost as it leaves": [sent(1, LOST), lost(1), message_counts(4, loss=1)],
    "lost as it arrives": [sent(1, 5), lost(5, "out_of_range"), message_counts(9, out_of_range=1)],
    "a broadcast to all alike": [broadcast(1, (5,)), message_counts(5, 2)],
    "a broadcast to each by itself": [broadcast(1, (5, LOST)), lost(1, dst=2), message_counts(4, 0, 1, loss=1)],
    "a broadcast to one": [broadcast(1, (5,), dst=(2,)), message_counts(5, 1)],
    "a broadcast to nobody": [broadcast(1, (), dst=()), message_counts(5)],
    "several tallies": [message_counts(0), sent(1, 5), message_counts(2, 0, 1), message_counts(5, 1)],
    "waiting": [queued(1), message_counts(9, 0, 1)],
    "waiting, then delivered": [queued(1, dst=(1, 2)), broadcast(3, (5,), created=1), message_counts(5, 2)],
    "lost while it waits": [queued(1), lost(2, "crash"), message_counts(9, crash=1)],
    "a loss to nobody": [message_counts(0, queue=0)],
    "down until it arrives": [FaultStarted(0, CRASH), sent(1, 5), FaultEnded(5, CRASH), message_counts(5, 1)],
    "down after it arrived": [sent(1, 5), FaultStarted(6, CRASH), message_counts(9, 1)],
    "down twice": [*[FaultStarted(0, CRASH)] * 2, sent(1, 5), *[FaultEnded(2, CRASH)] * 2, message_counts(5, 1)],
    "sender down as it arrives": [sent(1, 5, src=1, dst=0), FaultStarted(2, CRASH), message_counts(9, 1)],
    "lost to a crash": [sent(1, 5), FaultStarted(5, CRASH), lost(5, "crash"), message_counts(9, crash=1)],
    "a partition while it flies": [
        sent(1, 5),
        FaultStarted(2, PARTITION),
        FaultEnded(5, PARTITION),
        message_counts(9, 1),
    ],
    "a partition healed as it leaves": [
        FaultStarted(0, PARTITION),
        FaultEnded(1, PARTITION),
        sent(1, 5),
        message_counts(9, 1),
    ],
    "one of all lost as it arrives": [
        broadcast(1, (5,)),
        lost(5, "out_of_range"),
        message_counts(9, 1, out_of_range=1),
    ],
    "one of all waits no more": [
        queued(1, dst=(1, 2)),
        lost(2),
        broadcast(3, (5,), dst=(2,)),
        message_counts(9, 1, loss=1),
    ],
    "a message each of one transmission": [sent(1, 5), sent(1, 7, dst=2), message_counts(6, 1, 1)],
    "a fault begins as it is lost": [
        sent(1, LOST, dst=2),
        FaultStarted(1, CRASH),
        lost(1, dst=2),
        message_counts(4, loss=1),
    ],
    "lost in the noise as its frame ends": [queued(1), sent(2, 5, created=1), lost(3), message_counts(3, loss=1)],
    "within a group": [FaultStarted(0, PARTITION), sent(1, 5, src=1, dst=2), message_counts(9, 1)],
    "jamming": [FaultStarted(0, Jamming(centre=(0.0, 0.0), radius=1.0, start=0.0)), sent(1, 5), message_counts(9, 1)],
    "overtaking": [sent(1, 9), sent(2, 5, transmission=1), message_counts(9, 2)],
}

WRONG = {
    "delivered, not counted": ("delivered", [sent(1, 5), message_counts(5, 0, 1)]),
    "counted before it arrives": ("in flight", [sent(1, 5), message_counts(4, 1)]),
    "counted, never sent": ("sent", [message_counts(4, 1)]),
    "sent, not counted": ("sent", [sent(1, 5), message_counts(4)]),
    "lost, not counted": ("lost", [sent(1, 5), lost(5), message_counts(5, 1)]),
    "lost by another cause": ("lost", [sent(1, 5), lost(5), message_counts(5, out_of_range=1)]),
    "waiting, not counted": ("in flight", [queued(1, dst=(1, 2)), message_counts(9, 0, 1)]),
    "waiting counted once more as it leaves": ("sent", [queued(1), sent(3, 5, created=1), message_counts(5, 2)]),
    "arrives before it left": ("before it was transmitted", [sent(5, 4)]),
    "one arrives before it left": ("before it was transmitted", [broadcast(5, (6, 4))]),
    "leaves before it was created": ("before it was created", [sent(5, 6, created=7)]),
    "time runs backwards": ("backwards", [sent(5, 6), sent(4, 6, transmission=1)]),
    "leaves twice": ("once", [sent(1, 5), sent(2, 5)]),
    "leaves twice at once": ("once", [sent(1, 5), sent(1, 6)]),
    "leaves twice for one of all": ("once", [broadcast(1, (5,), dst=(2, 2))]),
    "leaves now and then": ("once", [sent(1, 5), sent(2, 5, dst=2)]),
    "lost later than it left": (
        "only a message in flight",
        [sent(1, LOST), lost(2), message_counts(2, loss=1)],
    ),
    "never arrives, is not lost": ("has a Lost event", [sent(1, LOST), message_counts(2, loss=1)]),
    "lost twice": ("once", [sent(1, 5), lost(5), lost(5)]),
    "lost twice while it waits": ("once", [queued(1), lost(2), lost(2)]),
    "lost, never sent": ("only a message in flight", [lost(1)]),
    "lost to another": ("only a message in flight", [sent(1, 5), lost(5, dst=2)]),
    "lost after it arrived": ("only a message in flight", [sent(1, 5), lost(6)]),
    "lost while it flies": ("on arrival", [sent(1, 5), lost(3)]),
    "lost while it flies after another waited": (
        "on arrival",
        [queued(1), sent(2, 5, transmission=1), lost(3, transmission=1)],
    ),
    "down as it arrives": (
        "reaches 1, whose radio is down",
        [sent(1, 5), FaultStarted(3, CRASH), message_counts(9, 1)],
    ),
    "down from when it arrives": ("reaches 1", [sent(1, 5), FaultStarted(5, CRASH), message_counts(5, 1)]),
    "down until after it arrived": ("reaches 1", [FaultStarted(0, CRASH), sent(1, 5), FaultEnded(6, CRASH)]),
    "down once more": (
        "reaches 1",
        [*[FaultStarted(0, CRASH)] * 2, sent(1, 5), FaultEnded(2, CRASH), message_counts(9, 1)],
    ),
    "one of all is down": ("reaches 1", [broadcast(1, (5,)), FaultStarted(3, CRASH), message_counts(9, 2)]),
    "sender is down": ("sends nothing", [FaultStarted(0, CRASH), sent(1, 5, src=1, dst=0)]),
    "down sender waits": ("sends nothing", [FaultStarted(0, Crash(node=0, start=0.0)), queued(1)]),
    "left across a partition": ("transmitted across", [FaultStarted(0, PARTITION), sent(1, 5)]),
    "arrives across a partition": ("across", [sent(1, 5), FaultStarted(2, PARTITION), message_counts(9, 1)]),
    "arrives as a partition begins": ("across", [sent(1, 5), FaultStarted(5, PARTITION), message_counts(9, 1)]),
    "across a partition of named groups": (
        "across",
        [FaultStarted(0, Partition(groups=((0, 2), (1,)), start=0.0)), sent(1, 5, src=2)],
    ),
    "over, never begun": ("started", [FaultEnded(1, CRASH)]),
    "over twice": ("started", [FaultStarted(0, CRASH), FaultEnded(1, CRASH), FaultEnded(1, CRASH)]),
}


def watch(events, **options):
    trace = Trace([Conservation(**options)])
    for event in events:
        trace.append(event)


@pytest.mark.parametrize("events", RIGHT.values(), ids=RIGHT)
def test_a_correct_history_passes(events):
    watch(events)


@pytest.mark.parametrize(("words", "events"), WRONG.values(), ids=WRONG)
def test_an_incorrect_history_is_detected(words, events):
    """The text says what is wrong, and ends with an event of those that happened."""
    with pytest.raises(AssertionError, match=words) as failure:
        watch(events)
    assert any(str(failure.value).endswith(f": {event}") for event in events)


def test_deliveries_are_checked_soon_and_at_the_end_without_message_counts():
    """64 transmissions are left unjudged if all arrive at once; at the end, none that arrived before the last event."""
    with pytest.raises(AssertionError, match="has a Lost event"):
        watch([sent(0, LOST), *(sent(k, k, transmission=k) for k in range(1, 65))])
    for last, wrong in [(5, False), (6, True)]:
        watcher = Conservation()
        for event in [FaultStarted(0, CRASH), sent(1, 5), sent(last, last, transmission=1, dst=2)]:
            watcher(event)
        with pytest.raises(AssertionError, match="reaches 1") if wrong else nullcontext():
            watcher.judge()


def test_a_message_long_in_flight_is_checked_when_it_arrives():
    """300 transmissions that take 1000 ns, sent one after the other."""
    events = [sent(k, k + 1000, transmission=k) for k in range(300)]
    watch([*events, message_counts(999, 0, 300)])
    watch([*events, message_counts(1100, 101, 199)])
    with pytest.raises(AssertionError, match="in flight"):
        watch([*events, message_counts(1100, 100, 200)])


def test_transmissions_that_wait_no_more_are_forgotten():
    """One that was delivered, one lost as it waited, and one of which either happened to a receiver."""
    watcher = Conservation()
    for event in [
        *[queued(1), sent(2, 5, created=1)],
        *[queued(3, transmission=1), lost(4, transmission=1)],
        *[queued(5, transmission=2, dst=(1, 2)), lost(6, transmission=2)],
        broadcast(7, (8,), transmission=2, dst=(2,), created=5),
        message_counts(9, 2, loss=2),
    ]:
        watcher(event)
    assert not watcher._waiting


def test_overtaking_is_detected_on_fifo_links():
    watch(
        [
            sent(1, 9),
            sent(2, 9, transmission=1),
            sent(2, 5, transmission=2, dst=2),
            sent(3, 5, transmission=3, src=1, dst=0),
        ],
        fifo=True,
    )
    with pytest.raises(AssertionError, match="overtakes"):
        watch(RIGHT["overtaking"], fifo=True)
    with pytest.raises(AssertionError, match="overtakes"):
        watch([broadcast(1, (9, 5)), broadcast(2, (8, 7), transmission=1)], fifo=True)


def live(seed, network=Network, links=None, faults=(), size=5, **options):
    """Let nodes talk for a second over a network under the eyes of the watcher."""
    clock, trace = Clock(), Trace([Conservation(**options)])
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.0, 20.0, (size, 2))

    def positions():
        return places * np.cos(clock.now / SECOND)

    fault_state = FaultState(positions) if faults else None
    links = links or Links()
    graph = nx.complete_graph(size)
    net = network(clock, graph, links, seed=seed, positions=positions, trace=trace, fault_state=fault_state)
    inject(draw_faults(faults, size, 1.0, seed), clock, net, trace)

    def transmit(node, dst, number):
        if number % 2:
            net.publish(node, number)
        else:
            net.send(node, dst if dst != node else None, number)

    for number in range(60):
        node, dst = rng.integers(size, size=2).tolist()
        act = Instant(clock, int(rng.integers(100)) * SECOND // 100, Phase.DECISION + node)
        act.callbacks.append(lambda _, n=node, d=dst, k=number: transmit(n, d, k))
    for tenth in range(11):
        count = Instant(clock, tenth * SECOND // 10, Phase.SAMPLE)
        count.callbacks.append(lambda _: trace.append(net.message_counts()))
    clock.run(until=SECOND + 1)
    return trace


PLANS = [(), (RandomFaults(rate=20.0, mean_duration=0.1),), (Crash(node=0, start=0.0, end=inf), RandomFaults(rate=5.0))]


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32),
    st.sampled_from(PLANS),
    st.sampled_from([Constant(), Constant(value=0.03), Uniform(low=0.0, high=0.3)]),
    st.sampled_from(["overtaking", "fifo"]),
    st.sampled_from([Unlimited(), Bitrate(bitrate=1e4, half_duplex=True, queue_limit=2.0), Bitrate(bitrate=1e4)]),
    st.sampled_from(["send", "delivery", "both"]),
    st.sampled_from([0.0, 0.3]),
)
def test_a_network_conserves_messages_whatever_its_links_and_faults(seed, faults, latency, order, medium, check, p):
    links = Links(latency=latency, order=order, medium=medium, range=25.0, range_check=check, loss=Bernoulli(p=p))
    live(seed, links=links, faults=faults, fifo=order == "fifo")


class SilentLoss(Arrivals):
    """It loses an arriving message and does not record it."""

    def _land(self, flight, nodes, **options):
        super()._land(flight, nodes[1:], **options)


class SendsWhenDown(LinkLayer):
    """A node that is down may transmit."""

    def transmit(self, src, *rest, **options):
        down = self._fault_state._down.pop(src, 0)
        super().transmit(src, *rest, **options)
        if down:
            self._fault_state._down[src] = down


class Unbreakable(ArrivalLosses):
    """Nothing keeps a message from arriving."""

    def causes(self, nodes, times, flights):
        return {}


class Leaky(MessageLog):
    """It counts a loss and does not record it."""

    def lose(self, transmission, causes):
        self._lost.update(causes.values())


class WrongCauses(LinkLayer):
    """It takes every loss for one by chance, in its count."""

    def message_counts(self):
        true = super().message_counts()
        return true._replace(lost_by={"loss": true.lost})


class Doubling(MessageLog):
    """It lets a loss happen twice."""

    def lose(self, transmission, causes):
        super().lose(transmission, causes)
        super().lose(transmission, causes)


SLOW = Links(latency=Constant(value=0.05))
ALL_SORTS = (RandomFaults(rate=20.0, mean_duration=0.1),)
CRASHES = (RandomFaults(rate=20.0, mean_duration=0.1, kinds=("crash",)),)


@pytest.mark.parametrize(
    ("layer", "faults", "words"),
    [
        (SilentLoss, ALL_SORTS, "sent, delivered, lost, in flight"),
        (SendsWhenDown, CRASHES, "sends nothing"),
        (Unbreakable, ALL_SORTS, "no message reaches"),
        (Leaky, ALL_SORTS, "no message reaches|has a Lost event"),
        (WrongCauses, ALL_SORTS, "lost by cause"),
        (Doubling, ALL_SORTS, "once"),
    ],
)
@pytest.mark.parametrize("seed", range(3))
def test_a_broken_network_is_detected(layer, faults, words, seed):
    live(seed, Network, SLOW, faults)
    with pytest.raises(AssertionError, match=words):
        live(seed, network_over(layer), SLOW, faults)


def test_the_watcher_sees_messages_that_are_not_kept():
    clock = Clock()
    trace = Trace([Conservation()], messages=False)
    network = Network(clock, nx.complete_graph(3), SLOW, trace=trace)
    network.publish(0, "x")
    trace.append(network.message_counts())
    with pytest.raises(AssertionError, match="in flight"):
        trace.append(network.message_counts()._replace(in_flight=1))


# A token.


class Pass(NamedTuple):
    epoch: int
    hop: int


def passed(t, src, dst, epoch, hop):
    return Sent(t, t, src, dst, t + 1, t, 24, Pass(epoch, hop))


ROUND = [passed(1, 0, 1, 1, 1), passed(2, 1, 2, 1, 2), passed(3, 2, 0, 1, 3)]
ONE = {
    "a round": ROUND,
    "sent again": [*ROUND[:2], passed(3, 0, 1, 1, 1)],
    "kept for a hop": [ROUND[0], passed(5, 1, 0, 1, 3)],
    "a new epoch": [ROUND[0], passed(5, 2, 1, 2, 1), passed(6, 1, 2, 2, 2)],
    "other bodies": [sent(1, 2), *ROUND, broadcast(4, (5,))],
    "sent again after a new epoch": [ROUND[0], passed(5, 2, 1, 2, 1), passed(6, 0, 1, 1, 1)],
}
TWO_OF_ONE_EPOCH = {
    "a hop back": [*ROUND, passed(4, 0, 1, 1, 2)],
    "from two": [ROUND[0], passed(2, 2, 1, 1, 1)],
    "to two": [ROUND[0], passed(2, 0, 2, 1, 1)],
    "in an old epoch": [ROUND[1], passed(5, 2, 1, 2, 1), passed(6, 1, 0, 1, 2)],
}
OLD = [*ROUND[:2], passed(5, 2, 1, 2, 1), passed(8, 2, 0, 1, 3)]
"""An epoch goes on after another began."""


def watch_token(watcher, events):
    for event in events:
        watcher(event)
    return watcher.spoilt


@pytest.mark.parametrize("events", ONE.values(), ids=ONE)
def test_one_token_passes(events):
    assert watch_token(OneToken(Pass, settled=0), events) == -1


@pytest.mark.parametrize("events", TWO_OF_ONE_EPOCH.values(), ids=TWO_OF_ONE_EPOCH)
def test_two_tokens_of_one_epoch_are_detected_at_any_time(events):
    with pytest.raises(AssertionError, match="an epoch has one token"):
        watch_token(OneToken(Pass), events)


@pytest.mark.parametrize(("settled", "noticed"), [(None, False), (9, False), (8, True)])
def test_two_tokens_are_detected_once_the_network_is_calm(settled, noticed):
    with pytest.raises(AssertionError, match="one token is left") if noticed else nullcontext():
        assert watch_token(OneToken(Pass, settled=settled), OLD) == 8


def test_each_part_of_a_partition_may_have_a_token():
    apart = [passed(1, 0, 1, 1, 1), passed(2, 2, 3, 2, 1), passed(3, 1, 0, 1, 2), passed(4, 3, 2, 2, 2)]
    assert [watch_token(OneToken(Pass, group, settled=0), apart) for group in ([0, 1], [2, 3])] == [-1, -1]
    assert watch_token(OneToken(Pass), apart) == 4
