"""Costs of large teams, losses on arrival, runs, recording and start-up, in time and memory; some have a limit.

Peak memory is measured in a separate process.
"""

import os
import time
from collections.abc import Callable, Generator, Mapping
from dataclasses import replace
from functools import partial
from math import pi, sqrt
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any

import networkx as nx
import numpy as np
import simpy
from numpy.typing import NDArray

from desim import Announcements, Evader, Links, Motion, Recording, Result, Scenario, Team, Wall, load, run, summary
from desim.analysis.metrics import end_time
from desim.analysis.trace_index import messages
from desim.config.arrays import Floats
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.positions import PositionSource
from desim.kernel.core.trace_file import TraceFile
from desim.kernel.core.units import SECOND, seconds
from desim.kernel.models.access import CsmaCa
from desim.kernel.models.faults import Crash
from desim.kernel.models.graphs import Complete
from desim.kernel.models.interference import CaptureEffect
from desim.kernel.models.latency import Constant
from desim.kernel.models.loss import Bernoulli, ByDistance, GilbertElliott
from desim.kernel.models.medium import Bitrate
from desim.kernel.models.reception import LogDistance
from desim.kernel.network import Network
from protocols.local_min import LocalMin
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Periodic, SharedSeed
from scenarios.benchmarks.learning_costs import environments
from scenarios.benchmarks.live_costs import live
from scenarios.benchmarks.measuring import Cost, apart, command, memory, per_unit
from scenarios.benchmarks.pages import replays
from scenarios.benchmarks.peers.bare_loop import bare_loop
from scenarios.benchmarks.peers.desim_ways import Publish
from scenarios.benchmarks.peers.simpy_contention import Contention
from scenarios.benchmarks.peers.workloads import LOGNORMAL, TICK, Workload
from scenarios.benchmarks.sweep_costs import large_store, two_workers
from scenarios.studies.study import SCENARIOS, Options
from scenarios.studies.table1_runs import configuration, decentralised

SIZES = (100, 1_000, 10_000, 100_000)
"""Numbers of nodes of the disk graphs; the cost of a message in the largest is compared with that in the second."""
DEGREE = 20
"""Mean number of neighbours on the disk graph."""
DURATION = 2.0
"""Simulated time of a run on a disk graph, s."""
LARGE_TEAM, HORIZON = 1_000, 10.0
"""Number of pursuers on the complete graph, and the simulated time, s."""
SLOT = 0.001
"""Slot delta, s."""
TABLE1_RUNS = 100
STREAMED = (100_000, 10_000_000)
"""Numbers of messages streamed to disk: a small and a large one."""
STARTS = 9
"""Number of times that each command is started."""
MEGABYTE = 1e6
MEASURED = ("relay", "recorded", "reliable")
"""The scenarios for which the time of all metrics of a run is measured, too."""


# Large teams.


class Drifting(PositionSource):
    """A position source: nodes move straight in a square and are reflected at its sides."""

    def __init__(self, env: Clock, size: int, side: float, seed: int):
        rng = np.random.default_rng(seed)
        self._env, self._side = env, side
        self._from, self._velocity = rng.uniform(0.0, side, (size, 2)), rng.uniform(-0.05, 0.05, (size, 2))
        self.max_speed = 0.05 * sqrt(2.0)

    def __call__(self) -> Floats:
        """Return the (n, 2) positions of all nodes, m."""
        return self._reflected(self._from + self._velocity * seconds(self._env.now))

    def of(self, nodes: NDArray[np.intp]) -> Floats:
        """Return the (k, 2) positions of some nodes, m."""
        start, velocity = self._from.take(nodes, axis=0), self._velocity.take(nodes, axis=0)
        return self._reflected(start + velocity * seconds(self._env.now))

    def _reflected(self, unfolded: Floats) -> Floats:
        """Return the positions in the square of nodes that would be at `unfolded` if it had no sides."""
        return self._side - np.abs(unfolded % (2.0 * self._side) - self._side)


