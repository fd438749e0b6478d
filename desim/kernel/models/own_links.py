"""The models of individual links, and whether the models of a network apply to its links."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from desim.config.traits import name_of
from desim.kernel.graph_files.node_names import shortened
from desim.kernel.models.graphs import edge_model, links_with_attributes
from desim.kernel.models.links import Links, Place
from desim.kernel.models.traits import link_trait, model_of_run

if TYPE_CHECKING:
    import networkx as nx

Overrides = dict[int, dict[int, Any]]
"""The latency, the loss or the order (overtaking or fifo) of individual links, by sender and receiver."""


def link_overrides(links: Links, graph: "nx.Graph[int]") -> dict[str, Overrides]:
    """Return the values of individual links, by "latency", "loss" and "order".

    Each is an attribute of an edge of the graph, or a value in `links.link`, which takes precedence.

    Raises:
        ValueError: if `links.link` names a link that is not in the graph, or an edge attribute is invalid.
    """
    for src, dst in (way for link in links.link for way in link.ways()):
        if not graph.has_edge(src, dst):
            raise ValueError(f"there is no link from {src} to {dst} in the graph")
    by_name: dict[str, Overrides] = {"latency": {}, "loss": {}, "order": {}}
    for name, overrides in by_name.items():
        for (src, dst), (_, model) in _own_models(links, graph, name):
            overrides.setdefault(src, {})[dst] = model
    return by_name


def overrides_of_run(overrides: Overrides, size: int) -> Overrides:
    """Return the models of individual links in one run of `size` nodes."""
    return {src: {dst: model_of_run(model, size) for dst, model in models.items()} for src, models in overrides.items()}


Way = tuple[int, int]
"""One direction of a link: sender and receiver."""


def link_misfits(links: Links, graph: "nx.Graph[int]") -> Iterator[tuple[Place, str]]:
    """Yield the key, below `network`, of each model that does not apply to a link that would use it, and the reason.

    An entry of `links.link` is yielded, too, if an earlier entry has one of its links: the last one would silently win.

    Args:
        links: the link models; their links are in the graph.
        graph: the communication graph.
    """
    first_by_way: dict[Way, int] = {}
    for k, link in enumerate(links.link):
        for src, dst in [way for way in link.ways() if first_by_way.setdefault(way, k) != k][:1]:
            yield ("link", k), f"the link from {src} to {dst} is also in link.{first_by_way[src, dst]}"
    yield from _name_misfits(links)
    for name in ("latency", "loss", "duplicate"):
        # Duplicates have one model for all links.
        link_models = {} if name == "duplicate" else dict(_own_models(links, graph, name))
        uses: list[tuple[Place, Any, Iterator[Way]]] = [
            (place, model, iter([way])) for way, (place, model) in link_models.items()
        ]
        ways_of_graph = ((src, dst) for src, receivers in graph.adjacency() for dst in receivers)
        uses.append(((name,), getattr(links, name), (way for way in ways_of_graph if way not in link_models)))
        for place, model, ways in uses:
            check = link_trait(model, "check_links")
            try:
                if check is not None and check(len(graph), ways) is False:
                    yield (
                        place,
                        f"check_links of {name_of(model)} returned False: it should raise ValueError with the reason",
                    )
            except ValueError as error:
                yield place, str(error)


def _name_misfits(links: Links) -> Iterator[tuple[Place, str]]:
    """Yield the key of each table of measurements that cannot number the nodes as the network does, and the reason."""
    names = links.node_names
    for place, table in links.measured_tables():
        order = table.node_order
        if not names or order == names:
            continue
        try:
            is_unchanged = table.numbered(names) is table
        except ValueError as error:
            yield place, f"{error}: the nodes are {shortened(names)}"
            continue
        if order and is_unchanged:  # although the orders differ: `nodes` of the table fixes its own
            text = f"numbers the nodes {shortened(order)}, and the network {shortened(names)}"
            yield place, f"{table.name} {text}: nodes should be in the order of the network, or absent"


def _own_models(links: Links, graph: "nx.Graph[int]", name: str) -> Iterator[tuple[Way, tuple[Place, Any]]]:
    """Yield each link with its own latency, loss or order (`name`), with the key of this value and the value."""
    for src, dst, attributes in links_with_attributes(graph):
        model = attributes.get(name)
        if model is not None:
            yield (src, dst), (("graph",), edge_model(src, dst, name, model))
    for k, link in enumerate(links.link):
        if (model := dict(link)[name]) is not None:
            for way in link.ways():
                yield way, (("link", k, name), model)
