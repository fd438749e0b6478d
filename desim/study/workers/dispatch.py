"""The driver: dispatches runs to workers in batches and reports the outcome of each run, even of a crashed one."""

import pickle
import traceback
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import BrokenExecutor, Future
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any, Literal

import cloudpickle

from desim.analysis.measuring import summary
from desim.config.caller_warnings import warn_caller
from desim.config.data_files import identified_run
from desim.config.fresh import fresh_copy
from desim.config.own_modules import plain_name
from desim.config.shared_state import StateWarning, collected_warnings
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result, run
from desim.simulation.watchdog import OUT_OF_MEMORY, within
from desim.study.workers.workers import Workers

Task = tuple[Scenario, int]
"""A scenario and the seed of its run."""
Measurement = Callable[[Result], Any]
"""Maps a result to the value to keep; called in the worker."""
Simulate = Callable[[Scenario, int], Result]
"""Performs the run of a scenario and a seed; called in the worker."""
FIRST_RUN = 0.25
"""The duration of a run, s of wall time, that is assumed until one has ended."""
INNERMOST = 30
"""The number of innermost calls that a traceback keeps: an infinite recursion has a thousand."""
CRASHED = "the worker process died during the run; the machine may have too little memory for it\n"
"""The text that replaces the traceback of a crashed run, as a crash leaves none."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a run: its measurement, or its failure."""

    status: Literal["ok", "error", "crashed"]
    """ok; error: the run raised an exception, or its result could not be returned, for example because it cannot be
    serialized; crashed: the run ended its worker process."""
    value: Any = None
    """The measurement, if ok."""
    error: BaseException | None = None
    """The exception; None if the run is ok, or if its exception cannot be pickled."""
    traceback: str = ""
    """The traceback of the exception, as text."""
    warnings: tuple[str, ...] = ()
    """What the run warned of: state that an earlier run has left, see `desim.config.shared_state`."""


Outcomes = Generator[tuple[int, Outcome], None, None]
"""Yields the position of each task and the outcome of its run."""
Batch = list[tuple[int, Outcome]]
"""The positions and the outcomes of runs that became known together."""
Submit = Callable[[list[int]], Future[Any]]
"""Submits the tasks at some positions to a worker."""


def _in_time(timeout: float, simulate: Simulate, scenario: Scenario, seed: int) -> Result:
    with within(timeout):
        return simulate(scenario, seed)


def drive(
    tasks: Sequence[Task], workers: Workers, measure: Measurement = summary, simulate: Simulate = run
) -> Outcomes:
    """Yield the position and the outcome of each task as soon as the outcome is known; see `drive_batches`."""
    with closing(drive_batches(tasks, workers, measure, simulate)) as batches:
        for batch in batches:
            yield from batch


def drive_batches(
    tasks: Sequence[Task], workers: Workers, measure: Measurement = summary, simulate: Simulate = run
) -> Generator[Batch, None, None]:
    """Yield the positions and the outcomes of tasks, a batch of runs as soon as its outcomes are known.

    Runs are dispatched in batches, in the order of the tasks. After a worker has died, each run of the unfinished
    batches is repeated alone, while no other run is under way. The runs of a batch whose call failed, for example
    because its result cannot be serialized, are repeated in the same way. If a worker dies while a run is repeated, the
    outcome of this run is "crashed". If the repeated call fails otherwise, the outcome is "error".

    Raises:
        BrokenExecutor: if a worker of the user's own executor died, after which the executor accepts no more calls.
        ConnectionError: if the connection to the workers is lost.
    """
    waiting = deque(range(len(tasks)))
    if workers.timeout is not None:
        simulate = partial(_in_time, workers.timeout, simulate)

    def submit(batch: list[int]) -> Future[Any]:
        return workers.submit(partial(perform, [tasks[k] for k in batch], measure, simulate))

    warned: set[str] = set()
    try:
        while waiting:
            unaccounted = yield from _in_batches(waiting, submit, workers, warned)
            for k in unaccounted:
                outcome = _run_alone(k, submit, workers)
                _warn([outcome], warned)
                yield [(k, outcome)]
    except BaseException:  # the other outcomes are not needed any more
        workers.stop()
        raise


