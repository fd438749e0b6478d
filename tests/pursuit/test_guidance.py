"""Guidance: the courses that lead to the evader, and how long they take."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from desim import Scenario, run
from desim.pursuit.core.events import Ended
from desim.pursuit.core.geometry import toward
from desim.pursuit.motion import guidance
from desim.pursuit.motion.guidance import ConstantBearing, PurePursuit
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Capture, Motion, Recording

numbers = st.floats(-10.0, 10.0).map(lambda x: round(x, 6))
plane = st.builds(complex, numbers, numbers)
speeds = st.floats(0.0, 5.0).map(lambda x: round(x, 6))


def course(gap, flight, speed, aim=None):
    """Return the velocity by constant bearing of one pursuer; it aims at the position of the evader by default."""
    aims = np.array([gap if aim is None else aim])
    return complex(ConstantBearing()(np.array([gap]), aims, flight, np.array([speed]))[0])


def meeting(gap, flight, speed):
    """Return the least t > 0 with |gap + flight t| = speed t, by the roots of the polynomial; None without any."""
    polynomial = [abs(flight) ** 2 - speed**2, 2 * (gap * flight.conjugate()).real, abs(gap) ** 2]
    roots = np.roots(polynomial)
    times = [root.real for root in roots if abs(root.imag) < 1e-9 * abs(root) and root.real > 0]
    return min(times, default=None)


@pytest.mark.slow
@given(plane, plane, speeds)
def test_the_course_leads_to_the_intercept_point_or_else_straight_to_the_evader(gap, flight, speed):
    """Held against the roots of |gap + w t|^2 = v^2 t^2, away from the double root, where rounding decides."""
    across = abs((flight * gap.conjugate()).imag) / max(abs(gap), 1e-300)
    assume(abs(gap) > 1e-3 and speed > 1e-3 and abs(speed - abs(flight)) > 1e-3 and abs(speed - across) > 1e-3)
    time, found = meeting(gap, flight, speed), course(gap, flight, speed)
    goal = gap if time is None else gap + flight * time
    assert found == pytest.approx(speed * goal / abs(goal), abs=1e-6)


@pytest.mark.slow
@given(plane, plane, st.floats(0.1, 5.0))
def test_the_line_of_sight_keeps_its_direction_and_the_speed_is_used_up(gap, flight, faster):
    """The relative velocity w - u is along the gap, and closes it."""
    assume(abs(gap) > 1e-3)
    speed = abs(flight) + faster
    found = course(gap, flight, speed)
    closing = (flight - found) * gap.conjugate() / abs(gap)
    assert abs(found) == pytest.approx(speed, rel=1e-12)
    assert closing.imag == pytest.approx(0.0, abs=1e-9)
    assert closing.real <= -faster + 1e-9  # fastest is radial flight: no less than v - w


def test_a_course_by_numbers():
    """Gap 3, the evader moves across it at 3, the pursuer at 5: 4 are left along it; 12 m ahead, met after 3/4 s."""
    assert course(3 + 0j, 3j, 5.0) == pytest.approx(4 + 3j)
    assert course(3 + 0j, 3 + 0j, 5.0) == pytest.approx(5 + 0j)  # radial flight: straight
    assert course(3 + 0j, -3 + 0j, 1.0) == pytest.approx(1 + 0j)  # head on, although slower
    assert course(3 + 0j, 3j, 2.0, aim=3 + 1j) == pytest.approx(2 * (3 + 1j) / abs(3 + 1j))  # too slow: to the aim
    assert course(0j, 1j, 5.0, aim=1j) == pytest.approx(5j)  # already there: to the aim
    assert course(3 + 0j, 3 + 0j, 3.0, aim=1j) == pytest.approx(3j)  # equally fast, it runs away: to the aim
    assert course(3 + 0j, -1 + 1j, abs(-1 + 1j)) == pytest.approx(1 + 1j)  # equally fast, it comes nearer: met


@pytest.mark.parametrize("gap", [0j, 1e-310 + 0j, 1e-160j, 3 + 4j, 1e9 + 1e9j])
@pytest.mark.parametrize("flight", [0j, 0.9 + 0j, 3e-5 - 4e-5j, -0.6 + 0.8j, 1e8j])
@pytest.mark.parametrize("speed", [0.0, 1e-300, 0.9, 1.0, 1e8])
def test_no_course_is_undefined_or_faster_than_allowed(gap, flight, speed):
    """At distance 0, without speed, at equal speeds."""
    for aim in (gap, 0j, gap + flight):
        for law in (PurePursuit(), ConstantBearing()):
            found = law(np.array([gap]), np.array([aim]), flight, np.array([speed]))
            assert np.isfinite(found).all()
            assert abs(found[0]) <= speed * (1 + 1e-12)
    assert course(0j, flight, speed) == 0j
    assert course(gap, flight, 0.0) == 0j


def test_pure_pursuit_is_straight_to_the_aim_whatever_the_evader_does():
    gaps, aims, v = np.array([1 + 0j, 2j]), np.array([1 + 1j, 3j]), np.array([2.0, 0.0])
    assert (PurePursuit()(gaps, aims, 5 - 3j, v) == toward(aims, v)).all()


@pytest.mark.slow
@given(plane, plane, plane, speeds)
def test_the_course_of_one_is_exactly_that_of_the_team(gap, aim, flight, speed):
    for law in (PurePursuit(), ConstantBearing(), lambda gaps, aims, w, v: toward(aims, v)):
        team = np.full(5, gap), np.full(5, aim), flight, np.full(5, speed)
        assert (guidance.guided_velocities(law, *team) == guidance.guided_velocity(law, gap, aim, flight, speed)).all()


# The circle of Apollonius.


@pytest.mark.slow
@given(plane, plane, st.floats(0.05, 0.95), st.floats(0.0, 6.28))
def test_constant_bearing_meets_the_evader_on_the_circle_of_apollonius(pursuer, evader, ratio, angle):
    """Whatever the heading of the evader: the pursuer at speed 1 has come as far as the evader has, over k.

    With k = v_e / v_p the points x with |x - x_e| = k |x - x_p| lie on the circle round (x_e - k^2 x_p) / (1 - k^2) of
    radius k d / (1 - k^2).
    """
    assume(abs(evader - pursuer) > 1e-2)
    flight = ratio * np.exp(1j * angle)
    velocity = course(evader - pursuer, flight, 1.0)
    time = abs(evader - pursuer) / abs(velocity - flight)
    point = pursuer + velocity * time
    assert point == pytest.approx(evader + flight * time, abs=1e-8)
    centre = (evader - ratio**2 * pursuer) / (1.0 - ratio**2)
    radius = ratio * abs(evader - pursuer) / (1.0 - ratio**2)
    assert abs(point - centre) == pytest.approx(radius, rel=1e-8, abs=1e-8)


# In a run.


class Straight:
    """An evader that runs straight on."""

    def __init__(self, angle):
        self.heading = complex(np.exp(1j * angle))

    def __call__(self, state, rng):
        return self.heading


def chase(me):
    """Chase from the start on."""
    yield me.at(0.0)
    me.assign(True)


def capture(guidance, *, start=(0.0, 0.0), evader=(3.0, 0.0), strategy=None, speed=2.0, v_e=0.9, step=0.01, **changes):
    """Return when one pursuer captures, s; None if it does not."""
    fleeing = {} if strategy is None else {"strategy": strategy}
    given = {
        "team": Team(positions=[start], speeds=speed, guidance=guidance),
        "evader": Evader(position=evader, speed=v_e, **fleeing),
        "motion": Motion(step=step),
        "protocol": chase,
        "prune": "none",
        "record": Recording(trajectory=0.0),
    }
    (end,) = run(Scenario(**(given | changes))).trace.of(Ended)
    return end.t / 1e9 if end.reason == "captured" else None


@pytest.mark.slow_but_one
@pytest.mark.parametrize("step", [0.01, 0.37])
@pytest.mark.parametrize("angle", [0.0, 0.7, 2.0, 3.1])
@pytest.mark.parametrize(("speed", "v_e"), [(2.0, 0.9), (5.0, 4.9)])
def test_the_time_to_intercept_an_evader_that_runs_straight_is_the_closed_form(step, angle, speed, v_e):
    """The gap of 3 m closes at sqrt(v^2 - w_across^2) - w_along, down to eps: t = (d - eps) / that, at any step."""
    across, along = v_e * np.sin(angle), v_e * np.cos(angle)
    expected = 2.9 / (np.sqrt(speed**2 - across**2) - along)
    found = capture(ConstantBearing(), strategy=Straight(angle), speed=speed, v_e=v_e, step=step)
    assert found == pytest.approx(expected, abs=2e-9)


@pytest.mark.slow
def test_a_slower_pursuer_intercepts_a_passing_evader_and_pure_pursuit_does_not():
    """At (0, 3) with 0.6 m/s, the evader runs past at 1 m/s from (-6, 0): 5 s of 3 m to (0, 0), it has 6 s.

    Constant bearing: b = (-6, -3)/sqrt(45), across 1/sqrt(5) = 0.447 < 0.6.
    """
    given = {"start": (0.0, 3.0), "evader": (-6.0, 0.0), "strategy": Straight(0.0), "speed": 0.6, "v_e": 1.0}
    along, across = -2 / np.sqrt(5), 1 / np.sqrt(5)
    expected = (np.sqrt(45) - 0.1) / (np.sqrt(0.36 - across**2) - along)
    assert capture(ConstantBearing(), **given) == pytest.approx(expected, abs=2e-9)
    assert capture(PurePursuit(), **given) is None


@pytest.mark.whole
def test_constant_bearing_is_never_later_than_pure_pursuit_and_often_much_earlier():
    """Forty headings, speeds and distances; half gain more than 0.02 s to 0.08 s over five seeds, here 0.08."""
    rng, gains = np.random.default_rng(3), []
    for _ in range(40):
        given = {
            "evader": (float(rng.uniform(1.0, 6.0)), 0.0),
            "strategy": Straight(rng.uniform(0.0, 6.28)),
            "speed": float(rng.uniform(1.2, 3.0)),
            "step": 0.01,
        }
        gains.append(capture(PurePursuit(), **given) - capture(ConstantBearing(), **given))
    assert min(gains) > -1e-6
    assert np.median(gains) > 0.05


def test_under_radial_flight_both_laws_are_equal():
    """The evader flees from its only pursuer: (3 - 0.1) / (2 - 0.9) s by both."""
    times = [capture(law) for law in (PurePursuit(), ConstantBearing())]
    assert times == pytest.approx([2.9 / 1.1] * 2, abs=2e-9)


def test_with_simultaneous_moves_the_evader_is_seen_as_it_moved_last():
    """The first step of 0.5 s is straight at it, for it has not moved yet: to (1, 0), while it goes up to (3, 0.45).

    Then the gap is (2, 0.45), which closes at sqrt(4 - across^2) - along.
    """
    found = capture(ConstantBearing(), strategy=Straight(np.pi / 2), motion=Motion(step=0.5, order="simultaneous"))
    gap = 2.0 + 0.45j
    along, across = 0.9 * gap.imag / abs(gap), 0.9 * gap.real / abs(gap)
    assert found == pytest.approx(0.5 + (abs(gap) - 0.1) / (np.sqrt(4 - across**2) - along), abs=2e-9)


def test_simultaneous_moves_work_with_sampled_capture_and_a_user_guidance_law():
    """A law that leads 1 s ahead of the evader misses one that stands still, and meets it, for it does not move."""

    def lead(gaps, aims, flight, speeds):
        return toward(gaps + flight, speeds)

    found = capture(lead, v_e=0.0, capture=Capture(test="sample"), step=0.25)
    assert found == 1.5  # 2.9 / 2 = 1.45 s, at the next sample


@pytest.mark.parametrize("count", [1, 30])
def test_a_law_cannot_change_the_speeds_of_the_team(count):
    """`speeds *= 2` would let it exceed them."""

    def fast(gaps, aims, evader_velocity, speeds):
        speeds *= 2.0
        return speeds + 0j

    with pytest.raises(ValueError, match="read-only"):
        run(Scenario(team=Team(count=count, guidance=fast, active_at_start=1.0), horizon=1.0), 1)
