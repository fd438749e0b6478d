"""What can happen on the network, and the trace that everything that happens is appended to.

Times are integer nanoseconds in memory and seconds in the file (one JSON object a line).
"""

import json
from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from keyword import iskeyword
from math import isfinite
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol, Self, TypeVar

from desim.kernel.clock import SECOND, nanoseconds

LOST = -1
"""The arrival time of a message that never arrives."""


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


MESSAGES = (Queued, Broadcast, Sent, Lost)
"""What can happen to messages."""


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
Kinds = Mapping[str, Callable[..., Event]]
"""What makes an event of its fields, by the name of its type."""
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

    def lines(self) -> Iterator[str]:
        """Yield each event as one line of JSON; see `line_of`."""
        return map(line_of, self.events)

    def write(self, path: Path) -> None:
        """Write the trace as JSON lines; see `TraceFile`."""
        with TraceFile(path) as file:
            for event in self.events:
                file(event)

    @classmethod
    def read(cls, lines: Iterable[str], kinds: Kinds) -> "Trace":
        """Return the trace of which these are the `lines`; see `events_of`."""
        trace = cls()
        trace.events += events_of(lines, kinds)
        return trace


class TraceFile:
    """A watcher that writes every event to a file as it happens, and keeps none: the lines of a trace with messages.

        with TraceFile("trace.jsonl") as file:
            run(scenario, seed, file)

    Until it is complete the file is called NAME.part; one that was never completed stays, and what had that name does.

    Args:
        path: of the file.
    """

    def __init__(self, path: str | Path):
        self._path = Path(path)
        self._part = self._path.with_name(self._path.name + ".part")

    def __enter__(self) -> Self:
        self._file = self._part.open("w", encoding="utf-8", newline="\n")
        return self

    def __call__(self, event: Event) -> None:
        """Write an event."""
        self._file.write(line_of(event))

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        self._file.close()
        if error is None:
            self._part.replace(self._path)


def line_of(event: Event) -> str:
    """Return an event as one line of JSON: its type, then its fields with times in seconds (null: never).

    A field that has its default is left out.
    """
    text, fields = _form(type(event))
    for value, (key, write, default) in zip(event, fields, strict=True):
        if default is _REQUIRED or value != default:
            text += key + write(value)
    return text + "}\n"


def events_of(lines: Iterable[str], kinds: Kinds) -> Iterator[Event]:
    """Yield the events of which these are the `lines`, one by one, so that a long trace need not fit in memory.

    Lists come back as tuples, and a body with fields as a named tuple of them: equal to that which was sent, but of
    another type.

    Args:
        lines: of JSON.
        kinds: of events that there may be.

    Raises:
        ValueError: with the number of the line that is no event.
    """
    for number, line in enumerate(lines, start=1):
        try:
            fields = json.loads(line)
            kind = kinds[fields.pop("event")]
            event = kind(**{name: _read(name, value) for name, value in fields.items()})
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"line {number} is no event: {error}") from error
        yield event


_TIMES = frozenset({"t", "arrival", "created"})
_REQUIRED = object()
"""In place of the default of a field that has none."""
_json = json.JSONEncoder(default=repr).encode
_number = float.__repr__
Field = tuple[str, Callable[[Any], str], Any]
"""What stands before the value of a field, how it is written, and its default."""


@cache
def _form(kind: Any) -> tuple[str, tuple[Field, ...]]:
    """Return how events of a type are written: how a line begins, and its fields."""
    defaults = kind._field_defaults
    fields = ((f", {_json(name)}: ", _writer(name), defaults.get(name, _REQUIRED)) for name in kind._fields)
    return f'{{"event": {_json(kind.__name__)}', tuple(fields)


def _writer(name: str) -> Callable[[Any], str]:
    """Return what writes a field of an event."""
    return _time if name in _TIMES else _body if name == "body" else _plain


def _time(time: Any) -> str:
    if isinstance(time, tuple):
        if LOST in time:
            return f"[{', '.join(map(_time, time))}]"
        return str([each / SECOND for each in time])  # as JSON, and twice as fast
    return "null" if time == LOST else _number(time / SECOND)


def _plain(value: Any) -> str:
    """Return a value as JSON; one that JSON does not know as its `repr`."""
    if type(value) is int:
        return repr(value)
    return _json(value.plain() if hasattr(value, "plain") else value)


def _body(value: Any) -> str:
    """Return a body as JSON."""
    return _plain(value) if hasattr(value, "plain") else _said(value)


def _said(value: Any) -> str:
    """Return a value as JSON, with the named tuples in it as tables."""
    if isinstance(value, tuple | list):
        names = getattr(value, "_fields", None)
        if names is None:
            return f"[{', '.join(map(_said, value))}]"
        return f"{{{', '.join([f'{_json(name)}: {_said(each)}' for name, each in zip(names, value, strict=True)])}}}"
    if value is True or value is False:
        return "true" if value else "false"
    return _number(value) if type(value) is float and isfinite(value) else _json(value)


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
        return _body_type(tuple(fields))(**fields)
    return fields


@cache
def _body_type(names: tuple[str, ...]) -> Callable[..., Any]:
    """Return the type of bodies that have these fields."""
    make: Any = namedtuple
    kind: Callable[..., Any] = make("Body", names)
    return kind
