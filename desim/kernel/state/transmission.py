"""A transmission: a record or a message on its way from one node to others."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from desim.kernel.core.events import Cause
from desim.kernel.core.records import Record
from desim.kernel.state.inbox import Message


class Transmission(NamedTuple):
    """One transmission: a record or a message, with its receivers."""

    number: int
    src: int
    created: int
    """Time of the call of `publish` or `send`, ns."""
    size: int
    """Bytes."""
    receivers: list[int]
    content: Record | Message
    port: str
    """Port of the inbox at which a message arrives; of no meaning for a record."""
    reachable: bool
    """False for a message to one node that, at the call of `send`, was not linked to the sender or, with a range check
    at transmission, was out of range; else True."""
    to_one: bool
    """Whether it is a message to one node."""


Lose = Callable[[Transmission, Mapping[int, Cause]], object]
"""A function that counts the losses of a transmission, given their causes by receiver."""


class Flight(NamedTuple):
    """A transmission and its airtime, ns."""

    transmission: Transmission
    airtime: int
