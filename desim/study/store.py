"""The store of a sweep: a SQLite file with a row per run. Only the driver writes to it.

Committed rows survive a driver that is killed. Configuration, replication and root seed identify a row, so a run that
is in the store is not repeated. `SELECT * FROM results` has a column per metric.

A row has the metrics that were computed for its run, and the store the code of each. A metric that is added later is
missing in earlier rows, until their runs are repeated because it is asked for. Values of a metric whose code has
changed since are removed.

Each row has a checksum. Opening a file checks its schema, its structure and each row, so a store that was damaged or
edited is refused. The checksums detect accidents; they do not protect against forgery.
"""

import json
import os
import sqlite3
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, wraps
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, ParamSpec, Self, TypeVar, get_type_hints
from zlib import crc32

from pydantic import BaseModel, ConfigDict, Field, Json, TypeAdapter, ValidationError, create_model

from desim.analysis.metrics import METRICS, Summary
from desim.config.json_numbers import from_json, to_json
from desim.study.configurations import Configuration

Status = Literal["ok", "error", "crashed"]
FORMAT = "3"
"""The version of the tables below, and of the hashes of configurations."""
TABLES = """
CREATE TABLE IF NOT EXISTS about (name TEXT PRIMARY KEY, value TEXT NOT NULL, checksum INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS configurations (
    configuration TEXT PRIMARY KEY, place INTEGER NOT NULL, settings TEXT NOT NULL, scenario TEXT NOT NULL,
    checksum INTEGER NOT NULL
);
CREATE TABLE IF NOT EXISTS runs (
    configuration TEXT NOT NULL REFERENCES configurations,
    replication INTEGER NOT NULL,
    root_seed TEXT NOT NULL,
    seed TEXT NOT NULL,
    status TEXT NOT NULL CHECK (status IN ('ok', 'error', 'crashed')),
    summary TEXT,
    traceback TEXT NOT NULL,
    checksum INTEGER NOT NULL,
    PRIMARY KEY (configuration, replication, root_seed)
);
CREATE TABLE IF NOT EXISTS metrics (
    name TEXT PRIMARY KEY, unit TEXT NOT NULL, code TEXT NOT NULL, checksum INTEGER NOT NULL
);
CREATE TABLE IF NOT EXISTS commands (
    folder TEXT NOT NULL, argv TEXT NOT NULL, checksum INTEGER NOT NULL, PRIMARY KEY (folder, argv)
);
"""
"""The tables of a store. Seeds are texts, because they may have more than 64 bits."""
NAMED_BY = {"about": 1, "configurations": 1, "runs": 4, "metrics": 1, "commands": 2}
"""The number of leading columns of each table that identify a row in an error message."""
PATIENCE = 30.0
"""The time-out for a file that another process has locked, s of wall time."""
PAUSE = 0.02
"""The pause between two attempts where SQLite itself does not wait, s of wall time."""
HINT = "remove it, or choose another folder (-o)"
Arguments = ParamSpec("Arguments")
Returned = TypeVar("Returned")


class StoreError(OSError):
    """Raised when a store cannot be read or written, or does not belong to the sweep; the text names its file."""


@dataclass(frozen=True, slots=True)
class Row:
    """A run of a sweep."""

    replication: int
    """The number of the run within its configuration, 0, 1, ..."""
    seed: int
    status: Status
    """ok; error: the run raised an exception; crashed: the run ended its worker process."""
    summary: Summary | None = None
    """The metrics, if ok."""
    traceback: str = ""
    """The traceback and the exception, if the run failed."""

    def value(self, metric: str) -> Any:
        """Return a metric of the run; None if it has no value or is missing, or if the run failed."""
        return None if self.summary is None else self.summary.get(metric)

    @property
    def ok(self) -> bool:
        """Whether the run ended and was measured."""
        return self.status == "ok"

    @property
    def error(self) -> str:
        """The exception of the run in one line; "" if it did not fail."""
        lines = self.traceback.strip().splitlines()
        last_call = max((k for k, line in enumerate(lines) if line.startswith("  ")), default=-1)
        ends = [line for line in lines[last_call + 1 :] if line] or lines[-1:] or [""]
        return ends[0]


