"""What each node has heard of every other: the newest record of each source that has arrived by now.

Reading needs no event: a record is noted with its time of arrival, and counts from then on.
"""

from bisect import insort
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, repeat
from typing import Any, NamedTuple

from desim.kernel.clock import Clock


class Record(NamedTuple):
    """State that its source announced; `seq` orders the records of one source."""

    src: int
    seq: int
    """From 1 on; 0: presumed."""
    sent: int
    """When it was announced, by the clock of its source, ns."""
    body: Any


ReceivedRecord = tuple[int, Record]
"""A record and the nanosecond at which it arrived."""
Table = dict[int, ReceivedRecord]
"""The newest record of each source that has been heard of."""
Arrival = int | list[int]
"""When a transmission reaches its receivers, ns: one number if they get it together."""


Predicate = Callable[[Any], object]
"""Of a body, whether it is one that a reader looks for."""


class SharedTable:
    """What all nodes but its source hear at one instant, kept once for all of them.

    Attributes:
        waiting: what has yet to arrive, or to be looked at, by its arrival.
        table: the newest record of each source, as of the last `settle`.
        marked: those of them whose body is marked.
        presumed_only: whether none has been noted but what was known from the start.
    """

    def __init__(self, predicate: Predicate | None):
        self._predicate = predicate
        self.waiting: list[ReceivedRecord] = []
        self.table: Table = {}
        self.matching: Table = {}
        self.only_initial = True

    def set_initial_belief(self, heard: ReceivedRecord) -> None:
        """Enter a record that is known from the start, unless something is known of its source."""
        if heard[1].src not in self.table:
            _store(heard, self.table, self.matching, self._predicate)

    def schedule(self, heard: ReceivedRecord) -> None:
        """Let a record arrive."""
        self.only_initial = False
        if self.waiting and heard < self.waiting[-1]:
            insort(self.waiting, heard)
        else:
            self.waiting.append(heard)

    def apply_arrived(self, now: int) -> None:
        """Enter what has arrived in the table."""
        arrived, table = 0, self.table
        for heard in self.waiting:
            arrival, record = heard
            if arrival > now:
                break
            arrived += 1
            known = table.get(record[0])  # src and seq, by position for speed
            if known is None or known[1][1] < record[1]:
                _store(heard, table, self.matching, self._predicate)
        del self.waiting[:arrived]


