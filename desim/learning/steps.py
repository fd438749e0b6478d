"""The steps of an episode, from one turn to the next, of which rewards are functions."""

from collections.abc import Sequence
from typing import NamedTuple

from desim.kernel.core.units import seconds
from desim.learning.rewards import Step
from desim.pursuit.sensing.world_state import WorldState


class StepStart(NamedTuple):
    """The start of a step, of which the end is still open."""

    now: int
    """ns"""
    capture_times: tuple[tuple[float, ...], ...]
    """(M, N) s; see `Step`."""
    at_large: Sequence[int]
    """The evaders that are not captured."""


def step_begun(world: WorldState, last: StepStart | None) -> StepStart:
    """Return the start of a step that begins now, which is that of the last step if it began at this instant, too."""
    if last is not None and last.now == world.now and last.at_large is world.at_large:
        return last
    times = tuple(body.capture_times(world.now) for body in world.bodies)
    return StepStart(world.now, times, world.at_large)


def step_ended(start: StepStart, profile: Sequence[int], world: WorldState, horizon: float, *, is_last: bool) -> Step:
    """Return a step that ends now.

    Args:
        start: its start.
        profile: (N,) the action of each pursuer after the decision at the start.
        world: the true state of the world.
        horizon: the latest end of the episode, s.
        is_last: whether the episode ends with the step.
    """
    now, times, before = start
    captured = tuple(sorted(set(before) - set(world.at_large))) if before is not world.at_large else ()
    left = world.time_left(now)
    return Step(seconds(now), seconds(world.now), tuple(profile), times, left, horizon, captured, is_last)
