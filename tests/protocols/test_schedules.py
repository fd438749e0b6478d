"""Schedules: when each pursuer revises."""

from collections import Counter
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import kstest

from desim import Scenario, run
from desim.kernel.core.events import Broadcast
from desim.kernel.core.seeds import stream
from desim.kernel.models.links import Links
from desim.pursuit.core.events import Decided, Started
from desim.pursuit.game.game import gain
from desim.pursuit.motion.capture import capture_time
from desim.pursuit.team.announcements import Announcements
from desim.scenario.checks import warnings
from desim.scenario.players import Team
from desim.scenario.scenario import Motion, Recording
from protocols.rule import SCHEDULES
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Periodic, Poisson, Rounds, SharedSeed, owned_slots
from protocols.temperature import ConstantTau


def decisions(schedule, count, horizon, seed=0):
    """Return the decisions of a frozen game under a schedule."""
    scenario = Scenario(
        horizon=horizon,
        team=Team(count=count),
        motion=Motion(static=True),
        protocol=SpatialAdaptivePlay(schedule=schedule),
        record={"trajectory": 0.0},
    )
    return run(scenario, seed).trace.of(Decided)


def test_every_slot_belongs_to_exactly_one_pursuer():
    """Over three blocks of 4096 slots the owners partition 1, 2, ..., whichever pursuer asks."""
    limit = 3 * 4096
    owned = []
    for pursuer in range(5):
        for k in owned_slots(pursuer, 5, stream(3, "slots")):
            if k > limit:
                break
            owned.append(k)
    assert sorted(owned) == list(range(1, limit + 1))


def test_shared_seed_decides_once_at_the_end_of_each_slot():
    times = [decision.t for decision in decisions(SharedSeed(slot=0.01), 6, 2.0)]
    assert times == [k * 10_000_000 for k in range(1, 200)]


@pytest.mark.slow
@pytest.mark.parametrize("schedule", [SharedSeed(slot=0.001), Poisson(rate=250.0)])
def test_owners_are_drawn_uniformly(schedule):
    """10,000 decisions of 4 pursuers: chi-squared with 3 degrees of freedom is below 16.3 with probability 0.999.

    The control, a pursuer that is called a tenth too often, is far above.
    """
    counts = np.array([*Counter(d.pursuer for d in decisions(schedule, 4, 10.0, seed=4)).values()])

    def chi_squared(observed):
        return ((observed - observed.mean()) ** 2).sum() / observed.mean()

    assert chi_squared(counts) < 16.3
    assert chi_squared(counts + np.array([counts[0] * 0.1, 0, 0, 0])) > 16.3


@pytest.mark.whole
def test_successive_owners_are_independent():
    """Pairs of owners of 20,000 slots fall evenly into 16 cells: chi-squared with 15 degrees of freedom < 37.7 (.999).

    The control, owners that take turns, is far above.
    """
    owners = [d.pursuer for d in decisions(SharedSeed(slot=0.001), 4, 20.0, seed=6)]

    def chi_squared(sequence):
        counts = np.array([Counter(pairwise(sequence))[i, j] for i in range(4) for j in range(4)])
        return ((counts - counts.mean()) ** 2).sum() / counts.mean()

    assert chi_squared(owners) < 37.7
    assert chi_squared(sorted(owners)) > 37.7


@pytest.mark.slow
def test_poisson_waits_are_exponential():
    """Mean and standard deviation of the waits of a pursuer are both 1/rate; n = 4,000, standard error 1/sqrt(n).

    The control has waits that are 12 % longer.
    """
    waits = np.diff([d.t for d in decisions(Poisson(rate=100.0), 1, 40.0, seed=5)]) / 1e9 * 100.0
    error = 1 / np.sqrt(len(waits))
    for scale, within in ((1.0, True), (1.12, False)):
        assert (abs(scale * waits.mean() - 1) < 5 * error) == within
        # The standard deviation of an exponential is less certain.
        assert (abs(scale * waits.std() - 1) < 5 * np.sqrt(2) * error) == within
    assert abs(np.corrcoef(waits[1:], waits[:-1])[0, 1]) < 5 * error


