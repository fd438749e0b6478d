"""Schedules: when each pursuer revises its action.

A schedule is called with an agent and a function `revise`. It returns a process that repeatedly waits, calls `revise`,
and lets the pursuer announce its action. `mean_slot(me)` is delta, the mean time between two revisions in the whole
team.

Paper: SharedSeed: the order of Lee & Bakolas, Algorithm 2. Poisson: the asynchronous learning of Blume 1993. Rounds:
    synchronous learning; if participation < 1, independent revisions as in Marden & Shamma 2012. Periodic: none; it
    models the timers of real robots.
Parameters: for each, the period or rate of revisions.
Assumes: for SharedSeed and Rounds, equal clocks; for Poisson and Periodic, nothing.
Messages: none besides announcements.
Robust to loss: yes, because the times of revisions do not depend on messages.
"""

from collections.abc import Callable, Iterator
from itertools import count
from math import inf
from typing import Annotated, Any, ClassVar, Literal, Protocol, Self

import numpy as np
from pydantic import Field

from desim.config.answers import wrong_answer
from desim.config.model import Period, Rate, Value
from desim.config.python_numbers import as_real
from desim.pursuit.team.agent import Agent, Process


class Schedule(Protocol):
    """When a pursuer revises: `schedule(me, revise)` is the process that calls `revise()` at each of its turns.

    A schedule may have the attributes of `desim.pursuit.core.traits.ScheduleTraits`.
    """

    def mean_slot(self, me: Agent) -> float:
        """Return delta, the mean time between two revisions in the team, s."""
        ...

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process: ...  # noqa: D102


class SharedSeed(Value):
    """One pursuer revises per slot: at time k delta, the k-th pursuer of a random sequence.

    All pursuers draw the same sequence from a shared seed. This is the order of Lee & Bakolas, Algorithm 2. It needs no
    messages, but equal clocks.
    """

    assumes: ClassVar[tuple[str, ...]] = ("equal_clocks",)
    kind: Literal["shared_seed"] = "shared_seed"
    slot: Period = 0.01
    """Length delta of a slot, s.

    In a slot shorter than the latency of an announcement, a pursuer decides before it hears of the last decision; long
    slots make a pursuer wait for N of them on average.

    If in doubt, use the latency, and at least the motion step.
    """

    def mean_slot(self, me: Agent) -> float:
        """Return delta, s."""
        return self.slot

    def without_serial_decisions(self) -> dict[str, Any]:
        """Return the table, as in a scenario file, of a schedule in which all pursuers revise in every slot."""
        return {"kind": "synchronous", "schedule": self}

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise at the end of each slot that belongs to the pursuer."""
        slot = self.slot
        for k in owned_slots(me.id, me.team_size, me.shared_stream("slots")):
            if k * slot >= me.now:  # skip slots in the past, after a crash or if the clock is ahead
                yield me.at(k * slot)
                revise()
                me.announce()


class Poisson(Value):
    """Each pursuer revises at the ticks of its own Poisson clock.

    Each revising pursuer is therefore an independent uniform draw from the team.
    """

    kind: Literal["poisson"] = "poisson"
    rate: Rate = 5.0
    """Revisions per second of each pursuer, 1/s.

    With a low rate the team reacts late. At a high one, decisions fall within the latency of each other and are based
    on old beliefs.

    If in doubt, use 5, and at most 1 / (N times the latency).
    """

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
    """In every round each pursuer revises with probability `participation`; announcements follow all decisions.

    In rounds, the stationary distribution of log-linear learning is not the Gibbs distribution. With a `participation`
    of 1 the team settles fastest in the game with one evader, because all pursuers revise at once.

    The theorem of Marden & Shamma 2012 on independent revisions does not apply. In the theorem the probability of
    revising tends to 0 with tau, as exp(-m / tau) for a constant m; here `participation`, q, is constant.
    """

    assumes: ClassVar[tuple[str, ...]] = ("equal_clocks",)
    at_once: ClassVar[bool] = True
    """Several pursuers may revise at the same instant."""
    kind: Literal["rounds"] = "rounds"
    period: Period = 0.1
    """Time between two rounds, s.

    In a period shorter than the latency of an announcement, a round begins before the decisions of the last one are
    known.

    If in doubt, use twice the latency, and at least 0.1.
    """
    participation: Annotated[float, Field(gt=0, le=1, strict=True)] = 1.0
    """Probability that a pursuer revises in a round, in (0, 1].

    With 1 all revise at once, and rules without inertia may swap actions for ever; with a small one few revise.

    If in doubt, use 1 for rules with inertia, and else 0.5.
    """

    def mean_slot(self, me: Agent) -> float:
        """Return period / (q N), s, where q is `participation`."""
        return self.period / (self.participation * me.team_size)

    def for_all(self) -> Self:
        """Return the rounds in which every pursuer revises."""
        return self.model_copy(update={"participation": 1.0})

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise at the end of each round with probability `participation`."""
        rng = me.stream("rounds")
        for tick in ticks(me, self.period, first=1):
            yield me.at(tick)
            if rng.random() < self.participation:
                revise()
                yield me.after_decisions()
                me.announce()


