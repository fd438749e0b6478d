"""Pictures of many runs."""

from collections.abc import Sequence
from itertools import product
from math import inf, isfinite, log10

from desim.analysis.metrics import METRICS, words
from desim.analysis.plots import BLUE, GREEN, GREY, SERIES, VERMILION, Axes, Figure, styled
from desim.analysis.statistics import Estimate
from desim.study.explain import AS_IT_IS, EXPLAINED, IDEAL, Cost, Explanation
from desim.study.result import SweepResult, text

MARKERS = "osD^v"
APART = 0.012
"""How far apart points of the same abscissa are drawn, so that their error bars are seen, as a share of its range."""
MOST_TICKS = 8
"""How many values of a key have a tick of their own."""
WIDE = 20.0
"""By what factor positive values should range for a logarithmic axis, and half of them lie below a quarter."""


def means(result: SweepResult, metric: str) -> Figure:
    """Draw the mean of a metric by configuration with 95 % intervals.

    Over the first key of the grid that takes several numbers, a line for each combination of the others; if none does,
    a row for each configuration.
    """
    unit = METRICS[metric].unit
    title = f"{words(metric)} ({unit})" if unit else words(metric)
    abscissa = next((key for key in result.keys if _is_swept_number(result, key)), None)
    height = 4.0 if abscissa else 1.2 + 0.3 * len(result.groups)
    with styled(figsize=(6.4, height)) as figure:
        axes = figure.add_subplot()
        axes.set_title(f"{result.name}, 95 % intervals", fontsize=9, parse_math=False)
        if abscissa is None:
            axes.set_xlabel(title)
            _draw_rows(axes, result, metric)
        else:
            axes.set_ylabel(title)
            _draw_lines(axes, result, metric, abscissa)
    return figure


def _is_swept_number(result: SweepResult, key: str) -> bool:
    values = {group.settings[key] for group in result.groups}
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    return numbers and len(values) > 1 and any(map(isfinite, values))


def _draw_lines(axes: Axes, result: SweepResult, metric: str, abscissa: str) -> None:
    """Draw a metric over a key, a line for each combination of the others."""
    values = sorted({group.settings[abscissa] for group in result.groups})
    places, is_plain = _places(values)
    others = [key for key in result.keys if key != abscissa]
    lines: dict[str, list[tuple[float, Estimate]]] = {}
    for group, found in zip(result.groups, result.estimates(metric), strict=True):
        given = [text(group.settings[key]) for key in others]
        if len(others) > 1:
            given = [f"{key} = {each}" for key, each in zip(others, given, strict=True)]
        name = ", ".join(given)
        lines.setdefault(_literal(name), []).append((places[group.settings[abscissa]], found))
    low, high = min(places.values()), max(places.values())
    looks = list(product(MARKERS, SERIES))
    for k, (name, points) in enumerate(lines.items()):
        marker, colour = looks[k % len(looks)]
        shift = (k - (len(lines) - 1) / 2.0) * APART * (high - low)
        x, y, error = zip(*((at + shift, each.mean, each.half_width) for at, each in sorted(points)), strict=True)
        axes.errorbar(x, y, error, color=colour, marker=marker, ms=3, lw=1.2, elinewidth=0.8, capsize=2, label=name)
    if len(values) <= MOST_TICKS or not is_plain:
        count = min(len(values), MOST_TICKS)
        ticks = [values[round(k * (len(values) - 1) / (count - 1))] for k in range(count)]
        axes.set_xticks([places[value] for value in ticks], [text(value) for value in ticks])
    axes.set_xlabel(abscissa)
    if len(lines) > 1:
        axes.legend(fontsize=7, title=others[0] if len(others) == 1 else None, title_fontsize=7)


def _places(values: Sequence[float]) -> tuple[dict[float, float], bool]:
    """Return where some of the values of a key are drawn, and whether that is just their value.

    If it is their logarithm, 0 is drawn to the left of the others; infinity is always to the right.
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
    """Draw a metric of each configuration, one below the other."""
    names = [_literal(", ".join(map(text, group.settings.values()))) for group in result.groups]
    found = result.estimates(metric)
    x, error = [each.mean for each in found], [each.half_width for each in found]
    axes.errorbar(x, range(len(names)), xerr=error, fmt="o", color=SERIES[0], ms=4, elinewidth=0.8, capsize=2)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_ylabel(", ".join(result.keys))


def _literal(name: str) -> str:
    """Return a text that matplotlib draws as it is: neither as mathematics, nor, because of a "_", not at all."""
    return name.replace("$", r"\$").replace("_", " _", name.startswith("_"))


def waterfall(found: Explanation) -> Figure:
    """Draw what each imperfection costs in each metric, with 95 % intervals."""
    with styled(figsize=(4.4 * len(found.costs), 4.0)) as figure:
        for axes, (metric, cost) in zip(
            figure.subplots(1, len(found.costs), squeeze=False)[0], found.costs.items(), strict=True
        ):
            draw_waterfall(axes, cost)
            axes.set_ylabel(EXPLAINED[metric].replace(", s", " (s)"))
        figure.suptitle(f"{found.name}: what imperfections cost, {found.runs} runs of equal seeds", fontsize=9)
    return figure


def draw_waterfall(axes: Axes, cost: Cost) -> None:
    """Draw the steps of one metric on given axes."""
    steps = dict(cost.parts) | ({"interaction": cost.interaction} if len(cost.parts) > 1 else {})
    names = [IDEAL, *steps, AS_IT_IS]
    last = len(names) - 1
    axes.bar([0, last], [cost.ideal.mean, cost.as_it_is.mean], color=[GREY, BLUE], width=0.6)
    _mark(axes, 0, 0.0, cost.ideal, ".2f")
    level = cost.ideal.mean
    for at, (name, step) in enumerate(steps.items(), start=1):
        rest = name == "interaction"
        colour = GREY if rest else VERMILION if step.mean.mean > 0.0 else GREEN
        axes.bar(at, step.mean.mean, bottom=level, color=colour, width=0.6, hatch="//" if rest else None)
        axes.plot([at - 0.7, at + 0.3], [level, level], color=GREY, lw=0.7)
        _mark(axes, at, level, step.mean, "+.2f")
        level += step.mean.mean
    _mark(axes, last, 0.0, cost.as_it_is, ".2f")
    axes.set_xticks(range(len(names)), names, fontsize=8, rotation=35, ha="right", rotation_mode="anchor")
    axes.margins(y=0.08)


def _mark(axes: Axes, at: int, base: float, found: Estimate, form: str) -> None:
    """Draw the interval of a bar that stands on a base, and write its height above."""
    end = base + found.mean
    axes.errorbar(at, end, found.half_width, color="black", elinewidth=0.8, capsize=2)
    top = max(base, end + found.half_width)
    axes.annotate(f"{found.mean:{form}}", (at, top), textcoords="offset points", xytext=(0, 3), ha="center", fontsize=7)
