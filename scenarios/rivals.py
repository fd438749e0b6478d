"""Compare all protocols with equal initial states, random draws and announcement rates, over a range of latencies.

There are three scenarios. "paper" is that of the paper, with one pursuer twice as fast as the others. In "relay stress"
all pursuers are equally fast, so that the relay pursuer (the pursuer that should chase) may change often. "paper,
unseen" is that of the paper without sensing of teammates, so that announcements also carry positions. A pursuer
announces exactly ten times a second, so protocols make equally many transmissions, of unequal sizes. There are three
exceptions. The centralised benchmark sends nothing. The geometric rules send nothing where positions are sensed. Under
`server`, reports and orders replace the announcements, with about as many transmissions. A pursuer, or the planner of
the centralised benchmark, decides ten times a second on average; the server decides whenever reports arrive. The cost
of delay is the increase of the potential gap (`desim.analysis.hindsight`) compared with the same protocol with the same
seeds and without delay. "nobody talks" is Spatial Adaptive Play without any announcement, not even of first actions. To
measure what a message is worth, `python -m scenarios.start --worth` gives the silent team the protocol and the initial
knowledge of the speaking one.
"""

from collections import defaultdict
from collections.abc import Sequence
from typing import TYPE_CHECKING

from desim.analysis.tables import aligned
from scenarios.studies.rivals_runs import LATENCIES, REFERENCE, SHOWN, WORLDS, Cell, N, measure
from scenarios.studies.study import Options, study

if TYPE_CHECKING:
    from desim.analysis.drawing.plots import Axes, Figure


def table(cells: Sequence[Cell], runs: int) -> str:
    """Return three tables for each scenario as text."""
    return "\n\n".join(part for world in WORLDS for part in _tables(world, cells, runs))


def _tables(world: str, cells: Sequence[Cell], runs: int) -> list[str]:
    by_setting = {(cell.protocol, cell.latency): cell for cell in cells if cell.world == world}
    names = list(dict.fromkeys(cell.protocol for cell in cells))
    heads = [f"L = {latency:g} s" for latency in LATENCIES]
    active, paired = [("", *heads)], [("", *heads)]
    for name in names:
        line = [by_setting[name, latency] for latency in LATENCIES]
        active.append((name, *(f"{cell.active_time:.1f}" for cell in line)))
        if name != REFERENCE:
            paired.append((name, *(f"{cell.difference:+.1f}" for cell in line)))
    heads = ["captured", "relayed", "after", "misassigned", "regret", "handovers", "sent/s", "kB/s"]
    messages = [("", *heads)]
    for name in names:
        cell = by_setting[name, SHOWN]
        messages.append(
            (
                name,
                f"{cell.captured:.0%}",
                f"{cell.relayed:.0%}",
                "-" if cell.time_to_relay is None else f"{cell.time_to_relay:.2f} s",
                f"{cell.misassigned_time:.2f} s",
                f"{cell.network_regret:.1f} s^2",
                f"{cell.handovers:.1f}",
                f"{cell.transmissions:.0f}",
                f"{cell.kilobytes:.2f}",
            )
        )
    about = f"{world}, {N} pursuers, {runs} runs, 95 % intervals"
    meaning = "regret: increase of the potential gap by delay"
    return [
        f"Sum of active times, s: {about}\n{aligned(active)}",
        f"Sum of active times minus that of {REFERENCE} with the same seeds, s: {about}\n{aligned(paired)}",
        f"At L = {SHOWN:g} s: {about}\n{meaning}\n{aligned(messages)}",
    ]


def picture(cells: Sequence[Cell]) -> "Figure":
    """Draw the active time of each protocol at each latency; protocols are in ascending order of total active time."""
    from desim.analysis.drawing import plots

    total: dict[str, float] = defaultdict(float)
    for cell in cells:
        total[cell.protocol] += cell.active_time.mean
    names = sorted(total, key=total.__getitem__)
    with plots.styled(figsize=(9.5, 4.6)) as figure:
        for axes, world in zip(figure.subplots(1, len(WORLDS), sharey=True, squeeze=False)[0], WORLDS, strict=True):
            draw(axes, world, names, [cell for cell in cells if cell.world == world])
        figure.supxlabel("one-way latency L (s)", fontsize=9)
    return figure


def draw(axes: "Axes", world: str, names: Sequence[str], cells: Sequence[Cell]) -> None:
    """Draw the active times of one scenario as colours and numbers, a row per protocol, a column per latency."""
    import numpy as np
    from matplotlib.colors import LogNorm

    times = np.zeros((len(names), len(LATENCIES)))
    for cell in cells:
        times[names.index(cell.protocol), LATENCIES.index(cell.latency)] = cell.active_time.mean
    axes.imshow(times, norm=LogNorm(), cmap="viridis_r", aspect="auto")
    middle = np.sqrt(times.min() * times.max())
    for (row, column), time in np.ndenumerate(times):
        colour = "black" if time < middle else "white"
        axes.text(column, row, f"{time:.0f}", ha="center", va="center", fontsize=8, color=colour)
    axes.set_xticks(range(len(LATENCIES)), [f"{latency:g}" for latency in LATENCIES])
    axes.set_yticks(range(len(names)), names)
    axes.set_title(f"{world}: sum of active times (s)", fontsize=9)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


@study("rivals", __doc__, seconds=45, runs=10)
def main(options: Options) -> None:
    """Measure, compare and show."""
    cells = measure(options)
    options.show({"cells": cells}, table(cells, options.runs), lambda: picture(cells))


if __name__ == "__main__":
    main()
