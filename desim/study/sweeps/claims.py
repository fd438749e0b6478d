"""Runs in batches (lots) that workers claim by lock files, so that fast workers do what slow ones have not begun.

The workers share a folder. The file of a lot is a lock that its worker holds while it performs the runs; when the lot
is done, a second file marks it. The lot of a worker that died is claimed again as soon as its lock is stale; see
`desim.study.store.lock_file`. Each worker has a store of its own, and `desim merge` puts the stores together.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence, Set
from pathlib import Path
from typing import TYPE_CHECKING

from desim.config.whole_files import write_whole
from desim.study.plan.metric_code import units_and_codes
from desim.study.results.result import SweepResult
from desim.study.results.runs import SHOWN
from desim.study.store.lock_file import LockFile
from desim.study.store.store import Store
from desim.study.sweeps.sweep import perform_jobs
from desim.study.sweeps.sweep_plan import Job, SweepPlan
from desim.study.workers.workers import Workers

if TYPE_CHECKING:
    from desim.study.store.run_table import Row

LARGEST = 50
"""The largest number of runs in a lot: these are repeated if a worker dies, and others may wait for them at the end."""
LOTS = 100
"""A sweep of at least so many runs has at least so many lots, enough for many workers."""


class Claims:
    """The lots of a sweep, in a folder that its workers share.

    Args:
        folder: the folder, which is created; several sweeps may share it.
        plan: the sweep; workers share lots only if their plans are equal.

    Raises:
        OSError: if the folder cannot be created.
    """

    def __init__(self, folder: Path, plan: SweepPlan):
        self.lots = lots_of(plan)
        self.folder = folder / _identity(plan)
        self.folder.mkdir(parents=True, exist_ok=True)

    def __iter__(self) -> Iterator[tuple[int, LockFile]]:
        """Yield the number and the lock of each lot that this process gets; the caller must release the lock.

        After the last lot, the lots that another process claimed and did not finish are tried again.
        """
        claimed: set[int] = set()
        claimed_before = -1
        while len(claimed) > claimed_before:  # until a whole round yields no lot
            claimed_before = len(claimed)
            for number in range(len(self.lots)):
                if number in claimed or self._done(number).exists():
                    continue
                lock = LockFile(self.folder / f"{number}.claim")
                if lock.try_acquire() is not None:  # another process holds it
                    continue
                if self._done(number).exists():  # the process that held the lock has just finished the lot
                    lock.release()
                else:
                    claimed.add(number)
                    yield number, lock

    def finish(self, number: int) -> None:
        """Record that the runs of a lot have ended."""
        write_whole(self._done(number), b"")

    def held(self) -> list[int]:
        """Return the numbers of the lots that a process has claimed and not released."""
        return [number for number in range(len(self.lots)) if (self.folder / f"{number}.claim").exists()]

    def done(self) -> list[int]:
        """Return the numbers of the lots whose runs have ended."""
        return [number for number in range(len(self.lots)) if self._done(number).exists()]

    def settle(self, succeeded: Set[tuple[str, int]]) -> None:
        """Reopen the lots with a run that did not succeed (failed, new, or in a lost store), and finish the others.

        Args:
            succeeded: the runs that succeeded, as pairs (hash of the configuration, replication).
        """
        for number, lot in enumerate(self.lots):
            if all((configuration.key, k) in succeeded for configuration, k in lot):
                self.finish(number)
            else:
                self._done(number).unlink(missing_ok=True)

    def _done(self, number: int) -> Path:
        return self.folder / f"{number}.done"


def lots_of(plan: SweepPlan) -> list[list[Job]]:
    """Return the runs of a plan in lots, which depend on nothing but the plan."""
    # A single shard is in the order of the grid, which differs between plans that are equal otherwise.
    jobs = [job for part in (1, 2) for job in plan.shard(part, 2)]
    size = max(1, min(LARGEST, len(jobs) // LOTS))
    return [jobs[begin : begin + size] for begin in range(0, len(jobs), size)]


def _identity(plan: SweepPlan) -> str:
    """Return the name that equal plans share, and no other plan has."""
    keys = sorted(configuration.key for configuration in plan.configurations)
    content = [plan.about, keys, plan.reps, units_and_codes(plan.metrics)]
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=list).encode()).hexdigest()[:16]


def carry_out_claimed(
    plan: SweepPlan,
    store: Store,
    workers: Workers,
    folder: Path,
    *,
    fail_fast: bool = False,
    metrics: Sequence[str] = SHOWN,
    on_start: Callable[[], None] = lambda: None,
) -> SweepResult:
    """Perform the lots of a plan that this process gets, until the others are done or claimed, and return the result.

    `folder` is shared by the workers, and the result has the runs of this store only. The other arguments are those of
    `desim.study.sweeps.sweep.carry_out`.

    Raises:
        RunError: if a run fails and `fail_fast` is set.
        OSError: if the folder cannot be written.
    """
    claims = Claims(folder, plan)
    done = plan.done(store, {"captured", *metrics})  # tables of a sweep always have the column captured
    failed: dict[tuple[str, int], Row] = {}
    on_start()
    for number, lock in claims:
        try:
            jobs = [
                (configuration, k) for configuration, k in claims.lots[number] if (configuration.key, k) not in done
            ]
            failures = perform_jobs(jobs, plan, store, workers, fail_fast=fail_fast) if jobs else {}
            claims.finish(number)
            failed |= failures
        finally:
            lock.release()
    return SweepResult.of(store, [configuration.key for configuration in plan.configurations], failed)
