"""Means and their intervals against tables and against chance."""

from functools import partial
from itertools import pairwise
from math import comb, exp, inf, isnan, nan, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import betainc, stdtr

from desim.analysis import looks, statistics
from desim.analysis.looks import FIRST_LOOK, OTHERS
from desim.analysis.statistics import differences, estimate, independent, paired, wilson
from desim.study.results.costs import Saving

next_look = partial(looks.next_look, first_look=30)
runs_needed = partial(looks.runs_needed, first_look=30)
"""With a first look at 30 values, for which numbers are easy to check."""


def test_the_interval_of_1_to_5_is_that_of_the_tables():
    """Variance 10 / 4, s.e. sqrt(2.5 / 5) = sqrt(0.5), and t(4, 0.975) = 2.7764451052 (any table of Student's t)."""
    found = estimate([1, 2, 3, 4, 5])
    assert (found.mean, found.count) == (3.0, 5)
    assert found.standard_error == pytest.approx(sqrt(0.5), rel=1e-12)
    assert found.half_width == pytest.approx(2.7764451052 * sqrt(0.5), rel=1e-10)


def test_an_estimate_as_text_has_its_interval():
    assert str(estimate([1, 2, 3, 4, 5])) == "3 +- 2 (95 % interval, 5 runs)"
    assert str(estimate([4.5])) == "4.5 +- nan (95 % interval, 1 run)"


def test_a_mean_as_text_is_as_exact_as_its_interval():
    """Four digits of 123,456 +- 12 would be 123,500."""
    found = [
        statistics.Estimate(mean, error, 30) for mean, error in ((123456.0, 6.0), (12345.678, 0.25), (3.14159, 0.2))
    ]
    assert [str(one).partition(" (")[0] for one in found] == ["123456 +- 12", "12345.68 +- 0.51", "3.142 +- 0.41"]
    assert str(estimate([123456.0] * 2)).startswith("123456 in all of 2 runs")


@pytest.mark.parametrize(
    ("count", "quantile"), [(2, 12.7062047364), (3, 4.3026527300), (11, 2.2281388520), (31, 2.0422724563)]
)
def test_the_half_width_is_students_quantile_times_the_standard_error(count, quantile):
    """t(n - 1, 0.975) from tables."""
    found = estimate([float(k) for k in range(count)])
    assert found.half_width / found.standard_error == pytest.approx(quantile, rel=1e-9)


def test_the_repr_of_an_estimate_has_its_half_width():
    """Of 1 to 5: sqrt(0.5) 2.7764451052 = 1.96324; Welch's estimate has it, too."""
    assert repr(estimate([1, 2, 3, 4, 5])) == "Estimate(mean=3, half_width=1.96324, standard_error=0.707107, count=5)"
    assert repr(statistics.independent([1.0, 2.0], [1.0, 2.0])).startswith("IndependentDifference(mean=0, half_width=")


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


@pytest.mark.slow
@given(st.lists(st.integers(-1000, 1000), min_size=2, max_size=30), st.integers(-8, 8), st.integers(-1000, 1000))
def test_an_estimate_follows_a_change_of_unit_and_of_origin(values, scale, shift):
    one, other = estimate(values), estimate([scale * each + shift for each in values])
    assert other.mean == pytest.approx(scale * one.mean + shift, abs=1e-7)
    assert other.standard_error == pytest.approx(abs(scale) * one.standard_error, abs=1e-7)


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [(0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (5, 10, 0.2366, 0.7634), (81, 263, 0.2553, 0.3662)],
)
def test_the_interval_of_wilson_is_that_of_the_books(successes, trials, low, high):
    """81 of 263: Newcombe 1998, "Two-sided confidence intervals for the single proportion", Table I, method 3."""
    assert wilson(successes, trials) == pytest.approx((low, high), abs=5e-5)


