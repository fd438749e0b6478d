"""A sweep: each configuration of a grid, many times, by whatever workers, into a store from which it can go on."""

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
from desim.config.trust import visible
from desim.results import environment
from desim.scenario.overrides import Source
from desim.scenario.scenario import Scenario
from desim.scenario.toml import validate
from desim.study.config_hash import code, tables
from desim.study.configurations import Configuration, SweepGrid, configurations
from desim.study.dispatch import drive, simulation
from desim.study.result import SweepResult
from desim.study.store import Row, Store, flat
from desim.study.workers import Workers, workers_for

Job = tuple[Configuration, int]
"""A configuration and the number of one of its runs."""
MAX_RUNS = 10_000
"""How many runs of a configuration `until` asks for at most, if no number is given."""


class RunError(RuntimeError):
    """A run failed, and the sweep was to end then."""


@dataclass(frozen=True)
class SweepPlan:
    """What is to be run: configurations, and the seeds of their runs."""

    base: Scenario
    """What is varied."""
    configurations: tuple[Configuration, ...]
    reps: int
    """Runs of each configuration."""
    root: int
    """Seed of the first run."""
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
        """Return what a scenario's table `sweep` says, or what is given instead of it.

        Raises:
            ScenarioError: with all that is wrong with the grid.
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
        """What it is a sweep of; a store is of one."""
        keys = list(self.configurations[0].settings)
        swept = tuple(f"{key}." for key in keys)
        codes = {
            name: each for cell in self.configurations for name, each in code(cell.scenario).items() if "<" not in name
        }
        return {
            "name": self.base.name,
            "grid": keys,
            "seeds": "common" if self.common else "independent",
            "root seed": self.root,
            "scenario": {key: each for key, each in flat(tables(self.base)).items() if not f"{key}.".startswith(swept)},
            "the code of desim": environment.code(),
            **{f"the code of {name}": each for name, each in codes.items()},
        }

    def seed(self, cell: Configuration, replication: int) -> int:
        """Return the seed of a run: that of the first plus its number, or a hash if configurations share none."""
        if self.common:
            return self.root + replication
        text = f"{self.root}/{cell.key}/{replication}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:7], "big")

    def check(self, store: Store) -> None:
        """Raise StoreError if a store is of another sweep."""
        store.check_same(self._written())

    def enter(self, store: Store) -> None:
        """Write down in a store what it is a sweep of.

        Raises:
            StoreError: if it is of another, or cannot be written.
        """
        store.tell(self._written())
        store.enter(self.configurations)

    def _written(self) -> dict[str, str]:
        return {name: json.dumps(each) for name, each in self.about.items()}

    def shard(self, part: int, parts: int) -> list[Job]:
        """Return the runs of one of several parts, which together are all; the first part is 1.

        Raises:
            ValueError: if there is no such part.
        """
        if not 1 <= part <= parts:
            raise ValueError(f"a shard should be 1/{parts} to {parts}/{parts}, got {part}/{parts}")
        jobs = [(cell, k) for cell in self.configurations for k in range(self.reps)]
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
    """Run each configuration of a grid over a scenario, many times, and return what was measured.

        found = sweep(Scenario(), {"network.latency.value": [0.0, 0.1], "network.range": [5.0, inf]}, reps=100)
        print(found)
        found.to_frame().groupby("network.range").active_time.mean()

    Args:
        scenario: what is varied.
        grid: keys of the scenario, dotted, and the values that each takes: numbers, texts, also arrays, tables,
            protocols and functions of a notebook; the grid of `scenario.sweep` if None.
        reps: runs of each configuration; those of `scenario.sweep` if None.
        executor: a number of worker processes (1: all happens here; 0: one per core), the address of a Dask scheduler
            ("tcp://host:8786"), or any executor of `concurrent.futures`, which stays open.
        seed: that of the first run; that of the scenario if None.
        store: a file to which runs are written as they end, and of which those are taken that are there; None: none.
        until: a metric and the half width of its 95 % interval at which a configuration has runs enough; it is first
            looked at after 30, and `reps`, or 10,000 if None, are the most.
        fail_fast: whether the first run that fails ends the sweep.
        timeout: wall time after which a run has failed, s; see `desim.simulation.watchdog`.

    Raises:
        ScenarioError: with all that is wrong with the grid.
        ValueError: if there are no runs, or no such metric.
        StoreError: if the store cannot be written, or is of another sweep.
        ConnectionError: if a scheduler does not answer.
        RunError: if a run fails, and `fail_fast`.
    """
    if until is not None:
        check_target(*until)
    plan = SweepPlan.of(scenario, grid, MAX_RUNS if until and reps is None else reps, seed)
    with Store(None if store is None else Path(store)) as kept, workers_for(executor) as workers:
        plan.enter(kept)
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
    """Do what a plan says and its store does not have yet; runs that failed before are tried again.

    A run that takes longer than `timeout`, s, has failed.
    """
    if until is not None:
        check_target(*until)
        if shard != (1, 1):
            raise ValueError("how many runs are needed depends on all of them: `until` and a shard exclude each other")
    done = {
        (cell.key, row.replication) for cell in plan.configurations for row in store.runs(cell.key, plan.root) if row.ok
    }
    while True:
        jobs = plan.shard(*shard) if until is None else _wanted(plan, store, *until)
        jobs = [(cell, k) for cell, k in jobs if (cell.key, k) not in done]
        if not jobs:
            return SweepResult.of(store, [cell.key for cell in plan.configurations])
        _run(jobs, plan, store, workers, fail_fast, timeout)
        done |= {(cell.key, k) for cell, k in jobs}


def _run(
    jobs: Sequence[Job], plan: SweepPlan, store: Store, workers: Workers, fail_fast: bool, timeout: float | None
) -> None:
    """Do some runs, and write down each as it ends."""
    seeds = [plan.seed(cell, k) for cell, k in jobs]
    tasks = [(cell.scenario, seed) for (cell, _), seed in zip(jobs, seeds, strict=True)]
    bar: tqdm[Any]
    with (
        tqdm(total=len(jobs), desc=visible(plan.base.name), unit="run", disable=None) as bar,
        closing(drive(tasks, workers, simulate=simulation(timeout))) as outcomes,
    ):
        for at, outcome in outcomes:
            (cell, k), seed = jobs[at], seeds[at]
            store.add(cell.key, plan.root, Row(k, seed, outcome.status, outcome.value, outcome.traceback))
            bar.update()
            if fail_fast and outcome.status != "ok":
                raise RunError(f"the run of {cell} with seed {seed} failed ({outcome.status})\n{outcome.traceback}")


def check_target(metric: str, half_width: float) -> None:
    """Raise ValueError if a metric cannot be measured to a half width."""
    numeric = [name for name, each in METRICS.items() if each.is_number]
    if metric not in numeric:
        raise ValueError(f"there is no metric {metric!r} to be measured; there are {', '.join(numeric)}")
    if not half_width > 0.0:
        raise ValueError(f"the half width of {metric} should be positive, got {half_width}")


def _wanted(plan: SweepPlan, store: Store, metric: str, half_width: float) -> list[Job]:
    """Return the runs that a precision takes as far as can be told, those that are there included."""
    jobs: list[Job] = []
    for cell in plan.configurations:
        rows = {row.replication: row for row in store.runs(cell.key, plan.root)}
        first = takewhile(rows.__contains__, count())  # without gaps, or the luck of the short ones would count
        values = [getattr(rows[k].summary, metric, None) for k in first]
        jobs += [(cell, k) for k in range(runs_needed(values, half_width, at_most=plan.reps))]
    return jobs
