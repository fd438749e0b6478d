"""A limit to how long something may take, and what each process waits for when it is reached."""

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from linecache import getline
from pathlib import Path
from threading import TIMEOUT_MAX, Event, Thread, get_ident
from traceback import extract_tb
from types import GeneratorType
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

if TYPE_CHECKING:
    import simpy

    from desim.kernel.clock import Clock


AGAIN = 0.1
"""How often the watcher looks whether its exception was lost, s."""


class TimedOut(BaseException):
    """What was to be done within a time took longer; no Exception, so that nobody on the way takes it for a fault."""


def checked(limit: float) -> float:
    """Return a limit, s; raise ValueError if it is none."""
    if not 0.0 < limit <= TIMEOUT_MAX:
        raise ValueError(f"should be a time > 0 s (got {limit:g})")
    return limit


@contextmanager
def within(limit: float) -> Iterator[None]:
    """Raise TimedOut in this thread, wherever it is then, if it is still inside after some seconds of wall time.

    A watching thread raises it between two instructions of Python, also in a loop without end; what is not Python ends
    first. Code in between may lose the exception: pydantic's serialiser drops it, or raises an error of its own
    instead. The watcher therefore raises it again whenever it is gone and the block is not over, but never while it is
    on its way, so that clean-up is not disturbed. A block that is not over at its limit ends with TimedOut, whatever
    else it raises or returns; only KeyboardInterrupt takes precedence.

    Raises:
        ValueError: if the limit, s, is none.
    """
    checked(limit)
    tell, over, thread = ctypes.pythonapi.PyThreadState_SetAsyncExc, Event(), ctypes.c_ulong(get_ident())
    on_its_way: WeakSet[TimedOut] = WeakSet()
    is_late = False

    class Told(TimedOut):
        def __init__(self, *text: object) -> None:  # SimPy copies exceptions
            super().__init__(*text or (f"took longer than {limit:g} s: the limit was reached as it began or ended",))
            on_its_way.add(self)

    def watch() -> None:
        nonlocal is_late
        pause = limit
        while not over.wait(pause):
            is_late, pause = True, AGAIN
            if not on_its_way:
                tell(thread, ctypes.py_object(Told))

    watcher = Thread(target=watch, daemon=True)

    def end() -> None:
        over.set()
        if watcher.is_alive():
            watcher.join()
        tell(thread, None)

    try:
        try:
            watcher.start()
            yield
        finally:
            end()
    except BaseException as error:
        end()  # again, for it may have been raised in there; now it is on its way, and nothing else is raised
        if not is_late or isinstance(error, KeyboardInterrupt | GeneratorExit):
            raise
        is_told = isinstance(error, TimedOut) and not isinstance(error, Told)
        raise TimedOut(f"took longer than {limit:g} s: {error if is_told else place_of(error)}") from error
    if is_late:
        raise TimedOut(f"took longer than {limit:g} s: it ended before it could be interrupted")


def place_of(error: BaseException) -> str:
    """Return where an error was raised: file, line and function."""
    at = extract_tb(error.__traceback__)[-1]
    return f"{short(at.filename)}:{at.lineno} ({at.name})"


def short(file: str) -> str:
    """Return the path of a source file from its package on."""
    return "/".join(Path(file).parts[-2:])


MOST = 100
"""How many processes are told of."""


def stuck(env: "Clock", error: TimedOut, processes: Mapping[int, Sequence["simpy.Process"]]) -> TimedOut:
    """Return the error of a simulation that took too long: where it was, and what each pursuer waits for.

    Args:
        env: its clock.
        error: as it was raised.
        processes: of each pursuer; one may run another by hand, its `behaviour`.
    """
    from desim.kernel.clock import seconds  # which takes time to import, and is needed only now

    due = {id(event): int(when) for when, _, _, event in env._queue}
    alive = [(pursuer, each) for pursuer, several in processes.items() for each in several if each.is_alive]
    head = f"at {seconds(env.now):.9g} s of simulated time, in {place_of(error)}; {len(alive):,} processes wait"
    lines = [f"pursuer {pursuer}: {_line(each)}{_until(each, due)}" for pursuer, each in alive[:MOST]]
    more = [f"... and {len(alive) - MOST:,} more"] if len(alive) > MOST else []
    return TimedOut("\n  ".join([head, *lines, *more]))


def _line(process: "simpy.Process") -> str:
    """Return where a process is, in the innermost of what it runs, and what is written there."""
    at: Any = process._generator
    inner = getattr(process, "behaviour", None) or at.gi_yieldfrom
    while isinstance(inner, GeneratorType) and inner.gi_frame is not None:
        at, inner = inner, inner.gi_yieldfrom
    file, line = at.gi_code.co_filename, at.gi_frame.f_lineno
    return f"{short(file)}:{line} ({at.gi_code.co_qualname}): {getline(file, line).strip()}"


def _until(process: "simpy.Process", due: Mapping[int, int]) -> str:
    """Return when what a process waits for comes, if that is known: the first of several events."""
    target = process.target
    from desim.kernel.clock import seconds

    times = [due[id(each)] for each in getattr(target, "_events", [target]) if id(each) in due]
    return f", at {seconds(min(times)):.9g} s" if times else ""
