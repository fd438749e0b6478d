"""Tables of received records: one that all nodes share, and one for each node.

A record that reaches most nodes at one instant is stored once, in the shared table. All other records are stored at
each node that they reach.
"""

from bisect import insort
from collections import defaultdict
from collections.abc import Collection, Iterable
from itertools import chain
from typing import Any

from desim.kernel.core.records import Predicate, Record, Table, TimedRecord, pairs


class SharedTable:
    """The records that reach all or most nodes at one instant, stored once for all nodes.

    A record waits until `apply_arrived` is called at or after its arrival time. It then enters the table, unless the
    table has a newer record of its source. A node that the record does not reach keeps the record that it had before,
    as an exception.

    Attributes:
        waiting: the waiting records, ordered by arrival.
        table: the newest record of each source at the last `apply_arrived`.
        matching: the records of the table whose body satisfies the predicate.
        exceptions: by node and source, the record that the node has instead of the record in the table; None: the node
            has no record of the source.
        only_initial: whether only initial beliefs have been added so far.
    """

    def __init__(self, predicate: Predicate | None):
        self._predicate = predicate
        self.waiting: list[TimedRecord] = []
        self.table: Table = {}
        self.matching: Table = {}
        self.exceptions: defaultdict[int, dict[int, TimedRecord | None]] = defaultdict(dict)
        self.only_initial = True
        self._unreached: dict[tuple[int, int], Collection[int]] = {}
        """By source and sequence number, the nodes that a waiting record does not reach."""
        self._excepted: dict[int, Collection[int]] = {}
        """By source, the nodes with an exception."""

    def set_initial_belief(self, received: TimedRecord) -> None:
        """Insert an initial belief at all nodes that have no record of its source."""
        src = received[1].src
        if src not in self.table:
            _store(received, self.table, self.matching, self._predicate)
        for node in self._excepted.get(src, ()):
            self.exceptions[node][src] = self.exceptions[node][src] or received

    def schedule(self, timed: TimedRecord, unreached: Collection[int]) -> None:
        """Let a record wait until its arrival time; it does not reach the nodes `unreached`."""
        self.only_initial = False
        if unreached:
            self._unreached[timed[1][:2]] = unreached
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
            unreached = self._unreached.pop(record[:2], ()) if self._unreached else ()
            if known is None or known[1][1] < record[1]:
                if unreached or self._excepted:
                    self._except(record[0], unreached, known)
                _store(timed, table, self.matching, self._predicate)
            else:
                for node in self._excepted.get(record[0], ()):
                    own = self.exceptions[node][record[0]]
                    if node not in unreached and (own is None or own[1][1] < record[1]):
                        self.exceptions[node][record[0]] = timed
        del self.waiting[:arrived]

    def known_by(self, node: int, src: int) -> TimedRecord | None:
        """Return the record that a node has of a source, an exception or from the table; None if it has no record."""
        own = self.exceptions.get(node, {})
        return own[src] if src in own else self.table.get(src)

    def table_of(self, node: int) -> Table:
        """Return the table as a node knows it: with its exceptions, and without its own record."""
        known = self.table.copy()
        known.pop(node, None)
        for src, received in self.exceptions[node].items() if node in self.exceptions else ():
            if received is not None:
                known[src] = received
            else:
                known.pop(src, None)
        return known

    def matching_of(self, node: int) -> Table:
        """Return the matching records among the records in `table_of` the node."""
        known = self.matching.copy()
        known.pop(node, None)
        for src, received in self.exceptions.get(node, {}).items():
            known.pop(src, None)
            if received is not None and self._predicate is not None and self._predicate(received[1].body):
                known[src] = received
        return known

    def forget(self, node: int) -> None:
        """Make a node forget all records of the table; it gets an exception for each."""
        self.exceptions[node] = {src: None for src in self.table if src != node}
        for src in self.exceptions[node]:
            self._excepted[src] = {node, *self._excepted.get(src, ())}

    def unreached(self, record: Record) -> int:
        """Return the number of nodes that a waiting record does not reach."""
        return len(self._unreached.get(record[:2], ()))

    def _except(self, src: int, unreached: Collection[int], known: TimedRecord | None) -> None:
        """Let some nodes keep the record that they have of a source, and end the exceptions of all other nodes.

        Args:
            src: the source.
            unreached: the nodes that the next record of the source does not reach.
            known: the present record of the source in the table; None if there is none.
        """
        exceptions = self.exceptions
        for node in self._excepted.pop(src, ()):
            if node not in unreached:
                del exceptions[node][src]
        for node in unreached:
            exceptions[node].setdefault(src, known)
        if unreached:
            self._excepted[src] = unreached


