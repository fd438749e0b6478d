"""Lots that workers claim by file: each run is done once, and what a dead worker claimed is done by another."""

import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from desim import Scenario, Team, sweep
from desim.study.store import lock_file
from desim.study.store.lock_file import LockFile
from desim.study.store.store import Store
from desim.study.sweeps.claims import LARGEST, Claims, carry_out_claimed, lots_of
from desim.study.sweeps.sweep_plan import SweepPlan
from desim.study.workers.workers import InProcess
from tests.command import accepted, refused
from tests.study.sweeps import rows

SMALL = Scenario(team=Team(count=2), horizon=0.5)
GRID = {"network.latency.value": [0.0, 0.1]}


def plan(reps=6, grid=GRID):
    return SweepPlan.of(SMALL, grid, reps)


def runs(lots):
    return sorted((configuration.key, k) for lot in lots for configuration, k in lot)


@pytest.mark.slow_cases("10000")
@pytest.mark.parametrize("reps", [1, 6, 1000, 10_000])
def test_lots_are_small_and_hold_each_run_once_whatever_the_order_of_the_grid(reps):
    lots = lots_of(plan(reps))
    assert runs(lots) == sorted((configuration.key, k) for configuration, k in plan(reps).shard(1, 1))
    assert max(map(len, lots)) <= LARGEST
    assert len(lots) >= min(100, 2 * reps)
    turned = lots_of(plan(reps, {"network.latency.value": [0.1, 0.0]}))
    assert [runs([lot]) for lot in turned] == [runs([lot]) for lot in lots]


def work(claims, taken):
    """Take lots until there are none."""
    for number, lock in claims:
        taken.append(number)
        claims.finish(number)
        lock.release()


@pytest.mark.slow
def test_workers_that_claim_at_the_same_time_never_get_the_same_lot(tmp_path):
    whole, taken = plan(100), []
    with ThreadPoolExecutor(4) as workers:
        list(workers.map(lambda _: work(Claims(tmp_path, whole), taken), range(4)))
    assert sorted(taken) == list(range(len(lots_of(whole))))


def test_other_sweeps_have_other_lots_in_the_same_folder(tmp_path):
    work(Claims(tmp_path, plan()), [])
    assert Claims(tmp_path, plan()).done() == list(range(len(lots_of(plan()))))
    assert Claims(tmp_path, plan(7)).done() == []


def test_the_lot_of_a_dead_worker_is_claimed_again_and_that_of_a_living_one_is_not(tmp_path, monkeypatch):
    monkeypatch.setattr(lock_file, "WATCH", 0.0)
    claims = Claims(tmp_path, plan())
    for number, place in ((0, lock_file.place()), (1, "another host")):
        text = f'{{"host": "h", "place": "{place}", "pid": {(1 << 22) + 1}, "token": "t"}}'
        (claims.folder / f"{number}.claim").write_text(text)
    taken = []
    work(claims, taken)
    assert taken == [k for k in range(len(claims.lots)) if k != 1]
    assert claims.held() == [1]
    os.utime(claims.folder / "1.claim", (time.time() - lock_file.STALE - 1.0,) * 2)
    work(claims, taken)
    assert taken[-1] == 1


def test_a_lot_that_another_worker_ends_while_it_is_claimed_is_released(tmp_path, monkeypatch):
    claims, acquire = Claims(tmp_path, plan()), LockFile.try_acquire

    def too_late(lock):
        held = acquire(lock)
        claims.finish(0)
        return held

    monkeypatch.setattr(LockFile, "try_acquire", too_late)
    taken = []
    work(claims, taken)
    assert taken == list(range(1, len(claims.lots)))
    assert claims.held() == []
    assert not (claims.folder / "0.claim").exists()


def test_a_lot_that_is_not_ended_is_got_once_by_each_worker(tmp_path):
    claims, taken = Claims(tmp_path, plan()), []
    for number, lock in claims:
        taken.append(number)
        lock.release()
    assert taken == list(range(len(claims.lots)))
    assert (claims.held(), claims.done()) == ([], [])


@pytest.mark.slow
def test_two_workers_have_the_runs_of_one_sweep_together(tmp_path):
    """The first ends after three lots, as one that is killed."""
    whole = plan()
    stores = [tmp_path / f"{k}.sqlite" for k in range(2)]
    with Store(stores[0]) as store, InProcess() as workers:
        whole.register(store)
        claims = Claims(tmp_path / "claims", whole)
        for count, (number, lock) in enumerate(claims):
            if count == 3:
                lock.release()
                break
            result = carry_out_one(whole, store, workers, claims, number)
            lock.release()
    assert result == 3
    with Store(stores[1]) as store, InProcess() as workers:
        whole.register(store)
        result = carry_out_claimed(whole, store, workers, tmp_path / "claims")
        assert sum(len(group.rows) for group in result.groups) == len(store) == 12 - 3
    accepted("merge", *stores, "-o", tmp_path / "all")
    sweep(SMALL, GRID, 6, store=tmp_path / "serial.sqlite")
    assert rows(tmp_path / "all" / "sweep.sqlite") == rows(tmp_path / "serial.sqlite")


def carry_out_one(whole, store, workers, claims, number):
    """Perform the runs of one lot; return how many there are in the store."""
    from desim.study.sweeps.sweep import perform_jobs

    perform_jobs(claims.lots[number], whole, store, workers, fail_fast=False)
    claims.finish(number)
    return len(store)


def test_just_the_lots_are_claimed_again_of_which_a_run_is_missing(tmp_path):
    """A run of lot 2 failed, and the runs of lot 0 are known from another sweep."""
    claims = Claims(tmp_path, plan())
    for number, lock in claims:
        if number:
            claims.finish(number)
        lock.release()
    claims.settle({run_of_grid for number, lot in enumerate(claims.lots) if number != 2 for run_of_grid in runs([lot])})
    assert set(range(len(claims.lots))) - set(claims.done()) == {2}


@pytest.mark.slow
def test_the_command_claims_lots_and_leaves_the_rest_to_others(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    accepted("examples", "relay")
    words = ("relay.toml", "--grid", "network.latency.value=0.0,0.1", "-n", 2, "--set", "horizon=0.2")
    accepted("sweep", *words, "--claim", "claims", "-o", "one")
    assert "4 runs" in accepted("merge", "one", "-o", "all").output
    assert "0 runs in" in accepted("sweep", *words, "--claim", "claims", "-o", "two").output
    told = refused("sweep", *words, "--claim", "claims", "--shard", "1/2")
    assert "--claim shares the runs with other commands: it excludes --shard" in told


def descriptors():
    """Return the number of open files of this process."""
    return len([*Path("/dev/fd").iterdir()])


def contested(path):
    lock = LockFile(path)
    assert lock.try_acquire() is None
    assert LockFile(path).try_acquire() is not None
    lock.release()


def damaged(path):
    path.write_bytes(b"no database" * 100)
    with pytest.raises(OSError, match=r"damaged|not a database"):
        Store(path)


def of_another_sweep(path):
    with Store(path) as store:
        plan().register(store)
        with pytest.raises(OSError, match="another"):
            plan(7, {"network.loss.p": [0.5]}).register(store)


@pytest.mark.skipif(not Path("/dev/fd").is_dir(), reason="no list of open files")
@pytest.mark.parametrize("act", [contested, damaged, of_another_sweep])
def test_what_fails_leaves_no_file_open(act, tmp_path):
    act(tmp_path / "first.sqlite")
    before = descriptors()
    act(tmp_path / "second.sqlite")
    assert descriptors() == before
