"""Connections to the SQLite file of a store, and its journal."""

import os
import sqlite3
import time
from pathlib import Path

LOCK_TIMEOUT = 30.0
"""The time-out, s of wall time, for a file that another process has locked."""
PAUSE = 0.02
"""The pause, s of wall time, between two attempts to change the journal; see `_use_write_ahead_log`."""


def address_of(path: Path, read_only: bool) -> str:
    """Return the URI with which SQLite opens a file.

    To read a file with a write-ahead log, SQLite needs the index of the log, the file -shm. If this file is missing,
    SQLite creates it, which requires write access. An immutable file is read without an index, so a file is opened as
    immutable if it or its folder is not writable. SQLite ignores the journal of an immutable file. If the journal (-wal
    or -journal) has content, the file is therefore opened read-only instead.
    """
    options = "rwc"
    if read_only:
        pending = any(file.is_file() and file.stat().st_size for file in map(Path, (f"{path}-wal", f"{path}-journal")))
        is_writable = os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)
        options = "rw" if is_writable else "ro" if pending else "ro&immutable=1"
    return f"{path.absolute().as_uri()}?mode={options}"


def connected(path: Path | None, read_only: bool = False) -> sqlite3.Connection:
    """Open a connection to a file, or to a new database in memory."""
    database = sqlite3.connect(
        ":memory:" if path is None else address_of(path, read_only), timeout=LOCK_TIMEOUT, uri=True
    )
    try:
        database.execute("PRAGMA trusted_schema = OFF")
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
        sqlite3.OperationalError: if the file is still locked then.
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


def use_rollback_journal(path: Path | None) -> None:
    """Give a file a rollback journal; with an exclusive lock on the file, SQLite needs no shared memory for this."""
    database = connected(path)
    try:
        database.execute("PRAGMA locking_mode = EXCLUSIVE")
        database.execute("PRAGMA journal_mode = DELETE")
    finally:
        database.close()
