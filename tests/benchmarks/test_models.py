"""Deliveries per second of `publish` under each model of latency, loss and reach, against an ideal link.

Forty nodes on a complete graph. A model whose draws do not depend on the hop is drawn in blocks; what it costs beside
the ideal is a time of arrival per receiver. Slower are those that ask numpy anew for each broadcast: for distances
(propagation, by_distance, any finite range), for a jitter on top of what belongs to a pair (per_pair), for the memory
of each link (gilbert_elliott) or for its measurement at that time (trace); and those under which a message may be lost
on arrival (range checked at delivery).
"""

import gc
from dataclasses import replace

import numpy as np
import pytest

from desim.kernel.measured.models import LatencyTrace, LossTrace
from desim.kernel.models.coherence import Coherence
from desim.kernel.models.common_losses import CommonCause
from desim.kernel.models.latency import Constant, Empirical, Gamma, Lognormal, Propagation, ShiftedExponential, Uniform
from desim.kernel.models.latency_by_link import PerPair
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli, ByDistance, GilbertElliott
from desim.kernel.models.reception import Disk, LogDistance, QuasiUnitDisk, Rice
from scenarios.benchmarks.peers.ways import WAYS
from scenarios.benchmarks.peers.workloads import LOGNORMAL, workloads
from tests.benchmarks.conftest import BY_MODEL

LAPS = 5
FAR = 10.0
"""Beyond every node, so that the number of receivers stays the same, m."""
DRAWN = np.random.default_rng(1).uniform(0.01, 0.02, (20, 40, 40)).tolist()
"""Values at 20 times for each link."""
FOR_ALL = "t,value\n" + "".join(f"{k / 10},{values[0][1]}\n" for k, values in enumerate(DRAWN))
BY_LINK = "t,src,dst,value\n" + "".join(
    f"{k / 10 + src / 1000},{src},{dst},{value}\n"
    for k, values in enumerate(DRAWN)
    for src, row in enumerate(values)
    for dst, value in enumerate(row)
    if src != dst
)
MODELS = {
    "ideal": Links(),
    "constant": Links(latency=Constant(value=0.015)),
    "uniform": Links(latency=Uniform(low=0.0, high=0.03)),
    "shifted_exponential": Links(latency=ShiftedExponential(offset=0.005, mean=0.01)),
    "gamma": Links(latency=Gamma(shape=2.0, scale=0.0075)),
    "lognormal": Links(latency=Lognormal(mean=0.015, cv=0.5)),
    "empirical": Links(latency=Empirical(values=(0.005, 0.01, 0.03))),
    "propagation": Links(latency=Propagation(speed=50.0)),
    "per_pair": Links(latency=PerPair()),
    "trace, all links": Links(latency=LatencyTrace(table=FOR_ALL)),
    "trace, by link": Links(latency=LatencyTrace(table=BY_LINK)),
    "lognormal, fifo": Links(latency=LOGNORMAL, order="fifo"),
    "bernoulli": Links(loss=Bernoulli(p=0.1)),
    "gilbert_elliott": Links(loss=GilbertElliott(share=0.1, burst=5.0)),
    "gilbert_elliott in time": Links(loss=GilbertElliott(share=0.1, burst=5.0, advance="time")),
    "loss trace, by link": Links(loss=LossTrace(table=BY_LINK)),
    "by_distance": Links(loss=ByDistance(distance=FAR)),
    "disk": Links(range=FAR, reception=Disk()),
    "quasi_unit_disk": Links(range=FAR, reception=QuasiUnitDisk(certain=1.0)),
    "log_distance": Links(range=100 * FAR, reception=LogDistance()),
    "rice, per message": Links(range=100 * FAR, reception=Rice(), fading="message"),
    "rice, correlated": Links(
        range=100 * FAR, reception=Rice(), fading="correlated", coherence=Coherence(frequency=2.4e9)
    ),
    "log_distance, correlated": Links(
        range=100 * FAR, reception=LogDistance(), fading="correlated", coherence=Coherence(decorrelation=10.0)
    ),
    "common_cause": Links(loss=CommonCause(p=0.1)),
    "gilbert_elliott in time, common": Links(loss=GilbertElliott(share=0.1, burst=5.0, advance="time", common=0.3)),
    "disk at delivery": Links(range=FAR, range_check="delivery"),
}


@pytest.mark.parametrize("way", MODELS)  # changes first
@pytest.mark.parametrize("lap", range(LAPS))
def test_publish_under_each_model(benchmark, lap, way):
    benchmark.group = BY_MODEL
    work = replace(workloads()[0], links=MODELS[way])
    ready = WAYS["publish"](work)
    gc.collect()
    benchmark.pedantic(ready.run)
    assert ready.network.message_counts().sent == 39 * work.turns
    benchmark.extra_info["deliveries"] = 39 * work.turns
