"""One trace from the events of several processes."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from itertools import count
from typing import Any, NamedTuple

from desim.kernel.core.events import (
    LOST,
    Broadcast,
    Cause,
    Event,
    Lost,
    MessageCounts,
    Sent,
    TransportCounts,
)
from desim.kernel.core.records import Record
from desim.kernel.core.trace_file import events_of
from desim.live.link import DatagramFate, SentDatagram
from desim.live.wire import Wire
from desim.pursuit.core.events import Ended, Sampled
from desim.results.run_folder import EVENTS

UNREAD: Cause = "socket"
"""The cause of the loss of a datagram that its receiver has never read."""


class Logs:
    """What the pursuers of a live run have reported.

    Args:
        wire: reads their datagrams.
    """

    def __init__(self, wire: Wire):
        self._wire = wire
        self.departures: list[tuple[int, SentDatagram]] = []
        self.outcomes: dict[tuple[int, int, bool], DatagramFate] = {}
        """By number, receiver, and whether it is of a copy."""
        self.lines: list[str] = []
        self.transports: list[TransportCounts] = []
        self._last_read: dict[tuple[int, int], int] = {}
        """By sender and receiver, when the last datagram that was read was sent, ns."""
        self.crashed: dict[int, int] = {}
        """By pursuer whose process was lost, when that was noticed, ns."""

    def sent(self, pursuer: int, rows: Iterable[Any]) -> None:
        """Take the transmissions of a pursuer."""
        for t, dst, causes, created, datagram in rows:
            lost = {int(node): cause for node, cause in causes.items()}
            self.departures.append((pursuer, SentDatagram(t, tuple(dst), lost, created, bytes.fromhex(datagram))))

    def arrived(self, rows: Iterable[Any]) -> None:
        """Take the outcomes of datagrams; a loss on arrival replaces an arrival."""
        for row in rows:
            outcome = DatagramFate(*row)
            key = outcome.number, outcome.dst, outcome.is_copy
            before = self.outcomes.get(key)
            if before is not None and outcome.cause and before.arrival != LOST:
                outcome = outcome._replace(arrival=before.arrival)
            self.outcomes[key] = outcome

    def merged(self, world: Iterable[Event], *, messages: bool) -> list[Event]:
        """Return all events of a run in order.

        Args:
            world: the events of the referee, which end with the last positions and the end.
            messages: whether the messages are among them.
        """
        *world, sampled, ended = world
        end = ended.t
        rows: list[tuple[int, int, Event]] = [(event.t, 0, event) for event in world]
        rows += [(event.t, 1, event) for event in events_of(self.lines, EVENTS) if event.t <= end]
        traffic = _Traffic(end)
        for pursuer, sent in self.departures:
            for node in sent.dst:
                if (sent.number, node, False) in self.outcomes:
                    last = self._last_read.get((pursuer, node), 0)
                    self._last_read[pursuer, node] = max(last, sent.t)
        numbers = count()
        for pursuer, sent in sorted(self.departures, key=lambda row: (row[1].t, row[0])):
            if sent.t <= end:
                rows += self._transmission(pursuer, sent, numbers, traffic)
        assert isinstance(sampled, Sampled) or sampled.t <= end
        assert isinstance(ended, Ended)
        rows.sort(key=lambda row: row[:2])
        kept = [event for _, _, event in rows if messages or not isinstance(event, Broadcast | Sent | Lost)]
        return [*kept, sampled, *self._counted(end), traffic.counts(), ended]

    def _transmission(
        self, src: int, sent: SentDatagram, numbers: Any, traffic: "_Traffic"
    ) -> Iterable[tuple[int, int, Event]]:
        """Yield a transmission and its losses, and those of its copies, each with its time and rank."""
        fates = {node: self._fate(src, sent, node, traffic.end) for node in sent.dst}
        yield from self._events(src, sent, fates, next(numbers), traffic)
        copies = {
            node: _Fate(outcome.arrival, outcome.cause)
            for node in sent.dst
            if (outcome := self.outcomes.get((sent.number, node, True))) is not None
        }
        if copies:
            yield from self._events(src, sent, copies, next(numbers), traffic)

    def _fate(self, src: int, sent: SentDatagram, node: int, end: int) -> "_Fate":
        if node in sent.causes:
            return _Fate(LOST, sent.causes[node])
        outcome = self.outcomes.get((sent.number, node, False))
        down = self.crashed.get(node)
        if outcome is None or outcome.src != src:
            if down is not None:
                return _Fate(LOST, "crash")
            # One that was still in the socket at the end has no successor; one that was lost in between has.
            return _Fate(LOST, UNREAD) if sent.t < self._last_read.get((src, node), 0) else _Fate(end + 1, "")
        if outcome.arrival != LOST and down is not None and outcome.arrival >= down:
            return _Fate(outcome.arrival, "crash")
        return _Fate(outcome.arrival, outcome.cause)

    def _events(
        self, src: int, sent: SentDatagram, fates: Mapping[int, "_Fate"], number: int, traffic: "_Traffic"
    ) -> Iterable[tuple[int, int, Event]]:
        content = self._wire.decode(sent.datagram).content
        arrivals, size, created = {node: fate.arrival for node, fate in fates.items()}, len(sent.datagram), sent.created
        traffic.transmit(sent, fates.values())
        if isinstance(content, Record):
            times = tuple(arrivals.values())
            yield (
                sent.t,
                2,
                Broadcast(sent.t, number, src, content.seq, tuple(fates), times, created, size, content.body),
            )
        else:
            for node, arrival in arrivals.items():
                yield sent.t, 2, Sent(sent.t, number, src, node, arrival, created, size, content.body)
        for node, fate in fates.items():
            if fate.cause and max(fate.arrival, sent.t) <= traffic.end:
                when = max(fate.arrival, sent.t)
                yield when, 3, Lost(when, number, src, node, fate.cause)

    def _counted(self, end: int) -> list[TransportCounts]:
        """Return the sum of the counts of transports, if there are any."""
        if not self.transports:
            return []
        totals: dict[str, Any] = defaultdict(int)
        causes: Counter[str] = Counter()
        for counts in self.transports:
            causes.update(counts.given_up)
            for name in counts._fields[1:]:
                if name != "given_up":
                    totals[name] += getattr(counts, name)
        return [TransportCounts(end, given_up=dict(sorted(causes.items())), **totals)]  # type: ignore[arg-type]


class _Fate(NamedTuple):
    """What becomes of a message at one receiver."""

    arrival: int
    """ns, or `LOST`"""
    cause: Cause


class _Traffic:
    """Counts the messages of a run that ends at a time, ns."""

    def __init__(self, end: int):
        self.end = end
        self._sent = self._transmissions = self._bytes = self._in_flight = 0
        self._lost: Counter[Cause] = Counter()

    def transmit(self, sent: SentDatagram, fates: Iterable[_Fate]) -> None:
        """Count a transmission."""
        self._transmissions += 1
        self._bytes += len(sent.datagram)
        for fate in fates:
            self._sent += 1
            if fate.arrival > self.end:
                self._in_flight += 1
            elif fate.cause:
                self._lost[fate.cause] += 1

    def counts(self) -> MessageCounts:
        """Return the counts."""
        lost = self._lost.total()
        delivered = self._sent - lost - self._in_flight
        by_cause = {cause: self._lost[cause] for cause in sorted(self._lost)}
        return MessageCounts(
            self.end, self._sent, delivered, lost, self._in_flight, by_cause, self._transmissions, self._bytes, 0.0
        )
