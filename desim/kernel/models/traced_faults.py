"""The faults of a trace: the events of their starts and ends, with records that need no code of users to be read."""

import json
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field

from desim.config.answers import wrong_answer
from desim.config.named_code import definition_of, import_name
from desim.config.traits import inherits
from desim.kernel.core.events import Nanoseconds
from desim.kernel.models.faults import BUILT_IN, Crash, Fault, Jamming, NamedNodes, Partition, Sketch, Window, nodes_of
from desim.kernel.models.graphs import Node


class Misbehaviour(Window):
    """A node does not follow its protocol; the network carries what it sends like any other message.

    This record has no effect: a model of a higher layer (a lie) creates it, and causes the misbehaviour.
    """

    kind: Literal["misbehaviour"] = "misbehaviour"
    node: Node
    """The node that misbehaves."""
    model: str
    """The kind of the lie, or of another model, by which the node misbehaves."""
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


TracedFault = Crash | Partition | Jamming | Misbehaviour | CustomFault
"""A fault whose start and end are events of the trace."""


def as_built_in(fault: Fault, base: type[Fault]) -> Fault:
    """Return a fault of a class that derives from a built-in one as the built-in fault with the same fields."""
    if type(fault) is base:
        return fault
    return base(**{name: getattr(fault, name) for name in base.model_fields if name != "kind"})


def traced(fault: Fault) -> TracedFault:
    """Return the record of a fault in a trace.

    A user's subclass of Crash, Partition or Jamming that overrides neither begin nor separates is recorded as its base
    class, without its own label and sketch. Any other fault of a user is recorded as a `CustomFault`.
    """
    for base in BUILT_IN:  # begin() of a Partition calls its separates()
        if all(inherits(fault, base, name) for name in ("begin", "separates") if hasattr(base, name)):
            return as_built_in(fault, base)  # type: ignore[return-value]
    nodes = tuple(node for nodes_of_key in nodes_of(fault).values() for node in nodes_of_key)
    sketch: Any = fault.sketch()
    if not isinstance(sketch, dict):
        raise wrong_answer("sketch() of a fault should return a dictionary of what a page draws", sketch, fault)
    try:
        drawn = json.loads(json.dumps(sketch, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise wrong_answer(f"sketch() of a fault should return JSON values ({error})", sketch, fault) from error
    model = import_name(definition_of(fault))
    return CustomFault(start=fault.start, end=fault.end, model=model, nodes=nodes, drawn=drawn)


class FaultStarted(NamedTuple):
    """A fault started."""

    t: Nanoseconds
    fault: Annotated[TracedFault, Field(discriminator="kind")]


class FaultEnded(NamedTuple):
    """A fault ended."""

    t: Nanoseconds
    fault: Annotated[TracedFault, Field(discriminator="kind")]