@pytest.mark.slow
@given(st.integers(1, 1000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_ends_of_the_wilson_interval_solve_its_equation(case):
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
def test_impossible_numbers_of_successes_are_an_error(successes, trials):
    with pytest.raises(ValueError, match=f"{successes} of {trials}"):
        wilson(successes, trials)


def test_a_share_has_the_interval_of_wilson_and_covers_as_often_as_it_says():
    """All outcomes of 10 and 30 trials by their weights; the t interval, the control, has no width if all are equal."""
    for n, p, expected, by_t in ((10, 0.95, 0.914, 0.401), (30, 0.95, 0.939, 0.785), (30, 0.5, 0.957, 0.957)):
        shares = [statistics.share([True] * k + [False] * (n - k)) for k in range(n + 1)]
        weights = [comb(n, k) * p**k * (1 - p) ** (n - k) for k in range(n + 1)]
        pairs = list(zip(weights, shares, strict=True))
        covered = sum(weight for weight, one in pairs if one.interval[0] <= p <= one.interval[1])
        means = [(weight, statistics.Estimate(one.mean, one.standard_error, n)) for weight, one in pairs]
        narrow = sum(weight for weight, one in means if abs(one.mean - p) <= one.half_width)
        assert (covered, narrow) == (pytest.approx(expected, abs=0.001), pytest.approx(by_t, abs=0.001))
    found = statistics.mean_or_share([True] * 29 + [False])
    assert found.interval == wilson(29, 30)
    assert found.bars == pytest.approx((29 / 30 - wilson(29, 30)[0], wilson(29, 30)[1] - 29 / 30))
    assert str(found) == "0.9667 (0.8333 to 0.9941, 95 % Wilson interval, 30 runs)"
    assert type(statistics.mean_or_share([1.0, 0.0])) is statistics.Estimate
    assert statistics.mean_or_share([True]).interval == wilson(1, 1)
    assert statistics.share([]).count == 0
    assert found.half_width == found.half_width_at(0.95) < found.half_width_at(0.99)
    assert wilson(29, 30, 0.95) == pytest.approx(wilson(29, 30, 0.9500001), abs=1e-6)
    assert estimate([1.0, 2.0, 3.0]).bars == pytest.approx((estimate([1.0, 2.0, 3.0]).half_width,) * 2)


def test_equal_values_have_no_error_bar():
    """A bar of no length would say that the mean is certain; the interval of a share has a width."""
    assert np.isnan(estimate([2.0, 2.0, 2.0]).bars).all()
    assert np.isnan(estimate([2.0]).bars).all()
    low, _ = wilson(3, 3)
    assert statistics.share([True] * 3).bars == pytest.approx((1.0 - low, 0.0))


LAWS = {
    "normal": (lambda rng, size: rng.normal(size=size), 0.0, 1.0),
    "exponential": (lambda rng, size: rng.exponential(size=size), 1.0, 1.0),
    "rare": (lambda rng, size: rng.exponential(size=size) * (rng.random(size) < 0.1), 0.1, sqrt(0.2 - 0.01)),
    "lognormal": (lambda rng, size: rng.lognormal(size=size), exp(0.5), sqrt((exp(1.0) - 1.0) * exp(1.0))),
}
"""Each law with its mean and its standard deviation."""


def four_errors(probability, trials):
    """4 standard errors of the share of so many trials: what chance exceeds once in 16,000."""
    return 4.0 * sqrt(probability * (1.0 - probability) / trials)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "count", "expected"),
    [
        *[("normal", 2, 0.950), ("normal", 5, 0.950), ("normal", 30, 0.950)],
        *[("exponential", 2, 0.911), ("exponential", 5, 0.883), ("exponential", 30, 0.926)],
        *[("lognormal", 2, 0.894), ("lognormal", 5, 0.822), ("lognormal", 30, 0.883)],
        *[("rare", 2, 0.186), ("rare", 5, 0.368), ("rare", 30, 0.754)],
    ],
)
def test_the_t_interval_covers_the_mean_as_often_as_the_header_says(law, count, expected):
    """2000 samples, within 4 s.e.: at most 0.035.

    Negative controls: 1.96 s.e. on either side of normal values cover P(|t_{n-1}| < 1.96), 0.700 of 2, 0.878 of 5; of
    skewed values the nominal 0.95 itself is excluded.
    """
    draw, mean, _ = LAWS[law]
    found = [estimate(sample) for sample in draw(np.random.default_rng(2), (2000, count))]
    covered = np.mean([abs(each.mean - mean) <= each.half_width for each in found])
    assert covered == pytest.approx(expected, abs=four_errors(expected, 2000))
    if law != "normal":
        assert covered < 0.95 - four_errors(0.95, 2000)
    elif count < 30:
        too_narrow = np.mean([abs(each.mean - mean) <= 1.96 * each.standard_error for each in found])
        theory = 1.0 - 2.0 * stdtr(count - 1, -1.96)
        assert too_narrow == pytest.approx(theory, abs=four_errors(theory, 2000))
        assert too_narrow < 0.95 - four_errors(0.95, 2000)


