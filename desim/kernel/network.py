"""The network: records and messages in flight between nodes, and the inboxes they arrive in.

A *record* is state: a newer one supersedes an older one of the same source, and it matters only when somebody reads
it. `publish` therefore needs no SimPy event: it notes when the record becomes visible to whom. A *message* is an
event: `send` wakes its receiver; but it, too, needs a SimPy event only if somebody waits for it. Both obey the same
links, and what is read in the phase of decisions of some instant, or later, is just what would have been delivered by
then.
"""

from collections.abc import Iterable, Iterator, Sequence
from heapq import heappop, heappush
from itertools import count, repeat
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from desim.kernel.clock import SECOND, Clock, nanoseconds
from desim.kernel.events import LOST, Broadcast, Sent, Tally, Trace
from desim.kernel.inbox import Inbox, Message
from desim.kernel.links import Hops, Links
from desim.kernel.seeds import stream
from desim.kernel.topology import Positions, Topology
from desim.value import LONGEST

if TYPE_CHECKING:
    import networkx as nx


class Record(NamedTuple):
    """State that its source announced; `seq` orders the records of one source."""

    src: int
    seq: int
    sent: int
    """When it was published, ns."""
    body: Any


Heard = tuple[int, Record]
"""A record and the nanosecond at which it arrived."""
Table = dict[int, Heard]
"""The newest record of each source that has been heard of."""
Nodes = NDArray[np.intp]
Arrival = int | list[int]
"""When a transmission reaches its receivers, ns: one number if they get it together."""


