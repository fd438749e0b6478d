"""Where two curves of a sweep cross, with a confidence interval: from which latency on is A better than B?

The curves are the means of a metric over the values of a key, joined by straight lines. The interval is that of Fieller
1954, "Some Problems in Interval Estimation": it holds the points at which a paired t test does not tell the two curves
apart. The difference at a point between two values of the key is interpolated run by run, so that common random
numbers narrow the interval. If the differences are normal, the interval covers the crossing of the interpolated true
means with the stated probability, for any number of runs. Where the two curves nearly touch, the interval may be
unbounded on one side or both: then the values of the key do not determine the crossing. A bootstrap would need random
numbers, and its intervals are always bounded. `tests/study/test_crossover.py` measures the coverage.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf, isfinite, nan, sqrt
from typing import Any, Self

import numpy as np

from desim.analysis.measuring import check_numeric
from desim.analysis.metrics import METRICS, words
from desim.analysis.statistics import chance_of_one_sign, differences, estimate, t_quantile
from desim.config.arrays import Floats
from desim.config.json_numbers import json_number
from desim.config.key_index import unit_of_key
from desim.config.python_numbers import real
from desim.kernel.core.portable_math import portable_sum
from desim.scenario.scenario import Scenario
from desim.study.plan.configurations import in_words
from desim.study.results.runs import Group, SweepRuns, is_number, text

CrossoverInterval = tuple[float, float]
ROUNDING = 1e-12
"""The relative size of a discriminant that is attributed to rounding."""


@dataclass(frozen=True)
class Crossover:
    """The value of a key from which one of two curves lies below the other."""

    metric: str
    key: str
    names: tuple[str, str]
    """The names of the two curves, a and b."""
    at: float | None
    """The last value at which the interpolated means change their order; None = they never do."""
    low: float
    """The lower end of the confidence interval of `at`; -inf = below the least value of the key."""
    high: float
    """The upper end; inf = above the greatest value of the key."""
    crossings: tuple[float, ...]
    """All values at which the means change their order."""
    least: str
    """The name of the curve that is the lower one beyond `at`, or everywhere if they do not cross."""
    more_is: str | None
    """Whether more of the metric is better or worse; None if unknown."""
    pairs: int
    """The number of seeds for which all runs have a value."""
    span: CrossoverInterval
    """The least and the greatest value of the key."""
    undecided: tuple[CrossoverInterval, ...]
    """The intervals of values of the key at which the two curves are not told apart, in ascending order."""
    confidence: float
    values: int = 1
    """The number of values of the key."""
    is_told_apart: bool = True
    """Whether a paired t test tells the two curves apart at a value beyond `at`, or at any if they do not cross.

    The level is 1 - `confidence` for all values of the key together (Bonferroni). Without this correction, a quarter of
    all studies of two equal curves over 16 values would find a winner.
    """

    @property
    def winner(self) -> str | None:
        """The better curve beyond `at`, or everywhere without a crossing, by name; the lower one if `more_is` is None.

        None: the interval of the crossing reaches the greatest value of the key, or no test beyond `at` tells the
        curves apart.
        """
        is_undecided_everywhere = any(low <= self.span[0] and high >= self.span[1] for low, high in self.undecided)
        if self.high == inf or not self.is_told_apart or (self.at is None and is_undecided_everywhere):
            return None
        other = next((name for name in self.names if name != self.least), self.least)
        return other if self.more_is == "better" else self.least

    @property
    def _level(self) -> str:
        """The level at which no value tells the curves apart, as text; "" if some value does."""
        risk = f"{100.0 * (1.0 - self.confidence):.3g} %"
        return "" if self.is_told_apart else f" at a level of {risk} for all {self.values} values together"

    def __str__(self) -> str:
        unit = f" {name}" if (name := unit_of_key(self.key, Scenario)) else ""
        low, high = self.span
        pairs = f"{self.pairs} pairs of runs with the same seed"
        method = "Bonferroni, " * (not self.is_told_apart) + pairs
        if (winner := self.winner) is None:
            relation = f"{' and '.join(self.names)} are not told apart"
        else:
            other = next((name for name in self.names if name != winner), winner)
            relation = f"{winner} {'beats' if self.more_is else 'is less than'} {other}"
        if self.at is None:  # no crossing
            if winner is None:
                place = f"for {self.key} from {low:g} to {high:g}{unit}"
                return f"{words(self.metric)}: {relation} {place}{self._level} ({method})"
            doubt = ", not at every value distinguishable from 0" if self.undecided else ""
            return (
                f"{words(self.metric)}: no crossing for {self.key} from {low:g} to {high:g}{unit}: {relation}"
                f" throughout{doubt} ({pairs})"
            )
        interval = interval_text((self.low, self.high), self.span, self.confidence)
        crossings = len(self.crossings)
        if winner is None and self.high < inf:  # a crossing that no test beyond it confirms
            how_often = f" {crossings} times, the last time" if crossings > 1 else ""
            place = f"at {self.key} = {self.at:.3g}{unit} ({interval}{unit}, Fieller)"
            beyond = f"but beyond {relation}{self._level} ({method})"
            return f"{words(self.metric)}: the means cross{how_often} {place}, {beyond}"
        several = f"; the means cross {crossings} times, and this is the last" * (crossings > 1)
        start = f"{self.at:.3g}{unit} on"
        if winner is None:  # an interval that reaches the greatest value of the key
            start = f"{low if self.low == -inf else self.low:.3g} to {high:g}{unit}"
            last = "the last time " * (crossings > 1)
            several = f"; the means cross{f' {crossings} times,' * (crossings > 1)} {last}at {self.at:.3g}{unit}"
            relation += "" if self.low == -inf else " any more"
        return (
            f"{words(self.metric)}: {relation} from {self.key} = {start} ({interval}{unit}, Fieller, {pairs}{several})"
        )

    def document(self) -> dict[str, Any]:
        """Return the crossover as JSON-compatible values."""
        return {
            "metric": self.metric,
            "key": self.key,
            "curves": list(self.names),
            "at": self.at,
            "interval": None if self.at is None else [json_number(self.low), json_number(self.high)],
            "confidence": self.confidence,
            "crossings": list(self.crossings),
            "least_beyond": self.least,
            "winner_beyond": self.winner,
            "undecided": [list(ends) for ends in self.undecided],
            "pairs": self.pairs,
            "sentence": str(self),
        }

    @classmethod
    def of(
        cls,
        result: SweepRuns,
        metric: str,
        key: str,
        a: Mapping[str, Any],
        b: Mapping[str, Any],
        where: Mapping[str, Any] | None = None,
        confidence: float = 0.95,
    ) -> Self:
        """Return where two curves of a sweep cross; see `SweepResult.crossover`."""
        check_paired(result, metric, confidence)
        lines = [curve(result, key, {**(where or {}), **settings}) for settings in (a, b)]
        x = sorted(lines[0].keys() & lines[1].keys())
        if len(x) < 2:
            raise ValueError(f"{key}: a crossover needs two or more finite numbers that both curves have, got {len(x)}")
        names = in_words(a), in_words(b)
        if names[0] == names[1]:
            raise ValueError(f"a crossover needs two curves, got {names[0]} twice")
        table = paired_values([line[value] for line in lines for value in x], metric)
        by_seed = differences(table[:, : len(x)], table[:, len(x) :])
        if len(by_seed) < 2:
            raise ValueError(f"{metric}: a crossover needs two seeds with a value at all {len(x)} values of {key}")
        means = by_seed.mean(axis=0)
        crossings = sign_changes(x, means.tolist())
        undecided = undecided_parts(x, by_seed, confidence)
        last_difference = next((value for value in reversed(means.tolist()) if value), 0.0)
        at = crossings[-1] if crossings else None
        low, high = (nan, nan) if at is None else interval_around(at, x, undecided)
        more_is = METRICS[metric].more_is if metric in METRICS else None
        return cls(
            metric,
            key,
            names,
            at,
            low,
            high,
            crossings,
            names[0] if last_difference < 0.0 else names[1],
            more_is,
            len(by_seed),
            (x[0], x[-1]),
            tuple(undecided),
            confidence,
            len(x),
            are_told_apart(x, by_seed, at, confidence),
        )


def are_told_apart(x: Sequence[float], by_seed: Floats, at: float | None, confidence: float) -> bool:
    """Return whether a test at a value beyond `at` (None: at any value) excludes 0.

    Only mean differences with the sign of the last one count. `by_seed` has the differences of the curves, (seeds,
    values). The level is 1 - `confidence` for all values together.
    """
    level = 1.0 - (1.0 - confidence) / len(x)
    beyond = [estimate(column) for value, column in zip(x, by_seed.T, strict=True) if at is None or value > at]
    last = next((difference.mean for difference in reversed(beyond) if difference.mean), 0.0)
    return any(difference.mean * last > 0.0 and difference.excludes_0(level) for difference in beyond)


def interval_around(at: float, x: Sequence[float], undecided: Sequence[CrossoverInterval]) -> CrossoverInterval:
    """Return the undecided interval around a crossing; an end at the first or last value of `x` becomes infinite."""
    near = 1e-9 * (x[-1] - x[0])  # without scatter the interval is a point, which the crossing may miss by rounding
    low, high = next((ends for ends in undecided if ends[0] - near <= at <= ends[1] + near), (at, at))
    return -inf if low <= x[0] else low, inf if high >= x[-1] else high


def interval_text(ends: CrossoverInterval, span: CrossoverInterval, confidence: float) -> str:
    """Return an interval as text; an infinite end is "below" the least or "beyond" the greatest value of the key."""
    low = f"below {span[0]:g}" if ends[0] == -inf else f"{ends[0]:.3g}"
    high = f"beyond {span[1]:g}" if ends[1] == inf else f"{ends[1]:.3g}"
    return f"{100 * confidence:g} % interval {low} to {high}"


def check_paired(result: SweepRuns, metric: str, confidence: float) -> None:
    """Raise ValueError if a metric is not numeric, the seeds are independent, or the confidence is not in (0, 1)."""
    check_numeric(metric, result.units)
    if not 0.0 < real(confidence, "the confidence") < 1.0:
        raise ValueError(f"the confidence should be between 0 and 1, got {confidence:g}")
    if not result.common:
        raise ValueError("runs with independent seeds cannot be paired: the sweep needs sweep.seeds = common")


def curve(result: SweepRuns, key: str, settings: Mapping[str, Any]) -> dict[float, Group]:
    """Return the configurations of a curve by their finite value of the key.

    Raises:
        ValueError: if the grid lacks a key or a value, a value is no number, or another key has several values.
    """
    values = result.values(key)
    if key in settings:
        raise ValueError(f"{key} is the key along which curves cross: a and b should not fix it")
    if not all(map(is_number, values)):
        raise ValueError(f"{key}: curves cross along numbers, and it takes {', '.join(map(text, values))}")
    groups = result.groups_with(settings)
    for name in result.keys:
        if name != key and len(open_values := {group.settings[name] for group in groups}) > 1:
            several = ", ".join(sorted(map(text, open_values)))
            wanted = in_words({other: result.setting(other, value) for other, value in settings.items()})
            raise ValueError(
                f"{name} takes {several} on the curve {wanted or 'of all'}: choose one"
                f' with where={{"{name}": ...}}, or --where {name}=...'
            )
    return {float(value): group for group in groups if isfinite(value := group.settings[key])}


def paired_values(groups: Sequence[Group], metric: str) -> Floats:
    """Return the (seeds, groups) values of a metric for the seeds that have a value in every group."""
    by_seed = [group.by_seed(metric) for group in groups]
    shared = sorted(set.intersection(*map(set, by_seed)))
    table = np.array([[numbers[seed] for numbers in by_seed] for seed in shared]).reshape(len(shared), len(groups))
    complete: Floats = table[np.isfinite(table).all(axis=1)]
    return complete


def sign_changes(x: Sequence[float], means: Sequence[float]) -> tuple[float, ...]:
    """Return where the polyline through the means changes its sign; along a stretch of zeros, that is the middle."""
    nonzero = [k for k, value in enumerate(means) if value]
    crossings = []
    for before, after in pairwise(nonzero):
        if means[before] * means[after] < 0.0:
            if after == before + 1:
                share = means[before] / (means[before] - means[after])
                crossings.append(x[before] + share * (x[after] - x[before]))
            else:
                crossings.append((x[before + 1] + x[after - 1]) / 2.0)
    return tuple(crossings)


def undecided_parts(x: Sequence[float], by_seed: Floats, confidence: float) -> list[CrossoverInterval]:
    """Return the intervals of points at which the paired t interval of the interpolated difference includes 0.

    On a segment with differences d and e at its ends, the difference at a share u is d + u (e - d), with the mean
    m + u s and the variance v + 2 u c + u^2 w. Here d has the mean m and the variance v, e - d the mean s and the
    variance w, and c is the covariance of both. The t interval includes 0 where (m + u s)^2 - q (v + 2 u c + u^2 w) is
    not positive, with q = t^2 / runs.
    """
    runs = len(by_seed)
    q = t_quantile(runs - 1, confidence) ** 2 / runs
    spreads = np.ptp(by_seed, axis=0).tolist()
    parts: list[CrossoverInterval] = []
    for k, (left, right) in enumerate(pairwise(x)):
        if not (spreads[k] or spreads[k + 1]) and chance_of_one_sign(runs) > 1.0 - confidence:
            parts.append((left, right))  # too few runs without scatter decide nothing, see `Estimate.excludes_0`
            continue
        start, rise = by_seed[:, k], by_seed[:, k + 1] - by_seed[:, k]
        v, c, w = covariance(start, start), covariance(start, rise), covariance(rise, rise)
        m, s = float(start.mean()), float(rise.mean())
        shares = _nonpositive_parts(s * s - q * w, 2.0 * (m * s - q * c), m * m - q * v)
        width = right - left  # rounded: left + width may differ from right
        parts += [(left + low * width, left + high * width if high < 1.0 else right) for low, high in shares]
    merged: list[CrossoverInterval] = []
    for low, high in parts:  # they ascend, as `x` does
        if merged and low <= merged[-1][1] + 1e-12 * (x[-1] - x[0]):
            merged[-1] = merged[-1][0], high
        else:
            merged.append((low, high))
    return merged


def _nonpositive_parts(a: float, b: float, c: float) -> list[CrossoverInterval]:
    """Return the intervals in [0, 1] on which a u^2 + b u + c <= 0."""
    discriminant = b * b - 4.0 * a * c
    if a > 0.0 and discriminant <= ROUNDING * b * b:  # one root, if there is no scatter, or none
        root = -b / (2.0 * a)
        return [(root, root)] if 0.0 <= root <= 1.0 and discriminant >= -ROUNDING * b * b else []
    if a == 0.0:
        roots = [-c / b] if b else []
    elif discriminant <= 0.0:
        roots = []
    else:  # the form of the two roots in which no digits cancel
        large = -(b + (sqrt(discriminant) if b >= 0.0 else -sqrt(discriminant))) / 2.0
        roots = sorted({large / a, c / large if large else 0.0})
    ends = [0.0, *(root for root in roots if 0.0 < root < 1.0), 1.0]
    inside = [(low, high) for low, high in pairwise(ends) if _at(a, b, c, (low + high) / 2.0) <= 0.0]
    touching = [(end, end) for end in (0.0, 1.0) if _at(a, b, c, end) <= 0.0]
    return inside or touching


def _at(a: float, b: float, c: float, u: float) -> float:
    return (a * u + b) * u + c


def covariance(first: Floats, second: Floats) -> float:
    """Return the covariance of two samples of equal size; its last digit is the same on all processors."""
    products: list[float] = ((first - first.mean()) * (second - second.mean())).tolist()
    return portable_sum(products) / (len(products) - 1)
