"""Connections to the SQLite file of a store, its journal, and its lock on a network file system."""

import os
import sqlite3
import time
from pathlib import Path

from desim.study.store.file_systems import has_locks
from desim.study.store.lock_file import LockFile

LOCK_TIMEOUT = 30.0
"""The time-out, s of wall time, for a file that another process has locked."""
PAUSE = 0.02
"""The pause, s of wall time, between two attempts to change the journal; see `use_write_ahead_log`."""


def address_of(path: Path, read_only: bool, network: str = "") -> str:
    """Return the URI with which SQLite opens a file.

    To read a file with a write-ahead log, SQLite needs the index of the log, the file -shm. If this file is missing,
    SQLite creates it, which requires write access. An immutable file is read without an index, so a file is opened as
    immutable if it or its folder is not writable. SQLite ignores the journal of an immutable file. If the journal (-wal
    or -journal) has content, the file is therefore opened read-only instead.

    On a network file system, a reader never writes: without locks, it could take the journal of a living writer on
    another host for that of a dead one, and undo it. If the network file system has no locks, SQLite uses none.

    Args:
        path: the path of the file.
        read_only: whether the file is only read.
        network: the name of the network file system of the file; "" if it is local.
    """
    options = "rwc"
    if read_only:
        pending = has_journal(path)
        options = "ro" if pending else "ro&immutable=1"
        if network and not has_write_ahead_log(path):
            options = "ro"
        elif not network and is_writable(path):
            options = "rw"
    no_locks = "&vfs=unix-none" if network and not has_locks(path.parent) else ""
    return f"{path.absolute().as_uri()}?mode={options}{no_locks}"


def has_journal(path: Path) -> bool:
    """Return whether the journal of a file has content: its writer is under way, or has died."""
    return any(file.is_file() and file.stat().st_size for file in map(Path, (f"{path}-wal", f"{path}-journal")))


def is_writable(path: Path) -> bool:
    """Return whether a file and its folder can be written."""
    return os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)


def has_write_ahead_log(path: Path) -> bool:
    """Return whether the header of a file names a write-ahead log (SQLite, "Database File Format", 1.3.3)."""
    with path.open("rb") as stream:
        return stream.read(20)[18:20] == b"\2\2"


def is_unsettled(path: Path) -> bool:
    """Return whether a file on a network file system has a journal with content, or a log from a local disk."""
    return has_journal(path) or has_write_ahead_log(path)


def connected(path: Path | None, read_only: bool = False, network: str = "") -> sqlite3.Connection:
    """Open a connection to a file, or to a new database in memory; see `address_of`."""
    database = sqlite3.connect(
        ":memory:" if path is None else address_of(path, read_only, network), timeout=LOCK_TIMEOUT, uri=True
    )
    try:
        database.execute("PRAGMA trusted_schema = OFF")  # a foreign schema may call only harmless functions
    except sqlite3.Error:
        database.close()
        raise
    return database


def use_write_ahead_log(database: sqlite3.Connection) -> str:
    """Give a new file a write-ahead log, so that readers and a writer do not block each other.

    Return "", or the reason why the file cannot have such a log. Changing the journal takes an exclusive lock. SQLite
    does not wait for this lock while another connection is about to write, for example when several processes create
    the store at the same time. The change is therefore attempted again, for up to `LOCK_TIMEOUT`.

    Raises:
        sqlite3.OperationalError: if the file is still locked after this time.
    """
    end = time.monotonic() + LOCK_TIMEOUT
    while True:
        try:
            (mode,) = database.execute("PRAGMA journal_mode = WAL").fetchone()
            database.executescript("BEGIN IMMEDIATE; ROLLBACK")  # fails if memory cannot be shared
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY:
                return str(error)
            if time.monotonic() > end:
                raise
            time.sleep(PAUSE)
        else:
            return "" if mode in {"wal", "memory"} else f"the journal is {mode}"


def use_rollback_journal(path: Path | None, network: str = "") -> None:
    """Give a file a rollback journal; with an exclusive lock on the file, SQLite needs no shared memory for this.

    What a process that died has left in a rollback journal is undone; what it has left in a write-ahead log is kept.
    """
    database = connected(path, network=network)
    try:
        database.execute("PRAGMA locking_mode = EXCLUSIVE")
        database.execute("PRAGMA journal_mode = DELETE")
        database.execute("SELECT count(*) FROM sqlite_master")  # reading undoes what a rollback journal holds
    finally:
        database.close()


def lock_of(path: Path) -> LockFile:
    """Return the lock among hosts of a file on a network file system, which its writer holds."""
    return LockFile(path.with_name(f"{path.name}.writer"))


def settle(path: Path, network: str) -> None:
    """Make a file on a network file system readable without writing, if a writer died and left a journal.

    The file of a living writer is not touched.
    """
    if is_unsettled(path) and is_writable(path):
        lock = lock_of(path)
        if lock.try_acquire() is None:
            try:
                use_rollback_journal(path, network)
            finally:
                lock.release()
