"""Many runs at once: the same function of scenario and seed, on one core or on all."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future, as_completed
from typing import Any, TypeVar

from tqdm import tqdm

from desim.analysis.metrics import summary
from desim.scenario import Scenario
from desim.simulation import Result, run

Task = tuple[Scenario, int]
"""A scenario and the seed to run it with."""
Measured = TypeVar("Measured")


def seeds_from(seed: int, runs: int) -> range:
    """Return the seeds of a number of runs: run k of seed s is the run of seed s + k, and can be repeated alone."""
    return range(seed, seed + runs)


def run_many(
    tasks: Sequence[Task],
    jobs: int = 0,
    label: str = "runs",
    measure: Callable[[Result], Measured] = summary,  # type: ignore[assignment]
) -> list[Measured]:
    """Run each task and return what was measured, in the order of the tasks, whatever the number of workers.

    Args:
        tasks: scenario and seed of each run.
        jobs: worker processes; 1 = none, everything happens here; 0 = one per core.
        label: stands before the progress bar, which is drawn on a terminal only.
        measure: what to keep of a result; it runs in the worker.
    """
    jobs = min(jobs or os.cpu_count() or 1, len(tasks))
    bar: tqdm[Any]
    with tqdm(total=len(tasks), desc=label, unit="run", disable=None) as bar:
        if jobs <= 1:
            return _run_some(tasks, measure, bar)
        return _run_on(jobs, tasks, measure, bar)


def _run_on(
    jobs: int, tasks: Sequence[Task], measure: Callable[[Result], Measured], bar: "tqdm[Any]"
) -> list[Measured]:
    from loky import get_reusable_executor

    executor = get_reusable_executor(max_workers=jobs)
    size = max(1, len(tasks) // (jobs * 32))
    chunks = [tasks[first : first + size] for first in range(0, len(tasks), size)]
    pending: list[Future[list[Measured]]] = [executor.submit(_run_some, chunk, measure) for chunk in chunks]
    try:
        for future in as_completed(pending):
            bar.update(len(future.result()))
    except BaseException:
        executor.shutdown(wait=False, kill_workers=True)
        raise
    return [measured for future in pending for measured in future.result()]


def _run_some(
    tasks: Sequence[Task], measure: Callable[[Result], Measured], bar: "tqdm[Any] | None" = None
) -> list[Measured]:
    measured = []
    for task in tasks:
        measured.append(measure(run(*task)))
        if bar is not None:
            bar.update()
    return measured
