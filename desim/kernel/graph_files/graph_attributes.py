"""Warnings about attributes of a graph that are not read, with what their author probably meant."""

import re
from collections.abc import Collection, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from desim.config.suggestion import did_you_mean

if TYPE_CHECKING:
    import networkx as nx

READ = ("latency", "loss", "order")
"""The attributes of an edge that are read."""
DRAWN = {"id", "key", "label", "name", "color", "colour", "shape", "shape_type", "size", "viz", "graphics", "style"}
DRAWN |= {"description", "url", "pid", "parents", "thickness", "interaction", "selected", "weight_label"}
"""Attributes that name or draw a node or an edge, without a meaning in a run."""
POSITIONS = {"pos", "position", "x", "y", "z", "lat", "latitude", "lon", "lng", "long", "longitude", "coordinates"}
"""Attributes of nodes with their positions; the sets below have names in the form of `_simple`."""
LATENCY = ("latency", "delay", "linkdelay", "propagationdelay", "lat", "ping")
LOSS = (
    *("loss", "packetloss", "packetlossrate", "packetlossratio", "lossrate", "lossratio", "lossprobability", "plr"),
    *("per", "droprate", "dropprobability", "packeterrorrate", "errorrate"),
)
DELIVERY = ("prr", "pdr", "reliability", "deliveryratio", "receptionratio")
RATE = ("bandwidth", "bitrate", "datarate", "capacity", "throughput", "rate")
MEANT = MappingProxyType(
    dict.fromkeys(LATENCY, "latency, in s")
    | dict.fromkeys(("rtt", "roundtriptime"), "twice the latency, in s")
    | dict.fromkeys(LOSS, "loss, from 0 to 1")
    | dict.fromkeys(DELIVERY, "1 - loss")
    | dict.fromkeys(("jitter", "delayvariation"), "a latency with a kind, such as uniform")
    | dict.fromkeys(RATE, "network.medium, one for all links")
)
"""What an attribute of an edge probably means, by its name in lower case without signs and units."""
UNIT = re.compile(r"[_\s(\[]+(ms|us|ns|s|sec|percent|pct|%|bps|kbps|mbps|gbps)[)\]]?$", re.IGNORECASE)
"""Matches the unit at the end of a name."""


def unread_attributes(graph: "nx.Graph[Any]", *, of_links_only: bool = False) -> tuple[str, ...]:
    """Return the sentences about the attributes of edges, of nodes and of the graph that are not read.

    Args:
        graph: the graph.
        of_links_only: whether to leave out attributes of nodes that seem not to be about links, such as positions.
    """
    of_edges = {name: None for *_, attributes in graph.edges(data=True) for name in attributes}
    of_nodes = {name: None for _, attributes in graph.nodes(data=True) for name in attributes}
    node_names = _link_names(of_nodes) if of_links_only else _node_names(of_nodes)
    return tuple(
        f"{whose} attributes that are not read: {', '.join(names)}; {advice}"
        for whose, names, advice in (
            ("edges have", list(_edge_names(of_edges)), f"those of an edge that are read are {', '.join(READ)}"),
            ("nodes have", list(node_names), "no attribute of a node is read"),
            ("the graph has", list(_link_names(graph.graph)), "give them to its edges"),
        )
        if names
    )


def _edge_names(names: Collection[Any]) -> Iterator[str]:
    for name in map(str, names):
        if name not in READ and name.lower() not in DRAWN:
            yield f"{name}{_meant(name)}"


def _node_names(names: Collection[Any]) -> Iterator[str]:
    for name in map(str, names):
        if name.lower() not in DRAWN and not name.startswith("_"):
            yield f"{name}{' (team.positions has initial positions, in m)' if name.lower() in POSITIONS else ''}"


def _link_names(attributes: Mapping[Any, Any]) -> Iterator[str]:
    """Yield the attributes of a graph, or of its nodes, that seem to be about links."""
    for name in map(str, attributes):
        is_about_links = _simple(name) in MEANT or name.lower() in READ
        if is_about_links and name.lower() not in POSITIONS:  # lat is a latitude here, and a latency of an edge
            yield f"{name}{_meant(name)}"


def _simple(name: str) -> str:
    """Return a name in lower case, without signs and its unit."""
    return re.sub(r"[^a-z]", "", UNIT.sub("", name).lower())


def _meant(name: str) -> str:
    """Return what an attribute of an edge probably means, in parentheses; "" if that is not known."""
    if (meaning := MEANT.get(_simple(name))) is not None:
        return f" (did you mean {meaning}?)"
    hint = did_you_mean(_simple(name), READ)
    return f" ({hint.removeprefix(', ')})" if hint else ""
