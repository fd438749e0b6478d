"""A run: the wiring of clock, world, network and agents, as a function of a scenario and a seed."""

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from desim.config.arguments import HintedAttributes, naming_arguments, scenario_argument, value_text
from desim.config.escaping import escaped
from desim.config.fresh import fresh_copy
from desim.config.html import html_properties, picture_of
from desim.kernel.clock_sync import Synchroniser, TwoWay
from desim.kernel.core.clock import Clock, NodeClock
from desim.kernel.core.events import Event, Trace, Watcher
from desim.kernel.core.seeds import seed_of
from desim.kernel.core.units import seconds, time_text
from desim.kernel.fault_injection import inject
from desim.kernel.network import Network
from desim.pursuit.byzantine.lies import draw_lies
from desim.pursuit.byzantine.lying import LyingTeam
from desim.pursuit.core.events import Captured, Ended
from desim.pursuit.sensing.noisy_sensing import NoisySensor, Sensor
from desim.pursuit.sensing.sensing import TeamSensor
from desim.pursuit.sensing.views import GlobalState, View
from desim.pursuit.sensing.world_state import WorldState
from desim.scenario.scenario import Scenario
from desim.simulation.run_end import RunEnd
from desim.simulation.team_processes import TeamProcesses
from desim.simulation.watchdog import TimedOut, interrupted_at, stuck
from desim.simulation.wiring import make_agents, make_network
from desim.simulation.world import World, initial_state

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from desim.pursuit.team.agent import Agent


ON_RESULTS = frozenset({"export", "plot", "replay", "save", "show", "summary", "write"})
"""Methods that users look for in a result; there are functions for them, which take the result."""


@dataclass(frozen=True, repr=False)
class Result(HintedAttributes):
    """The result of a run: its scenario, its seed and the trace of its events."""

    scenario: Scenario
    seed: int
    trace: Trace

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {escaped(self.scenario.name)}, seed {self.seed}: {self._outcome}>"

    def _repr_html_(self) -> str:
        """Return a table for notebooks: scenario, seed, protocol, outcome and number of events.

        A picture of the trajectories follows if positions were recorded and matplotlib (the extra `plot`) is installed.
        """
        rows = {
            "scenario": self.scenario.name,
            "seed": str(self.seed),
            "protocol": self.scenario.protocol_name,
            "ended": self._outcome,
            "events": f"{len(self.trace):,}",
        }
        return html_properties(rows) + picture_of("run", self)

    def _instead_of(self, name: str) -> str:
        """Return what to write instead of an attribute that a result does not have."""
        metric = name if name.isidentifier() and name not in ON_RESULTS else "active_time"
        return (
            f"it has scenario, seed and trace; functions take it, such as summary(result).{metric}, plot(result),"
            " replay(result) and export(result, 'events.csv')"
        )

    @property
    def _outcome(self) -> str:
        """The outcome of the run as text."""
        ends = self.trace.of(Ended)
        return outcome_of(ends[-1], len(self.trace.of(Captured)), len(self.scenario.evaders)) if ends else "not yet"


def outcome_of(end: Ended, captures: int, evaders: int) -> str:
    """Return the outcome of a run as text: how it ended and, if there are several evaders, the number of captures."""
    captured = f"captured {captures} of {evaders}" if evaders > 1 else ""
    if end.reason == "captured":
        how = f"{captured}, the last by" if captured else "captured by"
        return f"{how} {end.capturer} after {time_text(end.t)} s"
    if end.reason == "horizon":
        return f"{captured or 'not captured'} within {seconds(end.t):g} s"
    return f"{captured}, stopped after {time_text(end.t)} s".removeprefix(", ")


@naming_arguments
def run(scenario: Scenario, seed: int | None = None, *watchers: Watcher) -> Result:
    """Simulate a scenario once; equal arguments give equal traces.

    Use it for a single run whose trace you need, and `desim.sweep` for many runs over seeds and a grid of keys. Metrics
    are functions of the result (`desim.summary`).

    Args:
        scenario: the experiment.
        seed: seed of every random stream; if None, the seed of the scenario.
        watchers: called with each event as it happens; one that returns True ends the run.

    Raises:
        TypeError: if `scenario` is something else; the message says what to write instead.
        ValueError: if the seed is negative or not an integer.
        TimedOut: if the caller set a time limit (`desim.simulation.watchdog.within`) and it is exceeded; the text lists
            what each process is waiting for.
        RuntimeError: if code of the scenario calls `sys.exit`, which would otherwise look like success.
    """
    scenario_argument(Scenario).check(scenario, "run")
    return run_observed(scenario, scenario.seed if seed is None else seed_of(seed), watchers, lambda _: None)


class Simulation(NamedTuple):
    """The parts of a run that a caller may look at while the run lasts."""

    agents: "Sequence[Agent]"
    """(N,) the agents of the pursuers."""
    state: WorldState
    """The true state of the world."""
    trace: Trace
    """The events so far."""
    counts: "Callable[[], list[Event]]"
    """Returns the counts of messages up to now; the trace of a finished run has these events."""
    stop: "Callable[[], object]"
    """Ends the run after all other events of this instant."""


