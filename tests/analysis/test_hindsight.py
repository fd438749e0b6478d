"""Hindsight: by hand on frozen and moving games, and beside an ideal network."""

from dataclasses import replace
from functools import cache
from math import inf

import numpy as np
import pytest

from desim.analysis.hindsight import (
    hindsight,
    misassigned_time,
    network_regret,
    potential_gap,
    regret,
    settling_window,
    time_to_relay,
)
from desim.analysis.measuring import summary
from desim.analysis.metrics import active_time, capture_time
from desim.analysis.timeline import RelativePlaces, _Path, timeline
from desim.config.model import Value
from desim.kernel.core.events import MessageCounts, Trace
from desim.kernel.core.units import SECOND, nanoseconds
from desim.kernel.models.fault_plans import RandomCrashes
from desim.kernel.models.faults import Crash
from desim.kernel.models.graphs import Link, Ring
from desim.kernel.models.latency import Constant, Lognormal, Propagation
from desim.kernel.models.links import Links, Processing
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.medium import Bitrate
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.pursuit.core.events import BrokeDown, Decided, Ended, Sampled, Started
from desim.pursuit.evaders.recorded import RecordedMotion
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Capture, Motion, Recording, Scenario
from desim.simulation.run import Result, run
from protocols.centralised import Centralised
from protocols.geometric import Voronoi
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson
from protocols.server import Server

pytestmark = pytest.mark.own_trace
METRICS = (misassigned_time, time_to_relay, potential_gap, regret)
HORIZON = 8.0


def by_hand(phi, active, decisions, end, frozen=True, samples=(), more=(), speeds=None):
    """Return a result with these times of capture at first, and these (time, pursuer, action), s.

    The evader is at the origin, at 1 m/s; pursuers are on the x axis at 2 m/s, and capture at 0.5 m: phi = d - 0.5.

    Args:
        samples: (time, times of capture) of every pursuer later.
        more: other events.
    """

    def places(times):
        return tuple((each + 0.5, 0.0) for each in times)

    start = Started(0, ((0.0, 0.0),), places(phi), speeds or (2.0,) * len(phi), active)
    events = [Decided(nanoseconds(t), i, a) for t, i, a in decisions] + list(more)
    events += [Sampled(nanoseconds(t), ((0.0, 0.0),), places(times)) for t, times in samples]
    trace = Trace()
    trace.events = [start, *sorted(events, key=lambda each: each.t)]
    trace.events += [
        MessageCounts(nanoseconds(end), 0, 0, 0, 0, {}, 0, 0, 0.0),
        Ended(nanoseconds(end), "stopped", None),
    ]
    scenario = Scenario(
        horizon=HORIZON,
        team=Team(count=len(phi)),
        evader=Evader(speed=1.0),
        capture=Capture(radius=0.5),
        motion=Motion(static=frozen),
    )
    return Result(scenario, 0, trace)


def still(phi, *rest, every=None, **options):
    """Return a result of a pursuit in which no distance changes, sampled every so often."""
    end = rest[-1]
    times = np.arange(0.0, end + 1e-9, every or end)
    return by_hand(phi, *rest, frozen=False, samples=[(t, phi) for t in times], **options)


def test_a_pursuer_that_stands_still_keeps_its_heading():
    """It goes outwards at 1 m/s for a second, is at rest for a second, and goes back at 0.5 m/s to the last sample."""
    result = by_hand((3.0,), (True,), [], 4.0, frozen=False, samples=enumerate([(3.0,), (4.0,), (4.0,), (3.5,)]))
    courses = _Path(result, 1).courses(np.array([0.5, 1.5, 2.5, 3.0, 4.0]) * SECOND)
    assert [course.velocities.tolist() for course in courses] == [[1.0], [0.0], [-0.5], [0.0], [0.0]]
    assert [course.headings.tolist() for course in courses] == [[1.0], [1.0], [-1.0], [-1.0], [-1.0]]


GAME = ((1.0, 2.0, 4.0), (True,) * 3, [(1.0, 2, False), (2.0, 1, False), (4.0, 0, False), (5.0, 1, True)], 6.0)
"""phi = (1, 2, 4), r = 8; active are 012 to 1 s, 01 to 2 s, 0 to 4 s, no pursuer to 5 s, 1 to 6 s."""


