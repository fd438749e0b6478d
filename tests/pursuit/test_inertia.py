"""Players with inertia: trajectories against integration, contacts against dense sampling, and whole runs."""

from cmath import phase, rect
from math import inf, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from desim import Acceleration, Announcements, Evader, Links, Motion, Recording, Scenario, Team, TurnRate, run, summary
from desim.analysis.invariants import InertiaWatcher, MotionWatcher, watched
from desim.kernel.clock import Clock
from desim.kernel.units import SECOND, seconds
from desim.pursuit.capture import RadialTime, accelerated_capture_times, capture_time
from desim.pursuit.dynamics import Course, Courses, Piece, Simple
from desim.pursuit.events import Captured, Decided, Started
from desim.pursuit.inertia import InertialKinematics, first_contact
from desim.study.imperfections import without_inertia

numbers = st.floats(-3.0, 3.0).map(lambda x: round(x, 4))
plane = st.builds(complex, numbers, numbers)
LIMITED = [Acceleration(limit=0.7), TurnRate(limit=0.9, heading=1.0)]
kinds = st.sampled_from([Simple(), *LIMITED])


def integrated(dynamics, course, command, duration):
    """Return the displacement, m, and the velocity, m/s, by integration of the controlled motion."""

    def accelerate(_, state):
        missing = command - complex(*state[2:])
        control = missing * min(dynamics.limit / max(abs(missing), 1e-12), 1e4)
        return [*state[2:], control.real, control.imag]

    def turn(_, state):
        rate = max(min(phase(command / rect(1.0, state[2])) * 1e4, dynamics.limit), -dynamics.limit)
        velocity = rect(abs(command), state[2])
        return [velocity.real, velocity.imag, rate]

    rotates = isinstance(dynamics, TurnRate)
    begin = [phase(course.heading)] if rotates else [course.velocity.real, course.velocity.imag]
    found = solve_ivp(
        turn if rotates else accelerate, (0.0, duration), [0.0, 0.0, *begin], rtol=1e-8, atol=1e-9, max_step=0.02
    ).y[:, -1]
    return complex(*found[:2]), rect(abs(command), found[2]) if rotates else complex(*found[2:])


@pytest.mark.slow_but_one
@pytest.mark.parametrize("dynamics", LIMITED, ids=["acceleration", "turn rate"])
@pytest.mark.parametrize("command", [1.5 + 0.5j, -1.0 - 1.0j, 0.3j, -2.0 + 0.1j])
@pytest.mark.parametrize("duration", [0.4, 2.0, 6.0])
def test_a_piece_is_the_solution_of_the_controlled_motion(dynamics, command, duration):
    velocity = 1.2 + 0.9j
    course = Course(velocity, velocity / abs(velocity))
    piece = dynamics(2.0 - 1.0j, course, command)
    place, reached = integrated(dynamics, course, command, duration)
    assert piece.at(duration) - (2.0 - 1.0j) == pytest.approx(place, abs=2e-3)
    assert piece.velocity_at(duration) == pytest.approx(reached, abs=2e-3)


@given(kinds, plane, plane, st.floats(0.0, 4.0))
def test_a_piece_is_continuous_keeps_its_limits_and_ends_as_commanded(dynamics, velocity, command, t):
    course = Course(velocity, velocity / abs(velocity) if velocity else 1.0 + 0j)
    piece, step = dynamics(0j, course, command), 1e-5
    there, then = piece.at(t + step) - piece.at(t), piece.velocity_at(t + step) - piece.velocity_at(t)
    assert there / step == pytest.approx(piece.velocity_at(t + step / 2.0), abs=1e-3)
    assert abs(then) <= (piece.curvature + 1e-6) * step * 1.001
    assert piece.course_at(piece.curved + 1.0).velocity == pytest.approx(command, abs=1e-9)
    if isinstance(dynamics, Acceleration):
        assert abs(piece.velocity_at(t)) <= max(abs(velocity), abs(command)) + 1e-9
    elif command:
        assert abs(piece.velocity_at(t)) == pytest.approx(abs(command))


def test_a_robot_of_limited_turn_rate_keeps_its_heading_at_rest():
    stopped = TurnRate(limit=1.0)(1j, Course(2.0 + 0j, 1.0 + 0j), 0j)
    assert stopped.at(3.0) == 1j
    assert stopped.course_at(3.0) == (0j, 1.0 + 0j)
    assert Acceleration(limit=1.0)(1j, Course(2.0 + 0j, 1.0 + 0j), 0j).at(9.0) == pytest.approx(2.0 + 1j)


# Capture times.


@pytest.mark.parametrize(("limit", "expected"), [(0.5, 8.09091), (1.0, 6.27273), (10.0, 4.63636), (1e9, 4.45455)])
def test_capture_times_from_rest(limit, expected):
    """d = 5, eps = .1, v = 2, v_e = .9."""
    found = accelerated_capture_times(
        np.array([3.0 + 4.0j]), np.zeros(1, dtype=complex), np.array([2.0]), 0.9, 0.1, limit
    )
    assert found[0] == pytest.approx(expected, abs=5e-6)


