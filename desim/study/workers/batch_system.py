"""Workers that are jobs of a batch system, submitted by an executor such as submitit's.

The `submit` of such an executor returns no future of Python, but a job with `done` and `result`. A job takes seconds to
start, so each job performs runs for about a minute.
"""

import os
import time
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any, Protocol

from desim.config.python_numbers import whole
from desim.study.workers.workers import Workers

if TYPE_CHECKING:
    from concurrent.futures import Future

POLL = 0.2
"""The interval, s of wall time, at which jobs are asked whether they have ended."""
JOB_TIME = 60.0
"""The intended duration of a job, s of wall time."""
JOB_SIZE = 10_000
"""The largest number of runs in a job."""


class JobExecutor(Protocol):
    """An executor whose `submit` returns jobs, as those of submitit do."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Any:
        """Submit a call, and return its job."""


class JobWorkers(Workers):
    """The jobs of a batch system.

    Choose a number of jobs that your account may have at a time; if in doubt, leave it out.

    Args:
        executor: submits the jobs; an executor of submitit, for instance.
        jobs: the number of jobs at a time; None or 0 = the number of cores of this machine.

    Raises:
        ValueError: if the number of jobs is negative, or not an integer.
    """

    batch_time, batch_size, shares = JOB_TIME, JOB_SIZE, 1

    def __init__(self, executor: JobExecutor, jobs: int | None = None):
        number = 0 if jobs is None else whole(jobs, "the number of jobs")
        if number < 0:
            raise ValueError(f"the number of jobs should be at least 0, got {number}")
        super().__init__(executor, number or os.cpu_count())  # type: ignore[arg-type]
        self.max_pending = self.count  # jobs that wait count for the limit of an account, too

    def done(self, futures: Collection["Future[Any]"]) -> "set[Future[Any]]":
        """Wait until at least one of the jobs has ended, and return all that have ended."""
        while not (ended := {job for job in futures if job.done()}):
            time.sleep(POLL)
        return ended

    def died(self, error: BaseException) -> bool:
        """Return whether a job ended without a result: it was killed, or ran out of memory or time."""
        return type(error).__name__ == "UncompletedJobError"

    def renew(self) -> None:
        """Do nothing: each job is a process of its own."""
