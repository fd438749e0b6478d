"""The central server: its round trip, orders that are lost or overtaken, and what happens without it."""

from functools import partial
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from desim import MessageFault, Scenario, run
from desim.kernel.core.events import ClockCorrected, Sent
from desim.kernel.core.seeds import stream
from desim.kernel.models.access import Tdma
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.faults import Crash, Jamming, Partition
from desim.kernel.models.graphs import Ring, Star
from desim.kernel.models.latency import Constant, Lognormal, Uniform
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.medium import Bitrate
from desim.kernel.state.inbox import Message
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Started
from desim.pursuit.game.game import greedy_assignment, optimal_assignment, relay_profile
from desim.pursuit.motion.capture import capture_time
from desim.pursuit.team.announcements import Announcements
from desim.pursuit.team.beliefs import Belief
from desim.scenario.assumptions import violations
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion, Recording
from protocols.centralised import Centralised
from protocols.server import Server, TeamOrder, most_chasers, new_orders, time_not_chasing
from tests.many import LOSSY, at_rest, by_evader, chased, times
from tests.omniscient import RoundTrip

SECOND = 1_000_000_000


def changes(result):
    """Return [(t, pursuer, active)] of all changes of an action, those of one instant by id."""
    active, found = list(result.trace.of(Started)[0].active), []
    for event in result.trace:
        if not isinstance(event, Decided | BrokeDown):
            continue
        now = isinstance(event, Decided) and event.active
        if active[event.pursuer] != now:
            active[event.pursuer] = now
            found.append((event.t, event.pursuer, now))
    return sorted(found)


def profile(result):
    """Return the final profile."""
    active = list(result.trace.of(Started)[0].active)
    for _, pursuer, now in changes(result):
        active[pursuer] = now
    return tuple(active)


def static(protocol, *, count=6, latency=0.0, loss=0.0, horizon=5.0, seed=0, **given):
    """Return a game that stands still, pursuer j at 1 + j m (speed 1) of an evader that stands still."""
    model = Constant(value=latency) if isinstance(latency, float) else latency
    settings = {
        "seed": seed,
        "horizon": horizon,
        "team": Team(positions=[(1.1 + j, 0.0) for j in range(count)], speeds=1.0),
        "evader": Evader(position=(0.0, 0.0), speed=0.0),
        "motion": Motion(static=True),
        "protocol": protocol,
        "network": Links(latency=model, loss=Bernoulli(p=loss)),
        "record": Recording(trajectory=0.0, messages=True),
    }
    return Scenario(**(settings | given))


def stress(protocol, latency=0.0, **given):
    """Return a relay that depends on orders: 20 equal pursuers, none active at first."""
    settings = {
        "horizon": 60.0,
        "team": Team(speeds=1.0, active_at_start=0.0),
        "protocol": protocol,
        "network": Links(latency=Constant(value=latency)),
        "record": Recording(trajectory=0.0),
    }
    return Scenario(**(settings | given))


def late(event):
    """Return whether it happened after 4 s: enough has been seen."""
    return event.t > 4 * SECOND


@pytest.mark.whole
@pytest.mark.parametrize(
    ("world", "latency"),
    [
        ({"announce": Announcements(payload="state")}, 0.0),
        ({"announce": Announcements(payload="state")}, 0.6),
        ({"team": Team(active_at_start=0.5)}, 0.13),
        ({"evader": Evader(count=3)}, 0.13),
    ],
)
def test_it_equals_an_omniscient_centre_whose_orders_are_one_latency_late(world, latency):
    """The same pursuers do the same at the same nanoseconds, whichever pursuer is the host: each is dead reckoned
    exactly.

    A report arrives `latency` after it was made, and by then the server knows as much as the centre. Without latency
    the centre is the centralised benchmark, at the instants of the reports.
    """
    centre = RoundTrip(host=7, up=latency, down=latency)
    case = stress(Server(host=7), latency, **world)
    results = (run(case.model_copy(update={"protocol": each}), 0, late) for each in (case.protocol, centre))
    server, ideal = ([change for change in changes(each) if change[0] < 4 * SECOND] for each in results)
    assert server == ideal != []


@pytest.mark.whole
def test_the_centre_that_it_is_compared_with_is_the_centralised_benchmark_if_nothing_is_late():
    """At rest and in motion: all that `RoundTrip` has of its own are the instants and the delay."""
    for seed in range(2):
        ideal, centre = (run(stress(each), seed) for each in (Centralised(slot=0.005), RoundTrip()))
        assert [(j, now) for _, j, now in changes(centre)] == [(j, now) for _, j, now in changes(ideal)]


