"""Judge the runs of cases by a property: workers make the runs, except those whose judgement is in a log."""

import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from typing import NamedTuple

from desim.analysis.properties import judge
from desim.config.errors import ArgumentError
from desim.kernel.core.portable_math import portable_sum
from desim.scenario.properties import Property, recording
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result
from desim.simulation.watchdog import TimedOut
from desim.study.breaking.case_log import FAILED, CaseLog, CaseRun
from desim.study.breaking.features import Case
from desim.study.breaking.sightings import seen_in
from desim.study.store.run_table import Row
from desim.study.workers.dispatch import Measurement, Outcome, Task, drive
from desim.study.workers.workers import Workers


class Planned(NamedTuple):
    """A case that is to be run."""

    case: Case
    seed: int
    scenario: Scenario


class CaseJudge:
    """Judges runs by a property. Runs that a log has are not made again; the log receives the others.

    A run that exceeded another limit of wall time is made again. Without a log, nothing is kept.

    Attributes:
        seconds: the wall time of all runs that were judged, s, including runs in the log.
    """

    def __init__(self, prop: Property, workers: Workers, log: CaseLog | None = None):
        self._prop, self._workers, self._log = prop, workers, log
        self.seconds = 0.0

    def __call__(self, scenario: Scenario, seed: int) -> CaseRun:
        """Judge one run; see `judge_all`."""
        (case_run,) = self.judge_all([Planned({}, seed, scenario)])
        return case_run

    def judge_all(self, cases: Sequence[Planned]) -> list[CaseRun]:
        """Judge the run of each case, in order. A run that raises an exception, or is too long, has failed."""
        by_number: dict[int, CaseRun] = {}
        if self._log is not None:
            logged = ((k, self._log.find(planned.scenario, planned.seed)) for k, planned in enumerate(cases))
            limits = (None, self._workers.timeout)  # the run ended by itself, or would exceed the limit again
            by_number = {k: case_run for k, case_run in logged if case_run is not None and case_run.limit in limits}
        missing = [k for k in range(len(cases)) if k not in by_number]
        if missing:
            by_number |= dict(zip(missing, self._run_all([cases[k] for k in missing]), strict=True))
        self.seconds += portable_sum(case_run.seconds for case_run in by_number.values())
        return [by_number[k] for k in range(len(cases))]

    def _run_all(self, cases: Sequence[Planned]) -> list[CaseRun]:
        """Make the run of each case, and append it to the log as soon as it has ended."""
        tasks = [(with_messages(planned.scenario, self._prop), planned.seed) for planned in cases]
        runs: dict[int, CaseRun] = {}
        last_end = time.perf_counter()
        with closing(drive(tasks, self._workers, partial(_case_run, self._prop))) as outcomes:
            for k, outcome in outcomes:
                timeout = self._workers.timeout
                failure, limit = failure_of(outcome, timeout), timeout if isinstance(outcome.error, TimedOut) else None
                end = time.perf_counter()
                case_run = CaseRun(FAILED, [], failure=failure, limit=limit) if failure else outcome.value
                runs[k] = case_run._replace(seconds=round(end - last_end, 4))
                last_end = end
                if self._log is not None:
                    self._log.add(cases[k].scenario, cases[k].seed, runs[k], cases[k].case)
        return [runs[k] for k in range(len(cases))]


class JudgementError(ArgumentError):
    """A run has ended, but it cannot be judged by the property."""


def failure_of(outcome: Outcome, timeout: float | None) -> str:
    """Return the failure of a run, the class and the first line of its exception; empty: it has not failed.

    `timeout` is the longest wall time of a run, s; None: no limit.

    Raises:
        BaseException: if the run was ended from outside, or cannot be judged (JudgementError).
    """
    if outcome.status == "ok":
        return ""
    line = Row(0, 0, outcome.status, traceback=outcome.traceback).error
    kind, colon, text = line.partition(": ")
    if outcome.error is None and kind.replace(".", "").isidentifier():  # an exception that cannot be pickled
        return f"{kind.rpartition('.')[2]}{colon}{text}"
    error = outcome.error or RuntimeError(line)
    is_too_long = timeout is not None and isinstance(error, TimedOut)
    if isinstance(error, JudgementError) or not (isinstance(error, Exception) or is_too_long):
        raise error
    kind = "TimedOut" if is_too_long else type(error).__name__  # a watchdog raises a subclass with another name
    return ": ".join([kind, *str(error).strip().splitlines()[:1]])


def _case_run(prop: Property, result: Result) -> CaseRun:
    with judging(prop):
        return CaseRun(judge(prop, result), seen_in(result))


@contextmanager
def judging(prop: Property) -> Iterator[None]:
    """Turn an exception into a JudgementError: the run has ended, so its protocol did not raise the exception."""
    try:
        yield
    except Exception as error:
        kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        raise JudgementError("property", f"{prop.text!r} cannot be judged: {kind}{error}") from error


def with_messages(scenario: Scenario, prop: Property) -> Scenario:
    """Return a scenario that records what a property needs, and all messages."""
    recorded: Scenario = recording(scenario, [prop]).with_({"record.messages": True})
    return recorded


def outcomes_of(tasks: Sequence[Task], workers: Workers, measure: Measurement) -> list[Outcome]:
    """Return the outcome of each run, in the order of the tasks."""
    with closing(drive(tasks, workers, measure)) as outcomes:
        by_position = dict(outcomes)
    return [by_position[k] for k in range(len(tasks))]
