"""Sweeps: many runs of each configuration of a grid, on any workers; an interrupted sweep resumes from its store."""

from collections.abc import Callable, Collection, Generator, Sequence
from concurrent.futures import Executor
from contextlib import closing
from functools import partial
from itertools import count, takewhile
from pathlib import Path
from typing import Any

from desim.analysis.looks import runs_needed
from desim.analysis.measuring import Metrics, UsersMetrics, check_numeric, measured
from desim.config.arguments import naming_arguments, value_text
from desim.config.python_numbers import real
from desim.scenario.overrides import Source
from desim.scenario.scenario import Scenario
from desim.scenario.sweep_table import Design
from desim.study.plan.configurations import Configuration, SweepGrid
from desim.study.results.result import SweepResult
from desim.study.results.runs import SHOWN
from desim.study.store.run_table import Row
from desim.study.store.store import Store
from desim.study.sweeps.sweep_plan import MAX_RUNS, Job, SweepPlan
from desim.study.workers.batch_system import JobExecutor
from desim.study.workers.dispatch import drive_batches
from desim.study.workers.executors import workers_for
from desim.study.workers.progress import advance, progress
from desim.study.workers.workers import Workers


class RunError(RuntimeError):
    """Raised when a failed run ends a sweep or `desim explain`."""


@naming_arguments
def sweep(
    scenario: Scenario | Source,
    grid: SweepGrid | None = None,
    reps: int | None = None,
    executor: Executor | JobExecutor | Workers | int | str = 1,
    *,
    seed: int | None = None,
    design: Design | str | None = None,
    store: str | Path | None = None,
    until: tuple[str, float] | None = None,
    fail_fast: bool = False,
    timeout: float | None = None,
    metrics: Metrics | None = None,
    mix_versions: bool = False,
) -> SweepResult:
    """Run each configuration of a grid over a scenario many times, and return the metrics of the runs.

    Use this function to compare configurations on equal seeds. Give a long sweep a `store`: if interrupted, it resumes
    from there.

        swept = sweep(Scenario(), {"network.latency.value": [0.0, 0.1], "network.range": [5.0, inf]}, reps=100)
        print(swept)
        swept.to_frame().groupby("network.range").active_time.mean()
        print(sweep(Scenario(), grid, metrics={"late": lambda result: end_time(result) > 4.0}).table(["late"]))

    Args:
        scenario: the scenario that is varied.
        grid: dotted keys of the scenario and the values that each takes: numbers, texts, arrays, tables, protocols, and
            functions, even if defined in a notebook; or a range, "0:1:0.1", "log:0.01:1:5", or "0:1" with a design.
            None = the grid of `scenario.sweep`.
        reps: the number of runs of each configuration; None = that of `scenario.sweep`.
        executor: a number of worker processes (0: the number of cores; 1: all runs in this process), the address of a
            Dask scheduler ("tcp://host:8786"), any executor of `concurrent.futures`, which is not shut down, or one of
            a batch system, such as submitit's; `desim.study.workers.batch_system.JobWorkers` chooses how many jobs.
        seed: the root seed, from which the seeds of all runs are derived; None = the seed of the scenario.
        design: which points of the ranges of the grid are run, "sobol:64" for instance (`desim.scenario.sweep_table`);
            None = the design of `scenario.sweep` if its grid is used, else no design.
        store: the file to which each batch of runs is added as it ends; successful runs in it are not repeated; None =
            no file.
        until: a metric and a half width: each configuration is run until the 95 % interval of the mean of the metric
            has at most this half width. The interval is first checked when 100 runs have a value of the metric. `reps`
            (10,000 if None) is the maximum number of runs of a configuration. None = each configuration has `reps`
            runs.
        fail_fast: whether the first run that fails ends the sweep.
        timeout: the wall time, s, after which a run counts as failed; None = no limit; see
            `desim.simulation.watchdog`.
        metrics: metrics to compute in addition to the built-in ones, by name; see `desim.analysis.metrics`. A stored
            run that lacks one of them is repeated. If a metric raises an exception, its run counts as failed.
        mix_versions: whether runs may be added to a store whose runs were computed by another Python or other versions
            of numpy, scipy, SimPy or networkx. Last digits may then differ between runs.

    Raises:
        TypeError: if `scenario` is no scenario, or the grid is not a mapping; the message says what to write instead.
        ScenarioError: if the scenario or the grid is invalid; the message lists the errors.
        ValueError: if there are no runs, a number is out of its range, the metric of `until` does not exist or is not
            numeric, or a metric of `metrics` has a wrong name, is not a function or has no stable hash.
        StoreError: if the store cannot be written, belongs to another sweep, or has runs of other versions.
        ConnectionError: if a scheduler does not answer or has no workers.
        BrokenExecutor: if a worker of the user's own executor dies.
        RunError: if a run fails and `fail_fast` is set.
    """
    plan = SweepPlan.of(scenario, grid, MAX_RUNS if until is not None and reps is None else reps, seed, metrics, design)
    if until is not None:
        pair: Any = until
        if not isinstance(pair, list | tuple) or len(pair) != 2:
            example = "('active_time', 0.1)"
            raise ValueError(
                f"until should be a metric and a half width, {example} for instance (got {value_text(until)})"
            )
        until = until[0], real(until[1], f"the half width of {until[0]}")
        check_target(*until, plan.metrics)
    with workers_for(executor, plan.runs, timeout) as workers, Store(store) as sweep_store:
        plan.register(sweep_store, mix_versions=mix_versions)
        return carry_out(plan, sweep_store, workers, until=until, fail_fast=fail_fast)


