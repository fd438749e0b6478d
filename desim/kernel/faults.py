"""Faults: what breaks, when, and for how long, as frozen models; `desim.kernel.fault_injection` lets them happen.

A fault is a value with a time at which it begins and one at which it is over. A plan is a value that draws such faults
from the seed. Both are kinds of `[[fault]]` in a scenario file.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import count
from math import inf
from typing import Annotated, Any, Literal, NamedTuple, Protocol

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from desim.config.choice import OneOf
from desim.config.model import Box, Coordinate, Duration, Extent, Flag, Length, Rate, Time, Value
from desim.kernel.events import Nanoseconds
from desim.kernel.graphs import Node
from desim.kernel.seeds import stream


class _Window(Value):
    """What all faults share: they are open for a while."""

    start: Time
    """When it begins, s."""
    end: Extent = inf
    """When it is over, s; inf = never."""

    @field_validator("end")
    @classmethod
    def _after_it_begins(cls, end: float, info: ValidationInfo) -> float:
        if end <= info.data.get("start", 0.0):
            raise ValueError(f"should be later than start (got {end:g} and {info.data['start']:g})")
        return end


class Crash(_Window):
    """A node breaks down and, perhaps, recovers."""

    kind: Literal["crash"] = "crash"
    node: Node
    """Which node: in a pursuit, the number of the pursuer."""
    scope: Literal["radio", "robot"] = "robot"
    """radio: it neither sends nor receives; robot: it does not move or decide either."""
    memory: Flag = True
    """Whether it recovers with what it knew; if not, it has heard of nobody, and a robot starts anew."""


class Partition(_Window):
    """Groups of nodes cannot hear each other."""

    kind: Literal["partition"] = "partition"
    groups: Annotated[tuple[tuple[Node, ...], ...], Field(min_length=1)]
    """Lists of nodes; those that are in no list form one more group."""

    @field_validator("groups")
    @classmethod
    def _disjoint(cls, groups: tuple[tuple[int, ...], ...]) -> tuple[tuple[int, ...], ...]:
        named = [node for group in groups for node in group]
        twice = sorted({node for node in named if named.count(node) > 1})
        if twice:
            raise ValueError(f"should be disjoint, {twice[0]} is named twice")
        return groups


class Jamming(_Window):
    """Nobody within a disc hears anything."""

    kind: Literal["jamming"] = "jamming"
    centre: tuple[Coordinate, Coordinate]
    """[x, y], m."""
    radius: Length
    """m"""


class ClockSkew(Value):
    """A node whose clock shows offset + (1 + drift) t at the time t."""

    kind: Literal["clock_skew"] = "clock_skew"
    node: Node | None = None
    """Who; if absent, everybody: then offset and drift are the standard deviations of normal draws."""
    offset: Annotated[float, Field(ge=-1e6, le=1e6, strict=True)] = 0.0
    """s"""
    drift: Annotated[float, Field(gt=-1, le=1e3, strict=True)] = 0.0
    """Seconds gained per second."""


Fault = Crash | Partition | Jamming
"""Something that is broken for a while."""


class FaultStarted(NamedTuple):
    """A fault began."""

    t: Nanoseconds
    fault: Annotated[Fault, Field(discriminator="kind")]


class FaultEnded(NamedTuple):
    """A fault was over."""

    t: Nanoseconds
    fault: Annotated[Fault, Field(discriminator="kind")]


class FaultPlan(Protocol):
    """What draws faults: `plan(size, horizon, rng)`."""

    def __call__(self, size: int, horizon: float, rng: np.random.Generator) -> Iterable[Fault]:
        """Return the faults among `size` nodes until the horizon, s."""
        ...


class RandomCrashes(Value):
    """Every node breaks down at a rate, for an exponential time."""

    kind: Literal["random_crashes"] = "random_crashes"
    rate: Rate = 0.1
    """Breakdowns per second of each node that is up, 1/s."""
    mean_downtime: Duration = 1.0
    """Mean time until it recovers, s."""
    scope: Literal["radio", "robot"] = "robot"
    """radio: it neither sends nor receives; robot: it does not move or decide either."""
    memory: Flag = True
    """Whether it recovers with what it knew."""

    def __call__(self, size: int, horizon: float, rng: np.random.Generator) -> Iterator[Crash]:
        """Yield the crashes of each node until the horizon, s."""
        for node, each in enumerate(rng.spawn(size)):
            t = each.exponential(1.0 / self.rate)
            while t < horizon:
                until = t + max(each.exponential(self.mean_downtime), MIN_FAULT_DURATION)
                yield Crash(start=t, end=until, node=node, scope=self.scope, memory=self.memory)
                t = until + each.exponential(1.0 / self.rate)


class RandomFaults(Value):
    """Crashes, partitions and jamming of all sorts, at random: for soak runs."""

    kind: Literal["random"] = "random"
    rate: Rate = 1.0
    """Faults per second, 1/s."""
    mean_duration: Duration = 1.0
    """Mean duration of a fault, s."""
    end: Extent = inf
    """When the last fault is over at the latest, s."""
    kinds: Annotated[tuple[Literal["crash", "partition", "jamming"], ...], Field(min_length=1)] = (
        "crash",
        "partition",
        "jamming",
    )
    """What may happen."""
    box: Box = (0.0, 20.0)
    """Lower and upper bound of both coordinates of the centres of jamming discs, m."""

    def __call__(self, size: int, horizon: float, rng: np.random.Generator) -> Iterator[Fault]:
        """Yield the faults that begin before the horizon, s, in order of time."""
        t, end = 0.0, min(self.end, horizon)
        while (t := t + rng.exponential(1.0 / self.rate)) < end - MIN_FAULT_DURATION:
            duration = max(rng.exponential(self.mean_duration), MIN_FAULT_DURATION)
            window = {"start": t, "end": min(t + duration, self.end)}
            yield self._fault(self.kinds[rng.integers(len(self.kinds))], size, rng, window)

    def _fault(self, kind: str, size: int, rng: np.random.Generator, window: dict[str, float]) -> Fault:
        if kind == "crash":
            scope: Any = ("radio", "robot")[rng.integers(2)]
            return Crash(node=int(rng.integers(size)), scope=scope, memory=bool(rng.integers(2)), **window)
        if kind == "partition":
            cut = rng.permutation(size)[: rng.integers(1, max(size, 2))]
            return Partition(groups=(tuple(sorted(cut.tolist())),), **window)
        x, y = rng.uniform(*self.box, size=2).tolist()
        radius = rng.uniform(0.1, 0.5) * max(self.box[1] - self.box[0], 1.0)
        return Jamming(centre=(x, y), radius=float(radius), **window)


MIN_FAULT_DURATION = 1e-6
"""No drawn fault is shorter, s."""
FAULTS = OneOf(Crash, Partition, Jamming, RandomCrashes, RandomFaults, ClockSkew)


def clock_errors(given: Iterable[object], size: int, seed: int) -> list[tuple[float, float]]:
    """Return (offset in s, drift) of each node's clock; later skews add to earlier ones."""
    errors = np.zeros((size, 2))
    for k, skew in enumerate(each for each in given if isinstance(each, ClockSkew)):
        if skew.node is None:
            errors += stream(seed, "clocks", k).standard_normal((size, 2)) * (abs(skew.offset), abs(skew.drift))
        else:
            errors[skew.node] += skew.offset, skew.drift
    errors[:, 1] = np.maximum(errors[:, 1], MIN_CLOCK_RATE)
    return [(offset, drift) for offset, drift in errors.tolist()]


MIN_CLOCK_RATE = -0.99
"""A clock that ran backwards would be none."""


def draw_faults(given: Sequence[Fault | FaultPlan | ClockSkew], size: int, horizon: float, seed: int) -> list[Fault]:
    """Return faults with every plan replaced by what it draws; the k-th plan has a stream of its own."""
    faults: list[Fault] = []
    number = count()
    for each in given:
        if isinstance(each, Fault):
            faults.append(each)
        elif not isinstance(each, ClockSkew):
            found = each(size, horizon, stream(seed, "faults", next(number)))
            if found is None:
                raise ValueError(f"the plan {each!r} should return or yield faults, got None")
            faults += found
    return faults
