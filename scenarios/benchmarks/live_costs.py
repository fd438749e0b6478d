"""The cost of a live run: the processor time of a decision, beside that of a simulation and of the sockets alone."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from heapq import heapify, heapreplace
from statistics import median
from typing import Any, NamedTuple

from desim import Result, Scenario, load, run, summary
from desim.analysis.trace_index import messages
from desim.kernel.core.clock import RARE_COLLECTION
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.units import nanoseconds
from desim.live import LiveResult, Node
from desim.live import run as run_live
from desim.live.frames import frame_of
from desim.live.lines import Lines
from desim.live.referee import FRAME
from scenarios.benchmarks.measuring import Cost, apart
from scenarios.benchmarks.peers.bare_sockets import Traffic, bare_sockets
from scenarios.studies.study import SCENARIOS, Options

PURSUERS, RATE, DURATION = 12, 10.0, 5.0
"""Number of pursuers, decisions and heartbeats of each per second, and duration of a run, s."""
PROTOCOLS = ("local_min", "cbba")
SIMULATIONS = 5
"""Number of simulations in a lap: several, because one takes little time."""


def team(protocol: str) -> Scenario:
    """Return a team that negotiates for the whole run, because it is too slow to capture anything."""
    tables: dict[str, Any] = load(SCENARIOS / "relay.toml").plain()
    tables["team"] |= {"count": PURSUERS, "box": (0.0, 6.0), "speeds": 0.1}
    tables["announce"] |= {"heartbeat": 1.0 / RATE}
    tables["network"] |= {"latency": {"kind": "uniform", "low": 0.04, "high": 0.06}}
    schedule = {"kind": "poisson", "rate": RATE}
    return Scenario.model_validate(tables | {"horizon": DURATION, "protocol": {"kind": protocol, "schedule": schedule}})


class Lap(NamedTuple):
    """The processor times of a decision, s."""

    simulated: float
    nodes: float
    live: float
    sockets: float


def lap(scenario: Scenario, seed: int) -> Lap:
    """Measure a simulation, a live run, and the sockets of the live run, one after the other."""
    begin, simulated_decisions = time.process_time(), 0
    for k in range(SIMULATIONS):
        simulated_decisions += summary(run(scenario, seed + k)).decisions
    simulated = (time.process_time() - begin) / simulated_decisions
    nodes = nodes_alone(scenario, seed)
    with counted_lines() as lines:
        result = run_live(scenario, seed, tell=lambda _: None)
    decisions = summary(result).decisions
    sockets = apart(bare_sockets, traffic_of(result, lines))
    return Lap(simulated, nodes, portable_sum(result.conduct.cpu.values()) / decisions, sockets / decisions)


def nodes_alone(scenario: Scenario, seed: int) -> float:
    """Run all nodes in this process, as fast as it can; return the processor time of a decision, s.

    Nodes pass datagrams by function calls, and get a frame of the world at each multiple of `FRAME`.
    """
    decided: list[int] = []
    nodes = [Node(scenario, pursuer, seed, on_action=decided.append) for pursuer in range(PURSUERS)]
    now = 0

    def post(src: int, datagram: bytes, receivers: list[int]) -> None:
        for node in receivers:
            nodes[node].link.receive(datagram, src, now)

    for pursuer, node in enumerate(nodes):
        node.link._post = partial(post, pursuer)
    with RARE_COLLECTION:
        begin = time.process_time()
        due = [(node._env.peek(), pursuer) for pursuer, node in enumerate(nodes)]
        heapify(due)
        for frame_start in range(0, nanoseconds(DURATION), FRAME):
            frame = frame_of(nodes[0]._state, [node._mirror.orders for node in nodes])
            frame = frame._replace(t=frame_start, profile=[node.action for node in nodes])
            for node in nodes:
                node.follow(frame)
            while due[0][0] < frame_start + FRAME:
                now, pursuer = int(due[0][0]), due[0][1]
                nodes[pursuer]._env.advance(now)
                heapreplace(due, (nodes[pursuer]._env.peek(), pursuer))
        return (time.process_time() - begin) / len(decided)


@contextmanager
def counted_lines() -> Iterator[dict[str, list[int]]]:
    """Count the bytes of the lines that the referee sends and receives."""
    lines: dict[str, list[int]] = {"sent": [], "received": []}
    write, data_received = Lines.write, Lines.data_received

    def counted_write(connection: Lines, line: bytes) -> None:
        lines["sent"].append(len(line))
        write(connection, line)

    def counted_data(connection: Lines, data: bytes) -> None:
        lines["received"].append(len(data))
        data_received(connection, data)

    Lines.write, Lines.data_received = counted_write, counted_data  # type: ignore[assignment,method-assign]
    try:
        yield lines
    finally:
        Lines.write, Lines.data_received = write, data_received  # type: ignore[method-assign]


def traffic_of(result: Result | LiveResult, lines: dict[str, list[int]]) -> Traffic:
    """Return what was sent in a live run."""
    counts = messages(result)
    per_line = {name: portable_sum(sizes) / len(sizes) for name, sizes in lines.items()}
    return Traffic(
        PURSUERS,
        DURATION,
        counts.transmissions / PURSUERS,
        counts.sent / counts.transmissions,
        counts.bytes_sent / counts.transmissions,
        len(lines["received"]) / PURSUERS,
        per_line["received"],
        len(lines["sent"]) / PURSUERS,
        per_line["sent"],
    )


def live(options: Options) -> list[Cost]:
    """Measure the processor time of a decision of all processes of a live run, of a simulation, and of the sockets."""
    costs = []
    for protocol in PROTOCOLS:
        scenario = team(protocol)
        run(scenario)
        laps = [lap(scenario, seed) for seed in range(options.seed, options.seed + options.runs)]
        simulated, nodes, total, sockets = (median(times) for times in zip(*laps, strict=True))
        costs += [
            Cost(f"{protocol}: a decision, simulated", simulated * 1e6, "us"),
            Cost(f"{protocol}: by nodes without sockets", nodes * 1e6, "us"),
            Cost(f"{protocol}: its datagrams and lines, without nodes", sockets * 1e6, "us"),
            Cost(f"{protocol}: live, all processes", total * 1e6, "us"),
            Cost(f"{protocol}: nodes / simulated", nodes / simulated, "", 2.0),
            Cost(f"{protocol}: live / (simulated + sockets)", total / (simulated + sockets), "", 2.0),
        ]
    return costs
