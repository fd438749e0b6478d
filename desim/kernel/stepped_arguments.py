"""The arguments of a `SteppedNetwork`, checked and converted: nodes, links, faults, walls and horizon.

Each function raises ValueError with a sentence that names the argument.
"""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

from desim.config.arguments import value_text
from desim.config.caller_warnings import warn_caller
from desim.config.errors import KeyedError
from desim.config.model import MAX_TIME, Value
from desim.config.python_numbers import real, whole
from desim.kernel.core.clock import NEVER
from desim.kernel.core.units import nanoseconds
from desim.kernel.graph_files.node_names import numbered
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.fault_plans import FAULTS
from desim.kernel.models.faults import Fault
from desim.kernel.models.graphs import Complete, Edges, is_networkx
from desim.kernel.models.latency import mean_latency
from desim.kernel.models.links import Links
from desim.kernel.walls.wall import Wall

if TYPE_CHECKING:
    import networkx as nx

IMPLAUSIBLE_LATENCY = 10.0
"""Mean latency, s, from which on it was probably given in ms; sound takes so long through 15 km of water."""
LARGEST_NETWORK = 1_000_000
"""Largest number of nodes of a network; it is also that of the pursuers in a scenario."""


class _Tables(Value):
    """The lists of tables that are checked as those of a scenario file."""

    fault: tuple[Annotated[Any, FAULTS], ...] = ()
    wall: tuple[Wall, ...] = ()


def faults_argument(faults: Any) -> tuple[Any, ...]:
    """Return faults as objects; some may be given as dicts."""
    return _checked_tables("fault", faults, "Crash(start=1.0, node=0)")


def walls_argument(walls: Any) -> tuple[Wall, ...]:
    """Return walls as objects; some may be given as dicts."""
    return _checked_tables("wall", walls, "Wall(line=[[0, 0], [4, 0]])")


def _checked_tables(key: str, tables: Any, example: str) -> tuple[Any, ...]:
    """Return checked tables; an error names a key in a table, but not `key`, which is no argument of the caller."""
    if isinstance(tables, str | Mapping | Wall) or not isinstance(tables, Iterable):
        raise ValueError(f"{key}s should be a list of {key}s, such as [{example}] (got {value_text(tables)})")
    try:
        return tuple(getattr(_Tables(**{key: tuple(tables)}), key))
    except KeyedError as error:
        problems = [problem._replace(where="") for problem in error.problems]
    raise KeyedError(*problems)  # not from the first error, whose text names `key`


def links_argument(links: Any) -> Links:
    """Return links as an object; they may be given as a table `[network]` in a dict."""
    if links is None or isinstance(links, Links):
        return links or Links()
    if not isinstance(links, Mapping):
        raise ValueError(
            f"links should be Links(...), or a table [network] as a dict (got {value_text(links)}); those of a"
            " scenario file are load(file).network"
        )
    return Links(**links)


def nodes_argument(nodes: "int | nx.Graph[Any]", links: Links) -> tuple[Links, tuple[Any, ...], dict[Any, int] | None]:
    """Return the links with their graph, the label of each node by number, and its number by label.

    The last is None if the labels are the numbers.
    """
    if not is_networkx(nodes):
        try:
            size = whole(nodes, "nodes")
        except ValueError:
            example = "networkx.complete_graph(['a', 'b']) for nodes with names"
            raise ValueError(
                f"nodes should be their number, or a networkx graph, such as {example} (got {value_text(nodes)})"
            ) from None
        if not 1 <= size <= LARGEST_NETWORK:
            raise ValueError(f"a network should have at least 1 node and at most {LARGEST_NETWORK:,} (got {size:,})")
        _check_unit(links)
        return links, tuple(range(size)), None
    graph: Any = nodes
    if not isinstance(links.graph, Complete):
        raise ValueError("a network has one graph: give it as the nodes or as links.graph, and a number of nodes")
    if not len(graph):
        raise ValueError("a network should have at least 1 node (got an empty graph)")
    edges, numbers = Edges.of(graph), numbered(graph).numbers
    labels = tuple(sorted(numbers, key=numbers.__getitem__))
    links = links.model_copy(update={"graph": edges}).numbered(edges.names)
    _check_unit(links)
    are_numbers = labels == tuple(range(len(labels))) and not any(isinstance(label, bool | float) for label in labels)
    return links, labels, None if are_numbers else numbers


def _check_unit(links: Links) -> None:
    """Warn of a latency that was probably given in ms."""
    edges, names = (links.graph.edges, links.graph.names) if isinstance(links.graph, Edges) else ((), ())
    models = {"network.latency": links.latency, "network.processing.sender": links.processing.sender}
    models |= {f"network.link.{k}.latency": link.latency for k, link in enumerate(links.link) if link.latency}
    for edge in edges:
        if edge.latency:
            ends = (names[end] if end < len(names) else str(end) for end in (edge.src, edge.dst))
            models["the edge from {} to {}".format(*ends)] = edge.latency
    means = {key: mean for key, model in models.items() if (mean := mean_latency(model)) is not None}
    slowest = max(means, key=means.__getitem__, default="")
    if means.get(slowest, 0.0) >= IMPLAUSIBLE_LATENCY:
        warn_caller(f"{slowest}: a mean latency of {means[slowest]:g} s: times are in s, not ms")


def horizon_argument(horizon: float | None, faults: Iterable[Any]) -> int:
    """Return the horizon of plans of faults, ns; `NEVER` if it is None, which requires that there are no plans."""
    if horizon is None:
        plan = next((fault for fault in faults if not isinstance(fault, Fault | ClockSkew)), None)
        if plan is not None:
            raise ValueError(f"{value_text(plan)} needs horizon=, the time until which it draws, s")
        return NEVER
    duration = real(horizon, "horizon")
    if not 0 < duration <= MAX_TIME:
        raise ValueError(f"horizon should be a time above 0 and at most {MAX_TIME:g} s (got {value_text(horizon)})")
    return nanoseconds(duration)
