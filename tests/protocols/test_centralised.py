"""The centralised benchmark."""

import pytest

from desim import Scenario, run, summary
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.faults import Crash
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.core.events import Decided
from desim.pursuit.game.game import greedy_assignment, optimal_assignment
from desim.scenario.players import Evader, Team
from protocols.centralised import Centralised
from tests.many import at_rest, by_evader, chased, times


@pytest.mark.slow
def test_exactly_one_pursuer_chases_at_any_time_whatever_the_start():
    for p0 in (0.0, 0.5, 1.0):
        for seed in range(4):
            numbers = summary(run(Scenario(team=Team(active_at_start=p0), protocol=Centralised()), seed))
            assert numbers.captured
            assert numbers.idle_time == numbers.crowded_time == 0.0
            assert numbers.active_time == numbers.capture_time
            assert numbers.messages_sent == 0


def test_the_network_does_not_matter_to_it():
    ideal, deaf = (
        run(Scenario(protocol=Centralised(), network=Links(loss=Bernoulli(p=p))), 3).trace.of(Decided)
        for p in (0.0, 1.0)
    )
    assert ideal == deaf


@pytest.mark.slow_but_one
@pytest.mark.parametrize("skew", [{"offset": 29.0}, {"offset": -3.0}, {"drift": 50.0}])
def test_the_clock_of_the_pursuer_that_runs_it_does_not_matter_to_it(skew):
    right, skewed = (
        run(Scenario(protocol=Centralised(), fault=fault), 3).trace.of(Decided)
        for fault in ((), (ClockSkew(node=0, **skew),))
    )
    assert right
    assert skewed == right


@pytest.mark.parametrize("count", [2, 5])
def test_several_evaders_are_assigned_as_is_best(count):
    """Six games of four at rest, with fewer evaders or more; at least one is not the greedy assignment."""
    other = 0
    for seed in range(6):
        result = run(at_rest(Centralised(slot=1.0), 4, count, seed, horizon=15.0))
        phi = times(result)
        assert chased(result) == optimal_assignment(phi, 15.0)
        assert chased(result, 0.0) == chased(result)
        other += chased(result) != greedy_assignment(by_evader(phi), 15.0)
    assert other > 0


def test_a_broken_down_pursuer_is_assigned_no_evader():
    """Pursuers at 0 and 2 m, evaders at 1 and 5 m: as 0 breaks down 1 leaves the second evader for the first."""
    scenario = at_rest(
        Centralised(slot=0.5),
        2,
        2,
        team=Team(positions=[(0.0, 0.0), (2.0, 0.0)], speeds=1.0),
        evader=tuple(Evader(position=(x, 0.0), speed=0.0) for x in (1.0, 5.0)),
        fault=(Crash(node=0, start=1.0),),
    )
    assert chased(run(scenario), 0.9) == {0: 1, 1: 2}
    assert chased(run(scenario)) == {1: 1}


@pytest.mark.slow
def test_a_pursuer_that_would_be_late_is_assigned_no_evader():
    """phi = (5 - 0.1) / 0.1 = 49 s, and 30 s are left."""
    scenario = Scenario(
        team=Team(positions=[(0.0, 0.0), (0.0, 0.1)], speeds=1.0),
        evader=Evader(position=(5.0, 0.0)),
        protocol=Centralised(),
    )
    assert summary(run(scenario)).active_time == 0.0
