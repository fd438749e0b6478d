"""The process of one pursuer: a node, and a connection to the referee over which frames come and orders go."""

import asyncio
import os
import sys
from time import monotonic_ns, process_time
from traceback import StackSummary, walk_tb
from typing import Any

from desim.kernel.core.clock import RARE_COLLECTION
from desim.kernel.core.trace_file import line_of
from desim.kernel.core.units import nanoseconds
from desim.live.frames import WorldFrame
from desim.live.lines import Lines
from desim.live.namespaces import within_namespace
from desim.live.node import Node
from desim.live.sockets import udp_socket
from desim.live.start import PursuerStart
from desim.scenario.scenario import Scenario

REPORTS = 0.25
"""Time between two reports of events, s. If a process is killed, its events since the last report are lost."""
SILENCE = 1.0
"""Time without a frame after which a pursuer prints that the referee is silent, s."""
GIVE_UP = 30.0
"""Time without a frame after which a pursuer ends, s."""
LEAVING = 2.0
"""Time in which the referee should have read the last report, s."""
EXCHANGES = 8
"""Number of time stamps that a pursuer on another host exchanges with the referee."""
RAISED, ALONE, LOST_REFEREE = 1, 3, 4
"""Exit codes of a pursuer: the protocol has raised an exception; the referee was not found, or fell silent."""
LIBRARIES = ("desim", "protocols", "simpy", "asyncio", "contextlib")
"""The packages whose calls are left out of a traceback."""


def play(scenario: Scenario, start: PursuerStart) -> int:
    """Run one pursuer to the end of the run; return the exit code of the process."""
    with RARE_COLLECTION:
        return asyncio.run(_Pursuer(scenario, start).play())


