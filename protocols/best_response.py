"""Best response and better reply: at its turn a pursuer changes to an action of higher utility.

Paper: BestResponse: Cournot; Monderer & Shapley 1996, "Potential Games", for the finite improvement property.
    BetterReply: better reply with inertia, Young 2004, "Strategic Learning and Its Limits"; Marden, Arslan & Shamma
    2007, "Regret Based Dynamics".
Parameters: schedule, utility; for BetterReply alpha (probability of changing).
Assumes: announcements of all teammates. Best response ends in an equilibrium: in any potential game if revisions happen
    one at a time, and in the game with one evader (`desim.pursuit.game.game`) under any schedule.
    Better reply with inertia (alpha < 1) ends in an equilibrium of any potential game under any schedule.
Messages: announcements, see `announce` in the scenario.
Robust to loss: yes, with heartbeats.
"""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from desim.pursuit.team.agent import Agent
from protocols.rule import LearningRule, argmax, current_action

ChangeProbability = Annotated[float, Field(gt=0, le=1, strict=True)]
"""Probability that a pursuer follows its rule at a turn, rather than keep its action, in (0, 1]."""


class BestResponse(LearningRule):
    """At its turn a pursuer takes the action of highest utility; ties go to the lowest number (0: inactive)."""

    assumes: ClassVar[tuple[str, ...]] = (*LearningRule.assumes, "one_at_a_time")
    kind: Literal["best_response"] = "best_response"

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the best action at each turn."""
        while True:
            yield argmax(self.utilities(me))


class BetterReply(LearningRule):
    """At its turn a pursuer changes, with probability alpha, to a random action among those better than its own."""

    kind: Literal["better_reply"] = "better_reply"
    alpha: ChangeProbability = 0.5
    """Probability of changing if there is a better action, in (0, 1]; 1 - alpha is the inertia.

    If all change at once with probability 1, they may swap actions for ever; with a small alpha they settle slowly.

    If in doubt, use 0.5, or 1 if only one pursuer revises at a time.
    """

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield a better action or the present one at each turn."""
        while True:
            utilities = self.utilities(me)
            current = current_action(me, utilities)
            better = [action for action, value in utilities.items() if value > utilities[current]]
            changes = me.rng.random() < self.alpha
            yield better[me.rng.integers(len(better))] if better and changes else current
