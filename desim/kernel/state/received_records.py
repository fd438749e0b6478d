"""The newest record of each source that has arrived at each node.

A record holds the state of its source at one time. A record whose arrival is certain needs no SimPy event. It is stored
at transmission with its arrival time; `latest_records` and `matching` ignore it until that time. A record that can
still be lost on arrival is stored when its outcome is decided (`Records.insert`, `Records.receive`).

A record that reaches most nodes at one instant is stored once, in the table that all nodes share (`SharedTable`). All
other records are stored at each node that they reach (`desim.kernel.state.own_tables`).
"""

from bisect import insort
from collections import defaultdict
from collections.abc import Collection, Sequence
from itertools import repeat

from desim.kernel.core.clock import Clock
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.records import Arrival, Predicate, Record, Table, TimedRecord, per_receiver
from desim.kernel.state.own_tables import OwnTables

MAX_UNREAD = 2048
"""Length above which a list of unread records is merged into its table; a flat list has two items per record."""


class Records:
    """The tables of received records of all nodes.

    Args:
        env: the clock of the simulation.
        size: number of nodes.
        predicate: selects, by their bodies, the records that `matching` returns; if None, `matching` returns none.
        repeats: whether a record may be stored twice; the first arrival counts.
    """

    def __init__(self, env: Clock, size: int, predicate: Predicate | None, *, repeats: bool = False):
        self._env, self._size = env, size
        self._shared = SharedTable(predicate)
        self._own = OwnTables(size, predicate, self._shared.known_by)
        self._all_but_one = size - 1  # only a record transmitted to so many nodes may be shared; -1: none may
        self._scheduled, self._merge_interval = 0, max(4096, size)
        if repeats:
            self.expect_any_order()

    def expect_any_order(self) -> None:
        """From now on, accept records that are scheduled twice (the first arrival counts), or after a newer one."""
        # Every node then compares what arrives. No record is shared, because sharing relies on the order of
        # transmission.
        self._own.relayed.update(range(self._size))
        self._all_but_one = -1

    def set_initial_belief(self, record: Record) -> None:
        """Give all nodes an initial record now, unless they already have a record of the same source."""
        self._shared.set_initial_belief((self._env.now, record))

    def schedule(self, record: Record, receivers: list[int], arrival: Arrival, unreached: Collection[int] = ()) -> None:
        """Store a record with its arrival times.

        The cost is O(unreached nodes) if the record is shared (`share`), else O(receivers).

        Args:
            record: newer than every record of its source that was scheduled before; see also `expect_any_order`.
            receivers: the nodes that the record reaches.
            arrival: the arrival times, ns.
            unreached: the nodes that the record does not reach.
        """
        if isinstance(arrival, int) and self.share(record, len(receivers) + len(unreached), arrival, unreached):
            return
        self._own.put(receivers, per_receiver(arrival, len(receivers)), repeat(record))
        self._note_unread()

    def share(self, record: Record, transmitted: int, arrival: int, unreached: Collection[int]) -> bool:
        """Store a record once for all nodes if it was transmitted to all others and at most a third lose it.

        Args:
            record: as in `schedule`.
            transmitted: the number of nodes to which it was transmitted.
            arrival: its arrival time at all nodes that it reaches, ns.
            unreached: the nodes among these that it does not reach.

        Returns:
            Whether it has been stored.
        """
        if transmitted != self._all_but_one or 3 * len(unreached) > self._size:
            return False
        self._shared.schedule((arrival, record), unreached)
        if len(self._shared.waiting) > MAX_UNREAD:
            self._shared.apply_arrived(self._env.now)
        return True

    def is_news(self, node: int, record: Record) -> bool:
        """Return whether a node has got neither this record nor a newer one of its source by `relay`."""
        return self._own.relayed_up_to[node].get(record.src, -1) < record.seq

    def relay(self, node: int, record: Record) -> None:
        """Store a record that is news (`is_news`) and that a node receives now by other means than a transmission."""
        self._own.relayed.add(node)
        self._own.relayed_up_to[node][record.src] = record.seq
        self._own.unread[node] += self._env.now, record
        self._note_unread()

    def insert(self, nodes: list[int], record: Record) -> None:
        """Store a transmitted record at nodes now; a node that has this or a newer record of its source ignores it."""
        self.receive(nodes, [self._env.now] * len(nodes), [record] * len(nodes))

    def receive(self, nodes: list[int], times: list[int], records: Sequence[Record]) -> None:
        """Store transmitted records, in any order: record k reached node `nodes[k]` at `times[k]`, ns; see `insert`."""
        self._own.put(nodes, times, records)
        self._own.out_of_order.update(nodes)
        self._note_unread(len(nodes))

    def latest_records(self, node: int) -> Table:
        """Return the newest received record of each other node, by source; cost O(new records + sources)."""
        self._apply_arrived(node)
        own_table, shared = self._own.tables[node], self._shared
        if not shared.table:
            return own_table.copy()
        latest = shared.table_of(node)
        if own_table:
            latest |= own_table if shared.only_initial else self._not_older_than_shared(node, own_table)
        return latest

    def matching(self, node: int) -> Table:
        """Return the latest records whose body satisfies the predicate; cost O(new records + matches)."""
        self._apply_arrived(node)
        own_table, matching, shared = self._own.tables[node], self._own.matching[node], self._shared
        if not shared.table:
            return matching.copy()
        matches = shared.matching_of(node)
        if own_table:
            matches = {
                src: received
                for src, received in matches.items()
                if src not in own_table or own_table[src][1].seq < received[1].seq
            }
            matches |= self._not_older_than_shared(node, matching)
        return matches

    def forget(self, node: int) -> None:
        """Delete all records that a node has received, initial beliefs included."""
        self._apply_arrived(node)
        self._shared.forget(node)
        self._own.forget(node)

    def in_flight(self) -> int:
        """Return the number of records in flight, counted once per receiver."""
        now = self._env.now
        shared = [record for arrival, record in self._shared.waiting if arrival > now]
        not_arrived = portable_sum(self._size - 1 - self._shared.unreached(record) for record in shared)
        return self._own.in_flight(now) + not_arrived

    def _apply_arrived(self, node: int) -> None:
        """Move arrived records to the shared table and to the table of a node."""
        if self._shared.waiting:
            self._shared.apply_arrived(self._env.now)
        own_tables = self._own
        if own_tables.unread[node] or node in own_tables.still_in_flight:
            own_tables.merge(node, self._env.now)

    def _not_older_than_shared(self, node: int, own_table: Table) -> Table:
        """Return the records of a node's own table that are not older than its record in the shared table."""
        shared = self._shared.table_of(node) if node in self._shared.exceptions else self._shared.table
        return {
            src: received
            for src, received in own_table.items()
            if src not in shared or received[1].seq >= shared[src][1].seq
        }

    def _note_unread(self, count: int = 1) -> None:
        """Count unread records; at intervals, merge long lists, to bound the memory of nodes that do not read."""
        self._scheduled += count
        if self._scheduled >= self._merge_interval:
            self._scheduled, now = 0, self._env.now
            for node, unread in enumerate(self._own.unread):
                if len(unread) > MAX_UNREAD:
                    self._own.merge(node, now)


