"""Turning: shortest paths of bounded curvature against brute force, and capture times against a scan."""

from cmath import rect
from math import inf, pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from desim.pursuit.motion.capture import RadialTime
from desim.pursuit.motion.turning import shortest_path, turning_capture_times

seeds = st.integers(0, 2**32 - 1)
ANGLES = np.linspace(0.0, 2.0 * pi, 1_441)


def paths_to(targets, radius=1.0):
    """Return the lengths and the final headings of the shortest paths to targets, all with one radius."""
    lengths, headings = zip(*(shortest_path(complex(target), radius) for target in targets), strict=True)
    return np.array(lengths), np.array(headings)


def lengths_of(targets, radius):
    """Return the lengths of the shortest paths to targets, all with one radius."""
    return paths_to(targets, radius)[0]


def moved(targets, side, length, radius):
    """Return targets as seen after a move along an arc to the left (1), to the right (-1), or straight on (0)."""
    if not side:
        return targets - length
    turn = np.exp(1j * side * length / radius)
    return (targets - (turn - 1.0) * radius / (1j * side)) / turn


def brute_force(target, radius):
    """Return the least length of an arc and a line, or of an arc and an arc to the other side, that meets a target."""
    best = inf
    for side in (1, -1):

        def seen(angle, side=side):
            return moved(target, side, angle * radius, radius)

        def beside(angle, seen=seen):
            return seen(angle).imag

        def off_circle(angle, seen=seen, side=side):
            return abs(seen(angle) + 1j * side * radius) - radius

        for angle in (0.0, *roots(beside)):
            if seen(angle).real >= 0.0 and abs(beside(angle)) < 1e-9:
                best = min(best, angle * radius + seen(angle).real)
        for angle in (0.0, *roots(off_circle)):
            if abs(off_circle(angle)) < 1e-9:
                around = (seen(angle) + 1j * side * radius) / (1j * side * radius)  # 1 at the start of the second arc
                best = min(best, radius * (angle + (-side * np.angle(around)) % (2.0 * pi)))
    return best


def roots(function):
    """Return the angles in [0, 2 pi] at which a function changes its sign."""
    values = function(ANGLES)
    for k in np.flatnonzero(values[:-1] * values[1:] <= 0.0):
        if values[k] and values[k + 1]:
            yield brentq(function, ANGLES[k], ANGLES[k + 1], xtol=1e-14)
        else:
            yield ANGLES[k] if not values[k] else ANGLES[k + 1]


# Shortest paths.


@pytest.mark.parametrize(
    ("target", "length"), [(5.0, 5.0), (5j, 5.69646), (-5j, 5.69646), (-5.0, 8.53638), (0.0, 0.0), (1 + 1j, pi / 2)]
)
def test_lengths_by_numbers(target, length):
    """With rho = 1: straight on; aside, sqrt(5^2 - 2 * 5) = sqrt(15) from the tangent point; behind; a quarter turn."""
    assert lengths_of([target], 1.0)[0] == pytest.approx(length, abs=5e-6)


@pytest.mark.parametrize("target", [1 + 1.5j, 0.5 + 0.3j, 3 + 0.5j, -2 + 5j])
def test_along_the_final_heading_the_length_grows_by_the_distance(target):
    """By differences, within and beyond the turning circle, on the left and on the right."""
    targets = np.array([target, target.conjugate()])
    _, headings = paths_to(targets)
    grown = lengths_of(targets + 1e-6 * headings, 1.0) - lengths_of(targets - 1e-6 * headings, 1.0)
    assert grown == pytest.approx([2e-6, 2e-6], rel=1e-6)


def test_a_target_behind_by_rounding_alone_is_not_reached_by_a_full_turn():
    """At 1e-10 of the radius, a full turn would be less than 1e-9 rad longer than the angle; at 1e-8 it is due."""
    length, heading = shortest_path(-2e-10 + 0j, 2.0)
    assert (length, heading) == (pytest.approx(2e-10), pytest.approx(1.0))
    assert shortest_path(-2e-8 + 0j, 2.0)[0] == pytest.approx(4.0 * pi)


def test_the_length_of_a_path_to_a_target_aside_has_a_closed_form():
    """To (0, y) at the left, D = y - rho: a turn of pi - acos(rho / D) with theta = pi, then sqrt(D^2 - rho^2)."""
    for y in (2.5, 5.0, 40.0):
        exact = pi - np.arccos(1.0 / (y - 1.0)) + sqrt((y - 1.0) ** 2 - 1.0)
        assert lengths_of([1j * y, -1j * y], 1.0) == pytest.approx([exact, exact], rel=1e-14)


