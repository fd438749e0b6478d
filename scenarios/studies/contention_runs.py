"""The scenarios and measurements of `python -m scenarios.contention`."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.optimize import brentq

from desim import Announcements, Bitrate, Links, LoRa, Motion, Recording, Result, Scenario, Team
from desim.analysis.age import age_mean
from desim.analysis.metrics import active_time, captured, end_time, messages
from desim.analysis.statistics import Estimate, estimate
from desim.kernel.models.access import Aloha, CsmaCa, Ideal, Tdma
from protocols.cbba import CBBA
from protocols.local_min import LocalMin
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson
from protocols.schedules.token import TokenRing
from scenarios.studies.study import Options, metrics_of

N = 10
BITRATE = 19_200.0
"""bit/s"""
AIRTIME = 8.0 * 24 / BITRATE
"""Airtime of an announcement of 24 bytes, s."""
LOADS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Offered loads G: the airtime of all heartbeats as a share of the time; for a token ring, the airtime of the token as
a share of its holding time."""
JITTER = 0.5
"""Jitter of the heartbeats."""
CLOCKS = Poisson(rate=5.0)
PROTOCOLS: Mapping[str, Any] = MappingProxyType(
    {
        "SAP": SpatialAdaptivePlay(schedule=CLOCKS),
        "local_min": LocalMin(schedule=CLOCKS),
        "CBBA": CBBA(schedule=CLOCKS),
    }
)
TOKEN = "token ring"
NAMES = (*PROTOCOLS, TOKEN)
LONGEST: Mapping[str, int] = MappingProxyType({"SAP": 24, "local_min": 24, "CBBA": 120, TOKEN: 368})
"""Size of the longest message of each protocol in a team of `N`, bytes. A message of CBBA holds all claims, a token the
records of all pursuers."""
CSMA_CA = CsmaCa(slot=0.0005, sifs=0.0005, difs=0.001, window=16, ack=0.003, sensing_delay=0.0002)
REFERENCE = "ideal queue"
"""The access model with which the others are compared."""
ACCESSES: Mapping[str, Any] = MappingProxyType(
    {REFERENCE: Ideal(), "ALOHA": Aloha(), "CSMA/CA": CSMA_CA, "TDMA": Tdma()}
)
"""The access models; the slots of TDMA are as long as the longest message of the protocol."""
TEAM_SIZES = (5, 10, 20)
FACTORS = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 4.0)
"""Heartbeats of the measurement of ages, relative to 2 (N - 1) T."""
AGE_DURATION = 40
"""Duration of a measurement of ages, in periods of 2 (N - 1) T."""
SPREADING_FACTORS = tuple(range(7, 13))


@dataclass(frozen=True)
class Pursuits:
    """The results of the pursuits under one protocol and one access model at one offered load; times are in s."""

    protocol: str
    access: str
    load: float
    heartbeat: float
    """Time between two announcements of a pursuer, s; of a token ring, N times the holding time of the token."""
    active_time: Estimate
    difference: Estimate
    """Paired difference of the active time from that over the channel `REFERENCE`, s."""
    captured: float
    """Share of the pursuits that end with a capture."""
    lost: float
    """Share of the messages that are lost."""


@dataclass(frozen=True)
class Age:
    """The mean age of information, s, in one team at one heartbeat, s."""

    access: str
    size: int
    heartbeat: float
    age: Estimate


@dataclass(frozen=True)
class LoRaPursuits:
    """The shortest time between two announcements in a LoRa network, and the duration of the pursuits, s."""

    spreading_factor: int
    airtime: float
    """Airtime of an announcement, s."""
    interval: float
    """Shortest time between two announcements at the duty cycle of the preset, s."""
    end_time: Estimate
    over: float
    """Share of the pursuits that end within `interval`."""


def airtime(size: int) -> float:
    """Return the airtime of a message of `size` bytes, s."""
    return 8.0 * size / BITRATE


def links(access: str, longest: int) -> Links:
    """Return links with an access model, given the number of bytes of the longest message."""
    model = Tdma(slot=airtime(longest)) if access == "TDMA" else ACCESSES[access]
    return Links(medium=Bitrate(bitrate=BITRATE, shared=access == REFERENCE, queue_limit=1, access=model))


def heartbeat(protocol: str, load: float) -> float:
    """Return the time, s, between two announcements of a pursuer, or between two visits of the token without delays."""
    return N * airtime(LONGEST[protocol]) / load


