"""Errors of clocks: a frozen model, and functions that return which nodes have an error, and how large it is.

`desim.kernel.wandering_clock` computes what a clock with such an error shows.
"""

from collections.abc import Iterable
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from desim.config.model import Value
from desim.kernel.core.seeds import stream
from desim.kernel.models.faults import NO_NODES, NamedNodes
from desim.kernel.models.graphs import Node

MIN_DRIFT = -0.99
"""Lower bound of the drift of a clock, so that no clock stands still or runs backwards."""


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
    """Error at the time 0, s."""
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

    Raises:
        ValueError: if a `ClockSkew` names a node that does not exist.
    """
    errors = np.zeros((size, 2))
    for k, skew in enumerate(fault for fault in faults if isinstance(fault, ClockSkew)):
        if skew.node is None:
            errors += stream(seed, "clocks", k).standard_normal((size, 2)) * (abs(skew.offset), abs(skew.drift))
        elif skew.node >= size:
            raise ValueError(f"clock_skew.node: there is no node {skew.node}: the nodes are 0 .. {size - 1}")
        else:
            errors[skew.node] += skew.offset, skew.drift
    errors[:, 1] = np.maximum(errors[:, 1], MIN_DRIFT)
    return [(offset, drift) for offset, drift in errors.tolist()]
