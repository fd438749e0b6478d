"""The referee of a live run: it moves the players, sends the state of the world to the pursuers, and ends the run."""

from collections.abc import Callable, Generator, Sequence
from functools import partial
from time import monotonic_ns, process_time
from typing import Any

from desim.config.fresh import fresh_copy
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import Event, Trace, TransportCounts
from desim.kernel.core.seeds import seed_of
from desim.kernel.core.units import nanoseconds, seconds
from desim.kernel.fault_injection import inject
from desim.kernel.models.faults import Crash
from desim.kernel.models.traced_faults import FaultStarted
from desim.live.frames import frame_of
from desim.live.link import Drops
from desim.live.lobby import LOCAL, LiveError, Lobby
from desim.live.merge import Logs
from desim.live.nursery import Nursery
from desim.live.refusals import check_live
from desim.live.result import REFEREE, Conduct, LiveResult
from desim.live.wall_clock import WallClock
from desim.live.wire import Wire
from desim.pursuit.core.events import BrokeDown, Captured, Ended
from desim.pursuit.sensing.views import View
from desim.scenario.scenario import Scenario
from desim.simulation.run_end import RunEnd
from desim.simulation.team_processes import TeamProcesses
from desim.simulation.wiring import make_network
from desim.simulation.world import World, initial_state

