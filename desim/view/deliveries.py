"""What there is to draw of a run beside positions: how each message fared, who chased when, and what was broken.

In every picture a message goes evenly from where its sender was as it left to where its receiver is as it arrives. One
that is lost, for whatever reason and whenever that was settled, ends in a cross just before its receiver, at the time
of the loss: so one sees who did not hear. In a space-time diagram, which has lines for places, one that is lost as it
arrives ends on the line of its receiver.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

from desim.analysis.activity import action, moves, relays
from desim.analysis.trace_index import ended, require_messages, started
from desim.kernel.events import Broadcast, Cause, Lost, Queued, Sent
from desim.kernel.faults import Fault, FaultEnded, FaultStarted
from desim.simulation.run import Result


class Delivery(NamedTuple):
    """One message on its way to one receiver."""

    flight: int
    """The number of the transmission."""
    src: int
    dst: int
    created: int
    """When it was sent, ns; earlier than it left if the transmitter was busy."""
    left: int
    """When it left or, if it never did, when it was dropped, ns; after the end of the run if it waited then."""
    until: int
    """When it arrived or was lost, ns; after the end of the run if it was in flight then."""
    cause: Cause | None
    """Why it was lost, if it was."""
    size: int
    """Bytes."""
    body: Any
    """What it said; None if it never left."""


def deliveries(result: Result) -> list[Delivery]:
    """Return how every message fared, in the order of what they left as; a broadcast is one for each receiver.

    Raises:
        ValueError: if messages were sent and not recorded.
    """
    require_messages(result)
    found: dict[tuple[int, int], Delivery] = {}
    never = ended(result).t + 1
    for event in result.trace:
        if isinstance(event, Broadcast | Sent | Queued):
            for passage in _begun(event, never):
                found[passage.flight, passage.dst] = passage
        elif isinstance(event, Lost):
            passage = found[event.flight, event.dst]
            left = min(passage.left, event.t)
            found[event.flight, event.dst] = passage._replace(left=left, until=event.t, cause=event.cause)
    return sorted(found.values(), key=lambda each: (each.left, each.flight, each.dst))


def _begun(event: Broadcast | Sent | Queued, never: int) -> Iterator[Delivery]:
    """Yield what left or began to wait; if it is lost, when and why follows."""
    if isinstance(event, Queued):
        for dst in event.dst:
            yield Delivery(event.flight, event.src, dst, event.t, never, never, None, event.size, None)
        return
    for dst, arrival in event.fates():
        yield Delivery(event.flight, event.src, dst, event.created, event.t, arrival, None, event.size, event.body)


def news(body: Any) -> int | None:
    """Return what a message says that its sender does: which evader it chases, or 0; None if nothing."""
    said = getattr(body, "active", None)
    return said if isinstance(said, int) else None


class Interval(NamedTuple):
    """A time for which something was so, ns."""

    begin: int
    end: int


class Chase(NamedTuple):
    """A time for which somebody chased an evader, ns."""

    begin: int
    end: int
    evader: int
    """1 .. M"""


def chasing(result: Result) -> list[list[Chase]]:
    """Return when each pursuer chased which evader, in order of time."""
    actions, end = list(started(result).active), ended(result).t
    since = [0] * len(actions)
    found: list[list[Chase]] = [[] for _ in actions]
    for change, before in moves(result):
        if before:
            found[change.pursuer].append(Chase(since[change.pursuer], change.t, before))
        actions[change.pursuer], since[change.pursuer] = action(change), change.t
    for own, begin, chased in zip(found, since, actions, strict=True):
        if chased:
            own.append(Chase(begin, end, chased))
    return found


class Handover(NamedTuple):
    """Somebody came to be the only one that chases an evader, and was not the last that was so."""

    t: int
    """ns"""
    pursuer: int
    evader: int
    """1 .. M"""


def handover_events(result: Result) -> list[Handover]:
    """Return who came to chase an evader alone, in order of time; each but the first of an evader is a hand-over."""
    count = len(started(result).evaders)
    return sorted(Handover(t, who, evader) for evader in range(1, count + 1) for t, who in relays(result, evader))


def outages(result: Result) -> list[tuple[Fault, Interval]]:
    """Return what was broken and when, in order of its beginning; what is never over ends with the run."""
    end, open_faults = ended(result).t, list[FaultStarted]()
    found: list[tuple[Fault, Interval]] = []
    for event in result.trace:
        if isinstance(event, FaultStarted):
            open_faults.append(event)
        elif isinstance(event, FaultEnded):
            began = next(each for each in open_faults if each.fault == event.fault)
            open_faults.remove(began)
            found.append((event.fault, Interval(began.t, event.t)))
    found += [(began.fault, Interval(began.t, end)) for began in open_faults]
    return sorted(found, key=lambda each: each[1])