class OwnTables:
    """The records that are stored for each node, because they are not shared.

    An unread record is moved to the table of its node by `merge` at or after its arrival time, unless the table has a
    newer record of its source.

    Lists of unread records are flat: arrival, record, arrival, record ... The tuples (arrival, record) are created only
    on insertion into a table, so that the tuples of one table are adjacent in memory.

    Args:
        size: number of nodes.
        predicate: selects, by their bodies, the records of `matching`; None: none.
        shared: the table that all nodes share.

    Attributes:
        unread: by node, the records since the last merge, in the order of transmission.
        still_in_flight: by node, the records that were in flight at the last merge.
        tables: by node, the newest record of each source.
        matching: by node, the records of its table whose body satisfies the predicate.
        out_of_order: the nodes with unread records that are not in the order of transmission.
        relayed: the nodes that get records maybe twice, or after newer ones, as by other means than a transmission.
    """

    def __init__(self, size: int, predicate: Predicate | None, shared: SharedTable):
        self._predicate, self._shared = predicate, shared
        self.unread: list[list[Any]] = [[] for _ in range(size)]
        self.still_in_flight: dict[int, list[Any]] = {}
        self.tables: list[Table] = [{} for _ in range(size)]
        self.matching: list[Table] = [{} for _ in range(size)] if predicate is not None else [{}] * size
        self.out_of_order: set[int] = set()
        self.relayed: set[int] = set()

    def forget(self, node: int) -> None:
        """Delete the table of a node."""
        self.tables[node].clear()
        self.matching[node].clear()

    def in_flight(self, now: int) -> int:
        """Return the number of records in flight at `now` (ns)."""
        flat = chain(self.unread, self.still_in_flight.values())
        return sum(arrival > now for each in flat for arrival, _ in pairs(each))

    def merge(self, node: int, now: int) -> None:
        """Move the records that have arrived at a node by `now` (ns) to its table."""
        table, matching, fresh, predicate = self.tables[node], self.matching[node], self.unread[node], self._predicate
        still_in_flight = self.still_in_flight.pop(node, [])
        if node in self.relayed:
            still_in_flight, fresh = self._move_in_any_order(node, now, pairs(still_in_flight + fresh)), []
        elif node in self.out_of_order:
            still_in_flight, fresh = self._move_newer(node, now, pairs(still_in_flight + fresh)), []
            self.out_of_order.remove(node)  # records of later transmissions are newer
        elif still_in_flight:
            still_in_flight = self._move_newer(node, now, pairs(still_in_flight))
        for arrival, record in pairs(fresh):
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
        self.unread[node] = []
        if still_in_flight:
            self.still_in_flight[node] = still_in_flight

    def _move_newer(self, node: int, now: int, pending: Iterable[TimedRecord]) -> list[Any]:
        """Move arrived records to a node's table unless it has newer ones; return a flat list of those in flight."""
        still_in_flight: list[Any] = []
        table, matching, predicate = self.tables[node], self.matching[node], self._predicate
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

    def _move_in_any_order(self, node: int, now: int, pending: Iterable[TimedRecord]) -> list[Any]:
        """Do as `_move_newer` for a node with relayed records; if a record arrives twice, the first arrival counts."""
        still_in_flight: list[Any] = []
        table, matching = self.tables[node], self.matching[node]
        for arrival, record in pending:
            both = table.get(record.src), self._shared.known_by(node, record.src)
            known = [each for each in both if each is not None]
            if arrival > now:
                still_in_flight += arrival, record
            elif all((other.seq, -when) < (record.seq, -arrival) for when, other in known):
                _store((arrival, record), table, matching, self._predicate)
        return still_in_flight


def _store(received: TimedRecord, table: Table, matching: Table, predicate: Predicate | None) -> None:
    """Store a record in a table, and in the table of matching records if its body satisfies the predicate."""
    src = received[1].src
    table[src] = received
    if predicate is not None:
        if predicate(received[1].body):
            matching[src] = received
        else:
            matching.pop(src, None)
