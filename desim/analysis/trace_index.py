"""The events of a finished run by type, and a cache of the quantities that several metrics derive from them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import wraps
from itertools import chain
from typing import Any, TypeVar

from desim.kernel.core.events import MESSAGES, MessageCounts, TransportCounts
from desim.pursuit.core.events import Captured, Ended, Sampled, Started
from desim.simulation.run import Result

Derived = TypeVar("Derived")
Kind = TypeVar("Kind")
NO_POSITIONS = "positions were not recorded: set record.trajectory to a time greater than 0 s"
"""The error message for a run without recorded positions."""
NO_MESSAGES = "the trace lacks the messages that were sent: set record.messages = true"
"""The error message for a run whose messages were not recorded."""


@dataclass(frozen=True, repr=False)
class TraceIndex(Result):
    """The result of a finished run, with a cache of derived quantities."""

    derived: dict[Callable[[Result], Any], Any] = field(default_factory=dict, compare=False)
    """By function (see `remembered`), the value that it returned."""


def trace_index(result: Result) -> TraceIndex:
    """Return a result with the same trace and an empty cache; use it to call several metrics on one result."""
    return TraceIndex(result.scenario, result.seed, result.trace)


def remembered(derive: Callable[[Result], Derived]) -> Callable[[Result], Derived]:
    """Cache the return value of a function for each `TraceIndex`; callers must not modify the value."""

    @wraps(derive)
    def cached(result: Result) -> Derived:
        if not isinstance(result, TraceIndex):
            return derive(result)
        if derive not in result.derived:
            result.derived[derive] = derive(result)
        value: Derived = result.derived[derive]
        return value

    return cached


@remembered
def _places(result: Result) -> dict[type, list[int]]:
    """Return the positions in the trace of the events of each type."""
    places: dict[type, list[int]] = {}
    for place, kind in enumerate(map(type, result.trace)):
        if kind in places:
            places[kind].append(place)
        else:
            places[kind] = [place]
    return places


def places_of(result: Result, *kinds: type) -> list[int]:
    """Return the positions in the trace of the events of some types, in order.

    One pass serves all calls for a `TraceIndex`. For another result, each call searches the trace.
    """
    if not isinstance(result, TraceIndex):
        return [place for place, event in enumerate(result.trace) if isinstance(event, kinds)]
    return sorted(chain.from_iterable(places for kind, places in _places(result).items() if issubclass(kind, kinds)))


def traced_events(result: Result, kind: type[Kind]) -> list[Kind]:
    """Return the events of one type, in order, as `Trace.of` does; see `places_of`."""
    if not isinstance(result, TraceIndex):
        return result.trace.of(kind)
    events: list[Any] = result.trace.events
    return [events[place] for place in places_of(result, kind)]


@remembered
def started(result: Result) -> Started:
    """Return the `Started` event, the first of the run."""
    return traced_events(result, Started)[0]


@remembered
def ended(result: Result) -> Ended:
    """Return the `Ended` event, which gives the time and the reason of the end of the run."""
    return traced_events(result, Ended)[0]


@remembered
def captures(result: Result) -> list[Captured]:
    """Return the captures in order."""
    return traced_events(result, Captured)


@remembered
def positions_known(result: Result) -> bool:
    """Return whether positions are known: they were sampled, or the game is static."""
    return result.scenario.motion.static or bool(places_of(result, Sampled))


@remembered
def samples(result: Result) -> list[Started | Sampled]:
    """Return the events with positions: the start and, unless the game is static, the samples."""
    return [started(result), *(() if result.scenario.motion.static else traced_events(result, Sampled))]


def sampled(result: Result) -> list[Sampled]:
    """Return the samples of positions.

    Raises:
        ValueError: if there are none.
    """
    states = traced_events(result, Sampled)
    if not states:
        raise ValueError(NO_POSITIONS)
    return states


@remembered
def messages_recorded(result: Result) -> bool:
    """Return whether the trace of a run has its messages."""
    return result.scenario.record.messages is True or bool(places_of(result, *MESSAGES))


def lacks_messages(result: Result) -> bool:
    """Return whether messages were sent that the trace lacks."""
    return bool(messages(result).sent) and not messages_recorded(result)


def require_messages(result: Result) -> None:
    """Check that the trace of a run has its messages.

    Raises:
        ValueError: if the trace lacks messages that were sent.
    """
    if lacks_messages(result):
        raise ValueError(NO_MESSAGES)


@remembered
def messages(result: Result) -> MessageCounts:
    """Return the numbers of messages; a broadcast counts as one message per receiver."""
    return traced_events(result, MessageCounts)[0]


@remembered
def transport(result: Result) -> TransportCounts | None:
    """Return the counts of the transports; None if no message needed a transport."""
    counts = traced_events(result, TransportCounts)
    return counts[0] if counts else None
