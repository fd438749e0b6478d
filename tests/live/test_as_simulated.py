"""Live nodes and their referee on one clock, on which nothing is late, decide exactly as their simulation."""

import json
from math import inf
from random import Random

import pytest

from desim import Scenario, run
from desim.kernel.core.clock import Clock
from desim.kernel.core.events import Trace
from desim.kernel.fault_injection import inject
from desim.live.frames import WorldFrame, frame_of
from desim.live.node import Node
from desim.pursuit.core.events import Captured, Decided
from desim.pursuit.sensing.views import View
from desim.simulation.run_end import RunEnd
from desim.simulation.team_processes import TeamProcesses
from desim.simulation.wiring import make_network
from desim.simulation.world import World, initial_state

SEEDS = sorted({*range(60)} - {2, 7, 9, 18, 19, 24, 37, 41, 51, 52, 55})
"""Those below 60 whose scenario is valid, and can run live."""
SHORT = 14
"""One whose comparison takes little time."""


class Punctual:
    """A live run without processes, sockets and lateness; the world is that of a referee."""

    def __init__(self, scenario, seed, monkeypatch):
        self.env, self.trace = Clock(), Trace()
        self.end, self.sent, self.orders = RunEnd(self.env), [], []
        self.state = state = initial_state(self.env, scenario, seed)
        self.world = World(self.env, scenario, state, [View(state, scenario.prune)] * state.size, self.trace, self.end)
        network, _, faults = make_network(self.env, scenario, state, seed, None)
        team = TeamProcesses(self.env, scenario, self.world, {}, [], None, None)
        inject(faults, self.env, network, self.trace, crashed=team.crashed, recovered=team.recovered)
        self.world.begin()
        sent = self.sent
        monkeypatch.setattr(Node, "_post", lambda node, datagram, to: sent.append((node.pursuer, datagram, [*to])))
        self.nodes = [
            Node(scenario, k, seed, on_action=lambda action, k=k: self.orders.append((k, action)))
            for k in range(state.size)
        ]
        self.obeyed = [0] * state.size

    def play(self):
        """Perform all events in the order of their times, those of the world first, and return its events."""
        self.show()
        while not self.end.over.processed:
            now = min(self.env.peek(), *(node._env.peek() for node in self.nodes))
            is_of_world = self.env.peek() == now
            self.env.advance(int(now), self.end.over)
            if is_of_world:
                for node in self.nodes:
                    if node._env.peek() > now:
                        node._env.advance(int(now), node._over)
                self.show()
            for node in self.nodes if not self.end.over.processed else ():
                node._env.advance(int(now), node._over)
                self.carry(int(now))
        return list(self.trace)

    def show(self):
        """Show all nodes the world as it is now."""
        frame = WorldFrame(*json.loads(json.dumps(frame_of(self.state, self.obeyed))))
        for node in self.nodes:
            node.follow(frame)

    def carry(self, now):
        """Obey all orders and deliver all datagrams of an instant."""
        while self.orders or self.sent:
            for pursuer, action in self.orders:
                self.obeyed[pursuer] += 1
                self.world.set_action(pursuer, action)
            self.orders.clear()
            self.show()
            datagrams = self.sent.copy()
            self.sent.clear()
            for src, datagram, receivers in datagrams:
                for dst in receivers:
                    self.nodes[dst]._env.advance(now, self.nodes[dst]._over)
                    self.nodes[dst].link.receive(datagram, src, now)


def any_scenario(seed):
    """Return a random scenario without random losses, in which nothing but decisions coincides."""
    rng = Random(seed)
    size = rng.randint(2, 5)
    kind = rng.choice(["local_min", "best_response", "jsfp", "sap", "policy", "cbba", "cbaa", "server"])
    schedule = rng.choice(["token_ring", "token_walk", "local_mutex", "poisson", "rounds"])
    parameters = {"poisson": {"rate": 5.0}, "rounds": {"period": 0.2137}}.get(schedule, {})
    has_schedule = kind not in {"cbba", "cbaa", "server"}
    changes = {
        "team": {"count": size, "speeds": rng.choice([2.0, 3.0]), "active_at_start": rng.choice([0.0, 0.5, 1.0])},
        "horizon": rng.choice([3.0, 6.0]),
        "network": {"latency": rng.choice([0.013, 0.0531, 0.1237, 0.4111]), "range": rng.choice([inf, inf, 9.0])},
        "announce": {
            "payload": rng.choice(["action", "state", "time", "course"]),
            "start": rng.choice(["known", "silent"]),
            "trigger": rng.choice(["change", "both", "revision"]),
            "reckoning": rng.choice(["exact", "straight_line"]),
            "dissemination": {"kind": rng.choice(["one_hop", "one_hop", "flooding", "reliable", "gossip"])},
        },
        "protocol": {"kind": kind} | ({"schedule": {"kind": schedule} | parameters} if has_schedule else {}),
        "evader": [{"speed": 1.0} for _ in range(rng.choice([1, 1, 2]))],
        "clocks": {"sync": rng.choice([{"kind": "none"}, {"kind": "two_way", "interval": 0.07, "exchanges": 3}])},
    }
    if changes["announce"]["dissemination"]["kind"] == "reliable":  # is refused with corrected clocks
        changes["clocks"] = {}
    faults = [
        {"kind": "crash", "start": 0.5011, "end": 1.2013, "node": rng.randrange(size)},
        {"kind": "crash", "start": 0.4017, "end": 0.9019, "node": rng.randrange(size), "memory": False},
        {"kind": "partition", "start": 0.2003, "end": 1.0007, "groups": [[0], [*range(1, size)]]},
        {"kind": "clock_skew", "offset": 0.05, "drift": 1e-3},
    ]
    changes["fault"] = [fault for fault in faults if rng.random() < 0.3]
    world = rng.choice(
        [
            {},
            {"team.dynamics": {"kind": "acceleration", "limit": 3.0}},
            {"environment": {"flow": {"kind": "uniform", "velocity": [0.3, 0.2]}}},
            {"wall": [{"line": [[8.0, -9.0], [8.0, 14.0]], "blocks": ["motion"]}]},
        ]
    )
    return Scenario().with_(changes).with_(world)


def events_of(trace):
    """Return the decisions and captures in order; those of one instant have none."""
    return sorted(
        (event.t, type(event).__name__, *event[1:]) for event in trace if isinstance(event, Decided | Captured)
    )


@pytest.mark.slow
@pytest.mark.whole_but_one
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("seed", sorted(SEEDS, key=lambda seed: seed != SHORT))
def test_nodes_that_are_never_late_decide_as_in_a_simulation(seed, monkeypatch):
    scenario = any_scenario(seed)
    live, simulated = Punctual(scenario, seed, monkeypatch).play(), run(scenario, seed).trace
    assert events_of(live) == events_of(simulated)


@pytest.mark.slow
def test_the_comparison_detects_links_that_are_late(monkeypatch):
    scenario = Scenario().with_({"team.count": 4, "team.speeds": 2.0, "horizon": 3.0, "network.latency": 0.1})
    simulated = events_of(run(scenario, 3).trace)
    assert events_of(Punctual(scenario, 3, monkeypatch).play()) == simulated
    late = scenario.with_({"network.latency": 0.2})
    assert events_of(Punctual(late, 3, monkeypatch).play()) != simulated
