"""Stores on network file systems: a fake table of mounts, other hosts, and writers that are killed."""

import fcntl
import json
import os
import sqlite3
import subprocess
import sys
import threading
import time
import warnings
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import pytest

from desim.study.store import connection, file_systems, lock_file
from desim.study.store.connection import LOCK_TIMEOUT
from desim.study.store.file import StoreError
from desim.study.store.file_systems import network_file_system
from desim.study.store.lock_file import LockedError, LockFile
from desim.study.store.store import Store
from tests.study.sweeps import ROOT

TABLE = r"""
proc /proc proc rw 0 0
/dev/vda / ext4 rw 0 0
server:/home /home nfs4 rw,vers=4.2 0 0
/dev/vdb /home/local xfs rw 0 0
//server/share /mnt/my\040share cifs rw 0 0
ib0@tcp:/scratch /scratch lustre rw 0 0
gpfs /gpfs gpfs rw 0 0
beegfs_nodev /bee beegfs rw 0 0
me@host:/ /ssh fuse.sshfs rw 0 0
/dev/sdc1 /ntfs fuseblk rw 0 0
auto /net autofs rw 0 0
host:/data /net nfs rw 0 0
a /over nfs rw 0 0
b /over tmpfs rw 0 0
/dev/vda /homes ext4 rw 0 0
back /odd\134name ceph rw 0 0
C:\134 /mnt/c 9p rw,dirsync,noatime,aname=drvfs;path=C:\134;uid=1000,access=client 0 0
D: /mnt/d drvfs rw,noatime 0 0
shared /media/sf_shared vboxsf rw,nodev,relatime 0 0
share /guest virtiofs rw 0 0
AFS /afs afs rw,relatime,dyn 0 0
AuriStorFS /auri auristorfs rw 0 0
old /old smbfs rw 0 0
node:/volume /gluster fuse.glusterfs rw 0 0
remote:drive /home/local/Drive fuse.rclone rw,nosuid,nodev 0 0
overlay /container overlay rw,lowerdir=/a,upperdir=/home/b 0 0
short /line
"""


@pytest.fixture
def mounts(tmp_path, monkeypatch):
    """Return a function that gives this process another table of mounts."""

    def table(text):
        file = tmp_path / "mounts"
        file.write_text(text)
        monkeypatch.setattr(file_systems, "MOUNTS", file)

    return table


@pytest.fixture
def on_nfs(tmp_path, mounts):
    """Return a folder that is on NFS."""
    folder = tmp_path / "remote"
    folder.mkdir()
    mounts(f"/dev/vda / ext4 rw 0 0\nserver:/ {folder} nfs4 rw 0 0\n")
    return folder


def made(path):
    """Make a store, and see that its journal is told of."""
    with pytest.warns(UserWarning, match=f"^{path}: is on NFS, so the store has a rollback journal, and one process"):
        return Store(path)


@pytest.mark.parametrize(
    ("path", "name"),
    {
        "/usr/lib": "",
        "/home/me/out": "NFS",
        "/home": "NFS",
        "/home/local/out": "",
        "/homes/me": "",
        "/mnt/my share/a": "SMB",
        "/mnt/my": "",
        "/scratch/me": "Lustre",
        "/gpfs/x": "GPFS",
        "/bee/x": "BeeGFS",
        "/ssh/x": "FUSE",
        "/ntfs/x": "FUSE",
        "/net/x": "NFS",
        "/over/x": "",
        "/odd\\name/x": "Ceph",
        "/mnt/c/Users/me": "9P",
        "/mnt/d/x": "a folder of the host",
        "/media/sf_shared/x": "a folder of the host",
        "/guest/x": "virtiofs",
        "/afs/cell/x": "AFS",
        "/auri/x": "AFS",
        "/old/x": "SMB",
        "/gluster/x": "FUSE",
        "/home/local/Drive/x": "FUSE",
        "/container/x": "",
    }.items(),
)
def test_the_mount_of_a_folder_says_its_file_system(mounts, tmp_path, path, name):
    mounts(TABLE)
    assert network_file_system(tmp_path.__class__(path)) == name


def test_a_link_is_followed_and_a_machine_without_the_table_recognises_nothing(tmp_path, on_nfs, monkeypatch):
    link = tmp_path / "link"
    link.symlink_to(on_nfs)
    assert network_file_system(link / "later" / "sweep.sqlite") == "NFS"
    monkeypatch.setattr(file_systems, "MOUNTS", tmp_path / "none")
    assert network_file_system(link) == ""


