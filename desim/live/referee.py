"""The referee of a live run: it moves the players, answers what the pursuers sense, and ends the run."""

import asyncio
import json
import pickle
import secrets
import subprocess
import sys
from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from signal import Signals
from time import monotonic_ns
from typing import Any

from desim.config.fresh import fresh_copy
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import Event, Trace, TransportCounts
from desim.kernel.core.seeds import seed_of
from desim.kernel.core.units import SECOND, nanoseconds
from desim.kernel.fault_injection import inject
from desim.kernel.models.faults import Crash, FaultStarted, draw_faults
from desim.kernel.models.links import Links
from desim.kernel.network import Network
from desim.kernel.state.fault_state import FaultState
from desim.live.frames import frame_of
from desim.live.link import Drops
from desim.live.merge import Logs
from desim.live.own_bodies import OwnBodies
from desim.live.pursuer import LINE, Start, is_token
from desim.live.refusals import check_live
from desim.live.wall_clock import Lateness, WallClock
from desim.live.wire import Wire, WireError
from desim.pursuit.core.events import Captured
from desim.pursuit.sensing.views import View
from desim.scenario.scenario import Scenario
from desim.simulation.pursuer_positions import PursuerPositions
from desim.simulation.run import Result
from desim.simulation.run_end import RunEnd
from desim.simulation.team_processes import TeamProcesses
from desim.simulation.world import World, initial_state
from desim.study.workers.serialization import packed

FRAME = 20_000_000
"""Time between two frames, ns, or a motion step if that is longer."""
JOINING = 30.0
"""Time in which the processes of this machine should have joined, s."""
LEAD = 0.05
"""Time between the last pursuer that joins and the start of the run, s."""
LINGER = 2.0
"""Time in which the pursuers should have reported at the end, s."""
BACKLOG = 1 << 20
"""Bytes of frames that a pursuer has not read above which it gets no new one."""
LOCAL = "127.0.0.1"


class LiveError(RuntimeError):
    """A live run could not begin, or a protocol has raised an exception."""


