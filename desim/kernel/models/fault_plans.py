"""Plans that draw faults at random from the seed, and the list of all kinds of `[[fault]]`.

A plan is called once in a run, as `plan(size, horizon, rng)`, and returns the faults of the whole run.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import count, islice
from math import inf
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import PlainSerializer, PlainValidator, ValidationInfo, WithJsonSchema

from desim.config.answers import wrong_answer
from desim.config.arguments import value_text
from desim.config.choice import OneOf, kind_of
from desim.config.model import Box, Duration, Extent, FirstError, Flag, NotEmpty, Rate, Value
from desim.config.named_code import import_name, named_in_file
from desim.config.suggestion import did_you_mean
from desim.config.traits import inherits
from desim.kernel.core.seeds import stream
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.faults import BUILT_IN, Crash, Fault, MessageFault, RandomDraw
from desim.kernel.models.traits import FaultTraits

PLANNED_WITH = ("size", "horizon", "rng")
"""The arguments of a plan of faults."""
MAX_FAULTS = 1_000_000
"""Largest number of faults of a plan, which may be a generator without an end."""
FaultPlan = Callable[[int, float, np.random.Generator], Iterable[Fault]]
"""A model that draws faults: `plan(size, horizon, rng)` returns those of `size` nodes up to the horizon, s."""
MIN_FAULT_DURATION = 1e-6
"""Minimum duration of a drawn fault, s."""


class RandomCrashes(Value):
    """Each node crashes at a constant rate, for exponentially distributed downtimes."""

    kind: Literal["random_crashes"] = "random_crashes"
    rate: Rate = 0.1
    """Crash rate of each node that is up, 1/s.

    If in doubt, 1 / (horizon of the run), about one crash of each node.
    """
    mean_downtime: Duration = 1.0
    """Mean time until a crashed node recovers, s.

    If in doubt, a few time-outs of the protocol: a node that is back sooner is not missed.
    """
    scope: Literal["radio", "robot"] = "robot"
    """radio: the node neither sends nor receives; robot: it does not move or decide either."""
    memory: Flag = True
    """Whether the node keeps its beliefs."""

    breaks: ClassVar[frozenset[str]] = Crash.breaks
    is_scheduled: ClassVar[bool] = True

    @property
    def messages_only(self) -> bool:
        """Whether only radios are down."""
        return self.scope == "radio"

    def __call__(self, size: int, horizon: float, rng: np.random.Generator) -> Iterator[Crash]:
        """Yield, node by node, the crashes that start before the horizon, s."""
        for node, node_rng in enumerate(rng.spawn(size)):
            t = node_rng.exponential(1.0 / self.rate)
            while t < horizon:
                end = t + max(node_rng.exponential(self.mean_downtime), MIN_FAULT_DURATION)
                yield Crash(start=t, end=end, node=node, scope=self.scope, memory=self.memory)
                t = end + node_rng.exponential(1.0 / self.rate)


def _fault_kind(value: Any, info: ValidationInfo) -> str | type[Fault]:
    """Return the kind of a built-in fault, or the class of a user's, given as a class or "module:Name"."""
    if value in _BY_KIND:
        return str(value)
    if isinstance(value, str) and ":" in value:
        value = named_in_file(value, info)
    if not (isinstance(value, type) and issubclass(value, Fault)):
        hint = did_you_mean(value, _BY_KIND) if isinstance(value, str) else ""
        classes = 'a class that derives from Fault as "module:Name"'
        raise ValueError(f"should be {', '.join(_BY_KIND)}, or {classes}{hint} (got {value_text(value)})")
    return value


def _class_of(kind: str | type[Fault]) -> type[Fault]:
    return _BY_KIND[kind] if isinstance(kind, str) else kind


_BY_KIND: Mapping[str, type[Fault]] = MappingProxyType({kind_of(model): model for model in BUILT_IN})
FaultKind = Annotated[
    Any,
    PlainValidator(_fault_kind),
    PlainSerializer(lambda kind: kind if isinstance(kind, str) else import_name(kind), return_type=str),
    WithJsonSchema({"type": "string"}),
]
"""A kind of faults of the network: the name of a built-in one, or the class of a user."""


