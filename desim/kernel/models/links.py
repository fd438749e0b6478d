"""The link models of a network as one immutable object: graph, range, reception, latency, loss, medium."""

from collections.abc import Iterable, Iterator, Set
from contextlib import suppress
from math import inf
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, ValidationInfo, field_validator, model_validator

from desim.config.errors import KeyedError, Problem
from desim.config.fresh import fresh_copy
from desim.config.model import Extent, Time, Value
from desim.config.traits import name_of, overrides, positions
from desim.kernel.core.units import nanoseconds
from desim.kernel.measured.base import NamedTable
from desim.kernel.models.coherence import Coherence
from desim.kernel.models.graphs import (
    GRAPHS,
    Complete,
    Edges,
    GraphModel,
    Link,
    Order,
    graph_of,
    is_networkx,
    names_of,
)
from desim.kernel.models.latency import JITTERS, Constant, Latency
from desim.kernel.models.latency_by_link import LATENCIES
from desim.kernel.models.loss import LOSSES, Bernoulli, Loss
from desim.kernel.models.medium import MEDIA, Medium, Unlimited, contends
from desim.kernel.models.presets import PRESETS
from desim.kernel.models.reception import RECEPTION_MODELS, Disk, ReceptionModel
from desim.kernel.models.traits import InterferenceTraits, ReceptionTraits
from desim.kernel.models.transport import TRANSPORTS, BestEffort, Transport

HAVE_POWER = 'with fading = "correlated" it should be disk, log_distance, nakagami or rice, or have a method `received`'
"""The end of the error about a model of reception that does not follow a correlated channel."""
LoRaPreset = Literal["lora_sf7", "lora_sf8", "lora_sf9", "lora_sf10", "lora_sf11", "lora_sf12"]
Owner = TypeVar("Owner", bound=Value)
Place = tuple[str | int, ...]
"""The keys of a value, below `network`."""


class Processing(Value):
    """Processing delays of a message, in addition to its latency."""

    sender: Annotated[Latency, JITTERS] = Constant()
    """Processing delay at the sender, s, drawn for each transmission; the kinds are those of `latency` that do not
    depend on the receiver. A message reaches the queue of its transmitter after this delay. Messages of one sender keep
    their order. A random delay separates messages that several nodes create at one instant."""
    receiver: Time = 0.0
    """Processing delay at the receiver, s."""


def _completed(value: Any, preset: Any) -> Any:
    """Return a user's table with its missing keys, and those of its inner tables, filled in from a preset.

    A value that is not a table, or has another kind than the preset, is returned unchanged.
    """
    are_tables = isinstance(value, dict) and isinstance(preset, dict)
    if not are_tables or value.get("kind", preset.get("kind")) != preset.get("kind"):
        return value
    return preset | {key: _completed(part, preset.get(key)) for key, part in value.items()}


def _numbered(owner: Owner, names: tuple[str, ...], keys: Iterable[str] = ("latency", "loss")) -> Owner:
    """Return an edge or links whose tables of measurements number the nodes in the order of `names`, if they can."""
    numbered: dict[str, NamedTable] = {}
    for key in keys:
        if isinstance(table := getattr(owner, key), NamedTable):
            with suppress(ValueError):  # of a table with other names; `own_links` reports it
                numbered[key] = table.numbered(names)
    changed = {key: table for key, table in numbered.items() if table is not getattr(owner, key)}
    return BaseModel.model_copy(owner, update=changed) if changed else owner


