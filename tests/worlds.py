"""Worlds without agents or a network, to look at the physics alone."""

from types import SimpleNamespace

from desim.kernel.core.clock import Clock
from desim.kernel.core.events import Trace
from desim.pursuit.sensing.views import GlobalState, View
from desim.simulation.run_end import RunEnd
from desim.simulation.world import World, initial_state


def world_of(scenario, seed=0, sensor_of=None):
    """Return the parts of a world: env, state, world, end, and view, the true state.

    Args:
        scenario: the experiment.
        seed: of its random streams.
        sensor_of: returns the sensors of the team, given env and state; None for unlimited sensing.
    """
    env = Clock()
    state, end = initial_state(env, scenario, seed), RunEnd(env)
    sensor = None if sensor_of is None else sensor_of(env, state)
    views = [View(state, scenario.prune)] * state.size if sensor is None else sensor.views
    world = World(env, scenario, state, views, Trace(), end, sensor)
    view = GlobalState(state, scenario.prune, world.set_action)
    return SimpleNamespace(env=env, state=state, world=world, end=end, view=view)
