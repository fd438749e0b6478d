"""All pursuers revise together in every slot of a one-at-a-time schedule: a baseline for the cost of taking turns.

Paper: none for this combination of synchronous learning (Marden & Shamma 2012) and the slots of another schedule.
Parameters: schedule (the other schedule).
Assumes: equal clocks.
Messages: none besides announcements; the other schedule does not send its messages.
Robust to loss: yes, because the times of revisions do not depend on messages.
"""

from collections.abc import Callable
from typing import Annotated, ClassVar, Literal, Self

from desim.config.choice import OneOf
from desim.config.model import Value
from desim.pursuit.core.traits import ScheduleTraits
from desim.pursuit.team.agent import Agent, Process
from protocols.schedules.periodic import Rounds, Schedule, SharedSeed, slot_length
from protocols.schedules.token import TokenRing, TokenWalk


class Synchronous(Value):
    """All pursuers revise in each slot in which another schedule lets one pursuer revise.

    Each of the N pursuers therefore revises N times as often. Temperatures cool as fast as under the other schedule,
    because `mean_slot` is the same.
    """

    assumes: ClassVar[tuple[str, ...]] = ("equal_clocks",)
    at_once: ClassVar[bool] = True
    """All pursuers revise at the same instant."""
    kind: Literal["synchronous"] = "synchronous"
    schedule: Annotated[
        Schedule,
        OneOf(
            SharedSeed, TokenRing, TokenWalk, needs=("mean_slot(me)",), takes=("me", "revise"), traits=ScheduleTraits
        ),
    ] = SharedSeed()
    """The other schedule; all pursuers revise once in each of its slots."""

    def mean_slot(self, me: Agent) -> float:
        """Return the mean length of a slot of the other schedule, s."""
        return slot_length(self.schedule, me)

    def for_all(self) -> Self:
        """Return the schedule itself: every pursuer revises in each slot."""
        return self

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise at the end of each slot."""
        yield from Rounds(period=slot_length(self.schedule, me))(me, revise)
