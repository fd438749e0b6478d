"""Transports: how the network carries a message from one node to another, and what it promises about its arrival.

A transport is a set of qualities of service with the names of ROS 2 (Maruyama, Kato & Azumi 2016, "Exploring the
Performance of ROS2"): reliability (the kind), history and depth, lifespan, deadline, and liveliness with a lease. A
transport holds for the messages at a port, as a quality of service holds for a topic. A transport is immutable. Its
state in one run is in `desim.kernel.transport.sender` and `desim.kernel.transport.receiver`.

For a probability p that a message is lost, independently of all others, and at most K repeats:

    delivered          1 - p^(K+1)
    mean attempts      (1 - p^(K+1)) / (1 - p)
    n pieces, k needed sum of C(n, j) (1 - p)^j p^(n-j) over j = k .. n
"""

from math import inf
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, Tag, model_validator

from desim.config.choice import OneOf
from desim.config.json_numbers import from_json
from desim.config.model import MIN_PERIOD, Counted, Duration, Flag, Limit, Time, Timeout, Value, in_forms

MAX_WINDOW = 1024
"""Largest window of a reliable transport."""
MaxInterval = Annotated[float, Field(ge=MIN_PERIOD, strict=True), BeforeValidator(from_json), Counted]
"""A time of at least `MIN_PERIOD`, s; inf = never."""
SendWindow = Annotated[int, Field(ge=1, le=MAX_WINDOW, strict=True)]
"""A number of successive messages."""
Depth = Annotated[int, Field(ge=1, le=1_000_000, strict=True)]
"""A number of messages."""


def _whole(number: float) -> float:
    if number != inf and number % 1.0:
        raise ValueError(f"should be a whole number or inf (got {number:g})")
    return number


class Quality(Value):
    """The qualities that every transport has."""

    lifespan: Timeout = inf
    """Age of a message, s, from which on it is neither transmitted nor delivered. The receiver compares its own clock
    with the time stamp of the sender.

    If in doubt, inf; where only fresh messages count, a few periods of sending.
    """
    deadline: MaxInterval = inf
    """Longest time between two messages of a sender at a port, s. A receiver that has received one and waits longer for
    the next misses a deadline.

    If in doubt, three times the period of sending: a shorter one is missed at a single loss, a longer one notices a
    silent sender late.
    """
    lease: MaxInterval = inf
    """Lease of liveliness, s: a node loses the liveliness of another if it receives no transmission from it at a port
    for this long.

    If in doubt, three to five times the period of sending: with less, a few losses pass for a failure.
    """

    @property
    def is_plain(self) -> bool:
        """Whether messages are handed to the links as they are."""
        return False


class BestEffort(Quality):
    """A message is transmitted once, and is not acknowledged."""

    kind: Literal["best_effort"] = "best_effort"
    # A message is its only piece, see `Coded`.
    pieces: ClassVar[int] = 1
    needed: ClassVar[int] = 1
    spacing: ClassVar[float] = 0.0

    @property
    def is_plain(self) -> bool:
        """Whether messages are handed to the links as they are, because no quality is asked for."""
        return self == BEST_EFFORT


BEST_EFFORT = BestEffort()
"""Messages are handed to the links as they are."""


