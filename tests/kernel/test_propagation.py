"""What the links do to a transmission: models of single links, order, processing, draws ahead."""

from math import exp, hypot, sqrt

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import LOST, Sent, Trace
from desim.kernel.core.positions import PositionSource
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import SECOND
from desim.kernel.link_layer.propagation import LinkSampler
from desim.kernel.models.correlation import LinkMemory
from desim.kernel.models.graphs import Edge, Edges, Link
from desim.kernel.models.latency import Constant, Empirical, Gamma, Lognormal, Propagation, ShiftedExponential, Uniform
from desim.kernel.models.latency_by_link import PerPair
from desim.kernel.models.link_draws import BLOCK
from desim.kernel.models.links import Links, Processing
from desim.kernel.models.loss import Bernoulli, ByDistance, GilbertElliott
from desim.kernel.network import Network

DRAWN = [
    Uniform(),
    ShiftedExponential(offset=0.01),
    Gamma(offset=0.01, shape=2.5),
    Gamma(shape=0.5),
    Lognormal(),
    Empirical(values=(0.1, 0.2, 0.3)),
]
COUNTS = [1, 3, 0, 9, 4000, 200, 1, 9000, 7]
"""Receivers per transmission, so that blocks end within one."""


def sampler(links, size=4, graph=None, seed=7, positions=None):
    return LinkSampler(links, nx.complete_graph(size) if graph is None else graph, seed, positions)


def arrivals_in_order(trip, src, dst, now, airtime=0):
    """Return when a message that nothing is lost of is readable at each receiver, ns."""
    return trip.in_order(src, dst, trip.arrivals(src, dst, now, airtime, 24))


def delays(links, src, dst, seed=7, count=1, **rest):
    """Return what `count` transmissions take, s: (count, receivers)."""
    trip = sampler(links, seed=seed, **rest)
    taken = [np.broadcast_to(trip.arrivals(src, dst, 0, 0, 24), len(dst)) for _ in range(count)]
    return np.array(taken) / SECOND


# Draws ahead.


@pytest.mark.slow_but_one
@pytest.mark.parametrize("model", DRAWN)
@pytest.mark.parametrize("own", [(), (Link(src=1, dst=2, latency=Gamma()),)])
def test_latencies_are_exactly_the_draws_that_their_stream_gives(model, own):
    """In the order in which they are needed, whatever the blocks and whatever links of their own are elsewhere."""
    trip = sampler(Links(latency=model, link=own), graph=nx.star_graph([1, *range(2, 9001), 0]))
    found = [delay for count in COUNTS for delay in trip.arrivals(0, list(range(1, count + 1)), 0, 0, 24)]
    expected = model.draw(len(found), stream(7, "latency"))
    assert len(found) > 3 * BLOCK
    assert found == np.rint(expected * SECOND).astype(int).tolist()
    assert found != np.rint(model.draw(len(found), stream(8, "latency")) * SECOND).astype(int).tolist()


@pytest.mark.slow
def test_losses_are_exactly_the_draws_that_their_stream_gives():
    trip = sampler(Links(loss=Bernoulli(p=0.3)), graph=nx.star_graph([1, *range(2, 9001), 0]))
    found = [lost for count in COUNTS for lost in trip.losses(0, list(range(1, count + 1)), 0, 24)]
    assert found == (stream(7, "loss").random(len(found)) < 0.3).tolist()


def test_losses_and_latencies_use_separate_random_streams():
    """Latencies stay as they are whatever is lost, so that runs with and without loss are paired."""
    models = [Bernoulli(), Bernoulli(p=0.5), GilbertElliott()]
    found = []
    for loss in models:
        trip = sampler(Links(latency=Gamma(), loss=loss))
        row = []
        for k in range(20):
            trip.losses(0, [1, 2, 3], k * SECOND, 24)
            row += trip.arrivals(0, [1, 2, 3], k * SECOND, 0, 24)
        found.append(row)
    assert found[0] == found[1] == found[2]


