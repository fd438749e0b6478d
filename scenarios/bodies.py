"""What does latency cost robots with inertia, and does one decision at a time still pay for them?

Pursuers with simple motion, with several least turning radii and with several greatest accelerations chase an evader.
It flees the active pursuers, and so runs towards inactive ones, which take over. Under Spatial Adaptive Play one
pursuer decides at a time, or all decide at once in rounds, with equal numbers of decisions. The latency varies. A
handover lasts from the end of the lone chase of the old pursuer to the beginning of that of the new one.
"""

from collections.abc import Callable, Sequence
from math import isnan
from typing import TYPE_CHECKING

from desim.analysis.drawing import palette
from desim.analysis.statistics import Estimate
from desim.analysis.tables import aligned
from scenarios.studies.bodies_runs import ALL, LATENCIES, MOTIONS, ONE, RULES, SIMPLE, SPEED, Cell, N, measure
from scenarios.studies.study import Options, draw_estimates, study

if TYPE_CHECKING:
    from desim.analysis.drawing.plots import Axes, Figure


def table(cells: Sequence[Cell], runs: int) -> str:
    """Return all results as text."""
    about = f"{N} pursuers of {SPEED:g} m/s, {runs} runs, 95 % intervals"
    parts: list[tuple[str, Callable[[Cell], str], Sequence[str]]] = [
        ("Sum of active times, s", lambda cell: _text(cell.active_time), tuple(RULES)),
        ("Active time minus that without latency, same seeds, s", lambda cell: _text(cell.of_latency), tuple(RULES)),
        (
            "Active time minus that without latency, minus the same of simple motion, s",
            lambda cell: _text(cell.of_inertia),
            tuple(RULES),
        ),
        ("Active time if all decide at once minus that if one does, s", lambda cell: _text(cell.of_rule), (ALL,)),
        (
            "Capture time, or the horizon, s, and share captured",
            lambda cell: f"{_text(cell.duration)}, {cell.captured:.0%}",
            tuple(RULES),
        ),
        ("Handovers per run", lambda cell: _text(cell.handovers), tuple(RULES)),
        ("Active time in excess of one pursuer per handover, s", lambda cell: _text(cell.excess), tuple(RULES)),
    ]
    return "\n\n".join(f"{title}: {about}\n{_grid(cells, text, rules)}" for title, text, rules in parts)


def _grid(cells: Sequence[Cell], text: Callable[[Cell], str], rules: Sequence[str]) -> str:
    """Return a table with a row per rule and motion and a column per latency; `text` returns the text of an entry."""
    texts = {(cell.rule, cell.motion, cell.latency): text(cell) for cell in cells}
    rows: list[tuple[str, ...]] = [("rule", "motion", *(f"L = {latency:g} s" for latency in LATENCIES))]
    for rule in rules:
        rows += [(rule, motion, *(texts[rule, motion, latency] for latency in LATENCIES)) for motion in MOTIONS]
    return aligned(rows)


def _text(estimate: Estimate) -> str:
    return "-" if isnan(estimate.mean) else f"{estimate:.2f}"


def picture(cells: Sequence[Cell]) -> "Figure":
    """Draw active time by latency, its excess per handover, and what it costs that all decide at once."""
    from desim.analysis.drawing import plots

    with plots.styled(figsize=(9.0, 6.0)) as figure:
        (turning, accelerating), (handing, rule) = figure.subplots(2, 2)
        accelerating.sharey(turning)
        for axes, unit in ((turning, " m"), (accelerating, " m/s^2")):
            motions = [motion for motion in MOTIONS if motion == SIMPLE or motion.endswith(unit)]
            _draw(axes, cells, motions, ONE, lambda cell: cell.active_time)
            axes.set(ylabel=f"sum of active times (s)\n{ONE}")
            axes.legend(fontsize=7, loc="lower right")
        turning.set_ylim(bottom=0.0)
        _draw(handing, cells, list(MOTIONS), ONE, lambda cell: cell.excess)
        handing.set(ylabel=f"excess active time per handover (s)\n{ONE}", ylim=(0.0, None))
        rule.axhline(0.0, color="black", lw=0.6)
        _draw(rule, cells, list(MOTIONS), ALL, lambda cell: cell.of_rule)
        rule.set(ylabel="active time (s),\nall at once minus one at a time")
        for axes in (turning, accelerating, handing, rule):
            axes.set(xlabel="latency (s)")
    return figure


def _draw(
    axes: "Axes", cells: Sequence[Cell], motions: Sequence[str], rule: str, value: Callable[[Cell], Estimate]
) -> None:
    """Draw a value over the latency, a line per motion, side by side so that equal lines are seen."""
    looks = dict(zip(MOTIONS, zip((palette.GREY, *palette.SERIES), "xooosss", strict=True), strict=False))
    span = LATENCIES[-1] - LATENCIES[0]
    for k, motion in enumerate(motions):
        line = [cell for cell in cells if cell.rule == rule and cell.motion == motion and not isnan(value(cell).mean)]
        x = [cell.latency + 0.008 * span * (k - len(motions) / 2) for cell in line]
        colour, mark = looks[motion]
        draw_estimates(axes, x, list(map(value, line)), color=colour, marker=mark, elinewidth=0.6, label=motion)


@study("bodies", __doc__, seconds=3.5, runs=40)
def main(options: Options) -> None:
    """Run the pursuits and show the results."""
    cells = measure(options)
    options.show({"cells": cells}, table(cells, options.runs), lambda: picture(cells))


if __name__ == "__main__":
    main()
