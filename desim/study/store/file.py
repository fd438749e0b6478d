"""The SQLite file of a store: its tables, its journal, and the checks of its content.

Opening a file checks that it has the tables of a store, and lets SQLite check its structure. Reading a row checks only
the types of its values: an edited value of the right type is not noticed.
"""

import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache, wraps
from os import PathLike
from pathlib import Path
from typing import Any, ParamSpec, Self, TypeVar

from pydantic import TypeAdapter, ValidationError

from desim.config.arguments import value_text
from desim.config.caller_warnings import warn_caller
from desim.config.error_texts import text_of
from desim.config.file_names import STORE
from desim.config.interrupts import deferred
from desim.config.suggestion import close_to
from desim.study.store.connection import (
    LOCK_TIMEOUT,
    connected,
    is_unsettled,
    lock_of,
    settle,
    use_rollback_journal,
    use_write_ahead_log,
)
from desim.study.store.file_systems import network_file_system
from desim.study.store.lock_file import Holder, LockedError, LockFile

FORMAT = "4"
"""The version of the tables below, and of the hashes of configurations."""
TABLES = """
CREATE TABLE IF NOT EXISTS about (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS configurations (
    configuration TEXT PRIMARY KEY, place INTEGER NOT NULL, settings TEXT NOT NULL, scenario TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS runs (
    configuration TEXT NOT NULL REFERENCES configurations,
    replication INTEGER NOT NULL,
    root_seed TEXT NOT NULL,
    seed TEXT NOT NULL,
    status TEXT NOT NULL CHECK (status IN ('ok', 'error', 'crashed')),
    summary TEXT,
    traceback TEXT NOT NULL,
    PRIMARY KEY (configuration, replication, root_seed)
);
CREATE TABLE IF NOT EXISTS metrics (
    name TEXT PRIMARY KEY, unit TEXT NOT NULL, code TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS commands (
    folder TEXT NOT NULL, argv TEXT NOT NULL, PRIMARY KEY (folder, argv)
);
"""
"""The tables of a store. Seeds are texts, because they may have more than 64 bits."""
NAMED_BY = {"about": 1, "configurations": 1, "runs": 4, "metrics": 1, "commands": 2}
"""The number of leading columns of each table that identify a row in an error message."""
CACHE = 65_536
"""The largest size of the page cache, kB. The index of 10^6 runs fits into it; with SQLite's default of 2 MB, checking
them is slower."""
HINT = "remove it, or choose another folder (-o, in Python store=)"
ROWID = "ORDER BY rowid"
"""The order in which rows were added, in SQL."""
Arguments = ParamSpec("Arguments")
Returned = TypeVar("Returned")


class StoreError(OSError):
    """Raised when a store cannot be read or written, or belongs to another sweep; the message names the file."""


