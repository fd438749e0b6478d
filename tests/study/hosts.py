"""Processes that write to stores on a network file system, as if of several hosts: `python -m tests.study.hosts`.

The table of mounts says that the folder is on NFS. Processes are forked, so that each costs no imports.
"""

import os
import random
import signal
import sys
import time
import warnings
from pathlib import Path

from desim.scenario.scenario import Scenario
from desim.study.store import connection, file_systems, lock_file
from desim.study.store.file import StoreError
from desim.study.store.run_table import Row
from desim.study.store.store import Store
from desim.study.sweeps.sweep_plan import SweepPlan

PLAN = SweepPlan.of(Scenario(), {"network.range": [5.0]}, 3)
KEY = PLAN.configurations[0].key


def pretend(folder):
    """Let this process find a network file system in a folder."""
    table = folder / "mounts"
    table.write_text(f"/dev/vda / ext4 rw 0 0\nserver:/home {folder} nfs4 rw 0 0\n")
    file_systems.MOUNTS = table
    warnings.simplefilter("ignore")


def child(act, *args):
    """Perform a function in a process of its own; return its number."""
    number = os.fork()
    if number == 0:
        status = 1
        try:
            act(*args)
            status = 0
        finally:
            os._exit(status)
    return number


def on_host(name):
    """Let this process be of another host."""
    lock_file.place = lambda: name


def write(path, first=0):
    """Add run after run to a store, without end; print the number of each after it is committed."""
    with Store(path) as store:
        PLAN.register(store, mix_versions=True)
        for k in range(max(first, len(store)), 1 << 30):
            store.add(KEY, 0, Row(k, k, "error", None, f"run {k}"))
            os.write(1, f"{k}\n".encode())


def read(path):
    """Return the replications in a store, whose file and rows are checked."""
    with Store(path, read_only=True) as store:
        rows = store.runs(KEY, 0)
        assert [row.traceback for row in rows] == [f"run {row.replication}" for row in rows]
        return [row.replication for row in rows]


def kills(folder, times):
    """Kill a writer at random moments; after each, the store has all runs that were said to be committed.

    Every other is killed while it opens the store, the others while they write, after their first run.
    """
    path, moments, before = folder / "sweep.sqlite", random.Random(3), 0
    for life in range(times):
        reading, writing = os.pipe()
        number = os.fork()
        if number == 0:
            os.dup2(writing, 1)
            write(path)
        os.close(writing)
        first = os.read(reading, 1) if life % 2 else b""
        time.sleep(moments.uniform(0.0, 0.05))
        os.kill(number, signal.SIGKILL)
        os.waitpid(number, 0)
        with os.fdopen(reading, "rb") as told:
            said = [int(line) for line in (first + told.read()).split()]
        if not path.exists() or not path.stat().st_size:  # killed before it made the file
            continue
        try:
            rows = read(path)
        except StoreError as error:  # killed between the file and its tables
            if before or "is empty" not in str(error):
                raise
            continue
        assert rows == list(range(len(rows)))
        assert set(said) <= set(rows)
        assert len(rows) >= before
        before = len(rows)
    print(before)


def add_slowly(path, host, count):
    """Add runs in `count` stints; another writer that comes in between is waited for."""
    on_host(host)
    for k in range(count):
        while True:
            try:
                with Store(path) as store:
                    PLAN.register(store, mix_versions=True)
                    store.add(KEY, 0, Row(len(store), k, "error", None, f"run {len(store)}"))
                break
            except StoreError as error:
                if "uses it" not in str(error):
                    raise


def rivals(folder, count, locked):
    """Let three hosts, whose file locks are not seen by the others, write to one store; return what is in it."""
    file_systems.has_locks = connection.has_locks = lambda _: False
    if not locked:
        lock_file.LockFile.acquire = lambda self, *_: self
        lock_file.LockFile.is_held = lambda self: True
    path = folder / f"{'locked' if locked else 'alone'}.sqlite"
    with Store(path) as store:
        PLAN.register(store, mix_versions=True)
    numbers = [child(add_slowly, path, f"host {k}", count) for k in range(3)]
    failed = sum(os.waitpid(number, 0)[1] != 0 for number in numbers)
    try:
        rows = read(path)
    except (StoreError, AssertionError) as error:
        rows = str(error)
    print(failed, "failed;", "all there" if rows == list(range(3 * count)) else f"damaged: {rows}", flush=True)


if __name__ == "__main__":
    what, where, *options = sys.argv[1:]
    pretend(Path(where))
    {
        "kills": lambda: kills(Path(where), int(options[0])),
        "rivals": lambda: [rivals(Path(where), int(options[0]), locked) for locked in (True, False)],
    }[what]()
