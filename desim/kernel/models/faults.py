"""Faults as frozen models: crashes, partitions, jamming, clock errors. `desim.kernel.fault_injection` applies them.

A crash, a partition or a jamming disc has a start time and an end time; a clock error lasts for the whole run. A fault
plan draws faults at random from the seed. All of these are kinds of `[[fault]]` in a scenario file.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import count
from math import inf
from typing import Annotated, Any, Literal, NamedTuple, Protocol

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from desim.config.choice import OneOf
from desim.config.model import Box, Coordinate, Duration, Extent, FirstError, Flag, Length, NotEmpty, Rate, Time, Value
from desim.kernel.core.events import Nanoseconds
from desim.kernel.core.seeds import stream
from desim.kernel.models.graphs import Node

MIN_DRIFT = -0.99
"""Lower bound of the drift of a clock, so that no clock stands still or runs backwards."""


class Window(Value):
    """Base of the faults that have a start and an end time."""

    start: Time
    """Start time, s."""
    end: Extent = inf
    """End time, s; inf = never."""

    @field_validator("end")
    @classmethod
    def _ends_after_start(cls, end: float, info: ValidationInfo) -> float:
        if end <= info.data.get("start", 0.0):
            raise ValueError(f"should be later than start (got {end:g} and {info.data['start']:g})")
        return end


class Crash(Window):
    """A node crashes and, if the crash ends, recovers."""

    kind: Literal["crash"] = "crash"
    node: Node
    """The node that crashes; in a pursuit, the number of the pursuer."""
    scope: Literal["radio", "robot"] = "robot"
    """radio: the node neither sends nor receives; robot: it does not move or decide either."""
    memory: Flag = True
    """Whether the node keeps its beliefs; if not, it recovers without any, and a crashed robot restarts its process."""


class Partition(Window):
    """Groups of nodes cannot communicate with each other."""

    kind: Literal["partition"] = "partition"
    groups: Annotated[tuple[Annotated[tuple[Node, ...], FirstError()], ...], FirstError(), NotEmpty()]
    """Lists of nodes; nodes in no list form one more group."""

    @field_validator("groups")
    @classmethod
    def _disjoint(cls, groups: tuple[tuple[int, ...], ...]) -> tuple[tuple[int, ...], ...]:
        named = [node for group in groups for node in group]
        twice = sorted({node for node in named if named.count(node) > 1})
        if twice:
            raise ValueError(f"should be disjoint, node {twice[0]} is listed twice")
        return groups


class Jamming(Window):
    """No node within a disc receives messages."""

    kind: Literal["jamming"] = "jamming"
    centre: tuple[Coordinate, Coordinate]
    """[x, y], m."""
    radius: Length
    """m"""


class Misbehaviour(Window):
    """A node does not follow its protocol; the network carries what it sends like any other message.

    It has no effect here: a model of a higher layer draws it, and acts on it.
    """

    kind: Literal["misbehaviour"] = "misbehaviour"
    node: Node
    """The node that misbehaves."""
    model: str
    """The kind of the model."""
    number: Annotated[int, Field(ge=0, strict=True)]
    """Number of the misbehaviour in the run, from 0 on."""


class ClockSkew(Value):
    """The clock of a node shows offset + (1 + drift) t + x(t) at the time t, where x is a random walk.

    Without a walk the error is a straight line, which a protocol could fit once and for all. The variance of x is
    offset_walk^2 t + drift_walk^2 t^3 / 3; see `desim.kernel.wandering_clock`.
    """

    kind: Literal["clock_skew"] = "clock_skew"
    node: Node | None = None
    """The node. If absent, each node draws its errors from normal distributions with mean 0; offset and drift are their
    standard deviations."""
    offset: Annotated[float, Field(ge=-1e6, le=1e6, strict=True)] = 0.0
    """s"""
    drift: Annotated[float, Field(ge=MIN_DRIFT, le=1e3, strict=True)] = 0.0
    """Seconds gained per second; if the sum of the drifts of a node is below -0.99, it is raised to -0.99."""
    offset_walk: Annotated[float, Field(ge=0, le=1.0, strict=True)] = 0.0
    """Random walk of the offset, s per sqrt(s), from white noise of the frequency: after a time t its standard
    deviation is offset_walk sqrt(t). Each node has a walk of its own."""
    drift_walk: Annotated[float, Field(ge=0, le=1.0, strict=True)] = 0.0
    """Random walk of the drift, 1 per sqrt(s): after a time t its standard deviation is drift_walk sqrt(t)."""


Fault = Crash | Partition | Jamming
"""A fault of the network, with a start and an end time."""
TracedFault = Fault | Misbehaviour
"""A fault whose start and end are events of the trace."""


def nodes_of(fault: object) -> list[int]:
    """Return the nodes that a fault or a clock error names."""
    if isinstance(fault, Partition):
        return [node for group in fault.groups for node in group]
    return [fault.node] if isinstance(fault, Crash | Misbehaviour | ClockSkew) and fault.node is not None else []


class FaultStarted(NamedTuple):
    """A fault started."""

    t: Nanoseconds
    fault: Annotated[TracedFault, Field(discriminator="kind")]


class FaultEnded(NamedTuple):
    """A fault ended."""

    t: Nanoseconds
    fault: Annotated[TracedFault, Field(discriminator="kind")]


class FaultPlan(Protocol):
    """A model that draws faults: `plan(size, horizon, rng)`."""

    def __call__(self, size: int, horizon: float, rng: np.random.Generator) -> Iterable[Fault]:
        """Draw and return the faults of `size` nodes up to the horizon, s."""
        ...


class RandomCrashes(Value):
    """Each node crashes at a constant rate, for exponentially distributed downtimes."""

    kind: Literal["random_crashes"] = "random_crashes"
    rate: Rate = 0.1
    """Crash rate of each node that is up, 1/s."""
    mean_downtime: Duration = 1.0
    """Mean time until a crashed node recovers, s."""
    scope: Literal["radio", "robot"] = "robot"
    """radio: the node neither sends nor receives; robot: it does not move or decide either."""
    memory: Flag = True
    """Whether the node keeps its beliefs."""

    def __call__(self, size: int, horizon: float, rng: np.random.Generator) -> Iterator[Crash]:
        """Yield, node by node, the crashes that start before the horizon, s."""
        for node, each in enumerate(rng.spawn(size)):
            t = each.exponential(1.0 / self.rate)
            while t < horizon:
                end = t + max(each.exponential(self.mean_downtime), MIN_FAULT_DURATION)
                yield Crash(start=t, end=end, node=node, scope=self.scope, memory=self.memory)
                t = end + each.exponential(1.0 / self.rate)


class RandomFaults(Value):
    """Random crashes, partitions and jamming with random parameters, for soak tests."""

    kind: Literal["random"] = "random"
    rate: Rate = 1.0
    """Rate of faults, 1/s."""
    mean_duration: Duration = 1.0
    """Mean duration of a fault, s."""
    end: Extent = inf
    """Time by which all faults have ended, s."""
    kinds: Annotated[tuple[Literal["crash", "partition", "jamming"], ...], Field(min_length=1)] = (
        "crash",
        "partition",
        "jamming",
    )
    """The kinds of faults to draw."""
    box: Box = (0.0, 20.0)
    """Lower and upper bound of both coordinates of the centres of jamming discs, m."""

    def __call__(self, size: int, horizon: float, rng: np.random.Generator) -> Iterator[Fault]:
        """Yield the faults that start before `end` and the horizon, s, ordered by start time."""
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


PLANNED_WITH = ("size", "horizon", "rng")
"""The arguments of a plan of faults."""
MIN_FAULT_DURATION = 1e-6
"""Minimum duration of a drawn fault, s."""
FAULTS = OneOf(Crash, Partition, Jamming, RandomCrashes, RandomFaults, ClockSkew, takes=PLANNED_WITH)


def clock_errors(given: Iterable[object], size: int, seed: int) -> list[tuple[float, float]]:
    """Return (offset in s, drift) of the clock of each node, summed over all `ClockSkew` in `given`.

    A `ClockSkew` without a node adds an error drawn for each node. A sum of drifts below `MIN_DRIFT` is raised
    to it.
    """
    errors = np.zeros((size, 2))
    for k, skew in enumerate(each for each in given if isinstance(each, ClockSkew)):
        if skew.node is None:
            errors += stream(seed, "clocks", k).standard_normal((size, 2)) * (abs(skew.offset), abs(skew.drift))
        else:
            errors[skew.node] += skew.offset, skew.drift
    errors[:, 1] = np.maximum(errors[:, 1], MIN_DRIFT)
    return [(offset, drift) for offset, drift in errors.tolist()]


def draw_faults(given: Sequence[Fault | FaultPlan | ClockSkew], size: int, horizon: float, seed: int) -> list[Fault]:
    """Draw the faults of each plan, and return them with the given faults; clock errors are left out.

    Every plan has its own random stream.

    Raises:
        ValueError: if a plan returns or yields anything else than faults.
    """
    faults: list[Fault] = []
    number = count()
    for each in given:
        if isinstance(each, Fault):
            faults.append(each)
        elif not isinstance(each, ClockSkew):
            found: Any = each(size, horizon, stream(seed, "faults", next(number)))
            planned: list[Any] = [*found] if isinstance(found, Iterable) else [found]
            if strange := [fault for fault in planned if not isinstance(fault, Fault)]:
                raise ValueError(f"the plan {each!r} should return or yield faults, got {strange[0]!r}")
            faults += planned
    return faults
