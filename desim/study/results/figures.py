"""Figures of sweeps: the means of metrics over a key, or in rows."""

from collections.abc import Mapping, Sequence
from math import inf, isfinite, log10
from types import MappingProxyType
from typing import Any

from numpy.typing import NDArray

from desim.analysis.drawing.palette import GREY, SERIES
from desim.analysis.drawing.plots import Axes, Figure, Style, as_it_is, figure_of, in_style, size_of, styled
from desim.analysis.statistics import Estimate
from desim.config.escaping import escaped
from desim.study.plan.configurations import in_words
from desim.study.results.figure_labels import (
    LETTER,
    MAX_ABREAST,
    add_legend,
    add_legend_above,
    columns_of,
    height_of_legend,
    is_swept_number,
    key_with_unit,
    label_axes,
    line_name,
    literal,
    look_of,
    metric_with_unit,
    setting_name,
    swept_numbers,
    title_of_legend,
)
from desim.study.results.runs import SHOWN, Group, SweepRuns, labels_of_values, text

APART = 0.012
"""The horizontal offset between points with the same abscissa, as a share of the range of the abscissa; it keeps their
error bars apart."""
MAX_TICKS = 8
"""The largest number of values with a tick if the values of a key are numbers; otherwise each value has a tick."""
ASPECT = 0.7
"""The ratio of height to width of a figure with one panel, if only its width is given."""
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

    For the arguments and errors see `SweepResult.plot`.
    """
    keys = (by,) if isinstance(by, str) else tuple(by)
    for key in keys:
        result.values(key)  # refuses a key that the grid lacks
    labels = labels_of_values(result, labels)
    abscissa = _abscissa(result, x, keys)
    all_points = _points(result, metric, against)
    panels, common_value = _panels(result, all_points, abscissa, keys), _common_value(all_points)
    line_keys = keys or [key for key in result.keys if key != abscissa]

    def draw(axes: Axes, points: Sequence[Point]) -> None:
        title = metric_with_unit(metric, result, against, labels)
        if abscissa is None:
            axes.set_xlabel(title)
            _draw_rows(axes, result.keys, points, labels)
        else:
            axes.set_ylabel(title)
            _draw_lines(axes, result, abscissa, _lines(points, abscissa, line_keys, labels))
            if common_value is not None:
                _mark_common_value(axes, common_value)
        if against is not None:
            (axes.axvline if abscissa is None else axes.axhline)(0.0, color=GREY, lw=0.8, zorder=0)

    has_label = len(line_keys) == 1 and line_keys[0] in labels
    legend_title = escaped(labels[line_keys[0]]) if has_label else title_of_legend(line_keys)
    if ax is not None:
        figure = figure_of(ax, panels=list(panels), size=size)
        with in_style(style):
            draw(ax, next(iter(panels.values())))
            label_axes(ax, xlabel, ylabel)
            add_legend_above(ax, legend_title)
        return figure
    columns = columns_of(len(panels), size)
    rows = -(-len(panels) // columns)
    names = _names_of_lines(result, abscissa, line_keys, labels)
    width, height = _inches(size, rows, columns, None if abscissa else len(result.groups))
    if size is None:
        height += height_of_legend(names, width)
    with styled((width, height), style=style) as figure:
        grid = figure.subplots(rows, columns, squeeze=False, sharex=abscissa is not None, sharey=True)
        for axes, (name, points) in zip(grid.flat, panels.items(), strict=False):
            draw(axes, points)
            axes.set_title(as_it_is(name), fontsize=8, wrap=True)
        _label_outer(grid, len(panels), xlabel, ylabel)
        if size is None:
            intervals = "95 % intervals" if against is None else "paired differences, 95 % intervals"
            set_heading = figure.suptitle if len(panels) > 1 else grid.flat[0].set_title
            set_heading(as_it_is(f"{result.name}, {intervals}"), fontsize=9, wrap=True)
        add_legend(figure, legend_title)
    return figure


def _panels(
    result: SweepRuns, points: Sequence[Point], abscissa: str | None, keys: Sequence[str]
) -> dict[str, list[Point]]:
    """Return the points of each panel by its title: the values of the keys neither on the abscissa nor in `keys`."""
    panel_keys = [key for key in result.keys if keys and key not in (abscissa, *keys) and len(result.values(key)) > 1]
    panels: dict[str, list[Point]] = {}
    for group, estimate in points:
        title = in_words({key: group.settings[key] for key in panel_keys})
        panels.setdefault(title, []).append((group, estimate))
    return panels


def _inches(size: str | None, rows: int, columns: int, configurations: int | None) -> tuple[float, float]:
    """Return the width and height, inches, of a figure with rows and columns of panels; for `size` see `means`.

    `configurations` is the number of configurations if each has a row of its own, else None.
    """
    single_height = 4.0 if configurations is None else 1.2 + 0.3 * configurations
    default = (6.4, single_height) if rows * columns == 1 else (0.6 + 2.6 * columns, 0.6 + 2.2 * rows)
    if size is None:
        return default
    width, height = size_of(size)
    return width, height or (width * ASPECT * rows / columns**0.5 if configurations is None else default[1])


def _label_outer(grid: NDArray[Any], panels: int, xlabel: str | None, ylabel: str | None) -> None:
    """Label the axes at the left and at the bottom only, and hide those without a panel."""
    columns = grid.shape[1]
    for k, axes in enumerate(grid.flat):
        label_axes(axes, xlabel, ylabel)
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

    Without `x`, it is the first key not in `by` with several numbers. If no key has several numbers and `by` names
    keys, it is the first key not in `by` with several values.

    Raises:
        ValueError: if the grid has no key `x`, or it is also in `by`.
    """
    if x is not None:
        result.values(x)  # refuses a key that the grid lacks
        if x in by:
            raise ValueError(f"`x` and `by` should be different keys (got {x} for both)")
        return x
    varied = [key for key in result.keys if key not in by and len(result.values(key)) > 1]
    return next((key for key in swept_numbers(result) if key in varied), varied[0] if by and varied else None)