class Periodic(Value):
    """Each pursuer revises at the ticks of its own timer with a random phase.

    Use some jitter. An evader may chatter between its two nearest pursuers: it flees from one of them in even motion
    steps and from the other in odd ones. Without jitter, a timer whose period is an even number of motion steps is
    synchronous with the evader and may sample the same state for seconds.
    """

    kind: Literal["periodic"] = "periodic"
    period: Period = 0.2
    """Mean time between two revisions of a pursuer, s."""
    jitter: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.5
    """Largest share by which a wait is longer or shorter than the period, in [0, 1).

    If in doubt, use 0.5.
    """

    def mean_slot(self, me: Agent) -> float:
        """Return period / N, s."""
        return self.period / me.team_size

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise after waits of one period, varied by the jitter; the first wait is the random phase."""
        rng = me.stream("periodic")
        yield me.sleep(rng.uniform(0.0, self.period))
        while True:
            revise()
            me.announce()
            yield me.sleep(self.period * rng.uniform(1.0 - self.jitter, 1.0 + self.jitter))

    def warnings(self, step: float) -> Iterator[tuple[str, str]]:
        """Yield a warning, (key, reason), if the timer is synchronous with the motion step (s)."""
        steps = self.period / step
        if self.jitter == 0.0 and abs(steps - 2 * round(steps / 2)) < 1e-6 * steps:
            yield (
                "jitter",
                f"a strictly periodic timer of {round(steps)} motion steps, an even number, is synchronous with an"
                " evader that chatters between two pursuers, so possibly no pursuer is active for seconds: give it some"
                " jitter",
            )


def turns(schedule: Schedule, me: Agent, revise: Callable[[], None]) -> Process:
    """Return the process of a schedule for one pursuer.

    Raises:
        AnswerError: if a user's schedule returns no generator.
    """
    process = schedule(me, revise)
    if not isinstance(process, Iterator):
        raise wrong_answer("a schedule should be a generator that yields the events it waits for", process, schedule)
    return process


def slot_length(schedule: Schedule, me: Agent) -> float:
    """Return `mean_slot(me)` of a schedule, s.

    Raises:
        ValueError: if a user's schedule returns anything else than a finite time greater than 0.
    """
    mean_slot: Any = schedule.mean_slot
    answer = mean_slot(me) if callable(mean_slot) else None
    slot = as_real(answer)
    if not 0.0 < slot < inf:
        raise wrong_answer("mean_slot(me) should return a finite time > 0 s", answer, schedule)
    return slot


def ticks(me: Agent, period: float, first: int = 0, phase: float = 0.0) -> Iterator[float]:
    """Yield the instants phase + k * period, k = first, first + 1, ..., on the local clock, s.

    Instants in the past, such as those during a crash, are skipped.
    """
    for k in count(first):
        tick = phase + k * period
        if tick >= me.now:
            yield tick


def owned_slots(owner: int, team_size: int, rng: np.random.Generator) -> Iterator[int]:
    """Yield the numbers of the slots of one pursuer, from 1 on; `rng` draws the owner of each slot uniformly."""
    block = 4096  # number of draws at once; do not change it, because the sequence of a seed may depend on it
    for first in count(1, block):
        yield from (first + np.flatnonzero(rng.integers(team_size, size=block) == owner)).tolist()
