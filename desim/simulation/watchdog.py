"""A limit on the wall time of a block, and a description of what each process waits for when the limit is exceeded."""

import ctypes
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from linecache import getline
from pathlib import Path
from threading import TIMEOUT_MAX, Event, Thread, get_ident
from traceback import walk_tb
from types import GeneratorType
from typing import TYPE_CHECKING, Any

from desim.config.python_numbers import real

if TYPE_CHECKING:
    from desim.kernel.clock import Clock
    from desim.simulation.restartable import RestartableProcess


AGAIN = 0.1
"""Interval, s, at which the watching thread raises its exception again if the exception was lost."""


class TimedOut(BaseException):
    """A time limit was exceeded. It is not an `Exception`, so that `except Exception` does not catch it."""


def checked_limit(limit: float) -> float:
    """Return a time limit, s, as a `float`.

    Raises:
        ValueError: if the limit is not a number, is not positive, or is longer than a thread can wait.
    """
    limit = real(limit, "a time limit")
    if not 0.0 < limit <= TIMEOUT_MAX:
        raise ValueError(f"a time limit should be > 0 s and at most {TIMEOUT_MAX:g} s (got {limit:g})")
    return limit


@contextmanager
def within(limit: float) -> Iterator[None]:
    """Raise TimedOut in this thread if the block has not ended after `limit` s of wall time.

    Use it around a run or any other code that may not terminate. A watching thread raises the exception between two
    Python instructions, also in an endless loop; a call into C finishes first. Other code may swallow the exception:
    pydantic's serialiser drops it or raises another exception instead. The watching thread therefore raises TimedOut
    again while the block lasts, but not while an earlier TimedOut is propagating, so that clean-up is not interrupted.
    A block that exceeds its limit always ends with TimedOut, unless it raises KeyboardInterrupt or GeneratorExit.

    Raises:
        TimedOut: if the block takes longer than `limit`.
        ValueError: if `limit`, s, is not valid; see `checked_limit`.
    """
    limit = checked_limit(limit)
    set_exception, over, thread = ctypes.pythonapi.PyThreadState_SetAsyncExc, Event(), get_ident()
    is_late = is_over = False

    class Raised(TimedOut):
        def __init__(self, *text: object) -> None:  # SimPy copies exceptions, with their text
            super().__init__(
                *text
                or (f"took longer than {limit:g} s: the limit was reached while the timed block was entered or left",)
            )

    def watch() -> None:
        nonlocal is_late
        sys.settrace(None)  # a traced thread of Python 3.11 stands still while an exception is pending in another
        sys.setprofile(None)
        pause = limit
        while not over.wait(pause):
            is_late, pause = True, AGAIN
            if not _handles(thread, Raised):
                set_exception(ctypes.c_ulong(thread), ctypes.py_object(Raised))

    watcher = Thread(target=watch, daemon=True)
    usual_hook = sys.unraisablehook

    def ignore_raised(dropped: "sys.UnraisableHookArgs") -> None:
        if not issubclass(dropped.exc_type, Raised):  # one that hits a callback of the garbage collector is dropped
            usual_hook(dropped)

    def end() -> None:
        nonlocal is_over
        over.set()
        if watcher.is_alive():
            watcher.join()
        if is_late:  # one may be pending; Python 3.11 hangs under a tracer if it is withdrawn, so another replaces it
            with suppress(Raised):
                set_exception(ctypes.c_ulong(thread), ctypes.py_object(Raised))
                while True:
                    pass
        sys.unraisablehook = usual_hook
        is_over = True

    try:
        try:
            sys.unraisablehook = ignore_raised
            watcher.start()
            yield
        finally:
            end()
    except BaseException as error:
        while not is_over:
            with suppress(Raised):  # the watching thread may have raised another just before the first was handled
                end()
        if not is_late or isinstance(error, KeyboardInterrupt | GeneratorExit):
            raise
        is_described = isinstance(error, TimedOut) and not isinstance(error, Raised)
        raise TimedOut(f"took longer than {limit:g} s: {error if is_described else place_of(error)}") from error
    if is_late:
        raise TimedOut(f"took longer than {limit:g} s: it ended by itself, but too late")


def _handles(thread: int, kind: type[BaseException]) -> bool:
    """Return whether a thread is in an `except`, `finally` or `with` block because of an exception of a kind."""
    handled: Any = sys._current_exceptions().get(thread)
    error = handled[1] if isinstance(handled, tuple) else handled  # a tuple before Python 3.12
    while error is not None and not isinstance(error, kind):
        error = error.__context__
    return error is not None


def place_of(error: BaseException) -> str:
    """Return the file, line and function in which an error was raised."""
    *_, (frame, line) = walk_tb(error.__traceback__)
    code = frame.f_code
    where = line or code.co_firstlineno  # an instruction may belong to no line
    return f"{short(code.co_filename)}:{where} ({code.co_name})"


def short(file: str) -> str:
    """Return the folder and the name of a source file, for example "kernel/clock.py"."""
    return "/".join(Path(file).parts[-2:])


MAX_LISTED = 100
"""Maximum number of processes that are listed."""


def stuck(env: "Clock", error: TimedOut, processes: Mapping[int, Sequence["RestartableProcess"]]) -> TimedOut:
    """Return the error for a simulation that timed out.

    Its text has the simulated time, the line of code that was interrupted, and what each process is waiting for, up to
    `MAX_LISTED` processes.

    Args:
        env: the clock of the simulation.
        error: the exception as it was raised.
        processes: the processes of each pursuer.
    """
    from desim.kernel.units import seconds  # slow to import, and needed only here

    due = env.scheduled()
    alive = [(pursuer, each) for pursuer, several in processes.items() for each in several if each.is_alive]
    head = f"at {seconds(env.now):.9g} s of simulated time, in {place_of(error)}; {len(alive):,} processes wait"
    lines = [f"pursuer {pursuer}: {_line(each)}{_until(each, due)}" for pursuer, each in alive[:MAX_LISTED]]
    more = [f"... and {len(alive) - MAX_LISTED:,} more"] if len(alive) > MAX_LISTED else []
    return TimedOut("\n  ".join([head, *lines, *more]))


def _line(process: "RestartableProcess") -> str:
    """Return the source line at which a process waits, in the innermost of its nested generators."""
    from desim.kernel.clock import generator_of

    at = generator_of(process)
    inner = process.behaviour or at.gi_yieldfrom
    while isinstance(inner, GeneratorType) and inner.gi_frame is not None:
        at, inner = inner, inner.gi_yieldfrom
    file, line = at.gi_code.co_filename, at.gi_frame.f_lineno
    return f"{short(file)}:{line} ({at.gi_code.co_qualname}): {getline(file, line).strip()}"


def _until(process: "RestartableProcess", due: Mapping[int, int]) -> str:
    """Return ", at ... s", the time of the first scheduled event that a process waits for; "" if none is scheduled."""
    from desim.kernel.clock import parts_of
    from desim.kernel.units import seconds

    times = [due[id(each)] for each in parts_of(process.target) if id(each) in due]
    return f", at {seconds(min(times)):.9g} s" if times else ""
