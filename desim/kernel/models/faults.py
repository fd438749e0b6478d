"""Faults as frozen models: crashes, partitions, jamming, clock errors. `desim.kernel.fault_injection` applies them.

A crash, a partition or a jamming disc has a start time and an end time; a clock error lasts for the whole run. A fault
plan draws faults at random from the seed. All of these are kinds of `[[fault]]` in a scenario file.

A kind of faults is a class that derives from `Fault`. It says how the fault begins and ends (`begin`), which nodes it
names (`named`), how a page draws it (`sketch`), and what a loss by it is called (`cause`).
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import count, islice
from math import inf
from operator import index
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Protocol, Self

import numpy as np
from pydantic import (
    Field,
    PlainSerializer,
    PlainValidator,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from desim.config.answers import wrong_answer
from desim.config.choice import (
    OneOf,
    check_call,
    definition_of,
    import_name,
    is_unlisted_import,
    kind_of,
    load_named,
    refusal,
)
from desim.config.model import Box, Coordinate, Duration, Extent, FirstError, Flag, Length, NotEmpty, Rate, Time, Value
from desim.config.suggestion import did_you_mean
from desim.config.traits import inherits, positions
from desim.config.trust import is_trusted
from desim.kernel.core.events import Cause, Nanoseconds
from desim.kernel.core.seeds import stream
from desim.kernel.models.graphs import Node
from desim.kernel.models.traits import FaultTraits

MIN_DRIFT = -0.99
"""Lower bound of the drift of a clock, so that no clock stands still or runs backwards."""


NamedNodes = Mapping[str, Sequence[int]]
"""The nodes that a fault names, by the key of a scenario file."""
Undo = Callable[[], object]
"""A function that ends what a fault has begun."""
Sketch = dict[str, Any]
"""JSON values from which a page draws a fault; see `Window.sketch`."""
Delays = Callable[[int, Sequence[int], Any], Mapping[int, float | Sequence[float]]]
"""A function of sender, receivers and body of a message; see `FaultSite.intercept`."""
NO_NODES: NamedNodes = MappingProxyType({})


class FaultSite(Protocol):
    """What a fault can do to a network. Each method returns the function that ends what it has begun.

    Losses by the fault have its `cause`.
    """

    @property
    def size(self) -> int:
        """The number of nodes."""
        ...

    def targets(self) -> Sequence[int]:
        """Return the nodes that matter most now, the first one most; a network alone has none.

        In a pursuit they are the pursuers that chase, those that would capture first first.
        """
        ...

    def begin(self, fault: "Fault") -> Undo:
        """Begin another fault as a part of this one; the trace records both."""
        ...

    def crash(self, crash: "Crash") -> Undo:
        """Take a node down."""
        ...

    def partition(self, groups: Iterable[Iterable[int]]) -> Undo:
        """Separate groups of nodes from each other and from all other nodes."""
        ...

    def jam(self, centre: tuple[float, float], radius: float) -> Undo:
        """Block reception at all nodes within a disc, m."""
        ...

    def block(self, is_blocked: Callable[[int, int], bool]) -> Undo:
        """Lose each message from a sender to a receiver for which `is_blocked(src, dst)` is true.

        The answer must depend on the two nodes only, not on the time: while no fault begins or ends, the network
        decides arrivals in advance.
        """
        ...

    def intercept(self, delays: "Delays") -> Undo:
        """Lose, delay or copy messages that are sent from now on, as `delays(src, receivers, body)` says.

        It is called once for each broadcast or message, and returns the extra delay, s, at each receiver that is
        concerned; inf: the message is lost there. Several delays, such as (0.0, 0.5), are those of the message and of
        its copies: each arrives by so much later than the message would have. A message that is lost has no copies.
        """
        ...


class RandomDraw(NamedTuple):
    """What the random parameters of a fault are drawn from."""

    size: int
    """The number of nodes."""
    box: tuple[float, float]
    """Lower and upper bound of both coordinates of positions, m."""
    rng: np.random.Generator
    """The random stream."""


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

    def named(self) -> NamedNodes:
        """Return the nodes that the fault names, by key: errors about a node that does not exist name the key."""
        return NO_NODES

    def sketch(self) -> Sketch:
        """Return what a page draws, as JSON values, in addition to the name and the interval of the fault.

        "centre" and "radius" are drawn as a disc, "groups" as letters at the nodes of each list, "node" with "scope"
        as a crash mark, "node" with "model" as a warning sign. Other keys have no effect.
        """
        return {}

    @property
    def label(self) -> str:
        """The name of the fault in pictures: by default its kind, without the module."""
        return str(FaultTraits.of(self).kind or type(self).__name__).rpartition(":")[2]


class Fault(Window):
    """Base of the faults of the network; a class of a user derives from it, and is then a kind "module:Name".

        class LinkDown(Fault):
            ends: tuple[int, int]

            def named(self):
                return {"ends": self.ends}

            def begin(self, site):
                return site.block(lambda src, dst: {src, dst} == {*self.ends})

    A fault is also the plan that draws this fault alone. `FaultTraits` lists its optional attributes.
    """

    breaks: ClassVar[frozenset[str]] = frozenset()
    """The assumptions of protocols (`assumes`) that it breaks."""

    @property
    def messages_only(self) -> bool:
        """Whether it only loses or delays messages, and no robot breaks down."""
        return True

    def begin(self, site: FaultSite) -> Undo:
        """Begin the fault at its start time; return the function that ends it."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _can_begin(self) -> Self:
        if inherits(self, Fault):  # a class of a user that draws other faults need not begin itself
            if not positions(type(self), "begin"):
                raise ValueError("should have a method begin(site), which returns the function that ends the fault")
            check_call(self.begin, ("site",), self)
        return self

    def __call__(self, size: int, horizon: float, rng: np.random.Generator) -> Iterator["Fault"]:
        """Yield the fault itself."""
        yield self

    @classmethod
    def random_parameters(cls, draw: RandomDraw) -> dict[str, Any]:  # noqa: ARG003 - for classes with parameters
        """Return random parameters, without start and end, for a fault that `RandomFaults` draws."""
        return {}


