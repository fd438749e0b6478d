"""Rules: what a pursuer chooses whenever its schedule says that it is its turn.

A `Rule` is a protocol with a schedule. Its `actions(me)` is a generator: each `next` is a turn, what it yields is the
action (0: stay, j: chase evader j), and its local variables are what the pursuer remembers. Who has no choice but to
stay is not asked. A `LearningRule` chooses by what the actions are worth to it, and so has a utility, too. Any rule
runs under any schedule, network and dissemination.
"""

from collections.abc import Collection, Iterator
from typing import Annotated, ClassVar

from desim.config.choice import OneOf
from desim.config.model import MAX_TIME, Value
from desim.pursuit.agent import Agent, Process
from desim.pursuit.utility import UTILITIES, Mean, Utility
from protocols.mutex import LocalMutex
from protocols.schedules import Periodic, Poisson, Rounds, Schedule, SharedSeed
from protocols.synchronous import Synchronous
from protocols.token import TokenRing, TokenWalk

SCHEDULES = OneOf(
    SharedSeed,
    Poisson,
    Rounds,
    Periodic,
    TokenRing,
    TokenWalk,
    LocalMutex,
    Synchronous,
    needs=("mean_slot",),
    takes=("me", "revise"),
)


class Rule(Value):
    """A protocol in which each pursuer chooses an action whenever its schedule says so, and announces it."""

    assumes: ClassVar[tuple[str, ...]] = ("messages_get_through",)
    """What it needs to do what it promises; see `desim.scenario.assumptions`."""
    schedule: Annotated[Schedule, SCHEDULES] = SharedSeed()
    """When each pursuer revises."""

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the action of a pursuer at each of its turns: the number of an evader to chase it, 0 to stay."""
        raise NotImplementedError(f"{type(self).__name__} has no rule: write its actions(me)")

    def __call__(self, me: Agent) -> Process:
        """Negotiate for one pursuer.

        Raises:
            TypeError: if the rule does not yield actions.
            ValueError: if it ends.
        """
        actions = self.actions(me)
        if not isinstance(actions, Iterator):
            raise TypeError(f"actions(me) of {type(self).__name__} should yield actions, not return {actions!r}")

        def revise() -> None:
            action = next(actions, None) if me.has_choice() else 0
            if action is None:
                raise ValueError(f"actions(me) of {type(self).__name__} should never end: `while True`")
            me.assign(action)

        yield from self.schedule(me, revise)


class LearningRule(Rule):
    """A rule that goes by what the actions are worth, given what the others are believed to do."""

    utility: Annotated[Utility, UTILITIES] = Mean()
    """What being active is worth."""

    def utilities(self, me: Agent) -> dict[int, float]:
        """Return what each action it may choose is worth now, s: staying 0, and chasing an evader its gain.

        That of who can never capture is cut off at -30 years, so that averages remain numbers.
        """
        worth = {0: 0.0}
        for evader in me.options()[1:]:
            worth[evader] = max(me.gain(self.utility, evader), -MAX_TIME)
        return worth


def current_action(me: Agent, actions: Collection[int]) -> int:
    """Return what a pursuer does if that is one of the actions it may choose; else 0, for it has to stop."""
    return me.action if me.action in actions else 0


def argmax(utilities: dict[int, float]) -> int:
    """Return the action that is worth most; of several the first, so that nobody chases for nothing."""
    return max(utilities, key=utilities.__getitem__)
