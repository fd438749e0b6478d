"""The paths of a run on the plane, as a figure."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from desim.analysis.drawing.palette import (
    ACTIVE,
    ACTIVE_WITH_OTHERS,
    CAPTURE_MARK,
    EVADER,
    EVADER_MARK,
    INACTIVE,
    PURSUER_MARK,
)
from desim.analysis.drawing.plots import NARROW, Style, as_it_is, figure_of, in_style, styled
from desim.analysis.drawing.walls import draw_walls
from desim.analysis.trace_index import captures, sampled
from desim.kernel.core.units import time_text
from desim.simulation.run import Result

EVADER_PATH: Mapping[str, Any] = {
    **{"color": EVADER, "ls": (0, (3, 1.5)), "gapcolor": "white", "zorder": 4},
    **{"marker": EVADER_MARK, "markevery": [0]},
}
"""Style of an evader's path: a diamond at its start, and dashes that distinguish it from pursuers in greyscale, too."""


def trajectory(result: Result, size: str | None = None, *, style: Style = None, ax: Axes | None = None) -> Figure:
    """Draw the paths of the evaders, their capturers and all other pursuers that moved, and return the figure.

    Args:
        result: the result of a run with recorded positions.
        size: the width and perhaps the height; see `size_of`.
        style: a style of matplotlib on top of that of desim.
        ax: the axes to draw on; None = a figure of its own.

    Raises:
        ValueError: if the run recorded no positions, or the size or the style is invalid.
        TypeError: if `ax` is not one pair of axes of matplotlib.
    """
    if ax is not None:
        figure = figure_of(ax, size=size)
        with in_style(style):
            draw_trajectory(ax, result)
            ax.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False)
        return figure
    with styled((5.2, 5.2), size, style=style) as figure:
        axes = figure.add_subplot()
        draw_trajectory(axes, result)
        axes.set_title(as_it_is(f"{result.scenario.name}, seed {result.seed}"), wrap=True)
        figure.legend(loc="outside lower center", ncols=2 if figure.get_figwidth() >= NARROW else 1, fontsize=8)
    return figure


def set_plane(axes: Axes) -> None:
    """Prepare axes for positions: equal scales, labels in metres, and at most five intervals of ticks on each axis."""
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 5, 10]))


def draw_trajectory(axes: Axes, result: Result) -> None:
    """Draw on given axes the pursuers at the start, and the paths of the players that `trajectory` shows."""
    samples = sampled(result)
    evaders = np.array([sample.evaders for sample in samples])  # (samples, M, 2)
    pursuers = np.array([sample.pursuers for sample in samples])  # (samples, N, 2)
    captured = captures(result)
    capturers = list(dict.fromkeys(capture.capturer for capture in captured))
    others = [i for i in range(pursuers.shape[1]) if np.ptp(pursuers[:, i], axis=0).any() and i not in capturers]
    set_plane(axes)
    draw_walls(axes, result.scenario.wall)
    axes.plot(*pursuers[0].T, PURSUER_MARK, mfc="white", mec=INACTIVE, ms=5, label="pursuer at the start")
    for i in others:
        label = "pursuer that chased for a while" if i == others[0] else None
        axes.plot(*pursuers[:, i].T, color=ACTIVE_WITH_OTHERS, lw=1.4, label=label)
    several = len(evaders[0]) > 1
    for capturer in capturers:
        of_first = "pursuer that captures" if capturer == capturers[0] else None
        label = of_first if several else f"pursuer {capturer}, which captures"
        axes.plot(*pursuers[:, capturer].T, color=ACTIVE, lw=2.0, label=label, zorder=3)
    for k, path in enumerate(evaders.transpose(1, 0, 2), start=1):
        axes.plot(*path.T, lw=1.6, ms=5, label="evader" if k == 1 else None, **EVADER_PATH)
        if several:
            axes.annotate(str(k), path[0], (4, 4), textcoords="offset points", fontsize=8, zorder=6)
    for capture in captured:
        which = f"capture of {capture.evader} by {capture.capturer}" if several else "capture"
        label = f"{which}, {time_text(capture.t)} s"
        axes.plot(*evaders[-1, capture.evader - 1], CAPTURE_MARK, color="black", ms=11, zorder=5, label=label)
