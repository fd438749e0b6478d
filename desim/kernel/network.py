"""The network: records and messages in flight between nodes, and the inboxes they arrive in.

A *record* is state: a newer one supersedes an older one of the same source, and it matters only when somebody reads
it. `publish` therefore needs no SimPy event: it notes when the record becomes visible to whom. A *message* is an
event: `send` wakes its receiver. Both obey the same links, and a record read at some instant is just what would have
been delivered by then.
"""

from functools import partial
from heapq import heappop, heappush
from itertools import count, repeat
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import simpy
from numpy.typing import NDArray
from simpy.events import EventPriority

from desim.kernel.clock import SECOND, Clock, Instant, Phase
from desim.kernel.events import LOST, Broadcast, Sent, Tally, Trace
from desim.kernel.links import Hops, Links
from desim.kernel.seeds import stream
from desim.kernel.topology import Positions, Topology

if TYPE_CHECKING:
    import networkx as nx


class Record(NamedTuple):
    """State that its source announced; `seq` orders the records of one source."""

    src: int
    seq: int
    sent: int
    """When it was published, ns."""
    body: Any


class Message(NamedTuple):
    """Something one node told others."""

    src: int
    sent: int
    """When it was sent, ns."""
    body: Any


Heard = tuple[int, Record]
"""A record and the nanosecond at which it arrived."""
Table = dict[int, Heard]
"""The newest record of each source that has been heard of."""


class Inbox:
    """Where messages wait to be read. Waiting for one never consumes it, so a time-out cannot swallow it."""

    def __init__(self, env: Clock, node: int):
        self._env = env
        self._node = node
        self._mail: list[Message] = []
        self._bell: simpy.Event | None = None

    def arrival(self) -> simpy.Event:
        """Return an event that happens as soon as there is mail: now, if there is some already."""
        bell = self._bell or self._env.event()
        self._bell = bell
        if self._mail:
            self._ring()
        return bell

    def drain(self) -> list[Message]:
        """Return the mail that has arrived and not been read, oldest first, and empty the box."""
        mail, self._mail = self._mail, []
        return mail

    def put(self, message: Message) -> None:
        """Deliver a message and wake who waits for one."""
        self._mail.append(message)
        self._ring()

    def _ring(self) -> None:
        """Let the event that is waited for, if any, happen in this instant's phase of decisions."""
        bell, self._bell = self._bell, None
        if bell is not None:
            bell._ok, bell._value = True, None
            self._env.schedule(bell, EventPriority(Phase.DECISION + self._node))


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
        # Records on their way, and those that have arrived. What reaches everyone at the same instant is kept once
        # for all (in order of arrival); the rest is kept per receiver (in order of departure).
        self._common_waiting: list[Heard] = []
        self._common: Table = {}
        self._waiting: list[list[Heard]] = [[] for _ in range(size)]
        self._tables: list[Table] = [{} for _ in range(size)]
        self._sent = self._lost = self._in_the_air = 0

    def presume(self, src: int, body: Any) -> None:
        """Let everyone know a record of `src` from the start, without a message."""
        self._common[src] = (self._env.now, Record(src, 0, self._env.now, body))

    def publish(self, src: int, body: Any) -> None:
        """Announce the state of `src` to its neighbours; O(1) if it reaches everyone alike, else O(neighbours)."""
        dst = self.topology.neighbours(src)
        record = Record(src, next(self._seq[src]), self._env.now, body)
        arrival = self._arrivals(src, dst)
        if isinstance(arrival, int):
            if len(dst) == self.topology.size - 1:
                heappush(self._common_waiting, (arrival, record))
            else:
                heard = (arrival, record)
                for node in dst.tolist():
                    self._waiting[node].append(heard)
        else:
            for node, when in zip(dst.tolist(), arrival, strict=True):
                if when != LOST:
                    self._waiting[node].append((when, record))
        if self._trace is not None:
            arrivals = (arrival,) if isinstance(arrival, int) else tuple(arrival)
            self._trace.append_message(Broadcast(record.sent, src, record.seq, tuple(dst.tolist()), arrivals, body))

    def heard(self, node: int) -> Table:
        """Return the newest record `node` has heard of each other source, as of now; cost O(news + sources)."""
        now = self._env.now
        waiting = self._waiting[node]
        table = self._tables[node]
        if waiting:
            self._waiting[node] = [heard for heard in waiting if not _note(heard, table, now)]
        while self._common_waiting and self._common_waiting[0][0] <= now:
            _note(heappop(self._common_waiting), self._common, now)
        if not self._common:
            return table.copy()
        known = self._common.copy()
        known.pop(node, None)
        for heard in table.values():
            _note(heard, known, now)
        return known

    def send(self, src: int, dst: int | None, body: Any) -> None:
        """Send a message to one node, or to all neighbours (None); it wakes who waits at the inbox.

        A message to a node that is out of reach when it is sent is lost.
        """
        now = self._env.now
        message = Message(src, now, body)
        hearers = self.topology.neighbours(src)
        if dst is not None:
            hearers = hearers[hearers == dst]
            if not len(hearers):
                self._sent += 1
                self._lost += 1
                if self._trace is not None:
                    self._trace.append_message(Sent(now, src, dst, LOST, body))
                return
        arrival = self._arrivals(src, hearers)
        nodes = hearers.tolist()
        for node, when in zip(nodes, repeat(arrival) if isinstance(arrival, int) else arrival, strict=False):
            if when != LOST:
                self._in_the_air += 1
                delivery = Instant(self._env, when, Phase.DELIVERY)
                delivery.callbacks.append(partial(self._deliver, node, message))
            if self._trace is not None:
                self._trace.append_message(Sent(now, src, node, when, body))

    def inbox(self, node: int) -> Inbox:
        """Return the inbox of a node."""
        return self._inboxes[node]

    def tally(self) -> Tally:
        """Count the messages so far: those sent are delivered, lost or still in flight."""
        now = self._env.now
        in_flight = self._in_the_air + sum(arrival > now for waiting in self._waiting for arrival, _ in waiting)
        in_flight += (self.topology.size - 1) * sum(arrival > now for arrival, _ in self._common_waiting)
        return Tally(now, self._sent, self._sent - self._lost - in_flight, self._lost, in_flight)

    def _arrivals(self, src: int, dst: NDArray[np.intp]) -> int | list[int]:
        """Let a transmission leave now; return when it reaches each receiver, one number if all alike, ns."""
        now = self._env.now
        hops = Hops(src, dst)
        self._sent += len(dst)
        lost = self._links.loss(hops, self._loss_rng)
        delay = self._links.latency(hops, self._latency_rng)
        if lost is False and isinstance(delay, float):
            return now + round(delay * SECOND)
        arrival = np.broadcast_to(now + np.rint(np.multiply(delay, SECOND)).astype(np.int64), len(dst))
        arrival = np.where(lost, LOST, arrival)
        self._lost += int(np.count_nonzero(arrival == LOST))
        return list(arrival.tolist())

    def _deliver(self, node: int, message: Message, _: simpy.Event) -> None:
        self._in_the_air -= 1
        self._inboxes[node].put(message)


def _note(heard: Heard, table: Table, now: int) -> bool:
    """Enter what was heard in a table unless it is older than what is there; return False if it has yet to arrive."""
    if heard[0] > now:
        return False
    src = heard[1].src
    known = table.get(src)
    if known is None or known[1].seq < heard[1].seq:
        table[src] = heard
    return True
