"""The rows of runs in a store: one row per run, whose metrics are JSON.

A row has the metrics that were computed for its run; a metric that was added later is missing in it.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Set
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, Json, create_model

from desim.analysis.metrics import METRICS, Summary
from desim.config.json_numbers import from_json, to_json
from desim.study.store.file import StoreFile, adapter_of
from desim.study.store.run_table import Measured, Row, Status

Digits = Annotated[str, Field(pattern="^[0-9]{1,4000}$")]
"""A seed as text: a non-negative integer, short enough for Python's parser."""
ROOT_SEED, SUMMARY = 2, 5
"""The indices of the columns of `runs` that hold the root seed, and the metrics."""
RUN_VALUES = "(?, ?, ?, ?, ?, ?, ?)"
"""The placeholders of the values of a row of `runs` in SQL."""


class _Metrics(BaseModel):
    """The base of `_Numbers`: it accepts metrics that are not built in as further fields."""

    model_config = ConfigDict(strict=True, extra="allow", protected_namespaces=())
    __pydantic_extra__: dict[str, bool | int | float | Literal["Infinity", "-Infinity"] | None]


_FIELDS: dict[str, Any] = {name: (kind | None, None) for name, kind in get_type_hints(Summary).items()}
_Numbers = create_model("Numbers", __base__=_Metrics, **_FIELDS)
"""The model of a summary in JSON; a run that was stored before a metric existed lacks it."""
RUN: Any = tuple[str, Annotated[int, Field(ge=0)], Digits, Digits, Status, Json[_Numbers] | None, str]
"""The type of a row of `runs`."""
RUN_ADAPTER = adapter_of(RUN)


class RunRows(StoreFile):
    """A store file with the methods that write and read the rows of its table `runs`; see `StoreFile`."""

    def add_run(self, key: str, root: int, row: Row) -> None:
        """Add the run of a configuration (hash) and a root seed; see `desim.study.store.store.Store.add_all`."""
        values = (key, row.replication, str(root), str(row.seed), row.status, None, row.traceback)
        self._add(_with_numbers(values, row.summary), lambda: row.summary)

    def copy_run(self, other: "RunRows", row: tuple[Any, ...]) -> None:
        """Add the row of a run in another store; a failed run does not replace a stored run that also failed."""
        self._add(row, lambda: other.numbers(row), keeps_failed=True)

    def _add(
        self, row: tuple[Any, ...], numbers: Callable[[], Mapping[str, Any] | None], *, keeps_failed: bool = False
    ) -> None:
        """Add the row of a run, with its metrics as JSON; see `add_run` and `copy_run`.

        `numbers` returns these metrics, and is called only if the run is stored already.
        """
        on_conflict = "ON CONFLICT (configuration, replication, root_seed) DO NOTHING"
        if self.database.execute(f"INSERT INTO runs VALUES {RUN_VALUES} {on_conflict}", row).rowcount:
            return
        (stored,) = self.rows("runs", "WHERE configuration = ? AND replication = ? AND root_seed = ?", row[:3])
        old, new = self.numbers(stored), numbers()
        if old is None:  # the stored run failed
            if new is not None or not keeps_failed:
                self.put_run(row, new)
        elif new is not None and not new.keys() <= old.keys():
            self.put_run(stored, {**new, **old})  # only metrics that the stored run lacks are added

    def numbers(self, row: tuple[Any, ...]) -> dict[str, Any] | None:
        """Return the metrics in the row of a run by name, as JSON values; None if the run failed."""
        numbers: dict[str, Any] | None = self.read(adapter_of(Json[dict[str, Any]] | None), "runs", row, SUMMARY)
        return numbers

    def put_run(self, row: tuple[Any, ...], numbers: Mapping[str, Any] | None) -> None:
        """Write the row of a run with the given metrics, in place of the stored row of this run."""
        self.database.execute(f"INSERT OR REPLACE INTO runs VALUES {RUN_VALUES}", _with_numbers(row, numbers))

    def read_runs(self, key: str, root: int, units: Mapping[str, str]) -> Iterator[Row]:
        """Yield the runs of a configuration and a root seed, by replication, given the units of all metrics by name."""
        added = added_units(units)
        for run in self.read_measured(key, root, units):
            if isinstance(run, Measured):
                yield Row(run.replication, run.seed, "ok", Summary(run.values, added), run.traceback)
            else:
                yield run

    def read_measured(self, key: str, root: int, units: Mapping[str, str]) -> Iterator[Row | Measured]:
        """Yield the runs as `read_runs` does; those that did not fail are `Measured`, which is faster than a `Row`."""
        names = frozenset(units)
        for row in self.rows("runs", "WHERE configuration = ? ORDER BY replication", (key,)):
            if row[ROOT_SEED] != str(root):  # a store has one root seed, so the row was edited
                raise self.error("runs", row, f"should have the root seed {root}")
            yield self._run(row, names)

    def _run(self, row: tuple[Any, ...], names: Set[str]) -> Row | Measured:
        """Return the run in a row, given the names of all metrics of the store."""
        _, replication, _, seed, status, numbers, trace = self.read(RUN_ADAPTER, "runs", row)
        if (numbers is None) == (status == "ok"):
            raise self.error("runs", row, "should have a summary if its status is ok, and none if not")
        if numbers is None:
            return Row(replication, int(seed), status, None, trace)
        present = numbers.model_fields_set
        if not present <= names:
            raise self.error("runs", row, f"summary.{min(present - names)}: is no metric of this store")
        # `model_dump` takes 7 us, and only the metrics of users can be infinite.
        values = {**vars(numbers), **from_json(numbers.model_extra)} if numbers.model_extra else vars(numbers)
        if len(values) > len(present):
            values = {name: value for name, value in values.items() if name in present}
        return Measured(replication, int(seed), values, trace)


def added_units(units: Mapping[str, str]) -> dict[str, str]:
    """Return the units of the metrics that are not built in, by name, given the units of all metrics."""
    return {name: unit for name, unit in units.items() if name not in METRICS}


def _with_numbers(row: tuple[Any, ...], numbers: Mapping[str, Any] | None) -> tuple[Any, ...]:
    """Return the row of a run with the given metrics as JSON."""
    text = None if numbers is None else json.dumps(to_json(numbers))
    return *row[:SUMMARY], text, *row[SUMMARY + 1 :]
