"""The hops of one transmission: what a model of a link may know when it answers for them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desim.kernel.positions import PositionSource, as_position_source, distances
from desim.kernel.seeds import pair_uniform


@dataclass(slots=True)
class LinkContext:
    """From `src` to each of the (k,) nodes `dst`, at a time, with a message of a size."""

    src: int
    dst: NDArray[np.intp]
    now: float = 0.0
    """When the message leaves, s."""
    size: int = 0
    """Bytes."""
    seed: int = 0
    """Of the run."""
    positions: PositionSource | None = None

    @property
    def distances(self) -> NDArray[np.float64]:
        """(k,) distances between sender and receivers as the message leaves, m.

        Raises:
            ValueError: if the nodes have no positions.
        """
        if self.positions is None:
            raise ValueError("a model that asks for distances needs a network whose nodes have positions")
        nodes = np.concatenate((self.dst, [self.src]))
        return distances(as_position_source(self.positions).of(nodes), -1)[:-1]

    def uniform(self, name: str, *, symmetric: bool = True) -> NDArray[np.float64]:
        """Return (k,) uniform numbers in (0, 1) that belong to the pairs of nodes and never change."""
        return pair_uniform(self.seed, name, self.src, self.dst, symmetric=symmetric)
