"""The imperfections of a scenario, and what it is without each of them.

The graph is none: it says who is linked to whom. Nor is how often a pursuer decides by a clock of its own.
"""

from collections.abc import Callable, Mapping
from math import inf
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel, ValidationError

from desim.kernel.graphs import Edges
from desim.kernel.latency import Constant
from desim.kernel.links import Links, Processing
from desim.kernel.loss import Bernoulli
from desim.kernel.medium import Unlimited
from desim.kernel.reception import Disk
from desim.pursuit.sensing import Sensing
from desim.scenario.scenario import Scenario


def without_latency(scenario: Scenario) -> Scenario:
    """Return a scenario in which messages take no time: neither on their way, nor at its ends, nor to be transmitted.

    Nobody waits for a channel any more, so nothing is dropped from a queue or missed by who transmits. What a
    dissemination waits on purpose before it passes something on stays.
    """
    return _on(
        scenario,
        latency=Constant(),
        processing=Processing(),
        medium=Unlimited(),
        graph=_bare_graph(scenario, "latency"),
        link=_bare_links(scenario.network, "latency"),
    )


def without_loss(scenario: Scenario) -> Scenario:
    """Return a scenario in which no message is lost by chance on its way."""
    return _on(
        scenario,
        loss=Bernoulli(),
        graph=_bare_graph(scenario, "loss"),
        link=_bare_links(scenario.network, "loss"),
    )


def without_range(scenario: Scenario) -> Scenario:
    """Return a scenario in which whoever is linked hears each other at any distance."""
    return _on(scenario, range=inf, reception=Disk())


def without_faults(scenario: Scenario) -> Scenario:
    """Return a scenario in which nothing breaks, nobody is cut off or jammed, and all clocks are right."""
    return scenario.model_copy(update={"fault": ()})


def without_turns(scenario: Scenario) -> Scenario:
    """Return a scenario in which nobody waits with a decision for those of others, if the schedule has turns.

    If the messages of the schedule carry what pursuers do, they announce it instead, at once.
    """
    protocol = scenario.protocol
    schedule = getattr(protocol, "schedule", None)
    if not (isinstance(protocol, BaseModel) and hasattr(schedule, "without_turns")) or scenario.team.count == 1:
        return scenario
    try:
        free = type(protocol).model_validate({**dict(protocol), "schedule": schedule.without_turns()})
    except ValidationError:  # a rule of a user's that takes no other schedule has turns for good
        return scenario
    said = scenario.announce.model_copy(update={"trigger": "both"} if hasattr(schedule, "spreads_to") else {})
    return scenario.model_copy(update={"protocol": free, "announce": said})


def without_staleness(scenario: Scenario) -> Scenario:
    """Return a scenario in which each says at once what it does, senses where the others are, and knows who began.

    Announcements are repeated, and who is silent for long is forgotten. A rule that goes by announced positions only
    senses them, and is in no need of messages any more.
    """
    ideal = {"payload": "action", "trigger": "both", "belief_timeout": "auto", "warm_start": True}
    return scenario.model_copy(update={"announce": scenario.announce.model_copy(update=ideal)})


def without_blindness(scenario: Scenario) -> Scenario:
    """Return a scenario in which pursuers see the evaders at any distance."""
    return scenario.model_copy(update={"sensing": Sensing()}) if scenario.sensing.limited else scenario


IMPERFECTIONS: Mapping[str, Callable[[Scenario], Scenario]] = MappingProxyType(
    {
        "latency": without_latency,
        "loss": without_loss,
        "range limit": without_range,
        "faults": without_faults,
        "serial decisions": without_turns,
        "stale knowledge": without_staleness,
        "limited sight": without_blindness,
    }
)
"""What each is removed by."""


def _on(scenario: Scenario, **ideal: Any) -> Scenario:
    """Return a scenario with another network, if it differs at all."""
    network = scenario.network
    if all(getattr(network, key) == value for key, value in ideal.items()):
        return scenario
    return scenario.model_copy(update={"network": network.model_copy(update={"preset": None, **ideal})})


def _bare_links(network: Links, key: str) -> tuple[Any, ...]:
    """Return the links that are not like the rest, without a property of their own."""
    bare = [link.model_copy(update={key: None}) for link in network.link]
    return tuple(link for link in bare if (link.latency, link.loss, link.order) != (None, None, None))


def _bare_graph(scenario: Scenario, key: str) -> Any:
    """Return the graph with edges that have no property of their own."""
    made = scenario.network.graph(scenario.team.count).copy()  # a function may keep it
    own = [data for _, _, data in made.edges(data=True) if key in data]
    for data in own:
        del data[key]
    return Edges.of(made) if own else scenario.network.graph
