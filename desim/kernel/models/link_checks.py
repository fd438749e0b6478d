"""Checks that the models of a network apply to its links; a model of measurements may lack some of them."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from desim.kernel.graph_files.node_names import shortened
from desim.kernel.models.graphs import edge_model, links_with_attributes
from desim.kernel.models.links import Links
from desim.kernel.models.traits import link_trait

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
    """Yield the key and the text of each table of measurements that cannot have the numbers of the named nodes."""
    names = links.node_names
    for place, trace in links.traces():
        order = trace.nodes or trace.measurements.names
        if not names or order == names:
            continue
        try:
            is_numbered = trace.numbered(names) is trace
        except ValueError as error:
            yield place, f"{error}: the nodes are {shortened(names)}"
            continue
        if order and is_numbered:
            text = f"numbers the nodes {shortened(order)}, and the network {shortened(names)}"
            yield place, f"{trace.name} {text}: nodes should be in the order of the network, or absent"


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
