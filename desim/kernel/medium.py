"""Models of the medium: the airtime of a message of a given size, and how nodes share the channel."""

from math import ceil, inf
from typing import Annotated, ClassVar, Literal, Protocol

from pydantic import Field

from desim.config.choice import OneOf
from desim.config.model import Flag, Limit, Value

MAX_BYTES = 255
"""Maximum payload of a LoRa frame, whose length field is one byte."""
Count = Annotated[int, Field(ge=0, le=1_000_000, strict=True)]


class Medium(Protocol):
    """A model of the medium: `medium(size)` is the airtime (s) of a message of `size` bytes."""

    @property
    def shared(self) -> bool:
        """Whether all nodes share one channel."""
        ...

    @property
    def half_duplex(self) -> bool:
        """Whether a node cannot receive while it transmits."""
        ...

    @property
    def queue_limit(self) -> float:
        """Maximum number of waiting messages per node."""
        ...

    def __call__(self, size: int) -> float: ...  # noqa: D102


class _Radio(Value):
    """The fields of all media with airtime."""

    shared: Flag = False
    """Whether all nodes share one channel, which carries one message at a time."""
    half_duplex: Flag = False
    """Whether a node cannot receive while it transmits; no effect on a shared channel."""
    queue_limit: Limit = inf
    """Maximum number of waiting messages per node; beyond it the oldest is dropped; inf = unlimited."""


class Unlimited(Value):
    """Messages of any size have zero airtime and never wait."""

    shared: ClassVar[bool] = False
    half_duplex: ClassVar[bool] = False
    queue_limit: ClassVar[float] = inf
    kind: Literal["unlimited"] = "unlimited"

    def __call__(self, size: int) -> float:
        """Return 0 s."""
        return 0.0


class Bitrate(_Radio):
    """A constant bit rate: the airtime is 8 (size + header) / bitrate."""

    kind: Literal["bitrate"] = "bitrate"
    bitrate: Annotated[float, Field(ge=1, le=1e15, strict=True)]
    """bit/s"""
    header: Count = 0
    """Bytes that the link layer adds to every message."""

    def __call__(self, size: int) -> float:
        """Return the airtime, s."""
        return 8.0 * (size + self.header) / self.bitrate


class LoRa(_Radio):
    """The airtime of LoRa frames (Semtech, AN1200.22, "LoRa Modulation Basics", and SX1276 datasheet, 4.1.1.7).

    A frame carries at most 255 bytes. A longer message takes ceil(size / 255) frames, sent back to back, each with its
    own preamble and header; they are received or lost together. Not modelled: the bytes that number the frames of a
    message, and duty cycle limits, such as the 1 % of most European channels at 868 MHz.
    """

    kind: Literal["lora"] = "lora"
    spreading_factor: Annotated[int, Field(ge=7, le=12, strict=True)] = 7
    """SF: bits per symbol; a symbol takes 2^SF / bandwidth."""
    bandwidth: Annotated[float, Field(gt=0, le=1e9, strict=True)] = 125_000.0
    """Hz"""
    coding_rate: Annotated[int, Field(ge=1, le=4, strict=True)] = 1
    """CR: the code rate is 4 / (4 + CR), from 4/5 to 4/8."""
    preamble: Count = 8
    """Number of preamble symbols."""
    crc: Flag = True
    """Whether the payload has a checksum."""
    implicit_header: Flag = False
    """Whether the header is omitted."""

    def __call__(self, size: int) -> float:
        """Return the airtime, s, of all frames of a message."""
        full, rest = divmod(size, MAX_BYTES)
        return full * self._frame(MAX_BYTES) + (self._frame(rest) if rest or not full else 0.0)

    def _frame(self, size: int) -> float:
        """Return the airtime, s, of one frame: preamble + 4.25 + payload, in symbols, times the duration of a symbol.

        Symbols longer than 16 ms carry two bits fewer (low data rate optimisation).
        """
        symbol: float = 2**self.spreading_factor / self.bandwidth
        per_block = 4 * (self.spreading_factor - 2 * (symbol > 0.016))
        bits = 8 * size - 4 * self.spreading_factor + 28 + 16 * self.crc - 20 * self.implicit_header
        payload = 8 + max(ceil(bits / per_block) * (self.coding_rate + 4), 0)
        return (self.preamble + 4.25 + payload) * symbol


MEDIA = OneOf(Unlimited, Bitrate, LoRa, needs=("shared", "half_duplex", "queue_limit"))