def disk(size: int, seed: int) -> tuple[float, float]:
    """Simulate nodes that broadcast once a second on a disk graph.

    Return the CPU time, s, per message sent (one per receiver), and the rise of memory to its peak, B, per node.
    """
    before, env = memory("VmRSS"), Clock()
    places = Drifting(env, size, sqrt(pi * size / DEGREE), seed)
    network = Network(env, Complete()(size), Links(latency=LOGNORMAL, range=1.0), seed=seed, positions=places)
    phases = np.random.default_rng(seed).integers(SECOND, size=size).tolist()

    def node(me: int) -> Generator[simpy.Event, Any, None]:
        turn = int(Phase.DECISION) + me
        for when in range(phases[me], round(DURATION * SECOND), SECOND):
            yield Instant(env, when, turn)
            network.latest_records(me)
            network.publish(me, when)

    for me in range(size):
        env.process(node(me))
    begin = time.process_time()
    env.run()
    return (time.process_time() - begin) / network.message_counts().sent, (memory("VmHWM") - before) / size


def disk_graphs(options: Options) -> list[Cost]:
    """Measure the time per message and the memory per node on disk graphs of equal density and different size."""
    by_size = {}
    for size in SIZES:
        laps = [apart(disk, size, options.seed) for _ in range(options.runs if size < max(SIZES) else 1)]
        by_size[size] = tuple(map(median, zip(*laps, strict=True)))
    base, largest = SIZES[1], SIZES[-1]
    ratio = by_size[largest][0] / by_size[base][0]
    return [
        *(Cost(f"a message, N = {size:,}", per_message * 1e6, "us") for size, (per_message, _) in by_size.items()),
        Cost(f"N = {largest:,} / N = {base:,}", ratio, "", 2.0),
        Cost(f"memory of a node, N = {largest:,}", by_size[largest][1] / 1e3, "kB", 4.0),
    ]


def large_team(count: int, horizon: float) -> Scenario:
    """Return a scenario of a team on a complete graph that runs until the horizon.

    The area is so large that the evader is not captured before the horizon.
    """
    return Scenario(
        name="large_team",
        horizon=horizon,
        team=Team(count=count, box=(0.0, 1_000.0)),
        evader=Evader(box=(400.0, 600.0)),
        protocol=SpatialAdaptivePlay(schedule=SharedSeed(slot=SLOT)),
        announce=Announcements(start="known"),
    )


def large_team_cost(count: int, horizon: float, seed: int) -> tuple[float, float]:
    """Run `large_team`; return the wall time of the run, s, and the peak memory of the process, B."""
    begin = time.perf_counter()
    result = run(large_team(count, horizon), seed)
    took = time.perf_counter() - begin
    assert end_time(result) == horizon
    return took, memory("VmHWM")


def complete(options: Options) -> list[Cost]:
    """Measure Spatial Adaptive Play on a large complete graph."""
    took, peak = apart(large_team_cost, LARGE_TEAM, HORIZON, options.seed)
    load = f"N = {LARGE_TEAM:,}, {1 / SLOT:,.0f} decisions/s, {HORIZON:g} s"
    return [Cost(load, took, "s", 20.0), Cost("peak memory", peak / MEGABYTE, "MB", 1_000.0)]


# Loss models.


def losses(options: Options) -> list[Cost]:
    """Measure the cost of a message under each loss model, relative to one that cannot be lost."""
    plain = Workload("", nx.complete_graph(40), 2_000, LOGNORMAL, Links(latency=Constant(value=0.015)))
    moving = "by_distance, all moving"
    works: dict[str, Workload] = {"none": plain}
    for model in (Bernoulli(p=0.1), ByDistance(distance=10.0), GilbertElliott(share=0.1, burst=5.0)):
        works[model.kind] = replace(plain, links=Links(latency=Constant(value=0.015), loss=model))
    works[moving] = replace(works["by_distance"], speed=1.0)
    variants = {name: partial(published, work) for name, work in works.items()}
    times = per_unit(variants, range(options.seed, options.seed + 5 * options.runs))
    base = times.pop("none")
    return [Cost(f"{name} / no loss", took / base, "", None if name == moving else 3.3) for name, took in times.items()]


# Losses on arrival.


