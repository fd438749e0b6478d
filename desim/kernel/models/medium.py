"""Models of the medium: the airtime of a message of a given size, and how nodes share the channel."""

from collections.abc import Callable
from math import ceil, inf
from typing import Annotated, Any, ClassVar, Literal, Protocol, TypeGuard

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from desim.config.answers import wrong_answer
from desim.config.arrays import Bools, Integers
from desim.config.choice import OneOf
from desim.config.errors import KeyedError, Problem
from desim.config.model import MAX_TIME, AnyOrder, FirstError, Flag, Limit, Value
from desim.config.number_texts import counted
from desim.config.python_numbers import as_real
from desim.config.traits import inherits, is_ours
from desim.kernel.models.access import ACCESSES, Access, Channel, Ideal
from desim.kernel.models.graphs import Node
from desim.kernel.models.interference import INTERFERENCES, Collision, Interference, LoRaInterference, LoRaSignal
from desim.kernel.models.traits import MediumTraits

TUNING = 0.25
"""Largest difference of the frequencies of a LoRa frame and a radio that receives it, in bandwidths (SX1276 datasheet,
4.1.5)."""
MAX_BYTES = 255
"""Maximum payload of a LoRa frame, whose length field is one byte."""
MANY = 0.5
"""A warning is given if at least this share of the frames of one instant overlap."""
Overhead = Annotated[int, Field(ge=0, le=1_000_000, strict=True)]
SpreadingFactor = Annotated[int, Field(ge=7, le=12, strict=True)]


class Medium(Protocol):
    """A model of the medium: `medium(size)` is the airtime (s) of a message of `size` bytes."""

    @property
    def shared(self) -> bool:
        """Whether all nodes share one channel."""

    @property
    def half_duplex(self) -> bool:
        """Whether a node cannot receive while it transmits."""

    @property
    def queue_limit(self) -> float:
        """Maximum number of waiting messages per node."""

    def __call__(self, size: int) -> float: ...  # noqa: D102


class Radio(Value):
    """The fields of all media with airtime."""

    shared: Flag = False
    """Whether all nodes share one channel, which carries one message at a time."""
    half_duplex: Flag = False
    """Whether a node cannot receive while it transmits. It has no effect on a shared channel. Nodes that contend
    (`access`) never receive while they transmit."""
    queue_limit: Limit = inf
    """Maximum number of waiting messages per node; inf = unlimited. The message that is transmitted or contends does
    not count. If the queue is full, its oldest message is dropped.

    If in doubt, 1 for messages of which only the newest counts, else 100; with inf, an overloaded node sends ever older
    messages.
    """
    access: Annotated[Access, ACCESSES] = Ideal()
    """When a node may transmit. With any model but `ideal`, all nodes contend for one channel, and frames that overlap
    interfere."""
    reception: Annotated[Interference, INTERFERENCES] = Collision()
    """Which of several overlapping frames a receiver gets; no effect with `access.kind` "ideal"."""

    duty_cycle: Annotated[float, Field(ge=1e-6, le=1, strict=True)] | None = None
    """Largest share of the time that a node transmits, in [1e-6, 1]: after a frame of airtime T it is silent for T (1 /
    duty_cycle - 1). An acknowledgement is transmitted at once, and lengthens the silence by its airtime / duty_cycle.
    Only with `access` other than `ideal`; None: no limit.

    If in doubt, None; 0.01 is the law in most of the European band at 868 MHz.
    """

    @field_validator("access")
    @classmethod
    def _shares_once(cls, access: Access, info: ValidationInfo) -> Access:
        if info.data.get("shared") and not isinstance(access, Ideal):
            raise ValueError(
                f"nodes contend for one channel with the kind {access.kind!r}, and shared = true makes the channel an"
                " ideal queue: leave out one of them"
            )
        return access

    @field_validator("reception")
    @classmethod
    def _fits_medium(cls, reception: Interference) -> Interference:
        if isinstance(reception, LoRaInterference) and not issubclass(cls, LoRa):
            raise ValueError(
                "the kind 'lora' needs a medium of the kind 'lora'; allowed with this medium: collision, capture, sinr"
            )
        return reception

    @field_validator("duty_cycle")
    @classmethod
    def _limits_nodes_that_contend(cls, duty_cycle: float | None, info: ValidationInfo) -> float | None:
        if duty_cycle is not None and isinstance(info.data.get("access"), Ideal):
            raise ValueError(
                "a duty cycle, given or from a preset such as lora_sf7, needs nodes that contend: access.kind should"
                " not be 'ideal'"
            )
        return duty_cycle

    def check(self, size: int) -> None:
        """Raise KeyedError if the medium does not apply to a network of `size` nodes."""

    def airtime(self, size: int, node: int) -> float:
        """Return the airtime, s, of a message of `size` bytes that a node transmits."""
        return self(size)

    def interval(self, size: int, nodes: int) -> float:
        """Return the time, s, for which a message of `size` bytes keeps one of `nodes` nodes from sending the next one.

        It is the airtime, with the silence after it if there is a duty cycle, and with TDMA at least a round of slots.
        """
        return self.access.interval(airtime_of(self, size, nodes) / (self.duty_cycle or 1.0), nodes)

    def occupancy(self, size: int, nodes: int, *, to_one: bool = False) -> float:
        """Return the least time, s, for which a message of `size` bytes of one of `nodes` nodes occupies the channel.

        It is the airtime with what the access adds to each frame: whole slots of slotted ALOHA, and with CSMA/CA the
        interframe space before it and, for a message to one node (`to_one`), its acknowledgement.
        """
        return self.access.occupancy(airtime_of(self, size, nodes), to_one=to_one)

    def __call__(self, size: int) -> float:
        """Return the airtime, s."""
        raise NotImplementedError

    @property
    def contends(self) -> bool:
        """Whether nodes contend for one channel."""
        return not isinstance(self.access, Ideal)


