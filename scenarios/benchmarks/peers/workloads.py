"""The workloads of the speed comparison: senders, receivers, times and latencies of broadcasts.

In each workload the nodes take turns, one per millisecond: a node reads the messages it has received and broadcasts the
number of the turn. The table of a node contains the newest number received from each other node.
"""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, NamedTuple

import networkx as nx
import numpy as np
import simpy
from scipy.spatial.distance import pdist, squareform

from desim import Constant, Fault, Links, Lognormal
from desim.kernel.core.seeds import stream
from desim.kernel.models.link_draws import BLOCK

TICK = 0.001
"""Time between two turns, s."""
Table = dict[int, int]
"""The newest number received from each node, by the id of the sender."""
Turns = Generator[simpy.Event, Any, None]


@dataclass(frozen=True)
class Workload:
    """A graph of nodes, the number of their broadcasts, and the latency of messages."""

    name: str
    graph: "nx.Graph[int]"
    turns: int
    latency: Constant | Lognormal
    links: Links | None = None
    """The links in desim; if None, links with the field `latency` that are otherwise ideal. The other implementations
    always use `latency`."""
    faults: tuple[Fault, ...] = ()
    """Planned faults; in desim only."""
    speed: float = 0.0
    """Upper bound of the absolute value of each component of the nodes' velocities, m/s; in desim only."""
    seed: int = 0

    @property
    def size(self) -> int:
        """The number of nodes."""
        return len(self.graph)

    @property
    def end(self) -> float:
        """The end of the run, s: half a tick after the last broadcast, with messages still in flight."""
        return (self.turns - 0.5) * TICK

    def neighbours(self) -> list[list[int]]:
        """Return the neighbours of each node in ascending order."""
        return [sorted(self.graph.adj[node]) for node in range(self.size)]


LOGNORMAL = Lognormal(mean=0.02, cv=0.5)
"""The latency of the workloads W2 and W3."""


def disk_graph(size: int, degree: float, seed: int) -> "nx.Graph[int]":
    """Return a random geometric graph in a square; its radius is chosen to give the mean degree `degree`."""
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
    """The outcome of a run: the number of delivered messages, and the table of each node."""

    delivered: int
    tables: list[Table]


def note(table: Table, src: int, number: int) -> None:
    """Write a number into a table unless the table has a newer one from the same node."""
    if table.get(src, -1) < number:
        table[src] = number


class Arrivals:
    """The arrivals of broadcasts with random latencies, drawn in blocks as in desim."""

    def __init__(self, work: Workload):
        assert isinstance(work.latency, Lognormal)
        self._latency = work.latency
        self._neighbours = [np.array(neighbours, dtype=np.intp) for neighbours in work.neighbours()]
        self._rng = stream(work.seed, "latency")
        self._block, self._next = np.empty(0), 0

    def __call__(self, src: int, now: float) -> "zip[tuple[float, int]]":
        """Draw the arrivals of a broadcast sent at `now`, s; return their times, s, and receivers in order of time."""
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
