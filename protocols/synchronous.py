"""Synchronous revisions in the slots of a schedule with turns: a control that shows the cost of taking turns.

Paper: none; the synchronous learning of Marden & Shamma 2012 in the slots of another schedule.
Parameters: schedule, the other schedule.
Assumes: equal clocks.
Messages: none; those of the other schedule are not sent.
Robust to loss: yes, for nothing is sent.
"""

from collections.abc import Callable
from typing import Annotated, ClassVar, Literal

from desim.config.choice import OneOf
from desim.config.model import Value
from desim.pursuit.agent import Agent, Process
from protocols.schedules import Rounds, Schedule, SharedSeed
from protocols.token import TokenRing, TokenWalk


class Synchronous(Value):
    """All pursuers revise in each slot in which another schedule lets one pursuer revise.

    Each pursuer therefore revises N times as often. Temperatures cool as under the other schedule, with its slot.
    """

    assumes: ClassVar[tuple[str, ...]] = ("equal_clocks",)
    at_once: ClassVar[bool] = True
    kind: Literal["synchronous"] = "synchronous"
    schedule: Annotated[
        Schedule, OneOf(SharedSeed, TokenRing, TokenWalk, needs=("mean_slot",), takes=("me", "revise"))
    ] = SharedSeed()
    """The other schedule; there is one round in each of its slots."""

    def mean_slot(self, me: Agent) -> float:
        """Return the slot of the other schedule, s."""
        return self.schedule.mean_slot(me)

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise at the end of each slot."""
        yield from Rounds(period=self.schedule.mean_slot(me))(me, revise)