@pytest.mark.skipif(sys.platform != "linux", reason="the table of mounts is that of Linux")
def test_the_table_of_mounts_is_that_of_this_machine():
    assert Path("/") in {point for point, _ in file_systems._mounts()}


TYPES = {
    "NFS": "nfs nfs4",
    "SMB": "cifs smb2 smb3 smbfs ncpfs",
    "Lustre": "lustre",
    "GPFS": "gpfs",
    "BeeGFS": "beegfs fhgfs",
    "Ceph": "ceph",
    "AFS": "afs auristorfs",
    "9P": "9p",
    "virtiofs": "virtiofs",
    "a cluster file system": "gfs2 ocfs2 panfs orangefs pvfs2 wekafs glusterfs coda dvs cvfs",
    "a folder of the host": "drvfs vboxsf vmhgfs prl_fs",
    "FUSE": "fuse fuseblk fuse.sshfs fuse.other",
    "": "ext4 xfs btrfs zfs tmpfs overlay apfs ntfs3 nfsd squashfs autofs",
}


@pytest.mark.parametrize("name", TYPES)
def test_each_type_of_file_system_has_the_name_that_users_know(tmp_path, mounts, name):
    for kind in TYPES[name].split():
        mounts(f"/dev/vda / ext4 rw 0 0\nserver:/ {tmp_path} {kind} rw 0 0\n")
        assert network_file_system(tmp_path / "sweep.sqlite") == name, kind


def test_a_store_on_a_network_file_system_has_a_rollback_journal_and_one_writer_and_says_so_once(on_nfs):
    path = on_nfs / "sweep.sqlite"
    with made(path) as it:
        assert it.database.execute("PRAGMA journal_mode").fetchone() == ("delete",)
        assert it.database.execute("PRAGMA synchronous").fetchone() == (2,)
        with pytest.raises(StoreError, match="this process uses it already, and on NFS one process at a time"):
            Store(path)
        with Store(path, read_only=True) as reader:
            assert reader.check() == "ok"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with Store(path):
            pass
    assert [file.name for file in on_nfs.iterdir()] == ["sweep.sqlite"]


@pytest.mark.parametrize("left", ["a log", "a log with content", "a journal"])
@pytest.mark.parametrize("read_only", [True, False])
def test_what_a_dead_writer_left_is_taken_over(tmp_path, on_nfs, left, read_only):
    """A store that was made on a local disk has a write-ahead log; a copy taken meanwhile has content in it."""
    path = on_nfs / "sweep.sqlite"
    with Store(tmp_path / "sweep.sqlite") as local:
        local.note_command("here", ["a"])
        if left == "a log with content":
            copy(tmp_path, on_nfs)
    if left == "a log":
        copy(tmp_path, on_nfs)
    elif left == "a journal":
        half_written(tmp_path, on_nfs)
    with Store(path, read_only=read_only) as store:
        assert store.commands == [("here", ["a"])]
        assert store.database.execute("PRAGMA journal_mode").fetchone() == ("delete",)
    assert [file.name for file in on_nfs.iterdir()] == ["sweep.sqlite"]


def copy(source, folder):
    """Copy a store and its journal, but no memory."""
    for file in source.glob("sweep.sqlite*"):
        if not file.name.endswith("-shm"):
            (folder / file.name).write_bytes(file.read_bytes())


def half_written(source, folder):
    """Copy a store as a writer leaves it that dies in a transaction, after its pages were written."""
    connection.use_rollback_journal(source / "sweep.sqlite")
    database = connection.connected(source / "sweep.sqlite")
    database.execute("PRAGMA cache_size = 1")
    database.execute("BEGIN IMMEDIATE")
    database.executemany("INSERT INTO commands VALUES (?, ?)", [(f"{k}" * 500, "[]") for k in range(100)])
    copy(source, folder)
    assert (folder / "sweep.sqlite-journal").stat().st_size > 0
    database.close()


def test_a_file_system_without_locks_is_used_without_them(on_nfs, monkeypatch):
    """Lustre that is mounted without `flock` answers ENOSYS; SQLite could not open a file there."""
    fcntl = pytest.importorskip("fcntl")
    monkeypatch.setattr(fcntl, "lockf", lambda *_: (_ for _ in ()).throw(OSError(38, "Function not implemented")))
    assert "vfs=unix-none" in connection.address_of(on_nfs / "a.sqlite", False, "Lustre")
    with made(on_nfs / "a.sqlite") as store:
        assert store.check() == "ok"
    assert "vfs" not in connection.address_of(on_nfs / "a.sqlite", False)


def held(path, **fields):
    """Write the lock file of another process."""
    path.write_text(json.dumps({"host": "other", "place": "other 1", "pid": 7, "token": "t", **fields}))
    return path


