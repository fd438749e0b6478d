"""Measure the delivery rates of desim, a bare loop, SimPy and other simulators; also measure other costs of desim.

Nodes take turns, one per millisecond: a node reads the messages it has received and broadcasts the number of the turn.
The broadcasts are delivered in several ways (`--only`). `publish` and `send` are the two ways of desim. `heapq` is a
bare loop over a heap with one entry per broadcast. simpy-broadcast uses one SimPy event per broadcast. simpy-message
uses one Timeout per delivery; simpy-drawn-at-once does so, too, but draws all latencies of a broadcast at once.
simpy-documented uses a store per node and a process per message. All of these must end with the same tables of received
numbers. The other simulators are installed or built in a temporary folder: ns-3 and SimGrid in C++ (from Debian
packages that are unpacked, not installed; no root needed), Mesa, GrADyS-SIM and mango. Each of them must make the right
number of deliveries; mango runs a tenth of the turns only.

`--runs` is the number of laps. Every way runs once in each lap; a way that takes more than 5 s in the first lap is left
out of the later ones. A rate is the number of deliveries in a lap divided by the median CPU time of the laps.

Then the costs of large teams, losses on arrival, whole runs, recording, start-up, replays and live runs are measured,
in time, memory and size. Some costs have an upper limit; the table marks a cost above its limit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click
from tqdm import tqdm

from desim.analysis.drawing import palette
from desim.analysis.tables import aligned
from scenarios.benchmarks import costs, measuring
from scenarios.benchmarks.peers.elsewhere import PEERS
from scenarios.benchmarks.peers.ways import WAYS
from scenarios.benchmarks.peers.workloads import workloads
from scenarios.studies.study import Options, study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

from scenarios.benchmarks.rates import BROADCASTS, DESIM_WAYS, WORKLOAD_NAMES, Rate, measure, short


def table(rates: Sequence[Rate], missing: Mapping[str, str], laps: int) -> str:
    """Return as text the rates, the ratios of desim's rates to those of others, and the missing simulators."""
    works, ways = list(dict.fromkeys(rate.workload for rate in rates)), list(dict.fromkeys(rate.way for rate in rates))
    speed = {(rate.workload, rate.way): rate.per_second for rate in rates}
    heads = [short(work) for work in works]
    speeds, ratios = [["", *heads]], [["", *(f"{head} {ours}" for head in heads for ours in DESIM_WAYS)]]
    for way in ways:
        speeds.append([way, *(_quotient(speed.get((work, way)), 1e3, 0) for work in works)])
        if way not in DESIM_WAYS:
            pairs = [(speed.get((work, ours)), speed.get((work, way))) for work in works for ours in DESIM_WAYS]
            ratios.append([way, *(_quotient(of_desim, other, 2) if other else "-" for of_desim, other in pairs)])
    return "\n".join(
        [
            f"Thousand deliveries per second of CPU time, medians of {laps} laps",
            *works,
            aligned(speeds),
            "\nRate of desim / rate of",
            aligned(ratios),
            *(f"without {name}: {reason}" for name, reason in missing.items()),
        ]
    )


def _quotient(value: float | None, unit: float, digits: int) -> str:
    return "-" if value is None else f"{value / unit:,.{digits}f}"


def picture(rates: Sequence[Rate]) -> "Figure":
    """Draw a panel per workload with a bar per way, the fastest at the top."""
    from desim.analysis.drawing import plots

    works = list(dict.fromkeys(rate.workload for rate in rates))
    columns = min(2, len(works))
    rows = -(-len(works) // columns)
    ranked = sorted(rates, key=lambda rate: rate.per_second)
    panels = [[rate for rate in ranked if rate.workload == work] for work in works]
    with plots.styled(figsize=(4.6 * columns, 0.6 + rows * (0.5 + 0.19 * max(map(len, panels))))) as figure:
        for axes, work, bars in zip(figure.subplots(rows, columns, squeeze=False).flat, works, panels, strict=False):
            speeds = [rate.per_second for rate in bars]
            colours = [palette.SERIES[0] if rate.way in DESIM_WAYS else palette.GREY for rate in bars]
            drawn_bars = axes.barh([rate.way for rate in bars], speeds, color=colours, height=0.7)
            axes.bar_label(drawn_bars, [f" {speed / 1e3:,.0f}" for speed in speeds], fontsize=8)
            axes.set_xscale("log")
            axes.set_xlim(min(speeds) / 2, max(speeds) * 5)
            axes.set_title(work, fontsize=9)
            axes.tick_params(axis="y", length=0)
        figure.supxlabel("deliveries per second of CPU time; numbers at the bars in thousands", fontsize=9)
    return figure


def _names_from(allowed: Sequence[str]) -> Any:
    """Return the callback of an option that takes a list of names, separated by commas."""

    def check(_: click.Context, __: click.Parameter, text: str | None) -> list[str]:
        names = text.split(",") if text else list(allowed)
        for name in names:
            if name not in allowed:
                raise click.BadParameter(f"there is no {name!r}; choose from {', '.join(allowed)}")
        return names

    return check


@study(
    "benchmarks",
    __doc__,
    3,
    click.Option(["--only"], callback=_names_from([*WAYS, *PEERS]), help="Ways, separated by commas; default: all."),
    click.Option(
        ["--workloads"], callback=_names_from(WORKLOAD_NAMES), help=f"Some of {','.join(WORKLOAD_NAMES)}; default: all."
    ),
    click.Option(["--peers/--no-peers"], default=True, show_default=True, help="Include other simulators."),
    click.Option(
        ["--parts"],
        callback=_names_from([BROADCASTS, *costs.PARTS]),
        help=f"Some of {','.join([BROADCASTS, *costs.PARTS])}; default: all.",
    ),
)
def main(options: Options) -> None:
    """Measure, compare and show."""
    choices = options.extra
    ways = [name for name in choices["only"] if choices["peers"] or name not in PEERS]
    document: dict[str, Any] = {}
    tables, rates = [], list[Rate]()
    if BROADCASTS in choices["parts"]:
        works = [work for work in workloads() if short(work.name) in choices["workloads"]]
        rates, missing = measure(options, works, ways)
        document |= {BROADCASTS: [asdict(rate) for rate in rates], "missing": missing}
        tables.append(table(rates, missing, options.runs))
    parts = [name for name in costs.PARTS if name in choices["parts"]]
    costs_of = {name: costs.PARTS[name](options) for name in tqdm(parts, desc="costs", unit="part", disable=None)}
    if costs_of:
        document["costs"] = {name: [asdict(cost) for cost in part] for name, part in costs_of.items()}
        tables.append(measuring.table(costs_of))
    options.show(document, "\n\n".join(tables), (lambda: picture(rates)) if rates else None)


if __name__ == "__main__":
    main()