class Network:
    """Nodes 0 .. n - 1 that talk over the edges of a graph.

    Args:
        env: the clock of the simulation.
        graph: who is linked to whom; its nodes are 0 .. n - 1.
        links: latency, loss and range of every link.
        seed: of the streams "latency" and "loss".
        positions: where the nodes are now, (n, 2) m; needed if the range is finite.
        trace: where message events go, if it wants them.
    """

    def __init__(
        self,
        env: Clock,
        graph: "nx.Graph[int]",
        links: Links | None = None,
        *,
        seed: int = 0,
        positions: Positions | None = None,
        trace: Trace | None = None,
    ):
        self._env = env
        self._links = links or Links()
        self.topology = Topology(graph, self._links.range, positions)
        self._latency_rng, self._loss_rng = stream(seed, "latency"), stream(seed, "loss")
        self._trace = trace if trace is not None and trace.wants_messages else None
        size = self.topology.size
        self._inboxes = [Inbox(env, node) for node in range(size)]
        self._seq = [count(1) for _ in range(size)]
        # Records that reach everyone at one instant are kept once for all: a heap by arrival, and a table.
        self._common_waiting: list[Heard] = []
        self._common: Table = {}
        # All others are kept per reader: a list of arrival, record, arrival, record ... that have not been looked at or
        # have not arrived, and a table. Flat, because an object per delivery would keep the garbage collector busy.
        self._waiting: list[list[Any]] = [[] for _ in range(size)]
        self._tables: list[Table] = [{} for _ in range(size)]
        self._flights = count()
        self._published = self._sent = self._lost = 0

    def presume(self, src: int, body: Any) -> None:
        """Let everyone know a record of `src` from the start, without a message."""
        self._common[src] = (self._env.now, Record(src, 0, self._env.now, body))

    def publish(self, src: int, body: Any) -> None:
        """Announce the state of `src` to its neighbours; O(1) if it reaches everyone alike, else O(neighbours)."""
        record = Record(src, next(self._seq[src]), self._env.now, body)
        neighbours = self.topology.neighbours(src)
        reached, arrival = self._depart(src, neighbours)
        if isinstance(arrival, int) and len(reached) == self.topology.size - 1:
            heappush(self._common_waiting, (arrival, record))
        else:
            waiting = self._waiting
            for node, when in zip(reached.tolist(), _each(arrival), strict=False):
                waiting[node].extend((when, record))
        self._published += 1
        if self._published % 4096 == 0:
            self._fold_what_nobody_reads()
        if self._trace is not None:
            dst = tuple(neighbours.tolist())
            fates = _fates(dst, reached, arrival)
            alike = isinstance(arrival, int) and len(reached) == len(dst) > 0
            arrivals = tuple(fates[:1] if alike else fates)
            self._trace.append_message(Broadcast(record.sent, src, record.seq, dst, arrivals, body))

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

    def send(self, src: int, dst: int | None, body: Any) -> None:
        """Send a message to one node, or to all neighbours (None); it wakes who waits at the inbox.

        A message to a node that is out of reach when it is sent is lost.

        Raises:
            ValueError: if there is no such node.
        """
        neighbours = self.topology.neighbours(src)
        receivers: list[int] = neighbours.tolist()
        if dst is not None:
            if not 0 <= dst < self.topology.size:
                raise ValueError(f"there is no node {dst}: the nodes are 0 .. {self.topology.size - 1}")
            receivers, neighbours = [dst], neighbours[neighbours == dst]
            self._sent += 1 - len(neighbours)
            self._lost += 1 - len(neighbours)
        reached, arrival = self._depart(src, neighbours)
        message = Message(src, self._env.now, body)
        if len(reached):
            number, inboxes = next(self._flights), self._inboxes
            for node, when in zip(reached.tolist(), _each(arrival), strict=False):
                inboxes[node].put(message, when, number)
        if self._trace is not None:
            for node, when in zip(receivers, _fates(receivers, reached, arrival), strict=True):
                self._trace.append_message(Sent(message.sent, src, node, when, body))

    def inbox(self, node: int) -> Inbox:
        """Return the inbox of a node."""
        return self._inboxes[node]

    def tally(self) -> Tally:
        """Count the messages so far: those sent are delivered, lost or still in flight."""
        now = self._env.now
        in_flight = sum(inbox.in_flight() for inbox in self._inboxes)
        in_flight += sum(arrival > now for waiting in self._waiting for arrival, _ in _pairs(waiting))
        in_flight += (self.topology.size - 1) * sum(heard[0] > now for heard in self._common_waiting)
        return Tally(now, self._sent, self._sent - self._lost - in_flight, self._lost, in_flight)

    def _depart(self, src: int, dst: Nodes) -> tuple[Nodes, Arrival]:
        """Let a transmission leave now; return whom it will reach, and when.

        Raises:
            ValueError: if the latency model answers with what is not a time.
        """
        now = self._env.now
        self._sent += len(dst)
        hops = Hops(src, dst)
        lost = self._links.loss(hops, self._loss_rng)
        delay = self._links.latency(hops, self._latency_rng)
        if lost is not False:
            kept = ~np.broadcast_to(lost, dst.shape)
            self._lost += len(dst) - int(kept.sum())
            dst, delay = dst[kept], delay if np.ndim(delay) == 0 else np.asarray(delay)[kept]
        if not isinstance(delay, np.ndarray) or not delay.ndim:
            if not 0.0 <= delay <= LONGEST:
                raise ValueError(f"a latency should be from 0 to {LONGEST:g} s, got {delay}")
            return dst, now + nanoseconds(float(delay))
        try:
            arrivals = [now + round(each * SECOND) for each in delay.tolist()]
        except (ValueError, OverflowError) as error:  # nan, inf
            raise ValueError(f"latencies should be from 0 to {LONGEST:g} s, got {delay}") from error
        if arrivals and (min(arrivals) < now or max(arrivals) > now + LONGEST * SECOND):
            raise ValueError(f"latencies should be from 0 to {LONGEST:g} s, got {delay}")
        return dst, arrivals

    def _fold(self, node: int) -> None:
        """Enter what has arrived at a node in its table."""
        self._waiting[node] = _enter(_pairs(self._waiting[node]), self._tables[node], self._env.now)

    def _fold_what_nobody_reads(self) -> None:
        """Bound the memory that nodes cost which do not read."""
        for node, waiting in enumerate(self._waiting):
            if len(waiting) > 2048:
                self._fold(node)


def _each(arrival: Arrival) -> Iterable[int]:
    """Return the arrival at each receiver."""
    return repeat(arrival) if isinstance(arrival, int) else arrival


def _pairs(waiting: list[Any]) -> Iterator[Heard]:
    """Return a flat list two by two."""
    each = iter(waiting)
    return zip(each, each, strict=True)


def _fates(receivers: Sequence[int], reached: Nodes, arrival: Arrival) -> list[int]:
    """Return when a transmission reaches each receiver, or LOST."""
    when = dict(zip(reached.tolist(), _each(arrival), strict=False))
    return [when.get(node, LOST) for node in receivers]


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
