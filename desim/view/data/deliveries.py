"""The data that pictures show besides positions: deliveries of messages, chases, handovers and faults.

In the replay and the animation, a message moves at constant speed from the position of its sender at transmission to
that of its receiver at arrival. In a space-time diagram a message is an arrow between two lines. A lost message ends in
a cross, which shows the receiver that did not get the message. In the replay and the animation the cross is just short
of the receiver and appears at the time of the loss, whatever the cause of the loss. In the replay and in a space-time
diagram a collision is an asterisk instead. For the cross in a space-time diagram see `desim.view.pictures.spacetime`.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

from desim.analysis.activity import action, changes_with_previous, relays
from desim.analysis.trace_index import ended, require_messages, started
from desim.kernel.core.events import Broadcast, Cause, Lost, Queued, Sent
from desim.kernel.models.faults import FaultEnded, FaultStarted, TracedFault
from desim.simulation.run import Result


class Delivery(NamedTuple):
    """The delivery or the loss of one message to one receiver; a broadcast has a delivery for each receiver."""

    transmission: int
    """The number of the transmission."""
    src: int
    dst: int
    created: int
    """Time, ns, at which the message was handed to the transmitter; earlier than `left` if the transmitter was busy."""
    left: int
    """Start of transmission, ns. For a message lost in the queue: time of the loss. For a message still queued at the
    end of the run: a time after the end."""
    until: int
    """Time of arrival or loss, ns; after the end of the run if the message was still queued or in flight then."""
    cause: Cause | None
    """Cause of the loss; None if the message was not lost."""
    size: int
    """Bytes."""
    body: Any
    """Body of the message; None if it was never transmitted."""


def deliveries(result: Result) -> list[Delivery]:
    """Return all deliveries of a run, in order of the time of transmission.

    Raises:
        ValueError: if the trace lacks messages that were sent.
    """
    require_messages(result)
    by_receiver: dict[tuple[int, int], Delivery] = {}
    never = ended(result).t + 1
    for event in result.trace:
        if isinstance(event, Broadcast | Sent | Queued):
            for delivery in _begun(event, never):
                by_receiver[delivery.transmission, delivery.dst] = delivery
        elif isinstance(event, Lost):
            delivery = by_receiver[event.transmission, event.dst]
            left = min(delivery.left, event.t)
            by_receiver[event.transmission, event.dst] = delivery._replace(left=left, until=event.t, cause=event.cause)
    return sorted(by_receiver.values(), key=lambda delivery: (delivery.left, delivery.transmission, delivery.dst))


def _begun(event: Broadcast | Sent | Queued, never: int) -> Iterator[Delivery]:
    """Yield the deliveries that an event begins; a later event, `Lost`, reports a loss."""
    if isinstance(event, Queued):
        for dst in event.dst:
            yield Delivery(event.transmission, event.src, dst, event.t, never, never, None, event.size, None)
        return
    for dst, arrival in event.fates():
        yield Delivery(
            event.transmission, event.src, dst, event.created, event.t, arrival, None, event.size, event.body
        )


class Interval(NamedTuple):
    """An interval of time, ns."""

    begin: int
    end: int


class Chase(NamedTuple):
    """An interval of time, ns, in which a pursuer chased an evader."""

    begin: int
    end: int
    evader: int
    """1 .. M"""


def chasing(result: Result) -> list[list[Chase]]:
    """Return the chases of each pursuer, in order of time."""
    actions, end = list(started(result).active), ended(result).t
    since = [0] * len(actions)
    chases_by_pursuer: list[list[Chase]] = [[] for _ in actions]
    for change, before in changes_with_previous(result):
        if before:
            chases_by_pursuer[change.pursuer].append(Chase(since[change.pursuer], change.t, before))
        actions[change.pursuer], since[change.pursuer] = action(change), change.t
    for chases_of_pursuer, begin, chased in zip(chases_by_pursuer, since, actions, strict=True):
        if chased:
            chases_of_pursuer.append(Chase(begin, end, chased))
    return chases_by_pursuer


class Handover(NamedTuple):
    """A pursuer begins to chase an evader alone: it is the first to do so, or replaces the previous lone pursuer."""

    t: int
    """ns"""
    pursuer: int
    evader: int
    """1 .. M"""


def handover_events(result: Result) -> list[Handover]:
    """Return the handovers of all evaders, in order of time, including the first lone pursuer of each evader."""
    count = len(started(result).evaders)
    return sorted(Handover(t, who, evader) for evader in range(1, count + 1) for t, who in relays(result, evader))


def outages(result: Result) -> list[tuple[TracedFault, Interval]]:
    """Return the faults of a run with their intervals, in order of their start; the end of the run ends all faults."""
    end, open_faults = ended(result).t, list[FaultStarted]()
    intervals: list[tuple[TracedFault, Interval]] = []
    for event in result.trace:
        if isinstance(event, FaultStarted):
            open_faults.append(event)
        elif isinstance(event, FaultEnded):
            began = next(began_fault for began_fault in open_faults if began_fault.fault == event.fault)
            open_faults.remove(began)
            intervals.append((event.fault, Interval(began.t, event.t)))
    intervals += [(began.fault, Interval(began.t, end)) for began in open_faults]
    return sorted(intervals, key=lambda outage: outage[1])
