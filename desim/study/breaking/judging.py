"""Runs judged by a property: by several workers, and those of a log without a run."""

import time
from collections.abc import Sequence
from contextlib import closing
from functools import partial
from typing import Any, NamedTuple, cast

from desim.analysis.properties import Judgement, judge
from desim.kernel.core.portable_math import portable_sum
from desim.scenario.properties import Property, recording
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result, run
from desim.study.breaking.case_log import CaseLog, CaseRun
from desim.study.breaking.features import Case
from desim.study.breaking.sightings import seen_in
from desim.study.workers.dispatch import Measurement, Outcome, Task, drive
from desim.study.workers.workers import Workers


class Planned(NamedTuple):
    """A case that is to be run."""

    case: Case
    seed: int
    scenario: Scenario


class CaseJudge:
    """Judges runs by a property; those in a log are not made again, and it receives those that are made.

    Args:
        prop: the property.
        workers: they make the runs.
        log: what was judged before; None: nothing is kept.

    Attributes:
        seconds: the wall time of all runs that were judged, s, that of the runs in the log included.
    """

    def __init__(self, prop: Property, workers: Workers, log: CaseLog | None = None):
        self._prop, self._workers, self._log = prop, workers, log
        self.seconds = 0.0

    def __call__(self, scenario: Scenario, seed: int) -> Judgement:
        """CaseJudge one run.

        Raises:
            BaseException: what the run raised.
        """
        ((verdict, *_),) = self.judge_all([Planned({}, seed, scenario)])
        return verdict

    def judge_all(self, cases: Sequence[Planned]) -> list[CaseRun]:
        """CaseJudge the run of each case, in order.

        Raises:
            BaseException: what a run raised; the first one, if several did.
        """
        runs = self.attempt(cases)
        for case_run in runs:
            if isinstance(case_run, BaseException):
                raise case_run
        return cast("list[CaseRun]", runs)

    def attempt(self, cases: Sequence[Planned]) -> list[CaseRun | BaseException]:
        """Do as `judge_all`, and return the exceptions of runs in their places."""
        told: dict[int, CaseRun | BaseException] = {}
        if self._log is not None:
            logged = ((k, self._log.find(planned.scenario, planned.seed)) for k, planned in enumerate(cases))
            told = {k: case_run for k, case_run in logged if case_run is not None}
        missing = [k for k in range(len(cases)) if k not in told]
        if missing:
            told |= dict(zip(missing, self._run_all([cases[k] for k in missing]), strict=True))
        self.seconds += portable_sum(told_run.seconds for told_run in told.values() if isinstance(told_run, CaseRun))
        return [told[k] for k in range(len(cases))]

    def _run_all(self, cases: Sequence[Planned]) -> list[CaseRun | BaseException]:
        """Make the run of each case, and append it to the log."""
        tasks = [(with_messages(planned.scenario, self._prop), planned.seed) for planned in cases]
        begin = time.perf_counter()
        outcomes = outcomes_of(tasks, self._workers, partial(_case_run, self._prop))
        seconds = round((time.perf_counter() - begin) / len(cases), 4)
        runs: list[CaseRun | BaseException] = []
        for planned, outcome in zip(cases, outcomes, strict=True):
            if outcome.status != "ok":
                runs.append(outcome.error or RuntimeError(outcome.traceback))
                continue
            case_run = outcome.value._replace(seconds=seconds)
            runs.append(case_run)
            if self._log is not None:
                self._log.add(planned.scenario, planned.seed, case_run, planned.case)
        return runs


def _case_run(prop: Property, result: Result) -> CaseRun:
    return CaseRun(judge(prop, result), seen_in(result))


def with_messages(scenario: Scenario, prop: Property) -> Scenario:
    """Return a scenario that records what a property needs, and all messages."""
    return recording(scenario, [prop]).with_({"record.messages": True})


def judged(prop: Property, scenario: Scenario, seed: int) -> Judgement:
    """Return the judgement of a run."""
    return judge(prop, run(recording(scenario, [prop]), seed))


def outcomes_of(tasks: Sequence[Task], workers: Workers, measure: Measurement) -> list[Outcome]:
    """Return the outcome of each run, in the order of the tasks."""
    by_place: dict[int, Outcome] = {}
    with closing(drive(tasks, workers, measure)) as outcomes:
        by_place.update(outcomes)
    return [by_place[place] for place in range(len(tasks))]


def in_order(tasks: Sequence[Task], workers: Workers, measure: Measurement) -> list[Any]:
    """Return the measurement of each run, in the order of the tasks.

    Raises:
        BaseException: what a run raised.
    """
    outcomes = outcomes_of(tasks, workers, measure)
    for outcome in outcomes:
        if outcome.status != "ok":
            raise outcome.error or RuntimeError(outcome.traceback)
    return [outcome.value for outcome in outcomes]
