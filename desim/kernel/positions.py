"""Where the nodes are now: of everybody, or of some at the cost of some."""

from collections.abc import Callable
from math import inf
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Nodes = NDArray[np.intp]
PositionSource = Callable[[], Floats]
"""Returns everybody's position now, (n, 2) m; what more `Positions` can tell makes large networks fast."""


class Positions(Protocol):
    """Where the nodes are now."""

    @property
    def fastest(self) -> float:
        """The speed that nobody ever exceeds, m/s; inf if it is not known."""
        ...

    def __call__(self) -> Floats:
        """Return everybody's position, (n, 2) m."""
        ...

    def of(self, nodes: Nodes) -> Floats:
        """Return the positions of some, (k, 2) m; cost O(k)."""
        ...


class _PositionFunction:
    """Positions of which no more is known than a function that returns everybody's."""

    fastest = inf

    def __init__(self, everybody: PositionSource):
        self._everybody = everybody

    def __call__(self) -> Floats:
        return np.asarray(self._everybody())

    def of(self, nodes: Nodes) -> Floats:
        return self().take(nodes, axis=0)


def as_position_source(locator: PositionSource) -> Positions:
    """Return what a function tells of positions as `Positions`, unless it is that already."""
    return cast("Positions", locator) if hasattr(locator, "of") else _PositionFunction(locator)


def distances(at: Floats, here: int) -> Floats:
    """Return the (k,) distances of (k, 2) positions from one of them, m."""
    x, y = at[here].tolist()
    return np.asarray(np.hypot(at[:, 0] - x, at[:, 1] - y))
