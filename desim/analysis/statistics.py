"""Means and their uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

NORMAL_975 = 1.959963984540054
"""The quantile of the normal law beyond which 2.5 % lie."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """The mean of independent runs and its uncertainty."""

    mean: float
    standard_error: float
    """Standard deviation / sqrt(count); nan for a single run."""
    count: int

    @property
    def half_width(self) -> float:
        """Half the width of the 95 % t interval; nan for a single run."""
        from scipy.special import stdtrit

        return float(stdtrit(self.count - 1, 0.975) * self.standard_error) if self.count > 1 else float("nan")


def estimate(values: Sequence[float]) -> Estimate:
    """Return the mean of independent values.

    Raises:
        ValueError: if there are none.
    """
    count = len(values)
    if not count:
        raise ValueError("an estimate needs at least one value")
    error = float(np.std(values, ddof=1) / np.sqrt(count)) if count > 1 else float("nan")
    return Estimate(float(np.mean(values)), error, count)


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of a probability, given how many of so many independent trials were a success.

    The probabilities p with |p^ - p| <= z sqrt(p (1 - p) / n), where p^ is the share of successes and z the normal
    quantile (Wilson 1927, "Probable Inference, the Law of Succession, and Statistical Inference"): within [0, 1], and
    of positive width even if all trials end alike.

    Raises:
        ValueError: if there are no trials, or not from 0 to `trials` successes.
    """
    if not 0 <= successes <= trials or not trials:
        raise ValueError(f"should be 0 .. trials successes of at least one trial, got {successes} of {trials}")
    share, z2 = successes / trials, NORMAL_975**2 / trials
    middle, half = share + z2 / 2.0, sqrt(z2 * (share * (1.0 - share) + z2 / 4.0))
    low = (middle - half) / (1.0 + z2) if successes else 0.0
    high = (middle + half) / (1.0 + z2) if successes < trials else 1.0
    return low, high
