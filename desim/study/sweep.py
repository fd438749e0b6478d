"""Sweeps: many runs of each configuration of a grid, on any workers; an interrupted sweep resumes from its store."""

import hashlib
import json
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from itertools import count, takewhile
from operator import index
from pathlib import Path
from typing import Any, Self

from tqdm import tqdm

from desim.analysis.metrics import METRICS
from desim.analysis.statistics import runs_needed
from desim.config.trust import escaped
from desim.results import environment
from desim.scenario.overrides import Source
from desim.scenario.scenario import Scenario
from desim.scenario.toml import validate
from desim.study.config_hash import tables
from desim.study.configurations import Configuration, SweepGrid, configurations
from desim.study.dispatch import drive, simulation
from desim.study.result import SweepResult
from desim.study.store import Row, Store, flat
from desim.study.workers import Workers, workers_for

Job = tuple[Configuration, int]
"""A configuration and the number of one of its runs (its replication), from 0 on."""
MAX_RUNS = 10_000
"""The maximum number of runs of a configuration if `until` is given without `reps`."""


class RunError(RuntimeError):
    """Raised when a failed run ends a sweep or `desim explain`."""


@dataclass(frozen=True)
class SweepPlan:
    """The plan of a sweep: its configurations, and the seeds of their runs."""

    base: Scenario
    """The scenario that is varied."""
    configurations: tuple[Configuration, ...]
    reps: int
    """The number of runs of each configuration."""
    root: int
    """The seed of the first run."""
    common: bool = True
    """Whether run k of every configuration has the same seed."""

    @classmethod
    def of(
        cls,
        scenario: Scenario | Source,
        grid: SweepGrid | None = None,
        reps: int | None = None,
        seed: int | None = None,
    ) -> Self:
        """Return the plan in a scenario's table `sweep`; the arguments take precedence over it.

        Raises:
            ScenarioError: with all faults of the grid.
            ValueError: if there are no runs, or the seed is negative.
        """
        source = scenario if isinstance(scenario, Source) else Source.of(scenario)
        base = validate(source)
        reps, root = index(base.sweep.reps if reps is None else reps), index(base.seed if seed is None else seed)
        found = tuple(configurations(source, grid))
        return cls(base, found, reps, root, base.sweep.seeds == "common")

    def __post_init__(self) -> None:
        if self.reps < 1:
            raise ValueError(f"there should be at least one run of each configuration, got {self.reps}")
        if self.root < 0:
            raise ValueError(f"the seed should be at least 0, got {self.root}")

    @property
    def about(self) -> dict[str, Any]:
        """The properties that identify the sweep; a store belongs to one sweep."""
        keys = sorted(self.configurations[0].settings)
        swept = tuple(f"{key}." for key in keys)
        sources = {name: each for one in self.configurations for name, each in one.identity.sources.items()}
        return {
            "name": self.base.name,
            "grid": keys,
            "seeds": "common" if self.common else "independent",
            "root seed": self.root,
            "scenario": {key: each for key, each in flat(tables(self.base)).items() if not f"{key}.".startswith(swept)},
            "the code of desim": environment.code(),
            **sources,
        }

    def seed(self, configuration: Configuration, replication: int) -> int:
        """Return the seed of a run: `root` plus its number, or a hash if the configurations do not share seeds."""
        if self.common:
            return self.root + replication
        text = f"{self.root}/{configuration.key}/{replication}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:7], "big")

    def check(self, store: Store) -> None:
        """Raise StoreError if a store belongs to another sweep."""
        store.check_same(self._properties_as_json())

    def register(self, store: Store) -> None:
        """Record the properties and the configurations of the sweep in a store.

        Raises:
            StoreError: if the store belongs to another sweep, or cannot be written.
        """
        store.record_properties(self._properties_as_json())
        store.register(self.configurations)

    def _properties_as_json(self) -> dict[str, str]:
        return {name: json.dumps(each) for name, each in self.about.items()}

    def shard(self, part: int, parts: int) -> list[Job]:
        """Return the runs of shard `part` of `parts`, counted from 1; each run of the sweep is in exactly one shard.

        The order of the grid does not matter, so shards of which one has another order still are the whole sweep.

        Raises:
            ValueError: if `part` is not in 1 .. `parts`.
        """
        if not 1 <= part <= parts:
            raise ValueError(f"a shard should be 1/{parts} to {parts}/{parts}, got {part}/{parts}")
        ordered = sorted(self.configurations, key=lambda each: each.key) if parts > 1 else self.configurations
        jobs = [(configuration, k) for configuration in ordered for k in range(self.reps)]
        return jobs[part - 1 :: parts]


