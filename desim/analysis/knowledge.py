"""What each pursuer knew of each other, from when until when.

A reader knows the newest record of a source that has reached it: from the source itself or through others, whatever
the order in which records came.
"""

from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray

from desim.analysis.trace_index import Integers, ended, remembered, require_messages, started
from desim.kernel.clock import SECOND
from desim.kernel.events import LOST, Broadcast, Lost, Sent
from desim.kernel.faults import Crash, FaultEnded, clock_errors
from desim.kernel.records import Record
from desim.pursuit.announcements import records_in
from desim.simulation.run import Result

Pieces = NDArray[np.void]
"""Rows of `PIECE`, in order of reader, source and time."""

PIECE = np.dtype(
    [
        ("reader", np.int64),
        ("source", np.int64),
        ("created", np.int64),  # when the source announced it, ns
        ("active", np.int32),  # what the reader has heard that the source does: which evader it chases, or 0
        ("presumed", np.bool_),  # not heard, but known or presumed at first
        ("begin", np.int64),  # when it arrived, ns
        ("after", np.int64),  # the place in the trace after which it was known, among the events of `begin`
        ("until", np.int64),  # when it was superseded or forgotten, or the run ended, ns
        ("before", np.int64),  # the place in the trace up to which it was known, among the events of `until`
        ("superseded", np.bool_),  # whether that was by something newer
    ]
)
FIRST, LAST = -1, int(np.iinfo(np.int64).max)
"""Places before and after all others."""


@remembered
def knowledge(result: Result) -> Pieces:
    """Return what each pursuer knew of each other, from when until when; O(n log n) in the records received.

    A record counts from its arrival on if it is newer than what is known of its source, until a newer one arrives or
    its reader loses its memory. A body without an attribute `active` leaves what is heard of the action as it was.

    Raises:
        ValueError: if messages were sent and not recorded.
    """
    require_messages(result)
    profile, end = np.array(started(result).active, np.int64), ended(result).t
    said, hops = _messages(result, len(profile), end)
    edges = np.searchsorted(hops.dst, np.arange(len(profile) + 1))
    forgets = _forgets(result)
    lives = []
    for reader in range(len(profile)):
        mine = hops.between(edges[reader], edges[reader + 1])
        bounds = [0, *forgets.get(reader, []), end]
        # Faults come first at an instant: what arrives just as a life is over belongs to the next one.
        arrived = [0, *np.searchsorted(mine.arrival, bounds[1:-1]), len(mine.arrival)]
        for k, ((begin, until), span) in enumerate(zip(pairwise(bounds), pairwise(arrived), strict=True)):
            warm = k == 0 and result.scenario.announce.warm_start
            before = LAST if k == len(bounds) - 2 else FIRST
            life = _Life(reader, begin, until, before, profile if warm else np.zeros_like(profile), 0 if warm else -1)
            lives.append(life.pieces(said, mine.between(*span)))
    return np.concatenate(lives)


@dataclass(frozen=True, slots=True)
class _Announcements:
    """Every record that was told, each as often as it was; columns."""

    source: Integers
    seq: Integers
    created: Integers
    active: Integers
    """Which evader the source chases, or 0; -1 if it is not told."""


@dataclass(frozen=True, slots=True)
class _Receptions:
    """Transmissions to one receiver each, in order of receiver, arrival and place in the trace; columns."""

    dst: Integers
    arrival: Integers
    place: Integers
    first: Integers
    """The first record it carries, a row of `_Announcements`."""
    count: Integers
    """How many it carries."""

    def between(self, first: int, last: int) -> "_Receptions":
        """Return a part of them."""
        columns = (self.dst, self.arrival, self.place, self.first, self.count)
        return _Receptions(*(column[first:last] for column in columns))

    def unpacked(self) -> tuple[Integers, Integers]:
        """Return the hop and the row of `_Announcements` of each record that is carried."""
        hop = np.repeat(np.arange(len(self.dst)), self.count)
        start = np.cumsum(self.count) - self.count
        return hop, self.first[hop] + np.arange(len(hop)) - start[hop]


