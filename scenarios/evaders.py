"""Which evader lives longest, whoever chases it, and what becomes of a pursuit in which nobody sees far?

First, the scenario of the paper, in which one pursuer is twice as fast as the others: every strategy of the evader
against Spatial Adaptive Play on an ideal network, and against several protocols at one latency. Everybody decides ten
times a second on the average, and all runs have the same seeds, so that strategies can be compared run by run with the
paper's: pure evasion of the nearest pursuer, whether that chases or not.

Second, an evader that wanders among robots of which most are too slow to capture it: they watch, and report what they
see; two chase, going by those reports where they do not see for themselves. By how far everybody sees, and by what is
made of sightings that are old: where the evader was; where it would be at the velocity it had; or as far away as it may
be by now.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from math import inf
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import numpy as np

from desim import Result, Scenario, summary
from desim.analysis.metrics import Summary, active_time, captured, end_time
from desim.analysis.statistics import estimate, wilson
from desim.analysis.tables import aligned, json_number
from desim.kernel.events import Sent
from desim.kernel.latency import Constant
from desim.kernel.links import Links
from desim.pursuit.announcements import Announcements
from desim.pursuit.evasion import (
    ConstantHeading,
    Diffusion,
    Listener,
    MaxMin,
    PureEvasion,
    Still,
    Strategy,
    VoronoiVertex,
    WeightedFlee,
    Zigzag,
)
from desim.pursuit.events import Sampled
from desim.pursuit.sensing import Sensing, Sighting
from desim.scenario.scenario import Evader, Recording, Team
from scenarios.rivals import N, contender
from scenarios.study import Options, study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LATENCY = 0.1
"""One-way latency L, s."""
STRATEGIES: Mapping[str, Strategy] = MappingProxyType(
    {
        "pure evasion": PureEvasion(),
        "pure, of active": PureEvasion(flees_from="active"),
        "weighted flee": WeightedFlee(),
        "max-min": MaxMin(),
        "max-min, of active": MaxMin(flees_from="active"),
        "zigzag": Zigzag(),
        "Voronoi vertex": VoronoiVertex(arena=(0.0, 20.0)),
        "diffusion": Diffusion(),
        "constant heading": ConstantHeading(),
        "listener": Listener(),
        "still": Still(),
    }
)
REFERENCE = "pure evasion"
CLAIMED = "pure, of active"
"""It lives longer than the reference."""
IDEAL = "sap, ideal"
PROTOCOLS = (IDEAL, "sap", "local_min", "cbba", "server", "voronoi", "centralised")
NEAREST = "voronoi"
"""In which, of these protocols, the fast pursuer need not come to chase."""
MORE = 3
"""How many times as many runs the second table takes, which is about shares."""
RADII = (2.0, 4.0, 8.0, 16.0, inf)
"""R_s, m."""
HELD = "hold"
ESTIMATES: Mapping[str, str] = MappingProxyType(
    {HELD: "hold", "constant_velocity": "constant velocity", "worst_case": "worst case"}
)
SPOKEN = Announcements(heartbeat=0.5)
"""Actions are told as they change, and twice a second."""
WATCHERS, CHASERS = 10, 2
WATCHED = Scenario(
    name="limited sight",
    team=Team(count=WATCHERS + CHASERS, speeds=(0.5,) * WATCHERS + (1.5,) * CHASERS),
    evader=Evader(speed=1.2, strategy=Diffusion(sigma=0.4)),
    sensing=Sensing(track_timeout=2.0),
    protocol=contender("sap"),
    announce=SPOKEN,
    record=Recording(messages=True),
)
"""Whoever sees the evader cannot chase it, and whoever chases it does not see it at first."""


@dataclass(frozen=True)
class Cell:
    """What one strategy came to against one protocol, means over the runs."""

    strategy: str
    protocol: str
    latency: float
    """s"""
    survival: float
    """Time to capture, or t_f where there was none, s."""
    half_width: float
    """Of the 95 % interval of that, s."""
    difference: float
    """Survival less that of pure evasion in the same runs, s."""
    difference_half_width: float
    captured: float
    """Share of the runs."""
    active_time: float
    active_half_width: float
    handovers: float


@dataclass(frozen=True)
class Sighted:
    """What limited sight came to under one estimate, means over the runs."""

    radius: float
    """m"""
    estimate: str
    captured: float
    """Share of the runs."""
    captured_low: float
    """Ends of its 95 % Wilson interval."""
    captured_high: float
    survival: float
    """Time to capture, or t_f where there was none, s."""
    half_width: float
    difference: float
    """Survival less that in the same runs if the evader is held to be where it was last seen, s."""
    difference_half_width: float
    active_time: float
    active_half_width: float
    active_difference: float
    """Active time less that in the same runs if it is held to be there, s."""
    active_difference_half_width: float
    never_seen: float
    """Share of the runs in which nobody ever saw the evader."""
    lost: float
    """Share of the runs in which somebody did, and then for longer than `track_timeout` nobody."""
    reports: float
    """Messages with sightings, each receiver counted as one, per second of the pursuit."""
    report_transmissions: float
    """How many times sightings were put on the air, per second."""


class Watched(NamedTuple):
    """The numbers of one run with limited sight; see `Sighted`."""

    captured: bool
    survival: float
    active_time: float
    never_seen: bool
    lost: bool
    reports: int
    report_transmissions: int


def chase(strategy: str, protocol: str, latency: float = LATENCY) -> Scenario:
    """Return one scenario of the first table; the latency (s) does not matter to the ideal network."""
    ideal = protocol == IDEAL
    return Scenario(
        name=f"{strategy}, {protocol}",
        team=Team(count=N),
        evader=Evader(strategy=STRATEGIES[strategy]),
        protocol=contender("sap" if ideal else protocol),
        announce=SPOKEN,
        network=Links(latency=Constant(value=0.0 if ideal else latency)),
        record=Recording(trajectory=0.0),
    )


def watched(radius: float, made: str, latency: float = LATENCY) -> Scenario:
    """Return one scenario of the second table: how far they see (m), what is made of old sightings, latency (s)."""
    sensing = WATCHED.sensing.model_copy(update={"radius": radius, "estimate": made})
    return WATCHED.model_copy(update={"sensing": sensing, "network": Links(latency=Constant(value=latency))})


def measure_chases(options: Options, latency: float) -> list[Cell]:
    """Run every strategy against every protocol."""
    keys = [(strategy, protocol) for strategy in STRATEGIES for protocol in PROTOCOLS]
    scenarios = [chase(*key, latency) for key in keys]
    runs = dict(zip(keys, options.measure(scenarios, "strategies", summary), strict=True))
    return [cell(key, latency, runs[key], reference=runs[REFERENCE, key[1]]) for key in keys]


def cell(key: tuple[str, str], latency: float, runs: Sequence[Summary], *, reference: Sequence[Summary]) -> Cell:
    """Return what the runs of a strategy against a protocol came to, beside pure evasion with the same seeds."""
    survival, active = estimate([run.end_time for run in runs]), estimate([run.active_time for run in runs])
    paired = estimate([run.end_time - other.end_time for run, other in zip(runs, reference, strict=True)])
    return Cell(
        *key,
        0.0 if key[1] == IDEAL else latency,
        survival.mean,
        survival.half_width,
        paired.mean,
        paired.half_width,
        sum(run.captured for run in runs) / len(runs),
        active.mean,
        active.half_width,
        estimate([run.handovers for run in runs]).mean,
    )


def measure_sight(options: Options, latency: float) -> list[Sighted]:
    """Run every estimate at every radius; where everything is seen they are all the same."""
    keys = [(radius, made) for radius in RADII for made in (ESTIMATES if radius < inf else [HELD])]
    more = replace(options, runs=MORE * options.runs)
    scenarios = [watched(*key, latency) for key in keys]
    runs = dict(zip(keys, more.measure(scenarios, "sight", observe), strict=True))
    return [sighted(*key, runs[key], reference=runs[key[0], HELD]) for key in keys]


def observe(result: Result) -> Watched:
    """Return what came of one run with limited sight."""
    told = [
        event
        for event in result.trace.of(Sent)
        if isinstance(event.body, tuple) and any(isinstance(each, Sighting) for each in event.body)
    ]
    sensing, period = result.scenario.sensing, result.scenario.record.trajectory
    seen = [_seen(sample, sensing.radius) for sample in result.trace.of(Sampled)]
    since = seen[seen.index(True) :] if any(seen) else []
    longest = max((len(list(part)) for here, part in groupby(since) if not here), default=0)
    return Watched(
        captured(result),
        end_time(result),
        active_time(result),
        not since,
        longest * period > sensing.track_timeout,
        len(told),
        len({event.flight for event in told}),
    )


def _seen(sample: Sampled, radius: float) -> bool:
    """Return whether anybody is so near to the evader, m."""
    gaps = np.array(sample.pursuers) - np.array(sample.evader)
    return bool(np.hypot(gaps[:, 0], gaps[:, 1]).min() <= radius)


def sighted(radius: float, made: str, runs: Sequence[Watched], *, reference: Sequence[Watched]) -> Sighted:
    """Return what the runs with one radius and one estimate came to, beside those with the same seeds that hold."""
    survival, active = estimate([run.survival for run in runs]), estimate([run.active_time for run in runs])
    pairs = list(zip(runs, reference, strict=True))
    longer = estimate([run.survival - other.survival for run, other in pairs])
    more = estimate([run.active_time - other.active_time for run, other in pairs])
    count, duration = len(runs), sum(run.survival for run in runs)
    caught = sum(run.captured for run in runs)
    return Sighted(
        radius,
        made,
        caught / count,
        *wilson(caught, count),
        survival.mean,
        survival.half_width,
        longer.mean,
        longer.half_width,
        active.mean,
        active.half_width,
        more.mean,
        more.half_width,
        sum(run.never_seen for run in runs) / count,
        sum(run.lost for run in runs) / count,
        sum(run.reports for run in runs) / duration,
        sum(run.report_transmissions for run in runs) / duration,
    )


def table(cells: Sequence[Cell], sight: Sequence[Sighted], runs: int) -> str:
    """Return what was measured as text."""
    latency = max(each.latency for each in cells)
    what = f"paper, {N} pursuers, L = {latency:g} s if not ideal, {runs} runs, 95 % intervals"
    return "\n\n".join(
        [
            f"Time to capture, or t_f, s: {what}\n"
            + _grid(cells, lambda each: f"{each.survival:.2f} +- {each.half_width:.2f}"),
            f"The same less that of {REFERENCE} in the same runs, s: {what}\n"
            + _grid(
                [each for each in cells if each.strategy != REFERENCE],
                lambda each: f"{each.difference:+.2f} +- {each.difference_half_width:.2f}",
            )
            + "\n"
            + "\n".join(claims(cells)),
            f"Sum of active times, s: {what}\n"
            + _grid(cells, lambda each: f"{each.active_time:.1f} +- {each.active_half_width:.1f}"),
            f"Captured, and hand-overs per run: {what}\n"
            + _grid(cells, lambda each: f"{each.captured:.0%} {each.handovers:.1f}"),
            _sight_table(sight, latency, MORE * runs),
        ]
    )


def claims(cells: Sequence[Cell]) -> list[str]:
    """Return whether it pays to flee only from those that chase, against Spatial Adaptive Play."""
    told = []
    for each in cells:
        if each.strategy == CLAIMED and each.protocol in (IDEAL, "sap"):
            low, high = each.difference - each.difference_half_width, each.difference + each.difference_half_width
            verdict = "lives longer" if low > 0.0 else "lives less long" if high < 0.0 else "is not told apart"
            told.append(f"{each.protocol}: who flees only the active {verdict} ({low:+.2f} .. {high:+.2f} s)")
    return told


def _grid(cells: Sequence[Cell], said: Callable[[Cell], str]) -> str:
    """Return a row per strategy and a column per protocol."""
    here = {(each.strategy, each.protocol): said(each) for each in cells}
    names = dict.fromkeys(each.strategy for each in cells)
    return aligned([("", *PROTOCOLS), *((name, *(here[name, each] for each in PROTOCOLS)) for name in names)])


def _sight_table(sight: Sequence[Sighted], latency: float, runs: int) -> str:
    heads = ("captured", "95 % interval", "after, or t_f", "less hold", "active", "less hold")
    rows = [("R_s", "estimate", *heads, "never seen", "lost", "reports/s", "on the air/s")]
    for each in sight:
        limited, compared = each.radius < inf, each.estimate != HELD
        rows.append(
            (
                f"{each.radius:g} m" if limited else "inf",
                ESTIMATES[each.estimate] if limited else "",
                f"{each.captured:.0%}",
                f"{each.captured_low:.0%} .. {each.captured_high:.0%}",
                f"{each.survival:.1f} +- {each.half_width:.1f} s",
                f"{each.difference:+.1f} +- {each.difference_half_width:.1f} s" if compared else "",
                f"{each.active_time:.1f} +- {each.active_half_width:.1f} s",
                f"{each.active_difference:+.1f} +- {each.active_difference_half_width:.1f} s" if compared else "",
                f"{each.never_seen:.0%}",
                f"{each.lost:.0%}",
                f"{each.reports:.0f}",
                f"{each.report_transmissions:.1f}",
            )
        )
    lost = f"never seen: by nobody; lost: seen, and then by nobody for longer than {WATCHED.sensing.track_timeout:g} s"
    what = f"{WATCHERS} watch, {CHASERS} chase, sap, L = {latency:g} s, {runs} runs, 95 % intervals"
    return f"Limited sight: {what}\n{lost}\n{aligned(rows, right_from=2)}"


def picture(cells: Sequence[Cell], sight: Sequence[Sighted]) -> "Figure":
    """Draw what each strategy gains over pure evasion, and below what limited sight costs."""
    from desim.analysis import plots

    with plots.styled(figsize=(plots.COLUMN, 4.6), font=7.0) as figure:
        above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(3, 2))[:, 0]
        draw_strategies(above.add_subplot(), cells)
        shares, times = below.subplots(1, 2)
        draw_sight(shares, times, sight)
    return figure


def draw_strategies(axes: "Axes", cells: Sequence[Cell]) -> None:
    """Draw paired differences to pure evasion, a row per strategy: Spatial Adaptive Play with intervals, the rest."""
    from desim.analysis import plots

    here = {(each.strategy, each.protocol): each for each in cells if each.strategy != REFERENCE}
    names = sorted({name for name, _ in here}, key=lambda name: here[name, IDEAL].difference)
    latency = max(each.latency for each in cells)
    rows = np.arange(len(names))
    axes.axvline(0.0, color=plots.GREY, lw=0.6)
    rest = [each for each in PROTOCOLS if each not in (IDEAL, "sap", NEAREST)]
    for kinds, marker, label in (([NEAREST], "x", f"{NEAREST} (nearest)"), (rest, "|", "other protocols")):
        found = [(here[name, each].difference, row) for each in kinds for row, name in enumerate(names)]
        axes.plot(*zip(*found, strict=True), marker, color=plots.GREY, ms=4, mew=0.8, label=label)
    for protocol, off, colour, marker, label in (
        (IDEAL, 0.17, plots.BLUE, "o", "SAP, ideal network"),
        ("sap", -0.17, plots.VERMILION, "s", f"SAP, L = {latency:g} s"),
    ):
        line = [here[name, protocol] for name in names]
        x, error = [each.difference for each in line], [each.difference_half_width for each in line]
        axes.errorbar(x, rows + off, xerr=error, color=colour, marker=marker, ms=3, lw=0, elinewidth=0.8, label=label)
    axes.set_yticks(rows, names)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("lives longer than pure evasion by (s)")
    axes.legend(fontsize=6, loc="upper left", handlelength=1.0)


def draw_sight(shares: "Axes", times: "Axes", sight: Sequence[Sighted]) -> None:
    """Draw the share captured, and the active time, over the radius, a line per estimate."""
    from desim.analysis import plots

    radii = [radius for radius in RADII if radius < inf]
    styles = zip((plots.BLUE, plots.VERMILION, plots.GREEN), "osv", ESTIMATES, strict=True)
    for k, (colour, marker, made) in enumerate(styles):
        line = [each for each in sight if each.estimate == made and each.radius < inf]
        x = [each.radius * 1.08 ** (k - 1) for each in line]  # side by side
        style: dict[str, Any] = {"color": colour, "marker": marker, "ms": 3, "lw": 0.8, "elinewidth": 0.6}
        share = 100.0 * np.array([(each.captured, each.captured_low, each.captured_high) for each in line])
        shares.errorbar(x, share[:, 0], np.abs(share[:, 1:] - share[:, :1]).T, label=ESTIMATES[made], **style)
        times.errorbar(x, [each.active_time for each in line], [each.active_half_width for each in line], **style)
    for axes in (shares, times):
        axes.set(xscale="log", xlabel="sight R$_s$ (m)")
        axes.set_xticks(radii, [f"{radius:g}" for radius in radii])
        axes.minorticks_off()
        axes.set_ylim(bottom=0.0)
    shares.set(ylabel="captured (% of runs)", ylim=(0.0, 105.0))
    times.set_ylabel("active time (s)")
    shares.legend(fontsize=6, loc="lower right", handlelength=1.0)


@study(
    "evaders",
    __doc__,
    20,
    click.Option(
        ["--latency"],
        type=click.FloatRange(min=0.0, max=60.0),
        default=LATENCY,
        show_default=True,
        help="One-way latency, s.",
    ),
)
def main(options: Options) -> None:
    """Measure, compare, show."""
    latency: float = options.own["latency"]
    cells, sight = measure_chases(options, latency), measure_sight(options, latency)
    document = {
        "latency": latency,
        "cells": [asdict(each) for each in cells],
        "sight": [{key: json_number(value) for key, value in asdict(each).items()} for each in sight],
    }
    options.show(document, table(cells, sight, options.runs), lambda: picture(cells, sight))


if __name__ == "__main__":
    main()
