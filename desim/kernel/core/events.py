"""The events of the network, and the trace that stores the events of a run.

Times are integer nanoseconds.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Annotated, Any, Literal, NamedTuple, Protocol, TypeVar

import numpy as np
from pydantic import Field

from desim.config.arguments import value_text
from desim.config.calls import check_at_once, check_call

LOST = -1
"""The arrival time of a message that never arrives."""

# The types of the fields of events. The string in the annotation of a type, called its mark, selects how values read
# from a trace file are validated; see `desim.kernel.core.trace_file`.
Nanoseconds = Annotated[int, "time"]
"""A time, ns."""
ArrivalTime = Annotated[int, "arrival"]
"""A time, ns, or `LOST`."""
NodeId = Annotated[int, "node"]
"""The id of a node, 0 .. n - 1."""
Count = Annotated[int, "count"]
"""An integer >= 0."""
Body = Annotated[Any, "body"]
"""The content of a message."""


class Event(Protocol):
    """An event of a trace: a named tuple whose first field is its time."""

    @property
    def t(self) -> int:
        """The time of the event, ns."""

    def __iter__(self) -> Iterator[Any]: ...

    @property
    def _fields(self) -> tuple[str, ...]: ...


Cause = Annotated[str, Field(min_length=1)]
"""The cause of a loss, one of `CAUSES` or a name that a user's model gives to its losses (the attribute `cause`)."""
CAUSES = (
    "loss",
    "out_of_range",
    "partition",
    "jamming",
    "crash",
    "queue",
    "access",
    "half_duplex",
    "tuning",
    "collision",
)
"""The causes of losses of the built-in models. "loss": by chance, or by noise; "queue": dropped from a full queue;
"access": dropped by its sender, because the channel was busy too often (csma) or its slots are too short (tdma);
"half_duplex": the receiver was transmitting; "tuning": its radio is tuned to another frequency or spreading factor
(lora); "collision": another frame overlapped it at the receiver."""


class Queued(NamedTuple):
    """A transmission waits at its host, for a busy transmitter, or contends for the channel.

    `MessageCounts` counts its messages as in flight from here on.
    """

    t: Nanoseconds
    transmission: Count
    src: NodeId
    dst: tuple[NodeId, ...]
    size: Count


class Broadcast(NamedTuple):
    """A record was broadcast: one event for the messages to all receivers."""

    t: Nanoseconds
    transmission: Count
    """The number of the transmission."""
    src: NodeId
    seq: Count
    dst: tuple[NodeId, ...]
    arrival: tuple[ArrivalTime, ...]
    """Arrival time at each node of `dst`, ns, or `LOST`; one entry if all are equal. A message can still be lost on
    arrival."""
    created: Nanoseconds
    """When the record was published, ns; earlier than t if it waited."""
    size: Count
    """Bytes."""
    body: Body

    def fates(self) -> Iterator[tuple[int, int]]:
        """Yield each receiver and its arrival time, ns, or `LOST`."""
        times = self.arrival * len(self.dst) if len(self.arrival) == 1 else self.arrival
        return zip(self.dst, times, strict=True)


class Sent(NamedTuple):
    """A message was sent to one receiver.

    Its time t is the start of the transmission. If the message is acknowledged (`csma_ca`), it is the end of the
    attempt that succeeded; a message of which no attempt succeeds has no such event.
    """

    t: Nanoseconds
    transmission: Count
    """The number of the transmission, the same for all its receivers."""
    src: NodeId
    dst: NodeId
    arrival: ArrivalTime
    """Arrival time at `dst`, ns, or `LOST`; the message can still be lost on arrival."""
    created: Nanoseconds
    """When `send` was called, ns; earlier than t if the message waited or is acknowledged."""
    size: Count
    """Bytes."""
    body: Body

    def fates(self) -> Iterator[tuple[int, int]]:
        """Yield the receiver and its arrival time, ns, or `LOST`, like `Broadcast.fates`."""
        yield self.dst, self.arrival


class Lost(NamedTuple):
    """A message to one receiver was lost: in the queue of the transmitter, at transmission or on arrival."""

    t: Nanoseconds
    transmission: Count
    src: NodeId
    dst: NodeId
    cause: Cause


MESSAGES = (Queued, Broadcast, Sent, Lost)
"""The types of message events."""


class MessageCounts(NamedTuple):
    """The traffic of the network until time t; each receiver of a transmission counts as one message."""

    t: Nanoseconds
    sent: Count
    delivered: Count
    lost: Count
    in_flight: Count
    lost_by: dict[Cause, Count]
    """Number of lost messages by cause."""
    transmissions: Count
    """Number of transmissions, regardless of the number of receivers.

    It may differ from the number of different `transmission` in `Broadcast` and `Sent`: a message to all neighbours of
    a node without neighbours is transmitted and has no `Sent`; under `csma_ca` each attempt counts; and a copy that a
    fault makes has a number, but is not transmitted.
    """
    bytes_sent: Count
    """Bytes of all transmissions, without headers added by the medium."""
    utilisation: float
    """Share of time the channel was busy, in [0, 1]; the mean over all nodes if each has its own channel."""


class Delivered(NamedTuple):
    """A transport handed a message to a receiver; without a transport, a message is delivered as it arrives."""

    t: Nanoseconds
    src: NodeId
    dst: NodeId
    port: str
    to_all: bool
    """Whether the message was sent to all neighbours."""
    seq: Count
    """The number of the message among those of the sender at the port, to all or to this receiver."""
    created: Nanoseconds
    """When `send` was called, ns."""
    attempt: Count
    """The number of the attempt, or of the piece, with which it arrived, from 1 on."""
    body: Body

    def fates(self) -> Iterator[tuple[int, int]]:
        """Yield the receiver and the time of the delivery, ns, like `Broadcast.fates`."""
        yield self.dst, self.t