def test_the_misassigned_time_is_how_long_another_set_than_the_relay_pursuer_is_active():
    """All but 2 .. 4 s."""
    assert misassigned_time(by_hand(*GAME)) == 4.0


def test_the_potential_gap_is_the_integral_of_the_missing_potential():
    """Phi* = 7; Phi = 8 - 7/3, 8 - 3/2, 7, 0 and 6: 4/3 + 1/2 + 0 + 7 + 1."""
    assert potential_gap(by_hand(*GAME)) == pytest.approx(4 / 3 + 8.5, abs=1e-14)


def test_regret_is_that_of_the_better_fixed_action_of_each_pursuer():
    """What being active is worth, integrated over the five pieces of 1, 1, 2, 1 and 1 s:

    pursuer 0: 2/3 + 1/2 + 14 + 7 + 1/2 = 22 2/3, of which it got 15 1/6 to 4 s: it regrets 7 1/2;
    pursuer 1: 1/6 - 1/2 - 1 + 6 + 6 = 10 2/3, of which it got 1/6 - 1/2 + 6 = 5 2/3: 5;
    pursuer 2: -5/6 - 5/6 - 3 + 4 - 1 < 0, so that it should have stayed, and got -5/6: 5/6.
    The mean is 40/9 s^2, and 6 s passed.
    """
    result = by_hand(*GAME)
    assert hindsight(result).regret == pytest.approx([7.5, 5.0, 5 / 6], abs=1e-13)
    assert regret(result) == pytest.approx(40 / 9 / 6, abs=1e-14)


def test_the_regret_is_averaged_over_the_pursuers_that_may_chase():
    result = by_hand(*GAME)
    team = Team(count=3, relay=({"pursuer": 2, "motion": RecordedMotion(waypoints=((0.0, 1.0, 1.0),))},))
    relayed = replace(result, scenario=result.scenario.model_copy(update={"team": team}))
    first, second, third = hindsight(relayed).regret
    assert regret(relayed) == pytest.approx((first + second) / 2 / 6, abs=1e-14)
    assert third == 0.0


def test_regret_is_negative_for_a_pursuer_that_beats_every_fixed_action():
    """phi = (1, 2), r = 8; each single active pursuer has a good reason: pursuer 0 to 1 s gets 7, pursuer 1 from 1 to 2
    s gets 6.

    0 would have got 7 + 1/2: regret 1/2. 1 would have got -1/2 + 6: it is 1/2 better off than that.
    """
    result = by_hand((1.0, 2.0), (True, False), [(1.0, 0, False), (1.0, 1, True)], 2.0)
    assert hindsight(result).regret.tolist() == [0.5, -0.5]
    assert regret(result) == 0.0


def test_the_time_to_relay_is_the_first_time_from_which_it_chases_alone_for_a_window():
    """From 2 s on, for 2 s; the run does not end so."""
    result = by_hand(*GAME)
    assert time_to_relay(result, window=2.0) == 2.0
    assert time_to_relay(result, window=0.0) == 2.0
    assert time_to_relay(result, window=2.0 + 1e-9) is None


def test_the_end_of_the_run_may_cut_the_window_short():
    """Alone from 1 to 2 s, and from 2.5 to the end at 3 s."""
    acts = [(1.0, 1, False), (2.0, 1, True), (2.5, 1, False)]
    result = by_hand((1.0, 2.0), (True, True), acts, 3.0)
    assert [time_to_relay(result, window) for window in (0.5, 1.0, 1.25, inf)] == [1.0, 1.0, 2.5, 2.5]
    assert time_to_relay(by_hand((1.0, 2.0), (True, True), [(3.0, 1, False)], 3.0), 0.0) is None


def test_pieces_of_the_same_kind_make_one_window():
    """Pursuer 1 only repeats itself, and samples break nothing: alone from 1 s on."""
    result = still((1.0, 2.0), (True, True), [(1.0, 1, False), (2.0, 1, False)], 5.0, every=0.25)
    assert time_to_relay(result, window=3.5) == 1.0


