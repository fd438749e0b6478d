"""Dynamics: pieces of motion against the equations of motion, and capture times against their roots."""

from cmath import phase, rect
from math import inf, pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from desim import load
from desim.pursuit.motion.capture import RadialTime, accelerated_capture_times
from desim.pursuit.motion.dynamics import Acceleration, Course, Courses, Piece, Simple, TurnRate

TIMES = np.linspace(0.0, 4.0, 81)
complexes = st.builds(complex, st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))
headings = st.floats(-pi, pi).map(lambda angle: rect(1.0, angle))
limits = st.sampled_from([0.1, 0.7, 3.0, 40.0])


def integrated(controlled, state, times=TIMES):
    """Return the states at some times, of an ODE of complex numbers, by steps of `solve_ivp`."""
    found = solve_ivp(
        lambda _, y: controlled(y), (0.0, times[-1]), np.array(state), "DOP853", times, rtol=1e-10, atol=1e-12
    )
    return found.y


# Motion.


def test_simple_motion_takes_each_velocity_at_once():
    piece = Simple()(1j, Course(2.0 + 0j, 1.0 + 0j), 3.0 - 4.0j)
    assert [piece.at(t) for t in (0.0, 2.0)] == [1j, 6.0 - 7.0j]
    assert piece.course_at(1.0) == (3.0 - 4.0j, pytest.approx(0.6 - 0.8j))
    assert Simple()(1j, Course(2.0 + 0j, 1j), 0j) == Piece(1j, Course(0j, 1j))
    assert piece.curvature == 0.0


@pytest.mark.parametrize("side", [1j, -1j])
@pytest.mark.parametrize(("away", "turns_away"), [(0.89, True), (0.91, False), (1.1, False)])
def test_an_aim_that_it_captures_as_it_circles_turns_nobody_away(side, away, turns_away):
    """The turning circles of radius 1 m touch at the origin; with a capture radius of 0.1 m, 0.9 m are close enough."""
    command, aim = rect(2.0, 1.0), side + rect(away, 0.3)
    for heading in (1.0 + 0j, rect(1.0, 0.7)):
        course = Course(2.0 * heading, heading)
        steered = TurnRate(limit=2.0).steered(command * heading, course, aim * heading, 0.1)
        assert steered / heading == pytest.approx(-2.0 * side if turns_away else command)


@pytest.mark.slow
@given(complexes, complexes, complexes, limits)
def test_an_acceleration_solves_its_equation_of_motion(place, velocity, command, limit):
    """x'' = a (w - x') / |w - x'| until x' = w, then 0, integrated up to the end of the curve and on."""
    piece = Acceleration(limit=limit)(place, Course(velocity, 1.0 + 0j), command)
    duration = abs(command - velocity) / limit
    assert piece.curved == pytest.approx(duration, abs=1e-12)
    push = limit * (command - velocity) / abs(command - velocity) if duration else 0j

    def controlled(y):
        missing = command - y[1]
        toward = (missing / push).real > 1e-9 * duration if duration else False
        return np.array([y[1], push if toward else 0j])

    curve = np.linspace(0.0, max(min(duration, 4.0), 1e-9), 20)
    places, velocities = integrated(controlled, [place, velocity], curve)
    assert [piece.at(t) for t in curve] == pytest.approx(places, abs=1e-6)
    assert [piece.velocity_at(t) for t in curve] == pytest.approx(velocities, abs=1e-6)
    if duration < 4.0:
        assert piece.velocity_at(duration) == piece.course_at(9.0).velocity == pytest.approx(command, abs=1e-12)
        assert piece.at(4.0) - piece.at(duration) == pytest.approx(command * (4.0 - duration), abs=1e-9)
    assert all(abs(piece.velocity_at(t)) <= max(abs(velocity), abs(command)) + 1e-12 for t in TIMES)


