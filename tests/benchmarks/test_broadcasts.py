"""Deliveries per second of several ways to deliver the same broadcasts; they must all deliver the same.

The ways take turns, lap after lap, so that a machine whose speed drifts does not favour one of them. The same beside
other simulators: `python -m scenarios.benchmarks`.
"""

import gc
from functools import cache

import pytest

from scenarios.benchmarks.peers.ways import WAYS
from scenarios.benchmarks.peers.workloads import Outcome, workloads

LAPS = 5
WORKLOADS = {workload.name: workload for workload in workloads()}


@cache
def outcome(workload: str) -> Outcome:
    """Return what a workload should come to."""
    way = WAYS["simpy-message"](WORKLOADS[workload])
    way.run()
    return way.outcome()


@pytest.mark.parametrize("way", WAYS)  # changes first
@pytest.mark.parametrize("lap", range(LAPS))
@pytest.mark.parametrize("workload", WORKLOADS)
def test_every_implementation_delivers_the_same(benchmark, workload, lap, way):
    benchmark.group = workload
    ready = WAYS[way](WORKLOADS[workload])
    expected = outcome(workload)
    gc.collect()
    benchmark.pedantic(ready.run)
    assert ready.outcome() == expected
    benchmark.extra_info["deliveries"] = expected.delivered
