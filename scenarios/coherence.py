"""What is retransmitting worth on a channel that remembers? Pursuits over Rayleigh fading, at equal bytes.

A change of action is announced once; retransmitted to each teammate until it is acknowledged; repeated by heartbeats;
or repeated as coded copies 0.05 s apart. Heartbeats and copies need as many bytes as the retransmissions. The Doppler
frequency of the channel is varied, at the same probability of loss, beside a channel on which each message fades anew.

In a game at rest, the study measures the mean age of information of announcements that are made periodically.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from desim.analysis.statistics import Estimate
from desim.analysis.tables import aligned
from scenarios.studies.coherence_runs import CHANNELS, WAYS, Cell, measure
from scenarios.studies.study import Options, draw_estimates, study
from scenarios.studies.transport_runs import N_REST, ONCE, N

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def table(cells: Sequence[Cell], runs: int) -> str:
    """Return all results as text."""
    by_way = {(cell.channel, cell.way): cell for cell in cells}
    compared = [way for way in WAYS if way != ONCE]
    pursuits: list[tuple[str, ...]] = [("Doppler (Hz)", ONCE, *compared, *(f"bytes/s, {way}" for way in WAYS))]
    ages: list[tuple[str, ...]] = [("Doppler (Hz)", *WAYS)]
    for channel in CHANNELS:
        pursuits.append(
            (
                channel,
                text(by_way[channel, ONCE].active_time),
                *(text(by_way[channel, way].saving) for way in compared),
                *(f"{by_way[channel, way].rate:,.0f}" for way in WAYS),
            )
        )
        ages.append((channel, *(text(by_way[channel, way].age) for way in WAYS)))
    return (
        f"sum of active times, s: {ONCE}, and what the others save: {N} pursuers, {runs} runs, 95 % intervals\n"
        f"{aligned(pursuits)}\n\nmean age of information in a game at rest, s: {N_REST} pursuers\n{aligned(ages)}"
    )


def text(value: Estimate) -> str:
    """Return an estimate as text."""
    return f"{value.mean:.3g} +- {value.half_width:.2g}"


def picture(cells: Sequence[Cell]) -> "Figure":
    """Draw the savings of active time and the ages of information over the channels, a line per way."""
    from desim.analysis.drawing import palette, plots

    with plots.styled(figsize=(9.0, 3.2)) as figure:
        left, right = figure.subplots(1, 2)
        for k, (colour, way) in enumerate(zip(palette.SERIES, WAYS, strict=False)):
            line = [cell for cell in cells if cell.way == way]
            places = [place + 0.05 * (k - 1.5) for place in range(len(line))]  # shifted, so that error bars are seen
            style = {"color": colour, "label": way}
            for axes, values in ((left, [cell.saving for cell in line]), (right, [cell.age for cell in line])):
                if axes is left and way == ONCE:  # savings are against announcing once
                    continue
                # The channel without memory, the last one, is apart from the line over the Doppler frequency.
                draw_estimates(axes, places[:-1], values[:-1], marker="o", **style)
                draw_estimates(axes, places[-1:], values[-1:], marker="s", **style | {"label": None})
        for axes in (left, right):
            axes.set_xticks(range(len(CHANNELS)), CHANNELS)
            axes.set_xlabel("Doppler frequency of the channel (Hz)")
        left.set_ylabel("active time saved against\nannouncing once (s)")
        right.set_ylabel("mean age of information (s)")
        right.set_ylim(bottom=0.0)
        right.legend(fontsize=8)
    return figure


@study("coherence", __doc__, seconds=2, runs=20)
def main(options: Options) -> None:
    """Run the pursuits and show the results."""
    cells = measure(options)
    options.show({"cells": cells}, table(cells, options.runs), lambda: picture(cells))


if __name__ == "__main__":
    main()
