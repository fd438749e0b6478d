"""The imperfections of a scenario, and what it is without each of them."""

from collections.abc import Callable, Mapping
from itertools import combinations, permutations
from math import inf
from types import MappingProxyType
from typing import Any

from desim.kernel.graphs import Complete, Edges
from desim.kernel.latency import Constant
from desim.kernel.links import Links, Processing
from desim.kernel.loss import Bernoulli
from desim.kernel.medium import Unlimited
from desim.kernel.reach import Disk
from desim.scenario import Scenario
from desim.value import choices_of


def without_latency(scenario: Scenario) -> Scenario:
    """Return a scenario in which word takes no time: neither on its way, nor at its ends, nor to be put on the air."""
    network = scenario.network
    return _on(
        scenario,
        latency=Constant(),
        processing=Processing(),
        medium=Unlimited(),
        graph=_bare_graph(scenario, "latency"),
        link=_bare_links(network, "latency"),
    )


def without_loss(scenario: Scenario) -> Scenario:
    """Return a scenario in which no message is lost by chance."""
    return _on(
        scenario,
        loss=Bernoulli(),
        graph=_bare_graph(scenario, "loss"),
        link=_bare_links(scenario.network, "loss"),
    )


def without_range(scenario: Scenario) -> Scenario:
    """Return a scenario in which everybody hears everybody in one hop."""
    return _on(scenario, range=inf, reach=Disk(), graph=_completed(scenario))


def without_faults(scenario: Scenario) -> Scenario:
    """Return a scenario in which nothing breaks."""
    return scenario.model_copy(update={"fault": ()})


def without_turns(scenario: Scenario) -> Scenario:
    """Return a scenario in which all decide whenever one of the team would, if the protocol has a schedule."""
    protocol: Any = scenario.protocol
    schedule = getattr(protocol, "schedule", None)
    if schedule is None or getattr(schedule, "at_once", False) or scenario.team.count == 1:
        return scenario
    together = next(
        kinds["together"]
        for choice in choices_of(type(protocol).model_fields["schedule"])
        if "together" in (kinds := choice.choices())
    )
    return scenario.model_copy(update={"protocol": protocol.model_copy(update={"schedule": together(of=schedule)})})


def without_staleness(scenario: Scenario) -> Scenario:
    """Return a scenario in which each says at once what it does, senses where the others are, and knows who began.

    A rule that answers to positions only, as announced, senses them, too.
    """
    announce = scenario.announce
    trigger = announce.trigger if announce.trigger in {"change", "both", "revision"} else "both"
    ideal = {"payload": "action", "trigger": trigger, "forget_after": "auto", "warm_start": True}
    return scenario.model_copy(update={"announce": announce.model_copy(update=ideal)})


IMPERFECTIONS: Mapping[str, Callable[[Scenario], Scenario]] = MappingProxyType(
    {
        "latency": without_latency,
        "loss": without_loss,
        "range limit": without_range,
        "faults": without_faults,
        "serial decisions": without_turns,
        "stale knowledge": without_staleness,
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
    made = scenario.network.graph(scenario.team.count)
    own = [data for _, _, data in made.edges(data=True) if key in data]
    for data in own:
        del data[key]
    return _as_model(made) if own else scenario.network.graph


def _completed(scenario: Scenario) -> Any:
    """Return the complete graph, with the properties that edges have of their own."""
    made = scenario.network.graph(scenario.team.count)
    made.add_edges_from((permutations if made.is_directed() else combinations)(range(len(made)), 2))
    return _as_model(made)


def _as_model(graph: Any) -> Any:
    pairs = len(graph) * (len(graph) - 1) // (1 if graph.is_directed() else 2)
    plain = graph.number_of_edges() == pairs and not any(data for _, _, data in graph.edges(data=True))
    return Complete() if plain else Edges.of(graph)
