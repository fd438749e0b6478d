"""Whole runs in other units, moved and turned: the same events at the same times, whatever kinds are combined.

The units are those that the descriptions of the keys state. So a unit that is wrong, and a length or a time that is
hidden in the code, show as another run. The scenarios are those of `tests/test_soak.py`, in which anything may break.
"""

from cmath import phase, rect
from typing import get_args, get_type_hints

import numpy as np
import pytest

from desim import Scenario, run
from desim.config.choice import choices_of
from desim.config.field_docs import fields_of, unit_in
from desim.config.model import Value
from desim.config.model_parts import models_in
from desim.pursuit.core.events import Captured
from desim.pursuit.evaders import evasion
from desim.pursuit.motion.dynamics import TurnRate
from desim.pursuit.sensing import tracking
from tests.test_soak import Dice, anything

UNITS = {
    "m": (1, 0),
    "s": (0, 1),
    "m/s": (1, -1),
    "1/s": (0, -1),
    "rad/s": (0, -1),
    "rad/sqrt(s)": (0, -0.5),
    "bit/s": (0, -1),
    "Hz": (0, -1),
    "rad": (0, 0),
    "dB": (0, 0),
}
"""The powers of length and time in each unit."""
MIXED = {
    "Acceleration.limit": (1, -2),
    "Kalman.velocity_diffusion": (1, -1.5),
    "AlphaBeta.velocity_diffusion": (1, -1.5),
    "ClockSkew.offset": (0, 1),
    "ClockSkew.offset_walk": (0, 0.5),
    "ClockSkew.drift_walk": (0, -0.5),
    "Coherence.frequency": (-1, 0),  # of light, whose speed stays: a wave is as much longer
    "Jamming.radius": (1, 0),
    "Wall.thickness": (0, 0),
    "ConstantTime.value": (0, 1),
    "RandomTime.low": (0, 1),
    "RandomTime.high": (0, 1),
    **dict.fromkeys(("Eventually.limit", "InTotal.limit", "LeadsTo.limit", "NeverLonger.limit"), (0, 1)),
    "LatencyMatrix.values": (0, 1),
}
"""Those of keys whose description has no unit alone, or another one."""
ROWS = {"RecordedMotion.waypoints": ((0, 1), (1, 0), (1, 0)), "RecordedFlow.velocities": ((0, 1), (1, -1), (1, -1))}
"""Those of lists whose rows are a time and a vector."""

PURE = frozenset(
    [
        "active_at_start",
        "alpha",
        "attempts",
        "backoff",
        "bandwidth",
        "bias",
        "burst",
        "certain",
        "common",
        "correlation",
        "cv",
        "drift",
        "drop",
        "duty_cycle",
        "exponent",
        "factor",
        "far",
        "heading",
        "hysteresis",
        "jitter",
        "k",
        "loss_bad",
        "loss_good",
        "m",
        "max_repeats",
        "near",
        "noise",
        "offset",
        "p",
        "p13",
        "p14",
        "p23",
        "p31",
        "p32",
        "participation",
        "power",
        "power_exponent",
        "queue_limit",
        "ratio",
        "reorder",
        "reorder_correlation",
        "rho",
        "scale",
        "shape",
        "share",
        "shared",
        "threshold",
        "weights",
    ]
)
"""The names of numbers without a unit, or whose unit another key states."""


def powers(model, name):
    """Return the powers of length and time in a key of a model; (0, 0) if it is a pure number."""
    key, field = f"{type(model).__name__}.{name}", fields_of(type(model))[name]
    if key == "GilbertElliott.burst":
        return (0, 1) if model.advance == "time" else (0, 0)
    return MIXED.get(key) or UNITS.get(unit_in(field), (0, 0))


def table_of(model, convert):
    """Return the table of a model, with `convert(owner, key, value)` in place of each value that is no model."""
    if isinstance(model, Value):
        given = {name: getattr(model, name) for name in type(model).model_fields}
        return {
            name: table_of(value, convert) if _holds_models(value) else convert(model, name, value)
            for name, value in given.items()
            if name == "kind" or (value is not None and (name in model.model_fields_set or not isinstance(value, str)))
        }
    return [table_of(each, convert) for each in model]


def _holds_models(value):
    return isinstance(value, Value) or (isinstance(value, tuple | list) and any(map(_holds_models, value)))


