"""The measurements of `python -m scenarios.benchmarks`.

A way is an implementation that delivers the broadcasts of a workload, in this process (`peers.ways`) or in
another simulator (`peers.elsewhere`). A lap is one run of a way on a workload.
"""

import gc
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click
from tqdm import tqdm

from scenarios.benchmarks.peers.elsewhere import PEERS, UnavailableError
from scenarios.benchmarks.peers.ways import WAYS
from scenarios.benchmarks.peers.workloads import Workload, workloads
from scenarios.studies.study import Options

if TYPE_CHECKING:
    from scenarios.benchmarks.peers.workloads import Outcome


def short(workload: str) -> str:
    """Return the short name of a workload."""
    return workload.partition(":")[0]


DESIM_WAYS = ("publish", "send")
"""The two ways of desim to deliver a broadcast, named after its methods; for all ways see `scenarios.benchmarks`."""
BROADCASTS = "broadcasts"
"""The value of `--parts` for the delivery rates, which this module measures; `costs.PARTS` has the others."""
SLOW_LAP = 5.0
"""Limit of CPU time, s: a way whose first lap on a workload takes longer has no further laps on this workload."""
Commands = Mapping[str, Sequence[str]]
"""For each simulator of `PEERS`, by its name: the command that runs its program."""


@dataclass(frozen=True)
class Rate:
    """The delivery rate of one way on one workload."""

    workload: str
    way: str
    deliveries: int
    """Number of deliveries in a lap."""
    per_second: float
    """Deliveries in a lap, divided by the median CPU time of the laps, 1/s."""


class Laps:
    """The laps of all ways on one workload.

    A simulator that fails is skipped from then on, and the reason is kept.
    """

    def __init__(self, work: Workload, commands: Commands, missing: dict[str, str]):
        self._work, self._commands, self._missing = work, commands, missing
        self._expected: Outcome | None = None
        self._deliveries: dict[str, int] = {}
        self._seconds: dict[str, list[float]] = {}

    def lap(self, name: str) -> None:
        """Run a way once, unless its simulator is unavailable or its first lap took more than `SLOW_LAP`.

        Raises:
            RuntimeError: if the way runs in this process and its outcome (the number of deliveries and the final table
                of each node) differs from the outcome of the ways before it.
        """
        if name in self._missing or self._seconds.get(name, [0.0])[0] > SLOW_LAP:
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
    """Create a temporary environment for each named simulator; note in `missing` why a simulator is unavailable.

    Yield the commands that run their programs.
    """
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
    """Measure the rate of each way on each workload; return the rates, and why each missing simulator is missing."""
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


WORKLOAD_NAMES = [short(work.name) for work in workloads()]
