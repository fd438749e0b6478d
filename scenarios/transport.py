"""When does retransmitting an announcement beat repeating a fresh one? Pursuits over lossy links, at equal bytes.

A change of action is announced once; retransmitted to each teammate until it is acknowledged, with a constant time-out
or with back-off; repeated by heartbeats; or repeated as coded copies at short intervals. Heartbeats and copies need as
many bytes as the retransmissions with a constant time-out. Loss, the length of its bursts, the latency and the distance
of the evader, which makes changes rarer, are varied one at a time.

In a game at rest, the study measures the mean age of information of announcements that are made periodically.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

from desim.analysis.drawing import palette
from desim.analysis.statistics import Estimate
from desim.analysis.tables import aligned
from scenarios.studies.study import Options, draw_estimates, study
from scenarios.studies.transport_runs import N_REST, ONCE, REFERENCE, SWEEPS, WAYS, WITH_AGES, Cell, N, measure

if TYPE_CHECKING:
    from desim.analysis.drawing.plots import Axes, Figure

LABELS: Mapping[str, str] = MappingProxyType(
    {
        "loss": "share of lost messages",
        "burst": "mean burst of losses (s)",
        "latency": "latency (s)",
        "distance": "distance of the evader (m)",
    }
)


def table(cells: Sequence[Cell], runs: int) -> str:
    """Return all results as text."""
    about = f"{N} pursuers, {runs} runs, 95 % intervals"
    return "\n\n".join(
        [
            *(
                f"{LABELS[swept]}: sum of active times, s: {REFERENCE}, and differences from it: {about}\n"
                f"{_pursuits([cell for cell in cells if cell.swept == swept])}"
                for swept in SWEEPS
            ),
            *(
                f"{LABELS[swept]}: mean age of information in a game at rest, s: {N_REST} pursuers\n"
                f"{_ages([cell for cell in cells if cell.swept == swept])}"
                for swept in SWEEPS
                if swept in WITH_AGES
            ),
        ]
    )


def _pursuits(cells: Sequence[Cell]) -> str:
    compared = [way for way in WAYS if way != REFERENCE]
    lines = [(cells[0].swept, REFERENCE, *compared, *(f"bytes/s, {way}" for way in WAYS))]
    for value, by_way in _by_value(cells).items():
        active = by_way[REFERENCE].active_time
        differences = [by_way[way].difference for way in compared]
        lines.append(
            (
                f"{value:g}",
                f"{active:.1f}",
                *(f"{difference:+.2f}" for difference in differences),
                *(f"{by_way[way].rate:,.0f}" for way in WAYS),
            )
        )
    return aligned(lines)


def _ages(cells: Sequence[Cell]) -> str:
    lines = [(cells[0].swept, *WAYS, *(f"bytes/s, {way}" for way in WAYS))]
    for value, by_way in _by_value(cells).items():
        ages = [age for way in WAYS if (age := by_way[way].age) is not None]
        means = (f"{age:.3f}" for age in ages)
        lines.append((f"{value:g}", *means, *(f"{by_way[way].age_rate:,.0f}" for way in WAYS)))
    return aligned(lines)


def _by_value(cells: Sequence[Cell]) -> dict[float, dict[str, Cell]]:
    by_value: dict[float, dict[str, Cell]] = {}
    for cell in cells:
        by_value.setdefault(cell.value, {})[cell.way] = cell
    return by_value


def picture(cells: Sequence[Cell]) -> "Figure":
    """Draw the paired difference of the active time, and the age of information, a line per way to announce."""
    from desim.analysis.drawing import plots

    with plots.styled(figsize=(9.0, 5.5)) as figure:
        grid = figure.subplots(2, len(SWEEPS), squeeze=False)
        for (above, below), swept in zip(grid.T, SWEEPS, strict=True):
            line = [cell for cell in cells if cell.swept == swept]
            repeated = [way for way in WAYS if way != ONCE]
            draw(above, swept, {way: [cell.difference for cell in line if cell.way == way] for way in repeated})
            if swept in WITH_AGES:
                ages = {way: [cell.age for cell in line if cell.way == way and cell.age is not None] for way in WAYS}
                draw(below, swept, ages)
                below.set(yscale="log")
                below.set_xlabel(LABELS[swept])
            else:
                above.set_xlabel(LABELS[swept])
                below.axis("off")
                below.legend(*grid[1, 0].get_legend_handles_labels(), fontsize=8, loc="center")
        grid[0, 0].set_ylabel("active time minus that\nwith heartbeats (s)")
        grid[1, 0].set_ylabel("mean age of information (s)")
    return figure


def draw(axes: "Axes", swept: str, lines: Mapping[str, Sequence[Estimate]]) -> None:
    """Draw estimates over the property that varies, a line per way to announce."""
    values = SWEEPS[swept]
    for k, (colour, mark, way) in enumerate(zip(palette.SERIES, palette.MARKERS, WAYS, strict=False)):
        if way not in lines:
            continue
        places = [place + 0.05 * (k - 2) for place in range(len(values))]  # shifted, so that error bars are seen
        draw_estimates(axes, places, lines[way], color=colour, marker=mark, label=way)
    axes.set_xticks(range(len(values)), [f"{value:g}" for value in values])


@study("transport", __doc__, seconds=6, runs=8)
def main(options: Options) -> None:
    """Run the pursuits and show the results."""
    cells = measure(options)
    options.show({"cells": cells}, table(cells, options.runs), lambda: picture(cells))


if __name__ == "__main__":
    main()
