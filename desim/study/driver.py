"""The driver: hands runs to workers, and whatever becomes of a run, says what did."""

import pickle
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any, Literal

import cloudpickle

from desim.analysis.metrics import summary
from desim.scenario import Scenario
from desim.simulation import Result, run
from desim.study.workers import Workers

Task = tuple[Scenario, int]
"""A scenario and the seed to run it with."""
Measure = Callable[[Result], Any]
"""What to keep of a result; it runs in the worker."""
LOT_TIME = 0.25
"""How long a worker is to be busy with what it is handed at once, s: to hand over costs about a millisecond."""
LOT_SIZE = 64
"""How many runs it is handed at most."""


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


def drive(tasks: Sequence[Task], workers: Workers, measure: Measure = summary) -> Outcomes:
    """Yield what becomes of each task, as soon as it is known: its position and its outcome.

    Runs are handed out in lots, in the order of the tasks. When a worker dies, all that was handed out and has not
    come back is done again, one run at a time: a run with which a worker dies alone has crashed.

    Raises:
        BrokenExecutor: if a worker of a borrowed executor died, so that it takes no more work.
        ConnectionError: if the workers went away.
    """
    desk = _Desk(tasks, workers, measure)
    try:
        while desk.is_busy():
            desk.hand_out()
            yield from desk.take_in()
    finally:
        desk.clear()


def perform(tasks: Sequence[Task], measure: Measure) -> tuple[list[Outcome], float]:
    """Do some runs, in a worker: return what became of each, and how long one took, s."""
    start = perf_counter()
    outcomes = [_outcome(task, measure) for task in tasks]
    return outcomes, (perf_counter() - start) / len(tasks)


def _outcome(task: Task, measure: Measure) -> Outcome:
    try:
        return Outcome("ok", measure(run(*task)))
    except (Exception, SystemExit) as error:
        return Outcome("error", error=_passable(error), traceback=traceback.format_exc())


def _passable(error: BaseException) -> BaseException | None:
    """Return an exception if another process can be told of it."""
    try:
        pickle.loads(cloudpickle.dumps(error))
    except Exception:
        return None
    return error


class _Desk:
    """What waits, what the workers have, and what has to be done again."""

    def __init__(self, tasks: Sequence[Task], workers: Workers, measure: Measure):
        self._tasks, self._workers, self._measure = tasks, workers, measure
        self._waiting = deque(range(len(tasks)))
        self._suspects = deque[int]()
        """Runs of which one may have ended its worker."""
        self._out: dict[Future[Any], tuple[list[int], bool]] = {}
        """Lots that the workers have, and whether it is all they have."""
        self._broken = False
        self._run_time = LOT_TIME

    def is_busy(self) -> bool:
        return bool(self._waiting or self._suspects or self._out)

    def hand_out(self) -> None:
        """Hand out as much as the workers can do for now."""
        if self._broken and not self._out:
            self._workers.renew()
            self._broken = False
        if self._broken:
            return
        if self._suspects:
            if not self._out:
                self._hand(self._suspects, 1)
            return
        several = self._workers.count > 1
        while self._waiting and not self._broken and len(self._out) < (2 * self._workers.count if several else 1):
            fair = len(self._waiting) // (2 * self._workers.count)
            self._hand(self._waiting, max(1, min(int(LOT_TIME / self._run_time), fair, LOT_SIZE)))

    def _hand(self, queue: deque[int], size: int) -> None:
        lot = [queue.popleft() for _ in range(size)]
        try:
            future = self._workers.submit(partial(perform, [self._tasks[k] for k in lot], self._measure))
        except BrokenExecutor:
            queue.extendleft(reversed(lot))
            self._broken = True
        else:
            self._out[future] = lot, queue is self._suspects

    def take_in(self) -> Iterator[tuple[int, Outcome]]:
        """Yield what has come back, once something has."""
        for future in wait(self._out, return_when=FIRST_COMPLETED).done if self._out else ():
            lot, alone = self._out.pop(future)
            try:
                outcomes, run_time = future.result()
            except CancelledError as error:
                raise ConnectionError("the workers went away") from error
            except Exception as error:
                died = self._workers.died(error)
                self._broken |= isinstance(error, BrokenExecutor)
                if alone or (len(lot) == 1 and not died):
                    status: Literal["crashed", "error"] = "crashed" if died else "error"
                    yield lot[0], Outcome(status, error=error, traceback=f"{type(error).__name__}: {error}\n")
                else:
                    self._suspects.extend(lot)
            else:
                self._run_time = max(run_time, 1e-6)
                yield from zip(lot, outcomes, strict=True)

    def clear(self) -> None:
        """Let the workers stop what nobody waits for any more."""
        if self._out:
            for future in self._out:
                future.cancel()
            self._workers.stop()