@pytest.mark.slow
@given(seeds, st.sampled_from([0.3, 1.0, 2.5]), st.sampled_from([0.9, 3.0, 30.0]))
def test_paths_are_as_short_as_brute_force_finds(seed, radius, spread):
    """Targets within and beyond the turning circles, on both sides, of which the nearer ones need two arcs."""
    x, y = np.random.default_rng(seed).uniform(-spread, spread, (2, 4)) * radius
    found = lengths_of(x + 1j * y, radius)
    assert found == pytest.approx([brute_force(each, radius) for each in (x + 1j * y).tolist()], rel=1e-8, abs=1e-8)


@pytest.mark.slow
@given(seeds, st.sampled_from([0.3, 1.0, 2.5]), st.sampled_from([-1, 0, 1]), st.floats(0.0, 3.0))
def test_no_first_move_makes_a_path_shorter(seed, radius, side, share):
    """Bellman's inequality L(z) <= s + L(z as seen after s), with equality for the turn to the left or to the right.

    It makes L a lower bound of every path of arcs and lines, and not of brute force's two pieces only.
    """
    rng = np.random.default_rng(seed)
    targets = (rng.normal(size=300) + 1j * rng.normal(size=300)) * radius * rng.choice([0.5, 2.0, 10.0], 300)
    now, move = lengths_of(targets, radius), share * radius
    later = move + lengths_of(moved(targets, side, move, radius), radius)
    assert (now <= later + 1e-6 * (radius + later)).all()


@pytest.mark.slow
@given(seeds)
def test_a_path_of_this_length_exists(seed):
    """A small step to the left, to the right or straight on makes it shorter by the length of the step."""
    rng = np.random.default_rng(seed)
    targets = (rng.normal(size=300) + 1j * rng.normal(size=300)) * rng.choice([0.5, 2.0, 10.0], 300)
    now, step = lengths_of(targets, 1.0), 1e-7
    best = np.min([step + lengths_of(moved(targets, side, step, 1.0), 1.0) for side in (-1, 0, 1)], axis=0)
    assert best == pytest.approx(now, abs=1e-9)


@pytest.mark.slow
@given(seeds)
def test_beyond_the_turning_circles_the_gradient_of_the_length_is_the_final_heading(seed):
    """The eikonal equation, by differences, a little off the line behind, where both sides are equally short."""
    rng = np.random.default_rng(seed)
    targets = rng.normal(size=200) * 2.0 + 2.0j * rng.normal(size=200)
    _, headings = paths_to(targets)
    smooth = (np.abs(targets - 1j * np.sign(targets.imag)) > 1.02) & (np.abs(targets.imag) > 1e-3)
    for step in (1e-6, 1e-6j):
        slopes = (lengths_of(targets + step, 1.0) - lengths_of(targets - step, 1.0)) / 2e-6
        along = (headings * np.conj(step)).real / 1e-6
        assert along[smooth] == pytest.approx(slopes[smooth], abs=1e-4)
    assert np.abs(headings) == pytest.approx(1.0)


@pytest.mark.slow
@given(seeds)
def test_as_a_target_moves_away_the_length_grows_no_faster_than_its_distance(seed):
    """So L - v t falls, and has one root; where the target leaves a turning circle, the length falls at once."""
    rng = np.random.default_rng(seed)
    bearing = np.exp(1j * rng.choice([rng.uniform(-pi, pi), pi / 2 + 0.05 * rng.normal()]))
    distances = np.linspace(1e-3, 3.0, 2_001)
    assert np.diff(lengths_of(distances * bearing, 1.0)).max() <= (distances[1] - distances[0]) * (1.0 + 1e-9)


@pytest.mark.slow
@given(seeds)
def test_lengths_are_symmetric_and_scale(seed):
    """Mirrored targets have mirrored paths; twice the radius and twice the distance make twice the length."""
    rng = np.random.default_rng(seed)
    targets = rng.normal(size=100) * 2.0 + 2.0j * rng.normal(size=100)
    (left, ahead), (right, mirrored) = (paths_to(z) for z in (targets, targets.conj()))
    assert (left == right).all()
    assert (ahead == mirrored.conj()).all()
    assert lengths_of(2.0 * targets, 2.0) == pytest.approx(2.0 * left, rel=1e-9)


# Capture times.


def missing(times, offset, evader_speed, heading, speed, radius, limit):
    """Return L - eps - v t at (k,) times."""
    targets = (offset + evader_speed * times * offset / abs(offset)) / heading
    return lengths_of(targets, speed / limit) - radius - speed * times


@pytest.mark.parametrize(("offset", "length"), [(5.0, 5.0), (5j, 5.69646), (-5.0, 8.53638)])
def test_a_still_target_is_captured_after_its_path(offset, length):
    """phi = (L - eps) / v, with v = 2 m/s and omega = 2 rad/s, so that rho = 1 m; headings turn it all."""
    for heading in (1.0 + 0j, rect(1.0, 2.0)):
        (time,) = turning_capture_times(
            np.array([offset * heading]), np.array([heading]), np.array([2.0]), 0.0, 0.1, 2.0
        )
        assert time == pytest.approx((length - 0.1) / 2.0, abs=3e-6)


