"""Sources of the current positions of all nodes, or of some nodes at lower cost."""

from collections.abc import Callable
from math import inf

import numpy as np
from numpy.typing import NDArray

from desim.config.arrays import Floats, Integers

Nodes = NDArray[np.intp]
PositionFunction = Callable[[], Floats]
"""A function that returns the current positions of all nodes, (n, 2) m. A `PositionSource` is faster for large
networks."""


class PositionSource:
    """Base of the sources of the current positions of the nodes."""

    max_speed = inf
    """Upper bound of the speed of all nodes at all times, m/s; inf if unknown. The network does not search for the
    receivers of a node again before nodes of this speed can have come into range, or left it."""
    looks_back = False
    """Whether `at` also returns positions of the past."""

    def __call__(self) -> Floats:
        """Return the positions of all nodes, (n, 2) m."""
        raise NotImplementedError

    def of(self, nodes: Nodes) -> Floats:
        """Return the positions of some nodes, (k, 2) m; a subclass may override this method with one of cost O(k)."""
        return self().take(nodes, axis=0)

    def distance(self, node: int, other: int) -> float:
        """Return the present distance between two nodes, m; a subclass may override this method with a faster one."""
        (x, y), (u, v) = self.of(np.array([node, other])).tolist()
        return abs(complex(x - u, y - v))

    def at(self, nodes: Nodes, times: int | Integers) -> Floats:
        """Return the positions of some nodes, each at a time, (k, 2) m.

        The base class ignores the times and returns the present positions. If a subclass overrides this method and
        `before_change`, and sets `looks_back`, the network can decide for several messages together, after their
        arrivals, which of them were within range when they arrived.

        Args:
            nodes: (k,) the nodes.
            times: one time or (k,) times, ns; from the last change of the motion of a node up to now.
        """
        return self.of(nodes)

    def before_change(self, act: Callable[[], object]) -> None:
        """Register a function to call before the motion of a node changes.

        After the change, `at` is no longer valid for times before it.
        """


class _FunctionSource(PositionSource):
    """A position source that calls a function for the positions of all nodes."""

    def __init__(self, function: PositionFunction):
        self._function = function

    def __call__(self) -> Floats:
        return np.asarray(self._function(), dtype=float)


def as_position_source(positions: PositionFunction) -> PositionSource:
    """Return a `PositionSource` unchanged; wrap a plain function in one."""
    return positions if isinstance(positions, PositionSource) else _FunctionSource(positions)


def distances_from(at: Floats, index: int) -> Floats:
    """Return the (k,) distances, m, of (k, 2) positions from the position at an index."""
    x, y = at[index].tolist()
    return np.asarray(np.hypot(at[:, 0] - x, at[:, 1] - y))
