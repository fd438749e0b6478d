"""Schedules: when each pursuer revises its action.

A schedule is called with an agent and with what to do at its turn, and is the process that does it: it waits, calls
`revise`, lets the pursuer announce its action, and waits again. `mean_slot(me)` is the mean time delta between two
revisions in the whole team.

Paper: SharedSeed: the order of Lee & Bakolas, Algorithm 2. Poisson: the asynchronous learning of Blume 1993. Rounds:
    synchronous learning, with q < 1 independent revisions as in Marden & Shamma 2012. Periodic: timers of real robots.
Parameters: of each, how often a pursuer revises.
Assumes: SharedSeed and Rounds equal clocks; Poisson and Periodic nothing.
Messages: none.
Robust to loss: yes, for nothing is sent.
"""

from collections.abc import Callable, Iterator
from itertools import count
from typing import Annotated, Any, ClassVar, Literal, Protocol

import numpy as np
from pydantic import Field

from desim.config.model import Period, Rate, Value
from desim.pursuit.agent import Agent, Process


class Schedule(Protocol):
    """When a pursuer revises: `schedule(me, revise)` is the process that calls `revise()` at each of its turns.

    One under which pursuers wait for each other has a method `without_turns()` as well, which returns the table of a
    schedule under which they do not.
    """

    def mean_slot(self, me: Agent) -> float:
        """Return the mean time delta between two revisions in the team, s."""
        ...

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process: ...  # noqa: D102


class SharedSeed(Value):
    """One pursuer a slot, drawn by everyone from the same seed: k delta belongs to whom the k-th draw names.

    Exactly the order of Lee & Bakolas, Algorithm 2, without a message. Assumes equal clocks.
    """

    assumes: ClassVar[tuple[str, ...]] = ("equal_clocks",)
    kind: Literal["shared_seed"] = "shared_seed"
    slot: Period = 0.01
    """Length of a slot delta, s."""

    def mean_slot(self, me: Agent) -> float:
        """Return delta, s."""
        return self.slot

    def without_turns(self) -> dict[str, Any]:
        """Return a schedule under which every slot is everybody's."""
        return {"kind": "synchronous", "schedule": self}

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise at the end of each slot that is one's own."""
        for k in owned_slots(me.id, me.team_size, me.shared_stream("slots")):
            if k * self.slot >= me.now:  # not one that was over before a fast clock began or while one was broken down
                yield me.at(k * self.slot)
                revise()
                me.announce()


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
            me.announce()


class Rounds(Value):
    """At every round everybody revises, or each with a probability, before anybody says what it has decided.

    No Gibbs law, but on the relay game the fastest to settle: a round takes the time that others need for one revision.
    The theorem of Marden & Shamma 2012 on independent revisions does not apply either: its probability of revising
    vanishes with tau, as exp(-m / tau), while q is constant.
    """

    assumes: ClassVar[tuple[str, ...]] = ("equal_clocks",)
    at_once: ClassVar[bool] = True
    """Several may revise at the same instant."""
    kind: Literal["rounds"] = "rounds"
    period: Period = 0.1
    """Time between two rounds, s."""
    participation: Annotated[float, Field(gt=0, le=1, strict=True)] = 1.0
    """Probability that a pursuer revises in a round, in (0, 1]."""

    def mean_slot(self, me: Agent) -> float:
        """Return period / (q N), s."""
        return self.period / (self.participation * me.team_size)

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise at the end of each round, or not, by chance."""
        rng = me.stream("rounds")
        for tick in ticks(me, self.period, first=1):
            yield me.at(tick)
            if rng.random() < self.participation:
                revise()
                yield me.after_decisions()
                me.announce()


class Periodic(Value):
    """Every pursuer revises at the ticks of a timer of its own, from a random phase on.

    A strictly periodic timer whose period is an even multiple of the motion step keeps step with the evader's chatter
    between two nearest pursuers and may see the same picture for seconds; some jitter breaks that.
    """

    kind: Literal["periodic"] = "periodic"
    period: Period = 0.2
    """Mean time between two revisions of a pursuer, s."""
    jitter: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.5
    """Greatest share by which a wait is longer or shorter than the period, in [0, 1)."""

    def mean_slot(self, me: Agent) -> float:
        """Return period / N, s."""
        return self.period / me.team_size

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise after each wait of about a period."""
        rng = me.stream("periodic")
        yield me.sleep(rng.uniform(0.0, self.period))
        while True:
            revise()
            me.announce()
            yield me.sleep(self.period * rng.uniform(1.0 - self.jitter, 1.0 + self.jitter))

    def warnings(self, step: float) -> Iterator[tuple[str, str]]:
        """Yield why a timer without jitter and a motion step (s) hardly go together: the key, and the reason."""
        multiple = self.period / step
        if self.jitter == 0.0 and abs(multiple - 2 * round(multiple / 2)) < 1e-6 * multiple:
            yield (
                "jitter",
                f"a strictly periodic timer of {round(multiple)} motion steps, an even number, keeps step with the"
                " evader's chatter between two pursuers, and for seconds nobody may be active: give it some jitter",
            )


def ticks(me: Agent, period: float, first: int = 0, phase: float = 0.0) -> Iterator[float]:
    """Yield the instants phase + k * period (s), k = first, first + 1, ..., from now on, by the own clock, s.

    Those are left out that pass meanwhile, because the pursuer is broken down or its clock began late.
    """
    for k in count(first):
        tick = phase + k * period
        if tick >= me.now:
            yield tick


def owned_slots(owner: int, team_size: int, rng: np.random.Generator) -> Iterator[int]:
    """Yield the numbers k = 1, 2, ... of the slots that `rng` gives to one pursuer, uniformly among all."""
    block = 4096  # draws at a time; part of the definition of the sequence
    for first in count(1, block):
        yield from (first + np.flatnonzero(rng.integers(team_size, size=block) == owner)).tolist()