class Crash(Fault):
    """A node crashes and, if the crash ends, recovers."""

    kind: Literal["crash"] = "crash"
    node: Node
    """The node that crashes; in a pursuit, the number of the pursuer."""
    scope: Literal["radio", "robot"] = "robot"
    """radio: the node neither sends nor receives; robot: it does not move or decide either."""
    memory: Flag = True
    """Whether the node keeps its beliefs; if not, it recovers without any, and a crashed robot restarts its process."""

    breaks: ClassVar[frozenset[str]] = frozenset({"no_crashes"})
    is_scheduled: ClassVar[bool] = True

    @property
    def messages_only(self) -> bool:
        """Whether only the radio is down."""
        return self.scope == "radio"

    def begin(self, site: FaultSite) -> Undo:
        """Take the node down."""
        return site.crash(self)

    @classmethod
    def random_parameters(cls, draw: RandomDraw) -> dict[str, Any]:
        """Return a random scope, node and memory."""
        rng = draw.rng
        scope = ("radio", "robot")[rng.integers(2)]
        return {"scope": scope, "node": int(rng.integers(draw.size)), "memory": bool(rng.integers(2))}

    def named(self) -> NamedNodes:
        """Return the node."""
        return {"node": [self.node]}

    def sketch(self) -> Sketch:
        """Return the node, the scope, and whether the node keeps its beliefs."""
        return {"node": self.node, "scope": self.scope, "memory": self.memory}

    @property
    def label(self) -> str:
        """The part that is down, and its node."""
        return f"{self.scope} of {self.node} down"


class Partition(Fault):
    """Groups of nodes cannot communicate with each other."""

    kind: Literal["partition"] = "partition"
    groups: Annotated[tuple[Annotated[tuple[Node, ...], FirstError()], ...], FirstError(), NotEmpty()]
    """Lists of nodes; nodes in no list form one more group."""

    breaks: ClassVar[frozenset[str]] = frozenset({"undivided"})
    is_scheduled: ClassVar[bool] = True

    @field_validator("groups")
    @classmethod
    def _disjoint(cls, groups: tuple[tuple[int, ...], ...]) -> tuple[tuple[int, ...], ...]:
        named = [node for group in groups for node in group]
        twice = sorted({node for node in named if named.count(node) > 1})
        if twice:
            raise ValueError(f"should be disjoint, node {twice[0]} is listed twice")
        return groups

    def begin(self, site: FaultSite) -> Undo:
        """Separate the groups."""
        if inherits(self, Partition, "separates"):
            return site.partition(self.groups)
        return site.block(self.separates)

    @classmethod
    def random_parameters(cls, draw: RandomDraw) -> dict[str, Any]:
        """Return a random group of nodes, which is separated from the others."""
        size, rng = draw.size, draw.rng
        cut = rng.permutation(size)[: rng.integers(1, max(size, 2))]
        return {"groups": (tuple(sorted(cut.tolist())),)}

    def named(self) -> NamedNodes:
        """Return the nodes of all groups."""
        return {"groups": [node for group in self.groups for node in group]}

    def sketch(self) -> Sketch:
        """Return the groups."""
        return {"groups": [list(group) for group in self.groups]}

    def separates(self, src: int, dst: int) -> bool:
        """Return whether two nodes are in different groups."""
        return self._group(src) != self._group(dst)

    def _group(self, node: int) -> int:
        """Return the number of the group of a node; -1 if no list has it."""
        return next((k for k, group in enumerate(self.groups) if node in group), -1)


