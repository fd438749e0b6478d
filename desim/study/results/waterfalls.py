"""Waterfall charts of explanations: what each imperfection costs."""

from collections.abc import Mapping
from math import isnan

from desim.analysis.drawing.palette import BLUE, GREEN, GREY, ORANGE, SKY, VERMILION
from desim.analysis.drawing.plots import Axes, Figure, Style, figure_of, in_style, size_of, styled
from desim.analysis.statistics import Estimate
from desim.analysis.tables import decimals_of
from desim.config.escaping import escaped
from desim.config.number_texts import counted
from desim.kernel.core.portable_math import portable_sum
from desim.study.results.costs import AS_IT_IS, IDEAL, PERFECT, SILENT, Cost
from desim.study.results.figure_labels import literal

BAR = 0.42
"""The minimum width of a bar with its gap, inches, so that its number fits above it."""


def waterfall(
    name: str,
    runs: int,
    costs: Mapping[str, Cost],
    *,
    size: str | None = None,
    style: Style = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw the cost of each imperfection as a waterfall chart with 95 % intervals, with a panel for each metric.

    The first three arguments are fields of an `Explanation`. For the size, style and axes see `Explanation.plot`.

    Raises:
        ValueError: if the size or the style is invalid, or several metrics do not fit into `ax`.
        TypeError: if `ax` is not one pair of axes of matplotlib.
    """
    if ax is not None:
        figure = figure_of(ax, panels=list(costs), size=size)
        with in_style(style):
            (cost,) = costs.values()
            draw_waterfall(ax, cost)
        return figure
    default_width = portable_sum(max(4.4, BAR * _bars(cost)) for cost in costs.values())
    width, height = (default_width, None) if size is None else size_of(size)
    with styled((width, height or 4.0), style=style) as figure:
        panels = figure.subplots(1, len(costs), squeeze=False)[0]
        for axes, cost in zip(panels, costs.values(), strict=True):
            draw_waterfall(axes, cost)
        if size is None:
            title = f"{escaped(name)}: what imperfections cost, {counted(runs, 'run')} of equal seeds"
            figure.suptitle(title, fontsize=9, parse_math=False)
    return figure


def _bars(cost: Cost) -> int:
    """Return the number of bars of a waterfall chart; the gap before the bounds counts as a bar."""
    return len(cost.parts) + 2 + (len(cost.parts) > 1) + (0 if cost.bounds is None else 3)


def draw_waterfall(axes: Axes, cost: Cost) -> None:
    """Draw the waterfall chart of one metric on given axes, and beside it the bounds of the network.

    An imperfection is red if it makes the metric worse, green if it makes it better, and orange if `cost.more_is` is
    None. The interaction is grey.
    """
    steps = dict(cost.parts) | ({"interaction": cost.interaction} if len(cost.parts) > 1 else {})
    names = [IDEAL, *steps, AS_IT_IS]
    last = len(names) - 1
    axes.bar([0, last], [cost.ideal.mean, cost.as_it_is.mean], color=[GREY, BLUE], width=0.6)
    _mark(axes, 0, 0.0, cost.ideal)
    level = cost.ideal.mean
    for place, (name, step) in enumerate(steps.items(), start=1):
        is_interaction = name == "interaction"
        colours = {"worse": (VERMILION, GREEN), "better": (GREEN, VERMILION), None: (ORANGE, ORANGE)}
        colour = GREY if is_interaction else colours[cost.more_is][step.mean.mean <= 0.0]
        axes.bar(place, step.mean.mean, bottom=level, color=colour, width=0.6, hatch="//" if is_interaction else None)
        axes.plot([place - 0.7, place + 0.3], [level, level], color=GREY, lw=0.7)
        _mark(axes, place, level, step.mean, "+z")  # "z": a cost that is rounded to 0 has no minus sign
        level += step.mean.mean
    _mark(axes, last, 0.0, cost.as_it_is)
    places = list(range(len(names)))
    if cost.bounds is not None:
        bounds = {PERFECT: cost.bounds.perfect, SILENT: cost.bounds.silent}
        for place, (name, bound) in enumerate(bounds.items(), start=last + 2):
            axes.bar(place, bound.mean, color=SKY, width=0.6)
            _mark(axes, place, 0.0, bound)
            places.append(place)
            names.append(name)
    axes.set_xticks(places, list(map(literal, names)), fontsize=8, rotation=35, ha="right", rotation_mode="anchor")
    axes.margins(y=0.08)
    axes.set_ylabel(literal(f"{cost.label} ({cost.unit})" if cost.unit else cost.label))


def _mark(axes: Axes, place: int, base: float, estimate: Estimate, sign: str = "") -> None:
    """Draw the 95 % interval at the end of a bar that starts at `base`, and write the height of the bar above it."""
    end = base + estimate.mean
    below, above = estimate.bars
    axes.errorbar(place, end, [[below], [above]], color="black", elinewidth=0.8, capsize=2)
    top = max(base, end if isnan(above) else end + above)
    text = f"{estimate.mean:{sign}.{decimals_of(abs(estimate.mean), 2)}f}"
    axes.annotate(text, (place, top), textcoords="offset points", xytext=(0, 3), ha="center", fontsize=7)