@pytest.mark.slow
def test_the_window_is_twice_the_latency_and_the_mean_time_between_decisions_of_one_pursuer():
    """Four decisions of three pursuers in 6 s: one in 4.5 s each; latency 0.25 s: W = 9.5 s."""
    result = by_hand(*GAME)

    def window(**links):
        scenario = result.scenario.model_copy(update={"network": Links(**links)})
        return settling_window(Result(scenario, 0, result.trace))

    assert window() == 9.0
    assert window(latency=Constant(value=0.25)) == 9.5
    assert window(latency=Constant(value=0.25), processing=Processing(sender=0.5, receiver=0.25)) == 11.0
    assert window(latency=Lognormal(mean=0.25, cv=0.1)) == pytest.approx(9.5, abs=0.01)
    assert window(graph=Ring(), latency=Constant(value=0.25)) == 9.5
    # One link of six that takes 1 s makes the mean 0.375 s; 48 bytes take 2 s.
    assert window(latency=Constant(value=0.25), link=(Link(src=0, dst=2, latency=Constant(value=1.0)),)) == 9.75
    assert window(medium=Bitrate(bitrate=192.0)) == 9.0 + 2 * 48 * 8 / 192.0
    # Pursuers at 1.5, 2.5 and 4.5 m are 1, 2 and 3 m apart.
    assert window(latency=Propagation(speed=4.0)) == pytest.approx(9.0 + 2 * 2.0 / 4.0)


@pytest.mark.parametrize(
    ("protocol", "between"), [(Centralised(slot=0.5), 0.5), (Server(period=0.25), 0.25), (Voronoi(slot=0.125), 0.125)]
)
def test_the_window_of_a_pursuer_that_decides_at_ticks_is_that_of_its_ticks(protocol, between):
    """What they decide is on record only if it changes an action."""
    result = by_hand(*GAME)
    scenario = result.scenario.model_copy(update={"protocol": protocol})
    assert settling_window(Result(scenario, 0, result.trace)) == 2 * between


class Tabled(Value):
    """A latency from a table for 30 nodes: 0.25 s."""

    def start_run(self, size):
        assert size == 30
        return lambda context, rng: 0.25

    def __call__(self, context, rng):
        raise NotImplementedError


def test_the_window_of_a_big_team_is_that_of_all_its_links():
    """At 1 .. 30 m the mean distance of two pursuers is 31 / 3 m."""
    team = tuple(1.0 + i for i in range(30))
    result = by_hand(team, (True,) * 30, [(1.0, 0, True)], 2.0)

    def latency(**links):
        scenario = result.scenario.model_copy(update={"network": Links(**links)})
        return settling_window(Result(scenario, 0, result.trace)) / 2 - 60.0

    assert latency(latency=Constant(value=0.25)) == 0.25
    assert latency(latency=Tabled()) == 0.25
    assert latency(latency=Propagation(speed=1.0)) == pytest.approx(31 / 3)
    far = (Link(src=28, dst=29, latency=Constant(value=100.0)),)
    assert latency(latency=Constant(value=0.25), link=far) == pytest.approx(0.25 + 99.75 / 870)


def test_a_run_without_decisions_has_settled_if_the_relay_chases_alone_to_the_end():
    assert settling_window(by_hand((1.0, 2.0), (True, False), [], 3.0)) == inf
    assert time_to_relay(by_hand((1.0, 2.0), (True, False), [], 3.0)) == 0.0
    assert time_to_relay(by_hand((1.0, 2.0), (False, True), [], 3.0)) is None


def test_by_default_the_time_to_relay_is_that_of_the_window_of_the_run():
    """Alone from 1 s to 4 s and from 4.5 s to 10 s. With 4 decisions in 10 s of 2 pursuers W = 10 s, with 16 2.5 s."""
    acts = [(1.0, 1, False), (4.0, 1, True), (4.5, 1, False)]
    few = by_hand((1.0, 2.0), (True, True), [*acts, (5.0, 1, False)], 10.0)
    many = by_hand((1.0, 2.0), (True, True), [*acts, *[(5.0, 1, False)] * 13], 10.0)
    assert (time_to_relay(few), time_to_relay(many)) == (4.5, 1.0)


