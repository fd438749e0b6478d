"""Who is found out, who is suspected falsely, and what lies cost, on traces made by hand and in runs."""

import pytest

from desim import Scenario, run, summary
from desim.analysis.deception import captures_lost, damage_per_liar, false_accusations, first_lies, time_to_detect
from desim.analysis.metrics import active_time, capture_time
from desim.kernel.core.events import MessageCounts, Trace
from desim.kernel.core.units import SECOND
from desim.kernel.models.faults import Crash
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted, Misbehaviour
from desim.pursuit.byzantine.lies import Liar, Silent
from desim.pursuit.core.events import Distrusted, Ended
from desim.pursuit.team.announcements import Announcements
from desim.pursuit.team.trust import Plausible
from desim.scenario.players import Team
from desim.simulation.run import Result
from protocols.local_min import LocalMin
from protocols.schedules.periodic import Poisson


def made(events):
    """Return a trace of given events."""
    trace = Trace()
    trace.events += events
    return trace


def lie(node, number=0):
    return Misbehaviour(node=node, start=0.0, model="liar", number=number)


def test_only_what_honest_pursuers_believe_counts():
    """2 lies from 1 s on, 3 from 2 s on; 0 suspects 2 at 1.5 s, and 1 falsely; 2 suspects 0; 1 suspects 3 too early."""
    s = SECOND
    trace = made(
        [
            FaultStarted(0, Crash(node=5, start=0.0)),
            FaultStarted(s, lie(2)),
            Distrusted(s, 2, 0, True),
            Distrusted(3 * s // 2, 0, 2, True),
            Distrusted(3 * s // 2, 0, 1, True),
            Distrusted(3 * s // 2, 1, 3, True),
            FaultStarted(2 * s, lie(3, 1)),
            FaultEnded(2 * s, lie(2)),
            FaultStarted(3 * s, lie(2, 2)),
            Distrusted(4 * s, 1, 2, True),
            Distrusted(4 * s, 0, 1, False),
            Distrusted(4 * s, 0, 3, True),
            MessageCounts(4 * s, 0, 0, 0, 0, {}, 0, 0, 0.0),
            Ended(4 * s, "horizon", None),
        ]
    )
    result = Result(Scenario(), 0, trace)
    assert first_lies(result) == {2: s, 3: 2 * s}
    assert false_accusations(result) == 2  # of 1 by 0, and of 3 by 1 before it lied
    assert time_to_detect(result) == pytest.approx((0.5 + 2.0) / 2)


def scenario(trust="none", *faults):
    return Scenario(
        team=Team(count=12, speeds=1.5, active_at_start=0.0),
        protocol=LocalMin(schedule=Poisson(rate=5.0)),
        announce=Announcements(payload="time", heartbeat=0.2, trust=trust),
        fault=faults,
    )


def test_a_run_without_lies_has_no_damage_of_them():
    with pytest.raises(ValueError, match="no pursuer has a Byzantine fault in the run with seed 3"):
        damage_per_liar(run(Scenario(horizon=0.1, team=Team(count=2)), 3), active_time)


@pytest.mark.slow
def test_damage_is_that_of_the_same_seed_without_lies():
    liars = [Liar(node=node, start=0.0, action="chase", phi=0.0, acts="stay") for node in (0, 1)]
    lying, honest = run(scenario("none", *liars), 3), run(scenario(), 3)
    assert captures_lost(lying) == 1
    assert damage_per_liar(lying, active_time) == (active_time(lying) - active_time(honest)) / 2
    with pytest.raises(ValueError, match="has no value in the run with seed 3"):
        damage_per_liar(lying, capture_time)
    with pytest.raises(ValueError, match="no pursuer has a Byzantine fault in the run with seed 3"):
        damage_per_liar(honest, active_time)


def test_a_crash_is_kept_in_the_honest_run():
    """It loses the chaser for ever: the honest run has lost it, too."""
    crash = Crash(node=4, start=0.0)
    assert captures_lost(run(scenario("none", crash, Silent(node=1, start=0.0)), 3)) == 0


@pytest.mark.slow
def test_the_metrics_are_those_of_a_team_that_checks():
    liar = Liar(node=0, start=0.0, action="chase", phi=0.0, acts="stay")
    found = summary(run(scenario(Plausible(), liar), 3))
    assert found.false_accusations == 0
    assert 0.0 < found.time_to_detect < 1.0
    assert summary(run(scenario("none", liar), 3)).time_to_detect is None
    assert summary(run(scenario(Plausible()), 3)).time_to_detect is None
