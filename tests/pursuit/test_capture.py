"""Times of capture: closed forms, and the equations that they solve."""

from math import hypot, inf, nextafter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.pursuit.motion.capture import NO_SPEED, RadialTime, capture_time, intercept_times

coordinates = st.floats(-20.0, 20.0)
speeds_of_players = st.floats(0.0, 3.0).map(lambda v: round(v, 6))
points = st.tuples(coordinates, coordinates)


def intercept_time(evader, velocity, at, speed, radius):
    """Return the least time in which one pursuer can capture an evader of constant velocity; vectors are pairs."""
    offset = complex(*evader) - complex(*at)
    return float(intercept_times(np.array([offset]), np.array([complex(*velocity)]), np.array([speed]), radius)[0])


@given(points, st.lists(st.tuples(points, speeds_of_players), min_size=1, max_size=5), st.floats(0.0, 2.0))
def test_radial_capture_time_solves_its_equation(evader, team, v_e):
    """After phi the gap |x_e - x_i| - eps has been closed at v_i - v_e."""
    at, speeds = np.array([p for p, _ in team]), np.array([v for _, v in team])
    phi = capture_time(evader, at, speeds, v_e, 0.1)
    distance = np.hypot(*(np.array(evader) - at).T)
    for d, v, time in zip(distance, speeds, phi, strict=True):
        if d <= 0.1:
            assert time == 0.0
        elif v - v_e <= NO_SPEED:
            assert time == inf
        else:
            assert time * (v - v_e) == pytest.approx(d - 0.1, rel=1e-9, abs=1e-12)


@pytest.mark.slow
@given(points, points, points, speeds_of_players, st.floats(0.01, 1.0))
def test_intercept_time_is_the_first_time_at_which_the_evader_can_be_reached(evader, velocity, at, speed, eps):
    """|x_e + w t - x_i| <= v t + eps holds at phi and at no sampled earlier time."""
    phi = intercept_time(evader, velocity, at, speed, eps)

    def slack(t):
        gap = np.array(evader) + np.array(velocity) * t - np.array(at)
        return speed * t + eps - np.hypot(*gap)

    scale = 1e-6 * (1 + np.hypot(*velocity)) * (1 + min(phi, 1e6))
    horizon = 100.0 if phi == inf else phi
    if phi < 1e6:
        assert slack(phi) >= -scale
    assert phi == 0.0 or all(slack(t) < scale for t in np.linspace(0.0, min(horizon, 100.0), 200)[:-1])


def test_a_closing_speed_that_is_nothing_but_rounding_counts_as_none():
    """0.1 / 5e-324 would overflow."""
    assert capture_time([1.0, 0.0], [[0.0, 0.0]], [5e-324], 0.0, 0.1) == inf
    assert capture_time([1.0, 0.0], [[0.0, 0.0]], [0.1 + 0.2], 0.3, 0.1) == inf


def test_intercept_of_an_evader_that_flees_straight_is_the_radial_time():
    radial = capture_time([3.0, 4.0], [[0.0, 0.0]], [2.0], 0.9, 0.1)
    assert intercept_time([3.0, 4.0], [0.54, 0.72], [0.0, 0.0], 2.0, 0.1) == pytest.approx(radial)
    assert radial == pytest.approx([(5.0 - 0.1) / 1.1])


@pytest.mark.parametrize(
    ("evader", "pursuers", "speeds", "radius", "text"),
    [
        ([0.0], [[1.0, 1.0]], [1.0], 0.1, "shapes"),
        ([0.0, 0.0], [1.0, 1.0], [1.0], 0.1, "shapes"),
        ([0.0, 0.0], [[1.0, 1.0]], [1.0, 2.0], 0.1, "shapes"),
        ([0.0, 0.0], [[1.0, 1.0]], [1.0], 0.0, "greater than 0 m, got 0.0"),
    ],
)
def test_shapes_and_radius_are_checked(evader, pursuers, speeds, radius, text):
    with pytest.raises(ValueError, match=text):
        capture_time(evader, pursuers, speeds, 0.9, radius)


@pytest.mark.slow
@given(points, st.lists(st.tuples(points, speeds_of_players), min_size=1, max_size=5), st.floats(0.0, 2.0))
def test_the_time_of_one_is_that_of_all_to_the_last_bit(evader, team, v_e):
    """RadialTime as a whole, one by one, and capture_time are one function; they are asked at distances of their own.

    One by one the distance is that of complex numbers, as the world has it.
    """
    speeds = np.array([v for _, v in team])
    distances = np.array([abs(complex(*evader) - complex(*p)) for p, _ in team])
    radial = RadialTime(speeds, v_e, 0.1)
    together = radial(distances)
    assert together.tolist() == [radial.of(i, float(d)) for i, d in enumerate(distances)]
    assert together == pytest.approx(capture_time(evader, [p for p, _ in team], speeds, v_e, 0.1), rel=1e-12)
    assert radial.slow.tolist() == [bool(v - v_e <= NO_SPEED) for v in speeds]


