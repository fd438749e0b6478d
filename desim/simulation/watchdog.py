"""A limit on the wall time of a block, and a description of what each process waits for when the limit is exceeded."""

import contextlib
import ctypes
import gc
import signal
import sys
import weakref
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from linecache import getline
from math import inf
from pathlib import Path
from threading import TIMEOUT_MAX, Event, Lock, Thread, current_thread, get_ident, main_thread
from time import monotonic
from traceback import walk_tb
from types import CodeType, FrameType, GeneratorType
from typing import TYPE_CHECKING, Any

from desim.config.interrupts import deferred
from desim.config.number_texts import counted
from desim.config.own_modules import is_of_user
from desim.config.python_numbers import real

if TYPE_CHECKING:
    from desim.kernel.core.clock import Clock
    from desim.simulation.restartable import RestartableProcess


OUT_OF_MEMORY = (
    "out of memory: shorten the horizon, simulate fewer nodes, or record less (record.trajectory,"
    ' record.messages = "file")'
)
"""The advice for a `MemoryError`, which has no text of its own."""
HAS_THREADS = sys.platform not in {"emscripten", "wasi"}
"""Whether this Python can start threads. Python in a browser (Pyodide) cannot, and has no signal timers either."""
RAISE_INTERVAL = 0.1
"""Interval, s, at which the exception of a limit is raised again if it was lost."""
SOON = 1e-6
"""The shortest delay of a timer, s: 0 would stop it."""


class TimedOut(BaseException):
    """A time limit was exceeded. It is not an `Exception`, so that `except Exception` does not catch it."""

    def __reduce__(self) -> tuple[type["TimedOut"], tuple[Any, ...]]:
        return TimedOut, self.args  # no other process knows the class that `within` raises in its block


def checked_limit(limit: float) -> float:
    """Return a time limit, s, as a `float`.

    Raises:
        ValueError: if the limit is not a number, is not positive, or is longer than a thread can wait.
    """
    limit = real(limit, "a time limit, in s,")
    if not 0.0 < limit <= TIMEOUT_MAX:
        raise ValueError(f"a time limit should be > 0 s and at most {TIMEOUT_MAX:g} s (got {limit:g})")
    return limit


def within(limit: float) -> AbstractContextManager[None]:
    """Return a context that raises TimedOut in this thread if its block has not ended after `limit` s of wall time.

    Use it around a run or any other code that may not terminate. The exception is raised between two Python
    instructions, also in an endless loop; a call into C finishes first. Other code may swallow the exception: the
    serialiser of pydantic drops it or raises another exception instead, and Python reports and drops it in `__del__`.
    TimedOut is therefore raised again until the block ends, except while the block handles it: clean-up is not
    interrupted. A block that exceeds its limit always ends with TimedOut, unless it raises KeyboardInterrupt or
    GeneratorExit.

    In the main thread, the timer and the signal SIGALRM are used; an earlier timer goes on, and calls its own handler.
    In other threads, and on Windows, a watching thread raises the exception. Without threads, as in a browser, there is
    no limit: the page ends the worker in which Python runs.

    Raises:
        TimedOut: if the block takes longer than `limit`.
        ValueError: if `limit`, s, is not valid; see `checked_limit`.
    """
    limit = checked_limit(limit)
    if current_thread() is main_thread() and hasattr(signal, "setitimer"):
        return _Alarm(limit)
    return _Watch(limit) if HAS_THREADS else nullcontext()


class _Limit(AbstractContextManager[None]):
    """The time limit of a block.

    Attributes:
        is_late: whether the limit was exceeded while the block lasted.
        is_over: whether the block has ended; nothing is raised any more.
    """

    def __init__(self, limit: float):
        self.is_late = self.is_over = False
        self._limit = limit

        class Raised(TimedOut):  # one class for each limit, because limits may be nested
            def __init__(self, *text: object) -> None:  # SimPy copies an exception by this call
                super().__init__(*text or (f"took longer than {limit:g} s: while the timed block was left",))

        self._raised = Raised

    def _stop(self) -> None:
        """End the watch."""
        raise NotImplementedError

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._stop()
        if not self.is_late or isinstance(error, KeyboardInterrupt | GeneratorExit):
            return
        if error is None:
            raise TimedOut(f"took longer than {self._limit:g} s: it ended by itself, but too late")
        is_described = isinstance(error, TimedOut) and not isinstance(error, self._raised)
        raise TimedOut(
            f"took longer than {self._limit:g} s: {error if is_described else code_place_of(error)}"
        ) from error


