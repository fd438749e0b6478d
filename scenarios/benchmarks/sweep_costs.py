"""Costs of sweeps: the rate of two worker processes relative to one, and the commands for a store of a million runs."""

import time
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from io import StringIO
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from desim import Recording, Scenario, Team, run, summary, sweep
from desim.analysis.metrics import Summary
from desim.cli import main as command_line
from desim.study.plan.configurations import SweepGrid
from desim.study.store.run_table import Row
from desim.study.store.store import Store
from desim.study.sweeps.sweep_plan import SweepPlan
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson
from scenarios.benchmarks.measuring import Cost, apart, memory
from scenarios.studies.study import Options

SHORT = Scenario(
    name="short",
    horizon=5.0,
    team=Team(count=5),
    protocol=SpatialAdaptivePlay(schedule=Poisson(rate=5.0)),
    record=Recording(trajectory=0.0),
)
"""A scenario whose run takes about 20 ms."""
LATENCIES = (0.0, 0.05, 0.1, 0.2)
"""Latencies of the sweep, s."""
SWEPT = 400
"""Number of runs of a lap."""
GRID: SweepGrid = {"network.latency.value": [0.01 * k for k in range(10)], "team.count": list(range(5, 15))}
"""The grid of the large store: 100 configurations."""
STORED = 1_000_000
"""Number of runs of the large store."""
BATCH = 1_000
"""Number of runs that are added to the large store at a time."""
MEGABYTE = 1e6


def swept(runs: int, jobs: int, seed: int) -> tuple[float, float]:
    """Perform a sweep with a store; return its wall time, s, and the CPU time of this process, s."""
    with TemporaryDirectory() as folder:
        begin, begin_cpu = time.perf_counter(), time.process_time()
        grid = {"network.latency.value": LATENCIES}
        sweep(SHORT, grid, runs // len(LATENCIES), jobs, seed=seed, store=Path(folder) / "sweep.sqlite")
        return time.perf_counter() - begin, time.process_time() - begin_cpu


def side_by_side(two: Executor, runs: int, seed: int) -> float:
    """Perform half of the runs in each of two processes that share nothing; return the wall time, s."""
    begin = time.perf_counter()
    list(two.map(partial(swept, runs // 2, 1), (seed, seed)))
    return time.perf_counter() - begin


def two_workers(options: Options) -> list[Cost]:
    """Measure a sweep of short runs with one and two workers, and in two independent processes.

    The three take turns in short laps, because the speed of a shared machine drifts. The two independent processes show
    how much faster two cores are than one on this machine.
    """
    laps, few = [], 4 * len(LATENCIES)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as independent:
        side_by_side(independent, few, options.seed)  # all processes have started before they are measured
        for seed in range(options.seed, options.seed + 2 * options.runs):
            swept(few, 2, seed)  # idle workers end after a while
            two, driver = swept(SWEPT, 2, seed)
            independently = side_by_side(independent, SWEPT, seed)
            single, _ = swept(SWEPT, 1, seed)
            laps.append((single, two / single, two / independently, driver / two))
    medians = [median(values) for values in zip(*laps, strict=True)]
    return [
        Cost("a run with one worker", medians[0] / SWEPT * 1e3, "ms"),
        Cost("wall time, two workers / one", medians[1], "", round(1.0 / 1.9, 3)),
        Cost("wall time, two workers / two independent processes", medians[2], "", round(2.0 / 1.9, 3)),
        Cost("driver, share of a core", medians[3], "", 0.05),
    ]


def write_halves(folder: Path, count: int, seed: int) -> None:
    """Write two stores that have together `count` runs with made-up metrics."""
    plan = SweepPlan.of(SHORT, GRID, count // 100, seed)
    template = dict(summary(run(SHORT, seed)))
    names = [name for name, value in template.items() if isinstance(value, float)]
    rng = np.random.default_rng(seed)
    for part in (1, 2):
        jobs = plan.shard(part, 2)
        with Store(folder / f"sweep.{part}-of-2.sqlite") as store:
            plan.register(store)
            for k in range(0, len(jobs), BATCH):
                batch = jobs[k : k + BATCH]
                numbers = rng.random((len(batch), len(names))).tolist()
                store.add_all(
                    plan.root,
                    [
                        (configuration.key, Row(number, plan.root + number, "ok", _changed(template, names, values)))
                        for (configuration, number), values in zip(batch, numbers, strict=True)
                    ],
                )


def _changed(template: dict[str, Any], names: list[str], values: list[float]) -> Summary:
    return Summary(template | dict(zip(names, values, strict=True)))


def commanded(*words: str) -> tuple[float, float]:
    """Execute a command of desim; return its wall time, s, and the peak memory of this process, B."""
    begin = time.perf_counter()
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        command_line(list(words), standalone_mode=False)
    return time.perf_counter() - begin, memory("VmHWM")


def large_store(options: Options) -> list[Cost]:
    """Measure the commands that merge, report and export a large store."""
    costs_of: dict[str, tuple[float, float]] = {}
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_halves(folder, STORED, options.seed)
        merged = str(folder / "merged")
        costs_of["merge"] = apart(commanded, "merge", name, "-o", merged)
        costs_of["report"] = apart(commanded, "report", merged)
        costs_of["export"] = apart(commanded, "export", merged, str(folder / "runs.csv"))
    limits = {"merge": 60.0, "report": 30.0}
    return [
        *(
            Cost(f"desim {command}, {STORED:,} runs", took, "s", limits.get(command))
            for command, (took, _) in costs_of.items()
        ),
        *(
            Cost(f"peak memory of desim {command}", peak / MEGABYTE, "MB", 1_000.0)
            for command, (_, peak) in costs_of.items()
        ),
    ]