@pytest.mark.slow_but_one
@pytest.mark.parametrize("latency", [0.03, 0.1, 0.13, 0.37])
@pytest.mark.parametrize("host", [0, 3])
def test_the_first_order_takes_a_round_trip(host, latency):
    """States of t = 0 arrive at L, the order at 2 L; the host obeys it at L already. None moves before."""
    result = run(static(Server(host=host), latency=latency))
    there, back = (round(k * latency * SECOND) for k in (1, 2))
    assert changes(result) == sorted((there if j == host else back, j, False) for j in range(1, 6))
    assert profile(result) == (True, *[False] * 5)


def phase(pursuer, seed=0, period=0.1):
    """Return when a pursuer reports, or the server repeats its order, after the first time, s."""
    return stream(seed, "reports", pursuer).uniform(0.0, period)


@pytest.mark.parametrize(("latency", "period"), [(0.13, 0.1), (0.02, 0.1), (0.25, 0.1), (0.0, 0.3), (0.04, 0.3)])
def test_an_order_takes_effect_a_latency_after_the_report_at_which_the_server_finds_it_right(latency, period):
    """A at (0, 0) is sent by 2 L, the evader runs from (2, 0) at 0.9 m/s towards B at (8, 0); the host is too slow.

    From 2 L on A is at distance 2 + 0.9 (2 L) - 0.1 (t - 2 L), phi_A is 10 times that less eps, and phi_B 10 times
    6 - 0.9 t less eps. B would lose L before its order arrives: equal at 10 (2 + 2 L - 0.1 t) = 10 (6 - 0.9 t) + L.
    The first report of A or B that arrives after that makes the order, and both obey it L later.
    """
    scenario = static(
        Server(host=2, period=period),
        latency=latency,
        horizon=100.0,
        team=Team(positions=[(0.0, 0.0), (8.0, 0.0), (50.0, 0.0)], speeds=[1.0, 1.0, 0.5], active_at_start=0.0),
        evader=Evader(position=(2.0, 0.0), speed=0.9, strategy=lambda state, rng: 1.0),
        motion=Motion(),
    )
    crossing = (40.0 - 19.0 * latency) / 8.0
    phases = [phase(j, period=period) for j in (0, 1)]
    tick = min(each + np.ceil((crossing - latency - each) / period) * period for each in phases)
    first, switch = (t * SECOND for t in (2 * latency, tick + 2 * latency))
    expected = [(first, 0, True), (switch, 0, False), (switch, 1, True)]
    assert changes(run(scenario)) == [(pytest.approx(t, abs=2.0), j, active) for t, j, active in expected]


def obeyed(result):
    """Return what each pursuer but the host was to do, by the newest order that had arrived: [(t, pursuer, active)]."""
    arrived = sorted((sent.arrival, sent.dst, sent.body) for sent in orders(result))
    newest, active, found = {}, list(result.trace.of(Started)[0].active), []
    for t, pursuer, order in arrived:
        if order.number >= newest.get(pursuer, -1):
            newest[pursuer] = order.number
            if active[pursuer] != (order.chasers == (pursuer,)):
                active[pursuer] = order.chasers == (pursuer,)
                found.append((t, pursuer, active[pursuer]))
    return found


def orders(result):
    return [sent for sent in result.trace.of(Sent) if isinstance(sent.body, TeamOrder)]


def overtaken(result):
    """Return how many orders arrived after a newer one."""
    newest, count = {}, 0
    for sent in sorted(orders(result), key=lambda sent: (sent.arrival, sent.dst)):
        count += sent.body.number < newest.get(sent.dst, -1)
        newest[sent.dst] = max(newest.get(sent.dst, -1), sent.body.number)
    return count


@pytest.mark.slow
def test_an_order_that_was_overtaken_is_not_obeyed():
    """Latencies of 0 to 0.6 s, a period of 0.1 s: many orders overtake others, and only the newest counts, at once."""
    late = switched = 0
    for seed in range(3):
        scenario = Scenario(
            team=Team(count=8),
            protocol=Server(host=1),
            network=Links(latency=Uniform(low=0.0, high=0.6)),
            record=Recording(messages=True),
        )
        result = run(scenario, seed)
        found = [change for change in changes(result) if change[1] != 1]
        end = max(t for t, _, _ in found)
        assert found == sorted(change for change in obeyed(result) if change[0] <= end)
        late += overtaken(result)
        switched += len(found)
    assert late > 20
    assert switched > 20


