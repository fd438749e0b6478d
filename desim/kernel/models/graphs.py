"""Static communication graphs: frozen models that create a networkx graph of a given number of nodes."""

from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, Self, get_args

from pydantic import Field, ModelWrapValidatorHandler, ValidationError, ValidationInfo, model_validator

from desim.config.arguments import value_text
from desim.config.caller_warnings import warn_caller, warn_reader
from desim.config.choice import OneOf
from desim.config.errors import WORDINGS, KeyedError
from desim.config.model import Flag, Value
from desim.config.number_texts import counted, seconds_in
from desim.config.python_numbers import as_python
from desim.config.trust import resolve_path
from desim.kernel.graph_files.graph_attributes import unread_attributes
from desim.kernel.graph_files.graph_file import read_graph
from desim.kernel.graph_files.node_names import numbered
from desim.kernel.models.implicit_complete import complete_graph, is_implicit
from desim.kernel.models.latency import Constant, Latency
from desim.kernel.models.latency_by_link import LATENCIES
from desim.kernel.models.loss import LOSSES, Bernoulli, Loss

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

        # A cycle of one node would be a link of the node to itself.
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
    """A simple graph, given as a list of edges, as a file, or in Python as a networkx graph."""

    kind: Literal["edges"] = "edges"
    edges: tuple[Edge, ...] = ()
    """The edges; each may override the latency, loss and order of the network."""
    file: str | None = None
    """Instead of edges, nodes and names: path of a file in JSON (node-link, adjacency, Cytoscape), GraphML, GEXF, GML,
    TGF or the format of Pajek or METIS, of an edge list, an adjacency list or an adjacency matrix, relative to the
    scenario file. It is read once, when the model is created."""
    nodes: Annotated[int, Field(ge=1, strict=True)] | None = None
    """Number of nodes; if absent, that of the network."""
    directed: Flag = False
    """Whether edges are one-way. With a file, only for lists and matrices: all other formats state it themselves."""
    names: tuple[str, ...] = ()
    """The name of each node, by its number, if the file has names; `desim check` shows them."""

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, data: Any, make: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        if is_networkx(data):
            fields, notes = _fields(data)
            for note in unread_attributes(data, of_links_only=True):  # other attributes of nodes may be positions
                warn_caller(note)
        elif isinstance(data, dict) and data.get("file") is not None:
            if excluded := [name for name in ("edges", "nodes", "names") if name in data]:
                raise ValueError(f"should have either a file or {' and '.join(excluded)}: a file gives all of them")
            # A model without the file validates `directed`, which the reader of the file needs.
            directed = make(data | {"file": None}).directed if "directed" in data else None
            file = resolve_path(data["file"], info)
            graph = read_graph(file, directed)
            try:
                fields, notes = _fields(graph)
            except ValueError as error:
                raise ValueError(f"{file}: {error}") from error
            told = unread_attributes(graph, of_links_only=True)
            if directed is None and _is_one_way(graph):  # a user who states `directed` means it
                notes, told = (*notes, ONE_WAY), (*told, ONE_WAY)
            for note in told:
                warn_reader(f"{file}: {note}", info)
            fields = data | {"file": None} | fields
        else:
            return make(data)
        model = make(fields)
        model.__dict__["notes"] = notes  # no field, so it is not a part of the identity of the model
        return model

    @model_validator(mode="after")
    def _simple(self) -> Self:
        if self.names and self.nodes is not None and len(self.names) != self.nodes:
            nodes, names = counted(self.nodes, "node"), counted(len(self.names), "name")
            raise ValueError(f"names should be one per node (got {names} for {nodes})")
        first_by_ends: dict[tuple[int, int], int] = {}
        for k, edge in enumerate(self.edges):
            ends = (edge.src, edge.dst) if self.directed else (min(edge.src, edge.dst), max(edge.src, edge.dst))
            if (first := first_by_ends.setdefault(ends, k)) != k:
                src, dst = (self.names[end] if end < len(self.names) else end for end in (edge.src, edge.dst))
                raise ValueError(f"edges {first} and {k} are parallel: both join nodes {src} and {dst}")
        return self

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Warnings about the file or graph that the model was made of: attributes not read, shifted numbers."""
        return ()

    @classmethod
    def of(cls, graph: "nx.Graph[Any]") -> "Edges":
        """Return a networkx graph as a model; see `Edge` for the edge attributes.

        The nodes 0 .. n - 1 keep their numbers; other nodes get numbers, and `names` then has their names; see
        `desim.kernel.graph_files.node_names`.

        Raises:
            ValueError: if the graph has parallel edges that differ, or an edge attribute is invalid.
        """
        try:
            return cls.model_validate(graph)
        except ValidationError as error:
            problems = WORDINGS["call"](error, cls, {})
        raise KeyedError(*problems)

    def __call__(self, size: int) -> "nx.Graph[int]":
        """Return the graph.

        Raises:
            ValueError: if `nodes` or `names` is given for another size, or an edge names a node that does not exist.
        """
        import networkx as nx

        nodes = self.nodes if self.nodes is not None else len(self.names) or size
        if nodes != size:
            raise ValueError(f"the graph has {counted(nodes, 'node')}, the network {size}")
        graph: nx.Graph[int] = nx.empty_graph(size, create_using=nx.DiGraph if self.directed else nx.Graph)
        for edge in self.edges:
            if max(edge.src, edge.dst) >= size:
                raise ValueError(f"edge {edge.src} to {edge.dst}: the nodes should be 0 .. {size - 1}")
            models = {"latency": edge.latency, "loss": edge.loss, "order": edge.order}
            attributes = {name: model for name, model in models.items() if model is not None}
            graph.add_edge(edge.src, edge.dst, **attributes)
        return graph


def is_networkx(value: Any) -> bool:
    """Return whether a value is a networkx graph, without importing networkx, which is slow."""
    return hasattr(value, "is_multigraph") and hasattr(value, "adjacency") and not isinstance(value, type)


def _fields(graph: "nx.Graph[Any]") -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return a networkx graph as the fields of `Edges`, and the warnings about it."""
    numbering = numbered(graph)
    numbers, notes = numbering.numbers, list(unread_attributes(graph))
    if numbering.is_shifted:
        notes.append(
            f"its nodes have the numbers {numbering.names[0]} .. {numbering.names[-1]}, and here 0 .. {len(graph) - 1},"
            " in the same order (`names`)"
        )
    edges = list[dict[str, Any]]()
    models_by_ends: dict[tuple[int, int], dict[str, Any]] = {}
    for src, dst, attributes in graph.edges(data=True):
        models: dict[str, Any] = {
            name: _attribute(src, dst, name, attributes[name])
            for name in ("latency", "loss", "order")
            if name in attributes
        }
        ends = numbers[src], numbers[dst]
        first_models = models_by_ends.setdefault(ends if graph.is_directed() else (min(ends), max(ends)), models)
        # A repeated edge with equal models is left out. One with other models is kept, and `Edges` refuses it.
        if first_models is models or first_models != models:
            edges.append({"src": ends[0], "dst": ends[1]} | models)
    if repeated := graph.number_of_edges() - len(edges):
        notes.append(f"{repeated} of its edges repeat another one, with equal latency, loss and order, and count once")
    fields = {"edges": edges, "nodes": len(graph), "directed": graph.is_directed()}
    return fields | ({"names": numbering.names} if numbering.names else {}), tuple(notes)


