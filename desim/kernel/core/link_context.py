"""The context of one transmission: the inputs of a latency or loss model."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desim.kernel.core.positions import PositionFunction, as_position_source, distances_from
from desim.kernel.core.seeds import pair_uniform


@dataclass(slots=True)
class LinkContext:
    """The links of one transmission, from `src` to each of the (k,) nodes `dst`."""

    src: int
    dst: NDArray[np.intp]
    now: float = 0.0
    """Time of the transmission, s."""
    size: int = 0
    """Size of the message, bytes."""
    seed: int = 0
    """Seed of the run."""
    positions: PositionFunction | None = None
    """Returns the current positions of all nodes, m; None: the nodes have no positions."""
    known_distances: NDArray[np.float64] | None = None
    """The `distances`, if no node moves: a read-only array, the same object for the same `dst`, so a model may keep
    what it computes from it."""

    @property
    def distances(self) -> NDArray[np.float64]:
        """The (k,) current distances, m, between the sender and the receivers.

        Raises:
            ValueError: if the nodes have no positions.
        """
        if self.known_distances is not None:
            return self.known_distances
        if self.positions is None:
            raise ValueError("a latency or loss model that depends on distance needs the positions of the nodes")
        nodes = np.concatenate((self.dst, [self.src]))  # the sender last, so that one call returns all positions
        return distances_from(as_position_source(self.positions).of(nodes), -1)[:-1]

    def uniform(self, name: str, *, symmetric: bool = True) -> NDArray[np.float64]:
        """Return (k,) uniform draws in (0, 1), one per receiver, that stay the same throughout a run.

        Args:
            name: the name of the random quantity; different names have independent draws.
            symmetric: whether both directions of a link have the same draw.
        """
        return pair_uniform(self.seed, name, self.src, self.dst, symmetric=symmetric)
