"""The imperfections that a search adds to a scenario, each with values within bounds of its own."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from desim.config.arguments import value_text
from desim.config.errors import ArgumentError, problems_of
from desim.scenario.overrides import ScenarioError, Source
from desim.scenario.scenario import Scenario
from desim.scenario.value_ranges import is_range, setting_at, values_to_try
from desim.study.plan.configurations import checked_ranges

NewValues = dict[str, Any]
"""New values by dotted key, as for `Scenario.with_`; under "fault", the table of one fault to add."""
Case = dict[str, NewValues]
"""The changes of a case, by the name of the feature that makes them."""
Draw = Callable[[np.random.Generator, Scenario], NewValues]
SIZES = (3, 4, 5, 6, 8, 10, 12)
"""The numbers of pursuers that a search tries."""
CHANGED = 1 / 3
"""The probability that a case with a parent draws a feature anew."""


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a random number between two bounds, uniform on a logarithmic scale, with two digits."""
    return float(f"{low * (high / low) ** rng.random():.2g}")


def _window(rng: np.random.Generator, scenario: Scenario) -> NewValues:
    """Return the start and the end of a fault; half of all faults never end."""
    start = _between(rng, 0.02, 0.5) * scenario.horizon
    end = {"end": start + _between(rng, 0.02, 0.5) * scenario.horizon} if rng.random() < 0.5 else {}
    return {key: float(f"{time:.3g}") for key, time in ({"start": start} | end).items()}


def _fault(kind: str, **more: Any) -> Draw:
    return lambda rng, scenario: {"fault": {"kind": kind, **_window(rng, scenario), **more}}


def _crash(rng: np.random.Generator, scenario: Scenario) -> NewValues:
    node = int(rng.integers(scenario.team.count))
    return {"fault": {"kind": "crash", "node": node, "memory": bool(rng.integers(2)), **_window(rng, scenario)}}


def _partition(rng: np.random.Generator, scenario: Scenario) -> NewValues:
    size = scenario.team.count
    cut = sorted(rng.permutation(size)[: rng.integers(1, max(size, 2))].tolist())
    return {"fault": {"kind": "partition", "groups": [cut], **_window(rng, scenario)}}


def _news(rng: np.random.Generator, scenario: Scenario) -> NewValues:
    delay = {"delay": _between(rng, 0.1, 5.0)} if rng.random() < 0.5 else {}
    return {"fault": {"kind": "news_fault", **_window(rng, scenario), **delay}}


def _random_latency(rng: np.random.Generator, _: Scenario) -> NewValues:
    return {"network.latency": {"kind": "shifted_exponential", "mean": _between(rng, 0.01, 1.0)}}


def _bursts(rng: np.random.Generator, _: Scenario) -> NewValues:
    share, burst = _between(rng, 0.02, 0.5), _between(rng, 0.1, 5.0)
    return {"network.loss": {"kind": "gilbert_elliott", "share": share, "burst": burst, "advance": "time"}}


def _busy_channel(rng: np.random.Generator, _: Scenario) -> NewValues:
    return {"network.medium": {"kind": "bitrate", "bitrate": _between(rng, 1e4, 1e6), "access": {"kind": "csma"}}}


def _jamming(rng: np.random.Generator, scenario: Scenario) -> NewValues:
    disc = {"centre": [_between(rng, 1.0, 20.0), _between(rng, 1.0, 20.0)], "radius": _between(rng, 1.0, 20.0)}
    return {"fault": {"kind": "jamming", **_window(rng, scenario), **disc}}


def _wrong_clocks(rng: np.random.Generator, _: Scenario) -> NewValues:
    return {"fault": {"kind": "clock_skew", "offset": _between(rng, 0.01, 2.0), "drift": _between(rng, 1e-4, 1e-2)}}


