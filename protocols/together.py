"""Everybody at once, as often as under another schedule one of the team: what deciding one at a time costs.

Paper: none; the synchronous learning of Marden & Shamma 2012 at the pace of another schedule.
Parameters: of, the other schedule.
Assumes: equal clocks.
Messages: none; those of the other schedule are not sent.
Robust to loss: yes, for nothing is sent.
"""

from collections.abc import Callable
from typing import Annotated, ClassVar, Literal

from desim.pursuit.agent import Agent, Process
from desim.value import OneOf, Value
from protocols.mutex import LocalMutex
from protocols.schedules import Periodic, Poisson, Rounds, Schedule, SharedSeed
from protocols.token import TokenRing, TokenWalk

ONE_AT_A_TIME = (SharedSeed, Poisson, Periodic, TokenRing, TokenWalk, LocalMutex)


class Together(Value):
    """A round per slot of another schedule: where that lets one pursuer of the team revise, all revise.

    Rounds cost nothing but simulated decisions, N times as many. The slot that temperatures go by is that of the other
    schedule, so that they cool alike.
    """

    assumes: ClassVar[tuple[str, ...]] = ("equal_clocks",)
    at_once: ClassVar[bool] = True
    kind: Literal["together"] = "together"
    of: Annotated[Schedule, OneOf(*ONE_AT_A_TIME, needs=("mean_slot",), takes=("me", "revise"))] = SharedSeed()
    """The other schedule, of which there is a round per slot."""

    def mean_slot(self, me: Agent) -> float:
        """Return the slot of the other schedule, s."""
        return self.of.mean_slot(me)

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise at the end of each slot."""
        yield from Rounds(period=self.of.mean_slot(me))(me, revise)