class _Pursuer:
    """One pursuer of a live run."""

    def __init__(self, scenario: Scenario, start: PursuerStart):
        self._start, self._begin, self._offset = start, 0, 0
        self._node = Node(scenario, start.pursuer, start.seed, draws=start.draws, on_action=self._order)
        self._heard = self._reported = 0.0
        """The times of the last line of the referee and of the last report, s, by the clock of the event loop."""
        self._is_told = False
        """Whether the pursuer has printed that the referee is silent."""

    async def play(self) -> int:
        """Join the run, and play until it is over."""
        start, received = self._start, asyncio.Queue[Any]()
        self._lines = lines = Lines(lambda *words: received.put_nowait(words), lambda: received.put_nowait(("gone",)))
        try:
            await asyncio.get_running_loop().create_connection(lambda: lines, *start.referee)
        except OSError as error:
            if start.scenario:  # a process of another host; for one of this machine, the run has been interrupted
                why = os.strerror(error.errno) if error.errno else error
                self._tell(f"no referee at {start.referee[0]}, port {start.referee[1]}: {why}")
            return ALONE
        with within_namespace(start.namespace):
            main_socket, mailbox = (udp_socket((start.host, 0)) for _ in range(2))
        addresses = self._node.bind(main_socket), self._node.bind_mailbox(mailbox)
        lines.tell("hello", start.pursuer, start.token, start.scenario, addresses)
        while True:
            match await received.get():
                case "start", addresses, shares_clock:
                    try:
                        self._offset = 0 if shares_clock else await self._measured_offset(received)
                    except ConnectionError:
                        return LOST_REFEREE
                    peers, mailboxes = zip(*addresses, strict=True)
                    # Datagrams may arrive once all are ready: the node then has to know from whom.
                    self._node.connect([*map(tuple, peers)], [box and tuple(box) for box in mailboxes])
                    lines.tell("ready")
                case "begin", begin:
                    self._begin = begin
                    return await self._run(received)
                case "refused", why:
                    self._tell(why)
                    return ALONE
                case _:
                    return LOST_REFEREE

    def _tell(self, text: str) -> None:
        print(f"pursuer {self._start.pursuer}: {text}", file=sys.stderr)

    async def _measured_offset(self, received: "asyncio.Queue[Any]") -> int:
        """Return by how much the clock of the referee is ahead, ns, as the fastest of several exchanges shows it.

        Raise ConnectionError if the connection ends, or a line comes that is no answer.
        """
        fastest = (1 << 62, 0)  # the duration of an exchange and the offset that it shows, ns
        for _ in range(EXCHANGES):
            sent = monotonic_ns()
            self._lines.tell("ping")
            answer = await received.get()
            end = monotonic_ns()
            if answer[0] != "pong":
                raise ConnectionError
            fastest = min(fastest, (end - sent, answer[1] - (sent + end) // 2))
        return fastest[1]

    # The run.

    async def _run(self, received: "asyncio.Queue[Any]") -> int:
        """Play until the run is over; return the exit code."""
        node, cpu_before = self._node, process_time()
        self._heard = self._reported = asyncio.get_running_loop().time()
        running = asyncio.create_task(node.run(lambda: monotonic_ns() + self._offset - self._begin))
        self._lines.hear, self._lines.lost = self._take, node.stop
        while not received.empty():
            self._take(*received.get_nowait())
        watching = asyncio.create_task(self._watch())
        try:
            await running
        except BaseException as error:
            self._lines.tell("error", told(error))
            return RAISED
        finally:
            watching.cancel()
            was_lost = self._lines.ended.done()
            await self._leave(process_time() - cpu_before)
        return LOST_REFEREE if was_lost else 0

    def _take(self, word: str, *values: Any) -> None:
        """Take a line of the referee."""
        self._heard, self._is_told = asyncio.get_running_loop().time(), False
        if word == "over":
            self._node.stop(*values)
        elif word == "frame":
            self._node.follow(WorldFrame(*values))
            if self._heard > self._reported + REPORTS:
                self._reported = self._heard
                self._report()
        else:
            self._node.stop()

    async def _watch(self) -> None:
        """Print if the referee falls silent, and end the process if the silence lasts."""
        while True:
            await asyncio.sleep(SILENCE / 4)
            silent = asyncio.get_running_loop().time() - self._heard
            if silent > SILENCE and not self._is_told:
                self._is_told = True
                self._tell(f"no frame of the referee for {silent:.1f} s")
            if silent > GIVE_UP:
                os._exit(LOST_REFEREE)

    def _order(self, action: int) -> None:
        self._lines.tell("order", nanoseconds(self._node.now), action)

    # Reports.

    def _report(self) -> None:
        """Send what has happened since the last report."""
        link, trace = self._node.link, self._node.trace
        sent = [(*rest, datagram.hex()) for *rest, datagram in link.departures]
        self._lines.tell("report", sent, list(link.outcomes), list(map(line_of, trace.events)))
        for reported in (link.departures, link.outcomes, trace.events):
            reported.clear()

    async def _leave(self, cpu: float) -> None:
        """Send the last report, and how the run went, and close the connection."""
        node, lines = self._node, self._lines
        self._report()
        counts, lateness = node.transport_counts(), [] if node.clock is None else node.clock.lateness
        numbers = None if counts is None else list(counts)
        lines.tell("done", numbers, list(node.link.drops), lateness, list(node.link.errors), cpu)
        lines.close()
        await asyncio.wait({lines.ended}, timeout=LEAVING)


def told(error: BaseException) -> str:
    """Return an exception of a protocol as text, with the calls outside of `LIBRARIES`."""
    calls = [
        (frame, line)
        for frame, line in walk_tb(error.__traceback__)
        if str(frame.f_globals.get("__name__")).partition(".")[0] not in LIBRARIES
    ]
    notes = [str(note) for note in getattr(error, "__notes__", ())]
    lines = ["\n"] * bool(calls) + StackSummary.extract(iter(calls)).format()
    return "".join([*lines, " ".join([f"{type(error).__name__}: {error}", *notes])])
