"""The link models of a network as one immutable object: graph, range, reception, latency, loss, medium."""

from collections.abc import Set
from math import inf
from typing import Annotated, Any, Literal

from pydantic import field_validator, model_validator

from desim.config.fresh import fresh_copy
from desim.config.model import Extent, Time, Value
from desim.kernel.graphs import GRAPHS, Complete, Edges, GraphModel, Link, Order, graph_of, is_networkx
from desim.kernel.latency import LATENCIES, Constant, Latency
from desim.kernel.loss import LOSSES, Bernoulli, Loss
from desim.kernel.medium import MEDIA, Medium, Unlimited
from desim.kernel.presets import PRESETS
from desim.kernel.reception import RECEPTION_MODELS, Disk, ReceptionModel
from desim.kernel.transport import TRANSPORTS, BestEffort, Transport


class Processing(Value):
    """Processing delays of a message, in addition to its latency."""

    sender: Time = 0.0
    """Processing delay at the sender, s."""
    receiver: Time = 0.0
    """Processing delay at the receiver, s."""


def _completed(given: Any, table: dict[str, Any]) -> Any:
    """Return a given table, with the keys that it and the tables in it lack filled in from a preset.

    `table` is the table of the preset. A given value that is not a table, or has another kind, is returned unchanged.
    """
    if not isinstance(given, dict) or given.get("kind", table["kind"]) != table["kind"]:
        return given
    return table | given | _tables_completed(given, table)


def _tables_completed(given: dict[str, Any], preset: dict[str, Any]) -> dict[str, Any]:
    """Return the given values of the keys that are tables in a preset, completed from it."""
    return {
        key: _completed(given[key], table) for key, table in preset.items() if key in given and isinstance(table, dict)
    }


class Links(Value):
    """The models of the links of a network; the default is an ideal network: complete, no latency, no loss."""

    preset: (
        Literal[
            "wifi",
            "lte",
            "5g",
            "satellite",
            "acoustic",
            "lora_sf7",
            "lora_sf8",
            "lora_sf9",
            "lora_sf10",
            "lora_sf11",
            "lora_sf12",
        ]
        | None
    ) = None
    """Name of a set of illustrative values that replace the defaults of this table: wifi, lte, 5g, satellite, acoustic,
    lora_sf7 to lora_sf12."""
    graph: Annotated[GraphModel, GRAPHS] = Complete()
    """Communication graph, regardless of range; in Python also a networkx graph."""
    range: Extent = inf
    """Communication range, m; inf = any distance."""
    reception: Annotated[ReceptionModel, RECEPTION_MODELS] = Disk()
    """Probability of reception as a function of distance and range."""
    fading: Literal["per_link", "message"] = "per_link"
    """Whether random reception is drawn once per pair of nodes, or for every message."""
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
    """Which messages are transmitted twice, by the kinds of `loss`: instead of being lost, a message gets a copy, which
    counts as a message of its own."""
    medium: Annotated[Medium, MEDIA] = Unlimited()
    """Model of the airtime of messages and of access to the channel."""
    transport: Annotated[Transport, TRANSPORTS] = BestEffort()
    """How messages that nodes send to each other are carried, for example retransmitted. Announcements are not such
    messages, unless `announce.dissemination` sends them as messages."""
    link: tuple[Link, ...] = ()
    """Links with their own models."""

    def make_graph(self, size: int) -> Any:
        """Return the communication graph of a number of nodes, from a graph model that is as it was at the start.

        Raises:
            ValueError: if the model does not return a simple graph of this size, or an edge attribute is invalid.
        """
        with fresh_copy(self.graph) as graph:
            return graph_of(graph, size)

    @field_validator("graph", mode="before")
    @classmethod
    def _of_networkx(cls, given: Any) -> Any:
        return Edges.of(given) if is_networkx(given) else given

    @model_validator(mode="before")
    @classmethod
    def _fill_in_preset(cls, given: Any) -> Any:
        preset = given.get("preset") if isinstance(given, dict) else None
        if not isinstance(preset, str) or preset not in PRESETS:
            return given
        return PRESETS[preset] | given | _tables_completed(given, PRESETS[preset])

    def _derived(self) -> Set[str]:
        """Return the names of the fields with the value that the preset stands for."""
        if self.preset is None:
            return super()._derived()
        own, stands_for = dict(self), dict(type(self)(preset=self.preset))
        return {key for key in PRESETS[self.preset] if own[key] == stands_for[key]}
