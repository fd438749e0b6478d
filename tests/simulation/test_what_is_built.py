"""What a run builds from the keys of a scenario: the arguments of each constructor are golden.

In each scenario many keys differ from their defaults, so that an argument that is dropped or swapped is another line.
"""

import inspect
import pkgutil
from functools import cache
from importlib import import_module
from types import FunctionType

import numpy as np
import pytest
from pydantic import BaseModel

from desim import Scenario, run
from desim.live.node import Node
from tests.golden import golden

PACKAGES = ("kernel", "live", "pursuit", "scenario", "simulation")
AMONG_WALLS = {
    "horizon": 0.02,
    "team": {"count": 3, "speeds": [2.0, 2.5, 3.0], "box": [0.0, 5.0]},
    "evader": [
        {"speed": 1.5, "box": [6.0, 8.0], "motion_interval": 0.1, "motion_error": 0.2, "reaction_delay": 0.05},
        {"speed": 1.25, "position": [7.0, 1.0], "sensing_range": 9.0, "strategy": "hide"},
    ],
    "wall": [{"line": [[5.5, 0.0], [5.5, 3.0]]}],
    "sensing": {"radius": 8.0, "relay": True, "track_timeout": 3.0, "on_lost": "stay", "estimate": "hold"},
    "motion": {"step": 0.005},
    "capture": {"radius": 0.3, "captures_to_end": 1},
    "clocks": {"sync": {"kind": "two_way", "interval": 0.7}},
    "fault": [{"kind": "crash", "node": 1, "start": 0.3, "end": 0.4}, {"kind": "clock_skew", "node": 2, "offset": 0.1}],
    "network": {
        "range": 6.0,
        "range_check": "delivery",
        "reception": {"kind": "log_distance", "exponent": 2.5},
        "fading": "message",
        "latency": {"kind": "uniform", "low": 0.01, "high": 0.02},
        "loss": 0.125,
        "duplicate": 0.0625,
        "processing": {"sender": 0.003, "receiver": 0.004},
        "order": "fifo",
        "medium": {"kind": "bitrate", "bitrate": 1e6, "access": {"kind": "csma", "backoff": 0.02}, "queue_limit": 7},
    },
    "announce": {"trigger": "both", "heartbeat": 0.25, "payload": "time", "belief_timeout": 4.0, "jitter": 0.125},
    "protocol": {"kind": "sap", "schedule": {"kind": "poisson", "rate": 5.0}},
    "record": {"trajectory": 0.01, "messages": True},
    "prune": "infeasible",
}
IN_WIND = {
    "horizon": 0.02,
    "team": {"count": 3, "speeds": 2.0, "dynamics": {"kind": "acceleration", "limit": 3.0}},
    "evader": {"strategy": {"kind": "zigzag", "period": 0.5}, "motion_error": 0.0},
    "environment": {"flow": {"kind": "uniform", "velocity": [0.25, 0.125]}, "on": "all"},
    "sensing": {"radius": 7.0, "noise": 0.1, "interval": 0.1, "estimator": "kalman", "fusion": "naive"},
    "network": {"transport": {"kind": "reliable", "window": 5}, "graph": "ring", "loss": 0.25},
    "announce": {"payload": "state", "dissemination": "flooding", "trust": {"kind": "plausible"}},
    "fault": [{"kind": "liar", "node": 2, "start": 0.001, "phi": 0.5}],
    "protocol": "cbba",
}


LIVE = {
    "horizon": 0.5,
    "team": {"count": 3, "speeds": [2.0, 2.5, 3.0], "box": [0.0, 5.0]},
    "clocks": {"sync": {"kind": "two_way", "interval": 0.7}},
    "network": {"latency": 0.01, "loss": 0.125, "duplicate": 0.0625, "transport": {"kind": "reliable", "window": 5}},
    "announce": {"trigger": "both", "heartbeat": 0.25, "payload": "state", "belief_timeout": 4.0},
    "protocol": "cbba",
}
OTHERS = BaseModel, BaseException, tuple
PASSING = {
    "EvaderObservation",
    "Frame",
    "Instant",
    "Layout",
    "LinkContext",
    "Owed",
    "Speaker",
    "State",
    "Trace",
}
"""Objects of which a run makes many, or which are kept for the next run."""


def shown(value):
    """Return an argument as text that depends on no random number."""
    if isinstance(value, BaseModel):
        keys = value.model_fields_set - {"kind"}
        return f"{type(value).__name__}({', '.join(sorted(keys))})"
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    if value is None or isinstance(value, bool | int | str):
        return repr(value)
    if type(value) in {tuple, list, dict}:
        items = list(dict.fromkeys(map(shown, value)))
        return f"{type(value).__name__} of {len(value)}: {', '.join(items[:3])}"
    if isinstance(value, np.ndarray):
        return f"array {value.shape} {value.dtype}"
    return getattr(value, "__name__", f"<{type(value).__name__}>")


@cache
def constructors():
    """Return the classes whose objects are made by an `__init__` of their own, without models, events and errors."""
    found = []
    for package in PACKAGES:
        path = import_module(f"desim.{package}").__path__
        for module in pkgutil.walk_packages(path, f"desim.{package}."):
            for kind in vars(import_module(module.name)).values():
                if isinstance(kind, type) and kind.__module__ == module.name and "__init__" in vars(kind):
                    is_plain = isinstance(vars(kind)["__init__"], FunctionType)
                    if is_plain and kind.__name__ not in PASSING and not issubclass(kind, OTHERS):
                        found.append(kind)
    return found


def built(monkeypatch, act):
    """Return the calls of constructors in a function, each once, as lines in order."""
    calls = set()

    def noting(kind, made):
        signature = inspect.signature(made)

        def init(self, *args, **named):
            arguments = signature.bind(self, *args, **named).arguments
            _, *given = [f"{key}={shown(value)}" for key, value in arguments.items()]
            calls.add(f"{kind.__qualname__}({', '.join(given)})")
            made(self, *args, **named)

        return init

    for kind in constructors():
        monkeypatch.setattr(kind, "__init__", noting(kind, vars(kind)["__init__"]))
    act()
    return "\n".join(sorted(calls)) + "\n"


@pytest.mark.parametrize(("name", "keys"), [("among walls", AMONG_WALLS), ("in wind", IN_WIND)])
def test_what_a_run_builds_of_its_keys_is_golden(monkeypatch, name, keys):
    scenario = Scenario(**keys)
    golden(f"built/{name}.txt", built(monkeypatch, lambda: run(scenario, 3)))


def test_what_a_live_node_builds_of_its_keys_is_golden(monkeypatch):
    scenario = Scenario(**LIVE)
    golden("built/live node.txt", built(monkeypatch, lambda: Node(scenario, 1, 3, draws=True, on_action=print)))