@pytest.mark.slow
def test_the_t_interval_of_two_exponential_times_has_the_coverage_of_theory():
    """Their sum S ~ Gamma(2) and |x - y| / S ~ U(0, 1) are independent, and 1 is covered if |S - 2| <= c |x - y|.

    With c = t(1, 0.975) and a = 2 / (1 + c), the integral over S of (1 - |S - 2| / (c S))+ is 0.9109.
    4000 samples: within 4 s.e. = 0.018.
    """
    c = 12.7062047364
    a = 2.0 / (1.0 + c)
    short = (2.0 * (1.0 - exp(-a)) - (1.0 + c) * (1.0 - (1.0 + a) * exp(-a))) / c
    theory = 1.0 - (1.0 + 2.0 * exp(-2.0)) / c + short
    found = [estimate(sample) for sample in np.random.default_rng(3).exponential(size=(4000, 2))]
    covered = np.mean([abs(each.mean - 1.0) <= each.half_width for each in found])
    assert theory == pytest.approx(0.9109, abs=5e-5)
    assert covered == pytest.approx(theory, abs=four_errors(theory, 4000))


@pytest.mark.parametrize(
    ("trials", "expected", "simple"), [(2, 0.9565, 0.3333), (5, 0.9552, 0.6406), (30, 0.9524, 0.8749)]
)
def test_the_interval_of_wilson_covers_probabilities_on_average_95_times_in_100(trials, expected, simple):
    """The integral over p in [low, high] of the binomial weight of k is (I_high - I_low)(k + 1, n - k + 1) / (n + 1).

    Exact. Negative control: k / n +- 1.96 s.e., which has no width at 0 and n.
    """

    def mean_coverage(interval):
        ends = [(k, *interval(k)) for k in range(trials + 1)]
        weights = [np.diff(betainc(k + 1, trials - k + 1, np.clip(pair, 0.0, 1.0))).item() for k, *pair in ends]
        return sum(weights) / (trials + 1)

    def around_the_share(k):
        half = 1.96 * sqrt(k / trials * (1 - k / trials) / trials)
        return k / trials - half, k / trials + half

    assert mean_coverage(lambda k: wilson(k, trials)) == pytest.approx(expected, abs=5e-5)
    assert mean_coverage(around_the_share) == pytest.approx(simple, abs=5e-5)


def test_the_paired_difference_of_three_pairs_is_that_of_the_tables():
    """Differences 1, 2, 6: mean 3, variance (4 + 1 + 9) / 2 = 7, s.e. sqrt(7 / 3), t(2, 0.975) = 4.3026527300."""
    found = paired([11.0, 22.0, 36.0], [10.0, 20.0, 30.0])
    assert (found.mean, found.count) == (3.0, 3)
    assert found.standard_error == pytest.approx(sqrt(7.0 / 3.0), rel=1e-12)
    assert found.half_width == pytest.approx(4.3026527300 * sqrt(7.0 / 3.0), rel=1e-9)


def test_variation_shared_by_pairs_costs_no_precision():
    """Values that differ by 2 in every pair, however much they vary: half width 0, where each mean has 2.27."""
    common = [float(k) for k in range(10)]
    found = paired([each + 2.0 for each in common], common)
    assert (found.mean, found.standard_error, found.half_width) == (2.0, 0.0, 0.0)
    assert estimate(common).half_width > 2.0


NUMBERS = st.integers(-1000, 1000)
MAYBE = NUMBERS | st.sampled_from([None, nan, np.float64("nan")])


@given(st.lists(st.tuples(MAYBE, MAYBE), max_size=30))
def test_a_pair_counts_if_both_are_there_and_for_just_as_much_with_the_sign_of_its_order(pairs):
    values, others = [one for one, _ in pairs], [other for _, other in pairs]
    there = [(x, y) for x, y in pairs if x is not None and y is not None and not isnan(x) and not isnan(y)]
    found, mirrored = paired(values, others), paired(others, values)
    assert found.count == mirrored.count == len(there)
    if there:
        expected = estimate([x - y for x, y in there])
        assert (found.mean, mirrored.mean) == (expected.mean, -expected.mean)
        assert repr((found.standard_error, mirrored.standard_error)) == repr((expected.standard_error,) * 2)


