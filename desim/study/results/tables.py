"""The result of a sweep as tables of text, and as JSON: means by configuration, and paired differences."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from desim.analysis.metrics import title, unit_of, words
from desim.analysis.statistics import wilson
from desim.analysis.table_formats import Table
from desim.analysis.tables import as_json, digits_of, percent, with_half_width
from desim.config.arrays import Floats
from desim.config.errors import ArgumentError
from desim.config.json_numbers import json_number
from desim.config.number_texts import counted
from desim.study.plan.configurations import in_words
from desim.study.results.runs import CAPTURE_TIMES, SweepRuns, labels_of_values, text


def tables(result: SweepRuns, metrics: Sequence[str], against: Mapping[str, Any] | None = None) -> Iterator[Table]:
    """Yield the table of means and, if seeds are common and a key has several values, the table of differences.

    Seeds are common if run k of every configuration has the same seed. The differences are from the configurations with
    the values `against`, all else equal; None: with the first value of the first key that has several.

    Raises:
        ValueError: if `against` is given, and a configuration has no reference, or seeds are not common.
    """
    yield heading(result, metrics), _mean_rows(result, metrics)
    key = result.compared_by
    if against:
        rows = _difference_rows(result, metrics, against)
        yield f"difference from {in_words(against)}, all else equal, run by run with the same seed", rows
    elif result.common and key is not None:
        reference = f"{key} = {text(result.groups[0].settings[key])}" + ", all else equal" * (len(result.keys) > 1)
        yield f"difference from {reference}, run by run with the same seed", _difference_rows(result, metrics)


def relabelled(
    result: SweepRuns,
    tables: Iterable[Table],
    metrics: Sequence[str],
    labels: Mapping[str, str],
    without: Sequence[str] = (),
) -> list[Table]:
    """Return tables with labels in place of keys, values, metrics and other heads of columns, without some columns.

    Args:
        result: the result of a sweep.
        tables: its tables.
        metrics: the metrics in them.
        labels: texts by key, value, kind of a value, name of a metric, or head of a column ("runs", "captured").
        without: the heads of columns that are left out.

    Raises:
        ValueError: if a label or a column to be left out belongs to nothing in the tables.
    """
    all_tables = list(tables)
    heads = {cell for _, rows in all_tables for cell in rows[0]}
    label_of = labels_of_values(result, labels, {*heads, *metrics})
    for metric in metrics:
        if metric in label_of:
            label_of |= dict.fromkeys((title(metric, result.units), words(metric)), label_of[metric])
    if unknown := [name for name in without if name not in heads]:
        raise ArgumentError("without", f": no table has a column {unknown[0]}: they have {', '.join(sorted(heads))}")
    keys = len(result.keys)
    results: list[Table] = []
    for name, (head, *rows) in all_tables:
        columns = [k for k, cell in enumerate(head) if cell not in without]
        body = [[label_of.get(row[k], row[k]) if k < keys else row[k] for k in columns] for row in rows]
        results.append((name, [tuple(label_of.get(head[k], head[k]) for k in columns), *map(tuple, body)]))
    return results


def heading(result: SweepRuns, metrics: Sequence[str]) -> str:
    """Return the title of the table of means."""
    runs = sum(len(group.rows) for group in result.groups)
    lacking = (np.isnan(group.numbers(metric)) for group in result.groups for metric in metrics)
    some_lack = any(0 < np.count_nonzero(lacks) < len(lacks) for lacks in lacking)
    return (
        f"{result.name}: {counted(len(result.groups), 'configuration')}, {counted(runs, 'run')}; +- is half a 95 % t"
        f" interval, in brackets a Wilson interval{'; (n): defined in n runs only' if some_lack else ''}"
    )


def notes(result: SweepRuns, metrics: Sequence[str]) -> Iterator[str]:
    """Yield the notes below the tables.

    They say what pursuers know at the start, whether the means are over different seeds, how many runs failed, and of
    what the sweep warns.
    """
    if result.start_rule is not None:
        yield result.start_rule
    counts = [len(group.rows) - len(group.failed) for group in result.groups]
    if result.common and len(set(counts)) > 1:
        yield (
            f"the means are over {min(counts)} to {max(counts)} runs, and so over different seeds: compare"
            " configurations by their differences, which are over the seeds that both have"
        )
    for metric in metrics:
        shares = [
            len(group.present(metric)) / len(values) for group in result.groups if len(values := group.numbers(metric))
        ]
        if shares and min(shares) < max(shares):
            hint = ": end time counts the horizon" if metric in CAPTURE_TIMES else ""
            yield (
                f"{words(metric)} has a value in {percent(min(shares))} to {percent(max(shares))} of the runs, so its"
                f" means are over different, perhaps easier ones{hint}"
            )
    if result.failed:
        group = next(group for group in result.groups if group.failed)
        first = f"{group.in_words()}, seed {group.failed[0].seed}: {group.failed[0].failure}"
        yield f"{counted(len(result.failed), 'run')} failed; the first, with {first}"
    yield from (f"warning: {warning}" for warning in result.warnings(metrics))


def document(result: SweepRuns, metrics: Sequence[str], against: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return means, half widths and paired differences as JSON-compatible values; None where undefined.

    The entry `reference` has the settings of the configuration from which a difference is taken. If seeds are
    independent, there are no differences.

    Raises:
        ValueError: as `tables`.
    """
    means = {metric: result.estimates(metric) for metric in metrics}
    is_paired = bool(result.common or against)
    differences = {metric: result.differences(metric, against) for metric in metrics} if is_paired else {}
    references = [result.groups[k].settings for k in result.references(against)] if is_paired else None
    configurations = []
    for k, group in enumerate(result.groups):
        captured = group.present("captured")
        configurations.append(
            {
                "settings": _settings(group.settings),
                "runs": len(group.rows),
                "failed": len(group.failed),
                "captured": {
                    "share": float(np.mean(captured)) if len(captured) else None,
                    "interval": wilson(int(captured.sum()), len(captured)) if len(captured) else None,
                },
                "metrics": {metric: as_json(estimates[k]) for metric, estimates in means.items()},
                "reference": None if references is None else _settings(references[k]),
                "difference": {metric: as_json(estimates[k]) for metric, estimates in differences.items()},
            }
        )
    about = {"name": result.name, "grid": result.keys, "start": result.start, "warnings": result.warnings(metrics)}
    units = {metric: unit_of(metric, result.units) for metric in metrics}
    remarks = [note for note in notes(result, metrics) if not note.startswith("warning: ")]
    return about | {"notes": remarks, "units": units, "configurations": configurations}


