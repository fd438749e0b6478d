"""The store of a sweep: a file of SQLite with a row per run, to which only the driver writes.

What has been committed outlives a driver that is killed. A row belongs to its configuration, replication and root
seed, so that a run that is there is not done again. `SELECT * FROM results` has a column per metric.
"""

import json
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, ParamSpec, Self, TypeVar

from desim.analysis.metrics import COMMON, Summary, plain
from desim.study.configurations import Cell

Status = Literal["ok", "error", "crashed"]
FORMAT = "1"
"""Of the tables below."""
TABLES = f"""
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
CREATE VIEW IF NOT EXISTS results AS SELECT settings, replication, root_seed, runs.seed AS seed, status, traceback,
    {", ".join(f"json_extract(summary, '$.{name}') AS {name}" for name in COMMON if name != "seed")}
    FROM runs JOIN configurations USING (configuration) ORDER BY place, root_seed, replication;
"""
"""Seeds are texts, for they may have more than 64 bits."""
INSTEAD = """ON CONFLICT (configuration, replication, root_seed) DO UPDATE SET seed = excluded.seed,
    status = excluded.status, summary = excluded.summary, traceback = excluded.traceback WHERE"""
"""What to do with a run that is there already: put the other in its place if ..."""
Arguments = ParamSpec("Arguments")
Returned = TypeVar("Returned")


class StoreError(OSError):
    """A store cannot be read or written, or does not belong to the sweep; the text names its file."""


@dataclass(frozen=True, slots=True)
class Row:
    """A run of a sweep."""

    replication: int
    """Its number within its configuration, 0, 1, ..."""
    seed: int
    status: Status
    """ok; error: it raised something; crashed: it ended its worker."""
    summary: Summary | None = None
    """What was measured, if ok."""
    traceback: str = ""
    """Where it raised what, if it did."""

    @property
    def ok(self) -> bool:
        """Whether it ended and was measured."""
        return self.status == "ok"

    @property
    def error(self) -> str:
        """What it raised, in a line."""
        lines = self.traceback.strip().splitlines()
        last_call = max((k for k, line in enumerate(lines) if line.startswith("  ")), default=-1)
        ends = [line for line in lines[last_call + 1 :] if line] or lines[-1:] or [""]
        return ends[0]


