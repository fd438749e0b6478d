"""What came of a sweep: its runs by configuration, as a table to read, a frame to compute with, and files."""

import csv
import html
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from desim.analysis.metrics import METRICS, words
from desim.analysis.statistics import Estimate, estimate, paired, wilson
from desim.analysis.tables import aligned, number
from desim.study.store import Row, Store, StoreError

if TYPE_CHECKING:
    import pandas as pd

SHOWN = ("active_time", "capture_time", "messages_sent")
"""The metrics that a table shows if none are named."""


@dataclass(frozen=True)
class Group:
    """The runs of one configuration."""

    settings: Mapping[str, Any]
    """The value of each key of the grid, as tables have it."""
    rows: tuple[Row, ...]
    """In the order of replications."""

    def values(self, metric: str) -> list[Any]:
        """Return a metric of each run that did not fail; None where it does not exist."""
        return [getattr(row.summary, metric) for row in self.rows if row.summary is not None]

    @property
    def failed(self) -> list[Row]:
        """The runs that failed."""
        return [row for row in self.rows if not row.ok]


@dataclass(frozen=True)
class SweepResult:
    """The runs of a sweep by configuration."""

    name: str
    keys: tuple[str, ...]
    """Of the grid."""
    groups: tuple[Group, ...]
    """In the order of the grid, its last key changing fastest."""
    common: bool = True
    """Whether run k of every configuration has the same seed."""

    @classmethod
    def of(cls, store: Store, configurations: Sequence[str] | None = None) -> Self:
        """Return what a store has of all configurations, or of those of some keys.

        Raises:
            StoreError: if it was never used.
        """
        if "grid" not in store.about:
            raise StoreError(f"{store.path}: is empty")
        name, keys, seeds, root = (json.loads(store.about[each]) for each in ("name", "grid", "seeds", "root seed"))
        settings = dict(store.configurations())
        chosen = settings if configurations is None else configurations
        groups = tuple(Group(settings[key], tuple(store.runs(key, root))) for key in chosen)
        return cls(name, tuple(keys), groups, seeds == "common")

    @property
    def failed(self) -> list[Row]:
        """The runs that failed, in order."""
        return [row for group in self.groups for row in group.failed]

    def estimates(self, metric: str) -> list[Estimate]:
        """Return the mean of a metric over the runs of each configuration in which it exists."""
        return [_mean([value for value in group.values(metric) if value is not None]) for group in self.groups]

    def differences(self, metric: str, reference: int = 0) -> list[Estimate]:
        """Return how much greater a metric is than in the configuration at a position, run by run with equal seeds.

        Raises:
            ValueError: if configurations do not share their seeds.
        """
        if not self.common:
            raise ValueError("runs with independent seeds are no pairs")
        return [paired(*_aligned_values(group, self.groups[reference], metric)) for group in self.groups]

    def table(self, metrics: Sequence[str] = SHOWN) -> str:
        """Return means and half widths, and below them the differences from the first configuration, as text."""
        runs = sum(len(group.rows) for group in self.groups)
        head = f"{self.name}: {len(self.groups)} configurations, {runs} runs; +- is half a 95 % t interval"
        parts = [f"{head}, captured with Wilson's\n{aligned(self._means(metrics), len(self.keys))}"]
        if self.common and len(self.groups) > 1:
            first = ", ".join(f"{key} = {text(each)}" for key, each in self.groups[0].settings.items())
            parts.append(
                f"less that with {first}, in runs of the same seed\n{aligned(self._gaps(metrics), len(self.keys))}"
            )
        parts += [f"{len(self.failed)} runs failed; the first: {self.failed[0].error}"] if self.failed else []
        return "\n\n".join(parts)

    def _repr_html_(self) -> str:
        """Return the means as a table of a notebook."""
        head, *rows = self._means(SHOWN)
        lines = [_html_row(head, "th"), *(_html_row(row, "td") for row in rows)]
        note = f"{html.escape(self.name)}; &plusmn; is half a 95&nbsp;% t interval"
        return f"<table><caption>{note}</caption>{''.join(lines)}</table>"

    def _means(self, metrics: Sequence[str]) -> list[tuple[str, ...]]:
        """Return rows of text: settings, number of runs, share that captured, and the mean of each metric."""
        titles = (f"{words(name)}{f', {METRICS[name].unit}' if METRICS[name].unit else ''}" for name in metrics)
        failed = ("failed",) if self.failed else ()
        rows: list[tuple[str, ...]] = [(*self.keys, "runs", *failed, "captured", *titles)]
        found = [self.estimates(metric) for metric in metrics]
        for k, group in enumerate(self.groups):
            captured = group.values("captured")
            share = _share(captured) if captured else "-"
            lost = (str(len(group.failed)),) if self.failed else ()
            counts = (str(len(group.rows)), *lost)
            means = (_cell(each[k], len(captured)) for each in found)
            rows.append((*map(text, group.settings.values()), *counts, share, *means))
        return rows

    def _gaps(self, metrics: Sequence[str]) -> list[tuple[str, ...]]:
        found = [self.differences(metric) for metric in metrics]
        rows: list[tuple[str, ...]] = [(*self.keys, "pairs", *map(words, metrics))]
        for k, group in list(enumerate(self.groups))[1:]:
            pairs = len(_shared(group, self.groups[0]))
            means = (_cell(each[k], pairs, sign="+") for each in found)
            rows.append((*map(text, group.settings.values()), str(pairs), *means))
        return rows

    def records(self) -> Iterator[dict[str, Any]]:
        """Yield each run as a flat record: settings, replication, seed, status, metrics, and what it raised."""
        for group in self.groups:
            for row in group.rows:
                numbers = dict.fromkeys(METRICS) if row.summary is None else _numbers(row)
                yield {
                    **group.settings,
                    "replication": row.replication,
                    "status": row.status,
                    **(numbers | {"seed": row.seed}),
                    "error": row.error,
                }

    def document(self, metrics: Sequence[str] = SHOWN) -> dict[str, Any]:
        """Return means, half widths and paired differences as JSON has them; null where there is none."""
        means = {metric: self.estimates(metric) for metric in metrics}
        gaps = {metric: self.differences(metric) for metric in metrics} if self.common else {}
        configurations = []
        for k, group in enumerate(self.groups):
            captured = group.values("captured")
            configurations.append(
                {
                    "settings": {key: _finite(value) for key, value in group.settings.items()},
                    "runs": len(group.rows),
                    "failed": len(group.failed),
                    "captured": {
                        "share": sum(captured) / len(captured) if captured else None,
                        "interval": wilson(sum(captured), len(captured)) if captured else None,
                    },
                    "metrics": {metric: _plain(found[k]) for metric, found in means.items()},
                    "less_the_first": {metric: _plain(found[k]) for metric, found in gaps.items()},
                }
            )
        return {"name": self.name, "grid": self.keys, "configurations": configurations}

    def to_frame(self) -> "pd.DataFrame":
        """Return a row per run (the extra `frame`); see `records`.

        Raises:
            ImportError: if pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError as error:
            raise ImportError("pandas is missing: pip install 'pursuit-desim[frame]'") from error
        frame = pd.DataFrame(list(self.records()))
        for name, metric in METRICS.items():
            if metric.is_number and name in frame and frame[name].isna().all():
                frame[name] = frame[name].astype(float)  # or what nobody measured would be no number
        return frame

    def write(self, file: Path) -> None:
        """Write a row per run to a file: .csv, or .parquet (the extra `frame`).

        Raises:
            ValueError: if it is named otherwise.
            ImportError: if what Parquet needs is not installed.
            OSError: if it cannot be written.
        """
        if file.suffix == ".parquet":
            self.to_frame().to_parquet(file, index=False)
        elif file.suffix == ".csv":
            with file.open("w", encoding="utf-8", newline="") as stream:
                writer: csv.DictWriter[str] | None = None
                for record in self.records():
                    if writer is None:
                        writer = csv.DictWriter(stream, record, lineterminator="\n")
                        writer.writeheader()
                    writer.writerow(record)
        else:
            raise ValueError(f"{file}: should end in .csv or .parquet")


def _numbers(row: Row) -> dict[str, Any]:
    numbers = {name: getattr(row.summary, name) for name in METRICS}
    return {name: json.dumps(each) if isinstance(each, dict) else each for name, each in numbers.items()}


def _plain(found: Estimate) -> dict[str, Any]:
    return {"mean": _finite(found.mean), "half_width": _finite(found.half_width), "runs": found.count}


def _finite(value: Any) -> Any:
    """Return what JSON has for a number: null for none, "Infinity" for that."""
    if not isinstance(value, float) or isfinite(value):
        return value
    return None if isnan(value) else str(value).replace("inf", "Infinity")


def _mean(values: Sequence[float]) -> Estimate:
    return estimate(values) if values else Estimate(float("nan"), float("nan"), 0)


def _shared(one: Group, other: Group) -> list[tuple[Row, Row]]:
    """Return the runs of two configurations that have the same seed and did not fail."""
    there = {row.replication: row for row in other.rows if row.ok}
    return [(row, there[row.replication]) for row in one.rows if row.ok and row.replication in there]


def _aligned_values(one: Group, other: Group, metric: str) -> tuple[list[Any], list[Any]]:
    pairs = _shared(one, other)
    return [getattr(a.summary, metric) for a, _ in pairs], [getattr(b.summary, metric) for _, b in pairs]


def _share(captured: Sequence[bool]) -> str:
    """Return the share of runs with a capture and its interval, in %."""
    low, high = wilson(sum(captured), len(captured))
    return f"{sum(captured) / len(captured):.1%} ({low:.1%} .. {high:.1%})"


def _cell(found: Estimate, runs: int, sign: str = "") -> str:
    """Return a mean and its half width as text, with the number of runs if they are not all."""
    if not found.count:
        return "-"
    digits = 3 if abs(found.mean) < 100.0 else 1
    few = f" ({found.count})" if found.count != runs else ""
    return f"{found.mean:{sign},.{digits}f} +- {number(found.half_width, digits)}{few}"


def text(value: Any) -> str:
    """Return a setting as it is read."""
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)


def _html_row(cells: Sequence[str], tag: str) -> str:
    inner = "".join(f"<{tag}>{html.escape(cell).replace('+-', '&plusmn;')}</{tag}>" for cell in cells)
    return f"<tr>{inner}</tr>"
