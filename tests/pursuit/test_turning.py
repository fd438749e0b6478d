"""Paths of bounded curvature against a search over arcs, and capture times against a dense scan."""

from cmath import rect
from math import acos, asin, inf, pi, sqrt

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from desim import Capture, Evader, Motion, Scenario, Team, TurnRate, run
from desim.pursuit.events import Captured
from desim.pursuit.turning import (
    least_capture_radius,
    shortest_paths,
    turning_capture_times,
)

AHEAD = np.array([1.0 + 0j])
numbers = st.floats(-4.0, 4.0).map(lambda x: round(x, 4))
plane = st.builds(complex, numbers, numbers)


def length(target, rho=1.0):
    return float(shortest_paths(np.array([complex(target)]), np.array([rho]))[0][0])


@pytest.mark.parametrize(("target", "expected"), [(5, 5.0), (5j, 5.69646), (-5, 8.53638), (-5j, 5.69646), (0.5, None)])
def test_the_lengths_of_the_specification(target, expected):
    """A target within a turning circle is reached by turning away first: at least pi rho longer than straight."""
    assert length(target) == pytest.approx(expected, abs=1e-5) if expected else length(target) == 0.5


def searched(target, rho):
    """Return the least length of a path to a target: an arc, and then a line or an arc to the other side."""
    best, angles = inf, np.linspace(0.0, 2.0 * pi, 7201)
    for side in (1.0, -1.0):
        heading = np.exp(1j * side * angles)
        place = 1j * side * rho * (1.0 - heading)
        left = (target - place) / heading  # as seen after the arc
        line = np.abs(left.imag) <= 2e-3 * (1.0 + np.abs(left))
        best = min([best, *(rho * angles + np.abs(left))[line & (left.real >= 0.0)].tolist()])
        centre = -1j * side * rho
        on_arc = np.abs(np.abs(left - centre) - rho) <= 2e-3 * rho
        turned = np.angle((left - centre) / -centre) * -side % (2.0 * pi)
        best = min([best, *(rho * (angles + turned))[on_arc].tolist()])
    return best


@given(plane, st.floats(0.2, 3.0))
def test_no_path_of_two_pieces_is_shorter(target, rho):
    assume(abs(target) > 0.05 and abs(abs(target.imag) - 0.0) > 1e-3)
    near = abs(target - 1j * rho * np.sign(target.imag))
    assume(abs(near - rho) > 0.02 * rho)  # on the circle, the least length jumps
    assert length(target, rho) == pytest.approx(searched(target, rho), abs=0.03 * (1.0 + rho))


@given(plane, st.floats(0.2, 3.0))
def test_beyond_the_turning_circles_the_gradient_of_the_length_is_the_final_heading(target, rho):
    """The eikonal equation. On the axis behind the pursuer both sides are equally short."""
    assume(abs(target.imag) > 1e-3 and abs(target - 1j * rho * np.sign(target.imag)) > rho + 0.01)
    heading = complex(shortest_paths(np.array([target]), np.array([rho]))[1][0])
    step = 1e-6
    slopes = [(length(target + step * way, rho) - length(target - step * way, rho)) / (2 * step) for way in (1, 1j)]
    assert abs(heading) == pytest.approx(1.0)
    assert slopes == pytest.approx([heading.real, heading.imag], abs=1e-4)


@given(plane, st.floats(0.0, 0.95), st.floats(0.3, 4.0))
def test_the_capture_is_the_first_of_a_dense_scan(target, evader_speed, limit):
    assume(abs(target) > 0.06)
    (found,) = turning_capture_times(np.array([target]), AHEAD, np.ones(1), evader_speed, 0.05, limit).tolist()
    times = np.linspace(0.0, 1.02 * found + 1e-3, 5_001)
    flight = target / abs(target) * evader_speed
    reach = shortest_paths(target + flight * times, np.full(len(times), 1.0 / limit))[0] - 0.05 <= times
    assert reach.any()
    assert abs(times[reach.argmax()] - found) <= 2.0 * times[1]


