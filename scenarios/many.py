"""Several evaders: how good an assignment the team finds, and how soon all evaders are captured.

With one evader the game has one equilibrium. With several it often has many, some of them poor: if two pursuers should
swap their evaders, neither gains by changing first. Cooling, a temperature that falls during log-linear learning, can
help to leave poor profiles. Its benefit is measured in the static game at t = 0, in which no player moves. Slow cooling
lowers the temperature during the first 90 % of the slots. Fast cooling halves the temperature in every slot until it
has reached the same final temperature. The study compares protocols for several numbers of pursuers and evaders. It
gives the welfare (global utility) of the final profile divided by that of the best assignment, and the share of games
that end in the best assignment. For 4 pursuers and 4 evaders it also varies the number of slots, and it replaces
cooling by constant temperatures. In a second experiment all players move, and the time until all evaders are captured
is measured.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from desim.analysis.drawing import palette
from desim.analysis.tables import aligned
from scenarios.studies.many_runs import (
    BUDGET,
    BUDGETS,
    CONTENDERS,
    COOLED,
    GAMES_PER_RUN,
    HARD,
    HORIZON,
    REFERENCE,
    SIZES,
    TEMPERATURES,
    NegotiationSummary,
    PursuitSummary,
    run_pursuits,
    run_static_games,
)
from scenarios.studies.study import Options, draw_estimates, study

if TYPE_CHECKING:
    from desim.analysis.drawing.plots import Axes, Figure


def table(games: Sequence[NegotiationSummary], pursuits: Sequence[PursuitSummary], runs: int) -> str:
    """Return all results as text."""
    return "\n\n".join(
        [
            _by_size(games, runs),
            _by_cooling(games, GAMES_PER_RUN * runs),
            _by_temperature(games, GAMES_PER_RUN * runs),
            _pursuit_tables(pursuits, runs),
        ]
    )


def _by_size(games: Sequence[NegotiationSummary], runs: int) -> str:
    by_size = {(game.pursuers, game.evaders, game.protocol): game for game in games if game.slots == BUDGET}
    rows = [("", *(f"{n} to {m}" for n, m in SIZES))]
    for name in CONTENDERS:
        line = [by_size[*size, name] for size in SIZES]
        rows.append((name, *(f"{game.share:.3f}  {game.best.mean:4.0%}" for game in line)))
    return (
        f"Welfare of the final profile / optimum, and share of games that end in the best assignment, N to M:\n"
        f"static, r = {HORIZON:g} s, {BUDGET} slots, {runs} games, 95 % intervals\n{aligned(rows)}"
    )


def _by_cooling(games: Sequence[NegotiationSummary], runs: int) -> str:
    by_slots = {(game.slots, game.protocol): game for game in games if _is_hard(game)}
    rows = [("", *(f"{slots} slots" for slots in BUDGETS))]
    for name in COOLED:
        line = [by_slots[slots, name] for slots in BUDGETS]
        rows.append((name, *("{:.0%} ({:.0%} .. {:.0%})".format(game.best.mean, *game.best.interval) for game in line)))
    about = f"{HARD[0]} to {HARD[1]}, static, {runs} games, 95 % Wilson intervals"
    return f"Share of games that end in the best assignment: {about}\n{aligned(rows)}"


def _by_temperature(games: Sequence[NegotiationSummary], runs: int) -> str:
    by_temperature = {(game.temperature, game.protocol): game for game in games}
    rows = [("", *(f"{tau:g} s" for tau in TEMPERATURES))]
    for kind in ("sap", "selective_sap"):
        line = [by_temperature[tau, kind] for tau in TEMPERATURES]
        rows.append((kind, *(f"{game.share:.3f}" for game in line)))
    about = f"{HARD[0]} to {HARD[1]}, static, {BUDGET} slots, {runs} games, 95 % intervals"
    return f"Welfare of the final profile / optimum at constant temperatures: {about}\n{aligned(rows)}"


def _pursuit_tables(pursuits: Sequence[PursuitSummary], runs: int) -> str:
    by_size = {(pursuit.pursuers, pursuit.evaders, pursuit.protocol): pursuit for pursuit in pursuits}
    heads = [f"{n} to {m}" for n, m in SIZES]
    times, paired, caught = [("", *heads)], [("", *heads)], [("", *heads)]
    for name in CONTENDERS:
        line = [by_size[*size, name] for size in SIZES]
        times.append((name, *(f"{pursuit.duration:.2f}" for pursuit in line)))
        caught.append((name, *(f"{pursuit.captured.mean:.0%} ({pursuit.all_captured:.0%})" for pursuit in line)))
        if name != REFERENCE:
            paired.append((name, *(f"{pursuit.difference:+.2f}" for pursuit in line)))
    about = f"horizon {HORIZON:g} s, {runs} runs, 95 % intervals"
    return (
        f"Time until all are captured, or the horizon, s: {about}\n{aligned(times)}\n\n"
        f"Time until all are captured minus that of {REFERENCE} with the same seeds, s: {about}\n{aligned(paired)}\n\n"
        f"Share of the evaders captured by the horizon (share of the runs with all captured)\n{aligned(caught)}"
    )


def _is_hard(game: NegotiationSummary) -> bool:
    return (game.pursuers, game.evaders) == HARD and game.temperature is None


def picture(games: Sequence[NegotiationSummary], pursuits: Sequence[PursuitSummary]) -> "Figure":
    """Draw the effects of cooling and of a constant temperature, and the durations of the pursuits."""
    from desim.analysis.drawing import plots

    with plots.styled(figsize=(plots.COLUMN, 7.2), font=8.0) as figure:
        cooling, temperature, time = figure.subplots(3, 1, height_ratios=(1.0, 1.0, 1.25))
        draw_cooling(cooling, [game for game in games if _is_hard(game)])
        draw_temperatures(temperature, [game for game in games if game.temperature is not None])
        draw_pursuits(time, pursuits)
    return figure


def draw_cooling(axes: "Axes", games: Sequence[NegotiationSummary]) -> None:
    """Draw, over the number of slots, the share of games that end in the best assignment."""
    from matplotlib.ticker import PercentFormatter

    styles = zip(COOLED, "oDs^", (0.94, 0.98, 1.02, 1.06), palette.SERIES, strict=False)
    for name, marker, shift, colour in styles:
        line = [game for game in games if game.protocol == name]
        x = [game.slots * shift for game in line]  # shifted, so that error bars do not overlap
        dashes = "-" if name.endswith("slow") else ":"
        draw_estimates(
            axes, x, [game.best for game in line], color=colour, ls=dashes, marker=marker, ms=3.5, label=name
        )
    axes.set(xscale="log", xlabel="slots to negotiate", ylabel="best assignment\nfound (% of games)", ylim=(0, 1))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=""))
    axes.set_xticks(BUDGETS, [str(slots) for slots in BUDGETS])
    axes.minorticks_off()
    axes.set_title(f"{HARD[0]} pursuers, {HARD[1]} evaders, nobody moves", fontsize=8, pad=28)
    axes.legend(fontsize=7, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 0.98))


def draw_temperatures(axes: "Axes", games: Sequence[NegotiationSummary]) -> None:
    """Draw, over the constant temperature, the welfare divided by its optimum, a line per protocol."""
    kinds = {
        "sap": ("SAP", "o", 0.97, palette.SERIES[0]),
        "selective_sap": ("Selective SAP", "s", 1.03, palette.SERIES[2]),
    }
    for kind, (label, marker, shift, colour) in kinds.items():
        line = [game for game in games if game.protocol == kind]
        x = [(game.temperature or 0.0) * shift for game in line]
        draw_estimates(axes, x, [game.share for game in line], color=colour, marker=marker, ms=3.5, label=label)
    axes.set(xscale="log", xlabel=r"constant temperature $\tau$ (s)", ylabel="welfare / optimum", ylim=(0.0, 1.0))
    axes.set_xticks(TEMPERATURES, [f"{tau:g}" for tau in TEMPERATURES])
    axes.minorticks_off()
    axes.legend(fontsize=7, loc="lower left")


def draw_pursuits(axes: "Axes", pursuits: Sequence[PursuitSummary]) -> None:
    """Draw the durations of the pursuits, a row per protocol, a mark per size."""
    rows = {name: row for row, name in enumerate(CONTENDERS)}
    for k, ((n, m), marker, colour) in enumerate(zip(SIZES, "oDs^", palette.SERIES, strict=False)):
        line = [pursuit for pursuit in pursuits if (pursuit.pursuers, pursuit.evaders) == (n, m)]
        y = [rows[pursuit.protocol] + 0.15 * (k - 1.5) for pursuit in line]
        x, error = [pursuit.duration.mean for pursuit in line], [pursuit.duration.half_width for pursuit in line]
        axes.errorbar(
            x, y, xerr=error, color=colour, ls="none", marker=marker, ms=3.5, elinewidth=0.7, label=f"{n} to {m}"
        )
    axes.set_yticks(list(rows.values()), list(rows))
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.set(xlabel="time until all are captured, or $t_f$ (s)", xlim=(0, HORIZON))
    axes.legend(
        fontsize=7,
        title="pursuers to evaders",
        title_fontsize=7,
        ncols=4,
        loc="lower center",
        bbox_to_anchor=(0.3, 1.0),
    )


@study("many", __doc__, seconds=5, runs=40)
def main(options: Options) -> None:
    """Measure the static games and the pursuits, and show them."""
    games, pursuits = run_static_games(options), run_pursuits(options)
    document = {"negotiations": games, "pursuits": pursuits}
    options.show(document, table(games, pursuits, options.runs), lambda: picture(games, pursuits))


if __name__ == "__main__":
    main()