def in_units(scenario, length=1.0, time=1.0):
    """Return a scenario in which all lengths and all times are so many times as long."""

    def scaled(value, power):
        if isinstance(value, tuple | list):
            return [scaled(each, power) for each in value]
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        return value * length ** power[0] * time ** power[1] if is_number and power != (0, 0) else value

    def convert(owner, name, value):
        rows = ROWS.get(f"{type(owner).__name__}.{name}")
        if rows is not None:
            return [[scaled(each, power) for each, power in zip(row, rows, strict=True)] for row in value]
        return scaled(value, powers(owner, name))

    return Scenario.model_validate(table_of(scenario, convert))


def simplified(seed):
    """Return the table of a scenario without what has lengths and times of its own, in files and defaults."""
    table = anything(seed)
    network = table["network"]
    table["fault"] = [fault for fault in table["fault"] if fault["kind"] != "random_lies"]
    for owner in (network, *network["link"]):
        if owner["latency"]["kind"] == "trace":
            owner["latency"] = {"kind": "gamma"}
        if owner["loss"]["kind"] in {"trace", "signal_trace"}:
            owner["loss"] = {"kind": "bernoulli", "p": 0.2}
    if network["medium"]["kind"] == "lora":
        network["medium"] = contended(seed)
    if "coherence" in network:
        network["coherence"] = network["coherence"] | {"frequency": 2.0**30}
    return table


def contended(seed):
    """Return a medium for which nodes contend, of any kind."""
    dice = Dice(seed, "contended")
    access = [
        {"kind": "aloha"},
        {"kind": "csma", "backoff": 0.004, "sensing_delay": 0.0002},
        {"kind": "csma_ca", "sensing_delay": 4e-6, "ack_timeout": 69e-6, "eifs": 88e-6, "sensing_range": 5.0},
    ]
    reception = [
        {"kind": "collision"},
        {"kind": "capture", "threshold": 3.0, "fading": "rice", "shadowing": 3.0},
        {"kind": "sinr", "fading": "nakagami", "m": 2.0},
    ]
    return {"kind": "bitrate", "bitrate": 2e5, "access": dice.one(access), "reception": dice.one(reception)}


def history(scenario, unit=1):
    """Return what happens in a run: each event without its lengths, and its times in units of so many ns."""
    found = []
    for event in run(scenario).trace:
        times = [getattr(event, name, None) for name in ("t", "created", "arrival")]
        flat = [t for each in times if each is not None for t in (each if isinstance(each, tuple) else (each,))]
        names = ("pursuer", "active", "evader", "capturer", "src", "dst", "seq", "cause", "reason")
        what = [getattr(event, name, None) for name in names if not isinstance(getattr(event, name, None), float)]
        found.append((type(event).__name__, what, [t if t is None or t < 0 else t / unit for t in flat]))
    return found


def differs(one, other, tolerance=0.0):
    """Return the first events of two histories that differ, or None."""
    for first, second in zip(one, other, strict=False):
        times = zip(first[2], second[2], strict=False)
        apart = max((abs(s - t) for s, t in times if s is not None and t is not None), default=0.0)
        if first[:2] != second[:2] or len(first[2]) != len(second[2]) or apart > tolerance:
            return first, second
    return None if len(one) == len(other) else (len(one), len(other))


def models_of(model):
    """Yield a model and all models that its tables may be, once each."""
    pending, found = [model], {model}
    while pending:
        yield (outer := pending.pop())
        for field in fields_of(outer).values():
            inner = {
                *models_in(field.annotation),
                *(kind for each in choices_of(field) for kind in each.choices().values()),
            }
            pending += inner - found
            found |= inner


def is_real(model, name):
    def has_float(annotation):
        return annotation is float or any(has_float(each) for each in get_args(annotation) if not isinstance(each, str))

    return has_float(get_type_hints(model)[name])


def test_each_number_of_a_scenario_file_states_its_unit_or_is_a_pure_number():
    """Whoever adds a number states a unit of `UNITS`, or adds it to the tables above."""
    for model in models_of(Scenario):
        for name, field in fields_of(model).items():
            key, unit = f"{model.__name__}.{name}", unit_in(field)
            if is_real(model, name) and key not in {*MIXED, *ROWS}:
                assert unit in UNITS or (unit is None and name in PURE), key


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("length", [256.0, 1.0 / 64.0])
@pytest.mark.parametrize("seed", range(12))
def test_a_world_of_another_size_has_the_same_history_to_the_nanosecond(seed, length, monkeypatch):
    scenario = Scenario.model_validate(simplified(seed))
    assert in_units(scenario) == scenario
    before = history(scenario)
    monkeypatch.setattr(tracking, "START_SPEED", tracking.START_SPEED * length)
    assert differs(before, history(in_units(scenario, length=length))) is None


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_a_world_four_times_as_slow_has_the_same_history_four_times_as_late(seed, monkeypatch):
    """Up to rounding: each random time is rounded to a nanosecond."""
    scenario = Scenario.model_validate(simplified(seed))
    before = history(scenario)
    monkeypatch.setattr(tracking, "START_SPEED", tracking.START_SPEED / 4.0)
    assert differs(before, history(in_units(scenario, time=4.0), unit=4), tolerance=1000.0) is None


