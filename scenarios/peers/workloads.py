"""The broadcasts that are delivered: who tells whom, when, and how long it takes.

In every workload the nodes take turns, one a millisecond: a node reads what it has heard and broadcasts the number of
the turn. A table holds the newest number heard from each other node.
"""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, NamedTuple

import networkx as nx
import numpy as np
import simpy
from scipy.spatial.distance import pdist, squareform

from desim.kernel.latency import Constant, Lognormal
from desim.kernel.links import Links
from desim.kernel.propagation import BLOCK
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
    latency: Constant | Lognormal
    links: Links | None = None
    """What the links of desim are like if not ideal but for the latency; the other ways know latencies only."""
    seed: int = 0

    @property
    def size(self) -> int:
        """How many nodes there are."""
        return len(self.graph)

    @property
    def end(self) -> float:
        """When the run is over, s: half a tick after the last broadcast, with messages still in flight."""
        return (self.turns - 0.5) * TICK

    def neighbours(self) -> list[list[int]]:
        """Return whom each node tells, ascending."""
        return [sorted(self.graph.adj[node]) for node in range(self.size)]


LOGNORMAL = Lognormal(mean=0.02, cv=0.5)
"""The latency of W2 and W3."""


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


class Arrivals:
    """When a broadcast reaches whom, in order of arrival: random latencies, drawn in blocks as desim draws them."""

    def __init__(self, work: Workload):
        assert isinstance(work.latency, Lognormal)
        self._latency = work.latency
        self._neighbours = [np.array(each, dtype=np.intp) for each in work.neighbours()]
        self._rng = stream(work.seed, "latency")
        self._block, self._next = np.empty(0), 0

    def __call__(self, src: int, now: float) -> "zip[tuple[float, int]]":
        """Return the arrivals (s) of a broadcast that leaves now, and who is reached."""
        dst = self._neighbours[src]
        start, end = self._next, self._next + len(dst)
        if end > len(self._block):
            fresh = self._latency.draw(max(BLOCK, len(dst)), self._rng)
            self._block = np.concatenate((self._block[start:], fresh))
            start, end = 0, len(dst)
        self._next = end
        delays = self._block[start:end]
        order = delays.argsort()
        return zip((delays[order] + now).tolist(), dst[order].tolist(), strict=True)
