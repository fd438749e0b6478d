"""Sobol indices: the shares of the variance of a model that its inputs cause.

The first-order index of an input is the share that disappears if the input is known, and its total index the share that
remains if all other inputs are known. Their difference is due to interactions. Inputs are independent and uniform.

The estimators are those of Saltelli et al. 2010, "Variance based sensitivity analysis of model output. Design and
estimator for the total sensitivity index" (table 2, b and f). They need the model at the points of two matrices A and
B, and at the points of (AB)_i, which is A with column i from B.

A model with chance is run with the same seeds at all points. The indices then divide the variance of its mean over all
possible seeds, not over the seeds that were run: each product of two values is replaced by the mean of products of
values with different seeds. The estimators therefore do not count chance as an effect: an input that only changes the
random numbers of a run has the indices 0. With one seed, the model is treated as a model without chance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan, sqrt

import numpy as np

from desim.analysis.statistics import t_quantile
from desim.config.arrays import Floats
from desim.kernel.core.portable_math import portable_sum
from desim.scenario.sweep_table import Design
from desim.study.plan.designs import unit_points


@dataclass(frozen=True)
class IndexEstimate:
    """An index with its bootstrap interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class SobolIndices:
    """The indices of d inputs."""

    first: tuple[IndexEstimate, ...]
    total: tuple[IndexEstimate, ...]
    variance: float
    """The variance of the mean over all seeds, in the squared unit of the model."""
    variance_of_chance: float
    """The mean variance of values with different seeds at one point; nan with one seed."""
    is_varied: bool
    """Whether the variance is told apart from 0; if not, indices are nan."""
    alone: IndexEstimate
    """The sum of the first-order indices: what the inputs cause without interaction."""


def saltelli_points(size: int, inputs: int, seed: int = 0) -> Floats:
    """Return the (inputs + 2, size, inputs) points of A, B and each (AB)_i, from a Sobol sequence; in [0, 1)."""
    points = unit_points(Design(size=size, seed=seed), 2 * inputs)
    a, b = points[:, :inputs], points[:, inputs:]
    return np.stack([a, b, *(np.where(np.arange(inputs) == i, b, a) for i in range(inputs))])


def sobol_indices(values: Floats, *, resamples: int = 1000, rng: np.random.Generator | None = None) -> SobolIndices:
    """Return the indices of the inputs of a model; see the module.

    The intervals are percentiles of a bootstrap over the points; see `bootstrap_ends`. They hold for the seeds that
    were run, and for about 64 points or more.

    Args:
        values: the (inputs + 2, size, seeds) values of the model at the points of `saltelli_points`.
        resamples: the number of bootstrap samples.
        rng: draws these samples; None = a generator with the seed 0.
    """
    rng = np.random.default_rng(0) if rng is None else rng
    first, total, variance = _estimates(values)
    size, seeds = values.shape[1:]
    samples = [_estimates(values[:, rng.integers(size, size=size)]) for _ in range(resamples)]
    ends = bootstrap_ends(size)
    least = float(np.percentile([sample[2] for sample in samples], ends[0]))
    is_varied = variance > 0.0 and least > 0.0
    chance = float(values[:2].var(axis=2, ddof=1).mean()) if seeds > 1 else nan

    def with_interval(estimates: Floats, of_resamples: Floats) -> tuple[IndexEstimate, ...]:
        if not is_varied:
            return tuple(IndexEstimate(nan, nan, nan) for _ in estimates)
        # Samples without variance have no index, and are left out: one nan would make both ends nan.
        intervals = np.nanpercentile(of_resamples, ends, axis=0)
        return tuple(
            IndexEstimate(value, low, high)
            for value, low, high in zip(estimates.tolist(), *intervals.tolist(), strict=True)
        )

    (alone,) = with_interval(_sums([first]), _sums([sample[0] for sample in samples])[:, np.newaxis])
    return SobolIndices(
        with_interval(first, np.array([sample[0] for sample in samples])),
        with_interval(total, np.array([sample[1] for sample in samples])),
        variance,
        chance,
        is_varied,
        alone,
    )


def bootstrap_ends(size: int) -> Floats:
    """Return the two percentiles of bootstrap samples, in %, that bound the 95 % interval of a mean of n values.

    A resampled mean varies less than the mean, by the factor sqrt(1 - 1/n), and is normal instead of Student's t: for
    ten values, plain percentiles cover the mean in 90 % of cases instead of 95 %. The percentiles are therefore widened
    for both reasons (the expanded interval of Hesterberg 2015, "What Teachers Should Know About the Bootstrap").
    """
    from scipy.special import ndtr

    outside = ndtr(-sqrt(size / (size - 1)) * t_quantile(size - 1, 0.95))
    return np.array([100.0 * outside, 100.0 * (1.0 - outside)])


def _sums(rows: Sequence[Floats]) -> Floats:
    """Return the sums of some rows."""
    return np.array([portable_sum(row.tolist()) for row in rows])


def _estimates(values: Floats) -> tuple[Floats, Floats, float]:
    """Return the first-order and total indices (inputs,), and the variance."""
    a, b, mixed = values[0], values[1], values[2:]
    means = values[:2].mean(axis=(0, 1))  # by seed: an effect of a seed that is equal at all points does not count
    variance = float(_products(values[:2] - means, values[:2] - means).mean())
    if not variance > 0.0:
        undefined = np.full(len(mixed), nan)
        return undefined, undefined, variance
    changes = mixed - a
    first = _products(np.broadcast_to(b - means, changes.shape), changes).mean(axis=1) / variance
    total = _products(changes, changes).mean(axis=1) / (2.0 * variance)
    return first, total, variance


def _products(values: Floats, others: Floats) -> Floats:
    """Return the mean product of two values with different seeds (the last axis); with one seed, the product."""
    seeds = values.shape[-1]
    if seeds == 1:
        return np.asarray(values[..., 0] * others[..., 0])
    products = values.sum(axis=-1) * others.sum(axis=-1) - (values * others).sum(axis=-1)
    return np.asarray(products / (seeds * (seeds - 1)))
