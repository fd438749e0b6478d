"""The frames of transports: what a sender and a receiver transmit, and how many bytes each frame has.

The header of a message (`desim.kernel.core.message_size`) has its sender, its sequence number and the time at which it
was sent. A frame adds, in bytes:

    segment          8: 4 for the session, 4 for the oldest number that the receiver may still get
    skip             8: the same; there is no body
    acknowledgement  8: 4 for the session, 4 for the next expected number; 8 more for each 64 numbers of the window, if
                     it is larger than 1: a bit for each message received beyond the expected one
    piece            8: 4 for the session, 4 for its number, n and k

A port is not counted, as elsewhere.
"""

from typing import Any, NamedTuple

from desim.kernel.core.message_size import HEADER, NUMBER

FRAME = 8
"""Bytes that a frame adds to the header of a message."""


class Segment(NamedTuple):
    """A message under a reliable transport, transmitted for the first time or again."""

    port: str
    to_all: bool
    """Whether the message was sent to all neighbours; such messages have sequence numbers of their own."""
    session: int
    """The time at which the sender began to number its messages, ns: 0, or when it lost its memory."""
    seq: int
    """Sequence number of the message, from 1 on."""
    base: int
    """The least number of a message that the receiver may still get; it does not wait for earlier messages."""
    attempt: int
    """Number of the attempt, from 1 on; not transmitted, and so without bytes."""
    body: Any


class Skip(NamedTuple):
    """Tells a receiver not to wait for messages before `base`, which were given up."""

    port: str
    to_all: bool
    session: int
    base: int


class Acknowledgement(NamedTuple):
    """Tells the sender of messages which of them have been received."""

    port: str
    to_all: bool
    session: int
    expected: int
    """All messages before this number have been received, or are not expected any more."""
    received: tuple[int, ...]
    """The numbers of the later messages that have been received, ascending."""


class CodedPiece(NamedTuple):
    """One of the coded pieces of a message, or under best effort the whole message."""

    port: str
    to_all: bool
    session: int
    seq: int
    part: int
    """Number of the piece, from 1 on."""
    body: Any
    """The body of the message, which can be decoded only from enough pieces."""


TransportFrame = Segment | Skip | Acknowledgement | CodedPiece
SKIP_SIZE = HEADER + FRAME
"""Bytes of a `Skip`."""


def acknowledgement_size(window: int) -> int:
    """Return the bytes of an acknowledgement, given the window of the transport."""
    return HEADER + FRAME + (NUMBER * -(-window // 64) if window > 1 else 0)


def piece_size(size: int, needed: int) -> int:
    """Return the bytes of a piece of a message of `size` bytes, header included, of which `needed` pieces suffice."""
    body_size = -(-(size - HEADER) // needed)  # rounded up
    return HEADER + FRAME + body_size


def carried(body: Any) -> Any:
    """Return the body of the message that a transmission carries: that of a frame, or the body itself."""
    return body.body if isinstance(body, Segment | CodedPiece) else body
