"""The links of a network as one value: who is linked to whom, how far word reaches, how long it takes, what is lost."""

from math import inf
from typing import Annotated, Any, Literal

from pydantic import model_validator

from desim.config.model import Extent, Time, Value
from desim.kernel.graphs import GRAPHS, Complete, GraphModel, Link
from desim.kernel.latency import LATENCIES, Constant, Latency
from desim.kernel.loss import LOSSES, Bernoulli, Loss
from desim.kernel.medium import MEDIA, Medium, Unlimited
from desim.kernel.presets import PRESETS
from desim.kernel.reception import RECEPTION_MODELS, Disk, ReceptionModel


class Processing(Value):
    """Time that a message spends at both ends, beside its latency."""

    sender: Time = 0.0
    """From the decision to send to the message's leaving, s."""
    receiver: Time = 0.0
    """From the message's coming in to its being readable, s."""


def _completed(given: Any, table: dict[str, Any]) -> Any:
    """Return a table with what it does not say taken from another of the same kind."""
    alike = isinstance(given, dict) and given.get("kind", table["kind"]) == table["kind"]
    return table | given if alike else given


class Links(Value):
    """What the links of a network are like; the default is the ideal network."""

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
    """A named network whose values stand where this table gives none, illustrative: wifi, lte, 5g, satellite, acoustic,
    lora_sf7 to lora_sf12."""
    graph: Annotated[GraphModel, GRAPHS] = Complete()
    """Who is linked to whom, before range."""
    range: Extent = inf
    """Distance up to which two nodes hear each other, m; inf = any distance."""
    reception: Annotated[ReceptionModel, RECEPTION_MODELS] = Disk()
    """How reception depends on distance and range."""
    fading: Literal["per_link", "message"] = "per_link"
    """Whether chance in the reach is drawn once per pair of nodes, or for every message."""
    range_check: Literal["send", "delivery", "both"] = "send"
    """When the reach is judged: as a message leaves, as it arrives, or both."""
    latency: Annotated[Latency, LATENCIES] = Constant()
    """One-way latency, s."""
    order: Literal["overtaking", "fifo"] = "overtaking"
    """Whether a message may overtake an earlier one of its link, or waits for it."""
    processing: Processing = Processing()
    """Time spent at both ends."""
    loss: Annotated[Loss, LOSSES] = Bernoulli()
    """Which messages are lost."""
    medium: Annotated[Medium, MEDIA] = Unlimited()
    """What it takes to put a message on the air."""
    link: tuple[Link, ...] = ()
    """Links that are not like the rest."""

    @model_validator(mode="before")
    @classmethod
    def _fill_in_preset(cls, given: Any) -> Any:
        preset = given.get("preset") if isinstance(given, dict) else None
        if not isinstance(preset, str) or preset not in PRESETS:
            return given
        tables = {key: _completed(given[key], table) for key, table in PRESETS[preset].items() if key in given}
        return PRESETS[preset] | given | tables