class Jamming(Fault):
    """No node within a disc receives messages."""

    kind: Literal["jamming"] = "jamming"
    centre: tuple[Coordinate, Coordinate]
    """[x, y], m."""
    radius: Length
    """m"""

    is_scheduled: ClassVar[bool] = True

    def begin(self, site: FaultSite) -> Undo:
        """Jam the disc."""
        return site.jam(self.centre, self.radius)

    @classmethod
    def random_parameters(cls, draw: RandomDraw) -> dict[str, Any]:
        """Return a random disc in the box."""
        box, rng = draw.box, draw.rng
        x, y = rng.uniform(*box, size=2).tolist()
        return {"centre": (x, y), "radius": float(rng.uniform(0.1, 0.5) * max(box[1] - box[0], 1.0))}

    def sketch(self) -> Sketch:
        """Return the disc."""
        return {"centre": list(self.centre), "radius": self.radius}


class MessageFault(Fault):
    """Some messages are lost, arrive late, or arrive twice: those with given numbers.

    A message to one receiver has one number; a broadcast has as many as receivers, in the order of these. The first
    message that is sent while the fault lasts has the number 1. In a run without chance, a number names one message.
    The copies that such faults make have no numbers.
    """

    kind: Literal["message_fault"] = "message_fault"
    start: Time = 0.0
    """Start time, s."""
    messages: Annotated[tuple[Annotated[int, Field(ge=1, strict=True)], ...], FirstError(), NotEmpty()]
    """The numbers of the messages, from 1 on."""
    delay: Extent = inf
    """The time by which they arrive late, s; inf = never.

    If in doubt, inf. A time that is longer than a time-out of the protocol shows whether it takes old news for new.
    """
    duplicate: Flag = False
    """Whether they arrive as they should and once more, late by `delay`; then it is finite."""

    @field_validator("duplicate")
    @classmethod
    def _arrives_twice(cls, duplicate: bool, info: ValidationInfo) -> bool:
        if duplicate and info.data.get("delay") == inf:
            raise ValueError("a copy should arrive: set a finite delay")
        return duplicate

    def begin(self, site: FaultSite) -> Undo:
        """Count the messages from now on, and intercept those that are meant."""
        first, fate = 1, (0.0, self.delay) if self.duplicate else self.delay

        def delays(_src: int, receivers: Sequence[int], _body: Any) -> Mapping[int, float | Sequence[float]]:
            nonlocal first
            numbers, first = range(first, first + len(receivers)), first + len(receivers)
            numbered = zip(receivers, numbers, strict=True)
            return {node: fate for node, number in numbered if number in self.messages}

        return site.intercept(delays)

    def sketch(self) -> Sketch:
        """Return the numbers of the messages."""
        return {"messages": list(self.messages)}

    @property
    def label(self) -> str:
        """What becomes of the messages, and their numbers."""
        fate = "twice" if self.duplicate else "lost" if self.delay == inf else "late"
        return f"{fate}: message {', '.join(map(str, sorted(self.messages)))}"


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

    def named(self) -> NamedNodes:
        """Return the node."""
        return {"node": [self.node]}

    def sketch(self) -> Sketch:
        """Return the node and the kind of the model."""
        return {"node": self.node, "model": self.model}

    @property
    def label(self) -> str:
        """The kind of the model, and the node."""
        return f"{self.model} {self.node}"


