"""Reproduce Table I of Lee & Bakolas: the sum of active times, centralised and decentralised, N = 20 and 40.

In the decentralised cells pursuers exchange action messages over a complete graph with zero latency. As in Algorithm 2,
the slot delta equals the motion step h. According to the paper each pursuer starts "with a random action", but the
published figures match a start with all pursuers active, so both starts are shown. A centralised cell has a single run:
there are no random draws, and the planner decides before any pursuer moves, so the initial actions do not matter. The
initial configurations are in table1_20.toml and table1_40.toml; `python -m scenarios.find_table1` searches for them.
"""

from dataclasses import asdict, dataclass
from itertools import chain
from typing import TYPE_CHECKING

from desim import Scenario, load
from desim.analysis.metrics import active_time
from desim.analysis.statistics import estimate
from desim.analysis.tables import aligned, number
from desim.pursuit.team.agent import Behaviour
from desim.pursuit.team.announcements import Announcements
from desim.scenario.scenario import Motion
from desim.study.workers.batch import run_many, seeds_from
from protocols.centralised import Centralised
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import SharedSeed
from scenarios.study import SCENARIOS, Options, study

if TYPE_CHECKING:
    from collections.abc import Sequence

DELTAS = (0.1, 0.01, 0.001)
STARTS = {"all active": 1.0, "random": 0.5}
"""Probability that a pursuer is initially active, by start."""
ANY = "any"
"""The start of the centralised cells, which do not depend on it."""
PUBLISHED = {
    ("centralised", 20, 0.1): 4.6000,
    ("centralised", 20, 0.01): 4.5700,
    ("centralised", 20, 0.001): 4.5580,
    ("centralised", 40, 0.1): 4.8000,
    ("centralised", 40, 0.01): 4.6900,
    ("centralised", 40, 0.001): 4.6700,
    ("decentralised", 20, 0.1): 55.5900,
    ("decentralised", 20, 0.01): 11.6580,
    ("decentralised", 20, 0.001): 5.2088,
    ("decentralised", 40, 0.1): 116.4590,
    ("decentralised", 40, 0.01): 39.0082,
    ("decentralised", 40, 0.001): 7.9598,
}
"""Sum of active times (Lee & Bakolas, Table I), s, by algorithm, N and delta (s)."""


@dataclass(frozen=True)
class Cell:
    """One cell of the table: the mean over the runs of the sum of active times, s; `ratio` is measured / published."""

    algorithm: str
    pursuers: int
    delta: float
    start: str
    runs: int
    measured: float
    standard_error: float
    published: float
    ratio: float


def configuration(count: int) -> Scenario:
    """Load the scenario of Table I with `count` = 20 or 40 pursuers."""
    return load(SCENARIOS / f"table1_{count}.toml")


def centralised(base: Scenario, delta: float) -> Scenario:
    """Return a configuration under Algorithm 3, with slot and motion step `delta`, s."""
    return _with_protocol(base, Centralised(slot=delta), delta)


def decentralised(base: Scenario, delta: float, active_at_start: float = 1.0) -> Scenario:
    """Return a configuration under Algorithm 2, with slot and motion step `delta`, s."""
    start = base.team.model_copy(update={"active_at_start": active_at_start})
    protocol = SpatialAdaptivePlay(schedule=SharedSeed(slot=delta))
    return _with_protocol(base.model_copy(update={"team": start}), protocol, delta)


def _with_protocol(base: Scenario, protocol: Behaviour, delta: float) -> Scenario:
    once = Announcements(trigger="change")  # no message is lost, and Algorithm 2 repeats none
    return base.model_copy(update={"protocol": protocol, "motion": Motion(step=delta), "announce": once})


def measure(options: Options) -> list[Cell]:
    """Run all cells."""
    keys, tasks = [], []
    for algorithm, count, delta in PUBLISHED:
        base = configuration(count)
        for start, share in STARTS.items() if algorithm == "decentralised" else [(ANY, 1.0)]:
            scenario = centralised(base, delta) if start == ANY else decentralised(base, delta, share)
            seeds = seeds_from(options.seed, 1 if start == ANY else options.runs)
            keys.append((algorithm, count, delta, start))
            tasks.append([(scenario, seed) for seed in seeds])
    times = iter(run_many(list(chain.from_iterable(tasks)), options.jobs, "Table I", active_time))
    return [_cell(*key, [next(times) for _ in runs]) for key, runs in zip(keys, tasks, strict=True)]


def _cell(algorithm: str, count: int, delta: float, start: str, times: list[float]) -> Cell:
    found, published = estimate(times), PUBLISHED[algorithm, count, delta]
    error, ratio = 0.0 if start == ANY else found.standard_error, found.mean / published
    return Cell(algorithm, count, delta, start, found.count, found.mean, error, published, ratio)


def table(cells: list[Cell]) -> str:
    """Return the cells as text, one line per published figure, with both starts side by side."""
    found = {(cell.algorithm, cell.pursuers, cell.delta, cell.start): cell for cell in cells}
    rows: list[Sequence[str]] = [("", "", "", "", "all active", "", "", "random start", "", "")]
    rows.append(("algorithm", "N", "delta, s", "published", *("measured", "s.e.", "ratio") * 2))
    for (algorithm, count, delta), published in PUBLISHED.items():
        row = [algorithm, str(count), f"{delta:g}", number(published, 4)]
        for start in STARTS:
            cell = found.get((algorithm, count, delta, start)) or found[algorithm, count, delta, ANY]
            row += [number(cell.measured, 4), number(cell.standard_error, 4), number(cell.ratio, 3)]
        rows.append(row)
    return (
        f"Table I: sum of active times, s; {max(cell.runs for cell in cells)} runs per decentralised cell\n"
        + aligned(rows)
    )


@study("table1", __doc__, runs=100)
def main(options: Options) -> None:
    """Measure, compare and show."""
    cells = measure(options)
    options.show({"cells": [asdict(cell) for cell in cells]}, table(cells))


if __name__ == "__main__":
    main()
