"""Checks that the models of a network apply to its links; a model of measurements may lack some of them."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from desim.kernel.graphs import Edges, edge_model, links_with_attributes
from desim.kernel.link_trace_base import LinkTrace
from desim.kernel.links import Links
from desim.kernel.node_names import shortened
from desim.kernel.traits import link_trait

if TYPE_CHECKING:
    import networkx as nx

Way = tuple[int, int]
"""A link: sender and receiver."""
Place = tuple[str | int, ...]


def link_misfits(links: Links, graph: "nx.Graph[int]") -> Iterator[tuple[Place, str]]:
    """Yield the key, below `network`, and the text of each model that does not apply to a link that would use it.

    Args:
        links: the link models; their links are in the graph.
        graph: the communication graph.
    """
    yield from _name_misfits(links)
    for name in ("latency", "loss"):
        own = dict(_own_models(links, graph, name))
        uses: list[tuple[Place, Any, Iterator[Way]]] = [
            (place, model, iter([way])) for way, (place, model) in own.items()
        ]
        uses.append(((name,), getattr(links, name), (way for way in _ways(graph) if way not in own)))
        for place, model, ways in uses:
            check = link_trait(model, "check_links")
            try:
                if check is not None:
                    check(len(graph), ways)
            except ValueError as error:
                yield place, str(error)


def _name_misfits(links: Links) -> Iterator[tuple[Place, str]]:
    """Yield the key and the text of each table that numbers the names of nodes in another way than the graph does."""
    names = links.graph.names if isinstance(links.graph, Edges) else ()
    owners: list[tuple[Place, Any]] = [((), links), *((("link", k), link) for k, link in enumerate(links.link))]
    for place, owner in owners:
        for name in ("latency", "loss"):
            model = getattr(owner, name)
            order = (model.nodes or model.measurements.names) if isinstance(model, LinkTrace) else None
            if names and order and tuple(order) != names:
                text = f"numbers the nodes {shortened(order)}, and the graph {shortened(names)}"
                yield (*place, name), f"{model.name} {text}: set nodes to the names in the order of the graph"


def _own_models(links: Links, graph: "nx.Graph[int]", name: str) -> Iterator[tuple[Way, tuple[Place, Any]]]:
    """Yield the links with a latency or a loss of their own, each with the key of the model and the model."""
    for src, dst, attributes in links_with_attributes(graph):
        model = attributes.get(name)
        if model is not None:
            yield (src, dst), (("graph",), edge_model(src, dst, name, model))
    for k, link in enumerate(links.link):
        if (model := dict(link)[name]) is not None:
            for way in link.ways():
                yield way, (("link", k, name), model)


def _ways(graph: "nx.Graph[int]") -> Iterator[Way]:
    for src, neighbours in graph.adjacency():
        for dst in neighbours:
            yield src, dst