def _naming_the_file(method: Callable[Arguments, Returned]) -> Callable[Arguments, Returned]:
    """Return a method of a store such that its SQLite errors become StoreErrors, which name the file."""

    @wraps(method)
    def call(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Returned:
        try:
            return method(*args, **kwargs)
        except (sqlite3.Error, UnicodeDecodeError) as error:  # SQLite may quote damaged text
            raise StoreError(f"{args[0].path}: {error}") from error  # type: ignore[attr-defined]

    return call


class Store:
    """The runs of one sweep, of a shard of it, or of several merged shards.

    Args:
        path: the path of the file, which is created if it does not exist; None: in memory.
        read_only: whether the store is only read; its file must exist and need not be writable.

    Raises:
        StoreError: if the file is not a store, has another version, or is damaged.
    """

    def __init__(self, path: Path | None = None, *, read_only: bool = False):
        self.path: Any = path or "the store in memory"
        self.added = 0
        """The number of runs that were added since the store was opened, repeated ones included."""
        if read_only and not (path and path.is_file()):
            raise StoreError(f"{path}: there is no such store")
        if path and path.is_symlink():  # in an untrusted folder it may point to any file of the user
            raise StoreError(f"{path}: is a link, and its target would be written: give the folder of the store itself")
        self._open(path, read_only)

    @_naming_the_file
    def _open(self, path: Path | None, read_only: bool) -> None:
        if path is not None and not read_only:
            path.parent.mkdir(parents=True, exist_ok=True)
        self._database = _connected(path, read_only)
        try:
            self._prepare(path, read_only)
        except BaseException:
            self.close()
            raise

    def _prepare(self, path: Path | None, read_only: bool) -> None:
        """Check the content of the store, or create its tables."""
        if there := _schema(self._database):
            _check_schema(path, there, self._database)
            self._check_content()
        elif read_only:
            raise StoreError(f"{path}: is empty")
        else:
            self._create(path)
        about = {"format": FORMAT}
        if read_only:
            self._database.execute("PRAGMA query_only = ON")
            self.check_same(about)
        else:
            self._database.execute("PRAGMA synchronous = NORMAL")
            self.record_properties(about)

    def _create(self, path: Path | None) -> None:
        """Create the tables, with a write-ahead log if the file system supports it, else with a rollback journal."""
        fault = _use_write_ahead_log(self._database)
        if fault:
            self._database.close()
            _use_rollback_journal(path)
            self._database = _connected(path)
        self._database.executescript(f"BEGIN IMMEDIATE; {TABLES} {_view(())}; COMMIT")
        if fault:
            warnings.warn(
                f"{path}: this file system allows no write-ahead log ({fault}), so the store has a rollback journal:"
                " let only one sweep at a time use it",
                stacklevel=2,
            )

    def _check_content(self) -> None:
        """Raise StoreError unless the structure of the file is sound and each row matches its checksum."""
        if (found := self.check()) != "ok":
            raise StoreError(f"{self.path}: is damaged: {found}")
        for table in NAMED_BY:
            for _ in self._rows(table):
                pass
        if self._database.execute("PRAGMA foreign_key_check").fetchone():
            raise StoreError(f"{self.path}: is damaged: it has runs of a configuration that is missing")

    def _rows(self, table: str, where: str = "", values: Sequence[Any] = ()) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of a table without their checksums.

        Raises:
            StoreError: if a row does not match its checksum.
        """
        found = self._database.execute(f"SELECT * FROM {table} {where}", values)
        for *row, checksum in found:
            if checksum != _checksum(row):
                raise self._error(table, row, "does not match its checksum, so it was damaged or edited")
            yield tuple(row)

    def _error(self, table: str, row: Sequence[Any], why: str) -> StoreError:
        """Return an error that names a row of a table."""
        named = zip(self._columns(table)[: NAMED_BY[table]], row, strict=False)
        return StoreError(f"{self.path}: {table}: {', '.join(f'{name} {value}' for name, value in named)}: {why}")

    def _columns(self, table: str) -> list[str]:
        return [name for _, name, *_ in self._database.execute(f"PRAGMA table_info({table})")]

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """Yield the database inside a transaction that excludes other writers."""
        with self._database:
            self._database.execute("BEGIN IMMEDIATE")
            yield self._database

    @property
    @_naming_the_file
    def about(self) -> Mapping[str, str]:
        """The properties of the sweep that the store belongs to, as JSON texts by name."""
        return MappingProxyType(dict(self._rows("about")))

    @_naming_the_file
    def read_property(self, name: str, kind: Any) -> Any:
        """Return a property of the sweep, parsed from JSON and checked against a type.

        Raises:
            StoreError: if the property is missing, or has another type.
        """
        if name not in self.about:
            raise StoreError(f"{self.path}: is damaged: {name} is missing in about")
        return self._read(_adapter(Annotated[kind, Json]), "about", (name, self.about[name]), 1)

    def _read(self, adapter: TypeAdapter[Any], table: str, row: Sequence[Any], column: int | None = None) -> Any:
        """Return a row, or one column of it, parsed and checked against a type.

        Raises:
            StoreError: if a value has another type.
        """
        try:
            return adapter.validate_python(row if column is None else row[column], strict=True)
        except ValidationError as error:
            fault = error.errors(include_url=False)[0]
            number, *inner = fault["loc"] if column is None else (column, *fault["loc"])
            place = ".".join(map(str, (self._columns(table)[int(number)], *inner)))
            raise self._error(table, row, f"{place}: {fault['msg']}") from error

    @_naming_the_file
    def check_same(self, about: Mapping[str, str]) -> None:
        """Raise StoreError if a property of the sweep is recorded with another value."""
        mine = self.about
        for name, value in about.items():
            if mine.get(name, value) != value:
                why = _differs(name, self.read_property(name, Any), json.loads(value))
                raise StoreError(f"{self.path}: was made {why}; {HINT}")

    @_naming_the_file
    def record_properties(self, about: Mapping[str, str]) -> None:
        """Record the properties of the sweep.

        Raises:
            StoreError: if the store belongs to another sweep.
        """
        self.check_same(about)
        if about.keys() <= self.about.keys():
            return
        with self._writing() as database:
            self.check_same(about)
            database.executemany("INSERT OR IGNORE INTO about VALUES (?, ?, ?)", map(_with_checksum, about.items()))

    @_naming_the_file
    def register(self, cells: Sequence[Configuration]) -> None:
        """Add configurations in the given order, before all others in the store."""
        entered = {cell.key: (json.dumps(cell.columns), cell.scenario.model_dump_json()) for cell in cells}
        with self._writing() as database:
            there = {key: tuple(each) for key, _, *each in self._rows("configurations", "ORDER BY place")}
            others = {key: each for key, each in there.items() if key not in entered}
            rows = ((key, place, *each) for place, (key, each) in enumerate((entered | others).items()))
            database.executemany(
                "INSERT OR REPLACE INTO configurations VALUES (?, ?, ?, ?, ?)", map(_with_checksum, rows)
            )

    @_naming_the_file
    def register_metrics(self, metrics: Mapping[str, tuple[str, str]]) -> None:
        """Record the unit and the hash of the code of metrics; values that other code computed are removed."""
        with self._writing() as database:
            there = {name: (unit, code) for name, unit, code in self._rows("metrics")}
            changed = {name: each for name, each in metrics.items() if there.get(name) != each}
            outdated = {name for name, (_, code) in changed.items() if name in there and there[name][1] != code}
            for row in list(self._rows("runs")) if outdated else ():
                if (numbers := self._values(row)) is not None:
                    self._put_run(row, {name: each for name, each in numbers.items() if name not in outdated})
            database.executemany(
                "INSERT INTO metrics VALUES (?, ?, ?, ?) ON CONFLICT (name) DO UPDATE SET unit = excluded.unit,"
                " code = excluded.code, checksum = excluded.checksum",
                [_with_checksum((name, *each)) for name, each in changed.items()],
            )
            if not changed.keys() <= there.keys():
                database.execute("DROP VIEW results")
                database.execute(_view(tuple(there | changed)))

    @property
    @_naming_the_file
    def units(self) -> Mapping[str, str]:
        """The unit of each metric that runs of the store may have, by name."""
        return MappingProxyType({name: unit for name, unit, _ in self._rows("metrics", "ORDER BY rowid")})

    @_naming_the_file
    def note_command(self, folder: str, argv: Sequence[str]) -> None:
        """Record a command that adds runs to the store, and its working folder; one that is there is not repeated."""
        with self._writing() as database:
            values = _with_checksum((folder, json.dumps(argv)))
            database.execute("INSERT OR IGNORE INTO commands VALUES (?, ?, ?)", values)

    @property
    @_naming_the_file
    def commands(self) -> list[tuple[str, list[str]]]:
        """The working folder and the words of each command that added runs, oldest first."""
        return [(row[0], self._read(_adapter(ARGV), "commands", row, 1)) for row in self._rows("commands", ROWID)]

    @_naming_the_file
    def add(self, key: str, root: int, row: Row) -> None:
        """Add a run of a configuration and a root seed.

        It replaces the same run if that one failed. A run that did not fail only receives the metrics that it lacks.
        """
        values = (key, row.replication, str(root), str(row.seed), row.status, None, row.traceback)
        with self._writing():
            self._add(values, None if row.summary is None else dict(row.summary))
        self.added += 1

    def _add(self, row: tuple[Any, ...], numbers: Mapping[str, Any] | None, *, keeps_failed: bool = False) -> None:
        """Add the row of a run and its metrics; see `add`. With `keeps_failed` no failure replaces another."""
        there = list(self._rows("runs", "WHERE configuration = ? AND replication = ? AND root_seed = ?", row[:3]))
        known = self._values(there[0]) if there else None
        if known is None:
            if numbers is not None or not (there and keeps_failed):
                self._put_run(row, numbers)
        elif numbers is not None and not numbers.keys() <= known.keys():
            self._put_run(there[0], {**numbers, **known})

    def _values(self, row: tuple[Any, ...]) -> dict[str, Any] | None:
        """Return the metrics in the row of a run by name, as JSON values; None if the run failed."""
        found: dict[str, Any] | None = self._read(_adapter(Json[dict[str, Any]] | None), "runs", row, SUMMARY)
        return found

    def _put_run(self, row: tuple[Any, ...], numbers: Mapping[str, Any] | None) -> None:
        """Write the row of a run with some metrics, in place of the same run."""
        text = None if numbers is None else json.dumps(to_json(numbers))
        values = _with_checksum((*row[:SUMMARY], text, *row[SUMMARY + 1 :]))
        self._database.execute("INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?, ?, ?, ?, ?)", values)

    @_naming_the_file
    def runs(self, key: str, root: int) -> list[Row]:
        """Return the runs of a configuration and a root seed, in the order of replications."""
        where, units = "WHERE configuration = ? AND root_seed = ? ORDER BY replication", self.units
        return [self._run(row, units) for row in self._rows("runs", where, (key, str(root)))]

    def _run(self, row: tuple[Any, ...], units: Mapping[str, str]) -> Row:
        """Return the run in a row, given the units of the metrics of the store."""
        _, replication, _, seed, status, numbers, trace = self._read(_adapter(RUN), "runs", row)
        if (numbers is None) == (status == "ok"):
            raise self._error("runs", row, "should have a summary if its status is ok, and none if not")
        if numbers is None:
            return Row(replication, int(seed), status, None, trace)
        if strange := sorted(numbers.model_fields_set - units.keys()):
            raise self._error("runs", row, f"summary.{strange[0]}: is no metric of this store")
        own = {name: unit for name, unit in units.items() if name not in METRICS}
        return Row(
            replication, int(seed), status, Summary(from_json(numbers.model_dump(exclude_unset=True)), own), trace
        )

    @_naming_the_file
    def configurations(self) -> list[tuple[str, dict[str, Any]]]:
        """Return the key and the settings of each configuration, in order."""
        found = self._rows("configurations", "ORDER BY place")
        return [(row[0], self._read(_adapter(SETTINGS), "configurations", row, 2)) for row in found]

    @_naming_the_file
    def __len__(self) -> int:
        """Return the number of runs."""
        return int(self._database.execute("SELECT count(*) FROM runs").fetchone()[0])

    @_naming_the_file
    def merge(self, other: "Store") -> None:
        """Add the runs of another store of the same sweep; a run that succeeded there replaces one that failed here.

        A run that succeeded in both has the metrics of both.

        Raises:
            StoreError: if the other store belongs to another sweep, or has a metric that other code computed.
        """
        self.record_properties(other.about)
        codes = {name: code for name, _, code in self._rows("metrics")}
        metrics = {name: (unit, code) for name, unit, code in other._rows("metrics", ROWID)}
        for name, (_, code) in metrics.items():
            if codes.get(name, code) != code:
                raise StoreError(f"{self.path}: the metric {name} was computed by other code in {other.path}; {HINT}")
        self.register_metrics(metrics)
        for folder, argv in other.commands:
            self.note_command(folder, argv)
        # Runs first: if `other` is being written, each of them then has its configuration.
        runs, configurations = list(other._rows("runs")), list(other._rows("configurations"))
        with self._writing() as database:
            database.executemany(
                "INSERT OR IGNORE INTO configurations VALUES (?, ?, ?, ?, ?)", map(_with_checksum, configurations)
            )
            for row in runs:
                self._add(row, other._values(row), keeps_failed=True)

    @_naming_the_file
    def check(self) -> str:
        """Return "ok", or the damage that SQLite finds in the file."""
        return str(self._database.execute("PRAGMA integrity_check").fetchone()[0])

    def close(self) -> None:
        """Close the file; SQLite moves the content of its journal into it."""
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


Digits = Annotated[str, Field(pattern="^[0-9]{1,4000}$")]
"""A seed as text: a non-negative integer, short enough for Python's parser."""
ROWID = "ORDER BY rowid"
SUMMARY = 5
"""The column of `runs` with the metrics."""


class _Metrics(BaseModel):
    """Metrics that are not built in."""

    model_config = ConfigDict(strict=True, extra="allow", protected_namespaces=())
    __pydantic_extra__: dict[str, bool | int | float | Literal["Infinity", "-Infinity"] | None]


_FIELDS: dict[str, Any] = {name: (kind | None, None) for name, kind in get_type_hints(Summary).items()}
_Numbers = create_model("Numbers", __base__=_Metrics, **_FIELDS)
"""The model of a summary in JSON; a run that was stored before a metric existed lacks it."""
ARGV = Json[list[str]]
RUN: Any = tuple[str, Annotated[int, Field(ge=0)], Digits, Digits, Status, Json[_Numbers] | None, str]
SETTINGS = Json[dict[str, bool | int | float | str]]
"""The types of a row of `runs`, and of the settings of a configuration."""


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _address(path: Path, read_only: bool) -> str:
    """Return the URI with which SQLite opens a file.

    A file that is not writable is opened as immutable, because SQLite could not open it otherwise if it has a
    write-ahead log. If its journal has content, it is not opened as immutable, because SQLite would ignore the journal.
    """
    options = "rwc"
    if read_only:
        pending = any(each.is_file() and each.stat().st_size for each in map(Path, (f"{path}-wal", f"{path}-journal")))
        is_writable = os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)
        options = "rw" if is_writable else "ro" if pending else "ro&immutable=1"
    return f"{path.absolute().as_uri()}?mode={options}"


