"""Best response and better reply: in its turn a pursuer changes to an action that is worth more.

Paper: BestResponse: Cournot; Monderer & Shapley 1996, "Potential Games", for the finite improvement property.
    BetterReply: better reply with inertia, Young 2004, "Strategic Learning and Its Limits"; Marden, Arslan & Shamma
    2007, "Regret Based Dynamics".
Parameters: schedule, utility; alpha (how willing a pursuer is to change).
Assumes: one at a time, for best response to end in an equilibrium of any potential game (on the relay game it does so
    under any schedule); better reply with inertia needs no order. Word of everybody.
Messages: announcements as the scenario's `announce` says.
Robust to loss: yes, with heartbeats.
"""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from desim.pursuit.agent import Agent
from protocols.rule import LearningRule, argmax, current_action

Willingness = Annotated[float, Field(gt=0, le=1, strict=True)]
"""A probability that is not 0."""


class BestResponse(LearningRule):
    """Each pursuer in its turn takes the action that is worth most; if several are, the first of them: it stays."""

    assumes: ClassVar[tuple[str, ...]] = (*LearningRule.assumes, "one_at_a_time")
    kind: Literal["best_response"] = "best_response"

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the best action at each turn."""
        while True:
            yield argmax(self.utilities(me))


class BetterReply(LearningRule):
    """Each pursuer in its turn takes, with a probability, one of the actions that are worth more than the present."""

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
