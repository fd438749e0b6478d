"""A limit to how long something may take, whatever it does."""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import TIMEOUT_MAX, Event, Thread, get_ident
from traceback import extract_tb


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

    It is raised between two instructions of Python, also in a loop without end; what is not Python ends first.

    Raises:
        ValueError: if the limit, s, is none.
    """
    checked(limit)
    tell, over, thread = ctypes.pythonapi.PyThreadState_SetAsyncExc, Event(), ctypes.c_ulong(get_ident())

    def watch() -> None:
        if not over.wait(limit):
            tell(thread, ctypes.py_object(TimedOut))

    watcher = Thread(target=watch, daemon=True)
    try:
        try:
            watcher.start()
            yield
        finally:  # where it may still be raised, if the time is over at this very moment
            over.set()
            watcher.join()
            tell(thread, None)
    except TimedOut as error:
        raise TimedOut(f"took longer than {limit:g} s: {str(error) or place_of(error)}") from error


def place_of(error: BaseException) -> str:
    """Return where an error was raised: file, line and function."""
    at = extract_tb(error.__traceback__)[-1]
    return f"{short(at.filename)}:{at.lineno} ({at.name})"


def short(file: str) -> str:
    """Return the path of a source file from its package on."""
    return "/".join(Path(file).parts[-2:])