@pytest.mark.whole
def test_the_mean_slot_is_the_time_between_two_decisions_of_the_team():
    for schedule in (
        *(SharedSeed(slot=0.004), Poisson(rate=50.0), Rounds(period=0.02), Rounds(period=0.01, participation=0.5)),
        *(Periodic(period=0.02), Periodic(period=0.02, jitter=0.0)),
    ):
        made = len(decisions(schedule, 5, 16.0))
        assert schedule.mean_slot(SimpleNamespace(team_size=5)) == pytest.approx(0.004)
        assert made == pytest.approx(4000, abs=5 * np.sqrt(4000))


# Rounds.


@pytest.mark.parametrize("count", [1, 3, 8])
def test_in_a_round_all_pursuers_decide_at_one_instant_in_id_order(count):
    made = [(d.t, d.pursuer) for d in decisions(Rounds(period=0.1), count, 2.05)]
    assert made == [(k * 100_000_000, pursuer) for k in range(1, 21) for pursuer in range(count)]


def rounds(seed, latency, p0=0.5, count=7):
    """Return the first profile, those after each of 12 greedy rounds of 0.1 s, and the times of capture (r = 30 s)."""
    scenario = Scenario(
        horizon=30.0,
        team=Team(count=count, speeds=np.linspace(1.0, 2.0, count).tolist(), active_at_start=p0),
        motion=Motion(static=True),
        protocol=SpatialAdaptivePlay(tau=ConstantTau(value=1e-9), schedule=Rounds(period=0.1)),
        network={"latency": {"kind": "constant", "value": latency}},
        announce={"start": "known"},
        record={"trajectory": 0.0},
    )
    result = run(scenario, seed, lambda event: event.t > 1.25e9)
    start = result.trace.of(Started)[0]
    made = [d.active for d in result.trace.of(Decided)][: 12 * count]
    phi = capture_time(start.evaders[0], start.pursuers, start.speeds, 0.9, 0.1).tolist()
    return start.active, [tuple(made[k * count : (k + 1) * count]) for k in range(12)], phi


def all_respond(phi, profile):
    """Return the best responses of all to a profile, all at once; r = 30 s."""

    def others(i):
        return [phi[j] for j, active in enumerate(profile) if active and j != i]

    return tuple(gain(phi[i], others(i), 30.0) > 0.0 for i in range(len(phi)))


def one_by_one(phi, profile):
    """Return the profile after sequential best responses: not what a round is."""
    for i in range(len(phi)):
        profile = (*profile[:i], all_respond(phi, profile)[i], *profile[i + 1 :])
    return profile


@pytest.mark.slow
@pytest.mark.parametrize("latency", [0.0, 1e-9, 0.0999])
def test_a_round_is_simultaneous_best_response_even_without_latency(latency):
    """All respond to the profile of the round before. The control: one by one goes another way."""
    differs = 0
    for seed in range(12):
        profile, found, phi = rounds(seed, latency, p0=seed % 3 / 2)
        differs += found[0] != one_by_one(phi, profile)
        for each in found:
            profile = all_respond(phi, profile)
            assert each == profile
    assert differs > 6


def test_with_latency_above_the_period_decisions_use_the_round_before_last():
    """L = 0.15 s, rounds of 0.1 s: each answers what was decided two rounds ago, at first the profile of the start."""
    profile, found, phi = rounds(3, 0.15, p0=1.0)
    known = [profile, profile, *found]
    assert found == [all_respond(phi, known[k]) for k in range(12)]
    assert found != [all_respond(phi, known[k + 1]) for k in range(12)]


@pytest.mark.slow
@pytest.mark.slow_but_one
@pytest.mark.parametrize("kind", SCHEDULES.choices())
def test_each_revision_is_announced_at_its_instant(kind):
    """With the trigger "revision", also if the action is the same."""
    scenario = Scenario(
        horizon=2.0,
        team=Team(count=3),
        protocol={"kind": "local_min", "schedule": kind},
        announce=Announcements(trigger="revision", start="silent"),
        network=Links(latency=0.01),
        record=Recording(messages=True),
    )
    trace = run(scenario, 1).trace
    announced = Counter((event.created, event.src) for event in trace.of(Broadcast))
    decided = Counter((event.t, event.pursuer) for event in trace.of(Decided))
    assert announced >= decided
    assert len(decided) > 5