@pytest.mark.parametrize(
    ("values", "others"),
    [([], []), ([None, 1.0], [1.0, None]), ([nan], [1.0]), (np.array([1.0]), np.array([nan])), ([inf], [inf])],
    ids=["no pairs", "one of each missing", "nan", "arrays", "inf - inf"],
)
def test_no_pair_left_is_a_count_of_0_and_no_number(values, others):
    found = paired(values, others)
    assert found.count == 0
    assert isnan(found.mean)
    assert isnan(found.standard_error)
    assert isnan(found.half_width)


@pytest.mark.parametrize("kind", [bool, np.bool_, int])
def test_the_difference_of_truth_values_is_that_of_their_shares(kind):
    """3 of 4 against 1 of 4: 0.5."""
    ones, others = [[kind(x) for x in row] for row in ([1, 1, 1, 0], [0, 1, 0, 0])]
    assert paired(ones, others).mean == 0.5


@pytest.mark.parametrize(("values", "others"), [([1.0, 2.0], [1.0]), ([], [1.0])])
def test_runs_that_are_no_pairs_are_an_error(values, others):
    with pytest.raises(ValueError, match=f"{len(values)} and {len(others)}"):
        paired(values, others)


@pytest.mark.slow
def test_the_paired_interval_covers_the_difference_and_is_narrow():
    """1500 studies of 20 pairs with correlation 0.9 and difference 0.5, each value missing with probability 0.1.

    Covered with 0.95, s.e. 0.006; the variance of a difference is 2 - 1.8 = 0.2 instead of 2.
    Negative controls: the s.e. of independent runs, 3.16 times as large, covers P(|t_15| < 6.7), all but always; pairs
    of different seeds have an interval 3.16 times as wide.
    """
    rng = np.random.default_rng(4)
    values, others = np.moveaxis(rng.multivariate_normal([3.5, 3.0], [[1.0, 0.9], [0.9, 1.0]], size=(1500, 20)), -1, 0)
    values[rng.random(values.shape) < 0.1] = others[rng.random(others.shape) < 0.1] = nan
    found, unpaired = (list(map(paired, values, those)) for those in (others, np.roll(others, 1, axis=1)))
    error, half_width, count, missed = np.array(
        [(each.standard_error, each.half_width, each.count, abs(each.mean - 0.5)) for each in found]
    ).T
    apart = np.sqrt((np.nanvar(values, axis=1, ddof=1) + np.nanvar(others, axis=1, ddof=1)) / count)
    assert np.mean(missed <= half_width) == pytest.approx(0.95, abs=four_errors(0.95, 1500))
    assert np.mean(missed <= half_width * apart / error) > 0.999 > 0.95 + four_errors(0.95, 1500)
    assert np.mean(error**2 * count) == pytest.approx(0.2, abs=0.006)
    assert np.mean([each.half_width for each in unpaired]) == pytest.approx(sqrt(10.0) * half_width.mean(), rel=0.05)


def test_an_infinite_value_is_not_equal_to_others():
    assert differences(np.array([inf, 1.0, 2.0]), np.ones(3)).tolist() == [inf, 0.0, 1.0]
    found = estimate([inf, 1.0])
    assert (found.mean, str(found)) == (inf, "inf +- nan (95 % interval, 2 runs)")


def test_differences_that_differ_by_rounding_are_equal():
    """0.3 - 0.2 and 1.3 - 1.2 differ in the last bit, and 0.1 + 0.2 - 0.3 from 0; the control differs by 1e-12."""
    found = paired([0.3, 1.3, 2.3], [0.2, 1.2, 2.2])
    assert len({0.3 - 0.2, 1.3 - 1.2, 2.3 - 2.2}) > 1
    assert (found.mean, found.standard_error, found.excludes_0()) == (pytest.approx(0.1), 0.0, False)
    none = paired([0.1 + 0.2] * 9, [0.3] * 9)
    assert (none.mean, none.excludes_0()) == (0.0, False)
    assert paired([0.3, 1.3, 2.3], [0.2, 1.2, 2.2 + 1e-12]).standard_error > 0.0
    assert Saving.of([0.3 - 0.2, 1.3 - 1.2, 2.3 - 2.2]).mean.standard_error == 0.0


