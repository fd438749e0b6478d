"""Dissemination: the records each pursuer has, their arrival times, and the transmissions they took.

Positions are static and no pursuer has a record at first; the latency is L = 0.25 s, so that times are exact.
"""

from collections import Counter
from math import inf
from unittest.mock import patch

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import kstest

from desim import Scenario, load, run, summary
from desim.analysis.age import age_mean
from desim.kernel.core.events import GivenUp, MessageCounts, Sent
from desim.kernel.core.units import seconds
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.faults import Crash
from desim.kernel.models.graphs import Edges
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.transport import Coded, Reliable
from desim.pursuit.core.traits import DisseminationTraits
from desim.pursuit.team.agent import Agent
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Team
from desim.scenario.scenario import Motion, Recording
from protocols.dissemination import CodedOneHop, Flooding, Gossip, OneHop, ReliableOneHop
from scenarios.studies.study import SCENARIOS

L = 0.25
FAR = 1000
"""More hops than there are."""


def play(protocol, graph, dissemination, *watchers, **changes):
    """Run a protocol for a pursuer on each node of a graph."""
    given = {
        "horizon": 10.0,
        "team": Team(count=len(graph), active_at_start=0.0, speeds=1.0),
        "motion": Motion(static=True),
        "protocol": protocol,
        "network": Links(graph=Edges.of(graph), latency=Constant(value=L)),
        "announce": Announcements(trigger="never", start="silent", dissemination=dissemination),
        "record": Recording(trajectory=0.0, messages=True),
    }
    return run(Scenario(**(given | changes)), 0, *watchers)


def announcing_at(*times, by=0, heard=None):
    """Return a protocol in which one pursuer chases and announces it at times; at the end all log their records.

    heard: gets {pursuer: {source: (when the newest record arrived, s; its number)}}.
    """

    def protocol(me):
        if me.id == by:
            for t in times:
                yield me.at(t)
                me.assign(True)
                me.broadcast()
        yield me.at(max(9.5, me.now))
        if heard is not None:
            heard[me.id] = {
                j: (seconds(arrival), record.seq) for j, (arrival, record) in me._network.latest_records(me.id).items()
            }

    return protocol


def arrivals(graph, dissemination, **changes):
    """Return when each pursuer received the announcement of pursuer 0 at 1 s, and the result of the run."""
    heard = {}
    result = play(announcing_at(1.0, heard=heard), graph, dissemination, **changes)
    return {j: known[0][0] for j, known in heard.items() if 0 in known}, result


def test_one_hop_dissemination_reaches_only_the_neighbours():
    when, result = arrivals(nx.path_graph(5), OneHop())
    assert when == {1: 1.25}
    assert result.trace.of(MessageCounts)[0].transmissions == 1


@pytest.mark.parametrize(
    ("model", "hops"),
    [(OneHop(), 1), (ReliableOneHop(), 1), (CodedOneHop(), 1), (Flooding(hops=3), 3), (Gossip(), inf)],
)
def test_only_what_is_forwarded_travels_over_several_hops(model, hops):
    traits = DisseminationTraits.of(model)
    assert (traits.hops, traits.relays) == (hops, hops > 1)


@pytest.mark.parametrize("hops", [1, 2, 3, 5, FAR])
def test_flooding_travels_one_hop_per_latency_and_so_many_hops_at_most(hops):
    """On a path of 6 node k receives at 1 + k L; every node but the last two forwards once."""
    when, result = arrivals(nx.path_graph(6), Flooding(hops=hops, jitter=0.0))
    assert when == {k: 1.0 + k * L for k in range(1, min(hops, 5) + 1)}
    assert result.trace.of(MessageCounts)[0].transmissions == min(hops, 6)


def test_on_a_ring_flooding_travels_both_ways_and_meets():
    """Six nodes: 1 and 5 receive after L, 2 and 4 after 2 L, 3 after 3 L, twice; each transmits to 2 neighbours."""
    when, result = arrivals(nx.cycle_graph(6), Flooding(hops=FAR, jitter=0.0))
    assert when == {1: 1.25, 5: 1.25, 2: 1.5, 4: 1.5, 3: 1.75}
    tally = result.trace.of(MessageCounts)[0]
    assert (tally.transmissions, tally.sent, tally.delivered) == (6, 12, 12)
    assert Counter(seconds(sent.t) for sent in result.trace.of(Sent)) == {1.0: 2, 1.25: 4, 1.5: 4, 1.75: 2}