def _settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {key: json_number(value) for key, value in settings.items()}


def _mean_rows(result: SweepRuns, metrics: Sequence[str]) -> list[tuple[str, ...]]:
    """Return rows of text: settings, number of runs, share of runs that ended by capture, and the mean of each metric.

    If any run failed, the number of failed runs follows the number of runs.
    """
    titles = (title(name, result.units) for name in metrics)
    failed = ("failed",) if result.failed else ()
    rows: list[tuple[str, ...]] = [(*result.keys, "runs", *failed, "captured", *titles)]
    estimates = [result.estimates(metric) for metric in metrics]
    for k, group in enumerate(result.groups):
        captured = group.present("captured")
        share = _share(captured) if len(captured) else "-"
        counts = (str(len(group.rows)), *([str(len(group.failed))] if result.failed else []))
        means = (
            with_half_width(column[k], len(group.rows) - len(group.failed), digits=digits_of(column))
            for column in estimates
        )
        rows.append((*map(text, group.settings.values()), *counts, share, *means))
    return rows


def _difference_rows(
    result: SweepRuns, metrics: Sequence[str], against: Mapping[str, Any] | None = None
) -> list[tuple[str, ...]]:
    """Return rows of text: settings, number of pairs, and mean differences; a reference has no row."""
    differences = [result.differences(metric, against) for metric in metrics]
    rows: list[tuple[str, ...]] = [(*result.keys, "pairs", *(title(name, result.units) for name in metrics))]
    references = result.references(against)
    compared = [k for k, other in enumerate(references) if k != other]
    digits = [digits_of([column[k] for k in compared]) for column in differences]
    for k, (group, other) in enumerate(zip(result.groups, references, strict=True)):
        if k == other:
            continue
        pairs = len(group.pairs(result.groups[other])[0])
        means = (
            with_half_width(column[k], pairs, sign="+", digits=decimals)
            for column, decimals in zip(differences, digits, strict=True)
        )
        rows.append((*map(text, group.settings.values()), str(pairs), *means))
    return rows


def _share(captured: Floats) -> str:
    """Return the share of runs that ended by capture and its 95 % Wilson interval, as text in %."""
    low, high = wilson(int(captured.sum()), len(captured))
    return f"{percent(float(np.mean(captured)))} ({percent(low)} .. {percent(high)})"