def naming_the_file(method: Callable[Arguments, Returned]) -> Callable[Arguments, Returned]:
    """Convert the SQLite errors of a store's method into StoreErrors that name the file."""

    @wraps(method)
    def call(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Returned:
        try:
            return method(*args, **kwargs)
        except (sqlite3.Error, UnicodeDecodeError) as error:  # a message of SQLite may quote invalid UTF-8
            path = args[0].path  # type: ignore[attr-defined]
            raise StoreError(f"{path}: {_why_unusable(error, path)}") from error

    return call


def _missing(path: Path | None) -> str:
    """Return the message that a store does not exist, with a similar name in its folder, or how to make a store."""
    # Of DIR/sweep.sqlite without a folder DIR, the name DIR is the wrong one.
    wrong = path.parent if path is not None and path.name == STORE and not path.parent.is_dir() else path
    beside = sorted(other.name for other in wrong.parent.glob("*")) if wrong is not None else []
    similar = close_to(wrong.name, beside, cutoff=0.8) if wrong is not None else []
    hint = f", did you mean {similar[0]!r}?" if similar else "; `desim sweep FILE -o DIR` makes one in DIR"
    return f"{path}: there is no such store{hint}"


def _why_unusable(error: Exception, path: object) -> str:
    """Return the message of SQLite about a file, with what to give instead."""
    text = str(error)
    if text == "unable to open database file":
        return f"{text}: give a path that can be written"
    if text == "file is not a database" and isinstance(path, Path):
        return f"{text}, and is left as it is: give the path of a store (.sqlite), or of a new file"
    return text


class StoreFile:
    """An open file with the tables of a store.

    Args:
        path: the path of the file, which is created if it does not exist; None: in memory.
        read_only: whether the store is only read; the file must then exist, but need not be writable.

    Raises:
        TypeError: if the path is no path.
        StoreError: if the file cannot be opened, is not a store, was made by another version of
            desim, or is damaged; or if it is a symbolic link to a file that does not exist or is empty.
        OSError: if its folder cannot be created.
    """

    def __init__(self, path: str | PathLike[str] | None = None, *, read_only: bool = False):
        if not isinstance(path, str | PathLike | None):
            raise TypeError(
                f"store should be the path of a file, 'out/sweep.sqlite' for instance (got {value_text(path)})"
            )
        path = None if path is None else Path(path)
        self.path: Any = path or "the store in memory"
        self._lock: LockFile | None = None
        self._resources = ExitStack()
        if path and path.is_symlink() and not (path.is_file() and path.stat().st_size):
            raise StoreError(f"{path}: is a symbolic link to {path.readlink()}, which is no store: remove it")
        if path and path.is_dir():
            raise StoreError(f"{path}: is a folder, and a store is a file (.sqlite)")
        if read_only and not (path and path.is_file()):
            raise StoreError(_missing(path))
        self._open(path, read_only)

    @naming_the_file
    def _open(self, path: Path | None, read_only: bool) -> None:
        if path is not None and not read_only:
            path.parent.mkdir(parents=True, exist_ok=True)
        network = network_file_system(path) if path is not None else ""
        try:
            if path is not None and network:
                self._lock_among_hosts(path, network, read_only)
            self.database = connected(path, read_only, network)
            self._resources.callback(lambda: self.database.close())
            self._prepare(path, read_only, network)
        except BaseException:
            self.close()
            raise

    def _lock_among_hosts(self, path: Path, network: str, read_only: bool) -> None:
        """Get the lock of a file on a network file system, and settle the journal of a writer that died.

        Raises:
            StoreError: if another process writes to the file, or its lock file cannot be read or written.
        """

        def tell(holder: Holder) -> None:
            warn_caller(f"{path}: waits until {holder}, has ended")

        try:
            if read_only:
                settle(path, network)
                return
            self._lock = lock_of(path).acquire(LOCK_TIMEOUT, tell)
        except LockedError as error:
            raise StoreError(
                f"{path}: {error}, and on {network} one process at a time writes to a store: wait until it has ended,"
                " or choose another folder (-o, in Python store=)"
            ) from None
        except OSError as error:
            raise StoreError(
                f"{path}: its lock file {lock_of(path).path.name} cannot be used: {error.strerror or error}"
            ) from None
        self._resources.callback(self._lock.release)
        if path.exists() and is_unsettled(path):
            use_rollback_journal(path, network)

    def _prepare(self, path: Path | None, read_only: bool, network: str) -> None:
        """Check the content of the store, or create the tables in an empty file."""
        if _has_tables(path, self.database):
            self.database.execute(f"PRAGMA cache_size = -{CACHE}")
            self._check_content()
        elif read_only:
            raise StoreError(f"{path}: is empty")
        else:
            self._create(path, network)
            self.database.execute(f"PRAGMA cache_size = -{CACHE}")
        synchronous = "FULL" if network else "NORMAL"  # a commit waits for the file server anyway
        self.database.execute("PRAGMA query_only = ON" if read_only else f"PRAGMA synchronous = {synchronous}")

    def _create(self, path: Path | None, network: str) -> None:
        """Create the tables, with a write-ahead log if the file system supports it, else with a rollback journal."""
        reason = "" if network else use_write_ahead_log(self.database)
        if reason or network:
            self.database.close()
            use_rollback_journal(path, network)
            self.database = connected(path, network=network)
        self.database.executescript(f"BEGIN IMMEDIATE; {TABLES} {view_of(())}; COMMIT")
        if network:
            warn_caller(
                f"{path}: is on {network}, so the store has a rollback journal, and one process at a time writes to it",
            )
        elif reason:
            warn_caller(
                f"{path}: this file system allows no write-ahead log ({reason}), so the store has a rollback journal:"
                " let only one sweep at a time use it",
            )

    def _check_content(self) -> None:
        """Raise StoreError if the file is corrupt, or a run has no configuration."""
        if (state := self.check()) != "ok":
            raise StoreError(f"{self.path}: is damaged: {state}")
        if self.database.execute("PRAGMA foreign_key_check").fetchone():
            raise StoreError(f"{self.path}: is damaged: it has runs of a configuration that is missing")

    def rows(self, table: str, where: str = "", values: Sequence[Any] = ()) -> Iterator[tuple[Any, ...]]:
        """Return the rows of a table, which are read one by one."""
        return self.database.execute(f"SELECT * FROM {table} {where}", values)

    def error(self, table: str, row: Sequence[Any], problem: str) -> StoreError:
        """Return an error that names a row of a table."""
        named = zip(self._columns(table)[: NAMED_BY[table]], row, strict=False)
        return StoreError(f"{self.path}: {table}: {', '.join(f'{name} {value}' for name, value in named)}: {problem}")

    def _columns(self, table: str) -> list[str]:
        return [name for _, name, *_ in self.database.execute(f"PRAGMA table_info({table})")]

    @contextmanager
    def reading(self) -> Iterator[None]:
        """Read the state of one moment, even while another process writes."""
        self.database.execute("BEGIN")
        try:
            yield
        finally:
            self.database.rollback()

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """Yield the database inside a transaction that excludes other writers.

        Raises:
            StoreError: if the store is on a network file system and another host took this process for dead.
        """
        if self._lock is not None and not self._lock.is_held():
            raise StoreError(
                f"{self.path}: this process gave no sign of life for so long that another one took over the store;"
                " the same command resumes"
            )
        with self.database:
            self.database.execute("BEGIN IMMEDIATE")
            yield self.database

    def read(self, adapter: TypeAdapter[Any], table: str, row: Sequence[Any], column: int | None = None) -> Any:
        """Return a row, or one column of it, parsed and checked against a type.

        Raises:
            StoreError: if a value has another type.
        """
        try:
            return adapter.validate_python(row if column is None else row[column], strict=True)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            index, *inner = first["loc"] if column is None else (column, *first["loc"])
            place = ".".join(map(str, (self._columns(table)[int(index)], *inner)))
            raise self.error(table, row, f"{place}: {text_of(first)}") from error

    @naming_the_file
    def check(self) -> str:
        """Return "ok", or the damage that SQLite finds in the file."""
        return str(self.database.execute("PRAGMA integrity_check").fetchone()[0])

    def close(self) -> None:
        """Close the file; when its last connection closes, SQLite moves a write-ahead log into it."""
        self._resources.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@cache
def adapter_of(kind: Any) -> TypeAdapter[Any]:
    """Return the pydantic adapter that checks values against a type.

    Interrupts are deferred: pydantic drops one that is raised while it compiles a pattern, which then matches nothing.
    """
    with deferred():
        return TypeAdapter(kind)


def view_of(metrics: Sequence[str]) -> str:
    """Return the SQL of the view with a row per run and a column per metric."""
    if invalid := [name for name in metrics if not name.isidentifier()]:
        raise StoreError(f"metrics: name {invalid[0]}: should be a Python identifier")
    columns = [f"json_extract(summary, '$.{name}') AS \"{name}\"" for name in metrics if name != "seed"]
    selected = ", ".join(["settings", "replication", "root_seed", "runs.seed AS seed", "status", "traceback", *columns])
    source = "runs JOIN configurations USING (configuration) ORDER BY place, root_seed, replication"
    return f"CREATE VIEW IF NOT EXISTS results AS SELECT {selected} FROM {source}"


def _has_tables(path: Path | None, database: sqlite3.Connection) -> bool:
    """Return whether a database has the tables of a store; False if it is empty.

    Raises:
        StoreError: if it has anything else, such as a trigger, or a view in place of a table, whose query may never
            end.
    """
    objects = dict(database.execute("SELECT name, type FROM sqlite_master WHERE type <> 'index'"))
    if objects and "about" not in objects:
        raise StoreError(f"{path}: is a database, but not the store of a sweep")
    if objects and objects != dict.fromkeys(NAMED_BY, "table") | {"results": "view"}:
        raise StoreError(f"{path}: was made by another version of desim, or edited; {HINT}")
    return bool(objects)
