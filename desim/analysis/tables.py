"""Results as tables in plain text, and estimates as JSON."""

from collections.abc import Iterator, Mapping, Sequence
from math import floor, inf, isfinite, isnan, log10, nan
from typing import Any

from desim.analysis.measuring import users_metrics
from desim.analysis.metrics import METRICS, Summary, title, words
from desim.analysis.statistics import Estimate, Share, mean_or_share, share, t_quantile, wilson
from desim.config.json_numbers import json_number
from desim.config.number_texts import counted
from desim.kernel.core.portable_math import portable_sum
from desim.scenario.scenario import Scenario

PER_EVADER = {"captures", "mean_capture_time"}
"""The metrics that have no row in the table of several runs if there is one evader.

With one evader they repeat `captured` and `capture_time`.
"""
SHOWN = 12
"""Largest number of evaders listed in the table of a run."""
NANO = 1e-9
"""Smaller numbers count as rounding errors and are shown as 0. This is the resolution of times, s."""
ALL_EQUAL = "all equal"
"""The text in place of the half width if all values are equal, because their t interval has no width."""


def aligned(rows: Sequence[Sequence[str]], right_from: int = 1) -> str:
    """Return rows as text with aligned columns; columns from `right_from` on are aligned to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if k >= right_from else cell.ljust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    )


def run_table(scenario: Scenario, run: Summary, wall_time: float, shown: Sequence[str] = ()) -> str:
    """Return the table of one run; `wall_time` in s.

    A built-in metric whose `Metric.note` is None has a row only if its name is in `shown`.
    """
    rate = run.messages_sent / wall_time
    rows = [
        *_captures(scenario, run),
        *_rows_of_run(scenario, run, shown),
        ("wall time", f"{wall_time:.3f} s", f"{rate:,.0f} messages/s"),
    ]
    return _heading(scenario, f"seed {run.seed}") + aligned(rows, right_from=3)


def batch_table(scenario: Scenario, runs: Sequence[Summary], wall_time: float) -> str:
    """Return the table of several runs: means with their 95 % intervals; `wall_time` in s."""
    captured = portable_sum(run.captured for run in runs)
    low, high = wilson(captured, len(runs))
    rows: list[Sequence[str]] = [("", "mean", "+-", "least", "most", "runs"), *_rows_of_batch(scenario, runs)]
    seeds = f"seed {runs[0].seed}" if len(runs) == 1 else f"seeds {runs[0].seed} to {runs[-1].seed}"
    total, needed = len(scenario.evaders), scenario.capture.captures_to_end
    evaders = "" if total == 1 else "all " if needed in (None, total) else f"{needed} of {total} "
    rate = portable_sum(run.messages_sent for run in runs) / wall_time
    counts = [int(row[-1]) for row in rows if ALL_EQUAL in row]
    bound = wilson(0, min(counts))[1] if counts else 0.0
    on_equal = f"; {ALL_EQUAL}: at most {percent(bound)} of all seeds have another value" if counts else ""
    if len({*counts}) > 1:
        on_equal += f" (for {min(counts)} values; {percent(wilson(0, max(counts))[1])} for {max(counts)})"
    types_of_added = [{type(run[name]) for run in runs} - {type(None)} for name in runs[0] if name not in METRICS]
    on_shares = ", of shares half a Wilson interval" if {bool} in types_of_added else ""
    at_horizon = portable_sum(run.end_time >= scenario.horizon for run in runs)
    on_horizon = (
        f"{counted(at_horizon, 'run')} ended at the horizon of {scenario.horizon:g} s, which may be too short"
        + " for a capture\n"
    )
    return (
        _heading(scenario, seeds)
        + f"{evaders}captured in {captured} of {counted(len(runs), 'run')}; +- is half a 95 % t"
        + f" interval{on_shares}{on_equal}\n"
        + f"capture probability {fraction(captured / len(runs))}, 95 % Wilson interval {fraction(low)} to"
        + f" {fraction(high)}\n"
        + ("" if captured or not at_horizon else on_horizon)
        + aligned(rows)
        + f"\nwall time {wall_time:.3f} s, {rate:,.0f} messages/s"
    )


def number(value: float, digits: int = 3) -> str:
    """Return a number as text with thousands separators, or a dash for nan."""
    return "-" if isnan(value) else f"{value:,.{digits}f}"


def digits_of(values: Sequence[Estimate]) -> int:
    """Return the number of decimals that the estimates in a column of a table share.

    There are three, or one if all means are at least 100. If all numbers are below 0.01, the greatest has three digits.
    A cell that these decimals would show as certain has more; see `digits_in`.
    """
    sizes = [abs(size) for value in values for size in (value.mean, value.half_width) if isfinite(size)]
    return _decimals(sizes) if any(abs(value.mean) < 100.0 for value in values) else 1


def digits_in(value: Estimate, digits: int | None = None) -> int:
    """Return the number of decimals of an estimate in a column with `digits` decimals; None = in a column of its own.

    The estimate has more decimals if `digits` would show its half width as 0, so that the mean would seem certain. An
    estimate without a half width has more if `digits` would show its mean as 0.
    """
    has_width = value.count > 1 and value.others is None
    size = value.half_width if has_width else abs(value.mean)
    return decimals_of(size, digits_of([value]) if digits is None else digits)


def decimals_of(size: float, least: int = 3) -> int:
    """Return the number of decimals of a number >= 0: `least`, or as many as show two digits if `least` show 0."""
    return 1 - floor(log10(size)) if NANO <= size < inf and not float(f"{size:.{least}f}") else least


def _decimals(sizes: Sequence[float]) -> int:
    """Return the number of decimals of some numbers: three, or, if all are below 0.01, three digits of the greatest."""
    greatest = max(sizes, default=0.0)
    return 2 - floor(log10(greatest)) if NANO <= greatest < 0.01 else 3


def _shown(value: float) -> str:
    """Return a number of one run as text."""
    return number(value, _decimals([abs(value)]))


def fraction(share: float) -> str:
    """Return a share in [0, 1] as text with three decimals, or as many as tell it apart from 0 and 1."""
    return f"{share:.{_decimals_of_share(share, 3)}f}"


def percent(share: float, decimals: int = 1) -> str:
    """Return a share in [0, 1] as text in %, with some decimals, or as many as tell it apart from 0 and 100 %."""
    return f"{share:.{max(_decimals_of_share(share, 2 + decimals) - 2, decimals)}%}"


def _decimals_of_share(share: float, least: int) -> int:
    distance = min(share, 1.0 - share)
    return max(least, -floor(log10(distance))) if distance >= NANO else least


def with_half_width(value: Estimate, runs: int, sign: str = "", unit: str = "", digits: int | None = None) -> str:
    """Return "mean +- half width of the 95 % interval", with the number of values if it differs from `runs`.

    If all values are equal, return "mean in all, others < p", with the upper bound p of the share of all runs that have
    another value. Otherwise, for a share, return "share (low .. high)". Without values, return a dash. `sign` is the
    sign option of a format: "+" shows the sign of a positive mean, too. `unit` follows the number. `digits` is the
    number of decimals in the column; see `digits_in`.
    """
    if not value.count:
        return "-"
    digits, unit = digits_in(value, digits), f" {unit}".rstrip()
    few = f" ({value.count})" if value.count != runs else ""
    if value.others is not None:
        return f"{value.mean:{sign},.{digits}f}{unit} in all, others < {percent(value.others)}{few}"
    if isinstance(value, Share):
        low, high = value.interval
        return f"{sign * (value.mean >= 0.0)}{fraction(value.mean)} ({fraction(low)} .. {fraction(high)}){unit}{few}"
    return f"{value.mean:{sign},.{digits}f} +- {number(value.half_width, digits)}{unit}{few}"


def as_json(value: Estimate) -> dict[str, Any]:
    """Return an estimate as JSON values; a share also has its interval, which is not symmetric."""
    numbers = {"mean": json_number(value.mean), "half_width": json_number(value.half_width), "runs": value.count}
    return numbers | ({"interval": list(value.interval)} if isinstance(value, Share) else {})


def from_json(numbers: Mapping[str, Any]) -> Estimate:
    """Return the estimate that `as_json` converted to JSON values, up to rounding."""
    mean, half_width = (nan if numbers[key] is None else float(numbers[key]) for key in ("mean", "half_width"))
    count = int(numbers["runs"])
    if "interval" in numbers:
        successes = round(mean * count)
        return share([1.0] * successes + [0.0] * (count - successes))
    return Estimate(mean, half_width / t_quantile(count - 1, 0.95) if count > 1 else nan, count)


def _captures(scenario: Scenario, run: Summary) -> Iterator[tuple[str, str, str]]:
    """Yield the row of the capture.

    With several evaders, yield the number of captures, then a row for each evader: first the captured ones, in order of
    capture, then the others. After `SHOWN` evaders, a last row gives the number of the remaining ones.
    """
    outcome = (
        f"after {_shown(run['capture_time'])} s by pursuer {run.capturer}"
        if run.captured
        else f"no, the pursuit ended after {_shown(run.end_time)} s"
    )
    evaders = len(scenario.evaders)
    if evaders == 1:
        yield "captured", outcome, _note_of_end(scenario, run)
        return
    end = f"the last after {_shown(run.end_time)} s" if run.captured else outcome.removeprefix("no, ")
    note = _note_of_end(scenario, run)
    yield "captured", f"{run.captures} of {evaders}", f"{end}, {note}" if note else end
    times = run.capture_times
    for evader in [*times, *(j for j in map(str, range(1, evaders + 1)) if j not in times)][:SHOWN]:
        is_captured = evader in times
        text = f"after {_shown(times[evader])} s by pursuer {run.capturers[evader]}" if is_captured else "no"
        yield f"  evader {evader}", text, ""
    if evaders > SHOWN:
        yield f"  and {evaders - SHOWN} more", "", ""


def _note_of_end(scenario: Scenario, run: Summary) -> str:
    """Return a note if the horizon ended the run, and not a capture or a watcher; else ""."""
    return "" if run.captured or run.end_time < scenario.horizon else "the horizon: it may be too short for a capture"


def _rows_of_run(scenario: Scenario, run: Summary, shown: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """Yield the rows of the metrics of a run: label, value with unit, note."""
    added = dict(users_metrics(scenario.record.metrics))
    for name, metric in {**METRICS, **added}.items():
        value = run[name]
        is_silent = metric.note is None and name not in added and name not in shown
        if is_silent or value is None or (metric.silent_at_0 and not value):
            continue
        text = str(value).lower() if isinstance(value, bool) else f"{value:,}" if isinstance(value, int) else None
        text = f"{text or _shown(value)} {metric.unit}".rstrip()
        note = metric.note(run) if callable(metric.note) else metric.note or ""
        yield metric.label or words(name), text, note


def _rows_of_batch(scenario: Scenario, runs: Sequence[Summary]) -> Iterator[Sequence[str]]:
    """Yield the rows of the metrics of several runs; a metric that is None in every run has no row."""
    for name in runs[0]:
        if name in PER_EVADER and len(scenario.evaders) == 1:
            continue
        values = [value for run in runs if (value := run[name]) is not None]
        metric = METRICS.get(name)
        if not values or (metric and (not metric.in_tables or (metric.silent_at_0 and not any(values)))):
            continue
        if isinstance(values[0], dict):
            for key in sorted({key for value in values for key in value}):
                yield _row(f"  by {words(key)}", [value.get(key, 0) for value in values])
        else:
            yield _row(title(name, runs[0].units), values)


def _row(name: str, values: Sequence[float]) -> tuple[str, ...]:
    """Return the row of a metric in the table of several runs, given its values in the runs that have one."""
    summary = mean_or_share(values)
    digits = decimals_of(summary.half_width, _decimals([abs(value) for value in values if isfinite(value)]))
    mean, half_width, least, most = (
        number(value, digits) for value in (summary.mean, summary.half_width, min(values), max(values))
    )
    return (name, mean, half_width if summary.others is None else ALL_EQUAL, least, most, str(len(values)))


def _heading(scenario: Scenario, seeds: str) -> str:
    """Return the first line of a table, given the words for its seeds."""
    players = counted(scenario.team.count, "pursuer") + (
        f", {len(scenario.evaders)} evaders" if len(scenario.evaders) > 1 else ""
    )
    return f"{scenario.name}: {players}, {scenario.protocol_name}, {seeds}\n"
