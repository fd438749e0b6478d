"""What it costs to hand runs to workers: the rate of two against one, and what is added to very short runs."""

import time

import pytest

from desim.analysis.measuring import summary
from desim.scenario.players import Team
from desim.scenario.scenario import Motion, Recording, Scenario
from desim.study.workers.dispatch import drive
from desim.study.workers.executors import workers_for
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson

LAPS = 5
SHORT = Scenario(
    horizon=0.5,
    team=Team(count=3),
    motion=Motion(step=0.1),
    protocol=SpatialAdaptivePlay(schedule=Poisson(rate=5.0)),
    record=Recording(trajectory=0.0),
)
"""A run of about a millisecond."""
BUSY = 0.05
"""How long a run keeps a core busy, s."""


def busy(result):
    """Measure a run as slowly as if it had taken 50 ms of a core."""
    found, end = summary(result), time.thread_time() + BUSY
    while time.thread_time() < end:
        pass
    return found


def do(workers, runs, measure):
    """Do some runs; return the time of the driver alone, s of a core."""
    begin = time.process_time()
    tasks = [(SHORT, seed) for seed in range(runs)]
    assert all(outcome.status == "ok" for _, outcome in drive(tasks, workers, measure))
    return time.process_time() - begin


@pytest.mark.parametrize("jobs", [1, 2], ids=["one", "two"])  # changes first
@pytest.mark.parametrize("lap", range(LAPS))
@pytest.mark.parametrize(("measure", "runs"), [(busy, 60), (summary, 2000)], ids=["50 ms", "short"])
def test_runs_by_one_and_by_two(benchmark, lap, jobs, measure, runs):
    """Two workers should do 1.8 times the runs of 50 ms; a short run should take 2 ms more than half of it at most."""
    benchmark.group = f"{runs} runs, {'50 ms each' if measure is busy else 'very short'}"
    with workers_for(jobs) as workers:
        do(workers, 40, summary)  # they have started
        own = benchmark.pedantic(do, args=(workers, runs, measure))
    benchmark.extra_info |= {"way": jobs, "runs": runs}
    if jobs > 1:
        benchmark.extra_info["driver_microseconds_per_run"] = own / runs * 1e6
