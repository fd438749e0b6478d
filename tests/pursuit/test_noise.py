"""Noise of sightings: its moments, and the mean distance to a place that is known with errors."""

from math import atan2, exp, hypot, pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ive

from desim.pursuit.sensing.noise import LEAST, PositionNoise, RangeBearingNoise, expected_distance
from desim.pursuit.sensing.views import EvaderEstimate

DRAWS = 20_000


@pytest.mark.parametrize(
    ("distance", "deviation", "mean"), [(5.0, 1.0, 5.10107), (0.0, 1.0, 1.25331), (5.0, 0.0, 5.0), (0.0, 2.0, 2.50663)]
)
def test_the_mean_distance_is_that_of_a_rice_law(distance, deviation, mean):
    assert expected_distance(distance, deviation) == pytest.approx(mean, abs=1e-5)


@given(st.floats(0.0, 1e3), st.floats(1e-3, 1e3))
def test_the_mean_distance_agrees_with_bessel_functions(distance, deviation):
    """By scipy: s sqrt(pi/2) ((1 + 2 q) I0(q) + 2 q I1(q)) e^-q with q = d^2 / (4 s^2)."""
    q = (distance / deviation) ** 2 / 4.0
    if q < 1e6:
        known = deviation * sqrt(pi / 2) * ((1 + 2 * q) * ive(0, q) + 2 * q * ive(1, q))
        assert expected_distance(distance, deviation) == pytest.approx(known, rel=1e-9)
    assert expected_distance(distance, deviation) >= distance * (1 - 1e-12)


def test_an_estimate_knows_the_mean_distances_from_all_positions():
    estimate = EvaderEstimate(3 + 4j, deviation=1.0)
    assert estimate.distance(0j) == expected_distance(5.0, 1.0)
    assert estimate.distances(np.array([0j, 3 + 4j])).tolist() == [
        expected_distance(5.0, 1.0),
        expected_distance(0.0, 1.0),
    ]
    exact = EvaderEstimate(3 + 4j, uncertainty=0.5)
    assert exact.distances(np.array([0j])).tolist() == [exact.distance(0j)] == [5.5]


@pytest.mark.slow
@pytest.mark.parametrize(
    "noise",
    [
        PositionNoise(deviation=0.3),
        RangeBearingNoise(range=0.2, bearing=0.03),
        RangeBearingNoise(range=0.2, bearing=0.3),
    ],
)
@pytest.mark.parametrize("offset", [6 + 2j, -1 - 7j])
def test_sightings_have_the_mean_and_the_covariance_that_the_noise_states(noise, offset):
    """20,000 draws; a variance has a standard error of sqrt(2/n) = 1 % of itself. The control has 1.1 of the noise."""
    draws = np.random.default_rng(1).standard_normal((DRAWS, 2)).tolist()
    seen = np.array([noise(offset, *pair) - offset for pair in draws])
    xx, xy, yy = noise.covariance(offset)
    found = seen.real.var(), (seen.real * seen.imag).mean(), seen.imag.var()
    assert abs(seen.mean()) < 4 * sqrt((xx + yy) / DRAWS)
    error = sqrt(2.0 / DRAWS)
    assert abs(found[0] / xx - 1) < 4 * error
    assert abs(found[2] / yy - 1) < 4 * error
    assert abs(found[1] - xy) < 4 * sqrt(xx * yy / DRAWS) + 4 * abs(xy) * error
    assert abs(found[0] / (1.21 * xx) - 1) > 4 * error


def test_range_and_bearing_err_independently():
    """One deviation of the range, then of the bearing; a bearing would shorten the mean vector by e^(-s^2/2)."""
    noise, longer = RangeBearingNoise(range=0.5, bearing=0.1), exp(0.1**2 / 2)
    assert noise(3 + 4j, 1.0, 0.0) == pytest.approx((3 + 4j) * 5.5 / 5 * longer)
    turned = noise(3 + 4j, 0.0, 1.0)
    assert hypot(turned.real, turned.imag) == pytest.approx(5.0 * longer)
    assert atan2(turned.imag, turned.real) == pytest.approx(atan2(4.0, 3.0) + 0.1)
    assert noise(0j, 1.0, 0.0) == pytest.approx(0.5 * longer)


@given(st.floats(0.1, 1e3), st.floats(0.0, 10.0), st.floats(0.0, 1e-4))
def test_the_covariance_of_a_range_and_a_small_bearing_is_that_of_first_order(away, deviation, bearing):
    noise = RangeBearingNoise(range=deviation, bearing=bearing)
    least = (LEAST * max(deviation, away * bearing, 1.0)) ** 2
    xx, xy, yy = noise.covariance(complex(0.0, away))
    assert xy == pytest.approx(0.0, abs=1e-9 * max(xx, yy))
    assert yy == pytest.approx(max(deviation**2, least), rel=1e-6, abs=(away * bearing**2) ** 2)
    assert xx == pytest.approx(max((away * bearing) ** 2, least), rel=1e-6, abs=(deviation * bearing) ** 2 * 1.01)