@st.composite
def graphs(draw):
    """A random graph, connected or not."""
    count = draw(st.integers(2, 9))
    pairs = [(i, j) for i in range(count) for j in range(i)]
    graph = nx.empty_graph(count)
    graph.add_edges_from(draw(st.lists(st.sampled_from(pairs), max_size=2 * count, unique=True)))
    return graph


@pytest.mark.whole
@settings(max_examples=60, deadline=None)
@given(graphs(), st.integers(1, 9), st.booleans())
def test_flooding_is_breadth_first_search(graph, hops, breakable):
    """Node j receives at 1 + L d(0, j) if d <= hops; those with d < hops transmit once, each to all its neighbours.

    Whether something may break does not matter (it lets messages take another way through the simulator).
    """
    faults = (Crash(node=0, start=9.9),) if breakable else ()
    when, result = arrivals(graph, Flooding(hops=hops, jitter=0.0), fault=faults)
    distance = nx.single_source_shortest_path_length(graph, 0)
    assert when == {j: 1.0 + L * d for j, d in distance.items() if 0 < d <= hops}
    speakers = [j for j, d in distance.items() if d < hops]
    tally = result.trace.of(MessageCounts)[0]
    assert tally.transmissions == len(speakers)
    assert tally.sent == tally.delivered == sum(graph.degree(j) for j in speakers)


def test_a_repeated_announcement_is_new_and_a_duplicate_of_it_is_not():
    """A complete graph of 5: each of three announcements is transmitted once by each, whatever the number of copies."""
    heard = {}
    result = play(announcing_at(1.0, 2.0, 3.0, heard=heard), nx.complete_graph(5), Flooding(jitter=0.0))
    assert result.trace.of(MessageCounts)[0].transmissions == 3 * 5
    assert heard == {0: {}} | {j: {0: (3.25, 3)} for j in range(1, 5)}


def test_a_forwarded_record_keeps_the_time_and_sequence_number_of_its_source():
    """Two hops, and a relay whose clock is wrong: it stays the record that pursuer 0 made at 1 s."""
    seen = []

    def protocol(me):
        if me.id == 0:
            yield me.at(1.0)
            me.broadcast()
        yield me.at(5.0)
        seen.extend(me._network.latest_records(me.id).values())

    play(protocol, nx.path_graph(3), Flooding(jitter=0.0), fault=(ClockSkew(node=1, offset=2.0, drift=0.5),))
    assert [(arrival, record.src, record.seq, record.stamp) for arrival, record in seen] == [
        (1_250_000_000, 0, 1, 1_000_000_000),
        (1_500_000_000, 0, 1, 1_000_000_000),
    ]


# Jitter.


def delays(jitter, count=400):
    """Return the delays beyond 2 L with which node 2 of a path receives the announcements of node 0, s."""
    given = {"horizon": count + 1.0, "record": Recording(trajectory=0.0, messages=True)}
    times = [float(k) for k in range(1, count + 1)]
    result = play(announcing_at(*times), nx.path_graph(3), Flooding(jitter=jitter), **given)
    sent = [event for event in result.trace.of(Sent) if event.src == 1 and event.dst == 2]
    return np.array([event.t / 1e9 - L - t for event, t in zip(sent, times, strict=True)])


def test_relays_wait_for_a_uniform_time_up_to_the_jitter():
    """400 delays are within [0, J] and uniform (Kolmogorov and Smirnov, p > 0.001); the control: not in [0, 1.2 J]."""
    found = delays(0.1)
    assert -1e-9 <= found.min() < found.max() <= 0.1 + 1e-9
    assert kstest(found, "uniform", (0.0, 0.1)).pvalue > 0.001
    assert kstest(found, "uniform", (0.0, 0.12)).pvalue < 0.001
    assert delays(0.0, count=20) == pytest.approx(0.0, abs=1e-9)


