"""A run: the wiring of clock, world, network and agents, as a function of a scenario and a seed."""

from dataclasses import dataclass

import networkx as nx

from desim.kernel.clock import Clock
from desim.kernel.events import Trace, Watcher
from desim.kernel.network import Network
from desim.pursuit.agent import Agent, Assignment, Behaviour, Process
from desim.pursuit.state import coordinates
from desim.scenario import Scenario
from desim.world import World


@dataclass(frozen=True)
class Result:
    """What a run left behind: its scenario, its seed, and everything that happened."""

    scenario: Scenario
    seed: int
    trace: Trace


def run(scenario: Scenario, seed: int | None = None, *watchers: Watcher) -> Result:
    """Simulate a scenario once; equal arguments give equal traces.

    Args:
        scenario: what to simulate.
        seed: of every random stream; that of the scenario if None.
        watchers: are shown each event as it happens; one that returns True ends the run.
    """
    seed = scenario.seed if seed is None else seed
    env = Clock()
    trace = Trace(watchers, messages=scenario.record.messages, stop=lambda: world.stop())
    world = World(env, scenario, seed, trace)
    graph = nx.complete_graph(world.size)
    network = Network(
        env, graph, scenario.network, seed=seed, positions=lambda: coordinates(world.state().pursuers), trace=trace
    )
    for pursuer, active in enumerate(world.profile()):
        network.presume(pursuer, Assignment(active))
    _populate([Agent(pursuer, env, world, network, seed) for pursuer in range(world.size)], scenario.protocol, env)
    world.begin()
    env.run(until=world.over)
    world.sample()
    trace.append(network.tally())
    assert world.end is not None
    trace.append(world.end)
    return Result(scenario, seed, trace)


def _populate(agents: list[Agent], protocol: Behaviour, env: Clock) -> None:
    """Make a process of every agent."""
    for agent in agents:
        env.process(_start(agent, protocol))


def _start(agent: Agent, protocol: Behaviour) -> Process:
    """Run a protocol from time 0 on, in the order of ids whatever the order in which processes were made."""
    yield agent.at(0.0)
    yield from protocol(agent)