@pytest.mark.whole
def test_a_length_that_is_not_scaled_shows_as_another_history():
    """The control: where players are captured, also a capture radius that is a thousandth too small."""
    for seed in range(12):
        scenario = Scenario.model_validate(simplified(seed))
        if scenario.capture.test == "segment" and run(scenario).trace.of(Captured):
            capture = scenario.capture.model_copy(update={"radius": 0.999 * scenario.capture.radius})
            assert differs(history(scenario), history(scenario.model_copy(update={"capture": capture}))) is not None


POINTS = {
    *("Team.positions", "Evader.position", "Jamming.centre", "AffineFlow.centre", "RecordedMotion.waypoints"),
    *("Wall.line", "Wall.polygon"),
}
VECTORS = {"SteadyFlow.velocity", "AffineFlow.velocity", "HarmonicFlow.velocity", "HarmonicFlow.amplitude"}


def moved(scenario, turn=1.0, shift=0.0, mirrored=False):
    """Return a scenario that is mirrored at the x axis if so asked, then turned about the origin, then shifted."""

    def coordinates(vector, offset):
        x, y = vector
        place = turn * complex(x, -y if mirrored else y) + offset
        return [place.real, place.imag]

    def convert(owner, name, value):
        key = f"{type(owner).__name__}.{name}"
        offset = shift if key in POINTS else 0.0
        if key in ROWS:
            return [[t, *coordinates(vector, offset)] for t, *vector in value]
        if key in POINTS | VECTORS:
            is_one = isinstance(value[0], float)
            return coordinates(value, offset) if is_one else [coordinates(each, offset) for each in value]
        if key in {"ConstantHeading.angle", "TurnRate.heading"}:
            return phase(turn * rect(1.0, -value if mirrored else value))
        return -value if key == "AffineFlow.rotation" and mirrored else value

    return Scenario.model_validate(table_of(scenario, convert))


def about_the_origin(seed):
    """Return a scenario whose players start at given places about the origin, without what has directions of its own.

    These are errors of single coordinates, random places, the first direction of a search, a channel that depends on
    places, and cells.
    """
    table = simplified(seed)
    table["fault"] = [fault for fault in table["fault"] if fault["kind"] != "random"]
    network, sensing = table["network"], table["sensing"]
    if network["fading"] == "correlated":
        del network["coherence"]
        network["fading"] = "message"
    if "noise" in sensing:
        sensing["noise"] = {"kind": "range_bearing"}
    sensing["on_lost"] = "stay"
    if table.get("environment", {}).get("flow", {}).get("kind") == "gyre":
        table["environment"]["flow"] = {"kind": "affine", "expansion": -0.2, "rotation": 0.5, "centre": [1.0, 2.0]}
    dice = Dice(seed, "places")
    table["team"]["positions"] = [
        [dice.number(-5.0, 5.0), dice.number(-5.0, 5.0)] for _ in range(table["team"]["count"])
    ]
    for evader in table["evader"]:
        if evader["strategy"]["kind"] != "recorded":
            evader["position"] = [dice.number(-3.0, 3.0), dice.number(-3.0, 3.0)]
        if evader["strategy"]["kind"] == "voronoi_vertex":
            evader["strategy"]["arena"] = [-5.0, 5.0]
    return Scenario.model_validate(table)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_a_world_that_is_turned_has_the_same_history(seed, monkeypatch):
    scenario = about_the_origin(seed)
    before = history(scenario)
    plain, headings = evasion.random_heading, TurnRate.headings
    monkeypatch.setattr(evasion, "random_heading", lambda rng: 1j * plain(rng))
    monkeypatch.setattr(TurnRate, "headings", lambda *call: [1j * each for each in headings(*call)])
    assert differs(before, history(moved(scenario, turn=1j)), tolerance=10.0) is None


