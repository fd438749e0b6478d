"""The processes of the pursuers of a run: protocol, dissemination, heartbeats and reports."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from typing import TYPE_CHECKING, Protocol

from desim.kernel.core.clock import Clock, Phase
from desim.kernel.models.faults import Crash
from desim.kernel.models.medium import contends
from desim.pursuit.byzantine.lying import PORT as FORGED
from desim.pursuit.byzantine.lying import LyingTeam
from desim.pursuit.sensing.noisy_sensing import Sensor
from desim.pursuit.team.agent import Agent, merge_relayed, repeat
from desim.pursuit.team.judges import Judge
from desim.scenario.scenario import Scenario
from desim.simulation.restartable import RestartableProcess

if TYPE_CHECKING:
    import simpy


class Crashing(Protocol):
    """An object that takes pursuers down and up; see `desim.simulation.world.World`."""

    def crash(self, pursuer: int) -> None:
        """Take a pursuer down."""
        ...

    def recover(self, pursuer: int) -> None:
        """Bring a pursuer up again."""
        ...


class TeamProcesses:
    """The agents of a run and their processes.

    Args:
        env: the clock of the simulation.
        scenario: the experiment.
        world: takes pursuers down and up.
        agents: the agents whose processes run here, by pursuer: all of a simulation, one of a live node.
        judges: by pursuer, the judge of the announcements that it receives; None: it believes all.
        sensor: the sensors of a team with limited sensing; None for any other team.
        liars: the lies of the team; None: all are honest.

    Attributes:
        processes: the dissemination and the protocol of each pursuer.
    """

    def __init__(
        self,
        env: Clock,
        scenario: Scenario,
        world: Crashing,
        agents: Mapping[int, Agent],
        judges: Sequence[Judge | None],
        sensor: Sensor | None,
        liars: LyingTeam | None,
    ):
        self._env, self._scenario, self._world = env, scenario, world
        self._agents, self._judges, self._sensor, self._liars = agents, judges, sensor, liars
        self._embodied = scenario.protocol_traits.embodied
        self.processes: dict[int, tuple[RestartableProcess, RestartableProcess]] = {}
        self._open_crashes: dict[int, list[Crash]] = defaultdict(list)
        self._recoveries: dict[int, simpy.Event] = {}
        self._memory_lost: set[int] = set()

    def begin(self) -> None:
        """Start all processes."""
        env, announce, protocol = self._env, self._scenario.announce, self._scenario.protocol
        announces = self._scenario.announces
        for pursuer, agent in self._agents.items():
            if announces and announce.start == "announced":
                # In the relay phase: without latency, the announcement travels all hops before the first decision.
                agent.after(self._start_delay(agent), agent.broadcast, Phase.RELAY)
            relay = RestartableProcess(env, agent, announce.dissemination, Phase.RELAY)
            self.processes[pursuer] = relay, RestartableProcess(env, agent, protocol, Phase.DECISION)
            if announces and announce.has_heartbeats:
                env.process(repeat(agent, agent.broadcast, announce.heartbeat, "heartbeat", announce.jitter))
            if self._sensor is not None:
                view, period = self._sensor.views[pursuer], self._sensor.sensing.period
                report = view.report if self._liars is None else self._liars.unless_silent(pursuer, view.report)
                env.process(repeat(agent, report, period, "sightings"))
            if self._liars is not None:
                env.process(merge_relayed(agent, FORGED))
            judge, interval = self._judges[pursuer], announce.trust.period
            if judge is not None and interval is not None:
                accuse = judge.report if self._liars is None else self._liars.accusing(pursuer, judge.report)
                env.process(repeat(agent, accuse, interval, "accusations"))

    @contextmanager
    def closing(self) -> Iterator[None]:
        """Close all processes at the end of the block, in the order of the pursuers.

        What protocols do in `finally`, or at the end of a `with` block, then belongs to this run. Otherwise Python
        would do it whenever it frees the generators, perhaps during another run. The first of several errors counts.
        """
        first_error: BaseException | None = None
        try:
            yield
        except BaseException as error:
            first_error = error
        for process in chain.from_iterable(self.processes.values()):
            try:
                process.close()
            except (Exception, SystemExit) as error:
                first_error = first_error or error
        try:
            if first_error is not None:
                raise first_error
        finally:
            del first_error  # its traceback refers to this frame

    def _start_delay(self, agent: Agent) -> float:
        """Return the time, s, after which a pursuer announces its first action.

        It is 0, or random where nodes contend for a channel and announcements have some jitter.
        """
        medium, announce = self._scenario.network.medium, self._scenario.announce
        if not announce.jitter or not contends(medium):
            return 0.0
        return agent.stream("first announcement").uniform(0.0, announce.jitter * announce.heartbeat)

    def crashed(self, crash: Crash) -> None:
        """Take a pursuer down and suspend the processes on its robot, unless only its radio crashes."""
        if crash.scope == "robot":
            self._open_crashes[crash.node].append(crash)
            if len(self._open_crashes[crash.node]) == 1:
                self._world.crash(crash.node)
                self._recoveries[crash.node] = self._env.event()
                # A protocol that is not embodied does not run on the robot, and goes on.
                for process in self.processes.get(crash.node, ())[: 2 if self._embodied else 1]:
                    if process.is_alive:
                        process.interrupt(self._recoveries[crash.node])

    def recovered(self, crash: Crash) -> None:
        """End a crash: resume the pursuer unless another crash of its robot lasts, and clear the lost memory."""
        node, remembers = crash.node, True
        if crash.scope == "robot":
            self._open_crashes[node].remove(crash)
            if not crash.memory:
                self._memory_lost.add(node)
            if not self._open_crashes[node]:
                remembers = node not in self._memory_lost
                self._memory_lost.discard(node)
                self._world.recover(node)
                self._recoveries[node].succeed(remembers)
        if node in self._agents:
            self._agents[node].recovered(restarted=not remembers)
        if self._sensor is not None and not (remembers and crash.memory):
            self._sensor.views[node].forget(heard_only=remembers)