class RandomFaults(Value):
    """Random crashes, partitions and jamming with random parameters, for soak tests."""

    kind: Literal["random"] = "random"
    rate: Rate = 1.0
    """Rate of faults, 1/s.

    If in doubt, about ten faults in a run; with rate times `mean_duration` above 1, several overlap most of the time.
    """
    mean_duration: Duration = 1.0
    """Mean duration of a fault, s."""
    end: Extent = inf
    """Time by which all faults have ended, s."""
    kinds: Annotated[tuple[FaultKind, ...], FirstError(), NotEmpty()] = ("crash", "partition", "jamming")
    """The kinds of faults to draw: crash, partition, jamming, or a fault of a user as "module:Name", in Python its
    class."""
    box: Box = (0.0, 20.0)
    """Lower and upper bound of both coordinates of the centres of jamming discs, m. Their radii are 0.1 to 0.5 of the
    difference."""

    @property
    def breaks(self) -> frozenset[str]:
        """The assumptions that the kinds of faults break."""
        return frozenset[str]().union(*(_class_of(kind).breaks for kind in self.kinds))

    @property
    def messages_only(self) -> bool:
        """Whether no robot can break down: a kind derived from `Crash` may draw a crash of a robot."""
        return not any(issubclass(_class_of(kind), Crash) for kind in self.kinds)

    @property
    def memory(self) -> bool:
        """Whether all nodes keep their memory: only a kind derived from `Crash` may erase it."""
        return self.messages_only

    @property
    def is_scheduled(self) -> bool:
        """Whether all kinds are built in; what a fault of a user does may depend on the state of the run."""
        return all(isinstance(kind, str) for kind in self.kinds)

    def __call__(self, size: int, horizon: float, rng: np.random.Generator) -> Iterator[Fault]:
        """Yield the faults that start before `end` and the horizon, s, ordered by start time."""
        t, end, draw = 0.0, min(self.end, horizon), RandomDraw(size, self.box, rng)
        while (t := t + rng.exponential(1.0 / self.rate)) < end - MIN_FAULT_DURATION:
            duration = max(rng.exponential(self.mean_duration), MIN_FAULT_DURATION)
            window = {"start": t, "end": min(t + duration, self.end)}
            kind = _class_of(self.kinds[rng.integers(len(self.kinds))])
            yield kind(**window, **kind.random_parameters(draw))


FAULTS = OneOf(*BUILT_IN, MessageFault, RandomCrashes, RandomFaults, ClockSkew, takes=PLANNED_WITH, traits=FaultTraits)
"""The kinds of `[[fault]]` of a network; a pursuit adds those that need more than a network."""


def draw_faults(entries: Sequence[Fault | FaultPlan | ClockSkew], size: int, horizon: float, seed: int) -> list[Fault]:
    """Return all faults, in the order of the entries: faults themselves, and the faults that each plan draws.

    Clock errors are left out. Every plan has its own random stream.

    Raises:
        ValueError: if a plan returns or yields anything else than faults, or does not end.
    """
    faults: list[Fault] = []
    plan_numbers = count()
    for entry in entries:
        if inherits(entry, Fault):  # its `__call__` would yield the fault itself
            faults.append(entry)
        elif not isinstance(entry, ClockSkew):
            answer: Any = entry(size, horizon, stream(seed, "faults", next(plan_numbers)))
            planned: list[Any] = [*islice(answer, MAX_FAULTS + 1)] if isinstance(answer, Iterable) else [answer]
            if len(planned) > MAX_FAULTS:
                expected = f"a plan should end, with no fault after the horizon, and has over {MAX_FAULTS:,} faults"
                raise wrong_answer(expected, planned[-1], entry)
            if wrong := [fault for fault in planned if not isinstance(fault, Fault)]:
                raise wrong_answer("a plan should return or yield faults of the network", wrong[0], entry)
            faults += planned
    return faults