def contends(medium: Medium) -> TypeGuard[Radio]:
    """Return whether nodes contend for the channel of a medium; a user's medium must be a `Radio` for this."""
    return isinstance(medium, Radio) and medium.contends


def channel_of(medium: Medium, airtime: float) -> Channel | None:
    """Return how frames of an airtime (s) overlap on a medium; None if they do not."""
    if not isinstance(medium, Radio):
        return None
    if medium.contends:
        return medium.access.channel(airtime)
    return Channel(airtime, airtime) if medium.half_duplex and not medium.shared else None


class Unlimited(Value):
    """Messages of any size have zero airtime and never wait."""

    shared: ClassVar[bool] = False
    half_duplex: ClassVar[bool] = False
    queue_limit: ClassVar[float] = inf
    kind: Literal["unlimited"] = "unlimited"

    def __call__(self, size: int) -> float:
        """Return 0 s."""
        return 0.0


class Bitrate(Radio):
    """A constant bit rate: the airtime is 8 (size + header) / bitrate."""

    kind: Literal["bitrate"] = "bitrate"
    bitrate: Annotated[float, Field(ge=1, le=1e15, strict=True)]
    """Bit rate, bit/s.

    If in doubt, 6e6, the rate of broadcasts in 802.11g; 2.5e5 in 802.15.4.
    """
    header: Overhead = 0
    """Bytes that the link layer adds to every message."""

    def __call__(self, size: int) -> float:
        """Return the airtime, s."""
        return 8.0 * (size + self.header) / self.bitrate


