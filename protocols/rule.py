"""Rules: protocols that choose an action at each turn of a schedule.

A `Rule` is a protocol with a schedule. Its `actions(me)` is a generator that yields one action per turn (0: inactive,
j: chase evader j) and keeps the pursuer's memory in its local variables. While the pursuer can only be inactive,
`Rule.__call__` does not advance the generator, unless `asks_without_choice` is set. A `LearningRule` chooses by the
utilities of the actions. Any rule runs under any schedule, network and dissemination. Derive a new protocol from `Rule`
or `LearningRule` unless it needs messages of its own.
"""

from collections.abc import Collection, Iterator
from typing import Annotated, ClassVar

from desim.config.choice import OneOf
from desim.config.model import MAX_TIME, Value
from desim.pursuit.core.traits import ScheduleTraits
from desim.pursuit.game.utility import UTILITIES, Mean, Utility
from desim.pursuit.team.agent import Agent, Process
from protocols.schedules.mutex import LocalMutex
from protocols.schedules.periodic import Periodic, Poisson, Rounds, Schedule, SharedSeed, turns
from protocols.schedules.synchronous import Synchronous
from protocols.schedules.token import TokenRing, TokenWalk

SCHEDULES = OneOf(
    SharedSeed,
    Poisson,
    Rounds,
    Periodic,
    TokenRing,
    TokenWalk,
    LocalMutex,
    Synchronous,
    needs=("mean_slot(me)",),
    takes=("me", "revise"),
    traits=ScheduleTraits,
)


class Rule(Value):
    """A protocol in which each pursuer chooses an action at each turn of its schedule, and announces it."""

    assumes: ClassVar[tuple[str, ...]] = ("messages_get_through",)
    """The assumptions of the rule about the scenario; see `desim.scenario.assumptions`."""
    asks_without_choice: ClassVar[bool] = False
    """Whether `actions` also chooses at the turns at which a pursuer can only be inactive."""
    schedule: Annotated[Schedule, SCHEDULES] = SharedSeed()
    """When each pursuer revises."""

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the action of a pursuer at each of its turns: the number of the evader to chase, or 0 (inactive)."""
        raise NotImplementedError(f"{type(self).__name__} has no rule: write its actions(me)")

    def __call__(self, me: Agent) -> Process:
        """Run the schedule of a pursuer; at each turn, assign the next of `actions`.

        A pursuer that can only be inactive gets 0, and `actions` waits, unless `asks_without_choice` is set.

        Raises:
            TypeError: if `actions` is not a generator.
            ValueError: if `actions` ends, or the schedule is not a generator.
        """
        actions = self.actions(me)
        if not isinstance(actions, Iterator):
            raise TypeError(f"actions(me) of {type(self).__name__} should yield actions, not return {actions!r}")
        asks_always = self.asks_without_choice

        def revise() -> None:
            action = next(actions, None) if asks_always or me.has_choice() else 0
            if action is None:
                raise ValueError(f"actions(me) of {type(self).__name__} should never end: `while True`")
            me.assign(action)

        yield from turns(self.schedule, me, revise)


class LearningRule(Rule):
    """A rule that chooses by the utility of each action, given the believed actions of teammates."""

    utility: Annotated[Utility, UTILITIES] = Mean()
    """Utility of an active pursuer."""

    def utilities(self, me: Agent) -> dict[int, float]:
        """Return the utility, s, of each action that a pursuer may choose: 0 for inactivity, the gain for chasing.

        A gain is at least -1e9 s (`-MAX_TIME`), even if the pursuer can never capture, so that averages are finite.
        """
        utilities = {0: 0.0}
        for evader in me.options()[1:]:
            utilities[evader] = max(me.gain(self.utility, evader), -MAX_TIME)
        return utilities


def current_action(me: Agent, actions: Collection[int]) -> int:
    """Return the current action of a pursuer, or 0 if that action is not one of `actions`."""
    return me.action if me.action in actions else 0


def argmax(utilities: dict[int, float]) -> int:
    """Return the action of highest utility; ties go to the first, so inactivity is preferred to a chase of gain 0.

    Raises:
        ValueError: if the utilities are not a dict by action.
    """
    if not isinstance(utilities, dict):
        raise ValueError(
            f"argmax takes the utility of each action, {{0: 0.0, 1: 2.5}} for instance (got {utilities!r})"
        )
    return max(utilities, key=utilities.__getitem__)
