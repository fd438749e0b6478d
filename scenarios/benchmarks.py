"""Measure the speed of desim: deliveries per second of desim, of other implementations and simulators, and other costs.

Nodes take turns, one per millisecond: a node reads the messages it has received and broadcasts the number of the turn.
`publish` and `send` are the two ways of desim. `heapq` is a bare loop over a heap with one entry per broadcast.
simpy-broadcast uses one SimPy event per broadcast, simpy-message one Timeout per delivery, simpy-drawn-at-once the same
with all latencies of a broadcast drawn at once, simpy-documented a store per node and a process per message. All of
these must end with the same tables. The other simulators are installed or built in a temporary folder: ns-3 and SimGrid
in C++ (from Debian packages that are unpacked, not installed; no root needed), Mesa, GrADyS-SIM and mango. They must
make the same number of deliveries. The ways run in rotation, lap after lap; each rate is the median over the laps, per
second of CPU time. The other costs follow, each with its limit.
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
"""CPU time of a first lap beyond which the lap is not repeated, s."""
Commands = Mapping[str, Sequence[str]]
"""The command that runs the program of each other simulator, by name."""


@dataclass(frozen=True)
class Rate:
    """The delivery rate of one way on one workload."""

    workload: str
    way: str
    deliveries: int
    """Number of deliveries in a lap."""
    per_second: float
    """Deliveries per second of CPU time, median of the laps, 1/s."""


class Laps:
    """The laps of all ways on one workload; a simulator that fails is skipped from then on, and the reason is kept."""

    def __init__(self, work: Workload, commands: Commands, missing: dict[str, str]):
        self._work, self._commands, self._missing = work, commands, missing
        self._expected: Outcome | None = None
        self._deliveries: dict[str, int] = {}
        self._seconds: dict[str, list[float]] = {}

    def lap(self, name: str) -> None:
        """Run one lap of a way, unless its first lap was longer than `LONG`.

        Raises:
            RuntimeError: if its final tables differ from those of the ways before it.
        """
        if name in self._missing or self._seconds.get(name, [0.0])[0] > LONG:
            return
        try:
            deliveries, seconds = self._run_here(name) if name in WAYS else self._run_program(name)
        except UnavailableError as reason:
            self._missing[name] = f"{self._work.name}: {reason}"
            self._seconds.pop(name, None)
            return
        self._deliveries[name] = deliveries
        self._seconds.setdefault(name, []).append(seconds)

    def rates(self) -> list[Rate]:
        """Return the rate of each way that has not failed."""
        return [
            Rate(self._work.name, name, self._deliveries[name], self._deliveries[name] / median(laps))
            for name, laps in self._seconds.items()
        ]

    def _run_here(self, name: str) -> tuple[int, float]:
        way = WAYS[name](self._work)
        gc.collect()
        begin = time.process_time()
        way.run()
        seconds = time.process_time() - begin
        outcome = way.outcome()
        if outcome != (self._expected or outcome):
            raise RuntimeError(f"{self._work.name}: the final tables of {name} differ from those of the others")
        self._expected = outcome
        return outcome.delivered, seconds

    def _run_program(self, name: str) -> tuple[int, float]:
        return PEERS[name].run(self._commands[name], self._work)


@contextmanager
def environments(names: Sequence[str], missing: dict[str, str]) -> Iterator[Commands]:
    """Make temporary environments of other simulators; put the reason into `missing` for each that is unavailable."""
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
    """Return the rate of each way on each workload, and the reason for each simulator that is missing."""
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
    """Return the rates, the ratios of the rates of desim to the others, and the missing simulators as text."""
    works, ways = list(dict.fromkeys(each.workload for each in rates)), list(dict.fromkeys(each.way for each in rates))
    found = {(each.workload, each.way): each.per_second for each in rates}
    heads = [short(work) for work in works]
    speeds, ratios = [["", *heads]], [["", *(f"{head} {ours}" for head in heads for ours in OURS)]]
    for way in ways:
        speeds.append([way, *(_quotient(found.get((work, way)), 1e3, 0) for work in works)])
        if way not in OURS:
            line = [(found.get((work, ours)), found.get((work, way))) for work in works for ours in OURS]
            ratios.append([way, *(_quotient(own, other, 2) if other else "-" for own, other in line)])
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
        figure.supxlabel("deliveries per second of CPU time; numbers at the bars in thousands", fontsize=9)
    return figure


def _names_from(allowed: Sequence[str]) -> Any:
    """Return the callback of an option that takes a list of names, separated by commas."""

    def check(_: click.Context, __: click.Parameter, given: str | None) -> list[str]:
        names = given.split(",") if given else list(allowed)
        for name in names:
            if name not in allowed:
                raise click.BadParameter(f"there is no {name!r}; choose from {', '.join(allowed)}")
        return names

    return check


SHORT = [short(work.name) for work in workloads()]


@study(
    "benchmarks",
    __doc__,
    3,
    click.Option(["--only"], callback=_names_from([*WAYS, *PEERS]), help="Ways, separated by commas; default: all."),
    click.Option(["--workloads"], callback=_names_from(SHORT), help=f"Some of {','.join(SHORT)}; default: all."),
    click.Option(["--peers/--no-peers"], default=True, show_default=True, help="Include other simulators."),
    click.Option(
        ["--parts"],
        callback=_names_from([BROADCASTS, *costs.PARTS]),
        help=f"Some of {','.join([BROADCASTS, *costs.PARTS])}; default: all.",
    ),
)
def main(options: Options) -> None:
    """Measure, compare and show."""
    own = options.own
    ways = [name for name in own["only"] if own["peers"] or name not in PEERS]
    document: dict[str, Any] = {}
    tables, rates = [], list[Rate]()
    if BROADCASTS in own["parts"]:
        works = [work for work in workloads() if short(work.name) in own["workloads"]]
        rates, missing = measure(options, works, ways)
        document |= {BROADCASTS: [asdict(each) for each in rates], "missing": missing}
        tables.append(table(rates, missing, options.runs))
    asked = [name for name in costs.PARTS if name in own["parts"]]
    found = {name: costs.PARTS[name](options) for name in tqdm(asked, desc="costs", unit="part", disable=None)}
    if found:
        document["costs"] = {name: [asdict(each) for each in part] for name, part in found.items()}
        tables.append(measuring.table(found))
    options.show(document, "\n\n".join(tables), (lambda: picture(rates)) if rates else None)


if __name__ == "__main__":
    main()
