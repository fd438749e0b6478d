"""Short runs of rare combinations of models: golden counts of their events, metrics, and digests of their traces.

A run has one variant of each family below, none of them with its defaults. Watchers see what is wrong with any run
(`tests/test_soak.py`); here a difference from what the run was is seen, whatever it is. If only digests differ, compare
the traces: `python -m tests.test_traces ROW` prints that of a row.
"""

import json
import sys
from collections import Counter
from functools import cache
from hashlib import sha256
from math import inf

import pytest

from desim import Scenario, run, summary
from desim.analysis.metrics import plain
from desim.kernel.core.trace_file import line_of
from desim.kernel.models.access import ACCESSES
from desim.kernel.models.graphs import GRAPHS
from desim.kernel.models.interference import INTERFERENCES
from desim.kernel.models.latency_by_link import LATENCIES
from desim.kernel.models.loss import LOSSES
from desim.kernel.models.medium import MEDIA
from desim.kernel.models.reception import RECEPTION_MODELS
from desim.kernel.models.transport import TRANSPORTS
from desim.pursuit.byzantine.lies import PURSUER_FAULTS
from desim.pursuit.evaders.evasion import STRATEGIES
from desim.pursuit.game.utility import UTILITIES
from desim.pursuit.motion.dynamics import DYNAMICS
from desim.pursuit.motion.flow import FLOWS
from desim.pursuit.sensing.noise import NOISES
from desim.pursuit.sensing.tracking import ESTIMATORS
from desim.pursuit.team.announcements import DISSEMINATIONS
from desim.pursuit.team.trust import TRUSTS
from desim.scenario.scenario import PROTOCOLS
from protocols.rule import SCHEDULES
from protocols.temperature import TEMPERATURES
from tests.golden import golden

