"""At which load do announcements hurt? Pursuits over a contended channel, by protocol, access model and offered load.

The offered load is the airtime of the heartbeats of all pursuers as a share of the time. The study compares three
protocols that announce actions, and a token ring, which sends no announcements: its pursuers hold the token for its
airtime divided by the load. The channel is an ideal queue, or nodes contend for it by ALOHA, CSMA/CA or TDMA.

In a game at rest, the study measures the mean age of information by heartbeat, beside the optimum in theory under
ALOHA. For LoRa at a duty cycle of 1 %, it counts the pursuits that are over before a pursuer may announce its action a
second time.
"""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING

from desim.analysis.drawing import palette
from desim.analysis.tables import aligned
from scenarios.studies.contention_runs import (
    ACCESSES,
    AIRTIME,
    JITTER,
    LOADS,
    NAMES,
    REFERENCE,
    TEAM_SIZES,
    Age,
    LoRaPursuits,
    N,
    Pursuits,
    best_heartbeat,
    measure,
    measure_ages,
    measure_lora,
)
from scenarios.studies.study import Options, draw_estimates, study

if TYPE_CHECKING:
    from desim.analysis.drawing.plots import Axes, Figure

TICKS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Ticks of the heartbeat, s."""


def table(pursuits: Sequence[Pursuits], ages: Sequence[Age], lora: Sequence[LoRaPursuits], runs: int) -> str:
    """Return all results as text."""
    about_runs = f"{N} pursuers, {AIRTIME:g} s per announcement, {runs} runs, 95 % intervals"
    about = "sum of active times, s, and its difference from that over an ideal queue; share of messages lost"
    cells = {(pursuit.protocol, pursuit.access, pursuit.load): pursuit for pursuit in pursuits}
    return "\n\n".join(
        [
            *(f"{name}: {about}: {about_runs}\n{_pursuits(name, cells)}" for name in NAMES),
            f"Heartbeat with the least mean age of information, of those tried, with jitter {JITTER}\n{_best(ages)}",
            f"LoRa, local_min: {N} pursuers, {runs} runs\n{_lora(lora)}",
        ]
    )


def _pursuits(name: str, cells: Mapping[tuple[str, str, float], Pursuits]) -> str:
    compared = [access for access in ACCESSES if access != REFERENCE]
    lines = [("load", "heartbeat", REFERENCE, *compared, *(f"lost, {access}" for access in ACCESSES))]
    for load in LOADS:
        reference = cells[name, REFERENCE, load]
        active = f"{reference.active_time:.1f}"
        differences = [f"{cells[name, access, load].difference:+.2f}" for access in compared]
        lost = [f"{cells[name, access, load].lost:.0%}" for access in ACCESSES]
        lines.append((f"{load:g}", f"{reference.heartbeat:.3g} s", active, *differences, *lost))
    return aligned(lines)


def _best(ages: Sequence[Age]) -> str:
    lines = [("N", "theory, ALOHA", *ACCESSES)]
    for size in TEAM_SIZES:
        measured = [[age for age in _ages_of(ages, access, size) if isfinite(age.age.mean)] for access in ACCESSES]
        best = [min(line, key=lambda age: age.age.mean, default=None) for line in measured]
        texts = ["-" if age is None else f"{age.heartbeat:.2f} s (age {age.age.mean:.2f} s)" for age in best]
        lines.append((str(size), f"{best_heartbeat(size):.2f} s", *texts))
    return aligned(lines)


def _lora(pursuits: Sequence[LoRaPursuits]) -> str:
    lines = [("SF", "airtime", "shortest interval", "pursuit takes", "over before the second")]
    for pursuit in pursuits:
        takes = f"{pursuit.end_time:.1f} s"
        line = (
            str(pursuit.spreading_factor),
            f"{pursuit.airtime:.3f} s",
            f"{pursuit.interval:.1f} s",
            takes,
            f"{pursuit.over:.0%}",
        )
        lines.append(line)
    return aligned(lines)


def _ages_of(ages: Sequence[Age], access: str, size: int) -> list[Age]:
    return [age for age in ages if (age.access, age.size) == (access, size)]


def picture(pursuits: Sequence[Pursuits], ages: Sequence[Age]) -> "Figure":
    """Draw the paired difference of the active time over the load, and the age of information over the heartbeat."""
    from desim.analysis.drawing import plots

    with plots.styled(figsize=(9.0, 6.0)) as figure:
        above, below = figure.subfigures(2, 1, squeeze=False)[:, 0]
        grid = above.subplots(1, len(NAMES))
        for axes, name in zip(grid, NAMES, strict=True):
            draw_pursuits(axes, [pursuit for pursuit in pursuits if pursuit.protocol == name])
            axes.set_title(name, fontsize=9)
        grid[0].set_ylabel("active time minus that\nover an ideal queue (s)")
        grid[-1].legend(fontsize=7, loc="upper left")
        above.supxlabel("offered load", fontsize=9)
        rests = below.subplots(1, len(TEAM_SIZES), squeeze=False)[0]
        for axes, size in zip(rests, TEAM_SIZES, strict=True):
            draw_ages(axes, ages, size)
        rests[0].set_ylabel("mean age of information (s)")
        below.supxlabel("heartbeat (s); dotted: optimum of ALOHA in theory", fontsize=9)
    return figure


def draw_pursuits(axes: "Axes", pursuits: Sequence[Pursuits]) -> None:
    """Draw the paired difference of the active time over the offered load, a line per access model."""
    for k, (colour, mark, access) in enumerate(zip(palette.SERIES, palette.MARKERS, ACCESSES, strict=False)):
        line = [pursuit for pursuit in pursuits if pursuit.access == access]
        x = [pursuit.load * 1.04 ** (k - 1.5) for pursuit in line]  # shifted, so that error bars do not overlap
        draw_estimates(axes, x, [pursuit.difference for pursuit in line], color=colour, marker=mark, label=access)
    axes.set(xscale="log")
    axes.set_xticks(LOADS, [f"{load:g}" for load in LOADS], fontsize=7)
    axes.minorticks_off()


def draw_ages(axes: "Axes", ages: Sequence[Age], size: int) -> None:
    """Draw the mean age of information of a team over the heartbeat, a line per access model."""
    for colour, mark, access in zip(palette.SERIES, palette.MARKERS, ACCESSES, strict=False):
        line = _ages_of(ages, access, size)
        x = [age.heartbeat for age in line]
        draw_estimates(axes, x, [age.age for age in line], color=colour, marker=mark, elinewidth=None)
    axes.axvline(best_heartbeat(size), color=palette.GREY, ls=":")
    axes.set(xscale="log", ylim=(0, None))
    axes.set_title(f"{size} pursuers", fontsize=9)
    low, high = axes.get_xlim()
    ticks = [tick for tick in TICKS if low <= tick <= high]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks], fontsize=7)
    axes.minorticks_off()


@study("contention", __doc__, seconds=7, runs=20)
def main(options: Options) -> None:
    """Run the pursuits and show the results."""
    pursuits, ages, lora = measure(options), measure_ages(options), measure_lora(options)
    document = {
        "pursuits": pursuits,
        "ages": ages,
        "best_heartbeats": {str(size): best_heartbeat(size) for size in TEAM_SIZES},
        "lora": lora,
    }
    options.show(document, table(pursuits, ages, lora, options.runs), lambda: picture(pursuits, ages))


if __name__ == "__main__":
    main()
