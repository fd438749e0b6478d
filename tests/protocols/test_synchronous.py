"""Simultaneous decisions, at the pace of another schedule."""

import pytest
from pydantic import ValidationError

from desim import Scenario, run
from desim.kernel.core.events import Sent
from desim.kernel.core.units import SECOND
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.pursuit.core.events import Decided
from desim.pursuit.game.game import relay_profile
from desim.scenario.assumptions import violations
from desim.scenario.players import Team
from desim.scenario.scenario import Motion, Recording
from desim.study.ablation.imperfections import without_serial_decisions
from protocols.best_response import BestResponse
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.mutex import LocalMutex
from protocols.schedules.periodic import Rounds, SharedSeed
from protocols.schedules.synchronous import Synchronous
from protocols.schedules.token import TokenRing, TokenWalk
from tests.test_protocols import outcome

SLOT = 0.25
"""s"""


def frozen(schedule, count=6, rule=BestResponse, latency=0.0):
    """Return a game of t = 0 that is negotiated for 3 s."""
    return Scenario(
        horizon=3.0,
        team=Team(count=count, speeds=2.0),
        motion=Motion(static=True),
        protocol=rule(schedule=schedule),
        network=Links(latency=Constant(value=latency)),
        record=Recording(messages=True),
    )


def decisions(schedule, **options):
    """Return the decisions (pursuer and time, s) in order."""
    result = run(frozen(schedule, **options), 4)
    return [(event.t / SECOND, event.pursuer) for event in result.trace.of(Decided)]


def in_rounds(period, count=6, horizon=3.0):
    """Return the decisions of all at each multiple of a period (s) before the horizon, s."""
    rounds = round(horizon / period)
    return [(pytest.approx(period * k), i) for k in range(1, rounds) for i in range(count)]


@pytest.mark.parametrize(
    ("other", "latency"),
    [
        (SharedSeed(slot=SLOT), 0.0),
        (SharedSeed(slot=SLOT), 0.1),
        (TokenRing(holding_time=SLOT), 0.0),
        (TokenRing(holding_time=0.15), 0.1),
        (TokenWalk(holding_time=0.15), 0.1),
    ],
    ids=lambda each: getattr(each, "kind", each),
)
def test_all_six_decide_in_each_slot_of_the_team(other, latency):
    """At 0.25, 0.5, ..., 2.75 s, and 3 s is the end; a token is passed on every hold + L = 0.15 + 0.1 s."""
    assert decisions(Synchronous(schedule=other), latency=latency) == in_rounds(SLOT)


@pytest.mark.parametrize("other", [SharedSeed(slot=SLOT), TokenRing(holding_time=SLOT), TokenWalk(holding_time=SLOT)])
def test_each_decides_as_often_as_all_did_taking_turns(other):
    """In the same slots, six for one."""
    alone, together = decisions(other), decisions(Synchronous(schedule=other))
    assert [t for t, _ in alone] == pytest.approx([SLOT * k for k in range(1, 12)])
    assert [t for t, _ in together] == pytest.approx([t for t, _ in alone for _ in range(6)])


def test_it_is_rounds_of_that_period():
    assert decisions(Synchronous(schedule=SharedSeed(slot=SLOT))) == decisions(Rounds(period=SLOT))
    assert decisions(Synchronous(schedule=SharedSeed(slot=SLOT))) != decisions(Rounds(period=2 * SLOT))


@pytest.mark.slow
def test_no_token_is_sent():
    """Announcements are broadcast, tokens and receipts are sent."""
    ring = TokenRing(holding_time=SLOT)
    assert run(frozen(ring), 1).trace.of(Sent)
    assert not run(frozen(Synchronous(schedule=ring)), 1).trace.of(Sent)