BLOCKS, SIZE = 7, 4
HORIZON = 0.2
"""Of each run, s."""
TIMES = "t,value\n0,{}\n0.11,{}\n0.17,\n0.23,{}"
PAIRS = [(src, dst) for src in range(4) for dst in range(4) if src != dst]
ROWS = [f"{0.08 * k:g},{src},{dst},{5 + (7 * src + 5 * dst + 11 * k) % 40}" for k in range(3) for src, dst in PAIRS]
ROWS[14] = "0.08,0,3,"
LINKED = {"kind": "trace", "time": "at", "src": "from", "dst": "to", "value": "ms", "unit": "ms"}
CORRELATED = {
    "fading": "correlated",
    "coherence": {"doppler": 3.0, "frequency": 9e8, "decorrelation": 2.0, "shared": 0.4, "waves": 12},
}
QUALITY = {"lifespan": 0.06, "deadline": 0.04, "lease": 0.07}
BITS = {"kind": "bitrate", "bitrate": 2e5, "header": 3}
PASSABLE = {"line": [[4.0, 2.0], [4.0, 8.0]], "blocks": ["radio"], "loss": 4.0}
BLOCK = [[6.0, 1.0], [7.0, 1.0], [7.0, 9.0], [6.0, 9.0]]
SHORT = {"radius": 4.0, "relay": True, "period": 0.07, "track_timeout": 0.05}
SEEN = (
    {"sensing": SHORT | {"estimate": "hold", "noise": {"kind": "position", "deviation": 0.3}}},
    {
        "sensing": SHORT
        | {"noise": {"kind": "position"}, "estimator": {"kind": "alpha_beta", "velocity_diffusion": 0.5}}
    },
    {"sensing": {"noise": {"kind": "range_bearing", "bearing": 0.1}, "estimator": "kalman", "fusion": "naive"}},
    {"sensing": {"noise": {"kind": "position"}, "estimator": "kalman", "fusion": "covariance_intersection"} | SHORT},
    {"sensing": {"noise": {"kind": "none"}, "estimate": "hold"} | SHORT},
)
FLOWING = (
    {"kind": "uniform", "velocity": [0.3, -0.2]},
    {"kind": "harmonic", "velocity": [0.1, 0.0], "amplitude": [0.4, 0.2], "period": 0.3},
    {"kind": "recorded", "velocities": [[0.0, 0.2, 0.1], [0.15, -0.3, 0.2]]},
    {"kind": "affine", "expansion": -0.2, "rotation": 0.5, "centre": [5.0, 5.0]},
    {"kind": "gyre", "speed": 0.5, "size": 3.0, "shift": 1.0, "period": 2.0},
)
FAMILIES = {
    "graph": [
        {"kind": "complete"},
        {"kind": "complete"},
        {"kind": "ring"},
        {"kind": "star", "centre": 2},
        {"kind": "grid", "columns": 2},
        {
            "kind": "edges",
            "directed": True,
            "edges": [{"src": k, "dst": (k + 1) % 4, "latency": 0.01 * k} for k in range(4)]
            + [{"src": 0, "dst": 2, "loss": 0.4, "order": "fifo"}],
        },
    ],
    "range": [inf, inf, 5.0],
    "propagation": [
        {"reception": {"kind": "disk", "exponent": 2.5}} | CORRELATED,
        {"reception": {"kind": "quasi_unit_disk", "certain": 0.4, "p": 0.7, "exponent": 2.5}},
        {"reception": {"kind": "quasi_unit_disk", "certain": 0.3}, "fading": "message"},
        {"reception": {"kind": "log_distance", "exponent": 2.2, "shadowing": 4.0}},
        {"reception": {"kind": "log_distance", "exponent": 2.5}, "fading": "message"},
        {"reception": {"kind": "nakagami", "m": 2.0, "exponent": 2.4}, "fading": "message"},
        {"reception": {"kind": "nakagami", "exponent": 2.4}},
        {"reception": {"kind": "rice", "k": 5.0, "exponent": 2.4}},
        {"reception": {"kind": "rice"}} | CORRELATED,
    ],
    "range_check": ["send", "delivery", "both"],
    "latency": [
        {"kind": "constant", "value": 0.013},
        {"kind": "uniform", "low": 0.002, "high": 0.04},
        {"kind": "shifted_exponential", "offset": 0.003, "mean": 0.02},
        {"kind": "gamma", "offset": 0.001, "shape": 3.0, "scale": 0.004},
        {"kind": "lognormal", "offset": 0.002, "mean": 0.02, "cv": 0.8},
        {"kind": "empirical", "values": [0.003, 0.01, 0.06]},
        {
            "kind": "netem",
            "delay": 0.02,
            "jitter": 0.015,
            "correlation": 0.3,
            "distribution": "pareto",
            "reorder": 0.3,
            "reorder_correlation": 0.5,
            "gap": 2,
        },
        {"kind": "netem", "delay": 0.02, "jitter": 0.03, "distribution": "normal"},
        {"kind": "propagation", "speed": 300.0, "fixed": 0.004},
        {
            "kind": "per_pair",
            "base": {"kind": "gamma", "scale": 0.005},
            "jitter": {"kind": "uniform", "high": 0.01},
            "symmetric": False,
        },
        {
            "kind": "matrix",
            "values": [[0, 10, 20, 30], [12, 0, 5, 7], [8, 6, 0, 44], [3, 9, 27, 0]],
            "unit": "ms",
            "rtt": True,
            "jitter": {"kind": "uniform", "high": 0.004},
        },
        {
            "kind": "trace",
            "table": TIMES.format(0.01, 0.05, 0.02),
            "between": "linear",
            "after": "repeat",
            "start": 0.05,
        },
        {"kind": "trace", "table": TIMES.format(0.01, 0.05, 0.02), "start": "random", "rtt": True},
        LINKED | {"table": "\n".join(["at,from,to,ms", *ROWS]), "rtt": True, "between": "linear", "after": "hold"},
        LINKED
        | {
            "table": "\n".join(["at,from,to,ms", *(row for row in ROWS if row.split(",")[1] < row.split(",")[2])]),
            "both_ways": True,
            "start": "random",
        },
    ],
    "order": ["overtaking", "fifo"],
    "loss": [
        {"kind": "bernoulli", "p": 0.15},
        {"kind": "gilbert_elliott", "share": 0.3, "burst": 3.0, "loss_good": 0.05, "loss_bad": 0.9},
        {"kind": "gilbert_elliott", "share": 0.3, "burst": 0.05, "advance": "time", "common": 0.4},
        {"kind": "by_distance", "near": 0.05, "far": 0.8, "distance": 6.0, "exponent": 1.5},
        {"kind": "correlated", "p": 0.2, "correlation": 0.6},
        {"kind": "four_state", "p13": 0.2, "p31": 0.3, "p32": 0.3, "p23": 0.4, "p14": 0.1},
        {"kind": "common_cause", "p": 0.3, "common": 0.6},
        {"kind": "trace", "table": TIMES.format(0.1, 0.6, 0.3), "between": "linear", "received": True},
        {
            "kind": "signal_trace",
            "table": TIMES.format(-85, -93, -88),
            "threshold": -89.0,
            "width": 2.0,
            "start": "random",
        },
    ],
    "duplicate": [0.0, {"kind": "gilbert_elliott", "share": 0.4, "burst": 2.0}],
    "medium": [
        {"kind": "unlimited"},
        {"kind": "unlimited"},
        {"kind": "unlimited"},
        BITS | {"shared": True, "queue_limit": 2},
        BITS | {"half_duplex": True, "queue_limit": 1},
        BITS | {"access": "aloha", "reception": {"kind": "capture", "threshold": 3.0, "fading": "rice", "lock": True}},
        BITS | {"access": {"kind": "aloha"}, "duty_cycle": 0.2},
        BITS | {"access": {"kind": "slotted_aloha", "slot": 0.012, "p": 0.6}},
        BITS
        | {"access": {"kind": "csma", "backoff": 0.004, "attempts": 3, "sensing_delay": 0.0005, "sensing_range": 5.0}},
        BITS
        | {
            "access": {"kind": "csma", "persistence": "p_persistent", "p": 0.4, "slot": 0.002},
            "reception": {"kind": "sinr", "fading": "nakagami", "m": 2.0, "shadowing": 2.0, "noise": 1e-4},
        },
        BITS
        | {
            "access": {"kind": "csma_ca", "window": 4, "doublings": 2, "retries": 2, "slot": 0.001, "eifs": 0.004},
            "queue_limit": 3,
        },
        BITS
        | {
            "access": {"kind": "csma_ca", "window": 2, "retries": 1, "sensing_range": 4.0, "ack_timeout": 0.001},
            "reception": {"kind": "capture", "fading": "rayleigh", "shadowing": 1.0},
            "duty_cycle": 0.5,
        },
        BITS | {"bitrate": 4e5, "access": {"kind": "tdma", "slot": 0.02, "guard": 0.001, "slots": [0, 2, 1, 0, 3]}},
        {
            "kind": "lora",
            "spreading_factors": [7, 8, 7, 9],
            "bandwidth": 500e3,
            "coding_rate": 3,
            "preamble": 6,
            "access": "aloha",
            "reception": {"kind": "lora", "threshold": 2.0, "isolation": "croce"},
        },
        {"kind": "lora", "spreading_factor": 8, "bandwidth": 500e3, "frequencies": [1, 2, 1, 2], "access": "aloha"},
        {"kind": "lora", "bandwidth": 500e3, "crc": False, "implicit_header": True, "queue_limit": 1},
    ],
    "transport": [
        {"kind": "best_effort"},
        {"kind": "best_effort"} | QUALITY,
        {"kind": "reliable", "timeout": 0.03, "backoff": 1.5, "max_repeats": 2, "window": 2} | QUALITY,
        {"kind": "reliable", "ordered": False, "history": "keep_all", "window": 3, "min_timeout": 0.005},
        {"kind": "reliable", "depth": 2, "window": 1, "max_timeout": 0.1, "lifespan": 0.2},
        {"kind": "coded", "pieces": 4, "needed": 2, "spacing": 0.004, "deadline": 0.03},
    ],
    "processing": [
        {},
        {"sender": 0.004, "receiver": 0.008},
        {"sender": {"kind": "uniform", "high": 0.006}, "receiver": 0.003},
    ],
    "link": [[], [], [{"src": 0, "dst": 3, "latency": 0.05, "loss": 0.5, "order": "fifo"}]],
    "fault": [
        [],
        [{"kind": "crash", "start": 0.05, "end": 0.15, "node": 1, "scope": "robot"}],
        [{"kind": "crash", "start": 0.1, "node": 2}, {"kind": "clock_skew", "offset": 0.05, "drift": 0.04}],
        [{"kind": "partition", "start": 0.05, "end": 0.2, "groups": [[0, 1], [2]]}],
        [{"kind": "jamming", "start": 0.03, "end": 0.2, "centre": [4.0, 4.0], "radius": 3.0}],
        [{"kind": "message_fault", "messages": [2, 5, 6], "delay": 0.07, "duplicate": True}],
        [{"kind": "random_crashes", "rate": 3.0, "mean_downtime": 0.05, "memory": False}],
        [{"kind": "random", "rate": 12.0, "mean_duration": 0.04, "end": 0.25, "box": [0.0, 10.0]}],
        [{"kind": "random_lies", "rate": 8.0, "mean_duration": 0.1}],
        [{"kind": "chaser_crash", "start": 0.08, "end": 0.16}, {"kind": "silent", "start": 0.2, "node": 0}],
        [{"kind": "chaser_cut", "start": 0.08, "end": 0.16}, {"kind": "selective", "start": 0.02, "node": 1}],
        [{"kind": "liar", "start": 0.02, "node": 1, "phi": {"kind": "scaled", "factor": 0.5}}],
        [{"kind": "liar", "start": 0.02, "node": 2, "position": {"kind": "random", "box": [0.0, 10.0]}}],
        [{"kind": "news_fault", "start": 0.02, "changes": 2, "delay": 0.05}],
        [{"kind": "equivocate", "start": 0.02, "node": 1}, {"kind": "replay", "start": 0.05, "node": 3}],
        [{"kind": "spoof", "start": 0.02, "node": 1}, {"kind": "slander", "start": 0.02, "node": 0, "accused": [2]}],
    ],
    "clocks": [{}, {"sync": {"kind": "two_way", "interval": 0.05, "exchanges": 2}}],
    "strategy": [
        {"kind": "pure_evasion"},
        {"kind": "weighted_flee", "power": 1.5, "flees_from": "active"},
        {"kind": "max_min", "candidates": 10},
        {"kind": "max_geodesic", "candidates": 8, "look_ahead": 0.5},
        {"kind": "hide", "distance": 0.8},
        {"kind": "zigzag", "period": 0.2, "amplitude": 0.5},
        {"kind": "voronoi_vertex", "arena": [0.0, 10.0], "hysteresis": 0.2},
        {"kind": "diffusion", "sigma": 0.8},
        {"kind": "constant_heading", "angle": 0.7},
        {"kind": "constant_heading"},
        {"kind": "still"},
        {"kind": "recorded", "waypoints": [[0.0, 4.0, 5.0], [0.1, 4.05, 5.05], [0.4, 4.2, 4.9]], "start_time": 0.02},
        {"kind": "listener", "during_handover": {"kind": "still"}, "normally": {"kind": "zigzag"}},
    ],
    "evader": [
        [{"speed": 1.0, "box": [3.0, 7.0]}],
        [
            {"speed": 0.9, "box": [3.0, 7.0], "sensing_range": 3.0, "reaction_delay": 0.04},
            {"speed": 1.4, "box": [2.0, 5.0]},
        ],
        [{"speed": 1.1, "box": [3.0, 7.0], "motion_interval": 0.05, "motion_error": 0.1}],
    ],
    "world": [
        {},
        {"guidance": {"kind": "constant_bearing"}},
        {"sensing": {"estimate": "worst_case", "radius": 5.0, "on_lost": "stay", "track_timeout": 0.1}},
        {"sensing": {"estimate": "worst_case"} | SHORT, "guidance": {"kind": "constant_bearing"}},
        {"dynamics": {"kind": "acceleration", "limit": 2.0}} | SEEN[0],
        {"dynamics": {"kind": "turn_rate", "limit": 1.5}} | SEEN[1],
        {"dynamics": {"kind": "acceleration", "limit": 2.0}, "flow": FLOWING[0]} | SEEN[2],
        {"dynamics": {"kind": "turn_rate", "limit": 1.5}, "flow": FLOWING[2], "guidance": {"kind": "constant_bearing"}},
        *({"flow": flow} | seen for flow, seen in zip(FLOWING, SEEN, strict=True)),
        {"flow": FLOWING[0], "on": "pursuers"},
        {"wall": [PASSABLE]} | SEEN[3],
        {"wall": [{"polygon": BLOCK, "blocks": ["radio", "sight"], "material": "brick"}]} | SEEN[4],
        {"wall": [{"line": [[3.0, 3.0], [7.0, 3.0], [7.0, 6.0]]}]},
        {"wall": [{"polygon": BLOCK, "blocks": ["motion"]}, PASSABLE], "sensing": SHORT},
        *SEEN,
    ],
    "capture": [{"radius": 0.4}, {"radius": 0.9, "test": "sample", "captures_to_end": 1}],
    "motion": [
        {"step": 0.03},
        {"step": 0.05, "order": "simultaneous"},
        {"static": True},
    ],
    "team": [
        {"speeds": [1.0, 1.4, 0.7, 2.2], "active_at_start": 1.0},
        {"speeds": [3.0, 0.5, 1.5, 1.0], "active_at_start": 0.5, "power_exponent": 3.0},
        {"speeds": {"default": 1.2, "last": 2.5}, "active_at_start": 0.0},
    ],
    "prune": ["none", "inf", "infeasible"],
    "protocol": [
        {"kind": "argmin", "slot": 0.03, "hysteresis": 0.1, "by": "intercept_time", "time_constant": 0.1},
        {"kind": "argmin"},
        {"kind": "argmin_known"},
        {"kind": "best_response"},
        {"kind": "better_reply", "alpha": 0.8},
        {"kind": "binary_log_linear"},
        {"kind": "cbaa"},
        {"kind": "cbba", "winner_timeout": 0.1},
        {"kind": "centralised", "slot": 0.04},
        {"kind": "fictitious_play"},
        {"kind": "generalised_regret_matching", "rho": 0.2, "alpha": 0.7},
        {"kind": "jsfp", "alpha": 0.6, "rho": 0.1},
        {"kind": "local_min"},
        {"kind": "policy"},
        {"kind": "regret_matching", "rho": 0.05, "alpha": 0.9},
        {"kind": "sap"},
        {"kind": "selective_sap"},
        {"kind": "server", "host": 1, "period": 0.04, "takeover": True},
        {"kind": "server", "host": 2, "period": 0.05},
        {"kind": "voronoi", "slot": 0.02, "hysteresis": 0.2},
    ],
    "schedule": [
        {"kind": "shared_seed", "slot": 0.02},
        {"kind": "poisson", "rate": 12.0},
        {"kind": "rounds", "period": 0.05, "participation": 0.7},
        {"kind": "periodic", "period": 0.05, "jitter": 0.3},
        {"kind": "token_ring", "holding_time": 0.01, "attempts": 2},
        {"kind": "token_walk", "holding_time": 0.01, "attempts": 3},
        {"kind": "local_mutex", "rate": 12.0, "attempts": 3, "min_timeout": 0.01},
        {"kind": "synchronous", "schedule": {"kind": "shared_seed", "slot": 0.03}},
    ],
    "utility": [
        {"kind": "mean"},
        {"kind": "minimum"},
        {"kind": "local_mean"},
        {"kind": "component"},
        {"kind": "edge_penalty", "factor": 1.3},
    ],
    "tau": [
        {"kind": "paper", "scale": 4.0},
        {"kind": "constant", "value": 2.0},
        {"kind": "logarithmic", "scale": 2.0, "offset": 3.0},
        {"kind": "geometric", "first": 3.0, "ratio": 0.8, "floor": 0.1},
        {"kind": "adaptive", "cooling": {"kind": "geometric", "first": 3.0, "ratio": 0.7}, "reheat_on": ["silence"]},
    ],
    "announce": [
        {"payload": "action", "trigger": "change", "start": "known"},
        {"payload": "time", "trigger": "both", "heartbeat": 0.04, "jitter": 0.01, "belief_timeout": 0.06},
        {"payload": "state", "trigger": "heartbeat", "heartbeat": 0.05, "reckoning": "straight_line"},
        {"payload": "course", "trigger": "revision", "belief_timeout": inf},
        {"payload": "course", "trigger": "both", "heartbeat": 0.06, "reckoning": "straight_line"},
    ],
    "dissemination": [
        {"kind": "one_hop"},
        {"kind": "flooding", "hops": 2, "jitter": 0.003},
        {"kind": "gossip"},
        {"kind": "reliable", "timeout": 0.03, "max_repeats": 2},
        {"kind": "coded", "pieces": 3, "needed": 2, "spacing": 0.003},
    ],
    "trust": [
        {"kind": "none"},
        {"kind": "trimmed", "liars": 1},
        {"kind": "plausible", "radius": 6.0},
        {"kind": "accusations", "quorum": 1, "interval": 0.05},
        {"kind": "reputation", "threshold": 0.7, "decay_time": 0.2},
    ],
}
"""The variants of each family: at least one of each kind."""
FAMILIES_OF_KINDS = (
    *(ACCESSES, DISSEMINATIONS, DYNAMICS, ESTIMATORS, FLOWS, GRAPHS, INTERFERENCES, LATENCIES, LOSSES, MEDIA, NOISES),
    *(PROTOCOLS, PURSUER_FAULTS, RECEPTION_MODELS, SCHEDULES, STRATEGIES, TEMPERATURES, TRANSPORTS, TRUSTS, UTILITIES),
)


