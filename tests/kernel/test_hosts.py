"""The delay of a sender's host: before the queue, in order, counted and lost with its node."""

from math import sqrt

import networkx as nx
import numpy as np
import pytest

from desim.config.errors import KeyedError
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import Broadcast, Lost, Queued, Trace
from desim.kernel.link_layer.propagation import LinkSampler
from desim.kernel.models.latency import Constant, Netem, ShiftedExponential, Uniform
from desim.kernel.models.links import Links, Processing
from desim.kernel.models.medium import Bitrate, Unlimited
from desim.kernel.network import Network
from desim.kernel.state.fault_state import FaultState

MS = 1_000_000
"""Nanoseconds in a millisecond."""
MEDIA = [Unlimited(), Bitrate(bitrate=8e5), Bitrate(bitrate=8e5, shared=True), Bitrate(bitrate=8e5, half_duplex=True)]
CONTENDING = Bitrate(bitrate=8e5, access={"kind": "csma_ca"})


def network(medium, sender, graph=None, seed=4, **given):
    """Return a clock, a network whose frames of 100 bytes take 1 ms on a channel, and its trace."""
    clock, trace = Clock(), Trace()
    links = Links(medium=medium, processing=Processing(sender=sender))
    return (
        clock,
        Network(clock, nx.complete_graph(2) if graph is None else graph, links, seed=seed, trace=trace, **given),
        trace,
    )


@pytest.mark.parametrize("medium", [*MEDIA, CONTENDING])
@pytest.mark.parametrize("sender", [Uniform(low=0.0, high=0.05), ShiftedExponential(mean=0.02)])
def test_a_sender_passes_messages_on_in_the_order_created(medium, sender):
    """The delays alone would let about half of the pairs change places."""
    clock, net, trace = network(medium, sender)
    for _ in range(40):
        net.publish(0, None, size=100)
    clock.run()
    sent = trace.of(Broadcast)
    assert [each.seq for each in sent] == [*range(1, 41)]
    assert [each.created for each in sent] == [0] * 40
    assert sent[0].t > 0


@pytest.mark.parametrize("medium", [*MEDIA[1:], CONTENDING])
def test_a_constant_delay_at_the_sender_comes_before_the_air(medium):
    clock, net, trace = network(medium, 0.5)
    net.publish(0, None, size=100)
    clock.run()
    (sent,), (queued,) = trace.of(Broadcast), trace.of(Queued)
    assert (queued.t, sent.t // MS) == (0, 500)
    assert sent.arrival[0] // MS == 501


def test_without_a_queue_a_constant_delay_is_a_part_of_the_latency():
    clock, net, trace = network(Unlimited(), 0.5)
    net.publish(0, None, size=100)
    clock.run()
    (sent,) = trace.of(Broadcast)
    assert (sent.t, sent.arrival, trace.of(Queued)) == (0, (500 * MS,), [])


@pytest.mark.parametrize("medium", [*MEDIA, CONTENDING])
def test_a_constant_delay_is_that_of_a_model_that_always_draws_it(medium):
    """Not drawn, or a part of the latency, it leads to the same arrivals as one that is drawn for each message."""

    def arrivals(sender):
        clock, net, trace = network(medium, sender)
        for _ in range(5):
            net.publish(0, None, size=100)
        clock.run()
        return [(sent.created, sent.arrival) for sent in trace.of(Broadcast)]

    assert arrivals(0.5) == arrivals(Uniform(low=0.5, high=0.5))


@pytest.mark.slow
def test_the_delays_have_the_distribution_of_the_model():
    """Moments of 4000 messages of as many senders, and the typical latency; the control is 5 % off."""
    clock, net, trace = network(Unlimited(), ShiftedExponential(offset=0.01, mean=0.02), nx.cycle_graph(4000))
    for node in range(4000):
        net.send(node, (node + 1) % 4000, None, size=1)
    clock.run(until=1)
    counts = net.message_counts()
    assert counts.in_flight == 4000
    clock.run()
    delays = np.array([each.t for each in trace if type(each).__name__ == "Sent"]) / 1e9
    error = 0.02 / sqrt(4000)
    assert len(delays) == 4000
    assert abs(delays.mean() - 0.03) < 4 * error
    assert abs(delays.mean() - 0.0315) > 4 * error
    assert delays.min() > 0.01
    assert abs(delays.std() - 0.02) < 8 * error
    assert net.estimates.latency == pytest.approx(0.03)


@pytest.mark.parametrize("medium", [*MEDIA, CONTENDING])
def test_messages_in_a_host_are_in_flight_and_lost_with_it(medium):
    clock, net, trace = network(medium, Uniform(low=0.1, high=0.2), fault_state=FaultState())
    net.publish(0, None, size=100)
    net.publish(1, None, size=100)
    Instant(clock, 50 * MS, Phase.FAULT).callbacks.append(lambda _: net.crash(0))
    Instant(clock, 60 * MS, Phase.FAULT).callbacks.append(lambda _: net.recover(0))
    Instant(clock, 61 * MS, Phase.DECISION).callbacks.append(lambda _: net.publish(0, None, size=100))
    clock.run(until=40 * MS)
    assert (net.message_counts().sent, net.message_counts().in_flight) == (2, 2)
    clock.run()
    counts = net.message_counts()
    assert (counts.sent, counts.delivered, counts.in_flight, counts.lost_by) == (3, 2, 0, {"crash": 1})
    assert [(each.t, each.src) for each in trace.of(Lost)] == [(50 * MS, 0)]


def test_a_message_after_a_crash_does_not_wait_for_those_before():
    """Twenty messages wait for 0.95 s on average, because they stay in order; the one after the crash for 0.5 s."""
    starts = []
    for seed in range(8):
        clock, net, trace = network(Unlimited(), Uniform(low=0.0, high=1.0), fault_state=FaultState(), seed=seed)
        for _ in range(20):
            net.publish(0, None, size=100)
        Instant(clock, MS, Phase.FAULT).callbacks.append(lambda _, net=net: net.crash(0))
        Instant(clock, 2 * MS, Phase.FAULT).callbacks.append(lambda _, net=net: net.recover(0))
        Instant(clock, 3 * MS, Phase.DECISION).callbacks.append(lambda _, net=net: net.publish(0, None, size=100))
        clock.run()
        starts.append(trace.of(Broadcast)[-1].t)
    assert min(starts) < 500 * MS


@pytest.mark.parametrize("sender", [Constant(value=0.02), Uniform(low=0.0, high=0.04), Netem(delay=0.02, jitter=0.01)])
@pytest.mark.parametrize("medium", [Unlimited(), Bitrate(bitrate=1e6)])
def test_the_typical_latency_has_the_mean_of_the_sender_s_delay(sender, medium):
    links = Links(latency=0.1, processing=Processing(sender=sender, receiver=0.03), medium=medium)
    assert LinkSampler(links, nx.complete_graph(3), 1, None).typical_latency() == pytest.approx(0.15, rel=0.02)


@pytest.mark.parametrize("kind", ["per_pair", "matrix", "propagation", "trace"])
def test_a_delay_that_depends_on_the_receiver_is_refused(kind):
    with pytest.raises(KeyedError, match=f"sender.kind: there is no '{kind}'; allowed: constant, uniform"):
        Processing(sender={"kind": kind})