def test_among_equals_the_lowest_id_is_the_relay_pursuer():
    both = (2.0, 1.0, 1.0), 3.0
    for active, misassigned in (((False, True, False), 0.0), ((False, False, True), 3.0), ((True, False, False), 3.0)):
        assert misassigned_time(by_hand(both[0], active, [], both[1])) == misassigned


def test_no_pursuer_should_chase_if_all_would_be_late():
    """phi = 8 = r: no pursuer should chase, and the gap is that of the chaser, 8 - 9 < 0."""
    assert misassigned_time(by_hand((8.0, 9.0), (False, False), [], 3.0)) == 0.0
    assert time_to_relay(by_hand((8.0, 9.0), (False, False), [], 3.0)) == 0.0
    assert misassigned_time(by_hand((8.0, 9.0), (True, False), [], 3.0)) == 3.0
    assert potential_gap(by_hand((8.0, 9.0), (False, True), [], 3.0)) == 3.0
    assert misassigned_time(by_hand((7.5, 9.0), (False, False), [], 3.0)) == 3.0


def test_a_pursuer_that_cannot_capture_has_no_regret_and_no_part_in_the_potential():
    """Pursuer 1 is no faster than the evader. Alone it is misassigned, with Phi = 0 instead of 6.

    Pursuer 0 would gain 6 whatever 1 does, and regrets only to have stayed.
    """
    for active, gap, misassigned in (((True, True), 0.0, 3.0), ((False, True), 18.0, 3.0), ((True, False), 0.0, 0.0)):
        result = by_hand((2.0, 1.0), active, [], 3.0, speeds=(2.0, 1.0))
        assert (potential_gap(result), misassigned_time(result)) == (gap, misassigned)
        assert hindsight(result).regret.tolist() == [gap, 0.0]


