"""Log-linear learning with two actions in hand: the present one, and one that is tried.

Paper: BinaryLogLinear: Marden & Shamma 2012, "Revisiting Log-Linear Learning". SelectiveSAP: binary restrictive
    Spatial Adaptive Play, Marden 2007, "Learning in Large-Scale Games and Cooperative Control", 6.3.3; Selective SAP of
    Lee & Bakolas. The constrained action sets of Marden & Shamma, by which the present action restricts the next, are
    not implemented: every other action may be tried that `prune` allows.
Parameters: tau (temperature), schedule (who revises when), utility.
Assumes: as Spatial Adaptive Play; then it has the same Gibbs law. With two actions the binary rule *is* SAP, and the
    selective one is SAP that does nothing at every second turn.
Messages: as Spatial Adaptive Play; its pursuers compare two actions at a turn, however many there are.
Robust to loss: yes, with heartbeats.
"""

from collections.abc import Iterator
from typing import Literal

from desim.pursuit.agent import Agent
from desim.pursuit.game import logit
from protocols.rule import current_action
from protocols.sap import LogLinear, categorical


class BinaryLogLinear(LogLinear):
    """Each pursuer in its turn tries one of its other actions, and keeps it or not by the logit of the two."""

    kind: Literal["binary_log_linear"] = "binary_log_linear"

    def trial(self, me: Agent, options: list[int], now: int) -> int:
        """Return the action that is tried, of those it may choose: each but the present one with equal chances."""
        return options[(options.index(now) + int(me.rng.integers(1, len(options)))) % len(options)]

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the present action or the one that is tried."""
        for inverse_tau in self.inverse_temperatures(me):
            worth = self.utilities(me)
            now = current_action(me, worth)
            trial = self.trial(me, list(worth), now)
            yield (now, trial)[categorical(logit([worth[now], worth[trial]], inverse_tau), me.rng)]


class SelectiveSAP(BinaryLogLinear):
    """As the binary rule, but the action that is tried is drawn from all, and may be the present one again.

    Each action of the restricted set R_i, to stay or to chase an evader that it may chase, but the present one is tried
    with probability 1 / max |R_i|. The greatest set has all M + 1 actions.
    """

    kind: Literal["selective_sap"] = "selective_sap"  # type: ignore[assignment]

    def trial(self, me: Agent, options: list[int], now: int) -> int:
        """Return the action that is tried: each it may choose with probability 1 / (M + 1), else the present one."""
        place = int(me.rng.integers(me.evader_count + 1))
        return options[place] if place < len(options) else now
