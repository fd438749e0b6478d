"""The scenarios and measurements of `python -m scenarios.range`."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import networkx as nx
import numpy as np

from desim import Announcements, Constant, Links, Scenario, Team
from desim.analysis.metrics import active_time
from desim.analysis.statistics import Estimate, estimate, paired, share
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.topology.topology import Topology
from desim.pursuit.game.game import equilibria, greedy_maximal_independent_set
from desim.pursuit.game.utility import Component, EdgePenalty, LocalMean
from desim.pursuit.motion.capture import capture_time
from desim.study.workers.batch import seeds_from
from protocols.dissemination import Flooding
from protocols.local_min import ArgminKnown, LocalMin
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson
from scenarios.studies.study import Options

N = 10
TEAMS: Mapping[str, Team] = MappingProxyType({"paper": Team(count=N), "all able": Team(count=N, speeds=1.2)})
RANGES = (0.5, 1.0, 2.0, 4.0, 6.0, 8.0, 12.0, 20.0)
"""Communication ranges R, m."""
TICKS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
GAMES_PER_RUN = 100
"""Number of games at t = 0 per run requested with --runs; their equilibria are found by enumeration."""
CLOCKS = Poisson(rate=10.0)
HEARTBEAT = 0.3
"""Time, s, between two heartbeats: announcements that are sent even without a change of action."""
PROTOCOLS: Mapping[str, tuple[Any, Any]] = MappingProxyType(
    {
        "component": (SpatialAdaptivePlay(schedule=CLOCKS, utility=Component()), Flooding(hops=N)),
        "local mean": (SpatialAdaptivePlay(schedule=CLOCKS, utility=LocalMean()), None),
        "edge penalty": (SpatialAdaptivePlay(schedule=CLOCKS, utility=EdgePenalty()), None),
        "local min": (LocalMin(schedule=CLOCKS), None),
        "argmin known": (ArgminKnown(schedule=CLOCKS), Flooding(hops=N)),
    }
)
"""By name of a rule: the protocol, and the dissemination of its announcements (None: the default, one hop)."""
REFERENCE = "component"


@dataclass(frozen=True)
class Games:
    """Statistics of the games at t = 0 of one team at one range, m."""

    team: str
    range: float
    games: int
    unsettled: Estimate
    """Share of the games without a pure equilibrium if only neighbours count (utility `LocalMean`)."""
    components: float
    """Mean number of network components."""
    independent: float
    """Mean size of the greedy maximal independent set."""


@dataclass(frozen=True)
class Pursuits:
    """The results of the pursuits of one team under one protocol at one range (m); times are means over the runs, s."""

    team: str
    range: float
    protocol: str
    active_time: Estimate
    difference: Estimate
    """Paired difference of the active time from that of `REFERENCE`, s."""


def scenario(team: str, range: float, protocol: str) -> Scenario:  # noqa: A002
    """Return the scenario of Lee & Bakolas with a team, a communication range (m) and a protocol of this study."""
    model, dissemination = PROTOCOLS[protocol]
    settings = {} if dissemination is None else {"dissemination": dissemination}
    return Scenario(
        name=f"{protocol}, R = {range:g} m",
        team=TEAMS[team],
        protocol=model,
        announce=Announcements(heartbeat=HEARTBEAT, **settings),
        network=Links(range=range, latency=Constant(value=0.005)),
    )


def game(base: Scenario, seed: int) -> tuple[list[float], list[list[int]], "nx.DiGraph[int]"]:
    """Return the game at t = 0: (N,) capture times, s; the pursuers that each pursuer hears; and the graph of links."""
    places, evader = base.team.start(seed), base.evaders[0].start(seed)
    phi = capture_time(evader, places, base.team.all_speeds(), base.evaders[0].speed, base.capture.radius).tolist()
    graph = Topology(base.network.graph(N), base.network.range, lambda: places).graph()
    return phi, [list(graph.predecessors(i)) for i in sorted(graph)], graph


def games(team: str, range: float, options: Options) -> Games:  # noqa: A002
    """Return the statistics of the games at t = 0 of a team at one range, m."""
    base = scenario(team, range, "local mean")
    seeds = seeds_from(options.seed, options.runs * GAMES_PER_RUN)
    unsettled, components, independent = [], [], []
    for phi, hearing, graph in (game(base, seed) for seed in seeds):
        unsettled.append(not equilibria(phi, base.horizon, LocalMean(), hearing))
        components.append(nx.number_weakly_connected_components(graph))
        independent.append(portable_sum(greedy_maximal_independent_set(phi, base.horizon, hearing)))
    return Games(team, range, len(seeds), share(unsettled), float(np.mean(components)), float(np.mean(independent)))


def measure(options: Options) -> list[Pursuits]:
    """Run each protocol for each team at each range."""
    keys = [(team, range_, protocol) for team in TEAMS for range_ in RANGES for protocol in PROTOCOLS]
    times = options.measure_each(keys, scenario, "ranges", active_time)
    return [Pursuits(*key, estimate(times[key]), paired(times[key], times[(*key[:2], REFERENCE)])) for key in keys]
