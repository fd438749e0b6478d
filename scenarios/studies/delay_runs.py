"""The scenarios and measurements of `python -m scenarios.delay`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from desim import Constant, Links, Motion, Recording, Scenario, Team
from desim.analysis.metrics import active_time, excess_time
from desim.analysis.statistics import estimate
from desim.pursuit.team.agent import Agent, Behaviour, Process
from desim.pursuit.team.announcements import Announcements, Start
from protocols.centralised import Centralised
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson, Rounds, Schedule, SharedSeed
from protocols.schedules.token import TokenRing
from protocols.temperature import ConstantTau
from scenarios.studies.study import Options

N = 20
LAMBDA = 5.0
"""Decision rate lambda of one pursuer in the static games, 1/s."""
DELAYS = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 16.0, 64.0)
"""Values of the dimensionless latency L lambda: one-way latency times the decision rate of a pursuer."""
SCHEDULES: dict[str, Callable[[float], Schedule]] = {
    "poisson": lambda slot: Poisson(rate=1.0 / (N * slot)),
    "shared_seed": lambda slot: SharedSeed(slot=slot),
    "rounds": lambda slot: Rounds(period=N * slot),
    "token_ring": lambda slot: TokenRing(holding_time=slot),
}
SLOTS = (0.001, 0.003, 0.01, 0.03, 0.1)
"""Values of the slot delta, the mean time between two decisions of the team, in the pursuits, s."""
LATENCIES = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Values of L in the pursuits, s."""
CRITICAL = 1.1
"""Dimensionless latency L lambda at which the excess is about twice the excess without latency."""
ENDLESS = 1e5
"""Horizon of the static games, s."""
LONG = 1000.0
"""Horizon of the pursuits, s: the default of 30 s is too short for most pursuers to capture."""


@dataclass(frozen=True)
class Point:
    """One measurement of the excess in static games (see `scenarios.delay`)."""

    schedule: str
    delay: float
    """Dimensionless latency L lambda."""
    excess: float
    """The mean excess active time divided by N^2 delta."""
    standard_error: float


@dataclass(frozen=True)
class Cell:
    """The pursuit at one latency and slot: its mean active time, and the prediction of the law (`scenarios.delay`).

    All values are in s. The active time is summed over the pursuers.
    """

    latency: float
    slot: float
    active_time: float
    standard_error: float
    predicted: float


def static(schedule: Schedule, latency: float, start: Start = "announced") -> Scenario:
    """Return a game without motion in which all pursuers start active, could capture in time, and decide greedily.

    The protocol runs until the actions have settled.
    """
    protocol = SpatialAdaptivePlay(tau=ConstantTau(value=1e-9), schedule=schedule)
    return Scenario(
        name="static game",
        horizon=ENDLESS,
        team=Team(count=N),
        motion=Motion(static=True),
        protocol=partial(while_it_settles, protocol, 20.0 + 8.0 * latency),
        announce=Announcements(trigger="change", start=start),
        network=Links(latency=Constant(value=latency)),
        record=Recording(trajectory=0.0),
    )


def while_it_settles(protocol: Behaviour, duration: float, me: Agent) -> Process:
    """Run a protocol for some time, s; a greedy game that has settled does not change any more."""
    for event in protocol(me):
        yield event
        if me.now >= duration:
            return


def pursuit(latency: float, slot: float) -> Scenario:
    """Return the scenario of the paper, with Poisson clocks, and a horizon in which all pursuers could capture."""
    return Scenario(
        name="pursuit",
        horizon=LONG,
        team=Team(count=N),
        protocol=SpatialAdaptivePlay(schedule=SCHEDULES["poisson"](slot)),
        network=Links(latency=Constant(value=latency)),
        record=Recording(trajectory=0.0),
    )


def measure_law(options: Options) -> list[Point]:
    """Measure the excess for each schedule and each dimensionless latency of `DELAYS`.

    The token ring is measured only at zero latency. With latency its revisions are further apart, so its decision rate
    is no longer lambda.
    """
    slot = 1.0 / (N * LAMBDA)
    keys = [(name, delay) for name in SCHEDULES for delay in DELAYS if name != "token_ring" or not delay]
    scenarios = [static(SCHEDULES[name](slot), delay / LAMBDA) for name, delay in keys]
    estimates = means(scenarios, options, "static games", excess_time)
    unit = N * N * slot
    return [Point(*key, mean / unit, error / unit) for key, (mean, error) in zip(keys, estimates, strict=True)]


def law(points: Sequence[Point]) -> Callable[[float], float]:
    """Return the excess under Poisson clocks as a function of L lambda, interpolated between the measured points."""
    poisson = [(point.delay, point.excess) for point in points if point.schedule == "poisson"]
    delays, excess = zip(*poisson, strict=True)
    return lambda delay: float(np.interp(delay, delays, excess))


def measure_pursuits(options: Options, points: Sequence[Point]) -> list[Cell]:
    """Measure the active times over the grid of latencies and slots, and predict them by the law."""
    predicted = law(points)
    keys = [(latency, slot) for latency in LATENCIES for slot in SLOTS]
    alone = pursuit(0.0, SLOTS[0]).model_copy(update={"protocol": Centralised(slot=SLOTS[0])})
    (relay, _), *active_times = means([alone, *(pursuit(*key) for key in keys)], options, "pursuits", active_time)
    return [
        Cell(latency, slot, mean, error, relay + predicted(latency / (N * slot)) * N * N * slot)
        for (latency, slot), (mean, error) in zip(keys, active_times, strict=True)
    ]


def means(
    scenarios: Sequence[Scenario], options: Options, label: str, metric: Callable[..., float]
) -> list[tuple[float, float]]:
    """Run each scenario; return the mean and the standard error of a metric over its runs."""
    estimates = [estimate(values) for values in options.measure(scenarios, label, metric)]
    return [(estimate.mean, estimate.standard_error) for estimate in estimates]
