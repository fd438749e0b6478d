"""Everybody at once, at the pace of another schedule."""

import pytest

from desim import Scenario, run
from desim.kernel.clock import SECOND
from desim.kernel.latency import Constant
from desim.kernel.links import Links
from desim.pursuit.events import Decided
from desim.pursuit.game import relay_profile
from desim.scenario import Motion, Team
from desim.study.imperfections import without_turns
from protocols.best_response import BestResponse
from protocols.mutex import LocalMutex
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules import Poisson, Rounds, SharedSeed
from protocols.together import Together
from tests.test_protocols import outcome

SLOT = 0.25
"""s"""


def frozen(schedule, count=6, rule=BestResponse, latency=0.0):
    """Return a game of t = 0 that is negotiated for 3 s."""
    return Scenario(
        horizon=3.0,
        team=Team(count=count, speeds=2.0),
        motion=Motion(frozen=True),
        protocol=rule(schedule=schedule),
        network=Links(latency=Constant(value=latency)),
    )


def decisions(schedule, **options):
    """Return who decides when, s, in the order in which they do."""
    result = run(frozen(schedule, **options), 4)
    return [(event.t / SECOND, event.pursuer) for event in result.trace.of(Decided)]


@pytest.mark.parametrize("other", [SharedSeed(slot=SLOT), Poisson(rate=1.0 / (6 * SLOT))], ids=["slots", "clocks"])
def test_all_six_decide_in_each_slot_of_the_team(other):
    """1 / (N rate) = 0.25 s for both: at 0.25, 0.5, ..., 2.75 s, and 3 s is the end."""
    assert decisions(Together(of=other)) == [(SLOT * k, i) for k in range(1, 12) for i in range(6)]


def test_it_is_rounds_of_that_period():
    assert decisions(Together(of=SharedSeed(slot=SLOT))) == decisions(Rounds(period=SLOT))
    assert decisions(Together(of=SharedSeed(slot=SLOT))) != decisions(Rounds(period=2 * SLOT))


def test_temperatures_go_by_the_slot_of_the_other_schedule():
    """So what differs from the other schedule is who decides, not how warm it is; rounds of their own cool 6 times as
    fast, for they count 6 slots per round."""

    class Slots(BestResponse):
        def actions(self, me):
            while True:
                seen.append(self.schedule.mean_slot(me))
                yield 0

    seen = []
    run(frozen(Together(of=Poisson(rate=2.0)), rule=Slots), 1)
    assert set(seen) == {1.0 / 12.0}
    seen.clear()
    run(frozen(Rounds(period=SLOT), rule=Slots), 1)
    assert set(seen) == {SLOT / 6}


@pytest.mark.parametrize("latency", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(6))
def test_all_at_once_end_in_the_relay_profile_too(seed, latency):
    """The game is dominance solvable: who should leave, leaves in whatever order (Nisan, Schapira & Zohar 2008)."""
    profile, phi = outcome(run(frozen(Together(of=SharedSeed(slot=SLOT)), latency=latency), seed))
    assert profile == relay_profile(phi, 3.0)


def test_turns_are_replaced_by_rounds_of_the_same_slot():
    schedule = LocalMutex(rate=3.0)
    scenario = Scenario(protocol=SpatialAdaptivePlay(schedule=schedule))
    assert without_turns(scenario).protocol == SpatialAdaptivePlay(schedule=Together(of=schedule))
    assert without_turns(without_turns(scenario)) == without_turns(scenario)
