"""Figures of sweeps and explanations."""

from collections.abc import Callable, Mapping, Sequence
from math import floor, inf, isfinite, log10, nan
from textwrap import fill
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from desim.analysis.drawing.palette import BLUE, GREEN, GREY, MARKERS, ORANGE, SERIES, SKY, VERMILION
from desim.analysis.drawing.plots import (
    NARROW,
    Axes,
    Figure,
    Style,
    as_it_is,
    figure_of,
    in_style,
    size_of,
    styled,
)
from desim.analysis.metrics import unit_of as unit_of_metric
from desim.analysis.metrics import words
from desim.analysis.statistics import Estimate
from desim.config.key_index import unit_of_key
from desim.config.trust import escaped
from desim.scenario.scenario import Scenario
from desim.study.plan.configurations import in_words
from desim.study.results.costs import AS_IT_IS, IDEAL, PERFECT, SILENT, Cost, CostByMetric
from desim.study.results.runs import SHOWN, Group, SweepRuns, is_number, labels_of_values, text

Panel = TypeVar("Panel")
APART = 0.012
"""The horizontal offset between points with the same abscissa, as a share of the range of the abscissa; it keeps their
error bars apart."""
MAX_TICKS = 8
"""The largest number of values with a tick if the values of a key are numbers; otherwise each value has a tick."""
MAX_ABREAST = 3
"""The largest number of panels side by side."""
PAGE = 9.4
"""The maximum width, inches, of a figure with several heat maps side by side."""
LETTER = 0.075
"""The approximate width of a letter of 8 points, inches."""
LEGEND_LETTER = 0.062
"""The approximate width of a letter in a legend, inches."""
CELL = 0.68, 0.45
"""The minimum width and the height of a cell of a heat map, inches."""
FLAT = 0.7
"""The ratio of height to width of a figure with one panel, if only its width is given."""
MAX_DECIMALS = 3
"""The largest number of decimals in a cell of a heat map."""
INK = "#111111"
"""The colour of text on light cells. It is not black, because the report replaces black with the page's text colour."""
WIDE = 20.0
"""The minimum ratio of the largest to the smallest positive value for a logarithmic axis.

Such an axis also requires that no value is negative, and that there are at least three finite positive values. Half of
these, rounded down, must be below a quarter of the largest.
"""


Point = tuple[Group, Estimate | None]
"""A configuration and the estimate of a metric; None instead of the estimate if the configuration is a reference."""


