"""The imperfections of a scenario, and functions that remove them one by one.

Two properties do not count as imperfections: the graph, which defines the links between pursuers, and the decision rate
of pursuers that take no turns.
"""

from collections.abc import Callable, Mapping
from functools import reduce
from math import inf
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel, ValidationError

from desim.kernel.models.access import Ideal
from desim.kernel.models.coherence import Coherence
from desim.kernel.models.graphs import Edges
from desim.kernel.models.interference import Collision
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links, Processing
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.medium import LoRa, Unlimited, contends
from desim.kernel.models.reception import Disk
from desim.kernel.models.traits import FaultTraits
from desim.kernel.models.transport import BestEffort
from desim.kernel.walls.wall import What
from desim.pursuit.byzantine.lies import is_lie
from desim.pursuit.core.traits import DisseminationTraits
from desim.pursuit.motion.dynamics import Simple
from desim.pursuit.motion.environment import Environment
from desim.pursuit.sensing.noise import Noiseless
from desim.pursuit.sensing.sensing import Sensing
from desim.pursuit.sensing.tracking import Unfiltered
from desim.pursuit.team.announcements import one_hop
from desim.scenario.scenario import Scenario


def without_latency(scenario: Scenario) -> Scenario:
    """Return the scenario with zero propagation delay, processing delay and transmission time of messages.

    Nodes no longer wait for a channel. No message is dropped from a queue, or missed because its receiver transmits.
    Delays that a dissemination model adds on purpose before forwarding remain. If nodes contend for the channel, the
    channel remains, too, and so do random processing delays of senders: without them all frames of one instant would
    collide. See `without_contention`.
    """
    medium, sender = scenario.network.medium, scenario.network.processing.sender
    keeps_sender_delay = contends(medium) and type(sender) is not Constant
    return _with_network(
        scenario,
        latency=Constant(),
        processing=Processing(sender=sender) if keeps_sender_delay else Processing(),
        medium=medium if contends(medium) else Unlimited(),
        graph=_graph_without(scenario, "latency"),
        link=_links_without(scenario.network, "latency"),
    )


def without_contention(scenario: Scenario) -> Scenario:
    """Return the scenario in which the channel is an ideal queue: no back-off, collision or duty cycle.

    Messages still have an airtime, and wait for the channel. If the random processing delays of senders are the only
    latency, they are removed, too; `without_latency` keeps them.
    """
    medium = scenario.network.medium
    if not contends(medium):
        return scenario
    no_contention = (
        {"spreading_factors": None, "frequencies": None, "gateways": None} if isinstance(medium, LoRa) else {}
    )
    ideal = {"access": Ideal(), "reception": Collision(), "duty_cycle": None, "shared": True}
    network = scenario.network
    has_delays = network.latency != Constant() or network.processing.receiver != 0.0 or _has_own_latency(scenario)
    processing = network.processing if has_delays else Processing()
    return _with_network(scenario, medium=medium.model_copy(update=ideal | no_contention), processing=processing)


def without_loss(scenario: Scenario) -> Scenario:
    """Return the scenario without loss models; random reception is kept, because `without_range` removes it."""
    return _with_network(
        scenario,
        loss=Bernoulli(),
        graph=_graph_without(scenario, "loss"),
        link=_links_without(scenario.network, "loss"),
    )


def without_duplicates(scenario: Scenario) -> Scenario:
    """Return the scenario in which no message is transmitted twice."""
    return _with_network(scenario, duplicate=Bernoulli())


def without_transport(scenario: Scenario) -> Scenario:
    """Return the scenario in which messages are sent once, and none is acknowledged, retransmitted or coded."""
    best_effort = _with_network(scenario, transport=BestEffort())
    if DisseminationTraits.of(scenario.announce.dissemination).transport is None:
        return best_effort
    announce = scenario.announce.model_copy(update={"dissemination": one_hop()})
    return best_effort.model_copy(update={"announce": announce})


def without_range(scenario: Scenario) -> Scenario:
    """Return the scenario in which linked nodes receive each other's messages at any distance."""
    return _with_network(scenario, range=inf, reception=Disk())


def without_channel_memory(scenario: Scenario) -> Scenario:
    """Return the scenario in which the fading and the shadowing of each message are independent of other messages."""
    if scenario.network.fading != "correlated":
        return scenario
    return _with_network(scenario, fading="message", coherence=Coherence())


