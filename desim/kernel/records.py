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


Heard = tuple[int, Record]
"""A record and the nanosecond at which it arrived."""
Table = dict[int, Heard]
"""The newest record of each source that has been heard of."""
Arrival = int | list[int]
"""When a transmission reaches its receivers, ns: one number if they get it together."""


Mark = Callable[[Any], object]
"""Of a body, whether it is one that a reader looks for."""


class Common:
    """What all nodes but its source hear at one instant, kept once for all of them.

    Attributes:
        waiting: what has yet to arrive, or to be looked at, by its arrival.
        table: the newest record of each source, as of the last `settle`.
        marked: those of them whose body is marked.
        presumed_only: whether none has been noted but what was known from the start.
    """

    def __init__(self, mark: Mark | None):
        self._mark = mark
        self.waiting: list[Heard] = []
        self.table: Table = {}
        self.marked: Table = {}
        self.only_initial = True

    def set_initial_belief(self, heard: Heard) -> None:
        """Enter a record that is known from the start, unless something is known of its source."""
        if heard[1].src not in self.table:
            _put(heard, self.table, self.marked, self._mark)

    def note(self, heard: Heard) -> None:
        """Let a record arrive."""
        self.only_initial = False
        if self.waiting and heard < self.waiting[-1]:
            insort(self.waiting, heard)
        else:
            self.waiting.append(heard)

    def settle(self, now: int) -> None:
        """Enter what has arrived in the table."""
        arrived, table = 0, self.table
        for heard in self.waiting:
            arrival, record = heard
            if arrival > now:
                break
            arrived += 1
            known = table.get(record[0])  # src and seq, by position for speed
            if known is None or known[1][1] < record[1]:
                _put(heard, table, self.marked, self._mark)
        del self.waiting[:arrived]


