"""Mutual exclusion among neighbours: what they know of each other, what it costs, and that it never stops."""

from collections import Counter
from functools import partial
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import settings

from desim import Scenario, run
from desim.kernel.core.message_size import size_of
from desim.kernel.models.access import Tdma
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.fault_plans import RandomFaults
from desim.kernel.models.faults import Crash, Partition
from desim.kernel.models.graphs import Complete, Grid, Star
from desim.kernel.models.latency import Constant, Lognormal
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.medium import Bitrate
from desim.pursuit.core.events import Decided
from desim.scenario.players import Team
from protocols.schedules.mutex import CriticalSection, Deferred, LocalMutex, Reply, Request, request_and_reply
from protocols.schedules.periodic import Poisson
from tests.protocols.traffic import SECOND, Storm, bodies, flips, standing

frozen = partial(standing, count=7)
EXPLORING = not settings.default.derandomize
"""More plans, with --hypothesis-profile=explore."""


LATENCIES = pytest.mark.parametrize(
    "latency", [0.0, 0.05, 1.0, Lognormal(mean=0.05, cv=2.0)], ids=["0 s", "0.05 s", "1 s", "heavy tails"]
)


@pytest.mark.slow
@LATENCIES
@pytest.mark.parametrize("graph", [Complete(), Grid(columns=3), Star()])
def test_neighbours_never_decide_with_stale_mutual_information(graph, latency):
    """Each decision uses the last one of every neighbour, with any latency and reordering."""
    log = []
    horizon = 60.0 if latency == 1.0 else 10.0
    run(frozen(flips(LocalMutex(), log, graph(7)), latency=latency, graph=graph, horizon=horizon), 1)
    assert len(log) > 50
    assert all(believed == true for believed, true in log)


@pytest.mark.slow
@LATENCIES
@pytest.mark.parametrize("skew", [(), (ClockSkew(offset=3.0),)], ids=["clocks agree", "skewed clocks"])
def test_no_two_neighbours_are_inside_at_once(latency, skew):
    """With a section that takes a while: between entering and leaving of one no neighbour of it enters."""
    graph, inside, entered = Grid(columns=3)(7), set(), []

    def protocol(me):
        section = CriticalSection(me, 10, 0.001)
        for _ in range(5):
            yield from section.idle(me.now + me.rng.exponential(0.05))
            yield from section.enter()
            assert not inside & set(graph[me.id])
            inside.add(me.id)
            entered.append((me.id, frozenset(inside)))
            yield from section.idle(me.now + me.rng.exponential(0.05))
            inside.remove(me.id)
            section.leave()
        yield from section.idle(1e6)

    run(frozen(protocol, latency=latency, graph=Grid(columns=3), horizon=200.0, faults=skew), 3)
    assert Counter(i for i, _ in entered) == dict.fromkeys(range(7), 5)
    assert any(len(others) > 1 for _, others in entered)  # those who are no neighbours do not wait for each other


def test_poisson_clocks_do_not_exclude():
    """The control: announced decisions at the ticks of Poisson clocks are often stale at a latency of half a second."""
    log = []
    run(frozen(flips(Poisson(rate=5.0), log, Complete()(7)), latency=0.5, trigger="both"), 1)
    assert np.mean([believed != true for believed, true in log]) > 0.3


@pytest.mark.slow
@pytest.mark.parametrize("graph", [Complete(), Grid(columns=3), Star()])
def test_a_decision_takes_two_messages_per_neighbour(graph):
    result = run(frozen(flips(LocalMutex()), graph=graph), 0)
    links = graph(7)
    expected = sum(links.degree[d.pursuer] for d in result.trace.of(Decided))
    assert len(bodies(result, Request)) == len(bodies(result, Reply)) == expected
    assert not bodies(result, Deferred)


def test_of_simultaneous_requests_the_lower_id_has_priority():
    entered = []

    def protocol(me):
        section = CriticalSection(me, 10, 0.001)
        yield from section.enter()
        entered.append(me.id)
        section.leave()
        yield from section.idle(1e6)

    run(frozen(protocol, latency=0.1, horizon=5.0), 0)
    assert entered == list(range(7))


@pytest.mark.slow
def test_a_request_is_answered_once_though_its_answer_had_to_wait():
    result = run(frozen(flips(LocalMutex()), latency=0.1), 0)
    asked = Counter((each.src, each.dst, each.body.stamp) for each in bodies(result, Request))
    answered = Counter((each.dst, each.src, each.body.stamp) for each in bodies(result, Reply))
    assert bodies(result, Deferred)
    assert answered
    assert not answered - asked