def without_faults(scenario: Scenario) -> Scenario:
    """Return the scenario without faults of the network, robots and clocks: no crash, partition, jamming or skew."""
    return scenario.model_copy(update={"fault": tuple(fault for fault in scenario.fault if is_lie(fault))})


def without_lies(scenario: Scenario) -> Scenario:
    """Return the scenario without Byzantine faults; `announce.trust` is kept."""
    return scenario.model_copy(update={"fault": scenario.network_faults})


def without_serial_decisions(scenario: Scenario) -> Scenario:
    """Return the scenario in which pursuers take no turns: no decision waits for a decision of a teammate.

    If messages of the schedule, such as a token, carried the actions, pursuers now announce each change of action
    immediately, and repeat it with every heartbeat. A scenario without turns or with one pursuer is returned unchanged,
    and so is one whose protocol accepts no other schedule.
    """
    protocol: object = scenario.protocol
    schedule = scenario.schedule_traits
    if not isinstance(protocol, BaseModel) or schedule.without_serial_decisions is None or scenario.team.count == 1:
        return scenario
    try:
        fields = {**dict(protocol), "schedule": schedule.without_serial_decisions()}
        without_turns = type(protocol).model_validate(fields)
    except ValidationError:  # a user's protocol that accepts no other schedule keeps its turns
        return scenario
    announcements = scenario.announce.model_copy(update={"trigger": "both"} if schedule.spreads_to else {})
    return scenario.model_copy(update={"protocol": without_turns, "announce": announcements})


def without_staleness(scenario: Scenario) -> Scenario:
    """Return the scenario in which pursuers announce actions at once, and sense positions.

    Announcements are repeated, and beliefs about silent teammates expire. A protocol that uses announcements only for
    positions then senses the positions instead and needs no messages.
    """
    ideal = {"payload": "action", "trigger": "both", "belief_timeout": "auto"}
    return scenario.model_copy(update={"announce": scenario.announce.model_copy(update=ideal)})


def without_unknown_start(scenario: Scenario) -> Scenario:
    """Return the scenario in which all pursuers know the initial actions, without a message."""
    return scenario.model_copy(update={"announce": scenario.announce.model_copy(update={"start": "known"})})


def without_sensing_limit(scenario: Scenario) -> Scenario:
    """Return the scenario in which pursuers sense the evaders at any distance; noise and its filter are kept."""
    sensing = scenario.sensing
    if not sensing.limited:
        return scenario
    sees_all = sensing.model_copy(update={"radius": inf}) if scenario.space.blocks_sight else _unlimited(sensing)
    return scenario.model_copy(update={"sensing": sees_all})


def _unlimited(sensing: Sensing) -> Sensing:
    """Return sensing that neither distance nor walls limit; of its settings, only those of noisy sightings are kept."""
    kept_keys = ("noise", "interval", "estimator", "fusion", "period", "relay", "estimate")
    return Sensing() if not sensing.is_noisy else Sensing(**{key: dict(sensing)[key] for key in kept_keys})


def without_noise(scenario: Scenario) -> Scenario:
    """Return the scenario in which sightings have no errors, and need no filter."""
    if not scenario.sensing.is_noisy:
        return scenario
    noiseless = {"noise": Noiseless(), "estimator": Unfiltered(), "fusion": "by_stamp", "interval": Sensing().interval}
    sensing = scenario.sensing.model_copy(update=noiseless)
    return scenario.model_copy(update={"sensing": sensing if scenario.sight_is_limited else Sensing()})


def without_inertia(scenario: Scenario) -> Scenario:
    """Return the scenario in which all players take each commanded velocity at once."""
    team, evader, simple = scenario.team, scenario.evader, {"dynamics": Simple()}
    if not (team.has_inertia or any(evader.has_inertia for evader in scenario.evaders)):
        return scenario
    kinds: tuple[Any, ...] = evader if isinstance(evader, tuple) else (evader,)
    simple_evaders = tuple(kind.model_copy(update=simple) for kind in kinds)
    evaders = simple_evaders if isinstance(evader, tuple) else simple_evaders[0]
    return scenario.model_copy(update={"team": team.model_copy(update=simple), "evader": evaders})


def without_flow(scenario: Scenario) -> Scenario:
    """Return the scenario in which the medium is at rest."""
    return scenario.model_copy(update={"environment": Environment()})