ONE_WAY = (
    "all edges are one-way, because the file says that its graph is directed, as programs that draw graphs do by"
    " default: if links hold both ways, change it to undirected"
)
"""The warning about a file whose edges are all one-way."""


def _is_one_way(graph: "nx.Graph[Any]") -> bool:
    """Return whether a graph is directed and has several edges, and no edge has a reverse edge."""
    return (
        graph.is_directed()
        and graph.number_of_edges() > 1
        and not any(graph.has_edge(dst, src) for src, dst in graph.edges())
    )


def node_names(graph: "nx.Graph[Any]") -> str:
    """Return the names of the first nodes of a graph as one line of text, with long names truncated."""
    names = [value_text(node)[:20] for node in sorted(graph, key=str)[:MAX_NAMES]]
    return f"[{', '.join([*names, *(['...'] if len(graph) > MAX_NAMES else [])])}]"


def links_with_attributes(graph: "nx.Graph[int]") -> Iterator[tuple[int, int, dict[str, Any]]]:
    """Yield sender, receiver and attributes of each link whose edge has attributes; both ways of an undirected edge."""
    for src, neighbours in () if is_implicit(graph) else graph.adjacency():
        for dst, attributes in neighbours.items():
            if attributes:
                yield src, dst, attributes


def as_model(name: str, value: Any) -> Any:
    """Convert an edge attribute: a number becomes a constant latency (s) or a Bernoulli loss.

    A latency as a text with its unit, such as "5 ms", counts as a number. Any other value is returned unchanged.

    Raises:
        ValueError: if the attribute is an invalid order, or a number that is not a valid latency or probability.
    """
    if name == "order" and value not in (None, *get_args(Order)):
        raise ValueError(f"the order of an edge should be {' or '.join(get_args(Order))} (got {value_text(value)})")
    number = value if name == "order" or callable(value) else as_python(value)
    if name == "latency" and isinstance(number, str):
        number = seconds_in(number)
    if type(number) is not int and type(number) is not float:  # a boolean is no number
        return value
    return Constant(value=number) if name == "latency" else Bernoulli(p=number)


