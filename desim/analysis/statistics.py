"""Means and their uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


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
