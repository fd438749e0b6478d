"""The newest record of each source that has arrived at each node.

A record whose arrival is certain needs no SimPy event. It is stored at transmission with its arrival time;
`latest_records` and `matching` ignore it until then. A record that can still be lost on arrival is stored when its
outcome is decided (`Records.insert`, `Records.receive`).
"""

from bisect import insort
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, repeat
from typing import Any, NamedTuple

from desim.kernel.clock import SECOND, Clock


class Record(NamedTuple):
    """A state of node `src` at one time; `seq` orders its records."""

    src: int
    seq: int
    """Sequence number, from 1 on; 0: an initial belief, which all nodes are given at the start without a message."""
    stamp: int
    """Time stamp of the publication, by the clock of the source, ns."""
    body: Any

    @property
    def sent(self) -> float:
        """Time of the publication by the clock of the source, s."""
        return self.stamp / SECOND


TimedRecord = tuple[int, Record]
"""The arrival time of a record, ns (past or future), and the record."""
Table = dict[int, TimedRecord]
"""The newest received record of each source, with its arrival time, by source."""
Arrival = int | list[int]
"""Arrival times of a transmission at its receivers, ns; one number if all are equal."""
Predicate = Callable[[Any], object]
"""A function that selects bodies of records: its result is true for a match."""
MAX_UNREAD = 2048
"""Length of a flat list of unread records (two items per record) above which `_note_unread` merges it."""


class SharedTable:
    """The records that reach all nodes but their source at one instant, stored once for all nodes.

    A record waits until `apply_arrived` is called at or after its arrival time. It then enters the table, unless the
    table has a newer record of its source.

    Attributes:
        waiting: the waiting records, ordered by arrival.
        table: the newest record of each source at the last `apply_arrived`.
        matching: the records of the table whose body satisfies the predicate.
        only_initial: whether only initial beliefs have been added so far.
    """

    def __init__(self, predicate: Predicate | None):
        self._predicate = predicate
        self.waiting: list[TimedRecord] = []
        self.table: Table = {}
        self.matching: Table = {}
        self.only_initial = True

    def set_initial_belief(self, received: TimedRecord) -> None:
        """Insert an initial belief, unless the table has a record of its source."""
        if received[1].src not in self.table:
            _store(received, self.table, self.matching, self._predicate)

    def schedule(self, timed: TimedRecord) -> None:
        """Add a record to those waiting until their arrival times."""
        self.only_initial = False
        if self.waiting and timed < self.waiting[-1]:
            insort(self.waiting, timed)
        else:
            self.waiting.append(timed)

    def apply_arrived(self, now: int) -> None:
        """Move the records that have arrived by `now` (ns) to the table."""
        arrived, table = 0, self.table
        for timed in self.waiting:
            arrival, record = timed
            if arrival > now:
                break
            arrived += 1
            known = table.get(record[0])  # src and seq, by position for speed
            if known is None or known[1][1] < record[1]:
                _store(timed, table, self.matching, self._predicate)
        del self.waiting[:arrived]