@contextmanager
def elsewhere(monkeypatch):
    """Let this thread be on another host; a holder rewrites its file in a thread of its own."""
    here, this = lock_file.place(), threading.current_thread()
    with monkeypatch.context() as patch:
        patch.setattr(lock_file, "place", lambda: "other" if threading.current_thread() is this else here)
        yield


@pytest.fixture
def _unwatched(monkeypatch):
    """Let a stale lock be removed without a look at its signs of life."""
    monkeypatch.setattr(lock_file, "WATCH", 0.0)


def aged(path, seconds):
    """Let a file be older."""
    os.utime(path, (time.time() - seconds,) * 2)


def test_the_page_of_clusters_states_the_times_of_locks():
    page = " ".join((ROOT / "docs" / "howto" / "cluster.md").read_text().split())
    assert f"rewrites it every {lock_file.HEARTBEAT:g} s" in page
    assert f"A second writer waits for {LOCK_TIMEOUT:g} s" in page
    assert f"its lock file must be {lock_file.STALE:g} s old" in page
    assert f"while it is watched for another {lock_file.WATCH:g} s" in page


@pytest.mark.usefixtures("_unwatched")
def test_a_lock_of_another_host_is_stale_by_its_age_and_not_by_its_process(tmp_path):
    """Process 2 ** 22 + 1 runs nowhere: its number is above the largest of Linux."""
    path = held(tmp_path / "lock", pid=(1 << 22) + 1)
    assert "on other" in str(LockFile(path).try_acquire())
    aged(path, lock_file.STALE - 10.0)
    assert LockFile(path).try_acquire() is not None
    aged(path, lock_file.STALE + 10.0)
    lock = LockFile(path)
    assert lock.try_acquire() is None
    assert lock.is_held()
    lock.release()
    assert list(tmp_path.iterdir()) == []


def test_a_lock_that_is_never_released_does_not_keep_its_process(tmp_path):
    others = {*threading.enumerate()}
    lock = LockFile(tmp_path / "lock")
    assert lock.try_acquire() is None
    started = {*threading.enumerate()} - others
    lock.release()
    assert [thread.daemon for thread in started] == [True]


def test_a_sign_of_life_during_the_release_is_not_written_into_another_file(tmp_path, monkeypatch):
    """One of two other files has the number of the lock file, if this is closed before the sign of life is written."""
    rewrite, entered, go_on = lock_file._rewrite, threading.Event(), threading.Event()

    def late(file, content):
        entered.set()
        assert go_on.wait(5.0)
        rewrite(file, content)

    monkeypatch.setattr(lock_file, "HEARTBEAT", 1e-3)
    lock = LockFile(tmp_path / "lock")
    assert lock.try_acquire() is None
    monkeypatch.setattr(lock_file, "_rewrite", late)
    assert entered.wait(5.0)
    releasing = threading.Thread(target=lock.release)
    releasing.start()
    releasing.join(0.02)
    others = [tmp_path / "a", tmp_path / "b"]
    with others[0].open("wb"), others[1].open("wb"):
        go_on.set()
        releasing.join(5.0)
        time.sleep(0.01)
    assert [other.read_bytes() for other in others] == [b"", b""]


@pytest.mark.parametrize(("pid", "is_free"), [((1 << 22) + 1, True), (os.getppid(), False)])
def test_a_lock_of_this_host_is_stale_as_soon_as_its_process_is_gone(tmp_path, pid, is_free):
    lock = LockFile(held(tmp_path / "lock", place=lock_file.place(), pid=pid))
    assert (lock.try_acquire() is None) == is_free
    lock.release()


@pytest.mark.usefixtures("_unwatched")
@pytest.mark.parametrize(
    "content",
    [b'{"host": "oth', b"", b"\xff\xfe", b"[1, 2]", b'{"host": 1, "place": 2, "pid": "x", "token": 3}', b"[" * 9999],
)
def test_a_damaged_lock_file_counts_until_it_is_old(tmp_path, content):
    path = tmp_path / "lock"
    path.write_bytes(content)
    assert "an unknown process" in str(LockFile(path).try_acquire())
    aged(path, lock_file.STALE + 1.0)
    lock = LockFile(path)
    assert lock.try_acquire() is None
    lock.release()