def _connected(path: Path | None, read_only: bool = False) -> sqlite3.Connection:
    """Return a connection to a file, or to a new database in memory."""
    database = sqlite3.connect(":memory:" if path is None else _address(path, read_only), timeout=PATIENCE, uri=True)
    database.text_factory = lambda raw: raw.decode(errors="replace")  # then the checksum reveals invalid UTF-8
    try:
        database.execute("PRAGMA trusted_schema = OFF")
    except sqlite3.Error:
        database.close()
        raise
    return database


def _use_write_ahead_log(database: sqlite3.Connection) -> str:
    """Give a new file a write-ahead log, so that readers and a writer do not block each other.

    Return "", or the reason why the file cannot have one. Changing the journal takes an exclusive lock. SQLite does not
    wait for it while another connection is about to write, as when several processes create the store simultaneously.
    """
    end = time.monotonic() + PATIENCE
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


def _use_rollback_journal(path: Path | None) -> None:
    """Give a file a rollback journal, with exclusive locking, which needs no shared memory."""
    database = _connected(path)
    try:
        database.execute("PRAGMA locking_mode = EXCLUSIVE")
        database.execute("PRAGMA journal_mode = DELETE")
    finally:
        database.close()


def _schema(database: sqlite3.Connection) -> dict[str, tuple[str, str | None]]:
    """Return the type and the SQL of each table, index, view and trigger of a database, by name."""
    found = database.execute("SELECT name, type, sql FROM sqlite_master")
    return {name: (kind, sql) for name, kind, sql in found}


