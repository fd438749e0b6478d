"""Spatial Adaptive Play: one at a time, each pursuer draws its action from the logit of its gain.

Paper: Lee & Bakolas, "Relay Pursuit of an Evader by a Heterogeneous Group of Pursuers Using Potential Games",
    Algorithms 1 and 2; the rule is log-linear learning (Blume 1993; Young 1998).
Parameters: tau (temperature), schedule (who revises when).
Assumes: revisions one at a time and news that travels at once, for the Gibbs law and the paper's results; on a complete
    graph neither is needed for convergence as tau -> 0.
Messages: announcements as the scenario's `announce` says, one broadcast per change of action and heartbeat by default;
    and those of the schedule.
Robust to loss: yes, with heartbeats.
"""

from collections.abc import Iterator
from typing import Annotated, Literal

from desim.pursuit.agent import Agent, Process
from desim.pursuit.game import activation_probability
from desim.value import OneOf, Value
from protocols.mutex import LocalMutex
from protocols.schedules import Periodic, Poisson, Rounds, Schedule, SharedSeed
from protocols.temperature import ConstantTau, PaperTau, Temperature
from protocols.token import TokenRing, TokenWalk

SCHEDULES = OneOf(SharedSeed, Poisson, Rounds, Periodic, TokenRing, TokenWalk, LocalMutex, needs=("mean_slot",))


class SpatialAdaptivePlay(Value):
    """Each pursuer in its turn chooses to chase with probability expit(gain / tau), and says so."""

    kind: Literal["sap"] = "sap"
    tau: Annotated[Temperature, OneOf(PaperTau, ConstantTau)] = PaperTau()
    """Temperature, s."""
    schedule: Annotated[Schedule, SCHEDULES] = SharedSeed()
    """When each pursuer revises."""

    def __call__(self, me: Agent) -> Process:
        """Negotiate for one pursuer."""
        slot = self.schedule.mean_slot(me)

        def revise() -> None:
            inverse_tau = self.tau(max(me.now, 0.0) / slot)
            me.assign(me.rng.random() < activation_probability(me.gain(), inverse_tau))

        yield from self.schedule(me, revise)

    def warnings(self, step: float) -> Iterator[tuple[str, str]]:
        """Yield what is legal but hardly meant with a motion step (s): the key it concerns, and why."""
        if isinstance(self.schedule, Periodic):
            yield from ((f"schedule.{key}", why) for key, why in self.schedule.warnings(step))
