"""Run a list of scenarios and seeds, and measure each run, without a grid or a store."""

from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Any, TypeVar

from desim.analysis.measuring import summary
from desim.config.calls import check_action
from desim.kernel.core.seeds import run_seed
from desim.simulation.run import Result, run
from desim.study.workers.dispatch import Simulate, Task, drive
from desim.study.workers.executors import workers_for
from desim.study.workers.progress import advance, progress

Measured = TypeVar("Measured")


def seeds_from(seed: int, runs: int) -> range:
    """Return the seeds of several runs of a root seed; see `desim.kernel.core.seeds.run_seed`.

    Each run can be repeated alone, by its own seed.

    Raises:
        ValueError: if there are more runs than seeds of one root seed.
    """
    return range(run_seed(seed, 0), run_seed(seed, runs - 1) + 1) if runs > 0 else range(0)


def run_many(
    tasks: Sequence[Task],
    jobs: int = 0,
    label: str = "runs",
    measure: Callable[[Result], Measured] = summary,  # type: ignore[assignment]
    simulate: Simulate = run,
    on_done: Callable[[int, Measured], object] = lambda *_: None,
    timeout: float | None = None,
) -> list[Measured]:
    """Run each task and return the measurements in the order of the tasks, with any number of workers.

    Use it in a script that lists its own runs; `sweep` adds a grid, a store and statistics.

    Args:
        tasks: the scenario and the seed of each run.
        jobs: the number of worker processes; 0 = the number of cores. With 1 job, or a single task, all runs are made
            in this process.
        label: the text before the progress bar, which is drawn only on a terminal and in a notebook.
        measure: maps a result to the measurement to keep; called in the worker.
        simulate: performs a run; called in the worker.
        on_done: called with the number and the measurement of each run that has ended, in this process.
        timeout: the wall time, s, after which a run fails with `TimedOut`; None = no limit.

    Raises:
        BaseException: the exception of a failed run; if several fail, the exception that is reported first. If it
            cannot be pickled, a RuntimeError with its traceback is raised instead.
        BrokenExecutor: if a run ended its worker process.
        ValueError: if `jobs` is negative, or `timeout` is out of its range.
    """
    check_action(measure, ("result",), "measure")
    check_action(on_done, ("number", "measurement"), "on_done")
    measured: list[Any] = [None] * len(tasks)
    with (
        progress(len(tasks), label, "run") as bar,
        workers_for(jobs, len(tasks), timeout) as workers,
        closing(drive(tasks, workers, measure, simulate)) as outcomes,
    ):
        for k, outcome in outcomes:
            if outcome.status != "ok":
                raise outcome.error or RuntimeError(outcome.traceback)
            measured[k] = outcome.value
            advance(bar, 1)
            on_done(k, outcome.value)
    return measured
