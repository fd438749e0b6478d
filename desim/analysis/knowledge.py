"""What each pursuer knew of each other, from when until when.

A reader knows the newest record of a source that has reached it: from the source itself or through others, whatever
the order in which records came.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from desim.kernel.events import LOST, Broadcast, Lost, Queued, Sent, Tally
from desim.kernel.faults import Crash, Over
from desim.kernel.records import Record
from desim.pursuit.events import Ended, Started
from desim.simulation import Result

Integers = NDArray[np.int64]
Pieces = NDArray[np.void]
"""What was known from when until when: rows of `PIECE`, in order of reader, source and time."""

PIECE = np.dtype(
    [
        ("reader", np.int64),
        ("source", np.int64),
        ("created", np.int64),  # when the source announced it, ns
        ("active", np.bool_),  # what the reader believes that the source does
        ("presumed", np.bool_),  # known or presumed from the start, and not heard
        ("begin", np.int64),  # when it arrived, ns
        ("after", np.int64),  # the place in the trace after which it was known, among the events of `begin`
        ("until", np.int64),  # when it was superseded or forgotten, or the run ended, ns
        ("before", np.int64),  # the place in the trace up to which it was known, among the events of `until`
        ("superseded", np.bool_),  # whether that was by something newer
    ]
)
FIRST, LAST = -1, np.iinfo(np.int64).max
"""Places before and after all others."""


def known(result: Result) -> Pieces:
    """Return what each pursuer knew of each other, from when until when.

    A record counts from its arrival on if it is newer than what is known of its source; records number 0 are those
    that everyone presumes at first. A body without an attribute `active` leaves the belief as it was.

    Raises:
        ValueError: if messages were not recorded.
    """
    size, end = len(_start(result).active), _end(result)
    warm = result.scenario.announce.warm_start
    said, hops = _messages(result, size, end)
    edges = np.searchsorted(hops.dst, np.arange(size + 1))
    forgets = _forgets(result)
    lives = []
    for reader in range(size):
        believed = np.array(_start(result).active) if warm else np.zeros(size, np.bool_)
        rows = hops.between(edges[reader], edges[reader + 1])
        bounds = [0, *forgets.get(reader, []), end]
        for begin, until in pairwise(bounds):
            # Faults come first at an instant: what arrives as a life ends belongs to the next one, but for the last.
            last = until == end
            stop = len(rows.dst) if last else int(np.searchsorted(rows.arrival, until))
            start = int(np.searchsorted(rows.arrival, begin))
            life = _Life(reader, begin, until, LAST if last else FIRST)
            lives.append(life.pieces(believed, said, rows.between(start, stop)))
            believed = np.zeros(size, np.bool_)
    return np.concatenate(lives) if lives else np.empty(0, PIECE)


@dataclass(frozen=True, slots=True)
class _Said:
    """Every record that was told, each as often as it was; columns."""

    source: Integers
    seq: Integers
    created: Integers
    active: Integers
    """1, 0, or -1 if it is not said."""


@dataclass(frozen=True, slots=True)
class _Hops:
    """Transmissions to one receiver each, in order of receiver, arrival and place in the trace; columns."""

    dst: Integers
    arrival: Integers
    place: Integers
    first: Integers
    """Which record that was told is the first it carries."""
    count: Integers
    """How many it carries."""

    def between(self, first: int, last: int) -> "_Hops":
        """Return a part of them."""
        columns = (self.dst, self.arrival, self.place, self.first, self.count)
        return _Hops(*(column[first:last] for column in columns))


@dataclass(frozen=True, slots=True)
class _Life:
    """The time in which a reader forgets nothing."""

    reader: int
    begin: int
    until: int
    before: int

    def pieces(self, believed: NDArray[np.bool_], said: _Said, hops: _Hops) -> Pieces:
        """Return what the reader knew when, given what it believes at first and what reached it."""
        hop = np.repeat(np.arange(len(hops.dst)), hops.count)
        behind = np.cumsum(hops.count) - hops.count
        record = hops.first[hop] + np.arange(len(hop)) - behind[hop]
        foreign = said.source[record] != self.reader
        hop, record = hop[foreign], record[foreign]
        others = np.delete(np.arange(len(believed)), self.reader)

        def column(at_first: int | NDArray[np.generic], heard: Integers) -> Integers:
            """Return what was presumed of each other, then what was heard."""
            return np.concatenate([np.broadcast_to(at_first, len(others)), heard])

        source, seq = column(others, said.source[record]), column(0, said.seq[record])
        # In order of source and then of arrival, the running maximum of this key is the newest record yet.
        order = np.argsort(source.astype(np.int32), kind="stable")
        key = (source * (seq.max(initial=0) + 1) + seq)[order]
        fresh = np.concatenate([[True], key[1:] > np.maximum.accumulate(key)[:-1]])[: len(key)]
        order = order[fresh]
        active = column(believed[others], said.active[record])[order]
        told = np.maximum.accumulate(np.where(active >= 0, np.arange(len(order)), 0))

        pieces = np.empty(len(order), PIECE)
        pieces["reader"], pieces["source"] = self.reader, source[order]
        pieces["created"] = column(self.begin, said.created[record])[order]
        pieces["active"], pieces["presumed"] = active[told] == 1, order < len(others)
        pieces["begin"] = column(self.begin, hops.arrival[hop])[order]
        pieces["after"] = column(FIRST, hops.place[hop])[order]
        goes_on = pieces["source"][1:] == pieces["source"][:-1]
        pieces["until"], pieces["before"], pieces["superseded"] = self.until, self.before, False
        pieces["until"][:-1][goes_on] = pieces["begin"][1:][goes_on]
        pieces["before"][:-1][goes_on] = pieces["after"][1:][goes_on]
        pieces["superseded"][:-1] = goes_on
        return pieces


def _messages(result: Result, size: int, end: int) -> tuple[_Said, _Hops]:
    """Return the records that were told, and the transmissions that arrived with them before the end.

    Raises:
        ValueError: if messages were not recorded.
    """
    records: list[Record] = []
    dst: list[int] = []
    arrival: list[int] = []
    carried: list[tuple[int, int, int, int, int]] = []  # receivers, flight, place, first record, number of records
    lost: list[int] = []
    recorded = False
    for place, event in enumerate(result.trace):
        if isinstance(event, Broadcast | Sent):
            recorded = True
            told = _told(event)
            to = event.dst if isinstance(event, Broadcast) else (event.dst,)
            when = event.arrival if isinstance(event, Broadcast) else (event.arrival,)
            if told and to:
                carried.append((len(to), event.flight, place, len(records), len(told)))
                records += told
                dst += to
                arrival += when if len(when) == len(to) else when * len(to)
        elif isinstance(event, Lost):
            recorded = True
            lost.append(event.flight * size + event.dst)
        elif isinstance(event, Queued):
            recorded = True
    if not recorded and result.trace.of(Tally)[0].sent:
        raise ValueError("messages were sent but not recorded: set record.messages = true")
    receivers, *columns = np.array(carried, np.int64).reshape(-1, 5).T
    flight, place_of, first, count = (np.repeat(column, receivers) for column in columns)
    to_node, at = np.array(dst, np.int64), np.array(arrival, np.int64)
    arrived = np.flatnonzero((at != LOST) & (at <= end) & ~np.isin(flight * size + to_node, lost))
    arrived = arrived[np.lexsort((place_of[arrived], at[arrived], to_node[arrived]))]
    hops = _Hops(*(column[arrived] for column in (to_node, at, place_of, first, count)))
    return _columns(records), hops


def _told(event: Broadcast | Sent) -> tuple[Record, ...]:
    """Return the records that a transmission carries: those of others that it relays, or its own."""
    relayed: tuple[Record, ...] | None = getattr(event.body, "records", None)
    if relayed is not None:
        return relayed
    return (Record(event.src, event.seq, event.created, event.body),) if isinstance(event, Broadcast) else ()


def _columns(records: list[Record]) -> _Said:
    active = [-1 if (said := getattr(record.body, "active", None)) is None else int(said) for record in records]
    columns = ([record.src for record in records], [record.seq for record in records], [r.sent for r in records])
    return _Said(*(np.array(column, np.int64) for column in (*columns, active)))


def _forgets(result: Result) -> dict[int, list[int]]:
    """Return when each pursuer forgot all it had heard, ns: as it recovered from a crash without its memory."""
    forgets: dict[int, list[int]] = {}
    for over in result.trace.of(Over):
        if isinstance(over.fault, Crash) and not over.fault.memory:
            forgets.setdefault(over.fault.node, []).append(over.t)
    return forgets


def _start(result: Result) -> Started:
    return result.trace.of(Started)[0]


def _end(result: Result) -> int:
    return result.trace.of(Ended)[0].t
