"""The nursery: a process of one thread that forks those of the pursuers, and tells how each of them ends.

The caller may have threads, which no fork survives. The nursery ends its children when its standard input ends, which
is when the caller ends, whatever way; where Linux has it, the children end with the nursery even if they hang.
"""

import ctypes
import os
import pickle
import select
import signal
import sys
from contextlib import suppress
from time import monotonic
from typing import Any

GRACE = 2.0
"""Time that the children have to end by themselves once the standard input has ended, s."""
PR_SET_PDEATHSIG = 1


def main() -> None:
    """Fork a process for each pursuer that standard input names, and print the number and the status of each that ends.

    Standard input has a pickle of the folders of modules and, as bytes, of a function that returns the scenario and
    what each process is told.
    """
    length = int.from_bytes(sys.stdin.buffer.read(8), "big")
    paths, task = pickle.loads(sys.stdin.buffer.read(length))
    sys.path[:] = paths
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, signal.SIG_IGN)  # the caller decides when all end
    scenario, starts = pickle.loads(task)()
    from desim.live.node import Node
    from desim.live.pursuer import play

    Node(scenario, starts[0].pursuer, starts[0].seed)  # imports what all need, once
    numbers = {}
    for start in starts:
        if (child := os.fork()) == 0:
            _die_with_parent()
            code = 1
            try:
                code = play(scenario, start)
            finally:
                sys.stderr.flush()
                os._exit(code)
        numbers[child] = start.pursuer
    _watch(numbers)


def _watch(numbers: dict[int, int]) -> None:
    """Tell how each child ends, until all have; end them once standard input has ended."""
    deadline: float | None = None
    while numbers:
        child, status = os.waitpid(-1, os.WNOHANG)
        if child:
            with suppress(OSError):
                print(numbers.pop(child), os.waitstatus_to_exitcode(status), flush=True)
            numbers.pop(child, None)
            continue
        if deadline is None:
            readable, _, _ = select.select([sys.stdin], [], [], 0.02)
            if readable and not os.read(0, 1):
                deadline = monotonic() + GRACE
        else:
            select.select([], [], [], 0.02)
        if deadline is not None and monotonic() > deadline:
            for pid in numbers:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)


def _die_with_parent() -> None:
    """Let the system end this process when its parent ends, where it can."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            libc: Any = ctypes.CDLL(None)
            libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


if __name__ == "__main__":
    main()
