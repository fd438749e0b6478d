"""CSMA/CA with the capture effect in plain SimPy, written as its documentation suggests: a process per node.

A node waits for its next frame, counts down its back-off while the channel is idle, and transmits. At the end of a
frame it is decided receiver by receiver who gets it; each message then takes a latency of its own.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from math import dist, log, log1p, sqrt
from typing import Any

import numpy as np
import simpy
from numpy.typing import NDArray

from desim import CaptureEffect, CsmaCa, Lognormal
from scenarios.benchmarks.peers.workloads import note

Steps = Generator[simpy.Event, Any, None]


@dataclass(eq=False)
class Transmission:
    """A frame on the air."""

    src: int
    number: int
    overlapping: list["Transmission"] = field(default_factory=list)


class Contention:
    """Nodes in range of each other that take turns to broadcast.

    Args:
        positions: (n, 2) their positions, m.
        times: the times of the broadcasts, s.
        airtime: airtime of a frame, s.
        access: the model of channel access.
        capture: the model of interference; without preamble lock.
        latency: the latency of each message after its frame.
        seed: the seed of all draws.
    """

    def __init__(
        self,
        positions: NDArray[np.float64],
        times: Sequence[float],
        airtime: float,
        access: CsmaCa,
        capture: CaptureEffect,
        latency: Lognormal,
        seed: int,
    ):
        self.env, self.rng = simpy.Environment(), np.random.default_rng(seed)
        self.size, self.times, self.airtime, self.access = len(positions), times, airtime, access
        places = positions.tolist()
        decibels = -10.0 * capture.exponent / log(10.0)
        self.power = [[decibels * log(max(dist(place, other), 1e-3)) for other in places] for place in places]
        self.threshold = capture.threshold
        variance = log1p(latency.cv**2)
        self.mean, self.deviation = log(latency.mean) - variance / 2, sqrt(variance)
        self.queues = [simpy.Store(self.env) for _ in range(self.size)]
        self.on_air: list[Transmission] = []
        self.busy, self.idle = self.env.event(), self.env.event()
        self.idle_since = 0.0
        self.tables: list[dict[int, int]] = [{} for _ in range(self.size)]
        self.sent = self.delivered = 0
        for node in range(self.size):
            self.env.process(self.station(node))
        self.env.process(self.traffic())

    def run(self) -> None:
        """Run until all messages have arrived."""
        self.env.run()

    def traffic(self) -> Steps:
        """Let the nodes broadcast, one after the other."""
        for number, time in enumerate(self.times):
            yield self.env.timeout(time - self.env.now)
            self.sent += self.size - 1
            self.queues[number % self.size].put(number)

    def station(self, node: int) -> Steps:
        """Transmit the frames of a node, each after a back-off, except where the channel has been idle for DIFS."""
        queue, rng, window = self.queues[node], self.rng, self.access.window
        while True:
            has_waited = bool(queue.items)  # for the back-off after the frame before
            number = yield queue.get()
            if not has_waited and (self.on_air or not (yield from self.idle_for(0))):
                yield from self.back_off(int(rng.integers(window)))
            frame = self.begin(node, number)
            yield self.env.timeout(self.airtime)
            self.end(frame)
            yield from self.back_off(int(rng.integers(window)))

    def back_off(self, slots: int) -> Steps:
        """Wait for some slots in which the channel is idle, after DIFS; a frame only interrupts the count of slots."""
        while True:
            if self.on_air:
                yield self.idle
            since = self.idle_since
            if (yield from self.idle_for(slots)):
                return
            slots -= min(max(int((self.env.now - since - self.access.difs) / self.access.slot), 0), slots)

    def idle_for(self, slots: int) -> Generator[simpy.Event, Any, bool]:
        """Wait for the end of DIFS and some slots, or for the next frame; return whether the channel stayed idle."""
        end = self.idle_since + self.access.difs + slots * self.access.slot
        elapsed = self.env.timeout(max(end - self.env.now, 0.0))
        yield elapsed | self.busy
        return elapsed.processed

    def begin(self, node: int, number: int) -> Transmission:
        """Put a frame on the air."""
        frame = Transmission(node, number, list(self.on_air))
        for other in self.on_air:
            other.overlapping.append(frame)
        self.on_air.append(frame)
        if len(self.on_air) == 1:
            self.busy.succeed()
            self.idle = self.env.event()
        return frame

    def end(self, frame: Transmission) -> None:
        """Take a frame from the air, and send it to the nodes that receive it."""
        self.on_air.remove(frame)
        if not self.on_air:
            self.idle_since = self.env.now
            self.busy = self.env.event()
            self.idle.succeed()
        deaf = {other.src for other in frame.overlapping} | {frame.src}
        for node in range(self.size):
            limit = self.power[frame.src][node] - self.threshold
            if node not in deaf and all(self.power[other.src][node] <= limit for other in frame.overlapping):
                self.env.process(self.message(frame, node))

    def message(self, frame: Transmission, node: int) -> Steps:
        """Deliver a message after its latency."""
        yield self.env.timeout(self.rng.lognormal(self.mean, self.deviation))
        note(self.tables[node], frame.src, frame.number)
        self.delivered += 1