@pytest.mark.slow
@pytest.mark.parametrize("p", [0.5, 1.0])
def test_lost_reports_and_orders_are_repeated(p):
    """With half of all lost the game ends in the relay profile; with all lost every pursuer keeps its first action.

    But for the host: 3 periods and a round trip without a report, and it decides alone, for itself.
    """
    for seed in range(3):
        announce = Announcements(belief_timeout=np.inf)
        result = run(static(Server(host=2), latency=0.05, loss=p, seed=seed, announce=announce), seed)
        if p < 1.0:
            assert profile(result) == (True, *[False] * 5)
        else:
            assert changes(result) == []
            assert profile(result) == (True,) * 6
            assert result.trace.of(Decided) == []


def test_a_period_costs_one_report_and_one_order_per_pursuer():
    """6 pursuers, 5 s, period 0.1 s: 5 reports of 72 bytes at once and 50 times again, and 5 orders of 32.

    The first order is sent as the first reports arrive, and repeated 50 times, or 49 if that is before the second time.
    """
    result = run(static(Server(), latency=0.05))
    told = orders(result)
    reports = [sent for sent in result.trace.of(Sent) if not isinstance(sent.body, TeamOrder)]
    assert (len(reports), {sent.size for sent in reports}) == (5 * 51, {72})
    assert (len(told), {sent.size for sent in told}) == (5 * (51 if phase(0) > 0.05 else 50), {32})
    assert len(result.trace.of(Sent)) == len(reports) + len(told)
    assert len({sent.body.number for sent in told}) == 1  # the same order again and again


@pytest.mark.parametrize("period", [0.1, 0.5])
def test_a_pursuer_whose_reports_stop_is_excluded(period):
    """Pursuer 0 falls silent at 1.25 s; it counts for 3 periods and a round trip after its last report has come.

    The first report of another that comes later makes the order to pursuer 1, which obeys it 0.05 s later.
    """
    scenario = static(Server(host=5, period=period), latency=0.05, fault=(Crash(node=0, start=1.25),))
    ((t, pursuer, active),) = [change for change in changes(run(scenario)) if change[0] > 1.25 * SECOND]
    last, *_ = (
        phase(0, period=period) + k * period for k in range(99, -1, -1) if phase(0, period=period) + k * period < 1.25
    )
    late = last + 0.05 + 3 * period + 0.1
    come = [phase(j, period=period) + k * period + 0.05 for j in range(1, 5) for k in range(99)]
    assert (t / 1e9, pursuer, active) == (pytest.approx(min(each for each in come if each > late) + 0.05), 1, True)


def test_without_the_host_no_orders_are_sent_until_it_is_repaired():
    """The host breaks down at 1 s; pursuer 0, which chases, at 2 s: none takes over until the host is back at 4 s.

    Without its memory it waits for reports: one comes soon after 4.02 s, and then one better after another, within
    a period and two latencies that of pursuer 1.
    """
    faults = (Crash(node=5, start=1.0, end=4.02, memory=False), Crash(node=0, start=2.0))
    scenario = static(Server(host=5), latency=0.05, fault=faults, horizon=6.0)
    result = run(scenario)
    after = [change for change in changes(result) if change[0] > SECOND]
    assert [change[1:] for change in after if change[0] < 4 * SECOND] == [(0, False)]
    assert after[1][0] > 4.07 * SECOND
    assert after[-1][0] < 4.23 * SECOND
    assert profile(result) == (False, True, *[False] * 4)
    numbers = [sent.body.number for sent in orders(result)]
    later = [sent.body.number for sent in orders(result) if sent.t > 4 * SECOND]
    assert min(later) > max(set(numbers) - set(later))  # although it has forgotten the old ones


@pytest.mark.slow
def test_a_repaired_pursuer_obeys_the_order_as_it_is_repeated():
    """Pursuer 0 is down from 1 to 1.18 s, for less than it is remembered."""
    result = run(static(Server(host=5), latency=0.05, fault=(Crash(node=0, start=1.0, end=1.18),)))
    arrivals = [sent.arrival for sent in orders(result) if sent.dst == 0 and sent.arrival > 1.18 * SECOND]
    after = [change for change in changes(result) if change[0] >= SECOND]
    assert after == [(SECOND, 0, False), (min(arrivals), 0, True)]


