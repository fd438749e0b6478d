"""The signals that ask a program to end: SIGINT (Ctrl-C), SIGTERM (`kill`, batch systems), SIGHUP (closed terminal)."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = tuple(signal.Signals[name] for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""SIGINT, SIGTERM and SIGHUP, as far as this platform has them; Windows has no SIGHUP."""
_LEFT = (None, signal.SIG_IGN)
"""The handlers that `deferred` does not replace: None stands for one that was not set from Python."""


class Terminated(KeyboardInterrupt):
    """Raised on SIGTERM and SIGHUP; a KeyboardInterrupt, so that it triggers the same clean-up as Ctrl-C.

    Args:
        number: the number of the signal.
    """

    def __init__(self, number: int):
        super().__init__(number)
        self.number = number

    def __str__(self) -> str:
        return f"by {signal.Signals(self.number).name}"


def exit_code(error: KeyboardInterrupt) -> int:
    """Return the exit code of an interrupted program, as in shells: 128 + the number of the signal."""
    return 128 + (error.number if isinstance(error, Terminated) else signal.SIGINT)


@contextmanager
def raising() -> Iterator[None]:
    """Make SIGTERM and SIGHUP raise Terminated while the block runs.

    A signal that already has a handler, or is ignored (as SIGHUP under nohup), is not changed. SIGINT is never changed:
    it has the handler of Python, which raises KeyboardInterrupt, unless the program has chosen another. Only the main
    thread can set handlers, so a block in another thread changes nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    unhandled = [signum for signum in SIGNALS if signum != signal.SIGINT and signal.getsignal(signum) is signal.SIG_DFL]
    for signum in unhandled:
        signal.signal(signum, _terminate)
    try:
        yield
    finally:
        for signum in unhandled:
            signal.signal(signum, signal.SIG_DFL)


@contextmanager
def deferred() -> Iterator[None]:
    """Hold back the signals that arrive while the block runs, and raise the first of them at its end.

    Use it around a call of a library that itself calls Python code: the library may swallow the exception of a signal,
    or wrap it in another exception. A signal that is ignored (as SIGHUP under nohup) stays ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    is_over = False
    handlers = {signum: handler for signum in SIGNALS if (handler := signal.getsignal(signum)) not in _LEFT}

    def hold(number: int, _: FrameType | None) -> None:
        if is_over:  # an exception by a signal between two calls below has left this handler in place
            signal.signal(number, handlers[signal.Signals(number)])
            signal.raise_signal(number)
        else:
            received.append(number)

    try:
        for signum in handlers:
            signal.signal(signum, hold)
        yield
    finally:
        is_over = True
        for signum, handler in handlers.items():
            signal.signal(signum, handler)
        for number in received[:1]:
            signal.raise_signal(number)


def _terminate(number: int, _: FrameType | None) -> None:
    """Raise Terminated, unless one is being handled: the command `timeout` and terminals may send a signal twice."""
    error = sys.exc_info()[1]
    while error is not None:
        if isinstance(error, Terminated):
            return
        error = error.__context__
    raise Terminated(number)
