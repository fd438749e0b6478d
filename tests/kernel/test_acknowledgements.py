"""Acknowledgements that can be lost, EIFS, NAV and hidden nodes, against a simulation of plain loops."""

from dataclasses import replace
from itertools import product
from math import sqrt
from typing import Literal

import networkx as nx
import numpy as np
import pytest
from scipy.optimize import brentq

from desim.config.errors import KeyedError
from desim.config.model import Value
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.models.access import CsmaCa
from desim.kernel.models.links import Links
from desim.kernel.models.medium import Bitrate
from desim.kernel.network import Network
from desim.kernel.state.fault_state import FaultState
from tests.kernel.dcf import Timing, saturated

TIMING = Timing()


def access(timing, **changes):
    """Return the access model with the times of a reference."""
    times = {key: getattr(timing, key) * 1e-6 for key in ("slot", "sifs", "difs", "ack", "ack_timeout", "eifs")}
    counts = {key: getattr(timing, key) for key in ("window", "doublings", "retries")}
    return CsmaCa(**times | counts | changes)


def of_desim(graph, flows, horizon, seed, model, airtime=300, **links):
    """Return the messages that each flow delivers, and the number of attempts, in a time of `horizon` us."""
    clock, delivered = Clock(), dict.fromkeys(flows, 0)
    medium = Bitrate(bitrate=8e6, access=model)
    net = Network(clock, graph, Links(medium=medium, **links), seed=seed)

    for src, dst in flows.items():
        for _ in range(400):
            net.send(src, dst, src, size=airtime)
    clock.run(until=horizon * 1000)
    for dst in set(flows.values()):
        for message in net.inbox(dst, "").drain():
            delivered[message.body] += 1
    return delivered, net.message_counts()


def path(size):
    """Return a chain of nodes that hear their neighbours only."""
    return nx.path_graph(size)


def hears(graph):
    return {node: set(graph.adj[node]) for node in sorted(graph)}


FLOWS = {1: 0, 2: 1, 3: 4}
"""In a chain of five: 1 and 3 are hidden from each other, and 2 hears both, mostly at once, so it receives neither."""


def both(flows, graph, timing, *, replications=4, horizon=40_000, model=None):
    """Return the attempts and the deliveries of each flow, in desim and in the reference: means and standard errors."""
    model = access(timing) if model is None else model
    found = np.array([measured(of_desim(graph, flows, horizon, seed, model)) for seed in range(replications)])
    count = 4 * replications
    theory = np.array([reference(saturated(hears(graph), flows, horizon, seed, timing)) for seed in range(count)])
    error = np.sqrt(found.var(axis=0, ddof=1) / len(found) + theory.var(axis=0, ddof=1) / len(theory))
    return found.mean(axis=0), theory.mean(axis=0), error


def measured(result):
    delivered, counts = result
    return [float(counts.transmissions), *map(float, delivered.values())]


def reference(result):
    delivered, attempts, _ = result
    return [float(attempts), *map(float, delivered.values())]


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("eifs", [88, 28])
def test_hidden_nodes_deliver_what_plain_loops_do(eifs):
    """The control is the other interframe space, which changes the share of the node between the hidden ones."""
    timing = replace(TIMING, eifs=eifs)
    found, theory, error = both(FLOWS, path(5), timing)
    assert (abs(found - theory) < 4 * error).all()
    other = [
        reference(saturated(hears(path(5)), FLOWS, 40_000, seed, replace(TIMING, eifs=116 - eifs)))
        for seed in range(24)
    ]
    assert (abs(found - np.mean(other, axis=0)) > 3 * error).any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("graph", "flows"),
    [(nx.complete_graph(3), {0: 2, 1: 2}), (path(3), {0: 1, 2: 1}), (path(4), {1: 0, 2: 3}), (path(2), {0: 1})],
    ids=["hearing", "hidden", "exposed", "alone"],
)
def test_pairs_of_flows_deliver_what_plain_loops_do(graph, flows):
    found, theory, error = both(flows, graph, TIMING)
    assert (abs(found - theory) < 4 * error + 1e-9).all()


@pytest.mark.slow
def test_the_extended_space_protects_acknowledgements_from_a_node_that_could_not_receive_the_frame():
    """Node 2 hears the frames of 1 and 3 at once. With DIFS it disturbs the acknowledgement of node 0 at node 1."""
    lost = [saturated(hears(path(5)), FLOWS, 60_000, 1, replace(TIMING, eifs=eifs))[2] for eifs in (88, 28)]
    assert lost[0] == 0
    assert lost[1] > 5
    repeated = []
    for eifs in (88e-6, 28e-6):
        delivered, counts = of_desim(path(5), FLOWS, 60_000, 1, access(TIMING, eifs=eifs))
        repeated.append((counts.transmissions - sum(delivered.values())) / counts.transmissions)
    assert repeated[1] > repeated[0]