def alone(count, **given):
    """Return when a host without reports sends itself, if none is active at first, s."""
    team = Team(positions=[(1.1 + j, 0.0) for j in range(count)], speeds=1.0, active_at_start=0.0)
    (change,) = changes(run(static(Server(), team=team, latency=0.12, **given)))
    assert change[1:] == (0, True)
    return change[0] / 1e9


def test_a_host_waits_for_first_reports_only_if_there_are_other_pursuers():
    assert alone(1) == 0.0
    assert alone(3, loss=1.0) == pytest.approx(0.5 + phase(0))  # the first tick after 0.54 s


def test_a_round_trip_is_longer_by_the_time_that_a_report_takes_to_be_sent_and_to_be_answered():
    """72 bytes at 11520 bit/s take 0.05 s: the first tick after 0.3 + 2 (0.12 + 0.05) = 0.64 s."""
    slow = Links(latency=Constant(value=0.12), loss=Bernoulli(p=1.0), medium=Bitrate(bitrate=11520.0))
    assert alone(3, network=slow) == pytest.approx(0.6 + phase(0))


@pytest.mark.slow
def test_reports_of_one_instant_make_one_decision():
    """Without latency the reports of 1, 2, 3 come one by one at every tick, each better than the one before."""
    team = Team(positions=[(9.1 - j, 0.0) for j in range(4)], speeds=1.0)
    assert len({sent.body.number for sent in orders(run(static(Server(), team=team, horizon=20.0)))}) == 1


def test_orders_are_newer_than_those_before_also_if_the_clock_of_the_host_was_set_back():
    """The host is 3 s ahead until its first synchronisation. The chaser then crashes, and the next one is ordered."""
    faults = (ClockSkew(node=1, offset=3.0), Crash(node=0, start=2.0))
    scenario = static(Server(host=1), latency=0.05, horizon=4.0, fault=faults)
    result = run(scenario.with_({"clocks.sync": {"kind": "two_way"}}), 1)
    corrected = [
        event.correction for event in result.trace.of(ClockCorrected) if event.node == 1 and event.t < 2 * SECOND
    ]
    assert min(corrected) == pytest.approx(-3.0)
    numbers = {sent.body.chasers: sent.body.number for sent in orders(result)}
    assert list(numbers) == [(0,), (1,)]
    assert numbers[0,] < numbers[1,] < numbers[0,] + 2 * SECOND


def test_a_repaired_pursuer_does_not_send_its_missed_reports():
    """Pursuer 0 is down from 1 to 2.03 s: a single one is made up for as it is back, with the state of then."""
    result = run(static(Server(host=5), fault=(Crash(node=0, start=1.0, end=2.03),), horizon=2.45))
    times = [sent.t / 1e9 for sent in result.trace.of(Sent) if sent.src == 0]
    due = [0.0, *(phase(0) + k * 0.1 for k in range(25))]
    expected = [*(t for t in due if t < 1.0), 2.03, *(t for t in due if 2.03 < t < 2.45)]
    assert times == pytest.approx(expected)


def test_a_host_that_is_left_alone_leads_itself():
    result = run(
        static(Server(host=2), count=3, latency=0.05, fault=(Crash(node=0, start=1.0), Crash(node=1, start=1.0)))
    )
    when = [t for t, pursuer, active in changes(result) if pursuer == 2 and active]
    assert profile(result) == (False, False, True)
    last = 0.9 + max(phase(0), phase(1)) + 0.05
    due = min(t for k in range(99) if (t := phase(2) + k * 0.1) > last + 0.4)  # 3 periods and a round trip later
    assert [t / 1e9 for t in when] == pytest.approx([due])


def test_a_pursuer_that_would_be_late_is_assigned_no_evader():
    """phi = 1 .. 6 s, and 0.9 s are left."""
    assert profile(run(static(Server(), latency=0.05, horizon=0.9))) == (False,) * 6


def test_at_rest_no_time_is_lost_while_an_order_is_on_its_way():
    """The host would be .05 s later than the first pursuer, and obeys an order .12 s earlier."""
    team = Team(positions=[(1.1, 0.0), (3.1, 0.0), (1.15, 0.0)], speeds=1.0, active_at_start=0.0)
    assert changes(run(static(Server(host=2), team=team, latency=0.12))) == [(240_000_000, 0, True)]


