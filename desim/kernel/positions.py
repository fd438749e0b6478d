"""Sources of the current positions of the nodes: of all nodes, or of some nodes at lower cost."""

from collections.abc import Callable
from math import inf

import numpy as np
from numpy.typing import NDArray

from desim.config.arrays import Floats

Nodes = NDArray[np.intp]
PositionSource = Callable[[], Floats]
"""A function that returns the current positions of all nodes, (n, 2) m; a `Positions` is faster for large networks."""


class Positions:
    """Base of the sources of the current positions of the nodes."""

    fastest = inf
    """Upper bound of the speed of all nodes at all times, m/s; inf if unknown."""

    def __call__(self) -> Floats:
        """Return the positions of all nodes, (n, 2) m."""
        raise NotImplementedError

    def of(self, nodes: Nodes) -> Floats:
        """Return the positions of some nodes, (k, 2) m; a subclass may do it at the cost O(k)."""
        return self().take(nodes, axis=0)


class _PositionFunction(Positions):
    """`Positions` from a function that returns the positions of all nodes."""

    def __init__(self, function: PositionSource):
        self._function = function

    def __call__(self) -> Floats:
        return np.asarray(self._function())


def as_position_source(source: PositionSource) -> Positions:
    """Return a position source as `Positions`; a plain function is wrapped."""
    return source if isinstance(source, Positions) else _PositionFunction(source)


def distances(at: Floats, here: int) -> Floats:
    """Return the (k,) distances of (k, 2) positions from the position with index `here`, m."""
    x, y = at[here].tolist()
    return np.asarray(np.hypot(at[:, 0] - x, at[:, 1] - y))
