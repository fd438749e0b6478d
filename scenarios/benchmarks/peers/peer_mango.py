"""Deliver the broadcasts of a workload in mango's simulation world, one message per receiver.

This is a standalone program, which `elsewhere` runs; that module describes its input and output. The
nodes take turns; in its turn a node broadcasts once. After each turn the world takes one step, which delivers all
messages that have arrived. A step per turn is faster than a step per arrival.
"""

import asyncio
import json
import random
import sys
import time
from math import log, log1p, sqrt
from typing import Any

from mango import Agent
from mango.simulation import DelayProviderCommunicationSimulation, create_world

head, *lines = sys.stdin.read().splitlines()
turns, tick, mean, cv, seed = map(float, head.split())
neighbours = [list(map(int, line.split())) for line in lines]
size, variance = len(neighbours), log1p(cv**2)
rng = random.Random(int(seed))
delivered = 0


def latency() -> float:
    """Return the latency of a message, s."""
    return rng.lognormvariate(log(mean) - variance / 2, sqrt(variance)) if cv else mean


class Talker(Agent):  # type: ignore[misc]
    """A node that keeps the greatest turn number that it has received from each other node."""

    def __init__(self) -> None:
        super().__init__()
        self.table: dict[int, int] = {}

    def handle_message(self, content: Any, meta: dict[str, Any]) -> None:
        global delivered
        src = content % size
        if self.table.get(src, -1) < content:
            self.table[src] = content
        delivered += 1


async def main() -> None:
    """Let the nodes broadcast, one after the other, then deliver the messages in flight."""
    world = create_world(
        start_time=0.0,
        communication_sim=DelayProviderCommunicationSimulation(latency),
        record_messages=False,
    )
    agents = [world.register(Talker()) for _ in neighbours]
    async with world:
        for number in range(int(turns)):
            src = number % size
            for node in neighbours[src]:
                await world.send_message(number, agents[node].addr, agents[src].aid)
            await world.step(tick)
        while world.container._pending_messages:
            await world.step(tick)


begin = time.process_time()
asyncio.run(main())
print(json.dumps({"deliveries": delivered, "seconds": time.process_time() - begin}))
