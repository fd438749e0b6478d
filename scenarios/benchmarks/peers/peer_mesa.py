"""Deliver the broadcasts of a workload by Mesa's event list, one event per message.

This is a standalone program, which `elsewhere` runs.
"""

import json
import sys
import time
from math import log, log1p, sqrt

import mesa
import numpy as np
from mesa.experimental.devs import DEVSimulator

head, *lines = sys.stdin.read().splitlines()
turns, tick, mean, cv, seed = map(float, head.split())
neighbours = [list(map(int, line.split())) for line in lines]
size, variance = len(neighbours), log1p(cv**2)
rng = np.random.default_rng(int(seed))
tables: list[dict[int, int]] = [{} for _ in neighbours]
simulator = DEVSimulator()
simulator.setup(mesa.Model(seed=0))
delivered = 0


def turn(number: int) -> None:
    """Let a node broadcast, and schedule the next turn."""
    src = number % size
    dst, schedule = neighbours[src], simulator.schedule_event_relative
    delays = rng.lognormal(log(mean) - variance / 2, sqrt(variance), len(dst)).tolist() if cv else [mean] * len(dst)
    for node, delay in zip(dst, delays, strict=True):
        schedule(deliver, delay, function_args=[tables[node], src, number])
    if number + 1 < turns:
        simulator.schedule_event_absolute(turn, (number + 1) * tick, function_args=[number + 1])


def deliver(table: dict[int, int], src: int, number: int) -> None:
    """Write an arriving number into the table of its receiver, unless the table has a newer one from the same node."""
    global delivered
    if table.get(src, -1) < number:
        table[src] = number
    delivered += 1


simulator.schedule_event_absolute(turn, 0.0, function_args=[0])
begin = time.process_time()
simulator.run_until(float("inf"))
print(json.dumps({"deliveries": delivered, "seconds": time.process_time() - begin}))