class Retransmitted(NamedTuple):
    """A message was transmitted again to a receiver that had not acknowledged it in time."""

    t: Nanoseconds
    src: NodeId
    dst: NodeId
    port: str
    to_all: bool
    seq: Count
    attempt: Count
    """The number of this attempt, from 2 on."""


GiveUp = Literal["repeats", "lifespan", "superseded", "memory_loss"]
"""Why a message is given up; "repeats": it was repeated often enough, "superseded": newer messages filled the history,
"memory_loss": its sender lost its memory."""


class GivenUp(NamedTuple):
    """A sender gave up a message that a receiver had not acknowledged; the receiver may have got it all the same."""

    t: Nanoseconds
    src: NodeId
    dst: NodeId
    port: str
    to_all: bool
    seq: Count
    cause: GiveUp


class Expired(NamedTuple):
    """A receiver dropped a message that was older than its lifespan."""

    t: Nanoseconds
    src: NodeId
    dst: NodeId
    port: str
    to_all: bool
    seq: Count


class DeadlineMissed(NamedTuple):
    """A receiver has waited longer than the deadline for a message of a sender at a port."""

    t: Nanoseconds
    src: NodeId
    dst: NodeId
    port: str


class LivelinessLost(NamedTuple):
    """A receiver has received nothing from a node at a port for the time of its lease."""

    t: Nanoseconds
    src: NodeId
    dst: NodeId
    port: str


class TransportCounts(NamedTuple):
    """The counts of the transports of a network up to time t; each receiver of a message counts as one message."""

    t: Nanoseconds
    submitted: Count
    """Number of messages that were given to a transport."""
    delivered: Count
    expired: Count
    """Number of messages that their receivers dropped because of the lifespan."""
    given_up: dict[GiveUp, Count]
    """Number of messages that their senders gave up, by cause."""
    attempts: Count
    """Number of transmissions of messages, or of pieces, to each of their receivers."""
    retransmissions: Count
    acknowledgements: Count
    deadlines_missed: Count
    lives_lost: Count
    """Number of `LivelinessLost` events."""
    delay: Nanoseconds
    """Sum of the times from sending to delivery over all delivered messages, ns."""


class ClockCorrected(NamedTuple):
    """A node corrected its clock by synchronisation."""

    t: Nanoseconds
    node: NodeId
    correction: float
    """The sum of all corrections of its clock since the start, s."""


DELIVERIES = (Delivered, Retransmitted, GivenUp, Expired)
"""The types of events of transports about single messages, which are recorded if messages are."""
TRANSPORT = (*DELIVERIES, DeadlineMissed, LivelinessLost, TransportCounts)
"""The types of events of transports; without a transport there are none."""

Kind = TypeVar("Kind")
Watcher = Callable[[Event], object]
"""A function called with each event; the run ends if the function returns True, and fails if it raises."""


class Trace:
    """The events of a run, in order.

    Args:
        watchers: called with each event when it happens.
        messages: whether to store message events; the watchers receive them in either case.
        stop: called when a watcher requests the end of the run.

    Raises:
        ValueError: if a watcher cannot be called with an event.
    """

    def __init__(
        self, watchers: Iterable[Watcher] = (), *, messages: bool = True, stop: Callable[[], object] | None = None
    ):
        self.events: list[Event] = []
        self._watchers = tuple(watchers)
        for watch in self._watchers:
            if not callable(watch):
                raise ValueError(f"a watcher should be a function of an event (got {value_text(watch)})")
            try:
                check_call(watch, ("event",), watch)
                check_at_once(watch)
            except ValueError as error:
                raise ValueError(f"a watcher {error}") from error
        self._keeps_messages = messages
        self._stop = stop
        self.wants_messages = messages or bool(self._watchers)
        self.is_taken = False
        """Whether a `SteppedNetwork` has used this trace for an episode."""

    def append(self, event: Event) -> None:
        """Store an event and pass it to the watchers."""
        self.events.append(event)
        if self._watchers:
            self._show(event)

    def append_message(self, event: Event) -> None:
        """Pass a message event to the watchers, and store it if message events are kept."""
        if self._keeps_messages:
            self.append(event)  # a call, because a user's class may override it
        elif self._watchers:
            self._show(event)

    def close(self) -> None:
        """Drop the watchers and the function that ends the run, because they keep the whole simulation in memory."""
        self._watchers, self._stop = (), None

    def _show(self, event: Event) -> None:
        for watch in self._watchers:
            answer = watch(event)
            if (answer is True or (isinstance(answer, np.bool_) and answer)) and self._stop is not None:
                self._stop()

    def __iter__(self) -> Iterator[Event]:
        return iter(self.events)

    def __len__(self) -> int:
        return len(self.events)

    def of(self, kind: type[Kind]) -> list[Kind]:
        """Return the events of one type, in order.

        Raises:
            TypeError: if `kind` is not a class of events, or a tuple of such classes.
        """
        if not isinstance(kind, type | tuple):
            raise TypeError(
                f"`of` takes a class of events, such as desim.pursuit.core.events.Decided (got {value_text(kind)})"
            )
        return [event for event in self.events if isinstance(event, kind)]
