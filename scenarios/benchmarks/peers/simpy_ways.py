"""Ways to deliver the broadcasts of a workload in plain SimPy.

`Documented` uses a process per message, as the documentation of SimPy does. `PerMessage` and `PerMessageDrawnAtOnce`
use one event per message, and `PerBroadcast` uses one event per broadcast.
"""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from math import log, log1p, sqrt
from typing import Any

import numpy as np
import simpy

from desim.kernel.core.link_context import LinkContext
from desim.kernel.core.seeds import stream
from desim.kernel.models.latency import Constant
from scenarios.benchmarks.peers.workloads import TICK, Arrivals, Outcome, Table, Turns, Workload, note


class PlainSimPy:
    """The common part of the ways with SimPy: time in seconds and, by default, latencies drawn message by message."""

    def __init__(self, workload: Workload):
        self.work = workload
        self.env = simpy.Environment()
        self.neighbours = [np.array(neighbours, dtype=np.intp) for neighbours in workload.neighbours()]
        self.tables: list[Table] = [{} for _ in range(workload.size)]
        self.rng = stream(workload.seed, "latency")
        self.sent = 0
        self.env.process(self.turns())

    def run(self) -> None:
        """Run to the end; the benchmark times this call."""
        self.env.run(until=self.work.end)

    def turns(self) -> Turns:
        """Let the nodes read and broadcast, one after the other."""
        for number in range(self.work.turns):
            node = number % self.work.size
            yield from self.read(node)
            self.broadcast(node, number)
            yield self.env.timeout(TICK)

    def hops(self, src: int) -> Iterable[tuple[int, float]]:
        """Count the messages of a broadcast as sent; yield each neighbour and the latency, s, of the message to it."""
        dst, model, rng = self.neighbours[src], self.work.latency, self.rng
        self.sent += len(dst)
        if isinstance(model, Constant):
            for node in dst.tolist():
                yield node, model.value
            return
        variance = log1p(model.cv**2)
        mean, deviation = log(model.mean) - variance / 2, sqrt(variance)
        for node in dst.tolist():
            yield node, rng.lognormal(mean, deviation)

    def outcome(self) -> Outcome:
        """Return the outcome; each pending timeout, except that of the next turn, is a message in flight."""
        pending = sum(isinstance(event, simpy.Timeout) for *_, event in self.env._queue)
        return Outcome(self.sent - (pending - 1), self.tables)

    def read(self, node: int) -> Turns:
        """Update the table of a node with the messages it has received."""
        yield from ()

    def broadcast(self, src: int, number: int) -> None:
        """Broadcast a number to the neighbours of a node."""
        raise NotImplementedError


class Documented(PlainSimPy):
    """SimPy as in its documentation (example "Event Latency"): a store per node, a process per message."""

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
        """Put a message into a store after a delay, s."""
        yield self.env.timeout(delay)
        yield store.put(message)

    def outcome(self) -> Outcome:
        delivered, _ = super().outcome()
        for store, table in zip(self.stores, self.tables, strict=True):
            for src, number in store.items:
                note(table, src, number)
        return Outcome(delivered, self.tables)


class PerMessage(PlainSimPy):
    """One timeout per message; the callback of the timeout writes into the receiver's table."""

    def broadcast(self, src: int, number: int) -> None:
        timeout, tables = self.env.timeout, self.tables
        for dst, delay in self.hops(src):
            timeout(delay).callbacks.append(partial(_deliver, tables[dst], src, number))


class PerMessageDrawnAtOnce(PerMessage):
    """One timeout per message, with the latencies of a broadcast drawn at once."""

    def hops(self, src: int) -> Iterable[tuple[int, float]]:
        dst = self.neighbours[src]
        delay = self.work.latency(LinkContext(src, dst), self.rng)
        self.sent += len(dst)
        delays = [delay] * len(dst) if isinstance(delay, float) else delay.tolist()
        return zip(dst.tolist(), delays, strict=True)


class PerBroadcast(PlainSimPy):
    """One event per broadcast, which writes into the tables of all its receivers."""

    def __init__(self, workload: Workload):
        super().__init__(workload)
        self.reached = [[self.tables[node] for node in neighbours] for neighbours in workload.neighbours()]
        self.delivered = 0
        self.next_read = 0.0
        """Time, s, of the next read of a node: all arrivals until then can be written at once."""

    def turns(self) -> Turns:
        return self.together() if isinstance(self.work.latency, Constant) else self.one_by_one()

    def together(self) -> Turns:
        """Use one timeout per broadcast: with constant latency, messages cannot overtake each other."""
        env, deliver, latency = self.env, self.deliver, self.work.latency
        assert isinstance(latency, Constant)
        for number in range(self.work.turns):
            env.timeout(latency.value, number).callbacks.append(deliver)
            yield env.timeout(TICK)

    def deliver(self, event: simpy.Event) -> None:
        """Write a number into the tables of all neighbours, which it reaches at the same time."""
        number: int = event.value  # type: ignore[assignment]
        src = number % self.work.size
        tables = self.reached[src]
        for table in tables:
            table[src] = number
        self.delivered += len(tables)

    def one_by_one(self) -> Turns:
        """Use one event per broadcast, which writes into the tables of its receivers in the order of arrival."""
        env, end, size, arrivals = self.env, self.work.end, self.work.size, Arrivals(self.work)
        for number in range(self.work.turns):
            now = env.now
            self.next_read = min(now + TICK, end)
            _Visits(self, number, arrivals(number % size, now))
            yield env.timeout(TICK)

    def outcome(self) -> Outcome:
        return Outcome(self.delivered, self.tables)


class _Visits(simpy.Event):
    """A broadcast in flight: one event, scheduled first at the earliest arrival.

    Each time it is processed (`visit`), it writes all arrivals up to the next read into the tables of their receivers.
    It is then scheduled again at the first arrival after that read.
    """

    def __init__(self, way: PerBroadcast, number: int, arrivals: Iterator[tuple[float, int]]):
        self.env, self._ok, self._value = way.env, True, None
        self.way, self.number, self.src, self.arrivals = way, number, number % way.work.size, arrivals
        # SimPy sets `callbacks` to None when it processes an event; each `wait` sets this list again.
        self.visiting: list[Callable[[Any], None]] = [self.visit]
        self.wait(*next(arrivals))

    def wait(self, when: float, node: int) -> None:
        """Schedule this event at `when` (s), the arrival at `node`."""
        self.node, self.callbacks = node, self.visiting
        self.env.schedule(self, delay=when - self.env.now)

    def visit(self, _: simpy.Event) -> None:
        """Write into the tables of all receivers that the broadcast reaches until the next read of a node."""
        way, src, number, tables, visited = self.way, self.src, self.number, self.way.tables, 1
        table = tables[self.node]
        if table.get(src, -1) < number:
            table[src] = number
        for when, node in self.arrivals:
            if when > way.next_read:
                self.wait(when, node)
                break
            table = tables[node]
            if table.get(src, -1) < number:
                table[src] = number
            visited += 1
        way.delivered += visited


def _deliver(table: Table, src: int, number: int, _: simpy.Event) -> None:
    """Write an arriving number into the table of its receiver."""
    if table.get(src, -1) < number:
        table[src] = number
