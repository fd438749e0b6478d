"""Where runs are done: here, in worker processes, on a cluster, or on any executor of one's own.

Workers that are started here ignore the signals of `desim.study.interrupts`, which the driver answers, and exit as soon
as the driver is gone.
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
from multiprocessing import resource_tracker
from typing import Any, Self, TypeVar

from desim.config.trust import SHELTER
from desim.study.interrupts import SIGNALS
from desim.study.serialization import Call, called, packed

Returned = TypeVar("Returned")
PATIENCE = 10.0
"""How long a cluster has to answer, s."""
WATCH = 0.5
"""How often a worker looks whether its driver is still there, s."""


class Workers:
    """An executor as it was given: it is used, never shut down."""

    def __init__(self, executor: Executor, count: int | None = None, name: str = ""):
        self.executor = executor
        self._name = name or repr(executor)
        self.count: int = count or getattr(executor, "_max_workers", None) or os.cpu_count() or 1
        """How many work at the same time."""
        self.max_pending = 2 * self.count
        """How many calls to hand out at once, so that nobody waits for the next."""

    def submit(self, call: Call) -> Future[Any]:
        """Let a worker make a call."""
        try:
            content = packed(call)
        except Exception as error:  # what cannot be packed fails as if it had been tried
            future: Future[Any] = Future()
            future.set_exception(error)
            return future
        return self.executor.submit(called, content)

    def done(self, futures: Collection[Future[Any]]) -> set[Future[Any]]:
        """Return those of some calls that have come back, once one has.

        Raises:
            ConnectionError: if none ever will.
        """
        return wait(futures, return_when=FIRST_COMPLETED).done

    def result(self, future: Future[Any]) -> Any:
        """Return what a call returned, or raise why it did not.

        Raises:
            ConnectionError: if the workers went away.
        """
        try:
            return pickle.loads(future.result())
        except CancelledError as error:
            raise ConnectionError(f"{self._name}: went away before the runs were done") from error

    def died(self, error: BaseException) -> bool:
        """Return whether a call failed because its worker died; a cluster says so after several have."""
        return isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker"

    def renew(self) -> None:
        """Go on with new workers, after one died.

        Raises:
            BrokenExecutor: if they are not ours to start.
        """
        raise BrokenExecutor(f"a worker of {self._name} died, and it takes no more work: give a number of workers")

    def stop(self) -> None:
        """Let go of all that has been begun."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None


class InProcess(Workers):
    """No workers: everything is done at once, in this process, where a debugger sees it."""

    def __init__(self) -> None:
        self.count = self.max_pending = 1

    def submit(self, call: Call) -> Future[Any]:
        """Make a call; a Ctrl-C ends it."""
        future: Future[Any] = Future()
        try:
            future.set_result(call())
        except Exception as error:
            future.set_exception(error)
        return future

    def result(self, future: Future[Any]) -> Any:
        """Return what a call returned, as it is."""
        return future.result()


class Processes(Workers):
    """Worker processes of this machine; they are kept for a while, and used again by the next sweep."""

    def __init__(self, count: int):
        super().__init__(_pool(count), count)

    def renew(self) -> None:
        """Start new workers."""
        self.executor = _pool(self.count)

    def submit(self, call: Call) -> Future[Any]:
        """Let a worker make a call; workers are started by the first calls."""
        with _block_signals():
            return super().submit(call)

    def stop(self) -> None:
        """End the workers, whatever they are doing."""
        self.executor.shutdown(wait=True, kill_workers=True)  # type: ignore[call-arg]


class Cluster(Workers):
    """The workers of a Dask scheduler (the extra `cluster`), which looks after them.

    Raises:
        ConnectionError: if it does not answer in time, or has no workers.
    """

    def __init__(self, address: str, patience: float):
        try:
            from distributed import Client
        except ImportError as error:
            raise ConnectionError(
                f"{address}: no cluster without Dask: pip install 'pursuit-desim[cluster]'"
            ) from error
        try:
            self._client = _within(patience, lambda: Client(address, timeout=patience, set_as_default=False))
        except (OSError, ValueError) as error:  # time-outs are OSErrors
            why = f" ({error})" if str(error) else ""
            raise ConnectionError(f"{address}: no scheduler answers within {patience:g} s{why}") from error
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # we tell what goes wrong ourselves
        self._address, self._patience = address, patience
        try:
            self._check()
        except ConnectionError:
            self._client.close()
            raise
        super().__init__(self._client.get_executor(pure=False), sum(self._client.nthreads().values()), address)

    def done(self, futures: Collection[Future[Any]]) -> set[Future[Any]]:
        """Return those of some calls that have come back; while there are none, see whether there is a worker left."""
        while not (found := wait(futures, self._patience, FIRST_COMPLETED).done):
            self._check()
        return found

    def _check(self) -> None:
        """Raise ConnectionError if there are no workers for a while."""
        try:
            _within(self._patience, lambda: self._client.wait_for_workers(1, timeout=self._patience))
        except OSError as error:
            raise ConnectionError(f"{self._address}: has no workers within {self._patience:g} s") from error

    def renew(self) -> None:
        """Do nothing: others start them."""

    def __exit__(self, *_: object) -> None:
        self._client.close()


def workers_for(executor: Executor | int | str) -> Workers:
    """Return workers: a number of processes (1 = here, 0 = one per core), those of a scheduler, or an executor's.

    Raises:
        ConnectionError: if a scheduler does not answer.
        ValueError: if a number is negative.
    """
    if isinstance(executor, str):
        return Cluster(executor, PATIENCE)
    if isinstance(executor, Executor):
        return Workers(executor)
    if executor < 0:
        raise ValueError(f"the number of workers should be at least 0, got {executor}")
    count = executor or os.cpu_count() or 1
    return InProcess() if count == 1 else Processes(count)


def _pool(count: int) -> Executor:
    """Return worker processes that wait, or new ones; they start with the first calls."""
    from loky import get_reusable_executor

    if os.name == "posix":
        with _block_signals():
            resource_tracker.ensure_running()  # or a later `_block_signals` would start it, which makes us hear again
    with _block_signals():  # the executor starts a process that looks after its semaphores
        return get_reusable_executor(  # type: ignore[no-any-return]
            max_workers=count, initializer=_init_worker, initargs=(os.getpid(),), env=SHELTER
        )


def _within(patience: float, act: Callable[[], Returned]) -> Returned:
    """Return what an act of the client returns, or raise TimeoutError: it has no limit where a scheduler is silent."""
    found: Future[Returned] = Future()

    def make() -> None:
        try:
            found.set_result(act())
        except BaseException as error:
            found.set_exception(error)

    threading.Thread(target=make, daemon=True).start()
    return found.result(1.5 * patience)


@contextmanager
def _block_signals() -> Iterator[None]:
    """Let processes that are started here inherit that interrupts are not for them; those wait for us meanwhile.

    Python lets its handler run in the main thread whichever thread hears the signal, and another may not have blocked
    it. So what is heard is noted, and comes afterwards.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    heard: list[int] = []
    is_main = threading.current_thread() is threading.main_thread()
    handlers = {each: handler for each in SIGNALS if is_main and (handler := signal.getsignal(each)) is not None}
    for each in handlers:
        signal.signal(each, lambda number, _: heard.append(number))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        for each, handler in handlers.items():
            signal.signal(each, handler)  # what has come by now is noted before
        for number in heard[:1]:
            signal.raise_signal(number)


def _init_worker(driver: int) -> None:
    """Prepare a worker process: deaf to interrupts, and gone when its driver is."""
    for each in SIGNALS:
        signal.signal(each, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == driver:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