def test_the_time_of_one_by_hand():
    """v = (1, 2, 0.9), v_e = 0.9, eps = 0.5: 4 m of gap take 4 / 0.1 s, 4 / 1.1 s, for ever, up to rounding of 0.9."""
    radial = RadialTime(np.array([1.0, 2.0, 0.9 + 0.5 * NO_SPEED]), 0.9, 0.5)
    assert [radial.of(i, 4.5) for i in range(3)] == pytest.approx([40.0, 4.0 / 1.1, inf])
    assert [radial.of(i, 0.5) for i in range(3)] == [radial.of(i, 0.1) for i in range(3)] == [0.0, 0.0, 0.0]
    assert radial(np.array([0.5, 0.2, 0.5])).tolist() == [0.0, 0.0, 0.0]
    assert radial.of(2, nextafter(0.5, 1.0)) == inf
    assert radial(np.array([0.5, 0.5, nextafter(0.5, 1.0)])).tolist() == [0.0, 0.0, inf]
    assert all(type(radial.of(i, 4.5)) is float for i in range(3))


def test_a_team_of_only_fast_pursuers_has_finite_capture_times():
    """And what was asked for is not changed."""
    asked = np.array([1.0, 1e9])
    asked.setflags(write=False)
    assert np.isfinite(RadialTime(np.array([1.0, 2.0]), 0.9, 0.1)(asked)).all()


def test_just_faster_than_rounding_is_fast():
    """A difference of 1e-12 m/s is taken for rounding, the next one up for a speed: 0.5 m at 2e-12 m/s."""
    assert capture_time([0.6, 0.0], [[0.0, 0.0]], [1e-12], 0.0, 0.1) == inf
    assert capture_time([0.6, 0.0], [[0.0, 0.0]], [2e-12], 0.0, 0.1) == pytest.approx([0.5 / 2e-12])


def test_intercept_by_hand():
    """Head on at (4, 0), w = (-1, 0), v = 1, eps = 0.2: the gap of 3.8 m closes at 2 m/s.

    From behind at the same speed it never closes; nor does it if a slower pursuer is passed at a distance of 3 m. One
    that stands still and is passed at 0.1 m captures as the evader comes within 0.2 m, after 4 - sqrt(0.03) s. One that
    is passed at just eps captures then.
    """
    assert intercept_time([4.0, 0.0], [-1.0, 0.0], [0.0, 0.0], 1.0, 0.2) == pytest.approx(1.9)
    assert intercept_time([4.0, 0.0], [1.0, 0.0], [0.0, 0.0], 1.0, 0.2) == inf
    assert intercept_time([4.0, 3.0], [-1.0, 0.0], [0.0, 0.0], 0.1, 0.2) == inf
    assert intercept_time([4.0, 0.1], [-1.0, 0.0], [0.0, 0.0], 0.0, 0.2) == pytest.approx(4.0 - 0.03**0.5)
    assert intercept_time([0.1, 0.0], [9.0, 0.0], [0.0, 0.0], 0.0, 0.2) == 0.0
    assert intercept_time([-3.0, 1.0], [1.0, 0.0], [0.0, 0.0], 0.0, 1.0) == 3.0


@pytest.mark.slow
def test_the_formula_of_the_paper_is_the_smallest_root():
    """2000 random cases against numpy's roots of A t^2 + 2 B t + C = 0."""
    rng = np.random.default_rng(3)
    for _ in range(2000):
        (e, w), v, eps = rng.normal(size=(2, 2)) * (4.0, 2.0), rng.uniform(0.0, 3.0), rng.uniform(0.01, 0.5)
        found = intercept_time(e, w, (0.0, 0.0), v, eps)
        a, b, c = w @ w - v**2, e @ w - eps * v, e @ e - eps**2
        roots = [t.real for t in np.roots([a, 2 * b, c]) if abs(t.imag) < 1e-12 and t.real >= 0.0]
        assert found == pytest.approx(0.0 if c <= 0.0 else min(roots, default=inf), rel=1e-6)
        assert found in {0.0, inf} or hypot(*(e + w * found)) == pytest.approx(v * found + eps, rel=1e-9)


@pytest.mark.parametrize("kind", [np.int8, np.int64])
def test_whole_numbers_are_computed_with_as_others(kind):
    """The distance of 200 m is no number of one byte, nor is the square of the speed."""
    evader, pursuers, speeds = [100, 0], [[-100, 0], [60, 0]], [12, 5]
    of_kind = [np.array(values, dtype=kind) for values in (evader, pursuers, speeds)]
    assert capture_time(*of_kind, 1.0, 2.0).tolist() == capture_time(evader, pursuers, speeds, 1.0, 2.0).tolist()