def false_positives(judge, draw, studies=1000):
    """Return the share of studies without any effect in which a test tells two apart."""
    rng = np.random.default_rng(5)
    return np.mean([judge(draw(rng)) for _ in range(studies)])


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3, 5, 6, 10])
def test_differences_that_are_all_equal_are_no_effect_if_there_are_few(count):
    """Each pair differs by 1 or -1, equally probable: all by the same with probability 2^(1 - n), 0.5 for two pairs.

    1000 studies; at a level of 5 % the share is at most 0.05 by its binomial law, here at most 4 s.e. = 0.028 more.
    Control: an interval without width excludes 0 at any level.
    """

    def draw(rng):
        return estimate(rng.choice([-1.0, 1.0], count))

    assert false_positives(lambda one: one.excludes_0(), draw) <= 0.05 + four_errors(0.05, 1000)
    by_width = false_positives(lambda one: abs(one.mean) > one.half_width, draw)
    if count < 5:
        assert by_width == pytest.approx(2.0 ** (1 - count), abs=four_errors(2.0 ** (1 - count), 1000))
        assert by_width > 0.05 + four_errors(0.05, 1000)
    equal = estimate([1.0] * count)
    assert [equal.excludes_0(level) for level in (0.95, 0.999)] == [count >= 6, count >= 11]
    assert not estimate([0.0] * count).excludes_0()


@pytest.mark.parametrize("unit", [2.0**-480, 2.0**-300, 2.0**270, 2.0**500])
def test_the_intervals_of_very_great_and_small_values_are_those_in_their_unit(unit):
    first, second = np.array([1.0, 2.0, 4.0]), np.array([2.0, 5.0, 5.5, 7.0])
    usual, scaled = independent(first, second), independent(unit * first, unit * second)
    assert scaled.half_width == pytest.approx(unit * usual.half_width, rel=1e-12)


def test_two_samples_that_are_equal_each_are_told_apart_if_there_are_enough():
    """Of 2 n values, n are on one side by chance in 2 of the binomial coefficient: 2 of 6, 20 and 70."""
    found = [statistics.independent([1.0] * count, [0.0] * count) for count in (2, 3, 4)]
    assert [one.excludes_0() for one in found] == [False, False, True]
    assert [one.excludes_0(1.0 - 2.0 / 69) for one in found] == [False, False, True]
    assert not found[-1].excludes_0(1.0 - 2.0 / 71)
    assert statistics.independent([1.0] * 600, [0.0] * 600).excludes_0()  # no float holds the coefficient
    assert not statistics.independent([0.1 + 0.2, 0.3], [0.2, 0.2]).excludes_0()  # equal but for rounding
    assert statistics.independent([0.3 + 1e-12, 0.3], [0.2, 0.2]).excludes_0()


@given(st.lists(st.integers(-9, 9), min_size=2, max_size=30).filter(lambda values: len({*values}) > 1))
def test_values_that_differ_are_judged_by_the_t_test(values):
    found = estimate(values)
    assert found.excludes_0() == (abs(found.mean) > found.half_width)
    assert not estimate([5.0]).excludes_0()


HALF_30 = 2.0452296421 / sqrt(29.0)
"""Half width of 15 times 1 and 15 times -1: t(29, 0.975) sqrt(30 / 29 / 30)."""
SIGNS = [1.0, -1.0] * 15


@pytest.mark.parametrize(("count", "at_most", "expected"), [(0, 100, 30), (1, 100, 30), (29, 100, 30), (5, 20, 20)])
def test_the_first_look_is_at_30_runs_or_at_the_most_there_may_be(count, at_most, expected):
    """Also of values that agree entirely."""
    assert next_look([1.0] * count, 1.0, at_most=at_most) == expected


def test_the_first_look_is_at_100_runs_unless_it_is_said():
    assert FIRST_LOOK == 100
    assert [looks.next_look([1.0, 2.0] * k, 100.0, at_most=200) for k in (0, 49, 50)] == [100, 100, 100]


def test_a_look_ends_where_the_half_width_is_at_most_the_target_and_not_before():
    exact = estimate(SIGNS).half_width
    assert exact == pytest.approx(HALF_30, rel=1e-9)
    assert next_look(SIGNS, exact, at_most=100) == 30
    assert next_look(SIGNS, np.nextafter(exact, 0.0), at_most=100) == 33


