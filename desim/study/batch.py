"""Many runs of any scenarios, and what was measured of each: the plainest use of the driver."""

from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Any, TypeVar

from tqdm import tqdm

from desim.analysis.metrics import summary
from desim.config.trust import visible
from desim.simulation.run import Result, run
from desim.study.dispatch import Simulate, Task, drive
from desim.study.workers import workers_for

Measured = TypeVar("Measured")


def seeds_from(seed: int, runs: int) -> range:
    """Return the seeds of a number of runs: run k of seed s is the run of seed s + k, and can be repeated alone."""
    return range(seed, seed + runs)


def run_many(
    tasks: Sequence[Task],
    jobs: int = 0,
    label: str = "runs",
    measure: Callable[[Result], Measured] = summary,  # type: ignore[assignment]
    simulate: Simulate = run,
) -> list[Measured]:
    """Run each task and return what was measured, in the order of the tasks, whatever the number of workers.

    Args:
        tasks: scenario and seed of each run.
        jobs: worker processes; 1 = none, everything happens here; 0 = one per core.
        label: stands before the progress bar, which is drawn on a terminal only.
        measure: what to keep of a result; it runs in the worker.
        simulate: what makes the run, there.

    Raises:
        Exception: whatever a run raises first.
        BrokenExecutor: if a run ended its worker.
    """
    measured: list[Any] = [None] * len(tasks)
    bar: tqdm[Any]
    with (
        tqdm(total=len(tasks), desc=visible(label), unit="run", disable=None) as bar,
        workers_for(jobs if len(tasks) > 1 else 1) as workers,
        closing(drive(tasks, workers, measure, simulate)) as outcomes,
    ):
        for k, outcome in outcomes:
            if outcome.status != "ok":
                raise outcome.error or RuntimeError(outcome.traceback)
            measured[k] = outcome.value
            bar.update()
    return measured
