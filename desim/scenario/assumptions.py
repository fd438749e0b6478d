"""What a protocol may assume of a scenario, and whether the scenario keeps to it.

A protocol, its schedule or its utility names its assumptions in `assumes`. Each is a function of the scenario that
returns why it does not hold, or None. A broken assumption is worth a warning, not an error: what a protocol does where
its theorem does not hold is what the simulator is there to show.
"""

from collections.abc import Callable, Iterator, Mapping
from math import inf
from types import MappingProxyType, UnionType
from typing import TYPE_CHECKING

import networkx as nx

from desim.kernel.faults import ClockSkew, Crash, Partition, RandomCrashes, RandomFaults
from desim.kernel.implicit_complete import is_complete
from desim.kernel.propagation import LinkSampler
from desim.kernel.reception import Disk
from desim.kernel.topology import Topology

if TYPE_CHECKING:
    from desim.scenario.scenario import Scenario

Assumption = Callable[["Scenario"], str | None]


def undivided(scenario: "Scenario") -> str | None:
    """Nothing cuts the team in parts."""
    return "a partition cuts the team in parts" if _breaks(scenario, "partition", Partition) else None


def connected(scenario: "Scenario") -> str | None:
    """Everybody is linked to everybody, over any number of hops."""
    if parted := undivided(scenario):
        return parted
    graph = _who_hears_whom(scenario)
    if not is_complete(graph) and not nx.is_strongly_connected(graph):
        return "as it begins the network has several components"
    return None


def everyone_heard(scenario: "Scenario") -> str | None:
    """Everybody hears everybody, at once or as word is passed on."""
    if _is_passed_on(scenario):
        return connected(scenario) or _too_wide(scenario)
    graph, size = _who_hears_whom(scenario), scenario.team.count
    if graph.number_of_edges() < size * (size - 1):
        return "as it begins not everybody hears everybody, and word is not passed on (`announce.dissemination`)"
    return undivided(scenario)


def component_heard(scenario: "Scenario") -> str | None:
    """Everybody hears whoever can reach it over any number of hops."""
    graph = _who_hears_whom(scenario)
    if _is_passed_on(scenario):
        return _too_wide(scenario)
    if is_complete(graph):
        return None
    parts = nx.weakly_connected_components(graph)
    if any(graph.subgraph(part).size() < len(part) * (len(part) - 1) for part in parts):
        return (
            "as it begins some are linked over several hops only, and word is not passed on (`announce.dissemination`)"
        )
    return None


def messages_get_through(scenario: "Scenario") -> str | None:
    """What is lost is said again, so that everybody learns of it in the end."""
    network, trigger = scenario.network, scenario.announce.trigger
    if trigger not in {"change", "never"} or _spread_by_schedule(scenario):
        return None
    if trigger == "never":
        return "nothing is ever announced"
    if network.range < inf and not scenario.motion.static:
        return "who comes into range is never told what was said before (`announce.trigger`)"
    by_chance = network.range < inf and network.fading == "message" and network.reception != Disk()
    drops = network.medium.half_duplex or network.medium.queue_limit < inf
    travel = LinkSampler(network, network.graph(scenario.team.count), scenario.seed, None)
    if by_chance or drops or scenario.fault or not travel.lossless:
        return "what is lost is never said again (`announce.trigger`)"
    return None


def announcements_repeated(scenario: "Scenario") -> str | None:
    """What was said is said again, whether or not it has changed."""
    return "nothing is said twice (`announce.trigger`)" if scenario.announce.trigger in {"change", "never"} else None


def one_at_a_time(scenario: "Scenario") -> str | None:
    """No two pursuers decide at the same instant."""
    schedule = getattr(scenario.protocol, "schedule", None)
    return "everybody decides at once" if getattr(schedule, "at_once", False) and scenario.team.count > 1 else None


def no_crashes(scenario: "Scenario") -> str | None:
    """Nobody breaks down."""
    return "pursuers break down" if _breaks(scenario, "crash", Crash | RandomCrashes) else None


def equal_clocks(scenario: "Scenario") -> str | None:
    """All clocks show the same time."""
    return "clocks differ" if any(isinstance(fault, ClockSkew) for fault in scenario.fault) else None


def equal_speeds(scenario: "Scenario") -> str | None:
    """All pursuers are equally fast."""
    speeds = set(scenario.team.all_speeds())
    return f"speeds are {min(speeds):g} to {max(speeds):g} m/s" if len(speeds) > 1 else None


