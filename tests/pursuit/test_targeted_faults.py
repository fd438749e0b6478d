"""Faults that look at the run concern whoever chases when they begin."""

import pytest

from desim import Announcements, Links, Scenario, Team, judge, load, run
from desim.analysis.metrics import active_time
from desim.kernel.core.events import Lost
from desim.kernel.models.faults import Crash, CustomFault, FaultEnded, FaultStarted, Partition
from desim.pursuit.core.events import Decided
from desim.pursuit.team.targeted_faults import ChaserCrash, ChaserCut
from desim.scenario.scenario import Recording
from scenarios.studies.study import SCENARIOS

GAME = Scenario(
    team=Team(count=5),
    announce=Announcements(heartbeat=0.34),
    network=Links(latency=0.1),
    record=Recording(messages=True),
)
"""One pursuer chases after a second; with seed 3 it is the last one, which is the fastest."""
FIXED = {
    ChaserCrash: lambda nodes: [Crash(start=2.0, end=4.0, node=node) for node in nodes],
    ChaserCut: lambda nodes: [Partition(start=2.0, end=4.0, groups=tuple((node,) for node in nodes))],
}


def events(fault, **more):
    scenario = GAME.model_copy(update={"fault": tuple(fault), **more})
    return [event for event in run(scenario, 3).trace if not is_target(event)]


def is_target(event):
    return isinstance(event, FaultStarted | FaultEnded) and isinstance(event.fault, CustomFault)


@pytest.mark.parametrize("kind", FIXED)
def test_the_run_is_that_of_a_fault_of_the_pursuer_that_chases(kind):
    targeted = events([kind(start=2.0, end=4.0)])
    assert targeted == events(FIXED[kind]([4]))
    assert targeted != events(FIXED[kind]([3]))


@pytest.mark.parametrize("kind", FIXED)
def test_several_chasers_are_taken_in_the_order_of_their_capture_times(kind):
    """At the start all chase: the fastest of all would capture first."""
    (fault,) = (kind(start=0.05, end=1.0, chasers=2),)
    begun = [event.fault for event in run(GAME.model_copy(update={"fault": (fault,)}), 3).trace.of(FaultStarted)]
    parts = [part for part in begun if not isinstance(part, CustomFault)]
    nodes = [node for part in parts for named in part.named().values() for node in named]
    assert (len(nodes), nodes[0]) == (2, 4)


@pytest.mark.parametrize("kind", FIXED)
def test_without_a_chaser_nothing_happens(kind):
    idle = {"protocol": lambda me: iter(()), "team": Team(count=5, active_at_start=0.0)}
    assert events([kind(start=2.0, end=4.0)], **idle) == events([], **idle)


def test_a_chaser_that_is_cut_off_goes_on_and_hears_nothing():
    result = run(GAME.model_copy(update={"fault": (ChaserCut(start=2.0, end=4.0),)}), 3)
    lost = [event for event in result.trace.of(Lost) if event.cause == "partition"]
    assert lost
    assert all(4 in (event.src, event.dst) for event in lost)
    assert {event.pursuer for event in result.trace.of(Decided) if 2e9 < event.t < 4e9} >= {4}
    assert active_time(result) > 5.0


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["sap", "best_response", "cbaa", "cbba"])
def test_the_crash_of_the_chaser_leaves_teams_idle_that_believe_it_to_chase(protocol):
    """The evader runs from slow pursuers until the belief times out, and then none can be in time.

    The controls: `centralised` chases on, and the crash of a pursuer that does not chase harms nobody.
    """
    game = GAME.with_({"protocol": protocol, "record.messages": False})
    prop = "idle at most 2 in total against centralised"
    crash, other = ChaserCrash(start=0.6), Crash(start=0.6, node=1)
    margins = [judge(prop, run(game.model_copy(update={"fault": (fault,)}), 4)).margin for fault in (crash, other)]
    assert margins[0] < -20.0
    assert margins[1] >= 0.0


def test_they_are_kinds_of_a_scenario_file():
    faults = load(SCENARIOS / "properties.toml").fault
    assert [type(fault) for fault in faults] == [ChaserCrash, ChaserCut]
    with pytest.raises(ValueError, match="chasers: should be greater than or equal to 1"):
        ChaserCrash(start=1.0, chasers=0)