QUIET = frozenset({__file__, weakref.__file__, contextlib.__file__})
"""The files in whose code an alarm raises nothing."""
DEFERRING: CodeType = deferred.__wrapped__.__code__  # type: ignore[attr-defined]
"""The code that sets handlers of signals and puts them back; an alarm raises nothing there, nor in what it calls."""


def _is_quiet(frame: FrameType) -> bool:
    """Return whether an alarm raises nothing in a frame; see `_Alarm._ring`."""
    code = frame.f_code
    if code.co_filename in QUIET or any(code is getattr(call, "__code__", None) for call in gc.callbacks):
        return True
    outer: FrameType | None = frame
    while outer is not None and outer.f_code is not DEFERRING:
        outer = outer.f_back
    return outer is not None


class _Alarm(_Limit):
    """The time limit of a block of the main thread, which a signal interrupts."""

    def __enter__(self) -> None:
        self._begin, self._other_due, self._other_interval = monotonic(), inf, 0.0
        self._handler = signal.signal(signal.SIGALRM, self._ring)
        self._take_timer()

    def _take_timer(self) -> None:
        """Note when the earlier timer is due, and set the timer to this time or to the limit, whichever is sooner."""
        delay, self._other_interval = signal.getitimer(signal.ITIMER_REAL)
        now, end = monotonic(), self._begin + self._limit
        self._other_due = now + delay if delay else inf
        wait = min(end - now if now < end else RAISE_INTERVAL, self._other_due - now)
        signal.setitimer(signal.ITIMER_REAL, max(wait, SOON), RAISE_INTERVAL)

    def _return_timer(self) -> None:
        """Set the timer to the remaining time and the interval of the earlier timer."""
        delay = max(self._other_due - monotonic(), SOON) if self._other_due < inf else 0.0
        signal.setitimer(signal.ITIMER_REAL, delay, self._other_interval)

    def _ring(self, number: int, frame: FrameType | None) -> None:
        """Call the handler of the earlier timer if its time has come, and raise the exception if the limit has passed.

        Nothing is raised in a quiet frame; the timer rings again later. Quiet frames are those of this module, which
        reads `is_late` itself, and of `contextlib`; callbacks of weak references or of the garbage collector, where
        Python would only print the exception; and code that sets handlers of signals or puts them back.
        """
        now = monotonic()
        if now >= self._other_due:
            interval = self._other_interval
            self._other_due += interval * ((now - self._other_due) // interval + 1.0) if interval else inf
            self._return_timer()  # the handler may read or set the timer
            try:
                if callable(self._handler):
                    self._handler(number, frame)
            finally:
                if not self.is_over:
                    self._take_timer()
        if self.is_over or now < self._begin + self._limit:
            return
        self.is_late = True
        if not (_is_in(sys.exception(), self._raised) or (frame and _is_quiet(frame))):
            raise self._raised

    def _stop(self) -> None:
        self.is_over = True
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, self._handler)
        self._return_timer()


class _Watch(_Limit):
    """The time limit of a block of any thread, in which another thread raises the exception."""

    def __enter__(self) -> None:
        self._thread, self._wake, self._lock = get_ident(), Event(), Lock()
        Thread(target=self._raise_when_late, daemon=True).start()

    def _raise_when_late(self) -> None:
        sys.settrace(None)  # a traced thread of Python 3.11 stops while an exception is pending in another thread
        sys.setprofile(None)
        pause = self._limit
        while not self._wake.wait(pause):
            pause = RAISE_INTERVAL
            handled: Any = sys._current_exceptions().get(self._thread)
            with self._lock:
                if not (self.is_over or _is_in(handled[1] if isinstance(handled, tuple) else handled, self._raised)):
                    self.is_late = True
                    ctypes.pythonapi.PyThreadState_SetAsyncExc(
                        ctypes.c_ulong(self._thread), ctypes.py_object(self._raised)
                    )

    def _stop(self) -> None:
        while not self.is_over:  # the exception may be raised in this loop, too
            with suppress(self._raised), self._lock:
                self.is_over = True
        self._wake.set()
        if self.is_late:
            with suppress(self._raised):
                for _ in range(100):  # an exception that is still pending is raised at the end of an iteration
                    pass


def _is_in(error: BaseException | None, kind: type[BaseException]) -> bool:
    """Return whether an exception, or one in its chain of contexts, is of a kind."""
    while error is not None and not isinstance(error, kind):
        error = error.__context__
    return error is not None


