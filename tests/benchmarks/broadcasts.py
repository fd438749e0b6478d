"""Five ways to deliver the same broadcasts, and the workloads on which they are compared.

In every workload the nodes take turns, one a millisecond: a node reads what it has heard and broadcasts the number of
the turn. A table holds the newest number heard from each other node. All ways draw the same latencies from the same
stream, so at the end they must have the same tables: desim for all receivers of a broadcast at once, plain SimPy for
each message, as its documentation does, but for one way that shows what drawing at once is worth by hand.
"""

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from functools import partial
from math import log, log1p, sqrt
from typing import Any, NamedTuple

import networkx as nx
import numpy as np
import simpy
from scipy.spatial.distance import pdist, squareform

from desim.kernel.clock import SECOND, Clock, Instant, Phase
from desim.kernel.hops import Hops
from desim.kernel.latency import Constant, Latency, Lognormal
from desim.kernel.links import Links
from desim.kernel.network import Network
from desim.kernel.seeds import stream

TICK = 0.001
"""Time between two turns, s."""
Table = dict[int, int]
"""The newest number heard from each node."""
Turns = Generator[simpy.Event, Any, None]


@dataclass(frozen=True)
class Workload:
    """Who broadcasts to whom, how often, and how long it takes."""

    name: str
    graph: "nx.Graph[int]"
    turns: int
    latency: Latency
    links: Links | None = None
    """What the links of desim are like if not ideal but for the latency; the ways by hand know latencies only."""
    seed: int = 0

    @property
    def size(self) -> int:
        """How many nodes there are."""
        return len(self.graph)

    @property
    def end(self) -> float:
        """When the run is over, s: half a tick after the last broadcast, with messages still in flight."""
        return (self.turns - 0.5) * TICK


LOGNORMAL = Lognormal(mean=0.02, cv=0.5)
"""The latency of W2 and W3."""


def one_latency(model: Latency) -> Callable[[np.random.Generator], float]:
    """Return how one draws a single latency of a model, s."""
    if isinstance(model, Constant):
        return lambda rng: model.value
    variance = log1p(model.cv**2)
    mean, deviation = log(model.mean) - variance / 2, sqrt(variance)
    return lambda rng: rng.lognormal(mean, deviation)


def disk_graph(size: int, degree: float, seed: int) -> "nx.Graph[int]":
    """Return the graph of random points in a square that are near each other, of a given mean degree."""
    distances = pdist(np.random.default_rng(seed).random((size, 2)))
    near = distances <= np.quantile(distances, degree / (size - 1))
    return nx.from_numpy_array(squareform(near))


def workloads() -> list[Workload]:
    """Return the four workloads."""
    constant = Constant(value=0.015)
    return [
        Workload("W1: 40 nodes, complete, constant", nx.complete_graph(40), 2000, constant),
        Workload("W2: 40 nodes, complete, lognormal", nx.complete_graph(40), 2000, LOGNORMAL),
        Workload("W3: 1000 nodes, disk graph, lognormal", disk_graph(1000, 20, seed=0), 5000, LOGNORMAL),
        Workload("W4: 400 nodes, complete, constant", nx.complete_graph(400), 2000, constant),
    ]


class Outcome(NamedTuple):
    """What a run comes to: the number of messages delivered, and every node's table."""

    delivered: int
    tables: list[Table]


def note(table: Table, src: int, number: int) -> None:
    """Enter a number in a table unless a newer one of the same node is there."""
    if table.get(src, -1) < number:
        table[src] = number


class Desim:
    """What both ways of desim share."""

    def __init__(self, workload: Workload):
        self.work = workload
        self.env = Clock()
        links = workload.links or Links(latency=workload.latency)
        places = np.random.default_rng(workload.seed).random((workload.size, 2))
        self.network = Network(self.env, workload.graph, links, seed=workload.seed, positions=lambda: places)
        self.env.process(self.turns())

    def run(self) -> None:
        """Run to the end; this is what is timed."""
        self.env.run(until=round(self.work.end * SECOND))

    def turns(self) -> Turns:
        """Let one node after the other read and broadcast."""
        size, tick, first = self.work.size, round(TICK * SECOND), int(Phase.DECISION)
        for number in range(self.work.turns):
            node = number % size
            yield Instant(self.env, number * tick, first + node)
            self.read(node)
            self.broadcast(node, number)

    def outcome(self) -> Outcome:
        """Return what the run came to."""
        return Outcome(self.network.tally().delivered, [self.read(node) for node in range(self.work.size)])

    def read(self, node: int) -> Table:
        """Return what a node has heard."""
        raise NotImplementedError

    def broadcast(self, src: int, number: int) -> None:
        """Tell the neighbours of a node a number."""
        raise NotImplementedError