FRAME = 50_000_000
"""Time between two frames, ns, or a motion step if that is longer; each change of an action has a frame of its own."""
LEAD = 0.05
"""Time between the last pursuer that joins and the start of the run, s."""
LINGER = 2.0
"""Time in which the pursuers should have reported at the end, s."""
STALL = 0.5
"""Lateness of a timer of the referee, s, above which a note of the result says that the referee stalled."""


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
        tell: Callable[[str], object] = print,
    ):
        check_live(scenario)
        size = scenario.team.count
        self._scenario, self._seed = scenario, scenario.seed if seed is None else seed_of(seed)
        self._namespaces, self._draws, self._tell = namespaces or [""] * size, draws, tell
        self._conduct = Conduct()
        self._logs = Logs(Wire.of(scenario))
        self._lobby = Lobby(scenario, hosts or [LOCAL] * size, self._hear, self._lose)
        self._obeyed = [0] * size
        self._clock: WallClock | None = None

    async def play(self, nursery: Nursery) -> LiveResult:
        """Run the scenario, and return the result.

        Args:
            nursery: starts the processes of this machine.

        Raises:
            LiveError: if a process does not join, or a protocol raises an exception.
        """
        lobby = self._lobby
        with fresh_copy(self._scenario) as scenario:
            self._prepare(scenario)
            try:
                await lobby.gather(nursery, self._seed, self._namespaces, draws=self._draws, tell=self._tell)
                begin, cpu_before = monotonic_ns() + nanoseconds(LEAD), process_time()
                lobby.tell_all("begin", begin)
                self._clock = WallClock(self._env, self._end.over, lambda: monotonic_ns() - begin)
                await self._clock.ended
                missing = await self._last_reports()
                self._conduct.cpu[REFEREE] = process_time() - cpu_before
                return self._result(self._clock, missing)
            finally:
                lobby.close()

    # The run.

    def _prepare(self, scenario: Scenario) -> None:
        """Create the world, and plan the faults: those of robots happen here, those of radios also at the pursuers."""
        self._env = env = Clock()
        self._end, self._trace = end, trace = RunEnd(env), Trace([self._watch])
        self._state = state = initial_state(env, scenario, self._seed)
        self._world = world = World(env, scenario, state, [View(state, scenario.prune)] * state.size, trace, end)
        network, _, faults = make_network(env, scenario, state, self._seed, None)
        self._team = team = TeamProcesses(env, scenario, world, {}, [], None, None)
        inject(faults, env, network, trace, crashed=team.crashed, recovered=team.recovered)
        world.begin()
        env.process(self._frames(max(FRAME, nanoseconds(scenario.motion.step))))

    def _frames(self, period: int) -> Generator[Any, Any, None]:
        """Send a frame each period (ns)."""
        for when in range(0, self._state.horizon + period, period):
            yield Instant(self._env, when, Phase.SAMPLE + 1)
            self._send_frame()

    def _send_frame(self, _: object = None) -> None:
        """Send a frame."""
        self._lobby.tell_all("frame", *frame_of(self._state, self._obeyed), may_skip=True)

    def _send_frame_soon(self) -> None:
        """Send a frame after all other events of this instant."""
        Instant(self._env, self._env.now, Phase.SAMPLE + 1).callbacks.append(self._send_frame)

    def _watch(self, event: Event) -> None:
        """Send a frame after an event that pursuers cannot foresee."""
        if isinstance(event, Captured | BrokeDown):
            self._send_frame_soon()

    def _obey(self, pursuer: int, decided: int, action: int) -> None:
        """Let a pursuer act as its protocol decided at the time `decided`, ns."""
        self._obeyed[pursuer] += 1
        old_action = self._state.profile[pursuer]
        self._world.set_action(pursuer, action)
        if self._state.profile[pursuer] != old_action:
            self._conduct.orders.append(max(self._env.now - decided, 0))
            self._send_frame_soon()

    def _crash(self, pursuer: int, how: str) -> None:
        """Take down a pursuer whose process was lost; end the run if a protocol has raised an exception."""
        if self._lobby.errors:
            self._end.finish("stopped")
            return
        now = self._env.now
        crash = Crash(start=seconds(now), node=pursuer)
        self._logs.crashed[pursuer] = now
        self._trace.append(FaultStarted(now, crash))
        self._team.crashed(crash)  # a scheduled crash that ends later does not bring it up again
        self._conduct.ends[pursuer] = how
        self._tell(f"pursuer {pursuer} {how} at {seconds(now):.2f} s")

    # The pursuers.

    def _hear(self, pursuer: int, word: str, *values: Any) -> None:
        """Process a line of a pursuer."""
        if word == "order":
            self._meet(partial(self._obey, pursuer, *values))
        elif word == "report":
            self._logs.take(pursuer, *values)
        elif word == "done":
            counts, drops, lateness, errors, self._conduct.cpu[pursuer] = values
            self._logs.transports += [] if counts is None else [TransportCounts(*counts)]
            self._conduct.drops[pursuer] = Drops(*drops)
            self._conduct.note(pursuer, lateness, errors)

    def _lose(self, pursuer: int, how: str) -> None:
        self._meet(partial(self._crash, pursuer, how))

    def _meet(self, act: Callable[[], object]) -> None:
        if self._clock is not None:
            self._clock.meet(act)

    async def _last_reports(self) -> list[int]:
        """Tell that the run is over, and wait for the reports of the pursuers; return those that have not reported."""
        self._world.sample()
        self._lobby.tell_all("over", self._ended.t)
        missing = await self._lobby.reports(LINGER)
        if self._lobby.errors:
            raise LiveError(self._lobby.errors[0])
        return missing

    @property
    def _ended(self) -> Ended:
        assert self._end.outcome is not None
        return self._end.outcome

    def _result(self, clock: WallClock, missing: list[int]) -> LiveResult:
        """Return the result: the events of all processes, merged, and how the run went."""
        conduct = self._conduct
        conduct.notes += [f"pursuer {pursuer} has not reported within {LINGER:g} s of the end" for pursuer in missing]
        conduct.lateness = dict(sorted(conduct.lateness.items()))
        conduct.note(REFEREE, clock.lateness, [])
        late = conduct.lateness[REFEREE]
        if late.worst > STALL:
            conduct.notes.append(f"the referee stalled for {late.worst:.1f} s")
        trace = Trace()
        trace.events = self._logs.merged([*self._trace, self._ended], messages=self._scenario.record.messages is True)
        return LiveResult(self._scenario, self._seed, trace, conduct)
