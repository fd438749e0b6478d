"""Schedules: when each pursuer revises."""

from collections import Counter
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from desim import Scenario, run
from desim.kernel.seeds import stream
from desim.pursuit.events import Decided
from desim.scenario import Motion, Team
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules import Poisson, SharedSeed, owned_slots


def decisions(schedule, count, horizon, seed=0):
    """Return the decisions of a frozen game under a schedule."""
    scenario = Scenario(
        horizon=horizon,
        team=Team(count=count),
        motion=Motion(frozen=True),
        protocol=SpatialAdaptivePlay(schedule=schedule),
        record={"trajectory": 0.0},
    )
    return run(scenario, seed).trace.of(Decided)


def test_every_slot_belongs_to_exactly_one_pursuer():
    """Over three blocks of 4096 slots the owners partition 1, 2, ..., whoever asks."""
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


def test_poisson_waits_are_exponential():
    """Mean and standard deviation of the waits of a pursuer are both 1/rate; n = 4,000, standard error 1/sqrt(n)."""
    waits = np.diff([d.t for d in decisions(Poisson(rate=100.0), 1, 40.0, seed=5)]) / 1e9 * 100.0
    error = 1 / np.sqrt(len(waits))
    assert abs(waits.mean() - 1) < 5 * error
    assert abs(waits.std() - 1) < 5 * np.sqrt(2) * error  # the standard deviation of an exponential is less certain
    assert abs(np.corrcoef(waits[1:], waits[:-1])[0, 1]) < 5 * error


def test_the_mean_slot_is_the_time_between_two_decisions_of_the_team():
    for schedule in (SharedSeed(slot=0.004), Poisson(rate=50.0)):
        made = len(decisions(schedule, 5, 40.0))
        assert schedule.mean_slot(SimpleNamespace(team_size=5)) == pytest.approx(0.004)
        assert made == pytest.approx(10_000, abs=5 * np.sqrt(10_000))