def code_place_of(error: BaseException) -> str:
    """Return the file, line and function in which an error was raised: the innermost in code of a user, if any."""
    code, line = _raised_in(error)
    return f"{short(code.co_filename)}:{line} ({code.co_name})"


def _raised_in(error: BaseException) -> tuple[CodeType, int]:
    """Return the code and the line that `code_place_of` names."""
    places = list(walk_tb(error.__traceback__))[::-1]
    users = (place for place in places if is_of_user(place[0]))
    others = (place for place in places if place[0].f_code.co_filename != __file__ and not _is_generated(place[0]))
    frame, line = next(users, None) or next(others, None) or places[0]
    return frame.f_code, line or frame.f_code.co_firstlineno  # an instruction may belong to no line


def _is_generated(frame: FrameType) -> bool:
    """Return whether a frame runs code that a library generated, such as that of a named tuple; it has no file."""
    return frame.f_code.co_filename == "<string>" and frame.f_globals.get("__name__") != "__main__"  # `python -c`


def short(file: str) -> str:
    """Return the folder and the name of a source file, for example "kernel/clock.py"."""
    return "/".join(Path(file).parts[-2:])


MAX_LISTED = 100
"""Maximum number of lines about waiting processes."""
MAX_NAMED = 8
"""Maximum number of pursuers that such a line names."""


def interrupted_at(env: "Clock", error: BaseException) -> str:
    """Return the simulated time and the line of code at which a simulation was interrupted."""
    from desim.kernel.core.units import seconds  # slow to import, and needed only here

    code, line = _raised_in(error)
    source = getline(code.co_filename, line).strip()
    return f"at {seconds(env.now):.9g} s of simulated time, in {code_place_of(error)}{f': {source}' if source else ''}"


def _waiting_text(line: str, pursuers: Sequence[int]) -> str:
    """Return the text about the processes that wait at one line, given the pursuer of each."""
    if len(pursuers) == 1:
        return f"pursuer {pursuers[0]}: {line}"
    names = list(map(str, pursuers[:MAX_NAMED])) + (["..."] if len(pursuers) > MAX_NAMED else [])
    return f"{len(pursuers):,} processes wait at {line} (pursuers {', '.join(names)})"


def stuck(env: "Clock", error: TimedOut, processes: Mapping[int, Sequence["RestartableProcess"]]) -> TimedOut:
    """Return the error for a simulation that timed out.

    Its text has the simulated time, the line of code that was interrupted, and up to `MAX_LISTED` lines about waiting
    processes: one line for all processes that wait at the same line of code until the same time.

    Args:
        env: the clock of the simulation.
        error: the exception as it was raised.
        processes: the processes of each pursuer.
    """
    due = env.scheduled()
    alive = [(pursuer, process) for pursuer, pair in processes.items() for process in pair if process.is_alive]
    head = f"{interrupted_at(env, error)}; {'1 process waits' if len(alive) == 1 else f'{len(alive):,} processes wait'}"
    waiting: dict[str, list[int]] = {}
    for pursuer, process in alive:
        waiting.setdefault(f"{_line(process)}{_until(process, due)}", []).append(pursuer)
    lines = [_waiting_text(line, pursuers) for line, pursuers in list(waiting.items())[:MAX_LISTED]]
    more = [f"... and at {counted(len(waiting) - MAX_LISTED, 'more line')}"] if len(waiting) > MAX_LISTED else []
    return TimedOut("\n  ".join([head, *lines, *more]))


def _line(process: "RestartableProcess") -> str:
    """Return the source line at which a process waits, in the innermost of its nested generators."""
    from desim.kernel.core.clock import generator_of

    generator = generator_of(process)
    inner = process.behaviour or generator.gi_yieldfrom
    while isinstance(inner, GeneratorType) and inner.gi_frame is not None:
        generator, inner = inner, inner.gi_yieldfrom
    file, line = generator.gi_code.co_filename, generator.gi_frame.f_lineno
    return f"{short(file)}:{line} ({generator.gi_code.co_qualname}): {getline(file, line).strip()}"


def _until(process: "RestartableProcess", due: Mapping[int, int]) -> str:
    """Return ", at ... s", the time of the first scheduled event that a process waits for; "" if none is scheduled."""
    from desim.kernel.core.clock import parts_of
    from desim.kernel.core.units import seconds

    times = [due[id(event)] for event in parts_of(process.target) if id(event) in due]
    return f", at {seconds(min(times)):.9g} s" if times else ""
