"""The messages of a run, numbered as `MessageFault` numbers them, and which of them could have had an effect."""

from bisect import bisect_left, bisect_right
from collections import defaultdict
from math import inf
from typing import NamedTuple

import numpy as np

from desim.analysis.deliveries import delivery_table
from desim.kernel.core.events import LOST, Broadcast, Queued, Sent
from desim.kernel.core.units import seconds
from desim.kernel.link_layer.link_layer import FIRST_COPY
from desim.pursuit.core.events import Decided
from desim.pursuit.team.announcements import announced_action
from desim.simulation.run import Result


class MessageCopy(NamedTuple):
    """A message to one receiver; a broadcast counts as one message for each receiver."""

    number: int
    """The number, from 1 on, in the order of sending."""
    src: int
    dst: int
    sent: int
    """The time of sending, ns."""
    arrival: int
    """The time of arrival, ns; `LOST` if it never arrived."""
    seq: int | None
    """The number of the record among the records of its sender; None if the message is no record."""
    action: int | None
    """The action that the message announces; None if it announces none."""

    def __str__(self) -> str:
        """Return the number, the sender, the receiver, the time of sending, and the action."""
        announced = "" if self.action is None else f", says {f'chases {self.action}' if self.action else 'stays'}"
        return f"message {self.number}: {self.src} to {self.dst}, sent at {seconds(self.sent):.3f} s{announced}"


def copies(result: Result) -> list[MessageCopy]:
    """Return the messages of a run in the order of sending; its messages must be in its trace.

    Copies that faults make are left out: they have no numbers.
    """
    table = delivery_table(result)
    table = table.in_order_of(table.transmission)
    # Copies that faults make have transmission numbers from `FIRST_COPY` on.
    numbered = int(np.searchsorted(table.transmission, FIRST_COPY))
    columns = table.event, table.dst, table.created, np.where(table.cause < 0, table.until, LOST)
    rows = zip(*(column[:numbered].tolist() for column in columns), strict=True)
    return [_copy(number, table.events[event], *fate) for number, (event, *fate) in enumerate(rows, start=1)]


def _copy(number: int, event: Broadcast | Sent | Queued, dst: int, sent: int, arrival: int) -> MessageCopy:
    if isinstance(event, Queued):  # it has not left its sender
        return MessageCopy(number, event.src, dst, sent, LOST, None, None)
    seq = event.seq if isinstance(event, Broadcast) else None
    return MessageCopy(number, event.src, dst, sent, arrival, seq, announced_action(event.body))


def looks(result: Result) -> dict[int, list[int]]:
    """Return when each pursuer decided or sent something, ns, ascending: it may have read its records then."""
    times: defaultdict[int, list[int]] = defaultdict(list)
    for event in result.trace:
        if isinstance(event, Decided):
            times[event.pursuer].append(event.t)
        elif isinstance(event, Broadcast | Sent | Queued):
            times[event.src].append(event.t)
    return times


class ReadingTime(NamedTuple):
    """The time in which a message is the newest of its sender at its receiver, or would be if it had arrived."""

    copy: MessageCopy
    since: int
    """The time of arrival or, if it was lost, of sending, ns."""
    until: float
    """The time at which a newer record of the sender arrives, ns; inf: never, or the message is no record."""
    looks: list[int]
    """The times at which the receiver looked, ns, ascending; see `looks`."""

    def is_read(self, end: float = inf) -> bool:
        """Return whether the receiver looked while the message was the newest, up to and including `end`, ns."""
        index = bisect_left(self.looks, self.since)
        return index < len(self.looks) and self.looks[index] <= min(end, self.until)

    def last_look(self) -> float:
        """Return when the receiver looked for the last time up to `until`, ns; -inf: never."""
        index = bisect_right(self.looks, self.until)
        return self.looks[index - 1] if index else -inf


def readings(sent: list[MessageCopy], looks_of: dict[int, list[int]]) -> list[ReadingTime]:
    """Return when each message was the newest of its sender at its receiver, in the order of sending."""
    newer_arrival: dict[tuple[int, int], float] = {}
    last_first: list[ReadingTime] = []
    for copy in reversed(sent):
        since = copy.sent if copy.arrival == LOST else copy.arrival
        until = newer_arrival.get((copy.src, copy.dst), inf) if copy.seq is not None else inf
        last_first.append(ReadingTime(copy, since, until, looks_of.get(copy.dst, [])))
        if copy.seq is not None and copy.arrival != LOST:
            newer_arrival[copy.src, copy.dst] = min(until, copy.arrival)
    return last_first[::-1]
