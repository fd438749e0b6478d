"""The figure of a race: running means, with a cross where a configuration was dropped, and the number of those left."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from desim.analysis.drawing.palette import GREY
from desim.analysis.drawing.plots import Axes, Figure, Style, as_it_is, figure_of, in_style, styled
from desim.analysis.metrics import words
from desim.study.results.figure_labels import (
    add_legend,
    add_legend_above,
    axis_label,
    height_of_legend,
    literal,
    look_of,
)
from desim.study.selection.kim_nelson import Selection

MARKS = 5
"""The number of marks on a line of the longest race."""
NAMED = 10
"""The largest number of configurations that a legend names: the best ones."""
CROSS: dict[str, Any] = {"marker": "x", "ls": "none", "ms": 7, "mew": 1.6, "zorder": 3}
"""The style of the mark where a configuration was dropped."""
DROPPED, FIRST = "dropped", "end of the first runs"
"""The names of this mark and of the dotted line in the legend."""


def draw_race(
    selection: Selection,
    order: Sequence[int],
    names: Sequence[str],
    *,
    title: str,
    metric: str,
    unit: str,
    first: int,
    size: str | None = None,
    style: Style = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw a race: the fields of a `RaceResult`, whose `plot` says what size, style and axes are.

    `order` and `names` are the positions and the names of the configurations, the best first.

    Raises:
        ValueError: if the size or the style is invalid.
        TypeError: if `ax` is not one pair of axes of matplotlib.
    """
    label = axis_label(words(metric), unit)
    if ax is not None:
        figure = figure_of(ax, size=size)
        with in_style(style):
            _draw_means(ax, selection, order, names, first)
            ax.set_ylabel(label)
            ax.set_xlabel("runs of each configuration")
            add_legend_above(ax, None)
        return figure
    default_size = (6.4, 4.4 + height_of_legend([*names[:NAMED], DROPPED, FIRST], 6.4))
    with styled(default_size, size, style=style) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(4, 1))
        _draw_means(upper, selection, order, names, first)
        upper.set_ylabel(label)
        _draw_survivors(lower, selection)
        add_legend(figure, None)
        if size is None:
            upper.set_title(as_it_is(f"{title}: a race"), fontsize=9, wrap=True)
    return figure


def _draw_means(axes: Axes, selection: Selection, order: Sequence[int], names: Sequence[str], first: int) -> None:
    """Draw the running means from the second run on, and a line at the last of the first runs."""
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    dropped_systems = {dropped.system for dropped in selection.dropped}
    for rank, (system, name) in enumerate(zip(order, names, strict=True)):
        numbers = selection.samples[system]
        counts = np.arange(1, len(numbers) + 1)
        means = np.cumsum(numbers) / counts
        look = look_of(rank) if rank < NAMED else look_of(rank) | {"marker": ""}
        label = literal(name) if rank < NAMED else None
        gap = max(len(means) // MARKS, 1)  # lines begin their marks at different runs, so that no mark hides another
        axes.plot(counts[1:], means[1:], label=label, markevery=(rank % gap, gap), **look)
        if system in dropped_systems:
            axes.plot(counts[-1:], means[-1:], color=look["color"], **CROSS)
    if dropped_systems:
        axes.plot([], [], color="black", label=DROPPED, **CROSS)
    axes.axvline(first, color=GREY, lw=0.8, ls=":", zorder=0, label=FIRST)


def _draw_survivors(axes: Axes, selection: Selection) -> None:
    """Draw the number of configurations that are left, over the number of runs of each."""
    count, last = len(selection.samples), max(map(len, selection.samples))
    runs = [1, *(dropped.after for dropped in selection.dropped), last]
    left = [count - k for k in range(len(selection.dropped) + 1)]
    axes.step(runs, [*left, left[-1]], where="post", color="#555555", lw=1.2)
    axes.set(xlabel="runs of each configuration", ylabel="left", ylim=(0.0, count + 0.5))
    axes.set_yticks(sorted({1, count}))
