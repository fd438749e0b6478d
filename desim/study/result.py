"""The result of a sweep: its runs by configuration, as tables, a data frame and files."""

import csv
import html
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, Self

from desim.analysis.metrics import METRICS, check_numeric, title, words
from desim.analysis.statistics import Estimate, mean, paired, wilson
from desim.analysis.tables import aligned, as_json, with_half_width
from desim.config.html import html_table
from desim.config.json_numbers import json_number
from desim.config.trust import escaped
from desim.study.configurations import in_words, label
from desim.study.store import Row, Store
from desim.study.store_file import StoreError

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

SHOWN = ("active_time", "capture_time", "messages_sent")
"""The metrics that a table shows by default."""
MESSAGING = ("network.", "announce.")
"""The first parts of keys that have an effect only if pursuers need messages."""
NEEDLESS = (
    "; a protocol may need no messages if all know the initial actions (`announce.warm_start`) and see all positions"
    " (`announce.payload`), or if few pursuers could capture the evader in time"
)
Reference = int | Mapping[str, Any] | None
"""The configuration with which others are compared; see `SweepResult.differences`."""


@dataclass(frozen=True)
class Group:
    """The runs of one configuration."""

    settings: Mapping[str, Any]
    """The value of each key of the grid, as shown in tables."""
    rows: tuple[Row, ...]
    """The runs, in the order of replications."""

    def values(self, metric: str) -> list[Any]:
        """Return a metric of each run that did not fail; None for a run without a value."""
        return [row.value(metric) for row in self.rows if row.ok]

    def present(self, metric: str) -> list[Any]:
        """Return a metric of each run that has a value."""
        return [value for value in self.values(metric) if value is not None]

    def in_words(self, without: Sequence[str] = ()) -> str:
        """Return the settings as one line of text, except those of the keys in `without`."""
        return in_words({key: each for key, each in self.settings.items() if key not in without})

    @property
    def failed(self) -> list[Row]:
        """The runs that failed."""
        return [row for row in self.rows if not row.ok]


