"""Assumptions of protocols about a scenario, and checks of whether a scenario satisfies them.

A protocol, its schedule, its utility or a dissemination lists the names of its assumptions in `assumes`. Each
assumption is a function of the scenario that returns the reason why it does not hold, or None if it holds. The first
line of the function's docstring states the assumption. Links between pursuers are checked only at the start of the run
with the seed of the scenario. A violated assumption gives a warning, not an error, because simulations also study
protocols where their assumptions do not hold.
"""

from collections.abc import Callable, Iterator, Mapping
from math import inf
from types import MappingProxyType
from typing import TYPE_CHECKING

import networkx as nx

from desim.kernel.link_layer.propagation import LinkSampler
from desim.kernel.models.access import Tdma
from desim.kernel.models.implicit_complete import is_complete
from desim.kernel.models.medium import Medium, contends
from desim.kernel.models.reception import Disk
from desim.kernel.models.traits import FaultTraits, InterferenceTraits
from desim.kernel.topology.topology import Topology
from desim.pursuit.core.traits import Assuming, DisseminationTraits

if TYPE_CHECKING:
    from desim.scenario.scenario import Scenario

Assumption = Callable[["Scenario"], str | None]

NOT_FORWARDED = "announcements are not forwarded (`announce.dissemination`: flooding and gossip forward)"


def undivided(scenario: "Scenario") -> str | None:
    """No partition splits the team."""
    return "a partition splits the team" if _is_broken(scenario, "undivided") else None


def connected(scenario: "Scenario") -> str | None:
    """Every pursuer is connected to every other in both directions, over any number of hops."""
    if reason := undivided(scenario):
        return reason
    graph = initial_graph(scenario)
    if not is_complete(graph) and not nx.is_strongly_connected(graph):
        return "some pursuers cannot reach all others at the start"
    return None


def everyone_heard(scenario: "Scenario") -> str | None:
    """Announcements of every pursuer reach all others, directly or relayed."""
    if is_relayed(scenario):
        return connected(scenario) or _out_of_hops(scenario)
    graph, size = initial_graph(scenario), scenario.team.count
    if graph.number_of_edges() < size * (size - 1):
        return f"not all pursuers hear each other at the start, and {NOT_FORWARDED}"
    return undivided(scenario)


def component_heard(scenario: "Scenario") -> str | None:
    """Every pursuer gets the announcements of all others in its network component, directly or relayed.

    The component of a pursuer contains all whose messages can reach it over any number of hops
    (`Topology.component`). A link may be one-way: then only its receiver has the other end in its component.
    """
    if is_relayed(scenario):
        return _out_of_hops(scenario)
    graph = initial_graph(scenario)
    if is_complete(graph):
        return None
    # All that a pursuer can reach should hear it directly. The set is the same for all pursuers of a strongly connected
    # component. It is computed once for each, from the sets of the components to which its links lead.
    condensed = nx.condensation(graph)
    reached: dict[int, set[int]] = {}
    for component in reversed([*nx.topological_sort(condensed)]):
        members: set[int] = condensed.nodes[component]["members"]
        reached[component] = members.union(*(reached[successor] for successor in condensed[component]))
        if any(graph.out_degree(pursuer) < len(reached[component]) - 1 for pursuer in members):
            return f"some pursuers are several hops apart at the start, and {NOT_FORWARDED}"
    return None


def messages_get_through(scenario: "Scenario") -> str | None:
    """All receivers get each announcement eventually: it cannot be lost, or it is repeated."""
    network, trigger = scenario.network, scenario.announce.trigger
    if trigger not in {"change", "never"} or scenario.schedule_traits.spreads_to is not None:
        return None
    if trigger == "never":
        is_told = scenario.announce.start == "announced"
        return f"nothing{' but the first action' * is_told} is ever announced"
    if network.range < inf and not scenario.motion.static:
        return "a pursuer that comes into range does not receive earlier announcements (`announce.trigger`)"
    if DisseminationTraits.of(scenario.announce.dissemination).retransmits:
        has_crashes = no_crashes(scenario) is not None
        return "a pursuer that crashes may forget what it has acknowledged" if has_crashes else None
    is_fading = network.fading == "message" or (
        network.fading == "correlated" and network.coherence.doppler is not None
    )
    is_by_chance = network.range < inf and is_fading and network.reception != Disk()
    medium = network.medium
    may_drop = medium.half_duplex or medium.queue_limit < inf or _loses_frames(medium)
    sampler = LinkSampler(network, network.make_graph(scenario.team.count), scenario.seed, None)
    if is_by_chance or may_drop or scenario.fault or not sampler.lossless:
        return "lost announcements are never repeated (`announce.trigger`)"
    return None


def announcements_repeated(scenario: "Scenario") -> str | None:
    """Announcements are repeated, whether or not the action has changed."""
    return "nothing is repeated (`announce.trigger`)" if scenario.announce.trigger in {"change", "never"} else None


def one_at_a_time(scenario: "Scenario") -> str | None:
    """No two pursuers decide at the same instant."""
    at_once = scenario.schedule_traits.at_once
    return "several pursuers may decide at the same instant" if at_once and scenario.team.count > 1 else None


def rounds(scenario: "Scenario") -> str | None:
    """No pursuer waits for its turn: all decide together in rounds, or each at its own times."""
    schedule = scenario.schedule_traits
    if schedule.without_serial_decisions is None or scenario.team.count == 1:
        return None
    return (
        f"under {schedule.kind or 'its schedule'} pursuers decide one at a time; for rounds, set the schedule"
        ' kind to "rounds" or "synchronous"'
    )


