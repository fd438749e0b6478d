"""Sequential studies: the number of runs for a target precision.

A *look* is an interim check of whether the runs of a study suffice.

A sequential study ends as soon as a look finds a half width of at most a target. `python -m scenarios.coverage` made
this table from 4000 studies each (s.e. at most 0.7 %, and 0.015 for the bias). It has the share of intervals that cover
the mean, in %, the bias of the mean in half widths of the target, and the mean number of values. The target is the half
width of n = 30 or 300 values with a known sigma, 1.96 sigma / sqrt(n).

    distribution               target of   first look at 3          at 30                    at 100
    normal                            30   92.2 +0.002   34 values   94.7 +0.004   36 values   95.1 +0.011  100 values
    normal                           300   95.1 +0.003  317 values   95.1 +0.002  316 values   95.3 +0.001  318 values
    exponential                       30   80.2 -0.306   29 values   91.9 -0.070   37 values   94.0 -0.001  100 values
    exponential                      300   92.7 -0.109  315 values   93.8 -0.063  316 values   93.5 -0.064  318 values
    lognormal, sigma = 1              30   71.7 -0.421   20 values   88.0 -0.081   38 values   91.0 +0.006  101 values
    lognormal, sigma = 1             300   85.8 -0.349  279 values   88.5 -0.196  290 values   89.8 -0.165  293 values
    true with probability 0.1         30   97.4 -0.169   33 values   97.5 -0.078   36 values   94.2 -0.002  100 values
    true with probability 0.1        300   94.0 -0.107  317 values   94.6 -0.108  314 values   95.0 -0.102  317 values

A study of skewed values ends when its values happen to vary little, and then their mean is too low. So the intervals
cover the mean of exponential values in about 94 % of cases, and that of lognormal ones in 90 %. Other rules help
little. They bring lognormal values to 90 to 93 %, with up to ten times the runs: a correction as of Chow & Robbins, a
tenth more runs after the last look, and a first look at 25 to 50 times the squared skewness of the values (Cochran
1977, "Sampling Techniques", section 2.15).
"""

from collections.abc import Sequence
from math import ceil, inf, isnan

from desim.analysis.statistics import Share, mean_or_share

FIRST_LOOK = 100
"""Number of values at which `next_look` first judges their precision.

A few values may lie close together by chance, so a study whose first look is at 3 values often stops too early: its
95 % interval covers the mean of normal values 92 times in 100, and the mean of exponential values 80 times.
"""
OTHERS = 0.05
"""Values that are all equal end a sequential study if at most this share of all runs has another value."""


def runs_needed(values: Sequence[float | None], target: float, *, at_most: int, first_look: int = FIRST_LOOK) -> int:
    """Return the number of runs at which a sequential study ends, or that its next look needs.

    The study ends with the first look that finds a half width of at most `target`, or with `at_most` runs. Looks are
    taken at the same numbers of runs however many runs exist already. So a study that is interrupted and resumed ends
    at the same number of runs as an uninterrupted one. See `next_look` for the arguments.
    """
    look = next_look((), target, at_most=at_most, first_look=first_look)
    while look <= len(values):
        following_look = next_look(values[:look], target, at_most=at_most, first_look=first_look)
        if following_look == look:
            break
        look = following_look
    return look


def next_look(values: Sequence[float | None], target: float, *, at_most: int, first_look: int = FIRST_LOOK) -> int:
    """Return the number of runs that the next look needs, given the values of the first n runs; n if the study ends.

    The looks compute a sequential fixed-width confidence interval: the study ends at the first look at which the half
    width is at most the target (Chow & Robbins 1965, "On the asymptotic theory of fixed-width sequential confidence
    intervals for the mean"). The first look is at `first_look` runs. Each later look is at the number of runs predicted
    from the values, n (half width / target)^2, but at no fewer than 1.1 n and no more than 2 n runs. No look is at more
    than `at_most` runs. The limit 2 n bounds the effect of a bad estimate of the variance: at most half of the runs are
    superfluous. The limit 1.1 n keeps the looks few, because each may end the study too early by chance.

    The half width is that of the t interval, or of the Wilson interval for truth values (captured or not). A missing
    value (None or nan) counts as a run, but not for the mean. A study ends only with `at_most` runs, or with at least
    `first_look` values that are not missing. With fewer values, the next look is at the number of runs that is expected
    to give `first_look` values, at the present share of missing ones. If all values are equal numbers, the t interval
    has width 0. The look then ends the study if, by the Wilson interval, at most a share `OTHERS` of all runs has
    another value. This takes at least 73 values.

    The runs should be independent and in the order of their seeds; in the order in which they end, short runs would
    come first. The coverage is nominal only in the limit of a small target.

    Args:
        values: the values of the n runs so far.
        target: the half width to reach, in the unit of the values.
        at_most: the largest number of runs, whatever the precision.
        first_look: the number of values at which precision is first judged, at least 2.

    Raises:
        ValueError: if an argument is out of its range.
    """
    if not target > 0.0:
        raise ValueError(f"the half width to reach should be positive, got {target}")
    if at_most < 1 or first_look < 2:
        raise ValueError(f"at_most should be at least 1 and first_look at least 2, got {at_most} and {first_look}")
    count, numbers = len(values), [value for value in values if value is not None and not isnan(value)]
    if count >= at_most:
        return count
    if count < first_look:
        return min(first_look, at_most)
    numbers_needed = float(first_look)
    if len(numbers) >= first_look:
        half_width = _half_width(numbers)
        if half_width <= target:
            return count
        ratio = half_width / target
        numbers_needed = len(numbers) * ratio * ratio
    predicted = count * numbers_needed / max(len(numbers), 1)
    least, most = count + ceil(count / 10), 2 * count
    return min(max(least, ceil(min(most, predicted))), at_most)


def _half_width(values: Sequence[float]) -> float:
    """Return half the width of the 95 % interval of the mean: Wilson for truth values, else the t interval."""
    estimate = mean_or_share(values)
    is_share = isinstance(estimate, Share)
    return inf if not is_share and (estimate.others or 0.0) > OTHERS else estimate.half_width
