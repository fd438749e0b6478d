"""Reproduce Table I of Lee & Bakolas: the sum of active times, centralised and decentralised, N = 20 and 40.

In the decentralised cells pursuers exchange action messages over a complete graph with zero latency. As in Algorithm 2,
the slot delta equals the motion step h. According to the paper each pursuer starts "with a random action", but the
published figures match a start with all pursuers active, so both starts are shown. A centralised cell has a single run:
there are no random draws, and the planner decides before any pursuer moves, so the initial actions do not matter. The
initial configurations are in table1_20.toml and table1_40.toml; `python -m scenarios.find_table1` searches for them.
"""

from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING

from desim.analysis.metrics import active_time
from desim.analysis.statistics import estimate
from desim.analysis.tables import aligned, number
from desim.study.workers.batch import run_many, seeds_from
from scenarios.studies.study import Options, study
from scenarios.studies.table1_runs import PUBLISHED, centralised, configuration, decentralised

if TYPE_CHECKING:
    from collections.abc import Sequence

STARTS = {"all active": 1.0, "random": 0.5}
"""Probability that a pursuer is initially active, by start."""
ANY = "any"
"""The start of the centralised cells, which do not depend on it."""


@dataclass(frozen=True)
class Cell:
    """One cell of the table, in s: the mean over runs of the sum of active times; `ratio` is measured / published."""

    algorithm: str
    pursuers: int
    delta: float
    start: str
    runs: int
    measured: float
    standard_error: float
    published: float
    ratio: float


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
    measured, published = estimate(times), PUBLISHED[algorithm, count, delta]
    error = 0.0 if start == ANY else measured.standard_error  # a centralised cell has one run without random draws
    ratio = measured.mean / published
    return Cell(algorithm, count, delta, start, measured.count, measured.mean, error, published, ratio)


def table(cells: list[Cell]) -> str:
    """Return the cells as text, one line per published figure, with both starts side by side."""
    by_setting = {(cell.algorithm, cell.pursuers, cell.delta, cell.start): cell for cell in cells}
    rows: list[Sequence[str]] = [("", "", "", "", "all active", "", "", "random start", "", "")]
    rows.append(("algorithm", "N", "delta, s", "published", *("measured", "s.e.", "ratio") * 2))
    for (algorithm, count, delta), published in PUBLISHED.items():
        row = [algorithm, str(count), f"{delta:g}", number(published, 4)]
        for start in STARTS:
            cell = by_setting.get((algorithm, count, delta, start)) or by_setting[algorithm, count, delta, ANY]
            row += [number(cell.measured, 4), number(cell.standard_error, 4), number(cell.ratio, 3)]
        rows.append(row)
    return (
        f"Table I: sum of active times, s; {max(cell.runs for cell in cells)} runs per decentralised cell\n"
        + aligned(rows)
    )


@study("table1", __doc__, seconds=1.2, runs=100)
def main(options: Options) -> None:
    """Measure, compare and show."""
    cells = measure(options)
    options.show({"cells": cells}, table(cells))


if __name__ == "__main__":
    main()