def no_crashes(scenario: "Scenario") -> str | None:
    """No pursuer crashes; a crash of the radio alone counts, too."""
    return "pursuers break down" if _is_broken(scenario, "no_crashes") else None


def equal_clocks(scenario: "Scenario") -> str | None:
    """All clocks show the same time."""
    return "clocks differ" if _is_broken(scenario, "equal_clocks") else None


def equal_speeds(scenario: "Scenario") -> str | None:
    """All pursuers have the same speed; relays, which never chase, do not count."""
    relays = scenario.team.relays
    speeds = {speed for pursuer, speed in enumerate(scenario.team.all_speeds()) if pursuer not in relays}
    return f"speeds are {min(speeds):g} to {max(speeds):g} m/s" if len(speeds) > 1 else None


def host_in_range(scenario: "Scenario") -> str | None:
    """The pursuer that hosts the server is linked to every other in one hop, in both directions."""
    host, size = scenario.protocol_traits.host or 0, scenario.team.count
    if reason := undivided(scenario):
        return reason
    graph = initial_graph(scenario)
    far = [j for j in range(size) if j != host and not (graph.has_edge(j, host) and graph.has_edge(host, j))]
    return f"{len(far)} of {size - 1} are out of reach of pursuer {host} at the start" if far else None


def times_known(scenario: "Scenario") -> str | None:
    """Every pursuer knows all capture times.

    This requires that the evaders are seen at any distance. It also requires that positions are sensed, or that
    announcements with positions or capture times reach all.
    """
    if scenario.sensing.limited:
        return "pursuers see the evader only within the sensing radius (`sensing.radius`)"
    if scenario.space.blocks_sight:
        return "pursuers do not see the evader through walls (`wall`)"
    if scenario.sensing.is_noisy:
        return "pursuers do not see the evader exactly (`sensing.noise`)"
    if scenario.announce.payload == "action":
        return None
    if scenario.announce.payload == "time" and len(scenario.evaders) > 1:
        return "announcements contain the capture time of one evader only (`announce.payload`)"
    return everyone_heard(scenario) or messages_get_through(scenario)


def positions_known(scenario: "Scenario") -> str | None:
    """Every pursuer knows all positions: teammates are sensed or announce their positions, and the evaders are seen."""
    if scenario.announce.payload == "time":
        return "announcements contain no positions (`announce.payload`)"
    return times_known(scenario)


ASSUMPTIONS: Mapping[str, Assumption] = MappingProxyType(
    {
        assumption.__name__: assumption
        for assumption in (
            undivided,
            connected,
            everyone_heard,
            component_heard,
            messages_get_through,
            announcements_repeated,
            one_at_a_time,
            rounds,
            no_crashes,
            equal_clocks,
            equal_speeds,
            host_in_range,
            times_known,
            positions_known,
        )
    }
)
"""The assumptions by name, as listed in `assumes`."""


def violations(scenario: "Scenario") -> Iterator[tuple[str, str]]:
    """Yield (key, reason) for each violated assumption of the protocol, its parts or the dissemination."""
    protocol = scenario.protocol_traits
    parts = {
        "protocol": protocol,
        "protocol.schedule": Assuming.of(protocol.schedule),
        "protocol.utility": Assuming.of(protocol.utility),
        "announce.dissemination": DisseminationTraits.of(scenario.announce.dissemination),
    }
    for key, part in parts.items():
        kind = part.kind or ("the protocol" if part is protocol else key.rpartition(".")[2])
        for name in part.assumes:
            why = ASSUMPTIONS[name](scenario)
            if why is not None:
                yield key, f"{kind} assumes {name}, but {why}"


def _is_broken(scenario: "Scenario", assumption: str) -> bool:
    """Return whether a fault breaks an assumption, or a plan of random faults may draw a fault that breaks it."""
    return any(assumption in FaultTraits.of(fault).breaks for fault in scenario.fault)


def _loses_frames(medium: Medium) -> bool:
    """Return whether nodes contend, and frames may overlap or be lost to noise.

    Under TDMA, frames overlap only if clocks differ; that counts as a fault of the scenario, not here.
    """
    if not contends(medium):
        return False
    return not isinstance(medium.access, Tdma) or InterferenceTraits.of(medium.reception).has_noise


def is_relayed(scenario: "Scenario") -> bool:
    """Return whether announcements are relayed over several hops, or messages of the schedule carry actions to all."""
    relays = DisseminationTraits.of(scenario.announce.dissemination).relays
    return relays or scenario.schedule_traits.spreads_to == "all"


def _out_of_hops(scenario: "Scenario") -> str | None:
    """Return the reason why relayed announcements do not reach the whole component; None if they do."""
    hops = DisseminationTraits.of(scenario.announce.dissemination).hops
    if hops == inf or scenario.schedule_traits.spreads_to == "all":
        return None
    graph = initial_graph(scenario)
    if is_complete(graph):
        return None
    widest = max(max(lengths.values()) for _, lengths in nx.all_pairs_shortest_path_length(graph))
    return (
        f"some pursuers are {widest} hops apart at the start, but announcements travel at most {hops:g}"
        if widest > hops
        else None
    )


def initial_graph(scenario: "Scenario") -> "nx.DiGraph[int]":
    """Return the directed graph of the links at the start of the run with the seed of the scenario."""
    network, start = scenario.network, scenario.team.start(scenario.seed, scenario.space)
    topology = Topology(
        network.make_graph(scenario.team.count),
        network.range,
        lambda: start,
        network.reception,
        per_link=network.fading == "per_link",
        seed=scenario.seed,
        walls=scenario.wall,
    )
    return topology.graph()