def test_models_that_need_positions_get_them_for_every_message():
    at = np.array([[0.0, 0.0], [300.0, 0.0]])
    trip = sampler(Links(latency=Propagation(), loss=ByDistance(distance=600.0)), 2, positions=lambda: at)
    assert trip.arrivals(0, [1], 0, 0, 24) == [SECOND // 5]
    at[1] = 600.0, 0.0
    assert trip.arrivals(0, [1], SECOND, 0, 24) == [SECOND + 2 * SECOND // 5]
    assert trip.losses(0, [1], 0, 24) == [True]
    at[1] = 0.0, 0.0
    assert trip.losses(0, [1], 0, 24) == [False]


# Links of their own.


@pytest.mark.parametrize("model", [Constant(value=0.5), Uniform(low=0.4, high=0.6), PerPair()])
def test_a_link_of_its_own_takes_its_own_time_and_no_other_does(model):
    """Way 0 to 2 takes 9 s; the others are untouched, to the nanosecond, as is the way back unless it is both ways."""
    for both_ways in (False, True):
        own = Links(latency=model, link=(Link(src=0, dst=2, both_ways=both_ways, latency=Constant(value=9.0)),))
        for src, dst, k in ((0, [1, 2, 3], 1), (2, [0, 1, 3], 0), (1, [0, 2, 3], None)):
            plain, found = delays(Links(latency=model), src, dst, count=3), delays(own, src, dst, count=3)
            changed = np.zeros_like(plain, dtype=bool)
            if src == 0 or (src == 2 and both_ways):
                changed[:, k] = True
            assert (found[changed] == 9.0).all()
            assert (found[~changed] == plain[~changed]).all()


def test_link_attributes_of_an_edge_apply_both_ways_unless_the_graph_is_directed():
    for graph, back in ((nx.complete_graph(3), 9.0), (nx.complete_graph(3, nx.DiGraph), 0.5)):
        graph.edges[0, 1]["latency"] = 9.0
        links = Links(latency=Constant(value=0.5))
        assert delays(links, 0, [1, 2], graph=graph).tolist() == [[9.0, 0.5]]
        assert delays(links, 1, [0, 2], graph=graph).tolist() == [[back, 0.5]]


def test_a_link_that_is_named_comes_before_the_attribute_of_its_edge():
    graph = Edges(edges=(Edge(src=0, dst=1, latency=Constant(value=2.0)), Edge(src=1, dst=2)))(3)
    links = Links(latency=Constant(value=1.0), link=(Link(src=0, dst=1, latency=Constant(value=3.0)),))
    assert delays(links, 0, [1], graph=graph).tolist() == [[3.0]]
    assert delays(links, 1, [0, 2], graph=graph).tolist() == [[2.0, 1.0]]


def test_a_link_inherits_unset_properties_from_the_network():
    links = Links(latency=Constant(value=1.0), link=(Link(src=0, dst=1, loss=Bernoulli(p=1.0)),))
    assert delays(links, 0, [1, 2]).tolist() == [[1.0, 1.0]]
    links = Links(loss=Bernoulli(p=1.0), link=(Link(src=0, dst=1, latency=Constant(value=2.0)),))
    assert sampler(links).losses(0, [1, 2], 0, 24) == [True, True]


@pytest.mark.slow_but_one
@pytest.mark.parametrize("loss", [Bernoulli(), Bernoulli(p=0.2), GilbertElliott(share=0.2)])
def test_a_link_of_its_own_loses_its_own_share(loss):
    """2000 messages: 50 % on the link from 0 to 2, 20 % or none on the others, +- sqrt(p q n); the control is 40 %."""
    trip = sampler(Links(loss=loss, link=(Link(src=0, dst=2, loss=Bernoulli(p=0.5)),)))
    assert not trip.lossless
    lost = np.array([trip.losses(0, [1, 2, 3], 0, 24) or [False] * 3 for _ in range(2000)])
    plain = sampler(Links(loss=loss))
    alike = np.array([plain.losses(0, [1, 2, 3], 0, 24) or [False] * 3 for _ in range(2000)])
    assert abs(lost[:, 1].sum() - 1000) < 5 * sqrt(500)
    assert abs(lost[:, 1].sum() - 800) > 5 * sqrt(500)
    assert (lost[:, [0, 2]] == alike[:, [0, 2]]).all()


def test_bursts_of_a_link_of_its_own_go_on_from_message_to_message():
    """A burst of 10^6 messages: all or nothing within a run, and half of the runs; the control has no memory."""
    runs = []
    for seed in range(40):
        trip = sampler(Links(link=(Link(src=0, dst=1, loss=GilbertElliott(share=0.5, burst=1e6)),)), seed=seed)
        runs.append([trip.losses(0, [1], 0, 24)[0] for _ in range(50)])
    assert all(len(set(run)) == 1 for run in runs)
    assert 5 < sum(run[0] for run in runs) < 35
    trip = sampler(Links(link=(Link(src=0, dst=1, loss=Bernoulli(p=0.5)),)))
    assert len({trip.losses(0, [1], 0, 24)[0] for _ in range(50)}) == 2


def test_an_ideal_network_loses_nothing_and_reports_it():
    assert sampler(Links()).lossless
    assert sampler(Links(link=[Link(src=0, dst=1, loss=Bernoulli())])).lossless
    assert not sampler(Links(link=[Link(src=0, dst=1, loss=Bernoulli(p=0.1))])).lossless
    assert not sampler(Links(loss=Bernoulli(p=0.1), link=[Link(src=0, dst=1, loss=Bernoulli())])).lossless
    assert sampler(Links()).losses(0, [1, 2], 0, 24) is None
    assert not sampler(Links(loss=Bernoulli(p=0.1))).lossless


def test_links_of_their_own_are_those_of_a_whole_network():
    """From 0 to 1 it takes 2 s, from 1 to 0 nothing arrives, all others take 1 s."""
    clock = Clock()
    graph = nx.complete_graph(3)
    graph.edges[0, 1]["latency"] = 2
    net = Network(
        clock, graph, Links(latency=Constant(value=1.0), link=(Link(src=1, dst=0, loss=Bernoulli(p=1.0)),)), seed=1
    )
    for node in range(3):
        net.publish(node, None)
    clock.run(until=3 * SECOND)
    heard = [{src: arrival / SECOND for src, (arrival, _) in net.latest_records(node).items()} for node in range(3)]
    assert heard == [{2: 1.0}, {0: 2.0, 2: 1.0}, {0: 1.0, 1: 1.0}]
    assert net.message_counts().lost_by == {"loss": 1}


# Order.

MESSAGES = st.lists(st.tuples(st.integers(0, 3), st.integers(0, 30), st.integers(0, 500)), min_size=1, max_size=30)


@pytest.mark.slow
@given(MESSAGES, st.integers(0, 99), st.sampled_from([Uniform(high=1.0), PerPair(jitter=Uniform(high=1.0)), Gamma()]))
def test_with_fifo_no_message_of_a_link_arrives_before_an_earlier_one(messages, seed, model):
    """A message waits for those of its link before it and for nothing else: it arrives with the latest of them."""
    fifo = sampler(Links(latency=model, order="fifo"), seed=seed)
    free = sampler(Links(latency=model), seed=seed)
    seen = {}
    for src, t, airtime in sorted(messages, key=lambda each: each[1]):
        dst = [node for node in range(4) if node != src]
        now = t * SECOND // 100
        for node, when, alone in zip(
            dst, arrivals_in_order(fifo, src, dst, now, airtime), free.arrivals(src, dst, now, airtime, 24), strict=True
        ):
            latest = seen.setdefault((src, node), [])
            latest.append(alone)
            assert when == max(latest)


def test_without_fifo_messages_overtake():
    """The control of the property above: of 100 messages 10 ms apart with up to 1 s of latency many overtake."""
    trip = sampler(Links(latency=Uniform(high=1.0)))
    arrivals = [trip.arrivals(0, [1], k * SECOND // 100, 0, 24)[0] for k in range(100)]
    assert (np.diff(arrivals) < 0).sum() > 20
    trip = sampler(Links(latency=Uniform(high=1.0), order="fifo"))
    arrivals = [arrivals_in_order(trip, 0, [1], k * SECOND // 100)[0] for k in range(100)]
    assert (np.diff(arrivals) >= 0).all()


@pytest.mark.parametrize("own", [None, "fifo"])
@pytest.mark.parametrize("order", ["fifo", "overtaking"])
def test_fifo_messages_are_read_in_sending_order(order, own):
    clock = Clock()
    links = Links(latency=Uniform(high=1.0), order=order, link=(Link(src=0, dst=1, order=own),) if own else ())
    net = Network(clock, nx.complete_graph(2), links, seed=3)
    for k in range(50):
        event = Instant(clock, k * SECOND // 100, Phase.DECISION)
        event.callbacks.append(lambda _, k=k: net.send(0, 1, k))
    clock.run(until=5 * SECOND)
    read = [message.body for message in net.inbox(1).drain()]
    assert sorted(read) == list(range(50))
    assert (read == sorted(read)) is ("fifo" in {order, own})


def test_a_fifo_record_waits_for_an_earlier_one_if_a_model_returns_one_latency_for_all_receivers():
    """The record of 0.2 s has a latency of 0.1 s, and waits for the first one, which takes 1 s."""
    clock = Clock()
    links = Links(latency=lambda context, rng: 0.1 if context.now else 1.0, order="fifo")
    net = Network(clock, nx.complete_graph(3), links)
    net.publish(0, "slow")
    clock.run(until=SECOND // 5)
    net.publish(0, "fast")
    clock.run(until=SECOND // 2)
    assert net.latest_records(1) == {}
    clock.run(until=SECOND + 1)
    assert net.latest_records(1)[0][1].body == "fast"


def test_a_link_of_its_own_keeps_its_order_too():
    own = (Link(src=0, dst=1, latency=Uniform(high=1.0)),)
    trip = sampler(Links(order="fifo", link=own))
    arrivals = np.array([arrivals_in_order(trip, 0, [1, 2], k * SECOND // 100) for k in range(100)])
    assert (np.diff(arrivals, axis=0) >= 0).all()
    assert (np.diff(arrivals[:, 1]) == SECOND // 100).all()


# Time at both ends.


@pytest.mark.parametrize("order", ["fifo", "overtaking"])
@pytest.mark.parametrize(
    "model",
    [Constant(value=0.5), Uniform(low=0.5, high=0.5), PerPair(base=Constant(value=0.5)), lambda context, rng: 0.5],
)
@pytest.mark.parametrize("own", [(), (Link(src=0, dst=1, latency=Constant(value=0.5)),)])
def test_processing_and_airtime_are_added_once_each(model, order, own):
    """2 s of now, 10 ms to send, 0.3 s on the air, 0.5 s on the way, 7 ms to read: 2.817 s."""
    trip = sampler(Links(latency=model, order=order, link=own, processing=Processing(sender=0.010, receiver=0.007)))
    arrival = trip.arrivals(0, [1, 2, 3], 2 * SECOND, 300_000_000, 24)
    assert np.broadcast_to(arrival, 3).tolist() == [2_817_000_000] * 3


def test_times_are_rounded_to_the_nanosecond_and_not_cut_off():
    assert sampler(Links(latency=Constant(value=1.6e-9))).arrivals(0, [1], 0, 0, 24) == 2
    assert sampler(Links(latency=Uniform(low=1.6e-9, high=1.6e-9))).arrivals(0, [1], 0, 0, 24) == [2]


def test_a_lost_message_does_not_delay_later_ones():
    """Half of the messages are lost; one that is not arrives when it would, or with the last before it that arrived."""
    clock, trace = Clock(), Trace()
    links = Links(latency=Uniform(high=1.0), loss=Bernoulli(p=0.5), order="fifo")
    free = sampler(Links(latency=Uniform(high=1.0)), size=2)
    network = Network(clock, nx.complete_graph(2), links, seed=7, trace=trace)
    expected, latest = [], 0

    def transmit():
        for _ in range(200):
            network.send(0, 1, "x")
            yield clock.timeout(SECOND // 100)

    clock.process(transmit())
    clock.run()
    for sent in trace.of(Sent):
        (alone,) = free.arrivals(0, [1], sent.t, 0, 24)
        latest = latest if sent.arrival == LOST else max(latest, alone)
        expected.append(LOST if sent.arrival == LOST else latest)
    assert [sent.arrival for sent in trace.of(Sent)] == expected
    assert 50 < expected.count(LOST) < 150


def test_the_typical_latency_is_the_mean_of_draws_of_its_own():
    """Exponential of mean 50 ms over 4 nodes: 1,200 draws, within 5 x 50 / sqrt(1200) ms; none of the run."""
    links = Links(latency=ShiftedExponential(mean=0.05), order="fifo")
    trip, same = sampler(links), sampler(links)
    typical = trip.typical_latency()
    assert typical == pytest.approx(0.05, abs=5 * 0.05 / sqrt(1200))
    assert abs(2 * typical - 0.05) > 5 * 0.05 / sqrt(1200)
    assert trip.arrivals(0, [1, 2], 0, 0, 24) == same.arrivals(0, [1, 2], 0, 0, 24)
    fresh = sampler(links)
    run = np.array([fresh.arrivals(0, [1], 0, 0, 24)[0] / SECOND for _ in range(BLOCK)])
    means = np.cumsum(run) / np.arange(1, BLOCK + 1)
    assert abs(means - typical).min() > 1e-10


@pytest.mark.parametrize("graph", [nx.complete_graph(4), nx.path_graph(3), nx.star_graph(40), nx.complete_graph(110)])
@pytest.mark.parametrize("latency", DRAWN)
def test_the_typical_latency_is_that_of_draws_link_by_link(graph, latency):
    links = Links(latency=latency, processing=Processing(receiver=0.003))
    plain = LinkSampler(links, graph, 0, None, "typical ")
    times = []
    for src in list(graph) * (1 + 1000 // graph.number_of_edges()):
        times += plain.arrivals(src, sorted(graph[src]), 0, 0, 48)
        if len(times) > 10_000:
            break
    assert LinkSampler(links, graph, 0, None).typical_latency() == sum(times) / len(times) / SECOND


def test_the_typical_latency_includes_the_processing_at_both_ends():
    links = Links(latency=Constant(value=0.1), processing=Processing(sender=0.02, receiver=0.03))
    assert sampler(links).typical_latency() == pytest.approx(0.15)


def test_the_loss_of_a_link_of_its_own_does_not_change_its_latencies():
    def latencies(p):
        own = Link(src=0, dst=1, latency=Uniform(high=1.0), loss=Bernoulli(p=p))
        trip, found = sampler(Links(link=(own,))), []
        for _ in range(20):
            trip.losses(0, [1, 2], 0, 24)
            found.append(trip.arrivals(0, [1, 2], 0, 0, 24))
        return found

    assert latencies(0.0) == latencies(0.3)


def test_a_link_that_is_not_in_the_graph_is_refused():
    with pytest.raises(ValueError, match="no link from 0 to 2 in the graph"):
        sampler(Links(link=(Link(src=0, dst=2, loss=Bernoulli(p=0.5)),)), graph=nx.path_graph(3))


# Answers of models of one's own.


def answering(answer):
    """Return a model that always answers this."""
    return lambda context, rng: answer


@pytest.mark.parametrize("answer", [0.5, np.float64(0.5), np.array(0.5), [0.5] * 3, (0.5,) * 3, np.full(3, 0.5)])
def test_a_latency_model_may_answer_with_one_number_or_one_per_hop(answer):
    arrival = sampler(Links(latency=answering(answer))).arrivals(0, [1, 2, 3], 0, 0, 24)
    assert np.broadcast_to(arrival, 3).tolist() == [SECOND // 2] * 3


@pytest.mark.parametrize("order", ["fifo", "overtaking"])
@pytest.mark.parametrize("count", [0, 1, 2, 4])
def test_a_latency_model_that_answers_for_another_number_of_hops_is_refused_with_its_answer(count, order):
    trip = sampler(Links(latency=answering([0.5] * count), order=order))
    with pytest.raises(ValueError, match=rf"each of 3 links, got \[{', '.join(['0.5'] * count)}\] from"):
        trip.arrivals(0, [1, 2, 3], 0, 0, 24)


@pytest.mark.parametrize("answer", [True, np.True_, [True] * 3, np.full(3, True)])
def test_a_loss_model_may_answer_with_one_truth_or_one_per_hop(answer):
    assert sampler(Links(loss=answering(answer))).losses(0, [1, 2, 3], 0, 24) == [True] * 3


NO_TRUTHS = [None, 0.0, 1, [0.0, 1.0, 0.0], [0, 1, 0], [None] * 3, "yes", [], [True], [True] * 2, [True] * 4]


@pytest.mark.parametrize("answer", NO_TRUTHS, ids=repr)
def test_a_loss_model_that_answers_with_anything_but_one_truth_or_one_per_hop_is_refused(answer):
    with pytest.raises(ValueError, match=r"one boolean or one for each of 3 links, got (None|'yes'|[\d.\[])"):
        sampler(Links(loss=answering(answer))).losses(0, [1, 2, 3], 0, 24)


@pytest.mark.parametrize("as_attribute", [True, False], ids=["edge", "link"])
def test_a_link_of_its_own_answers_for_a_single_hop(as_attribute):
    """One number, or a list of one; two of them, or none, are refused, and so is a loss that is no truth."""

    def trip(**model):
        graph = nx.complete_graph(4)
        if as_attribute:
            graph.edges[0, 2].update(model)
            return sampler(Links(), graph=graph)
        return sampler(Links(link=(Link(src=0, dst=2, **model),)))

    for answer in (0.5, [0.5]):
        assert trip(latency=answering(answer)).arrivals(0, [1, 2, 3], 0, 0, 24) == [0, SECOND // 2, 0]
    for count in (0, 2):
        with pytest.raises(ValueError, match=rf"each of 1 links, got \[{', '.join(['0.5'] * count)}\] from"):
            trip(latency=answering([0.5] * count)).arrivals(0, [1, 2, 3], 0, 0, 24)
    for answer in (True, [True]):
        assert trip(loss=answering(answer)).losses(0, [1, 2, 3], 0, 24) == [False, True, False]
    for answer in (None, 1.0, [1.0], [], [True, True]):
        with pytest.raises(ValueError, match="one boolean or one for each of 1 links"):
            trip(loss=answering(answer)).losses(0, [1, 2, 3], 0, 24)


@pytest.mark.parametrize("order", ["fifo", "overtaking"])
@pytest.mark.parametrize("by_edge", [True, False])
def test_a_link_may_keep_an_order_of_its_own(order, by_edge):
    """Links 0 to 1 and 0 to 2 fare alike but for the order of the first; the control is the second."""
    other = {"fifo": "overtaking", "overtaking": "fifo"}[order]
    graph = nx.complete_graph(3)
    if by_edge:
        graph.edges[0, 1]["order"] = order
    own = () if by_edge else (Link(src=0, dst=1, order=order),)
    trip = sampler(Links(latency=Uniform(high=1.0), order=other, link=own), graph=graph)
    found = np.array([arrivals_in_order(trip, 0, [1, 2], k * SECOND // 100) for k in range(100)])
    kept = (np.diff(found, axis=0) >= 0).all(axis=0)
    assert kept.tolist() == [order == "fifo", other == "fifo"]


# Losses with a memory, or by distance: against a plain model that draws link by link.


class Static(PositionSource):
    """Nodes at random places, which they never leave."""

    max_speed = 0.0

    def __init__(self, size):
        self.at_start = np.random.default_rng(size).random((size, 2))

    def __call__(self):
        return self.at_start


class Drifting(Static):
    """The same nodes, closer together at each query."""

    max_speed = 1.0

    def __call__(self):
        self.at_start = 0.9995 * self.at_start
        return self.at_start


MODELS = [
    ByDistance(distance=1.0),
    ByDistance(near=0.2, far=0.9, distance=0.7, exponent=1.3),
    GilbertElliott(share=0.3, burst=4.0),
    GilbertElliott(share=0.3, burst=4.0, loss_good=0.1, loss_bad=0.7),
    GilbertElliott(share=0.3, burst=0.02, advance="time"),
    GilbertElliott(share=0.3, burst=0.02, advance="time", loss_good=0.1, loss_bad=0.7),
]


def plain_losses(model, history, places, uniform):
    """Yield the losses of each transmission of a history, from a state per link and one uniform draw after another."""
    states = {}  # by link: whether it was bad at its last message, and the time of that
    for src, dst, now in history:
        if isinstance(model, ByDistance):
            at = places()
            apart = [hypot(*(at[node] - at[src])) for node in dst]
            yield [next(uniform) < model.probability(np.array([each]))[0] for each in apart]
            continue
        recovery = 1.0 / model.burst
        failure = recovery * model.share / (1.0 - model.share)
        bad = []
        for node in dst:
            chance = model.share
            if (src, node) in states:
                was_bad, since = states[src, node]
                if model.advance == "time":
                    chance += (was_bad - model.share) * exp((failure + recovery) * (since - now))
                else:
                    chance = 1.0 - recovery if was_bad else failure
            bad.append(next(uniform) < chance)
            states[src, node] = bad[-1], now
        if model.loss_good == 0.0 and model.loss_bad == 1.0:
            yield bad
        else:
            yield [next(uniform) < (model.loss_bad if each else model.loss_good) for each in bad]


def losses_and_plain_losses(model, seed, moving):
    """Return the losses of a random history, and those of the plain model: broadcasts, to all or some, and single."""
    rng, size = np.random.default_rng(seed), 8
    places = [(Drifting if moving else Static)(size) for _ in range(2)]
    trip = sampler(Links(loss=model), size, seed=seed, positions=places[0])
    others = [[node for node in range(size) if node != src] for src in range(size)]
    history = []
    for k in range(1500):
        src = int(rng.integers(3))
        some = sorted(rng.choice(others[src], int(rng.integers(1, size)), replace=False).tolist())
        history.append((src, others[src] if rng.random() < 0.7 else some, k // 2 * 0.001))
    found = [trip.losses(src, dst, round(now * SECOND), 24) for src, dst, now in history]
    uniform = iter(stream(seed, "loss").random(30_000).tolist())
    return found, list(plain_losses(model, history, places[1], uniform))


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("model", MODELS, ids=lambda model: f"{model.kind}")
def test_losses_are_those_of_a_plain_model_that_draws_link_by_link(model, moving):
    """Whatever is drawn in blocks, kept for the next broadcast of a sender, or put aside for a single message."""
    for seed in range(3):
        found, plain = losses_and_plain_losses(model, seed, moving)
        assert found == plain
        assert 500 < sum(map(sum, plain)) < sum(map(len, plain)) - 500


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS[2:])
def test_the_comparison_detects_links_that_are_not_put_aside(model, monkeypatch):
    """The control: each new list of receivers starts anew."""
    select = LinkMemory.select
    monkeypatch.setattr(LinkMemory, "select", lambda row, dst: dst is row.dst or row.__init__(0.3) or select(row, dst))
    found, plain = losses_and_plain_losses(model, 0, moving=False)
    assert found != plain


@pytest.mark.slow
def test_the_comparison_detects_distances_that_are_kept_though_nodes_move(monkeypatch):
    """The control."""
    monkeypatch.setattr(Drifting, "max_speed", 0.0)
    found, plain = losses_and_plain_losses(MODELS[0], 0, moving=True)
    assert found != plain