@pytest.mark.slow
def test_a_node_that_hears_a_frame_is_silent_until_the_end_of_its_acknowledgement():
    """Node 2 hears the frame of 1, which 0 acknowledges out of its hearing, and then sends to 1."""
    for seed in range(30):
        clock = Clock()
        net = Network(clock, path(3), Links(medium=Bitrate(bitrate=8e6, access=access(TIMING))), seed=seed)
        net.send(1, 0, "first", size=300)
        Instant(clock, 100_000, Phase.DECISION).callbacks.append(lambda _, net=net: net.send(2, 1, "second", size=300))
        clock.run(until=5_000_000)
        counts = net.message_counts()
        assert (counts.transmissions, counts.delivered) == (2, 2)


def test_saturated_nodes_that_all_hear_each_other_have_the_throughput_of_bianchi():
    """A failure takes as long as a success: frame + SIFS + acknowledgement + DIFS; 5 nodes, W = 16, m = 6.

    As in `test_access`, 0.6 % of the formula is allowed besides the error. The control is W = 128.
    """

    def bianchi(window, nodes=5, doublings=6):
        def attempt(p):
            return 2 / (1 + window + p * window * sum((2 * p) ** i for i in range(doublings)))

        tau = attempt(brentq(lambda p: p - 1 + (1 - attempt(p)) ** (nodes - 1), 1e-9, 1 - 1e-9))
        some, one = 1 - (1 - tau) ** nodes, nodes * tau * (1 - tau) ** (nodes - 1)
        return one * 300 / ((1 - some) * 9 + some * (300 + 10 + 50 + 28))

    ring = {k: (k + 1) % 5 for k in range(5)}
    runs = [of_desim(nx.complete_graph(5), ring, 80_000, seed, access(TIMING, retries=1000)) for seed in range(5)]
    found = np.array([sum(delivered.values()) * 300 / 80_000 for delivered, _ in runs])
    error = found.std(ddof=1) / sqrt(len(found))
    assert abs(found.mean() - bianchi(16)) < 4 * error + 0.006 * bianchi(16)
    assert abs(found.mean() - bianchi(128)) > 4 * error + 0.006 * bianchi(16)


def test_a_saturated_sender_alone_has_the_period_of_the_formula():
    """DIFS + a mean of 7.5 slots + frame + SIFS + acknowledgement, 455.5 us; an uncertainty of 400 windows."""
    delivered, counts = of_desim(path(2), {0: 1}, 150_000, 1, access(TIMING))
    period = 28 + 7.5 * 9 + 300 + 10 + 50
    assert delivered[0] == pytest.approx(150_000 / period, rel=4 * 9 * sqrt((16**2 - 1) / 12 / 329) / period)
    assert counts.lost == 0


@pytest.mark.slow
@pytest.mark.parametrize("p", [0.2, 0.5])
def test_both_the_frame_and_its_acknowledgement_must_get_through(p):
    """An attempt succeeds with (1 - p)^2, so a message takes (1 - q^8) / (1 - q) attempts, q = 1 - (1 - p)^2.

    It is delivered if any of its frames arrives. The control, acknowledgements that are never lost, has q = p.
    """
    counts = [of_desim(path(2), {0: 1}, 200_000, seed, access(TIMING), loss=p)[1] for seed in range(4)]
    sure = [
        of_desim(path(2), {0: 1}, 200_000, seed, access(TIMING, ack_timeout=None, eifs=None), loss=p)[1]
        for seed in range(4)
    ]

    def attempts(q):
        return (1 - q**8) / (1 - q)

    q = 1 - (1 - p) ** 2
    for counted, mean in ((counts, attempts(q)), (sure, attempts(p))):
        ratios = np.array([each.transmissions / (each.delivered + each.lost) for each in counted])
        error = ratios.std(ddof=1) / 2
        assert abs(ratios.mean() - mean) < 5 * error + 0.01
    assert attempts(q) > 1.2 * attempts(p)


