"""Pictures of many runs."""

from itertools import cycle
from math import inf, isfinite
from typing import Any

from desim.analysis.metrics import METRICS, words
from desim.analysis.plots import SERIES, Axes, Figure, styled
from desim.study.result import SweepResult, text


def means(result: SweepResult, metric: str) -> Figure:
    """Draw the mean of a metric by configuration with 95 % intervals.

    Over the first key of the grid that takes several numbers, a line for each combination of the others; if none does,
    a point for each configuration.
    """
    with styled(figsize=(6.4, 4.0)) as figure:
        axes = figure.add_subplot()
        unit = METRICS[metric].unit
        axes.set_ylabel(f"{words(metric)} ({unit})" if unit else words(metric))
        axes.set_title(f"{result.name}, 95 % intervals", fontsize=9, parse_math=False)
        abscissa = next((key for key in result.keys if _is_swept_number(result, key)), None)
        if abscissa is None:
            _draw_points(axes, result, metric)
        else:
            _draw_lines(axes, result, metric, abscissa)
    return figure


def _is_swept_number(result: SweepResult, key: str) -> bool:
    values = {group.settings[key] for group in result.groups}
    return len(values) > 1 and all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def _draw_lines(axes: Axes, result: SweepResult, metric: str, abscissa: str) -> None:
    """Draw a metric over a key, a line for each combination of the others."""
    values = sorted({group.settings[abscissa] for group in result.groups})
    finite = [value for value in values if isfinite(value)]
    logarithmic = finite[0] > 0.0 and finite[-1] > 20.0 * finite[0]
    beyond = finite[-1] * 2.0 if logarithmic else finite[-1] + 0.2 * (finite[-1] - finite[0] or 1.0)
    place = {value: value if isfinite(value) else beyond for value in values}
    lines: dict[str, list[tuple[float, Any]]] = {}
    for group, found in zip(result.groups, result.estimates(metric), strict=True):
        others = ", ".join(f"{key} = {text(each)}" for key, each in group.settings.items() if key != abscissa)
        lines.setdefault(others, []).append((place[group.settings[abscissa]], found))
    for colour, (name, points) in zip(cycle(SERIES), lines.items(), strict=False):
        x, y, error = zip(*((at, found.mean, found.half_width) for at, found in sorted(points)), strict=True)
        axes.errorbar(x, y, error, color=colour, marker="o", ms=3, lw=1.2, elinewidth=0.8, capsize=2, label=name)
    if logarithmic:
        axes.set_xscale("log")
    if inf in place or len(values) <= 8:
        axes.set_xticks([place[value] for value in values], [text(value) for value in values])
        axes.minorticks_off()
    axes.set_xlabel(abscissa)
    if len(lines) > 1:
        axes.legend(fontsize=7)


def _draw_points(axes: Axes, result: SweepResult, metric: str) -> None:
    """Draw a metric of each configuration, one beside the other."""
    names = ["\n".join(text(each) for each in group.settings.values()) for group in result.groups]
    found = result.estimates(metric)
    y, error = [each.mean for each in found], [each.half_width for each in found]
    axes.errorbar(range(len(names)), y, error, fmt="o", color=SERIES[0], ms=4, elinewidth=0.8, capsize=2)
    axes.set_xticks(range(len(names)), names, fontsize=7)
    axes.set_xlabel(", ".join(result.keys))
