"""The newest record that each pursuer had of every other pursuer, over time.

A record is a state, such as an action, that a pursuer has announced (`desim.kernel.core.records`). This pursuer is its
source; a reader receives the record directly or over several hops. Of the records of one source that have arrived, a
reader keeps the one with the highest sequence number. An older record that arrives later is ignored.

Kept equal to a loop over the trace by
`tests/analysis/test_age.py::test_ages_and_beliefs_equal_those_of_a_plain_loop_over_the_trace`.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise, repeat
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desim.analysis.deception import first_lies
from desim.analysis.trace_index import ended, places_of, remembered, require_messages, started, traced_events
from desim.config.arrays import Integers
from desim.kernel.core.events import LOST, Broadcast, ClockCorrected, Delivered, Lost, Sent
from desim.kernel.core.records import Record
from desim.kernel.core.units import SECOND, nanoseconds
from desim.kernel.models.clock_skew import clock_errors
from desim.kernel.models.faults import Crash
from desim.kernel.models.traced_faults import FaultEnded
from desim.kernel.wandering_clock import clock_walks
from desim.pursuit.team.announcements import action_in_game, own_records, relayed_records
from desim.simulation.run import Result

Pieces = NDArray[np.void]
"""Rows of `PIECE`: each is a period in which a reader had the same newest record of a source.

