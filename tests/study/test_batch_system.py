"""Sweeps on executors whose `submit` returns jobs: submitit's, and a stand-in that keeps what it is given."""

import pytest

from desim import Scenario, Team, sweep
from desim.study.sweeps.sweep import RunError
from desim.study.workers.batch_system import JobWorkers
from desim.study.workers.executors import workers_for

SMALL = Scenario(team=Team(count=2), horizon=0.5)
GRID = {"network.latency.value": [0.0, 0.1]}


class UncompletedJobError(RuntimeError):
    """The error of submitit for a job that was killed."""


class Job:
    """A job that has ended after it was asked three times."""

    def __init__(self, act):
        self.act, self.asked = act, 0

    def done(self):
        self.asked += 1
        return self.asked >= 3

    def result(self):
        return self.act()

    def cancel(self):
        """Do nothing."""


class Jobs:
    """An executor of jobs; the jobs of some numbers are killed."""

    def __init__(self, killed=()):
        self.killed, self.submitted = killed, 0

    def submit(self, function, *args):
        self.submitted += 1
        return Job(self._killed if self.submitted in self.killed else lambda: function(*args))

    def _killed(self):
        raise UncompletedJobError("out of memory")


def texts(result):
    return [row for group in result.groups for row in group.rows]


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr("desim.study.workers.batch_system.POLL", 0.0)


@pytest.mark.slow
def test_a_sweep_over_jobs_is_the_serial_sweep_and_has_few_of_them():
    executor = Jobs()
    found = sweep(SMALL, GRID, 12, JobWorkers(executor, 3))
    assert texts(found) == texts(sweep(SMALL, GRID, 12))
    assert executor.submitted <= 12


@pytest.mark.slow
def test_the_runs_of_a_killed_job_are_repeated_and_a_run_that_kills_its_job_has_crashed():
    assert texts(sweep(SMALL, GRID, 6, JobWorkers(Jobs({1}), 2))) == texts(sweep(SMALL, GRID, 6))
    executor = Jobs({1, 2})
    statuses = [row.status for row in texts(sweep(SMALL, {"network.latency.value": [0.1]}, 1, executor))]
    assert statuses == ["crashed"]


def test_an_executor_of_jobs_is_recognised_and_its_number_of_jobs_is_the_callers():
    assert workers_for(Jobs()).count >= 1
    workers = JobWorkers(Jobs(), 7)
    limited, free = workers_for(workers, timeout=2.0), workers_for(workers)
    assert (limited.timeout, limited.count, limited.executor) == (2.0, 7, workers.executor)
    assert free.timeout is workers.timeout is None
    with pytest.raises(ValueError, match="executor should be a number of processes"):
        workers_for(object())
    with pytest.raises(ValueError, match=r"executor should be an executor, not its class: Jobs\(...\)"):
        workers_for(Jobs)


@pytest.mark.slow
@pytest.mark.whole
def test_submitit_performs_a_sweep(tmp_path, monkeypatch):
    """Its LocalExecutor starts a process for each job, as its executor of Slurm starts a job there."""
    submitit = pytest.importorskip("submitit")
    monkeypatch.setattr("desim.study.workers.batch_system.POLL", 0.05)
    executor = submitit.LocalExecutor(folder=tmp_path / "jobs")
    executor.update_parameters(timeout_min=5)
    found = sweep(SMALL, GRID, 2, JobWorkers(executor, 2), store=tmp_path / "a.sqlite")
    assert texts(found) == texts(sweep(SMALL, GRID, 2))


@pytest.mark.slow
def test_a_sweep_that_ends_early_says_why_also_if_its_jobs_cannot_be_cancelled(monkeypatch):
    monkeypatch.delattr(Job, "cancel")

    def fails(result):
        raise ValueError("no")

    with pytest.raises(RunError, match="ValueError: no"):
        sweep(SMALL, GRID, 4, JobWorkers(Jobs(), 2), metrics={"fails": fails}, fail_fast=True)


@pytest.mark.parametrize(("jobs", "why"), [(-1, "at least 0, got -1"), (1.5, "should be an integer"), ("2", "integer")])
def test_a_number_of_jobs_that_cannot_be_is_refused(jobs, why):
    with pytest.raises(ValueError, match=why):
        JobWorkers(Jobs(), jobs)
