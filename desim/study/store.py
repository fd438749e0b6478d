"""The store of a sweep: a SQLite file with a row per run, written by the process that dispatches the runs.

Committed rows survive if this process is killed. Configuration, replication and root seed identify a row. A run that is
in the store is repeated only if it failed or lacks a metric. `SELECT * FROM results` has a column per metric.

A row has the metrics that were computed for its run. The store records a hash of the code of each metric. A metric that
is added later is missing in earlier rows, until a command that needs it repeats their runs. If the code of a metric
changes, its values are removed when the new code is registered.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, Json, create_model

from desim.analysis.metrics import METRICS, Summary
from desim.config.json_numbers import from_json, to_json
from desim.study.configurations import Configuration
from desim.study.store_file import (
    FORMAT,
    HINT,
    ROWID,
    StoreError,
    StoreFile,
    adapter_of,
    naming_the_file,
    view_of,
    with_checksum,
)

Status = Literal["ok", "error", "crashed"]


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
        whole = self.traceback.strip().splitlines()
        own = takewhile(lambda line: not line.startswith("  +-"), whole)  # not the members of a group
        lines = [line.removeprefix("  | ") for line in own]
        last_call = max((k for k, line in enumerate(lines) if line.startswith('  File "')), default=-1)
        ends = [line for line in lines[last_call + 1 :] if line.strip() and not line.startswith("  ")]
        return (ends or lines[-1:] or [""])[0]


class Store(StoreFile):
    """The runs of one sweep, of a shard of it (one of several parts that are run separately), or of merged shards.

    Args:
        path: the path of the file, which is created if it does not exist; None: in memory.
        read_only: whether the store is only read; its file must exist and need not be writable.

    Attributes:
        added: number of runs added by `add` since the store was opened, repeated ones included, merged ones not.

    Raises:
        StoreError: if the file cannot be opened, is not a store, has another version, or is damaged.
    """

    def __init__(self, path: Path | None = None, *, read_only: bool = False):
        super().__init__(path, read_only=read_only)
        self.added = 0
        self._codes: dict[str, str] = {}
        try:
            (self.check_same if read_only else self.record_properties)({"format": FORMAT})
        except BaseException:
            self.close()
            raise

    @property
    @naming_the_file
    def about(self) -> Mapping[str, str]:
        """The properties of the sweep that the store belongs to, as JSON texts by name."""
        return MappingProxyType(dict(self.rows("about")))

    @naming_the_file
    def read_property(self, name: str, kind: Any) -> Any:
        """Return a property of the sweep, parsed from JSON and checked against a type.

        Raises:
            StoreError: if the property is missing, or has another type.
        """
        if name not in self.about:
            raise StoreError(f"{self.path}: is damaged: {name} is missing in about")
        return self.read(adapter_of(Annotated[kind, Json]), "about", (name, self.about[name]), 1)

    @naming_the_file
    def check_same(self, about: Mapping[str, str]) -> None:
        """Raise StoreError if a property of the sweep is recorded with another value."""
        mine = self.about
        for name, value in about.items():
            if mine.get(name, value) != value:
                why = _differs(name, self.read_property(name, Any), json.loads(value))
                raise StoreError(f"{self.path}: was made {why}; {HINT}")

    @naming_the_file
    def record_properties(self, about: Mapping[str, str]) -> None:
        """Record the properties of the sweep.

        Raises:
            StoreError: if the store belongs to another sweep.
        """
        self.check_same(about)
        if about.keys() <= self.about.keys():
            return
        with self.writing() as database:
            self.check_same(about)
            database.executemany("INSERT OR IGNORE INTO about VALUES (?, ?, ?)", map(with_checksum, about.items()))

    @naming_the_file
    def register(self, cells: Sequence[Configuration]) -> None:
        """Add or replace configurations, in the given order and before all others in the store."""
        entered = {cell.key: (json.dumps(cell.columns), cell.scenario.model_dump_json()) for cell in cells}
        with self.writing() as database:
            there = {key: tuple(each) for key, _, *each in self.rows("configurations", "ORDER BY place")}
            others = {key: each for key, each in there.items() if key not in entered}
            rows = ((key, place, *each) for place, (key, each) in enumerate((entered | others).items()))
            database.executemany(
                "INSERT OR REPLACE INTO configurations VALUES (?, ?, ?, ?, ?)", map(with_checksum, rows)
            )

    @naming_the_file
    def register_metrics(self, metrics: Mapping[str, tuple[str, str]]) -> None:
        """Record the unit and the hash of the code of metrics; values that other code computed are removed."""
        with self.writing() as database:
            there = {name: (unit, code) for name, unit, code in self.rows("metrics")}
            changed = {name: each for name, each in metrics.items() if there.get(name) != each}
            outdated = {name for name, (_, code) in changed.items() if name in there and there[name][1] != code}
            for row in list(self.rows("runs")) if outdated else ():
                if (numbers := self._values(row)) is not None:
                    self._put_run(row, {name: each for name, each in numbers.items() if name not in outdated})
            database.executemany(
                "INSERT INTO metrics VALUES (?, ?, ?, ?) ON CONFLICT (name) DO UPDATE SET unit = excluded.unit,"
                " code = excluded.code, checksum = excluded.checksum",
                [with_checksum((name, *each)) for name, each in changed.items()],
            )
            if not changed.keys() <= there.keys():
                database.execute("DROP VIEW results")
                database.execute(view_of(tuple(there | changed)))
        self._codes |= {name: code for name, (_, code) in metrics.items()}

    @property
    @naming_the_file
    def units(self) -> Mapping[str, str]:
        """The unit of each metric that runs of the store may have, by name."""
        return MappingProxyType({name: unit for name, unit, _ in self.rows("metrics", "ORDER BY rowid")})

    @naming_the_file
    def note_command(self, folder: str, argv: Sequence[str]) -> None:
        """Record a command that adds runs to the store, and its working folder, unless the pair is recorded already."""
        with self.writing() as database:
            values = with_checksum((folder, json.dumps(argv)))
            database.execute("INSERT OR IGNORE INTO commands VALUES (?, ?, ?)", values)

    @property
    @naming_the_file
    def commands(self) -> list[tuple[str, list[str]]]:
        """The working folder and the words of each command that added runs, oldest first."""
        return [(row[0], self.read(adapter_of(ARGV), "commands", row, 1)) for row in self.rows("commands", ROWID)]

    @naming_the_file
    def add(self, key: str, root: int, row: Row) -> None:
        """Add a run of a configuration and a root seed.

        A stored run that failed is replaced. A stored run that succeeded only receives the metrics that it lacks.

        Raises:
            StoreError: if another process has registered other code of a metric since this process registered it.
        """
        values = (key, row.replication, str(root), str(row.seed), row.status, None, row.traceback)
        with self.writing() as database:
            for name, code in database.execute("SELECT name, code FROM metrics"):
                if self._codes.get(name, code) != code:
                    raise StoreError(f"{self.path}: another command computes the metric {name} by other code; {HINT}")
            self._add(values, None if row.summary is None else dict(row.summary))
        self.added += 1

    def _add(self, row: tuple[Any, ...], numbers: Mapping[str, Any] | None, *, keeps_failed: bool = False) -> None:
        """Add the row of a run and its metrics; see `add`.

        With `keeps_failed`, a failed run does not replace a stored run that also failed.
        """
        there = list(self.rows("runs", "WHERE configuration = ? AND replication = ? AND root_seed = ?", row[:3]))
        known = self._values(there[0]) if there else None
        if known is None:
            if numbers is not None or not (there and keeps_failed):
                self._put_run(row, numbers)
        elif numbers is not None and not numbers.keys() <= known.keys():
            self._put_run(there[0], {**numbers, **known})

    def _values(self, row: tuple[Any, ...]) -> dict[str, Any] | None:
        """Return the metrics in the row of a run by name, as JSON values; None if the run failed."""
        found: dict[str, Any] | None = self.read(adapter_of(Json[dict[str, Any]] | None), "runs", row, SUMMARY)
        return found

    def _put_run(self, row: tuple[Any, ...], numbers: Mapping[str, Any] | None) -> None:
        """Write the row of a run with the given metrics, in place of the stored row of this run."""
        text = None if numbers is None else json.dumps(to_json(numbers))
        values = with_checksum((*row[:SUMMARY], text, *row[SUMMARY + 1 :]))
        self.database.execute("INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?, ?, ?, ?, ?)", values)

    @naming_the_file
    def runs(self, key: str, root: int) -> list[Row]:
        """Return the runs of a configuration and a root seed, in the order of replications."""
        where, units = "WHERE configuration = ? AND root_seed = ? ORDER BY replication", self.units
        return [self._run(row, units) for row in self.rows("runs", where, (key, str(root)))]

    def _run(self, row: tuple[Any, ...], units: Mapping[str, str]) -> Row:
        """Return the run in a row, given the units of the metrics of the store."""
        _, replication, _, seed, status, numbers, trace = self.read(adapter_of(RUN), "runs", row)
        if (numbers is None) == (status == "ok"):
            raise self.error("runs", row, "should have a summary if its status is ok, and none if not")
        if numbers is None:
            return Row(replication, int(seed), status, None, trace)
        if strange := sorted(numbers.model_fields_set - units.keys()):
            raise self.error("runs", row, f"summary.{strange[0]}: is no metric of this store")
        own = {name: unit for name, unit in units.items() if name not in METRICS}
        return Row(
            replication, int(seed), status, Summary(from_json(numbers.model_dump(exclude_unset=True)), own), trace
        )

    @naming_the_file
    def configurations(self) -> list[tuple[str, dict[str, Any]]]:
        """Return the key and the settings of each configuration, in order."""
        found = self.rows("configurations", "ORDER BY place")
        return [(row[0], self.read(adapter_of(SETTINGS), "configurations", row, 2)) for row in found]

    @naming_the_file
    def __len__(self) -> int:
        """Return the number of runs."""
        return int(self.database.execute("SELECT count(*) FROM runs").fetchone()[0])

    @naming_the_file
    def merge(self, other: "Store") -> None:
        """Add the runs of another store of the same sweep; a run that succeeded there replaces one that failed here.

        A run that succeeded in both has the metrics of both stores.

        Raises:
            StoreError: if the other store belongs to another sweep, or has a metric that other code computed.
        """
        self.record_properties(other.about)
        codes = {name: code for name, _, code in self.rows("metrics")}
        metrics = {name: (unit, code) for name, unit, code in other.rows("metrics", ROWID)}
        for name, (_, code) in metrics.items():
            if codes.get(name, code) != code:
                raise StoreError(f"{self.path}: the metric {name} was computed by other code in {other.path}; {HINT}")
        self.register_metrics(metrics)
        for folder, argv in other.commands:
            self.note_command(folder, argv)
        # Another process may be writing to `other`. It registers a configuration before it adds the first run of it.
        # The runs are therefore read before the configurations, so that no run is read without its configuration.
        runs, configurations = list(other.rows("runs")), list(other.rows("configurations"))
        with self.writing() as database:
            database.executemany(
                "INSERT OR IGNORE INTO configurations VALUES (?, ?, ?, ?, ?)", map(with_checksum, configurations)
            )
            for row in runs:
                self._add(row, other._values(row), keeps_failed=True)


Digits = Annotated[str, Field(pattern="^[0-9]{1,4000}$")]
"""A seed as text: a non-negative integer, short enough for Python's parser."""
SUMMARY = 5
"""The index of the column of `runs` that holds the metrics."""


