"""The scenarios and measurements of `python -m scenarios.bodies`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, nan
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from desim import Announcements, Constant, Evader, Links, PureEvasion, Result, Scenario, Team
from desim.analysis.activity import evader_pursuits
from desim.analysis.metrics import active_time, captured, end_time
from desim.analysis.statistics import Estimate, estimate, paired
from desim.config.arrays import Floats
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.units import seconds
from desim.pursuit.motion.dynamics import Acceleration, Dynamics, Simple, TurnRate
from desim.scenario.scenario import Capture, Motion, Recording
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Rounds, SharedSeed
from scenarios.studies.study import Options, metrics_of

N = 8
SPEED = 1.2
"""Speed of the pursuers, m/s; that of the evader is 0.9 m/s."""
PERIOD = 0.4
"""Mean time between two decisions of a pursuer, and time between two announcements, s."""
RADII = (0.5, 1.0, 2.0)
"""Least turning radii, m."""
ACCELERATIONS = (2.0, 1.0, 0.5)
"""Greatest accelerations, m/s^2."""
SIMPLE = "simple"
MOTIONS: Mapping[str, Dynamics] = MappingProxyType(
    {SIMPLE: Simple()}
    | {f"radius {radius:g} m": TurnRate(limit=SPEED / radius) for radius in RADII}
    | {f"{limit:g} m/s^2": Acceleration(limit=limit) for limit in ACCELERATIONS}
)
"""The dynamics of the pursuers, by name."""
ONE, ALL = "one at a time", "all at once"
RULES: Mapping[str, Any] = MappingProxyType(
    {
        ONE: SpatialAdaptivePlay(schedule=SharedSeed(slot=PERIOD / N)),
        ALL: SpatialAdaptivePlay(schedule=Rounds(period=PERIOD)),
    }
)
"""Spatial Adaptive Play, in which pursuers decide one at a time or in rounds, with equal numbers of decisions."""
LATENCIES = (0.0, 0.25, 0.5, 1.0)
"""One-way latencies, s."""


class Handovers(NamedTuple):
    """The handovers of a run."""

    number: int
    excess: float
    """Active time in excess of one pursuer between the lone chases of the old and the new pursuer, s."""


@dataclass(frozen=True)
class Cell:
    """The results of one combination of rule, motion and latency."""

    rule: str
    motion: str
    latency: float
    """s"""
    captured: float
    """Share of the pursuits that end with a capture."""
    duration: Estimate
    """Capture time, or the horizon, s."""
    active_time: Estimate
    """s"""
    of_latency: Estimate
    """Paired difference of the active time from that without latency, s."""
    of_inertia: Estimate
    """Paired difference of `of_latency` from that of simple motion, s."""
    of_rule: Estimate
    """Paired difference of the active time from that of SAP with one decision at a time, s."""
    handovers: Estimate
    """Number per run."""
    excess: Estimate
    """Active time in excess of one pursuer per handover, s; its mean is nan without handovers."""


def pursuit(rule: str, motion: str, latency: float) -> Scenario:
    """Return a pursuit of an evader that flees the active ones of 8 pursuers with equal speeds."""
    return Scenario(
        name="bodies",
        horizon=60.0,
        team=Team(count=N, speeds=SPEED, active_at_start=0.0, dynamics=MOTIONS[motion]),
        evader=Evader(strategy=PureEvasion(flees_from="active")),
        capture=Capture(radius=0.3),
        motion=Motion(step=0.05),
        protocol=RULES[rule],
        announce=Announcements(payload="course", heartbeat=PERIOD),
        network=Links(latency=Constant(value=latency)),
        record=Recording(trajectory=0.0),
    )


def measure(options: Options) -> list[Cell]:
    """Run each rule with each motion at each latency, and return the results."""
    keys = [(rule, motion, latency) for rule in RULES for motion in MOTIONS for latency in LATENCIES]
    runs = options.measure_each(keys, pursuit, "bodies", metrics_of(active_time, captured, end_time, handovers))
    times = {key: np.array([active_time for active_time, *_ in runs_of_key]) for key, runs_of_key in runs.items()}
    return [_cell(key, runs_of_key, times) for key, runs_of_key in runs.items()]


def _cell(key: tuple[str, str, float], runs: Sequence[Any], times: Mapping[tuple[str, str, float], Floats]) -> Cell:
    """Return the results of one combination; `times` has the active times of all combinations."""
    rule, motion, latency = key
    _, caught, durations, handed_over = zip(*runs, strict=True)

    def cost_of_latency(motion: str) -> Floats:
        return times[rule, motion, latency] - times[rule, motion, 0.0]

    return Cell(
        *key,
        portable_sum(caught) / len(runs),
        estimate(durations),
        estimate(times[key]),
        estimate(cost_of_latency(motion)),
        paired(cost_of_latency(motion), cost_of_latency(SIMPLE)),
        paired(times[key], times[ONE, motion, latency]),
        estimate([float(of_run.number) for of_run in handed_over]),
        ratio([of_run.excess for of_run in handed_over], [of_run.number for of_run in handed_over]),
    )


def ratio(parts: Sequence[float], counts: Sequence[int]) -> Estimate:
    """Return the quotient of two sums over runs, with the standard error of a ratio (Cochran 1977, section 6.3)."""
    total = portable_sum(counts)
    if not total:
        return Estimate(nan, inf, len(counts))
    quotient = portable_sum(parts) / total
    error = estimate([part - quotient * count for part, count in zip(parts, counts, strict=True)]).standard_error
    return Estimate(quotient, error * len(counts) / total, len(counts))


def handovers(result: Result) -> Handovers:
    """Return the handovers of a run with one evader.

    A handover lasts from the end of the last lone chase of the old pursuer to the beginning of that of the new one. In
    this time n pursuers are active, and the excess is the integral of max(n - 1, 0).
    """
    (hunt,) = evader_pursuits(result)
    active = {pursuer for pursuer, chasing in enumerate(hunt.start) if chasing}
    previous_t, last_alone, count, excess, excess_since = 0, None, 0, 0.0, 0.0
    for t, pursuer, _ in [*hunt.steps, (hunt.end, -1, 0)]:  # the last entry closes the interval before the end
        if t > previous_t:
            if len(active) == 1:
                (alone,) = active
                if last_alone is not None and alone != last_alone:
                    count, excess = count + 1, excess + excess_since
                last_alone, excess_since = alone, 0.0
            else:
                excess_since += max(len(active) - 1, 0) * seconds(t - previous_t)
        active ^= {pursuer}
        previous_t = t
    return Handovers(count, excess)
