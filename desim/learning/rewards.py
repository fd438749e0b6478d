"""Rewards: functions of a step, the time between two turns of an environment.

The utility of a pursuer, or of the team, at the start of the step is multiplied by the duration and divided by the
horizon. Rewards are therefore in seconds, as utilities are, and the rewards of successive steps add up. Their sum over
an episode is the mean utility over the horizon from the first turn on; the time before it belongs to no step, because
no decision changes what happens then.
"""

from collections.abc import Callable, Mapping, Sequence
from math import inf
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from desim.config.answers import wrong_answer
from desim.config.arguments import value_text
from desim.config.arrays import array_of
from desim.config.calls import check_action
from desim.pursuit.game.game import gain, welfare


class Step(NamedTuple):
    """The time between two turns, during which the pursuers keep the actions that they have at its start.

    The first step of an episode begins at the first turn, and the last one ends with the episode.
    A capture or a crash during a step may change actions without a decision; the next step begins with these.
    """

    start: float
    """Time since the start of the episode, s."""
    end: float
    """s; equal to `start` if the next turn is at the same instant."""
    profile: tuple[int, ...]
    """(N,) the action of each pursuer after the decision at the start."""
    capture_times: tuple[tuple[float, ...], ...]
    """(M, N) true capture times at the start, s; inf if an evader is captured."""
    time_left: float
    """The time left r at the start, s."""
    horizon: float
    """The latest end of the episode, s."""
    captured: tuple[int, ...]
    """The evaders that were captured during the step."""
    is_last: bool
    """Whether the episode ends with the step."""

    @property
    def duration(self) -> float:
        """The length of the step, s."""
        return self.end - self.start


Reward = Callable[[Step], float | Sequence[float]]
"""A reward: a number for the whole team, or one for each of the N pursuers."""


def team(step: Step) -> float:
    """Return the global utility of the game at the start of a step, times the share of the step in the horizon, s."""
    utility = welfare(np.transpose(step.capture_times), step.profile, step.time_left) if any(step.profile) else 0.0
    return utility * step.duration / step.horizon


def wonderful_life(step: Step) -> list[float]:
    """Return the (N,) wonderful-life utilities at the start of a step, times the share of the step in the horizon, s.

    The utility of a pursuer is its marginal contribution to the global utility: the potential game of Lee & Bakolas.
    """
    utilities = _wonderful_life(step)
    return [utilities.get(i, 0.0) for i in range(len(step.profile))]


def _wonderful_life(step: Step) -> dict[int, float]:
    """Return the wonderful-life utility of each pursuer that chases; see `wonderful_life`."""
    share = step.duration / step.horizon
    utilities: dict[int, float] = {}
    for evader, times in enumerate(step.capture_times, start=1):
        chasing = [i for i, action in enumerate(step.profile) if action == evader and times[i] < inf]
        phi = [times[i] for i in chasing]
        for k, i in enumerate(chasing):
            utilities[i] = share * gain(phi[k], phi[:k] + phi[k + 1 :], step.time_left)
    return utilities


REWARDS: Mapping[str, Reward] = MappingProxyType({"wonderful_life": wonderful_life, "team": team})
"""The rewards by name."""


def reward_named(reward: Any) -> Reward:
    """Return a reward, given its name or the function.

    Raises:
        ValueError: if there is no such reward.
    """
    if callable(reward):
        check_action(reward, ("step",), "a reward")
        function: Reward = reward
        return function
    if not isinstance(reward, str) or reward not in REWARDS:
        raise ValueError(f"a reward should be {', '.join(REWARDS)} or a function of a step (got {value_text(reward)})")
    return REWARDS[reward]


def rewards_of(reward: Reward, step: Step) -> Mapping[int, float]:
    """Return the rewards of a step by pursuer; a pursuer that is missing gets 0.

    Raises:
        ValueError: if a user's function returns neither a finite number nor one for each pursuer.
    """
    if reward is wonderful_life:  # as a rule few pursuers chase, and the check below takes longer
        return _wonderful_life(step)
    answer: Any = reward(step)
    count = len(step.profile)
    values = array_of(answer)
    is_number = values.dtype.kind in "biuf" and np.isfinite(values).all()
    if not is_number or values.shape not in {(), (count,)}:
        raise wrong_answer(f"a reward should be a finite number, or one for each of {count} pursuers", answer, reward)
    return dict(enumerate(np.broadcast_to(values, count).astype(float).tolist()))
