"""The driver: hands runs to workers, and whatever becomes of a run, says what did."""

import pickle
import traceback
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import BrokenExecutor, Future
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any, Literal

import cloudpickle

from desim.analysis.metrics import summary
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result, run
from desim.simulation.watchdog import within
from desim.study.workers import Workers

Task = tuple[Scenario, int]
"""A scenario and the seed to run it with."""
Measurement = Callable[[Result], Any]
"""What to keep of a result; it runs in the worker."""
Simulate = Callable[[Scenario, int], Result]
"""What makes a run of a scenario and a seed; it runs in the worker, too."""
BATCH_TIME = 0.25
"""How long a worker is to be busy with what it is handed at once, s: to hand over costs about a millisecond."""
BATCH_SIZE = 64
"""How many runs it is handed at most."""
INNERMOST = 30
"""How many calls of a traceback are kept, those where it happened: a recursion without end has a thousand."""
CRASHED = "the run ended the process of its worker, or needs more memory than there is\n"
"""What there is to say of a run that crashed: the same wherever it did."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a run."""

    status: Literal["ok", "error", "crashed"]
    """ok; error: it raised something; crashed: it ended its worker."""
    value: Any = None
    """What was measured, if ok."""
    error: BaseException | None = None
    """What it raised, if that can be passed on."""
    traceback: str = ""
    """Where, as text."""


Outcomes = Generator[tuple[int, Outcome], None, None]
"""The position of each task and what became of it."""
HandOut = Callable[[list[int]], Future[Any]]
"""Hands the tasks at some positions to a worker."""


def simulation(timeout: float | None, simulate: Simulate = run) -> Simulate:
    """Return what makes a run, and raises TimedOut if it takes longer than a time, s."""
    return simulate if timeout is None else partial(_in_time, timeout, simulate)


def _in_time(timeout: float, simulate: Simulate, scenario: Scenario, seed: int) -> Result:
    with within(timeout):
        return simulate(scenario, seed)


def drive(
    tasks: Sequence[Task], workers: Workers, measure: Measurement = summary, simulate: Simulate = run
) -> Outcomes:
    """Yield what becomes of each task, as soon as it is known: its position and its outcome.

    Runs are handed out in lots, in the order of the tasks. When a worker dies, all that was handed out and has not
    come back is done again, one run at a time: a run with which a worker dies alone has crashed.

    Raises:
        BrokenExecutor: if a worker of a borrowed executor died, so that it takes no more work.
        ConnectionError: if the workers went away.
    """
    waiting = deque(range(len(tasks)))

    def hand_out(lot: list[int]) -> Future[Any]:
        return workers.submit(partial(perform, [tasks[k] for k in lot], measure, simulate))

    try:
        while waiting:
            suspects = yield from _in_batches(waiting, hand_out, workers)
            for k in suspects:
                yield k, _alone(k, hand_out, workers)
    except BaseException:  # nobody waits for the rest any more
        workers.stop()
        raise


def _in_batches(
    waiting: deque[int], hand_out: HandOut, workers: Workers
) -> Generator[tuple[int, Outcome], None, list[int]]:
    """Yield outcomes until all are known or a worker dies; return the runs that were begun and are not known."""
    out: dict[Future[Any], list[int]] = {}
    suspects: list[int] = []
    broken, run_time = False, BATCH_TIME
    try:
        while out or (waiting and not broken):
            while waiting and not broken and len(out) < workers.max_pending:
                fair = len(waiting) // (2 * workers.count)
                lot = [waiting.popleft() for _ in range(max(1, min(int(BATCH_TIME / run_time), fair, BATCH_SIZE)))]
                try:
                    out[hand_out(lot)] = lot
                except BrokenExecutor:
                    broken = True
                    waiting.extendleft(reversed(lot))
            for future in workers.done(out):
                lot = out.pop(future)
                try:
                    outcomes, run_time = workers.result(future)
                except ConnectionError:
                    raise
                except Exception as error:
                    suspects += lot
                    broken |= isinstance(error, BrokenExecutor)
                else:
                    yield from zip(lot, outcomes, strict=True)
    finally:
        for future in out:
            future.cancel()
    if broken:
        workers.renew()
    return suspects


def _alone(k: int, hand_out: HandOut, workers: Workers) -> Outcome:
    """Return what becomes of a run while there is no other."""
    outcome: Outcome
    try:
        future = hand_out([k])
        workers.done([future])
        ((outcome,), _) = workers.result(future)
    except ConnectionError:
        raise
    except Exception as error:
        if isinstance(error, BrokenExecutor):
            workers.renew()
        if workers.died(error):
            return Outcome("crashed", error=error, traceback=CRASHED)
        return Outcome("error", error=error, traceback=f"{type(error).__name__}: {error}\n")
    return outcome


def perform(tasks: Sequence[Task], measure: Measurement, simulate: Simulate) -> tuple[list[Outcome], float]:
    """Do some runs, in a worker: return what became of each, and how long one took, s."""
    start = perf_counter()
    outcomes = [_outcome(task, measure, simulate) for task in tasks]
    return outcomes, max((perf_counter() - start) / len(tasks), 1e-6)


def _outcome(task: Task, measure: Measurement, simulate: Simulate) -> Outcome:
    try:
        return Outcome("ok", measure(simulate(*task)))
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit, too
        told = traceback.format_exc(limit=-INNERMOST)
        return Outcome("error", error=_passable(error), traceback=told)


def _passable(error: BaseException) -> BaseException | None:
    """Return an exception if another process can be told of it, without its traceback if that cannot be pickled.

    Once distributed is imported, exceptions are pickled with their tracebacks.
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