@pytest.mark.parametrize(
    ("ratio", "expected"),
    [(1.49, 45), (1.51, 46), (1.97, 60), (1.0001, 33), (1.09, 33), (1.11, 34), (3.0, 60), (1e300, 60)],
)
def test_the_next_look_is_where_the_half_width_predicts_within_1_1_and_2_times_the_runs(ratio, expected):
    """n (half width / target)^2 of 30: 44.7, 45.3, 59.1; below 33 it is 33, above 60 it is 60."""
    assert next_look(SIGNS, HALF_30 / sqrt(ratio), at_most=100) == expected


def test_an_unreachable_target_of_many_runs_is_no_overflow():
    """Ratios of 1e200, whose square is beyond the largest number, and of 1e450, which is so itself."""
    assert next_look([1e150, -1e150] * 15, 1e-50, at_most=100) == 60
    assert next_look([1e150, -1e150] * 15, 1e-300, at_most=100) == 60


@pytest.mark.parametrize(("count", "expected"), [(30, 33), (31, 35), (70, 77), (71, 79), (100, 110)])
def test_a_tenth_more_is_rounded_up(count, expected):
    values = [(-1.0) ** k for k in range(count)]
    assert next_look(values, 0.9999 * estimate(values).half_width, at_most=1000) == expected


@pytest.mark.parametrize(("at_most", "expected"), [(1, 30), (30, 30), (31, 31), (59, 59), (60, 60), (61, 60)])
def test_there_are_never_more_runs_than_may_be_and_none_is_taken_back(at_most, expected):
    assert next_look(SIGNS, 1e-6, at_most=at_most) == expected


def test_values_that_are_all_equal_end_it_where_few_runs_may_differ():
    """By Wilson's interval of 0 in n, z^2 / (n + z^2), which is 0.0506 for n = 72 and 0.04999 for 73."""
    assert next_look([2.5] * 30, 1e-9, at_most=100) == 60
    assert next_look([2.5] * 72, 1e-9, at_most=200) == 144
    assert next_look([2.5] * 73, 1e-9, at_most=200) == 73
    assert wilson(0, 73)[1] < OTHERS < wilson(0, 72)[1]


@given(st.floats(-1e9, 1e9), st.integers(2, 200))
def test_equal_values_have_a_bound_on_the_others_instead_of_a_width(value, count):
    """Control: one other value, and the bound is that of no interval."""
    found = estimate([value] * count)
    assert (found.mean, found.standard_error) == (value, 0.0)
    assert found.others == pytest.approx(3.841458820694124 / (count + 3.841458820694124))
    assert f"at most {found.others:.1%} differ" in str(found)
    assert estimate([value] * count + [value + 1.0 + abs(value)]).others is None
    assert estimate([value]).others is None


@pytest.mark.parametrize("kind", [bool, np.bool_])
@pytest.mark.parametrize("outcome", [True, False])
def test_thirty_captures_in_a_row_do_not_prove_that_the_next_one_succeeds(kind, outcome):
    """Wilson's interval of 30 of 30 is z^2 / (30 + z^2) = 0.1135 wide; of numbers, it has no width."""
    values = [kind(outcome)] * 30
    assert next_look(values, 0.0567, at_most=100) == 33
    assert next_look(values, 0.0568, at_most=100) == 30
    assert next_look([float(each) for each in values], 0.0567, at_most=100) == 60


def test_truth_values_are_counted_to_judge_their_share():
    """15 of 30: half width z sqrt(1/4 n + z^2 / 4 n^2) / (1 + z^2 / n) = 0.1685, of n = 30."""
    assert next_look([True, False] * 15, 0.1686, at_most=100) == 30
    assert next_look([True, False] * 15, 0.1684, at_most=100) == 33


def test_truth_values_among_numbers_are_numbers():
    assert next_look([True, -1.0] * 15, 1.001 * HALF_30, at_most=100) == 30
    assert next_look([True, -1.0] * 15, 0.999 * HALF_30, at_most=100) == 33


@pytest.mark.parametrize("missing", [None, nan])
@pytest.mark.parametrize(
    ("there", "runs", "target", "expected"),
    [
        (30, 60, 1.01 * HALF_30, 60),
        (30, 60, HALF_30 / sqrt(1.391), 84),
        (30, 60, HALF_30 / 2.0, 120),
        (28, 40, 1.01 * HALF_30, 44),
        (20, 60, 100.0, 90),
        (14, 60, 100.0, 120),
        (2, 30, 100.0, 60),
        (0, 30, 100.0, 60),
    ],
)
def test_missing_values_count_as_runs_but_not_towards_the_mean(missing, there, runs, target, expected):
    """Of 30 values in 60 runs 41.7 would do: 83.5 runs. Of fewer than 30, none ends it: 60 * 30 / 20 = 90 have 30."""
    values = [missing] * (runs - there) + SIGNS[:there]
    assert next_look(values, target, at_most=1000) == expected


