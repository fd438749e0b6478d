"""Every class of models in the packages, and what each needs, so that a property can be tested over all of them."""

import importlib
import pkgutil
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

import desim
import protocols
from desim.config.model import Value
from desim.pursuit.evaders.recorded import RecordedMotion

TABLE = "t,value\n0,0.5\n1,0.25\n"
WAYPOINTS = [[0.0, 1.0, 1.0], [1.0, 2.0, 2.0]]
NEEDED: dict[str, dict[str, Any]] = {
    "Always": {"condition": "idle"},
    "Bitrate": {"bitrate": 9600.0},
    "ByzantineFault": {"start": 1.0, "node": 0},
    "ChaserCrash": {"start": 1.0},
    "ChaserCut": {"start": 1.0},
    "ConstantPosition": {"value": [1.0, 2.0]},
    "Crash": {"start": 1.0, "node": 1},
    "CustomFault": {"start": 1.0, "model": "faults:Mine", "drawn": {}},
    "Edge": {"src": 0, "dst": 1},
    "Empirical": {"values": [0.5]},
    "Equivocate": {"start": 1.0, "node": 0},
    "Eventually": {"condition": "captured", "limit": 2.0},
    "FalseAnnouncements": {"start": 1.0, "node": 0},
    "GyreFlow": {"speed": 0.5, "size": 2.0},
    "HarmonicFlow": {"amplitude": [0.5, 0.0], "period": 2.0},
    "InTotal": {"condition": "idle", "limit": 2.0},
    "Jamming": {"start": 1.0, "centre": [1.0, 2.0], "radius": 1.0},
    "LatencyMatrix": {"values": [[0.0, 0.5], [0.25, 0.0]]},
    "LatencyTrace": {"table": TABLE},
    "Layer": {"weights": [[0.5]], "bias": [0.25]},
    "LeadsTo": {"condition": "idle", "then": "not idle", "limit": 2.0},
    "Liar": {"start": 1.0, "node": 0},
    "LimitedTime": {"condition": "idle", "limit": 2.0},
    "Link": {"src": 0, "dst": 1, "latency": 0.5},
    "LossTrace": {"table": TABLE},
    "MessageFault": {"messages": [1]},
    "Misbehaviour": {"start": 1.0, "node": 0, "model": "liar", "number": 0},
    "NeverLonger": {"condition": "idle", "limit": 2.0},
    "Partition": {"start": 1.0, "groups": [[0, 1], [2]]},
    "Property": {"condition": "idle"},
    "RecordedFlow": {"velocities": [[0.0, 0.5, 0.0]]},
    "RecordedMotion": {"waypoints": WAYPOINTS},
    "RecordedPositions": {"file": "positions.csv"},
    "RelayNode": {"pursuer": 1, "motion": RecordedMotion(waypoints=WAYPOINTS)},
    "ReplayAttack": {"start": 1.0, "node": 0},
    "Selective": {"start": 1.0, "node": 0},
    "SignalTrace": {"table": TABLE},
    "_Chosen": {"exporter": "csv"},
    "_One": {"one": "idle never longer than 2"},
    "Silent": {"start": 1.0, "node": 0},
    "Slander": {"start": 1.0, "node": 0, "accused": [1]},
    "SlottedAloha": {"slot": 1.0},
    "Spoof": {"start": 1.0, "node": 0},
    "SteadyFlow": {"velocity": [0.5, 0.0]},
    "TargetedFault": {"start": 1.0},
    "VoronoiVertex": {"arena": [0.0, 5.0]},
    "Window": {"start": 1.0},
    "Wall": {"line": [[0.0, 0.0], [1.0, 0.0]]},
}
"""The arguments without which a class has no valid object, by its name."""


PLAYED = "desim.learning.episode"
"""The module that makes a class of each rule that is played."""
ABSTRACT = {"Fault", "LinkTrace", "_LossTrace"}
"""Classes without objects."""


def classes(base: type[Value] = Value) -> Iterator[type[Value]]:
    """Yield every class derived from `Value` in the packages, private ones included."""
    if base is Value:
        for package in (desim, protocols):
            for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
                if not module.name.endswith("__main__"):
                    importlib.import_module(module.name)
    for model in base.__subclasses__():
        if model.__module__.partition(".")[0] in {"desim", "protocols"} and model.__module__ != PLAYED:
            yield model
            yield from classes(model)


MODELS = sorted(
    {model for model in classes() if model.__name__ not in ABSTRACT},
    key=lambda model: (model.__module__, model.__qualname__),
)


def made(model: type[Value], changes: Mapping[str, Any] = MappingProxyType({})) -> Value:
    """Return an object of a class, with what it needs and with changes."""
    return model(**NEEDED.get(model.__name__, {}) | dict(changes))
