"""Fictitious play: each pursuer answers not what the others do, but what they have done so far.

Paper: FictitiousPlay: Brown 1951; Monderer & Shapley 1996, "Fictitious Play Property for Games with Identical
    Interests". JointStrategyFictitiousPlay: Marden, Arslan & Shamma 2009, "Joint Strategy Fictitious Play with Inertia
    for Potential Games", with fading memory.
Parameters: schedule, utility; alpha (how willing a pursuer is to change), rho (how fast it forgets).
Assumes: word of everybody; no order of revisions. Fictitious play converges in beliefs in every potential game, with
    times of capture that do not change; how often each pursuer was active is averaged over all turns, so it is slow
    to follow those that do.
Messages: announcements as the scenario's `announce` says.
Robust to loss: yes, with heartbeats: what was heard last counts again at each turn.
"""

from collections import defaultdict
from collections.abc import Iterator
from itertools import count
from math import inf
from typing import Any, Literal, Self

from pydantic import model_validator

from desim.pursuit.agent import Agent
from desim.value import Probability
from protocols.best_response import Willingness
from protocols.rule import LearningRule, best


class FictitiousPlay(LearningRule):
    """The best action if each other were active, independently, as often as it was found to be at the turns so far."""

    kind: Literal["fictitious_play"] = "fictitious_play"

    @model_validator(mode="after")
    def _can_expect(self) -> Self:
        if not hasattr(self.utility, "expected"):
            raise ValueError(f"fictitious play needs a utility with `expected`, got {self.utility!r}")
        return self

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the best response to the empirical frequencies."""
        utility: Any = self.utility
        frequency: dict[int, float] = defaultdict(float)
        for turn in count(1):
            beliefs = me.beliefs()
            for j in beliefs.keys() | frequency.keys():
                frequency[j] += ((j in beliefs and beliefs[j].active) - frequency[j]) / turn
            circle = me.circle(utility.scope)
            times = {j: each.capture_time for j, each in beliefs.items() if j in circle and each.capture_time < inf}
            chances = [frequency[j] for j in times]
            gain = utility.expected(me.capture_time(), list(times.values()), chances, me.time_left())
            yield best([0.0, gain])


class JointStrategyFictitiousPlay(LearningRule):
    """The action that would have been worth most on the average, and inertia; an optimal action is kept."""

    kind: Literal["jsfp"] = "jsfp"
    alpha: Willingness = 0.5
    """Probability of changing to a better action, in (0, 1]; 1 - alpha is the inertia."""
    rho: Probability = 0.03
    """Least weight of the latest turn in the average, which is how fast memory fades; 0: all turns count the same."""

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield an action of greatest average utility, or the present one."""
        average = [0.0, 0.0]
        for turn in count(1):
            weight = max(self.rho, 1.0 / turn)
            average = [v + weight * (u - v) for u, v in zip(self.utilities(me), average, strict=True)]
            present, willing = int(me.action), me.rng.random() < self.alpha
            yield best(average) if willing and average[present] < max(average) else present