@dataclass
class Conduct:
    """How a live run went, besides its trace.

    Attributes:
        lateness: by process, the pursuers and "referee", how late its timers were.
        delivery_error: how much later than its time each message was delivered.
        drops: by pursuer, the datagrams that it has dropped.
        ends: by pursuer, how its process ended before the run was over.
        notes: sentences about what went wrong.
    """

    lateness: dict[int | str, Lateness] = field(default_factory=dict)
    delivery_error: Lateness = Lateness(0, 0.0, 0.0, 0.0)
    drops: dict[int, Drops] = field(default_factory=dict)
    ends: dict[int, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    @property
    def p99(self) -> float:
        """The greatest 99th percentile of lateness of all processes, s."""
        return max((late.p99 for late in self.lateness.values()), default=0.0)


@dataclass(frozen=True, repr=False)
class LiveResult(Result):
    """The result of a live run: as that of a simulation, and how the run went."""

    conduct: Conduct = field(default_factory=Conduct)


@dataclass
class _Connection:
    """A pursuer that has joined."""

    writer: asyncio.StreamWriter
    address: list[Any]
    pid: int
    is_done: bool = False
    latenesses: list[int] = field(default_factory=list)
    errors: list[int] = field(default_factory=list)


class Referee:
    """Runs a scenario live once.

    Args:
        scenario: the experiment.
        seed: the seed; None: that of the scenario.
        hosts: (N,) the host at which each pursuer listens; None: the loopback.
        draws: whether losses and latencies are drawn by the pursuers; False: the links are real.
        namespaces: (N,) the network namespace of each pursuer; None: that of the caller.
        tell: called with sentences about the run as it goes on.

    Raises:
        ValueError: if the scenario cannot run live.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int | None = None,
        *,
        hosts: Sequence[str] | None = None,
        draws: bool = True,
        namespaces: Sequence[str] | None = None,
        tell: Callable[[str], object] = lambda text: None,
    ):
        check_live(scenario)
        size = scenario.team.count
        self._scenario, self._seed = scenario, scenario.seed if seed is None else seed_of(seed)
        self._hosts, self._namespaces = hosts or [LOCAL] * size, namespaces or [""] * size
        self._draws, self._tell, self._token = draws, tell, secrets.token_hex(16)
        self.conduct = Conduct()
        self._wire = Wire(size, len(scenario.evaders), OwnBodies(scenario.protocol, WireError))
        self._logs = Logs(self._wire)
        self._joined: dict[int, _Connection] = {}
        self._ready: set[int] = set()
        self._changed = asyncio.Condition()
        self._orders: deque[tuple[int, int]] = deque()
        self._gone: deque[tuple[int, str]] = deque()
        self._obeyed = [0] * size
        self._errors: list[str] = []
        self._statuses: dict[int, int] = {}
        self._clock: WallClock | None = None
        self._is_over = False

    async def play(self) -> LiveResult:
        """Run the scenario, and return the result.

        Raises:
            LiveError: if a process does not join, or a protocol raises an exception.
        """
        server = await asyncio.start_server(self._welcome, self._host, 0, limit=LINE)
        address = server.sockets[0].getsockname()[:2]
        starts = [
            Start((address[0], address[1]), self._token, pursuer, self._seed, host, self._draws, self._namespaces[pursuer])
            for pursuer, host in enumerate(self._hosts)
        ]
        nursery = await _start_nursery(self._scenario, starts)
        watching = asyncio.create_task(self._watch(nursery))
        try:
            await self._until(lambda: len(self._joined) == len(starts), JOINING, "did not join")
            everybody = self._joined.values()
            self._send("start", [connection.address for connection in everybody_in_order(self._joined)], True)
            await self._until(lambda: len(self._ready) == len(everybody), JOINING, "is not ready")
            begin = monotonic_ns() + nanoseconds(LEAD)
            self._send("begin", begin)
            with fresh_copy(self._scenario) as scenario:
                world = await self._run(scenario, begin)
            return await self._finish(world)
        finally:
            self._is_over = True
            server.close()
            for connection in self._joined.values():
                connection.writer.close()
            assert nursery.stdin is not None
            nursery.stdin.close()
            with suppress(asyncio.CancelledError):
                await nursery.wait()
                await watching

    @property
    def _host(self) -> str:
        return LOCAL

    # The run.

    async def _run(self, scenario: Scenario, begin: int) -> list[Event]:
        """Move the players until the run is over; return the events of the world."""
        env = Clock()
        end, trace = RunEnd(env), Trace()
        self._end, self._trace, self._env = end, trace, env
        state = initial_state(env, scenario, self._seed)
        self._state = state
        views = [View(state, scenario.prune)] * state.size
        self._world = world = World(env, scenario, state, views, trace, end)
        self._inject(scenario, world, trace)
        world.begin()
        env.process(self._frames(max(FRAME, nanoseconds(scenario.motion.step))))
        self._clock = clock = WallClock(env, end.over, lambda: monotonic_ns() - begin)
        await clock.follow(self._take)
        world.sample()
        assert end.event is not None
        self._send("over", end.event.t)
        return [*trace, end.event]

    def _inject(self, scenario: Scenario, world: World, trace: Trace) -> None:
        """Plan the faults of robots; those of the network have no messages here."""
        state, env = self._state, self._env
        positions = PursuerPositions(state, scenario.team.top_speed + scenario.environment.top_speed)
        faults = draw_faults(scenario.network_faults, state.size, scenario.horizon, self._seed)
        graph = scenario.network.make_graph(state.size)
        network = Network(env, graph, Links(), positions=positions, fault_state=FaultState(positions) if faults else None)
        judges = [None] * state.size
        team = TeamProcesses(env, scenario, world, {}, judges, None, None)
        inject(faults, env, network, trace, crashed=team.crashed, recovered=team.recovered)

    def _frames(self, period: int) -> Any:
        """Send a frame each period (ns)."""
        for when in range(0, self._state.horizon + period, period):
            yield Instant(self._env, when, Phase.SAMPLE + 1)
            self._send("frame", *frame_of(self._state, self._obeyed), frames=True)

    def _take(self) -> bool:
        """Obey the orders of the pursuers, and take those down whose process was lost."""
        any_taken = bool(self._orders or self._gone)
        while self._orders:
            pursuer, action = self._orders.popleft()
            self._obeyed[pursuer] += 1
            self._world.set_action(pursuer, action)
        while self._gone:
            pursuer, why = self._gone.popleft()
            self._crash(pursuer, why)
        return any_taken

    def _crash(self, pursuer: int, why: str) -> None:
        """Take a pursuer down whose process was lost."""
        now = self._env.now
        self._logs.crashed[pursuer] = now
        self._trace.append(FaultStarted(now, Crash(start=now / SECOND, node=pursuer)))
        self._world.crash(pursuer)
        self.conduct.ends[pursuer] = why
        self._tell(f"pursuer {pursuer} {why} after {now / SECOND:.2f} s")
        if self._errors:
            self._end.finish("stopped")

    def _send(self, *words: Any, frames: bool = False) -> None:
        line = json.dumps(words).encode() + b"\n"
        for connection in self._joined.values():
            if not (connection.is_done or (frames and connection.writer.transport.get_write_buffer_size() > BACKLOG)):
                connection.writer.write(line)

    # The pursuers.

    async def _welcome(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a process that connects."""
        pursuer: int | None = None
        try:
            pursuer = await self._admit(reader, writer)
            while pursuer is not None and (line := await reader.readline()):
                self._hear(pursuer, *json.loads(line))
        except (OSError, ValueError, TypeError, asyncio.IncompleteReadError) as error:
            self.conduct.notes.append(f"a connection was closed: {error}")
        finally:
            writer.close()
            if pursuer is not None:
                await self._lose(pursuer)

    async def _admit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> int | None:
        """Return the number of a pursuer that joins; None if it does not belong to the run."""
        word, pursuer, token, address, pid = json.loads(await reader.readline())
        is_ours = word == "hello" and is_token(token, self._token)
        if not is_ours or pursuer not in range(len(self._hosts)) or pursuer in self._joined:
            writer.write(json.dumps(["refused", "this run has no such pursuer, or has it already"]).encode() + b"\n")
            return None
        self._joined[pursuer] = _Connection(writer, [str(address[0]), int(address[1])], int(pid))
        async with self._changed:
            self._changed.notify_all()
        return int(pursuer)

    def _hear(self, pursuer: int, word: str, *values: Any) -> None:
        """Take a line of a pursuer."""
        connection = self._joined[pursuer]
        if word == "order":
            self._orders.append((pursuer, values[1]))
            self._wake()
        elif word == "sent":
            self._logs.sent(pursuer, *values)
        elif word == "outcomes":
            self._logs.arrived(*values)
        elif word == "events":
            self._logs.lines += values[0]
        elif word == "ping":
            connection.writer.write(json.dumps(["pong", monotonic_ns()]).encode() + b"\n")
        elif word == "ready":
            self._ready.add(pursuer)
            asyncio.get_running_loop().create_task(self._notify())
        elif word == "error":
            self._errors.append(f"pursuer {pursuer}: {' '.join([values[0], *values[1]])}")
        elif word == "done":
            counts, drops, connection.latenesses, connection.errors = values
            self._logs.transports += [] if counts is None else [TransportCounts(*counts)]
            self.conduct.drops[pursuer] = Drops(*drops)
            connection.is_done = True

    async def _notify(self) -> None:
        async with self._changed:
            self._changed.notify_all()

    async def _lose(self, pursuer: int) -> None:
        """Note that the process of a pursuer has closed its connection."""
        connection = self._joined[pursuer]
        if not (connection.is_done and not self._errors) and not self._is_over:
            await asyncio.sleep(0.05)  # so that the nursery can tell how it ended
            self._gone.append((pursuer, _ending(self._statuses.get(pursuer))))
            self._wake()
        connection.is_done = True
        await self._notify()

    def _wake(self) -> None:
        if self._clock is not None:
            self._clock.wake()

    async def _until(self, holds: Callable[[], bool], limit: float, what: str) -> None:
        """Wait until a condition about all pursuers holds.

        Raises:
            LiveError: if it does not within a limit, s, or a process has ended.
        """
        try:
            async with asyncio.timeout(limit), self._changed:
                await self._changed.wait_for(lambda: holds() or bool(self._statuses) or bool(self._errors))
        except TimeoutError:
            missing = sorted(set(range(len(self._hosts))) - (self._ready or self._joined.keys()))
            raise LiveError(f"pursuer {', '.join(map(str, missing))} {what} within {limit:g} s") from None
        if not holds():
            ends = [f"pursuer {pursuer} {_ending(status)}" for pursuer, status in self._statuses.items()]
            raise LiveError("; ".join(self._errors or ends))

    async def _watch(self, nursery: asyncio.subprocess.Process) -> None:
        """Note how the processes end."""
        assert nursery.stdout is not None
        while line := await nursery.stdout.readline():
            pursuer, status = map(int, line.split())
            self._statuses[pursuer] = status
            await self._notify()

    async def _finish(self, world: list[Event]) -> LiveResult:
        """Wait for the reports of the pursuers, and merge all events."""
        with suppress(TimeoutError):
            async with asyncio.timeout(LINGER), self._changed:
                await self._changed.wait_for(lambda: all(joined.is_done for joined in self._joined.values()))
        if self._errors:
            raise LiveError("; ".join(self._errors))
        self._is_over = True
        conduct = self.conduct
        assert self._clock is not None
        errors: list[int] = []
        for pursuer, connection in sorted(self._joined.items()):
            conduct.lateness[pursuer] = Lateness.of(connection.latenesses)
            errors += connection.errors
        conduct.lateness["referee"] = late = Lateness.of(self._clock.lateness)
        conduct.delivery_error = Lateness.of(errors)
        if late.worst > 1.0:
            conduct.notes.append(f"the referee stalled for {late.worst:.1f} s")
        trace = Trace()
        trace.events = self._logs.merged(world, self._scenario.record.messages is True)
        return LiveResult(self._scenario, self._seed, trace, conduct)


def everybody_in_order(joined: dict[int, _Connection]) -> list[_Connection]:
    """Return the pursuers in order."""
    return [joined[pursuer] for pursuer in sorted(joined)]


def _ending(status: int | None) -> str:
    """Return how a process ended as text."""
    if status is None:
        return "was lost"
    if status < 0:
        return f"was ended by {Signals(-status).name}"
    return f"ended with exit code {status}"


def _tasks(scenario: Scenario, starts: list[Start]) -> tuple[Scenario, list[Start]]:
    return scenario, starts


async def _start_nursery(scenario: Scenario, starts: list[Start]) -> asyncio.subprocess.Process:
    """Start the processes of the pursuers."""
    nursery = await asyncio.create_subprocess_exec(
        sys.executable,
        *("-m", "desim.live.nursery"),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    task = pickle.dumps((sys.path, packed(partial(_tasks, scenario, starts))))
    assert nursery.stdin is not None
    nursery.stdin.write(len(task).to_bytes(8, "big") + task)
    await nursery.stdin.drain()
    return nursery


