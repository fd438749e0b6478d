"""Inertia in a run: limits, exact reckoning, every protocol, capture times in hindsight."""

from itertools import cycle
from math import atan2, pi

import numpy as np
import pytest

from desim import Acceleration, Announcements, Evader, Links, Motion, Recording, Scenario, Team, TurnRate, run, summary
from desim.analysis.timeline import timeline
from desim.kernel.core.units import SECOND, seconds
from desim.kernel.models.latency import Constant
from desim.pursuit.core.events import Captured, Decided, Sampled, Started
from desim.pursuit.evaders.evasion import STRATEGIES, ConstantHeading, Still
from desim.pursuit.motion.capture import capture_time
from desim.pursuit.motion.dead_reckoning import MotionState
from desim.pursuit.motion.dynamics import Course, Courses, Simple
from desim.pursuit.motion.environment import Environment
from desim.pursuit.motion.flow import NoFlow, SteadyFlow
from desim.scenario.scenario import PROTOCOLS
from desim.simulation.world import World
from desim.study.ablation.imperfections import without_inertia
from desim.testing.pursuits import InertiaWatcher, PotentialWatcher, watched
from protocols.best_response import BestResponse
from protocols.schedules.periodic import Poisson
from tests.worlds import world_of

LIMITED = [Acceleration(limit=0.7), TurnRate(limit=0.9, heading=1.0)]
NAMES = ["acceleration", "turn rate"]
BASE = Scenario(team=Team(count=6), horizon=40.0, network=Links(latency=0.1))
KINDS = PROTOCOLS.choices()


def having(dynamics, **changes):
    return BASE.model_copy(update={"team": Team(count=6, dynamics=dynamics), **changes})


def decisions(result):
    return [(event.t, event.pursuer, event.active) for event in result.trace.of(Decided)]


def chase(me):
    """Chase from the start on."""
    yield me.at(0.0)
    me.assign(True)


def lone(dynamics, evader, *, position=(0.0, 0.0), speed=2.0, step=0.05, **changes):
    """Return the time of capture, s, by a lone pursuer that chases from the start on."""
    scenario = Scenario(
        team=Team(positions=[position], speeds=speed, dynamics=dynamics),
        evader=evader,
        protocol=chase,
        motion=Motion(step=step),
        **changes,
    )
    (captured,) = run(scenario, 1).trace.of(Captured)
    return seconds(captured.t)


# Capture at the predicted time.


@pytest.mark.parametrize(("limit", "phi"), [(0.5, 8.09091), (1.0, 6.27273), (10.0, 4.63636), (1e9, 4.45455)])
@pytest.mark.parametrize("step", [0.05, 0.37])
def test_a_chase_in_a_line_takes_the_capture_time_at_any_motion_step(limit, phi, step):
    """d = 5, v = 2, v_e = .9, eps = .1, from rest: phi = (d - eps + v^2 / (2 a)) / (v - v_e), in one line exactly."""
    evader = Evader(position=(3.0, 4.0), speed=0.9, strategy=ConstantHeading(angle=atan2(4.0, 3.0)))
    time = lone(Acceleration(limit=limit), evader, step=step)
    assert time == pytest.approx((4.9 + 2.0 / limit) / 1.1, abs=1e-6)
    assert time == pytest.approx(phi, abs=6e-6)


@pytest.mark.parametrize(("place", "length"), [((5.0, 0.0), 5.0), ((0.0, 5.0), 5.69646), ((-5.0, 1e-3), 8.53638)])
def test_a_still_target_is_captured_along_the_shortest_path(place, length):
    """rho = 1 m: turning towards a target beyond the turning circle is the shortest path, with pure pursuit also."""
    evader, dynamics = Evader(position=place, speed=0.0, strategy=Still()), TurnRate(limit=2.0, heading=0.0)
    times = [lone(dynamics, evader, step=step) for step in (0.1, 0.01)]
    assert times == pytest.approx([(length - 0.1) / 2.0] * 2, abs=1e-3)