def sweep(
    scenario: Scenario | Source,
    grid: SweepGrid | None = None,
    reps: int | None = None,
    executor: Executor | int | str = 1,
    *,
    seed: int | None = None,
    store: str | Path | None = None,
    until: tuple[str, float] | None = None,
    fail_fast: bool = False,
    timeout: float | None = None,
) -> SweepResult:
    """Run each configuration of a grid over a scenario many times, and return the metrics of the runs.

    Use it to compare configurations on equal seeds. Give a long sweep a `store`, from which it resumes if interrupted.

        found = sweep(Scenario(), {"network.latency.value": [0.0, 0.1], "network.range": [5.0, inf]}, reps=100)
        print(found)
        found.to_frame().groupby("network.range").active_time.mean()

    Args:
        scenario: the scenario that is varied.
        grid: dotted keys of the scenario and the values that each takes: numbers, texts, also arrays, tables, protocols
            and functions of a notebook; None = the grid of `scenario.sweep`.
        reps: the number of runs of each configuration; None = that of `scenario.sweep`.
        executor: a number of worker processes (1: all runs in this process; 0: one per core), the address of a Dask
            scheduler ("tcp://host:8786"), or any executor of `concurrent.futures`, which is not shut down.
        seed: the seed of the first run; None = that of the scenario.
        store: the file that receives each run as it ends; runs that it has are not repeated; None = no file.
        until: a metric and a target: each configuration is run until the 95 % interval of the mean of the metric has at
            most this half width. It is first checked after 30 runs, and `reps` (10,000 if None) is the maximum number.
        fail_fast: whether the first run that fails ends the sweep.
        timeout: the wall time after which a run counts as failed, s; see `desim.simulation.watchdog`.

    Raises:
        ScenarioError: with all faults of the grid.
        ValueError: if there are no runs, or the metric of `until` does not exist.
        StoreError: if the store cannot be written, or belongs to another sweep.
        ConnectionError: if a scheduler does not answer.
        RunError: if a run fails and `fail_fast` is set.
    """
    if until is not None:
        check_target(*until)
    plan = SweepPlan.of(scenario, grid, MAX_RUNS if until and reps is None else reps, seed)
    with Store(None if store is None else Path(store)) as kept, workers_for(executor) as workers:
        plan.register(kept)
        return carry_out(plan, kept, workers, until=until, fail_fast=fail_fast, timeout=timeout)


def carry_out(
    plan: SweepPlan,
    store: Store,
    workers: Workers,
    *,
    until: tuple[str, float] | None = None,
    shard: tuple[int, int] = (1, 1),
    fail_fast: bool = False,
    timeout: float | None = None,
) -> SweepResult:
    """Perform the runs of a plan that its store lacks, and return the result; runs that failed before are repeated.

    A run that takes longer than `timeout`, s, counts as failed.
    """
    if until is not None:
        check_target(*until)
        if shard != (1, 1):
            raise ValueError("`until` and a shard exclude each other: `until` needs the results of all shards")
    done = {
        (configuration.key, row.replication)
        for configuration in plan.configurations
        for row in store.runs(configuration.key, plan.root)
        if row.ok
    }
    while True:
        jobs = plan.shard(*shard) if until is None else _wanted(plan, store, *until)
        jobs = [(configuration, k) for configuration, k in jobs if (configuration.key, k) not in done]
        if not jobs:
            return SweepResult.of(store, [configuration.key for configuration in plan.configurations])
        _run(jobs, plan, store, workers, fail_fast, timeout)
        done |= {(configuration.key, k) for configuration, k in jobs}


def _run(
    jobs: Sequence[Job], plan: SweepPlan, store: Store, workers: Workers, fail_fast: bool, timeout: float | None
) -> None:
    """Perform some runs, and add each to the store as it ends."""
    seeds = [plan.seed(configuration, k) for configuration, k in jobs]
    tasks = [(configuration.scenario, seed) for (configuration, _), seed in zip(jobs, seeds, strict=True)]
    bar: tqdm[Any]
    with (
        tqdm(total=len(jobs), desc=escaped(plan.base.name), unit="run", disable=None) as bar,
        closing(drive(tasks, workers, simulate=simulation(timeout))) as outcomes,
    ):
        for at, outcome in outcomes:
            (configuration, k), seed = jobs[at], seeds[at]
            store.add(configuration.key, plan.root, Row(k, seed, outcome.status, outcome.value, outcome.traceback))
            bar.update()
            if fail_fast and outcome.status != "ok":
                raise RunError(
                    f"the run of {configuration} with seed {seed} failed ({outcome.status})\n{outcome.traceback}"
                )


def check_target(metric: str, half_width: float) -> None:
    """Raise ValueError if a metric is not numeric, or its target half width is not positive."""
    numeric = [name for name, each in METRICS.items() if each.is_number]
    if metric not in numeric:
        raise ValueError(f"there is no numeric metric {metric!r}; there are {', '.join(numeric)}")
    if not half_width > 0.0:
        raise ValueError(f"the half width of {metric} should be positive, got {half_width}")


def _wanted(plan: SweepPlan, store: Store, metric: str, half_width: float) -> list[Job]:
    """Return the runs needed to reach a half width, predicted from those in the store; the latter are included."""
    jobs: list[Job] = []
    for configuration in plan.configurations:
        rows = {row.replication: row for row in store.runs(configuration.key, plan.root)}
        # Only the runs before the first that is missing count: short runs end first, so the others would be biased.
        first = takewhile(rows.__contains__, count())
        values = [getattr(rows[k].summary, metric, None) for k in first]
        jobs += [(configuration, k) for k in range(runs_needed(values, half_width, at_most=plan.reps))]
    return jobs
