"""The state of the pursuit at one instant.

A point of the plane is a complex number x + iy: the heading from p to q is (q - p) / |q - p|, and a rotation by an
angle a is a product with e^(ia). Both are single array operations for a whole team. Files, traces and results
contain [x, y].
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from desim.config.arrays import Floats, Points


class State:
    """The positions of the pursuers and of one evader, and the pursuers that chase this evader.

    The arrays of a state must not be changed.

    Attributes:
        stamp: the instant, ns.
        pursuers: (N,) positions, m.
        evader: position of the evader, m.
        active: (N,) whether each pursuer chases the evader.
        offsets: (N,) vectors from each pursuer to the evader, m.
        distances: (N,) distances from each pursuer to the evader, m.
        nearest: index of the pursuer nearest to the evader, active or not; the lowest index if several are equally
            near; -1 if there are no pursuers.
    """

    def __init__(self, stamp: int, pursuers: Points, evader: complex, active: NDArray[np.bool_]):
        self.stamp = stamp
        self.pursuers = pursuers
        self.evader = evader
        self.active = active
        self.offsets: Points = evader - pursuers
        self.distances = lengths(self.offsets)
        self.nearest = int(self.distances.argmin()) if len(pursuers) else -1

    @property
    def t(self) -> float:
        """The instant, s."""
        return self.stamp / 1e9


def lengths(vectors: Points) -> Floats:
    """Return the (k,) lengths of complex vectors, bit for bit as the built-in `abs` returns them.

    `np.abs` is not used, because the last bits of its results depend on the processor.

    Kept equal to the built-in `abs` of each by
    `tests/pursuit/test_kinematics.py::test_the_lengths_of_many_are_those_of_each`.
    """
    moduli: Floats = np.hypot(vectors.real, vectors.imag)
    return moduli


def complex_points(points: Sequence[Sequence[float]] | Floats) -> Points:
    """Return (k, 2) coordinates as (k,) complex numbers."""
    return np.ascontiguousarray(points, dtype=np.float64).view(np.complex128)[:, 0]


def coordinates(points: Points) -> Floats:
    """Return (k,) complex numbers as (k, 2) coordinates."""
    return np.ascontiguousarray(points).view(np.float64).reshape(-1, 2)