def test_a_robot_that_is_broken_is_not_the_relay_pursuer():
    """0 is broken from 1 to 3 s, twice from 2 s on; 1 chases from 1 s to 3.5 s; a broken radio does not matter."""
    first, second = Crash(start=1.0, end=2.5, node=0), Crash(start=2.0, end=3.0, node=0)
    radio = Crash(start=0.0, end=5.0, node=0, scope="radio")
    events = [
        FaultStarted(0, radio),
        FaultStarted(SECOND, first),
        BrokeDown(SECOND, 0),
        FaultStarted(2 * SECOND, second),
    ]
    events += [FaultEnded(5 * SECOND // 2, first), FaultEnded(3 * SECOND, second), FaultEnded(5 * SECOND, radio)]
    acts = [(1.0, 1, True), (3.5, 1, False), (4.0, 0, True)]
    result = by_hand((1.0, 2.0), (True, False), acts, 5.0, more=events)
    assert misassigned_time(result) == 1.0
    assert potential_gap(result) == 0.5 * 1.0 + 0.5 * 7.0
    sound = by_hand((1.0, 2.0), (True, False), acts, 5.0, more=[BrokeDown(SECOND, 0)])
    assert misassigned_time(sound) == 3.0


# What moves.


def test_the_time_that_is_left_runs_in_a_pursuit():
    """phi = 1, no pursuer active, r = 8 - t: misassigned to 7 s, the gap is the integral of 7 - t, 24.5.

    Samples every second have a breakpoint at 7 s, where it changes; the gap is linear but for that.
    """
    result = still((1.0,), (False,), [], 8.0, every=1.0)
    assert (misassigned_time(result), potential_gap(result), time_to_relay(result)) == (7.0, 24.5, 7.0)
    assert regret(result) == (24.5 - 0.5) / 8.0  # from 7 to 8 s it would have been late


def test_a_straight_chase_between_two_samples_is_exact():
    """0 comes nearer, phi = 4 - t, 1 stays at 2.5: the relay is 1 to 1.5 s, then 0. r - phi is 5.5 - t, then 4."""
    samples = [(0.0, (4.0, 2.5)), (4.0, (0.0, 2.5))]
    acts = [(1.5, 0, True), (1.5, 1, False)]
    result = by_hand((4.0, 2.5), (False, True), acts, 4.0, frozen=False, samples=samples)
    assert misassigned_time(result) == potential_gap(result) == 0.0
    idle = by_hand(
        (4.0, 2.5), (False, False), [(1.5, 1, False)], 4.0, frozen=False, samples=[*samples, (1.5, (2.5,) * 2)]
    )
    assert potential_gap(idle) == pytest.approx(5.5 * 1.5 - 1.5**2 / 2 + 4.0 * 2.5, abs=1e-12)


def test_a_change_of_relay_between_two_samples_is_seen_at_one_of_them():
    """As above, but pursuer 1 stays active for 0.5 s too long: seen with samples every half a second only."""
    acts = [(2.0, 0, True), (2.0, 1, False)]
    for every, seen in ((0.5, 0.5), (4.0, 0.0)):
        samples = [(t, (4.0 - t, 2.5)) for t in np.arange(0.0, 4.1, every)]
        result = by_hand((4.0, 2.5), (False, True), acts, 4.0, frozen=False, samples=samples)
        assert misassigned_time(result) == seen


def test_positions_stay_after_the_last_sample_and_start_at_the_initial_ones_before_the_first():
    """phi = 4 - t to 2 s, and 2 from then on: the gap of an idle pursuer is 4 x 2 + (6 - t) from 2 to 4 s = 8 + 6."""
    result = by_hand((4.0,), (False,), [], 4.0, frozen=False, samples=[(2.0, (2.0,))])
    assert potential_gap(result) == 14.0


def test_in_a_static_game_samples_are_ignored():
    result = by_hand(*GAME, samples=[(0.0, (9.0, 9.0, 0.5)), (6.0, (9.0, 9.0, 0.5))])
    assert misassigned_time(result) == 4.0


def test_without_positions_there_is_no_hindsight_and_the_summary_has_none():
    result = by_hand(*GAME, frozen=False)
    for metric in METRICS:
        with pytest.raises(ValueError, match=r"set record\.trajectory"):
            metric(result)
    numbers = summary(result)
    assert (numbers.misassigned_time, numbers.potential_gap, numbers.regret, numbers.time_to_relay) == (None,) * 4
    assert summary(by_hand(*GAME)).misassigned_time == 4.0


def test_a_run_without_time_is_neither_right_nor_wrong():
    result = by_hand((1.0,), (False,), [], 0.0)
    assert [metric(result) for metric in METRICS] == [0.0, None, 0.0, 0.0]


# Of real runs; that all is what brute force finds is tested with several evaders and with one in test_several.

CASES = {
    "frozen": {"motion": Motion(static=True), "horizon": 3.0},
    "pursuit": {"horizon": 4.0},
    "crashes": {"horizon": 4.0, "fault": (RandomCrashes(rate=0.5, mean_downtime=0.5),)},
}


@cache
def negotiated(case, seed, **changes):
    """Return a run of five pursuers near the evader, some of which may be too slow."""
    near = {"team": Team(count=5, box=(7.0, 13.0), speeds=(1.0, 1.2, 0.8, 1.1, 1.6), active_at_start=0.5)}
    protocol = SpatialAdaptivePlay(schedule=Poisson(rate=4.0))
    links = Links(latency=Constant(value=0.1), loss=Bernoulli(p=0.3))
    return run(Scenario(**(near | {"protocol": protocol, "network": links} | CASES[case] | changes)), seed)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["pursuit", "crashes"])
def test_the_timeline_in_parts_is_the_whole_timeline(case, monkeypatch):
    result = negotiated(case, 1)
    (whole,) = timeline(result)
    expected = [metric(result) for metric in METRICS]
    for pieces in (1, 7):
        monkeypatch.setattr("desim.analysis.timeline.PART", 5 * pieces)
        parts = list(timeline(result))
        assert max(len(part.durations) for part in parts) == pieces
        assert [part.times[-1] for part in parts[:-1]] == [part.times[0] for part in parts[1:]]
        for name in ("active", "phi", "left", "durations"):
            joined = np.concatenate([getattr(part, name) for part in parts])
            np.testing.assert_allclose(joined, getattr(whole, name), rtol=1e-13)
        assert [metric(result) for metric in METRICS] == pytest.approx(expected, abs=1e-12)


def test_the_timeline_has_the_active_time_of_the_run():
    result = negotiated("crashes", 2)
    (whole,) = timeline(result)
    assert (whole.durations > 0).all()
    assert whole.durations.sum() == pytest.approx(summary(result).end_time, abs=1e-12)
    assert whole.durations @ whole.active.sum(axis=1) == pytest.approx(active_time(result), abs=1e-9)


@pytest.mark.slow
def test_between_samples_the_times_of_capture_are_nearly_those_of_fine_samples():
    """Sampled every 0.05 s and at every motion step, 0.01 s: the gap differs by < 0.1 %, sampled once by > 1 %."""
    gaps = [
        potential_gap(negotiated("pursuit", 1, record=Recording(trajectory=period))) for period in (0.01, 0.05, 4.0)
    ]
    assert gaps[1] == pytest.approx(gaps[0], rel=1e-3)
    assert gaps[2] != pytest.approx(gaps[0], rel=1e-2)


# Beside an ideal network.


@pytest.mark.slow
def test_the_regret_of_a_network_is_the_excess_of_a_metric_over_the_ideal_network():
    faults, network = 0, 0
    for seed in range(4):
        result = negotiated("crashes", seed)
        ideal = negotiated("pursuit", seed, network=Links())
        assert network_regret(result) == potential_gap(result) - potential_gap(ideal)
        assert network_regret(result, active_time) == active_time(result) - active_time(ideal)
        faults += potential_gap(negotiated("crashes", seed, network=Links())) != potential_gap(ideal)
        network += potential_gap(negotiated("pursuit", seed)) != potential_gap(ideal)
    assert min(faults, network) > 0  # it takes both, that network and no faults


@pytest.mark.slow
def test_an_ideal_network_leaves_nothing_to_regret():
    for seed in (0, 1):
        assert network_regret(negotiated("pursuit", seed, network=Links())) == 0.0


def test_a_metric_without_a_value_is_refused_with_its_name_and_the_seed():
    """A pursuit of 0.01 s has no capture, and so no time of it."""
    result = negotiated("pursuit", 3, horizon=0.01)
    with pytest.raises(ValueError, match=r"^capture_time has no value in the run with seed 3$"):
        network_regret(result, capture_time)

    def only_given(each):
        return 1.0 if each is result else None

    with pytest.raises(ValueError, match=r"^only_given has no value in the run on an ideal network with seed 3$"):
        network_regret(result, only_given)


@pytest.mark.whole
def test_latency_is_regretted_on_average():
    """Static games of five, 20 seeds: the mean of the regret of a latency of 0.5 s is 3 standard errors above 0.

    The control, a latency of 0.001 s, is not.
    """

    def regrets(latency):
        links = Links(latency=Constant(value=latency))
        cases = (negotiated("frozen", seed, network=links, horizon=10.0) for seed in range(20))
        return np.array([network_regret(result) for result in cases])

    slow, fast = regrets(0.5), regrets(0.001)
    assert slow.mean() > 3 * slow.std(ddof=1) / np.sqrt(20)
    assert not fast.mean() > 3 * fast.std(ddof=1) / np.sqrt(20)


def test_in_a_flow_that_changes_pursuers_at_rest_keep_their_places_and_headings_in_hindsight():
    """Samples lie between motion steps, in which the simulated flow is constant: places are off, within the bound."""
    flow = {"kind": "harmonic", "amplitude": [2.0, 1.0], "period": 0.5}
    resting = {"positions": [[0, 0]], "active_at_start": 0.0, "dynamics": {"kind": "turn_rate", "heading": 0.5}}
    changes = {"environment.flow": flow, "motion.step": 0.02, "record.trajectory": 0.03}
    scenario = Scenario(horizon=1.0).with_(changes | {f"team.{key}": value for key, value in resting.items()})
    result, places = run(scenario, 1), RelativePlaces(scenario)
    known = [result.trace.of(Started)[0], *result.trace.of(Sampled)]
    worst = max(abs(places(sample)[0]) for sample in known)
    assert places.error / 10.0 < worst <= places.error
    courses = _Path(result, 1).courses(np.array([sample.t for sample in known]))
    assert {complex(each.headings[0]) for each in courses} == set(scenario.team.headings(1))