@pytest.mark.parametrize("place", [(0.0, 1.0), (0.3, 0.8), (-0.4, -0.9)])
def test_a_target_within_the_turning_circle_is_reached_by_turning_away_first(place):
    """Turning towards it, a pursuer would circle about it for ever."""
    dynamics, evader = TurnRate(limit=2.0, heading=0.0), Evader(position=place, speed=0.0, strategy=Still())
    there, course = np.array([complex(*place)]), Courses(np.zeros(1, dtype=complex), np.ones(1, dtype=complex))
    (expected,) = dynamics.capture_times(there, course, np.array([2.0]), 0.0, 0.1)
    assert expected > pi / 2.0
    assert lone(dynamics, evader, step=0.002) == pytest.approx(expected, abs=0.02)
    away = dynamics.steered(2.0j, Course(0j, 1.0 + 0j), complex(*place), 0.1)
    assert away == pytest.approx(-2.0j if place[1] > 0.0 else 2.0j)
    assert dynamics.steered(2.0j, Course(0j, 1.0 + 0j), complex(*place) * 9.0, 0.1) == 2.0j


# Limits.


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dynamics", "error"), [(Acceleration(limit=1e9), 1e-6), (TurnRate(limit=1e6, heading=0.0), 1e-5)], ids=NAMES
)
@pytest.mark.parametrize("strategy", ["pure_evasion", "diffusion"])
def test_a_run_with_hardly_any_inertia_is_one_without(dynamics, error, strategy):
    """A turn at 1e6 rad/s takes up to 3e-6 s; with it all decisions are the same, and all positions within 1e-5 m."""
    evader = Evader(strategy=strategy, position=(10.0, 10.0))
    for seed in (1, 2):
        own, simple = run(having(dynamics, evader=evader), seed), run(having(Simple(), evader=evader), seed)
        assert decisions(own) == decisions(simple)
        assert summary(own).capture_time == pytest.approx(summary(simple).capture_time, abs=10 * error)
        pairs = zip(own.trace.of(Sampled), simple.trace.of(Sampled), strict=True)
        for one, other in pairs:
            if one.t == other.t:
                assert np.array(one.pursuers) == pytest.approx(np.array(other.pursuers), abs=error)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("dynamics", LIMITED, ids=NAMES)
@pytest.mark.parametrize("guidance", ["pure_pursuit", "constant_bearing"])
def test_results_converge_in_the_motion_step(dynamics, guidance):
    """A lone pursuer of an evader that runs past it, without negotiation: errors of order h."""
    heading = {"kind": "constant_heading", "angle": pi / 2}
    times = [
        summary(
            run(
                Scenario(
                    team=Team(positions=[(0.0, 0.0)], speeds=1.5, guidance=guidance, dynamics=dynamics),
                    evader=Evader(position=(8.0, 2.0), speed=0.6, strategy=heading),
                    protocol=chase,
                    motion=Motion(step=step),
                    record=Recording(trajectory=0.0),
                )
            )
        ).capture_time
        for step in (0.08, 0.02, 0.005, 0.00125)
    ]
    errors = np.abs(np.diff(times))
    assert (errors[1:] < 0.5 * errors[:-1] + 1e-6).all()
    assert errors[-1] < 1e-2


# What is announced.


@pytest.mark.whole
@pytest.mark.parametrize("dynamics", LIMITED, ids=NAMES)
def test_announced_courses_are_worth_as_much_as_sight_if_they_arrive_at_once(dynamics):
    """Positions and courses of teammates are extrapolated exactly; without courses, decisions differ."""
    silent = {"network": Links(), "record": Recording(trajectory=0.0), "horizon": 12.0}
    seen, told, placed = (
        decisions(run(having(dynamics, announce=Announcements(payload=payload), **silent), 5))
        for payload in ("action", "course", "state")
    )
    assert told == seen
    assert placed != seen


