"""Means and their intervals against tables and against chance."""

from math import comb, isnan, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.analysis.statistics import estimate, wilson


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


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [(0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (5, 10, 0.2366, 0.7634), (81, 263, 0.2553, 0.3662)],
)
def test_the_interval_of_wilson_is_that_of_the_books(successes, trials, low, high):
    """81 of 263: Newcombe 1998, "Two-sided confidence intervals for the single proportion", Table I, method 3."""
    assert wilson(successes, trials) == pytest.approx((low, high), abs=5e-5)


@given(st.integers(1, 1000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_ends_of_the_interval_of_wilson_are_just_as_far_from_the_share_as_their_own_law_allows(case):
    """(p^ - p)^2 = z^2 p (1 - p) / n at both, one on either side of p^; failures mirror successes."""
    successes, trials = case
    low, high = wilson(successes, trials)
    assert 0.0 <= low <= successes / trials <= high <= 1.0
    for p in (low, high):
        if 0.0 < p < 1.0:
            assert (successes / trials - p) ** 2 == pytest.approx(1.959963984540054**2 * p * (1 - p) / trials)
    assert wilson(trials - successes, trials) == pytest.approx((1.0 - high, 1.0 - low))


def test_the_interval_of_wilson_covers_a_rare_event_where_that_of_the_mean_does_not():
    """20 trials at p = 0.05, all outcomes by their weights: covered with 0.925; by mean +- 1.96 s.e. with 0.639."""
    n, p = 20, 0.05
    weight = [comb(n, k) * p**k * (1 - p) ** (n - k) for k in range(n + 1)]
    covered = sum(w for k, w in enumerate(weight) if wilson(k, n)[0] <= p <= wilson(k, n)[1])
    simple = sum(w for k, w in enumerate(weight) if abs(k / n - p) <= 1.96 * sqrt(k / n * (1 - k / n) / n))
    assert covered == pytest.approx(0.925, abs=0.001)
    assert simple == pytest.approx(0.639, abs=0.001)


@pytest.mark.parametrize(("successes", "trials"), [(0, 0), (3, 2), (-1, 2)])
def test_what_are_no_successes_of_trials_is_an_error(successes, trials):
    with pytest.raises(ValueError, match=f"{successes} of {trials}"):
        wilson(successes, trials)
