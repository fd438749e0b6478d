"""Figures of designs: a metric at scattered points, over each key, or as contours over two keys."""

from collections.abc import Sequence
from math import isfinite, log10
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from desim.analysis.drawing.plots import Axes, Figure, Style, as_it_is, figure_of, in_style, styled
from desim.analysis.statistics import Estimate
from desim.study.plan.configurations import in_words
from desim.study.results.figure_labels import (
    add_legend,
    add_legend_above,
    columns_of,
    height_of_legend,
    key_with_unit,
    line_name,
    look_of,
    metric_with_unit,
    swept_numbers,
    title_of_legend,
)
from desim.study.results.figures import is_wide
from desim.study.results.heat_maps import draw_panels
from desim.study.results.runs import Group, SweepRuns

LEVELS = 9
"""The number of bands of contours."""
Point = tuple[Group, Estimate]


def scatter(
    result: SweepRuns, metric: str, *, size: str | None = None, style: Style = None, ax: Axes | None = None
) -> Figure:
    """Draw the mean of a metric at each point of a design, in a panel for each key whose numbers were drawn.

    Points of one colour have equal values of the other keys. Vertical bars are 95 % intervals. For the arguments see
    `SweepResult.plot`.

    Raises:
        ValueError: if no key takes several numbers, the sweep has no such metric, the size is invalid, or several
            panels do not fit into `ax`.
        TypeError: if `ax` is not one pair of axes of matplotlib.
    """
    keys = result.drawn_keys or swept_numbers(result)
    if not keys:
        raise ValueError("a scatter plot needs a key that takes several numbers, there is none")
    line_keys = [key for key in result.keys if key not in keys and len(result.values(key)) > 1]
    points = list(zip(result.groups, result.estimates(metric), strict=True))
    lines: dict[str, list[Point]] = {}
    for group, estimate in points:
        lines.setdefault(line_name(group, line_keys), []).append((group, estimate))
    title = metric_with_unit(metric, result)

    def draw(axes: Axes, key: str) -> None:
        for k, (name, line) in enumerate(lines.items()):
            x = [group.settings[key] for group, _ in line]
            means = [estimate.mean for _, estimate in line]
            bars = list(zip(*(estimate.bars for _, estimate in line), strict=True))
            look = look_of(k) | {"ls": "none", "ms": 3.0, "elinewidth": 0.5}
            axes.errorbar(x, means, bars, label=name, **look)
        _scale(axes, key, points)
        axes.set_xlabel(key_with_unit(key))

    if ax is not None:
        figure = figure_of(ax, panels=keys, size=size)
        with in_style(style):
            draw(ax, keys[0])
            ax.set_ylabel(title)
            if line_keys:
                add_legend_above(ax, title_of_legend(line_keys))
        return figure
    columns = columns_of(len(keys), size)
    rows = -(-len(keys) // columns)
    width = 4.8 if columns == 1 else 0.6 + 2.6 * columns
    height = 0.5 + 2.6 * rows + height_of_legend(list(lines), width)
    with styled((width, height), size, style=style) as figure:
        panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
        for axes, key in zip(panels.flat, keys, strict=False):
            draw(axes, key)
        for axes in panels.flat[len(keys) :]:
            axes.set_axis_off()
        for row in panels:
            row[0].set_ylabel(title)
        if size is None:
            figure.suptitle(as_it_is(f"{result.name}, 95 % intervals"), fontsize=9, wrap=True)
        if line_keys:
            add_legend(figure, title_of_legend(line_keys))
    return figure


def contour(
    result: SweepRuns, metric: str, *, size: str | None = None, style: Style = None, ax: Axes | None = None
) -> Figure:
    """Draw the mean of a metric over two keys as coloured bands, between points that are joined to triangles.

    Dots are the points; points at infinity are left out. Each combination of values of the other keys has a panel; all
    share one colour scale. For the arguments see `SweepResult.plot`.

    Raises:
        ValueError: if a design drew numbers of one key or of more than two; a grid has fewer than two keys that take
            several numbers; a panel has fewer than three points, or all on a line; the sweep has no such metric; the
            size is invalid; or several panels do not fit into `ax`.
        TypeError: if `ax` is not one pair of axes of matplotlib.
    """
    keys = result.drawn_keys or swept_numbers(result)[:2]
    if len(keys) != 2:
        hint = "; `scatter` has a panel for each key" if keys else ""
        raise ValueError(f"contours need two keys that take several numbers, there are {len(keys)}{hint}")
    panels: dict[str, list[Point]] = {}
    points = list(zip(result.groups, result.estimates(metric), strict=True))
    for group, estimate in points:
        if isfinite(estimate.mean) and all(isfinite(group.settings[key]) for key in keys):
            panel_settings = {k: v for k, v in group.settings.items() if k not in keys and len(result.values(k)) > 1}
            panels.setdefault(in_words(panel_settings), []).append((group, estimate))
    if not panels:
        raise ValueError(f"{metric}: no configuration has a finite value")
    means = [estimate.mean for panel in panels.values() for _, estimate in panel]
    colours = ScalarMappable(Normalize(min(means), max(means)), "cividis")

    def draw(axes: Axes, panel: list[Point]) -> None:
        _draw_bands(axes, keys, panel, points, colours)

    columns = columns_of(len(panels), size, beside=1.2)
    default_size = (1.6 + 3.0 * columns, 0.8 + 2.4 * -(-len(panels) // columns))
    return draw_panels(
        panels,
        draw,
        colours,
        metric_with_unit(metric, result),
        columns=columns,
        default_size=default_size,
        size=size,
        style=style,
        ax=ax,
    )


def _draw_bands(
    axes: Axes, keys: Sequence[str], panel: Sequence[Point], points: Sequence[Point], colours: ScalarMappable
) -> None:
    """Draw the bands of one panel; triangles join points that are near on the axes as drawn, also logarithmic ones."""
    from matplotlib.tri import Triangulation

    coordinates = []
    for key in keys:
        numbers = [float(group.settings[key]) for group, _ in panel]
        coordinates.append([log10(number) for number in numbers] if _is_log(key, points) else numbers)
    spans = [(max(numbers) - min(numbers)) or 1.0 for numbers in coordinates]
    scaled = [[number / span for number in numbers] for numbers, span in zip(coordinates, spans, strict=True)]
    if len(panel) < 3:
        raise ValueError(f"contours need three points in each panel, there are {len(panel)}")
    try:
        triangles = Triangulation(*scaled).triangles
    except (RuntimeError, ValueError) as error:  # raised by qhull
        raise ValueError("contours need points that do not lie on one line") from error
    x, y = ([group.settings[key] for group, _ in panel] for key in keys)
    low, high = colours.get_clim()
    levels = np.linspace(low, high if high > low else low + 1.0, LEVELS + 1)
    means = [estimate.mean for _, estimate in panel]
    bands = Triangulation(x, y, triangles), means
    look: dict[str, Any] = {"levels": levels, "norm": colours.norm, "cmap": colours.get_cmap()}
    axes.tricontourf(*bands, **look).set_edgecolor("face")  # else the page shows through between two bands
    axes.plot(x, y, ls="none", marker="o", ms=2.0, color="white", mec="#111111", mew=0.5, clip_on=False)
    for axis, key in zip("xy", keys, strict=True):
        _scale(axes, key, points, axis)
    axes.set(xlabel=key_with_unit(keys[0]), ylabel=key_with_unit(keys[1]))


def _is_log(key: str, points: Sequence[Point]) -> bool:
    values = sorted({group.settings[key] for group, _ in points})
    return values[0] > 0.0 and is_wide(values)


def _scale(axes: Axes, key: str, points: Sequence[Point], axis: str = "x") -> None:
    if _is_log(key, points):
        (axes.set_xscale if axis == "x" else axes.set_yscale)("log")
