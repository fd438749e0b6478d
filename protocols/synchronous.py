"""Everybody at once in every slot that another schedule gives to one: what it costs to take turns.

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
    """A round per slot of a schedule under which pursuers take turns: where that lets one revise, all revise.

    So each revises N times as often. The slot that temperatures go by is that of the other schedule, so that they cool
    alike.
    """

    assumes: ClassVar[tuple[str, ...]] = ("equal_clocks",)
    at_once: ClassVar[bool] = True
    kind: Literal["synchronous"] = "synchronous"
    schedule: Annotated[
        Schedule, OneOf(SharedSeed, TokenRing, TokenWalk, needs=("mean_slot",), takes=("me", "revise"))
    ] = SharedSeed()
    """The other schedule, of which there is a round per slot."""

    def mean_slot(self, me: Agent) -> float:
        """Return the slot of the other schedule, s."""
        return self.schedule.mean_slot(me)

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise at the end of each slot."""
        yield from Rounds(period=self.schedule.mean_slot(me))(me, revise)
