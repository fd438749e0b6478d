"""The wiring of a run: its network and its agents, for a simulation and for each live node."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from desim.config.arrays import Floats, Integers
from desim.kernel.core.clock import Clock, NodeClock
from desim.kernel.core.events import Trace
from desim.kernel.core.positions import Nodes, PositionSource
from desim.kernel.core.units import nanoseconds
from desim.kernel.link_layer.link_layer import LinkLayer
from desim.kernel.models.fault_plans import draw_faults
from desim.kernel.models.faults import Fault
from desim.kernel.network import Network
from desim.kernel.state.fault_state import FaultState
from desim.kernel.wandering_clock import node_clocks
from desim.pursuit.byzantine.evidence import Witness
from desim.pursuit.core.state import coordinates
from desim.pursuit.sensing.views import GlobalState, View
from desim.pursuit.sensing.world_state import WorldState
from desim.pursuit.team.agent import Agent, Voice
from desim.pursuit.team.announcements import announced_action
from desim.pursuit.team.judges import Judge
from desim.pursuit.team.trust import judge_of
from desim.scenario.scenario import Scenario


class TeamNetwork(NamedTuple):
    """The network of a team, and the clocks and faults that were drawn for it."""

    network: Network
    clocks: Sequence[NodeClock]
    """(N,) the clocks of the pursuers."""
    faults: list[Fault]
    """The faults of robots, radios and the network, which have yet to be injected."""


def make_network(
    env: Clock,
    scenario: Scenario,
    state: WorldState,
    seed: int,
    trace: Trace | None,
    link_layer: Callable[..., LinkLayer] = LinkLayer,
    *,
    positions: "PursuerPositions | None" = None,
) -> TeamNetwork:
    """Create the network of a team.

    Args:
        env: the clock of the simulation.
        scenario: the experiment.
        state: the true state of the world.
        seed: the seed of the run.
        trace: receives the events of messages; None: they are not recorded.
        link_layer: as in `Network`.
        positions: the positions of the pursuers. None: those of the state, which change at most at the top speed over
            ground.
    """
    faults = draw_faults(scenario.network_faults, state.size, scenario.horizon, seed)
    positions = positions or PursuerPositions(state, scenario.team.top_speed + scenario.environment.top_speed)
    # The clocks of a planner that is not on a robot have no error.
    skews = scenario.network_faults if scenario.protocol_traits.embodied else ()
    clocks = node_clocks(env, skews, state.size, seed, nanoseconds(scenario.horizon))
    network = Network(
        env,
        scenario.network.make_graph(state.size),
        scenario.network,
        seed=seed,
        positions=positions,
        trace=trace,
        fault_state=FaultState(positions) if faults else None,
        predicate=announced_action,
        clocks=clocks,
        walls=scenario.wall,
        link_layer=link_layer,
    )
    return TeamNetwork(network, clocks, faults)


def make_agents(
    env: Clock,
    scenario: Scenario,
    seed: int,
    team: TeamNetwork,
    views: Sequence[View],
    global_state: GlobalState,
    trace: Trace,
    voice: Voice | None = None,
) -> tuple[list[Agent], list[Judge | None]]:
    """Create the agents of all pursuers, and their judges.

    If `announce.start` is "known", all agents know the initial actions.

    Args:
        env: the clock of the simulation.
        scenario: the experiment.
        seed: the seed of the run.
        team: the network.
        views: (N,) the view of each pursuer.
        global_state: the true state of the world, through which the agents act.
        trace: receives the events of the judges.
        voice: sends the messages; None: the network.
    """
    network, step, announce = team.network, nanoseconds(scenario.motion.step), scenario.announce
    agents, judges = [], []
    for pursuer, (view, clock) in enumerate(zip(views, team.clocks, strict=True)):
        witness = Witness(pursuer, view, clock, network, voice or network, step, trace)
        judge = judge_of(announce.trust, witness)
        judges.append(judge)
        agents.append(Agent(pursuer, env, view, global_state, network, seed, announce, clock, voice or network, judge))
    if announce.start == "known":
        for agent, clock in zip(agents, team.clocks, strict=True):
            network.set_initial_belief(agent.id, agent.announcement(), clock.stamp)
    return agents, judges


class PursuerPositions(PositionSource):
    """The positions of the pursuers for the network; see `desim.kernel.core.positions.PositionSource`."""

    looks_back = True

    def __init__(self, state: WorldState, top_speed: float):
        self._state = state
        self.max_speed = 0.0 if state.static else top_speed

    def __call__(self) -> Floats:
        """Return the (N, 2) positions now, m."""
        return coordinates(self._state.positions())

    def of(self, nodes: Nodes) -> Floats:
        """Return the (k, 2) positions of some pursuers now, m."""
        return coordinates(self._state.players.positions_of(nodes))

    def distance(self, node: int, other: int) -> float:
        """Return the present distance between two pursuers, m.

        Kept equal to that between their positions by
        `tests/simulation/test_world.py::test_the_distance_of_two_pursuers_is_that_between_their_positions`.
        """
        return self._state.players.distances(node, [other])[0]

    def at(self, nodes: Nodes, times: int | Integers) -> Floats:
        """Return the (k, 2) positions of some pursuers, m, at times of the present piece, ns."""
        return coordinates(self._state.players.positions_at(nodes, times))

    def before_change(self, act: Callable[[], object]) -> None:
        """Register a function to call before the motion of a player changes."""
        self._state.players.before_change(act)