@dataclass(frozen=True, repr=False)
class SweepResult:
    """The runs of a sweep by configuration."""

    name: str
    keys: tuple[str, ...]
    """The keys of the grid."""
    groups: tuple[Group, ...]
    """The groups in the order of the grid, whose last key changes fastest."""
    common: bool = True
    """Whether run k of every configuration has the same seed."""
    units: Mapping[str, str] = field(default_factory=dict)
    """The unit of each metric of the sweep that is not built in, by name."""

    @classmethod
    def of(
        cls,
        store: Store,
        configurations: Sequence[str] | None = None,
        failed: Mapping[tuple[str, int], Row] = MappingProxyType({}),
    ) -> Self:
        """Return the result of the runs in a store, for all configurations or for those with given hashes.

        The rows of `failed`, by (configuration hash, replication), replace the rows of the same runs in the store.

        Raises:
            StoreError: if the store is empty or damaged.
        """
        if "grid" not in store.about:
            raise StoreError(f"{store.path}: is empty")
        kinds = {"name": str, "grid": list[str], "seeds": str, "root seed": int}
        name, grid, seeds, root = (store.read_property(each, kind) for each, kind in kinds.items())
        settings = dict(store.configurations())
        for key, each in settings.items():
            if each.keys() != set(grid):
                raise StoreError(f"{store.path}: configuration {key}: should have the settings {', '.join(grid)}")
        chosen = settings if configurations is None else configurations
        keys = tuple(next(iter(settings.values()), grid))  # in the order of the last sweep
        groups = tuple(
            Group(
                {each: settings[key][each] for each in keys},
                tuple(failed.get((key, row.replication), row) for row in store.runs(key, root)),
            )
            for key in chosen
        )
        units = {name: unit for name, unit in store.units.items() if name not in METRICS}
        return cls(name, keys, groups, seeds == "common", units)

    @property
    def failed(self) -> list[Row]:
        """The runs that failed, in order."""
        return [row for group in self.groups for row in group.failed]

    def estimates(self, metric: str) -> list[Estimate]:
        """Return the mean of a metric for each configuration, over its runs with a value.

        Raises:
            ValueError: if the sweep has no numeric metric of this name.
        """
        check_numeric(metric, self.units)
        return [mean(group.present(metric)) for group in self.groups]

    def differences(self, metric: str, reference: Reference = None) -> list[Estimate]:
        """Return the mean paired difference of a metric from a reference configuration, over runs with equal seeds.

        Args:
            metric: the name of the metric.
            reference: the position of the reference in `groups`; or the values of some keys, such as
                {"protocol": "sap"}: each configuration is compared with the one that has these values and is otherwise
                equal; see `setting`. None = the first value of the first key that has several values.

        Raises:
            ValueError: if the configurations do not share their seeds, the sweep has no numeric metric of this name, or
                a configuration has no reference.
        """
        check_numeric(metric, self.units)
        if not self.common:
            raise ValueError("runs with independent seeds cannot be paired")
        return [
            paired(*_aligned_values(group, self.groups[other], metric))
            for group, other in zip(self.groups, self.references(reference), strict=True)
        ]

    def references(self, reference: Reference = None) -> list[int]:
        """Return the position in `groups` of the reference of each configuration; see `differences`.

        Raises:
            ValueError: if a configuration has no reference.
        """
        if isinstance(reference, int):
            return [reference] * len(self.groups)
        if reference is None:
            return self._first_references
        if isinstance(reference, str):  # type: ignore[unreachable]
            raise ValueError(f'a reference should be a mapping, such as {{"protocol": "sap"}} (got {reference!r})')
        wanted = {key: self.setting(key, value) for key, value in reference.items()}
        places = {repr(dict(group.settings)): k for k, group in enumerate(self.groups)}
        found = [places.get(repr({**group.settings, **wanted})) for group in self.groups]
        for group, other in zip(self.groups, found, strict=True):
            if other is None:
                raise ValueError(f"{group.in_words()}: has no reference with {in_words(wanted)}")
        return [other for other in found if other is not None]

    def values(self, key: str) -> list[Any]:
        """Return the values of a key of the grid, in the order of the grid.

        Raises:
            ValueError: if the grid has no such key.
        """
        if key not in self.keys:
            near = get_close_matches(key, self.keys, n=1)
            hint = f", did you mean {near[0]}?" if near else f": its keys are {', '.join(self.keys) or 'none'}"
            raise ValueError(f"the grid has no key {key}{hint}")
        return list({repr(group.settings[key]): group.settings[key] for group in self.groups}.values())

    def setting(self, key: str, value: Any) -> Any:
        """Return the value of a key of the grid that a given value selects.

        A value of the key is selected if it equals the given value, has the same text, or is the only one of this kind.
        For example, "cbba" is the text of `CBBA()`, and the kind of `CBBA(schedule=Poisson(rate=5.0))`.

        Raises:
            ValueError: if the grid has no such key, the key does not take the value, or it takes several of this kind.
        """
        there = self.values(key)
        for each in there:
            if each == value or text(each) == label(value):
                return each
        alike = [each for each in there if kind_of(text(each)) == label(value)]
        if len(alike) == 1:
            return alike[0]
        what = "has several values of the kind" if alike else "does not take the value"
        raise ValueError(f"{key} {what} {label(value)}: it takes {', '.join(map(text, there))}")

    @property
    def _compared_by(self) -> str | None:
        """The first key that has several values; None if there is none."""
        return next((key for key in self.keys if len(self.values(key)) > 1), None)

    @property
    def _first_references(self) -> list[int]:
        """The position in `groups` of the default reference of each configuration; see `differences`."""
        return self.first_along(self._compared_by)

    def first_along(self, key: str | None) -> list[int]:
        """Return for each configuration the position in `groups` of the first one that differs at most in `key`."""
        first = dict[str, int]()
        others = (repr({each: value for each, value in group.settings.items() if each != key}) for group in self.groups)
        return [first.setdefault(other, k) for k, other in enumerate(others)]

    def warnings(self, metrics: Sequence[str] = SHOWN) -> list[str]:
        """Return a warning for each key of the grid on which neither `captured` nor any of the given metrics depends.

        Such a key makes no difference, bit for bit, between runs with the same seed and all else equal: with all values
        of the other keys, or with one value of another key, for example one protocol. There is no warning if seeds are
        independent, or if a run failed. `SweepPlan.warnings` returns the warnings that need no runs.
        """
        metrics = [metrics] if isinstance(metrics, str) else metrics
        if self.failed or not self.common:
            return []
        names = ", ".join(("captured", *map(words, metrics)))
        return [
            f"{where}nothing shown ({names}) depends on {key}: equal in {_counted(count, 'pair')} of runs that differ"
            f" in it only{NEEDLESS * key.startswith(MESSAGING)}"
            for key in self.keys
            for where, count in self._without_effect(key, metrics)
        ]

    def _without_effect(self, key: str, metrics: Sequence[str]) -> Iterator[tuple[str, int]]:
        """Yield where a key has no effect, as text, and the number of pairs of runs that differ in it only."""
        firsts = zip(self.groups, self.first_along(key), strict=True)
        pairs = [(group, _pairs(self.groups[first], group)) for k, (group, first) in enumerate(firsts) if k != first]
        if count := _equal(pairs, metrics):
            yield "", count
            return
        for other in self.keys:
            values = dict.fromkeys(text(group.settings[other]) for group, _ in pairs) if other != key else {}
            for value in values if len(values) > 1 else ():
                if count := _equal([each for each in pairs if text(each[0].settings[other]) == value], metrics):
                    yield f"with {other} = {value}, ", count

    def plot(self, y: str = SHOWN[0], *, kind: Literal["means", "phase"] = "means", **options: Any) -> "Figure":
        """Return a figure of a metric; needs matplotlib (the extra `plot`).

        The figure can be resized, `figure.set_size_inches(3.5, 2.5)`, and written with `figure.savefig(file)`.

            swept.plot("active_time", x="network.latency.value", by="protocol", labels={"sap": "SAP (ours)"})
            swept.plot("active_time", against={"protocol": "sap"}, size="8.5cm")

        Args:
            y: the name of the metric.
            kind: means: the mean by configuration, or the paired difference from a reference, over a key; phase: the
                mean over two keys as a heat map.
            options: for means, the options of `desim.study.figures.means`: x, by, against, labels, xlabel, ylabel,
                size; phase has none.

        Raises:
            ValueError: if the sweep has no such metric, key or value.
            TypeError: if an option does not exist.
        """
        from desim.study import figures

        draw = {"means": figures.means, "phase": figures.phase}
        if kind not in draw:
            raise ValueError(f"kind should be means or phase, got {kind!r}")
        return draw[kind](self, y, **options)

    def table(self, metrics: Sequence[str] = SHOWN) -> str:
        """Return the means with half widths, then the differences along the first key with several values, as text."""
        parts = [f"{title}\n{aligned(rows, len(self.keys))}" for title, rows in self.tables(metrics)]
        notes = [*self._failures(), *(f"warning: {each}" for each in self.warnings(metrics))]
        return "\n\n".join([*parts, *notes])

    def tables(self, metrics: Sequence[str] = SHOWN) -> list[tuple[str, list[tuple[str, ...]]]]:
        """Return each table as its title and rows of text; the first row is the header."""
        metrics = [metrics] if isinstance(metrics, str) else metrics
        return [(self._head(metrics), self._mean_rows(metrics)), *self._difference_tables(metrics)]

    def __str__(self) -> str:
        return self.table()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self._head(()).partition(';')[0]}, over {', '.join(self.keys)}>"

    def _repr_html_(self) -> str:
        """Return the tables as HTML, for notebooks."""
        parts = [html_table(title, rows) for title, rows in self.tables()]
        notes = [*self._failures(), *(f"warning: {each}" for each in self.warnings())]
        return "".join([*parts, *(f"<p>{html.escape(each)}</p>" for each in notes)])

    def _head(self, metrics: Sequence[str]) -> str:
        runs = sum(len(group.rows) for group in self.groups)
        found = [group.values(metric) for group in self.groups for metric in metrics]
        some_lack = any(0 < values.count(None) < len(values) for values in found)
        return (
            f"{self.name}: {_counted(len(self.groups), 'configuration')}, {_counted(runs, 'run')}; +- is half a 95 % t"
            f" interval, in brackets a Wilson interval{'; (n): defined in n runs only' if some_lack else ''}"
        )

    def _difference_tables(self, metrics: Sequence[str]) -> Iterator[tuple[str, list[tuple[str, ...]]]]:
        """Yield the title and the rows of the table of differences, if configurations can be compared."""
        key = self._compared_by
        if self.common and key is not None:
            first = f"{key} = {text(self.groups[0].settings[key])}" + ", all else equal" * (len(self.keys) > 1)
            yield f"difference from {first}, run by run with the same seed", self._difference_rows(metrics)

    def _failures(self) -> Iterator[str]:
        for group in self.groups:
            if group.failed:
                first = f"{group.in_words()}, seed {group.failed[0].seed}: {group.failed[0].error}"
                yield f"{_counted(len(self.failed), 'run')} failed; the first, with {first}"
                return

    def _mean_rows(self, metrics: Sequence[str]) -> list[tuple[str, ...]]:
        """Return rows of text: settings, number of runs, share with a capture, and the mean of each metric."""
        titles = (title(name, self.units) for name in metrics)
        failed = ("failed",) if self.failed else ()
        rows: list[tuple[str, ...]] = [(*self.keys, "runs", *failed, "captured", *titles)]
        found = [self.estimates(metric) for metric in metrics]
        for k, group in enumerate(self.groups):
            captured = group.present("captured")
            share = _share(captured) if captured else "-"
            counts = (str(len(group.rows)), *([str(len(group.failed))] if self.failed else []))
            means = (with_half_width(each[k], len(group.rows) - len(group.failed)) for each in found)
            rows.append((*map(text, group.settings.values()), *counts, share, *means))
        return rows

    def _difference_rows(self, metrics: Sequence[str]) -> list[tuple[str, ...]]:
        found = [self.differences(metric) for metric in metrics]
        rows: list[tuple[str, ...]] = [(*self.keys, "pairs", *map(words, metrics))]
        for k, (group, other) in enumerate(zip(self.groups, self.references(), strict=True)):
            if k == other:
                continue
            pairs = len(_pairs(group, self.groups[other]))
            means = (with_half_width(each[k], pairs, sign="+") for each in found)
            rows.append((*map(text, group.settings.values()), str(pairs), *means))
        return rows

    @property
    def _measured(self) -> tuple[str, ...]:
        """The names of the metrics."""
        return (*METRICS, *self.units)

    @property
    def _columns(self) -> tuple[str, ...]:
        return (*self.keys, "replication", "status", *self._measured, "error")

    def records(self) -> Iterator[dict[str, Any]]:
        """Yield each run as a flat record: settings, replication, seed, status, metrics and error."""
        measured = self._measured
        for group in self.groups:
            for row in group.rows:
                metrics = dict.fromkeys(measured) if row.summary is None else _metric_values(row, measured)
                yield {
                    **group.settings,
                    "replication": row.replication,
                    "status": row.status,
                    **(metrics | {"seed": row.seed}),
                    "error": row.error,
                }

    def document(self, metrics: Sequence[str] = SHOWN) -> dict[str, Any]:
        """Return means, half widths and paired differences as JSON-compatible values; None where undefined."""
        means = {metric: self.estimates(metric) for metric in metrics}
        differences = {metric: self.differences(metric) for metric in metrics} if self.common else {}
        configurations = []
        for k, group in enumerate(self.groups):
            captured = group.present("captured")
            configurations.append(
                {
                    "settings": {key: json_number(value) for key, value in group.settings.items()},
                    "runs": len(group.rows),
                    "failed": len(group.failed),
                    "captured": {
                        "share": sum(captured) / len(captured) if captured else None,
                        "interval": wilson(sum(captured), len(captured)) if captured else None,
                    },
                    "metrics": {metric: as_json(found[k]) for metric, found in means.items()},
                    "difference": {metric: as_json(found[k]) for metric, found in differences.items()},
                }
            )
        about = {"name": self.name, "grid": self.keys, "warnings": self.warnings(metrics)}
        return about | {"configurations": configurations}

    def to_frame(self) -> "pd.DataFrame":
        """Return a data frame with a row per run (needs the extra `frame`); see `records`.

        Raises:
            ImportError: if pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError as error:
            missing = "pandas is missing: pip install 'pursuit-desim[frame]', or in a clone '.[frame]'"
            raise ImportError(missing) from error
        records = list(self.records())
        columns = {name: [record[name] for record in records] for name in self._columns}
        return pd.DataFrame({name: pd.Series(*_typed(values)) for name, values in columns.items()})

    def write(self, file: str | Path) -> None:
        """Write a row per run to a file: .csv, or .parquet (needs the extra `frame`).

        In CSV, control characters of texts are escaped, and a text that a spreadsheet would read as a formula is
        prefixed with an apostrophe.

        Raises:
            ValueError: if the file has another suffix.
            ImportError: if a package for Parquet is not installed.
            OSError: if the file cannot be written.
        """
        file = Path(file)
        if file.suffix == ".parquet":
            self.to_frame().to_parquet(file, index=False)
        elif file.suffix == ".csv":
            with file.open("w", encoding="utf-8", newline="") as stream:
                writer = csv.writer(stream, lineterminator="\n")
                writer.writerow(map(_cell, self._columns))
                writer.writerows(map(_cell, map(record.get, self._columns)) for record in self.records())
        else:
            raise ValueError(f"{file}: should end in .csv or .parquet")


def _cell(value: Any) -> Any:
    """Return a value as a cell of a CSV file that is safe in spreadsheets and terminals; numbers are unchanged.

    A text that begins with = + - @, a tab or a line break is prefixed with an apostrophe (see OWASP, "CSV Injection").
    """
    if not isinstance(value, str):
        return value
    shown = escaped(value)
    return f"'{shown}" if shown.startswith(("=", "+", "-", "@", "\t", "\n")) else shown


def _metric_values(row: Row, measured: Sequence[str]) -> dict[str, Any]:
    """Return metrics of a run by name; a missing metric is None, a dict becomes JSON text."""
    values = {name: row.value(name) for name in measured}
    return {name: json.dumps(each) if isinstance(each, dict) else each for name, each in values.items()}


def _pairs(one: Group, other: Group) -> list[tuple[Row, Row]]:
    """Return the pairs of runs of two configurations that have the same seed and did not fail."""
    there = {row.replication: row for row in other.rows if row.ok}
    return [(row, there[row.replication]) for row in one.rows if row.ok and row.replication in there]


def _equal(pairs: Sequence[tuple[Group, list[tuple[Row, Row]]]], metrics: Sequence[str]) -> int:
    """Return the number of pairs of runs; 0 if the runs of any pair differ in `captured` or one of the metrics."""
    inner = [pair for _, each in pairs for pair in each]
    same = all(one.value(name) == other.value(name) for one, other in inner for name in ("captured", *metrics))
    return len(inner) if same else 0


def _aligned_values(one: Group, other: Group, metric: str) -> tuple[list[Any], list[Any]]:
    pairs = _pairs(one, other)
    return [a.value(metric) for a, _ in pairs], [b.value(metric) for _, b in pairs]


def _share(captured: Sequence[bool]) -> str:
    """Return the share of runs with a capture and its 95 % Wilson interval, as text in %."""
    low, high = wilson(sum(captured), len(captured))
    return f"{sum(captured) / len(captured):.1%} ({low:.1%} .. {high:.1%})"


def text(value: Any) -> str:
    """Return a setting as text."""
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)


def kind_of(value: str) -> str:
    """Return the kind of a model that is given as text; for example, the kind of "sap(tau=...)" is "sap"."""
    return value.partition("(")[0]


def _counted(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def _typed(values: list[Any]) -> tuple[list[Any], None, str]:
    """Return the arguments of a pandas series for a column, with one type for all values; integers stay integers."""
    kinds = {type(each) for each in values} - {type(None)}
    some_missing = None in values
    if kinds == {bool}:
        return values, None, "boolean" if some_missing else "bool"
    if kinds == {int} and all(each is None or abs(each) < 2**63 for each in values):
        return values, None, "Int64" if some_missing else "int64"
    if kinds <= {int, float} and kinds != {int}:
        return values, None, "float64"
    return [each if each is None else text(each) for each in values], None, "str"
