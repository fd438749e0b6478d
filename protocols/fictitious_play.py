"""Fictitious play: each pursuer answers not what the others do, but what they have done so far.

Paper: FictitiousPlay: Brown 1951; Monderer & Shapley 1996, "Fictitious Play Property for Games with Identical
    Interests". JointStrategyFictitiousPlay: Marden, Arslan & Shamma 2009, "Joint Strategy Fictitious Play with Inertia
    for Potential Games", with fading memory.
Parameters: schedule, utility; alpha (how willing a pursuer is to change), rho (how fast it forgets).
Assumes: word of everybody; no order of revisions. Fictitious play converges in beliefs in every potential game, with
    times of capture that do not change; how often each pursuer chased is averaged over all turns, so it is slow
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

from desim.config.model import Probability
from desim.pursuit.agent import Agent
from desim.pursuit.beliefs import Belief
from protocols.best_response import Willingness
from protocols.rule import LearningRule, argmax, current_action


class FictitiousPlay(LearningRule):
    """The best action if each other chased each evader, independently, as often as it did at the turns so far."""

    kind: Literal["fictitious_play"] = "fictitious_play"

    @model_validator(mode="after")
    def _can_expect(self) -> Self:
        if not hasattr(self.utility, "expected"):
            raise ValueError(f"fictitious play needs a utility with `expected`, got {self.utility!r}")
        return self

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the best response to the empirical frequencies."""
        frequencies: dict[int, dict[int, float]] = defaultdict(lambda: defaultdict(float))
        for turn in count(1):
            beliefs = {evader: me.beliefs(evader=evader) for evader in me.evaders()}
            for evader, believed in beliefs.items():
                frequency = frequencies[evader]
                for j in believed.keys() | frequency.keys():
                    frequency[j] += ((j in believed and believed[j].active == evader) - frequency[j]) / turn
            chased = me.options()[1:]
            yield argmax(
                {0: 0.0} | {each: self._expected(me, each, beliefs[each], frequencies[each]) for each in chased}
            )

    def _expected(self, me: Agent, evader: int, beliefs: dict[int, Belief], frequency: dict[int, float]) -> float:
        """Return what chasing an evader is worth if teammates chase it as often as they did, s."""
        utility: Any = self.utility
        counted_teammates = me.counted_teammates(utility.scope)
        times = {
            j: each.capture_time for j, each in beliefs.items() if j in counted_teammates and each.capture_time < inf
        }
        chances = [frequency[j] for j in times]
        gain: float = utility.expected(me.capture_time(evader), list(times.values()), chances, me.time_left())
        return gain


class JointStrategyFictitiousPlay(LearningRule):
    """The action that would have been worth most on the average, and inertia; an optimal action is kept."""

    kind: Literal["jsfp"] = "jsfp"
    alpha: Willingness = 0.5
    """Probability of changing to a better action, in (0, 1]; 1 - alpha is the inertia."""
    rho: Probability = 0.03
    """Least weight of the latest turn in the average, which is how fast memory fades; 0: all turns count the same."""

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield an action of greatest average utility, or the present one."""
        average: dict[int, float] = defaultdict(float)
        for turn in count(1):
            weight = max(self.rho, 1.0 / turn)
            worth = self.utilities(me)
            for action, utility in worth.items():
                average[action] += weight * (utility - average[action])
            now, willing = current_action(me, worth), me.rng.random() < self.alpha
            averages = {action: average[action] for action in worth}
            better = argmax(averages)
            yield better if willing and averages[now] < averages[better] else now
