"""Figures of sweeps and explanations."""

import re
from collections.abc import Iterator, Sequence
from functools import cache
from math import inf, isfinite, log10, nan

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from desim.analysis.metrics import unit_of as unit_of_metric
from desim.analysis.metrics import words
from desim.analysis.palette import BLUE, GREEN, GREY, ORANGE, SERIES, VERMILION
from desim.analysis.plots import Axes, Figure, styled
from desim.analysis.statistics import Estimate
from desim.config.choice import choices_of
from desim.config.model import fields_of, models_in
from desim.config.trust import escaped
from desim.study.explanation import AS_IT_IS, IDEAL, Cost, Explanation
from desim.study.result import SweepResult, text

MARKERS = "osD^v"
APART = 0.012
"""The horizontal offset between points with the same abscissa, as a share of the range of the abscissa; it keeps their
error bars apart."""
MAX_TICKS = 8
"""The largest number of ticks that mark values of a key."""
MAX_ABREAST = 3
"""The largest number of panels side by side."""
PAGE = 9.4
"""The maximum width of a figure with many panels, in."""
LETTER = 0.075
"""The approximate width of a letter of 8 points, in."""
CELL = 0.68, 0.45
"""The minimum width and the height of a cell of a phase diagram, in."""
INK = "#111111"
"""The colour of text on light cells. It is not black, because the report replaces black with the page's text colour."""
WIDE = 20.0
"""The minimum ratio of the largest to the smallest positive value for a logarithmic axis.

Such an axis also requires that half of the positive values are below a quarter of the largest.
"""


def means(result: SweepResult, metric: str) -> Figure:
    """Draw the mean of a metric by configuration with 95 % intervals.

    The abscissa is the first key of the grid that takes several numbers, with a line for each combination of the other
    keys. If no key does, each configuration has a row.
    """
    title = _with_unit(metric, result)
    abscissa = next(iter(swept_numbers(result)), None)
    height = 4.0 if abscissa else 1.2 + 0.3 * len(result.groups)
    with styled(figsize=(6.4, height)) as figure:
        axes = figure.add_subplot()
        axes.set_title(escaped(f"{result.name}, 95 % intervals"), fontsize=9, parse_math=False)
        if abscissa is None:
            axes.set_xlabel(title)
            _draw_rows(axes, result, metric)
        else:
            axes.set_ylabel(title)
            _draw_lines(axes, result, metric, abscissa)
            _add_legend(axes, result, abscissa)
    return figure


