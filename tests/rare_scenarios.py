"""Scenarios of the parts of desim that no scenario file reaches within a second, for digests of runs.

Each has many imperfections at once: a digest says only that a run has changed, and `tests/test_traces.py` has the
combinations in which one can look for the cause.
"""

from desim import Scenario

RARE = {
    # Ranges that are checked within the motion steps of players with inertia, a floor, crashes of chasers.
    "curves": Scenario(
        horizon=1.0,
        record={"messages": True},
        team={
            "count": 8,
            "box": [0.0, 10.0],
            "speeds": 3.0,
            "dynamics": {"kind": "turn_rate", "limit": 2.5},
            "guidance": {"kind": "constant_bearing"},
            "active_at_start": 1.0,
        },
        evader=[
            {
                "speed": 2.0,
                "box": [0.0, 10.0],
                "dynamics": {"kind": "acceleration", "limit": 4.0},
                "strategy": "max_min",
            },
            {"speed": 1.0, "box": [0.0, 10.0], "strategy": {"kind": "listener", "during_handover": "still"}},
        ],
        motion={"step": 0.3},
        capture={"radius": 0.4, "test": "sample"},
        sensing={
            "radius": 6.0,
            "interval": 0.05,
            "noise": {"kind": "position", "deviation": 0.3},
            "estimator": {"kind": "alpha_beta"},
            "relay": True,
        },
        protocol={
            "kind": "regret_matching",
            "schedule": {"kind": "local_mutex", "rate": 12.0, "attempts": 3, "min_timeout": 0.01},
            "utility": "component",
        },
        announce={
            "payload": "course",
            "trigger": "both",
            "heartbeat": 0.1,
            "jitter": 0.01,
            "dissemination": {"kind": "reliable", "timeout": 0.03, "max_repeats": 2},
        },
        network={
            "range": 5.0,
            "range_check": "both",
            "latency": {"kind": "uniform", "low": 0.002, "high": 0.04},
            "reception": {"kind": "quasi_unit_disk", "certain": 0.4},
            "fading": "message",
        },
        fault=[
            {"kind": "chaser_crash", "start": 0.3, "end": 0.6},
            {"kind": "jamming", "start": 0.5, "end": 0.8, "centre": [4.0, 4.0], "radius": 3.0},
        ],
    ),
    # A flow, fused tracks, contention with interference, clocks that are set, and lies that are accused.
    "currents": Scenario(
        horizon=1.0,
        record={"messages": True},
        team={
            "count": 5,
            "box": [0.0, 10.0],
            "speeds": [1.0, 1.4, 0.7, 2.2, 3.0],
            "guidance": {"kind": "constant_bearing"},
            "active_at_start": 1.0,
        },
        evader={"speed": 1.4, "box": [2.0, 8.0], "strategy": "zigzag", "sensing_range": 3.0, "reaction_delay": 0.04},
        environment={"flow": {"kind": "gyre", "speed": 0.5, "size": 3.0, "shift": 1.0, "period": 2.0}},
        motion={"step": 0.1, "order": "simultaneous"},
        sensing={
            "noise": {"kind": "range_bearing", "bearing": 0.1},
            "estimator": "kalman",
            "radius": 5.0,
            "relay": True,
            "fusion": "covariance_intersection",
            "interval": 0.05,
        },
        protocol={
            "kind": "fictitious_play",
            "schedule": {"kind": "periodic", "period": 0.05, "jitter": 0.3},
            "utility": "edge_penalty",
        },
        announce={
            "payload": "state",
            "trigger": "heartbeat",
            "heartbeat": 0.05,
            "reckoning": "straight_line",
            "dissemination": "coded",
            "trust": {"kind": "accusations", "quorum": 1, "interval": 0.05},
        },
        network={
            "range": 6.0,
            "range_check": "delivery",
            "medium": {
                "kind": "bitrate",
                "bitrate": 4e5,
                "header": 3,
                "access": {
                    "kind": "csma_ca",
                    "window": 4,
                    "doublings": 2,
                    "retries": 2,
                    "slot": 0.001,
                    "ack_timeout": 0.001,
                    "sensing_range": 5.0,
                },
                "reception": {"kind": "sinr", "fading": "nakagami", "m": 2.0, "shadowing": 2.0, "noise": 1e-4},
                "queue_limit": 3,
            },
            "loss": {"kind": "correlated", "p": 0.2, "correlation": 0.6},
            "duplicate": 0.1,
        },
        clocks={"sync": {"kind": "two_way", "interval": 0.05, "exchanges": 2}},
        fault=[
            {"kind": "clock_skew", "offset": 0.05, "drift": 0.04},
            {"kind": "slander", "start": 0.02, "node": 0, "accused": [2]},
            {"kind": "equivocate", "start": 0.2, "node": 1},
            {"kind": "replay", "start": 0.3, "node": 3},
        ],
    ),
    # Crashes without memory, lies and failures that are drawn, links with their own models, TDMA.
    "crashes": Scenario(
        horizon=1.0,
        record={"messages": True},
        team={"count": 6, "box": [0.0, 10.0], "speeds": 1.5},
        evader={"speed": 1.0, "box": [3.0, 7.0], "strategy": {"kind": "diffusion", "sigma": 0.8}},
        protocol="cbaa",
        announce={
            "payload": "time",
            "trigger": "both",
            "heartbeat": 0.04,
            "belief_timeout": 0.06,
            "dissemination": "gossip",
            "trust": "reputation",
        },
        network={
            "graph": {
                "kind": "edges",
                "directed": True,
                "edges": [{"src": k, "dst": (k + 1) % 6, "latency": 0.01 * k} for k in range(6)]
                + [{"src": 0, "dst": 2, "loss": 0.4, "order": "fifo"}],
            },
            "latency": {
                "kind": "per_pair",
                "base": {"kind": "gamma", "scale": 0.005},
                "jitter": {"kind": "uniform", "high": 0.01},
                "symmetric": False,
            },
            "loss": {"kind": "gilbert_elliott", "share": 0.3, "burst": 0.05, "advance": "time", "common": 0.4},
            "transport": {
                "kind": "reliable",
                "ordered": False,
                "history": "keep_all",
                "window": 3,
                "min_timeout": 0.005,
                "deadline": 0.04,
                "lifespan": 0.2,
            },
            "medium": {
                "kind": "bitrate",
                "bitrate": 4e5,
                "header": 3,
                "access": {"kind": "tdma", "slot": 0.02, "guard": 0.001},
            },
            "processing": {"sender": {"kind": "uniform", "high": 0.006}, "receiver": 0.003},
        },
        fault=[
            {"kind": "random_crashes", "rate": 3.0, "mean_downtime": 0.05, "memory": False},
            {"kind": "random", "rate": 12.0, "mean_duration": 0.04, "end": 0.25, "box": [0.0, 10.0]},
            {"kind": "random_lies", "rate": 8.0, "mean_duration": 0.1},
            {"kind": "news_fault", "start": 0.02, "changes": 2, "delay": 0.05},
        ],
    ),
    # Tokens by LoRa with correlated fading, among walls.
    "tokens": Scenario(
        horizon=1.0,
        record={"messages": True},
        team={"count": 6, "box": [0.0, 10.0], "speeds": 1.5},
        evader={"speed": 1.0, "box": [3.0, 7.0], "strategy": {"kind": "hide", "distance": 0.8}},
        wall=[{"polygon": [[6.0, 1.0], [7.0, 1.0], [7.0, 9.0], [6.0, 9.0]], "blocks": ["motion"]}],
        protocol={
            "kind": "binary_log_linear",
            "tau": "logarithmic",
            "schedule": {"kind": "token_walk", "holding_time": 0.01, "attempts": 3},
        },
        network={
            "range": 6.0,
            "fading": "correlated",
            "reception": {"kind": "rice", "k": 5.0, "exponent": 2.4},
            "coherence": {"doppler": 3.0, "frequency": 9e8, "decorrelation": 2.0, "shared": 0.4, "waves": 12},
            "medium": {
                "kind": "lora",
                "bandwidth": 500e3,
                "spreading_factors": [7, 8, 7, 9, 7, 7],
                "access": "aloha",
                "reception": {"kind": "lora", "threshold": 2.0, "isolation": "croce"},
            },
            "transport": {"kind": "coded", "pieces": 4, "needed": 2, "spacing": 0.004, "deadline": 0.03},
        },
        fault=[
            {"kind": "crash", "start": 0.2, "end": 0.5, "node": 1},
            {"kind": "chaser_cut", "start": 0.3, "end": 0.7},
        ],
    ),
    # Slotted ALOHA with capture, common causes of losses, liars, and an evader that errs.
    "slots": Scenario(
        horizon=1.0,
        record={"messages": True},
        team={"count": 4, "box": [0.0, 10.0], "speeds": {"default": 1.2, "last": 2.5}},
        evader={
            "speed": 1.1,
            "box": [3.0, 7.0],
            "motion_interval": 0.05,
            "motion_error": 0.1,
            "strategy": {"kind": "voronoi_vertex", "arena": [0.0, 10.0], "hysteresis": 0.2},
        },
        capture={"radius": 0.05},
        motion={"step": 0.05, "order": "simultaneous"},
        protocol={
            "kind": "better_reply",
            "alpha": 0.8,
            "schedule": {"kind": "rounds", "period": 0.05, "participation": 0.7},
        },
        announce={
            "dissemination": {"kind": "flooding", "hops": 2, "jitter": 0.003},
            "trigger": "both",
            "heartbeat": 0.1,
            "trust": {"kind": "plausible", "radius": 6.0},
        },
        network={
            "medium": {
                "kind": "bitrate",
                "bitrate": 4e5,
                "header": 3,
                "access": {"kind": "slotted_aloha", "slot": 0.012, "p": 0.6},
                "reception": {"kind": "capture", "threshold": 3.0, "fading": "rice", "lock": True},
            },
            "latency": {
                "kind": "matrix",
                "values": [[0, 10, 20, 30], [12, 0, 5, 7], [8, 6, 0, 44], [3, 9, 27, 0]],
                "unit": "ms",
                "rtt": True,
                "jitter": {"kind": "uniform", "high": 0.004},
            },
            "loss": {"kind": "common_cause", "p": 0.3, "common": 0.6},
        },
        fault=[
            {"kind": "spoof", "start": 0.02, "node": 1},
            {"kind": "liar", "start": 0.2, "node": 2, "position": {"kind": "random", "box": [0.0, 10.0]}},
            {"kind": "selective", "start": 0.02, "node": 1},
        ],
    ),
}
"""By name."""