@pytest.mark.slow
@given(complexes, headings, st.floats(0.1, 3.0), headings, limits)
def test_a_turn_solves_the_equations_of_the_unicycle(place, heading, speed, ahead, limit):
    """x' = v h, h' = i omega h with |omega| = limit, towards the commanded direction and no farther."""
    piece = TurnRate(limit=limit)(place, Course(0j, heading), speed * ahead)
    angle = phase(ahead / heading)
    curve = np.linspace(0.0, max(min(piece.curved, 4.0), 1e-9), 20)

    def controlled(y):
        return np.array([speed * y[1], 1j * np.copysign(limit, angle) * y[1]])

    places, courses = integrated(controlled, [place, heading], curve)
    assert [piece.at(t) for t in curve] == pytest.approx(places, abs=1e-6)
    assert [piece.course_at(t).heading for t in curve] == pytest.approx(courses, abs=1e-6)
    assert piece.curved == pytest.approx(abs(angle) / limit, rel=1e-12)
    assert piece.curved <= pi / limit * (1.0 + 1e-12)
    assert piece.course_at(piece.curved + 1.0).velocity == pytest.approx(speed * ahead, abs=1e-9 * speed)
    for t in TIMES:
        assert abs(piece.velocity_at(t)) == pytest.approx(speed)
        assert abs(piece.course_at(t).heading) == pytest.approx(1.0)


@given(complexes, complexes, headings, complexes, limits, st.floats(0.0, 3.0))
def test_a_command_given_again_changes_nothing(place, velocity, heading, command, limit, when):
    """A piece cut in two where another player begins a piece of its own is the same path."""
    for dynamics in (Simple(), Acceleration(limit=limit), TurnRate(limit=limit)):
        course = Course(velocity, velocity / abs(velocity) if velocity else heading)
        whole = dynamics(place, course, command)
        if abs(abs(phase(command / course.heading)) - pi) < 1e-9 if command else False:
            continue  # exactly backwards, both arcs are equally long
        rest = dynamics(whole.at(when), whole.course_at(when), command)
        for t in (0.0, 0.1, 2.0):
            assert rest.at(t) == pytest.approx(whole.at(when + t), abs=1e-7)
            assert rest.velocity_at(t) == pytest.approx(whole.velocity_at(when + t), abs=1e-6)


@pytest.mark.parametrize(
    ("turned", "angle"), [(1j, pi / 2), (-1j, -pi / 2), (rect(1.0, 3.0), 3.0), (rect(1.0, -3.0), -3.0), (1.0 + 0j, 0.0)]
)
def test_a_turn_takes_the_shorter_arc(turned, angle):
    piece = TurnRate(limit=2.0)(0j, Course(0j, 1j), 3.0 * turned * 1j)
    assert piece.turn_rate * piece.curved == pytest.approx(angle)
    assert piece.curvature == pytest.approx(6.0)


def test_a_player_that_is_to_stand_still_brakes_or_stops():
    """From 2 m/s at 0.5 m/s^2: 4 s and 4 m. A turning player stops at once; both keep their heading."""
    course = Course(2j, 1j)
    braking = Acceleration(limit=0.5)(1.0 + 0j, course, 0j)
    assert braking.curved == 4.0
    assert [braking.at(t) for t in (2.0, 4.0, 9.0)] == pytest.approx([1.0 + 3.0j, 1.0 + 4.0j, 1.0 + 4.0j])
    assert abs(braking.velocity_at(5.0)) < 1e-12
    stopped = TurnRate(limit=0.5)(1.0 + 0j, course, 0j)
    assert stopped.at(9.0) == 1.0
    assert stopped.course_at(9.0) == (0j, 1j)


def test_a_flow_carries_the_curve():
    """Over ground, the drift is added; the course is relative to the flow."""
    for dynamics in (Simple(), Acceleration(limit=0.5), TurnRate(limit=0.5)):
        piece = dynamics(1j, Course(1.0 + 0j), 2j)
        carried = piece._replace(drift=0.3 - 0.1j)
        for t in (0.0, 1.0, 9.0):
            assert carried.at(t) == pytest.approx(piece.at(t) + (0.3 - 0.1j) * t)
            assert carried.velocity_at(t) == pytest.approx(piece.velocity_at(t) + 0.3 - 0.1j)
            assert carried.course_at(t) == piece.course_at(t)


def test_headings_at_the_start():
    """Random ones are spread evenly: the mean of 4000 of length 1 is 0 within 4 / sqrt(4000) = 0.063.

    The control leaves out a tenth of the circle.
    """
    rng = np.random.default_rng(1)
    drawn = np.array(TurnRate().headings(rng, 4_000))
    assert abs(np.mean(drawn)) < 0.063
    assert abs(np.mean(drawn[np.angle(drawn) < 0.8 * np.pi])) > 0.063
    assert np.abs(drawn) == pytest.approx(1.0)
    assert TurnRate(heading=0.5).headings(rng, 2) == [rect(1.0, 0.5)] * 2
    assert Acceleration().headings(rng, 2) == Simple().headings(rng, 2) == [1.0 + 0j] * 2


