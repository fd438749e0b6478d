"""What it takes to put a message on the air: frozen models of the airtime that follows from its bytes."""

from math import ceil, inf
from typing import Annotated, ClassVar, Literal, Protocol

from pydantic import Field

from desim.config.choice import OneOf
from desim.config.model import Flag, Limit, Value

MAX_BYTES = 255
"""The payload of a LoRa frame: its length is one byte."""
Count = Annotated[int, Field(ge=0, le=1_000_000, strict=True)]


class Medium(Protocol):
    """What the air is like: `medium(size)` is the airtime of a message of so many bytes, s."""

    @property
    def shared(self) -> bool:
        """Whether all nodes share one channel."""
        ...

    @property
    def half_duplex(self) -> bool:
        """Whether a node is deaf while it transmits."""
        ...

    @property
    def queue_limit(self) -> float:
        """How many messages may wait in a transmitter."""
        ...

    def __call__(self, size: int) -> float: ...  # noqa: D102


class _Radio(Value):
    """What all media share."""

    shared: Flag = False
    """Whether all nodes share one channel, on which one message is on the air at a time."""
    half_duplex: Flag = False
    """Whether a node is deaf while it transmits; on a shared channel nobody else transmits then."""
    queue_limit: Limit = inf
    """How many messages of a node may wait; one more, and the oldest of them is dropped. inf = any number."""


class Unlimited(Value):
    """Messages take no time on the air, whatever their size, and need not wait."""

    shared: ClassVar[bool] = False
    half_duplex: ClassVar[bool] = False
    queue_limit: ClassVar[float] = inf
    kind: Literal["unlimited"] = "unlimited"

    def __call__(self, size: int) -> float:
        """Return 0 s."""
        return 0.0


class Bitrate(_Radio):
    """So many bits a second: 8 (bytes + header) / bitrate."""

    kind: Literal["bitrate"] = "bitrate"
    bitrate: Annotated[float, Field(ge=1, le=1e15, strict=True)]
    """bit/s"""
    header: Count = 0
    """Bytes that the link adds to every message."""

    def __call__(self, size: int) -> float:
        """Return the airtime, s."""
        return 8.0 * (size + self.header) / self.bitrate


class LoRa(_Radio):
    """The airtime of LoRa frames (Semtech, AN1200.22, "LoRa Modulation Basics", and SX1276 datasheet, 4.1.1.7).

    A frame carries at most 255 bytes. A longer message takes ceil(size / 255) frames, each with a preamble and a header
    of its own, one right after the other; they are received or lost together. The bytes that number the frames of a
    message are left out, and so are limits of the duty cycle, such as the 1 % of most European channels at 868 MHz.
    """

    kind: Literal["lora"] = "lora"
    spreading_factor: Annotated[int, Field(ge=7, le=12, strict=True)] = 7
    """SF: a symbol carries so many bits and takes 2^SF / bandwidth."""
    bandwidth: Annotated[float, Field(gt=0, le=1e9, strict=True)] = 125_000.0
    """Hz"""
    coding_rate: Annotated[int, Field(ge=1, le=4, strict=True)] = 1
    """CR: 1 is 4/5, 4 is 4/8."""
    preamble: Count = 8
    """Symbols of the preamble."""
    crc: Flag = True
    """Whether the payload has a checksum."""
    implicit_header: Flag = False
    """Whether the header is left out."""

    def __call__(self, size: int) -> float:
        """Return the airtime of all frames that a message takes, s."""
        full, rest = divmod(size, MAX_BYTES)
        return full * self._frame(MAX_BYTES) + (self._frame(rest) if rest or not full else 0.0)

    def _frame(self, size: int) -> float:
        """Return (preamble + 4.25 + payload symbols) symbol times, s.

        Symbols of more than 16 ms carry two bits less (low data rate optimisation).
        """
        symbol: float = 2**self.spreading_factor / self.bandwidth
        per_block = 4 * (self.spreading_factor - 2 * (symbol > 0.016))
        bits = 8 * size - 4 * self.spreading_factor + 28 + 16 * self.crc - 20 * self.implicit_header
        payload = 8 + max(ceil(bits / per_block) * (self.coding_rate + 4), 0)
        return (self.preamble + 4.25 + payload) * symbol


MEDIA = OneOf(Unlimited, Bitrate, LoRa, needs=("shared", "half_duplex", "queue_limit"))