def _in_batches(
    waiting: deque[int], submit: Submit, workers: Workers, warned: set[str]
) -> Generator[Batch, None, list[int]]:
    """Submit runs until a worker dies, and yield their outcomes; return the submitted runs without an outcome."""
    submitted: dict[Future[Any], list[int]] = {}
    unaccounted: list[int] = []
    is_broken, run_time = False, FIRST_RUN
    try:
        while submitted or (waiting and not is_broken):
            while waiting and not is_broken and len(submitted) < workers.max_pending:
                fair_size = len(waiting) // (workers.shares * workers.count)
                size = max(1, min(int(workers.batch_time / run_time), fair_size, workers.batch_size))
                batch = [waiting.popleft() for _ in range(size)]
                try:
                    submitted[submit(batch)] = batch
                except BrokenExecutor:
                    is_broken = True
                    waiting.extendleft(reversed(batch))
            for future in workers.done(submitted):
                batch = submitted.pop(future)
                try:
                    outcomes, run_time = workers.result(future)
                except ConnectionError:  # to the workers: a ConnectionError of a run is in its outcome
                    raise
                except Exception as error:
                    unaccounted += batch
                    is_broken |= isinstance(error, BrokenExecutor)
                else:
                    _warn(outcomes, warned)
                    yield list(zip(batch, outcomes, strict=True))
    finally:
        for future in submitted:
            if hasattr(future, "cancel"):  # a job of a batch system may have none
                future.cancel()
    if is_broken:
        workers.renew()
    return unaccounted


def _warn(outcomes: Sequence[Outcome], warned: set[str]) -> None:
    """Warn, in this process, of what runs warned of in their workers, once for each text."""
    for text in dict.fromkeys(text for outcome in outcomes for text in outcome.warnings):
        if text not in warned:
            warned.add(text)
            warn_caller(text, StateWarning)


def _run_alone(k: int, submit: Submit, workers: Workers) -> Outcome:
    """Perform a run while no other run is under way, and return its outcome."""
    outcome: Outcome
    try:
        future = submit([k])
        workers.done([future])
        ((outcome,), _) = workers.result(future)
    except ConnectionError:
        raise
    except Exception as error:
        if isinstance(error, BrokenExecutor):
            workers.renew()
        if workers.died(error):
            return Outcome("crashed", error=error, traceback=CRASHED)
        _explain(error)
        return Outcome("error", error=error, traceback=f"{type(error).__name__}: {error}\n")
    return outcome


def perform(tasks: Sequence[Task], measure: Measurement, simulate: Simulate) -> tuple[list[Outcome], float]:
    """Perform some runs in a worker; return their outcomes and the mean duration of a run, s of wall time."""
    start = perf_counter()
    outcomes = [_outcome(task, measure, simulate) for task in tasks]
    return outcomes, max((perf_counter() - start) / len(tasks), 1e-6)


def _outcome(task: Task, measure: Measurement, simulate: Simulate) -> Outcome:
    scenario, seed = task
    texts: list[str] = []
    try:
        # In any worker, each run starts from the state of the driver's objects, as if it were the only run.
        with (
            collected_warnings() as texts,
            identified_run(),
            fresh_copy((scenario, measure), with_collections=True) as (copied, fresh_measure),
        ):
            result = simulate(copied, seed)
            if copied is not scenario and isinstance(result, Result):
                result = replace(result, scenario=scenario)  # the caller's object, not its copy
            measured = fresh_measure(result)
        return Outcome("ok", measured, warnings=tuple(texts))
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit, too
        _explain(error)
        module = type(error).__module__  # has the folder in its name, if the module lies beside a scenario file
        text = traceback.format_exc(limit=-INNERMOST).replace(f"{module}.", f"{plain_name(module)}.")
        return Outcome("error", error=_picklable(error), traceback=text, warnings=tuple(texts))


def _explain(error: BaseException) -> None:
    """Give a MemoryError without a text a text that says what to do."""
    if isinstance(error, MemoryError) and not str(error):
        error.args = (OUT_OF_MEMORY,)


def _picklable(error: BaseException) -> BaseException | None:
    """Return the exception if it can be pickled, if necessary without its traceback and context; otherwise None.

    Once Dask's package `distributed` is imported, exceptions are pickled with their tracebacks.
    """
    if not _survives_pickling(error):
        error.__traceback__ = error.__context__ = None
    return error if _survives_pickling(error) else None


def _survives_pickling(error: BaseException) -> bool:
    try:
        pickle.loads(cloudpickle.dumps(error))
    except Exception:
        return False
    return True