def test_pending_forwards_do_not_delay_incoming_messages():
    """Jitter of 2 s: node 1 forwards both announcements of 1.0 and 1.1 s, each after a delay of its own."""
    result = play(announcing_at(1.0, 1.1), nx.path_graph(3), Flooding(jitter=2.0))
    first, second = (event for event in result.trace.of(Sent) if event.src == 1 and event.dst == 2)
    assert {event.body.records[0].seq for event in (first, second)} == {1, 2}
    assert first.t < second.t < 3.4e9


@pytest.mark.timeout(10)
@pytest.mark.parametrize("drift", [-0.9, 0.5, 4.0, 900.0])
def test_relays_with_clock_errors_forward_records_all_the_same(drift):
    """The delay is up to J = 0.005 s by a clock that is 1 + drift as fast."""
    skews = tuple(ClockSkew(node=node, offset=3.0, drift=drift) for node in (1, 2, 3))
    result = play(
        announcing_at(*np.linspace(1.0, 3.0, 50).tolist()), nx.path_graph(4), Flooding(), fault=skews, horizon=5.0
    )
    sent = [event for event in result.trace.of(Sent) if (event.src, event.dst) == (2, 3)]
    said = [event.body.records[0].seq for event in sent]
    assert len(set(said)) == len(said) > 10
    assert max(said) == 50


# Flooding by a function.

CRASH = "fault=[{{kind='crash', node=3, start=0.2, end=0.4, scope='robot', memory={}}}]"


class ByProcess(Flooding):
    """Flooding by a process that waits for each arrival."""

    def __call__(self, me):
        with patch.object(Agent, "listen", lambda _, *arguments: arguments):
            ((act, port, phase, _),) = super().__call__(me)
        while True:
            yield me.arrival(port, phase)
            act(me.mail(port))


def flooded(changes, kind=Flooding):
    """Return the events of a scenario with flooding of a kind."""
    scenario = load(SCENARIOS / "flooding.toml", ["horizon=0.6", *changes])
    announce = scenario.announce
    dissemination = kind(hops=announce.dissemination.hops, jitter=announce.dissemination.jitter)
    announce = announce.model_copy(update={"dissemination": dissemination})
    return list(run(scenario.model_copy(update={"announce": announce}), 2).trace)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        [],
        ["network.latency=0.01", "announce.dissemination.jitter=0.0", "network.range_check=send"],
        ["network.latency=0.0", "announce.dissemination.hops=2"],
        [CRASH.format("false")],
        [CRASH.format("false"), "network.latency=0.03", "network.range_check=send"],
        [CRASH.format("true"), "network.loss=0.2"],
    ],
    ids=["flooding", "at once", "without latency", "without memory", "decided at sending", "with memory"],
)
def test_flooding_by_a_function_is_flooding_by_a_process(changes):
    assert flooded(changes) == flooded(changes, ByProcess)


@pytest.mark.slow
def test_the_comparison_detects_news_that_is_not_forwarded():
    """The control of the test above."""
    listen = Agent.listen

    def half(me, act, *more):
        return listen(me, lambda messages: act([message for message in messages if message.src % 2]), *more)

    def without_news(me, act, port, phase, ignores):
        return listen(me, act, port, phase, lambda message: ignores(message) or message.src == 3)

    for wrong in (half, without_news):
        with patch.object(Agent, "listen", wrong):
            assert flooded([]) != flooded([], ByProcess)


# Within an instant.


@pytest.mark.parametrize("faults", [(), (Crash(node=1, start=9.9),)], ids=["noted at sending", "settled on arrival"])
@pytest.mark.parametrize("latency", [0.0, 1e-9])
def test_flooding_without_latency_reaches_all_before_the_next_decision_of_its_instant(latency, faults):
    """All decide at 1 s, in order of ids, on a path of 8: the first chases, and all others learn of it in time.

    The control: 1 ns per hop is too late.
    """
    seen, later = {}, {}

    def protocol(me):
        yield me.at(1.0)
        seen[me.id] = me.believed_active()
        me.assign(me.id == 0)
        me.broadcast()
        yield me.at(1.000001)
        later[me.id] = me.believed_active()

    links = Links(graph=Edges.of(nx.path_graph(8)), latency=Constant(value=latency))
    play(protocol, nx.path_graph(8), Flooding(hops=7, jitter=0.0), network=links, fault=faults)
    assert [seen[j] for j in range(8)] == ([[]] + [[0]] * 7 if latency == 0.0 else [[]] * 8)
    assert [later[j] for j in range(8)] == [[]] + [[0]] * 7


