"""Faults of the network as frozen models: crashes, partitions, jamming, lost or late messages.

A fault has a start time and an end time; `desim.kernel.fault_injection` applies it. Other kinds of `[[fault]]` in a
scenario file are plans that draw faults (`fault_plans`), and clock errors, which last for the whole run (`clock_skew`).

A kind of faults is a class that derives from `Fault`. It says how the fault begins and ends (`begin`), which nodes it
names (`named`), how a page draws it (`sketch`), and what a loss by it is called (`cause`).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from math import inf
from operator import index
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Protocol, Self

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from desim.config.answers import wrong_answer
from desim.config.calls import check_call
from desim.config.model import AnyOrder, Coordinate, Extent, FirstError, Flag, Length, NotEmpty, Time, Value
from desim.config.traits import inherits, positions
from desim.kernel.core.events import Cause
from desim.kernel.models.graphs import Node
from desim.kernel.models.traits import FaultTraits

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
    """What a fault can do to a network. Each method that has an effect returns the function that ends this effect.

    The trace records the fault, each fault that it begins as a part, and each crash. Its other effects show only in the
    losses and arrivals of messages; pages draw them as its `sketch` says. Losses by the fault have its `cause`.
    """

    @property
    def size(self) -> int:
        """The number of nodes."""

    def targets(self) -> Sequence[int]:
        """Return the nodes that matter most at present, in descending order; empty in a network without a pursuit.

        In a pursuit they are the pursuers that chase, in the order of their capture times.
        """

    def begin(self, fault: "Fault") -> Undo:
        """Begin another fault as a part of this one; the trace records both.

        Losses by the part have the `cause` of its class, or else that of the class of this fault. If neither class has
        one, they have the kind of the part.

        Raises:
            ValueError: if the part names a node that does not exist.
        """

    def crash(self, crash: "Crash") -> Undo:
        """Take a node down; the trace records the crash, so that metrics and pages know which nodes are down.

        Losses by the crash have the `cause` of this fault; with `begin(crash)`, they would have the cause of the crash
        if the crash has one. `start` and `end` of the crash have no effect: it lasts until the returned function is
        called.

        Raises:
            ValueError: if the node does not exist.
        """

    def partition(self, groups: Iterable[Iterable[int]]) -> Undo:
        """Separate groups of nodes from each other and from all other nodes."""

    def jam(self, centre: tuple[float, float], radius: float) -> Undo:
        """Block reception at all nodes within a disc, m."""

    def block(self, is_blocked: Callable[[int, int], bool]) -> Undo:
        """Lose each message from a sender to a receiver for which `is_blocked(src, dst)` is true.

        The answer must depend on the two nodes only, not on the time: while no fault begins or ends, the network
        decides arrivals in advance.
        """

    def intercept(self, delays: "Delays") -> Undo:
        """Lose, delay or copy messages that are sent from now on, as `delays(src, receivers, body)` says.

        `delays` is called once for each broadcast, and once for each message to one node. It returns the extra delay,
        s, at each receiver that the fault affects; inf: the message is lost there. Several delays, such as (0.0, 0.5),
        are those of the message and of its copies, each relative to the arrival without the fault. A lost message has
        no copies. A finite delay is limited to `MAX_TIME`, as each latency is.
        """


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
        """Return the nodes that the fault names, by key; an error about a node that does not exist states the key."""
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
    """The assumptions of protocols (`assumes`) that the fault breaks."""

    @property
    def messages_only(self) -> bool:
        """Whether the fault only loses or delays messages, and no robot breaks down."""
        return True

    def begin(self, site: FaultSite) -> Undo:
        """Begin the fault at its start time; return the function that ends it."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _can_begin(self) -> Self:
        if inherits(self, Fault):  # a class that overrides `__call__` draws other faults, and need not begin itself
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
    groups: Annotated[tuple[Annotated[tuple[Node, ...], FirstError()], ...], FirstError(), NotEmpty(), AnyOrder()]
    """Lists of nodes; nodes in no list form one more group."""

    breaks: ClassVar[frozenset[str]] = frozenset({"undivided"})
    is_scheduled: ClassVar[bool] = True

    @field_validator("groups")
    @classmethod
    def _disjoint(cls, groups: tuple[tuple[int, ...], ...]) -> tuple[tuple[int, ...], ...]:
        nodes = [node for group in groups for node in group]
        repeated = sorted({node for node in nodes if nodes.count(node) > 1})
        if repeated:
            raise ValueError(f"should be disjoint, node {repeated[0]} is listed twice")
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
        group = rng.permutation(size)[: rng.integers(1, max(size, 2))]
        return {"groups": (tuple(sorted(group.tolist())),)}

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
        """Return a random disc about a point of the box, with 0.1 to 0.5 of the width of the box as its radius.

        In a box without a width the radius is 0.1 to 0.5 m.
        """
        box, rng = draw.box, draw.rng
        x, y = rng.uniform(*box, size=2).tolist()
        return {"centre": (x, y), "radius": float(rng.uniform(0.1, 0.5) * (box[1] - box[0] or 1.0))}

    def sketch(self) -> Sketch:
        """Return the disc."""
        return {"centre": list(self.centre), "radius": self.radius}


