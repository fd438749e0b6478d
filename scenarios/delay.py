"""Measure the cost of latency: the scaling law of excess active time, and a heat map over latency and slot.

The law: if all pursuers start active, could capture in time and decide greedily, the excess active time is
(g_N(L lambda) + (1 - 1 / N) L lambda) N^2 delta. The excess is the integral of max(n - 1, 0) over time, where n is the
number of active pursuers. L is the one-way latency, lambda the decision rate of a pursuer, and the slot delta = 1 / (N
lambda) the mean time between two decisions of the team. The second term is the latency of the first announcements; it
is absent if all know at first who is active (`scenarios.start --law`).

First, the excess is measured on static games, for several schedules. Then the sum of active times of a pursuit with
motion is predicted, without any fit, over a grid of latencies and slots. The prediction is the active time of the
centralised benchmark plus the excess. The horizon is so long that all pursuers could capture in time. Where the
prediction exceeds about 30 s, the evader may be captured before the excess has decayed, so the measured sum is lower.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from desim.analysis.tables import aligned
from scenarios.studies.study import Options, study

if TYPE_CHECKING:
    from desim.analysis.drawing.plots import Axes, Figure
from scenarios.studies.delay_runs import (
    CRITICAL,
    DELAYS,
    LATENCIES,
    SCHEDULES,
    SLOTS,
    Cell,
    N,
    Point,
    measure_law,
    measure_pursuits,
)


def table(points: Sequence[Point], cells: Sequence[Cell], runs: int) -> str:
    """Return two tables as text: the measured law, and the active times over latency and slot."""
    by_delay = {(point.schedule, point.delay): point for point in points}
    rows = [("L lambda", *SCHEDULES)]
    for delay in DELAYS:
        points_at_delay = [by_delay.get((name, delay)) for name in SCHEDULES]
        rows.append(
            (f"{delay:g}", *(f"{p.excess:.3f} +- {p.standard_error:.3f}" if p else "" for p in points_at_delay))
        )
    by_setting = {(cell.latency, cell.slot): cell for cell in cells}
    grid = [("L | delta", *(f"{slot:g} s" for slot in SLOTS))]
    for latency in LATENCIES:
        line = [by_setting[latency, slot] for slot in SLOTS]
        grid.append(
            (f"{latency:g} s", *(f"{c.active_time:.1f} +- {c.standard_error:.1f} ({c.predicted:.1f})" for c in line))
        )
    return (
        f"Excess active time on static games in units of N^2 delta, N = {N}, {runs} runs each, +- standard error\n"
        f"{aligned(rows)}\n\n"
        f"Sum of active times of the pursuit, s, Poisson clocks, {runs} runs each (predicted by the law, no fit)\n"
        f"{aligned(grid)}"
    )


def picture(points: Sequence[Point], cells: Sequence[Cell]) -> "Figure":
    """Draw the law for each schedule, and the heat map with the prediction of the law."""
    from desim.analysis.drawing import palette, plots

    with plots.styled(figsize=(9.0, 3.9)) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.25))
        for colour, mark, name in zip(palette.SERIES, palette.MARKERS, SCHEDULES, strict=False):
            line = [point for point in points if point.schedule == name]
            x = [max(point.delay, DELAYS[1] / 2) for point in line]
            left.errorbar(
                x,
                [point.excess for point in line],
                [point.standard_error for point in line],
                color=colour,
                marker=mark,
                ms=4,
                lw=1.2,
                label=name,
            )
        left.loglog()
        ticks = [DELAYS[1] / 2, *DELAYS[1:]]
        left.set_xticks(ticks, [f"{x:g}" for x in DELAYS])
        left.set_yticks([1, 3, 10, 30, 100], ["1", "3", "10", "30", "100"])
        left.minorticks_off()
        left.set(xlabel=r"latency in decisions of one pursuer, $L\lambda$", ylabel=r"excess active time ($N^2\delta$)")
        left.legend(fontsize=8)
        draw_heat_map(right, cells)
    return figure


def draw_heat_map(axes: "Axes", cells: Sequence[Cell]) -> None:
    """Draw the measured active time as colours, the law in brackets, and the line L lambda = `CRITICAL`."""
    from matplotlib.colors import LogNorm

    measured = np.array([cell.active_time for cell in cells]).reshape(len(LATENCIES), len(SLOTS))
    predicted = np.array([cell.predicted for cell in cells]).reshape(measured.shape)
    rows = np.arange(len(LATENCIES))
    columns = np.arange(len(SLOTS))
    image = axes.pcolormesh(columns, rows, measured, norm=LogNorm(), cmap="viridis_r", shading="nearest")
    for row, column in np.ndindex(measured.shape):
        text = f"{measured[row, column]:.0f}\n({predicted[row, column]:.0f})"
        colour = "black" if measured[row, column] < 15 else "white"
        axes.text(column, row, text, ha="center", va="center", fontsize=7, color=colour)
    critical = [np.interp(CRITICAL * N * slot, LATENCIES, rows, right=np.nan) for slot in SLOTS]
    axes.plot(columns, critical, color="#D55E00", lw=1.6, ls="--", label=rf"$L = {CRITICAL:g} / \lambda$")
    axes.set_xticks(columns, [f"{slot:g}" for slot in SLOTS])
    axes.set_yticks(rows, [f"{latency:g}" for latency in LATENCIES])
    axes.set(xlabel=r"slot $\delta$ (s)", ylabel="one-way latency L (s)")
    axes.set_title("sum of active times: measured (colour), by the law (in brackets)", fontsize=9)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.12), fontsize=8)
    scale = axes.figure.colorbar(image, ax=axes, label="s")
    scale.set_ticks([7, 10, 20, 40], labels=["7", "10", "20", "40"])
    scale.minorticks_off()


@study("delay", __doc__, seconds=4, runs=10)
def main(options: Options) -> None:
    """Measure the law and the pursuits, and compare them."""
    points = measure_law(options)
    cells = measure_pursuits(options, points)
    document = {"law": points, "pursuits": cells}
    options.show(document, table(points, cells, options.runs), lambda: picture(points, cells))


if __name__ == "__main__":
    main()