@pytest.mark.slow
@pytest.mark.parametrize("latency", [0.1, 1.0])
def test_a_decision_takes_a_round_trip(latency):
    """Two latencies after its first request is sent, at the earliest; and one alone needs just that."""
    result = run(frozen(flips(LocalMutex()), latency=latency, horizon=30.0), 0)
    first = {}
    for sent in bodies(result, Request):
        first.setdefault(sent.body.stamp, sent.t)
    waits = []
    for pursuer in range(7):
        asked = [t for (_, i), t in first.items() if i == pursuer]
        decided = [d.t for d in result.trace.of(Decided) if d.pursuer == pursuer]
        waits += [d - t for d, t in zip(decided, asked, strict=False)]
    assert min(waits) == round(2 * latency * SECOND)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("latency", [0.0, 0.02, 1.0])
def test_the_mean_slot_is_the_time_between_two_decisions_of_the_team(latency):
    """Up to what contention adds: less than a third, from idle to saturated sections."""
    slots, play = set(), flips(LocalMutex())

    def protocol(me):
        slots.add(LocalMutex().mean_slot(me))
        return play(me)

    horizon = 100.0 if latency == 1.0 else 30.0
    result = run(frozen(protocol, latency=latency, horizon=horizon), 0)
    found = horizon / len(result.trace.of(Decided))
    (slot,) = slots
    assert 0.8 * slot < found < 1.33 * slot


def test_the_mean_slot_counts_the_airtime_of_requests_and_replies():
    """Among 5 each asks 4, in 16 + 16 bytes, and is answered in 16 + 16 + 24, so 352 bytes; no longer than 5 L."""
    slots = set()

    def protocol(me):
        slots.add(LocalMutex(rate=5.0).mean_slot(me))
        assert max(map(size_of, request_and_reply(me))) == LocalMutex().message_size(5, 24) == 16 + 16 + 24
        yield me.sleep(0.0)

    slow = Links(latency=Constant(value=0.02), medium=Bitrate(bitrate=9600.0))
    run(Scenario(horizon=0.1, team=Team(count=5), protocol=protocol, network=slow), 0)
    (slot,) = slots
    assert slot == pytest.approx((1.0 / 5.0 + 2.0 * 0.02 + 352 * 8 / 9600) / 5)


def test_a_neighbourhood_makes_at_most_one_decision_per_latency():
    """With a latency of 1 s, five among whom each has four neighbours take 5 s for a decision of each, not .2 + 2 s."""
    me = SimpleNamespace(
        id=0, team_size=5, mean_degree=4, latency=1.0, airtime=lambda _: 0.0, announcement=lambda: None
    )
    assert LocalMutex(rate=5.0).mean_slot(me) == 1.0


def test_no_request_is_repeated_while_messages_wait_for_the_slots_of_a_tdma():
    """A round takes 0.3 s, and two requests with two replies 0.15 s on the air."""
    medium = Bitrate(bitrate=9600.0, access=Tdma(slot=0.1))
    result = run(frozen(flips(LocalMutex(rate=0.2)), count=3, horizon=20.0, medium=medium), 1)
    requests = [(each.src, each.dst, each.body) for each in bodies(result, Request)]
    assert len(requests) == len(set(requests)) > 3


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("graph", [Complete(), Grid(columns=3)])
def test_with_a_third_of_messages_lost_all_keep_deciding_and_few_decide_on_stale_beliefs(graph):
    """A neighbour is left out wrongly if none of 10 requests is answered: .51^10 = 1 of 840; 3 runs of 10 s.

    All decide again and again: no pause exceeds 10 rounds of retransmission.
    """
    log = []
    for seed in range(3):
        result = run(frozen(flips(LocalMutex(), log, graph(7)), latency=0.02, loss=Bernoulli(p=0.3), graph=graph), seed)
        for pursuer in range(7):
            times = [0, *(d.t for d in result.trace.of(Decided) if d.pursuer == pursuer), 10 * SECOND]
            assert max(b - a for a, b in pairwise(times)) < 4 * SECOND
    assert np.mean([believed != true for believed, true in log]) < 0.03


@pytest.mark.slow
def test_a_neighbour_that_broke_down_is_waited_for_once_and_excludes_again_when_it_is_back():
    """Ten requests in vain take 10 x 2.5 L = 1.25 s; after that no pursuer waits for it."""
    log = []
    fault = Crash(start=2.0, end=8.0, node=3, scope="radio")
    graph = Complete()(4)
    protocol = flips(LocalMutex(), log, graph)
    result = run(frozen(protocol, count=4, latency=0.05, horizon=20.0, faults=(fault,)), 0)

    def pauses(since, until):
        times = [d.t / SECOND for d in result.trace.of(Decided) if d.pursuer != 3 and since < d.t / SECOND < until]
        return np.diff(times)

    assert pauses(2.0, 4.5).max() > 1.0
    assert pauses(4.5, 8.0).max() < 1.0
    late = log[-len([d for d in result.trace.of(Decided) if d.t > 11 * SECOND]) :]
    assert len(late) > 50
    assert all(believed == true for believed, true in late)