def test_a_share_q_of_the_rounds_of_each_is_a_revision():
    """4 pursuers, 2,000 rounds, q = 0.3: standard error sqrt(q (1 - q) / 8000) = 0.005; chances are independent."""
    made = decisions(Rounds(period=0.01, participation=0.3), 4, 20.005, seed=1)
    revised = np.zeros((2000, 4))
    for decision in made:
        assert decision.t % 10_000_000 == 0
        revised[decision.t // 10_000_000 - 1, decision.pursuer] = 1.0
    error = np.sqrt(0.3 * 0.7 / revised.size)
    assert revised.sum() == len(made)
    assert abs(revised.mean() - 0.3) < 4 * error
    assert abs(revised.mean() - 0.33) > 4 * error
    correlation = np.corrcoef(revised.T)[np.triu_indices(4, 1)]
    assert np.abs(correlation).max() < 4 / np.sqrt(2000)


# Periodic timers.


def ticks(schedule, count, horizon, seed=0):
    """Return the times of each pursuer's decisions, s."""
    times = {pursuer: [] for pursuer in range(count)}
    for decision in decisions(schedule, count, horizon, seed):
        times[decision.pursuer].append(decision.t / 1e9)
    return [np.array(each) for each in times.values()]


@pytest.mark.slow_but_one
@pytest.mark.parametrize("jitter", [0.1, 0.5, 0.99])
def test_waits_of_a_timer_are_uniform_about_the_period(jitter):
    """2,000 waits within 0.01 (1 -+ jitter) s, uniform (Kolmogorov and Smirnov, p > 0.001); their mean is a period.

    The control: a jitter that is a tenth greater is distinguished.
    """
    (times,) = ticks(Periodic(period=0.01, jitter=jitter), 1, 20.0, seed=2)
    waits = np.diff(times) / 0.01 - 1.0
    assert np.abs(waits).max() <= jitter + 1e-6
    assert abs(waits.mean()) < 4 * jitter / np.sqrt(3 * len(waits))
    assert kstest(waits, "uniform", (-jitter, 2 * jitter)).pvalue > 0.001
    assert kstest(waits, "uniform", (-1.1 * jitter, 2.2 * jitter)).pvalue < 0.001


def test_a_timer_without_jitter_is_strictly_periodic():
    for times in ticks(Periodic(period=0.1, jitter=0.0), 3, 10.0):
        assert len(times) >= 99
        assert np.diff(times) == pytest.approx(0.1, abs=1e-9)


@pytest.mark.slow
def test_timers_begin_at_random_phases():
    """200 phases are uniform in [0, period) (p > 0.001); the control, a third less, is distinguished."""
    first = np.array([times[0] for times in ticks(Periodic(period=0.5, jitter=0.5), 200, 0.75)])
    assert kstest(first / 0.5, "uniform").pvalue > 0.001
    assert kstest(first / 0.75, "uniform").pvalue < 0.001


@pytest.mark.parametrize(
    ("period", "jitter", "step", "warned"),
    [
        (0.02, 0.0, 0.01, True),
        (0.2, 0.0, 0.01, True),
        (0.2, 0.0, 0.1, True),
        (0.03, 0.0, 0.01, False),
        (0.3, 0.0, 0.1, False),
        (0.025, 0.0, 0.01, False),
        (0.01, 0.0, 0.02, False),
        (0.2, 0.01, 0.01, False),
        (0.2, 0.5, 0.01, False),
    ],
)
def test_a_strict_timer_with_an_even_number_of_steps_gives_a_warning(period, jitter, step, warned):
    protocol = SpatialAdaptivePlay(schedule=Periodic(period=period, jitter=jitter))
    found = dict(warnings(Scenario(protocol=protocol, motion=Motion(step=step))))
    assert [*found] == (["protocol.schedule.jitter"] if warned else [])
    if warned:
        assert f"{round(period / step)} motion steps" in found["protocol.schedule.jitter"]
