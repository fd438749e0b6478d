"""The process of one pursuer: a node, and a connection to the referee over which frames come and orders go."""

import asyncio
import json
import os
import sys
from contextlib import suppress
from time import monotonic_ns, process_time
from traceback import format_exception_only
from typing import Any

from desim.kernel.core.events import Broadcast, Lost, Sent
from desim.kernel.core.trace_file import line_of
from desim.kernel.core.units import nanoseconds
from desim.kernel.models.faults import FaultEnded, FaultStarted
from desim.live.frames import WorldFrame
from desim.live.namespaces import within_namespace
from desim.live.node import Node
from desim.live.sockets import udp_socket
from desim.live.start import PursuerStart
from desim.scenario.scenario import Scenario

LINE = 1 << 24
"""Largest length of a line between a pursuer and the referee, bytes."""
SILENCE = 1.0
"""Time without a frame after which a pursuer tells that the referee stalls, s."""
GIVE_UP = 30.0
"""Time without a frame after which a pursuer ends, s."""
EXCHANGES = 8
"""Number of time stamps that a pursuer on another host exchanges with the referee."""
ALONE, LOST_REFEREE = 3, 4
"""Exit codes of a pursuer: the referee was not found, or fell silent."""
OF_NETWORK = (Broadcast, Sent, Lost, FaultStarted, FaultEnded)
"""Events of a node that the referee makes itself."""


def play(scenario: Scenario, start: PursuerStart) -> int:
    """Run one pursuer to the end of the run; return the exit code of the process."""
    try:
        return asyncio.run(_Pursuer(scenario, start).play())
    except (ConnectionError, asyncio.IncompleteReadError):
        return LOST_REFEREE


class _Pursuer:
    """One pursuer of a live run."""

    def __init__(self, scenario: Scenario, start: PursuerStart):
        self._start, self._begin, self._offset = start, 0, 0
        self._node = Node(scenario, start.pursuer, start.seed, draws=start.draws, on_action=self._order)
        self._heard = 0.0
        self._is_silent = False

    async def play(self) -> int:
        """Join the run, and play until it is over."""
        start = self._start
        try:
            self._reader, self._writer = await asyncio.open_connection(*start.referee, limit=LINE)
        except OSError as error:
            print(f"pursuer {start.pursuer}: no referee at {start.referee[0]}: {error}", file=sys.stderr)
            return ALONE
        with within_namespace(start.namespace):
            bound = udp_socket((start.host, 0))
        address = await self._node.bind((start.host, 0), bound)
        self._tell("hello", start.pursuer, start.token, start.scenario, list(address))
        word, *values = await self._hear()
        while word != "start":
            if word == "refused":
                print(f"pursuer {start.pursuer}: {values[0]}", file=sys.stderr)
                return ALONE
            word, *values = await self._hear()
        addresses, shares_clock = values
        self._offset = 0 if shares_clock else await self._measured_offset()
        self._node.connect([(host, port) for host, port in addresses])  # before others may send
        self._tell("ready")
        word, self._begin = await self._hear()
        return await self._run()

    async def _run(self) -> int:
        node, loop = self._node, asyncio.get_running_loop()
        self._spent = process_time()
        self._heard = loop.time()
        running = asyncio.create_task(node.run(self._now, caught_up=self._report))
        listening = asyncio.create_task(self._listen())
        watching = asyncio.create_task(self._watch())
        code = 0
        try:
            await asyncio.wait({running, listening}, return_when=asyncio.FIRST_COMPLETED)
            if listening.done() and listening.exception():  # the referee has gone
                code = LOST_REFEREE
                node.stop()
            await running
        except BaseException as error:
            self._tell("error", "".join(format_exception_only(error)).strip(), getattr(error, "__notes__", []))
            raise
        finally:
            watching.cancel()
            self._report()
            counts, drops = node.transport_counts(), node.link.drops
            lateness = [] if node.clock is None else node.clock.lateness
            cpu = process_time() - self._spent
            self._tell("done", None if counts is None else list(counts), list(drops), lateness, node.link.errors, cpu)
            with suppress(OSError):
                await asyncio.wait_for(self._writer.drain(), 2.0)
                self._writer.close()
                await self._writer.wait_closed()
            listening.cancel()
        return code

    def _now(self) -> int:
        return monotonic_ns() + self._offset - self._begin

    async def _measured_offset(self) -> int:
        """Return by how much the clock of the referee is ahead, ns: that of the fastest of several exchanges."""
        best = (1 << 62, 0)
        for _ in range(EXCHANGES):
            sent = monotonic_ns()
            self._tell("ping")
            _, there = await self._hear()
            back = monotonic_ns()
            best = min(best, (back - sent, there - (sent + back) // 2))
        return best[1]

    async def _listen(self) -> None:
        """Take the frames of the referee until the run is over."""
        while True:
            word, *values = await self._hear()
            self._heard, self._is_silent = asyncio.get_running_loop().time(), False
            if word == "frame":
                self._node.show(WorldFrame(*values))
            elif word == "over":
                self._node.stop(*values)
                return

    async def _watch(self) -> None:
        """Tell if the referee falls silent, and end if it stays so."""
        while True:
            await asyncio.sleep(SILENCE / 4)
            silent = asyncio.get_running_loop().time() - self._heard
            if silent > SILENCE and not self._is_silent and self._now() > 0:
                self._is_silent = True
                print(f"pursuer {self._start.pursuer}: no frame of the referee for {silent:.1f} s", file=sys.stderr)
            if silent > GIVE_UP:
                os._exit(LOST_REFEREE)

    def _order(self, action: int) -> None:
        self._tell("order", nanoseconds(self._node.now), action)

    def _report(self) -> None:
        """Send what has happened since the last report."""
        link, trace = self._node.link, self._node.trace
        if link.departures:
            self._tell("sent", [sent._replace(datagram=bytes.hex(sent.datagram)) for sent in link.departures])
            link.departures.clear()
        if link.outcomes:
            self._tell("outcomes", link.outcomes)
            link.outcomes.clear()
        if trace.events:
            lines = [line_of(event) for event in trace.events if not isinstance(event, OF_NETWORK)]
            trace.events.clear()
            if lines:
                self._tell("events", lines)

    def _tell(self, *words: Any) -> None:
        self._writer.write(json.dumps(words).encode() + b"\n")

    async def _hear(self) -> Any:
        line = await self._reader.readline()
        if not line:
            raise ConnectionError("the referee has gone")
        return json.loads(line)