def run_observed(
    scenario: Scenario, seed: int, watchers: "Sequence[Watcher]", begins: "Callable[[Simulation], object]"
) -> Result:
    """Simulate a scenario once, as `run`.

    Args:
        scenario: the experiment.
        seed: seed of every random stream.
        watchers: called with each event as it happens; one that returns True ends the run.
        begins: called once with the parts of the run, before its first event.
    """
    env = Clock()
    end = RunEnd(env)
    trace = Trace(watchers, messages=scenario.record.messages is True, stop=end.stop)
    try:
        with fresh_copy(scenario, is_run=True) as fresh:
            _simulate(fresh, seed, env, end, trace, begins)
    finally:
        trace.close()
    return Result(scenario, seed, trace)


def _simulate(
    scenario: Scenario,
    seed: int,
    env: Clock,
    end: RunEnd,
    trace: Trace,
    begins: "Callable[[Simulation], object]",
) -> None:
    """Connect the parts of a simulation and let it run to its end; see `run`."""
    state = initial_state(env, scenario, seed)
    team_network = make_network(env, scenario, state, seed, trace)
    network, clocks, faults = team_network
    sensor = _sensor(scenario, state, network, clocks, env, seed)
    views: Sequence[View] = [View(state, scenario.prune)] * state.size if sensor is None else sensor.views
    world = World(env, scenario, state, views, trace, end, sensor)
    if world.eavesdropper is not None:
        network.overhear(world.eavesdropper)
    chasers = partial(_chasers, View(state, scenario.prune))
    lies = draw_lies(scenario.fault, state.size, scenario.horizon, seed)
    liars = None
    if lies:
        liars = LyingTeam(env, network, views, seed, world.set_action, lies, chasers, trace)
    global_state = GlobalState(state, scenario.prune, world.set_action if liars is None else liars.set_action)
    voice = liars or network
    sync = scenario.clocks.sync
    if scenario.protocol_traits.embodied and isinstance(sync, TwoWay):
        Synchroniser(env, network, clocks, sync, seed, trace, voice.send)
    agents, judges = make_agents(env, scenario, seed, team_network, views, global_state, trace, voice)
    team = TeamProcesses(env, scenario, world, dict(enumerate(agents)), judges, sensor, liars)
    inject(faults, env, network, trace, crashed=team.crashed, recovered=team.recovered, targets=chasers)

    def counts() -> "list[Event]":
        transported = network.transport_counts()
        return [*([] if transported is None else [transported]), network.message_counts()]

    begins(Simulation(agents, state, trace, counts, end.stop))
    with _without_exits(), team.closing():
        try:
            team.begin()
            world.begin()
            _run_to_end(env, end, team)
            world.sample()
            for event in counts():
                trace.append(event)
            assert end.outcome is not None
            trace.append(end.outcome)
        finally:
            trace.close()
        events = len(trace)
    del trace.events[events:]  # what a `finally` of a protocol has done after the end


def _run_to_end(env: Clock, end: RunEnd, team: TeamProcesses) -> None:
    """Let the events of a simulation happen up to its end; errors tell what the processes were waiting for."""
    try:
        env.run(until=end.over)
    except TimedOut as error:
        raise stuck(env, error, team.processes) from error
    except KeyboardInterrupt as error:
        error.add_note(interrupted_at(env, error))
        raise


@contextmanager
def _without_exits() -> Iterator[None]:
    """Raise RuntimeError in place of SystemExit, which would look like success."""
    try:
        yield
    except SystemExit as error:
        notes = getattr(error, "__notes__", [])  # a `RestartableProcess` adds them to errors of its behaviour
        who = "the protocol" if notes else "code of the scenario"
        raise RuntimeError(" ".join([f"{who} called exit({value_text(error.code)})", *notes])) from error


def _chasers(truth: View) -> list[int]:
    """Return the pursuers that chase an evader, in the order of their capture times."""
    chasing: defaultdict[int, list[int]] = defaultdict(list)
    for pursuer, evader in enumerate(truth.state.profile):
        if evader:
            chasing[evader].append(pursuer)
    times = [
        (time, pursuer)
        for evader, pursuers in chasing.items()
        for time, pursuer in zip(truth.capture_times_of(pursuers, evader), pursuers, strict=True)
    ]
    return [pursuer for _, pursuer in sorted(times)]


def _sensor(
    scenario: Scenario,
    state: WorldState,
    network: Network,
    clocks: "Sequence[NodeClock]",
    env: Clock,
    seed: int,
) -> Sensor | None:
    """Create the sensors of the team; return None if sensing is perfect or the protocol is omniscient."""
    if scenario.sight_is_perfect or scenario.protocol_traits.omniscient:
        return None
    if scenario.sensing.is_noisy:
        return NoisySensor(scenario.sensing, state, scenario.prune, network, clocks, env, seed)
    return TeamSensor(scenario.sensing, state, scenario.prune, network, clocks)