class CustomFault(Window):
    """The record of a fault of a user's kind in a trace, which can be read without the code of the user."""

    kind: Literal["custom"] = "custom"
    model: str
    """The kind of the fault, "module:Name"."""
    nodes: tuple[Node, ...] = ()
    """The nodes that it names."""
    drawn: Sketch
    """What a page draws; see `Window.sketch`."""

    def named(self) -> NamedNodes:
        """Return the nodes."""
        return {"nodes": self.nodes}

    def sketch(self) -> Sketch:
        """Return what a page draws."""
        return self.drawn

    @property
    def label(self) -> str:
        """The name of the class of the fault."""
        return self.model.rpartition(":")[2]


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
    """Seconds gained per second; if the sum of the drifts of a node is below -0.99, it is raised to -0.99.

    If in doubt, 2e-5, an ordinary quartz; 1e-6 with temperature compensation.
    """
    offset_walk: Annotated[float, Field(ge=0, le=1.0, strict=True)] = 0.0
    """Random walk of the offset, s per sqrt(s), from white noise of the frequency: after a time t its standard
    deviation is offset_walk sqrt(t). Each node has a walk of its own."""
    drift_walk: Annotated[float, Field(ge=0, le=1.0, strict=True)] = 0.0
    """Random walk of the drift, 1 per sqrt(s): after a time t its standard deviation is drift_walk sqrt(t)."""

    breaks: ClassVar[frozenset[str]] = frozenset({"equal_clocks"})
    is_scheduled: ClassVar[bool] = True

    def named(self) -> NamedNodes:
        """Return the node, if one is given."""
        return NO_NODES if self.node is None else {"node": [self.node]}


BUILT_IN: tuple[type[Fault], ...] = (Crash, Partition, Jamming)
"""The built-in faults of the network, with a start and an end time."""
TracedFault = Crash | Partition | Jamming | Misbehaviour | CustomFault
"""A fault whose start and end are events of the trace."""