They are sorted by reader, then by the reader's period between two losses of memory, then by source and time.
"""

PIECE = np.dtype(
    [
        ("reader", np.int64),
        ("source", np.int64),
        ("created", np.int64),  # time of the announcement by the source, ns; for an initial belief, `begin`
        ("active", np.int32),  # action of the source as received: the evader that it chases, or 0
        ("presumed", np.bool_),  # whether the row is an initial belief instead of a record received
        ("begin", np.int64),  # time of arrival, ns; for an initial belief, the start of the run or the loss of memory
        ("after", np.int64),  # trace position: the events at `begin` that are in the period are those after it
        ("until", np.int64),  # time at which a newer record arrived, the memory was lost or the run ended, ns
        ("before", np.int64),  # trace position: the events at `until` that are in the period are those before it
        ("superseded", np.bool_),  # whether the arrival of a newer record ended the period
    ]
)
FIRST, LAST = -1, int(np.iinfo(np.int64).max)
"""Positions in the trace before and after all events."""
DELIVERED = -1
"""Stands for the number of a transmission in the row of a delivery by a transport, to which no `Lost` refers."""
ROUNDING = 100
"""Error of a time computed from a stamp, ns: a stamp is rounded to 1 ns, and the slowest clock takes 100 ns for it."""
ROWS = 1 << 12
"""Number of rows of a batch, so few that numpy reuses the memory of the temporary arrays."""


@remembered
def knowledge(result: Result) -> Pieces:
    """Return the newest record that each pursuer had of every other over time; O(n log n) for n received records.

    A period ends when a newer record arrives or the reader loses its memory. The action in a record is the attribute
    `active` of its body, an evader or 0; a record without an action does not change the known action. A relayed record
    of a node that does not exist is ignored.

    Raises:
        ValueError: if the trace lacks messages that were sent.
    """
    require_messages(result)
    profile, end = np.array(started(result).active, np.int64), ended(result).t
    announced, transmissions, receptions = _messages(result, len(profile), end)
    lives, size = _lives(result, receptions, end), len(profile)
    record_counts = transmissions.count[receptions.transmission]
    # Some of these rows stay unused if relays carry records back to their sources, or records arrive out of order.
    pieces, number = np.empty(len(lives.reader) * (size - 1) + record_counts.sum(), PIECE), 0
    for batch in lives.batches(size, record_counts):
        number += batch.fill(pieces[number:], announced, transmissions, receptions, profile)
    return pieces[:number]


@dataclass(frozen=True, slots=True)
class _Announcements:
    """The columns of a table of all records sent; messages to one node share the rows of a common body."""

    source: Integers
    rank: Integers
    """The rank of the sequence number among all numbers of the table and 0; the rank of 0 is 1."""
    created: Integers
    active: Integers
    """The evader that the source chases, or 0; -1 if the record has no action."""


@dataclass(frozen=True, slots=True)
class _Transmissions:
    """The columns of a table of transmissions and deliveries with records, one row each, in order of the trace."""

    place: Integers
    """The position in the trace."""
    first: Integers
    """The row in `_Announcements` of the first record carried."""
    count: Integers
    """Number of records carried."""


@dataclass(frozen=True, slots=True)
class _Receptions:
    """The columns of a table of receptions, one row each, in order of receiver, arrival and transmission."""

    dst: Integers
    arrival: Integers
    """ns"""
    transmission: Integers
    """The row in `_Transmissions`."""

    def between(self, first: int, last: int) -> "_Receptions":
        """Return the rows from `first` to before `last`."""
        return _Receptions(self.dst[first:last], self.arrival[first:last], self.transmission[first:last])

    def unpacked(self, transmissions: _Transmissions) -> tuple[Integers, Integers]:
        """Return, for each record received, the row of its reception in this table and its row in `_Announcements`."""
        count, first = transmissions.count[self.transmission], transmissions.first[self.transmission]
        if (count == 1).all():  # usual without relays
            return np.arange(len(count)), first
        # The records of a reception are successive: `first`, `first` + 1, ...
        reception = np.repeat(np.arange(len(count)), count)
        return reception, np.arange(len(reception)) + (first - np.cumsum(count) + count)[reception]


@dataclass(frozen=True, slots=True)
class _Lives:
    """The columns of a table of lives, in order of reader and time. A life is a period between two losses of memory."""

    edges: Integers
    """(lives + 1,) the row in `_Receptions` of the first reception of each life, and the number of receptions."""
    reader: Integers
    begin: Integers
    """Start of the run, or time of a loss of memory, ns."""
    until: Integers
    """Time of the next loss of memory, or end of the run, ns."""
    before: Integers
    """As in `PIECE`: `LAST` if the life ends with the run, else `FIRST`, because faults come first at an instant."""
    knows: Integers
    """1 if the reader knows the initial actions of all, else 0; also the rank of its initial beliefs.

    A network gives known initial actions the number 0, of rank 1; rank 0 is below that of any record.
    """

    def batches(self, size: int, record_counts: Integers) -> "Iterator[_Lives]":
        """Yield the lives in batches of about `ROWS` rows at most; one life may have more.

        A batch has at most 2^16 pairs of a life and a source, unless one life has more: numpy sorts integers of 16 bits
        in linear time.

        Args:
            size: number of pursuers.
            record_counts: number of records in each reception.
        """
        number = np.arange(len(self.reader))
        rows = np.append(0, np.cumsum(record_counts))[self.edges[:-1]] + number * size
        part, block = rows // ROWS, number // max((1 << 16) // size, 1)
        bounds = np.flatnonzero((np.diff(part) > 0) | (np.diff(block) > 0)) + 1
        for first, last in pairwise([0, *bounds.tolist(), len(number)]):
            columns = (self.reader, self.begin, self.until, self.before, self.knows)
            yield _Lives(self.edges[first : last + 1], *(column[first:last] for column in columns))

    def fill(
        self,
        rows: Pieces,
        announced: _Announcements,
        transmissions: _Transmissions,
        receptions: _Receptions,
        profile: Integers,
    ) -> int:
        """Write the newest records of the readers in these lives over time, and return the number of rows written.

        Args:
            rows: where to write, at least one row for each initial belief and each record received.
            announced: all records sent.
            transmissions: all transmissions.
            receptions: all receptions.
            profile: (N,) the initial action of each pursuer.
        """
        size, count, received = len(profile), len(self.reader), receptions.between(self.edges[0], self.edges[-1])
        reception, record = received.unpacked(transmissions)
        life_of = np.repeat(np.arange(count), np.diff(self.edges))[reception]
        is_foreign = announced.source[record] != self.reader[life_of]
        if not is_foreign.all():  # a relay may carry a record back to its source
            reception, record, life_of = reception[is_foreign], record[is_foreign], life_of[is_foreign]
        # A pair of a life and a source is numbered life * size + source. The rows are the initial belief of each pair,
        # then all records received, in order of arrival.
        initial_pairs = np.delete(np.arange(count * size), np.arange(count) * size + self.reader)
        lives, sources = np.divmod(initial_pairs, size)

        def column(of_beliefs: int | Integers, of_records: Integers) -> Integers:
            return np.concatenate([np.broadcast_to(of_beliefs, len(initial_pairs)), of_records])

        pair = column(initial_pairs, life_of * size + announced.source[record])
        rank = column(self.knows[lives], announced.rank[record])
        order = np.argsort(pair.astype(np.min_scalar_type(count * size)), kind="stable")
        # In order of pair, then arrival, a row is newer than all earlier ones of its pair if this key exceeds theirs.
        # The slices `[: len(...)]` drop the appended value if there are no rows.
        key = (pair * (rank.max(initial=0) + 1) + rank)[order]
        order = order[np.append(True, key[1:] > np.maximum.accumulate(key)[:-1])[: len(key)]]
        active = column(self.knows[lives] * profile[sources], announced.active[record])[order]
        last_with_action = np.maximum.accumulate(np.where(active >= 0, np.arange(len(order)), 0))
        life = column(lives, life_of)[order]

        pieces = rows[: len(order)]
        pieces["reader"], pieces["source"] = self.reader[life], pair[order] - life * size
        pieces["created"] = column(self.begin[lives], announced.created[record])[order]
        pieces["active"], pieces["presumed"] = active[last_with_action], order < len(initial_pairs)
        begin = pieces["begin"] = column(self.begin[lives], received.arrival[reception])[order]
        after = pieces["after"] = column(FIRST, transmissions.place[received.transmission][reception])[order]
        superseded = np.append(np.diff(pair[order]) == 0, False)[: len(order)]
        pieces["until"] = np.where(superseded, np.roll(begin, -1), self.until[life])
        pieces["before"] = np.where(superseded, np.roll(after, -1), self.before[life])
        pieces["superseded"] = superseded
        return len(pieces)


def _lives(result: Result, receptions: _Receptions, end: int) -> _Lives:
    """Return the lives of all readers up to the end of the run, ns; a reader knows no initial actions after a loss."""
    memory_losses, size = _memory_losses(result), len(started(result).active)
    knows = int(result.scenario.announce.start == "known")
    lives, edges = list[tuple[int, int, int, int, int]](), list[int]()
    for reader, (first, last) in enumerate(pairwise(np.searchsorted(receptions.dst, np.arange(size + 1)).tolist())):
        losses = memory_losses.get(reader, [])
        # At an instant faults come first, so a record that arrives as the memory is lost belongs to the next life.
        edges += [first, *(first + np.searchsorted(receptions.arrival[first:last], losses)).tolist()]
        for k, (begin, until) in enumerate(pairwise([0, *losses, end])):
            lives.append((reader, begin, until, LAST if k == len(losses) else FIRST, knows if k == 0 else 0))
    return _Lives(np.array([*edges, len(receptions.dst)]), *np.array(lives, np.int64).T)


def _messages(result: Result, size: int, end: int) -> tuple[_Announcements, _Transmissions, _Receptions]:
    """Return the records sent, their transmissions, and the receptions up to `end` (ns)."""
    records: list[Record] = []
    # (place in the trace, first record, number of records, number, number of receivers) of each transmission, flat
    transmissions: list[int] = []
    nodes: list[tuple[int, ...]] = []  # the receivers of each transmission
    arrivals: list[Iterable[int]] = []  # ns, at these receivers
    # For messages to one node: first record and number of records, by the identity of the body, which copies share.
    carried: dict[int, tuple[int, int]] = {}
    clocks, events = _Clocks(result, size), result.trace.events
    for place in places_of(result, Broadcast, Sent, Delivered):
        event: Any = events[place]
        if isinstance(event, Broadcast):
            announced = clocks.true_records(event)
            transmissions += (place, len(records), len(announced), event.transmission, len(event.dst))
            records += announced
            # One tuple for all receivers: the pairs of `event.fates()` take ten times as long.
            nodes.append(event.dst)
            is_one_time = len(event.arrival) == 1
            arrivals.append(repeat(event.arrival[0], len(event.dst)) if is_one_time else event.arrival)
            continue
        if id(event.body) not in carried:
            announced = clocks.true_records(event)
            carried[id(event.body)] = len(records), len(announced)
            records += announced
        first, count = carried[id(event.body)]
        if count:
            number, arrival = (event.transmission, event.arrival) if isinstance(event, Sent) else (DELIVERED, event.t)
            transmissions += (place, first, count, number, 1)
            nodes.append((event.dst,))
            arrivals.append((arrival,))
    *columns, numbers, receiver_counts = np.array(transmissions, np.int64).reshape(-1, 5).T
    sent = np.repeat(np.arange(len(receiver_counts)), receiver_counts)  # the transmission of each message to one node
    node, at = (np.fromiter(chain.from_iterable(column), np.int64, len(sent)) for column in (nodes, arrivals))
    lost = [event.transmission * size + event.dst for event in traced_events(result, Lost)]
    arrived = np.flatnonzero((at != LOST) & (at <= end))
    arrived = arrived[~np.isin(numbers[sent[arrived]] * size + node[arrived], lost)]
    # Stable sorts: the rows are in order of `sent`, and nearly in order of `at`, so that the first sort is fast.
    arrived = arrived[np.argsort(at[arrived], kind="stable")]
    arrived = arrived[np.argsort(node[arrived].astype(np.min_scalar_type(size)), kind="stable")]
    table = _columns(records, len(started(result).evaders))
    return table, _Transmissions(*columns), _Receptions(node[arrived], at[arrived], sent[arrived])


class _Clocks:
    """The errors of the nodes' clocks, and the times at which records were published.

    The time stamp of a record is a reading of its source's clock, unless another pursuer forged the record.
    """

    def __init__(self, result: Result, size: int):
        scenario = result.scenario
        faults = scenario.network_faults if scenario.protocol_traits.embodied else ()  # as `TeamNetwork` has them
        self._errors = clock_errors(faults, size, result.seed)
        self._walks = clock_walks(faults, self._errors, result.seed, nanoseconds(scenario.horizon))
        self._corrections: dict[int, list[tuple[int, float]]] = {}
        """By node: the time, ns, and the value, s, of each correction, the newest first."""
        for correction in traced_events(result, ClockCorrected):
            self._corrections.setdefault(correction.node, [(0, 0.0)]).insert(0, (correction.t, correction.correction))
        self._lies = first_lies(result)
        self._published: dict[tuple[int, int], int] = {}
        """By source and sequence number, the time of publication, ns."""
        self._are_exact = not (self._corrections or any(map(any, self._errors)) or any(self._walks))

    def true_records(self, event: Broadcast | Sent | Delivered) -> Sequence[Record]:
        """Return the records in a transmission or delivery, forwarded or the sender's own, with true time stamps."""
        relayed = relayed_records(event.body)
        if relayed is None:
            if not self._are_exact:
                self._note_publication(event)
            return own_records(event)
        records = [record for record in relayed if record.src < len(self._errors)]
        if self._are_exact:
            return records
        return [record._replace(stamp=self._publication_time(record, event)) for record in records]

    def _note_publication(self, event: Broadcast | Sent | Delivered) -> None:
        """Note when a record is published: when its source broadcasts it, or sends the first frame that carries it.

        Otherwise a copy that a pursuer with a Byzantine fault forwards could count as the first transmission.
        """
        if isinstance(event, Broadcast):
            self._published.setdefault((event.src, event.seq), event.created)
        for record in relayed_records(getattr(event.body, "body", None)) or ():
            if record.src < len(self._errors):
                self._publication_time(record, event)

    def _publication_time(self, record: Record, event: Broadcast | Sent | Delivered) -> int:
        """Return the true time, ns, at which a record in a transmission or delivery was published.

        If a pursuer with a Byzantine fault is the first to transmit a record, it may have forged the record. Then the
        time of that transmission counts, not the stamp.
        """
        key = record.src, record.seq
        if key not in self._published:
            is_suspect = self._lies.get(event.src, inf) <= event.created
            time = event.created if is_suspect else self._time_of_stamp(record.src, record.stamp, event.created)
            self._published[key] = min(time, event.created)
        return self._published[key]

    def _time_of_stamp(self, node: int, stamp: int, latest: int) -> int:
        """Return the last true time up to `latest`, ns, at which the clock of a node showed a stamp, ns.

        A clock that was set back showed some stamps twice. One that was set forward skipped some stamps; the result for
        these is the time at which an earlier correction would have shown them.
        """
        (offset, drift), walk = self._errors[node], self._walks[node]
        time = 0
        for begin, correction in self._corrections.get(node, [(0, 0.0)]):
            uncorrected = stamp - (offset + correction) * SECOND
            time = round(uncorrected / (1.0 + drift)) if walk is None else nanoseconds(walk.when(uncorrected / SECOND))
            if begin - ROUNDING <= time <= latest + ROUNDING:
                break
        return time


def _columns(records: list[Record], evaders: int) -> _Announcements:
    """Return the table of the records, given the number of evaders."""
    source, seq, created, bodies = zip(*records, strict=True) if records else ((),) * len(Record._fields)
    active = [-1 if (action := action_in_game(body, evaders)) is None else action for body in bodies]
    _, rank = np.unique([0, *seq], return_inverse=True)
    return _Announcements(*(np.array(column, np.int64) for column in (source, rank[1:] + 1, created, active)))


def _memory_losses(result: Result) -> dict[int, list[int]]:
    """Return the times, ns, at which each pursuer lost its memory: at the end of each crash with `memory` = false."""
    memory_losses: dict[int, list[int]] = {}
    for over in traced_events(result, FaultEnded):
        if isinstance(over.fault, Crash) and not over.fault.memory:
            memory_losses.setdefault(over.fault.node, []).append(over.t)
    return memory_losses
