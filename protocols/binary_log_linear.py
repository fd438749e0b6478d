"""Log-linear learning that compares two actions per turn: the present one and a trial action.

Paper: BinaryLogLinear: Marden & Shamma 2012, "Revisiting Log-Linear Learning". SelectiveSAP: binary restrictive
    Spatial Adaptive Play, Marden 2007, "Learning in Large-Scale Games and Cooperative Control", 6.3.3; Selective SAP of
    Lee & Bakolas. The constrained action sets of Marden & Shamma, by which the present action restricts the next, are
    not implemented: a pursuer may try every other action that `prune` allows.
Parameters: tau (temperature), schedule (who revises when), utility.
Assumes: as Spatial Adaptive Play (`protocols.sap`); the stationary distribution is then the same Gibbs distribution.
    With two actions the binary rule *is* SAP. With one evader, SelectiveSAP is SAP that skips each turn with
    probability 1/2.
Messages: as Spatial Adaptive Play.
Robust to loss: yes, with heartbeats.
"""

from collections.abc import Iterator
from typing import Literal

from desim.pursuit.game.game import logit
from desim.pursuit.team.agent import Agent
from protocols.rule import current_action
from protocols.sap import LogLinear, categorical


class BinaryLogLinear(LogLinear):
    """At its turn a pursuer compares a trial action with its present one, and draws one of the two from their logit."""

    kind: Literal["binary_log_linear"] = "binary_log_linear"

    def trial(self, me: Agent, options: list[int], current: int) -> int:
        """Draw the trial action uniformly from all options except the present action."""
        return options[(options.index(current) + int(me.rng.integers(1, len(options)))) % len(options)]

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the present action or the trial action at each turn."""
        for inverse_tau in self.inverse_temperatures(me):
            utilities = self.utilities(me)
            current = current_action(me, utilities)
            trial = self.trial(me, list(utilities), current)
            yield (current, trial)[categorical(logit([utilities[current], utilities[trial]], inverse_tau), me.rng)]


class SelectiveSAP(BinaryLogLinear):
    """The binary rule with a trial action drawn from all actions, the present one included.

    The restricted set R_i contains inactivity and each evader that the pursuer may chase. It has at most M + 1 actions,
    where M is the number of evaders at the start. Each action in R_i is drawn as the trial action with probability
    1 / (M + 1). If none is drawn, the trial action is the present action, which the pursuer then keeps.
    """

    kind: Literal["selective_sap"] = "selective_sap"  # type: ignore[assignment]

    def trial(self, me: Agent, options: list[int], current: int) -> int:
        """Draw the trial action: each of the options with probability 1 / (M + 1), else the present action."""
        index = int(me.rng.integers(me.evader_count + 1))
        return options[index] if index < len(options) else current
