"""Deliver the broadcasts of a workload in GrADyS-SIM NextGen, as one packet to each receiver.

This is a standalone program, which `elsewhere` runs. The simulator's own medium has a single delay, and
checks for every node whether it is within range. `Medium` transmits to the neighbours only, with a separate delay for
each. This is faster than the simulator's broadcast.
"""

import json
import logging
import sys
import time
from math import inf, log, log1p, sqrt

import numpy as np
from gradysim.protocol.interface import IProtocol
from gradysim.protocol.messages.communication import BroadcastMessageCommand, CommunicationCommand
from gradysim.protocol.messages.telemetry import Telemetry
from gradysim.simulator.handler.communication import CommunicationHandler, CommunicationMedium
from gradysim.simulator.handler.timer import TimerHandler
from gradysim.simulator.node import Node
from gradysim.simulator.simulation import SimulationBuilder, SimulationConfiguration

head, *lines = sys.stdin.read().splitlines()
turns, tick, mean, cv, seed = map(float, head.split())
neighbours = [list(map(int, line.split())) for line in lines]
size, variance = len(neighbours), log1p(cv**2)
rng = np.random.default_rng(int(seed))
delivered = 0


class Medium(CommunicationHandler):  # type: ignore[misc]
    """A medium that broadcasts along the edges of the graph."""

    def handle_command(
        self, command: CommunicationCommand, sender: Node, medium: CommunicationMedium | None = None
    ) -> None:
        source, dst = self._sources[sender.id], neighbours[sender.id]
        delays = rng.lognormal(log(mean) - variance / 2, sqrt(variance), len(dst)).tolist() if cv else [mean] * len(dst)
        for node, delay in zip(dst, delays, strict=True):
            self._transmit_message(command.message, source, self._destinations[node], CommunicationMedium(inf, delay))


class Talker(IProtocol):  # type: ignore[misc]
    """A node that broadcasts the number of each of its turns, and keeps the newest number from each other node."""

    def initialize(self) -> None:
        self.table: dict[int, int] = {}
        self.number = self.provider.get_id()
        self.next()

    def next(self) -> None:
        """Set the timer of the next turn."""
        if self.number < turns:
            self.provider.schedule_timer("", self.number * tick)

    def handle_timer(self, timer: str) -> None:
        self.provider.send_communication_command(BroadcastMessageCommand(str(self.number)))
        self.number += size
        self.next()

    def handle_packet(self, message: str) -> None:
        global delivered
        number = int(message)
        src = number % size
        if self.table.get(src, -1) < number:
            self.table[src] = number
        delivered += 1

    def handle_telemetry(self, telemetry: Telemetry) -> None: ...

    def finish(self) -> None: ...


builder = SimulationBuilder(SimulationConfiguration(execution_logging=False))
builder.add_handler(Medium()).add_handler(TimerHandler())
for _ in neighbours:
    builder.add_node(Talker, (0.0, 0.0, 0.0))
simulation = builder.build()
logging.getLogger().setLevel(logging.ERROR)
begin = time.process_time()
simulation.start_simulation()
print(json.dumps({"deliveries": delivered, "seconds": time.process_time() - begin}))
