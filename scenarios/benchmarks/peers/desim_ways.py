"""Deliver the broadcasts of a workload in desim: as published records, and as messages to inboxes."""

from math import sqrt

import numpy as np

from desim.config.arrays import Floats, Integers
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.positions import Nodes, PositionSource
from desim.kernel.core.units import SECOND, seconds
from desim.kernel.fault_injection import inject
from desim.kernel.models.links import Links
from desim.kernel.network import Network
from desim.kernel.state.fault_state import FaultState
from scenarios.benchmarks.peers.workloads import TICK, Outcome, Table, Turns, Workload, note


class Desim:
    """The common part of `Publish` and `Send`, the two ways to deliver the broadcasts in desim."""

    def __init__(self, workload: Workload):
        self.work = workload
        self.env = Clock()
        links = workload.links or Links(latency=workload.latency)
        positions = _Moving(self.env, workload)
        faults = FaultState(positions) if workload.faults else None
        self.network = Network(
            self.env, workload.graph, links, seed=workload.seed, positions=positions, fault_state=faults
        )
        inject(workload.faults, self.env, self.network)
        self.env.process(self.turns())

    def run(self) -> None:
        """Run to the end; the benchmark times this call."""
        self.env.run(until=round(self.work.end * SECOND))

    def turns(self) -> Turns:
        """Let the nodes read and broadcast, one after the other."""
        size, tick, first = self.work.size, round(TICK * SECOND), int(Phase.DECISION)
        for number in range(self.work.turns):
            node = number % size
            yield Instant(self.env, number * tick, first + node)
            self.read(node)
            self.broadcast(node, number)

    def outcome(self) -> Outcome:
        """Return the outcome of the run."""
        return Outcome(self.network.message_counts().delivered, [self.table(node) for node in range(self.work.size)])

    def read(self, node: int) -> object:
        """Let a node read the messages it has received."""
        raise NotImplementedError

    def broadcast(self, src: int, number: int) -> None:
        """Broadcast a number to the neighbours of a node."""
        raise NotImplementedError

    def table(self, node: int) -> Table:
        """Return the newest number that a node has received from each other node."""
        raise NotImplementedError


class _Moving(PositionSource):
    """Nodes that start in a unit square and move straight on."""

    looks_back = True

    def __init__(self, env: Clock, workload: Workload):
        rng = np.random.default_rng(workload.seed)
        self._env, self._start = env, rng.random((workload.size, 2))
        self._velocity = rng.uniform(-workload.speed, workload.speed, (workload.size, 2))
        self.max_speed = sqrt(2.0) * workload.speed

    def __call__(self) -> Floats:
        return self._start + self._velocity * seconds(self._env.now)

    def of(self, nodes: Nodes) -> Floats:
        return self._start[nodes] + self._velocity[nodes] * seconds(self._env.now)

    def at(self, nodes: Nodes, times: int | Integers) -> Floats:
        return self._start[nodes] + self._velocity[nodes] * (np.atleast_1d(times) / SECOND)[:, np.newaxis]


class Publish(Desim):
    """Records: `Network.publish`, and `Network.latest_records`, which returns the newest record of each sender."""

    def read(self, node: int) -> object:
        return self.network.latest_records(node)

    def broadcast(self, src: int, number: int) -> None:
        self.network.publish(src, number)

    def table(self, node: int) -> Table:
        return {src: record.body for src, (_, record) in self.network.latest_records(node).items()}


class Send(Desim):
    """Messages: `Network.send` to all neighbours; each node drains its inbox into a table."""

    def __init__(self, workload: Workload):
        super().__init__(workload)
        self.tables: list[Table] = [{} for _ in range(workload.size)]

    def read(self, node: int) -> object:
        table = self.tables[node]
        for src, _, number in self.network.inbox(node).drain():
            note(table, src, number)
        return table

    def broadcast(self, src: int, number: int) -> None:
        self.network.send(src, None, number)

    def table(self, node: int) -> Table:
        self.read(node)
        return self.tables[node]