def host_in_reach(scenario: "Scenario") -> str | None:
    """The pursuer that carries the server hears everybody, and everybody hears it, in one hop."""
    host, size = getattr(scenario.protocol, "host", 0), scenario.team.count
    if parted := undivided(scenario):
        return parted
    graph = _who_hears_whom(scenario)
    far = [j for j in range(size) if j != host and not (graph.has_edge(j, host) and graph.has_edge(host, j))]
    return f"as it begins {len(far)} of {size - 1} are out of reach of pursuer {host}" if far else None


def times_known(scenario: "Scenario") -> str | None:
    """Everybody knows everybody's time of capture: positions are sensed, or all are told, and the evader is seen."""
    if scenario.sensing.limited:
        return "not everybody sees the evader (`sensing.radius`)"
    if scenario.announce.payload == "action":
        return None
    if scenario.announce.payload == "time" and len(scenario.evaders) > 1:
        return "nobody says how soon it would capture other evaders than its own (`announce.payload`)"
    return everyone_heard(scenario) or messages_get_through(scenario)


def places_known(scenario: "Scenario") -> str | None:
    """Everybody knows where everybody is: positions are sensed, or all are told."""
    if scenario.announce.payload == "time":
        return "nobody says where it is (`announce.payload`)"
    return times_known(scenario)


ASSUMPTIONS: Mapping[str, Assumption] = MappingProxyType(
    {
        each.__name__: each
        for each in (
            undivided,
            connected,
            everyone_heard,
            component_heard,
            messages_get_through,
            announcements_repeated,
            one_at_a_time,
            no_crashes,
            equal_clocks,
            equal_speeds,
            host_in_reach,
            times_known,
            places_known,
        )
    }
)
"""By the name under which a protocol names it."""


def broken(scenario: "Scenario") -> Iterator[tuple[str, str]]:
    """Yield the assumptions of the protocol, its schedule and its utility that a scenario breaks: the key, and why.

    Raises:
        ValueError: if there is no assumption of that name.
    """
    protocol = scenario.protocol
    for key in ("", "schedule", "utility"):
        part = getattr(protocol, key, None) if key else protocol
        kind = getattr(part, "kind", key or "the protocol")
        for name in getattr(part, "assumes", ()):
            if name not in ASSUMPTIONS:
                raise ValueError(f"{kind} assumes {name!r}, which nobody knows; there are {', '.join(ASSUMPTIONS)}")
            why = ASSUMPTIONS[name](scenario)
            if why is not None:
                yield ".".join(filter(None, ("protocol", key))), f"{kind} assumes {name}, but {why}"


def _breaks(scenario: "Scenario", kind: str, faults: type | UnionType) -> bool:
    """Return whether there are faults of a kind, or a random plan draws such."""
    return any(
        isinstance(fault, faults) or (isinstance(fault, RandomFaults) and kind in fault.kinds)
        for fault in scenario.fault
    )


def _spread_by_schedule(scenario: "Scenario") -> str | None:
    """Return to whom the messages of the schedule carry what pursuers do, and repeat it: all, neighbours or nobody."""
    return getattr(getattr(scenario.protocol, "schedule", None), "spreads_to", None)


def _is_passed_on(scenario: "Scenario") -> bool:
    """Return whether word travels over several hops."""
    one_hop = getattr(scenario.announce.dissemination, "kind", "one_hop") == "one_hop"
    return not one_hop or _spread_by_schedule(scenario) == "all"


def _too_wide(scenario: "Scenario") -> str | None:
    """Return why word does not travel far enough, if so."""
    hops = getattr(scenario.announce.dissemination, "hops", inf)
    if hops == inf or _spread_by_schedule(scenario) == "all":
        return None
    graph = _who_hears_whom(scenario)
    if is_complete(graph):
        return None
    lengths = nx.all_pairs_shortest_path_length(graph)
    widest = max(max(found.values()) for _, found in lengths)
    return f"as it begins word has {widest} hops to travel and travels {hops}" if widest > hops else None


def _who_hears_whom(scenario: "Scenario") -> "nx.DiGraph[int]":
    """Return who hears whom as the run with the seed of the scenario begins."""
    network, start = scenario.network, scenario.team.start(scenario.seed)
    topology = Topology(
        network.graph(scenario.team.count),
        network.range,
        lambda: start,
        network.reception,
        per_link=network.fading == "per_link",
        seed=scenario.seed,
    )
    return topology.graph()
