"""The figure of a comparison: how many pursuers chase over time, and the active time of each seed."""

from collections.abc import Sequence

import numpy as np

from desim.analysis.activity import Steps, activity
from desim.analysis.drawing.palette import GREY, SERIES
from desim.analysis.drawing.plots import Axes, Figure, styled
from desim.analysis.measuring import summary
from desim.config.arrays import Floats
from desim.live.agreement import Agreement
from desim.simulation.run import Result

SIZE = 6.3, 2.6
"""inches"""
GRID = 400
"""Number of points of a curve over time."""


def agreement_figure(agreement: Agreement) -> Figure:
    """Draw live and simulated runs side by side.

    On the left is the mean number of pursuers that chase, over time; after its end a run counts as 0. On the right, the
    active time: each point is a seed; without any difference, all points would be on the diagonal.
    """
    results_of: dict[str, Sequence[Result]] = {"live": agreement.live, "simulated": agreement.simulated}
    with styled(SIZE) as figure:
        left, right = figure.subplots(1, 2)
        _draw_activity(left, results_of)
        _draw_pairs(right, agreement)
    return figure


def _draw_activity(axes: Axes, results_of: dict[str, Sequence[Result]]) -> None:
    steps = {name: [activity(result) for result in results] for name, results in results_of.items()}
    end = max(float(np.sum(durations)) for functions in steps.values() for durations, _ in functions)
    grid = np.linspace(0.0, end, GRID)
    for (name, functions), colour, line in zip(steps.items(), SERIES, ("-", "--"), strict=False):
        curves = [_at(grid, function) for function in functions]
        axes.plot(grid, np.mean(curves, axis=0), color=colour, ls=line, label=name)
    axes.set(xlabel="time (s)", ylabel="pursuers that chase", ylim=(0.0, None))
    axes.legend()


def _at(grid: Floats, function: Steps) -> Floats:
    """Return the values of a step function at some times, s; 0 after its end."""
    durations, counts = function
    index = np.searchsorted(np.cumsum(durations), grid, side="right")
    return np.where(index < len(counts), counts[np.minimum(index, len(counts) - 1)], 0.0)


def _draw_pairs(axes: Axes, agreement: Agreement) -> None:
    live, simulated = [
        [summary(result).active_time for result in results] for results in (agreement.live, agreement.simulated)
    ]
    top = 1.05 * max(*live, *simulated, 1e-9)
    axes.plot([0.0, top], [0.0, top], color=GREY, lw=0.8)
    axes.plot(simulated, live, "o", color=SERIES[0], ms=4)
    axes.set(xlabel="active time, simulated (s)", ylabel="active time, live (s)", xlim=(0, top), ylim=(0, top))
    axes.set_aspect("equal")
