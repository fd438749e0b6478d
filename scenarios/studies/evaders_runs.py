"""The scenarios and measurements of `python -m scenarios.evaders`.

The first part of the study compares the strategies of the evader; the second part limits what the pursuers sense.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from math import inf
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from desim import Announcements, Constant, Evader, Links, Recording, Result, Scenario, Team, summary
from desim.analysis.metrics import Summary, active_time, captured, end_time
from desim.analysis.statistics import Estimate, estimate, paired, share
from desim.kernel.core.events import Sent
from desim.kernel.core.portable_math import portable_sum
from desim.pursuit.core.events import Sampled
from desim.pursuit.evaders.evasion import (
    ConstantHeading,
    Diffusion,
    Listener,
    MaxMin,
    PureEvasion,
    Still,
    Strategy,
    VoronoiVertex,
    WeightedFlee,
    Zigzag,
)
from desim.pursuit.sensing.sensing import Sensing, Sighting
from scenarios.studies.rivals_runs import N, contender
from scenarios.studies.study import Options

LATENCY = 0.1
"""One-way latency L, s."""
STRATEGIES: Mapping[str, Strategy] = MappingProxyType(
    {
        "pure evasion": PureEvasion(),
        "pure, of active": PureEvasion(flees_from="active"),
        "weighted flee": WeightedFlee(),
        "max-min": MaxMin(),
        "max-min, of active": MaxMin(flees_from="active"),
        "zigzag": Zigzag(),
        "Voronoi vertex": VoronoiVertex(arena=(0.0, 20.0)),
        "diffusion": Diffusion(),
        "constant heading": ConstantHeading(),
        "listener": Listener(),
        "still": Still(),
    }
)
REFERENCE = "pure evasion"
CLAIMED = "pure, of active"
"""The strategy for which a line of the output states whether it survives longer than the reference."""
IDEAL = "sap, ideal"
PROTOCOLS = (IDEAL, "sap", "local_min", "cbba", "server", "voronoi", "centralised")
NEAREST = "voronoi"
"""The protocol under which the nearest pursuer chases, not necessarily the fast one."""
MORE = 3
"""The second part (limited sensing) has this many times the runs of the first, because it estimates shares."""
RADII = (2.0, 4.0, 8.0, 16.0, inf)
"""Sensing radii R_s, m."""
HELD = "hold"
ESTIMATES: Mapping[str, str] = MappingProxyType(
    {HELD: "hold", "constant_velocity": "constant velocity", "worst_case": "worst case"}
)
SPOKEN = Announcements(heartbeat=0.5)
"""Actions are announced at the start, on change, and twice a second."""
WATCHERS, CHASERS = 10, 2
WATCHED = Scenario(
    name="limited sight",
    team=Team(count=WATCHERS + CHASERS, speeds=(0.5,) * WATCHERS + (1.5,) * CHASERS),
    evader=Evader(speed=1.2, strategy=Diffusion(sigma=0.4)),
    sensing=Sensing(track_timeout=2.0),
    protocol=contender("sap"),
    announce=SPOKEN,
    record=Recording(messages=True),
)
"""Ten watchers too slow to capture the evader, and two chasers. `watched` sets the latency, the sensing radius and the
kind of estimate."""


@dataclass(frozen=True)
class Cell:
    """The results of one strategy against one protocol, means over the runs; times are in s."""

    strategy: str
    protocol: str
    latency: float
    """One-way latency, s."""
    survival: Estimate
    """Time to capture, or the horizon without capture, s."""
    difference: Estimate
    """Paired difference from the survival of pure evasion, s."""
    captured: float
    """Share of the runs with capture."""
    active_time: Estimate
    handovers: float


@dataclass(frozen=True)
class Sighted:
    """The results of one sensing radius and one estimate, means over the runs; times are in s."""

    radius: float
    """Sensing radius R_s, m."""
    estimate: str
    captured: Estimate
    """Share of the runs with capture."""
    survival: Estimate
    """Time to capture, or the horizon without capture, s."""
    difference: Estimate
    """Paired difference from the survival with the estimate "hold", s."""
    active_time: Estimate
    active_difference: Estimate
    """Paired difference from the active time with the estimate "hold", s."""
    never_seen: float
    """Share of the runs in which no pursuer ever saw the evader."""
    lost: float
    """Share of the runs in which the evader was seen, and later was out of sight of all pursuers for longer than
    `track_timeout`."""
    reports: float
    """Messages with sightings, one per receiver, per second of the pursuit."""
    report_transmissions: float
    """Transmissions with sightings, one per broadcast, per second of the pursuit."""


class Watched(NamedTuple):
    """The measurements of one run with limited sensing; see `Sighted`. Reports are counts here, not rates."""

    captured: bool
    survival: float
    active_time: float
    never_seen: bool
    lost: bool
    reports: int
    report_transmissions: int


def chase(strategy: str, protocol: str, latency: float = LATENCY) -> Scenario:
    """Return one scenario of the first part; the latency, s, does not apply to the ideal network."""
    ideal = protocol == IDEAL
    return Scenario(
        name=f"{strategy}, {protocol}",
        team=Team(count=N),
        evader=Evader(strategy=STRATEGIES[strategy]),
        protocol=contender("sap" if ideal else protocol),
        announce=SPOKEN,
        network=Links(latency=Constant(value=0.0 if ideal else latency)),
        record=Recording(trajectory=0.0),
    )


def watched(radius: float, kind: str, latency: float = LATENCY) -> Scenario:
    """Return one scenario of the second part, given a sensing radius, m, a kind of estimate, and a latency, s."""
    sensing = WATCHED.sensing.model_copy(update={"radius": radius, "estimate": kind})
    return WATCHED.model_copy(update={"sensing": sensing, "network": Links(latency=Constant(value=latency))})


def measure_chases(options: Options, latency: float) -> list[Cell]:
    """Run each strategy against each protocol."""
    keys = [(strategy, protocol) for strategy in STRATEGIES for protocol in PROTOCOLS]
    runs = options.measure_each(keys, partial(chase, latency=latency), "strategies", summary)
    return [cell(key, latency, runs[key], reference=runs[REFERENCE, key[1]]) for key in keys]


def cell(key: tuple[str, str], latency: float, runs: Sequence[Summary], *, reference: Sequence[Summary]) -> Cell:
    """Return the results of a strategy against a protocol, and the difference from pure evasion with equal seeds."""
    times = [run.end_time for run in runs]
    return Cell(
        *key,
        0.0 if key[1] == IDEAL else latency,
        estimate(times),
        paired(times, [run.end_time for run in reference]),
        portable_sum(run.captured for run in runs) / len(runs),
        estimate([run.active_time for run in runs]),
        estimate([run.handovers for run in runs]).mean,
    )


def measure_sight(options: Options, latency: float) -> list[Sighted]:
    """Run each estimate at each radius; at infinite radius only "hold", because all estimates are equal there."""
    keys = [(radius, kind) for radius in RADII for kind in (ESTIMATES if radius < inf else [HELD])]
    with_more_runs = replace(options, runs=MORE * options.runs)
    runs = with_more_runs.measure_each(keys, partial(watched, latency=latency), "sight", observe)
    return [sighted(*key, runs[key], reference=runs[key[0], HELD]) for key in keys]


def observe(result: Result) -> Watched:
    """Return the measurements of one run with limited sensing."""
    reports = [
        event
        for event in result.trace.of(Sent)
        if isinstance(event.body, tuple) and any(isinstance(part, Sighting) for part in event.body)
    ]
    sensing, period = result.scenario.sensing, result.scenario.record.trajectory
    seen = [_is_seen(sample, sensing.radius) for sample in result.trace.of(Sampled)]
    from_first_sight = seen[seen.index(True) :] if any(seen) else []
    longest = max((len(list(samples)) for is_seen, samples in groupby(from_first_sight) if not is_seen), default=0)
    return Watched(
        captured(result),
        end_time(result),
        active_time(result),
        not from_first_sight,
        longest * period > sensing.track_timeout,
        len(reports),
        len({event.transmission for event in reports}),
    )


def _is_seen(sample: Sampled, radius: float) -> bool:
    """Return whether any pursuer is within the radius (m) of the evader."""
    gaps = np.array(sample.pursuers) - np.array(sample.evaders[0])
    return bool(np.hypot(gaps[:, 0], gaps[:, 1]).min() <= radius)


def sighted(radius: float, kind: str, runs: Sequence[Watched], *, reference: Sequence[Watched]) -> Sighted:
    """Return the results of one radius and one estimate, and the differences from "hold" with equal seeds."""
    times, active = [run.survival for run in runs], [run.active_time for run in runs]
    count, duration = len(runs), portable_sum(times)
    return Sighted(
        radius,
        kind,
        share([run.captured for run in runs]),
        estimate(times),
        paired(times, [run.survival for run in reference]),
        estimate(active),
        paired(active, [run.active_time for run in reference]),
        portable_sum(run.never_seen for run in runs) / count,
        portable_sum(run.lost for run in runs) / count,
        portable_sum(run.reports for run in runs) / duration,
        portable_sum(run.report_transmissions for run in runs) / duration,
    )