@pytest.mark.whole
def test_random_static_games_end_in_the_relay_profile():
    """Any host, latency with heavy tails, a quarter of all lost, unequal speeds: 3 games."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        count = int(rng.integers(2, 13))
        scenario = Scenario(
            horizon=20.0,
            team=Team(count=count, speeds=rng.uniform(0.8, 2.0, count).tolist(), active_at_start=0.5),
            motion=Motion(static=True),
            protocol=Server(host=int(rng.integers(count))),
            network=Links(latency=Lognormal(mean=0.1, cv=1.0), loss=Bernoulli(p=0.25)),
            announce=Announcements(belief_timeout=np.inf, payload=str(rng.choice(["action", "time", "state"]))),
            record=Recording(trajectory=0.0),
        )
        result = run(scenario, seed)
        (start,) = result.trace.of(Started)
        phi = capture_time(start.evaders[0], start.pursuers, start.speeds, 0.9, 0.1)
        assert profile(result) == relay_profile(phi.tolist(), 20.0)


# Several evaders.


@pytest.mark.slow
@pytest.mark.parametrize("payload", ["action", "time", "state"])
def test_at_rest_several_evaders_are_assigned_as_by_the_centralised_benchmark(payload):
    """Any host, a fifth of all lost; at least one is not the greedy assignment."""
    other = 0
    for seed in range(4):
        announce = Announcements(payload=payload, belief_timeout=np.inf)
        case = at_rest(Server(host=seed), 6, 3, seed, announce=announce, network=LOSSY)
        result = run(case, None, lambda event: event.t > 3 * SECOND)
        phi = times(result)
        assert chased(result) == optimal_assignment(phi, 30.0)
        other += chased(result) != greedy_assignment(by_evader(phi), 30.0)
    assert other > 0


def test_an_order_names_the_chaser_of_each_evader():
    """Pursuers 1 and 0 are next to the evaders 1 and 2, the third is out of reach: 24 bytes and 8 for each that is."""
    case = at_rest(
        Server(host=2),
        3,
        3,
        team=Team(positions=[(3.0, 0.0), (1.0, 0.0), (9.0, 0.0)], speeds=[1.0, 1.0, 0.1]),
        evader=tuple(Evader(position=(x, 0.0), speed=0.0) for x in (0.0, 2.0, 1000.0)),
        record=Recording(trajectory=0.0, messages=True),
    )
    told = orders(run(case, None, lambda event: event.t > SECOND))
    assert {sent.body.chasers for sent in told} == {(1, 0, None)}
    assert {sent.size for sent in told} == {24 + 2 * 8}
    assert [told[0].body.action(j) for j in range(3)] == [2, 1, 0]


def test_an_order_is_of_as_many_numbers_as_there_are_evaders():
    assert [TeamOrder(7, (1,)).action(j) for j in range(3)] == [0, 1, 0]
    assert [TeamOrder(7, (None,)).action(j) for j in range(3)] == [0, 0, 0]
    assert [TeamOrder(7, (None, 0, 2)).action(j) for j in range(3)] == [2, 0, 3]


def test_a_pursuer_ordered_to_chase_a_captured_evader_stays_without_a_decision():
    """Pursuer 0 begins at 0.2 s and captures the first evader at 1.4 s; an order to chase it is still under way."""
    scenario = static(
        Server(host=2),
        latency=0.1,
        team=Team(positions=[(1.3, 0.0), (9.0, 0.0), (50.0, 0.0)], speeds=1.0, active_at_start=0.0),
        evader=tuple(Evader(position=(x, 0.0), speed=0.0) for x in (0.0, 20.0)),
        motion=Motion(),
        horizon=30.0,
    )
    result = run(scenario, None, lambda event: event.t > 3 * SECOND)
    (capture,) = result.trace.of(Captured)
    told = [sent for sent in orders(result) if sent.dst == 0 and sent.arrival > capture.t]
    assert (capture.capturer, told[0].body.chasers) == (0, (0, 1))
    assert [event for event in result.trace.of(Decided) if event.pursuer == 0 and event.t > capture.t] == []


def test_a_host_that_does_not_exist_is_an_error():
    with pytest.raises(ValueError, match=r"protocol.host: there is no pursuer 6: they are 0 .. 5"):
        static(Server(host=6))


def test_its_assumptions():
    """In a star around pursuer 0 only that one reaches all; of a ring of 6 three are too far from any."""

    def why(**given):
        return [reason.partition(", but ")[2] for _, reason in violations(static(**given))]

    assert why(protocol=Server()) == why(protocol=Server(host=5)) == []
    assert why(protocol=Server(), network=Links(graph=Star())) == []
    assert why(protocol=Server(host=2), network=Links(graph=Star())) == [
        "4 of 5 are out of reach of pursuer 2 at the start"
    ]
    assert why(protocol=Server(), network=Links(graph=Ring())) == ["3 of 5 are out of reach of pursuer 0 at the start"]
    assert why(protocol=Server(), fault=(Crash(node=1, start=1.0),)) == ["pursuers break down"]
    parted = (Partition(start=1.0, end=2.0, groups=((0,),)),)
    assert why(protocol=Server(), fault=parted) == ["a partition splits the team"]


def test_the_host_waits_for_the_reports_of_the_first_round_of_a_tdma():
    """Slots of 1 s: the report of pursuer 1 leaves at 1 s; 3 periods of the protocol take 0.3 s."""
    medium = Bitrate(bitrate=1e5, access=Tdma(slot=1.0), queue_limit=1)
    result = run(static(Server(), count=3, network=Links(medium=medium)), 0)
    numbers = [each.body.number for each in result.trace.of(Sent) if isinstance(each.body, TeamOrder)]
    assert min(numbers) >= SECOND


# Trust.


@st.composite
def judged(draw):
    """Draw the capture times, s, that a server believes, by evader and pursuer; the server itself is pursuer 0."""
    count, evaders = draw(st.integers(1, 4)), draw(st.integers(1, 3))
    times = st.floats(0.1, 20.0)
    return [{j: draw(times) for j in range(count) if j == 0 or draw(st.integers(0, 2))} for _ in range(evaders)]


@pytest.mark.slow
@given(judged())
@settings(max_examples=60)
def test_orders_go_to_the_best_of_the_pursuers_that_are_trusted_for_each_evader(believed):
    """By enumeration of all matchings. The trust in a pursuer may differ by evader, so the lists of ids do, too."""

    def beliefs(period, evader, orders):
        return {j: Belief(0, time) for j, time in believed[evader - 1].items() if j}

    host = SimpleNamespace(
        id=0,
        now=0.0,
        evader_count=len(believed),
        beliefs=beliefs,
        capture_time=lambda evader: believed[evader - 1][0],
        time_left=lambda ahead=0.0: 10.0,
    )
    chasers = Server()._chasers(host, {j: [] for j in range(1, 4)}, 0.0, ())
    assert all(j is None or j in believed[k] for k, j in enumerate(chasers))
    assert len({j for j in chasers if j is not None}) == sum(j is not None for j in chasers)

    def worth(choice):
        return sum(10.0 - believed[k][j] for k, j in enumerate(choice) if j is not None)

    options = [[None, *(j for j, time in each.items() if time < 10.0)] for each in believed]
    valid = (each for each in product(*options) if len(set(each) - {None}) == len(each) - each.count(None))
    assert worth(chasers) == pytest.approx(max(map(worth, valid)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 8, 12])
def test_a_server_with_trust_and_several_evaders_decides_to_the_end(seed):
    given = {"team": Team(count=8), "evader": Evader(count=2), "announce": {"trust": "trimmed"}}
    assert orders(run(Scenario(protocol=Server(), horizon=4.0, record=Recording(messages=True), **given), seed))


def test_an_order_that_arrives_twice_is_new_once():
    twice = [Message(3, 10, TeamOrder(7, (1,)))] * 2
    assert list(new_orders(twice, {})) == [(3, TeamOrder(7, (1,)))]


def test_the_time_without_a_chase_is_that_of_each_nanosecond():
    rng = np.random.default_rng(1)
    for _ in range(200):
        starts = sorted(rng.integers(0, 16, size=rng.integers(0, 4)).tolist())
        ordered = [(start, int(rng.integers(3))) for start in starts]
        begun = [(-1, int(rng.integers(3))), *ordered]
        actions = [[action for start, action in begun if start <= now][-1] for now in range(16)]
        for now in range(17):
            assert time_not_chasing(begun[0][1], ordered, 1, now, 16) == sum(action != 1 for action in actions[now:])


def test_as_many_evaders_as_possible_are_chased_though_fewer_would_be_caught_earlier():
    """Two pairs with phi = 0 leave the third evader to nobody; of the silent one only its place counts."""
    late, silent = 9.9, {3: 4}
    assert most_chasers([{0: 0.0, 1: late}, {1: 0.0, 2: late}, {0: late}], {}, 10.0) == {1: 1, 2: 2, 3: 0}
    assert most_chasers([{0: 0.0}, {1: 0.0}, {0: late}], silent, 10.0) == {1: 0, 2: 1, 3: 4}


def static_with_crash(protocol, node, end, **given):
    """Return a static game of six with a latency of .1 s, in which a pursuer is down from 1 s on."""
    return static(protocol, latency=0.1, horizon=6.0, fault=[Crash(node=node, start=1.0, end=end)], **given)


@pytest.mark.parametrize(("takeover", "chasers"), [(True, [1]), (False, [])])
def test_the_next_pursuer_takes_over_from_a_host_that_is_down(takeover, chasers):
    """Pursuer 0 is the host and the nearest. Without a server the others keep their orders: to stay."""
    final = profile(run(static_with_crash(Server(takeover=takeover), 0, 9.0)))
    assert [j for j, active in enumerate(final) if active] == chasers


def test_a_takeover_lasts_three_periods_two_round_trips_and_a_tick_at_most():
    """The last order left before 1 s. Silence lasts 3 periods and a round trip, and is found at the next tick. The new
    server has its first report a period and a latency later, and chases itself.
    """
    result = run(static_with_crash(Server(takeover=True), 0, 9.0))
    (start,) = (t for t, j, active in changes(result) if j == 1 and active)
    assert 1.0 + 0.3 < start / SECOND <= 1.0 + 0.1 + 0.3 + 0.2 + 0.1 + 0.1 + 0.1


def test_a_host_that_is_up_again_is_the_server_again():
    """Its first order, though older than those of pursuer 1, makes all obey it, and pursuer 1 as well."""
    result = run(static_with_crash(Server(takeover=True), 0, 3.0))
    assert profile(result) == (True, *[False] * 5)
    servers = [(event.t, event.src) for event in result.trace.of(Sent) if isinstance(event.body, TeamOrder)]
    assert {src for t, src in servers if 2 * SECOND < t < 3 * SECOND} == {1}
    assert {src for t, src in servers if t > 3.3 * SECOND} == {0}


def test_a_server_follows_another_one_before_it_in_turn():
    """Pursuer 1 is the server in the place of the host, 2 while 1 is down, and then 1 again."""
    faults = (Crash(node=0, start=0.0), Crash(node=1, start=2.0, end=4.0))
    result = run(static(Server(takeover=True), count=4, latency=0.02, horizon=5.0, fault=faults))
    servers = [(sent.t / SECOND, sent.src) for sent in orders(result)]
    assert {src for t, src in servers if t < 2.0} == {1}
    assert {src for t, src in servers if 2.0 < t < 4.0} == {2}
    assert {src for t, src in servers if t > 4.1} == {1}


def test_each_side_of_a_partition_has_a_server():
    """Those cut off from the host find the next of their own side, whoever of it is down or on the other side."""
    cut = Partition(groups=[[0, 1, 2], [3, 4, 5]], start=1.0, end=9.0)
    result = run(static(Server(takeover=True), latency=0.1, horizon=6.0, fault=[cut]))
    assert profile(result) == (True, False, False, True, False, False)


def test_orders_that_arrive_late_are_no_sign_of_a_host_that_is_down():
    """The orders of .7 to .8 s arrive after 2.7 s, those of .8 to 1 s in time: the takeover is that without delays."""
    crash = Crash(node=0, start=1.0)
    prompt, late = (
        run(static(Server(takeover=True), latency=0.1, horizon=6.0, fault=(crash, *more)))
        for more in ((), (MessageFault(start=0.7, end=0.8, messages=range(1, 11), delay=2.0),))
    )
    arrivals = [sent.arrival for sent in orders(late) if sent.src == 0]
    assert max(arrivals) > 2.7 * SECOND
    assert changes(late) == changes(prompt)
    assert changes(late)[-1][1:] == (1, True)
    servers = {sent.src for sent in orders(late) if sent.t > 1.5 * SECOND}
    assert servers == {1}, "nor do they depose the new server"


@pytest.mark.parametrize(("horizon", "chasers"), [(5.0, [0]), (9.0, [5])])
def test_a_silent_chaser_keeps_its_order_unless_another_would_be_in_time(horizon, chasers):
    """The host, 6 m from the evader, hears nobody from 1 s on; pursuer 0, 1 m from it, still hears the host."""
    jammed = Jamming(start=1.0, centre=(6.0, 0.0), radius=0.5)
    final = profile(run(static(Server(host=5), latency=0.05, horizon=horizon, fault=(jammed,))))
    assert [j for j, active in enumerate(final) if active] == chasers


def test_a_silent_chaser_keeps_its_evader_while_another_one_chases_a_second():
    """The host is 2.5 m from the first evader and 7.5 m from the second, pursuer 1 is 2.4 m from the first, r = 9 s.

    From 1 s on the host hears nobody. It alone would chase the first evader, and 1 of 2 would be chased.
    """
    scenario = static(
        Server(host=0),
        latency=0.05,
        horizon=9.0,
        team=Team(positions=[(2.5, 0.0), (0.0, 2.4)], speeds=1.0),
        evader=tuple(Evader(position=(x, 0.0), speed=0.0) for x in (0.0, 10.0)),
        fault=[Jamming(start=1.0, centre=(2.5, 0.0), radius=0.5)],
    )
    assert chased(run(scenario, None, late)) == {0: 2, 1: 1}


@st.composite
def silences(draw):
    """Draw what a server knows as it decides: (phi by evader and pursuer that is heard, present chasers, silent ones).

    The server itself is pursuer 0, and silent ones include a present chaser.
    """
    count, evaders = draw(st.integers(2, 6)), draw(st.integers(1, 4))
    waiting = draw(st.permutations([*range(count), *[None] * evaders]))
    present = tuple(waiting[:evaders])
    chasers = [j for j in present if j]
    assume(chasers)
    silent = {draw(st.sampled_from(chasers))} | {j for j in range(1, count) if draw(st.booleans())}
    times = st.integers(1, 15).map(float) | st.floats(0.1, 15.0)
    phi = [{j: draw(times) for j in range(count) if j not in silent} for _ in range(evaders)]
    return phi, present, silent


@pytest.mark.slow
@given(silences(), st.sets(st.integers(0, 5)))
@settings(max_examples=200)
def test_no_decision_leaves_fewer_evaders_with_a_chaser_that_is_up_because_a_chaser_is_silent(known, down):
    """Of the silent ones any may be down. One that is heard chases if it would be in time: r = 10 s.

    And no fewer have a chaser that is up than if the silent ones were stopped.
    """
    phi, present, silent = known
    host = SimpleNamespace(
        id=0,
        now=0.0,
        evader_count=len(phi),
        evaders=lambda: range(1, len(phi) + 1),
        beliefs=lambda period, evader, orders: {j: Belief(0, time) for j, time in phi[evader - 1].items() if j},
        trusted=lambda period: {j: None for j in phi[0] if j},
        capture_time=lambda evader: phi[evader - 1][0],
        time_left=lambda ahead=0.0: 10.0,
    )

    def up(chasers):
        """Return the number of evaders that have a chaser which is up and, if it is heard, in time."""
        return sum(j not in down if j in silent else j is not None and phi[k][j] < 10.0 for k, j in enumerate(chasers))

    decide = partial(Server()._chasers, host, {j: [] for j in range(1, 6)}, 0.0)
    chasers = decide(present)
    assert len(set(chasers) - {None}) == len(chasers) - chasers.count(None)
    assert all(j not in silent or j == old for old, j in zip(present, chasers, strict=True))
    assert up(chasers) >= max(up(present), up(decide(())))


@pytest.mark.slow
def test_lost_orders_do_not_depose_the_host():
    """A pursuer that lost three orders in a row may be the server until it hears the host, for a share of the time of
    about .4^3, and nobody else obeys it.
    """
    result = run(static(Server(takeover=True), latency=0.02, loss=0.4, horizon=20.0))
    orders = [event.src for event in result.trace.of(Sent) if isinstance(event.body, TeamOrder)]
    assert {j for t, j, _ in changes(result) if t > SECOND} <= {1}
    assert 0.85 * len(orders) < orders.count(0) < len(orders)


def test_a_server_with_takeover_does_not_assume_that_nobody_crashes():
    crash = [Crash(node=0, start=1.0, end=2.0)]
    assert any("no crashes" in text or "crash" in text for _, text in violations(static(Server(), fault=crash)))
    assert not list(violations(static(Server(takeover=True), fault=crash)))
