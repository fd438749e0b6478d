"""The watchers of a pursuit: they let right ones pass, and notice each kind of wrong one."""

from contextlib import nullcontext
from pkgutil import resolve_name

import numpy as np
import pytest

from desim import Scenario, run
from desim.kernel.core.units import SECOND
from desim.kernel.models.faults import Crash
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Sampled, Started
from desim.pursuit.evaders.evader import EvaderBody
from desim.pursuit.game.utility import EdgePenalty
from desim.pursuit.motion.dynamics import DYNAMICS, Acceleration, TurnRate, coasts
from desim.pursuit.motion.guidance import apollonius_disc
from desim.pursuit.motion.kinematics import Kinematics
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion, Recording
from desim.simulation.run import Result
from desim.simulation.steering import Steering
from desim.simulation.world import World
from desim.testing.pursuits import (
    ActiveTimeWatcher,
    ApolloniusWatcher,
    InertiaWatcher,
    MotionWatcher,
    PotentialWatcher,
    watched,
)
from protocols.best_response import BestResponse
from protocols.regret_matching import RegretMatching
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Periodic, Poisson, Rounds
from protocols.temperature import ConstantTau

S = SECOND


def started(*active, pursuers=((0.0, 0.0), (4.0, 0.0)), evader=(2.0, 0.0), others=()):
    """Two pursuers of 1 and 2 m/s."""
    return Started(0, (evader, *others), pursuers, (1.0, 2.0), active)


def sampled(t, *pursuers, evader=(2.0, 0.0), others=()):
    return Sampled(round(t * S), (evader, *others), pursuers)


def show(watcher, *events):
    for event in events:
        watcher(event)


# Active time.


@pytest.mark.parametrize(
    ("events", "own"),
    [
        ([started(True, False)], (3.0, 0.0)),
        ([started(1, 0), Decided(1 * S, 0, False), Decided(2 * S, 1, True)], (1.0, 1.0)),
        ([started(1, 0), Decided(1 * S, 0, True), Decided(2 * S, 0, False), Decided(2 * S, 0, False)], (2.0, 0.0)),
        ([started(1, 0), BrokeDown(1 * S, 0)], (1.0, 0.0)),
        ([started(1, 2), Captured(1 * S, 2, 1)], (3.0, 1.0)),
        ([started(1, 2), Decided(1 * S, 0, 2), Captured(2 * S, 2, 1), Decided(2 * S, 1, 1)], (2.0, 3.0)),
    ],
)
def test_stopwatches_run_while_pursuers_are_active(events, own):
    watcher = ActiveTimeWatcher()
    assert watcher.end == 0
    show(watcher, *events)
    assert watcher.until(3 * S).tolist() == [round(each * S) for each in own]


def breakdown(*watchers):
    """Return a run of a few seconds in which an active pursuer breaks down after 0.3 s, and obeys from 0.7 s on."""
    scenario = Scenario(
        horizon=5.0,
        team=Team(positions=((0.0, 0.0), (9.0, 0.0)), speeds=2.0),
        evader=Evader(position=(4.0, 0.0), speed=0.5),
        protocol=BestResponse(schedule=Periodic(period=0.1)),
        fault=(Crash(node=0, start=0.3, end=0.7),),
    )
    return watched(scenario, 0, *watchers)


def test_the_metrics_are_the_integrals_of_the_trace():
    watcher = ActiveTimeWatcher()
    watcher.judge(breakdown(watcher))
    assert watcher.until(watcher.end).sum() / S > 2.0


@pytest.mark.parametrize(("kind", "words"), [(BrokeDown, "active time"), (Decided, "active time"), (Started, "energy")])
def test_a_trace_with_missing_or_wrong_events_is_detected(kind, words):
    """Without the breakdown or the decisions, or with other speeds."""
    watcher = ActiveTimeWatcher()
    result = breakdown(watcher)
    first, *rest = result.trace.events
    if kind is Started:
        result.trace.events = [first._replace(speeds=(2.0 + 1e-6, 2.0)), *rest]
    else:
        result.trace.events = [first, *(event for event in rest if not isinstance(event, kind))]
    with pytest.raises(AssertionError, match=f"the {words} of the metric, .*, differs from that of the stopwatches, "):
        watcher.judge(Result(result.scenario, result.seed, result.trace))


