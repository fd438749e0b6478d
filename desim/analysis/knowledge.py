"""The newest record that each pursuer had of every other pursuer, over time.

A record is a state, such as an action, that a pursuer has announced (`desim.kernel.core.records`). This pursuer is its
source; a reader receives the record directly or over several hops. Of the records of one source that have arrived, a
reader keeps the one with the highest sequence number. An older record that arrives later is ignored.

Kept equal to a loop over the trace by
`tests/analysis/test_age.py::test_ages_and_beliefs_equal_those_of_a_plain_loop_over_the_trace`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise, repeat

import numpy as np
from numpy.typing import NDArray

from desim.analysis.deception import first_lies
from desim.analysis.trace_index import ended, remembered, require_messages, started
from desim.config.arrays import Integers
from desim.kernel.core.events import LOST, Broadcast, ClockCorrected, Delivered, Lost, Sent
from desim.kernel.core.records import Record
from desim.kernel.core.units import SECOND, nanoseconds
from desim.kernel.models.clock_skew import clock_errors
from desim.kernel.models.faults import Crash
from desim.kernel.models.traced_faults import FaultEnded
from desim.kernel.wandering_clock import clock_walks
from desim.pursuit.team.announcements import action_in_game, records_in, relayed_records
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
        ("presumed", np.bool_),  # whether it is an initial belief, not a record received
        ("begin", np.int64),  # time of arrival, ns; for an initial belief, the start of the run or the loss of memory
        ("after", np.int64),  # trace position; of the events at `begin`, only the later ones find the record known
        ("until", np.int64),  # time at which a newer record arrived, the memory was lost or the run ended, ns
        ("before", np.int64),  # trace position; of the events at `until`, only the earlier ones find the record known
        ("superseded", np.bool_),  # whether the arrival of a newer record ended the period
    ]
)
FIRST, LAST = -1, int(np.iinfo(np.int64).max)
"""Positions in the trace before and after all events."""
DELIVERED = -1
"""In place of the number of a transmission: a message that a transport has delivered, and that is not lost."""
ROUNDING = 100
"""ns; a stamp is rounded to 1 ns, which the slowest clock (`MIN_DRIFT`) takes 100 ns for."""


@remembered
def knowledge(result: Result) -> Pieces:
    """Return the newest record that each pursuer had of every other over time; O(n log n) for n received records.

    A record that is newer than the known one counts from its arrival until a newer one arrives or the reader loses its
    memory. A record without an action (an attribute `active` of its body, an evader or 0) does not change the known
    action. A relayed record of a node that does not exist is ignored.

    Raises:
        ValueError: if the trace lacks messages that were sent.
    """
    require_messages(result)
    profile, end = np.array(started(result).active, np.int64), ended(result).t
    announced, receptions = _messages(result, len(profile), end)
    edges = np.searchsorted(receptions.dst, np.arange(len(profile) + 1))
    memory_losses = _memory_losses(result)
    lives = []
    for reader in range(len(profile)):
        mine = receptions.between(edges[reader], edges[reader + 1])
        bounds = [0, *memory_losses.get(reader, []), end]
        # At an instant faults come first, so a record that arrives as the memory is lost belongs to the next period.
        arrived = [0, *np.searchsorted(mine.arrival, bounds[1:-1]), len(mine.arrival)]
        for k, ((begin, until), span) in enumerate(zip(pairwise(bounds), pairwise(arrived), strict=True)):
            is_known = k == 0 and result.scenario.announce.start == "known"
            before = LAST if k == len(bounds) - 2 else FIRST
            life = _Life(
                reader, begin, until, before, profile if is_known else np.zeros_like(profile), 0 if is_known else -1
            )
            lives.append(life.pieces(announced, mine.between(*span)))
    return np.concatenate(lives)


@dataclass(frozen=True, slots=True)
class _Announcements:
    """The columns of a table of all records sent; one row per record and transmission."""

    source: Integers
    seq: Integers
    created: Integers
    active: Integers
    """The evader that the source chases, or 0; -1 if the record has no action."""


@dataclass(frozen=True, slots=True)
class _Receptions:
    """The columns of a table of receptions, one row each, in order of receiver, arrival and `place`."""

    dst: Integers
    arrival: Integers
    place: Integers
    """The position of the transmission in the trace."""
    first: Integers
    """The row in `_Announcements` of the first record carried."""
    count: Integers
    """Number of records carried."""

    def between(self, first: int, last: int) -> "_Receptions":
        """Return the rows from `first` to before `last`."""
        columns = (self.dst, self.arrival, self.place, self.first, self.count)
        return _Receptions(*(column[first:last] for column in columns))

    def unpacked(self) -> tuple[Integers, Integers]:
        """Return, for each record received, the row of its reception in this table and its row in `_Announcements`."""
        reception = np.repeat(np.arange(len(self.dst)), self.count)
        start = np.cumsum(self.count) - self.count
        return reception, self.first[reception] + np.arange(len(reception)) - start[reception]


@dataclass(frozen=True, slots=True)
class _Life:
    """A period in which a reader keeps its memory; `profile` holds its initial beliefs, the action of each pursuer."""

    reader: int
    begin: int
    until: int
    before: int
    profile: Integers
    seq: int
    """Sequence number of the initial beliefs; records with this or a lower number are ignored."""

    def pieces(self, announced: _Announcements, receptions: _Receptions) -> Pieces:
        """Return the newest records of the reader over time, given its receptions in this period."""
        reception, record = receptions.unpacked()
        foreign = announced.source[record] != self.reader
        reception, record = reception[foreign], record[foreign]
        sources = np.delete(np.arange(len(self.profile)), self.reader)

        def column(presumed: int | NDArray[np.generic], heard: Integers) -> Integers:
            return np.concatenate([np.broadcast_to(presumed, len(sources)), heard])

        source, seq = column(sources, announced.source[record]), column(self.seq, announced.seq[record]) + 1
        # In order of source, then arrival, the running maximum of this key belongs to the newest record so far.
        order = np.argsort(source.astype(np.min_scalar_type(len(self.profile))), kind="stable")
        key = (source * (seq.max(initial=0) + 1) + seq)[order]
        newer = np.append(True, key[1:] > np.maximum.accumulate(key)[:-1])[: len(key)]
        order = order[newer]
        active = column(self.profile[sources], announced.active[record])[order]
        last_with_action = np.maximum.accumulate(np.where(active >= 0, np.arange(len(order)), 0))

        pieces = np.empty(len(order), PIECE)
        pieces["reader"], pieces["source"] = self.reader, source[order]
        pieces["created"] = column(self.begin, announced.created[record])[order]
        pieces["active"], pieces["presumed"] = active[last_with_action], order < len(sources)
        pieces["begin"] = column(self.begin, receptions.arrival[reception])[order]
        pieces["after"] = column(FIRST, receptions.place[reception])[order]
        pieces["until"], pieces["before"], pieces["superseded"] = self.until, self.before, False
        earlier = np.flatnonzero(pieces["source"][1:] == pieces["source"][:-1])
        pieces["until"][earlier] = pieces["begin"][earlier + 1]
        pieces["before"][earlier] = pieces["after"][earlier + 1]
        pieces["superseded"][earlier] = True
        return pieces


def _messages(result: Result, size: int, end: int) -> tuple[_Announcements, _Receptions]:
    """Return the records sent, and their receptions up to `end` (ns)."""
    records: list[Record] = []
    nodes: list[tuple[int, ...]] = []
    arrivals: list[Iterable[int]] = []
    # (number of receivers, transmission, place in the trace, first record, number of records) of each transmission
    carried: list[tuple[int, int, int, int, int]] = []
    lost: list[int] = []
    clocks = _Clocks(result, size)
    for place, event in enumerate(result.trace):
        if isinstance(event, Broadcast | Sent | Delivered):
            announced = clocks.true_records(event)
            # The receivers of a broadcast are taken as a whole: pairs of receiver and arrival take ten times as long.
            reached = event.dst if isinstance(event, Broadcast) else tuple(node for node, _ in event.fates())
            if announced and reached:
                number = DELIVERED if isinstance(event, Delivered) else event.transmission
                carried.append((len(reached), number, place, len(records), len(announced)))
                records += announced
                nodes.append(reached)
                if isinstance(event, Broadcast):
                    alike = len(event.arrival) == 1
                    arrivals.append(repeat(event.arrival[0], len(reached)) if alike else event.arrival)
                else:
                    arrivals.append(tuple(arrival for _, arrival in event.fates()))
        elif isinstance(event, Lost):
            lost.append(event.transmission * size + event.dst)
    receivers, *columns = np.array(carried, np.int64).reshape(-1, 5).T
    transmission, place_of, first, count = (np.repeat(column, receivers) for column in columns)
    node, at = (np.fromiter(chain.from_iterable(column), np.int64, len(place_of)) for column in (nodes, arrivals))
    arrived = np.flatnonzero((at != LOST) & (at <= end) & ~np.isin(transmission * size + node, lost))
    # In order of (node, at, place): the rows are in order of place, and nearly in order of `at`, which is then fast.
    arrived = arrived[np.argsort(at[arrived], kind="stable")]
    arrived = arrived[np.argsort(node[arrived].astype(np.min_scalar_type(size)), kind="stable")]
    return _columns(records, len(started(result).evaders)), _Receptions(
        *(column[arrived] for column in (node, at, place_of, first, count))
    )


class _Clocks:
    """The errors of the nodes' clocks, and the times at which records were published.

    The time stamp of a record is a reading of its source's clock, if it was not forged by another pursuer.
    """

    def __init__(self, result: Result, size: int):
        scenario = result.scenario
        faults = scenario.network_faults if scenario.protocol_traits.embodied else ()  # as `TeamNetwork` has them
        self._errors = clock_errors(faults, size, result.seed)
        self._walks = clock_walks(faults, self._errors, result.seed, nanoseconds(scenario.horizon))
        self._corrections: dict[int, list[tuple[int, float]]] = {}
        """By node: the time, ns, and the value, s, of each correction, the newest first."""
        for correction in result.trace.of(ClockCorrected):
            self._corrections.setdefault(correction.node, [(0, 0.0)]).insert(0, (correction.t, correction.correction))
        self._lies = first_lies(result)
        self._published: dict[tuple[int, int], int] = {}
        """By source and sequence number, the time of publication, ns."""
        self._right = not (self._corrections or any(map(any, self._errors)) or any(self._walks))

    def true_records(self, event: Broadcast | Sent | Delivered) -> Sequence[Record]:
        """Return the records in a transmission or delivery, forwarded or the sender's own, with true time stamps."""
        relayed = relayed_records(event.body)
        if relayed is None:
            if not self._right:
                self._note(event)
            return records_in(event)
        records = tuple(record for record in relayed if record.src < len(self._errors))
        if self._right:
            return records
        return tuple(record._replace(stamp=self._time(record, event)) for record in records)

    def _note(self, event: Broadcast | Sent | Delivered) -> None:
        """Note when a record is published: as its source broadcasts it, or in the first frame of a transport with it.

        A pursuer with a Byzantine fault may forward it later, and may be the first whose message arrives.
        """
        if isinstance(event, Broadcast):
            self._published.setdefault((event.src, event.seq), event.created)
        for record in relayed_records(getattr(event.body, "body", None)) or ():
            if record.src < len(self._errors):
                self._time(record, event)

    def _time(self, record: Record, event: Broadcast | Sent | Delivered) -> int:
        """Return the true time, ns, at which a record in a transmission or delivery was published.

        A record that a pursuer with a Byzantine fault transmits first may be forged: it was published then.
        """
        name = record.src, record.seq
        if name not in self._published:
            is_suspect = self._lies.get(event.src, event.created + 1) <= event.created
            shown = event.created if is_suspect else self._true(record.src, record.stamp, event.created)
            self._published[name] = min(shown, event.created)
        return self._published[name]

    def _true(self, node: int, stamp: int, latest: int) -> int:
        """Return the true time, ns, at which the clock of a node showed a stamp, ns; the last one up to `latest`.

        A clock that has stepped back showed some stamps twice, and one that has stepped forward did not show some.
        """
        (offset, drift), walk = self._errors[node], self._walks[node]
        time = 0
        for begin, correction in self._corrections.get(node, [(0, 0.0)]):
            shown = stamp - (offset + correction) * SECOND
            time = round(shown / (1.0 + drift)) if walk is None else nanoseconds(walk.when(shown / SECOND))
            if begin - ROUNDING <= time <= latest + ROUNDING:
                break
        return time


def _columns(records: list[Record], evaders: int) -> _Announcements:
    active = [-1 if (action := action_in_game(record.body, evaders)) is None else action for record in records]
    source, seq, created = ([record[k] for record in records] for k in range(3))
    return _Announcements(*(np.array(column, np.int64) for column in (source, seq, created, active)))


def _memory_losses(result: Result) -> dict[int, list[int]]:
    """Return the times, ns, at which each pursuer lost its memory: at the end of each crash with `memory` = false."""
    memory_losses: dict[int, list[int]] = {}
    for over in result.trace.of(FaultEnded):
        if isinstance(over.fault, Crash) and not over.fault.memory:
            memory_losses.setdefault(over.fault.node, []).append(over.t)
    return memory_losses
