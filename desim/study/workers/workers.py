"""Workers perform runs: in this process, in worker processes, on a Dask cluster, or on an executor of the user.

Worker processes ignore the signals of `desim.config.interrupts`, because the driver, the process that dispatches
the runs, handles them. On POSIX systems, worker processes exit when the driver has died.
"""

import logging
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import contextmanager
from typing import Any, Self, TypeVar

from desim.config.arguments import value_text
from desim.config.extras import missing
from desim.config.interrupts import SIGNALS, deferred
from desim.config.trust import NO_CWD_IMPORT
from desim.kernel.core.portable_math import portable_sum
from desim.study.workers.serialization import Call, called, packed

Returned = TypeVar("Returned")
WATCH = 0.5
"""The interval, s of wall time, at which a worker checks that its driver is alive."""


class Workers:
    """The workers of a user's executor, which is never shut down; also the base class of the other kinds of workers."""

    batch_time = 0.25
    """The intended duration of a batch of runs, s of wall time: dispatching a batch takes about a millisecond."""
    batch_size = 64
    """The largest number of runs in a batch."""
    shares = 2
    """The number of batches per worker into which the last waiting runs are divided: a greater number balances unequal
    runs, a smaller one costs less."""
    timeout: float | None = None
    """The wall time of a run, s, after which it counts as failed; None: no limit; see `workers_for`."""

    def __init__(self, executor: Executor, count: int | None = None, name: str = ""):
        self.executor = executor
        self._name = name or value_text(executor)
        self.count: int = count or getattr(executor, "_max_workers", None) or os.cpu_count() or 1
        """The number of calls that the workers can perform at the same time."""
        self.max_pending = 2 * self.count
        """The largest number of submitted calls that have not ended: twice `count`, so that no worker has to wait."""

    def submit(self, call: Call) -> Future[Any]:
        """Submit a call to a worker."""
        try:
            content = packed(call)
        except Exception as error:  # a call that cannot be serialized fails like one that raises
            future: Future[Any] = Future()
            future.set_exception(error)
            return future
        return self.executor.submit(called, content)

    def done(self, futures: Collection[Future[Any]]) -> set[Future[Any]]:
        """Wait until at least one of the given calls has ended, and return all that have ended.

        Raises:
            ConnectionError: if no call can end because the workers are lost.
        """
        return wait(futures, return_when=FIRST_COMPLETED).done

    def result(self, future: Future[Any]) -> Any:
        """Return the result of a call, or raise its exception.

        Raises:
            ConnectionError: if the connection to the workers is lost.
        """
        try:
            return pickle.loads(future.result())
        except CancelledError as error:
            raise ConnectionError(f"{self._name}: disconnected before the runs were done") from error

    def died(self, error: BaseException) -> bool:
        """Return whether a call failed because its worker died; Dask first retries the call on other workers."""
        return isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker"

    def renew(self) -> None:
        """Replace the workers after one died.

        Raises:
            BrokenExecutor: if the executor belongs to the user.
        """
        raise BrokenExecutor(
            f"a worker died, so {self._name} accepts no more calls: pass a number of workers instead of an executor,"
            " and desim replaces workers that die"
        )

    def stop(self) -> None:
        """End the running calls if the kind of workers allows it; do nothing by default."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None


class InProcess(Workers):
    """No worker processes: each call is made at once in this process, where a debugger can follow it."""

    def __init__(self) -> None:
        self.count = self.max_pending = 1

    def submit(self, call: Call) -> Future[Any]:
        """Make a call; Ctrl-C ends it."""
        future: Future[Any] = Future()
        try:
            future.set_result(call())
        except Exception as error:
            future.set_exception(error)
        return future

    def result(self, future: Future[Any]) -> Any:
        """Return the result of a call, or raise its exception."""
        return future.result()


class Processes(Workers):
    """Worker processes of this machine; idle ones stay alive for a while, and the next sweep reuses them.

    Args:
        count: the number of processes.
        kept: whether the processes are for this object only, and stay alive until `stop`.
    """

    def __init__(self, count: int, *, kept: bool = False):
        self._kept = kept
        self._pools: list[Executor] = []  # at most one; copies made by `workers_for` share this list
        super().__init__(_pool(count, kept=kept), count)

    @property
    def executor(self) -> Executor:
        """The pool of the processes; after `stop`, a new one."""
        if not self._pools:
            self._pools.append(_pool(self.count, kept=self._kept))
        return self._pools[0]

    @executor.setter
    def executor(self, pool: Executor) -> None:
        self._pools[:] = [pool]

    def renew(self) -> None:
        """Replace the workers after one died; the next calls start the new ones."""
        self.executor = _pool(self.count, kept=self._kept)

    def submit(self, call: Call) -> Future[Any]:
        """Submit a call to a worker; the first calls start the workers."""
        with _block_signals():
            return super().submit(call)

    def stop(self) -> None:
        """Kill the workers, even during a call; the next call starts new ones."""
        while self._pools:
            self._pools.pop().shutdown(wait=True, kill_workers=True)  # type: ignore[call-arg]


class Cluster(Workers):
    """The workers of a Dask scheduler (needs the extra `cluster`); `patience` is the time-out for its answers, s.

    Raises:
        ConnectionError: if Dask is not installed, the scheduler does not answer in time, or it has no workers.
    """

    def __init__(self, address: str, patience: float):
        try:
            from distributed import Client
        except ImportError:
            raise ConnectionError(f"{address}: {missing('distributed')}") from None
        try:
            self._client = _within(patience, lambda: Client(address, timeout=patience, set_as_default=False))
        except (OSError, ValueError) as error:  # time-outs are OSErrors
            reason = f" ({error})" if str(error) else ""
            raise ConnectionError(f"{address}: no scheduler answers within {patience:g} s{reason}") from error
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # we raise ConnectionErrors instead
        self._address, self._patience = address, patience
        try:
            self._check()
        except ConnectionError:
            self._client.close()
            raise
        super().__init__(self._client.get_executor(pure=False), portable_sum(self._client.nthreads().values()), address)

    def done(self, futures: Collection[Future[Any]]) -> set[Future[Any]]:
        """Wait until at least one of the given calls has ended, and return all that have ended.

        Raises:
            ConnectionError: if the cluster has no workers within the time-out.
        """
        while not (finished := wait(futures, self._patience, FIRST_COMPLETED).done):
            self._check()
        return finished

    def _check(self) -> None:
        """Raise ConnectionError if the cluster has no workers within the time-out."""
        try:
            _within(self._patience, lambda: self._client.wait_for_workers(1, timeout=self._patience))
        except OSError as error:
            raise ConnectionError(f"{self._address}: has no workers within {self._patience:g} s") from error

    def renew(self) -> None:
        """Do nothing: the cluster replaces its own workers."""

    def __exit__(self, *_: object) -> None:
        self._client.close()


def _pool(count: int, *, kept: bool) -> Executor:
    """Return a pool of worker processes, which start when the first calls are submitted.

    If `kept` is true, the pool is new. Otherwise it is loky's reusable pool, which all such callers share.
    """
    from multiprocessing import resource_tracker  # a browser lacks this module and loky, and makes runs in this process

    from loky import ProcessPoolExecutor, get_reusable_executor

    if os.name == "posix":
        with _block_signals():
            resource_tracker.ensure_running()  # it unblocks signals, so the next `with` blocks them again
    with _block_signals():  # loky starts a tracker of its own, another process
        make = ProcessPoolExecutor if kept else get_reusable_executor
        return make(  # type: ignore[no-any-return]
            max_workers=count, initializer=_init_worker, initargs=(os.getpid(),), env=NO_CWD_IMPORT
        )


def _within(patience: float, request: Callable[[], Returned]) -> Returned:
    """Make a request and return its result, or raise TimeoutError after 1.5 x `patience` seconds.

    The time-out of the Dask client is not enough: the client may wait forever for a scheduler.
    """
    future: Future[Returned] = Future()

    def send() -> None:
        try:
            future.set_result(request())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=send, daemon=True).start()
    return future.result(1.5 * patience)


@contextmanager
def _block_signals() -> Iterator[None]:
    """Block the signals of `SIGNALS` while processes start, so that the processes inherit the block.

    Signals that arrive meanwhile are delivered afterwards. A signal may also reach another thread that does not block
    it; Python would then run the handler of the signal in the main thread, which is starting the processes. So the
    signals are deferred, too.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    with deferred():
        previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)  # pending signals are recorded now


def _init_worker(driver: int) -> None:
    """Make a worker process ignore the signals of `SIGNALS`, and exit when its driver has died, see the module."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == driver:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
