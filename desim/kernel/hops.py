"""The hops of one transmission: what a model of a link may know when it answers for them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desim.kernel.seeds import pair_luck

Positions = Callable[[], NDArray[np.float64]]
"""Where the nodes are now, (n, 2) m."""


@dataclass(slots=True)
class Hops:
    """From `src` to each of the (k,) nodes `dst`, at a time, with a message of a size."""

    src: int
    dst: NDArray[np.intp]
    now: float = 0.0
    """When the message leaves, s."""
    size: int = 0
    """Bytes."""
    seed: int = 0
    """Of the run."""
    positions: Positions | None = None

    @property
    def distances(self) -> NDArray[np.float64]:
        """(k,) distances between sender and receivers as the message leaves, m.

        Raises:
            ValueError: if the nodes have no positions.
        """
        if self.positions is None:
            raise ValueError("a model that asks for distances needs a network whose nodes have positions")
        return distances(self.positions(), self.src, self.dst)

    def luck(self, name: str, *, symmetric: bool = True) -> NDArray[np.float64]:
        """Return (k,) uniform numbers in (0, 1) that belong to the pairs of nodes and never change."""
        return pair_luck(self.seed, name, self.src, self.dst, symmetric=symmetric)


def distances(at: NDArray[np.float64], src: int, dst: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the (k,) distances from one node to others, given everybody's position (n, 2), m."""
    apart = at[dst] - at[src]
    return np.asarray(np.hypot(apart[:, 0], apart[:, 1]))
