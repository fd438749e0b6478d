"""Fictitious play: each pursuer responds to the past play of its teammates rather than to their present actions.

Paper: FictitiousPlay: Brown 1951; Monderer & Shapley 1996, "Fictitious Play Property for Games with Identical
    Interests". JointStrategyFictitiousPlay: Marden, Arslan & Shamma 2009, "Joint Strategy Fictitious Play with Inertia
    for Potential Games", with fading memory.
Parameters: schedule, utility; for JointStrategyFictitiousPlay alpha (probability of changing), rho (rate of
    forgetting).
Assumes: announcements of all teammates; revisions in any order. While capture times are constant, the empirical
    frequencies of fictitious play converge to the equilibria of every potential game. The frequencies are averages
    over all past revisions (turns) of the pursuer, so they adapt slowly when capture times change.
Messages: announcements, see `announce` in the scenario.
Robust to loss: yes, with heartbeats; at each turn the last action received from a teammate counts again, until that
    action expires (`announce.belief_timeout`).
"""

from collections import defaultdict
from collections.abc import Iterator
from itertools import count
from math import inf
from typing import Literal, Self

from pydantic import model_validator

from desim.config.model import Probability
from desim.config.traits import inherits
from desim.pursuit.core.traits import UtilityTraits
from desim.pursuit.team.agent import Agent
from desim.pursuit.team.beliefs import Belief
from protocols.best_response import ChangeProbability
from protocols.rule import LearningRule, argmax, current_action


class FictitiousPlay(LearningRule):
    """The best response to the empirical frequencies of the teammates' actions, assumed to be independent."""

    kind: Literal["fictitious_play"] = "fictitious_play"

    @model_validator(mode="after")
    def _can_expect(self) -> Self:
        if UtilityTraits.of(self.utility).expected is None:
            raise ValueError(f"fictitious play needs a utility with `expected`, got {self.utility!r}")
        if not inherits(self, LearningRule, "utilities") and inherits(self, FictitiousPlay, "actions"):
            raise ValueError("fictitious play never calls `utilities`: override `actions`, or give another `utility`")
        return self

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the best response to the empirical frequencies."""
        expected = UtilityTraits.of(self.utility).expected
        assert expected is not None
        frequencies: dict[int, dict[int, float]] = defaultdict(lambda: defaultdict(float))
        for turn in count(1):
            beliefs = {evader: me.beliefs(evader=evader) for evader in me.evaders()}
            for evader, believed in beliefs.items():
                frequency = frequencies[evader]
                # The mean over all turns. A teammate whose announcement has expired counts as not chasing in this turn.
                for j in believed.keys() | frequency.keys():
                    frequency[j] += ((j in believed and believed[j].active == evader) - frequency[j]) / turn
            utilities = {0: 0.0}
            for evader in me.options()[1:]:
                times = self._counted_times(me, beliefs[evader])
                chances = [frequencies[evader][j] for j in times]
                utilities[evader] = expected(me.capture_time(evader), list(times.values()), chances, me.time_left())
            yield argmax(utilities)

    def _counted_times(self, me: Agent, beliefs: dict[int, Belief]) -> dict[int, float]:
        """Return the believed capture time, s, of each teammate that counts in the utility, if that time is finite."""
        counted = me.counted_teammates(self.utility.scope)
        return {j: belief.capture_time for j, belief in beliefs.items() if j in counted and belief.capture_time < inf}


class JointStrategyFictitiousPlay(LearningRule):
    """The action of highest average utility against the past joint actions, with inertia.

    The present action is kept if no other has a higher average.
    """

    kind: Literal["jsfp"] = "jsfp"
    alpha: ChangeProbability = 0.5
    """Probability of changing to a better action, in (0, 1]; 1 - alpha is the inertia.

    If all change at once with probability 1, they may swap actions for ever; with a small alpha they settle slowly.

    If in doubt, use 0.5.
    """
    rho: Probability = 0.03
    """Rate of forgetting: turn n enters the average with the weight max(rho, 1/n); 0: all turns have equal weight.

    The memory is about 1 / rho turns: a long one averages over positions that are past, a short one over chance.

    If in doubt, use 0.03, or 0 in a static game.
    """

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the action of highest average utility, or the present one."""
        average: dict[int, float] = defaultdict(float)
        for turn in count(1):
            weight = max(self.rho, 1.0 / turn)
            utilities = self.utilities(me)
            for action, utility in utilities.items():
                average[action] += weight * (utility - average[action])
            current, changes = current_action(me, utilities), me.rng.random() < self.alpha
            averages = {action: average[action] for action in utilities}
            better = argmax(averages)
            yield better if changes and averages[current] < averages[better] else current
