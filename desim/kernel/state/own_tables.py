"""Tables of received records, one for each node: the records that do not reach most nodes at one instant."""

from collections import defaultdict
from collections.abc import Callable, Iterable
from itertools import chain
from typing import Any

from desim.kernel.core.records import Predicate, Record, Table, TimedRecord, pairs


class OwnTables:
    """The records that are stored once for each node that they reach, because they are not shared.

    An unread record is moved to the table of its node by `merge` at or after its arrival time, unless the table has a
    newer record of its source.

    Lists of unread records are flat: arrival, record, arrival, record ... The tuples (arrival, record) are created only
    on insertion into a table, so that the tuples of one table are adjacent in memory.

    Kept equal to a comparison of each record with the one before by
    `tests/kernel/test_records.py::test_each_node_reads_what_a_plain_model_delivers_one_by_one`.

    Args:
        size: number of nodes.
        predicate: selects, by their bodies, the records of `matching`; None: none.
        shared: returns the record of a source that a node has in the shared table (`SharedTable.known_by`), or None.

    Attributes:
        unread: by node, the records since the last merge, in the order of transmission.
        still_in_flight: by node, the records that were in flight at the last merge.
        tables: by node, the newest record of each source.
        matching: by node, the records of its table whose body satisfies the predicate.
        out_of_order: the nodes with unread records that are not in the order of transmission.
        relayed: the nodes that may get a record twice, or after a newer one, for example by `Records.relay`.
        relayed_up_to: by node and source, the greatest sequence number of a record that `Records.relay` has stored.
    """

    def __init__(self, size: int, predicate: Predicate | None, shared: Callable[[int, int], TimedRecord | None]):
        self._predicate, self._shared = predicate, shared
        self.unread: list[list[Any]] = [[] for _ in range(size)]
        self.still_in_flight: dict[int, list[Any]] = {}
        self.tables: list[Table] = [{} for _ in range(size)]
        self.matching: list[Table] = [{} for _ in range(size)] if predicate is not None else [{}] * size
        self.out_of_order: set[int] = set()
        self.relayed: set[int] = set()
        self.relayed_up_to: defaultdict[int, dict[int, int]] = defaultdict(dict)

    def put(self, nodes: Iterable[int], times: Iterable[int], records: Iterable[Record]) -> None:
        """Add unread records, each for a node and with its arrival time, ns."""
        unread = self.unread
        for node, when, record in zip(nodes, times, records, strict=False):  # `records` may be an endless `repeat`
            pending = unread[node]
            pending.append(when)  # two calls of `append` are faster than one of `extend`
            pending.append(record)

    def forget(self, node: int) -> None:
        """Delete the table of a node."""
        self.tables[node].clear()
        self.matching[node].clear()
        self.relayed_up_to.pop(node, None)

    def in_flight(self, now: int) -> int:
        """Return the number of records in flight at `now` (ns)."""
        flat = chain(self.unread, self.still_in_flight.values())
        return sum(arrival > now for records in flat for arrival, _ in pairs(records))

    def merge(self, node: int, now: int) -> None:
        """Move the records that have arrived at a node by `now` (ns) to its table."""
        table, matching, unread, predicate = self.tables[node], self.matching[node], self.unread[node], self._predicate
        still_in_flight = self.still_in_flight.pop(node, [])
        if node in self.relayed:
            still_in_flight, unread = self._move_in_any_order(node, now, pairs(still_in_flight + unread)), []
        elif node in self.out_of_order:
            still_in_flight, unread = self._move_newer(node, now, pairs(still_in_flight + unread)), []
            self.out_of_order.remove(node)  # what is transmitted from now on is newer than what was unread
        elif still_in_flight:
            still_in_flight = self._move_newer(node, now, pairs(still_in_flight))
        for arrival, record in pairs(unread):
            if arrival > now:
                still_in_flight.append(arrival)
                still_in_flight.append(record)
            else:  # unread records are in the order of transmission, so it is newer than the record in the table
                table[record[0]] = received = (arrival, record)  # src and body, by position for speed
                if predicate is not None:  # `_store`, inlined: its call would take a sixth of the time of a record
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
            stored = table.get(record[0])
            if arrival > now:
                still_in_flight.append(arrival)
                still_in_flight.append(record)
            elif stored is None or stored[1][1] < record[1]:  # src and seq, by position for speed
                _store((arrival, record), table, matching, predicate)
        return still_in_flight

    def _move_in_any_order(self, node: int, now: int, pending: Iterable[TimedRecord]) -> list[Any]:
        """Do as `_move_newer`, at a node that may get a record twice; of two arrivals of a record the first counts."""
        still_in_flight: list[Any] = []
        table, matching = self.tables[node], self.matching[node]
        for arrival, record in pending:
            if arrival > now:
                still_in_flight += arrival, record
                continue
            rank = record.seq, -arrival  # a newer record ranks higher, and of one record the earlier arrival
            stored, shared = table.get(record.src), self._shared(node, record.src)
            if (stored is None or (stored[1].seq, -stored[0]) < rank) and (
                shared is None or (shared[1].seq, -shared[0]) < rank
            ):
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