class SharedTable:
    """The records that reach all or most nodes at one instant, stored once for all nodes.

    A record waits until `apply_arrived` is called at or after its arrival time. It then enters the table, unless the
    table has a newer record of its source. A node that the record does not reach keeps the record that it had before,
    as an exception.

    Kept equal to a record stored at each node by
    `tests/kernel/test_records.py::test_each_node_reads_what_a_plain_model_delivers_one_by_one`.

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
        """By source and sequence number of a waiting record, the nodes that it does not reach."""
        self._excepted: dict[int, Collection[int]] = {}
        """By source, the nodes with an exception."""

    def set_initial_belief(self, received: TimedRecord) -> None:
        """Give an initial belief to all nodes that have no record of its source."""
        src = received[1].src
        if src not in self.table:
            self._store(received)
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
            stored = table.get(record[0])  # src and seq, by position for speed
            unreached = self._unreached.pop(record[:2], ()) if self._unreached else ()
            if stored is None or stored[1][1] < record[1]:
                if unreached or self._excepted:
                    self._except(record[0], unreached, stored)
                self._store(timed)
            else:  # the table has a newer record; the nodes that the newer one did not reach may need this one
                for node in self._excepted.get(record[0], ()):
                    exception = self.exceptions[node][record[0]]
                    if node not in unreached and (exception is None or exception[1][1] < record[1]):
                        self.exceptions[node][record[0]] = timed
        del self.waiting[:arrived]

    def _store(self, received: TimedRecord) -> None:
        """Store a record in the table, and among the matching records if its body satisfies the predicate."""
        src = received[1].src
        self.table[src] = received
        if self._predicate is not None:
            if self._predicate(received[1].body):
                self.matching[src] = received
            else:
                self.matching.pop(src, None)

    def known_by(self, node: int, src: int) -> TimedRecord | None:
        """Return the record that a node has of a source, its exception or that in the table; None if it has none."""
        exceptions = self.exceptions.get(node, {})
        return exceptions[src] if src in exceptions else self.table.get(src)

    def table_of(self, node: int) -> Table:
        """Return the table as a node knows it: with its exceptions, and without its own record."""
        latest = self.table.copy()
        latest.pop(node, None)
        for src, received in self.exceptions[node].items() if node in self.exceptions else ():
            if received is not None:
                latest[src] = received
            else:
                latest.pop(src, None)
        return latest

    def matching_of(self, node: int) -> Table:
        """Return those records of `table_of` that satisfy the predicate."""
        matches = self.matching.copy()
        matches.pop(node, None)
        for src, received in self.exceptions.get(node, {}).items():
            matches.pop(src, None)
            if received is not None and self._predicate is not None and self._predicate(received[1].body):
                matches[src] = received
        return matches

    def forget(self, node: int) -> None:
        """Make a node forget all records of the table, by an exception for each."""
        self.exceptions[node] = {src: None for src in self.table if src != node}
        for src in self.exceptions[node]:
            self._excepted[src] = {node, *self._excepted.get(src, ())}

    def unreached(self, record: Record) -> int:
        """Return the number of nodes that a waiting record does not reach."""
        return len(self._unreached.get(record[:2], ()))

    def _except(self, src: int, unreached: Collection[int], stored: TimedRecord | None) -> None:
        """Let some nodes keep the record that they have of a source, and end the exceptions of all other nodes.

        Args:
            src: the source.
            unreached: the nodes that keep it, because the next record of the source does not reach them.
            stored: the record of the source in the table, which the next one will replace; None if there is none.
        """
        exceptions = self.exceptions
        for node in self._excepted.pop(src, ()):
            if node not in unreached:
                del exceptions[node][src]
        for node in unreached:
            exceptions[node].setdefault(src, stored)
        if unreached:
            self._excepted[src] = unreached
