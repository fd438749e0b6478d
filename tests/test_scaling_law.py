"""How long too many chase: the law g_N(L lambda) N^2 delta, by latency and schedule, and what it makes of a pursuit."""

from functools import partial

import numpy as np
import pytest

from desim import Scenario
from desim.analysis.batch import run_many
from desim.analysis.metrics import activity, active_time, excess_time
from desim.kernel.latency import Constant
from desim.kernel.links import Links
from desim.pursuit.word import Announcements
from desim.scenario import Motion, Recording, Team
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules import Poisson, Rounds, SharedSeed
from protocols.temperature import ConstantTau
from protocols.token import TokenRing

pytestmark = pytest.mark.slow

N = 20
DELTA = 0.01
UNIT = N**2 * DELTA
"""s"""


def while_it_settles(protocol, duration, me):
    """Run a protocol for a while only: a greedy game that has settled does not change any more."""
    for event in protocol(me):
        yield event
        if me.now >= duration:
            return


def settled_excess(result):
    """Return the excess of a run, s, and whether just one chased at last, and for longer than a tenth of the horizon."""
    durations, counts = activity(result)
    return excess_time(result), counts[-1] == 1 and durations[-1] > 6.0


def excess(schedule, latency, runs, duration=40.0):
    """Return the mean excess of random static games of 60 s in units of N^2 delta, and its standard error."""
    greedy = SpatialAdaptivePlay(tau=ConstantTau(value=1e-9), schedule=schedule)
    scenario = Scenario(
        horizon=60.0,
        team=Team(count=N),
        motion=Motion(frozen=True),
        protocol=partial(while_it_settles, greedy, duration),
        announce=Announcements(trigger="change"),  # nothing is lost
        network=Links(latency=Constant(value=latency)),
        record=Recording(trajectory=0.0),
    )
    found = run_many([(scenario, seed) for seed in range(runs)], jobs=2, measure=settled_excess)
    assert all(settled for _, settled in found)
    return mean([time for time, _ in found], UNIT)


def mean(times, unit=1.0):
    """Return a mean, and its standard error."""
    return np.mean(times) / unit, np.std(times, ddof=1) / np.sqrt(len(times)) / unit


def apart(found, published):
    """Return how many joint standard errors two means are apart."""
    return abs(found[0] - published[0]) / np.hypot(found[1], published[1])