def test_a_holder_shows_signs_of_life_and_a_rival_is_refused_after_its_patience(tmp_path, monkeypatch):
    monkeypatch.setattr(lock_file, "HEARTBEAT", 0.01)
    monkeypatch.setattr(lock_file, "PAUSE", 0.001)
    path = tmp_path / "lock"
    holder = LockFile(path).acquire(0.0)
    aged(path, 100.0)
    end = time.monotonic() + 30.0
    while time.time() - path.stat().st_mtime > 50.0:
        assert time.monotonic() < end, "it never rewrote its lock"
        time.sleep(0.005)
    monkeypatch.setattr(lock_file, "HEARTBEAT", 1e6)
    clock = count(0.0, 0.004)  # the third look at the lock is the last one, however slow the machine
    monkeypatch.setattr(lock_file, "time", SimpleNamespace(monotonic=lambda: next(clock), sleep=time.sleep))
    waited = []
    told = r"^process \d+ on .*, whose last sign of life is \d+ s old, uses it$"
    with elsewhere(monkeypatch), pytest.raises(LockedError, match=told):
        LockFile(path).acquire(0.01, waited.append)
    assert len(waited) == 1
    holder.release()


@pytest.mark.parametrize("slow", [0.0, 3600.0])
def test_a_holder_whose_clock_differs_by_an_hour_keeps_its_lock_while_it_rewrites_it(tmp_path, monkeypatch, slow):
    """Where the time of a file is that of the host that writes. The control is a holder that has stopped."""
    path, rewrite = tmp_path / "lock", lock_file._rewrite
    holder, rival = LockFile(path), LockFile(path)

    def by_own_clock(file, content):
        rewrite(file, content)
        if file == holder._file:
            os.utime(path, (time.time() - slow,) * 2)

    monkeypatch.setattr(lock_file, "_rewrite", by_own_clock)
    monkeypatch.setattr(lock_file, "HEARTBEAT", 0.01)
    monkeypatch.setattr(lock_file, "WATCH", 0.3)
    monkeypatch.setattr(lock_file, "PAUSE", 0.02)
    holder.acquire(0.0)
    with elsewhere(monkeypatch):
        with pytest.raises(LockedError, match=r"^process \d+ on .*, whose last sign of life is 0 s old, uses it$"):
            rival.acquire(0.0)
        assert holder.is_held()
        holder._ended.set()
        time.sleep(0.05)
        aged(path, lock_file.STALE + 1.0)
        assert rival.try_acquire() is None
    assert not holder.is_held()
    rival.release()
    holder.release()


def test_a_lock_whose_time_lies_ahead_is_stale_after_it_was_not_rewritten_for_long(tmp_path, monkeypatch):
    path = held(tmp_path / "lock")
    aged(path, -3600.0)
    monkeypatch.setattr(lock_file, "STALE", 0.05)
    monkeypatch.setattr(lock_file, "PAUSE", 0.01)
    lock = LockFile(path).acquire(5.0)
    assert lock.is_held()
    lock.release()


def test_a_lock_file_that_is_a_folder_or_a_link_is_refused(on_nfs):
    path = on_nfs / "a.sqlite.writer"
    path.symlink_to(on_nfs / "nowhere")
    told = r"a\.sqlite: its lock file a\.sqlite\.writer cannot be used: "
    with pytest.raises(StoreError, match=told):
        Store(on_nfs / "a.sqlite")
    path.unlink()
    path.mkdir()
    with pytest.raises(StoreError, match=told):
        Store(on_nfs / "a.sqlite")


@pytest.mark.usefixtures("_unwatched")
def test_a_lock_that_was_replaced_before_it_could_be_removed_is_put_back(tmp_path):
    """Two rivals see a stale lock; one has replaced it by its own when the other removes it."""
    path = held(tmp_path / "lock", token="stale")
    aged(path, lock_file.STALE + 1.0)
    slow, fast = LockFile(path), LockFile(path)
    seen = lock_file._holder(path, time.time())
    assert fast.try_acquire() is None
    slow._remove(seen)
    assert fast.is_held()
    fast.release()


def test_a_file_system_without_links_has_locks_all_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "link", lambda *_: (_ for _ in ()).throw(OSError(95, "Operation not supported")))
    lock, rival = LockFile(tmp_path / "lock"), LockFile(tmp_path / "lock")
    assert lock.try_acquire() is None
    assert rival.try_acquire() is not None
    assert lock.is_held()
    assert not rival.is_held()
    lock.release()
    assert rival.try_acquire() is None
    rival.release()


def test_a_writer_that_was_taken_for_dead_writes_no_more(on_nfs):
    """As after the machine slept: another host has the lock now."""
    with made(on_nfs / "a.sqlite") as store:
        held(on_nfs / "a.sqlite.writer")
        with pytest.raises(StoreError, match="another one took over the store; the same command resumes"):
            store.note_command("here", ["a"])
    assert (on_nfs / "a.sqlite.writer").exists(), "the lock of the other was removed"


