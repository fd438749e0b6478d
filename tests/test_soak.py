"""Soak: random faults x protocols x networks x evaders x sight, under the eyes of all watchers of invariants.

Some plans every time; a thousand with --hypothesis-profile=explore, as many as one likes with SOAK=5000 pytest.
"""

import os

import numpy as np
import pytest
from hypothesis import settings

from desim import Scenario, summary
from desim.kernel.core.units import SECOND
from desim.kernel.models.graphs import GRAPHS
from desim.kernel.models.latency_by_link import LATENCIES
from desim.kernel.models.loss import LOSSES
from desim.kernel.models.medium import MEDIA
from desim.kernel.models.reception import RECEPTION_MODELS
from desim.kernel.models.transport import TRANSPORTS
from desim.pursuit.core.events import Decided, Ended
from desim.pursuit.evaders.evasion import STRATEGIES
from desim.pursuit.game.utility import UTILITIES
from desim.pursuit.sensing.noise import NOISES
from desim.pursuit.sensing.world_state import WorldState
from desim.pursuit.team.announcements import DISSEMINATIONS, STARTS
from desim.pursuit.team.trust import TRUSTS
from desim.scenario.scenario import PROTOCOLS
from desim.testing.messages import Conservation, OneToken
from desim.testing.pursuits import PotentialWatcher, watched
from protocols.rule import SCHEDULES
from protocols.schedules.token_messages import Token
from protocols.temperature import TEMPERATURES

PLANS = int(os.environ.get("SOAK", "16" if settings.default.derandomize else "1000"))
BLOCK = 8
KINDS = PROTOCOLS.choices()
NEEDED = {
    "bitrate": {"bitrate": 5e4},
    "empirical": {"values": [0.01, 0.02, 0.5]},
    "max_min": {"candidates": 12},
    "voronoi_vertex": {"arena": [0.0, 10.0]},
    "trace": {"table": "t,value\n0,0.01\n0.3,0.2\n0.4,\n0.6,0.05", "between": "linear", "start": "random"},
    "signal_trace": {"table": "t,value\n0,-80\n0.3,-91\n0.4,\n0.6,-89", "width": 1.0},
    "recorded": {"waypoints": [[0.3, 5.0, 5.0]]},
    "edges": {"edges": [{"src": 0, "dst": 1}, {"src": 1, "dst": 0}, {"src": 1, "dst": 2}], "directed": True},
}
"""What a kind cannot do without, or would be slow with."""


class Dice:
    """Draws that follow from a seed and a name."""

    def __init__(self, seed, name):
        self._rng = np.random.default_rng([seed, *name.encode()])

    def one(self, choices):
        return choices[self._rng.integers(len(choices))]

    def kind(self, family, but=()):
        """Return the table of one of the kinds of a family of models, the same for all that it may leave to default."""
        name = self.one([each for each in family.choices() if each not in {*but, "matrix"}])  # has one size
        return {"kind": name} | NEEDED.get(name, {})

    def number(self, low, high):
        return float(self._rng.uniform(low, high))

    def count(self, low, high):
        return int(self._rng.integers(low, high + 1))

    def chance(self, p):
        return bool(self._rng.random() < p)


def protocol(dice, kinds=KINDS, **parts):
    """Return the table of a protocol with parts at random, but for those given, as far as it has such parts."""
    kind = dice.one(list(kinds))
    drawn = {
        "schedule": dice.kind(SCHEDULES),
        "utility": dice.kind(UTILITIES),
        "tau": dice.one([dice.kind(TEMPERATURES), {"kind": "constant", "value": 5.0}]),
    }
    has = KINDS[kind].model_fields
    return {"kind": kind} | {name: each for name, each in (drawn | parts).items() if name in has}