@given(plane, st.floats(0.2, 4.0), st.floats(0.2, 3.0), st.floats(0.0, 1.0), st.floats(0.0, 0.95))
def test_a_capture_time_is_the_root_of_the_motion_along_the_line_of_sight(offset, limit, speed, share, ratio):
    """The piece towards the evader, projected on the line of sight, reaches an evader that flees along it."""
    distance = abs(offset) + 0.2
    velocity, bearing, flight = share * speed * rect(1.0, 2.0), rect(1.0, phase(offset)), ratio * speed
    piece = Acceleration(limit=limit)(0j, Course(velocity, 1.0 + 0j), speed * bearing)

    def gap(t):
        return distance + flight * t - (piece.at(t) * bearing.conjugate()).real - 0.1

    times = accelerated_capture_times(
        np.array([distance * bearing]), np.array([velocity]), np.array([speed]), flight, 0.1, limit
    )
    end = piece.curved + (abs(gap(piece.curved)) + 1.0) / (speed - flight)
    assert times[0] == pytest.approx(brentq(gap, 0.0, end, xtol=1e-12), rel=1e-7)


def test_without_a_limit_capture_times_are_those_of_simple_motion():
    rng = np.random.default_rng(3)
    offsets, speeds = rng.normal(size=40) * 5 + 5j * rng.normal(size=40), rng.uniform(0.5, 2.0, 40)
    courses = Courses(0.3 * np.exp(1j * rng.uniform(-3, 3, 40)), np.exp(1j * rng.uniform(-3, 3, 40)))
    simple = RadialTime(speeds, 0.9, 0.1)(np.abs(offsets))
    for dynamics in (Acceleration(limit=1e9), TurnRate(limit=1e6), Simple()):
        found = dynamics.capture_times(offsets, courses, speeds, 0.9, 0.1)
        assert (found == inf).tolist() == (simple == inf).tolist()
        assert found[simple < inf].tolist() == pytest.approx(simple[simple < inf].tolist(), rel=1e-5, abs=1e-5)
        one = [
            dynamics.capture_times(offsets[k:], Courses(*(c[k:] for c in courses)), speeds[k:], 0.9, 0.1)[0]
            for k in (0, 7, 39)
        ]
        assert one == pytest.approx(found[[0, 7, 39]].tolist(), rel=1e-12)


# Contacts.


@given(kinds, kinds, plane, plane, plane, plane, plane, st.floats(0.05, 1.0))
def test_the_first_contact_is_that_of_a_dense_sampling(one, other, offset, v, w, command, aim, radius):
    target = one(offset, Course(v, v / abs(v) if v else 1.0 + 0j), command)
    player = other(0j, Course(w, w / abs(w) if w else 1j), aim)
    times = np.linspace(0.0, 3.0, 6_001)
    gaps = np.array([abs(target.at(t) - player.at(t)) for t in times]) - radius
    found = first_contact(target, player, radius, 0.0, 3.0)
    if found is None:
        assert gaps.min() > 0.0
    else:
        assert abs(target.at(found) - player.at(found)) - radius == pytest.approx(0.0, abs=1e-9) or found == 0.0
        assert (gaps[times < found - 1e-9] > -1e-12).all()


def test_a_grazing_contact_and_none():
    """A pursuer turns about (0, 1) at radius 1; an evader stands 1.5 above the centre: the gap falls to .5."""
    player = TurnRate(limit=1.0)(0j, Course(1.0 + 0j, 1.0 + 0j), -1.0 + 0.0001j)
    target = Piece(2.5j, Course())
    assert first_contact(target, player, 0.499999, 0.0, 3.0) is None
    assert first_contact(target, player, 0.500001, 0.0, 3.2) == pytest.approx(pi, abs=1e-2)