def test_a_sweep_whose_store_another_host_writes_to_is_refused(on_nfs, monkeypatch):
    monkeypatch.setattr("desim.study.store.file.LOCK_TIMEOUT", 0.0)
    held(on_nfs / "a.sqlite.writer")
    told = r"a\.sqlite: process 7 on other, whose last sign of life is \d s old, uses it, and on NFS one process"
    with pytest.warns(UserWarning, match="waits until process 7 on other"), pytest.raises(StoreError, match=told):
        Store(on_nfs / "a.sqlite")


def of_hosts(*args):
    """Run the program `tests.study.hosts`, and return what it prints."""
    words = [sys.executable, "-W", "ignore", "-m", "tests.study.hosts", *map(str, args)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.slow
def test_a_writer_killed_at_40_moments_loses_no_run_that_was_committed(tmp_path):
    """The program checks rows and file after each; half of the writers are killed after their first run.

    A writer is there again within one stint, as its lock is of here.
    """
    assert int(of_hosts("kills", tmp_path, 40)) >= 20


@pytest.mark.slow
def test_hosts_whose_file_locks_are_not_seen_by_the_others_take_turns(tmp_path):
    """The control is SQLite alone, with locks that other hosts do not see: it loses runs or damages the file."""
    locked, alone = of_hosts("rivals", tmp_path, 15).splitlines()
    assert locked == "0 failed; all there"
    assert "damaged" in alone


@pytest.mark.parametrize(
    ("error", "runs"),
    [(None, True), (ProcessLookupError(), False), (OverflowError(), False), (PermissionError(), True)],
)
def test_a_process_runs_unless_the_system_does_not_know_it(error, runs, monkeypatch):
    """Where there is no /proc, as on macOS; a process of another user may not be asked."""

    def kill(pid, number):
        assert (pid, number) == (7, 0)
        if error:
            raise error

    monkeypatch.setattr(lock_file, "Path", lambda _: tmp)
    monkeypatch.setattr(lock_file.os, "kill", kill)
    tmp = SimpleNamespace(read_text=lambda: (_ for _ in ()).throw(FileNotFoundError()))
    assert lock_file._runs(7) is runs
    monkeypatch.setattr(lock_file.os, "name", "nt")
    assert lock_file._runs(7)


@pytest.mark.parametrize(("state", "runs"), [("S", True), ("R", True), ("Z", False), ("X", False)])
def test_a_process_that_has_ended_and_was_not_asked_for_does_not_run(state, runs, monkeypatch):
    monkeypatch.setattr(lock_file, "Path", lambda _: SimpleNamespace(read_text=lambda: f"7 (a ) S) {state} 1 2"))
    assert lock_file._runs(7) is runs


def test_a_folder_that_cannot_be_probed_counts_as_one_with_locks(tmp_path, monkeypatch):
    assert file_systems.has_locks(tmp_path)
    assert file_systems.has_locks(tmp_path / "missing")
    probed = []
    make = file_systems.tempfile.TemporaryFile
    monkeypatch.setattr(file_systems.tempfile, "TemporaryFile", lambda **named: probed.append(named) or make(**named))
    monkeypatch.setattr(file_systems, "_succeeds", lambda lock: probed.append(lock.args[1:]))
    assert not file_systems.has_locks(tmp_path)
    assert probed == [{"dir": tmp_path}, (fcntl.LOCK_EX | fcntl.LOCK_NB,)]
    monkeypatch.setitem(sys.modules, "fcntl", None)
    assert file_systems.has_locks(tmp_path)


def test_a_database_that_refuses_the_first_command_is_closed(monkeypatch):
    class Database:
        is_closed = False

        def execute(self, _):
            raise sqlite3.OperationalError("no way")

        def close(self):
            self.is_closed = True

    made = Database()
    monkeypatch.setattr(connection.sqlite3, "connect", lambda *_, **__: made)
    with pytest.raises(sqlite3.OperationalError, match="no way"):
        connection.connected(None)
    assert made.is_closed


def test_a_rollback_journal_is_set_under_the_file_system_of_the_store(monkeypatch, tmp_path):
    """Where it has no locks, SQLite has to open the file without."""
    opened, database = [], SimpleNamespace(execute=lambda _: None, close=lambda: None)
    monkeypatch.setattr(connection, "connected", lambda *args, **named: opened.append((args, named)) or database)
    connection.use_rollback_journal(tmp_path / "sweep.sqlite", "Lustre")
    assert opened == [((tmp_path / "sweep.sqlite",), {"network": "Lustre"})]