@pytest.mark.whole
@settings(max_examples=40, deadline=None)
@given(graphs(), st.integers(0, 8))
def test_flooding_without_latency_reaches_all_connected_pursuers(graph, speaker):
    speaker %= len(graph)
    heard = {}
    links = Links(graph=Edges.of(graph))
    play(announcing_at(1.0, by=speaker, heard=heard), graph, Flooding(hops=FAR, jitter=0.0), network=links)
    others = nx.node_connected_component(graph, speaker) - {speaker}
    assert {j: known[speaker] for j, known in heard.items() if speaker in known} == dict.fromkeys(others, (1.0, 1))


# Gossip.


def test_gossip_carries_records_one_hop_farther_with_every_announcement():
    """On a path pursuer k announces all its records at k + 1 s.

    So node j learns of all k < j at j + L, of j + 1 at j + 2 + L, and of those farther on never.
    """
    heard = {}

    def protocol(me):
        yield me.at(me.id + 1.0)
        me.broadcast()
        yield me.at(9.5)
        heard[me.id] = {j: seconds(arrival) for j, (arrival, _) in me._network.latest_records(me.id).items()}

    result = play(protocol, nx.path_graph(5), Gossip())
    for j, known in heard.items():
        right = {j + 1: j + 2 + L} if j < 4 else {}
        assert known == dict.fromkeys(range(j), j + L) | right
    assert result.trace.of(MessageCounts)[0].transmissions == 5


def test_gossip_merges_by_the_newest():
    """0 announces a chase at 1 s and its end at 2 s; to 2 that takes 5 s, by 1, which announces at 3 s, 2 x 0.25 s."""
    graph, seen = nx.complete_graph(3), {}
    graph.edges[0, 2]["latency"] = 5.0

    def protocol(me):
        for t in (1.0, 2.0) if me.id == 0 else (3.0,) if me.id == 1 else ():
            yield me.at(t)
            me.assign(t == 1.0 and me.id == 0)
            me.broadcast()
        for t in (3.2, 3.3, 6.5, 7.5) if me.id == 2 else ():
            yield me.at(t)
            seen[t] = [
                (seconds(arrival), record.seq, record.body.active)
                for arrival, record in me._network.latest_records(me.id).values()
            ]

    play(protocol, graph, Gossip(), network=Links(graph=Edges.of(graph), latency=Constant(value=L)))
    assert seen[3.2] == []
    assert sorted(seen[3.3]) == sorted(seen[6.5]) == sorted(seen[7.5]) == [(3.25, 1, False), (3.25, 2, False)]


def test_gossip_does_not_send_receivers_records_about_themselves():
    """Its own record comes back and is not stored; 16 + 8 bytes for the hops and 24 for each record."""
    heard = {}

    def protocol(me):
        for t in (1.0, 2.0, 3.0):
            yield me.at(t)
            me.broadcast()
        yield me.at(9.5)
        heard[me.id] = set(me._network.latest_records(me.id))

    result = play(protocol, nx.complete_graph(3), Gossip())
    assert heard == {j: {0, 1, 2} - {j} for j in range(3)}
    assert [event.size for event in result.trace.of(Sent) if event.src == 0] == [48, 48, 96, 96, 96, 96]


# Loss.


