"""What can happen on the network, and the trace that everything that happens is appended to.

Times are integer nanoseconds.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Annotated, Any, Literal, NamedTuple, Protocol, TypeVar

LOST = -1
"""The arrival time of a message that never arrives."""

# What the numbers of events stand for: a trace that is read from a file is checked by these marks.
Nanoseconds = Annotated[int, "time"]
"""A time, ns."""
Arrival = Annotated[int, "arrival"]
"""A time, ns, or `LOST`."""
NodeId = Annotated[int, "node"]
"""The number of a node, from 0 on."""
Count = Annotated[int, "count"]
"""Not negative."""
Body = Annotated[Any, "body"]
"""The content of a message."""


class Event(Protocol):
    """Something that happened: a named tuple whose first field is its time."""

    @property
    def t(self) -> int:
        """The nanosecond at which it happened."""
        ...

    def __iter__(self) -> Iterator[Any]: ...

    @property
    def _fields(self) -> tuple[str, ...]: ...

    @property
    def _field_defaults(self) -> dict[str, Any]: ...


Cause = Literal["loss", "reach", "partition", "jamming", "crash", "queue", "half_duplex"]
"""Why a message was lost; "queue": dropped from a full one, "half_duplex": its receiver was on the air itself."""


class Queued(NamedTuple):
    """A transmission has to wait for its transmitter; it is on its way from now on, for the count of messages."""

    t: Nanoseconds
    flight: Count
    src: NodeId
    dst: tuple[NodeId, ...]
    size: Count


class Broadcast(NamedTuple):
    """A record left: one message to everyone in reach, all of them in this one event."""

    t: Nanoseconds
    flight: Count
    """The number of the transmission."""
    src: NodeId
    seq: Count
    dst: tuple[NodeId, ...]
    arrival: tuple[Arrival, ...]
    """When it reaches each of `dst`, unless it is lost on arrival, or `LOST`; one entry for all if they are alike."""
    created: Nanoseconds
    """When it was announced, ns; earlier than t if the transmitter was busy."""
    size: Count
    """Bytes."""
    body: Body

    def fates(self) -> Iterator[tuple[int, int]]:
        """Yield each receiver, and when it is reached, or `LOST`."""
        alike = len(self.arrival) == 1
        return zip(self.dst, self.arrival * len(self.dst) if alike else self.arrival, strict=True)


class Sent(NamedTuple):
    """A message left for one receiver."""

    t: Nanoseconds
    flight: Count
    """The number of the transmission; all receivers of one transmission have the same."""
    src: NodeId
    dst: NodeId
    arrival: Arrival
    """When it reaches `dst`, unless it is lost on arrival, or `LOST`."""
    created: Nanoseconds
    """When it was sent, ns; earlier than t if the transmitter was busy."""
    size: Count
    """Bytes."""
    body: Body

    def fates(self) -> Iterator[tuple[int, int]]:
        """Yield its receiver, and when that is reached, or `LOST`; as of a broadcast."""
        yield self.dst, self.arrival


class Lost(NamedTuple):
    """A message to one receiver will never be read: lost as it left, while it waited to, or as it arrived."""

    t: Nanoseconds
    flight: Count
    src: NodeId
    dst: NodeId
    cause: Cause


MESSAGES = (Queued, Broadcast, Sent, Lost)
"""What can happen to messages."""


class MessageCounts(NamedTuple):
    """What the network carried until the run ended, each receiver of a transmission counted as one message."""

    t: Nanoseconds
    sent: Count
    delivered: Count
    lost: Count
    in_flight: Count
    lost_by: dict[Cause, Count]
    """How many were lost by each cause."""
    transmissions: Count
    """How many times something was put on the air, whatever the number of receivers."""
    bytes_sent: Count
    """Bytes of the messages put on the air, without what the medium adds to each."""
    utilisation: float
    """Share of the time in which the channels were busy, in [0, 1]: of the shared one, or the mean over all nodes'."""


Kind = TypeVar("Kind")
Watcher = Callable[[Event], object]
"""Called with every event as it happens: it ends the run by returning True, and fails it by raising."""


class Trace:
    """Everything that happened, in order.

    Args:
        watchers: are shown each event as it happens.
        messages: whether to keep message events; if not, the watchers see them all the same.
        stop: called when a watcher asks for the end of the run.
    """

    def __init__(
        self, watchers: Iterable[Watcher] = (), *, messages: bool = True, stop: Callable[[], object] | None = None
    ):
        self.events: list[Event] = []
        self._watchers = tuple(watchers)
        self._keeps_messages = messages
        self._stop = stop
        self.wants_messages = messages or bool(self._watchers)

    def append(self, event: Event) -> None:
        """Record an event and show it to the watchers."""
        self.events.append(event)
        if self._watchers:
            self._show(event)

    def append_message(self, event: Event) -> None:
        """Show the event of a message to the watchers, and record it if messages are kept."""
        if self._keeps_messages:
            self.events.append(event)
        if self._watchers:
            self._show(event)

    def _show(self, event: Event) -> None:
        for watch in self._watchers:
            if watch(event) is True and self._stop is not None:
                self._stop()

    def __iter__(self) -> Iterator[Event]:
        return iter(self.events)

    def __len__(self) -> int:
        return len(self.events)

    def of(self, kind: type[Kind]) -> list[Kind]:
        """Return the events of one type, in order."""
        return [event for event in self.events if isinstance(event, kind)]
