"""Which evasion strategy survives longest against each protocol, and what do pursuers lose by limited sensing?

The first part uses the scenario of Lee & Bakolas, in which one pursuer is twice as fast as the others. Each strategy of
the evader plays against Spatial Adaptive Play on an ideal network, and against several protocols with a latency
(`--latency`). Each pursuer decides ten times a second on average. All strategies run with the same seeds, so each is
compared run by run with pure evasion. This is the strategy of the paper, in which the evader flees from the nearest
pursuer, active or not.

In the second part the evader moves in a random direction that changes gradually (`diffusion`). Most of the pursuers are
too slow to capture it: they watch and report their sightings. Two fast ones chase, and use the reports where they do
not see the evader. The sensing radius varies, and so does the estimate of the evader's position from an old sighting:
its last position; its last position extrapolated with its last velocity; or the worst case, anywhere that it can have
reached since.
"""

from collections.abc import Callable, Sequence
from math import inf
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from desim.analysis.drawing import palette
from desim.analysis.tables import aligned
from scenarios.studies.evaders_runs import (
    CHASERS,
    CLAIMED,
    ESTIMATES,
    HELD,
    IDEAL,
    LATENCY,
    MORE,
    NEAREST,
    PROTOCOLS,
    RADII,
    REFERENCE,
    WATCHED,
    WATCHERS,
    Cell,
    Sighted,
    measure_chases,
    measure_sight,
)
from scenarios.studies.rivals_runs import N
from scenarios.studies.study import NumberRange, Options, draw_estimates, study

if TYPE_CHECKING:
    from desim.analysis.drawing.plots import Axes, Figure


def table(cells: Sequence[Cell], sight: Sequence[Sighted], runs: int) -> str:
    """Return all results as text."""
    latency = max(cell.latency for cell in cells)
    about = f"paper, {N} pursuers, L = {latency:g} s if not ideal, {runs} runs, 95 % intervals"
    return "\n\n".join(
        [
            f"Time to capture, or the horizon without capture, s: {about}\n"
            + _grid(cells, lambda cell: f"{cell.survival:.2f}"),
            f"Time to capture minus that of {REFERENCE} with the same seeds, s: {about}\n"
            + _grid(
                [cell for cell in cells if cell.strategy != REFERENCE],
                lambda cell: f"{cell.difference:+.2f}",
            )
            + "\n"
            + "\n".join(claims(cells)),
            f"Sum of active times, s: {about}\n" + _grid(cells, lambda cell: f"{cell.active_time:.1f}"),
            f"Share of runs with capture, and handovers per run: {about}\n"
            + _grid(cells, lambda cell: f"{cell.captured:.0%} {cell.handovers:.1f}"),
            _sight_table(sight, latency, MORE * runs),
        ]
    )


def claims(cells: Sequence[Cell]) -> list[str]:
    """Return two lines that state whether an evader that ignores inactive pursuers survives longer than the reference.

    One line is for the ideal network, the other for the network with latency; the protocol is Spatial Adaptive Play.
    """
    lines = []
    for cell in cells:
        if cell.strategy == CLAIMED and cell.protocol in (IDEAL, "sap"):
            low, high = cell.difference.interval
            verdict = (
                "lives longer" if low > 0.0 else "lives less long" if high < 0.0 else "shows no significant difference"
            )
            lines.append(
                f"{cell.protocol}: an evader that ignores inactive pursuers {verdict} ({low:+.2f} .. {high:+.2f} s)"
            )
    return lines


def _grid(cells: Sequence[Cell], text: Callable[[Cell], str]) -> str:
    """Return a table with a row per strategy and a column per protocol; `text` returns the text of an entry."""
    texts = {(cell.strategy, cell.protocol): text(cell) for cell in cells}
    names = dict.fromkeys(cell.strategy for cell in cells)
    return aligned([("", *PROTOCOLS), *((name, *(texts[name, protocol] for protocol in PROTOCOLS)) for name in names)])


def _sight_table(sight: Sequence[Sighted], latency: float, runs: int) -> str:
    heads = ("captured", "95 % interval", "time", "vs hold", "active", "vs hold")
    rows = [("R_s", "estimate", *heads, "never seen", "lost", "reports/s", "transmissions/s")]
    for sighted in sight:
        is_limited, has_difference = sighted.radius < inf, sighted.estimate != HELD
        rows.append(
            (
                f"{sighted.radius:g} m" if is_limited else "inf",
                ESTIMATES[sighted.estimate] if is_limited else "",
                f"{sighted.captured.mean:.0%}",
                "{:.0%} .. {:.0%}".format(*sighted.captured.interval),
                f"{sighted.survival:.1f} s",
                f"{sighted.difference:+.1f} s" if has_difference else "",
                f"{sighted.active_time:.1f} s",
                f"{sighted.active_difference:+.1f} s" if has_difference else "",
                f"{sighted.never_seen:.0%}",
                f"{sighted.lost:.0%}",
                f"{sighted.reports:.0f}",
                f"{sighted.report_transmissions:.1f}",
            )
        )
    lost = (
        "time: to capture, or the horizon without capture; lost: seen, and later out of sight of all pursuers for more"
        f" than {WATCHED.sensing.track_timeout:g} s"
    )
    about = f"{WATCHERS} watchers, {CHASERS} chasers, sap, L = {latency:g} s, {runs} runs, 95 % intervals"
    return f"Limited sensing: {about}\n{lost}\n{aligned(rows, right_from=2)}"