class Records:
    """The tables of all nodes.

    Args:
        env: the clock of the simulation.
        size: number of nodes.
        mark: what `marked` looks for; nothing if None.
    """

    def __init__(self, env: Clock, size: int, mark: Mark | None):
        self._env, self._size, self._mark = env, size, mark
        self._common = Common(mark)
        # What does not reach all alike is kept per reader, in the order of departure: what has not been looked at, what
        # had not arrived when it was, and a table. Both lists are flat (arrival, record, arrival, record ...), because
        # tuples that are made as they are entered lie together in memory.
        self._waiting: list[list[Any]] = [[] for _ in range(size)]
        self._late: dict[int, list[Any]] = {}
        self._tables: list[Table] = [{} for _ in range(size)]
        self._marked: list[Table] = [{} for _ in range(size)] if mark is not None else [{}] * size
        self._noted, self._patience = 0, max(4096, size)
        self._entered: set[int] = set()  # readers that records reach out of order
        self._forgetful: set[int] = set()  # readers that have forgotten what was presumed

    def set_initial_belief(self, record: Record) -> None:
        """Let all nodes know a record from now on, unless they know another of its source."""
        self._common.set_initial_belief((self._env.now, record))

    def note(self, record: Record, receivers: list[int], arrival: Arrival) -> None:
        """Let a record reach its receivers; O(1) if it reaches everyone at one instant, else O(receivers).

        Args:
            record: newer than all of its source that were noted before.
            receivers: whom it reaches.
            arrival: when.
        """
        if len(receivers) == self._size - 1 and isinstance(arrival, int):
            self._common.note((arrival, record))
            return
        waiting = self._waiting
        for node, when in zip(receivers, per_receiver(arrival, len(receivers)), strict=True):
            pile = waiting[node]
            pile.append(when)  # twice, in less time than `extend` takes
            pile.append(record)
        self._noted += 1
        if self._noted == self._patience:
            self._noted = 0
            self._fold_what_nobody_reads()

    def enter(self, node: int, record: Record) -> None:
        """Let a node know a record from now on, unless it knows it or a newer one of the same source."""
        self._settle(node)
        self._entered.add(node)
        heard, own = (self._env.now, record), self._tables[node]
        if _is_newer(heard, own) and (node in self._forgetful or _is_newer(heard, self._common.table)):
            _put(heard, own, self._marked[node], self._mark)

    def heard(self, node: int) -> Table:
        """Return the newest record `node` has heard of each other source, as of now; cost O(news + sources)."""
        self._settle(node)
        own, common = self._tables[node], self._common
        if not common.table or node in self._forgetful:
            return own.copy()
        known = common.table.copy()
        known.pop(node, None)
        if own:
            known |= own if common.only_initial else self._still_new(own)
        return known

    def marked(self, node: int) -> Table:
        """Return those records that `heard` returns whose body is marked; cost O(news + marked)."""
        self._settle(node)
        own, marked, common = self._tables[node], self._marked[node], self._common
        if not common.table or node in self._forgetful:
            return marked.copy()
        known = common.marked.copy()
        known.pop(node, None)
        if own:
            known = {src: heard for src, heard in known.items() if _is_newer(heard, own)}
            known |= self._still_new(marked)
        return known

    def forget(self, node: int) -> None:
        """Let a node forget all it has heard, and what was presumed.

        Raises:
            ValueError: if there is something that all nodes heard together, which is kept for all.
        """
        if not self._common.only_initial:
            raise ValueError("what all nodes have heard together cannot be forgotten by one")
        self._fold(node)
        self._tables[node].clear()
        self._marked[node].clear()
        self._forgetful.add(node)

    def in_flight(self) -> int:
        """Return how many records have yet to arrive, each receiver counted."""
        now = self._env.now
        own = sum(arrival > now for pile in chain(self._waiting, self._late.values()) for arrival, _ in _pairs(pile))
        return own + (self._size - 1) * sum(arrival > now for arrival, _ in self._common.waiting)

    def _settle(self, node: int) -> None:
        """Enter what has arrived at a node in its table, and what has arrived at all in theirs."""
        if self._common.waiting:
            self._common.settle(self._env.now)
        if self._waiting[node] or node in self._late:
            self._fold(node)

    def _still_new(self, own: Table) -> Table:
        """Return those records of a table that are not older than what all nodes heard together."""
        common = self._common.table
        return {src: heard for src, heard in own.items() if src not in common or heard[1].seq >= common[src][1].seq}

    def _fold(self, node: int) -> None:
        """Enter what has arrived at a node in its table."""
        now, table, marked, fresh = self._env.now, self._tables[node], self._marked[node], self._waiting[node]
        mark = self._mark
        late = self._late.pop(node, [])
        if node in self._entered:
            late, fresh = late + fresh, []
        if late:
            late = self._compare(node, _pairs(late))
        for arrival, record in _pairs(fresh):
            if arrival > now:
                late.append(arrival)
                late.append(record)
            else:  # nothing newer of its source is there
                table[record[0]] = heard = (arrival, record)  # src and body, by position for speed
                if mark is not None:
                    if mark(record[3]):
                        marked[record[0]] = heard
                    else:
                        marked.pop(record[0], None)
        self._waiting[node] = []
        if late:
            self._late[node] = late

    def _compare(self, node: int, pile: Iterable[Heard]) -> list[Any]:
        """Enter what has arrived at a node, unless something newer of its source is there; return the rest, flat."""
        late: list[Any] = []
        now, table, marked, mark = self._env.now, self._tables[node], self._marked[node], self._mark
        for arrival, record in pile:
            known = table.get(record[0])
            if arrival > now:
                late.append(arrival)
                late.append(record)
            elif known is None or known[1][1] < record[1]:  # src and seq, by position for speed
                table[record[0]] = heard = (arrival, record)
                if mark is not None:
                    _put(heard, table, marked, mark)
        return late

    def _fold_what_nobody_reads(self) -> None:
        """Bound the memory that nodes cost which do not read."""
        for node, waiting in enumerate(self._waiting):
            if len(waiting) > 2048:
                self._fold(node)


def _put(heard: Heard, table: Table, marked: Table, mark: Mark | None) -> None:
    """Enter a record in a table, and in that of the marked if its body is."""
    src = heard[1].src
    table[src] = heard
    if mark is not None:
        if mark(heard[1].body):
            marked[src] = heard
        else:
            marked.pop(src, None)


def _is_newer(heard: Heard, table: Table) -> bool:
    """Return whether a record is newer than what a table has of its source."""
    known = table.get(heard[1].src)
    return known is None or known[1].seq < heard[1].seq


def per_receiver(arrival: Arrival, receivers: int) -> Iterable[int]:
    """Return the arrival at each of so many receivers."""
    return repeat(arrival, receivers) if isinstance(arrival, int) else arrival


def _pairs(flat: list[Any]) -> Iterator[Heard]:
    """Return a flat list two by two."""
    items = iter(flat)
    return zip(items, items, strict=True)
