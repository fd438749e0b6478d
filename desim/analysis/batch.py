"""Many runs at once: the same function of scenario and seed, on one core or on all."""

import os
from collections.abc import Sequence
from concurrent.futures import Future, as_completed

from tqdm import tqdm

from desim.analysis.metrics import Summary, summary
from desim.run import run
from desim.scenario import Scenario

Task = tuple[Scenario, int]
"""A scenario and the seed to run it with."""


def seeds_from(seed: int, runs: int) -> range:
    """Return the seeds of a number of runs: run k of seed s is the run of seed s + k, and can be repeated alone."""
    return range(seed, seed + runs)


def run_many(tasks: Sequence[Task], jobs: int = 0, label: str = "runs") -> list[Summary]:
    """Run each task and return the summaries in the order of the tasks, whatever the number of workers.

    Args:
        tasks: scenario and seed of each run.
        jobs: worker processes; 1 = none, everything happens here; 0 = one per core.
        label: stands before the progress bar, which is drawn on a terminal only.
    """
    jobs = min(jobs or os.cpu_count() or 1, max(len(tasks), 1))
    with tqdm(total=len(tasks), desc=label, unit="run", disable=None) as bar:
        if jobs == 1:
            results = []
            for task in tasks:
                results.append(summary(run(*task)))
                bar.update()
            return results
        return _run_on(jobs, tasks, bar)


def _run_on(jobs: int, tasks: Sequence[Task], bar: "tqdm[None]") -> list[Summary]:
    from loky import get_reusable_executor

    executor = get_reusable_executor(max_workers=jobs)
    size = max(1, len(tasks) // (jobs * 32))
    pending: dict[Future[list[Summary]], int] = {
        executor.submit(_run_some, tasks[first : first + size]): first for first in range(0, len(tasks), size)
    }
    done: dict[int, list[Summary]] = {}
    try:
        for future in as_completed(pending):
            done[pending[future]] = future.result()
            bar.update(len(future.result()))
    except BaseException:
        executor.shutdown(wait=False, kill_workers=True)
        raise
    return [each for first in sorted(done) for each in done[first]]


def _run_some(tasks: Sequence[Task]) -> list[Summary]:
    return [summary(run(*task)) for task in tasks]
