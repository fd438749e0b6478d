"""The workers that a caller asks for by a number, an address, or an executor."""

import os
from concurrent.futures import Executor
from copy import copy

from desim.config.arguments import value_text
from desim.config.python_numbers import whole
from desim.simulation.watchdog import checked_limit
from desim.study.workers.batch_system import JobExecutor, JobWorkers
from desim.study.workers.workers import Cluster, InProcess, Processes, Workers

START_TIMEOUT = 10.0
"""The time-out, s of wall time, for answers of a cluster."""


def workers_for(
    executor: Executor | JobExecutor | Workers | int | str, calls: int | None = None, timeout: float | None = None
) -> Workers:
    """Return the workers for an executor, the address of a Dask scheduler, or a number of processes.

    An executor whose `submit` returns jobs instead of futures is one of a batch system, such as submitit's. The number
    0 stands for the number of cores. There are no more processes than `calls`, the largest number of calls, if it
    is given. With the number 1, calls are made in this process. A run that takes longer than `timeout` s of wall time
    counts as failed; `Workers` of the user are copied for this, because several sweeps may share them.

    Raises:
        ConnectionError: if Dask is not installed, or a scheduler does not answer or has no workers.
        ValueError: if a number is negative, the executor is of another type, or `timeout` is out of its range.
    """
    if timeout is not None:
        timeout = checked_limit(timeout)
    workers = copy(executor) if isinstance(executor, Workers) else _new_workers(executor, calls)
    workers.timeout = timeout
    return workers


def _new_workers(executor: Executor | JobExecutor | int | str, calls: int | None) -> Workers:
    if isinstance(executor, str) and executor.isdecimal():
        raise ValueError(f"executor should be the number {executor} instead of the text {executor!r}")
    if isinstance(executor, str) and ":" in executor:
        return Cluster(executor, START_TIMEOUT)
    if isinstance(executor, Executor):
        return Workers(executor)
    if hasattr(executor, "submit"):
        if isinstance(executor, type):
            raise ValueError(f"executor should be an executor, not its class: {executor.__name__}(...)")
        return JobWorkers(executor)
    try:
        number = whole(executor, "the number of workers")
    except ValueError:
        raise ValueError(
            "executor should be a number of processes, the address of a Dask scheduler or an executor of"
            f" concurrent.futures, such as ProcessPoolExecutor (got {value_text(executor)})"
        ) from None
    if number < 0:
        raise ValueError(f"the number of workers should be at least 0, got {number}")
    count = number or os.cpu_count() or 1
    if calls is not None:
        count = max(min(count, calls), 1)
    return InProcess() if count == 1 else Processes(count)