def multiples(result: SweepRuns, metrics: Sequence[str], *, has_legend: bool = True) -> Figure:
    """Draw several metrics by configuration, each as `means` does, in small panels with one legend.

    Args:
        result: the result of a sweep.
        metrics: the names of the metrics.
        has_legend: whether a legend names the lines; several figures of one sweep can share the legend of `legend`.

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
    names = _names_of_lines(result, abscissa, line_keys) if has_legend else []
    width = 0.4 + 3.0 * columns
    size = (width, 0.3 + height * rows + height_of_legend(names, width))
    with styled(figsize=size, font=8.0) as figure:
        panels = figure.subplots(rows, columns, squeeze=False, sharey=abscissa is None)
        for axes, metric in zip(panels.flat, metrics, strict=False):
            axes.set_title(metric_with_unit(metric, result), loc="left")
            points = _points(result, metric, None)
            if abscissa is None:
                _draw_rows(axes, result.keys, points)
            else:
                _draw_lines(axes, result, abscissa, _lines(points, abscissa, line_keys))
                if (value := _common_value(points)) is not None:
                    _mark_common_value(axes, value)
        for k, axes in enumerate(panels.flat):
            if k >= len(metrics):
                axes.set_axis_off()
            if abscissa is None and k % columns:
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
    names = [name for name in _names_of_lines(result, abscissa, line_keys) if name]
    if not names:
        return None
    width = MAX_ABREAST * 3.0
    with styled(figsize=(width, height_of_legend(names, width)), font=8.0) as figure:
        axes = figure.add_subplot()
        axes.set_axis_off()
        for k, name in enumerate(names):
            axes.plot([], [], label=name, **look_of(k))
        add_legend(figure, title_of_legend(line_keys))
        axes.remove()  # they only gave the legend its lines
    figure.set_figwidth(figure.legends[0].get_window_extent().width / figure.dpi)  # no margins: a phone would shrink it
    return figure


def _names_of_lines(
    result: SweepRuns, abscissa: str | None, by: Sequence[str], labels: Mapping[str, str] = MappingProxyType({})
) -> list[str]:
    """Return the names of the lines over a key, in their order; none if each configuration has a row."""
    return list(dict.fromkeys(line_name(group, by, labels) for group in result.groups)) if abscissa else []


def _draw_lines(
    axes: Axes, result: SweepRuns, abscissa: str, lines: Mapping[str, Sequence[tuple[Any, Estimate]]]
) -> None:
    """Draw estimates over a key: joined by lines if the values of the key are numbers, otherwise equally spaced."""
    values = result.values(abscissa)
    if is_number := is_swept_number(result, abscissa):
        values = sorted(values)
        places, is_identity = _axis_positions(values)
    else:
        places, is_identity = {value: float(k) for k, value in enumerate(values)}, False
    low, high = min(places.values()), max(places.values())
    axes.update_datalim([(low, 0.0), (high, 0.0)], updatey=False)  # a reference has no points, and yet a tick
    for k, (name, points) in enumerate(lines.items()):
        if not points:
            continue
        shift = (k - (len(lines) - 1) / 2.0) * APART * (high - low)
        bars = sorted((places[value] + shift, estimate.mean, estimate.bars) for value, estimate in points)
        x, y, ends = zip(*bars, strict=True)
        error = list(zip(*ends, strict=True))
        look = look_of(k) | {"ls": "-" if is_number else "none"}
        axes.errorbar(x, y, error, elinewidth=0.8, capsize=2, label=name, **look)
    if len(values) <= MAX_TICKS or not is_identity:  # matplotlib's own ticks fit only values at their own position
        count = min(len(values), MAX_TICKS) if is_number else len(values)
        ticks = [values[round(k * (len(values) - 1) / max(count - 1, 1))] for k in range(count)]
        ticks = _without_overlap(axes, ticks, places)
        axes.set_xticks([places[value] for value in ticks], [literal(text(value)) for value in ticks])
    axes.set_xlabel(key_with_unit(abscissa))


def _without_overlap(axes: Axes, values: Sequence[Any], places: Mapping[Any, float]) -> list[Any]:
    """Return the values without those whose tick labels would touch the label before or the last one."""
    if len(values) < 2:
        return list(values)
    span = max(places.values()) - min(places.values()) or 1.0
    width = axes.get_position().width * axes.figure.get_figwidth()  # type: ignore[union-attr]  # a figure or a part
    letter = 0.9 * LETTER * span / width  # the width of a letter in the unit of `places`
    first, *inner, last = values
    kept = [first]
    for value in inner:
        gaps = places[value] - places[kept[-1]], places[last] - places[value]
        sizes = (len(text(value)) + len(text(other)) for other in (kept[-1], last))
        if all(gap > letter * (size / 2 + 0.5) for gap, size in zip(gaps, sizes, strict=True)):
            kept.append(value)
    return [*kept, last]


def _common_value(points: Sequence[Point]) -> float | None:
    """Return the value that a metric has in every run of several configurations; None if there is no such value."""
    estimates = [estimate for _, estimate in points if estimate is not None and estimate.count]
    values = {estimate.mean for estimate in estimates}
    return values.pop() if len(values) == 1 and all(estimate.others is not None for estimate in estimates) else None


def _mark_common_value(axes: Axes, value: float) -> None:
    """Show the one value of a metric, in place of a scale that would show rounding errors around it."""
    low = min(value, 0.0)
    if isfinite(value):
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


def is_wide(values: Sequence[float]) -> bool:
    """Return whether some ascending values are drawn on a logarithmic axis; see `WIDE`."""
    positive = [value for value in values if 0.0 < value < inf]
    return (
        values[0] >= 0.0
        and len(positive) > 2
        and positive[-1] > max(WIDE * positive[0], 4.0 * positive[len(positive) // 2 - 1])
    )


def _axis_positions(values: Sequence[float]) -> tuple[dict[float, float], bool]:
    """Return the position on the axis of each of some ascending values, and whether each position equals its value.

    On a logarithmic axis, 0 is drawn to the left of the other values. Infinity is always drawn to the right.
    """
    positive, logarithmic = [value for value in values if 0.0 < value < inf], is_wide(values)
    on_scale = positive if logarithmic else [value for value in values if isfinite(value)]
    places = {value: log10(value) if logarithmic else float(value) for value in on_scale}
    low, high = places[on_scale[0]], places[on_scale[-1]]
    margin = 0.2 * (high - low) or 1.0
    beyond = {value: low - margin if value < on_scale[0] else high + margin for value in values if value not in places}
    return places | beyond, not logarithmic and not beyond


def _draw_rows(
    axes: Axes, keys: Sequence[str], points: Sequence[Point], labels: Mapping[str, str] = MappingProxyType({})
) -> None:
    """Draw estimates with a row for each configuration."""
    names = [", ".join(setting_name(key, group, labels, False) for key in keys) for group, _ in points]
    bars = [(row, estimate) for row, (_, estimate) in enumerate(points) if estimate is not None]
    x = [estimate.mean for _, estimate in bars]
    error = list(zip(*(estimate.bars for _, estimate in bars), strict=True)) or None
    look: dict[str, Any] = {"color": SERIES[0], "ms": 4, "elinewidth": 0.8, "capsize": 2}
    axes.errorbar(x, [row for row, _ in bars], xerr=error, fmt="o", **look)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_ylabel(", ".join(map(key_with_unit, keys)))