def with_losses_on_arrival() -> Mapping[str, tuple[Workload, Workload]]:
    """Return pairs of workloads, by a description: one with losses that are decided on arrival, and one without."""
    constant, random = Links(latency=Constant(value=0.015)), Links(latency=LOGNORMAL)
    radio = Bitrate(bitrate=1e6)
    pairs: dict[str, tuple[Workload, Workload]] = {}
    for name, links in {"constant latency": constant, "lognormal latency": random}.items():
        work = Workload(name, nx.complete_graph(40), 2_000, LOGNORMAL, links)
        moving = replace(work, speed=1.0, links=links.model_copy(update={"range": 10.0}))
        assert moving.links is not None
        at_delivery = replace(moving, links=moving.links.model_copy(update={"range_check": "delivery"}))
        half_duplex = links.model_copy(update={"medium": radio.model_copy(update={"half_duplex": True})})
        full_duplex = replace(work, links=links.model_copy(update={"medium": radio}))
        pairs |= {
            f"a crash plan, {name}": (replace(work, faults=(Crash(node=3, start=0.5, end=1.0),)), work),
            f"range checked at delivery, {name}": (at_delivery, moving),
            f"half duplex, {name}": (replace(work, links=half_duplex), full_duplex),
        }
    return pairs


def published(work: Workload, seed: int) -> int:
    """Run a workload with `publish`; return the number of messages sent."""
    way = Publish(replace(work, seed=seed))
    way.run()
    return way.network.message_counts().sent


def arrivals(options: Options) -> list[Cost]:
    """Measure the cost of a message whose loss is decided on arrival, relative to one whose arrival is certain."""
    pairs = with_losses_on_arrival()
    variants = {f"{name}, {k}": partial(published, work) for name, pair in pairs.items() for k, work in enumerate(pair)}
    took = per_unit(variants, range(options.seed, options.seed + options.runs))
    return [Cost(f"{name} / without", took[f"{name}, 0"] / took[f"{name}, 1"], "", 3.3) for name in pairs]


# Contention.

AIRTIME = 0.0006
"""Airtime of a frame on a channel for which nodes contend, s; a millisecond passes between broadcasts on average."""
SIDE = 20.0
"""Side of the square in which these nodes stand, m."""


