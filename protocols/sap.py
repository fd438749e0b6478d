"""Spatial Adaptive Play: one at a time, each pursuer draws an action from the logit of the utilities.

Paper: Lee & Bakolas, "Relay Pursuit of an Evader by a Heterogeneous Group of Pursuers Using Potential Games",
    Algorithms 1 and 2; the rule is log-linear learning (Blume 1993; Young 1998).
Parameters: tau (temperature), schedule (who revises when), utility.
Assumes: revisions one at a time and zero latency, for the stationary Gibbs distribution and the paper's results. On a
    complete graph the team settles in an equilibrium as tau -> 0 even if neither holds.
Messages: announcements, see `announce` in the scenario: by default one broadcast per change of action and one per
    heartbeat. The schedule may send messages of its own.
Robust to loss: yes, with heartbeats.
"""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

import numpy as np

from desim.pursuit.game.game import logit
from desim.pursuit.team.agent import Agent
from protocols.rule import LearningRule
from protocols.schedules.periodic import slot_length
from protocols.temperature import TEMPERATURES, PaperTau, Temperature, inverse_temperatures


class LogLinear(LearningRule):
    """The common part of the log-linear rules: a temperature that may decrease."""

    assumes: ClassVar[tuple[str, ...]] = (*LearningRule.assumes, "one_at_a_time")
    tau: Annotated[Temperature, TEMPERATURES] = PaperTau()
    """Temperature or cooling schedule, s."""

    def inverse_temperatures(self, me: Agent) -> Iterator[float]:
        """Return an iterator over 1/tau at each turn, 1/s."""
        return inverse_temperatures(self.tau, me, slot_length(self.schedule, me))


class SpatialAdaptivePlay(LogLinear):
    """At its turn a pursuer draws each action with probability proportional to exp(utility / tau)."""

    kind: Literal["sap"] = "sap"

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield an action drawn from the logit at each turn."""
        for inverse_tau in self.inverse_temperatures(me):
            utilities = self.utilities(me)
            yield list(utilities)[categorical(logit([*utilities.values()], inverse_tau), me.rng)]


def categorical(chances: list[float], rng: np.random.Generator) -> int:
    """Draw an index with the given probabilities, using one random number of `rng`."""
    uniform = rng.random()
    for index in range(len(chances) - 1, 0, -1):
        if uniform < chances[index]:
            return index
        uniform -= chances[index]
    return 0  # also if the sum of the chances is a rounding error less than 1
