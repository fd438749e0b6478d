"""The picture of an explanation: from the ideal scenario to the one as it is, a step per imperfection."""

from desim.analysis.plots import BLUE, GREEN, GREY, VERMILION, Axes, Figure, styled
from desim.analysis.statistics import Estimate
from desim.study.explain import AS_IT_IS, EXPLAINED, IDEAL, Cost, Explanation


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
        chance = name == "interaction"
        colour = GREY if chance else VERMILION if step.mean > 0.0 else GREEN
        axes.bar(at, step.mean, bottom=level, color=colour, width=0.6, hatch="//" if chance else None)
        axes.plot([at - 0.7, at + 0.3], [level, level], color=GREY, lw=0.7)
        _mark(axes, at, level, step, "+.2f")
        level += step.mean
    _mark(axes, last, 0.0, cost.as_it_is, ".2f")
    axes.set_xticks(range(len(names)), names, fontsize=8, rotation=35, ha="right", rotation_mode="anchor")
    axes.margins(y=0.08)


def _mark(axes: Axes, at: int, base: float, found: Estimate, form: str) -> None:
    """Draw the interval of a bar that stands on a base, and write its height above."""
    end = base + found.mean
    axes.errorbar(at, end, found.half_width, color="black", elinewidth=0.8, capsize=2)
    top = max(base, end + found.half_width)
    axes.annotate(f"{found.mean:{form}}", (at, top), textcoords="offset points", xytext=(0, 3), ha="center", fontsize=7)
