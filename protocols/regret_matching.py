"""Regret matching: a pursuer draws each action with probability proportional to its regret for not having taken it.

Paper: RegretMatching: Hart & Mas-Colell 2000, "A Simple Adaptive Procedure Leading to Correlated Equilibrium", its
    unconditional variant: the regret of an action is the mean gain if the action had been taken at every turn. The
    conditional procedure of the paper (a regret for each pair of actions, and an inertia constant) is not implemented.
    Only that procedure leads to correlated equilibria.
    GeneralisedRegretMatching: Marden, Arslan & Shamma 2007, "Regret Based Dynamics: Convergence in Weakly Acyclic
    Games", with fading memory and inertia.
Parameters: schedule, utility; rho (rate of forgetting), alpha (probability of choosing anew).
Assumes: announcements of all teammates; revisions in any order. With the default parameters, regret matching has no
    regret in the long run, and the empirical frequencies of profiles (joint actions) tend to the coarse correlated
    equilibria. In the game with one evader and constant capture times, the only coarse correlated equilibrium is the
    profile in which the relay pursuer alone is active, if the conditions in `desim.pursuit.game.game.relay_pursuer`
    hold. Generalised regret matching settles in a pure equilibrium.
Messages: announcements, see `announce` in the scenario.
Robust to loss: yes, with heartbeats.
"""

from collections import defaultdict
from collections.abc import Iterator
from itertools import count
from typing import Literal

from desim.config.model import Probability
from desim.kernel.core.portable_math import portable_sum
from desim.pursuit.team.agent import Agent
from protocols.best_response import ChangeProbability
from protocols.rule import LearningRule, current_action
from protocols.sap import categorical


class RegretMatching(LearningRule):
    """Each action is drawn with probability proportional to the positive part of its regret.

    The regret of an action is its utility minus that of the action taken, averaged over the turns. If no regret is
    positive, the present action is kept; with a uniform draw instead, most runs would not settle.
    """

    kind: Literal["regret_matching"] = "regret_matching"
    rho: Probability = 0.0
    """Rate of forgetting: at turn n the average moves towards the new value by max(rho, 1/n) of their difference. With
    0 it is the mean over all turns.

    The memory is about 1 / rho turns.

    If in doubt, use 0 in a static game, and 0.1 if the players move.
    """
    alpha: ChangeProbability = 1.0
    """Probability of choosing anew, in (0, 1]; 1 - alpha is the inertia.

    If in doubt, use 1 if only one pursuer revises at a time, and 0.5 if several may do so at once.
    """

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield an action drawn in proportion to its regret, or the present one."""
        regret: dict[int, float] = defaultdict(float)
        for turn in count(1):
            utilities = self.utilities(me)
            current, weight = current_action(me, utilities), max(self.rho, 1.0 / turn)
            for action, utility in utilities.items():
                regret[action] += weight * (utility - utilities[current] - regret[action])
            positive = [max(regret[action], 0.0) for action in utilities]
            total = portable_sum(positive)
            changes = me.rng.random() < self.alpha
            if total > 0.0 and changes:
                yield list(utilities)[categorical([r / total for r in positive], me.rng)]
            else:
                yield current


class GeneralisedRegretMatching(RegretMatching):
    """Regret matching with fading memory and inertia."""

    kind: Literal["generalised_regret_matching"] = "generalised_regret_matching"  # type: ignore[assignment]
    rho: Probability = 0.1
    """Rate of forgetting: at turn n the average moves towards the new value by max(rho, 1/n) of their difference. With
    0 it is the mean over all turns.

    The memory is about 1 / rho turns: a long one averages over positions that are past, a short one over chance.

    If in doubt, use 0.1.
    """
    alpha: ChangeProbability = 0.5
    """Probability of choosing anew, in (0, 1]; 1 - alpha is the inertia.

    If in doubt, use 0.5.
    """