# Capture times.


def times_of(offsets, velocities, speeds, limit, evader_speed=0.9, radius=0.1):
    """Return capture times with a limited acceleration."""
    return accelerated_capture_times(
        np.array(offsets, complex), np.array(velocities, complex), np.array(speeds, float), evader_speed, radius, limit
    )


@pytest.mark.parametrize(("limit", "phi"), [(0.5, 8.09091), (1.0, 6.27273), (10.0, 4.63636), (1e9, 4.45455)])
def test_the_time_from_rest_by_numbers(limit, phi):
    """d = 5, eps = .1, v = 2, v_e = .9: as long as a t <= v a parabola, then (d - eps + v^2 / (2 a)) / (v - v_e)."""
    assert times_of([5.0, 3.0 + 4.0j], [0j, 0j], [2.0, 2.0], limit) == pytest.approx([phi, phi], abs=5e-6)
    assert times_of([5.0], [0j], [2.0], limit)[0] == pytest.approx((4.9 + 2.0 / limit) / 1.1, rel=1e-12)


def test_a_capture_while_still_accelerating():
    """(v_e + sqrt(v_e^2 + 2 a (d - eps))) / a = (0.9 + sqrt(0.81 + 1)) / 0.1 = 22.45 s, of a t <= v = 3 m/s."""
    assert times_of([5.1], [0j], [3.0], 0.1)[0] == pytest.approx((0.9 + sqrt(0.81 + 0.2 * 5.0)) / 0.1, rel=1e-12)


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1))
def test_a_capture_time_is_the_root_of_the_equation_of_motion(seed):
    """Initial velocities along, against and across the line of sight, integrated up to the contact along it."""
    rng = np.random.default_rng(seed)
    for _ in range(3):
        speed, limit = rng.uniform(1.0, 3.0), rng.choice([0.2, 1.0, 8.0])
        velocity = rect(rng.uniform(0.0, speed), rng.choice([0.0, pi, pi / 2, rng.uniform(-pi, pi)]))
        offset = rect(rng.uniform(0.2, 8.0), rng.uniform(-pi, pi))
        bearing = offset / abs(offset)
        (found,) = times_of([offset], [velocity], [speed], limit)
        duration = abs(speed * bearing - velocity) / limit
        push = (speed * bearing - velocity) / max(duration, 1e-12)

        def gap(t, y, offset=offset, bearing=bearing):
            return abs(offset) - 0.1 + 0.9 * t - (y[0] / bearing).real

        gap.terminal = True
        start, t = np.array([0j, velocity]), 0.0
        for end, thrust in ((duration, push), (1e4, 0j)):
            way = solve_ivp(
                lambda _, y, thrust=thrust: np.array([y[1], thrust]),
                (t, end),
                start,
                "DOP853",
                events=gap,
                rtol=1e-10,
                atol=1e-10,
            )
            start, t = way.y[:, -1], way.t[-1]
            if way.t_events[0].size:
                break
        assert found == pytest.approx(t, rel=1e-6, abs=1e-6)


@given(st.integers(0, 2**32 - 1))
def test_several_are_each_alone(seed):
    """To the last bit, in any order."""
    rng = np.random.default_rng(seed)
    offsets, speeds = rng.normal(size=9) * 3.0 + 3.0j * rng.normal(size=9), rng.choice([0.0, 0.5, 0.9, 1.0, 2.0], 9)
    velocities = speeds * rng.choice([0.0, 0.7, 1.0], 9) * np.exp(1j * rng.uniform(-pi, pi, 9))
    together = times_of(offsets, velocities, speeds, 1.3)
    assert not np.isnan(together).any()
    alone = [times_of(offsets[[k]], velocities[[k]], speeds[[k]], 1.3)[0] for k in range(9)]
    assert together.tolist() == alone
    order = rng.permutation(9)
    assert times_of(offsets[order], velocities[order], speeds[order], 1.3).tolist() == together[order].tolist()


