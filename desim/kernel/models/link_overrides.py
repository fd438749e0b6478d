"""The models of individual links, which replace those of all links."""

from typing import TYPE_CHECKING, Any

from desim.kernel.models.graphs import edge_model, links_with_attributes
from desim.kernel.models.links import Links
from desim.kernel.models.traits import model_of_run

if TYPE_CHECKING:
    import networkx as nx

Overrides = dict[int, dict[int, Any]]
"""The models, or the orders, of individual links, by sender and receiver."""


def link_overrides(links: Links, graph: "nx.Graph[int]") -> dict[str, Overrides]:
    """Return the models and the orders of individual links, by "latency", "loss" and "order".

    Each is an attribute of an edge of the graph, or a value in `links.link`, which takes precedence.

    Raises:
        ValueError: if `links.link` names a link that is not in the graph, or an edge attribute is invalid.
    """
    found: dict[str, Overrides] = {"latency": {}, "loss": {}, "order": {}}
    for src, dst, attributes in links_with_attributes(graph):
        for name, overrides in found.items():
            if (value := attributes.get(name)) is not None:
                overrides.setdefault(src, {})[dst] = edge_model(src, dst, name, value)
    for link in links.link:
        for src, dst in link.ways():
            if not graph.has_edge(src, dst):
                raise ValueError(f"there is no link from {src} to {dst} in the graph")
            for name, overrides in found.items():
                model = dict(link)[name]
                if model is not None:
                    overrides.setdefault(src, {})[dst] = model
    return found


def overrides_of_run(overrides: Overrides, size: int) -> Overrides:
    """Return the models of individual links in one run of `size` nodes."""
    return {src: {dst: model_of_run(model, size) for dst, model in models.items()} for src, models in overrides.items()}