def _view(metrics: Sequence[str]) -> str:
    """Return the SQL of the view with a row per run and a column per metric."""
    columns = [f"json_extract(summary, '$.{name}') AS \"{name}\"" for name in metrics if name != "seed"]
    named = ", ".join(["settings", "replication", "root_seed", "runs.seed AS seed", "status", "traceback", *columns])
    source = "runs JOIN configurations USING (configuration) ORDER BY place, root_seed, replication"
    return f"CREATE VIEW IF NOT EXISTS results AS SELECT {named} FROM {source}"


@cache
def _known_schema(metrics: tuple[str, ...] = ()) -> Mapping[str, tuple[str, str | None]]:
    """Return the schema of a store with some metrics; see `_schema`."""
    database = sqlite3.connect(":memory:")
    try:
        database.executescript(f"{TABLES} {_view(metrics)}")
        return MappingProxyType(_schema(database))
    finally:
        database.close()


def _check_schema(path: Path | None, there: Mapping[str, tuple[str, str | None]], database: sqlite3.Connection) -> None:
    """Raise StoreError unless a database has exactly the schema of a store.

    Otherwise a trigger, or a view in place of a table, could run SQL of the file's author in every command.
    """
    known = _known_schema()
    if "about" not in there:
        raise StoreError(f"{path}: is a database, but not the store of a sweep")
    if strange := sorted(there.keys() - known.keys()):
        raise StoreError(f"{path}: has an unexpected object ({there[strange[0]][0]} {strange[0]}); {HINT}")
    _check_same_schema(path, {name: each for name, each in known.items() if each[0] == "table"}, there)
    metrics = tuple(name for (name,) in database.execute(f"SELECT name FROM metrics {ROWID}"))
    if strange := [name for name in metrics if not (isinstance(name, str) and name.isidentifier())]:
        raise StoreError(f"{path}: metrics: name {strange[0]}: should be a Python identifier")
    _check_same_schema(path, _known_schema(metrics), there)