class Records:
    """The tables of all nodes.

    Args:
        env: the clock of the simulation.
        size: number of nodes.
        mark: what `matching` looks for; nothing if None.
    """

    def __init__(self, env: Clock, size: int, predicate: Predicate | None):
        self._env, self._size, self._predicate = env, size, predicate
        self._shared = SharedTable(predicate)
        # What does not reach all alike is kept per reader, in the order of departure: what has not been looked at, what
        # had not arrived when it was, and a table. Both lists are flat (arrival, record, arrival, record ...), because
        # tuples that are made as they are entered lie together in memory.
        self._waiting: list[list[Any]] = [[] for _ in range(size)]
        self._late: dict[int, list[Any]] = {}
        self._tables: list[Table] = [{} for _ in range(size)]
        self._matching: list[Table] = [{} for _ in range(size)] if predicate is not None else [{}] * size
        self._scheduled, self._merge_interval = 0, max(4096, size)
        self._out_of_order: set[int] = set()  # readers that records reach out of order
        self._forgetful: set[int] = set()  # readers that have forgotten what was presumed

    def set_initial_belief(self, record: Record) -> None:
        """Let all nodes know a record from now on, unless they know another of its source."""
        self._shared.set_initial_belief((self._env.now, record))

    def schedule(self, record: Record, receivers: list[int], arrival: Arrival) -> None:
        """Let a record reach its receivers; O(1) if it reaches everyone at one instant, else O(receivers).

        Args:
            record: newer than all of its source that were noted before.
            receivers: whom it reaches.
            arrival: when.
        """
        if len(receivers) == self._size - 1 and isinstance(arrival, int):
            self._shared.schedule((arrival, record))
            return
        waiting = self._waiting
        for node, when in zip(receivers, per_receiver(arrival, len(receivers)), strict=True):
            pending = waiting[node]
            pending.append(when)  # twice, in less time than `extend` takes
            pending.append(record)
        self._scheduled += 1
        if self._scheduled == self._merge_interval:
            self._scheduled = 0
            self._merge_unread()

    def insert(self, node: int, record: Record) -> None:
        """Let a node know a record from now on, unless it knows it or a newer one of the same source."""
        self._apply_arrived(node)
        self._out_of_order.add(node)
        heard, own = (self._env.now, record), self._tables[node]
        if _is_newer(heard, own) and (node in self._forgetful or _is_newer(heard, self._shared.table)):
            _store(heard, own, self._matching[node], self._predicate)

    def latest_records(self, node: int) -> Table:
        """Return the newest record `node` has heard of each other source, as of now; cost O(news + sources)."""
        self._apply_arrived(node)
        own, common = self._tables[node], self._shared
        if not common.table or node in self._forgetful:
            return own.copy()
        known = common.table.copy()
        known.pop(node, None)
        if own:
            known |= own if common.only_initial else self._still_new(own)
        return known

    def matching(self, node: int) -> Table:
        """Return those records that `heard` returns whose body is marked; cost O(news + marked)."""
        self._apply_arrived(node)
        own, matching, common = self._tables[node], self._matching[node], self._shared
        if not common.table or node in self._forgetful:
            return matching.copy()
        known = common.matching.copy()
        known.pop(node, None)
        if own:
            known = {src: heard for src, heard in known.items() if _is_newer(heard, own)}
            known |= self._still_new(matching)
        return known

    def forget(self, node: int) -> None:
        """Let a node forget all it has heard, and what was presumed.

        Raises:
            ValueError: if there is something that all nodes heard together, which is kept for all.
        """
        if not self._shared.only_initial:
            raise ValueError("what all nodes have heard together cannot be forgotten by one")
        self._merge(node)
        self._tables[node].clear()
        self._matching[node].clear()
        self._forgetful.add(node)

    def in_flight(self) -> int:
        """Return how many records have yet to arrive, each receiver counted."""
        now = self._env.now
        own = sum(
            arrival > now for pending in chain(self._waiting, self._late.values()) for arrival, _ in _pairs(pending)
        )
        return own + (self._size - 1) * sum(arrival > now for arrival, _ in self._shared.waiting)

    def _apply_arrived(self, node: int) -> None:
        """Enter what has arrived at a node in its table, and what has arrived at all in theirs."""
        if self._shared.waiting:
            self._shared.apply_arrived(self._env.now)
        if self._waiting[node] or node in self._late:
            self._merge(node)

    def _still_new(self, own: Table) -> Table:
        """Return those records of a table that are not older than what all nodes heard together."""
        common = self._shared.table
        return {src: heard for src, heard in own.items() if src not in common or heard[1].seq >= common[src][1].seq}

    def _merge(self, node: int) -> None:
        """Enter what has arrived at a node in its table."""
        now, table, matching, fresh = self._env.now, self._tables[node], self._matching[node], self._waiting[node]
        predicate = self._predicate
        late = self._late.pop(node, [])
        if node in self._out_of_order:
            late, fresh = late + fresh, []
        if late:
            late = self._compare(node, _pairs(late))
        for arrival, record in _pairs(fresh):
            if arrival > now:
                late.append(arrival)
                late.append(record)
            else:  # nothing newer of its source is there
                table[record[0]] = heard = (arrival, record)  # src and body, by position for speed
                if predicate is not None:
                    if predicate(record[3]):
                        matching[record[0]] = heard
                    else:
                        matching.pop(record[0], None)
        self._waiting[node] = []
        if late:
            self._late[node] = late

    def _compare(self, node: int, pending: Iterable[ReceivedRecord]) -> list[Any]:
        """Enter what has arrived at a node, unless something newer of its source is there; return the rest, flat."""
        late: list[Any] = []
        now, table, matching, predicate = self._env.now, self._tables[node], self._matching[node], self._predicate
        for arrival, record in pending:
            known = table.get(record[0])
            if arrival > now:
                late.append(arrival)
                late.append(record)
            elif known is None or known[1][1] < record[1]:  # src and seq, by position for speed
                table[record[0]] = heard = (arrival, record)
                if predicate is not None:
                    _store(heard, table, matching, predicate)
        return late

    def _merge_unread(self) -> None:
        """Bound the memory that nodes cost which do not read."""
        for node, waiting in enumerate(self._waiting):
            if len(waiting) > 2048:
                self._merge(node)


def _store(heard: ReceivedRecord, table: Table, matching: Table, predicate: Predicate | None) -> None:
    """Enter a record in a table, and in that of the marked if its body is."""
    src = heard[1].src
    table[src] = heard
    if predicate is not None:
        if predicate(heard[1].body):
            matching[src] = heard
        else:
            matching.pop(src, None)


def _is_newer(heard: ReceivedRecord, table: Table) -> bool:
    """Return whether a record is newer than what a table has of its source."""
    known = table.get(heard[1].src)
    return known is None or known[1].seq < heard[1].seq


def per_receiver(arrival: Arrival, receivers: int) -> Iterable[int]:
    """Return the arrival at each of so many receivers."""
    return repeat(arrival, receivers) if isinstance(arrival, int) else arrival


def _pairs(flat: list[Any]) -> Iterator[ReceivedRecord]:
    """Return a flat list two by two."""
    items = iter(flat)
    return zip(items, items, strict=True)
