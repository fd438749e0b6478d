"""Sources of the current positions of the nodes: of all nodes, or of some nodes at lower cost."""

from collections.abc import Callable
from math import inf
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Nodes = NDArray[np.intp]
PositionSource = Callable[[], Floats]
"""A function that returns the current positions of all nodes, (n, 2) m; a `Positions` is faster for large networks."""


class Positions(Protocol):
    """The current positions of the nodes."""

    @property
    def fastest(self) -> float:
        """Upper bound of the speed of all nodes at all times, m/s; inf if unknown."""
        ...

    def __call__(self) -> Floats:
        """Return the positions of all nodes, (n, 2) m."""
        ...

    def of(self, nodes: Nodes) -> Floats:
        """Return the positions of some nodes, (k, 2) m; cost O(k)."""
        ...


class _PositionFunction:
    """`Positions` from a function that returns the positions of all nodes."""

    fastest = inf

    def __init__(self, function: PositionSource):
        self._function = function

    def __call__(self) -> Floats:
        return np.asarray(self._function())

    def of(self, nodes: Nodes) -> Floats:
        return self().take(nodes, axis=0)


def as_position_source(source: PositionSource) -> Positions:
    """Return a position source as `Positions`; a plain function is wrapped."""
    return cast("Positions", source) if hasattr(source, "of") else _PositionFunction(source)


def distances(at: Floats, here: int) -> Floats:
    """Return the (k,) distances of (k, 2) positions from the position with index `here`, m."""
    x, y = at[here].tolist()
    return np.asarray(np.hypot(at[:, 0] - x, at[:, 1] - y))