def _check_same_schema(
    path: Path | None,
    known: Mapping[str, tuple[str, str | None]],
    there: Mapping[str, tuple[str, str | None]],
) -> None:
    """Raise StoreError if a table or view of the known schema is missing or different in a database."""
    for name, each in known.items():
        if each != there.get(name):
            state = "missing" if name not in there else "different"
            raise StoreError(f"{path}: was made by another version of desim, or edited: {name} is {state}; {HINT}")


def _checksum(row: Sequence[Any]) -> int:
    """Return the CRC-32 of a row."""
    return crc32(json.dumps(row, default=repr).encode())


def _with_checksum(row: Sequence[Any]) -> tuple[Any, ...]:
    return *row, _checksum(row)


def _differs(name: str, one: Any, other: Any) -> str:
    """Return the difference between two sweeps, given a recorded property of each, as the end of an error message."""
    if name == "format":
        return "by another version of desim"
    if name == "scenario":
        old, new = flat(one), flat(other)
        keys = sorted(key for key in old.keys() | new.keys() if old.get(key) != new.get(key))
        texts = "; ".join(f"{key} was {old.get(key, 'not there')}, is {new.get(key, 'not there')}" for key in keys[:5])
        return f"by another configuration: {texts}"
    was, now = json.dumps(one), json.dumps(other)
    is_source = name.startswith(("the code of ", "the content of "))
    return f"by another {'version' if is_source else 'sweep'}: {name} was {was}, is {now}"


def flat(node: Any, opens: Callable[[Any], bool] = lambda _: True, above: str = "") -> dict[str, Any]:
    """Return the values in nested tables and lists by dotted key; a node that `opens` rejects is a value itself."""
    inner = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else None
    if inner is None or not opens(node):
        return {above.removesuffix("."): node}
    return {key: each for name, value in inner for key, each in flat(value, opens, f"{above}{name}.").items()}