class Reliable(Quality):
    """A message is retransmitted until its receivers have acknowledged it (automatic repeat request).

    With a window of 1 this is stop-and-wait, otherwise selective repeat (Tanenbaum & Wetherall 2011, "Computer
    Networks", section 3.4). A broadcast is transmitted once to all neighbours, and then to each neighbour that has not
    acknowledged it. Acknowledgements are messages on the same links.
    """

    kind: Literal["reliable"] = "reliable"
    needed: ClassVar[int] = 1
    timeout: Annotated[
        Annotated[Duration, Tag("number")] | Annotated[Literal["auto"], Tag("text")], in_forms("text", "number")
    ] = "auto"
    """Time after which an unacknowledged message is transmitted again, s; "auto" is 5/4 of a round trip: two typical
    latencies, the airtime of the message, and that of one acknowledgement for each receiver.

    If in doubt, "auto": a shorter time repeats messages whose answers are on the way, a longer one waits after every
    loss.
    """
    min_timeout: Duration = 0.001
    """Least time-out that "auto" gives, s."""
    backoff: Annotated[float, Field(ge=1, le=10, strict=True)] = 2.0
    """Factor by which the time-out grows from one attempt to the next.

    If in doubt, 2, as in TCP (RFC 6298): with 1, repetitions keep a crowded channel crowded.
    """
    max_timeout: Timeout = 1.0
    """Largest time-out that `backoff` reaches, s; a longer first time-out stays as it is.

    If in doubt, 1: it bounds how long a receiver that is back in reach waits for its messages.
    """
    max_repeats: Annotated[Limit, AfterValidator(_whole)] = inf
    """Largest number K of retransmissions of a message to a receiver; then the message is given up; inf = unlimited.

    If in doubt, inf: `keep_last` gives a message up when newer ones take its place. With keep_all, about 7.
    """
    window: SendWindow = 10
    """Largest number of successive messages to a receiver from the first unacknowledged one on; 1 = stop-and-wait.

    If in doubt, 10; at least the number of messages that are sent in a round trip, else senders wait for
    acknowledgements.
    """
    ordered: Flag = True
    """Whether messages of a sender at a port are delivered in the order sent, so that a missing one delays the later
    ones; if not, each is delivered as it arrives."""
    history: Literal["keep_last", "keep_all"] = "keep_last"
    """Which unacknowledged messages of a sender at a port are kept. keep_last: the last `depth`, older ones are given
    up; keep_all: all, so that memory grows without bound if a receiver stays out of reach."""
    depth: Depth = 10
    """Number of messages that `keep_last` keeps.

    If in doubt, 1 where a message replaces the one before, such as a position, and else the number that is sent in the
    longest outage to be survived.
    """

    @property
    def gives_up(self) -> bool:
        """Whether a message may be given up although no newer one replaces it."""
        return min(self.max_repeats, self.lifespan) < inf


class Coded(Quality):
    """A message is sent as n coded pieces, of which any k suffice to decode it; nothing is acknowledged.

    Each piece has 1/k of the bytes of the body. With k = 1 every piece is a copy of the message (repetition). The code
    is ideal, as Reed & Solomon's is (1960, "Polynomial Codes over Certain Finite Fields").
    """

    kind: Literal["coded"] = "coded"
    pieces: Annotated[int, Field(ge=1, le=255, strict=True)] = 2
    """Number n of pieces that are transmitted.

    If in doubt, 2 with needed = 1: at a loss p of pieces, p^2 of the messages are lost, at twice the airtime.
    """
    needed: Annotated[int, Field(ge=1, le=255, strict=True)] = 1
    """Number k of pieces that suffice.

    If in doubt, 1. A larger k at the same ratio n / k withstands the same share of losses with less variation, in more
    transmissions, each with a header.
    """
    spacing: Time = 0.0
    """Time between the transmissions of two pieces, s; with a time longer than a burst of losses, a burst takes one
    piece only."""

    @model_validator(mode="after")
    def _enough(self) -> Self:
        if self.needed > self.pieces:
            raise ValueError(f"needed should be at most the number of pieces, {self.pieces} (got {self.needed})")
        return self


Transport = BestEffort | Reliable | Coded
TRANSPORTS = OneOf(BestEffort, Reliable, Coded, is_closed=True)


def check_transport(transport: Any) -> None:
    """Raise ValueError if the transport of a message is no transport, but for example the name of one, or a class."""
    if not isinstance(transport, Quality):
        raise ValueError(
            f"transport should be BestEffort(...), Reliable(...) or Coded(...), or None for that of the links (got"
            f" {transport!r})"
        )
