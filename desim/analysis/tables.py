"""Results as plain text that a person reads."""

from collections.abc import Iterator, Sequence
from math import isnan

from desim.analysis.metrics import Summary
from desim.analysis.statistics import estimate
from desim.scenario import Scenario

TIMES = ("active_time", "idle_time", "crowded_time", "excess_time")
COUNTS = (
    "decisions",
    "switches",
    "messages_sent",
    "messages_delivered",
    "messages_lost",
    "messages_in_flight",
    "transmissions",
    "bytes_sent",
)
AGES = ("age_mean", "age_peak", "age_at_decision")


def aligned(rows: Sequence[Sequence[str]], right_from: int = 1) -> str:
    """Return rows as text with columns lined up, those from `right_from` on to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if k >= right_from else cell.ljust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    )


def run_table(scenario: Scenario, run: Summary, wall_time: float) -> str:
    """Return what one run came to; wall_time in s."""
    outcome = (
        f"after {run.capture_time:.3f} s by pursuer {run.capturer}"
        if run.captured
        else f"no, the pursuit ended after {run.end_time:.3f} s"
    )
    rate = run.messages_sent / wall_time
    rows = [
        ("captured", outcome, ""),
        ("active time", f"{run.active_time:.3f} s", "summed over the pursuers"),
        ("idle time", f"{run.idle_time:.3f} s", "nobody active"),
        ("crowded time", f"{run.crowded_time:.3f} s", "more than one active"),
        ("decisions", f"{run.decisions:,}", f"{run.switches:,} of them changed an action"),
        ("messages sent", f"{run.messages_sent:,}", "each receiver of a broadcast counts as one"),
        ("  delivered", f"{run.messages_delivered:,}", ""),
        ("  lost", f"{run.messages_lost:,}", _causes(run)),
        ("  in flight", f"{run.messages_in_flight:,}", "when the run ended"),
        ("bytes sent", f"{run.bytes_sent:,}", f"in {run.transmissions:,} transmissions"),
    ]
    rows += _rows_of_word(run)
    rows.append(("wall time", f"{wall_time:.3f} s", f"{rate:,.0f} messages/s"))
    return _heading(scenario, f"seed {run.seed}") + aligned(rows, right_from=3)


def batch_table(scenario: Scenario, runs: Sequence[Summary], wall_time: float) -> str:
    """Return the means of several runs with their 95 % intervals; wall_time in s."""
    captured = [run for run in runs if run.captured]
    rows: list[Sequence[str]] = [("", "mean", "+-", "least", "most", "runs")]
    if captured:
        rows.append(_row("capture time, s", [run.capture_time or 0.0 for run in captured]))
    rows += [_row(f"{_words(name)}, s", [getattr(run, name) for run in runs]) for name in TIMES]
    for name in COUNTS:
        rows.append(_row(_words(name), [getattr(run, name) for run in runs]))
        if name == "messages_lost":
            rows += _rows_of_causes(runs)
    if any(run.utilisation > 0 for run in runs):
        rows.append(_row("utilisation", [run.utilisation for run in runs]))
    for name, unit in (*((age, ", s") for age in AGES), ("belief_error", "")):
        measured = [value for run in runs if (value := getattr(run, name)) is not None]
        if measured:
            rows.append(_row(_words(name) + unit, measured))
    seeds = f"seeds {runs[0].seed} to {runs[-1].seed}"
    rate = sum(run.messages_sent for run in runs) / wall_time
    return (
        _heading(scenario, seeds)
        + f"captured in {len(captured)} of {len(runs)} runs; +- is half a 95 % t interval\n"
        + aligned(rows)
        + f"\nwall time {wall_time:.3f} s, {rate:,.0f} messages/s"
    )


def number(value: float, digits: int = 3) -> str:
    """Return a number with thousands separators, or a dash if there is none."""
    return "-" if isnan(value) else f"{value:,.{digits}f}"


def _causes(run: Summary) -> str:
    """Return how many messages were lost by what."""
    return ", ".join(f"{number:,} by {_words(cause)}" for cause, number in sorted(run.messages_lost_by.items()))


def _rows_of_causes(runs: Sequence[Summary]) -> Iterator[Sequence[str]]:
    """Yield how many messages were lost by each cause that there was."""
    for cause in sorted({cause for run in runs for cause in run.messages_lost_by}):
        yield _row(f"  by {_words(cause)}", [run.messages_lost_by.get(cause, 0) for run in runs])


def _rows_of_word(run: Summary) -> Iterator[tuple[str, str, str]]:
    """Yield what the network did to word, as far as there is something to tell."""
    if run.utilisation > 0:
        yield "utilisation", f"{run.utilisation:.3f}", "share of the time in which the channels were busy"
    meanings = ("averaged over time and pairs", "just before newer word came", "when the reader decided")
    for name, meaning in zip(AGES, meanings, strict=True):
        age = getattr(run, name)
        if age is not None:
            yield _words(name), f"{age:.3f} s", meaning
    if run.belief_error is not None:
        yield "belief error", f"{run.belief_error:.3f}", "share of pairs with wrong word of the action"


def _row(name: str, values: Sequence[float]) -> tuple[str, ...]:
    found = estimate(values)
    return (name, *(number(x) for x in (found.mean, found.half_width, min(values), max(values))), str(len(values)))


def _words(name: str) -> str:
    return name.replace("_", " ")


def _heading(scenario: Scenario, what: str) -> str:
    kind = getattr(scenario.protocol, "kind", getattr(scenario.protocol, "__name__", "own protocol"))
    return f"{scenario.name}: {scenario.team.count} pursuers, {kind}, {what}\n"