@pytest.mark.slow
def test_flooding_under_loss_uses_every_path():
    """0 - 3 over 1 or over 2, half of all messages lost: 1 - (1 - 1/4)^2 = 7/16; the control, one path: 1/4.

    2,000 announcements, standard error 0.011.
    """
    count = 2000
    times = np.arange(1, count + 1) / 10
    for edges, expected in (([(0, 1), (0, 2), (1, 3), (2, 3)], 7 / 16), ([(0, 1), (1, 3)], 1 / 4)):
        reached = []

        def protocol(me, reached=reached):
            for t in times:
                yield me.at(float(t))
                if me.id == 0:
                    me.broadcast()
                if me.id == 3 and 0 in me._network.latest_records(me.id):
                    reached.append(me._network.latest_records(me.id)[0][1].seq)

        graph = nx.empty_graph(4)
        graph.add_edges_from(edges)
        links = Links(graph=Edges.of(graph), latency=Constant(value=0.01), loss=Bernoulli(p=0.5))
        still = {"network": links, "horizon": count / 10 + 1.0, "record": Recording(trajectory=0.0)}
        play(protocol, graph, Flooding(jitter=0.001), **still)
        share = len(set(reached)) / count
        error = np.sqrt(expected * (1 - expected) / count)
        assert abs(share - expected) < 4 * error
        assert abs(share - (11 / 16 - expected)) > 4 * error


# Records that arrive by a detour first.


def transmissions(edges, hops):
    """Return the receivers of 0's announcement at 1 s, and each one's transmissions, over (i, j, latency in s)."""
    graph = nx.Graph()
    graph.add_nodes_from(range(1 + max(max(edge[:2]) for edge in edges)))
    for i, j, latency in edges:
        graph.add_edge(i, j, latency=latency)
    when, result = arrivals(graph, Flooding(hops=hops, jitter=0.0), network=Links(graph=Edges.of(graph)))
    said = {(sent.src, sent.transmission) for sent in result.trace.of(Sent)}
    return when, Counter(src for src, _ in said)


@pytest.mark.parametrize(
    ("path", "hops", "when", "said"),
    [
        ([(2, 3, 0.25)], 2, {1: 1.25, 2: 1.5, 3: 3.25}, {0: 1, 1: 1, 2: 1}),
        ([(2, 3, 0.25), (3, 4, 0.25)], 3, {1: 1.25, 2: 1.5, 3: 1.75, 4: 3.5}, {0: 1, 1: 1, 2: 2, 3: 1}),
    ],
)
def test_a_duplicate_is_forwarded_only_with_more_hops_left(path, hops, when, said):
    """0 - 1 - 2 takes 0.5 s, 0 - 2 takes 2 s; with 2 hops 2 receives by 1 with none left, then from 0 with one, and 3.

    With 3 hops 2 forwards the copy by 1, with one hop left, and again that from 0: so 4 receives it. What the
    others receive twice may not travel farther than before.
    """
    assert transmissions([(0, 1, 0.25), (1, 2, 0.25), (0, 2, 2.0), *path], hops) == (when, said)


@pytest.mark.parametrize(
    "edges",
    [
        [(0, 1, 0.25), (0, 2, 0.25), (1, 3, 0.25), (2, 3, 1.0), (3, 4, 0.25)],
        [(0, 3, 0.25), (0, 1, 1.0), (1, 2, 1.0), (2, 3, 1.0), (3, 4, 0.25)],
    ],
    ids=["equal", "fewer"],
)
@pytest.mark.parametrize("hops", [3, 4, FAR])
def test_a_duplicate_with_as_many_or_fewer_hops_left_is_not_forwarded(edges, hops):
    when, said = transmissions(edges, hops)
    assert sorted(when) == [1, 2, 3, 4]
    assert set(said.values()) == {1}


# Retransmitted and coded.


class First:
    """A loss model that loses the first transmissions of pursuer 0 to each other pursuer."""

    def __init__(self, count):
        self.count, self.sent = count, Counter()

    def __call__(self, context, rng):
        links = [(context.src, node) for node in context.dst.tolist()]
        self.sent.update(links)
        return np.array([context.src == 0 and self.sent[link] <= self.count for link in links])


def lossy(graph, count):
    return Links(graph=Edges.of(graph), latency=Constant(value=L), loss=First(count))


