"""Sequential studies, which draw values until their interval is narrow enough: for `scenarios.coverage`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import e, exp, sqrt

import numpy as np
from numpy.typing import NDArray

from desim.analysis.looks import FIRST_LOOK, runs_needed
from desim.analysis.statistics import NORMAL_975, estimate, wilson

SIZES = (30, 300)
"""The numbers of values; each target is the half width of that many values of known deviation."""
FIRST_LOOKS = (3, 30, FIRST_LOOK)
MOST = 20
"""The largest number of values of a study, in multiples of the greater of its size (see `SIZES`) and its first look."""
Values = NDArray[np.float64] | NDArray[np.bool_]


@dataclass(frozen=True)
class Law:
    """A distribution with a known mean and standard deviation."""

    draw: Callable[[np.random.Generator, int], Values]
    mean: float
    deviation: float


LAWS = {
    "normal": Law(lambda rng, size: rng.normal(size=size), 0.0, 1.0),
    "exponential": Law(lambda rng, size: rng.exponential(size=size), 1.0, 1.0),
    "lognormal, sigma = 1": Law(lambda rng, size: rng.lognormal(size=size), exp(0.5), sqrt((e - 1.0) * e)),
    "true with probability 0.1": Law(lambda rng, size: rng.random(size) < 0.1, 0.1, 0.3),
}


@dataclass(frozen=True)
class Coverage:
    """How often the intervals of several studies cover the mean, and what the studies cost."""

    share: float
    """Share of the intervals that cover the mean."""
    bias: float
    """Mean error of the means, as a share of the target half width."""
    values: float
    """Mean number of values of a study."""


def covers(values: Sequence[float], mean: float) -> bool:
    """Return whether the 95 % interval of values covers a mean: Wilson's of truth values, else the t interval."""
    if isinstance(values[0], bool):
        low, high = wilson(sum(map(int, values)), len(values))
        return low <= mean <= high
    interval = estimate(values)
    return abs(interval.mean - mean) <= interval.half_width


def coverage(law: Law, size: int, first_look: int, studies: int, seed: int = 1) -> Coverage:
    """Return the coverage of studies whose target is the half width of `size` values of known deviation."""
    rng, target = np.random.default_rng(seed), NORMAL_975 * law.deviation / sqrt(size)
    covered, errors, counts = 0, [], []
    for _ in range(studies):
        drawn = law.draw(rng, MOST * max(size, first_look)).tolist()
        values = drawn[: runs_needed(drawn, target, at_most=len(drawn), first_look=first_look)]
        covered += covers(values, law.mean)
        errors.append(estimate(values).mean - law.mean)
        counts.append(len(values))
    return Coverage(covered / studies, float(np.mean(errors)) / target, float(np.mean(counts)))