@pytest.mark.slow
@given(seeds, st.sampled_from([0.3, 1.0, 5.0]))
def test_captures_are_the_first_in_a_scan(seed, spread):
    """Evaders that begin within a turning circle are among them: as they leave it, L falls at once."""
    rng = np.random.default_rng(seed)
    for _ in range(4):
        offset, heading = complex(*rng.normal(size=2)) * spread, rect(1.0, rng.uniform(-pi, pi))
        limit, radius, flight = rng.choice([0.5, 1.0, 3.0]), rng.choice([0.02, 0.3]), rng.uniform(0.0, 0.98)
        (time,) = turning_capture_times(np.array([offset]), np.array([heading]), np.ones(1), flight, radius, limit)
        if abs(offset) <= radius:
            assert time == 0.0
            continue
        own, scale = (offset, flight, heading, 1.0, radius, limit), 1.0 + abs(offset) + 1.0 / limit
        assert missing(np.array([time * (1.0 + 1e-11)]), *own)[0] <= 1e-9 * scale
        assert (missing(np.linspace(0.0, time * (1.0 - 1e-9), 2_000), *own) > -1e-8 * scale).all()


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.6 + 0.6j, 0.3 + 0.2j, 0.3 - 0.2j])
def test_a_capture_as_the_evader_leaves_a_turning_circle(offset):
    """Within the circle the pursuer needs two arcs. On it, L falls by more than 4 m at once, to below v t.

    From z, the evader is on it at z s, where |z s - i rho| = rho: s = 2 rho |y| / |z|^2.
    """
    values = missing(np.linspace(0.0, 4.0, 40_001), offset, 0.3, 1.0 + 0j, 1.0, 0.02, 1.0)
    assert np.diff(values).min() < -4.0
    (found,) = turning_capture_times(np.array([offset]), np.ones(1, complex), np.ones(1), 0.3, 0.02, 1.0)
    leaves = (2.0 * abs(offset.imag) / abs(offset) ** 2 - 1.0) * abs(offset) / 0.3
    assert found == pytest.approx(leaves, rel=1e-9)


@pytest.mark.slow
@given(seeds)
def test_several_are_each_alone(seed):
    rng = np.random.default_rng(seed)
    offsets, headings = rng.normal(size=(2, 7)) * 2.0 + 2.0j * rng.normal(size=(2, 7))
    headings, speeds = headings / np.abs(headings), rng.choice([0.5, 1.0, 2.0], 7)
    together = turning_capture_times(offsets, headings, speeds, 0.9, 0.1, 1.3)
    alone = [turning_capture_times(offsets[[k]], headings[[k]], speeds[[k]], 0.9, 0.1, 1.3)[0] for k in range(7)]
    assert together == pytest.approx(alone, rel=1e-11)
    order = rng.permutation(7)
    again = turning_capture_times(offsets[order], headings[order], speeds[order], 0.9, 0.1, 1.3)
    assert again == pytest.approx(together[order], rel=1e-11)


def test_without_a_limit_the_capture_time_is_radial():
    """And a limit only ever delays."""
    rng = np.random.default_rng(1)
    offsets = rng.normal(size=50) * 5.0 + 5.0j * rng.normal(size=50)
    headings, speeds = np.exp(1j * rng.uniform(-pi, pi, 50)), rng.uniform(1.0, 3.0, 50)
    radial = RadialTime(speeds, 0.9, 0.1)(np.abs(offsets))
    before = turning_capture_times(offsets, headings, speeds, 0.9, 0.1, 0.2)
    for limit in (1.0, 5.0, 1e3, 1e6):
        found = turning_capture_times(offsets, headings, speeds, 0.9, 0.1, limit)
        assert (radial <= found * (1.0 + 1e-12)).all()
        assert (found <= before * (1.0 + 1e-9)).mean() > 0.9  # not all: within a turning circle, more room may help
        before = found
    assert before == pytest.approx(radial, rel=1e-4, abs=1e-4)


def test_the_slow_and_the_captured():
    """A pursuer no faster than the evader never captures it; within the radius, each has captured it."""
    offsets, headings = np.array([3.0, 3.0, 0.1, 3.0], complex), np.ones(4, complex)
    times = turning_capture_times(offsets, headings, np.array([0.5, 0.9, 0.5, 1.0]), 0.9, 0.1, 1.0)
    assert times == pytest.approx([inf, inf, 0.0, 29.0])
    assert turning_capture_times(np.zeros(1, complex), headings[:1], np.ones(1), 0.5, 0.1, 1.0)[0] == 0.0