IMPLIED = {"ideal", "simple", "collision", "best_effort"}
"""The kinds of models that no table names."""


@cache
def variants(row):
    """Return a variant of each family: each occurs once in as many rows as it has, in an order of its own each time."""
    chosen = {}
    for family, of in FAMILIES.items():
        turn, place = divmod(row, len(of))
        order = sorted(of, key=lambda variant, key=f"{turn} {family}": sha256(f"{key} {variant}".encode()).digest())
        chosen[family] = order[place]
    return chosen


def tables(row):
    """Return the tables of the scenario of a row."""
    chosen = variants(row)
    network = ("graph", "range", "range_check", "latency", "order", "loss", "duplicate", "medium", "transport")
    parts = {"schedule": chosen["schedule"], "utility": chosen["utility"], "tau": chosen["tau"]}
    has = PROTOCOLS.choices()[chosen["protocol"]["kind"]].model_fields
    links = {name: chosen[name] for name in (*network, "processing")} | chosen["propagation"]
    if chosen["graph"]["kind"] == "complete":
        links["link"] = chosen["link"]
    world = chosen["world"]
    body = {name: world[name] for name in ("guidance", "dynamics") if name in world}
    return {
        "seed": row,
        "horizon": HORIZON,
        "prune": chosen["prune"],
        "team": {"count": 4, "box": [0.0, 10.0]} | chosen["team"] | body,
        "evader": [table | {"strategy": chosen["strategy"]} for table in chosen["evader"]],
        "sensing": {"interval": 0.04} | world.get("sensing", {}),
        "capture": chosen["capture"],
        "motion": chosen["motion"],
        "environment": {"flow": world.get("flow", "none"), "on": world.get("on", "all")},
        "wall": world.get("wall", []),
        "protocol": chosen["protocol"] | {name: part for name, part in parts.items() if name in has},
        "announce": chosen["announce"] | {"dissemination": chosen["dissemination"], "trust": chosen["trust"]},
        "network": links,
        "clocks": chosen["clocks"],
        "fault": chosen["fault"],
        "record": {"trajectory": 0.1, "messages": True},
    }