class Records:
    """The tables of received records of all nodes.

    Args:
        env: the clock of the simulation.
        size: number of nodes.
        predicate: selects, by their bodies, the records that `matching` returns; if None, it returns no records.
    """

    def __init__(self, env: Clock, size: int, predicate: Predicate | None):
        self._env, self._size, self._predicate = env, size, predicate
        self._shared = SharedTable(predicate)
        # Records that do not reach all nodes at one instant are kept per reader: unread records, in the order of
        # transmission (_waiting); records in flight at the last read (_still_in_flight); and the newest record per
        # source (_tables). The first two are flat lists (arrival, record, arrival, record ...): the tuples (arrival,
        # record) are created only on insertion into a table, so that the tuples of one table are adjacent in memory.
        self._waiting: list[list[Any]] = [[] for _ in range(size)]
        self._still_in_flight: dict[int, list[Any]] = {}
        self._tables: list[Table] = [{} for _ in range(size)]
        self._matching: list[Table] = [{} for _ in range(size)] if predicate is not None else [{}] * size
        self._scheduled, self._merge_interval = 0, max(4096, size)
        self._out_of_order: set[int] = set()  # readers with unread records that are not in the order of transmission
        self._relayed: set[int] = set()  # readers that get records by other ways, even before they are transmitted
        self._apart: set[int] = set()  # readers with their own copies of the shared records

    def set_initial_belief(self, record: Record) -> None:
        """Give all nodes an initial record now, unless they already have a record of the same source."""
        received = self._env.now, record
        self._shared.set_initial_belief(received)
        for node in self._apart - {record.src}:
            if record.src not in self._tables[node]:
                _store(received, self._tables[node], self._matching[node], self._predicate)

    def schedule(self, record: Record, receivers: list[int], arrival: Arrival) -> None:
        """Store a record with its arrival times; O(1) if it reaches all nodes at one instant, else O(receivers).

        Args:
            record: newer than every record of its source that was scheduled before.
            receivers: the nodes it reaches.
            arrival: the arrival times, ns.
        """
        waiting = self._waiting
        if isinstance(arrival, int) and self._reaches_all_others(record.src, receivers):
            self._shared.schedule((arrival, record))
            if not self._apart:
                return
            receivers = self._apart_among(record.src, receivers)
        for node, when in zip(receivers, per_receiver(arrival, len(receivers)), strict=True):
            pending = waiting[node]
            pending.append(when)  # two calls of `append` are faster than one of `extend`
            pending.append(record)
        self._note_unread()

    def relay(self, node: int, record: Record) -> None:
        """Store a record that a node has received by other ways than `schedule`; see `insert`."""
        self._relayed.add(node)
        self.insert([node], record)

    def insert(self, nodes: list[int], record: Record) -> None:
        """Store a transmitted record at nodes now; a node that has this or a newer record of its source ignores it."""
        now, waiting = self._env.now, self._waiting
        if self._reaches_all_others(record.src, nodes):
            self._shared.schedule((now, record))
            nodes = self._apart_among(record.src, nodes)
        for node in nodes:
            waiting[node] += now, record
        self._out_of_order.update(nodes)
        self._note_unread()

    def receive(self, nodes: list[int], times: list[int], records: Sequence[Record]) -> None:
        """Store transmitted records, each at a node that it reached at a time (ns); as `insert`, in any order."""
        waiting = self._waiting
        for node, when, record in zip(nodes, times, records, strict=True):
            pending = waiting[node]
            pending.append(when)
            pending.append(record)
        self._out_of_order.update(nodes)
        self._note_unread(len(nodes))

    def latest_records(self, node: int) -> Table:
        """Return the newest received record of each other node, by source; cost O(new records + sources)."""
        self._apply_arrived(node)
        own, shared = self._tables[node], self._shared
        if not shared.table or node in self._apart:
            return own.copy()
        known = shared.table.copy()
        known.pop(node, None)
        if own:
            known |= own if shared.only_initial else self._not_older_than_shared(own)
        return known

    def matching(self, node: int) -> Table:
        """Return those of `latest_records` whose body satisfies the predicate; cost O(new records + matches)."""
        self._apply_arrived(node)
        own, matching, shared = self._tables[node], self._matching[node], self._shared
        if not shared.table or node in self._apart:
            return matching.copy()
        known = shared.matching.copy()
        known.pop(node, None)
        if own:
            known = {src: received for src, received in known.items() if _is_newer(received, own)}
            known |= self._not_older_than_shared(matching)
        return known

    def separate(self, node: int) -> None:
        """Give a node its own copies of the shared records, so that it may miss some of the records to come.

        A record that reaches all other nodes at one instant is still stored once for them.
        """
        if node in self._apart:
            return
        known, matching = self.latest_records(node), self.matching(node)
        self._tables[node], self._matching[node] = known, matching
        self._apart.add(node)
        self._out_of_order.add(node)  # the copies are in the order of arrival
        self._waiting[node] += [item for timed in self._shared.waiting if timed[1].src != node for item in timed]

    def forget(self, node: int) -> None:
        """Delete all records that a node has received, initial beliefs included."""
        self.separate(node)
        self._apply_arrived(node)
        self._tables[node].clear()
        self._matching[node].clear()

    def in_flight(self) -> int:
        """Return the number of records in flight, counted once per receiver."""
        now = self._env.now
        own = sum(
            arrival > now
            for pending in chain(self._waiting, self._still_in_flight.values())
            for arrival, _ in _pairs(pending)
        )
        shared = [record for arrival, record in self._shared.waiting if arrival > now]
        return own + sum(self._size - 1 - len(self._apart - {record.src}) for record in shared)

    def _reaches_all_others(self, src: int, receivers: list[int]) -> bool:
        """Return whether the receivers are all nodes but the source, and but nodes that have their own copies."""
        if len(receivers) == self._size - 1:
            return True
        if not self._apart or len(receivers) < self._size - 1 - len(self._apart):
            return False
        apart = len(self._apart.intersection(receivers))
        return len(receivers) - apart == self._size - len(self._apart | {src})

    def _apart_among(self, src: int, receivers: list[int]) -> list[int]:
        """Return those of the receivers of a record that have their own copies of the shared records."""
        is_to_all = len(receivers) == self._size - 1
        return sorted(self._apart - {src} if is_to_all else self._apart.intersection(receivers))

    def _apply_arrived(self, node: int) -> None:
        """Move arrived records to the shared table and to the table of a node."""
        if self._shared.waiting:
            self._shared.apply_arrived(self._env.now)
        if self._waiting[node] or node in self._still_in_flight:
            self._merge(node)

    def _not_older_than_shared(self, own: Table) -> Table:
        """Return the records of a table that are not older than the record of their source in the shared table."""
        shared = self._shared.table
        return {src: each for src, each in own.items() if src not in shared or each[1].seq >= shared[src][1].seq}

    def _merge(self, node: int) -> None:
        """Move the records that have arrived at a node to its table."""
        now, table, matching, fresh = self._env.now, self._tables[node], self._matching[node], self._waiting[node]
        predicate = self._predicate
        still_in_flight = self._still_in_flight.pop(node, [])
        if node in self._relayed:
            still_in_flight, fresh = self._move_in_any_order(node, _pairs(still_in_flight + fresh)), []
        elif node in self._out_of_order:
            still_in_flight, fresh = self._move_newer(node, _pairs(still_in_flight + fresh)), []
            self._out_of_order.remove(node)  # what is transmitted from now on is newer than what was transmitted
        elif still_in_flight:
            still_in_flight = self._move_newer(node, _pairs(still_in_flight))
        for arrival, record in _pairs(fresh):
            if arrival > now:
                still_in_flight.append(arrival)
                still_in_flight.append(record)
            else:  # in the order of transmission, so newer than the record in the table
                table[record[0]] = received = (arrival, record)  # src and body, by position for speed
                if predicate is not None:
                    if predicate(record[3]):
                        matching[record[0]] = received
                    else:
                        matching.pop(record[0], None)
        self._waiting[node] = []
        if still_in_flight:
            self._still_in_flight[node] = still_in_flight

    def _move_newer(self, node: int, pending: Iterable[TimedRecord]) -> list[Any]:
        """Move arrived records to a node's table unless it has newer ones; return a flat list of those in flight."""
        still_in_flight: list[Any] = []
        now, table, matching, predicate = self._env.now, self._tables[node], self._matching[node], self._predicate
        for arrival, record in pending:
            known = table.get(record[0])
            if arrival > now:
                still_in_flight.append(arrival)
                still_in_flight.append(record)
            elif known is None or known[1][1] < record[1]:  # src and seq, by position for speed
                if predicate is None:
                    table[record[0]] = arrival, record
                else:
                    _store((arrival, record), table, matching, predicate)
        return still_in_flight

    def _move_in_any_order(self, node: int, pending: Iterable[TimedRecord]) -> list[Any]:
        """Do as `_move_newer` with records that also come by other ways, so that a record may arrive twice."""
        still_in_flight: list[Any] = []
        now, table, matching = self._env.now, self._tables[node], self._matching[node]
        shared = {} if node in self._apart else self._shared.table
        for arrival, record in pending:
            known = [each[record.src] for each in (table, shared) if record.src in each]
            if arrival > now:
                still_in_flight += arrival, record
            elif all((other.seq, -when) < (record.seq, -arrival) for when, other in known):
                _store((arrival, record), table, matching, self._predicate)
        return still_in_flight

    def _note_unread(self, count: int = 1) -> None:
        """Now and then, merge long lists of unread records, to bound the memory of nodes that do not read."""
        self._scheduled += count
        if self._scheduled >= self._merge_interval:
            self._scheduled = 0
            for node, waiting in enumerate(self._waiting):
                if len(waiting) > MAX_UNREAD:
                    self._merge(node)


def _store(received: TimedRecord, table: Table, matching: Table, predicate: Predicate | None) -> None:
    """Store a record in a table, and in the table of matching records if its body satisfies the predicate."""
    src = received[1].src
    table[src] = received
    if predicate is not None:
        if predicate(received[1].body):
            matching[src] = received
        else:
            matching.pop(src, None)


def _is_newer(received: TimedRecord, table: Table) -> bool:
    """Return whether a record is newer than the record of its source in a table, or the table has none."""
    known = table.get(received[1].src)
    return known is None or known[1].seq < received[1].seq


def per_receiver(arrival: Arrival, receivers: int) -> Iterable[int]:
    """Return the arrival time (ns) at each of `receivers` receivers."""
    return repeat(arrival, receivers) if isinstance(arrival, int) else arrival


def _pairs(flat: list[Any]) -> Iterator[TimedRecord]:
    """Return the pairs (arrival, record) of a flat list."""
    items = iter(flat)
    return zip(items, items, strict=True)