def test_pursuers_are_independent_and_turned_and_mirrored_planes_are_equal():
    rng = np.random.default_rng(4)
    offsets, speeds = rng.normal(size=30) + 1j * rng.normal(size=30), rng.uniform(0.5, 3.0, 30)
    headings = np.exp(1j * rng.uniform(-pi, pi, 30))
    times = turning_capture_times(offsets, headings, speeds, 0.9, 0.1, 2.0)
    each = [
        turning_capture_times(offsets[k : k + 1], headings[k : k + 1], speeds[k : k + 1], 0.9, 0.1, 2.0)[0]
        for k in range(30)
    ]
    assert times.tolist() == pytest.approx(each, rel=1e-12)
    assert (times == inf).tolist() == ((speeds <= 0.9) & (np.abs(offsets) > 0.1)).tolist()
    turned = turning_capture_times(offsets * 1j, headings * 1j, speeds, 0.9, 0.1, 2.0)
    mirrored = turning_capture_times(offsets.conj(), headings.conj(), speeds, 0.9, 0.1, 2.0)
    assert turned.tolist() == pytest.approx(times.tolist(), rel=1e-9)
    assert mirrored.tolist() == pytest.approx(times.tolist(), rel=1e-12)
    assert turning_capture_times(offsets, headings, speeds, 0.9, 0.1, 1e6)[speeds > 1.0].tolist() == pytest.approx(
        (np.maximum(np.abs(offsets) - 0.1, 0.0) / (speeds - 0.9))[speeds > 1.0].tolist(), abs=1e-4
    )


@pytest.mark.parametrize(("ratio", "expected"), [(0.3, 0.04535), (0.5, 0.12782), (0.9, 0.44368)])
def test_the_least_capture_radius_of_the_homicidal_chauffeur(ratio, expected):
    assert least_capture_radius(1.0, ratio) == pytest.approx(expected, abs=5e-6)
    assert least_capture_radius(3.0, ratio) == pytest.approx(3.0 * least_capture_radius(1.0, ratio))
    with pytest.raises(ValueError, match="slower than the pursuer"):
        least_capture_radius(1.0, 1.0)


def dodger(distance):
    """Return a strategy that flees and, with the pursuer behind at a distance, turns aside by a right angle."""
    heading, last, ready = None, inf, True

    def strategy(state, rng):
        nonlocal heading, last, ready
        (gap,) = state.offsets.tolist()
        now = abs(gap)
        if heading is not None and now > last:  # the pursuer has passed
            heading, ready = None, False
        last, ready = now, ready or now > distance
        if heading is None and ready and now <= distance:
            heading = 1j * gap / now
        return gap / now if heading is None else heading

    return strategy


def worst_dodge(ratio):
    """Return the greatest miss distance and the distance of the dodge, in turning radii, by search.

    The pursuer turns by an angle, and misses where the closing speed is 0: the evader is then at the angle acos(g) from
    its heading, and has come there on a straight line from the axis.
    """
    side = acos(ratio)
    turned = np.linspace(1e-4, pi - side - 1e-3, 200_001)
    miss = ratio * turned - (1.0 - np.cos(turned)) / np.sin(turned + side)
    angle, most = turned[miss.argmax()], miss.max()
    begin = 1j * (1.0 - rect(1.0, angle)) + (most - ratio * angle) * rect(1.0, angle + side)
    assert angle + side == pytest.approx(pi / 2.0, abs=1e-3)
    return most, begin.real


@pytest.mark.slow_but_one
@pytest.mark.parametrize("ratio", [0.3, 0.5, 0.9])
def test_a_chauffeur_captures_an_evader_that_dodges_only_above_the_barrier(ratio):
    """10 % above and below the barrier, which is found by search, too. A fast evader is judged at its first dodge."""
    most, distance = worst_dodge(ratio)
    assert most == pytest.approx(sqrt(1 - ratio**2) + ratio * asin(ratio) - 1.0, abs=1e-8)
    until = 60.0 if ratio < 0.8 else (5.0 - distance) / (1.0 - ratio) + 1.6

    def captured(share):
        scenario = Scenario(
            team=Team(positions=((-5.0, 0.0),), speeds=1.0, dynamics=TurnRate(limit=1.0, heading=0.0)),
            evader=Evader(position=(0.0, 0.0), speed=ratio, strategy=dodger(distance)),
            capture=Capture(radius=share * most),
            motion=Motion(step=0.005),
            horizon=60.0,
        )
        result = run(scenario, 1)
        return any(event.t <= until * 1e9 for event in result.trace.of(Captured))

    assert captured(1.1)
    assert not captured(0.9)