def traced(fault: Fault) -> TracedFault:
    """Return the record of a fault in a trace.

    A fault of a user's class that begins as a built-in one does, only with a cause of its own for instance, is
    recorded as the built-in fault, and any other as a `CustomFault`.
    """
    for base in BUILT_IN:
        if all(inherits(fault, base, name) for name in ("begin", "separates") if hasattr(base, name)):
            fields = {name: getattr(fault, name) for name in base.model_fields if name != "kind"}
            return fault if type(fault) is base else base(**fields)  # type: ignore[return-value]
    nodes = tuple(node for named in nodes_of(fault).values() for node in named)
    sketch: Any = fault.sketch()
    if not isinstance(sketch, dict):
        raise wrong_answer("sketch() of a fault should return a dictionary of what a page draws", sketch, fault)
    try:
        drawn = json.loads(json.dumps(sketch, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise wrong_answer(f"sketch() of a fault should return JSON values ({error})", sketch, fault) from error
    model = import_name(definition_of(fault))
    return CustomFault(start=fault.start, end=fault.end, model=model, nodes=nodes, drawn=drawn)


def cause_of(fault: Fault) -> Cause:
    """Return the cause of the losses by a fault: its own `cause`, or else its kind."""
    traits = FaultTraits.of(fault)
    return traits.cause or (traits.kind or type(fault).__name__).rpartition(":")[2]


def nodes_of(fault: object) -> NamedNodes:
    """Return the nodes that a fault, a clock error or a plan names, by key.

    Raises:
        ValueError: if `named` of a user's fault returns anything else.
    """
    method = FaultTraits.of(fault).named
    if method is None:
        return NO_NODES
    named: Any = method()
    try:
        return {str(key): tuple(map(index, nodes)) for key, nodes in named.items()}
    except (AttributeError, TypeError) as error:
        expected = 'the numbers of nodes by key, such as {"node": [3]}'
        raise wrong_answer(f"named() of a fault should return {expected}", named, fault) from error


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
        if is_unlisted_import(value) and not is_trusted(info):
            raise ValueError(refusal(value))
        value = load_named(value, (info.context or {}).get("folder"))
    if not (isinstance(value, type) and issubclass(value, Fault)):
        hint = did_you_mean(value, _BY_KIND) if isinstance(value, str) else ""
        classes = 'a class that derives from Fault as "module:Name"'
        raise ValueError(f"should be {', '.join(_BY_KIND)}, or {classes}{hint} (got {value!r})")
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
    """Lower and upper bound of both coordinates of the centres of jamming discs, m."""

    @property
    def breaks(self) -> frozenset[str]:
        """The assumptions that the kinds of faults break."""
        return frozenset[str]().union(*(_class_of(kind).breaks for kind in self.kinds))

    @property
    def messages_only(self) -> bool:
        """Whether no robot breaks down: no kind is a crash, which may be one of a robot."""
        return not any(issubclass(_class_of(kind), Crash) for kind in self.kinds)

    @property
    def memory(self) -> bool:
        """Whether all nodes keep their memory: no kind is a crash, which may erase it."""
        return self.messages_only

    @property
    def is_scheduled(self) -> bool:
        """Whether all kinds are built in, as a fault of a user may look at the run."""
        return all(isinstance(kind, str) for kind in self.kinds)

    def __call__(self, size: int, horizon: float, rng: np.random.Generator) -> Iterator[Fault]:
        """Yield the faults that start before `end` and the horizon, s, ordered by start time."""
        t, end, draw = 0.0, min(self.end, horizon), RandomDraw(size, self.box, rng)
        while (t := t + rng.exponential(1.0 / self.rate)) < end - MIN_FAULT_DURATION:
            duration = max(rng.exponential(self.mean_duration), MIN_FAULT_DURATION)
            window = {"start": t, "end": min(t + duration, self.end)}
            kind = _class_of(self.kinds[rng.integers(len(self.kinds))])
            yield kind(**window, **kind.random_parameters(draw))


PLANNED_WITH = ("size", "horizon", "rng")
"""The arguments of a plan of faults."""
MAX_FAULTS = 1_000_000
"""Largest number of faults of a plan, which may be a generator without an end."""
MIN_FAULT_DURATION = 1e-6
"""Minimum duration of a drawn fault, s."""
FAULTS = OneOf(*BUILT_IN, MessageFault, RandomCrashes, RandomFaults, ClockSkew, takes=PLANNED_WITH, traits=FaultTraits)


def is_skewed(faults: Iterable[object]) -> bool:
    """Return whether a fault makes a clock wrong."""
    return any(isinstance(fault, ClockSkew) for fault in faults)


def drawn_skews(faults: Iterable[object]) -> list[ClockSkew]:
    """Return the clock errors in `faults` that are drawn for each node."""
    return [fault for fault in faults if isinstance(fault, ClockSkew) and fault.node is None]


def clock_skews(faults: Iterable[object], node: int) -> list[ClockSkew]:
    """Return the clock errors in `faults` that concern a node."""
    return [skew for skew in faults if isinstance(skew, ClockSkew) and skew.node in (None, node)]


def clock_errors(faults: Iterable[object], size: int, seed: int) -> list[tuple[float, float]]:
    """Return (offset in s, drift) of the clock of each node, summed over all `ClockSkew` in `faults`.

    A `ClockSkew` without a node adds an error drawn for each node. A sum of drifts below `MIN_DRIFT` is raised
    to it.
    """
    errors = np.zeros((size, 2))
    for k, skew in enumerate(fault for fault in faults if isinstance(fault, ClockSkew)):
        if skew.node is None:
            errors += stream(seed, "clocks", k).standard_normal((size, 2)) * (abs(skew.offset), abs(skew.drift))
        else:
            errors[skew.node] += skew.offset, skew.drift
    errors[:, 1] = np.maximum(errors[:, 1], MIN_DRIFT)
    return [(offset, drift) for offset, drift in errors.tolist()]


def draw_faults(entries: Sequence[Fault | FaultPlan | ClockSkew], size: int, horizon: float, seed: int) -> list[Fault]:
    """Draw the faults of each plan, and return them with the faults among the entries; clock errors are left out.

    Every plan has its own random stream.

    Raises:
        ValueError: if a plan returns or yields anything else than faults, or does not end.
    """
    faults: list[Fault] = []
    number = count()
    for entry in entries:
        if inherits(entry, Fault):  # unless a class of a user draws other faults
            faults.append(entry)
        elif not isinstance(entry, ClockSkew):
            answer: Any = entry(size, horizon, stream(seed, "faults", next(number)))
            planned: list[Any] = [*islice(answer, MAX_FAULTS + 1)] if isinstance(answer, Iterable) else [answer]
            if len(planned) > MAX_FAULTS:
                expected = f"a plan should end, with no fault after the horizon, and has over {MAX_FAULTS:,} faults"
                raise wrong_answer(expected, planned[-1], entry)
            if strange := [fault for fault in planned if not isinstance(fault, Fault)]:
                raise wrong_answer("a plan should return or yield faults of the network", strange[0], entry)
            faults += planned
    return faults
