"""The runs of a sweep as records, as a data frame, and as a CSV or Parquet file."""

import csv
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from desim.analysis.metrics import METRICS
from desim.config.escaping import csv_cell
from desim.config.extras import naming_extras
from desim.config.whole_files import replacing
from desim.study.results.runs import SweepRuns, text
from desim.study.store.run_table import Row

if TYPE_CHECKING:
    import pandas as pd


def records(result: SweepRuns) -> Iterator[dict[str, Any]]:
    """Yield each run as a flat record: settings, replication, seed, status, metrics and error."""
    metric_names = (*METRICS, *result.units)
    for group in result.groups:
        for row in group.rows:
            metrics = dict.fromkeys(metric_names) if row.summary is None else _metric_values(row, metric_names)
            yield {
                **group.settings,
                "replication": row.replication,
                "status": row.status,
                **(metrics | {"seed": row.seed}),  # a metric that a failed run has, too
                "error": row.error,
            }


def data_frame(result: SweepRuns) -> "pd.DataFrame":
    """Return a data frame with a row per run.

    Raises:
        ImportError: if pandas is not installed.
    """
    with naming_extras():
        import pandas as pd
    rows = list(records(result))
    columns = {name: [row[name] for row in rows] for name in _columns(result)}
    return pd.DataFrame({name: pd.Series(*_typed(values)) for name, values in columns.items()})


def write(result: SweepRuns, file: Path) -> None:
    """Write a row per run to a file; see `SweepResult.write`."""
    if file.suffix == ".parquet":
        with replacing(file) as part:
            data_frame(result).to_parquet(part, index=False)
    elif file.suffix == ".csv":
        columns = _columns(result)
        with replacing(file) as part, part.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(map(csv_cell, columns))
            writer.writerows(map(csv_cell, map(record.get, columns)) for record in records(result))
    else:
        raise ValueError(f"{file}: should end in .csv, .parquet, .tex or .md")


def _columns(result: SweepRuns) -> tuple[str, ...]:
    return (*result.keys, "replication", "status", *METRICS, *result.units, "error")


def _metric_values(row: Row, metric_names: Sequence[str]) -> dict[str, Any]:
    """Return metrics of a run by name; a missing metric is None, a dict becomes JSON text."""
    values = {name: row.value(name) for name in metric_names}
    return {name: json.dumps(value) if isinstance(value, dict) else value for name, value in values.items()}


def _typed(values: list[Any]) -> tuple[list[Any], None, str]:
    """Return the arguments of a pandas series for a column, with one type for all values.

    A column of integers remains a column of integers if values are missing, and becomes text if a number does not fit
    in 64 bits. A column of integers and floats becomes a column of floats.
    """
    kinds = {type(value) for value in values} - {type(None)}
    some_missing = None in values
    if kinds == {bool}:
        return values, None, "boolean" if some_missing else "bool"
    if kinds == {int} and all(value is None or abs(value) < 2**63 for value in values):
        return values, None, "Int64" if some_missing else "int64"
    if kinds <= {int, float} and kinds != {int}:
        return values, None, "float64"
    return [value if value is None else text(value) for value in values], None, "str"
