"""Regret matching: the more a pursuer regrets not having done something, the likelier it does it.

Paper: RegretMatching: Hart & Mas-Colell 2000, "A Simple Adaptive Procedure Leading to Correlated Equilibrium", its
    unconditional variant: the regret of an action is that of not having done it at every turn. The conditional
    procedure that gives the paper its name (regrets of each action against each other, and a constant of inertia) and
    that leads to correlated equilibria is not implemented.
    GeneralisedRegretMatching: Marden, Arslan & Shamma 2007, "Regret Based Dynamics: Convergence in Weakly Acyclic
    Games", with fading memory and inertia.
Parameters: schedule, utility; rho (how fast regret fades), alpha (how willing a pursuer is to change).
Assumes: word of everybody; no order of revisions. Regret matching has no regret in the long run, and how often each
    profile was played tends to the coarse correlated equilibria: in the relay game with one evader and times of capture
    that do not change, to the relay profile. The generalised one settles in a pure equilibrium.
Messages: announcements as the scenario's `announce` says.
Robust to loss: yes, with heartbeats.
"""

from collections import defaultdict
from collections.abc import Iterator
from itertools import count
from typing import Literal

from desim.config.model import Probability
from desim.pursuit.agent import Agent
from protocols.best_response import Willingness
from protocols.rule import LearningRule, current_action
from protocols.sap import categorical


class RegretMatching(LearningRule):
    """Each action with probability proportional to its regret, if that is positive; if none is, no change.

    The regret of an action is how much more it would have been worth than what was done, averaged over the turns. To
    draw at random where there is no regret, as one may, would leave most runs unsettled.
    """

    kind: Literal["regret_matching"] = "regret_matching"
    rho: Probability = 0.0
    """Least weight of the latest turn in the average, which is how fast regret fades; 0: all turns count the same."""
    alpha: Willingness = 1.0
    """Probability of choosing anew, in (0, 1]; 1 - alpha is the inertia."""

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield an action in proportion to its regret, or the present one."""
        regret: dict[int, float] = defaultdict(float)
        for turn in count(1):
            worth = self.utilities(me)
            now, weight = current_action(me, worth), max(self.rho, 1.0 / turn)
            for action, utility in worth.items():
                regret[action] += weight * (utility - worth[now] - regret[action])
            positive = [max(regret[action], 0.0) for action in worth]
            total = sum(positive)
            willing = me.rng.random() < self.alpha
            yield list(worth)[categorical([r / total for r in positive], me.rng)] if total > 0.0 and willing else now


class GeneralisedRegretMatching(RegretMatching):
    """Regret matching with fading memory and inertia."""

    kind: Literal["generalised_regret_matching"] = "generalised_regret_matching"  # type: ignore[assignment]
    rho: Probability = 0.1
    """Least weight of the latest turn in the average, which is how fast regret fades; 0: all turns count the same."""
    alpha: Willingness = 0.5
    """Probability of choosing anew, in (0, 1]; 1 - alpha is the inertia."""
