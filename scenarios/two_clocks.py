"""Which time step determines Table I? Active time over a grid of negotiation slot delta and motion step h.

The time-stepped loop of Lee & Bakolas uses one number for both. Here the 20 pursuers of Table I negotiate every delta
and set their headings every h, for all pairs of five values. A change of active time with delta is due to negotiation,
a change with h to the integration of motion.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from desim.analysis.metrics import active_time
from desim.analysis.statistics import estimate
from desim.analysis.tables import aligned
from desim.scenario.scenario import Capture, Motion
from scenarios.studies.study import Options, study
from scenarios.studies.table1_runs import configuration, decentralised

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VALUES = (0.001, 0.003, 0.01, 0.03, 0.1)
"""Values of delta and of h, s."""


@dataclass(frozen=True)
class Cell:
    """The mean over the runs of the sum of active times, s, for one slot delta and one motion step h."""

    slot: float
    step: float
    active_time: float
    standard_error: float


def measure(options: Options) -> list[Cell]:
    """Run the grid; capture is tested along the whole step, so h does not set the resolution of capture."""
    base = configuration(20).model_copy(update={"capture": Capture(test="segment")})
    grid = [(slot, step) for slot in VALUES for step in VALUES]
    scenarios = [decentralised(base, slot).model_copy(update={"motion": Motion(step=step)}) for slot, step in grid]
    cells = []
    for (slot, step), times in zip(grid, options.measure(scenarios, "two clocks", active_time), strict=True):
        measured = estimate(times)
        cells.append(Cell(slot, step, measured.mean, measured.standard_error))
    return cells


def spread(cells: list[Cell], along: str) -> float:
    """Return the greatest ratio of active times between cells that differ in `along` ("slot" or "step") alone."""
    fixed = "step" if along == "slot" else "slot"
    lines = [[cell.active_time for cell in cells if getattr(cell, fixed) == value] for value in VALUES]
    return max(max(line) / min(line) for line in lines)


def table(cells: list[Cell], runs: int) -> str:
    """Return the grid as text, and the conclusion from it."""
    by_setting = {(cell.slot, cell.step): cell for cell in cells}
    rows = [("delta | h", *(f"{step:g} s" for step in VALUES))]
    for slot in VALUES:
        line = [by_setting[slot, step] for step in VALUES]
        rows.append((f"{slot:g} s", *(f"{cell.active_time:.2f} +- {cell.standard_error:.2f}" for cell in line)))
    by_slot, by_step = spread(cells, "slot"), spread(cells, "step")
    return (
        f"Sum of active times, s, N = 20, {runs} runs per cell, +- standard error\n"
        + aligned(rows)
        + f"\nIt changes along delta by up to a factor {by_slot:.1f}, along h by up to {by_step:.2f}, chance "
        + "included: Table I is about the "
        + ("negotiation slot." if by_slot > by_step else "motion step.")
    )


def picture(cells: list[Cell]) -> "Figure":
    """Draw the active time over delta, one line per h, and over h, one line per delta; the paper has delta = h."""
    from desim.analysis.drawing import palette, plots

    by_setting = {(cell.slot, cell.step): cell for cell in cells}

    def draw(axes: plots.Axes, x: str, other: str) -> None:
        for colour, marker, fixed in zip(palette.SERIES, "osD^v", VALUES, strict=False):
            line = [by_setting[(v, fixed) if x == "slot" else (fixed, v)] for v in VALUES]
            y, error = np.array([(cell.active_time, cell.standard_error) for cell in line]).T
            axes.errorbar(VALUES, y, error, color=colour, marker=marker, ms=4, lw=1.2, label=f"{other} = {fixed:g} s")
        axes.loglog()
        axes.set_xticks(VALUES, [f"{v:g}" for v in VALUES], minor=False)
        axes.set_yticks([5, 10, 20, 50], ["5", "10", "20", "50"], minor=False)
        axes.minorticks_off()

    with plots.styled(figsize=(8.0, 3.4)) as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        draw(left, "slot", "h")
        draw(right, "step", "$\\delta$")
        left.legend(fontsize=7)
        right.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), reverse=True)
        left.set(xlabel="negotiation slot $\\delta$ (s)", ylabel="sum of active times (s)")
        right.set(xlabel="motion step h (s)")
    return figure


@study("two_clocks", __doc__, seconds=1.3, runs=40)
def main(options: Options) -> None:
    """Measure, compare and show."""
    cells = measure(options)
    by_slot, by_step = spread(cells, "slot"), spread(cells, "step")
    document = {"cells": cells, "spread_along_slot": by_slot, "spread_along_step": by_step}
    options.show(document, table(cells, options.runs), lambda: picture(cells))


if __name__ == "__main__":
    main()
