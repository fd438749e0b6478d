"""Measure how fast desim is: deliveries per second beside other ways and other simulators, and what else costs time.

Nodes take turns, one a millisecond: a node reads what it has heard and broadcasts the number of the turn. `publish` and
`send` are desim's. `heapq` is a bare loop over a heap with an entry per broadcast; simpy-broadcast an event per
broadcast in SimPy; simpy-message a Timeout per delivery, simpy-drawn-at-once the same with the latencies of a broadcast
drawn at once; simpy-documented a store per node and a process per message. They all must end with the same tables. The
other simulators are installed or built in a folder that is thrown away: ns-3 and SimGrid in C++ (Debian's packages;
nothing is installed, no root needed), Mesa, GrADyS-SIM and mango; they must make as many deliveries. The ways take
turns, lap after lap; what counts is the time of a core, median of the laps. Then come the other costs, each beside what
it may be at most.
"""

import gc
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click
from tqdm import tqdm

from desim.analysis.tables import aligned
from scenarios import costs, measuring
from scenarios.peers.elsewhere import PEERS, UnavailableError
from scenarios.peers.ways import WAYS
from scenarios.peers.workloads import Workload, workloads
from scenarios.study import Options, study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from scenarios.peers.workloads import Outcome

OURS = ("publish", "send")
BROADCASTS = "broadcasts"
"""The part of the study that is not one of `costs.PARTS`."""
LONG = 5.0
"""A lap that takes longer is not repeated, s."""
Commands = Mapping[str, Sequence[str]]
"""What runs the programs of other simulators, by name."""


@dataclass(frozen=True)
class Rate:
    """How fast one way delivers one workload."""

    workload: str
    way: str
    deliveries: int
    """Of a lap."""
    per_second: float
    """Deliveries in a second of a core, median of the laps."""


class Laps:
    """The laps of one workload by all ways; a simulator that fails is left out from then on, and why is noted."""

    def __init__(self, work: Workload, commands: Commands, missing: dict[str, str]):
        self._work, self._commands, self._missing = work, commands, missing
        self._expected: Outcome | None = None
        self._deliveries: dict[str, int] = {}
        self._seconds: dict[str, list[float]] = {}

    def lap(self, name: str) -> None:
        """Do one lap by a way, unless its first took long.

        Raises:
            RuntimeError: if it does not end with the tables of the ways before it.
        """
        if name in self._missing or self._seconds.get(name, [0.0])[0] > LONG:
            return
        try:
            deliveries, seconds = self._here(name) if name in WAYS else self._elsewhere(name)
        except UnavailableError as reason:
            self._missing[name] = f"{self._work.name}: {reason}"
            self._seconds.pop(name, None)
            return
        self._deliveries[name] = deliveries
        self._seconds.setdefault(name, []).append(seconds)

    def rates(self) -> list[Rate]:
        """Return what the laps came to."""
        return [
            Rate(self._work.name, name, self._deliveries[name], self._deliveries[name] / median(laps))
            for name, laps in self._seconds.items()
        ]

    def _here(self, name: str) -> tuple[int, float]:
        way = WAYS[name](self._work)
        gc.collect()
        begin = time.process_time()
        way.run()
        seconds = time.process_time() - begin
        outcome = way.outcome()
        if outcome != (self._expected or outcome):
            raise RuntimeError(f"{self._work.name}: {name} does not end with the tables of the others")
        self._expected = outcome
        return outcome.delivered, seconds

    def _elsewhere(self, name: str) -> tuple[int, float]:
        return PEERS[name].run(self._commands[name], self._work)


@contextmanager
def environments(names: Sequence[str], missing: dict[str, str]) -> Iterator[Commands]:
    """Make the environments of other simulators, and throw them away; note of those that cannot be had why."""
    with TemporaryDirectory(prefix="peers-") as folder:
        commands = {}
        for name in tqdm(names, desc="environments", unit="", disable=None):
            try:
                commands[name] = PEERS[name].make(Path(folder) / name)
            except UnavailableError as reason:
                missing[name] = str(reason)
                click.echo(f"without {name}: {reason}", err=True)
        yield commands


def measure(options: Options, works: Sequence[Workload], ways: Sequence[str]) -> tuple[list[Rate], dict[str, str]]:
    """Return how fast each way delivers each workload, and why some do not."""
    missing: dict[str, str] = {}
    rates: list[Rate] = []
    bar: tqdm[Any]
    with (
        environments([name for name in ways if name in PEERS], missing) as commands,
        tqdm(total=len(works) * options.runs * len(ways), desc=BROADCASTS, unit="lap", disable=None) as bar,
    ):
        for work in works:
            laps = Laps(replace(work, seed=options.seed), commands, missing)
            for _ in range(options.runs):
                for name in ways:
                    bar.set_postfix_str(f"{short(work.name)} {name}")
                    laps.lap(name)
                    bar.update()
            rates += laps.rates()
    return rates, missing


