"""The nursery: a process with one thread that forks the processes of the pursuers, and tells how each of them ends.

It is a process of its own because a fork of a caller with threads may hang, and because it imports once for several
runs. Its standard input ends when the caller ends, in any way; it then ends its children. On Linux, children also end
with the nursery even if they hang.
"""

import asyncio
import ctypes
import os
import pickle
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from time import monotonic
from traceback import print_exc
from typing import Any, Self

from desim.live.start import PursuerStart
from desim.scenario.scenario import Scenario
from desim.study.workers.serialization import packed

GRACE = 2.0
"""Time that the children have to end by themselves once the standard input has ended, s."""
POLL = 0.05
"""Time between two looks for children that have ended, s."""
PR_SET_PDEATHSIG = 1
OnEnd = Callable[[int, int | None], object]
"""A function called with a pursuer whose process has ended, and with the status of the process.

The status is that of `os.waitstatus_to_exitcode`; None: it is not known, because the nursery has ended before.
"""


class Nursery:
    """The processes of live runs; used as an asynchronous context, at whose end all of them have ended."""

    def __init__(self) -> None:
        self._ended: list[OnEnd] = []
        """The function to call, by number of the run."""
        self._alive: set[tuple[int, int]] = set()
        """The number of the run and of the pursuer of each process that has not ended."""

    async def __aenter__(self) -> Self:
        """Start the nursery.

        Raises:
            OSError: if the system cannot fork.
        """
        if not hasattr(os, "fork"):
            raise OSError("desim live needs a system with fork, such as Linux or macOS")
        self._process = await asyncio.create_subprocess_exec(
            sys.executable,
            *("-m", "desim.live.nursery"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for the caller, who ends all
        )
        self._watching = asyncio.create_task(self._watch())
        return self

    async def __aexit__(self, *_: object) -> None:
        """End all processes."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        await self._process.wait()
        await self._watching

    async def start(self, scenario: Scenario, starts: Sequence[PursuerStart], ended: OnEnd) -> None:
        """Start the pursuers of a run, and call a function with each whose process ends."""
        run = len(self._ended)
        self._ended.append(ended)
        self._alive |= {(run, start.pursuer) for start in starts}
        # `packed` takes a call: one that returns the scenario and the starts. Unpacking it needs `sys.path`.
        task = pickle.dumps((run, sys.path, packed(partial(tuple, (scenario, starts)))))
        assert self._process.stdin is not None
        with suppress(ConnectionError):  # if the nursery has ended, which `_watch` tells
            self._process.stdin.write(len(task).to_bytes(8, "big") + task)
            await self._process.stdin.drain()
        if self._watching.done():
            self._tell_lost()

    async def _watch(self) -> None:
        assert self._process.stdout is not None
        while line := await self._process.stdout.readline():
            run, pursuer, status = map(int, line.split())
            self._alive.discard((run, pursuer))
            self._ended[run](pursuer, status)
        self._tell_lost()

    def _tell_lost(self) -> None:
        """Tell that the remaining processes are lost: the nursery has ended, and their status is not known."""
        while self._alive:
            run, pursuer = min(self._alive)
            self._alive.remove((run, pursuer))
            self._ended[run](pursuer, None)


# In the process of the nursery.


def serve() -> None:
    """Fork a process for each pursuer that standard input names; print run, number and status when a process ends."""
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, signal.SIG_IGN)  # the caller decides when all end
    children: dict[int, tuple[int, int]] = {}
    """The number of the run and of the pursuer of each child, by its process id."""
    is_open = True
    while is_open:
        readable, _, _ = select.select([0], [], [], POLL if children else None)
        if readable:
            is_open = _serve(children)
        _reap(children)
    deadline = monotonic() + GRACE
    while children:
        _reap(children)
        select.select([], [], [], POLL)
        if monotonic() > deadline:
            for child in children:
                with suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)


def _serve(children: dict[int, tuple[int, int]]) -> bool:
    """Read one task, and fork its processes; return False at the end of standard input, which may be within a task."""
    if not (content := _read(int.from_bytes(_read(8), "big"))):
        return False
    run, sys.path[:], task = pickle.loads(content)
    scenario, starts = pickle.loads(task)()
    from desim.live.node import Node
    from desim.live.pursuer import play

    with suppress(Exception):  # each pursuer raises the exception again, and tells it
        Node(scenario, starts[0].pursuer, starts[0].seed)  # imports what all need, once
    for start in starts:
        if (child := os.fork()) == 0:
            _die_with_parent()
            os.close(0)  # the nursery alone reads tasks
            code = 1
            try:
                code = play(scenario, start)
            except BaseException:
                print_exc()
            finally:
                sys.stderr.flush()
                os._exit(code)
        children[child] = run, start.pursuer
    return True


def _read(length: int) -> bytes:
    """Read so many bytes, or none at the end of standard input."""
    parts = b""
    while len(parts) < length and (part := os.read(0, length - len(parts))):
        parts += part
    return parts if len(parts) == length else b""


def _reap(children: dict[int, tuple[int, int]]) -> None:
    """Tell which children have ended."""
    while children:
        child, status = os.waitpid(-1, os.WNOHANG)
        if not child:
            return
        with suppress(OSError):
            print(*children.pop(child), os.waitstatus_to_exitcode(status), flush=True)


def _die_with_parent() -> None:
    """Let the system end this process when its parent ends, where it can."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            libc: Any = ctypes.CDLL(None)
            libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


if __name__ == "__main__":
    serve()
