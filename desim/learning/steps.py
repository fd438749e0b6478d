"""The steps of an episode, from one turn to the next, of which rewards are functions."""

from collections.abc import Mapping, Sequence
from math import inf

from desim.kernel.core.units import seconds
from desim.learning.rewards import Step
from desim.pursuit.sensing.world_state import WorldState
from desim.simulation.run import Simulation


def step_begun(simulation: Simulation, horizon: float, actions: Mapping[int, int], *, of_all: bool) -> Step:
    """Return a step that begins now; until it has ended, its end is its start, and `captured` has who is at large.

    Args:
        simulation: the run.
        horizon: the latest end of the episode, s.
        actions: the actions that are taken now, by pursuer; one that is not among its options has the effect of 0.
        of_all: whether the capture times are those of all pursuers, or only of those that chase the evader.
    """
    world, agents = simulation.state, simulation.agents
    profile = world.profile.copy()
    for i, action in actions.items():
        profile[i] = action if action in agents[i].options() else 0
    times = all_times(world) if of_all else chasers_times(world, profile)
    start = seconds(world.now)
    left, at_large = world.time_left(world.now), tuple(world.at_large)
    return Step(start, start, tuple(profile), times, left, horizon, at_large, False)


def step_ended(step: Step, world: WorldState, *, is_last: bool) -> Step:
    """Return a step that has begun and ends now, given whether the episode ends with it."""
    at_large = step.captured
    captured = () if len(at_large) == len(world.at_large) else tuple(sorted(set(at_large) - set(world.at_large)))
    return step._replace(end=seconds(world.now), captured=captured, is_last=is_last)


def all_times(world: WorldState) -> tuple[tuple[float, ...], ...]:
    """Return the (M, N) capture times now, s."""
    return tuple(body.capture_times(world.now) for body in world.bodies)


def chasers_times(world: WorldState, profile: Sequence[int]) -> tuple[tuple[float, ...], ...]:
    """Return the (M, N) capture times now, s, of those that chase the evader under a profile; inf for the others.

    The utilities of the game depend on no others, and those of few are computed sooner.
    """
    rows = []
    for body in world.bodies:
        chasing = [i for i, action in enumerate(profile) if action == body.number]
        times = [inf] * len(profile)
        for i, time in zip(chasing, body.capture_times_of(chasing, world.now) if chasing else (), strict=True):
            times[i] = time
        rows.append(tuple(times))
    return tuple(rows)
