"""Static communication graphs: frozen models that create a networkx graph of a given number of nodes."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, Self, get_args

from pydantic import Field, ValidationInfo, model_validator

from desim.config.choice import OneOf
from desim.config.model import Flag, Value
from desim.config.trust import resolve_path
from desim.kernel.implicit_complete import complete_graph, is_implicit
from desim.kernel.latency import LATENCIES, Constant, Latency
from desim.kernel.loss import LOSSES, Bernoulli, Loss

if TYPE_CHECKING:
    import networkx as nx

Order = Literal["overtaking", "fifo"]
"""overtaking: a message may overtake an earlier one of its link; fifo: messages arrive in the order sent."""
MAX_NAMES = 10
"""Maximum number of nodes listed in an error message."""
Node = Annotated[int, Field(ge=0, strict=True)]


class GraphModel(Protocol):
    """A graph model: `graph(size)` returns a graph of the nodes 0 .. size - 1; see `Edge` for the edge attributes."""

    def __call__(self, size: int) -> "nx.Graph[int]": ...  # noqa: D102


class Complete(Value):
    """Every node is linked to every other node."""

    kind: Literal["complete"] = "complete"

    def __call__(self, size: int) -> "nx.Graph[int]":
        """Return the graph, which is read-only; O(1) in time and memory."""
        return complete_graph(size)


class Ring(Value):
    """Each node is linked to the next, and the last to the first."""

    kind: Literal["ring"] = "ring"

    def __call__(self, size: int) -> "nx.Graph[int]":
        """Return the graph."""
        import networkx as nx

        graph: nx.Graph[int] = nx.cycle_graph(size) if size > 2 else nx.path_graph(size)
        return graph


class Star(Value):
    """One central node is linked to all others; there are no other links."""

    kind: Literal["star"] = "star"
    centre: Node = 0
    """The central node."""

    def __call__(self, size: int) -> "nx.Graph[int]":
        """Return the graph.

        Raises:
            ValueError: if the central node does not exist.
        """
        import networkx as nx

        if self.centre >= size:
            raise ValueError(f"there is no node {self.centre}: the nodes are 0 .. {size - 1}")
        others = [node for node in range(size) if node != self.centre]
        graph: nx.Graph[int] = nx.star_graph([self.centre, *others])
        return graph


class Grid(Value):
    """A rectangular grid; each node is linked to its horizontal and vertical neighbours; the last row may be short."""

    kind: Literal["grid"] = "grid"
    columns: Annotated[int, Field(ge=1, strict=True)] = 5
    """Nodes in a row; node k is in row k // columns."""

    def __call__(self, size: int) -> "nx.Graph[int]":
        """Return the graph."""
        import networkx as nx

        graph: nx.Graph[int] = nx.empty_graph(size)
        graph.add_edges_from((k, k + 1) for k in range(size - 1) if (k + 1) % self.columns)
        graph.add_edges_from((k, k + self.columns) for k in range(size - self.columns))
        return graph


class Edge(Value):
    """An edge of a graph; its latency, loss and order override those of the network."""

    src: Node
    """The sender, or one end of an undirected edge."""
    dst: Node
    """The receiver, or the other end of an undirected edge."""
    latency: Annotated[Latency, LATENCIES] | None = None
    """One-way latency, s."""
    loss: Annotated[Loss, LOSSES] | None = None
    """Loss model."""
    order: Order | None = None
    """overtaking: a message may overtake an earlier one of this link; fifo: messages arrive in the order sent."""


class Link(Edge):
    """A link with its own latency, loss or order, which overrides that of the network and of the graph's edge."""

    both_ways: Flag = False
    """Whether the link from `dst` to `src` has the same models."""

    @model_validator(mode="after")
    def _differs(self) -> Self:
        if self.latency is None and self.loss is None and self.order is None:
            raise ValueError("should have a latency, a loss or an order of its own")
        return self

    def ways(self) -> list[tuple[int, int]]:
        """Return the directions (sender, receiver) of the link to which its own models apply."""
        return [(self.src, self.dst), *([(self.dst, self.src)] if self.both_ways else [])]


class Edges(Value):
    """A simple graph, given as a list of edges or as a file in node-link JSON or GraphML."""

    kind: Literal["edges"] = "edges"
    edges: tuple[Edge, ...] = ()
    """The edges; each may override the latency, loss and order of the network."""
    file: str | None = None
    """Instead of edges, nodes and directed: path of a node-link JSON (*.json) or GraphML (*.graphml) file, relative to
    the scenario file. The file is read once, when the model is created."""
    nodes: Annotated[int, Field(ge=1, strict=True)] | None = None
    """Number of nodes; if absent, that of the network."""
    directed: Flag = False
    """Whether edges are one-way."""

    @model_validator(mode="before")
    @classmethod
    def _read(cls, given: Any, info: ValidationInfo) -> Any:
        if not isinstance(given, dict) or given.get("file") is None:
            return given
        if beside := [name for name in ("edges", "nodes", "directed") if name in given]:
            raise ValueError(f"should have either a file or {' and '.join(beside)}: a file gives all of them")
        return given | {"file": None} | _fields(_graph_in(resolve_path(given["file"], info)))

    @model_validator(mode="after")
    def _simple(self) -> Self:
        seen: dict[tuple[int, int], int] = {}
        for k, edge in enumerate(self.edges):
            ends = (edge.src, edge.dst) if self.directed else (min(edge.src, edge.dst), max(edge.src, edge.dst))
            if (first := seen.setdefault(ends, k)) != k:
                raise ValueError(f"edges {first} and {k} are parallel: both join nodes {edge.src} and {edge.dst}")
        return self

    @classmethod
    def of(cls, graph: "nx.Graph[int]") -> "Edges":
        """Return a networkx graph with the nodes 0 .. n - 1 as a model; see `Edge` for the edge attributes.

        Raises:
            ValueError: if the graph has other nodes or parallel edges, or an edge attribute is invalid.
        """
        return cls.model_validate(_fields(graph))

    def __call__(self, size: int) -> "nx.Graph[int]":
        """Return the graph.

        Raises:
            ValueError: if `nodes` is given and is not `size`, or an edge names a node that does not exist.
        """
        import networkx as nx

        if self.nodes is not None and self.nodes != size:
            raise ValueError(f"the graph has {self.nodes} nodes, the network {size}")
        graph: nx.Graph[int] = nx.empty_graph(size, create_using=nx.DiGraph if self.directed else nx.Graph)
        for edge in self.edges:
            if max(edge.src, edge.dst) >= size:
                raise ValueError(f"edge {edge.src} to {edge.dst}: the nodes should be 0 .. {size - 1}")
            own = {"latency": edge.latency, "loss": edge.loss, "order": edge.order}
            given = {name: model for name, model in own.items() if model is not None}
            graph.add_edge(edge.src, edge.dst, **given)
        return graph


