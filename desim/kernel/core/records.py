"""Records: the states that nodes publish; `desim.kernel.state.received_records` keeps those that have arrived."""

from collections.abc import Callable, Iterable, Iterator
from itertools import repeat
from typing import Any, NamedTuple

from desim.kernel.core.units import SECOND


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


def per_receiver(arrival: Arrival, receivers: int) -> Iterable[int]:
    """Return the arrival time (ns) at each of `receivers` receivers."""
    return repeat(arrival, receivers) if isinstance(arrival, int) else arrival


def pairs(flat: list[Any]) -> Iterator[tuple[int, Any]]:
    """Return the pairs (time, item) of a flat list."""
    items = iter(flat)
    return zip(items, items, strict=True)
