"""Best response and better reply: at its turn a pursuer changes to an action of higher utility.

Paper: BestResponse: Cournot; Monderer & Shapley 1996, "Potential Games", for the finite improvement property.
    BetterReply: better reply with inertia, Young 2004, "Strategic Learning and Its Limits"; Marden, Arslan & Shamma
    2007, "Regret Based Dynamics".
Parameters: schedule, utility; alpha (probability of changing).
Assumes: announcements of all teammates. Best response ends in an equilibrium of any potential game if revisions happen
    one at a time; in the relay game it does so under any schedule. Better reply with inertia needs no order of
    revisions.
Messages: announcements, see `announce` in the scenario.
Robust to loss: yes, with heartbeats.
"""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from desim.pursuit.agent import Agent
from protocols.rule import LearningRule, argmax, current_action

Willingness = Annotated[float, Field(gt=0, le=1, strict=True)]
"""A probability greater than 0."""


class BestResponse(LearningRule):
    """At its turn a pursuer takes the action of highest utility; ties go to the lowest number (0: stay)."""

    assumes: ClassVar[tuple[str, ...]] = (*LearningRule.assumes, "one_at_a_time")
    kind: Literal["best_response"] = "best_response"

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the best action at each turn."""
        while True:
            yield argmax(self.utilities(me))


class BetterReply(LearningRule):
    """At its turn a pursuer changes, with probability alpha, to a random action among those better than its own."""

    kind: Literal["better_reply"] = "better_reply"
    alpha: Willingness = 0.5
    """Probability of changing if there is a better action, in (0, 1]; 1 - alpha is the inertia."""

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield a better action or the present one."""
        while True:
            worth = self.utilities(me)
            now = current_action(me, worth)
            better = [action for action, value in worth.items() if value > worth[now]]
            willing = me.rng.random() < self.alpha
            yield better[me.rng.integers(len(better))] if better and willing else now
