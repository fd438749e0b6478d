"""Schedules: when each pursuer revises its action.

A schedule is called with an agent and with what to do at its turn, and is the process that does it: it waits, calls
`revise`, and waits again. `mean_slot(me)` is the mean time delta between two revisions in the whole team.
"""

from collections.abc import Callable, Iterator
from itertools import count
from typing import Literal, Protocol

import numpy as np

from desim.pursuit.agent import Agent, Process
from desim.value import Period, Rate, Value


class Schedule(Protocol):
    """When a pursuer revises: `schedule(me, revise)` is the process that calls `revise()` at each of its turns."""

    def mean_slot(self, me: Agent) -> float:
        """Return the mean time delta between two revisions in the team, s."""
        ...

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process: ...  # noqa: D102


class SharedSeed(Value):
    """One pursuer a slot, drawn by everyone from the same seed: k delta belongs to whom the k-th draw names.

    Exactly the order of Lee & Bakolas, Algorithm 2, without a message. Assumes equal clocks.
    """

    kind: Literal["shared_seed"] = "shared_seed"
    slot: Period = 0.01
    """Length of a slot delta, s."""

    def mean_slot(self, me: Agent) -> float:
        """Return delta, s."""
        return self.slot

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise at the end of each slot that is one's own."""
        for k in owned_slots(me.id, me.team_size, me.shared_stream("slots")):
            yield me.at(k * self.slot)
            revise()


class Poisson(Value):
    """Every pursuer revises at the ticks of a Poisson clock of its own: asynchronous, no message, i.i.d. order."""

    kind: Literal["poisson"] = "poisson"
    rate: Rate = 5.0
    """Revisions per second of each pursuer, 1/s."""

    def mean_slot(self, me: Agent) -> float:
        """Return 1 / (N rate), s."""
        return 1.0 / (me.team_size * self.rate)

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise after independent exponential waits."""
        rng = me.stream("poisson")
        while True:
            yield me.sleep(rng.exponential(1.0 / self.rate))
            revise()


def owned_slots(owner: int, team_size: int, rng: np.random.Generator) -> Iterator[int]:
    """Yield the numbers k = 1, 2, ... of the slots that `rng` gives to one pursuer, uniformly among all."""
    block = 4096  # draws at a time; part of the definition of the sequence
    for first in count(1, block):
        yield from (first + np.flatnonzero(rng.integers(team_size, size=block) == owner)).tolist()
