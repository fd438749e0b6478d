"""Screening: which inputs of a model have an effect, in few runs.

Source: Morris 1991, "Factorial Sampling Plans for Preliminary Computational Experiments". Each trajectory begins at a
random point of a grid of `LEVELS` levels, and changes one input after another by `STEP`, up or down, in random order.
The change of the model divided by `STEP` is an elementary effect: the change over the whole range, if the model were
linear. The step of an input with few values (a list or whole numbers) goes over half of them; the effect of a list is
the change itself.

The mean of absolute effects (mu*, Campolongo et al. 2007, "An effective screening design for sensitivity analysis of
large models") is 0 for an input without effect. An input that only changes random numbers has a mean absolute effect,
too: compare it with `of_chance`, which follows from the scatter of the runs at a point. The standard deviation of
effects is 0 for an input with a linear effect, and large for an input with interactions or a nonlinear effect.
"""

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from desim.config.arrays import Floats
from desim.study.sensitivity.sobol_indices import IndexEstimate, bootstrap_ends

LEVELS = 4
"""The number of levels of an input: 0, 1/3, 2/3, 1."""
STEP = LEVELS / (2.0 * (LEVELS - 1))
"""The change of an input, 2/3: every level is then as probable as another."""
ROUNDING = 1e-9
"""The spread of effects, relative to their size, that rounding can make; points are rounded to 12 digits."""


@dataclass(frozen=True)
class ElementaryEffects:
    """The effects of d inputs, in the unit of the model."""

    mean_absolute: tuple[IndexEstimate, ...]
    """mu*: the mean of the absolute effects of each input, with its bootstrap interval."""
    mean: tuple[float, ...]
    """mu: the mean of the effects, with their signs."""
    deviation: tuple[float, ...]
    """sigma: the standard deviation of the effects."""
    of_chance: tuple[float, ...] = ()
    """The mean absolute effect that chance alone would give each input, by the scatter of the runs; () if unknown."""

    def within_chance(self) -> list[int]:
        """Return the inputs whose mu* is above 0, and not told apart from that of chance alone."""
        pairs = enumerate(zip(self.mean_absolute, self.of_chance, strict=False))
        return [k for k, (effect, of_chance) in pairs if effect.value > 0.0 and effect.low <= of_chance]

    def matters(self, share: float) -> list[int]:
        """Return the inputs whose mu* may be at least a share of the greatest, by the upper end of its interval."""
        greatest = max(effect.value for effect in self.mean_absolute)
        return [
            k for k, effect in enumerate(self.mean_absolute) if effect.high > 0.0 and effect.high >= share * greatest
        ]


def morris_points(trajectories: int, inputs: int, rng: np.random.Generator) -> Floats:
    """Return the (trajectories, inputs + 1, inputs) points of trajectories, each in {0, 1/3, 2/3, 1}."""
    points = np.empty((trajectories, inputs + 1, inputs))
    for trajectory in points:
        low = rng.integers(LEVELS // 2, size=inputs) / (LEVELS - 1)
        up = rng.random(inputs) < 0.5
        trajectory[0] = np.where(up, low, low + STEP)
        for k, changed in enumerate(rng.permutation(inputs)):
            trajectory[k + 1] = trajectory[k]
            trajectory[k + 1, changed] = low[changed] + (STEP if up[changed] else 0.0)
    return points.round(12)


def among_items(points: Floats, rng: np.random.Generator) -> Floats:
    """Return the (trajectories, points, inputs) shares, in [0, 1), of inputs with a few values at some points.

    Level k becomes a share in quarter k of the values, at a random place that is the same along a trajectory. So any
    number of values are equally probable, and a step goes over half of them, to another value.
    """
    quarters = (points * (LEVELS - 1)).round()
    shares: Floats = (quarters + rng.random((len(points), 1, points.shape[2]))) / LEVELS
    return shares


def elementary_effects(
    points: Floats,
    values: Floats,
    spans: Floats | None = None,
    *,
    resamples: int = 1000,
    rng: np.random.Generator | None = None,
) -> ElementaryEffects:
    """Return the effects of the inputs of a model.

    Args:
        points: the points of trajectories, of `morris_points`.
        values: the (trajectories, inputs + 1) values of the model at these points; of a model with chance, the
            (trajectories, inputs + 1, seeds) values with the same seeds at all points, whose means count.
        spans: the (trajectories, inputs) shares of the ranges over which the steps go, and 1 for lists, whose effects
            are not scaled; None: the differences of the points. Where a share is 0, the step changes nothing, and the
            effect is 0.
        resamples: the number of bootstrap samples, which draw trajectories.
        rng: draws these samples; None = a generator with the seed 0.
    """
    rng = np.random.default_rng(0) if rng is None else rng
    steps = np.diff(points, axis=1)
    changed = np.abs(steps).argmax(axis=2)
    step_sizes = np.take_along_axis(steps, changed[..., None], axis=2)[..., 0]
    if spans is not None:
        step_sizes = np.copysign(np.take_along_axis(spans, changed, axis=1), step_sizes)

    def by_input(differences: Floats) -> Floats:
        """Return the (trajectories, inputs) changes over the whole ranges, given the changes at the steps in order."""
        slopes = np.divide(differences, step_sizes, out=np.zeros(changed.shape), where=step_sizes != 0.0)
        sorted_slopes = np.empty_like(slopes)
        np.put_along_axis(sorted_slopes, changed, slopes, axis=1)
        return sorted_slopes

    by_seed = np.diff(values if values.ndim == 3 else values[..., None], axis=1)
    effects, seeds = by_input(by_seed.mean(axis=2)), by_seed.shape[2]
    of_chance: list[float] = []
    if seeds > 1:  # the mean absolute value of a normal number is sqrt(2 / pi) standard deviations
        errors = by_input(by_seed.std(axis=2, ddof=1) / sqrt(seeds))
        of_chance = np.sqrt(2.0 / pi * np.square(errors).mean(axis=0)).tolist()
    draws = rng.integers(len(effects), size=(resamples, len(effects)))
    ends = bootstrap_ends(len(effects)) if len(effects) > 1 else [0.0, 100.0]
    low, high = np.percentile(np.abs(effects)[draws].mean(axis=1), ends, axis=0).tolist()
    sizes = np.abs(effects).mean(axis=0).tolist()
    spreads = effects.std(axis=0, ddof=1) if len(effects) > 1 else np.zeros(len(sizes))
    spreads[spreads <= ROUNDING * np.array(sizes)] = 0.0
    return ElementaryEffects(
        tuple(IndexEstimate(*estimate) for estimate in zip(sizes, low, high, strict=True)),
        tuple(effects.mean(axis=0).tolist()),
        tuple(spreads.tolist()),
        tuple(of_chance),
    )
