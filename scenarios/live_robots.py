"""The protocol of `desim` on your own robots: a server moves three toy robots, and three nodes negotiate.

    python -m scenarios.live_robots

The server is another process, and stands for the robots, their positioning and the evader: it takes a velocity, and
answers with positions. Each node is what would run on one robot: the unchanged protocol of the scenario, its socket,
and ten lines that carry positions in and commands out.
"""

import asyncio
import json
import socket
import sys
import time
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click

from desim import Scenario, load
from desim.live import Node

HOST = "127.0.0.1"
PERIOD = 0.02
"""Time between two commands to a robot, s."""
SPEEDS = 2.0, 2.0, 3.0


def toy_robots(port: int) -> None:
    """Serve three robots and an evader that flees from the nearest: [robot, vx, vy] in, [places, evader, over] out."""
    places, velocities = [0j, 6 + 0j, 3 + 6j], [0j, 0j, 0j]
    evader, moved_at = 3 + 2j, time.monotonic()

    def move() -> bool:
        """Move all up to now; return whether the evader is captured."""
        nonlocal evader, moved_at
        now = time.monotonic()
        elapsed, moved_at = now - moved_at, now
        nearest = min(places, key=lambda place: abs(place - evader))
        evader += elapsed * (evader - nearest) / max(abs(evader - nearest), 1e-9)
        places[:] = [place + elapsed * velocity for place, velocity in zip(places, velocities, strict=True)]
        return min(abs(place - evader) for place in places) <= 0.2

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            robot, x, y = json.loads(line)
            velocities[robot], is_over = complex(x, y), move()
            answer: list[Any] = [[[place.real, place.imag] for place in places], [evader.real, evader.imag], is_over]
            writer.write(json.dumps(answer).encode() + b"\n")

    async def run() -> None:
        async with await asyncio.start_server(serve, HOST, port) as server:
            await server.serve_forever()

    asyncio.run(run())


async def drive(scenario: Scenario, pursuer: int, ports: list[int], start: int, robots: int) -> float:
    """Let one robot take part until the evader is captured; return the time of its node at the end, s."""
    reader, writer = await asyncio.open_connection(HOST, robots)
    node, peers = Node(scenario, pursuer), [(HOST, port) for port in ports]
    velocity = [0.0, 0.0]
    async with node.open(peers[pursuer], peers, lambda: time.monotonic_ns() - start):
        while not node.is_over:
            writer.write(json.dumps([pursuer, *velocity]).encode() + b"\n")
            places, evader, is_captured = json.loads(await reader.readline())
            if is_captured:
                break
            node.sense(places[pursuer], [evader], places)  # positions in ...
            velocity = node.velocity()  # ... commands out
            await asyncio.sleep(PERIOD)
    writer.close()
    return node.now


def free_ports(count: int) -> list[int]:
    """Return ports that are free now."""
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for unbound in sockets:
        unbound.bind((HOST, 0))
    ports = [bound.getsockname()[1] for bound in sockets]
    for bound in sockets:  # only after all have a port, so that no two get the same
        bound.close()
    return ports


async def play(scenario: Scenario, robots: int) -> list[float]:
    """Run all nodes; they could as well be programs of their own, on one machine or on several."""
    ports, start = free_ports(3), time.monotonic_ns()
    return await asyncio.gather(*(drive(scenario, pursuer, ports, start, robots) for pursuer in range(3)))


@click.command()
def main() -> None:
    """Start the robots, and print when the evader was captured."""
    relay = load(Path(__file__).with_name("relay.toml"))
    team = relay.team.model_copy(update={"count": 3, "speeds": SPEEDS})
    scenario = relay.model_copy(update={"team": team, "horizon": 10.0})
    (port,) = free_ports(1)
    robots = get_context("spawn").Process(target=toy_robots, args=(port,), daemon=True)
    robots.start()
    for _ in range(200):  # until the server accepts connections, at most 20 s
        try:
            socket.create_connection((HOST, port)).close()
            break
        except OSError:
            time.sleep(0.1)
    times = asyncio.run(play(scenario, port))
    robots.terminate()
    robots.join()
    sys.stdout.write(f"captured after {min(times):.2f} s\n")


if __name__ == "__main__":
    main()
