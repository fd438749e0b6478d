"""What each node has heard of every other: the newest record of each source that has arrived by now.

Reading needs no event: a record is noted with its time of arrival, and counts from then on.
"""

from collections.abc import Iterable, Iterator
from heapq import heappop, heappush
from itertools import repeat
from typing import Any, NamedTuple

from desim.kernel.clock import Clock


class Record(NamedTuple):
    """State that its source announced; `seq` orders the records of one source."""

    src: int
    seq: int
    sent: int
    """When it was announced, by the clock of its source, ns."""
    body: Any


Heard = tuple[int, Record]
"""A record and the nanosecond at which it arrived."""
Table = dict[int, Heard]
"""The newest record of each source that has been heard of."""
Arrival = int | list[int]
"""When a transmission reaches its receivers, ns: one number if they get it together."""


class Records:
    """The tables of all nodes."""

    def __init__(self, env: Clock, size: int):
        self._env, self._size = env, size
        # Records that reach everyone at one instant are kept once for all: a heap by arrival, and a table.
        self._common_waiting: list[Heard] = []
        self._common: Table = {}
        # All others are kept per reader: a list of arrival, record, arrival, record ... that have not been looked at or
        # have not arrived, and a table. Flat, because an object per delivery would keep the garbage collector busy.
        self._waiting: list[list[Any]] = [[] for _ in range(size)]
        self._tables: list[Table] = [{} for _ in range(size)]
        self._noted = 0

    def note(self, record: Record, receivers: list[int], arrival: Arrival) -> None:
        """Let a record reach its receivers; O(1) if it reaches everyone at one instant, else O(receivers)."""
        if len(receivers) == self._size - 1 and isinstance(arrival, int):
            heappush(self._common_waiting, (arrival, record))
        else:
            waiting = self._waiting
            for node, when in zip(receivers, each(arrival, len(receivers)), strict=True):
                waiting[node].extend((when, record))
        self._noted += 1
        if self._noted % 4096 == 0:
            self._fold_what_nobody_reads()

    def enter(self, node: int, record: Record) -> None:
        """Let a node know a record from now on, unless it knows a newer one of the same source."""
        _enter([(self._env.now, record)], self._tables[node], self._env.now)

    def heard(self, node: int) -> Table:
        """Return the newest record `node` has heard of each other source, as of now; cost O(news + sources)."""
        now = self._env.now
        if self._waiting[node]:
            self._fold(node)
        while self._common_waiting and self._common_waiting[0][0] <= now:
            _enter([heappop(self._common_waiting)], self._common, now)
        if not self._common:
            return self._tables[node].copy()
        known = self._common.copy()
        known.pop(node, None)
        _enter(self._tables[node].values(), known, now)
        return known

    def forget(self, node: int) -> None:
        """Let a node forget all it has heard.

        Raises:
            ValueError: if there is something that all nodes heard together, which is kept for all.
        """
        if self._common or self._common_waiting:
            raise ValueError("what all nodes have heard together cannot be forgotten by one")
        self._fold(node)
        self._tables[node].clear()

    def in_flight(self) -> int:
        """Return how many records have yet to arrive, each receiver counted."""
        now = self._env.now
        late = sum(arrival > now for waiting in self._waiting for arrival, _ in _pairs(waiting))
        return late + (self._size - 1) * sum(heard[0] > now for heard in self._common_waiting)

    def _fold(self, node: int) -> None:
        """Enter what has arrived at a node in its table."""
        self._waiting[node] = _enter(_pairs(self._waiting[node]), self._tables[node], self._env.now)

    def _fold_what_nobody_reads(self) -> None:
        """Bound the memory that nodes cost which do not read."""
        for node, waiting in enumerate(self._waiting):
            if len(waiting) > 2048:
                self._fold(node)


def each(arrival: Arrival, receivers: int) -> Iterable[int]:
    """Return the arrival at each of so many receivers."""
    return repeat(arrival, receivers) if isinstance(arrival, int) else arrival


def _pairs(waiting: list[Any]) -> Iterator[Heard]:
    """Return a flat list two by two."""
    items = iter(waiting)
    return zip(items, items, strict=True)


def _enter(news: Iterable[Heard], table: Table, now: int) -> list[Any]:
    """Enter what has arrived in a table, unless something newer of its source is there; return the rest, flat."""
    late: list[Any] = []
    for arrival, record in news:
        if arrival > now:
            late += (arrival, record)
        else:
            known = table.get(record[0])
            if known is None or known[1][1] < record[1]:  # src and seq, by position for speed
                table[record[0]] = (arrival, record)
    return late