def pursuit(protocol: str, access: str, load: float) -> Scenario:
    """Return the scenario of Lee & Bakolas with a protocol, an access model and an offered load."""
    period = heartbeat(protocol, load)
    network = links(access, LONGEST[protocol])
    if protocol == TOKEN:
        token = SpatialAdaptivePlay(schedule=TokenRing(holding_time=period / N))
        return _scenario(token, Announcements(trigger="never"), network)
    return _scenario(PROTOCOLS[protocol], Announcements(heartbeat=period, jitter=JITTER), network)


def _scenario(protocol: Any, announce: Announcements, network: Links, size: int = N, **more: Any) -> Scenario:
    return Scenario(
        name="contention", team=Team(count=size), protocol=protocol, announce=announce, network=network, **more
    )


def measure(options: Options) -> list[Pursuits]:
    """Run each protocol under each access model at each offered load."""
    keys = [(name, access, load) for name in NAMES for access in ACCESSES for load in LOADS]
    runs = options.measure_each(keys, pursuit, "pursuits", metrics_of(active_time, captured, share_lost))
    measured = {key: np.array(values, dtype=float).T for key, values in runs.items()}
    pursuits = []
    for (name, access, load), (times, caught, lost) in measured.items():
        differences = times - measured[name, REFERENCE, load][0]
        shares = float(caught.mean()), float(lost.mean())
        means = estimate(times), estimate(differences), *shares
        pursuits.append(Pursuits(name, access, load, heartbeat(name, load), *means))
    return pursuits


def share_lost(result: Result) -> float:
    """Return the share of the messages that are lost."""
    return messages(result).lost / max(messages(result).sent, 1)


def best_heartbeat(size: int) -> float:
    """Return the heartbeat, s, with the least age of information under ALOHA in theory.

    With an airtime T, a heartbeat h is received with p = exp(-a / h), a = 2 (N - 1) T. With a jitter J, the coefficient
    of variation c of the waits is given by c^2 = J^2 / 3, so the mean age is T + h ((1 + c^2) / 2 + 1/p - 1), as of any
    renewal process (Yates et al. 2021, "Age of Information: An Introduction and Survey"). This age is least where
    e^x (1 - x) = (1 - c^2) / 2 with x = a / h. With Poisson heartbeats, c = 1, the best h is a.
    """
    squared_variation = JITTER**2 / 3
    x = brentq(lambda x: exp(x) * (1 - x) - (1 - squared_variation) / 2, 1e-6, 1.0)
    return float(2 * (size - 1) * AIRTIME / x)


def standing(access: str, size: int, period: float) -> Scenario:
    """Return a game at rest in which only heartbeats are sent, for the measurement of ages."""
    return _scenario(
        SpatialAdaptivePlay(schedule=Poisson(rate=0.1)),
        Announcements(heartbeat=period, jitter=JITTER, trigger="heartbeat"),
        links(access, LONGEST["SAP"]),
        size,
        motion=Motion(static=True),
        horizon=AGE_DURATION * 2 * (size - 1) * AIRTIME,
        record=Recording(trajectory=0.0, messages=True),
    )


def measure_ages(options: Options) -> list[Age]:
    """Measure the mean age of information in teams of several sizes at several heartbeats."""
    keys = [
        (access, size, factor * 2 * (size - 1) * AIRTIME)
        for access in ACCESSES
        for size in TEAM_SIZES
        for factor in FACTORS
    ]
    runs = options.measure_each(keys, standing, "ages", age_mean)
    return [Age(*key, estimate(values)) for key, values in runs.items()]


def measure_lora(options: Options) -> list[LoRaPursuits]:
    """Measure how many pursuits end before a pursuer of a LoRa network may announce a second time."""
    return [lora_pursuits(spreading_factor, options) for spreading_factor in SPREADING_FACTORS]


def lora_pursuits(spreading_factor: int, options: Options) -> LoRaPursuits:
    """Measure the pursuits over a LoRa network of one spreading factor."""
    links = Links(preset=f"lora_sf{spreading_factor}")
    announce = Announcements(heartbeat=1.0, jitter=JITTER)
    scenario = _scenario(PROTOCOLS["local_min"], announce, links)
    (times,) = options.measure([scenario], "LoRa", end_time)
    medium = scenario.network.medium
    assert isinstance(medium, LoRa)
    assert medium.duty_cycle is not None
    interval = scenario.announcement_airtime / medium.duty_cycle
    over = sum(time < interval for time in times) / len(times)
    return LoRaPursuits(spreading_factor, scenario.announcement_airtime, interval, estimate(times), over)