class _Metrics(BaseModel):
    """The base of `_Numbers`: it accepts metrics that are not built in as further fields."""

    model_config = ConfigDict(strict=True, extra="allow", protected_namespaces=())
    __pydantic_extra__: dict[str, bool | int | float | Literal["Infinity", "-Infinity"] | None]


_FIELDS: dict[str, Any] = {name: (kind | None, None) for name, kind in get_type_hints(Summary).items()}
_Numbers = create_model("Numbers", __base__=_Metrics, **_FIELDS)
"""The model of a summary in JSON; a run that was stored before a metric existed lacks it."""
ARGV = Json[list[str]]
RUN: Any = tuple[str, Annotated[int, Field(ge=0)], Digits, Digits, Status, Json[_Numbers] | None, str]
SETTINGS = Json[dict[str, bool | int | float | str]]
"""The types of the words of a command, of a row of `runs`, and of the settings of a configuration."""


def _differs(name: str, one: Any, other: Any) -> str:
    """Return the end of the error message "was made ...", which tells how two sweeps differ.

    Args:
        name: the property in which they differ.
        one: its value in the store.
        other: its value in the other sweep.
    """
    if name == "format":
        return "by another version of desim"
    if name == "scenario":
        old, new = flat(one), flat(other)
        keys = sorted(key for key in old.keys() | new.keys() if old.get(key) != new.get(key))
        texts = "; ".join(f"{key} was {old.get(key, 'not there')}, is {new.get(key, 'not there')}" for key in keys[:5])
        return f"by another scenario: {texts}"
    was, now = json.dumps(one), json.dumps(other)
    is_source = name.startswith(("the code of ", "the content of "))
    return f"by another {'version' if is_source else 'sweep'}: {name} was {was}, is {now}"


def flat(node: Any, opens: Callable[[Any], bool] = lambda _: True, above: str = "") -> dict[str, Any]:
    """Return the values in nested tables and lists by dotted key.

    A table or list that is empty, or that `opens` rejects, counts as one value.
    """
    if not (isinstance(node, dict | list) and node and opens(node)):
        return {above.removesuffix("."): node}
    inner = node.items() if isinstance(node, dict) else enumerate(node)
    return {key: each for name, value in inner for key, each in flat(value, opens, f"{above}{name}.").items()}