def test_temperatures_go_by_the_slot_of_the_other_schedule():
    """So what differs from the other schedule is the deciding pursuers, not the temperature; rounds of their own cool 6
    times as fast, for they count 6 slots per round.
    """

    class Slots(BestResponse):
        def actions(self, me):
            while True:
                seen.append(self.schedule.mean_slot(me))
                yield 0

    seen = []
    run(frozen(Synchronous(schedule=SharedSeed(slot=0.5)), rule=Slots), 1)
    assert set(seen) == {0.5}
    seen.clear()
    run(frozen(Synchronous(schedule=TokenRing(holding_time=0.4)), rule=Slots, latency=0.1), 1)
    assert seen == [pytest.approx(0.5)] * len(seen) != []
    seen.clear()
    run(frozen(Rounds(period=SLOT), rule=Slots), 1)
    assert set(seen) == {SLOT / 6}


@pytest.mark.parametrize("latency", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(6))
def test_all_at_once_end_in_the_relay_profile_too(seed, latency):
    """The game is dominance solvable: every pursuer that should leave, leaves in any order (Nisan, Schapira & Zohar
    2008).
    """
    case = frozen(Synchronous(schedule=SharedSeed(slot=SLOT)), latency=latency).model_copy(update={"seed": seed})
    profile, phi = outcome(case, case.protocol.kind)
    assert profile == relay_profile(phi, 3.0)


@pytest.mark.parametrize(
    "other", [SharedSeed(slot=SLOT), TokenRing(holding_time=0.2, attempts=3), TokenWalk(holding_time=0.2)]
)
def test_it_takes_a_schedule_with_slots_also_from_a_file(other):
    scenario = Scenario(protocol=SpatialAdaptivePlay(schedule=Synchronous(schedule=other)))
    assert Scenario.model_validate(scenario.plain()) == scenario


@pytest.mark.parametrize("kind", ["poisson", "rounds", "periodic", "local_mutex", "synchronous", "no_such"])
def test_a_file_cannot_have_one_without_slots(kind):
    """A slot that is an average of independent clocks has no owner, and all at once are so already."""
    with pytest.raises(ValidationError, match="'shared_seed', 'token_ring', 'token_walk'"):
        Synchronous.model_validate({"kind": "synchronous", "schedule": {"kind": kind}})


def test_it_needs_equal_clocks_and_is_not_one_at_a_time():
    """What rules assume that settle only if pursuers decide one by one."""

    class Alone(BestResponse):
        assumes = ("one_at_a_time",)

    skewed = frozen(Synchronous(), rule=Alone).model_copy(update={"fault": (ClockSkew(offset=0.1),)})
    assert dict(violations(skewed)) == {
        "protocol": f"{skewed.protocol.kind} assumes one_at_a_time, but several pursuers may decide at the same"
        " instant",
        "protocol.schedule": "synchronous assumes equal_clocks, but clocks differ",
    }
    assert not dict(violations(frozen(SharedSeed(), rule=Alone)))


@pytest.mark.parametrize("other", [SharedSeed(slot=SLOT), TokenRing(holding_time=0.2), TokenWalk(holding_time=0.2)])
def test_it_replaces_schedules_with_slots_when_turns_are_removed(other):
    scenario = Scenario(protocol=SpatialAdaptivePlay(schedule=other))
    assert without_serial_decisions(scenario).protocol == SpatialAdaptivePlay(schedule=Synchronous(schedule=other))
    assert without_serial_decisions(without_serial_decisions(scenario)) == without_serial_decisions(scenario)


@pytest.mark.slow
def test_without_turns_local_mutex_decides_by_its_clocks_and_sends_no_requests():
    """At 6 x 3 = 18 decisions per second, of which 54 +- 3 x 7.3 are expected in 3 s; and no requests are sent."""
    free = without_serial_decisions(frozen(LocalMutex(rate=3.0)))
    result = run(free, 4)
    assert not result.trace.of(Sent)
    assert 32 <= len(result.trace.of(Decided)) <= 76
    assert run(frozen(LocalMutex(rate=3.0)), 4).trace.of(Sent)
