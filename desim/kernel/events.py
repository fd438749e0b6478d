"""What can happen on the network, and the trace that everything that happens is appended to.

Times are integer nanoseconds in memory and seconds in the file (one JSON object a line).
"""

import json
from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from keyword import iskeyword
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol, TypeVar

from desim.kernel.clock import nanoseconds, seconds

LOST = -1
"""The arrival time of a message that never arrives."""


class Event(Protocol):
    """Something that happened: a named tuple whose first field is its time."""

    @property
    def t(self) -> int:
        """The nanosecond at which it happened."""
        ...

    def _asdict(self) -> dict[str, Any]: ...

    @property
    def _field_defaults(self) -> dict[str, Any]: ...


Cause = Literal["loss", "reach", "partition", "jamming", "crash", "queue", "half_duplex"]
"""Why a message was lost; "queue": dropped from a full one, "half_duplex": its receiver was on the air itself."""


class Queued(NamedTuple):
    """A transmission has to wait for its transmitter; it is on its way from now on, for the count of messages."""

    t: int
    flight: int
    src: int
    dst: tuple[int, ...]
    size: int


class Broadcast(NamedTuple):
    """A record left: one message to everyone in reach, all of them in this one event."""

    t: int
    flight: int
    """The number of the transmission."""
    src: int
    seq: int
    dst: tuple[int, ...]
    arrival: tuple[int, ...]
    """When it reaches each of `dst`, unless it is lost on arrival, or `LOST`; one entry for all if they are alike."""
    created: int
    """When it was announced, ns; earlier than t if the transmitter was busy."""
    size: int
    """Bytes."""
    body: Any


class Sent(NamedTuple):
    """A message left for one receiver."""

    t: int
    flight: int
    """The number of the transmission; all receivers of one transmission have the same."""
    src: int
    dst: int
    arrival: int
    """When it reaches `dst`, unless it is lost on arrival, or `LOST`."""
    created: int
    """When it was sent, ns; earlier than t if the transmitter was busy."""
    size: int
    """Bytes."""
    body: Any


class Lost(NamedTuple):
    """A message to one receiver will never be read: lost as it left, while it waited to, or as it arrived."""

    t: int
    flight: int
    src: int
    dst: int
    cause: Cause


class Tally(NamedTuple):
    """What the network carried until the run ended, each receiver of a transmission counted as one message."""

    t: int
    sent: int
    delivered: int
    lost: int
    in_flight: int
    lost_by: dict[Cause, int]
    """How many were lost by each cause."""
    transmissions: int
    """How many times something was put on the air, whatever the number of receivers."""
    bytes_sent: int
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

    def lines(self) -> Iterator[str]:
        """Yield each event as one line of JSON: its type, then its fields with times in seconds (null: never).

        A field that has its default is left out.
        """
        for event in self.events:
            defaults = event._field_defaults
            fields = {
                name: _plain(name, value)
                for name, value in event._asdict().items()
                if name not in defaults or value != defaults[name]
            }
            yield json.dumps({"event": type(event).__name__} | fields, default=repr) + "\n"

    def write(self, path: Path) -> None:
        """Write the trace as JSON lines."""
        with path.open("w", encoding="utf-8", newline="\n") as file:
            file.writelines(self.lines())

    @classmethod
    def read(cls, lines: Iterable[str], kinds: Mapping[str, Callable[..., Event]]) -> "Trace":
        """Return the trace of which these are the `lines`.

        Lists come back as tuples, and a body with fields as a named tuple of them: equal to that which was sent, but of
        another type.

        Args:
            lines: of JSON.
            kinds: what makes an event of its fields, by the name of its type.

        Raises:
            ValueError: with the number of the line that is no event.
        """
        trace = cls()
        for number, line in enumerate(lines, start=1):
            try:
                fields = json.loads(line)
                kind = kinds[fields.pop("event")]
                trace.events.append(kind(**{name: _read(name, value) for name, value in fields.items()}))
            except (ValueError, TypeError, KeyError, AttributeError) as error:
                raise ValueError(f"line {number} is no event: {error}") from error
        return trace


_TIMES = frozenset({"t", "arrival", "created"})


def _plain(name: str, value: Any) -> Any:
    """Return a field of an event as what JSON has; of a body it does not know, the `repr`."""
    if name in _TIMES:
        return _seconds(value)
    if hasattr(value, "plain"):
        return value.plain()
    return _fields(value) if name == "body" else value


def _fields(value: Any) -> Any:
    """Return a value with the named tuples in it as tables."""
    if hasattr(value, "_asdict"):
        return {name: _fields(each) for name, each in value._asdict().items()}
    return [_fields(each) for each in value] if isinstance(value, tuple | list) else value


def _seconds(time: Any) -> Any:
    if isinstance(time, tuple):
        return [_seconds(each) for each in time]
    return None if time == LOST else seconds(time)


def _read(name: str, value: Any) -> Any:
    """Return a field of an event from what JSON has."""
    if name in _TIMES:
        return _nanoseconds(value)
    return _named(value) if name == "body" else _tuples(value)


def _nanoseconds(time: Any) -> Any:
    if isinstance(time, list):
        return tuple(map(_nanoseconds, time))
    return LOST if time is None else nanoseconds(time)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _named(value: Any) -> Any:
    """Return a value with named tuples for the tables in it, if their keys can be names, and tuples for lists."""
    if isinstance(value, list):
        return tuple(map(_named, value))
    if not isinstance(value, dict):
        return value
    fields = {name: _named(each) for name, each in value.items()}
    if all(name.isidentifier() and not name.startswith("_") and not iskeyword(name) for name in fields):
        return _body(tuple(fields))(**fields)
    return fields


@cache
def _body(names: tuple[str, ...]) -> Callable[..., Any]:
    """Return the type of bodies that have these fields."""
    make: Any = namedtuple
    kind: Callable[..., Any] = make("Body", names)
    return kind