@pytest.mark.parametrize("attempts", [1, 4])
def test_a_neighbour_that_does_not_answer_gets_the_documented_number_of_requests(attempts):
    """Once it is known to be silent, each later request is made once."""
    fault = Crash(start=2.0, node=3, scope="radio")
    schedule = LocalMutex(attempts=attempts)
    result = run(frozen(flips(schedule), count=4, latency=0.02, faults=(fault,)), 0)
    for src in range(3):
        asked = Counter(sent.body.stamp for sent in bodies(result, Request) if (sent.src, sent.dst) == (src, 3))
        late = [number for stamp, number in asked.items() if stamp[0] > 2 * SECOND]
        assert (late[0], set(late[1:])) == (attempts, {1})


def test_a_request_is_repeated_after_the_documented_time_outs():
    """A request of 32 bytes and its reply of 56 take 11/150 s at 9600 bit/s: 5/4 of (0.04 s + 11/150 s 1.5^k).

    The first request may have waited for the transmitter, so the pauses before the third and the fourth are compared.
    """
    fault = Crash(start=2.0, node=1, scope="radio")
    links = {"latency": 0.02, "medium": Bitrate(bitrate=9600.0)}
    result = run(frozen(flips(LocalMutex(attempts=4)), count=2, faults=(fault,), **links), 0)
    asked = [sent for sent in bodies(result, Request) if sent.src == 0]
    (stamp, number), *_ = Counter(sent.body.stamp for sent in asked).most_common(1)
    assert number == 4
    pauses = np.diff([sent.t / SECOND for sent in asked if sent.body.stamp == stamp])
    assert pauses[1:] == pytest.approx([1.25 * (0.04 + 11.0 / 150.0 * 1.5**k) for k in (1, 2)])


@pytest.mark.slow
def test_after_a_partition_all_exclude_each_other_again():
    log = []
    fault = Partition(start=1.0, end=5.0, groups=((0, 2, 5),))
    result = run(frozen(flips(LocalMutex(), log, Complete()(7)), latency=0.03, horizon=15.0, faults=(fault,)), 0)
    apart, again = ([d for d in result.trace.of(Decided) if a < d.t / SECOND < b] for a, b in ((3.0, 5.0), (7.0, 15.0)))
    assert {d.pursuer for d in apart} == {d.pursuer for d in again} == set(range(7))
    assert all(believed == true for believed, true in log[-len(again) :])
    assert any(believed != true for believed, true in log[: -len(again)])  # the control: across the cut


@pytest.mark.whole
def test_no_storm_ends_in_a_deadlock():
    """30 plans of crashes, partitions, jamming and losses until 3 s: every pursuer decides from then on, with current
    information.

    What goes wrong in one plan of 10 is seen with 1 - (9 / 10)^30 = 0.958; 300 plans to explore.

    A neighbour is given up in 10 x 2.5 L, and at most once more for each; all is well again after another second.
    """
    stuck, mistaken = {}, {}
    for seed in range(300 if EXPLORING else 30):
        rng = np.random.default_rng([seed, 6])
        count, graph = int(rng.integers(2, 8)), (Complete(), Grid(columns=3), Star())[rng.integers(3)]
        latency = (Lognormal(mean=0.02, cv=1.0), Constant(value=0.02), Constant())[rng.integers(3)]
        plan = RandomFaults(rate=float(rng.uniform(0.5, 4.0)), mean_duration=0.7, end=3.0)
        log = []
        story = {
            "latency": latency,
            "graph": graph,
            "faults": (plan,),
            "loss": Storm(float(rng.uniform(0.0, 0.4)), 3.0),
        }
        result = run(frozen(flips(LocalMutex(), log, graph(count)), count=count, horizon=7.0, **story), seed)
        late = [d for d in result.trace.of(Decided) if d.t > 5 * SECOND]
        stuck[seed] = set(range(count)) - {d.pursuer for d in late}
        mistaken[seed] = sum(believed != true for believed, true in log[len(log) - len(late) :])
    assert {seed: who for seed, who in stuck.items() if who} == {}
    assert {seed: number for seed, number in mistaken.items() if number} == {}