def carry_out(
    plan: SweepPlan,
    store: Store,
    workers: Workers,
    *,
    until: tuple[str, float] | None = None,
    shard: tuple[int, int] = (1, 1),
    fail_fast: bool = False,
    metrics: Collection[str] = SHOWN,
    on_start: Callable[[], None] = lambda: None,
) -> SweepResult:
    """Perform the runs of a plan that a store lacks, and return the result; runs that failed before are repeated.

    A stored run is repeated if it lacks one of the given metrics, the metric of `until` or a metric of the plan. If the
    repetition fails, the stored run is kept, and the result reports the failure. `on_start` is called before the first
    run, unless there is none to perform.

    Raises:
        ValueError: if `until` is invalid, or given together with one of several shards.
        RunError: if a run fails and `fail_fast` is set.
    """
    if until is not None:
        check_target(*until, plan.metrics)
        if shard != (1, 1):
            raise ValueError("`until` and a shard exclude each other: `until` needs the results of all shards")
    done = plan.done(store, {"captured", *metrics, *(() if until is None else until[:1])})
    failed: dict[tuple[str, int], Row] = {}
    is_started = False
    while True:
        jobs = plan.shard(*shard) if until is None else _jobs_until(plan, store, *until, failed.keys())
        jobs = [(configuration, k) for configuration, k in jobs if (configuration.key, k) not in done]
        if not jobs:
            return SweepResult.of(store, [configuration.key for configuration in plan.configurations], failed)
        if not is_started:
            on_start()
            is_started = True
        failed |= perform_jobs(jobs, plan, store, workers, fail_fast=fail_fast)
        done |= {(configuration.key, k) for configuration, k in jobs}


def perform_jobs(
    jobs: Sequence[Job], plan: SweepPlan, store: Store, workers: Workers, *, fail_fast: bool
) -> dict[tuple[str, int], Row]:
    """Perform some runs, add each batch to the store as it ends, and return those that failed.

    Raises:
        RunError: if a run fails and `fail_fast` is set.
    """
    failed: dict[tuple[str, int], Row] = {}
    with (
        progress(len(jobs), plan.base.name, "run") as bar,
        closing(job_batches(jobs, plan, store, workers)) as batches,
    ):
        for batch in batches:
            advance(bar, len(batch))
            for configuration, row in batch:
                if not row.ok:
                    failed[configuration.key, row.replication] = row
                if fail_fast:
                    check_ok(configuration, row)
    return failed


def job_batches(
    jobs: Sequence[Job], plan: SweepPlan, store: Store, workers: Workers
) -> Generator[list[tuple[Configuration, Row]], None, None]:
    """Perform some runs, add each batch to the store as it ends, and yield it."""
    seeds = [plan.seed(configuration, k) for configuration, k in jobs]
    tasks = [(configuration.scenario, seed) for (configuration, _), seed in zip(jobs, seeds, strict=True)]
    measure = partial(measured, plan.metrics)
    with closing(drive_batches(tasks, workers, measure)) as batches:
        for batch in batches:
            rows = [
                (jobs[k][0], Row(jobs[k][1], seeds[k], outcome.status, outcome.value, outcome.traceback))
                for k, outcome in batch
            ]
            store.add_all(plan.root, [(configuration.key, row) for configuration, row in rows])
            yield rows


def check_ok(configuration: Configuration, row: Row) -> None:
    """Raise RunError if a run failed: one sentence, with the traceback of the run as a note."""
    if not row.ok:
        error = RunError(f"the run of {configuration} with seed {row.seed} failed: {row.failure}")
        error.add_note(row.traceback)
        raise error


def check_target(metric: str, half_width: float, user_metrics: UsersMetrics = ()) -> None:
    """Raise ValueError if there is no numeric metric of this name, or its target half width is not positive."""
    check_numeric(metric, dict(user_metrics))
    if not half_width > 0.0:
        raise ValueError(f"the half width of {metric} should be positive, got {half_width}")


def _jobs_until(
    plan: SweepPlan, store: Store, metric: str, half_width: float, failed: Collection[tuple[str, int]]
) -> list[Job]:
    """Return runs 0 .. n - 1 of each configuration; n is the number of runs that the half width needs.

    If it is not yet known when the half width is reached, n is the number of runs at which the half width is checked
    next; see `runs_needed`. A run that fails when it is repeated counts as a run without a value.
    """
    jobs: list[Job] = []
    for configuration in plan.configurations:
        stored = store.runs(configuration.key, plan.root)
        summaries = {row.replication: row.summary for row in stored if row.summary is None or metric in row.summary}
        summaries |= {k: None for key, k in failed if key == configuration.key}
        # Only runs before the first gap in the replications count: runs are stored as they end, so that beyond the gap
        # short runs are over-represented.
        before_gap = takewhile(summaries.__contains__, count())
        values = [None if (numbers := summaries[k]) is None else numbers[metric] for k in before_gap]
        jobs += [(configuration, k) for k in range(runs_needed(values, half_width, at_most=plan.reps))]
    return jobs
