"""One trace from the events of several processes."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from itertools import count
from typing import Any, NamedTuple

from desim.kernel.core.events import LOST, Broadcast, Cause, Event, Lost, MessageCounts, Sent, TransportCounts
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.records import Record
from desim.kernel.core.trace_file import events_of
from desim.live.link import DatagramFate, SentDatagram
from desim.live.wire import Wire
from desim.pursuit.core.events import Sampled
from desim.results.run_folder import EVENTS

UNREAD: Cause = "socket"
"""The cause of the loss of a datagram that its receiver has never read."""
WORLD, PURSUER, MESSAGE, LOSS, LAST = range(5)
"""The order of simultaneous events: of the world, of pursuers, of messages, losses, and the positions at the end."""


class _Fate(NamedTuple):
    """What becomes of a message at one receiver."""

    arrival: int
    """ns, or `LOST`"""
    cause: Cause


class Logs:
    """The reports of the pursuers of a live run.

    Args:
        wire: reads their datagrams.

    Attributes:
        crashed: by pursuer whose process was lost, the time at which the loss was noticed, ns.
        transports: the counts of the transports of each pursuer.
    """

    def __init__(self, wire: Wire):
        self._wire = wire
        self._departures: list[tuple[int, SentDatagram]] = []
        self._fates: defaultdict[int, dict[tuple[int, bool], DatagramFate]] = defaultdict(dict)
        """By number of a datagram, which includes its sender: its fates, by receiver and whether of a copy."""
        self._lines: list[str] = []
        self.crashed: dict[int, int] = {}
        self.transports: list[TransportCounts] = []

    def take(self, pursuer: int, departures: Iterable[Any], fates: Iterable[Any], lines: Iterable[str]) -> None:
        """Take a report of a pursuer; see `desim.live.pursuer`."""
        self._lines += lines
        for t, dst, causes, created, datagram in departures:
            lost = {int(node): cause for node, cause in causes.items()}
            sent = SentDatagram(t, tuple(dst), lost, created, bytes.fromhex(datagram))
            self._departures.append((pursuer, sent))
        for fate in map(DatagramFate._make, fates):
            reported, key = self._fates[fate.number], (fate.dst, fate.is_copy)
            if fate.cause and key in reported and reported[key].arrival != LOST:  # a loss replaces an arrival
                fate = fate._replace(arrival=reported[key].arrival)
            reported[key] = fate

    def merged(self, world: Iterable[Event], *, messages: bool) -> list[Event]:
        """Return all events of a run in order.

        Args:
            world: the events of the referee; the last is the end.
            messages: whether the messages are among them.
        """
        *world, ended = world
        end = ended.t
        rows = [(event.t, LAST if event.t == end and isinstance(event, Sampled) else WORLD, event) for event in world]
        rows += [(event.t, PURSUER, event) for event in events_of(self._lines, EVENTS) if event.t <= end]
        sizes: list[int] = []
        sent = [event for transmission in self._transmissions(end, sizes) for event in transmission]
        counts = _counts(end, sent, sizes)
        if messages:
            rows += [(event.t, LOSS if isinstance(event, Lost) else MESSAGE, event) for event in sent]
        rows.sort(key=lambda row: row[:2])
        return [*(event for _, _, event in rows), *_sum(end, self.transports), counts, ended]

    def _transmissions(self, end: int, sizes: list[int]) -> Iterator[Iterator[Event]]:
        """Yield the events of each transmission and of its copies, in order; append the bytes of each to `sizes`."""
        last_read = self._last_read()
        numbers = count()
        for src, sent in sorted(self._departures, key=lambda row: (row[1].t, row[0])):
            if sent.t > end:
                return
            reported, content = self._fates[sent.number], self._wire.decode(sent.datagram).content
            fates = {
                node: self._after_crash(reported[node, False])
                if (node, False) in reported
                else self._unknown(sent, node, end, last_read.get((src, node), 0))
                for node in sent.dst
            }
            copies = {node: self._after_crash(fate) for (node, is_copy), fate in reported.items() if is_copy}
            for by_node in (fates, copies) if copies else (fates,):
                sizes.append(len(sent.datagram))
                yield _events(next(numbers), src, sent, content, by_node, end)

    def _last_read(self) -> dict[tuple[int, int], int]:
        """Return, by sender and receiver, the transmission time of the last datagram that was read, ns."""
        last: dict[tuple[int, int], int] = {}
        for src, sent in self._departures:
            for node, _ in self._fates[sent.number]:
                last[src, node] = max(last.get((src, node), 0), sent.t)
        return last

    def _unknown(self, sent: SentDatagram, node: int, end: int, last_read: int) -> _Fate:
        """Return what has become of a message at a receiver that has not reported it."""
        if node in sent.causes:
            return _Fate(LOST, sent.causes[node])
        if node in self.crashed:
            return _Fate(LOST, "crash")
        # If a later datagram was read, this one was lost; else it was still in the socket at the end.
        return _Fate(LOST, UNREAD) if sent.t < last_read else _Fate(end + 1, "")

    def _after_crash(self, fate: DatagramFate) -> _Fate:
        """Return the fate of a datagram, which is lost if the process of its receiver was lost before its arrival."""
        down = self.crashed.get(fate.dst)
        is_down = down is not None and fate.arrival != LOST and fate.arrival >= down
        return _Fate(fate.arrival, "crash" if is_down else fate.cause)


def _events(
    number: int, src: int, sent: SentDatagram, content: Any, fates: dict[int, _Fate], end: int
) -> Iterator[Event]:
    """Yield the events of a transmission with a number, and of its losses up to the end, ns."""
    t, size, created = sent.t, len(sent.datagram), sent.created
    arrivals = tuple(fate.arrival for fate in fates.values())
    if isinstance(content, Record):
        yield Broadcast(t, number, src, content.seq, tuple(fates), arrivals, created, size, content.body)
    else:
        for node, arrival in zip(fates, arrivals, strict=True):
            yield Sent(t, number, src, node, arrival, created, size, content.body)
    for node, fate in fates.items():
        when = max(fate.arrival, t)
        if fate.cause and when <= end:
            yield Lost(when, number, src, node, fate.cause)


def _counts(end: int, events: list[Event], sizes: list[int]) -> MessageCounts:
    """Return the traffic up to the end, ns, given the events of messages, and the bytes of each transmission."""
    arrivals = [arrival for event in events if isinstance(event, Broadcast | Sent) for _, arrival in event.fates()]
    lost = Counter(event.cause for event in events if isinstance(event, Lost))
    in_flight = sum(arrival > end for arrival in arrivals)
    fates = len(arrivals), len(arrivals) - in_flight - lost.total(), lost.total(), in_flight
    return MessageCounts(end, *fates, dict(sorted(lost.items())), len(sizes), portable_sum(sizes), 0.0)


def _sum(end: int, transports: list[TransportCounts]) -> list[TransportCounts]:
    """Return the sum of the counts of transports up to the end, ns, if there are any."""
    if not transports:
        return []
    totals = {
        name: portable_sum(getattr(counts, name) for counts in transports)
        for name in TransportCounts._fields
        if name not in {"t", "given_up"}
    }
    causes = Counter[str]()
    for counts in transports:
        causes.update(counts.given_up)
    return [TransportCounts(t=end, given_up=dict(sorted(causes.items())), **totals)]  # type: ignore[arg-type]
