"""Where runs are done: here, in worker processes, on a cluster, or on any executor of one's own.

Workers that are started here ignore Ctrl-C, which is the driver's to answer, and leave as soon as the driver is gone.
"""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from typing import Any, Self

from desim.study.shipping import Call, Shipped

PATIENCE = 10.0
"""How long a cluster has to answer, s."""
WATCH = 0.5
"""How often a worker looks whether its driver is still there, s."""


class Serial(Executor):
    """An executor that does everything at once, here, where a debugger sees it."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function and return its result as a future that is done."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # but not a Ctrl-C
            future.set_exception(error)
        return future


class Workers:
    """An executor as it was given: it is used, never shut down."""

    def __init__(self, executor: Executor, count: int | None = None):
        self.executor = executor
        known: int = getattr(executor, "_max_workers", 1)
        self.count = count or known
        """How many work at the same time."""

    def submit(self, call: Call) -> Future[Any]:
        """Let a worker make a call."""
        return self.executor.submit(Shipped(call))

    def renew(self) -> None:
        """Go on with new workers, after one died.

        Raises:
            BrokenExecutor: if they are not ours to start.
        """
        raise BrokenExecutor(f"a worker of {self.executor!r} died, and it takes no more work: give a number of workers")

    def stop(self) -> None:
        """Let go of all that has been begun."""

    def died(self, error: BaseException) -> bool:
        """Return whether a call failed because its worker died."""
        return isinstance(error, BrokenExecutor)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None


class Processes(Workers):
    """Worker processes of this machine; they are kept for a while, and used again by the next sweep."""

    def __init__(self, count: int):
        self.count = count
        self.renew()

    def renew(self) -> None:
        """Start new workers, unless there are some that wait."""
        from loky import get_reusable_executor

        self.executor = get_reusable_executor(max_workers=self.count, initializer=_serve, initargs=(os.getpid(),))

    def submit(self, call: Call) -> Future[Any]:
        """Let a worker make a call; workers are started by the first calls."""
        with _deaf():
            return super().submit(call)

    def stop(self) -> None:
        """End the workers, whatever they are doing."""
        self.executor.shutdown(wait=True, kill_workers=True)  # type: ignore[call-arg]


class Cluster(Workers):
    """The workers of a Dask scheduler (the extra `cluster`).

    Raises:
        ConnectionError: if it does not answer in time, or has no workers.
    """

    def __init__(self, address: str, patience: float = PATIENCE):
        try:
            from distributed import Client
        except ImportError as error:
            raise ConnectionError(
                f"{address}: no cluster without Dask: pip install 'pursuit-desim[cluster]'"
            ) from error
        try:
            self._client = Client(address, timeout=patience, set_as_default=False)
        except (OSError, ValueError) as error:  # time-outs are OSErrors
            raise ConnectionError(f"{address}: no scheduler answers within {patience:g} s ({error})") from error
        try:
            self._client.wait_for_workers(1, timeout=patience)
        except TimeoutError as error:
            self._client.close()
            raise ConnectionError(f"{address}: the scheduler has no workers within {patience:g} s") from error
        super().__init__(self._client.get_executor(pure=False), sum(self._client.nthreads().values()))

    def renew(self) -> None:
        """Do nothing: the cluster looks after its workers."""

    def died(self, error: BaseException) -> bool:
        """Return whether a call failed because its worker died, more than once."""
        return type(error).__name__ == "KilledWorker"

    def __exit__(self, *_: object) -> None:
        self._client.close()


def workers_for(executor: Executor | int | str) -> Workers:
    """Return workers: a number of processes (1 = here, 0 = one per core), those of a scheduler, or an executor's.

    Raises:
        ConnectionError: if a scheduler does not answer.
        ValueError: if a number is negative.
    """
    if isinstance(executor, str):
        return Cluster(executor)
    if isinstance(executor, Executor):
        return Workers(executor)
    if executor < 0:
        raise ValueError(f"the number of workers should be at least 0, got {executor}")
    count = executor or os.cpu_count() or 1
    return Workers(Serial(), 1) if count == 1 else Processes(count)


@contextmanager
def _deaf() -> Iterator[None]:
    """Let processes that are started here inherit that Ctrl-C is not for them; it waits for us meanwhile."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(driver: int) -> None:
    """Prepare a worker process: deaf to Ctrl-C, and gone when its driver is."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == driver:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