def played(row):
    """Return the result of the run of a row; the reason as text if there is none."""
    try:
        scenario = Scenario(**tables(row))
    except ValueError as error:
        return str(error)
    return run(scenario)


def lines(result):
    """Return the trace of a result, a line each event."""
    return list(map(line_of, result.trace))


def shown(row):
    """Return the kinds of a row, the counts of its events, its metrics, and the digest of its trace, as text."""
    result = played(row)
    if isinstance(result, str):
        return result
    names = [variant["kind"] for variant in variants(row).values() if isinstance(variant, dict) and "kind" in variant]
    trace = lines(result)
    counts = Counter(json.loads(line)["event"] for line in trace)
    events = " ".join(f"{name} {counts[name]}" for name in sorted(counts))
    metrics = [f"{name} {number(value)}" for name, value in plain(summary(result)).items() if value not in (None, 0)]
    digest = sha256("".join(trace).encode()).hexdigest()[:16]
    return "\n".join([" ".join(names), events, ", ".join(metrics), digest])


def number(value):
    """Return a number with six digits, and any other value, as text."""
    return f"{value:.6g}" if isinstance(value, float) else json.dumps(value)


@cache
def kinds():
    """Return the kinds that occur in all rows."""
    return set().union(*(kinds_in(tables(row)) for row in range(BLOCKS * SIZE)))


def kinds_in(value):
    """Return the kinds that occur in tables."""
    if isinstance(value, dict):
        return {value.get("kind")}.union(*map(kinds_in, value.values()))
    return (
        set().union(*map(kinds_in, value))
        if isinstance(value, (list, tuple))
        else {value}
        if isinstance(value, str)
        else set()
    )


@pytest.mark.parametrize("family", FAMILIES_OF_KINDS, ids=lambda family: next(iter(family.choices())))
def test_every_kind_occurs(family):
    assert family.choices().keys() - IMPLIED <= kinds()


@pytest.mark.parametrize("block", range(BLOCKS))
def test_short_runs_are_golden(block):
    golden(f"traces/{block}.txt", {str(row): shown(row) for row in range(SIZE * block, SIZE * (block + 1))})


if __name__ == "__main__":
    print("".join(lines(played(int(sys.argv[1])))), end="")