def multiples(result: SweepResult, metrics: Sequence[str]) -> Figure:
    """Draw several metrics by configuration, each as `means` does, in small panels with one legend.

    Raises:
        ValueError: if there are no metrics.
    """
    if not metrics:
        raise ValueError("there should be at least one metric to draw")
    abscissa = next(iter(swept_numbers(result)), None)
    columns = min(MAX_ABREAST, len(metrics))
    rows = -(-len(metrics) // columns)
    height = 2.1 if abscissa else 0.8 + 0.2 * len(result.groups)
    names = list(_lines(result, metrics[0], abscissa)) if abscissa else []
    width = 0.4 + 3.0 * columns
    abreast = max(1, int(width / (0.6 + LETTER * max(map(len, names), default=0))))
    size = (width, 0.3 + height * rows + 0.17 * -(-len(names) // abreast))
    with styled(figsize=size, font=8.0) as figure:
        panels = figure.subplots(rows, columns, squeeze=False, sharey=abscissa is None)
        for axes, metric in zip(panels.flat, metrics, strict=False):
            axes.set_title(_with_unit(metric, result), loc="left")
            if abscissa is None:
                _draw_rows(axes, result, metric)
            else:
                _draw_lines(axes, result, metric, abscissa)
        for k, axes in enumerate(panels.flat):
            if k >= len(metrics):
                axes.set_axis_off()
            if abscissa is None and k % columns:
                axes.tick_params(labelleft=False)
                axes.set_ylabel("")
            if k + columns < len(metrics):
                axes.set_xlabel("")
        if len(names) > 1:
            found = panels.flat[0].get_legend_handles_labels()
            title = _legend_title(result, abscissa)
            figure.legend(*found, loc="outside lower center", ncols=abreast, title=title, title_fontsize=8)
        figure.draw_without_rendering()  # a first layout: the legend shrinks the panels, which changes their ticks
    return figure


def phase(result: SweepResult, metric: str) -> Figure:
    """Draw the mean of a metric over the first two keys that take several numbers, as a heat map with printed values.

    The values of a key are equally spaced. Each combination of the other keys has a panel; all panels share one colour
    scale.

    Raises:
        ValueError: if fewer than two keys take several numbers.
    """
    keys = swept_numbers(result)
    if len(keys) < 2:
        raise ValueError(f"a phase diagram needs two keys that take several numbers, there are {len(keys)}")
    x, y = keys[:2]
    over = {key: sorted({group.settings[key] for group in result.groups}) for key in (x, y)}
    panels: dict[str, NDArray[np.float64]] = {}
    for group, found in zip(result.groups, result.estimates(metric), strict=True):
        panel = panels.setdefault(group.in_words(without=(x, y)), np.full((len(over[y]), len(over[x])), nan))
        panel[over[y].index(group.settings[y]), over[x].index(group.settings[x])] = found.mean
    known = np.concatenate([panel[np.isfinite(panel)] for panel in panels.values()])
    low, high = (known.min(), known.max()) if known.size else (0.0, 1.0)
    colours = ScalarMappable(Normalize(low, high), "cividis")
    longest = max(map(len, [*map(_cell_text, known.tolist()), *map(text, over[x])]), default=0)
    across = 0.4 + max(CELL[0], LETTER * (longest + 2)) * len(over[x])
    columns = max(1, min(len(panels), MAX_ABREAST, int((PAGE - 0.8) / across)))
    rows = -(-len(panels) // columns)
    size = (0.8 + columns * across, 0.8 + rows * (0.4 + CELL[1] * len(over[y])))
    with styled(figsize=size, font=8.0) as figure:
        shared = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for axes, (others, panel) in zip(shared.flat, panels.items(), strict=False):
            _draw_map(axes, panel, colours)
            axes.set_title(escaped(others), fontsize=8, parse_math=False)
            axes.set(xlabel=_key_with_unit(x), ylabel=_key_with_unit(y))
            axes.set_xticks(range(len(over[x])), map(text, over[x]))
            axes.set_yticks(range(len(over[y])), map(text, over[y]))
        for axes in shared.flat[len(panels) :]:
            axes.set_axis_off()
        for axes in shared.flat:
            axes.label_outer()
        figure.suptitle(_with_unit(metric, result), fontsize=8)
    return figure


def _draw_map(axes: Axes, values: NDArray[np.float64], colours: ScalarMappable) -> None:
    """Draw values (rows, columns), first row at the bottom, as coloured cells with their text; "-" if not finite."""
    # Rectangles, because an image has pixels even in an SVG.
    faces = np.asarray(colours.to_rgba(values))  # (rows, columns, 4)
    for (row, column), value in np.ndenumerate(values):
        there = isfinite(value)
        red, green, blue, _ = faces[row, column].tolist()
        face = (red, green, blue) if there else "none"
        axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, facecolor=face, edgecolor="none"))
        dark = there and 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
        axes.text(column, row, _cell_text(value), ha="center", va="center", color="white" if dark else INK)
    axes.set(xlim=(-0.5, values.shape[1] - 0.5), ylim=(-0.5, values.shape[0] - 0.5))
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def _cell_text(value: float) -> str:
    """Return a mean as the text of a cell: three significant digits, or all integer digits from 1000 on."""
    if not isfinite(value):
        return "-"
    return f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"


def swept_numbers(result: SweepResult) -> list[str]:
    """Return the keys of the grid that take several numbers, at least one of them finite."""
    return [key for key in result.keys if _is_swept_number(result, key)]


def _with_unit(metric: str, result: SweepResult) -> str:
    unit = unit_of_metric(metric, result.units)
    return _literal(f"{words(metric)} ({unit})" if unit else words(metric))


def _key_with_unit(key: str) -> str:
    unit = unit_of(key)
    return _literal(f"{key} ({unit})" if unit else key)


def _is_swept_number(result: SweepResult, key: str) -> bool:
    values = {group.settings[key] for group in result.groups}
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    return numbers and len(values) > 1 and any(map(isfinite, values))


def _draw_lines(axes: Axes, result: SweepResult, metric: str, abscissa: str) -> None:
    """Draw a metric over a key, with a line for each combination of the other keys."""
    values = sorted({group.settings[abscissa] for group in result.groups})
    places, is_plain = _axis_positions(values)
    lines = _lines(result, metric, abscissa)
    low, high = min(places.values()), max(places.values())
    for k, (name, points) in enumerate(lines.items()):
        marker, colour = MARKERS[k % len(MARKERS)], SERIES[k % len(SERIES)]  # 5 * 6 different pairs
        shift = (k - (len(lines) - 1) / 2.0) * APART * (high - low)
        known = sorted((places[value] + shift, each.mean, each.half_width) for value, each in points)
        x, y, error = zip(*known, strict=True)
        axes.errorbar(x, y, error, color=colour, marker=marker, ms=3.5, lw=1.2, elinewidth=0.8, capsize=2, label=name)
    if len(values) <= MAX_TICKS or not is_plain:
        count = min(len(values), MAX_TICKS)
        ticks = [values[round(k * (len(values) - 1) / (count - 1))] for k in range(count)]
        axes.set_xticks([places[value] for value in ticks], [text(value) for value in ticks])
    axes.set_xlabel(_key_with_unit(abscissa))


def _lines(result: SweepResult, metric: str, abscissa: str) -> dict[str, list[tuple[float, Estimate]]]:
    """Return the lines by name, one for each combination of the other keys: pairs of abscissa and estimate."""
    others = [key for key in result.keys if key != abscissa]
    lines: dict[str, list[tuple[float, Estimate]]] = {}
    for group, found in zip(result.groups, result.estimates(metric), strict=True):
        given = [text(group.settings[key]) for key in others]
        if len(others) > 1:
            given = [f"{key} = {each}" for key, each in zip(others, given, strict=True)]
        lines.setdefault(_literal(", ".join(given)), []).append((group.settings[abscissa], found))
    return lines


def _add_legend(axes: Axes, result: SweepResult, abscissa: str) -> None:
    if len(axes.get_legend_handles_labels()[0]) > 1:
        axes.legend(fontsize=7, title=_legend_title(result, abscissa), title_fontsize=7)


def _legend_title(result: SweepResult, abscissa: str | None) -> str | None:
    """Return the key whose values name the lines; None if there is no key, or if the names include several keys."""
    others = [key for key in result.keys if key != abscissa]
    return _key_with_unit(others[0]) if len(others) == 1 else None


def _axis_positions(values: Sequence[float]) -> tuple[dict[float, float], bool]:
    """Return the position of each value of a key on the axis, and whether the positions equal the values.

    On a logarithmic axis, 0 is drawn to the left of the other values. Infinity is always drawn to the right.
    """
    positive = [value for value in values if 0.0 < value < inf]
    logarithmic = (
        values[0] >= 0.0
        and len(positive) > 2
        and positive[-1] > max(WIDE * positive[0], 4.0 * positive[len(positive) // 2 - 1])
    )
    inner = positive if logarithmic else [value for value in values if isfinite(value)]
    places = {value: log10(value) if logarithmic else float(value) for value in inner}
    low, high = places[inner[0]], places[inner[-1]]
    margin = 0.2 * (high - low) or 1.0
    beyond = {value: low - margin if value < inner[0] else high + margin for value in values if value not in places}
    return places | beyond, not logarithmic and not beyond


def _draw_rows(axes: Axes, result: SweepResult, metric: str) -> None:
    """Draw a metric with a row for each configuration."""
    names = [_literal(", ".join(map(text, group.settings.values()))) for group in result.groups]
    found = result.estimates(metric)
    x, error = [each.mean for each in found], [each.half_width for each in found]
    axes.errorbar(x, range(len(names)), xerr=error, fmt="o", color=SERIES[0], ms=4, elinewidth=0.8, capsize=2)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_ylabel(", ".join(map(_key_with_unit, result.keys)))


def _literal(name: str) -> str:
    """Return a text escaped for matplotlib, which reads "$" as mathematics and hides labels that begin with "_"."""
    return escaped(name).replace("$", r"\$").replace("_", " _", name.startswith("_"))


def waterfall(found: Explanation) -> Figure:
    """Draw the cost of each imperfection in each metric as a waterfall chart, with 95 % intervals."""
    with styled(figsize=(4.4 * len(found.costs), 4.0)) as figure:
        for axes, cost in zip(
            figure.subplots(1, len(found.costs), squeeze=False)[0], found.costs.values(), strict=True
        ):
            draw_waterfall(axes, cost)
            axes.set_ylabel(_literal(f"{cost.label} ({cost.unit})" if cost.unit else cost.label))
        title = f"{escaped(found.name)}: what imperfections cost, {found.runs} runs of equal seeds"
        figure.suptitle(title, fontsize=9, parse_math=False)
    return figure


def draw_waterfall(axes: Axes, cost: Cost) -> None:
    """Draw the waterfall chart of one metric on given axes: red if an imperfection makes it worse, green if better."""
    steps = dict(cost.parts) | ({"interaction": cost.interaction} if len(cost.parts) > 1 else {})
    names = [IDEAL, *steps, AS_IT_IS]
    last = len(names) - 1
    axes.bar([0, last], [cost.ideal.mean, cost.as_it_is.mean], color=[GREY, BLUE], width=0.6)
    _mark(axes, 0, 0.0, cost.ideal, ".2f")
    level = cost.ideal.mean
    for at, (name, step) in enumerate(steps.items(), start=1):
        rest = name == "interaction"
        signs = {"worse": (VERMILION, GREEN), "better": (GREEN, VERMILION), None: (ORANGE, ORANGE)}
        colour = GREY if rest else signs[cost.more_is][step.mean.mean <= 0.0]
        axes.bar(at, step.mean.mean, bottom=level, color=colour, width=0.6, hatch="//" if rest else None)
        axes.plot([at - 0.7, at + 0.3], [level, level], color=GREY, lw=0.7)
        _mark(axes, at, level, step.mean, "+.2f")
        level += step.mean.mean
    _mark(axes, last, 0.0, cost.as_it_is, ".2f")
    axes.set_xticks(
        range(len(names)), list(map(_literal, names)), fontsize=8, rotation=35, ha="right", rotation_mode="anchor"
    )
    axes.margins(y=0.08)


def _mark(axes: Axes, at: int, base: float, found: Estimate, form: str) -> None:
    """Draw the 95 % interval at the end of a bar that starts at `base`, and write the height of the bar above."""
    end = base + found.mean
    axes.errorbar(at, end, found.half_width, color="black", elinewidth=0.8, capsize=2)
    top = max(base, end + found.half_width)
    axes.annotate(f"{found.mean:{form}}", (at, top), textcoords="offset points", xytext=(0, 3), ha="center", fontsize=7)


UNIT = re.compile(r", (1/s|m/s|rad/s|rad/sqrt\(s\)|bit/s|Hz|kHz|dB|dBm|rad|s|m)(?=[;:,.]|$)")
"""Finds the unit in a description, such as "Mean one-way latency, s."."""


@cache
def unit_of(key: str) -> str | None:
    """Return the unit of a dotted key; None if it has none, or different units in different kinds of its tables."""
    from desim.scenario.scenario import Scenario

    fields: list[FieldInfo] = []
    models: list[type[BaseModel]] = [Scenario]
    for part in (each for each in key.split(".") if not each.isdigit()):
        fields = [fields_of(model)[part] for model in models if part in model.model_fields]
        models = [model for field in fields for model in _models_of(field)]
    units = {found[1] if (found := UNIT.search(field.description or "")) else None for field in fields}
    return units.pop() if len(units) == 1 else None


def _models_of(field: FieldInfo) -> Iterator[type[BaseModel]]:
    """Yield the models that a field may hold."""
    for choice in choices_of(field):
        yield from choice.choices().values()
    yield from models_in(field.annotation)
