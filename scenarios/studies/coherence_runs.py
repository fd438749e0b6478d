"""The scenarios and measurements of `python -m scenarios.coherence`."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from desim import Coherence, Constant, Links, Nakagami, Scenario
from desim.analysis.statistics import Estimate, estimate
from scenarios.studies import transport_runs
from scenarios.studies.study import Options
from scenarios.studies.transport_runs import (
    CODED,
    HEARTBEATS,
    ONCE,
    RELIABLE,
    Budget,
    Run,
    Setting,
    budget_of,
    with_equal_bytes,
)

WAYS = (ONCE, RELIABLE, HEARTBEATS, CODED)
"""How a change of action is announced, see `scenarios.studies.transport_runs`."""
RANGE = 14.0
"""Range, m, at which about 30 % of the messages are lost."""
NONE = "no memory"
CHANNELS: Mapping[str, float | None] = MappingProxyType({"0.1": 0.1, "1": 1.0, "10": 10.0, NONE: None})
"""Doppler frequency, Hz, by name; None: each message fades anew."""
SETTING = Setting(loss=0.0)
"""The setting of `transport_runs`, whose losses are replaced by fading."""


@dataclass(frozen=True)
class Cell:
    """The results of one way to announce on one channel; times are in s."""

    channel: str
    """Doppler frequency, Hz, or `NONE`."""
    way: str
    active_time: Estimate
    saving: Estimate
    """Paired difference: the active time of announcing once on the same channel minus that of this way, s."""
    age: Estimate
    """Mean age of information in a game at rest, s."""
    rate: float
    """Bytes per second of a pursuit."""


def links(channel: str) -> Links:
    """Return links with Rayleigh fading whose probability of reception does not depend on the channel."""
    doppler = CHANNELS[channel]
    memory = {"fading": "message"} if doppler is None else {"coherence": Coherence(doppler=doppler)}
    return Links(
        **{
            "latency": Constant(value=SETTING.latency),
            "range": RANGE,
            "reception": Nakagami(m=1.0, exponent=3.0),
            "fading": "correlated",
        }
        | memory
    )


def pursuit(channel: str, way: str, budget: Budget | None = None) -> Scenario:
    """Return the scenario of Lee & Bakolas on a channel; `budget` is that of `RELIABLE`; see `transport_runs`."""
    return _on(channel, transport_runs.pursuit(SETTING, way, budget))


def at_rest(channel: str, way: str, budget: Budget | None = None) -> Scenario:
    """Return a game at rest on a channel, in which each pursuer announces its action periodically."""
    return _on(channel, transport_runs.at_rest(SETTING, way, budget))


def _on(channel: str, scenario: Scenario) -> Scenario:
    return scenario.model_copy(update={"network": links(channel)})


def measure(options: Options) -> list[Cell]:
    """Run each way to announce on each channel."""
    pursuits = with_equal_bytes(options, CHANNELS, WAYS, pursuit, "pursuits", transport_runs.run_of_pursuit)
    rests = with_equal_bytes(options, CHANNELS, WAYS, at_rest, "ages", transport_runs.run_at_rest)
    return [
        _cell(channel, way, pursuits[channel, way], pursuits[channel, ONCE], rests[channel, way])
        for channel in CHANNELS
        for way in WAYS
    ]


def _cell(channel: str, way: str, runs: list[Run], reference: list[Run], ages: list[Run]) -> Cell:
    times, reference_times = (np.array([run.value for run in run_list]) for run_list in (runs, reference))
    age = estimate([run.value for run in ages])
    return Cell(channel, way, estimate(times), estimate(reference_times - times), age, budget_of(runs).bytes)
