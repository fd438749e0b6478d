"""What do pursuers that lie cost a team, how much of it does each defence restore, and at which price?

First, one pursuer of twelve lies in several ways, under four protocols. Second, the number of liars grows under each
defence of `announce.trust`. Third, honest teams with wrong clocks show where the truth looks like a lie. Fourth, teams
with and without a liar show the effect of latency and loss. Pursuers have equal speeds, and announce their capture
times.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

from desim.analysis.drawing import palette
from desim.analysis.tables import aligned
from scenarios.studies.liars_runs import (
    DEFENCES,
    HONEST,
    LATE,
    LIES,
    NONE,
    OBSERVING,
    PROTOCOLS,
    WORST,
    Cell,
    N,
    measure,
)
from scenarios.studies.study import Options, draw_estimates, study

if TYPE_CHECKING:
    from desim.analysis.drawing.plots import Axes, Figure


THIN: Mapping[str, float] = MappingProxyType({"elinewidth": 0.6})
"""The look of error bars on bars."""


def table(cells: Sequence[Cell], runs: int) -> str:
    """Return all results as text."""
    about = f"{N} pursuers, {runs} runs"
    return "\n\n".join(
        [
            f"One liar, no defence: share captured, and later than by the honest team, s: {about}\n{_lies(cells)}",
            f"local_min, liars that claim to be there at once: share captured: {about}\n{_numbers(cells)}",
            f"sap, honest, wrong clocks, latency {LATE:g} s, 10 % loss: false accusations, active time, s: {about}\n"
            f"{_clocks(cells)}",
            f"local_min, latency and 10 % loss: share captured, active time, s: {about}\n{_latency(cells)}",
        ]
    )


def _lies(cells: Sequence[Cell]) -> str:
    lines = [("lie", *PROTOCOLS)]
    for lie in LIES:
        row_cells = [cell for cell in cells if cell.part == "lies" and cell.lie == lie]
        lines.append((lie, *(f"{cell.captured.mean:.2f}, {cell.delay:+.1f}" for cell in row_cells)))
    return aligned(lines)


def _numbers(cells: Sequence[Cell]) -> str:
    rows = _by_defence(cells, "numbers", WORST)
    lines = [("defence", *(f"{cell.value:g} liars" for cell in rows[NONE]))]
    lines += [(defence, *(f"{cell.captured.mean:.2f}" for cell in row_cells)) for defence, row_cells in rows.items()]
    return aligned(lines)


def _clocks(cells: Sequence[Cell]) -> str:
    rows = _by_defence(cells, "clocks", HONEST)
    lines = [("defence", *(f"{cell.value:g} s" for cell in rows[NONE]))]
    for defence, row_cells in rows.items():
        row = (f"{cell.false_accusations.mean:.1f}, {cell.active_time.mean:.1f}" for cell in row_cells)
        lines.append((defence, *row))
    return aligned(lines)


def _latency(cells: Sequence[Cell]) -> str:
    lines: list[tuple[str, ...]] = []
    for lie in (HONEST, WORST):
        rows = _by_defence(cells, "latency", lie)
        lines = lines or [("", *(f"{cell.value:g} s" for cell in rows[NONE]))]
        for defence, row_cells in rows.items():
            row = (f"{cell.captured.mean:.2f}, {cell.active_time.mean:.1f}" for cell in row_cells)
            lines.append((f"{lie}, {defence}", *row))
    return aligned(lines)


def _by_defence(cells: Sequence[Cell], part: str, lie: str) -> dict[str, list[Cell]]:
    by_defence: dict[str, list[Cell]] = {}
    for cell in cells:
        if cell.part == part and cell.lie == lie:
            by_defence.setdefault(cell.defence, []).append(cell)
    return by_defence


def picture(cells: Sequence[Cell]) -> "Figure":
    """Draw the damage by lie and protocol, captures by liars and defence, false accusations, and the price."""
    from desim.analysis.drawing import plots

    with plots.styled(figsize=(9.0, 6.0)) as figure:
        (damage, numbers), (price, clocks) = figure.subplots(2, 2)
        _draw_lies(damage, cells)
        _draw(numbers, _by_defence(cells, "numbers", WORST), "captured")
        numbers.set(xlabel="liars that claim to be there at once", ylabel="share captured", ylim=(-0.03, 1.03))
        _draw(price, _by_defence(cells, "latency", HONEST), "active_time")
        price.set(xlabel="mean latency, 10 % loss, no liar (s)", ylabel="sum of active times (s)", ylim=(0.0, None))
        suspected = {name: line for name, line in _by_defence(cells, "clocks", HONEST).items() if name in OBSERVING}
        _draw(clocks, suspected, "false_accusations")
        clocks.set(xlabel="deviation of the clocks, no liar (s)", ylabel="false accusations per run", ylim=(0.0, None))
        numbers.legend(fontsize=7, loc="center right")
    return figure


def _draw_lies(axes: "Axes", cells: Sequence[Cell]) -> None:
    names = [name for name in LIES if name != HONEST]
    for k, (protocol, colour) in enumerate(zip(PROTOCOLS, palette.SERIES, strict=False)):
        by_lie = {cell.lie: cell for cell in cells if cell.part == "lies" and cell.protocol == protocol}
        y = [row + 0.18 * (k - 1.5) for row in range(len(names))]
        delays = [by_lie[name].delay for name in names]
        error = [delay.half_width for delay in delays]
        axes.barh(y, [delay.mean for delay in delays], 0.16, xerr=error, color=colour, label=protocol, error_kw=THIN)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set(xlabel="capture time, or horizon, beyond that of the honest team (s)")
    axes.legend(fontsize=7, loc="lower right")


def _draw(axes: "Axes", lines: Mapping[str, Sequence[Cell]], measure: str) -> None:
    """Draw a result over the value that varies, a line per defence."""
    for k, (colour, mark, defence) in enumerate(zip(palette.SERIES, palette.MARKERS, DEFENCES, strict=False)):
        line = lines.get(defence, ())
        if not line:
            continue
        span = line[-1].value - line[0].value
        x = [cell.value + 0.008 * span * (k - 2.5) for cell in line]  # shifted, so that equal lines are seen
        estimates = [getattr(cell, measure) for cell in line]
        draw_estimates(axes, x, estimates, color=colour, marker=mark, elinewidth=0.6, label=defence)


@study("liars", __doc__, seconds=7.5, runs=40)
def main(options: Options) -> None:
    """Run the pursuits and show the results."""
    cells = measure(options)
    options.show({"cells": cells}, table(cells, options.runs), lambda: picture(cells))


if __name__ == "__main__":
    main()