def _naming_the_file(method: Callable[Arguments, Returned]) -> Callable[Arguments, Returned]:
    """Let errors of SQLite name the file."""

    @wraps(method)
    def call(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Returned:
        try:
            return method(*args, **kwargs)
        except sqlite3.Error as error:
            raise StoreError(f"{args[0].path}: {error}") from error  # type: ignore[attr-defined]

    return call


class Store:
    """The runs of one sweep, of a shard of it, or of several merged.

    Args:
        path: of the file, which is made if it is not there; None: in memory.
        must_exist: whether it is an error if it is not there.

    Raises:
        StoreError: if it is no store, or one of another version.
    """

    def __init__(self, path: Path | None = None, *, must_exist: bool = False):
        self.path: Any = path or "the store in memory"
        if must_exist and not (path and path.is_file()):
            raise StoreError(f"{path}: there is no such store")
        if path and path.is_symlink():  # a stranger's folder may have one to whatever it wants changed
            raise StoreError(f"{path}: is a link, and would be written to: name the folder of the store itself")
        self._open(path)

    @_naming_the_file
    def _open(self, path: Path | None) -> None:
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
        self._database = sqlite3.connect(path or ":memory:", timeout=30.0)
        about = {"format": FORMAT, "metrics": json.dumps(COMMON)}
        tables = {name for (name,) in self._database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if not tables:
            self._database.execute("PRAGMA journal_mode = WAL")
            self._database.executescript(f"BEGIN IMMEDIATE; {TABLES} COMMIT")
        elif "about" not in tables:
            raise StoreError(f"{path}: is a database, but not of the runs of a sweep")
        self._database.execute("PRAGMA synchronous = NORMAL")
        self.tell(about)

    @property
    def about(self) -> Mapping[str, str]:
        """What sweep it is of, by name."""
        return MappingProxyType(dict(self._database.execute("SELECT name, value FROM about")))

    @_naming_the_file
    def check_same(self, about: Mapping[str, str]) -> None:
        """Raise StoreError if it is of another sweep than is written down."""
        mine = self.about
        for name, value in about.items():
            if mine.get(name, value) != value:
                why = _differs(name, mine[name], value)
                raise StoreError(f"{self.path}: was made {why}; remove it, or choose another folder (-o)")

    @_naming_the_file
    def tell(self, about: Mapping[str, str]) -> None:
        """Write down what sweep it is of.

        Raises:
            StoreError: if it is of another.
        """
        self.check_same(about)
        mine = self.about
        if new := [(name, value) for name, value in about.items() if name not in mine]:
            with self._database:
                self._database.executemany("INSERT OR IGNORE INTO about VALUES (?, ?)", new)

    @_naming_the_file
    def enter(self, cells: Sequence[Cell]) -> None:
        """Write down configurations, before those that are there."""
        rows = [
            (cell.key, k, json.dumps(cell.columns), cell.scenario.model_dump_json()) for k, cell in enumerate(cells)
        ]
        with self._database:
            self._database.execute("UPDATE configurations SET place = place + ?", (len(cells),))
            self._database.executemany(
                "INSERT INTO configurations VALUES (?, ?, ?, ?)"
                " ON CONFLICT (configuration) DO UPDATE SET place = excluded.place",
                rows,
            )

    @_naming_the_file
    def add(self, key: str, root: int, row: Row) -> None:
        """Write down a run of a configuration and a root seed, instead of one that failed."""
        numbers = None if row.summary is None else json.dumps(plain(row.summary))
        values = (key, row.replication, str(root), str(row.seed), row.status, numbers, row.traceback)
        with self._database:
            self._database.execute(
                f"INSERT INTO runs VALUES (?, ?, ?, ?, ?, ?, ?) {INSTEAD} runs.status != 'ok'", values
            )

    @_naming_the_file
    def runs(self, key: str, root: int) -> list[Row]:
        """Return the runs of a configuration and a root seed, in the order of replications."""
        found = self._database.execute(
            "SELECT replication, seed, status, summary, traceback FROM runs"
            " WHERE configuration = ? AND root_seed = ? ORDER BY replication",
            (key, str(root)),
        )
        return [
            Row(replication, int(seed), status, numbers and Summary(**json.loads(numbers)), trace)
            for replication, seed, status, numbers, trace in found
        ]

    @_naming_the_file
    def configurations(self) -> list[tuple[str, dict[str, Any]]]:
        """Return the key and the settings of each configuration, in order."""
        found = self._database.execute("SELECT configuration, settings FROM configurations ORDER BY place")
        return [(key, json.loads(settings)) for key, settings in found]

    @_naming_the_file
    def __len__(self) -> int:
        """Return the number of runs."""
        return int(self._database.execute("SELECT count(*) FROM runs").fetchone()[0])

    @_naming_the_file
    def take(self, other: "Store") -> None:
        """Add the runs of another store of the same sweep; one that failed here and not there is replaced.

        Raises:
            StoreError: if it is of another sweep.
        """
        self.tell(other.about)
        self._database.execute("ATTACH ? AS other", (str(other.path),))
        try:
            with self._database:
                self._database.execute("INSERT OR IGNORE INTO configurations SELECT * FROM other.configurations")
                self._database.execute(
                    f"INSERT INTO runs SELECT * FROM other.runs WHERE true {INSTEAD}"
                    " runs.status != 'ok' AND excluded.status = 'ok'"
                )
        finally:
            self._database.execute("DETACH other")

    @_naming_the_file
    def check(self) -> str:
        """Return "ok", or what SQLite finds wrong with the file."""
        return str(self._database.execute("PRAGMA integrity_check").fetchone()[0])

    def close(self) -> None:
        """Let go of the file; what is in its journal goes into it."""
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _differs(name: str, one: str, other: str) -> str:
    """Return in what two sweeps differ, given what is written down of each."""
    if name in {"format", "metrics"}:
        return "by another version of desim"
    if name == "scenario":
        old, new = flat(json.loads(one)), flat(json.loads(other))
        keys = sorted(key for key in old.keys() | new.keys() if old.get(key) != new.get(key))
        texts = "; ".join(f"{key} was {old.get(key, 'not there')}, is {new.get(key, 'not there')}" for key in keys[:5])
        return f"by another configuration: {texts}"
    return f"by another {'version' if 'code' in name else 'sweep'}: {name} was {one}, is {other}"


def flat(node: Any, opens: Callable[[Any], bool] = lambda _: True, above: str = "") -> dict[str, Any]:
    """Return what is in tables and lists, and in those in them, by dotted key; one that `opens` denies is one value."""
    inner = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else None
    if inner is None or not opens(node):
        return {above.removesuffix("."): node}
    return {key: each for name, value in inner for key, each in flat(value, opens, f"{above}{name}.").items()}
