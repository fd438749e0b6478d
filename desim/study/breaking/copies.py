"""The messages of a run, numbered as `MessageFault` numbers them, and which of them could have had an effect."""

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterator
from math import inf
from typing import Any, NamedTuple

from desim.kernel.core.events import LOST, Broadcast, Lost, Queued, Sent
from desim.kernel.core.units import seconds
from desim.pursuit.core.events import Decided
from desim.pursuit.team.announcements import announced_action
from desim.simulation.run import Result


class MessageCopy(NamedTuple):
    """A message to one receiver: a broadcast counts once for each."""

    number: int
    """From 1 on, in the order of sending."""
    src: int
    dst: int
    sent: int
    """ns"""
    arrival: int
    """ns; `LOST` if it never arrived."""
    seq: int | None
    """The number of the record among those of its sender; None if it is no record."""
    action: int | None
    """The action that it announces; None if it announces none."""

    def __str__(self) -> str:
        """Return the number, the sender, the receiver, the time of sending, and the action."""
        told = "" if self.action is None else f", says {f'chases {self.action}' if self.action else 'stays'}"
        return f"message {self.number}: {self.src} to {self.dst}, sent at {seconds(self.sent):.3f} s{told}"


def copies(result: Result) -> list[MessageCopy]:
    """Return the messages of a run in the order of sending; its messages must be in its trace."""
    fates: dict[int, dict[int, tuple[int, int, int, int | None, Any]]] = {}
    for event in result.trace:
        if isinstance(event, Queued):
            fates.setdefault(event.transmission, {}).update(
                dict.fromkeys(event.dst, (event.src, event.t, LOST, None, None))
            )
        elif isinstance(event, Broadcast | Sent):
            seq = event.seq if isinstance(event, Broadcast) else None
            receivers = fates.setdefault(event.transmission, {})
            for dst, arrival in event.fates():
                receivers[dst] = event.src, event.created, arrival, seq, event.body
        elif isinstance(event, Lost):
            receivers = fates.setdefault(event.transmission, {})
            src, sent, _, seq, body = receivers.get(event.dst, (event.src, event.t, LOST, None, None))
            receivers[event.dst] = src, sent, LOST, seq, body
    ordered = ((dst, fate) for transmission in sorted(fates) for dst, fate in fates[transmission].items())
    return [
        MessageCopy(number, src, dst, sent, arrival, seq, announced_action(body))
        for number, (dst, (src, sent, arrival, seq, body)) in enumerate(ordered, start=1)
    ]


def looks(result: Result) -> dict[int, list[int]]:
    """Return when each pursuer decided or sent something, ns, ascending: it may have read its records then."""
    times: defaultdict[int, list[int]] = defaultdict(list)
    for event in result.trace:
        if isinstance(event, Decided):
            times[event.pursuer].append(event.t)
        elif isinstance(event, Broadcast | Sent | Queued):
            times[event.src].append(event.t)
    return times


def read_in_time(sent: list[MessageCopy], looks_of: dict[int, list[int]]) -> Iterator[tuple[MessageCopy, bool]]:
    """Yield each message, and whether its receiver looked while it was the newest of its sender there.

    A message that was lost counts from its sending on.
    """
    newer: dict[tuple[int, int], float] = {}
    for copy in reversed(sent):
        since = copy.sent if copy.arrival == LOST else copy.arrival
        until = newer.get((copy.src, copy.dst), inf) if copy.seq is not None else inf
        times = looks_of.get(copy.dst, [])
        at = bisect_left(times, since)
        yield copy, at < len(times) and times[at] <= until
        if copy.seq is not None and copy.arrival != LOST:
            newer[copy.src, copy.dst] = min(until, copy.arrival)