def test_a_message_whose_acknowledgements_are_lost_is_delivered_once():
    """The link back loses all: the frame is transmitted eight times, and its receiver delivers it once."""
    graph = nx.DiGraph([(0, 1), (1, 0)])
    graph.edges[1, 0]["loss"] = 1.0
    clock = Clock()
    net = Network(clock, graph, Links(medium=Bitrate(bitrate=8e6, access=access(TIMING))))
    net.send(0, 1, "once", size=300)
    clock.run()
    counts = net.message_counts()
    assert [message.body for message in net.inbox(1).drain()] == ["once"]
    assert (counts.transmissions, counts.sent, counts.delivered, counts.lost, counts.in_flight) == (8, 1, 1, 0, 0)


@pytest.mark.parametrize(("node", "t", "loss"), [*product([0, 1], [100, 310, 335, 359, 365], [0.0, 1.0])])
def test_a_crash_between_a_frame_and_its_acknowledgement_loses_no_count(t, node, loss):
    """The frame is on the air from 28 to 328 us, and its acknowledgement, if it is not lost, from 338 to 388 us."""
    clock = Clock()
    faults = FaultState(lambda: np.zeros((2, 2)))
    links = Links(medium=Bitrate(bitrate=8e6, access=access(TIMING)), loss=loss)
    net = Network(clock, path(2), links, fault_state=faults)
    net.send(0, 1, "x", size=300)
    net.send(0, 1, "y", size=300)
    Instant(clock, t * 1000, Phase.FAULT).callbacks.append(lambda _: net.crash(node))
    Instant(clock, 20_000_000, Phase.FAULT).callbacks.append(lambda _: net.recover(node))
    Instant(clock, 30_000_000, Phase.DECISION).callbacks.append(lambda _: net.send(0, 1, "z", size=300))
    clock.run()
    counts = net.message_counts()
    assert counts.sent == counts.delivered + counts.lost == 3
    bodies = [message.body for message in net.inbox(1).drain()]
    assert ("z" in bodies) is (loss == 0.0)
    assert counts.delivered == len(bodies)


def test_a_node_that_crashes_as_it_acknowledges_is_not_heard():
    """The message is delivered at 328 us, the acknowledgement ends at 388 us, and the receiver is down from 359 us."""
    clock, links = Clock(), Links(medium=Bitrate(bitrate=8e6, access=access(TIMING)))
    net = Network(clock, path(2), links, fault_state=FaultState())
    net.send(0, 1, "x", size=300)
    Instant(clock, 359_000, Phase.FAULT).callbacks.append(lambda _: net.crash(1))
    clock.run()
    counts = net.message_counts()
    assert (counts.transmissions, counts.delivered, counts.lost) == (8, 1, 0)


class LostIfLong(Value):
    """Loses what is longer than 50 bytes on the way back."""

    kind: Literal["lost_if_long"] = "lost_if_long"

    def __call__(self, context, rng):
        return context.size > 50 and context.src == 1


def test_an_acknowledgement_is_lost_as_a_frame_of_its_own_size():
    clock, links = Clock(), Links(medium=Bitrate(bitrate=8e6, access=access(TIMING)), loss=LostIfLong())
    net = Network(clock, path(2), links)
    net.send(0, 1, "x", size=300)
    clock.run()
    assert net.message_counts().transmissions == 1


@pytest.mark.parametrize("t", [335, 400])
def test_a_node_that_crashes_between_two_attempts_begins_anew(t):
    """All frames are lost, so the message after the crash is transmitted eight times, as one without a crash is.

    The first frame ends at 328 us, and the wait for its acknowledgement at 388 us.
    """
    clock, links = Clock(), Links(medium=Bitrate(bitrate=8e6, access=access(TIMING)), loss=1.0)
    net = Network(clock, path(2), links, fault_state=FaultState())
    net.send(0, 1, "x", size=300)
    Instant(clock, t * 1000, Phase.FAULT).callbacks.append(lambda _: net.crash(0))
    Instant(clock, 20_000_000, Phase.FAULT).callbacks.append(lambda _: net.recover(0))
    Instant(clock, 30_000_000, Phase.DECISION).callbacks.append(lambda _: net.send(0, 1, "y", size=300))
    clock.run()
    assert net.message_counts().transmissions == 1 + 8


@pytest.mark.parametrize(
    ("times", "match"),
    [
        ({"ack_timeout": 59e-6}, "ack_timeout should be at least sifs . ack, 6e-05 s .got 5.9e-05"),
        ({"eifs": 27e-6}, "eifs should be at least difs, 2.8e-05 s .got 2.7e-05"),
    ],
)
def test_times_that_are_too_short_are_refused(times, match):
    with pytest.raises(KeyedError, match=match):
        access(TIMING, **times)
