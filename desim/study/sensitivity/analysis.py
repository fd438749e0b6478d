"""Sensitivity analysis: runs at the points of trajectories, and then at the points of Sobol matrices.

Screening comes first. A key is screened out if the upper end of the interval of its mean absolute effect is below a
tenth of the greatest effect. It then keeps the middle of its range, so that the many points of the indices are spent on
the other keys. All points have the same seeds.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from desim.analysis.measuring import Metrics, check_numeric, users_metrics
from desim.analysis.metrics import unit_of
from desim.config.arguments import naming_arguments
from desim.config.arrays import Floats
from desim.config.errors import ArgumentError
from desim.config.python_numbers import whole
from desim.kernel.core.seeds import seed_of, stream
from desim.scenario.overrides import Source
from desim.scenario.scenario import Scenario, without_metrics
from desim.scenario.toml import validate
from desim.scenario.value_ranges import KeyRange, is_range, setting_at
from desim.study.plan.configurations import (
    SweepGrid,
    as_source,
    checked_ranges,
    label,
    sweep_of,
    valid_configurations,
)
from desim.study.sensitivity.morris import ElementaryEffects, among_items, elementary_effects, morris_points
from desim.study.sensitivity.sensitivity_result import SensitivityResult
from desim.study.sensitivity.sobol_indices import SobolIndices, saltelli_points, sobol_indices
from desim.study.store.store import Store
from desim.study.sweeps.metric_values import metric_values
from desim.study.sweeps.sweep import carry_out
from desim.study.sweeps.sweep_plan import SweepPlan
from desim.study.workers.executors import workers_for
from desim.study.workers.workers import Workers

POINTS, TRAJECTORIES, RUNS = 64, 10, 4
"""The default numbers of points of a matrix, of trajectories, and of runs at each point."""
SHARE = 0.1
"""The share of the greatest mean absolute effect below which a key is screened out."""


@naming_arguments
def sensitivity(
    scenario: Scenario | Source,
    grid: SweepGrid | None = None,
    metric: str = "active_time",
    *,
    points: int = POINTS,
    trajectories: int = TRAJECTORIES,
    runs: int = RUNS,
    executor: Executor | int | str = 1,
    seed: int | None = None,
    store: str | Path | None = None,
    metrics: Metrics | None = None,
    timeout: float | None = None,
    mix_versions: bool = False,
) -> SensitivityResult:
    """Find which keys decide a metric: each key's share of the variance of the metric over the ranges of the keys.

    Use it before a sweep over many keys: a sweep over those that decide is then enough.

        ranges = {"network.latency.value": "log:0.01:1", "network.loss.p": "0:0.5", "protocol": ["sap", "cbba"]}
        print(sensitivity(load("relay.toml"), ranges))

    Args:
        scenario: the scenario that is varied.
        grid: dotted keys, each with a range ("0:0.5", "log:0.01:1") or a list of equally probable values;
            None = the grid of `scenario.sweep`. A design in it has no effect.
        metric: the name of the metric; every run needs a value.
        points: the number of rows of a Sobol matrix, a power of 2; 0 = screening only. There are (keys + 2) times as
            many points; if in doubt, 64. Four times as many halve the intervals.
        trajectories: the number of trajectories of the screening, each with keys + 1 points; 0 = none, so that all keys
            have indices; if in doubt, 10.
        runs: the number of runs at each point, with the same seeds at all points. With 1, chance counts as an effect of
            the keys; if in doubt, 4, and more if the result says that most of the variance of a run is chance.
        executor: as in `sweep`.
        seed: the root seed of the runs; None = that of the scenario.
        store: the file in which runs are kept; finished runs in it are not repeated.
        metrics: metrics in addition to the built-in ones, by name.
        timeout: the wall time, s, after which a run counts as failed.
        mix_versions: as in `sweep`.

    Raises:
        TypeError: if `scenario` is no scenario.
        ScenarioError: if the scenario or the grid is invalid, or a key does not take a value of its range.
        ValueError: if fewer than two keys have several values, a number is out of its range, or the metric does not
            exist, is not numeric, or has no or an infinite value in a run.
        StoreError: if the store cannot be used; see `sweep`.
        RunError: if a run fails.
    """
    analysis = Analysis.of(scenario, grid, metric, points, trajectories, runs, seed, metrics)
    with workers_for(executor, timeout=timeout) as workers, Store(store) as analysis_store:
        return analysis.carry_out(analysis_store, workers, mix_versions=mix_versions)


@dataclass(frozen=True)
class Analysis:
    """A sensitivity analysis before its runs."""

    source: Source
    grid: SweepGrid
    """The ranges and lists of the keys."""
    metric: str
    unit: str
    points: int
    trajectories: int
    plan: SweepPlan
    """The scenario, the number of runs at each point and their seeds; `_values` adds the points as configurations."""

    @classmethod
    def of(
        cls,
        scenario: Scenario | Source,
        grid: SweepGrid | None,
        metric: str,
        points: int = POINTS,
        trajectories: int = TRAJECTORIES,
        runs: int = RUNS,
        seed: int | None = None,
        metrics: Metrics | None = None,
    ) -> Self:
        """Return the analysis; for the arguments and the errors see `sensitivity`."""
        source = as_source(scenario, "sensitivity")
        base = validate(source)
        source, sweep = sweep_of(source, grid)
        unchecked = sweep.grid
        for key, values in unchecked.items():
            if len(values) < 2 and not is_range(values):
                raise ValueError(f"{key}: has one value, {label(values[0])}: give a range or several values")
        if len(unchecked) == 1:
            (key,) = unchecked
            raise ValueError(f"{key}: with one key there is nothing to divide: give ranges of two keys or more")
        ranges = checked_ranges(source, unchecked)
        user_metrics = users_metrics(base.record.metrics, {} if metrics is None else metrics)
        check_numeric(metric, dict(user_metrics))
        points, trajectories = whole(points, "points"), whole(trajectories, "trajectories")
        if points < 0 or points & (points - 1) or 0 < points < 8:
            raise ArgumentError("points", f"should be 0 or a power of 2 from 8 on, such as 64 (got {points})")
        if trajectories < 0 or trajectories == 1 or not (points or trajectories):
            raise ArgumentError("trajectories", f"should be at least 2, or 0 with points (got {trajectories})")
        root = base.seed if seed is None else seed_of(seed)
        plan = SweepPlan(without_metrics(base), (), whole(runs, "runs"), root, metrics=user_metrics)
        unit = unit_of(metric, {name: added.unit for name, added in user_metrics})
        return cls(source, ranges, metric, unit, points, trajectories, plan)

    def carry_out(self, store: Store, workers: Workers, *, mix_versions: bool = False) -> SensitivityResult:
        """Perform the runs that a store lacks, and return the result.

        Raises:
            StoreError: if the store belongs to another sweep; see `SweepPlan.register`.
            RunError: if a run fails.
            ValueError: if a run has no value of the metric, or an infinite one.
        """

        def values_at(shares: Floats) -> Floats:
            return self._values(shares, store, workers, mix_versions)

        keys = len(self.grid)
        effects: ElementaryEffects | None = None
        kept, runs = list(range(keys)), 0
        if self.trajectories:
            points = morris_points(self.trajectories, keys, stream(0, "morris"))
            firsts = [first for first, *_ in self.grid.values()]
            # Keys with few values step over half of them.
            discrete = [k for k, first in enumerate(firsts) if not isinstance(first, KeyRange) or first.is_whole]
            points[:, :, discrete] = among_items(points[:, :, discrete], stream(0, "items"))
            values = values_at(points.reshape(-1, keys))
            runs += values.size
            by_seed = values.reshape(*points.shape[:2], -1)
            effects = elementary_effects(points, by_seed, self._spans(points), rng=stream(0, "bootstrap"))
            kept = effects.matters(SHARE)
        indices: SobolIndices | None = None
        if self.points and kept:
            points = np.full((len(kept) + 2, self.points, keys), 0.5)
            points[:, :, kept] = saltelli_points(self.points, len(kept))
            values = values_at(points.reshape(-1, keys))
            runs += values.size
            indices = sobol_indices(values.reshape(*points.shape[:2], -1), rng=stream(0, "bootstrap"))
        return SensitivityResult(
            self.plan.base.name,
            self.metric,
            self.unit,
            {
                key: str(values[0]) if is_range(values) else ", ".join(map(label, values))
                for key, values in self.grid.items()
            },
            self.plan.reps,
            runs,
            effects,
            tuple(kept),
            indices,
        )

    def _values(self, shares: Floats, store: Store, workers: Workers, mix_versions: bool) -> Floats:
        """Return the (points, runs) values of the metric at points, given their (points, keys) shares of the ranges."""
        position_of: dict[str, int] = {}
        distinct: list[dict[str, Any]] = []
        positions = []
        for settings in map(self._settings, shares.tolist()):
            positions.append(position_of.setdefault(repr(settings), len(distinct)))
            if positions[-1] == len(distinct):
                distinct.append(settings)
        plan = replace(self.plan, configurations=tuple(valid_configurations(self.source, self.grid, distinct)))
        plan.register(store, mix_versions=mix_versions)
        result = carry_out(plan, store, workers, fail_fast=True, metrics=[self.metric])
        values: Floats = metric_values(plan, result, self.metric)[positions]
        return values

    def _spans(self, points: Floats) -> Floats:
        """Return the (trajectories, keys) shares of the ranges that trajectories cover; 1 for lists."""
        spans = np.abs(points[:, -1] - points[:, 0])
        for k, (first, *_) in enumerate(self.grid.values()):
            if not isinstance(first, KeyRange):
                spans[:, k] = 1.0
            elif first.is_whole:
                ends = zip(*(map(first.at, points[:, end, k].tolist()) for end in (0, -1)), strict=True)
                spans[:, k] = [first.share_between(*pair) for pair in ends]
        return spans

    def _settings(self, shares: Sequence[float]) -> dict[str, Any]:
        return {key: setting_at(values, share) for (key, values), share in zip(self.grid.items(), shares, strict=True)}