FEATURES: Mapping[str, Draw] = MappingProxyType(
    {
        "team": lambda rng, _: {"team.count": int(rng.choice(SIZES))},
        "latency": lambda rng, _: {"network.latency": _between(rng, 0.01, 1.0)},
        "random latency": _random_latency,
        "loss": lambda rng, _: {"network.loss": _between(rng, 0.01, 0.6)},
        "bursts": _bursts,
        "duplicates": lambda rng, _: {"network.duplicate": _between(rng, 0.01, 0.5)},
        "range": lambda rng, _: {"network.range": _between(rng, 3.0, 30.0)},
        "busy channel": _busy_channel,
        "silent start": lambda *_: {"announce.start": "silent"},
        "heartbeat": lambda rng, _: {"announce.heartbeat": _between(rng, 0.05, 2.0)},
        "changes only": lambda *_: {"announce.trigger": "change"},
        "crash": _crash,
        "partition": _partition,
        "jamming": _jamming,
        "wrong clocks": _wrong_clocks,
        "chaser crash": _fault("chaser_crash"),
        "chaser cut": _fault("chaser_cut"),
        "news fault": _news,
        "chaser lies": _fault("liar", chaser=True, action="stay"),
    }
)
"""The imperfections by name; each draws new values of keys. "team" comes first: other features name pursuers."""


def of_grid(grid: Mapping[str, Sequence[Any]], scenario: Scenario) -> Mapping[str, Draw]:
    """Return features of a user: each key takes one of its values, or a number of its range.

    Raises:
        ScenarioError: if the scenario does not take a value of a key.
        ArgumentError: if the values of a key are no list.
    """

    def draw_of(key: str, values: Sequence[Any]) -> Draw:
        if is_range(values):
            return lambda rng, _: {key: setting_at(values, rng.random())}
        return lambda rng, _: {key: values[int(rng.integers(len(values)))]}

    for key, values in grid.items():
        if isinstance(values, str) or not isinstance(values, Sequence | np.ndarray):
            raise ArgumentError(
                "vary", f": {key}: should be a list of values, [{value_text(values)}] (got {value_text(values)})"
            )
    ranges = {key: values for key, values in grid.items() if is_range(values)}
    grid = {**grid, **checked_ranges(Source.of(scenario), ranges)}
    for key, values in grid.items():
        for value in values_to_try(values):
            try:
                scenario.with_({key: value})
            except ScenarioError as error:
                raise ScenarioError(*(problem._replace(where="vary") for problem in problems_of(error))) from None
    return {key: draw_of(key, [*values]) for key, values in grid.items()}


def drawn(
    features: Mapping[str, Draw], rng: np.random.Generator, scenario: Scenario, parent: Case | None = None
) -> Case:
    """Return a random case.

    The case has each feature with probability 1/2 (Groce et al. 2012, "Swarm Testing"): many failures occur only
    without some other feature. A case with a parent draws a third of the features anew, and keeps the others.
    """
    case: Case = {}
    for name, draw in features.items():
        if parent is not None and rng.random() >= CHANGED:
            if name in parent:
                case[name] = parent[name]
        elif rng.random() < 0.5:
            case[name] = draw(rng, scenario)
        if name == "team" and name in case:  # later features draw pursuers of this team
            scenario = changed_or_none(scenario, {name: case[name]}) or scenario
    return case


def applied(scenario: Scenario, case: Mapping[str, NewValues]) -> Scenario:
    """Return a scenario with the changes of a case; the faults of the scenario stay.

    Raises:
        ScenarioError: if the result would not be valid.
    """
    faults = [changes["fault"] for changes in case.values() if "fault" in changes]
    new_values = {key: value for changes in case.values() for key, value in changes.items() if key != "fault"}
    return scenario.with_(new_values | ({"fault": [*scenario.fault, *faults]} if faults else {}))


def changed_or_none(scenario: Scenario, case: Case) -> Scenario | None:
    """Return a scenario with the changes of a case; None if the result would not be valid."""
    try:
        return applied(scenario, case)
    except ValueError:
        return None