def without_walls(use: What) -> Callable[[Scenario], Scenario]:
    """Return a function that returns a scenario in which no wall blocks one use: radio, sight or motion.

    Initial positions stay the same: a wall that blocked motion still blocks starting positions.
    """

    def without(scenario: Scenario) -> Scenario:
        replacement: tuple[What, ...] = ("start",) if use == "motion" else ()
        blocked = [(wall, _replaced(wall.blocks, use, replacement)) for wall in scenario.wall]
        walls = tuple(wall.model_copy(update={"blocks": blocks}) for wall, blocks in blocked if blocks)
        if walls == scenario.wall:
            return scenario
        sees_all = use == "sight" and not scenario.sensing.limited
        sensing = {"sensing": _unlimited(scenario.sensing)} if sees_all else {}
        return scenario.model_copy(update={"wall": walls, **sensing})

    return without


def _replaced(blocks: tuple[What, ...], use: What, replacement: tuple[What, ...]) -> tuple[What, ...]:
    """Return `blocks` with one use replaced by others, each name once."""
    return tuple(dict.fromkeys(name for block in blocks for name in (replacement if block == use else (block,))))


IMPERFECTIONS: Mapping[str, Callable[[Scenario], Scenario]] = MappingProxyType(
    {
        "latency": without_latency,
        "contention": without_contention,
        "loss": without_loss,
        "duplicates": without_duplicates,
        "transport": without_transport,
        "range limit": without_range,
        "channel memory": without_channel_memory,
        "faults": without_faults,
        "lies": without_lies,
        "serial decisions": without_serial_decisions,
        "unknown start": without_unknown_start,
        "stale knowledge": without_staleness,
        "limited sight": without_sensing_limit,
        "noise": without_noise,
        "inertia": without_inertia,
        "flow": without_flow,
        "walls (radio)": without_walls("radio"),
        "walls (sight)": without_walls("sight"),
        "walls (motion)": without_walls("motion"),
    }
)
"""The name of each imperfection, and the function that removes it."""


PERFECT_NETWORK = (
    without_contention,
    without_latency,
    without_loss,
    without_duplicates,
    without_transport,
    without_range,
    without_walls("radio"),
)
"""The removals that make everything arrive at once; contention first, or `without_latency` keeps the airtime."""


def with_perfect_network(scenario: Scenario) -> Scenario:
    """Return the scenario in which every message arrives at once at all neighbours in the graph.

    Network faults are removed, too: partitions, jamming, and crashes of radios. All else is kept: broken robots, lies,
    wrong clocks, noise, and what pursuers announce and when. A plan that draws crashes beside other faults is kept.
    """
    network = reduce(lambda better, remove: remove(better), PERFECT_NETWORK, scenario)
    faults = tuple(fault for fault in network.fault if not FaultTraits.of(fault).messages_only)
    return network if faults == network.fault else network.model_copy(update={"fault": faults})


def without_messages(scenario: Scenario) -> Scenario:
    """Return the scenario in which every message is sent once, takes as much of the channel as before, and is lost."""
    silent = without_transport(without_loss(scenario))
    return _with_network(silent, loss=Bernoulli(p=1.0))


def _with_network(scenario: Scenario, **ideal: Any) -> Scenario:
    """Return a scenario with other values of its network; the same object if nothing changes."""
    network = scenario.network
    if dict(network) | ideal == dict(network):
        return scenario
    return scenario.model_copy(update={"network": type(network)(**dict(network) | {"preset": None} | ideal)})


def _links_without(network: Links, key: str) -> tuple[Any, ...]:
    """Return the links without their model `key`; links that have no model of their own left are dropped."""
    other_keys = {"latency", "loss", "order"} - {key}
    kept = [link for link in network.link if any(getattr(link, name) is not None for name in other_keys)]
    return tuple(link.model_copy(update={key: None}) for link in kept)


def _has_own_latency(scenario: Scenario) -> bool:
    """Return whether a link or an edge of the graph has a latency of its own."""
    return any(link.latency is not None for link in scenario.network.link) or (
        _graph_without(scenario, "latency") is not scenario.network.graph
    )


def _graph_without(scenario: Scenario, key: str) -> Any:
    """Return the graph of a scenario, without one property (`key`) of its edges."""
    # A copy, because a graph model may return the same object at each call.
    graph = scenario.network.make_graph(scenario.team.count).copy()
    edges = [data for _, _, data in graph.edges(data=True) if key in data]
    for data in edges:
        del data[key]
    return Edges.of(graph) if edges else scenario.network.graph
