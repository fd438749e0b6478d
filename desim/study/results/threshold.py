"""The value of a key from which a metric exceeds its baseline by a share, with its interval: what costs 10 %?

A run with the metric y at a value of the key, and b at the baseline with the same seed, gives the difference
y - (1 + share) b. Where its mean changes sign, the ratio of the means is 1 + share. The t test of this difference is
the one from which Fieller 1954, "Some Problems in Interval Estimation", makes the interval of a ratio of two means. The
value of the key therefore has the interval of `desim.study.results.crossover`, and the relative difference at the end
of the curve has Fieller's interval: both intervals hold the values that the same paired test does not exclude. An
interval by the delta method would be symmetric, and wrong where the baseline is not far from 0 in standard errors.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isinf, nan, sqrt
from typing import Any, Self

from desim.analysis.metrics import words
from desim.analysis.statistics import differences, t_quantile
from desim.config.arrays import Floats
from desim.config.errors import ArgumentError
from desim.config.json_numbers import json_number
from desim.config.key_index import unit_of_key
from desim.config.python_numbers import real
from desim.scenario.scenario import Scenario
from desim.study.results.crossover import (
    CrossoverInterval,
    check_paired,
    covariance,
    curve,
    interval_around,
    interval_text,
    paired_values,
    sign_changes,
    undecided_parts,
)
from desim.study.results.runs import SweepRuns, text


@dataclass(frozen=True)
class Threshold:
    """The value of a key from which a metric differs from its baseline by more than a share."""

    metric: str
    key: str
    over: float
    """The share of the baseline's mean: 0.1 = 10 % more, -0.1 = 10 % less."""
    baseline: Any
    """The value of the key at the baseline."""
    at: float | None
    """The value from which the interpolated mean exceeds the share; None = there is no such value, or all are such.

    If the mean exceeds the share at the least value of the key but not at the greatest, `at` is the first value at
    which it no longer does.
    """
    is_beyond: bool | None
    """True: the mean exceeds the share beyond `at`, or everywhere; False: below `at`, or nowhere; None: not decided."""
    low: float
    """The lower end of the confidence interval of `at`; -inf = below the least value of the key."""
    high: float
    """The upper end; inf = above the greatest value of the key."""
    crossings: tuple[float, ...]
    """All values at which the interpolated mean crosses the share."""
    pairs: int
    """The number of seeds for which all runs have a value."""
    span: CrossoverInterval
    """The least and the greatest value of the key."""
    relative: tuple[CrossoverInterval, CrossoverInterval]
    """The intervals of the relative difference from the baseline at the two ends of `span`."""
    relative_means: tuple[float, float]
    """The relative differences of the means at these two ends."""
    confidence: float
    undecided: tuple[CrossoverInterval, ...]
    """The intervals of values of the key at which it is not decided whether the mean exceeds the share, ascending."""

    @property
    def _doubt(self) -> str:
        """A note on undecided values among those of which the sentence speaks, as text; "" if there are none."""
        if self.at is None:
            doubted = self.undecided
        elif self.is_beyond:
            doubted = tuple(part for part in self.undecided if part[0] > self.high)
        else:
            doubted = tuple(part for part in self.undecided if part[1] < self.low)
        return ", though not decided at every value" if doubted else ""

    def __str__(self) -> str:
        unit = f" {name}" if (name := unit_of_key(self.key, Scenario)) else ""
        amount = f"{100 * abs(self.over):.3g} %"
        side = "over" if self.over > 0 else "under"
        subject = f"{words(self.metric)}: {{}} {amount} {side} its mean at {self.key} = {text(self.baseline)}{unit}"
        low, high = self.span
        interval = f" ({interval_text((self.low, self.high), self.span, self.confidence)}{unit})"
        if self.is_beyond is None:
            where = f" is not decided at {self.key} = {high:g}{unit}"
            sentence = subject.format("whether it is more than") + where
            sentence += "" if self.at is None else f"; the means cross at {self.at:.3g}{unit}{interval}"
        elif self.at is not None:
            where = f"from {self.key} = {self.at:.3g}{unit} {'on' if self.is_beyond else 'down'}"
            sentence = f"{subject.format('more than')} {where}{interval}{self._doubt}"
        elif self.is_beyond:
            sentence = f"{subject.format('more than')} at all of {self.key} from {low:g} to {high:g}{unit}{self._doubt}"
        else:
            sentence = f"{subject.format('not more than')} up to {high:g}{unit}"
            if self.crossings:
                sentence += f", though in between: the means cross {len(self.crossings)} times"
            else:
                sentence += self._doubt
        end = 0 if self.at is not None and self.is_beyond is False else 1
        less, more = self.relative[end]
        at_end = f"at {self.span[end]:g}{unit} it is {100 * self.relative_means[end]:+.3g} %"
        relative = "not bounded" if isinf(less) else f"{100 * less:+.3g} to {100 * more:+.3g} %"
        return f"{sentence}; {at_end} ({relative}; Fieller, {self.pairs} runs with the same seeds at each value)"

    def document(self) -> dict[str, Any]:
        """Return the threshold as JSON-compatible values."""
        return {
            "metric": self.metric,
            "key": self.key,
            "over": self.over,
            "baseline": json_number(self.baseline),
            "at": self.at,
            "is_beyond": self.is_beyond,
            "interval": None if self.at is None else [json_number(self.low), json_number(self.high)],
            "confidence": self.confidence,
            "crossings": list(self.crossings),
            "undecided": [list(ends) for ends in self.undecided],
            "pairs": self.pairs,
            "relative_at_ends": [
                {"value": value, "mean": mean, "interval": [json_number(end) for end in ends]}
                for value, mean, ends in zip(self.span, self.relative_means, self.relative, strict=True)
            ],
            "sentence": str(self),
        }

    @classmethod
    def of(
        cls,
        result: SweepRuns,
        metric: str,
        key: str,
        over: float,
        baseline: Any = None,
        where: Mapping[str, Any] | None = None,
        confidence: float = 0.95,
    ) -> Self:
        """Return the value from which a metric exceeds its baseline; see `SweepResult.threshold`."""
        check_paired(result, metric, confidence)
        over = real(over, "over")
        if not over or not -1.0 < over < inf:
            raise ArgumentError("over", f"should be a share, 0.1 for 10 %, above -1 and not 0, got {over:g}")
        reference, x, values, bases = _beside_baseline(result, metric, key, baseline, where or {})
        sign = 1.0 if over > 0.0 else -1.0
        # Positive where the metric is beyond the share, above or below the baseline.
        excess = sign * differences(values, (1.0 + over) * bases[:, None])
        means = excess.mean(axis=0).tolist()
        crossings, undecided = sign_changes(x, means), undecided_parts(x, excess, confidence)
        is_beyond: bool | None = means[-1] > 0.0
        at = None
        if crossings and is_beyond:
            at = crossings[-1]
        elif crossings and means[0] > 0.0:
            at = crossings[0]
        low, high = (nan, nan) if at is None else interval_around(at, x, undecided)
        if undecided and undecided[-1][1] >= x[-1]:
            is_beyond = None
        ends = (values[:, 0], values[:, -1])
        return cls(
            metric,
            key,
            over,
            reference,
            at,
            is_beyond,
            low,
            high,
            crossings,
            len(bases),
            (x[0], x[-1]),
            (_relative(ends[0], bases, confidence), _relative(ends[1], bases, confidence)),
            (float(ends[0].mean() / bases.mean()) - 1.0, float(ends[1].mean() / bases.mean()) - 1.0),
            confidence,
            tuple(undecided),
        )