@given(st.lists(MAYBE, max_size=80), st.floats(0.1, 1e4), st.integers(1, 200), st.integers(-20, 20))
def test_there_is_a_next_look_or_an_end_and_it_does_not_depend_on_the_unit(values, target, at_most, exponent):
    """Either no more runs, or to the first look, or from a tenth more to twice as many; at most what may be."""
    found, count = next_look(values, target, at_most=at_most), len(values)
    scale = 2.0**exponent
    assert next_look([x if x is None else x * scale for x in values], target * scale, at_most=at_most) == found
    assert count <= found <= max(at_most, count)
    if 30 <= count < found < at_most:
        assert 1.1 * count <= found + 1e-9 <= 2 * count + 1
    if found == count < at_most:
        there = [x for x in values if x is not None and not isnan(x)]
        assert estimate(there).half_width <= target
        assert len(there) >= 30


@pytest.mark.parametrize(
    ("target", "options", "named"),
    [
        (0.0, {"at_most": 9}, "got 0.0"),
        (-1.0, {"at_most": 9}, "got -1.0"),
        (nan, {"at_most": 9}, "got nan"),
        (1.0, {"at_most": 0}, "got 0 and 30"),
        (1.0, {"at_most": 9, "first_look": 1}, "got 9 and 1"),
    ],
)
@pytest.mark.parametrize("asked", [next_look, runs_needed])
def test_a_precision_that_cannot_be_is_an_error(asked, target, options, named):
    with pytest.raises(ValueError, match=named):
        asked([], target, **options)


def test_a_target_of_any_width_ends_at_the_first_look():
    assert runs_needed([*SIGNS, 5.0], float("inf"), at_most=100) == 30


@pytest.mark.slow
@settings(max_examples=50)
@given(st.lists(MAYBE, min_size=60, max_size=60), st.floats(50.0, 1000.0), st.integers(1, 60), st.integers(2, 20))
def test_an_interrupted_study_ends_where_it_would_have_ended_anyway(values, target, at_most, first_look):
    """Looks from the start, one after the other; however many runs are there already, the answer is one of them."""
    rule = {"at_most": at_most, "first_look": first_look}
    looks = [next_look([], target, **rule)]
    while (following := next_look(values[: looks[-1]], target, **rule)) > looks[-1]:
        looks.append(following)
    asked = [runs_needed(values[:count], target, **rule) for count in range(len(values) + 1)]
    assert asked[-1] == looks[-1] <= at_most
    assert set(asked) == set(looks)
    assert all(one <= other for one, other in pairwise(asked))
    assert all(found > count for count, found in enumerate(asked[: looks[-1]]))


@pytest.mark.slow
def test_a_rare_capture_is_covered_if_truth_values_are_judged_as_such():
    """p = 0.05 to within 0.04, 1000 studies: 0.974, s.e. 0.005.

    Negative control: the t interval of 30 numbers 0 and 1, of which one in 0.95^30 = 0.21 has no width.
    """
    rng, p = np.random.default_rng(6), 0.05
    covered = as_numbers = 0
    for _ in range(1000):
        values = (rng.random(400) < p).tolist()
        count = runs_needed(values, 0.04, at_most=400)
        low, high = wilson(sum(values[:count]), count)
        covered += low <= p <= high
        numbers = [float(each) for each in values]
        found = estimate(numbers[:30])
        as_numbers += abs(found.mean - p) <= found.half_width
    assert covered / 1000 > 0.95 - four_errors(0.95, 1000)
    assert as_numbers / 1000 < 1.0 - 0.95**30 + four_errors(0.79, 1000) < 0.95 - four_errors(0.95, 1000)


def test_an_estimate_has_the_form_of_a_number():
    """1 and 3: the mean is 2, and half the width of its interval 12.706 * 1."""
    assert f"{estimate([1.0, 3.0]):+.1f}" == "+2.0 +- 12.7"
    assert f"{estimate([1.0, 3.0])}" == str(estimate([1.0, 3.0]))
