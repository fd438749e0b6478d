"""How much range do pursuers need? Active time by communication range, and the share of games without an equilibrium.

A pursuer receives announcements from the pursuers within range R. The study compares five rules. Three are Spatial
Adaptive Play with different utilities: `local mean` is the paper's utility over the active neighbours only; `component`
is the paper's utility over the whole network component, and needs flooding; `edge penalty` is the time left minus the
pursuer's own capture time, minus a penalty for each active neighbour. The other two are rules without a utility, for
pursuers that can capture in time. Under `local min`, such a pursuer chases if no active neighbour has a smaller capture
time. Under `argmin known`, with flooding, it chases if no other pursuer that it knows of has a smaller one, whether
active or not.

For the games at t = 0, the study also gives the number of network components, the size of the greedy maximal
independent set, and the share of games without a pure equilibrium under the utility `local mean`. This share is found
by enumeration of all profiles. There are two teams. In the team "paper", only the fast pursuer and those near the
evader can capture it in time; in the team "all able", most pursuers can.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from desim.analysis.drawing import palette
from desim.analysis.tables import aligned
from scenarios.studies.study import Options, draw_estimates, study

if TYPE_CHECKING:
    from desim.analysis.drawing.plots import Axes, Figure
from scenarios.studies.range_runs import PROTOCOLS, RANGES, REFERENCE, TEAMS, TICKS, Games, N, Pursuits, games, measure


def table(pursuits: Sequence[Pursuits], static: Sequence[Games], runs: int) -> str:
    """Return all results as text."""
    return "\n\n".join(
        part
        for team in TEAMS
        for part in _tables(
            team,
            [pursuit for pursuit in pursuits if pursuit.team == team],
            [game for game in static if game.team == team],
            runs,
        )
    )


def _tables(team: str, pursuits: Sequence[Pursuits], static: Sequence[Games], runs: int) -> list[str]:
    by_setting = {(pursuit.range, pursuit.protocol): pursuit for pursuit in pursuits}
    properties = [("R", "no equilibrium", "95 % interval", "components", "independent set")]
    active, paired = [("R", *PROTOCOLS)], [("R", *(name for name in PROTOCOLS if name != REFERENCE))]
    for game in static:
        radius = f"{game.range:g} m"
        interval = "{:.1%} .. {:.1%}".format(*game.unsettled.interval)
        properties.append(
            (radius, f"{game.unsettled.mean:.1%}", interval, f"{game.components:.2f}", f"{game.independent:.2f}")
        )
        line = [by_setting[game.range, name] for name in PROTOCOLS]
        active.append((radius, *(f"{cell.active_time:.1f}" for cell in line)))
        compared = [cell for cell in line if cell.protocol != REFERENCE]
        paired.append((radius, *(f"{cell.difference:+.1f}" for cell in compared)))
    about_runs = f"{team}, {N} pursuers, {runs} runs, 95 % intervals"
    about_games = f"{team}, {N} pursuers, {static[0].games} games"
    return [
        f"Games of t = 0, in which a pursuer hears the pursuers within R: {about_games}\n{aligned(properties)}",
        f"Sum of active times, s: {about_runs}\n{aligned(active)}",
        f"Sum of active times minus that of the game per component with the same seeds, s: {about_runs}\n"
        f"{aligned(paired)}",
    ]


def picture(pursuits: Sequence[Pursuits], static: Sequence[Games]) -> "Figure":
    """Draw the active time by protocol, and below it the statistics of the games at t = 0."""
    from desim.analysis.drawing import plots

    with plots.styled(figsize=(9.0, 6.4)) as figure:
        grid = figure.subplots(2, len(TEAMS), sharex=True, height_ratios=(3, 2))
        for column, team in enumerate(TEAMS):
            draw_pursuits(grid[0, column], [pursuit for pursuit in pursuits if pursuit.team == team])
            draw_games(grid[1, column], [game for game in static if game.team == team])
            grid[0, column].set_title(team, fontsize=9)
        grid[0, -1].legend(fontsize=8)
        grid[0, 0].set_ylabel("sum of active times (s)")
        grid[1, 0].set_ylabel("games of neighbours\nwithout equilibrium (%)", color=palette.SERIES[1])
        for axes in grid[1]:
            axes.set_xlabel("range R (m)")
    return figure


def draw_pursuits(axes: "Axes", pursuits: Sequence[Pursuits]) -> None:
    """Draw the active time over the range, a line per protocol."""
    for k, (colour, mark, name) in enumerate(zip(palette.SERIES, palette.MARKERS, PROTOCOLS, strict=False)):
        line = [pursuit for pursuit in pursuits if pursuit.protocol == name]
        x = [pursuit.range * 1.03 ** (k - 2) for pursuit in line]  # shifted, so that error bars do not overlap
        draw_estimates(axes, x, [pursuit.active_time for pursuit in line], color=colour, marker=mark, label=name)
    axes.set(xscale="log")
    axes.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
    axes.minorticks_off()


def draw_games(axes: "Axes", static: Sequence[Games]) -> None:
    """Draw the share of games without equilibrium, the number of components and the size of the independent set."""
    share = 100.0 * np.array([(game.unsettled.mean, *game.unsettled.interval) for game in static])
    axes.fill_between(RANGES, share[:, 1], share[:, 2], color=palette.SERIES[1], alpha=0.25, lw=0)
    axes.plot(RANGES, share[:, 0], color=palette.SERIES[1], marker="o", ms=3, lw=1.2)
    axes.set_ylim(0, 60)
    counts = axes.twinx()
    counts.spines["right"].set_visible(True)
    sizes = {"components": ("--", [game.components for game in static])}
    sizes["greedy independent set"] = ":", [game.independent for game in static]
    for label, (style, values) in sizes.items():
        counts.plot(RANGES, values, style, color=palette.GREY, label=label)
    counts.set(ylabel="number", ylim=(0, N))
    if static[0].team == next(iter(TEAMS)):  # one legend is enough for all panels
        counts.legend(fontsize=7, loc="upper right")


@study("range", __doc__, seconds=9, runs=10)
def main(options: Options) -> None:
    """Run the pursuits, enumerate the games, and show the results."""
    pursuits = measure(options)
    static = [games(team, range_, options) for team in TEAMS for range_ in RANGES]
    document = {"pursuits": pursuits, "games": static}
    options.show(document, table(pursuits, static, options.runs), lambda: picture(pursuits, static))


if __name__ == "__main__":
    main()