def picture(cells: Sequence[Cell], sight: Sequence[Sighted]) -> "Figure":
    """Draw how much longer each strategy survives than pure evasion, and below it the cost of limited sensing."""
    from desim.analysis.drawing import plots

    with plots.styled(figsize=(plots.COLUMN, 4.6), font=7.0) as figure:
        above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(3, 2))[:, 0]
        draw_strategies(above.add_subplot(), cells)
        shares, times = below.subplots(1, 2)
        draw_sight(shares, times, sight)
    return figure


def draw_strategies(axes: "Axes", cells: Sequence[Cell]) -> None:
    """Draw a row per strategy: how much longer it survives than pure evasion with the same seeds.

    Only the points of SAP have intervals.
    """
    by_setting = {(cell.strategy, cell.protocol): cell for cell in cells if cell.strategy != REFERENCE}
    names = sorted({name for name, _ in by_setting}, key=lambda name: (by_setting[name, IDEAL].difference.mean, name))
    latency = max(cell.latency for cell in cells)
    rows = np.arange(len(names))
    axes.axvline(0.0, color=palette.GREY, lw=0.6)
    remaining = [protocol for protocol in PROTOCOLS if protocol not in (IDEAL, "sap", NEAREST)]
    for kinds, marker, label in (([NEAREST], "x", f"{NEAREST} (nearest)"), (remaining, "|", "other protocols")):
        points = [
            (by_setting[name, protocol].difference.mean, row) for protocol in kinds for row, name in enumerate(names)
        ]
        axes.plot(*zip(*points, strict=True), marker, color=palette.GREY, ms=4, mew=0.8, label=label)
    for protocol, shift, colour, marker, label in (
        (IDEAL, 0.17, palette.BLUE, "o", "SAP, ideal network"),
        ("sap", -0.17, palette.VERMILION, "s", f"SAP, L = {latency:g} s"),
    ):
        line = [by_setting[name, protocol] for name in names]
        x, error = [cell.difference.mean for cell in line], [cell.difference.half_width for cell in line]
        axes.errorbar(x, rows + shift, xerr=error, color=colour, marker=marker, ms=3, lw=0, elinewidth=0.8, label=label)
    axes.set_yticks(rows, names)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("lives longer than pure evasion by (s)")
    axes.legend(fontsize=6, loc="upper left", handlelength=1.0)


def draw_sight(shares: "Axes", times: "Axes", sight: Sequence[Sighted]) -> None:
    """Draw the share of captures and the active time over the sensing radius, a line per estimate."""
    from matplotlib.ticker import PercentFormatter

    radii = [radius for radius in RADII if radius < inf]
    styles = zip((palette.BLUE, palette.VERMILION, palette.GREEN), "osv", ESTIMATES, strict=True)
    for k, (colour, marker, kind) in enumerate(styles):
        line = [sighted for sighted in sight if sighted.estimate == kind and sighted.radius < inf]
        x = [sighted.radius * 1.08 ** (k - 1) for sighted in line]  # shifted, so that error bars do not overlap
        style: dict[str, Any] = {"color": colour, "marker": marker, "lw": 0.8, "elinewidth": 0.6}
        draw_estimates(shares, x, [sighted.captured for sighted in line], label=ESTIMATES[kind], **style)
        draw_estimates(times, x, [sighted.active_time for sighted in line], **style)
    for axes in (shares, times):
        axes.set(xscale="log", xlabel="sight R$_s$ (m)")
        axes.set_xticks(radii, [f"{radius:g}" for radius in radii])
        axes.minorticks_off()
        axes.set_ylim(bottom=0.0)
    shares.set(ylabel="captured (% of runs)", ylim=(0.0, 1.05))
    shares.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=""))
    times.set_ylabel("active time (s)")
    shares.legend(fontsize=6, loc="lower right", handlelength=1.0)


@study(
    "evaders",
    __doc__,
    20,
    click.Option(
        ["--latency"],
        type=NumberRange(min=0.0, max=60.0),
        default=LATENCY,
        show_default=True,
        help="One-way latency, s.",
    ),
    seconds=11,
)
def main(options: Options) -> None:
    """Measure, compare and show."""
    latency: float = options.extra["latency"]
    cells, sight = measure_chases(options, latency), measure_sight(options, latency)
    document = {"latency": latency, "cells": cells, "sight": sight}
    options.show(document, table(cells, sight, options.runs), lambda: picture(cells, sight))


if __name__ == "__main__":
    main()