class LoRa(Radio):
    """The airtime of LoRa frames (Semtech, AN1200.22, "LoRa Modulation Basics", and SX1276 datasheet, 4.1.1.7).

    A frame carries at most 255 bytes. A longer message takes ceil(size / 255) frames, sent back to back, each with its
    own preamble and header; all frames of a message are received or lost together. Not modelled: the bytes that number
    the frames of a message.
    """

    kind: Literal["lora"] = "lora"
    spreading_factor: SpreadingFactor = 7
    """SF: bits per symbol; a symbol takes 2^SF / bandwidth. A gain in range by a large SF is not modelled: set `range`.

    If in doubt, 7: each step almost doubles the airtime.
    """
    spreading_factors: Annotated[tuple[SpreadingFactor, ...], FirstError()] | None = None
    """SF of each node, for nodes that contend; if None, all have `spreading_factor`."""
    frequencies: Annotated[tuple[Annotated[float, Field(gt=0, le=1e12, strict=True)], ...], FirstError()] | None = None
    """Carrier frequency of each node, Hz, for nodes that contend; if None, all are equal."""
    gateways: Annotated[Annotated[tuple[Node, ...], FirstError()] | None, AnyOrder()] = None
    """Nodes that hear all spreading factors and frequencies, for nodes that contend. Each other node has one radio: it
    hears only frames with its own spreading factor and a frequency within a quarter of the bandwidth of its own. It
    loses other frames ("tuning"). If None, all nodes are gateways."""
    bandwidth: Annotated[float, Field(ge=1, le=1e9, strict=True)] = 125_000.0
    """Hz"""
    coding_rate: Annotated[int, Field(ge=1, le=4, strict=True)] = 1
    """CR: the code rate is 4 / (4 + CR), from 4/5 to 4/8."""
    preamble: Overhead = 8
    """Number of preamble symbols."""
    crc: Flag = True
    """Whether the payload has a checksum."""
    implicit_header: Flag = False
    """Whether the header is omitted."""

    @field_validator("spreading_factors", "frequencies", "gateways")
    @classmethod
    def _differ_only_if_they_contend(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None and isinstance(info.data.get("access"), Ideal):
            raise ValueError("nodes may differ only if they contend: access.kind should not be 'ideal'")
        return value

    def __call__(self, size: int) -> float:
        """Return the airtime, s, of all frames of a message with the largest spreading factor of the nodes."""
        return self._message_airtime(size, max(self.spreading_factors or (self.spreading_factor,)))

    def check(self, size: int) -> None:
        """Raise KeyedError if the medium does not apply to a network of `size` nodes."""
        for name in ("spreading_factors", "frequencies"):
            if (per_node := vars(self)[name]) is not None and len(per_node) != size:
                raise KeyedError(
                    Problem(f"should have one for each of {counted(size, 'node')} (got {len(per_node)})", name)
                )

        if unknown := sorted({*(self.gateways or ())}.difference(range(size))):
            raise KeyedError(Problem(f"there is no node {unknown[0]}: the nodes are 0 .. {size - 1}", "gateways"))

    @property
    def is_tuned(self) -> bool:
        """Whether the radios of some nodes do not hear all frames."""
        return self.gateways is not None and not (self.spreading_factors is None and self.frequencies is None)

    def hears(self, src: int, nodes: Integers) -> Bools:
        """Return (k,) whether the radio of each of k nodes is tuned to the frames of the node `src`."""
        sent, gateways = self.signal(src), self.gateways or ()

        def is_heard_by(node: int) -> bool:
            tuned = self.signal(node)
            is_near = abs(tuned.frequency - sent.frequency) <= TUNING * sent.bandwidth
            return node in gateways or (is_near and tuned.spreading_factor == sent.spreading_factor)

        return np.array([*map(is_heard_by, nodes.tolist())], dtype=bool)

    def airtime(self, size: int, node: int) -> float:
        """Return the airtime, s, of a message of `size` bytes that a node transmits."""
        return self._message_airtime(size, self.signal(node).spreading_factor)

    def signal(self, node: int) -> LoRaSignal:
        """Return the parameters of the frames of a node."""
        factor = self.spreading_factor if self.spreading_factors is None else self.spreading_factors[node]
        frequency = 0.0 if self.frequencies is None else self.frequencies[node]
        return LoRaSignal(factor, self.bandwidth, frequency, self.preamble)

    def _message_airtime(self, size: int, factor: int) -> float:
        full_frames, remainder = divmod(size, MAX_BYTES)
        last_airtime = self._frame_airtime(remainder, factor) if remainder or not full_frames else 0.0
        return full_frames * self._frame_airtime(MAX_BYTES, factor) + last_airtime

    def _frame_airtime(self, size: int, factor: int) -> float:
        """Return the airtime, s, of one frame: preamble + 4.25 + payload, in symbols, times the duration of a symbol.

        Symbols longer than 16 ms carry two bits fewer (low data rate optimisation).
        """
        symbol_time: float = 2**factor / self.bandwidth
        bits_per_block = 4 * (factor - 2 * (symbol_time > 0.016))
        bits = 8 * size - 4 * factor + 28 + 16 * self.crc - 20 * self.implicit_header
        payload = 8 + max(ceil(bits / bits_per_block) * (self.coding_rate + 4), 0)
        return (self.preamble + 4.25 + payload) * symbol_time


def airtime_of(medium: Medium, size: int, nodes: int) -> float:
    """Return the longest airtime, s, of a message of `size` bytes that one of `nodes` nodes transmits.

    It is limited to `MAX_TIME`, which is longer than any run. A medium of a user with its own method `airtime` is asked
    for each node.

    Raises:
        ValueError: if the medium returns anything else than a finite time of at least 0 s, or does not apply to a
            network of this size.
    """
    if is_ours(type(medium)) or MediumTraits.of(medium).airtime is None or inherits(medium, Radio, "airtime"):
        return _checked(medium(size), medium)
    if isinstance(medium, Radio):
        medium.check(nodes)
    airtime = airtimes(medium)
    return max(airtime(size, node) for node in range(nodes))


def airtimes(medium: Medium) -> Callable[[int, int], float]:
    """Return a function of the size of a message, bytes, and the node that transmits it: the airtime, s.

    The function raises ValueError as `airtime_of` does.
    """
    node_airtime = MediumTraits.of(medium).airtime
    if node_airtime is None or (is_ours(type(medium)) and not contends(medium)):  # then nodes do not differ
        return lambda size, _: _checked(medium(size), medium)
    return lambda size, node: _checked(node_airtime(size, node), medium)


def _checked(airtime: Any, medium: Medium) -> float:
    number = airtime if type(airtime) is float else as_real(airtime)
    if 0.0 <= number < inf:
        return min(number, MAX_TIME)
    raise wrong_answer("an airtime should be a finite time >= 0 s", airtime, medium)


MEDIA = OneOf(
    Unlimited, Bitrate, LoRa, needs=("shared", "half_duplex", "queue_limit"), takes=("size",), traits=MediumTraits
)