class Publish(Desim):
    """Records: `Network.publish` and `Network.heard`."""

    def read(self, node: int) -> Table:
        return self.network.heard(node)

    def broadcast(self, src: int, number: int) -> None:
        self.network.publish(src, number)

    def outcome(self) -> Outcome:
        delivered, tables = super().outcome()
        return Outcome(delivered, [{src: record.body for src, (_, record) in heard.items()} for heard in tables])


class Send(Desim):
    """Messages: `Network.send` to all neighbours, and inboxes that their owners drain into tables of their own."""

    def __init__(self, workload: Workload):
        super().__init__(workload)
        self.tables: list[Table] = [{} for _ in range(workload.size)]

    def read(self, node: int) -> Table:
        table = self.tables[node]
        for src, _, number in self.network.inbox(node).drain():
            note(table, src, number)
        return table

    def broadcast(self, src: int, number: int) -> None:
        self.network.send(src, None, number)


class PlainSimPy:
    """What the ways without desim share: time in seconds, and a latency drawn for each message."""

    def __init__(self, workload: Workload):
        self.work = workload
        self.env = simpy.Environment()
        self.neighbours = [np.array(sorted(workload.graph.adj[node]), dtype=np.intp) for node in range(workload.size)]
        self.tables: list[Table] = [{} for _ in range(workload.size)]
        self.rng = stream(workload.seed, "latency")
        self.sent = 0
        self.env.process(self.turns())

    def run(self) -> None:
        """Run to the end; this is what is timed."""
        self.env.run(until=self.work.end)

    def turns(self) -> Turns:
        """Let one node after the other read and broadcast."""
        for number in range(self.work.turns):
            node = number % self.work.size
            yield from self.read(node)
            self.broadcast(node, number)
            yield self.env.timeout(TICK)

    def hops(self, src: int) -> Iterable[tuple[int, float]]:
        """Yield each neighbour of a node and the latency of a message to it, s."""
        dst = self.neighbours[src]
        self.sent += len(dst)
        latency, rng = one_latency(self.work.latency), self.rng
        for node in dst.tolist():
            yield node, latency(rng)

    def outcome(self) -> Outcome:
        """Return what the run came to; beside the next turn, every timeout ahead is a message in flight."""
        ahead = sum(isinstance(event, simpy.Timeout) for *_, event in self.env._queue)
        return Outcome(self.sent - (ahead - 1), self.tables)

    def read(self, node: int) -> Turns:
        """Bring the table of a node up to date."""
        raise NotImplementedError

    def broadcast(self, src: int, number: int) -> None:
        """Tell the neighbours of a node a number."""
        raise NotImplementedError


class Documented(PlainSimPy):
    """SimPy as its documentation writes it (example "Event Latency"): a store per node, a process per message."""

    def __init__(self, workload: Workload):
        super().__init__(workload)
        self.stores = [simpy.Store(self.env) for _ in range(workload.size)]

    def read(self, node: int) -> Turns:
        store, table = self.stores[node], self.tables[node]
        while store.items:
            src, number = yield store.get()
            note(table, src, number)

    def broadcast(self, src: int, number: int) -> None:
        for dst, delay in self.hops(src):
            self.env.process(self.latency(self.stores[dst], delay, (src, number)))

    def latency(self, store: simpy.Store, delay: float, message: tuple[int, int]) -> Turns:
        """Put a message in a store after a while."""
        yield self.env.timeout(delay)
        yield store.put(message)

    def outcome(self) -> Outcome:
        delivered, _ = super().outcome()
        for store, table in zip(self.stores, self.tables, strict=True):
            for src, number in store.items:
                note(table, src, number)
        return Outcome(delivered, self.tables)


class ByHand(PlainSimPy):
    """SimPy by hand: one timeout per delivery, whose callback writes into the receiver's table."""

    def read(self, node: int) -> Turns:
        yield from ()

    def broadcast(self, src: int, number: int) -> None:
        timeout, tables = self.env.timeout, self.tables
        for dst, delay in self.hops(src):
            timeout(delay).callbacks.append(partial(deliver, tables[dst], src, number))


class ByHandAtOnce(ByHand):
    """By hand, but with the latencies of a broadcast drawn at once."""

    def hops(self, src: int) -> Iterable[tuple[int, float]]:
        dst = self.neighbours[src]
        delay = self.work.latency(Hops(src, dst), self.rng)
        self.sent += len(dst)
        delays = [delay] * len(dst) if isinstance(delay, float) else delay.tolist()
        return zip(dst.tolist(), delays, strict=True)


def deliver(table: Table, src: int, number: int, _: simpy.Event) -> None:
    """Write a message that arrives into a table."""
    if table.get(src, -1) < number:
        table[src] = number


Way = Desim | PlainSimPy
WAYS: dict[str, Callable[[Workload], Way]] = {
    "publish": Publish,
    "send": Send,
    "by hand": ByHand,
    "by hand, drawn at once": ByHandAtOnce,
    "documented": Documented,
}