def means(
    result: SweepRuns,
    metric: str,
    *,
    x: str | None = None,
    by: str | Sequence[str] = (),
    against: Mapping[str, Any] | None = None,
    labels: Mapping[str, str] = MappingProxyType({}),
    xlabel: str | None = None,
    ylabel: str | None = None,
    size: str | None = None,
    style: Style = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw the mean of a metric by configuration, or its paired difference from a reference, with 95 % intervals.

    Args:
        result: the result of a sweep.
        metric: the name of the metric.
        x: the key on the abscissa; None = the first key not in `by` that takes several numbers. If there is none, each
            configuration has a row; but with `by`, the first other key with several values is on the abscissa.
        by: the key or keys whose values name the lines; each combination of values of the other keys has a panel. By
            default all keys but `x` name the lines, in one panel.
        against: values of some keys, such as {"protocol": "sap"}. The reference of a configuration is the configuration
            that has these values and is otherwise equal. The differences from the references are drawn instead of the
            means; see `SweepResult.differences`. None = draw the means.
        labels: texts to show in place of values, such as {"sap": "SAP (ours)"}. A label belongs to a value, or to the
            kind of a value, such as "sap" of "sap(tau=...)", if only one value has this kind. If one key names the
            lines, a label of this key is the title of the legend. Text between dollar signs is mathematics, here and
            in `xlabel` and `ylabel`.
        xlabel: the label of the abscissa; None = the name and the unit of the key or metric on it.
        ylabel: the label of the ordinate; None = the name and the unit of the metric or keys on it.
        size: the width and perhaps the height, such as "8.5cm" or "8.5cmx6cm". A figure with a size has no title: put
            the title in the caption. A figure can also be resized later with `set_size_inches`. None = a size that
            suits the panels.
        style: a style of matplotlib that replaces parts of desim's own: rcParams, the name of a style, or a list of
            these.
        ax: the axes to draw on, for a figure of several; the figure then keeps its size and its title. None = a figure
            of its own.

    Raises:
        ValueError: if the sweep has no such metric, key, value or reference, the size is invalid, or several panels do
            not fit into `ax`.
        TypeError: if `ax` is not one pair of axes of matplotlib.
    """
    keys = (by,) if isinstance(by, str) else tuple(by)
    for key in keys:
        result.values(key)  # refuses a key that the grid lacks
    labels = labels_of_values(result, labels)
    abscissa = _abscissa(result, x, keys)
    all_points = _points(result, metric, against)
    panels, flat = _panels(result, all_points, abscissa, keys), _flat(all_points)
    named = keys or [key for key in result.keys if key != abscissa]

    def draw(axes: Axes, points: Sequence[Point]) -> None:
        title = metric_with_unit(metric, result, against, labels)
        if abscissa is None:
            axes.set_xlabel(title)
            _draw_rows(axes, result.keys, points, labels)
        else:
            axes.set_ylabel(title)
            _draw_lines(axes, result, abscissa, _lines(points, abscissa, named, labels))
            if flat is not None:
                _mark_flat(axes, flat)
        if against is not None:
            (axes.axvline if abscissa is None else axes.axhline)(0.0, color=GREY, lw=0.8, zorder=0)

    legend_title = escaped(labels[named[0]]) if len(named) == 1 and named[0] in labels else title_of_legend(named)
    if ax is not None:
        figure = figure_of(ax, panels=list(panels), size=size)
        with in_style(style):
            draw(ax, next(iter(panels.values())))
            _label(ax, xlabel, ylabel)
            _add_legend_above(ax, legend_title)
        return figure
    columns = min(MAX_ABREAST, len(panels))
    rows = -(-len(panels) // columns)
    names = [] if abscissa is None else list(dict.fromkeys(line_name(group, named, labels) for group in result.groups))
    width, height = _inches(size, rows, columns, None if abscissa else len(result.groups))
    if size is None:
        height += height_of_legend(names, width)
    with styled(figsize=(width, height), font=9.0 if width >= NARROW else 8.0, style=style) as figure:
        shared = figure.subplots(rows, columns, squeeze=False, sharex=abscissa is not None, sharey=True)
        for axes, (name, points) in zip(shared.flat, panels.items(), strict=False):
            draw(axes, points)
            axes.set_title(escaped(name), fontsize=8, **as_it_is(name))
        _label_outer(shared, len(panels), xlabel, ylabel)
        if size is None:
            intervals = "95 % intervals" if against is None else "paired differences, 95 % intervals"
            over = figure.suptitle if len(panels) > 1 else shared.flat[0].set_title
            over(escaped(f"{result.name}, {intervals}"), fontsize=9, **as_it_is(result.name))
        add_legend(figure, legend_title)
    return figure


def _panels(
    result: SweepRuns, points: Sequence[Point], abscissa: str | None, keys: Sequence[str]
) -> dict[str, list[Point]]:
    """Return the points of each panel by its title, which names the values of the keys that have no other place."""
    averaged = [key for key in result.keys if keys and key not in (abscissa, *keys) and len(result.values(key)) > 1]
    panels: dict[str, list[Point]] = {}
    for group, estimate in points:
        title = in_words({key: group.settings[key] for key in averaged})
        panels.setdefault(title, []).append((group, estimate))
    return panels


def _inches(size: str | None, rows: int, columns: int, listed: int | None) -> tuple[float, float]:
    """Return the width and the height of a figure, inches.

    Args:
        size: the size that was asked for; see `means`.
        rows: the number of rows of panels.
        columns: the number of panels abreast.
        listed: the number of configurations if each has a row of its own, else None.
    """
    one_high = 4.0 if listed is None else 1.2 + 0.3 * listed
    usual = (6.4, one_high) if rows * columns == 1 else (0.6 + 2.6 * columns, 0.6 + 2.2 * rows)
    if size is None:
        return usual
    width, height = size_of(size)
    return width, height or (width * FLAT * rows / columns**0.5 if listed is None else usual[1])


def _label_outer(shared: NDArray[Any], panels: int, xlabel: str | None, ylabel: str | None) -> None:
    """Label the axes at the left and at the bottom only, and hide those without a panel."""
    columns = shared.shape[1]
    for k, axes in enumerate(shared.flat):
        _label(axes, xlabel, ylabel)
        if k % columns:
            axes.set_ylabel("")
        if k + columns < panels:
            axes.set_xlabel("")
        axes.tick_params(labelbottom=k + columns >= panels)
        axes.set_axis_on() if k < panels else axes.set_axis_off()


def file_name(kind: str, metric: str | None = None, against: Mapping[str, Any] | None = None) -> str:
    """Return the name of the file of a figure, without a suffix; figures of different metrics have different names."""
    return f"{kind if against is None else 'differences'}-{metric or SHOWN[0]}"


def _points(result: SweepRuns, metric: str, against: Mapping[str, Any] | None) -> list[Point]:
    """Return each configuration with the mean of a metric, or with its difference from a reference."""
    if against is None:
        return list(zip(result.groups, result.estimates(metric), strict=True))
    references, differences = result.references(against), result.differences(metric, against)
    return [
        (group, None if other == k else difference)
        for k, (group, other, difference) in enumerate(zip(result.groups, references, differences, strict=True))
    ]


def _abscissa(result: SweepRuns, x: str | None, by: Sequence[str]) -> str | None:
    """Return the key on the abscissa; None if each configuration has a row.

    Raises:
        ValueError: if the grid has no key `x`, or it is also in `by`.
    """
    if x is not None:
        result.values(x)
        if x in by:
            raise ValueError(f"{x} cannot be both the abscissa and the name of the lines")
        return x
    varied = [key for key in result.keys if key not in by and len(result.values(key)) > 1]
    return next((key for key in swept_numbers(result) if key in varied), varied[0] if by and varied else None)


def _label(axes: Axes, xlabel: str | None, ylabel: str | None) -> None:
    """Set the labels that are given, and let all labels wrap where the figure is too small for them."""
    if xlabel is not None:
        axes.set_xlabel(escaped(xlabel))
    if ylabel is not None:
        axes.set_ylabel(escaped(ylabel))
    axes.xaxis.label.set_wrap(True)
    axes.yaxis.label.set_wrap(True)


def multiples(result: SweepRuns, metrics: Sequence[str], *, has_legend: bool = True) -> Figure:
    """Draw several metrics by configuration, each as `means` does, in small panels with one legend.

    Args:
        result: the result of a sweep.
        metrics: the names of the metrics.
        has_legend: whether a legend names the lines; several figures of one sweep can share that of `legend`.

    Raises:
        ValueError: if there are no metrics.
    """
    if not metrics:
        raise ValueError("there should be at least one metric to draw")
    abscissa = next(iter(swept_numbers(result)), None)
    columns = min(MAX_ABREAST, len(metrics))
    rows = -(-len(metrics) // columns)
    height = 2.1 if abscissa else 0.8 + 0.2 * len(result.groups)
    line_keys = [key for key in result.keys if key != abscissa]
    lines = (
        {metric: _lines(_points(result, metric, None), abscissa, line_keys) for metric in metrics} if abscissa else {}
    )
    names = list(lines[metrics[0]]) if abscissa and has_legend else []
    width = 0.4 + 3.0 * columns
    size = (width, 0.3 + height * rows + height_of_legend(names, width))
    with styled(figsize=size, font=8.0) as figure:
        panels = figure.subplots(rows, columns, squeeze=False, sharey=abscissa is None)
        for axes, metric in zip(panels.flat, metrics, strict=False):
            axes.set_title(metric_with_unit(metric, result), loc="left")
            if abscissa is None:
                _draw_rows(axes, result.keys, _points(result, metric, None))
            else:
                _draw_lines(axes, result, abscissa, lines[metric])
                if (value := _flat(_points(result, metric, None))) is not None:
                    _mark_flat(axes, value)
        for k, axes in enumerate(panels.flat):
            if k >= len(metrics):
                axes.set_axis_off()
            if abscissa is None and k % columns:
                axes.tick_params(labelleft=False)
                axes.set_ylabel("")
            if k + columns < len(metrics):
                axes.set_xlabel("")
        if has_legend:
            add_legend(figure, title_of_legend(line_keys))
    return figure


def legend(result: SweepRuns) -> Figure | None:
    """Draw the legend of the figures of `multiples` on its own; None if their lines have no names."""
    abscissa = next(iter(swept_numbers(result)), None)
    line_keys = [key for key in result.keys if key != abscissa]
    names = [name for group in result.groups if (name := line_name(group, line_keys))] if abscissa else []
    if not names:
        return None
    names = list(dict.fromkeys(names))
    width = MAX_ABREAST * 3.0
    with styled(figsize=(width, height_of_legend(names, width)), font=8.0) as figure:
        axes = figure.add_subplot()
        axes.set_axis_off()
        for k, name in enumerate(names):
            axes.plot([], [], label=name, **look_of(k))
        add_legend(figure, title_of_legend(line_keys))
        axes.remove()
    return figure


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
    one colour scale, and one number of decimals. For the arguments see `means`.

    Raises:
        ValueError: if fewer than two keys take several numbers, or a design drew them, the sweep has no such metric,
            the size is invalid, or several panels do not fit into `ax`.
        TypeError: if `ax` is not one pair of axes of matplotlib.
    """
    keys = swept_numbers(result)
    if len(keys) < 2:
        raise ValueError(f"a heat map needs two keys that take several numbers, there are {len(keys)}")
    if result.drawn_keys:
        raise ValueError("a heat map needs a grid; the points of a design have `contour` and `scatter`")
    x, y = keys[:2]
    over = {key: sorted({group.settings[key] for group in result.groups}) for key in (x, y)}
    panels: dict[str, NDArray[np.float64]] = {}
    for group, estimate in zip(result.groups, result.estimates(metric), strict=True):
        panel = panels.setdefault(group.in_words(without=(x, y)), np.full((len(over[y]), len(over[x])), nan))
        panel[over[y].index(group.settings[y]), over[x].index(group.settings[x])] = estimate.mean
    finite = np.concatenate([panel[np.isfinite(panel)] for panel in panels.values()])
    low, high = (finite.min(), finite.max()) if finite.size else (0.0, 1.0)
    colours = ScalarMappable(Normalize(low, high), "cividis")
    form = _cell_format(finite.tolist())
    longest = max(map(len, [*(_cell_text(value, form) for value in finite.tolist()), *map(text, over[x])]), default=0)
    across = 0.4 + max(CELL[0], LETTER * (longest + 2)) * len(over[x])
    columns = max(1, min(len(panels), MAX_ABREAST, int((PAGE - 0.8) / across)))
    rows = -(-len(panels) // columns)

    def draw(axes: Axes, panel: NDArray[np.float64]) -> None:
        _draw_map(axes, panel, colours, form)
        axes.set(xlabel=key_with_unit(x), ylabel=key_with_unit(y))
        axes.set_xticks(range(len(over[x])), map(text, over[x]))
        axes.set_yticks(range(len(over[y])), map(text, over[y]))
        _label(axes, xlabel, ylabel)

    usual = (1.6 + columns * across, 0.8 + rows * (0.4 + CELL[1] * len(over[y])))
    return draw_panels(
        panels,
        draw,
        colours,
        metric_with_unit(metric, result),
        columns=columns,
        usual=usual,
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
    usual: tuple[float, float],
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
        usual: the usual width and height of the figure, inches.
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
    width, height = usual if size is None else size_of(size)
    with styled(figsize=(width, height or width * usual[1] / usual[0]), font=8.0, style=style) as figure:
        shared = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for axes, (settings, panel) in zip(shared.flat, panels.items(), strict=False):
            draw(axes, panel)
            axes.set_title(escaped(settings), fontsize=8, parse_math=False)
        for axes in shared.flat[len(panels) :]:
            axes.set_axis_off()
        for axes in shared.flat:
            axes.label_outer()
        add_colour_bar(figure, colours, shared.ravel().tolist(), title)
    return figure


def add_colour_bar(figure: Figure, colours: ScalarMappable, axes: Sequence[Axes], title: str) -> None:
    """Add the colour scale of several panels to a figure, as vector graphics."""
    bar = figure.colorbar(colours, ax=axes, label=title, fraction=0.05, pad=0.03)
    bar.outline.set_visible(False)
    if bar.solids is not None:
        bar.solids.set_rasterized(False)  # an image would have pixels even in an SVG


def _draw_map(axes: Axes, values: NDArray[np.float64], colours: ScalarMappable, form: str) -> None:
    """Draw values (rows, columns), first row at the bottom, as coloured cells with their text; "-" if not finite."""
    # Rectangles, because an image has pixels even in an SVG.
    faces = np.asarray(colours.to_rgba(values))  # (rows, columns, 4)
    for (row, column), value in np.ndenumerate(values):
        there = isfinite(value)
        red, green, blue, _ = faces[row, column].tolist()
        face = (red, green, blue) if there else "none"
        axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, facecolor=face, edgecolor="none"))
        dark = there and 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
        axes.text(column, row, _cell_text(value, form), ha="center", va="center", color="white" if dark else INK)
    axes.set(xlim=(-0.5, values.shape[1] - 0.5), ylim=(-0.5, values.shape[0] - 0.5))
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def _cell_format(values: Sequence[float]) -> str:
    """Return the common format of the cells of a heat map.

    The largest value has three significant digits, or all its integer digits, and the smallest value that is not 0 has
    one at least; beyond three decimals, all values are in scientific notation.
    """
    sizes = [abs(value) for value in values if value]
    if not sizes:
        return ".0f"
    decimals = max(0, 2 - floor(log10(max(sizes))), -floor(log10(min(sizes))))
    return f",.{decimals}f" if decimals <= MAX_DECIMALS else ".2e"


def _cell_text(value: float, form: str) -> str:
    """Return a mean as the text of a cell; a dash if it is not finite."""
    return f"{value:{form}}" if isfinite(value) else "-"


def swept_numbers(result: SweepRuns) -> list[str]:
    """Return the keys of the grid that take several numbers, at least one of them finite."""
    return [key for key in result.keys if _is_swept_number(result, key)]


def metric_with_unit(
    metric: str,
    result: SweepRuns,
    against: Mapping[str, Any] | None = None,
    labels: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Return the name and the unit of a metric, or of its difference from a reference, whose label is its name."""
    unit = f" ({unit_name})" if (unit_name := unit_of_metric(metric, result.units)) else ""
    if against is None:
        return _literal(f"{words(metric)}{unit}")
    reference = {key: text(result.setting(key, value)) for key, value in against.items()}
    if len(reference) > 1:  # values alone do not say of which keys they are
        names = ", ".join(
            f"{_label_or_text(key, labels)}{_literal(' = ')}{_label_or_text(value, labels)}"
            for key, value in reference.items()
        )
    elif any(value in labels for value in reference.values()):
        names = ", ".join(_label_or_text(value, labels) for value in reference.values())
    else:
        names = _literal(in_words(reference))
    return f"{_literal(f'difference in {words(metric)} from ')}{names}{_literal(unit)}"


def _label_or_text(name: str, labels: Mapping[str, str]) -> str:
    return escaped(labels[name]) if name in labels else _literal(name)


def key_with_unit(key: str) -> str:
    """Return a key and its unit as the label of an axis."""
    unit = unit_of_key(key, Scenario)
    return _literal(f"{key} ({unit})" if unit else key)


def _is_swept_number(result: SweepRuns, key: str) -> bool:
    values = {group.settings[key] for group in result.groups}
    numbers = all(map(is_number, values))
    return numbers and len(values) > 1 and any(map(isfinite, values))


def _draw_lines(
    axes: Axes, result: SweepRuns, abscissa: str, lines: Mapping[str, Sequence[tuple[Any, Estimate]]]
) -> None:
    """Draw estimates over a key: joined by lines if the values of the key are numbers, otherwise equally spaced."""
    swept = result.values(abscissa)
    is_number = _is_swept_number(result, abscissa)
    values = sorted(swept) if is_number else swept
    places, is_plain = (
        _axis_positions(values) if is_number else ({value: float(k) for k, value in enumerate(swept)}, False)
    )
    low, high = min(places.values()), max(places.values())
    for k, (name, points) in enumerate(lines.items()):
        if not points:
            continue
        shift = (k - (len(lines) - 1) / 2.0) * APART * (high - low)
        bars = sorted((places[value] + shift, estimate.mean, estimate.half_width) for value, estimate in points)
        x, y, error = zip(*bars, strict=True)
        look = look_of(k) | {"ls": "-" if is_number else "none"}
        axes.errorbar(x, y, error, elinewidth=0.8, capsize=2, label=name, **look)
    if len(values) <= MAX_TICKS or not is_plain:
        count = min(len(values), MAX_TICKS) if is_number else len(values)
        ticks = [values[round(k * (len(values) - 1) / max(count - 1, 1))] for k in range(count)]
        ticks = _apart(axes, ticks, places)
        axes.set_xticks([places[value] for value in ticks], [_literal(text(value)) for value in ticks])
    axes.set_xlabel(key_with_unit(abscissa))


def _apart(axes: Axes, values: Sequence[Any], places: Mapping[Any, float]) -> list[Any]:
    """Return the values, without those whose labels would touch the label before or the last one."""
    span = max(places.values()) - min(places.values()) or 1.0
    width = axes.get_position().width * axes.figure.get_figwidth()  # type: ignore[union-attr]  # a figure or a part
    letter = 0.9 * LETTER * span / width
    first, *inner, last = values if len(values) > 1 else (*values, values[0])
    kept = [first]
    for value in inner:
        gaps = places[value] - places[kept[-1]], places[last] - places[value]
        sizes = (len(text(value)) + len(text(other)) for other in (kept[-1], last))
        if all(gap > letter * (size / 2 + 0.5) for gap, size in zip(gaps, sizes, strict=True)):
            kept.append(value)
    return kept if len(values) == 1 else [*kept, last]


def look_of(k: int) -> dict[str, Any]:
    """Return the colour and the mark of line k of a diagram."""
    return {"color": SERIES[k % len(SERIES)], "marker": MARKERS[k % len(MARKERS)], "ms": 3.5, "lw": 1.2}


def _flat(points: Sequence[Point]) -> float | None:
    """Return the value that a metric has in every run of several configurations; None if there is no such value."""
    estimates = [estimate for _, estimate in points if estimate is not None and estimate.count]
    values = {estimate.mean for estimate in estimates}
    return values.pop() if len(values) == 1 and all(estimate.others is not None for estimate in estimates) else None


def _mark_flat(axes: Axes, value: float) -> None:
    """Show the one value of a metric, in place of a scale that would show rounding errors around it."""
    low = min(value, 0.0)
    axes.set_ylim(low - 0.05, low + 1.05 * (abs(value) or 1.0))
    axes.set_yticks([value], [f"{value:.4g}"])
    place: dict[str, Any] = {"transform": axes.transAxes, "ha": "right", "va": "top"}
    axes.text(0.98, 0.85, f"{value:.4g} in every run", fontsize=7, **place)


def _lines(
    points: Sequence[Point], abscissa: str, by: Sequence[str], labels: Mapping[str, str] = MappingProxyType({})
) -> dict[str, list[tuple[Any, Estimate]]]:
    """Return the lines by name, one for each combination of values of the keys `by`.

    A line is a list of pairs (value on the abscissa, estimate), without the configurations that are references.
    """
    lines: dict[str, list[tuple[Any, Estimate]]] = {}
    for group, estimate in points:
        line = lines.setdefault(line_name(group, by, labels), [])
        if estimate is not None:
            line.append((group.settings[abscissa], estimate))
    return lines


def line_name(group: Group, by: Sequence[str], labels: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the name of the line of a configuration: its values of the keys `by`."""
    return ", ".join(_named(key, group, labels, len(by) > 1) for key in by)


def _named(key: str, group: Group, labels: Mapping[str, str], is_one_of_several: bool) -> str:
    """Return the label of a setting; if it has none, its value, preceded by the key if several keys name a line."""
    value = text(group.settings[key])
    if value in labels:
        return escaped(labels[value])
    return _literal(f"{key} = {value}" if is_one_of_several else value)


def add_legend(figure: Figure, title: str | None) -> None:
    """Add a legend below all panels, outside of their axes, if the lines have names; a single line is named, too."""
    width = figure.get_figwidth()
    if handles := _handles(figure.axes):
        names = [_wrapped(name, width) for name in handles]
        look: dict[str, Any] = {"fontsize": 7, "title": title, "title_fontsize": 7}
        figure.legend(list(handles.values()), names, loc="outside lower center", ncols=_abreast(names, width), **look)


def _add_legend_above(axes: Axes, title: str | None) -> None:
    """Add a legend above axes of a figure that is not ours: only there it lies neither on data nor on labels."""
    if handles := _handles([axes]):
        place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.01), "borderaxespad": 0.0}
        columns = _abreast(list(handles), axes.get_window_extent().width / axes.figure.dpi)
        look: dict[str, Any] = {"fontsize": 7, "title": title, "title_fontsize": 7, "frameon": False}
        axes.legend(list(handles.values()), list(handles), ncols=columns, **place, **look)