def _graph_in(file: Path) -> "nx.Graph[Any]":
    import networkx as nx

    try:
        if file.suffix == ".graphml":
            _check_plain(file.read_bytes())
            return nx.read_graphml(file, node_type=int)
        data = json.loads(file.read_text(encoding="utf-8-sig"))
        if not isinstance(data, dict):
            raise ValueError("it should be an object with nodes and edges")
        key = "edges" if "edges" in data else "links"  # networkx before 3.4 writes "links"
        return nx.node_link_graph({**data, "multigraph": True}, edges=key)  # keeps parallel edges, to reject them
    except OSError as error:
        raise ValueError(f"{file} cannot be read: {error.strerror}") from error
    except Exception as error:  # the readers of networkx raise many types of exception for malformed input
        raise ValueError(f"{file} is not a graph in node-link JSON (.json) or GraphML (.graphml): {error}") from error


def _check_plain(xml: bytes) -> None:
    """Raise ValueError if XML declares a document type, whose entities could expand to any amount of text."""
    from xml.parsers.expat import ParserCreate

    def refuse(*_: object) -> None:
        raise ValueError("it should declare no document type (<!DOCTYPE ...>)")

    parser = ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.Parse(xml, True)


def _fields(graph: "nx.Graph[Any]") -> dict[str, Any]:
    """Return a networkx graph as the fields of `Edges`."""
    size = len(graph)
    if set(graph) != set(range(size)):
        raise ValueError(f"the nodes of the graph should be 0 .. {size - 1}, got {node_names(graph)}")
    edges = [
        {"src": int(src), "dst": int(dst)}
        | {name: as_model(name, own[name]) for name in ("latency", "loss", "order") if name in own}
        for src, dst, own in graph.edges(data=True)
    ]
    return {"edges": edges, "nodes": size, "directed": graph.is_directed()}


def node_names(graph: "nx.Graph[Any]") -> str:
    """Return the names of the first nodes of a graph as one line of text, with long names truncated."""
    names = [repr(node)[:20] for node in sorted(graph, key=str)[:MAX_NAMES]]
    return f"[{', '.join([*names, *(['...'] if len(graph) > MAX_NAMES else [])])}]"


def links_with_attributes(graph: "nx.Graph[int]") -> Iterator[tuple[int, int, dict[str, Any]]]:
    """Yield sender, receiver and attributes of each link whose edge has attributes; both ways of an undirected edge."""
    for src, neighbours in () if is_implicit(graph) else graph.adjacency():
        for dst, attributes in neighbours.items():
            if attributes:
                yield src, dst, attributes


def as_model(name: str, value: Any) -> Any:
    """Convert an edge attribute: a number becomes a constant latency (s) or a Bernoulli loss.

    Any other value is returned unchanged.

    Raises:
        ValueError: if the attribute is an invalid order, or a number that is not a valid latency or probability.
    """
    if name == "order" and value not in (None, *get_args(Order)):
        raise ValueError(f"the order of an edge should be {' or '.join(get_args(Order))} (got {value!r})")
    if name == "order" or isinstance(value, bool) or not isinstance(value, int | float):
        return value
    return Constant(value=float(value)) if name == "latency" else Bernoulli(p=float(value))


def edge_model(name: str, value: Any) -> Any:
    """Return an edge attribute as a model, or an order; see `as_model`.

    Raises:
        ValueError: if the attribute is invalid, or no model.
    """
    model = as_model(name, value)
    if name != "order":
        try:
            (LATENCIES if name == "latency" else LOSSES).check(model)
        except ValueError as error:
            raise ValueError(f"the {name} of an edge {error}") from error
    return model


def graph_of(model: GraphModel, size: int) -> "nx.Graph[int]":
    """Return the graph of a model for a network of `size` nodes.

    Raises:
        ValueError: if the model does not return a simple graph of this size, or an edge attribute is invalid.
    """
    import networkx as nx

    graph: object = model(size)
    if not isinstance(graph, nx.Graph):
        raise ValueError(f"should be a simple graph of {size} nodes, got {type(graph).__name__}, not a networkx.Graph")
    if len(graph) != size or graph.is_multigraph():
        raise ValueError(f"should be a simple graph of {size} nodes, got {graph}")
    for _, _, attributes in links_with_attributes(graph):
        for name in ("latency", "loss", "order"):
            if (value := attributes.get(name)) is not None:
                edge_model(name, value)
    return graph


GRAPHS = OneOf(Complete, Ring, Star, Grid, Edges, takes=("size",))