@pytest.mark.slow
@pytest.mark.parametrize("reckoning", ["exact", "straight_line"])
@pytest.mark.parametrize("latency", [0.0, 0.2])
def test_without_inertia_courses_are_worth_no_more_than_states(reckoning, latency):
    told, placed = (
        decisions(
            run(
                having(
                    Simple(),
                    announce=Announcements(payload=payload, reckoning=reckoning),
                    network=Links(latency=latency),
                    horizon=10.0,
                ),
                3,
            )
        )
        for payload in ("course", "state")
    )
    assert told == placed
    assert len(told) > 30


@pytest.mark.parametrize("dynamics", [Simple(), *LIMITED], ids=["simple", *NAMES])
@pytest.mark.parametrize("guidance", ["pure_pursuit", "constant_bearing"])
def test_a_teammate_is_reckoned_exactly_while_it_chases_and_after_it_has_stopped(dynamics, guidance):
    """From its motion at 0.33 s, in the middle of a step, through turns of the evader; from 1.27 s on it brakes."""
    team = Team(
        positions=[(0.0, 0.0), (9.0, 1.0)], speeds=1.5, active_at_start=0.0, dynamics=dynamics, guidance=guidance
    )
    evader = Evader(position=(4.0, 3.0), speed=0.9, strategy={"kind": "zigzag"})
    scenario = Scenario(team=team, evader=evader, motion=Motion(step=0.1), announce=Announcements(payload="course"))
    parts = world_of(scenario)
    parts.world.begin()
    parts.env.run(until=SECOND // 3)
    parts.view.set_action(0, 1)
    begun, start = parts.env.now, parts.state.motion(0)
    for hundredths in (40, 77, 127):
        parts.env.run(until=hundredths * SECOND // 100)
        found = parts.view.reckoned(start, 1.5, parts.env.now - begun, 1, exact=True)
        assert found.position == pytest.approx(parts.state.position(0), abs=1e-9)
        assert found.course.velocity == pytest.approx(parts.state.players.course(0).velocity, abs=1e-9)
    parts.view.set_action(0, 0)
    ended, stopped = parts.env.now, parts.state.motion(0)
    for hundredths in (150, 600):
        parts.env.run(until=hundredths * SECOND // 100)
        now = parts.env.now
        chased = parts.view.reckoned(start, 1.5, now - begun, 1, exact=True, ended=now - ended)
        for motion in (chased, stopped):
            found = parts.view.idle(motion, now - ended)
            assert found.position == pytest.approx(parts.state.position(0), abs=1e-9)
            assert found.course.velocity == pytest.approx(parts.state.players.course(0).velocity, abs=1e-9)


@pytest.mark.parametrize("dynamics", [Simple(), *LIMITED], ids=["simple", *NAMES])
@pytest.mark.parametrize("flow", [NoFlow(), SteadyFlow(velocity=(0.3, -0.1))], ids=["still", "flow"])
def test_to_be_idle_for_a_time_is_to_be_idle_for_a_part_of_it_and_then_for_the_rest(dynamics, flow):
    parts = world_of(having(dynamics, environment=Environment(flow=flow)))
    parts.world.begin()
    parts.env.run(until=2 * SECOND)
    start, since, between = parts.state.motion(0), SECOND * 9 // 10, SECOND * 7 // 10
    if start.course is not None:
        start = MotionState(start.position, Course(1.5 * start.course.heading, start.course.heading))
    found = parts.view.idle(parts.view.idle(start, since, between), between)
    whole = parts.view.idle(start, since)
    assert found.position == pytest.approx(whole.position, abs=1e-9)
    assert (abs(whole.position - start.position) > 0.1) == (flow != NoFlow() or type(dynamics) is Acceleration)
    if whole.course is not None:
        assert found.course.velocity == pytest.approx(whole.course.velocity, abs=1e-9)


def test_without_a_course_a_teammate_is_reckoned_as_if_its_motion_were_simple():
    parts = world_of(having(TurnRate(limit=0.5, heading=0.0)))
    assert parts.view.idle(MotionState(3.0 + 1j), SECOND) == MotionState(3.0 + 1j)
    (simple,) = capture_time([0.0, 0.0], [[3.0, 4.0]], [1.0], 0.9, 0.1)
    evader = parts.state.body(1).position
    found = parts.view.capture_times_from([0], [MotionState(evader - (3.0 + 4.0j))], 1)[0]
    assert found == pytest.approx(simple)
    away = MotionState(evader - (3.0 + 4.0j), Course(0j, -0.6 - 0.8j))
    assert parts.view.capture_times_from([0], [away], 1)[0] > simple + 10.0


# Every protocol, every strategy.


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "dynamics"),
    [*zip(KINDS, cycle([Acceleration(limit=2.0), TurnRate(limit=2.0)]), strict=False)],
    ids=lambda each: getattr(each, "kind", each),
)
def test_every_protocol_captures_an_evader_in_spite_of_inertia(kind, dynamics):
    """Watched, with announced courses, late and lost; the pursuers are twice as fast.

    Both dynamics in turn: a protocol knows of them by capture times and courses only.
    """
    scenario = Scenario(
        horizon=40.0,
        team=Team(count=4, speeds=2.0, box=(5.0, 15.0), dynamics=dynamics),
        evader=Evader(speed=0.7, dynamics=Acceleration(limit=4.0)),
        capture={"radius": 0.4},
        protocol={"kind": kind},
        announce={"payload": "course"} if kind not in {"cbaa", "cbba"} else {},
        network=Links(latency=Constant(value=0.05), loss=0.05),
        motion=Motion(step=0.05),
    )
    result = watched(scenario, 2, InertiaWatcher(scenario))
    assert result.trace.of(Captured)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(
    ("strategy", "dynamics", "guidance"),
    [  # each two values together
        (strategy, dynamics, ("pure_pursuit", "constant_bearing")[(k + turns) % 2])
        for k, strategy in enumerate(each for each in STRATEGIES.choices() if each != "recorded")
        for turns, dynamics in enumerate(LIMITED)
    ],
    ids=lambda each: getattr(each, "kind", each),
)
def test_no_invariant_of_motion_is_broken(dynamics, guidance, strategy):
    needed = {"max_min": {"candidates": 12}, "voronoi_vertex": {"arena": [0.0, 20.0]}}.get(strategy, {})
    scenario = Scenario(
        team=Team(count=5, speeds=2.0, dynamics=dynamics, guidance=guidance),
        evader=Evader(dynamics=dynamics, strategy={"kind": strategy} | needed),
        horizon=12.0,
    )
    inertia = InertiaWatcher(scenario)
    watched(scenario, 2, inertia)
    assert inertia.judged > 50


# Static games.


@pytest.mark.parametrize("dynamics", [Simple(), *LIMITED], ids=["simple", *NAMES])
def test_in_a_static_game_capture_times_are_those_of_simple_motion(dynamics):
    """Nothing has a course there: decisions, hindsight and the potential are those without inertia."""
    scenario = having(
        dynamics,
        motion=Motion(static=True),
        protocol=BestResponse(schedule=Poisson(rate=5.0)),
        network=Links(),
        horizon=5.0,
    )
    potential = PotentialWatcher(scenario)
    result = watched(scenario, 3, potential)
    assert potential.judged > 20
    simple = run(without_inertia(scenario), 3)
    assert decisions(result) == decisions(simple)
    assert summary(result).regret == summary(simple).regret


# Hindsight.


def test_initial_headings_are_drawn_per_seed_and_player_or_given():
    team = Team(count=4, dynamics=TurnRate())
    assert len({*team.headings(1), *team.headings(2)}) == 8
    assert Team(count=2, dynamics=TurnRate(heading=pi / 2)).headings(1) == pytest.approx([1j, 1j])


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(
    ("dynamics", "environment"),
    [
        *((each, {}) for each in LIMITED),
        (Simple(), {"flow": {"kind": "uniform", "velocity": (0.4, 0.1)}, "on": "pursuers"}),
        (Simple(), {"flow": {"kind": "harmonic", "amplitude": (0.4, 0.1), "period": 3.0}, "on": "pursuers"}),
        (Simple(), {"flow": {"kind": "affine", "expansion": -0.1, "rotation": 0.2}}),
        (Simple(), {"flow": {"kind": "gyre", "speed": 0.3, "size": 5.0}}),
    ],
    ids=[*NAMES, "wind", "tide", "affine", "gyre"],
)
def test_the_capture_times_of_hindsight_are_those_of_the_run(dynamics, environment, monkeypatch):
    """Read in the middle between two samples, from mean courses between them: errors fall with the period.

    An evader that changes its heading to and fro at every motion step is elsewhere between two samples.
    """
    worst = {}
    for period in (0.1, 0.02):
        read, make = {}, World.__init__

        def noted(self, env, *given, read=read, make=make, period=period):
            make(self, env, *given)

            def looks():
                while True:
                    yield env.timeout(round(period / 2 * SECOND))
                    read[env.now] = self.state.body(1).capture_times(env.now)

            env.process(looks())

        monkeypatch.setattr(World, "__init__", noted)
        scenario = having(
            dynamics,
            horizon=5.0,
            evader=Evader(strategy=ConstantHeading(angle=1.0)),
            record=Recording(trajectory=period),
            protocol=chase,
            environment=Environment(**environment),
        )
        result = run(scenario, 2)
        monkeypatch.undo()
        errors = []
        for part in timeline(result):
            middle = (part.times[:-1] + part.times[1:]) // 2
            for t, phi in zip(middle.tolist(), part.phi, strict=True):
                if t in read:
                    true = np.array(read[t])
                    assert (np.isinf(true) == np.isinf(phi)).all()
                    known = np.isfinite(true)
                    errors += np.abs(phi[known] - true[known]).tolist()
        assert len(errors) > 50
        worst[period] = np.median(errors)
    assert worst[0.02] < 0.4 * worst[0.1] < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("dynamics", LIMITED, ids=NAMES)
@pytest.mark.parametrize(
    ("flow", "error"),
    [
        ({"kind": "uniform", "velocity": [0.8, -0.5]}, 1e-9),
        ({"kind": "harmonic", "amplitude": [0.8, -0.5], "period": 2.0}, 5e-4),
    ],
    ids=["uniform", "harmonic"],
)
def test_a_flow_on_all_changes_no_decision_and_nothing_in_hindsight(dynamics, flow, error):
    """Courses are relative to the flow; in one that changes, up to its change within a motion step."""
    still = having(dynamics, horizon=6.0)
    carried = Scenario(team=still.team, network=still.network, horizon=6.0, environment={"flow": flow})
    own, other = run(still, 3), run(carried, 3)
    assert decisions(own) == decisions(other)
    assert summary(own).regret == pytest.approx(summary(other).regret, abs=error)
    assert summary(own).regret > 2.0 * error


@pytest.mark.slow
def test_in_hindsight_a_lone_pursuer_makes_no_mistake():
    """It takes its first phi, 8.09091 s; without inertia 4.45455 s. Its regret is 0, whatever its inertia."""
    dynamics = Acceleration(limit=0.5)
    scenario = Scenario(
        team=Team(positions=((0.0, 0.0),), speeds=2.0, dynamics=dynamics), evader=Evader(position=(3.0, 4.0))
    )
    result = run(scenario, 1)
    (captured,), (started,) = result.trace.of(Captured), result.trace.of(Started)
    assert seconds(captured.t) == pytest.approx(8.09091, abs=0.02)
    simple = capture_time(started.evaders[0], started.pursuers, started.speeds, 0.9, 0.1)[0]
    assert simple == pytest.approx(4.45455, abs=1e-5)
    assert summary(result).regret == pytest.approx(0.0, abs=1e-6)
    assert without_inertia(scenario).team.dynamics == Simple()
