"""Rules: what a pursuer chooses whenever its schedule says that it is its turn.

A `Rule` is a protocol with a schedule. Its `actions(me)` is a generator: each `next` is a turn, what it yields is the
action (0: stay, 1: chase), and its local variables are what the pursuer remembers. Who has no choice but to stay is not
asked. A `LearningRule` chooses by what the actions are worth to it, and so has a utility, too. Any rule runs under any
schedule, network and dissemination.
"""

from collections.abc import Iterator
from typing import Annotated, ClassVar

from desim.pursuit.agent import Agent, Process
from desim.pursuit.utility import UTILITIES, Mean, Utility
from desim.value import LONGEST, OneOf, Value
from protocols.mutex import LocalMutex
from protocols.schedules import Periodic, Poisson, Rounds, Schedule, SharedSeed
from protocols.together import Together
from protocols.token import TokenRing, TokenWalk

SCHEDULES = OneOf(
    SharedSeed,
    Poisson,
    Rounds,
    Periodic,
    TokenRing,
    TokenWalk,
    LocalMutex,
    Together,
    needs=("mean_slot",),
    takes=("me", "revise"),
)


class Rule(Value):
    """A protocol in which each pursuer chooses an action whenever its schedule says so, and announces it."""

    assumes: ClassVar[tuple[str, ...]] = ("word_gets_through",)
    """What it needs to do what it promises; see `desim.assumptions`."""
    schedule: Annotated[Schedule, SCHEDULES] = SharedSeed()
    """When each pursuer revises."""

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the action of a pursuer at each of its turns: 1 to chase, 0 to stay."""
        raise NotImplementedError(f"{type(self).__name__} has no rule: write its actions(me)")

    def __call__(self, me: Agent) -> Process:
        """Negotiate for one pursuer."""
        actions = self.actions(me)

        def revise() -> None:
            me.assign(me.may_chase() and bool(next(actions)))

        yield from self.schedule(me, revise)


class LearningRule(Rule):
    """A rule that goes by what the actions are worth, given what the others are believed to do."""

    utility: Annotated[Utility, UTILITIES] = Mean()
    """What being active is worth."""

    def utilities(self, me: Agent) -> list[float]:
        """Return what each action is worth now, s: staying 0, and chasing its gain.

        That of a pursuer that can never capture is cut off at -30 years, so that averages remain numbers.
        """
        return [0.0, max(me.gain(self.utility), -LONGEST)]


def best(utilities: list[float]) -> int:
    """Return the action that is worth most; of several the first, so that nobody chases for nothing."""
    return utilities.index(max(utilities))