class Links(Value):
    """The models of the links of a network; the default is an ideal network: complete, no latency, no loss."""

    preset: Literal["wifi", "lte", "5g", "satellite", "acoustic", LoRaPreset] | None = None
    """Name of a set of illustrative values that replace the defaults of this table: wifi, lte, 5g, satellite, acoustic,
    lora_sf7 to lora_sf12."""
    graph: Annotated[GraphModel, GRAPHS] = Complete()
    """Communication graph, regardless of range; in Python also a networkx graph."""
    range: Extent = inf
    """Communication range, m; inf = any distance."""
    reception: Annotated[ReceptionModel, RECEPTION_MODELS] = Disk()
    """Probability of reception as a function of distance and range."""
    fading: Literal["per_link", "message", "correlated"] = "per_link"
    """Whether random reception is drawn once per pair of nodes, for every message, or is correlated in time and place
    (`coherence`).

    If in doubt, correlated: message flatters repetitions, and per_link keeps a bad link bad for ever.
    """
    coherence: Coherence = Coherence()
    """How fading and shadowing change with time and place."""
    range_check: Literal["send", "delivery", "both"] = "send"
    """When reception is evaluated: at transmission, on arrival, or both."""
    latency: Annotated[Latency, LATENCIES] = Constant()
    """One-way latency, s."""
    order: Order = "overtaking"
    """overtaking: a message may overtake an earlier one of its link; fifo: messages arrive in the order sent."""
    processing: Processing = Processing()
    """Processing delays at the sender and the receiver."""
    loss: Annotated[Loss, LOSSES] = Bernoulli()
    """Loss model."""
    duplicate: Annotated[Loss, LOSSES] = Bernoulli()
    """Which messages are transmitted twice. The kinds are those of `loss`: a message that such a model would lose gets
    a copy instead, which counts as a message of its own."""
    medium: Annotated[Medium, MEDIA] = Unlimited()
    """Model of the airtime of messages and of access to the channel."""
    transport: Annotated[Transport, TRANSPORTS] = BestEffort()
    """How messages that nodes send to each other are carried, for example retransmitted. Announcements are not such
    messages, unless `announce.dissemination` sends them as messages."""
    link: tuple[Link, ...] = ()
    """Links with their own models."""

    @property
    def delays_start(self) -> bool:
        """Whether a transmission starts only after the processing delay of its sender.

        It need not wait if the delay is constant and the medium has no queues: the receiver's delay then includes it.

        Kept equal to a delay before the queue by
        `tests/kernel/test_hosts.py::test_a_constant_delay_is_that_of_a_model_that_always_draws_it`.
        """
        sender = self.processing.sender
        if type(sender) is not Constant:
            return True
        return nanoseconds(sender.value) > 0 and type(self.medium) is not Unlimited

    @property
    def node_names(self) -> tuple[str, ...]:
        """The names of the nodes, by number: those of the graph, else of the first table of measurements with names."""
        if names := names_of(self.graph):
            return names
        orders = (table.node_order for _, table in self.measured_tables())
        return next((order for order in orders if order), ())

    def measured_tables(self) -> Iterator[tuple[Place, NamedTable]]:
        """Yield the key and the model of each table of measurements, over time or between all nodes."""
        edges = self.graph.edges if isinstance(self.graph, Edges) else ()
        owners: list[tuple[Place, Any]] = [((), self)]
        owners += ((("link", k), link) for k, link in enumerate(self.link))
        owners += ((("graph", "edges", k), edge) for k, edge in enumerate(edges))
        for place, owner in owners:
            for name in ("latency", "loss", *(() if place else ("duplicate",))):
                if isinstance(model := getattr(owner, name), NamedTable):
                    yield (*place, name), model

    def numbered(self, names: tuple[str, ...]) -> "Links":
        """Return the links with all tables of measurements numbering the nodes in the order of `names`.

        A table with other names is unchanged; `desim.kernel.models.own_links` reports it.
        """
        numbered, changed = _numbered(self, names, ("latency", "loss", "duplicate")), dict[str, Any]()
        if (links := tuple(_numbered(link, names) for link in self.link)) != self.link:
            changed["link"] = links
        if isinstance(graph := self.graph, Edges):
            edges = tuple(_numbered(edge, names) for edge in graph.edges)
            if edges != graph.edges:
                changed["graph"] = BaseModel.model_copy(graph, update={"edges": edges})
        return BaseModel.model_copy(numbered, update=changed) if changed else numbered

    @model_validator(mode="after")
    def _check_coherence(self) -> Self:
        """Raise KeyedError if the fading is correlated, but the reception or the coherence lacks something for it."""
        if self.fading != "correlated":
            kind: Any = type(self.reception)
            if overrides(kind, "received", min(positions(kind, "__call__"), default=0)):
                why = (
                    'has its own received, which only fading = "correlated" calls: it should have its own __call__, too'
                )
                raise KeyedError(Problem(f"{name_of(self.reception)} {why}", "reception"))
            return self
        traits = ReceptionTraits.of(self.reception)
        if traits.received is None:
            raise KeyedError(Problem(f"{name_of(self.reception)} has no power that changes: {HAVE_POWER}", "reception"))
        varies = {
            *traits.varies,
            *(InterferenceTraits.of(self.medium.reception).varies if contends(self.medium) else ()),
        }
        if problems := [text for variation in sorted(varies) if (text := self.coherence.lacks(variation))]:
            raise KeyedError(Problem(" and ".join(problems), "coherence"))
        return self

    @property
    def unused_fields(self) -> dict[str, str]:
        """The coherence of a channel that is not correlated."""
        return {} if self.fading == "correlated" else {"coherence": f"fading {self.fading!r}"}

    @model_validator(mode="after")
    def _number_by_graph(self) -> Self:
        if names := names_of(self.graph):
            self.__dict__.update(self.numbered(names).__dict__)
        return self

    def make_graph(self, size: int) -> Any:
        """Return the communication graph of a number of nodes, made by a fresh copy of the graph model.

        Raises:
            ValueError: if the model does not return a simple graph of this size, or an edge attribute is invalid.
        """
        with fresh_copy(self.graph) as graph:
            return graph_of(graph, size)

    @field_validator("graph", mode="before")
    @classmethod
    def _of_networkx(cls, value: Any) -> Any:
        return Edges.of(value) if is_networkx(value) else value

    @field_validator("link", mode="before")
    @classmethod
    def _has_numbers(cls, value: Any, info: ValidationInfo) -> Any:
        """Raise ValueError, with the number of the node, if a link gives the name of a node instead."""
        graph = info.data.get("graph")
        names = names_of(graph)
        for k, link in enumerate(value if isinstance(value, list | tuple) else ()):
            for end in ("src", "dst"):
                node = link.get(end) if isinstance(link, dict) else None
                if isinstance(node, str) and node in names:
                    raise ValueError(
                        f"{end} of link {k} should be a number; the number of {node} is {names.index(node)}"
                    )
        return value

    @model_validator(mode="before")
    @classmethod
    def _fill_in_preset(cls, data: Any) -> Any:
        preset = data.get("preset") if isinstance(data, dict) else None
        if not isinstance(preset, str) or preset not in PRESETS:
            return data
        return _completed(data, PRESETS[preset])

    def _derived(self) -> Set[str]:
        """Return the names of the fields with the value of the preset."""
        if self.preset is None:
            return super()._derived()
        fields, preset_fields = dict(self), dict(type(self)(preset=self.preset))
        return {key for key in PRESETS[self.preset] if fields[key] == preset_fields[key]}