def _handles(panels: Sequence[Axes]) -> dict[str, Any]:
    """Return the marks of the lines of several panels by name."""
    return {label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}


def _wrapped(name: str, width: float) -> str:
    """Return the name of a line in as many lines as a legend of a width, inches, takes; mathematics is not divided."""
    return name if "$" in name else fill(name, max(12, int((width - 0.6) / LEGEND_LETTER)), break_long_words=False)


def _abreast(names: Sequence[str], width: float) -> int:
    """Return the number of columns of a legend."""
    longest = max((len(line) for name in names for line in name.split("\n")), default=0)
    return max(1, min(len(names), int(width / (0.6 + LEGEND_LETTER * longest))))


def height_of_legend(names: Sequence[str], width: float) -> float:
    """Return the height, inches, of a legend with a title below a figure; 0 without names."""
    shown = [_wrapped(name, width) for name in names if name]
    lines = max((name.count("\n") + 1 for name in shown), default=0)
    return 0.3 + 0.15 * lines * -(-len(shown) // _abreast(shown, width)) if shown else 0.0


def title_of_legend(by: Sequence[str]) -> str | None:
    """Return the key whose values name the lines; None if there is no key, or if the names include several keys."""
    return key_with_unit(by[0]) if len(by) == 1 else None


def is_wide(values: Sequence[float]) -> bool:
    """Return whether some ascending values are drawn on a logarithmic axis; see `WIDE`."""
    positive = [value for value in values if 0.0 < value < inf]
    return (
        values[0] >= 0.0
        and len(positive) > 2
        and positive[-1] > max(WIDE * positive[0], 4.0 * positive[len(positive) // 2 - 1])
    )


def _axis_positions(values: Sequence[float]) -> tuple[dict[float, float], bool]:
    """Return the position on the axis of each of some ascending values, and whether positions equal values.

    On a logarithmic axis, 0 is drawn to the left of the other values. Infinity is always drawn to the right.
    """
    positive, logarithmic = [value for value in values if 0.0 < value < inf], is_wide(values)
    inner = positive if logarithmic else [value for value in values if isfinite(value)]
    places = {value: log10(value) if logarithmic else float(value) for value in inner}
    low, high = places[inner[0]], places[inner[-1]]
    margin = 0.2 * (high - low) or 1.0
    beyond = {value: low - margin if value < inner[0] else high + margin for value in values if value not in places}
    return places | beyond, not logarithmic and not beyond


def _draw_rows(
    axes: Axes, keys: Sequence[str], points: Sequence[Point], labels: Mapping[str, str] = MappingProxyType({})
) -> None:
    """Draw estimates with a row for each configuration."""
    names = [", ".join(_named(key, group, labels, False) for key in keys) for group, _ in points]
    bars = [(row, estimate) for row, (_, estimate) in enumerate(points) if estimate is not None]
    x, error = [estimate.mean for _, estimate in bars], [estimate.half_width for _, estimate in bars]
    look: dict[str, Any] = {"color": SERIES[0], "ms": 4, "elinewidth": 0.8, "capsize": 2}
    axes.errorbar(x, [row for row, _ in bars], xerr=error, fmt="o", **look)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_ylabel(", ".join(map(key_with_unit, keys)))


def _literal(name: str) -> str:
    """Return a text escaped for matplotlib, which reads "$" as mathematics and hides labels that begin with "_"."""
    return escaped(name).replace("$", r"\$").replace("_", " _", name.startswith("_"))


def waterfall(
    explanation: CostByMetric, *, size: str | None = None, style: Style = None, ax: Axes | None = None
) -> Figure:
    """Draw the cost of each imperfection in each metric as a waterfall chart, with 95 % intervals.

    For the arguments see `means`; each metric has a panel.

    Raises:
        ValueError: if the size or the style is invalid, or several metrics do not fit into `ax`.
        TypeError: if `ax` is not one pair of axes of matplotlib.
    """
    if ax is not None:
        figure = figure_of(ax, panels=list(explanation.costs), size=size)
        with in_style(style):
            (cost,) = explanation.costs.values()
            draw_waterfall(ax, cost)
            ax.set_ylabel(_literal(f"{cost.label} ({cost.unit})" if cost.unit else cost.label))
        return figure
    width, height = (4.4 * len(explanation.costs), None) if size is None else size_of(size)
    with styled(figsize=(width, height or 4.0), font=9.0 if width >= NARROW else 8.0, style=style) as figure:
        for axes, cost in zip(
            figure.subplots(1, len(explanation.costs), squeeze=False)[0], explanation.costs.values(), strict=True
        ):
            draw_waterfall(axes, cost)
            axes.set_ylabel(_literal(f"{cost.label} ({cost.unit})" if cost.unit else cost.label))
        title = f"{escaped(explanation.name)}: what imperfections cost, {explanation.runs} runs of equal seeds"
        if size is None:
            figure.suptitle(title, fontsize=9, parse_math=False)
    return figure


def draw_waterfall(axes: Axes, cost: Cost) -> None:
    """Draw the waterfall chart of one metric on given axes, and beside it the bounds of the network.

    An imperfection is red if it makes the metric worse, green if it makes it better, and orange if `cost.more_is` is
    None. The interaction is grey.
    """
    steps = dict(cost.parts) | ({"interaction": cost.interaction} if len(cost.parts) > 1 else {})
    names = [IDEAL, *steps, AS_IT_IS]
    last = len(names) - 1
    axes.bar([0, last], [cost.ideal.mean, cost.as_it_is.mean], color=[GREY, BLUE], width=0.6)
    _mark(axes, 0, 0.0, cost.ideal, ".2f")
    level = cost.ideal.mean
    for at, (name, step) in enumerate(steps.items(), start=1):
        is_interaction = name == "interaction"
        signs = {"worse": (VERMILION, GREEN), "better": (GREEN, VERMILION), None: (ORANGE, ORANGE)}
        colour = GREY if is_interaction else signs[cost.more_is][step.mean.mean <= 0.0]
        axes.bar(at, step.mean.mean, bottom=level, color=colour, width=0.6, hatch="//" if is_interaction else None)
        axes.plot([at - 0.7, at + 0.3], [level, level], color=GREY, lw=0.7)
        _mark(axes, at, level, step.mean, "+.2f")
        level += step.mean.mean
    _mark(axes, last, 0.0, cost.as_it_is, ".2f")
    places = list(range(len(names)))
    if cost.bounds is not None:
        bounds = {PERFECT: cost.bounds.perfect, SILENT: cost.bounds.silent}
        for place, (name, bound) in enumerate(bounds.items(), start=last + 2):
            axes.bar(place, bound.mean, color=SKY, width=0.6)
            _mark(axes, place, 0.0, bound, ".2f")
            places.append(place)
            names.append(name)
    axes.set_xticks(places, list(map(_literal, names)), fontsize=8, rotation=35, ha="right", rotation_mode="anchor")
    axes.margins(y=0.08)


def _mark(axes: Axes, at: int, base: float, estimate: Estimate, form: str) -> None:
    """Draw the 95 % interval at the end of a bar that starts at `base`, and write the height of the bar above it."""
    end = base + estimate.mean
    axes.errorbar(at, end, estimate.half_width, color="black", elinewidth=0.8, capsize=2)
    top = max(base, end + estimate.half_width)
    axes.annotate(
        f"{estimate.mean:{form}}", (at, top), textcoords="offset points", xytext=(0, 3), ha="center", fontsize=7
    )
