"""Draw the figures of Lee & Bakolas: initial configuration, trajectories, and individual utilities over time.

There are these three figures for each configuration of Table I (N = 20 and 40). Trajectories are drawn for the
decentralised Algorithm 2 with three slots delta and for the centralised Algorithm 3, utilities only for Algorithm 2.
Each figure shows the run of the first seed; the table has means over all seeds.

The utility of a pursuer i is its wonderful-life utility U_E(S) - U_E(S without i). S is the true set of active pursuers
and U_E the global utility (`desim.pursuit.game.game`). The utility of an inactive pursuer is 0.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from desim import Recording, Result, Scenario, run
from desim.analysis.activity import active_time, handovers, relays
from desim.analysis.drawing import palette
from desim.analysis.hindsight import gains
from desim.analysis.statistics import estimate
from desim.analysis.tables import aligned
from desim.analysis.timeline import timeline
from desim.analysis.trace_index import ended, started, trace_index
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.units import SECOND, seconds
from scenarios.studies.study import Options, study
from scenarios.studies.table1_runs import DELTAS, centralised, configuration, decentralised

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

COUNTS = (20, 40)
SAMPLING = 0.02
"""Time between two samples of positions, s."""
PRINT_DPI = 300
"""Resolution of the PNG, dots per inch."""
SHORT_SHARE = 0.1
"""If a pursuer first chases alone before this share of a run has passed, an inset shows the beginning enlarged."""


@dataclass(frozen=True)
class RunMetrics:
    """The metrics of one run."""

    active_time: float
    """Sum of active times over the pursuers, s."""
    end: float
    """Time to capture, or the horizon without capture, s."""
    captured: bool
    alone_from: float | None
    """First time at which exactly one pursuer was active, s; None if never."""
    handovers: int


def run_metrics(result: Result) -> RunMetrics:
    """Return the metrics of a run."""
    end, chain = ended(result), relays(result)
    first = seconds(chain[0][0]) if chain else None
    return RunMetrics(active_time(result), seconds(end.t), end.reason == "captured", first, handovers(result))


def panels(count: int) -> dict[str, Scenario]:
    """Return the scenario of each panel by title: centralised with the shortest slot, and decentralised with each slot.

    Positions are recorded.
    """
    base = configuration(count).model_copy(update={"record": Recording(trajectory=SAMPLING)})
    first_panel = {"centralised": centralised(base, min(DELTAS))}
    return first_panel | {f"delta = {delta:g} s": decentralised(base, delta) for delta in DELTAS}


class IndividualUtilities(NamedTuple):
    """The utilities of the pursuers between the breakpoints of a run (see `desim.analysis.timeline`)."""

    times: "NDArray[np.int64]"
    """(k + 1,) breakpoints, ns."""
    active: "NDArray[np.bool_]"
    """(k, N) whether each pursuer is active."""
    utilities: "NDArray[np.float64]"
    """(k, N) utilities, s; 0 while inactive."""


def individual_utilities(result: Result) -> IndividualUtilities:
    """Return the utilities of the pursuers of a run."""
    parts = list(timeline(result))
    times = np.concatenate([parts[0].times[:1], *(part.times[1:] for part in parts)])
    active = np.concatenate([part.active for part in parts])
    utilities = np.where(active, np.concatenate([gains(part) for part in parts]), 0.0)
    return IndividualUtilities(times, active, utilities)


def draw_initial(result: Result) -> "Figure":
    """Draw the initial positions of all players, with the ids of the pursuers."""
    from desim.analysis.drawing import plots
    from desim.view.pictures.paths import label_points

    start = started(result)
    with plots.styled((plots.COLUMN, 3.6), font=7) as figure:
        axes = figure.add_subplot()
        places, fast = np.array(start.pursuers), np.array(start.speeds) > min(start.speeds)
        axes.plot(*places[~fast].T, "o", color=palette.BLUE, ms=4, label=f"pursuer, {min(start.speeds):g} m/s")
        axes.plot(*places[fast].T, "^", color=palette.BLUE, ms=6, label=f"pursuer, {max(start.speeds):g} m/s")
        axes.plot(
            *start.evaders[0],
            "s",
            color=palette.VERMILION,
            ms=4,
            label=f"evader, {result.scenario.evaders[0].speed:g} m/s",
        )
        axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", xlim=(-1, 21), ylim=(-1, 21))
        axes.set(xticks=range(0, 21, 5), yticks=range(0, 21, 5))
        figure.legend(loc="outside lower center", ncols=3, handletextpad=0.2, columnspacing=1)
        figure.draw_without_rendering()
        label_points(axes, places.tolist(), [str(k) for k in range(len(places))], avoid=[start.evaders[0]])
    return figure


def draw_trajectories(results: "Mapping[str, Result]") -> "Figure":
    """Draw the trajectories of the runs, in four panels with shared axes."""
    from desim.analysis.drawing import plots
    from desim.view.pictures.paths import draw_pursuit, label_handovers

    with plots.styled((plots.COLUMN, 4.1), font=7) as figure:
        labels: dict[str, Artist] = {}
        grid = figure.subplots(2, 2, sharex=True, sharey=True).ravel().tolist()
        for axes, (name, result) in zip(grid, results.items(), strict=True):
            draw_pursuit(axes, result)
            end = ended(result)
            axes.set_title(
                f"{name}\n{'captured' if end.reason == 'captured' else 'not captured'} after {seconds(end.t):.2f} s"
            )
            axes.label_outer()
            handles, names = axes.get_legend_handles_labels()
            labels |= dict(zip(names, handles, strict=True))
        axes.set(xticks=range(0, 21, 5), yticks=range(0, 21, 5))
        look = {"handlelength": 1.5, "handletextpad": 0.5, "columnspacing": 1.0}
        figure.legend(list(labels.values()), list(labels), loc="outside lower center", ncols=3, **look)
        figure.draw_without_rendering()
        for axes, result in zip(grid, results.values(), strict=True):
            label_handovers(axes, result)
    return figure


def draw_utilities(results: "Mapping[str, Result]") -> "Figure":
    """Draw the individual utilities over time, one panel per run, each with its own vertical scale."""
    from desim.analysis.drawing import plots

    with plots.styled((plots.COLUMN, 4.4), font=7) as figure:
        rows = figure.subplots(len(results), 1, sharex=True)
        all_utilities = [individual_utilities(result) for result in results.values()]
        for axes, (name, result), utilities in zip(rows, results.items(), all_utilities, strict=True):
            draw_utility_panel(axes, utilities)
            axes.set_title(name, loc="left")
            axes.label_outer()
            if (chain := relays(result)) and chain[0][0] < SHORT_SHARE * ended(result).t:
                _draw_beginning(axes, utilities, 1.1 * seconds(chain[0][0]))
        rows[-1].set_xlabel("time (s)")
        figure.supylabel("individual utility (s)", fontsize=7)
        handles, names = rows[-1].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=3)
        figure.draw_without_rendering()
        for axes, result, utilities in zip(rows, results.values(), all_utilities, strict=True):
            _label_handovers(axes, relays(result), utilities)
    return figure


def _label_handovers(axes: "Axes", chain: "Sequence[tuple[int, int]]", utilities: IndividualUtilities) -> None:
    """Write the id of each pursuer of `chain` where it begins to chase alone, which is where a bold line begins.

    `chain` is the return value of `desim.analysis.activity.relays`.
    """
    from desim.view.pictures.paths import label_points

    begin, end = axes.get_xlim()
    rows = [int(np.searchsorted(utilities.times, t, side="right")) - 1 for t, _ in chain]
    places = [
        (seconds(t), float(utilities.utilities[row, pursuer])) for row, (t, pursuer) in zip(rows, chain, strict=True)
    ]
    # Points on the beginning of each bold line, which no label should cover.
    points = [(t + k * (end - begin) / 100, u) for t, u in places for k in range(1, 8)]
    label_points(axes, places, [str(pursuer) for _, pursuer in chain], avoid=points, color=palette.BLUE)


def _draw_beginning(axes: "Axes", utilities: IndividualUtilities, until: float) -> None:
    """Draw the utilities up to a time (`until`, s) enlarged, in the empty part of a panel."""
    inset = axes.inset_axes((0.36, 0.22, 0.62, 0.5))
    draw_utility_panel(inset, utilities)
    inset.set_xlim(0.0, until)
    inset.set_title("the beginning", fontsize=6, pad=2)
    inset.tick_params(labelsize=6, length=2, pad=1.5)


def draw_utility_panel(axes: "Axes", panel: IndividualUtilities) -> None:
    """Draw the utility of each active pursuer, bold while no other is active, and a line at 0 for the inactive ones."""
    times, active, utilities = panel
    t = np.repeat(times, 2)[1:-1] / SECOND  # both ends of each piece, so that lines have steps
    is_alone = active & (active.sum(axis=1) == 1)[:, None]
    axes.axhline(0.0, color=palette.GREY, lw=0.8, label="inactive")
    looks: list[tuple[NDArray[np.bool_], str, dict[str, Any]]] = [
        (active & ~is_alone, "active with others", {"color": palette.SKY, "lw": 0.7}),
        (is_alone, "active alone", {"color": palette.BLUE, "lw": 2.0}),
    ]
    for mask, label, look in looks:
        for k, i in enumerate(np.flatnonzero(mask.any(axis=0))):
            u = np.repeat(np.where(mask[:, i], utilities[:, i], np.nan), 2)
            axes.plot(t, u, label=None if k else label, **look)


def pictures(count: int, seed: int) -> "Iterator[tuple[str, Figure]]":
    """Yield each figure for a number of pursuers, with its name."""
    results = {name: trace_index(run(scenario, seed)) for name, scenario in panels(count).items()}
    yield f"configuration_{count}", draw_initial(results["centralised"])
    yield f"trajectories_{count}", draw_trajectories(results)
    del results["centralised"]  # utilities are drawn for Algorithm 2 only
    yield f"utilities_{count}", draw_utilities(results)


def table(runs_of: dict[tuple[int, str], list[RunMetrics]]) -> str:
    """Return the means over the runs as text, a line per panel."""
    rows: list[Sequence[str]] = [("N", "panel", "active time, s", "ends, s", "captured", "alone from, s", "handovers")]
    for (count, name), runs in runs_of.items():
        starts = [run.alone_from for run in runs if run.alone_from is not None]
        rows.append(
            (
                str(count),
                name,
                f"{estimate([run.active_time for run in runs]).mean:.2f}",
                f"{estimate([run.end for run in runs]).mean:.2f}",
                f"{portable_sum(run.captured for run in runs)}/{len(runs)}",
                f"{estimate(starts).mean:.2f}" if starts else "-",
                f"{estimate([float(run.handovers) for run in runs]).mean:.1f}",
            )
        )
    return aligned(rows)


@study("figures", __doc__, seconds=6, runs=1)
def main(options: Options) -> None:
    """Measure and draw."""
    scenarios = {(count, name): scenario for count in COUNTS for name, scenario in panels(count).items()}
    runs_of = dict(zip(scenarios, options.measure(list(scenarios.values()), "figures", run_metrics), strict=True))
    cells = [{"N": n, "panel": name, "runs": runs} for (n, name), runs in runs_of.items()]
    options.show({"cells": cells}, table(runs_of))
    named = (picture for count in COUNTS for picture in pictures(count, options.seed))
    options.save_figures(lambda: ((f"{options.name}_{name}", figure) for name, figure in named), dpi=PRINT_DPI)


if __name__ == "__main__":
    main()
