"""The sockets of a live run, and nothing else: the same datagrams and lines, between as many processes.

The time that a live run takes beyond this is that of desim. Each process has a loop of asyncio, sends datagrams at
equal intervals, and drops what it receives. The parent process takes the place of the referee: it sends lines to all
others, and drops the lines that it receives.
"""

import asyncio
import os
import socket
import time
from collections.abc import Callable
from math import fsum
from typing import NamedTuple

HOST = "127.0.0.1"
LARGEST = 1 << 16
"""Bytes of the largest datagram."""
LEAD = 0.5
"""Time in which the processes start, s."""
REST = 0.2
"""Time for which they still receive at the end, s."""


class Traffic(NamedTuple):
    """The traffic of one run; the numbers are means over the pursuers."""

    pursuers: int
    duration: float
    """s"""
    broadcasts: float
    """Number of transmissions of a pursuer."""
    receivers: float
    """Number of receivers of a transmission."""
    datagram: float
    """Bytes of a datagram."""
    lines: float
    """Number of lines that a pursuer sends to the referee."""
    line: float
    """Bytes of such a line."""
    frames: float
    """Number of lines that the referee sends to each pursuer."""
    frame: float
    """Bytes of such a line."""


def bare_sockets(traffic: Traffic) -> float:
    """Send and receive the traffic of a run; return the processor time of all processes, s."""
    ends = [socket.socketpair() for _ in range(traffic.pursuers)]
    datagrams = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(traffic.pursuers)]
    for bound in datagrams:
        bound.bind((HOST, 0))
    begin, times = time.monotonic() + LEAD, os.pipe()
    for pursuer in range(traffic.pursuers):
        if os.fork() == 0:
            spent = asyncio.run(_pursuer(traffic, pursuer, datagrams, ends[pursuer][1], begin))
            os.write(times[1], f"{spent}\n".encode())
            os._exit(0)
    spent = asyncio.run(_referee(traffic, [end for end, _ in ends], begin))
    for _ in range(traffic.pursuers):
        os.wait()
    return spent + fsum(map(float, os.read(times[0], LARGEST).split()))


class _Sink(asyncio.Protocol):
    """Drops what it receives."""


async def _pursuer(
    traffic: Traffic, pursuer: int, datagrams: list[socket.socket], to_referee: socket.socket, begin: float
) -> float:
    loop, bound = asyncio.get_running_loop(), datagrams[pursuer]
    bound.setblocking(False)
    loop.add_reader(bound, lambda: bound.recvfrom(LARGEST))
    lines, _ = await loop.create_connection(_Sink, sock=to_referee)
    others = [other.getsockname() for other in datagrams if other is not bound][: round(traffic.receivers)]
    datagram, line = bytes(round(traffic.datagram)), bytes(round(traffic.line))

    def broadcast() -> None:
        for address in others:
            bound.sendto(datagram, address)

    share = pursuer / traffic.pursuers
    _repeat(broadcast, begin, share, traffic.duration, traffic.broadcasts)
    _repeat(lambda: lines.write(line), begin, share, traffic.duration, traffic.lines)
    return await _spent(traffic, begin)


async def _referee(traffic: Traffic, ends: list[socket.socket], begin: float) -> float:
    loop, frame = asyncio.get_running_loop(), bytes(round(traffic.frame))
    lines = [(await loop.create_connection(_Sink, sock=end))[0] for end in ends]

    def show() -> None:
        for line in lines:
            line.write(frame)

    _repeat(show, begin, 0.0, traffic.duration, traffic.frames)
    return await _spent(traffic, begin)


def _repeat(act: Callable[[], object], begin: float, share: float, duration: float, number: float) -> None:
    """Call a function a number of times at equal intervals, for the first time after a share of an interval."""
    loop = asyncio.get_running_loop()
    period = duration / max(number, 1e-9)

    def ring(k: int) -> None:
        if k >= number:
            return
        act()
        loop.call_at(begin + (k + 1 + share) * period, ring, k + 1)

    loop.call_at(begin + share * period, ring, 0)


async def _spent(traffic: Traffic, begin: float) -> float:
    """Wait until all has been sent; return the processor time of this process since `begin`, s."""
    await asyncio.sleep(begin - time.monotonic())
    before = time.process_time()
    await asyncio.sleep(begin + traffic.duration + REST - time.monotonic())
    return time.process_time() - before