WALLS = [
    {"polygon": [[2.0, 2.0], [3.1, 2.2], [3.0, 3.3], [1.9, 3.0]], "blocks": ["motion", "sight", "radio"], "loss": 6.0},
    {"polygon": [[6.1, 6.3], [8.2, 6.1], [7.9, 7.7]], "blocks": ["motion", "sight"]},
    {"line": [[4.1, 0.3], [4.4, 2.9], [6.3, 2.2]], "blocks": ["motion"]},
]
HARMONIC = {"kind": "harmonic", "velocity": [0.2, 0.3], "amplitude": [0.1, -0.2], "period": 3.0, "phase": 0.4}
AFFINE = {"kind": "affine", "velocity": [0.1, 0.2], "expansion": -0.05, "rotation": 0.3, "centre": [3.0, 4.0]}
ANYWHERE = {
    "walls": {"wall": WALLS, "evader.strategy": {"kind": "weighted_flee"}},
    "walls, simultaneous": {"wall": WALLS, "motion.order": "simultaneous", "protocol": {"kind": "sap"}},
    "wind": {"environment": {"flow": HARMONIC, "on": "pursuers"}, "team.guidance": {"kind": "constant_bearing"}},
    "a whirl": {"environment": {"flow": AFFINE, "on": "all"}, "evader.strategy": {"kind": "listener"}},
    "accelerations": {"team.dynamics": {"kind": "acceleration"}, "evader.dynamics": {"kind": "acceleration"}},
    "turns": {"team.dynamics": {"kind": "turn_rate", "heading": 0.3}, "capture.radius": 0.3},
    "out of sight": {"sensing.radius": 3.0, "sensing.estimate": "constant_velocity", "protocol": {"kind": "local_min"}},
    "out of range": {"network.range": 5.0, "evader.strategy": {"kind": "constant_heading", "angle": 0.4}},
    "announced": {"announce.payload": "state", "network.latency": 0.1, "evader.strategy.flees_from": "active"},
    "two evaders": {"evader": [{"position": [5.0, 4.0]}, {"position": [1.0, 9.0], "strategy": {"kind": "still"}}]},
}
"""Features of a pursuit, with shapes and directions in the plane."""


def anywhere(changes, seed=3):
    """Return a pursuit by four pursuers at given places, with some features."""
    places = np.random.default_rng(seed).uniform(0.0, 10.0, (4, 2)).tolist()
    plain = {"team.count": 4, "team.speeds": [1.5, 2.0, 1.8, 2.2], "team.positions": places, "horizon": 15.0}
    plain |= {"motion.step": 0.05, "record.trajectory": 0.0, "protocol": {"kind": "best_response"}}
    return Scenario().with_(plain | ({} if "evader" in changes else {"evader.position": [5.0, 4.5]}) | changes)


@pytest.mark.slow
@pytest.mark.parametrize("name", ANYWHERE)
def test_a_pursuit_that_is_shifted_turned_or_mirrored_has_the_same_history(name):
    """Captures and decisions come at the same times, wherever corners of walls and winds point to."""
    scenario = anywhere(ANYWHERE[name])
    before = history(scenario)
    assert any(event == "Captured" for event, *_ in before)
    for move in (
        {"shift": 137.25 - 77.5j},
        {"turn": rect(1.0, 0.7)},
        {"turn": rect(1.0, -2.0), "shift": 3.0 + 1j, "mirrored": True},
    ):
        assert differs(before, history(moved(scenario, **move)), tolerance=50.0) is None, move


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["centralised", "argmin", "voronoi"])
def test_the_order_of_a_team_has_no_effect_where_no_draw_depends_on_it(kind):
    order = [2, 0, 3, 1]
    for name, changes in ANYWHERE.items():
        if name.startswith("walls") and kind == "voronoi":
            continue  # refused
        one = anywhere(changes | {"protocol": {"kind": kind}, "team.active_at_start": 1.0})
        places, speeds = one.team.positions, one.team.all_speeds()
        other = one.with_(
            {"team.positions": [list(places[i]) for i in order], "team.speeds": [speeds[i] for i in order]}
        )
        captures = [
            [(event.t, event.evader, numbers[event.capturer]) for event in run(made).trace.of(Captured)]
            for made, numbers in ((one, range(4)), (other, order))
        ]
        assert captures[0], name
        for (t, *who), (s, *whom) in zip(*captures, strict=True):
            assert (who, t) == (whom, pytest.approx(s, abs=50)), name