def _beside_baseline(
    result: SweepRuns, metric: str, key: str, baseline: Any, where: Mapping[str, Any]
) -> tuple[Any, list[float], Floats, Floats]:
    """Return the setting of the baseline, the values of a key, and the metric at these values and at the baseline.

    The (k,) values ascend; the metric of n seeds is (n, k) and (n,). The baseline None is the least value.

    Raises:
        ValueError: if there are fewer than two values or seeds, or the mean at the baseline is not positive.
    """
    line = curve(result, key, where)
    x = sorted(line)
    if len(x) < 2:
        raise ValueError(f"{key}: a threshold needs two or more finite numbers, got {len(x)}")
    reference = x[0] if baseline is None else result.setting(key, baseline)
    (base,) = result.groups_with({**where, key: reference})
    table = paired_values([*(line[value] for value in x), base], metric)
    if len(table) < 2:
        raise ValueError(f"{metric}: a threshold needs two seeds with a value at all {len(x)} values of {key}")
    values, bases = table[:, :-1], table[:, -1]
    if not bases.mean() > 0.0:
        place = f"{key} = {text(reference)}"
        raise ValueError(f"{metric}: a share of the baseline needs a positive mean, got {bases.mean():g} at {place}")
    return reference, x, values, bases


def _relative(values: Floats, bases: Floats, confidence: float) -> CrossoverInterval:
    """Return Fieller's interval of mean(values) / mean(bases) - 1 for pairs; infinite if mean(bases) may be 0.

    It holds the ratios r at which the paired t interval of values - r bases includes 0: between the roots of
    (m - r n)^2 = q (v - 2 r c + r^2 w), with the means m and n, the variances v and w, the covariance c, and
    q = t^2 / runs. In powers of r this is square r^2 - 2 half r + constant = 0.
    """
    runs = len(values)
    q = t_quantile(runs - 1, confidence) ** 2 / runs
    m, n = float(values.mean()), float(bases.mean())
    square = n * n - q * covariance(bases, bases)
    if square <= 0.0:
        return -inf, inf
    half = m * n - q * covariance(values, bases)
    constant = m * m - q * covariance(values, values)
    root = sqrt(max(0.0, half * half - square * constant))
    return (half - root) / square - 1.0, (half + root) / square - 1.0
