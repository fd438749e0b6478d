"""The newest record of each source that has arrived at each node.

A record holds the state of its source at one time. A record whose arrival is certain needs no SimPy event. It is stored
at transmission with its arrival time; `latest_records` and `matching` ignore it until that time. A record that can
still be lost on arrival is stored when its outcome is decided (`Records.insert`, `Records.receive`).
"""

from bisect import insort
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from itertools import chain, repeat
from typing import Any, NamedTuple

from desim.kernel.clock import SECOND, Clock


class Record(NamedTuple):
    """The state of node `src` at one time; `seq` orders the records of the node."""

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
"""Length above which a list of unread records is merged into its table; a flat list has two items per record."""


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
        for src, received in self.exceptions.get(node, {}).items():
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


class Records:
    """The tables of received records of all nodes.

    Args:
        env: the clock of the simulation.
        size: number of nodes.
        predicate: selects, by their bodies, the records that `matching` returns; if None, `matching` returns none.
        repeats: whether a record may be stored twice; the first arrival counts.
    """

    def __init__(self, env: Clock, size: int, predicate: Predicate | None, *, repeats: bool = False):
        self._env, self._size, self._predicate = env, size, predicate
        self._shared = SharedTable(predicate)
        # Records that are not shared (`share`) are kept for each node that reads them (reader): unread records, in
        # the order of transmission (_waiting); records in flight at the last read (_still_in_flight); and the newest
        # record of each source (_tables). The first two are flat lists (arrival, record, arrival, record ...). The
        # tuples (arrival, record) are created only on insertion into a table, so that the tuples of one table are
        # adjacent in memory.
        self._waiting: list[list[Any]] = [[] for _ in range(size)]
        self._still_in_flight: dict[int, list[Any]] = {}
        self._tables: list[Table] = [{} for _ in range(size)]
        self._matching: list[Table] = [{} for _ in range(size)] if predicate is not None else [{}] * size
        self._scheduled, self._merge_interval = 0, max(4096, size)
        self._out_of_order: set[int] = set()  # readers with unread records that are not in the order of transmission
        # Readers that get records maybe twice, or after newer ones: those that also get them by `relay`, or all.
        self._relayed = set(range(size)) if repeats else set[int]()
        self._all_but_one = -1 if repeats else size - 1  # number of receivers of a record that may be shared

    def set_initial_belief(self, record: Record) -> None:
        """Give all nodes an initial record now, unless they already have a record of the same source."""
        self._shared.set_initial_belief((self._env.now, record))

    def schedule(self, record: Record, receivers: list[int], arrival: Arrival, unreached: Collection[int] = ()) -> None:
        """Store a record with its arrival times.

        The cost is O(unreached nodes) if the record is shared (`share`), else O(receivers).

        Args:
            record: newer than every record of its source that was scheduled before.
            receivers: the nodes that the record reaches.
            arrival: the arrival times, ns.
            unreached: the nodes that the record does not reach.
        """
        if isinstance(arrival, int) and self.share(record, len(receivers) + len(unreached), arrival, unreached):
            return
        waiting = self._waiting
        for node, when in zip(receivers, per_receiver(arrival, len(receivers)), strict=True):
            pending = waiting[node]
            pending.append(when)  # two calls of `append` are faster than one of `extend`
            pending.append(record)
        self._note_unread()

    def share(self, record: Record, transmitted: int, arrival: int, unreached: Collection[int]) -> bool:
        """Store a record once for all nodes, as `schedule`, if it reaches most of all nodes at one instant.

        Args:
            record: as for `schedule`.
            transmitted: the number of nodes to which it was transmitted.
            arrival: its arrival time at all nodes that it reaches, ns.
            unreached: those of the nodes that it does not reach.

        Returns:
            Whether it has been stored.
        """
        if transmitted != self._all_but_one or 3 * len(unreached) > self._size:
            return False
        self._shared.schedule((arrival, record), unreached)
        if len(self._shared.waiting) > MAX_UNREAD:
            self._shared.apply_arrived(self._env.now)
        return True

    def relay(self, node: int, record: Record) -> None:
        """Store a record that a node has received by other means than a scheduled arrival; see `insert`."""
        self._relayed.add(node)
        self.insert([node], record)

    def insert(self, nodes: list[int], record: Record, unreached: Collection[int] = ()) -> None:
        """Store a transmitted record at nodes now; a node that has this or a newer record of its source ignores it.

        The nodes `unreached` do not get the record by this call.
        """
        now, waiting = self._env.now, self._waiting
        if self.share(record, len(nodes) + len(unreached), now, unreached):
            return
        for node in nodes:
            waiting[node] += now, record
        self._out_of_order.update(nodes)
        self._note_unread()

    def receive(self, nodes: list[int], times: list[int], records: Sequence[Record]) -> None:
        """Store transmitted records, in any order: record k reached node `nodes[k]` at `times[k]`, ns; see `insert`."""
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
        if not shared.table:
            return own.copy()
        known = shared.table_of(node)
        if own:
            known |= own if shared.only_initial else self._not_older_than_shared(node, own)
        return known

    def matching(self, node: int) -> Table:
        """Return the latest records whose body satisfies the predicate; cost O(new records + matches)."""
        self._apply_arrived(node)
        own, matching, shared = self._tables[node], self._matching[node], self._shared
        if not shared.table:
            return matching.copy()
        known = shared.matching_of(node)
        if own:
            known = {src: received for src, received in known.items() if _is_newer(received, own)}
            known |= self._not_older_than_shared(node, matching)
        return known

    def forget(self, node: int) -> None:
        """Delete all records that a node has received, initial beliefs included."""
        self._apply_arrived(node)
        self._shared.forget(node)
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
        return own + sum(self._size - 1 - self._shared.unreached(record) for record in shared)

    def _apply_arrived(self, node: int) -> None:
        """Move arrived records to the shared table and to the table of a node."""
        if self._shared.waiting:
            self._shared.apply_arrived(self._env.now)
        if self._waiting[node] or node in self._still_in_flight:
            self._merge(node)

    def _not_older_than_shared(self, node: int, own: Table) -> Table:
        """Return the records of a node's own table that are not older than its record in the shared table."""
        shared = self._shared.table_of(node) if node in self._shared.exceptions else self._shared.table
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
            self._out_of_order.remove(node)  # records of later transmissions are newer
        elif still_in_flight:
            still_in_flight = self._move_newer(node, _pairs(still_in_flight))
        for arrival, record in _pairs(fresh):
            if arrival > now:
                still_in_flight.append(arrival)
                still_in_flight.append(record)
            else:  # in the order of transmission, so newer than the record in the table
                # `| 0` copies a time > 1 s into 32 B: the sum that it was takes 48.
                table[record[0]] = received = (arrival | 0, record)  # src and body, by position for speed
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
                    table[record[0]] = arrival | 0, record
                else:
                    _store((arrival, record), table, matching, predicate)
        return still_in_flight

    def _move_in_any_order(self, node: int, pending: Iterable[TimedRecord]) -> list[Any]:
        """Do as `_move_newer` for a node with relayed records; if a record arrives twice, the first arrival counts."""
        still_in_flight: list[Any] = []
        now, table, matching = self._env.now, self._tables[node], self._matching[node]
        for arrival, record in pending:
            both = table.get(record.src), self._shared.known_by(node, record.src)
            known = [each for each in both if each is not None]
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
            self._shared.apply_arrived(self._env.now)
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