def test_without_a_limit_the_capture_time_is_radial():
    """A limit only ever delays a pursuer that is not faster than v along the line of sight."""
    rng = np.random.default_rng(2)
    offsets, speeds = rng.normal(size=99) * 5.0 + 5.0j * rng.normal(size=99), rng.uniform(0.0, 3.0, 99)
    velocities = speeds * rng.random(99) * np.exp(1j * rng.uniform(-pi, pi, 99))
    radial, before = RadialTime(speeds, 0.9, 0.1)(np.abs(offsets)), inf
    for limit in (0.1, 1.0, 10.0, 1e9):
        found = times_of(offsets, velocities, speeds, limit)
        assert (radial <= found * (1.0 + 1e-12)).all()
        assert (found <= before).all()
        before = found
    assert before == pytest.approx(radial, rel=1e-8, abs=1e-8)


def test_the_slow_the_fast_and_the_captured():
    """A pursuer no faster than the evader never captures it, not even at full speed; one within the radius has."""
    times = times_of([3.0, 3.0, 0.1, 0j, 3.0], [0j, 0.9, 0j, 0j, 2.0], [0.9, 0.9, 0.1, 0.1, 2.0], 1.0)
    assert times == pytest.approx([inf, inf, 0.0, 0.0, 2.9 / 1.1])


def test_the_family_computes_capture_times_alike():
    """From rest, heading for the evader, a turn costs nothing and an acceleration v^2 / (2 a) / (v - v_e)."""
    given = np.array([5.0 + 0j]), Courses(np.array([0j]), np.array([1.0 + 0j])), np.array([2.0]), 0.9, 0.1
    expected = [(Simple(), 4.9 / 1.1), (TurnRate(limit=0.1), 4.9 / 1.1), (Acceleration(limit=2.0), 5.9 / 1.1)]
    for dynamics, phi in expected:
        assert dynamics.capture_times(*given)[0] == pytest.approx(phi)


# Refusals.

RECORD = 'evader.strategy = { kind = "recorded", waypoints = [[0, 1, 2]] }'
REFUSED = {
    "no speed": (
        'team.speeds = 0.0\nteam.dynamics = "turn_rate"',
        r"s\.toml:2: team\.dynamics: has no effect, because all speeds \(team\.speeds\) are 0",
    ),
    "no speed of any": (
        '[team]\ndynamics = { kind = "acceleration", limit = 2.0 }\nspeeds = [0.0, 0.0]\ncount = 2',
        r"s\.toml:2: team\.dynamics: has no effect, because all speeds",
    ),
    "a still evader": (
        '[evader]\nspeed = 0.0\ndynamics = "acceleration"',
        r"s\.toml:3: evader\.dynamics: has no effect, because the speed is 0",
    ),
    "a recorded evader": (
        f'{RECORD}\nevader.dynamics = "turn_rate"',
        r"s\.toml:2: evader\.dynamics: has no effect, because the record determines the motion",
    ),
    "no limit": (
        'team.dynamics = { kind = "acceleration", limit = 0.0 }',
        r"team\.dynamics\.limit: should be greater than or equal to 0\.000001",
    ),
    "endless": (
        'team.dynamics = { kind = "turn_rate", limit = inf }',
        r"team\.dynamics\.limit: should be a finite number|less than or equal to 1000000",
    ),
    "too sharp": (
        'team.dynamics = { kind = "turn_rate", limit = 1.1e6 }',
        r"team\.dynamics\.limit: should be less than or equal to 1000000",
    ),
    "a heading in degrees": (
        'evader.dynamics = { kind = "turn_rate", heading = 90.0 }',
        r"evader\.dynamics\.heading: should be less than or equal to 6\.28",
    ),
    "a heading with acceleration": (
        'team.dynamics = { kind = "acceleration", heading = 1.0 }',
        r"team\.dynamics\.heading: unknown key.*allowed: kind, limit",
    ),
    "another kind": (
        'team.dynamics = "turnrate"',
        r"there is no 'turnrate', did you mean 'turn_rate'\?; allowed: .*simple",
    ),
}


@pytest.mark.parametrize(("text", "why"), REFUSED.values(), ids=REFUSED)
def test_dynamics_that_have_no_effect_or_are_out_of_range_are_refused_with_the_place(text, why, tmp_path):
    file = tmp_path / "s.toml"
    file.write_text(text + "\n")
    with pytest.raises(ValueError, match=why):
        load(file)


def test_some_pursuer_or_evader_that_can_move_is_enough(tmp_path):
    file = tmp_path / "s.toml"
    file.write_text(f'team = {{ speeds = {{ default = 0.0, last = 1.0 }}, dynamics = "turn_rate" }}\n{RECORD}\n')
    assert load(file).team.has_inertia
    assert not load(file).evader.has_inertia