@pytest.mark.parametrize("dynamics", LIMITED, ids=["acceleration", "turn rate"])
def test_all_ways_to_read_a_position_agree(dynamics):
    env = Clock()
    players = InertialKinematics(env, np.array([0j, 1j, 3.0 + 0j]), [dynamics] * 3, np.array([1.0 + 0j, 1j, -1.0 + 0j]))
    players.command(np.array([1.0 + 1.0j, -1.0 + 0j, 0j]), np.array([0.1j, 0.1j, 0j]))
    env.run(until=SECOND * 3 // 2)
    some = np.array([2, 0])
    one_by_one = [players.position(j) for j in range(3)]
    assert players.distances(0, [1, 2]) == [abs(one_by_one[0] - one_by_one[j]) for j in (1, 2)]
    early = players.positions_at(some, np.array([0, SECOND])).tolist()
    assert players.positions().tolist() == one_by_one
    assert players.positions_of(some).tolist() == [one_by_one[2], one_by_one[0]]
    assert players.positions_at(some, env.now).tolist() == [one_by_one[2], one_by_one[0]]
    assert early[0] == 3.0 + 0j
    assert early[1] != one_by_one[0]
    assert players.courses([1]).velocities[0] == players.course(1).velocity
    assert players.velocity(1) == players.course(1).velocity + 0.1j
    end, mean = players.advance(0, 2j, 0.5, 0.1j)
    assert end == pytest.approx(players.position(0) + mean * 0.5)


# Whole runs.

BASE = Scenario(team=Team(count=6), horizon=40.0, network=Links(latency=0.1))


def having(dynamics, **changes):
    return BASE.model_copy(update={"team": Team(count=6, dynamics=dynamics), **changes})


@pytest.mark.parametrize("dynamics", [Acceleration(limit=1e8), TurnRate(limit=1e6)], ids=["acceleration", "turn rate"])
def test_a_run_with_hardly_any_inertia_is_one_without(dynamics):
    for seed in (1, 2):
        own, simple = summary(run(having(dynamics), seed)), summary(run(BASE, seed))
        assert own.capture_time == pytest.approx(simple.capture_time, abs=1e-4)
        assert own.active_time == pytest.approx(simple.active_time, abs=1e-3)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("dynamics", LIMITED, ids=["acceleration", "turn rate"])
def test_results_converge_in_the_motion_step(dynamics):
    times = [summary(run(having(dynamics, motion=Motion(step=h)), 3)).capture_time for h in (0.04, 0.01, 0.0025)]
    assert abs(times[1] - times[2]) < abs(times[0] - times[2]) < 0.1
    assert times[1] == pytest.approx(times[2], abs=0.02)


def decisions(result):
    return [(event.t, event.pursuer, event.active) for event in result.trace.of(Decided)]


@pytest.mark.slow_but_one
@pytest.mark.parametrize("dynamics", LIMITED, ids=["acceleration", "turn rate"])
def test_announced_courses_are_worth_as_much_as_sight_if_they_arrive_at_once(dynamics):
    """Positions and courses of teammates are extrapolated exactly; without courses, decisions differ."""
    silent = {"network": Links(), "record": Recording(trajectory=0.0)}
    seen, told, placed = (
        decisions(run(having(dynamics, announce=Announcements(payload=payload), **silent), 5))
        for payload in ("action", "course", "state")
    )
    assert told == seen
    assert placed != seen


@pytest.mark.slow_but_one
@pytest.mark.parametrize("dynamics", LIMITED, ids=["acceleration", "turn rate"])
@pytest.mark.parametrize("guidance", ["pure_pursuit", "constant_bearing"])
@pytest.mark.parametrize("strategy", ["diffusion", "zigzag", "still"])
def test_no_invariant_of_motion_is_broken(dynamics, guidance, strategy):
    scenario = Scenario(
        team=Team(count=5, dynamics=dynamics, guidance=guidance),
        evader=Evader(dynamics=dynamics, strategy=strategy),
        horizon=12.0,
    )
    inertia = InertiaWatcher(scenario)
    watched(scenario, 2, inertia)
    assert inertia.judged > 50


@pytest.mark.parametrize("dynamics", LIMITED, ids=["acceleration", "turn rate"])
def test_a_limit_that_is_exceeded_is_detected(dynamics):
    """The robots have a limit 2 % above that of the scenario that is watched."""
    scenario = having(dynamics)
    agile = having(dynamics.model_copy(update={"limit": 1.02 * dynamics.limit}))
    with pytest.raises(AssertionError, match="no player exceeds its"):
        run(agile, 1, InertiaWatcher(scenario))
    run(agile, 1, InertiaWatcher(agile), MotionWatcher(scenario))


def test_initial_headings_are_drawn_per_seed_and_player_or_given():
    team = Team(count=4, dynamics=TurnRate())
    assert len({*team.headings(1), *team.headings(2)}) == 8
    assert Team(count=2, dynamics=TurnRate(heading=pi / 2)).headings(1) == pytest.approx([1j, 1j])


def test_in_hindsight_capture_times_allow_for_inertia():
    """A lone pursuer at rest announces the first phi, and its misassigned time is 0 whatever its inertia."""
    scenario = having(
        Acceleration(limit=0.5), team=Team(positions=((0.0, 0.0),), speeds=2.0, dynamics=Acceleration(limit=0.5))
    )
    scenario = scenario.model_copy(update={"evader": Evader(position=(3.0, 4.0))})
    result = run(scenario, 1)
    (captured,), (started,) = result.trace.of(Captured), result.trace.of(Started)
    assert seconds(captured.t) == pytest.approx(8.09091, abs=0.02)
    simple = capture_time(started.evaders[0], started.pursuers, started.speeds, 0.9, 0.1)[0]
    assert simple == pytest.approx(4.45455, abs=1e-5)
    assert summary(result).regret == pytest.approx(0.0, abs=1e-6)
    assert without_inertia(scenario).team.dynamics == Simple()