def short(workload: str) -> str:
    """Return the short name of a workload."""
    return workload.partition(":")[0]


def table(rates: Sequence[Rate], missing: Mapping[str, str], laps: int) -> str:
    """Return what was measured, how many times as fast desim is, and what is missing."""
    works, ways = list(dict.fromkeys(each.workload for each in rates)), list(dict.fromkeys(each.way for each in rates))
    found = {(each.workload, each.way): each.per_second for each in rates}
    heads = [short(work) for work in works]
    speeds, ratios = [["", *heads]], [["", *(f"{head} {ours}" for head in heads for ours in OURS)]]
    for way in ways:
        speeds.append([way, *(_told(found.get((work, way)), 1e3, 0) for work in works)])
        if way not in OURS:
            line = [(found.get((work, ours)), found.get((work, way))) for work in works for ours in OURS]
            ratios.append([way, *(_told(own, other, 2) if other else "-" for own, other in line)])
    return "\n".join(
        [
            f"Thousand deliveries per second of a core, medians of {laps} laps",
            *works,
            aligned(speeds),
            "\nHow many times as fast desim is as",
            aligned(ratios),
            *(f"without {name}: {reason}" for name, reason in missing.items()),
        ]
    )


def _told(value: float | None, unit: float, digits: int) -> str:
    return "-" if value is None else f"{value / unit:,.{digits}f}"


def picture(rates: Sequence[Rate]) -> "Figure":
    """Draw a panel per workload with a bar per way, the fastest on top."""
    from desim.analysis import plots

    works = list(dict.fromkeys(each.workload for each in rates))
    columns = min(2, len(works))
    rows = -(-len(works) // columns)
    ranked = sorted(rates, key=lambda each: each.per_second)
    here = [[each for each in ranked if each.workload == work] for work in works]
    with plots.styled(figsize=(4.6 * columns, 0.6 + rows * (0.5 + 0.19 * max(map(len, here))))) as figure:
        for axes, work, bars in zip(figure.subplots(rows, columns, squeeze=False).flat, works, here, strict=False):
            speeds = [each.per_second for each in bars]
            colours = [plots.SERIES[0] if each.way in OURS else plots.GREY for each in bars]
            drawn = axes.barh([each.way for each in bars], speeds, color=colours, height=0.7)
            axes.bar_label(drawn, [f" {speed / 1e3:,.0f}" for speed in speeds], fontsize=8)
            axes.set_xscale("log")
            axes.set_xlim(min(speeds) / 2, max(speeds) * 5)
            axes.set_title(work, fontsize=9)
            axes.tick_params(axis="y", length=0)
        figure.supxlabel("deliveries per second of a core; beside the bars in thousands", fontsize=9)
    return figure


def _chosen(allowed: Sequence[str]) -> Any:
    """Return what checks a list of names with commas between them."""

    def check(_: click.Context, __: click.Parameter, given: str | None) -> list[str]:
        names = given.split(",") if given else list(allowed)
        for name in names:
            if name not in allowed:
                raise click.BadParameter(f"there is no {name!r}: {', '.join(allowed)}")
        return names

    return check


SHORT = [short(work.name) for work in workloads()]


@study(
    "benchmarks",
    __doc__,
    3,
    click.Option(["--only"], callback=_chosen([*WAYS, *PEERS]), help="Ways, with commas between; all if absent."),
    click.Option(["--workloads"], callback=_chosen(SHORT), help=f"Of {','.join(SHORT)}; all if absent."),
    click.Option(["--peers/--no-peers"], default=True, show_default=True, help="With other simulators."),
    click.Option(
        ["--parts"],
        callback=_chosen([BROADCASTS, *costs.PARTS]),
        help=f"Of {','.join([BROADCASTS, *costs.PARTS])}; all if absent.",
    ),
)
def main(options: Options) -> None:
    """Measure, compare, show."""
    own = options.own
    ways = [name for name in own["only"] if own["peers"] or name not in PEERS]
    document: dict[str, Any] = {}
    said, rates = [], list[Rate]()
    if BROADCASTS in own["parts"]:
        works = [work for work in workloads() if short(work.name) in own["workloads"]]
        rates, missing = measure(options, works, ways)
        document |= {BROADCASTS: [asdict(each) for each in rates], "missing": missing}
        said.append(table(rates, missing, options.runs))
    asked = [name for name in costs.PARTS if name in own["parts"]]
    found = {name: costs.PARTS[name](options) for name in tqdm(asked, desc="costs", unit="part", disable=None)}
    if found:
        document["costs"] = {name: [asdict(each) for each in part] for name, part in found.items()}
        said.append(measuring.table(found))
    options.show(document, "\n\n".join(said), (lambda: picture(rates)) if rates else None)


if __name__ == "__main__":
    main()
