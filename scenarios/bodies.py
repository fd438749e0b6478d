"""What does latency cost robots with inertia, and does one decision at a time still pay for them?

Pursuers with simple motion, with several least turning radii and with several greatest accelerations chase an evader
that flees the active ones, and so runs towards others that take over. Under Spatial Adaptive Play one pursuer decides
at a time, or all decide at once in rounds, with equal numbers of decisions. The latency varies. A handover lasts from
the end of the lone chase of the old pursuer to the beginning of that of the new one.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from math import isnan
from typing import TYPE_CHECKING

from desim.analysis.statistics import Estimate
from desim.analysis.tables import aligned
from scenarios.studies.bodies_runs import ALL, LATENCIES, MOTIONS, ONE, RULES, SIMPLE, SPEED, Cell, N, measure
from scenarios.studies.study import Options, study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def table(cells: Sequence[Cell], runs: int) -> str:
    """Return all results as text."""
    what = f"{N} pursuers of {SPEED:g} m/s, {runs} runs, 95 % intervals"
    parts: list[tuple[str, Callable[[Cell], str], Sequence[str]]] = [
        ("Sum of active times, s", lambda each: _text(each.active_time), tuple(RULES)),
        ("Active time minus that without latency, same seeds, s", lambda each: _text(each.of_latency), tuple(RULES)),
        (
            "Active time minus that without latency, minus the same of simple motion, s",
            lambda each: _text(each.of_inertia),
            tuple(RULES),
        ),
        ("Active time if all decide at once minus that if one does, s", lambda each: _text(each.of_rule), (ALL,)),
        (
            "Capture time, or the horizon, s, and share captured",
            lambda each: f"{_text(each.duration)}, {each.captured:.0%}",
            tuple(RULES),
        ),
        ("Handovers per run", lambda each: _text(each.handovers), tuple(RULES)),
        ("Active time in excess of one pursuer per handover, s", lambda each: _text(each.excess), tuple(RULES)),
    ]
    return "\n\n".join(f"{title}: {what}\n{_grid(cells, text, rules)}" for title, text, rules in parts)


def _grid(cells: Sequence[Cell], text: Callable[[Cell], str], rules: Sequence[str]) -> str:
    """Return a table with a row per rule and motion and a column per latency; `text` returns the text of an entry."""
    here = {(each.rule, each.motion, each.latency): text(each) for each in cells}
    rows: list[tuple[str, ...]] = [("rule", "motion", *(f"L = {latency:g} s" for latency in LATENCIES))]
    for rule in rules:
        rows += [(rule, motion, *(here[rule, motion, latency] for latency in LATENCIES)) for motion in MOTIONS]
    return aligned(rows)


def _text(found: Estimate) -> str:
    return "-" if isnan(found.mean) else f"{found.mean:.2f} +- {found.half_width:.2f}"


def picture(cells: Sequence[Cell]) -> "Figure":
    """Draw active time by latency, its excess per handover, and what it costs that all decide at once."""
    from desim.analysis.drawing import plots

    with plots.styled(figsize=(9.0, 6.0)) as figure:
        (turning, accelerating), (handing, rule) = figure.subplots(2, 2)
        accelerating.sharey(turning)
        for axes, unit in ((turning, " m"), (accelerating, " m/s^2")):
            motions = [motion for motion in MOTIONS if motion == SIMPLE or motion.endswith(unit)]
            _draw(axes, cells, motions, ONE, lambda each: each.active_time)
            axes.set(ylabel=f"sum of active times (s)\n{ONE}")
            axes.legend(fontsize=7, loc="lower right")
        turning.set_ylim(bottom=0.0)
        _draw(handing, cells, list(MOTIONS), ONE, lambda each: each.excess)
        handing.set(ylabel=f"excess active time per handover (s)\n{ONE}", ylim=(0.0, None))
        rule.axhline(0.0, color="black", lw=0.6)
        _draw(rule, cells, list(MOTIONS), ALL, lambda each: each.of_rule)
        rule.set(ylabel="active time (s),\nall at once minus one at a time")
        for axes in (turning, accelerating, handing, rule):
            axes.set(xlabel="latency (s)")
    return figure


def _draw(
    axes: "Axes", cells: Sequence[Cell], motions: Sequence[str], rule: str, value: Callable[[Cell], Estimate]
) -> None:
    """Draw a value over the latency, a line per motion, side by side so that equal lines are seen."""
    from desim.analysis.drawing import palette

    looks = dict(zip(MOTIONS, zip((palette.GREY, *palette.SERIES), "xooosss", strict=True), strict=False))
    span = LATENCIES[-1] - LATENCIES[0]
    for k, motion in enumerate(motions):
        here = [each for each in cells if each.rule == rule and each.motion == motion and not isnan(value(each).mean)]
        x = [each.latency + 0.008 * span * (k - len(motions) / 2) for each in here]
        y, error = [value(each).mean for each in here], [value(each).half_width for each in here]
        colour, mark = looks[motion]
        axes.errorbar(x, y, error, color=colour, marker=mark, ms=3, lw=1.0, elinewidth=0.6, label=motion)


@study("bodies", __doc__, runs=40)
def main(options: Options) -> None:
    """Run the pursuits and show the results."""
    cells = measure(options)
    options.show({"cells": [asdict(each) for each in cells]}, table(cells, options.runs), lambda: picture(cells))


if __name__ == "__main__":
    main()
