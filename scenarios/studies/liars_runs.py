"""The scenarios and measurements of `python -m scenarios.liars`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from desim import Announcements, Bernoulli, ClockSkew, Links, Lognormal, Recording, Scenario, Team
from desim.analysis.deception import false_accusations
from desim.analysis.metrics import active_time, captured, end_time
from desim.analysis.statistics import Estimate, estimate, paired, share
from desim.pursuit.byzantine.lies import ByzantineFault, Equivocate, Liar, ReplayAttack, Silent, Spoof
from desim.pursuit.team.trust import Accusations, Credulous, Plausible, Reputation, Trimmed
from protocols.best_response import BestResponse
from protocols.cbba import CBBA
from protocols.local_min import LocalMin
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson
from scenarios.studies.study import Options, metrics_of

N = 12
NONE = "none"
HONEST = "honest"
PROTOCOLS: Mapping[str, Any] = MappingProxyType(
    {
        kind: rule(schedule=Poisson(rate=5.0))
        for kind, rule in {
            "sap": SpatialAdaptivePlay,
            "best_response": BestResponse,
            "local_min": LocalMin,
            "cbba": CBBA,
        }.items()
    }
)
LIES: Mapping[str, tuple[type[ByzantineFault], Mapping[str, Any]]] = MappingProxyType(
    {
        HONEST: (Silent, {}),  # not used: an honest team has no liar
        "there at once": (Liar, {"action": "chase", "phi": 0.0, "acts": "stay"}),
        "chases": (Liar, {"action": "chase", "acts": "stay"}),
        "opposite": (Liar, {"action": "opposite"}),
        "spoof": (Spoof, {"action": "chase", "phi": 0.0}),
        "equivocate": (Equivocate, {"phi": 0.0, "acts": "stay"}),
        "replay": (ReplayAttack, {"delay": 2.0}),
        "silent": (Silent, {}),
    }
)
"""The Byzantine faults, by name. A liar "there at once" stays, and announces "I chase, my capture time is 0"; "chases"
is the same with the true time; "opposite" the contrary of its action; "spoof" lies in the name of random teammates."""
WORST = "there at once"
DEFENCES: Mapping[str, Any] = MappingProxyType(
    {
        NONE: Credulous(),
        "trimmed, F = 1": Trimmed(liars=1),
        "trimmed, F = 2": Trimmed(liars=2),
        "plausible": Plausible(),
        "accusations": Accusations(),
        "reputation": Reputation(),
    }
)
NUMBERS = (0, 1, 2, 3, 4, 6)
"""Numbers of liars."""
OFFSETS = (0.0, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Standard deviations of the clocks, s."""
LATENCIES = (0.0, 0.05, 0.2, 0.5)
"""Mean latencies, s."""
OBSERVING = ("plausible", "accusations", "reputation")
LATE = 0.2
"""Mean latency where clocks are wrong, s."""
LOSSES = 0.1
"""Probability of a loss where there is latency."""


@dataclass(frozen=True)
class Cell:
    """The results of one combination of protocol, lie, defence, clocks and latency."""

    part: str
    """The property that varies: "lies", "numbers", "clocks" or "latency"."""
    protocol: str
    lie: str
    defence: str
    value: float
    """Number of liars, deviation of the clocks, s, or mean latency, s."""
    captured: Estimate
    """Share of the pursuits that end with a capture."""
    delay: Estimate
    """Paired difference of the duration from that of the honest team without a defence, s."""
    active_time: Estimate
    """s"""
    false_accusations: Estimate
    """Number per run."""


def pursuit(
    protocol: str, lie: str, defence: str, liars: int = 1, offset: float = 0.0, latency: float = 0.0
) -> Scenario:
    """Return a pursuit by 12 pursuers of equal speed, of which some have a Byzantine fault from the start."""
    model, parameters = LIES[lie]
    faults: list[Any] = [model(node=node, start=0.0, **parameters) for node in range(liars if lie != HONEST else 0)]
    faults += [ClockSkew(offset=offset)] if offset else []
    network = Links(latency=Lognormal(mean=latency, cv=0.5), loss=Bernoulli(p=LOSSES)) if latency else Links()
    return Scenario(
        name="liars",
        team=Team(count=N, speeds=1.5, active_at_start=0.0),
        protocol=PROTOCOLS[protocol],
        announce=Announcements(payload="time", heartbeat=0.2, trust=DEFENCES[defence], start="silent"),
        network=network,
        fault=tuple(faults),
        record=Recording(trajectory=0.0),
    )


def keys() -> list[tuple[str, str, str, str, float]]:
    """Return the part, protocol, lie, defence and value of each cell."""
    lies = [("lies", protocol, lie, NONE, 1.0) for protocol in PROTOCOLS for lie in LIES]
    numbers = [("numbers", "local_min", WORST, defence, float(n)) for defence in DEFENCES for n in NUMBERS]
    clocks = [("clocks", "sap", HONEST, defence, offset) for defence in (NONE, *OBSERVING) for offset in OFFSETS]
    latency = [
        ("latency", "local_min", lie, defence, value)
        for lie in (HONEST, WORST)
        for defence in DEFENCES
        for value in LATENCIES
    ]
    return lies + numbers + clocks + latency


def scenario_of(part: str, protocol: str, lie: str, defence: str, value: float) -> Scenario:
    """Return the scenario of a cell."""
    options_of_part: dict[str, dict[str, Any]] = {
        "lies": {},
        "numbers": {"liars": int(value)},
        "clocks": {"offset": value, "latency": LATE},
        "latency": {"latency": value},
    }
    return pursuit(protocol, lie, defence, **options_of_part[part])


def measure(options: Options) -> list[Cell]:
    """Run each cell, and the honest team without a defence with which it is compared."""
    metric = metrics_of(captured, end_time, active_time, false_accusations)
    runs = options.measure_each(keys(), scenario_of, "liars", metric)
    return [_cell(key, runs[key], runs[_reference(key)]) for key in runs]


def _reference(key: tuple[str, str, str, str, float]) -> tuple[str, str, str, str, float]:
    part, protocol, _, _, value = key
    if part == "numbers":
        return part, protocol, WORST, NONE, 0.0
    return part, protocol, HONEST, NONE, value


def _cell(key: tuple[str, str, str, str, float], runs: Sequence[Any], reference: Sequence[Any]) -> Cell:
    caught, durations, active_times, accusations = zip(*runs, strict=True)
    _, honest, *_ = zip(*reference, strict=True)
    return Cell(*key, share(caught), paired(durations, honest), estimate(active_times), estimate(accusations))
