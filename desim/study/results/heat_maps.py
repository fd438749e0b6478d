"""Heat maps of sweeps: a metric over two keys, as coloured cells with printed values."""

from collections.abc import Callable, Mapping, Sequence
from math import floor, isfinite, log10, nan
from typing import TypeVar

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from desim.analysis.drawing.plots import Axes, Figure, Style, figure_of, in_style, styled
from desim.config.escaping import escaped
from desim.study.results.figure_labels import (
    LETTER,
    columns_of,
    key_with_unit,
    label_axes,
    metric_with_unit,
    swept_numbers,
)
from desim.study.results.runs import SweepRuns, text

Panel = TypeVar("Panel")
PAGE = 9.4
"""The maximum width, inches, of a figure with several heat maps side by side."""
CELL = 0.68, 0.45
"""The minimum width and the height of a cell of a heat map, inches."""
MAX_DECIMALS = 3
"""The largest number of decimals in a cell of a heat map."""
INK = "#111111"
"""The colour of text on light cells. It is not black, because the report replaces black with the page's text colour."""


def phase(
    result: SweepRuns,
    metric: str,
    *,
    xlabel: str | None = None,
    ylabel: str | None = None,
    size: str | None = None,
    style: Style = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw the mean of a metric over the first two keys that take several numbers, as a heat map with printed values.

    The values of a key are equally spaced. Each combination of values of the other keys has a panel; all panels share
    one colour scale, and one number of decimals. See `SweepResult.plot`.

    Raises:
        ValueError: if fewer than two keys take several numbers, a design drew them, the sweep has no such metric, the
            size is invalid, or several panels do not fit into `ax`.
        TypeError: if `ax` is not one pair of axes of matplotlib.
    """
    keys = swept_numbers(result)
    if len(keys) < 2:
        raise ValueError(f"a heat map needs two keys that take several numbers, there are {len(keys)}")
    if result.drawn_keys:
        raise ValueError("a heat map needs a grid; the points of a design have `contour` and `scatter`")
    x, y = keys[:2]
    values_of = {key: sorted({group.settings[key] for group in result.groups}) for key in (x, y)}
    panels: dict[str, NDArray[np.float64]] = {}
    for group, estimate in zip(result.groups, result.estimates(metric), strict=True):
        panel = panels.setdefault(group.in_words(without=(x, y)), np.full((len(values_of[y]), len(values_of[x])), nan))
        panel[values_of[y].index(group.settings[y]), values_of[x].index(group.settings[x])] = estimate.mean
    finite = np.concatenate([panel[np.isfinite(panel)] for panel in panels.values()])
    low, high = (finite.min(), finite.max()) if finite.size else (0.0, 1.0)
    colours = ScalarMappable(Normalize(low, high), "cividis")
    cell_format = _cell_format(finite.tolist())
    cell_texts = [_cell_text(value, cell_format) for value in finite.tolist()]
    longest = max(map(len, [*cell_texts, *map(text, values_of[x])]), default=0)
    map_width = 0.4 + max(CELL[0], LETTER * (longest + 2)) * len(values_of[x])
    columns = max(1, min(columns_of(len(panels), size, beside=1.2), int((PAGE - 0.8) / map_width)))
    rows = -(-len(panels) // columns)

    def draw(axes: Axes, panel: NDArray[np.float64]) -> None:
        _draw_map(axes, panel, colours, cell_format)
        axes.set(xlabel=key_with_unit(x), ylabel=key_with_unit(y))
        axes.set_xticks(range(len(values_of[x])), map(text, values_of[x]))
        axes.set_yticks(range(len(values_of[y])), map(text, values_of[y]))
        label_axes(axes, xlabel, ylabel)

    default_size = (1.6 + columns * map_width, 0.8 + rows * (0.4 + CELL[1] * len(values_of[y])))
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


def draw_panels(
    panels: Mapping[str, Panel],
    draw: Callable[[Axes, Panel], None],
    colours: ScalarMappable,
    title: str,
    *,
    columns: int,
    default_size: tuple[float, float],
    size: str | None,
    style: Style,
    ax: Axes | None,
) -> Figure:
    """Draw panels with one colour scale: side by side on a figure of their own, or a single one on given axes.

    Args:
        panels: what each panel shows, by its title.
        draw: draws a panel on axes.
        colours: the colour scale.
        title: what the colours show.
        columns: the number of panels abreast.
        default_size: the width and the height of the figure, inches, if `size` is None.
        size: as in `SweepResult.plot`.
        style: as in `SweepResult.plot`.
        ax: as in `SweepResult.plot`.

    Raises:
        ValueError: if the size is invalid, or several panels do not fit into `ax`.
        TypeError: if `ax` is not one pair of axes of matplotlib.
    """
    if ax is not None:
        figure = figure_of(ax, panels=list(panels), size=size)
        with in_style(style):
            draw(ax, next(iter(panels.values())))
            add_colour_bar(figure, colours, [ax], title)
        return figure
    rows = -(-len(panels) // columns)
    with styled(default_size, size, font=8.0, style=style) as figure:
        grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for axes, (settings, panel) in zip(grid.flat, panels.items(), strict=False):
            draw(axes, panel)
            axes.set_title(escaped(settings), fontsize=8, parse_math=False)
        for axes in grid.flat[len(panels) :]:
            axes.set_axis_off()
        for axes in grid.flat:
            axes.label_outer()
        add_colour_bar(figure, colours, grid.ravel().tolist(), title)
    return figure


def add_colour_bar(figure: Figure, colours: ScalarMappable, axes: Sequence[Axes], title: str) -> None:
    """Add the colour scale of several panels to a figure, as vector graphics."""
    bar = figure.colorbar(colours, ax=axes, label=title, fraction=0.05, pad=0.03)
    bar.outline.set_visible(False)
    if bar.solids is not None:
        bar.solids.set_rasterized(False)  # an image would have pixels even in an SVG
        bar.solids.set_edgecolor("face")  # else the page shows through between its parts, and changes their colours


def _draw_map(axes: Axes, values: NDArray[np.float64], colours: ScalarMappable, cell_format: str) -> None:
    """Draw values (rows, columns), first row at the bottom, as coloured cells with their text; "-" if not finite."""
    # Rectangles, because an image has pixels even in an SVG.
    faces = np.asarray(colours.to_rgba(values))  # (rows, columns, 4)
    for (row, column), value in np.ndenumerate(values):
        is_finite = isfinite(value)
        red, green, blue, _ = faces[row, column].tolist()
        face = (red, green, blue) if is_finite else "none"
        axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, facecolor=face, edgecolor="none"))
        is_dark = is_finite and 0.299 * red + 0.587 * green + 0.114 * blue < 0.5  # the luma of ITU-R BT.601
        ink = "white" if is_dark else INK
        axes.text(column, row, _cell_text(value, cell_format), ha="center", va="center", color=ink)
    axes.set(xlim=(-0.5, values.shape[1] - 0.5), ylim=(-0.5, values.shape[0] - 0.5))
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def _cell_format(values: Sequence[float]) -> str:
    """Return the common format of the cells of a heat map.

    The largest value has three significant digits, or all its integer digits, and the smallest value that is not 0 has
    one at least. If this takes more than three decimals, all values are in scientific notation.
    """
    sizes = [abs(value) for value in values if value]
    if not sizes:
        return ".0f"
    decimals = max(0, 2 - floor(log10(max(sizes))), -floor(log10(min(sizes))))
    return f",.{decimals}f" if decimals <= MAX_DECIMALS else ".2e"


def _cell_text(value: float, cell_format: str) -> str:
    """Return a mean as the text of a cell; a dash if it is not finite."""
    return f"{value:{cell_format}}" if isfinite(value) else "-"