def _attribute(src: Any, dst: Any, name: str, value: Any) -> Any:
    """Convert an attribute of the edge between two nodes; see `as_model`."""
    try:
        return as_model(name, value)
    except KeyedError as error:
        raise ValueError(f"the {name} of the edge from {src} to {dst}: {error.reason}") from None


def edge_model(src: int, dst: int, name: str, value: Any) -> Any:
    """Return the model that an edge attribute stands for: a number, the table or the name of a kind, or a model.

    Raises:
        ValueError: if the attribute is not valid; the message names the edge and the attribute.
    """
    if name == "order":
        return as_model(name, value)
    try:
        model = as_model(name, value)
        if not callable(model):  # a table or a name: an edge makes a model of it
            return dict(Edge(src=0, dst=0, **{name: model}))[name]
        (LATENCIES if name == "latency" else LOSSES).check(model)
    except KeyedError as error:
        raise ValueError(f"the {name} of the edge from {src} to {dst}: {error.reason}") from None
    except ValueError as error:
        raise ValueError(f"the {name} of the edge from {src} to {dst} {error}") from error
    return model


def graph_of(model: GraphModel, size: int) -> "nx.Graph[int]":
    """Return the graph of a model for a network of `size` nodes.

    Raises:
        ValueError: if the model does not return a simple graph of this size, or an edge attribute is invalid.
    """
    import networkx as nx

    graph: object = model(size)
    if not isinstance(graph, nx.Graph) or len(graph) != size or graph.is_multigraph():
        kind = graph if isinstance(graph, nx.Graph) else f"{type(graph).__name__}, not a networkx.Graph"
        raise ValueError(f"should be a simple graph of {counted(size, 'node')}, got {kind}")
    for src, dst, attributes in links_with_attributes(graph):
        for name in ("latency", "loss", "order"):
            if (value := attributes.get(name)) is not None:
                edge_model(src, dst, name, value)
    return graph


def names_of(graph: Any) -> tuple[str, ...]:
    """Return the names of the nodes of a model of graphs, in the order of their numbers; empty if they have none."""
    return graph.names or () if isinstance(graph, Edges) else ()


GRAPHS = OneOf(Complete, Ring, Star, Grid, Edges, takes=("size",))
