"""The store of a sweep: a SQLite file with a row per run, written by the process that dispatches the runs.

Committed rows survive if this process is killed. A row is identified by its configuration, its replication and its root
seed, from which the seeds of all runs of a sweep are derived. A run that is in the store is repeated only if it failed
or lacks a metric. `SELECT * FROM results` has a column per metric.

A row has the metrics that were computed for its run. The store records a hash of the code of each metric. A metric that
is added later is missing in earlier rows, until a command that needs it repeats their runs. If the code of a metric
changes, its values are removed when the new code is registered.
"""

import json
import sqlite3
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import Json

from desim.kernel.core.clock import RARE_COLLECTION
from desim.study.plan.configurations import Configuration
from desim.study.store.file import FORMAT, HINT, ROWID, StoreError, adapter_of, naming_the_file, view_of
from desim.study.store.properties import SweepProperties
from desim.study.store.run_rows import RunRows, added_units
from desim.study.store.run_table import Row, RunTable


class Store(SweepProperties, RunRows):
    """The runs of one sweep, of a shard of it (one of several parts that are run separately), or of merged shards.

    For the arguments see `StoreFile`.

    Attributes:
        added: number of runs added since the store was opened, with repeated runs, but without merged ones.

    Raises:
        StoreError: if the file cannot be opened, is not a store, has another version, or is damaged.
    """

    def __init__(self, path: str | PathLike[str] | None = None, *, read_only: bool = False):
        super().__init__(path, read_only=read_only)
        self.added = 0
        self._codes: dict[str, str] = {}
        try:
            (self.check_same if read_only else self.record_properties)({"format": FORMAT})
        except BaseException:
            self.close()
            raise

    @naming_the_file
    def register(self, configurations: Sequence[Configuration]) -> None:
        """Add or replace configurations, in the given order and before all others in the store."""
        new = {one.key: (json.dumps(one.columns), one.scenario.model_dump_json()) for one in configurations}
        with self.writing() as database:
            stored = {key: tuple(columns) for key, _, *columns in self.rows("configurations", "ORDER BY place")}
            remaining = {key: columns for key, columns in stored.items() if key not in new}
            rows = ((key, place, *columns) for place, (key, columns) in enumerate((new | remaining).items()))
            database.executemany("INSERT OR REPLACE INTO configurations VALUES (?, ?, ?, ?)", rows)

    @naming_the_file
    def register_metrics(self, metrics: Mapping[str, tuple[str, str]]) -> None:
        """Record the unit and the hash of the code of metrics; values that other code computed are removed."""
        with self.writing() as database:
            stored = {name: (unit, code) for name, unit, code in self.rows("metrics")}
            changed = {name: code for name, code in metrics.items() if stored.get(name) != code}
            outdated = {name for name, (_, code) in changed.items() if name in stored and stored[name][1] != code}
            for row in list(self.rows("runs")) if outdated else ():
                if (numbers := self.numbers(row)) is not None:
                    self.put_run(row, {name: number for name, number in numbers.items() if name not in outdated})
            database.executemany(
                "INSERT INTO metrics VALUES (?, ?, ?) ON CONFLICT (name) DO UPDATE SET unit = excluded.unit,"
                " code = excluded.code",
                [(name, *code) for name, code in changed.items()],
            )
            if not changed.keys() <= stored.keys():
                database.execute("DROP VIEW results")
                database.execute(view_of(tuple(stored | changed)))
        self._codes |= {name: code for name, (_, code) in metrics.items()}

    @property
    @naming_the_file
    def units(self) -> Mapping[str, str]:
        """The unit of each metric that runs of the store may have, by name."""
        return MappingProxyType({name: unit for name, unit, _ in self.rows("metrics", ROWID)})

    @naming_the_file
    def note_command(self, folder: str, argv: Sequence[str]) -> None:
        """Record a command that adds runs to the store, and its working folder, unless the pair is recorded already."""
        with self.writing() as database:
            database.execute("INSERT OR IGNORE INTO commands VALUES (?, ?)", (folder, json.dumps(argv)))

    @property
    @naming_the_file
    def commands(self) -> list[tuple[str, list[str]]]:
        """The working folder and the words of each command that added runs, oldest first."""
        return [
            (row[0], self.read(adapter_of(Json[list[str]]), "commands", row, 1)) for row in self.rows("commands", ROWID)
        ]

    def add(self, key: str, root: int, row: Row) -> None:
        """Add a run; see `add_all`."""
        self.add_all(root, [(key, row)])

    @naming_the_file
    def add_all(self, root: int, runs: Sequence[tuple[str, Row]]) -> None:
        """Add runs of a root seed, each with the hash of its configuration.

        A stored run that failed is replaced. A stored run that succeeded only receives the metrics that it lacks. If
        the disk is full, the runs before the first that does not fit are stored.

        Raises:
            StoreError: if another process has registered different code for a metric since this process registered it.
        """
        # 12 runs in one transaction take 0.1 ms each, and 0.26 ms in transactions of their own.
        try:
            self._add_together(root, runs)
        except sqlite3.Error:
            if len(runs) == 1:
                raise
            for run in runs:
                self.add_all(root, [run])
        else:
            self.added += len(runs)

    def _add_together(self, root: int, runs: Sequence[tuple[str, Row]]) -> None:
        """Add all of some runs, or none if this fails."""
        with self.writing() as database:
            for name, code in database.execute("SELECT name, code FROM metrics"):
                if self._codes.get(name, code) != code:
                    raise StoreError(f"{self.path}: another command computes the metric {name} by other code; {HINT}")
            for key, row in runs:
                self.add_run(key, root, row)

    @naming_the_file
    def runs(self, key: str, root: int) -> list[Row]:
        """Return the runs of a configuration and a root seed, in the order of replications."""
        return list(self.read_runs(key, root, self.units))

    @naming_the_file
    def run_table(self, key: str, root: int, others: Mapping[tuple[str, int], Row] = MappingProxyType({})) -> RunTable:
        """Return the runs of a configuration and a root seed as a table, which needs less memory than a list.

        The rows of `others`, by (configuration hash, replication), replace the rows of the same runs.
        """
        units = self.units
        runs = self.read_measured(key, root, units)
        with RARE_COLLECTION:  # a third faster: the collector looks through all runs until they are columns
            return RunTable((others.get((key, run.replication), run) for run in runs), added_units(units))

    @naming_the_file
    def configurations(self) -> list[tuple[str, dict[str, Any]]]:
        """Return the key and the settings of each configuration, in order."""
        rows = self.rows("configurations", "ORDER BY place")
        settings = adapter_of(Json[dict[str, bool | int | float | str]])
        return [(row[0], self.read(settings, "configurations", row, 2)) for row in rows]

    @property
    @naming_the_file
    def keys(self) -> list[str]:
        """The hashes of the configurations, in order: those of the last sweep that was registered are the first."""
        return [key for (key,) in self.database.execute("SELECT configuration FROM configurations ORDER BY place")]

    @property
    @naming_the_file
    def failed_runs(self) -> int:
        """The number of runs that failed."""
        return int(self.database.execute("SELECT count(*) FROM runs WHERE status != 'ok'").fetchone()[0])

    @naming_the_file
    def outcomes(self) -> tuple[frozenset[tuple[str, int]], frozenset[tuple[str, int]]]:
        """Return the runs that succeeded and those that failed, as pairs (hash of the configuration, replication)."""
        rows = self.database.execute("SELECT configuration, replication, status = 'ok' FROM runs").fetchall()
        done, failed = (frozenset((key, k) for key, k, is_ok in rows if is_ok == ok) for ok in (1, 0))
        return done, failed

    @naming_the_file
    def __len__(self) -> int:
        """Return the number of runs."""
        return int(self.database.execute("SELECT count(*) FROM runs").fetchone()[0])

    @naming_the_file
    def count(self, configurations: int, reps: int | None) -> int:
        """Return how many runs the first `configurations` have, with replications below `reps`; None: with any."""
        first = "SELECT configuration FROM configurations ORDER BY place LIMIT ?"
        query = f"SELECT count(*) FROM runs WHERE configuration IN ({first}) AND (? IS NULL OR replication < ?)"
        return int(self.database.execute(query, (configurations, reps, reps)).fetchone()[0])

    @naming_the_file
    def merge(self, other: "Store", *, mix_versions: bool = False) -> None:
        """Add the runs of another store of the same sweep; a run that succeeded there replaces a failed one here.

        A run that succeeded in both has the metrics of both stores.

        Raises:
            StoreError: if the other store belongs to another sweep, or computed a metric by different code; or if
                another Python or other packages computed its runs, unless `mix_versions` is set.
        """
        if isinstance(self.path, Path) and isinstance(other.path, Path) and self.path.samefile(other.path):
            return  # nothing to add; with a rollback journal, a file that is being read cannot be written
        self.check_same(other.about)
        self.check_versions(other.versions, f"{other.path} has those of", mix=mix_versions)
        codes = {name: code for name, _, code in self.rows("metrics")}
        metrics = {name: (unit, code) for name, unit, code in other.rows("metrics", ROWID)}
        for name, (_, code) in metrics.items():
            if codes.get(name, code) != code:
                raise StoreError(f"{self.path}: the metric {name} was computed by other code in {other.path}; {HINT}")
        self.record_properties(other.about)
        self.record_versions(other.versions, f"{other.path} has those of", mix=mix_versions)
        self.register_metrics(metrics)
        for folder, argv in other.commands:
            self.note_command(folder, argv)
        # Another process may be writing to `other`. In one transaction no run is read without its configuration.
        with other.reading(), self.writing() as database:
            database.executemany(
                "INSERT OR IGNORE INTO configurations VALUES (?, ?, ?, ?)", other.rows("configurations")
            )
            for row in other.rows("runs"):
                self.copy_run(other, row)