@dataclass(frozen=True, slots=True)
class _Life:
    """The time in which a reader forgets nothing, and what it presumes as it begins."""

    reader: int
    begin: int
    until: int
    before: int
    profile: Integers
    seq: int
    """Number of the records that it presumes; older ones tell it nothing new."""

    def pieces(self, said: _Announcements, hops: _Receptions) -> Pieces:
        """Return what the reader knew when, given what reached it."""
        hop, record = hops.unpacked()
        foreign = said.source[record] != self.reader
        hop, record = hop[foreign], record[foreign]
        others = np.delete(np.arange(len(self.profile)), self.reader)

        def column(presumed: int | NDArray[np.generic], heard: Integers) -> Integers:
            return np.concatenate([np.broadcast_to(presumed, len(others)), heard])

        source, seq = column(others, said.source[record]), column(self.seq, said.seq[record]) + 1
        # In order of source, then arrival, the running maximum of this key is the newest record so far.
        order = np.argsort(source.astype(np.int32), kind="stable")
        key = (source * (seq.max(initial=0) + 1) + seq)[order]
        newer = np.append(True, key[1:] > np.maximum.accumulate(key)[:-1])[: len(key)]
        order = order[newer]
        active = column(self.profile[others], said.active[record])[order]
        telling = np.maximum.accumulate(np.where(active >= 0, np.arange(len(order)), 0))

        pieces = np.empty(len(order), PIECE)
        pieces["reader"], pieces["source"] = self.reader, source[order]
        pieces["created"] = column(self.begin, said.created[record])[order]
        pieces["active"], pieces["presumed"] = active[telling], order < len(others)
        pieces["begin"] = column(self.begin, hops.arrival[hop])[order]
        pieces["after"] = column(FIRST, hops.place[hop])[order]
        pieces["until"], pieces["before"], pieces["superseded"] = self.until, self.before, False
        earlier = np.flatnonzero(pieces["source"][1:] == pieces["source"][:-1])
        pieces["until"][earlier] = pieces["begin"][earlier + 1]
        pieces["before"][earlier] = pieces["after"][earlier + 1]
        pieces["superseded"][earlier] = True
        return pieces


def _messages(result: Result, size: int, end: int) -> tuple[_Announcements, _Receptions]:
    """Return the records that were told, and the hops with which they arrived by the end, ns."""
    records: list[Record] = []
    fates: list[tuple[int, int]] = []
    carried: list[tuple[int, int, int, int, int]] = []  # receivers, flight, place, first record, records
    lost: list[int] = []
    clocks = _Clocks(result, size)
    for place, event in enumerate(result.trace):
        if isinstance(event, Broadcast | Sent):
            said, reached = clocks.true_records(event), list(event.fates())
            if said and reached:
                carried.append((len(reached), event.flight, place, len(records), len(said)))
                records += said
                fates += reached
        elif isinstance(event, Lost):
            lost.append(event.flight * size + event.dst)
    receivers, *columns = np.array(carried, np.int64).reshape(-1, 5).T
    flight, place_of, first, count = (np.repeat(column, receivers) for column in columns)
    node, at = np.fromiter(chain.from_iterable(fates), np.int64).reshape(-1, 2).T
    arrived = np.flatnonzero((at != LOST) & (at <= end) & ~np.isin(flight * size + node, lost))
    arrived = arrived[np.lexsort((place_of[arrived], at[arrived], node[arrived]))]
    return _columns(records), _Receptions(*(column[arrived] for column in (node, at, place_of, first, count)))


class _Clocks:
    """The clocks of the nodes: a record that is relayed bears the time of its source."""

    def __init__(self, result: Result, size: int):
        self._errors = clock_errors(result.scenario.fault, size, result.seed)
        self._right = not any(offset or drift for offset, drift in self._errors)

    def true_records(self, event: Broadcast | Sent) -> tuple[Record, ...]:
        """Return the records that a transmission carries, those that it relays or its own, with their true times."""
        relays = getattr(event.body, "records", None) is not None
        return tuple(map(self._set_right, records_in(event))) if relays and not self._right else records_in(event)

    def _set_right(self, record: Record) -> Record:
        offset, drift = self._errors[record.src]
        return record._replace(sent=round((record.sent - offset * SECOND) / (1.0 + drift)))


def _columns(records: list[Record]) -> _Announcements:
    active = [-1 if (action := getattr(record.body, "active", None)) is None else action for record in records]
    source, seq, created = ([record[k] for record in records] for k in range(3))
    return _Announcements(*(np.array(column, np.int64) for column in (source, seq, created, active)))


def _forgets(result: Result) -> dict[int, list[int]]:
    """Return when each pursuer forgot all it had heard, ns: as it recovered from a crash without its memory."""
    forgets: dict[int, list[int]] = {}
    for over in result.trace.of(FaultEnded):
        if isinstance(over.fault, Crash) and not over.fault.memory:
            forgets.setdefault(over.fault.node, []).append(over.t)
    return forgets