def teams(dice, size):
    """Return a team; in some, a pursuer only relays messages, on its way across the others."""
    motion = {"kind": "recorded", "waypoints": [[0.0, 0.0, dice.number(0.0, 10.0)], [dice.number(0.5, 4.0), 10.0, 5.0]]}
    return {
        "relay": [{"pursuer": size // 2, "motion": motion}] if size > 1 and dice.chance(0.25) else [],
        "count": size,
        "box": (0.0, 10.0),
        "speeds": [dice.number(0.5, 3.0) for _ in range(size)],
        "active_at_start": dice.one([0.0, 0.5, 1.0]),
        "guidance": {"kind": dice.one(["pure_pursuit", "constant_bearing"])},
    }


def evaders(dice, **changes):
    """Return one to three evaders of all sorts."""
    return [
        {
            "box": (2.0, 8.0),
            "speed": dice.number(0.0, 2.0),
            "strategy": dice.kind(STRATEGIES),
            "sensing_range": dice.one([np.inf, 4.0]),
            "reaction_delay": dice.one([0.0, 0.07]),
        }
        | changes
        for _ in range(dice.count(1, 3))
    ]


def faults(dice, size, until):
    """Return a random plan of faults that are over at a time (s), and perhaps clocks that are wrong."""
    plan = {"kind": "random", "rate": dice.number(0.5, 8.0), "mean_duration": dice.number(0.05, 1.0), "end": until}
    skew = {"kind": "clock_skew", "offset": dice.number(0.0, 0.3), "drift": dice.number(0.0, 0.1)}
    crashes = {"kind": "random_crashes", "rate": 0.5, "mean_downtime": 0.3, "memory": dice.chance(0.5)}
    for_ever = {"kind": "crash", "start": 0.4, "node": 0, "scope": dice.one(["radio", "robot"])}
    partition = {"kind": "partition", "start": 0.3, "end": 0.8, "groups": [[0], [size - 1]] if size > 1 else [[0]]}
    jamming = {"kind": "jamming", "start": 0.5, "end": until, "centre": [5.0, 5.0], "radius": dice.number(1.0, 5.0)}
    more = [crashes, for_ever] if until == np.inf else []
    lies = {"kind": "random_lies", "rate": dice.number(0.5, 4.0), "mean_duration": 0.5, "end": until}
    return [
        plan | {"box": (0.0, 10.0)},
        *(each for each in [*more, skew, partition, jamming, lies] if dice.chance(0.3)),
    ]


def sight(dice):
    """Return the errors of the eyes, in most cases none, and what is made of them."""
    noise = {"noise": dice.kind(NOISES, but=("none",)), "interval": dice.one([0.05, 0.2])}
    tracks = {"estimator": "kalman", "fusion": dice.one(["by_stamp", "naive", "covariance_intersection"])}
    return dice.one([{}, {}, noise | {"estimator": "alpha_beta"}, noise | tracks, noise | {"estimate": "hold"}])


FLOWS = (
    {"kind": "uniform", "velocity": [0.4, -0.3]},
    {"kind": "harmonic", "velocity": [0.1, 0.0], "amplitude": [0.5, 0.2], "period": 0.7},
    {"kind": "recorded", "velocities": [[0.2, 0.0, 0.0], [0.9, 0.5, 0.5]]},
    {"kind": "affine", "expansion": -0.2, "rotation": 0.5, "centre": [5.0, 5.0]},
    {"kind": "gyre", "speed": 0.5, "size": 3.0, "shift": 1.0, "period": 2.0},
)


def bodies(dice, scenario):
    """Return a scenario, in some cases with inertia, or with a flow that its models allow for."""
    dynamics = {"kind": dice.one(["acceleration", "turn_rate"]), "limit": dice.number(0.3, 5.0)}
    has_inertia, on = dice.chance(0.3), dice.one(["all", "pursuers"])
    if has_inertia and scenario["sensing"]["estimate"] == "worst_case":
        scenario = scenario | {"sensing": scenario["sensing"] | {"estimate": "hold"}}
    if has_inertia:
        scenario = scenario | {"team": scenario["team"] | {"dynamics": dynamics}}
    if dice.chance(0.3):
        slow = [each for each in scenario["evader"] if each["strategy"]["kind"] != "recorded"]
        slow[:1] = [each | {"dynamics": dynamics} for each in slow[:1]]
        scenario = scenario | {"evader": slow or scenario["evader"]}
    allowed = {(False, "all"), (False, "pursuers"), (True, "all")}
    if scenario["sensing"]["estimate"] == "worst_case":
        allowed = set()
    if dice.chance(0.3) and (has_inertia, on) in allowed:
        flow = dice.one(FLOWS[:3] if has_inertia else FLOWS)
        scenario = scenario | {"environment": {"flow": flow, "on": on}}
    return scenario


def transport(dice):
    """Return a transport, with all qualities or with none."""
    qualities = {"lifespan": dice.number(0.05, 1.0), "deadline": 0.2, "lease": dice.number(0.1, 0.5)}
    more = {"window": dice.count(1, 4), "ordered": dice.chance(0.5), "max_repeats": dice.one([2.0, np.inf]), "depth": 4}
    found = dice.kind(TRANSPORTS)
    return found | dice.one([{}, qualities]) | (more if found["kind"] == "reliable" else {})


def medium(dice):
    """Return a medium, one on which what is sent may have to wait in all ways that there are."""
    found = dice.kind(MEDIA)
    waits = [{}, {"shared": True}, {"half_duplex": True}, {"queue_limit": dice.number(0.5, 3.0)}]
    return found | (dice.one(waits) if found["kind"] != "unlimited" else {})


def anything(seed):
    """Return a scenario in which anything may be imperfect and break."""
    dice = Dice(seed, "anything")
    size = dice.count(1, 8)
    graph = dice.one([{"kind": "complete"}, dice.kind(GRAPHS, but=() if size == 3 else ("edges",))])
    link = {"src": 0, "dst": size - 1, "latency": dice.kind(LATENCIES), "loss": dice.kind(LOSSES), "order": "fifo"}
    drawn = {
        "seed": seed,
        "horizon": dice.number(1.0, 3.0),
        "prune": dice.one(["none", "inf", "infeasible"]),
        "team": teams(dice, size),
        "evader": evaders(dice),
        "sensing": {
            "radius": dice.one([np.inf, np.inf, 3.0, 6.0]),
            "estimate": dice.one(["hold", "constant_velocity", "worst_case"]),
            "relay": dice.chance(0.5),
            "track_timeout": dice.one([0.2, 5.0]),
            "on_lost": dice.one(["stay", "search"]),
        }
        | sight(dice),
        "capture": {
            "radius": dice.number(0.05, 0.5),
            "test": dice.one(["segment", "sample"]),
            "captures_to_end": dice.one([None, 1]),
        },
        "motion": {
            "step": dice.one([0.01, 0.037, 0.1]),
            "order": dice.one(["evader_first", "simultaneous"]),
            "static": dice.chance(0.1),
        },
        "protocol": protocol(dice),
        "announce": {
            "payload": dice.one(["action", "time", "state", "course"]),
            "reckoning": dice.one(["exact", "straight_line"]),
            "trigger": dice.one(["change", "heartbeat", "both", "revision", "never"]),
            "heartbeat": dice.one([0.1, 0.3]),
            "belief_timeout": dice.one(["auto", 0.5, np.inf]),
            "start": dice.one(list(STARTS)),
            "dissemination": dice.kind(DISSEMINATIONS),
            "trust": dice.one(["none", dice.kind(TRUSTS)]),
        },
        "network": {
            "graph": graph,
            "link": [link] if graph["kind"] == "complete" and size > 1 and dice.chance(0.3) else [],
            "processing": dice.one([{}, {"sender": 0.01, "receiver": 0.02}]),
            "range": dice.one([np.inf, 4.0]),
            "reception": dice.kind(RECEPTION_MODELS),
            "fading": dice.one(["per_link", "message"]),
            "range_check": dice.one(["send", "delivery", "both"]),
            "latency": dice.kind(LATENCIES),
            "order": dice.one(["overtaking", "fifo"]),
            "loss": dice.one([dice.kind(LOSSES), {"kind": "bernoulli", "p": 0.3}]),
            "medium": medium(dice),
            "duplicate": dice.one([0.0, 0.3]),
            "transport": transport(dice),
        },
        "clocks": {"sync": dice.one(["none", {"kind": "two_way", "exchanges": 2}])},
        "fault": faults(dice, size, dice.one([1.0, np.inf])),
        "record": {"trajectory": dice.one([0.011, 0.05]), "messages": dice.chance(0.5)},
    }
    if drawn["network"]["reception"]["kind"] in {"disk", "log_distance", "nakagami", "rice"} and dice.chance(0.5):
        coherence = {"doppler": 2.0, "frequency": 1e9, "decorrelation": 2.0, "shared": 0.5, "waves": 16}
        drawn["network"] |= {"fading": "correlated", "coherence": coherence}
    return bodies(dice, drawn)


def calm_at_last(seed):
    """Return a scenario in which nothing breaks any more from 1 s on, nothing is lost, and all are linked."""
    dice = Dice(seed, "calm at last")
    schedule = {"kind": dice.one(["token_ring", "token_walk"]), "holding_time": 0.02}
    learning = [kind for kind, model in KINDS.items() if "schedule" in model.model_fields]
    table = anything(seed)
    size = table["team"]["count"]
    return table | {
        "horizon": 1.0 + 3.0 * detection_time(size),
        "motion": {"static": True},
        "protocol": protocol(dice, learning, schedule=schedule),
        "network": {
            "latency": dice.one([{"kind": "constant"}, {"kind": "uniform", "high": 0.06}, {"kind": "gamma"}]),
            "order": dice.one(["overtaking", "fifo"]),
        },
        "fault": faults(dice, size, 1.0),
    }


def detection_time(size):
    """Return how long it takes at most to miss a token that is held for 0.02 s and takes 0.03 s per hop, s."""
    return 5 * size * 0.05 + 5 * 0.075


def climbing(seed):
    """Return a scenario in which no decision lowers the potential; see `PotentialWatcher`."""
    dice = Dice(seed, "climbing")
    moving = {
        "motion": {"step": dice.one([0.01, 0.05])},
        "announce": {"trigger": dice.one(["change", "both", "revision"])},
        "record": {"trajectory": 0.02},
    }
    frozen = {
        "motion": {"static": True},
        "announce": moving["announce"] | {"payload": dice.one(["action", "time", "state"])},
        "record": {"trajectory": 0.0},
    }
    serial = [{"kind": kind} for kind in SCHEDULES.choices() if kind not in {"rounds", "synchronous"}]
    slots = {"kind": "shared_seed", "slot": 0.02}
    still = dice.chance(0.5)
    return (frozen if still else moving) | {
        "seed": seed,
        "horizon": 2.0,
        "prune": dice.one(["none", "inf", "infeasible"]),
        "team": teams(dice, dice.count(2, 8)),
        "evader": evaders(dice, speed=dice.number(0.0, 1.0)),
        "capture": {"radius": 0.05},
        "protocol": protocol(
            dice,
            ["sap", "binary_log_linear", "selective_sap", "best_response", "better_reply"],
            schedule=dice.one(serial) if still else slots,
            tau={"kind": "constant", "value": 1e-12},
            utility={"kind": dice.one(["mean", "component"])},
        ),
    }


@pytest.fixture
def acted(monkeypatch):
    """How many pursuers of the worlds that are made chase from which instant (ns) on."""
    acts, act = [], WorldState.set_actions

    def noted(self, actions):
        acts.append((self.now, np.count_nonzero(actions)))
        act(self, actions)

    monkeypatch.setattr(WorldState, "set_actions", noted)
    return acts


def judged(table, *watchers, acted):
    """Run a scenario under all watchers, compare its active time with what really happened, and return the result."""
    acted.clear()
    scenario = Scenario.model_validate(table)
    order = [Conservation(fifo=True)] if scenario.network.order == "fifo" else []
    result = watched(scenario, None, OneToken(Token), *order, *watchers)
    times, counts = zip(*acted, strict=True)
    true = np.diff([*times, result.trace.of(Ended)[0].t]) @ counts / SECOND
    assert summary(result).active_time == pytest.approx(true, abs=1e-9)
    return result


def blocks(plans):
    return [range(first, min(first + BLOCK, plans)) for first in range(0, plans, BLOCK)]


def wrong(seeds, judge):
    """Return a description of what is wrong with the run of each seed, if anything is."""
    found = ""
    for seed in seeds:
        try:
            judge(seed)
        except Exception as error:  # all are of interest, in one go
            found += f"seed {seed}: {type(error).__name__}: {error}\n"
    return found


@pytest.mark.slow
@pytest.mark.parametrize("seeds", blocks(PLANS), ids=str)
def test_all_invariants_hold_under_any_faults(seeds, acted):
    assert not wrong(seeds, lambda seed: judged(anything(seed), acted=acted))


@pytest.mark.whole
@pytest.mark.parametrize("seeds", blocks(PLANS // 4), ids=str)
def test_one_token_is_left_when_faults_have_ended(seeds, acted):
    def judge(seed):
        table = calm_at_last(seed)
        size, schedule = table["team"]["count"], table["protocol"]["schedule"]["kind"]
        settled = round((1.0 + 1.5 * detection_time(size)) * SECOND)
        result = judged(table, OneToken(Token, settled=settled), acted=acted)
        visited = {decided.pursuer for decided in result.trace.of(Decided) if decided.t >= settled}
        assert len(visited) == size if schedule == "token_ring" else visited

    assert not wrong(seeds, judge)


@pytest.mark.slow
@pytest.mark.parametrize("seeds", blocks(PLANS // 4), ids=str)
def test_no_decision_of_serial_play_with_full_information_lowers_the_potential(seeds, acted):
    def judge(seed):
        potential = PotentialWatcher(Scenario.model_validate(climbing(seed)))
        judged(climbing(seed), potential, acted=acted)
        assert potential.judged > 0

    assert not wrong(seeds, judge)
