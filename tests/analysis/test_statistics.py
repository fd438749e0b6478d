"""Means and their intervals against tables and against chance."""

from math import isnan, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.analysis.statistics import estimate


def test_the_interval_of_1_to_5_is_that_of_the_tables():
    """Variance 10 / 4, s.e. sqrt(2.5 / 5) = sqrt(0.5), and t(4, 0.975) = 2.7764451052 (any table of Student's t)."""
    found = estimate([1, 2, 3, 4, 5])
    assert (found.mean, found.count) == (3.0, 5)
    assert found.standard_error == pytest.approx(sqrt(0.5), rel=1e-12)
    assert found.half_width == pytest.approx(2.7764451052 * sqrt(0.5), rel=1e-10)


@pytest.mark.parametrize(
    ("count", "quantile"), [(2, 12.7062047364), (3, 4.3026527300), (11, 2.2281388520), (31, 2.0422724563)]
)
def test_the_half_width_is_students_quantile_times_the_standard_error(count, quantile):
    """t(n - 1, 0.975) from tables."""
    found = estimate([float(k) for k in range(count)])
    assert found.half_width / found.standard_error == pytest.approx(quantile, rel=1e-9)


def test_a_single_value_has_a_mean_and_no_uncertainty():
    found = estimate([4.5])
    assert (found.mean, found.count) == (4.5, 1)
    assert isnan(found.standard_error)
    assert isnan(found.half_width)


def test_equal_values_have_an_interval_of_no_width():
    found = estimate([2.0] * 4)
    assert (found.mean, found.standard_error, found.half_width) == (2.0, 0.0, 0.0)


@pytest.mark.parametrize("empty", [[], (), np.array([])], ids=["list", "tuple", "array"])
def test_no_values_are_an_error(empty):
    with pytest.raises(ValueError, match="at least one value"):
        estimate(empty)


@given(st.lists(st.integers(-1000, 1000), min_size=2, max_size=30), st.integers(-8, 8), st.integers(-1000, 1000))
def test_an_estimate_follows_a_change_of_unit_and_of_origin(values, scale, shift):
    one, other = estimate(values), estimate([scale * each + shift for each in values])
    assert other.mean == pytest.approx(scale * one.mean + shift, abs=1e-7)
    assert other.standard_error == pytest.approx(abs(scale) * one.standard_error, abs=1e-7)


def test_the_interval_covers_the_mean_95_times_in_100():
    """4000 samples of five: 0.95 with s.e. 0.0034, so within 4 s.e. = 0.014.

    Negative control: 1.96 s.e. on either side, as for many values, covers 0.878 only (P(|t_4| < 1.96)).
    """
    samples = np.random.default_rng(1).normal(3.0, 2.0, size=(4000, 5))
    found = [estimate(sample) for sample in samples]
    covered = np.mean([abs(each.mean - 3.0) <= each.half_width for each in found])
    too_narrow = np.mean([abs(each.mean - 3.0) <= 1.96 * each.standard_error for each in found])
    assert covered == pytest.approx(0.95, abs=0.014)
    assert too_narrow == pytest.approx(0.878, abs=0.021)
    assert too_narrow < 0.95 - 0.014