def crowd(work: Workload, seed: int) -> tuple[Floats, list[float]]:
    """Return (n, 2) random positions, m, and the times of broadcasts, s, which are those of a Poisson process."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0.0, SIDE, (work.size, 2)), rng.exponential(TICK, work.turns).cumsum().tolist()


def contended(work: Workload, seed: int) -> tuple[int, int]:
    """Let nodes contend by CSMA/CA with the capture effect in desim; return the messages sent and delivered."""
    clock, medium = Clock(), Bitrate(bitrate=8 * 24 / AIRTIME, access=CsmaCa(), reception=CaptureEffect())
    places, times = crowd(work, seed)
    links = Links(latency=work.latency, medium=medium)
    network = Network(clock, work.graph, links, seed=seed, positions=lambda: places)

    def turns() -> Generator[simpy.Event, Any, None]:
        for number, when in enumerate(times):
            yield Instant(clock, round(when * SECOND), Phase.DECISION)
            node = number % work.size
            network.latest_records(node)
            network.publish(node, number, size=24)

    clock.process(turns())
    clock.run(until=round((times[-1] + 1.0) * SECOND))
    counts = network.message_counts()
    return counts.sent, counts.delivered


def contended_in_simpy(work: Workload, seed: int) -> tuple[int, int]:
    """Do the same in plain SimPy, without reading the tables; return the messages sent and delivered."""
    channel = Contention(*crowd(work, seed), AIRTIME, CsmaCa(), CaptureEffect(), LOGNORMAL, seed=seed)
    channel.run()
    return channel.sent, channel.delivered


def contention(options: Options) -> list[Cost]:
    """Measure the cost of a message on a channel for which nodes contend, relative to the same in plain SimPy."""
    work = Workload("", nx.complete_graph(40), 2_000, LOGNORMAL)
    variants: dict[str, Callable[[int], int]] = {
        "desim": lambda seed: contended(work, seed)[0],
        "SimPy": lambda seed: contended_in_simpy(work, seed)[0],
    }
    took = per_unit(variants, range(options.seed, options.seed + options.runs))
    return [
        Cost("a message, 40 nodes, CSMA/CA with capture", took["desim"] * 1e6, "us"),
        Cost("desim / SimPy", took["desim"] / took["SimPy"], "", 1 / 3),
    ]


# Walls.


def among_walls(blocks: int) -> Scenario:
    """Return a scenario of 40 moving pursuers with log-distance reception; square blocks weaken radio.

    The evader is too far away to be captured, so that equally many messages are sent with and without walls.
    """
    corners = ((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0))
    places = [(10.0 + 25.0 * (block // 3), 10.0 + 25.0 * (block % 3)) for block in range(blocks)]
    return Scenario(
        name="among_walls",
        horizon=40.0,
        team=Team(count=40, box=(0.0, 100.0), speeds=2.0),
        evader=Evader(position=(500.0, 500.0), speed=3.0),
        motion=Motion(step=0.05),
        protocol=LocalMin(schedule=Periodic(period=0.1)),
        announce=Announcements(heartbeat=0.1),
        network=Links(latency=Constant(value=0.02), range=80.0, reception=LogDistance(exponent=2.5, shadowing=4.0)),
        wall=tuple(
            Wall(polygon=tuple((left + x, below + y) for x, y in corners), loss=6.0, blocks=("radio",))
            for left, below in places
        ),
    )


def walls(options: Options) -> list[Cost]:
    """Measure the cost of a run with 48 corners that weaken radio, relative to the same run without walls."""
    variants = {name: partial(_one_run, among_walls(blocks)) for name, blocks in {"walls": 12, "none": 0}.items()}
    took = per_unit(variants, range(options.runs))
    return [Cost("40 moving nodes, 48 corners / no walls", took["walls"] / took["none"], "", 1.5)]


# Whole runs.


def table_1(_: Options) -> list[Cost]:
    """Measure the wall time and the CPU time of the Table I study, run as a command with two worker processes."""
    with TemporaryDirectory() as folder:
        arguments = ["--runs", str(TABLE1_RUNS), "--jobs", "2", "--out", folder]
        before = os.times()
        took = command("-m", "scenarios.table1", *arguments)
        after = os.times()
    cpu_time = portable_sum(after[2:4]) - portable_sum(before[2:4])
    return [
        Cost(f"scenarios.table1 --runs {TABLE1_RUNS} --jobs 2", took, "s", 60.0),
        Cost("CPU time of both cores", cpu_time, "s"),
    ]


def loop(options: Options) -> list[Cost]:
    """Measure the CPU time per slot of a run of the Table I study, relative to that of a bare loop.

    The bare loop is Algorithm 2 of Lee & Bakolas without messages. In the runs of desim, the motion step h is one slot
    delta in one variant, and ten slots in another.
    """
    fine = decentralised(configuration(40), SLOT)
    coarse = fine.model_copy(update={"motion": Motion(step=10 * SLOT)})
    variants: dict[str, Callable[[int], int]] = {
        "h = delta": lambda seed: round(end_time(run(fine, seed)) / SLOT),
        "h = 10 delta": lambda seed: round(end_time(run(coarse, seed)) / SLOT),
        "bare": lambda seed: bare_loop(fine, seed, SLOT),
    }
    took = per_unit(variants, range(options.seed, options.seed + 2 * options.runs))
    return [
        Cost("a slot of the bare loop", took["bare"] * 1e6, "us"),
        Cost("h = delta / bare loop", took["h = delta"] / took["bare"], "", 0.9),
        Cost("h = 10 delta / the same bare loop", took["h = 10 delta"] / took["bare"], "", 0.5),
    ]


# Shipped scenarios.


USUAL_LIMIT = 5.0
"""Most CPU time of a run of a shipped scenario, relative to `relay.toml`, if it has no limit of its own."""
LIMITS = MappingProxyType(
    {
        **{"noisy": 6.0, "radio": 6.0, "voronoi": 4.0, "flooding": 3.5},
        **{"inertia": 3.0, "recorded": 2.5, "server": 2.0},
    }
)
"""The limits of some scenarios; docs/explanation/performance.md says why some cost more than `USUAL_LIMIT`."""


def examples(options: Options) -> list[Cost]:
    """Measure the CPU time of a run of each shipped scenario, with the seed of its file, relative to `relay.toml`.

    For some scenarios, also measure the time of all metrics, relative to that of the run.
    """
    files = sorted(SCENARIOS.glob("*.toml"))
    variants = {file.stem: partial(_one_run, load(file)) for file in files}
    measured = {f"metrics of {name}": partial(_metrics, run(load(SCENARIOS / f"{name}.toml"))) for name in MEASURED}
    times = per_unit(variants | measured, range(options.runs))
    return [
        *(
            Cost(f"{name} / relay", times[name] / times["relay"], "", LIMITS.get(name, USUAL_LIMIT))
            for name in variants
            if name != "relay"
        ),
        *(Cost(f"metrics of {name} / {name}", times[f"metrics of {name}"] / times[name], "") for name in MEASURED),
    ]


def _one_run(scenario: Scenario, _: int) -> int:
    run(scenario)
    return 1


def _metrics(result: Result, _: int) -> int:
    summary(result)
    return 1


# Recording.


def many_messages(count: int) -> Scenario:
    """Return a scenario in which about `count` messages are sent."""
    heartbeat, team = 0.01, 40
    return Scenario(
        name="many_messages",
        horizon=count * heartbeat / (team * (team - 1)),
        team=Team(count=team, box=(0.0, 1_000.0)),
        evader=Evader(box=(400.0, 600.0)),
        protocol=SpatialAdaptivePlay(schedule=SharedSeed(slot=heartbeat)),
        announce=Announcements(start="known", heartbeat=heartbeat, trigger="heartbeat"),
        network=Links(latency=LOGNORMAL),
        record=Recording(trajectory=0.0),
    )


def kept(scenario: Scenario, seed: int) -> int:
    """Run with all messages kept in the trace; return the number of messages."""
    return sent(run(scenario.model_copy(update={"record": Recording(trajectory=0.0, messages=True)}), seed))


def streamed(scenario: Scenario, seed: int) -> int:
    """Run with all messages written to disk as they are sent; return the number of messages."""
    with TemporaryDirectory() as folder, TraceFile(Path(folder) / "trace.jsonl") as file:
        return sent(run(scenario, seed, file))


def peak_of_stream(count: int, seed: int) -> float:
    """Stream the messages of a run, about `count`, to disk; return the peak memory of the process, B."""
    streamed(many_messages(count), seed)
    return memory("VmHWM")


def recording(options: Options) -> list[Cost]:
    """Measure the cost of recording all messages, in memory and on disk."""
    scenario = many_messages(STREAMED[0])
    variants: dict[str, Callable[[int], int]] = {
        "off": lambda seed: sent(run(scenario, seed)),
        "kept": partial(kept, scenario),
        "streamed": partial(streamed, scenario),
    }
    took = per_unit(variants, range(options.seed, options.seed + options.runs))
    few, many = (apart(peak_of_stream, count, options.seed) for count in STREAMED)
    return [
        Cost("a message, none recorded", took["off"] * 1e6, "us"),
        Cost("all kept / none", took["kept"] / took["off"], "", 1.3),
        Cost("all on disk / none", took["streamed"] / took["off"], "", 1.5),
        Cost(f"rise of peak memory, {STREAMED[0]:,} to {STREAMED[1]:,} on disk", (many - few) / MEGABYTE, "MB", 10.0),
    ]


# The start.


def start(_: Options) -> list[Cost]:
    """Measure the start-up time of commands, and of Python and numpy alone for comparison."""
    commands: dict[str, tuple[tuple[str, ...], float | None]] = {
        "python -c pass": (("-c", "pass"), None),
        'python -c "import numpy"': (("-c", "import numpy"), None),
        "desim --help": (("-m", "desim", "--help"), 0.15),
        "desim run relay.toml": (("-m", "desim", "run", str(SCENARIOS / "relay.toml")), 1.0),
    }
    laps = [{name: command(*arguments) for name, (arguments, _) in commands.items()} for _ in range(STARTS)]
    return [Cost(name, median(lap[name] for lap in laps), "s", limit) for name, (_, limit) in commands.items()]


PARTS: Mapping[str, Callable[[Options], list[Cost]]] = MappingProxyType(
    {
        "disk_graphs": disk_graphs,
        "complete": complete,
        "losses": losses,
        "arrivals": arrivals,
        "contention": contention,
        "walls": walls,
        "table1": table_1,
        "loop": loop,
        "examples": examples,
        "recording": recording,
        "start": start,
        "environments": environments,
        "sweeps": two_workers,
        "large_store": large_store,
        "replays": replays,
        "live": live,
    }
)


# Measurements of a result.


def sent(result: Result) -> int:
    """Return the number of messages sent in a run."""
    return messages(result).sent
