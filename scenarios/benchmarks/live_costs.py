"""What a live run costs: the processor time of a decision, beside that of a simulation and of the sockets alone."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from statistics import median
from typing import Any, NamedTuple

from desim import Result, Scenario, load, run, summary
from desim.analysis.trace_index import messages
from desim.kernel.core.portable_math import portable_sum
from desim.live import LiveResult
from desim.live import run as run_live
from desim.live.lines import Lines
from scenarios.benchmarks.measuring import Cost, apart
from scenarios.benchmarks.peers.bare_sockets import Traffic, bare_sockets
from scenarios.studies.study import SCENARIOS, Options

PURSUERS, RATE, DURATION = 12, 10.0, 5.0
"""Number of pursuers, decisions and heartbeats of each per second, and duration of a run, s."""
PROTOCOLS = ("sap", "cbba")
SIMULATIONS = 5
"""Number of simulations of a lap, which take little time."""


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
    live: float
    sockets: float


def lap(scenario: Scenario, seed: int) -> Lap:
    """Measure a simulation, a live run, and the sockets of the live run, one after the other."""
    begin, decisions = time.process_time(), 0
    for k in range(SIMULATIONS):
        decisions += summary(run(scenario, seed + k)).decisions
    simulated = (time.process_time() - begin) / decisions
    with counted_lines() as lines:
        result = run_live(scenario, seed, tell=lambda _: None)
    made = summary(result).decisions
    sockets = apart(bare_sockets, traffic_of(result, lines))
    return Lap(simulated, portable_sum(result.conduct.cpu.values()) / made, sockets / made)


@contextmanager
def counted_lines() -> Iterator[dict[str, list[int]]]:
    """Count the bytes of the lines that the referee sends and receives."""
    lines: dict[str, list[int]] = {"sent": [], "received": []}
    write, data_received = Lines.write, Lines.data_received

    def counted_write(end: Lines, line: bytes) -> None:
        lines["sent"].append(len(line))
        write(end, line)

    def counted_data(end: Lines, data: bytes) -> None:
        lines["received"].append(len(data))
        data_received(end, data)

    Lines.write, Lines.data_received = counted_write, counted_data  # type: ignore[method-assign]
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
        simulated, total, sockets = (median(times) for times in zip(*laps, strict=True))
        costs += [
            Cost(f"{protocol}: a decision, simulated", simulated * 1e6, "us"),
            Cost(f"{protocol}: a decision, live, all processes", total * 1e6, "us"),
            Cost(f"{protocol}: the same datagrams and lines alone", sockets * 1e6, "us"),
            Cost(f"{protocol}: live / (2 simulated + sockets)", total / (2 * simulated + sockets), "", 1.0),
        ]
    return costs