def test_a_lost_announcement_is_repeated_to_each_neighbour_until_it_is_acknowledged():
    """Three neighbours lose two transmissions each, of which one is the broadcast: repetitions at 1.6 and 2.2 s."""
    graph = nx.star_graph(3)
    model = ReliableOneHop(timeout=0.6, backoff=1.0)
    when, result = arrivals(graph, model, network=lossy(graph, 2))
    assert when == pytest.approx(dict.fromkeys((1, 2, 3), 1.0 + 2 * 0.6 + L))
    assert summary(result).retransmissions == 6
    assert arrivals(graph, OneHop(), network=lossy(graph, 2))[0] == {}
    assert arrivals(graph, CodedOneHop(pieces=3), network=lossy(graph, 2))[0] == dict.fromkeys((1, 2, 3), 1.0 + L)


def test_a_newer_announcement_replaces_one_that_is_not_acknowledged():
    heard, graph = {}, nx.star_graph(1)
    announcing = announcing_at(1.0, 1.5, heard=heard)
    result = play(announcing, graph, ReliableOneHop(timeout=0.6, backoff=1.0), network=lossy(graph, 2))
    assert heard[1] == {0: (1.5 + 0.6 + L, 2)}
    assert [(each.t / 1e9, each.seq, each.cause) for each in result.trace.of(GivenUp)] == [(1.5, 1, "superseded")]


def test_an_announcement_counts_for_ages_when_it_is_delivered():
    """Sent at 1 s, it arrives at 1.85 s: the mean age from then to 10 s is that of a ramp from 0.85 to 9 s."""
    graph = nx.star_graph(1)
    _, result = arrivals(graph, ReliableOneHop(timeout=0.6), network=lossy(graph, 1))
    assert age_mean(result) == pytest.approx((0.85 + 9.0) / 2)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("attempts", [1, 4])
def test_the_age_of_heartbeats_is_that_of_a_renewal_process(attempts):
    """Period T, latency l, n attempts at distances R within a period, each lost with p; P = p^n:

    the mean age is l + R (mean number of failures before a success within n) + T (1 + P) / (2 (1 - P)): .16 s for
    n = 1, .0887 s for n = 4. The standard error is that of 8 runs, about 2.5 %; each is the control of the other.
    """
    period, latency, gap, p = 0.1, 0.01, 0.03, 0.5
    lost = p**attempts
    failures = sum(k * p**k * (1 - p) for k in range(attempts)) / (1 - lost)
    theory = latency + gap * failures + period * (1 + lost) / (2 * (1 - lost))
    assert theory == pytest.approx({1: 0.16, 4: 0.0887}[attempts], abs=1e-4)
    model = ReliableOneHop(timeout=gap, backoff=1.0) if attempts > 1 else OneHop()
    scenario = Scenario(
        horizon=6.0,
        team=Team(count=4, speeds=1.0),
        motion=Motion(static=True),
        protocol=lambda me: iter(()),
        network=Links(latency=Constant(value=latency), loss=Bernoulli(p=p)),
        announce=Announcements(trigger="heartbeat", heartbeat=period, dissemination=model),
        record=Recording(trajectory=0.0, messages=True),
    )
    found = np.array([age_mean(run(scenario, seed)) for seed in range(8)])
    error = found.std(ddof=1) / np.sqrt(len(found))
    assert abs(found.mean() - theory) < 3 * error, (found.mean(), error)
    assert abs(found.mean() - {1: 0.0887, 4: 0.16}[attempts]) > 3 * error


@pytest.mark.slow_cases("flooding-coded")
@pytest.mark.parametrize(
    "transport", [Reliable(timeout=0.5), Reliable(ordered=False), Coded(pieces=2)], ids=lambda each: each.kind
)
@pytest.mark.parametrize("dissemination", [Flooding(jitter=0.0), Gossip()], ids=lambda each: each.kind)
def test_messages_of_a_dissemination_are_carried_by_the_transport_of_the_network(dissemination, transport):
    """On a path of 4 the record of pursuer 0 reaches the others as without a transport."""
    graph = nx.path_graph(4)
    links = Links(graph=Edges.of(graph), latency=Constant(value=L), transport=transport)
    when, result = arrivals(graph, dissemination, network=links)
    assert when == arrivals(graph, dissemination)[0]
    assert summary(result).share_delivered == 1.0
