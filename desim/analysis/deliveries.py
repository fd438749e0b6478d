"""Deliveries of messages, chases, handovers and faults of a run, which pictures show besides positions."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, repeat
from typing import Any, NamedTuple

import numpy as np

from desim.analysis.activity import action, changes_with_previous, relays
from desim.analysis.trace_index import ended, remembered, require_messages, started
from desim.config.arrays import Integers
from desim.kernel.core.events import Broadcast, Cause, Lost, Queued, Sent
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted, TracedFault
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


@dataclass(frozen=True, slots=True)
class DeliveryTable:
    """All deliveries of a run as columns, in order of (created, transmission, dst); the fields of `Delivery`.

    With 500 pursuers, half a million messages in a second are usual. To make this table takes a twentieth of the time
    of a list of tuples.
    """

    transmission: Integers
    src: Integers
    dst: Integers
    created: Integers
    left: Integers
    until: Integers
    cause: Integers
    """The position of the cause in `causes`; -1 if the message was not lost."""
    event: Integers
    """The position of the event that began the delivery in `events`."""
    causes: tuple[Cause, ...]
    events: Sequence[Broadcast | Sent | Queued]

    def take(self, rows: Integers) -> "DeliveryTable":
        """Return the rows with the given indices, in the order of the indices."""
        if len(rows) == len(self.dst) and (np.diff(rows) > 0).all():
            return self
        columns = ("transmission", "src", "dst", "created", "left", "until", "cause", "event")
        return replace(self, **{column: getattr(self, column)[rows] for column in columns})

    def in_order_of(self, time: Integers) -> "DeliveryTable":
        """Return the table in order of a column of times, then of transmission and receiver."""
        if (np.diff(time) >= 0).all() and (
            np.diff(self.transmission * (self.dst.max(initial=0) + 1) + self.dst) > 0
        ).all():
            return self  # sorting 2.6 million rows takes a second
        return self.take(np.lexsort((self.dst, self.transmission, time)))


@remembered
def delivery_table(result: Result) -> DeliveryTable:
    """Return all deliveries of a run as columns.

    Raises:
        ValueError: if the trace lacks messages that were sent.
    """
    require_messages(result)
    never, size = ended(result).t + 1, len(started(result).active)
    events: list[Broadcast | Sent | Queued] = []
    losses: list[Lost] = []
    rows: list[tuple[int, int, int, int, int]] = []  # (number of receivers, transmission, src, created, left)
    receivers: list[tuple[int, ...]] = []
    arrivals: list[Iterable[int]] = []
    for event in result.trace:
        if isinstance(event, Broadcast):
            rows.append((len(event.dst), event.transmission, event.src, event.created, event.t))
            receivers.append(event.dst)
            # `arrival` has one entry if all arrive at once; 10,000 tuples would take more memory than iterators.
            arrivals.append(event.arrival if len(event.arrival) != 1 else repeat(event.arrival[0], len(event.dst)))
        elif isinstance(event, Sent):
            rows.append((1, event.transmission, event.src, event.created, event.t))
            receivers.append((event.dst,))
            arrivals.append((event.arrival,))
        elif isinstance(event, Queued):
            rows.append((len(event.dst), event.transmission, event.src, event.t, never))
            receivers.append(tuple(event.dst))
            arrivals.append(repeat(never, len(event.dst)))
        else:
            if isinstance(event, Lost):
                losses.append(event)
            continue
        events.append(event)
    counts, *shared = np.array(rows, np.int64).reshape(-1, 5).T
    total = int(counts.sum())
    transmission, src, created, left = (np.repeat(column, counts) for column in shared)
    dst = np.fromiter(chain.from_iterable(receivers), np.int64, total)
    until = np.fromiter(chain.from_iterable(arrivals), np.int64, total)
    cause, begun_by = np.full(total, -1), np.repeat(np.arange(len(events)), counts)
    causes = tuple(sorted({loss.cause for loss in losses}))
    key = transmission * size + dst
    order = np.arange(total)
    if not (key[1:] > key[:-1]).all():
        # A message that was queued has a second event when its transmission begins; the last event counts.
        order = np.argsort(key, kind="stable")
        order = order[np.append(key[order][1:] != key[order][:-1], True)[:total]]
    lost = np.array([(loss.transmission * size + loss.dst, loss.t) for loss in losses], np.int64).reshape(-1, 2)
    row = order[np.searchsorted(key[order], lost[:, 0])]
    np.minimum.at(left, row, lost[:, 1])  # a message lost in the queue has no start of transmission
    until[row], cause[row] = lost[:, 1], [causes.index(loss.cause) for loss in losses]
    table = DeliveryTable(transmission, src, dst, created, left, until, cause, begun_by, causes, events).take(order)
    return table.in_order_of(table.created)


def deliveries(result: Result) -> list[Delivery]:
    """Return all deliveries of a run, in order of the time of transmission.

    Raises:
        ValueError: if the trace lacks messages that were sent.
    """
    table = delivery_table(result)
    table = table.in_order_of(table.left)
    columns = (table.transmission, table.src, table.dst, table.created, table.left, table.until)
    numbers = zip(*(column.tolist() for column in columns), strict=True)
    causes = [None if cause < 0 else table.causes[cause] for cause in table.cause.tolist()]
    events = [table.events[event] for event in table.event.tolist()]
    return [
        Delivery._make((*row, cause, event.size, _body(event)))
        for row, cause, event in zip(numbers, causes, events, strict=True)
    ]


def _body(event: Broadcast | Sent | Queued) -> Any:
    return None if isinstance(event, Queued) else event.body


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
    begins = [0] * len(actions)
    chases_by_pursuer: list[list[Chase]] = [[] for _ in actions]
    for change, before in changes_with_previous(result):
        if before:
            chases_by_pursuer[change.pursuer].append(Chase(begins[change.pursuer], change.t, before))
        actions[change.pursuer], begins[change.pursuer] = action(change), change.t
    for chases_of_pursuer, begin, chased in zip(chases_by_pursuer, begins, actions, strict=True):
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
            start = next(open_fault for open_fault in open_faults if open_fault.fault == event.fault)
            open_faults.remove(start)
            intervals.append((event.fault, Interval(start.t, event.t)))
    intervals += [(start.fault, Interval(start.t, end)) for start in open_faults]
    return sorted(intervals, key=lambda outage: outage[1])