@pytest.mark.own_trace
@pytest.mark.parametrize(
    ("name", "wrong", "words"),
    [
        ("desim.testing.pursuits.active_time", lambda right: lambda result: right(result) + 1e-6, "active time"),
        ("desim.testing.pursuits.energy", lambda right: lambda result: right(result) * 1.001, "energy"),
        ("desim.kernel.network.Network.message_counts", lambda right: lambda net: right(net)._replace(sent=0), "sent"),
        ("desim.simulation.world.Steering.redirect", lambda right: lambda *order: None, "no player exceeds its speed"),
    ],
)
def test_a_watched_run_is_checked_against_all_invariants(name, wrong, words, monkeypatch):
    breakdown()
    monkeypatch.setattr(name, wrong(resolve_name(name)))
    with pytest.raises(AssertionError, match=words):
        breakdown()


# Motion.

GAME = Scenario(
    team=Team(positions=((0.0, 0.0), (4.0, 0.0)), speeds=(1.0, 2.0)), evader=Evader(position=(2.0, 0.0), speed=0.5)
)
RIGHT = {
    "nobody moves": [started(0, 0), sampled(1.0, (0.0, 0.0), (4.0, 0.0))],
    "as fast as it can": [started(1, 1), sampled(0.5, (0.5, 0.0), (4.0, 1.0), evader=(2.25, 0.0))],
    "half of the time": [started(0, 0), Decided(S // 2, 0, True), sampled(1.0, (0.5, 0.0), (4.0, 0.0))],
    "until it breaks down": [started(1, 0), BrokeDown(S // 4, 0), sampled(1.0, (0.0, -0.25), (4.0, 0.0))],
    "two samples at once": [started(0, 0), *[sampled(1.0, (0.0, 0.0), (4.0, 0.0))] * 2],
    "several evaders": [
        started(1, 2, others=[(3.0, 0.0)]),
        sampled(1.0, (1.0, 0.0), (3.0, 0.0), others=[(3.2, 0.0)]),
        Captured(S, 2, 1),
        sampled(2.0, (2.0, 0.0), (3.0, 0.0), others=[(3.2, 0.0)]),
    ],
}
WRONG = {
    "who stays moves": ("player 0", [started(0, 0), sampled(1.0, (1e-6, 0.0), (4.0, 0.0))]),
    "faster than it can": ("player 1", [started(1, 1), sampled(0.5, (0.0, 0.0), (4.0, 1.0 + 1e-6))]),
    "longer than it was active": (
        "player 0",
        [started(0, 0), Decided(S // 2, 0, True), sampled(1.0, (0.51, 0.0), (4.0, 0.0))],
    ),
    "broken and moving": ("player 0", [started(1, 0), BrokeDown(S // 4, 0), sampled(1.0, (0.3, 0.0), (4.0, 0.0))]),
    "a jump": ("player 1", [started(1, 1), sampled(0.0, (0.0, 0.0), (5.0, 0.0))]),
    "nowhere": ("player 0", [started(1, 1), sampled(1.0, (np.nan, 0.0), (4.0, 0.0))]),
    "an evader too fast": ("player 2", [started(0, 0), sampled(1.0, (0.0, 0.0), (4.0, 0.0), evader=(2.0, 0.501))]),
    "another evader too fast": (
        "player 3",
        [started(0, 0, others=[(3.0, 0.0)]), sampled(1.0, (0.0, 0.0), (4.0, 0.0), others=[(3.0, 0.26)])],
    ),
    "captured and moving": (
        "player 3",
        [
            started(0, 0, others=[(3.0, 0.0)]),
            Captured(S // 2, 2, 1),
            sampled(1.0, (0.0, 0.0), (4.0, 0.0), others=[(3.2, 0.0)]),
        ],
    ),
    "its capturer goes on": (
        "player 1",
        [
            started(1, 2, others=[(3.0, 0.0)]),
            Captured(S // 2, 2, 1),
            sampled(1.0, (0.0, 0.0), (2.9, 0.0), others=[(3.0, 0.0)]),
        ],
    ),
}


def game_of(events):
    """Return the scenario of a history: there may be another evader, of 0.25 m/s."""
    other = Evader(position=(3.0, 0.0), speed=0.25)
    several = {"evader": (GAME.evader, other)} if len(events[0].evaders) > 1 else {}
    return GAME.model_copy(update=several)


@pytest.mark.parametrize("events", RIGHT.values(), ids=RIGHT)
def test_correct_motion_passes(events):
    show(MotionWatcher(game_of(events)), *events)


@pytest.mark.parametrize(("words", "events"), WRONG.values(), ids=WRONG)
def test_incorrect_motion_is_detected(words, events):
    with pytest.raises(AssertionError, match=f"no player exceeds its speed.*{words}"):
        show(MotionWatcher(game_of(events)), *events)


def test_in_a_static_game_no_player_moves():
    watcher = MotionWatcher(GAME.model_copy(update={"motion": Motion(static=True)}))
    show(watcher, started(1, 1), sampled(1.0, (0.0, 0.0), (4.0, 0.0)))
    with pytest.raises(AssertionError, match="player 0"):
        watcher(sampled(2.0, (0.1, 0.0), (4.0, 0.0)))


def hurried(choose_velocity):
    return lambda self, state, *, handover: 1.001 * choose_velocity(self, state, handover=handover)


def leaping(command):
    def leap(self, velocities, drifts=None):
        command(self, velocities, drifts)
        self._origins = self._origins + 1e-6

    return leap


def deaf(_):
    return lambda self, pursuer, now, until: None


def inert(_):
    """A breakdown that is recorded, and stops no pursuer."""

    def crash(self, pursuer):
        self._trace.append(BrokeDown(self._env.now, pursuer))

    return crash


@pytest.mark.parametrize(
    ("owner", "method", "break_it"),
    [
        (EvaderBody, "choose_velocity", hurried),
        (Kinematics, "command", leaping),
        (Steering, "redirect", deaf),
        (World, "crash", inert),
    ],
)
def test_a_world_that_moves_players_wrongly_is_detected(owner, method, break_it, monkeypatch):
    """The evader is 0.1 % too fast, all jump by 1 um, actions wait for a step, or a broken down pursuer goes on."""
    breakdown()
    monkeypatch.setattr(owner, method, break_it(getattr(owner, method)))
    with pytest.raises(AssertionError, match="no player exceeds its speed"):
        breakdown()


# Inertia.

LIMITED = [Acceleration(limit=0.7), TurnRate(limit=0.9)]
NAMES = ["acceleration", "turn rate"]


def with_inertia(dynamics, evader=None):
    """Return the game with inertia of the pursuers, or of the evader."""
    team = GAME.team if evader else GAME.team.model_copy(update={"dynamics": dynamics})
    return GAME.model_copy(
        update={"team": team, "evader": GAME.evader.model_copy(update={"dynamics": evader} if evader else {})}
    )


def parabola(acceleration, *times):
    """Return samples of pursuer 0 from rest, and of pursuer 1 at rest."""
    return [started(1, 1), *(sampled(t, (0.5 * acceleration * t * t, 0.0), (4.0, 0.0)) for t in times)]


def arc(rate, *times):
    """Return samples of pursuer 1 at 2 m/s on a circle through (4, 0), and of pursuer 0 at rest."""
    places = [4.0 + 2.0 / (1j * rate) * (np.exp(1j * rate * t) - 1.0) for t in times]
    samples = [sampled(t, (0.0, 0.0), (z.real, z.imag)) for t, z in zip(times, places, strict=True)]
    return [started(1, 1), *samples]


@pytest.mark.parametrize(
    ("scenario", "motion", "player"),
    [
        (with_inertia(Acceleration(limit=0.7)), lambda share: parabola(0.7 * share, 0.1, 0.2, 0.3), 0),
        (with_inertia(TurnRate(limit=0.9)), lambda share: arc(0.9 * share, 0.05, 0.1, 0.15), 1),
        (with_inertia(TurnRate(limit=0.9)), lambda share: arc(-0.9 * share, 0.05, 0.08, 0.13), 1),
        (
            with_inertia(None, evader=Acceleration(limit=0.7)),
            lambda share: [
                started(0, 0),
                *(sampled(t, (0.0, 0.0), (4.0, 0.0), evader=(2.0 + 0.35 * share * t * t, 0.0)) for t in (0.1, 0.2)),
            ],
            2,
        ),
    ],
    ids=["acceleration", "turn rate to the left", "turn rate to the right", "evader"],
)
def test_a_limit_that_is_exceeded_by_one_percent_is_detected(scenario, motion, player):
    """At the limit it passes; a player without a limit may do anything."""
    right = InertiaWatcher(scenario)
    show(right, *motion(1.0))
    assert right.judged >= 1
    show(InertiaWatcher(GAME), *motion(1.5))
    with pytest.raises(AssertionError, match=f"no player exceeds its (acceleration|turn rate): player {player}"):
        show(InertiaWatcher(scenario), *motion(1.01))


@pytest.mark.slow
@pytest.mark.parametrize("dynamics", LIMITED, ids=NAMES)
@pytest.mark.parametrize("evades", [False, True])
def test_a_world_that_exceeds_a_limit_by_one_percent_is_detected(dynamics, evades):
    """The players have a limit 1 % above that of the scenario that is watched; nothing else is wrong."""
    agile = dynamics.model_copy(update={"limit": 1.01 * dynamics.limit})
    calm, lively = (
        Scenario(
            horizon=6.0,
            team=Team(count=6) if evades else Team(count=6, dynamics=each),
            evader=Evader(dynamics=each) if evades else Evader(),
            record=Recording(trajectory=0.02),
        )
        for each in (dynamics, agile)
    )
    watched(lively, 1, MotionWatcher(calm))
    inertia = InertiaWatcher(calm)
    watched(calm, 1, inertia)
    assert inertia.judged > 10
    with pytest.raises(AssertionError, match="no player exceeds its"):
        run(lively, 1, InertiaWatcher(calm))


def test_a_robot_that_brakes_moves_while_it_is_inactive():
    """With a limited acceleration up to its speed, with any other motion not at all."""
    events = [started(1, 0), sampled(0.1, (0.1, 0.0), (4.0, 0.0)), Decided(S // 10, 0, 0)]
    braking = with_inertia(Acceleration(limit=10.0))
    show(MotionWatcher(braking), *events, sampled(0.2, (0.15, 0.0), (4.0, 0.0)))
    for scenario, place in ((GAME, 0.15), (with_inertia(TurnRate()), 0.15), (braking, 0.21)):
        with pytest.raises(AssertionError, match=r"no player exceeds its speed.*player 0"):
            show(MotionWatcher(scenario), *events, sampled(0.2, (place, 0.0), (4.0, 0.0)))


class Delegating:
    """Dynamics of a user that move as others do, times a factor, and say nothing about themselves."""

    is_simple = False

    def __init__(self, inner, factor=1.0):
        self.inner, self.factor = inner, factor
        self.headings, self.steered, self.capture_times = inner.headings, inner.steered, inner.capture_times

    def __call__(self, position, course, command):
        return self.inner(position, course, command * self.factor)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("kind", DYNAMICS.choices())
def test_dynamics_of_a_user_are_watched_as_those_that_they_delegate_to(kind):
    """They raise no false alarm when they coast, and are caught when they are too fast."""
    dynamics = DYNAMICS.choice(kind)()
    given = {"horizon": 3.0, "record": Recording(trajectory=0.05), "protocol": BestResponse(schedule=Poisson(rate=5.0))}
    right, wrong = (
        Scenario(
            team=Team(count=6, dynamics=Delegating(dynamics, factor)),
            evader=Evader(dynamics=Delegating(dynamics, factor)),
            **given,
        )
        for factor in (1.0, 1.3)
    )
    assert coasts(right.team.dynamics) == coasts(dynamics) == (kind == "acceleration")
    watched(right, 1)
    with pytest.raises(AssertionError, match="no player exceeds its speed"):
        watched(wrong, 1)


def test_dynamics_of_a_user_that_say_what_they_limit_are_compared_with_it():
    class Declared(Delegating):
        limits, limit = "acceleration", 0.7

    scenario = with_inertia(Declared(Acceleration()))
    show(InertiaWatcher(scenario), *parabola(0.7, 0.1, 0.2, 0.3))
    with pytest.raises(AssertionError, match="no player exceeds its acceleration"):
        show(InertiaWatcher(scenario), *parabola(0.71, 0.1, 0.2, 0.3))


# Potential.

SURE = ConstantTau(value=1e-12)
FROZEN = Motion(static=True)


def decide(*decisions, active=(1, 1), motion=FROZEN, sample=None):
    """Show decisions (t, pursuer, action), and perhaps a sample, to a watcher; return how many it judged.

    The game has r = 30 s at first, and phi = (0.5 / 0.5, 2.8 / 1.5) s.
    """
    begin = started(*active, pursuers=((0.4, 0.0), (3.9, 0.0)), evader=(1.0, 0.0))
    watcher = PotentialWatcher(GAME.model_copy(update={"motion": motion}))
    show(watcher, begin, *(Decided(round(t * S), pursuer, action) for t, pursuer, action in decisions))
    show(watcher, *([sample] if sample else []))
    return watcher.judged


def test_decisions_that_raise_the_potential_or_leave_it_pass():
    """Phi is 30 s less the mean of 1 and 2.8 / 1.5 s, or less 1 s; 0 if no pursuer chases."""
    assert decide((1, 1, 0), (1, 1, 0), (2, 0, 1), active=(1, 1)) == 3
    assert decide((1, 1, 1), (1, 0, 1), (2, 1, 0), active=(0, 0)) == 3


@pytest.mark.parametrize(
    ("active", "decision", "fall"),
    [((1, 1), (1, 0, 0), 0.433333), ((1, 0), (1, 1, 1), 0.433333), ((1, 0), (1, 0, 0), 29.0)],
)
def test_a_decision_that_lowers_the_potential_is_detected(active, decision, fall):
    """phi = (1, 2.8 / 1.5) s: the mean of both is 13/30 s more than the least and less than the greatest."""
    with pytest.raises(AssertionError, match=f"no decision lowers the potential: Decided.*by {str(fall)[:4]}"):
        decide(decision, active=active)


@pytest.mark.parametrize("t", [1.0, 1.5])
def test_in_motion_decisions_are_judged_at_samples_by_positions_and_time_left_of_that_instant(t):
    """At 1 s phi = (2.9 / 0.5, 0.9 / 1.5) s; at 1.5 s they are unknown."""
    sample = sampled(1.0, (-2.0, 0.0), (2.0, 0.0), evader=(1.0, 0.0))
    assert decide((t, 0, 0), motion=Motion(), sample=sample) == (t == 1.0)
    with pytest.raises(AssertionError, match="lowers") if t == 1.0 else nullcontext():
        decide((t, 1, 0), motion=Motion(), sample=sample)


def test_the_time_left_runs_in_motion_only():
    """Pursuer 0 with phi = 1 s had better chase while r > 1 s; r = 30 s at any time of a frozen game."""
    late = sampled(29.5, (0.4, 0.0), (3.9, 0.0), evader=(1.0, 0.0))
    assert decide((29.5, 0, 0), active=(1, 0), motion=Motion(), sample=late) == 1
    with pytest.raises(AssertionError, match="lowers"):
        decide((29.5, 0, 0), active=(1, 0))


def serial(seed, *, protocol=None, **changes):
    """Return a static game of six, one at a time and with true knowledge of all; half of them chase at first."""
    given = {
        "seed": seed,
        "horizon": 3.0,
        "team": Team(count=6, speeds=2.0, active_at_start=0.5),
        "evader": Evader(count=2),
        "motion": FROZEN,
        "protocol": protocol or SpatialAdaptivePlay(schedule=Poisson(rate=5.0), tau=SURE),
        "announce": Announcements(trigger="change"),
        "record": Recording(trajectory=0.0),
    }
    return Scenario(**(given | changes))


def falls(**changes):
    """Return in how many of 10 games a decision lowers the potential."""
    number = 0
    for seed in range(10):
        scenario = serial(seed, **changes)
        watcher = PotentialWatcher(scenario)
        try:
            run(scenario, None, watcher)
            assert watcher.judged > 20
        except AssertionError as error:
            if "lowers the potential" not in str(error):
                raise
            number += 1
    return number


@pytest.mark.slow
def test_serial_play_with_true_knowledge_never_lowers_the_potential():
    assert falls() == 0
    assert falls(protocol=BestResponse(schedule=Periodic())) == 0


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    "changes",
    [
        {"protocol": SpatialAdaptivePlay(schedule=Poisson(), tau=ConstantTau(value=1.0))},
        {"protocol": BestResponse(schedule=Rounds())},
        {"protocol": RegretMatching(schedule=Poisson())},
        {"protocol": BestResponse(schedule=Poisson(), utility=EdgePenalty())},
        {"network": Links(latency=Constant(value=0.3))},
        {"network": Links(loss=Bernoulli(p=0.5))},
        {"announce": Announcements(trigger="change", start="silent")},
        {"announce": Announcements(trigger="change", belief_timeout=0.2)},
        {"announce": Announcements(trigger="never")},
        {"fault": (Crash(node=0, start=0.1), Crash(node=1, start=0.1), Crash(node=2, start=0.1))},
    ],
    ids=["hot", "at once", "no reply", "another game", "late", "lossy", "cold", "forgetful", "silent", "broken"],
)
def test_the_assumptions_of_the_theorem_are_necessary(changes):
    """The controls: without any one of its conditions some decisions lower the potential."""
    assert falls(**changes) > 0


@pytest.mark.parametrize("player", ["team", "evader"])
def test_the_disc_of_a_player_with_inertia_is_not_watched(player):
    team, body = Team(guidance="constant_bearing"), TurnRate(limit=1.0)
    assert ApolloniusWatcher.applies(Scenario(team=team))
    changed = {"team": team} | {
        player: Team(guidance=team.guidance, dynamics=body) if player == "team" else Evader(dynamics=body)
    }
    assert not ApolloniusWatcher.applies(Scenario(**changed))


@pytest.mark.slow_but_one
@pytest.mark.parametrize("strategy", ["pure_evasion", "zigzag", "diffusion", "max_min", "still"])
def test_with_constant_bearing_each_apollonius_disc_contains_the_next(strategy):
    """Also while pursuers hand over, and against two evaders. The control: pure pursuit of an evader that turns."""
    for guidance, holds in (("constant_bearing", True), ("pure_pursuit", False)):
        scenario = Scenario(
            team=Team(count=6, guidance=guidance, speeds=1.5),
            evader=(Evader(strategy=strategy), Evader(strategy=strategy)),
            protocol=SpatialAdaptivePlay(schedule=Poisson(rate=5.0)),
            horizon=6.0,
        )
        watch = ApolloniusWatcher(scenario)
        assert ApolloniusWatcher.applies(scenario) is holds
        if holds:
            run(scenario, 4, watch)
            assert watch.judged > 50
        elif strategy == "zigzag":
            with pytest.raises(AssertionError, match="a chase confines the evader"):
                run(scenario, 4, watch)


def test_the_apollonius_disc_of_numbers():
    """m = .5, d = 4: 4/3 m beyond the evader, radius 8/3 m; it contains the points that the evader reaches first."""
    centre, radius = apollonius_disc(4.0, 0.0, 0.5, 1.0)
    assert (centre, radius) == (pytest.approx(4.0 + 4.0 / 3.0), pytest.approx(8.0 / 3.0))
    for angle in np.linspace(0.0, 6.0, 7):
        for share, first in ((0.999, True), (1.001, False)):
            point = centre + share * radius * np.exp(1j * angle)
            assert bool(abs(point - 4.0) / 0.5 < abs(point) / 1.0) is first
    with pytest.raises(ValueError, match="the pursuer should be faster than the evader, got 1 and 1 m/s"):
        apollonius_disc(1.0, 0.0, 1.0, 1.0)
