"""The steps of an episode, from one turn to the next, of which rewards are functions."""

from collections.abc import Collection, Mapping, Sequence
from math import inf
from typing import NamedTuple

from desim.kernel.core.units import seconds
from desim.learning.rewards import Step
from desim.pursuit.sensing.world_state import WorldState
from desim.simulation.run import Simulation


class StepStart(NamedTuple):
    """The start of a step, of which the end is still open."""

    now: int
    """ns"""
    profile: Sequence[int]
    """(N,) the action of each pursuer after the decision."""
    capture_times: tuple[tuple[float, ...], ...]
    """(M, N) s; see `Step`."""
    at_large: Sequence[int]
    """The evaders that are not captured."""


def step_begun(
    simulation: Simulation, actions: Mapping[int, int], last: StepStart | None, *, of_all: bool, may_keep: bool
) -> StepStart:
    """Return the start of a step that begins now.

    Args:
        simulation: the run.
        actions: the actions that are taken now, by pursuer; one that is not among its options has the effect of 0.
        last: the start of the step before; where many take their turns at one instant, it is mostly the same.
        of_all: whether the capture times are those of all pursuers, or only of those that chase the evader, if any do.
        may_keep: whether some pursuers may not be asked now; capture times are then those of the present chasers, too.
    """
    world, agents = simulation.state, simulation.agents
    profile = world.profile  # it is replaced as actions change, and never changed itself
    for i, action in actions.items():
        taken = action if action and action in agents[i].options() else 0
        if taken != profile[i]:
            profile = [*profile[:i], taken, *profile[i + 1 :]]
    now, at_large = world.now, world.at_large
    if last is not None and last.now == now and last.profile == profile and last.at_large is at_large:
        return last
    if of_all:
        times = all_times(world)
    else:
        kept = world.profile if may_keep and profile != world.profile else ()
        times = chasers_times(world, profile, kept) if any(profile) or any(kept) else ()
    return StepStart(now, profile, times, at_large)


def without_unasked(start: StepStart, asked: Collection[int], before: Sequence[int]) -> StepStart:
    """Return the start of a step in which the pursuers that were not asked keep the actions that they had before."""
    profile = [action if i in asked else before[i] for i, action in enumerate(start.profile)]
    return start if profile == start.profile else start._replace(profile=profile)


def step_ended(start: StepStart, world: WorldState, horizon: float, *, is_last: bool) -> Step:
    """Return a step that ends now.

    Args:
        start: its start.
        world: the true state of the world.
        horizon: the latest end of the episode, s.
        is_last: whether the episode ends with the step.
    """
    now, profile, times, before = start
    captured = tuple(sorted(set(before) - set(world.at_large))) if before is not world.at_large else ()
    left = world.time_left(now)
    return Step(seconds(now), seconds(world.now), tuple(profile), times, left, horizon, captured, is_last)


def all_times(world: WorldState) -> tuple[tuple[float, ...], ...]:
    """Return the (M, N) capture times now, s."""
    return tuple(body.capture_times(world.now) for body in world.bodies)


def chasers_times(
    world: WorldState, profile: Sequence[int], other: Sequence[int] = ()
) -> tuple[tuple[float, ...], ...]:
    """Return the (M, N) capture times now, s, of those that chase the evader under a profile; inf for the others.

    The utilities of the game depend on no others, and those of few are computed sooner. With another profile, those of
    its chasers are there, too.
    """
    rows = []
    for body in world.bodies:
        times = [inf] * len(profile)
        if body.number in profile or body.number in other:
            chasing = [i for i, action in enumerate(profile) if action == body.number]
            chasing += [i for i, action in enumerate(other) if action == body.number and profile[i] != action]
            for i, time in zip(chasing, body.capture_times_of(chasing, world.now), strict=True):
                times[i] = time
        rows.append(tuple(times))
    return tuple(rows)