class MessageFault(Fault):
    """The messages with given numbers are lost, arrive late, or arrive twice.

    A message to one node has one number; a broadcast has one for each receiver, in the order of the receivers. The
    first message that is sent while the fault lasts has the number 1. Without random draws, a number always names the
    same message. Copies that a `message_fault` makes have no numbers.
    """

    kind: Literal["message_fault"] = "message_fault"
    start: Time = 0.0
    """Start time, s."""
    messages: Annotated[tuple[Annotated[int, Field(ge=1, strict=True)], ...], FirstError(), NotEmpty(), AnyOrder()]
    """The numbers of the messages, from 1 on."""
    delay: Extent = inf
    """Time by which the messages arrive late, s; inf = never.

    If in doubt, inf. A time longer than a time-out of the protocol shows whether the protocol takes old news for new.
    """
    duplicate: Flag = False
    """Whether the messages arrive on time, and a copy of each arrives late by `delay`, which should then be finite."""

    @field_validator("duplicate")
    @classmethod
    def _arrives_twice(cls, duplicate: bool, info: ValidationInfo) -> bool:
        if duplicate and info.data.get("delay") == inf:
            raise ValueError("a copy should arrive: set a finite delay")
        return duplicate

    def begin(self, site: FaultSite) -> Undo:
        """Count the messages from now on, and intercept those whose numbers are in `messages`."""
        next_number, fate = 1, (0.0, self.delay) if self.duplicate else self.delay

        def delays(_src: int, receivers: Sequence[int], _body: Any) -> Mapping[int, float | Sequence[float]]:
            nonlocal next_number
            numbered_receivers = [*enumerate(receivers, next_number)]
            next_number += len(receivers)
            return {node: fate for number, node in numbered_receivers if number in self.messages}

        return site.intercept(delays)

    def sketch(self) -> Sketch:
        """Return the numbers of the messages."""
        return {"messages": list(self.messages)}

    @property
    def label(self) -> str:
        """What becomes of the messages, and their numbers."""
        fate = "twice" if self.duplicate else "lost" if self.delay == inf else "late"
        return f"{fate}: message {', '.join(map(str, sorted(self.messages)))}"


BUILT_IN: tuple[type[Fault], ...] = (Crash, Partition, Jamming)
"""The built-in faults of the network, with a start and an end time."""


def cause_of(fault: Fault) -> Cause:
    """Return the cause of the losses by a fault: its own `cause`, or else its kind."""
    traits = FaultTraits.of(fault)
    return traits.cause or (traits.kind or type(fault).__name__).rpartition(":")[2]


def nodes_of(fault: object) -> NamedNodes:
    """Return the nodes that a fault, a clock error or a plan names, by key.

    Raises:
        ValueError: if `named` of a user's fault returns anything but lists of node numbers by key.
    """
    named = FaultTraits.of(fault).named
    if named is None:
        return NO_NODES
    answer: Any = named()
    try:
        return {str(key): tuple(map(index, nodes)) for key, nodes in answer.items()}
    except (AttributeError, TypeError) as error:
        expected = 'the numbers of nodes by key, such as {"node": [3]}'
        raise wrong_answer(f"named() of a fault should return {expected}", answer, fault) from error
