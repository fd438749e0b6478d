"""The state of the pursuit at one instant, as its strategies see it.

A point of the plane is a complex number x + iy: the heading from p to q is (q - p) / |q - p|, a turn by an angle a is a
product with e^(ia), and each of these is one operation on a whole team. Files, traces and results have [x, y].
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.complex128]
Floats = NDArray[np.float64]


class State:
    """Where the pursuers and an evader are at one instant, and who chases it; its arrays are not to be written to.

    Attributes:
        t: the instant, ns.
        pursuers: (N,) positions, m.
        evader: its position, m.
        active: (N,) who chases it.
        offsets: (N,) from each pursuer to the evader, m.
        distances: (N,) of each pursuer to the evader, m.
        nearest: the pursuer nearest to the evader, active or not; the lowest id if several are, -1 if there is none.
    """

    def __init__(self, t: int, pursuers: Points, evader: complex, active: NDArray[np.bool_]):
        self.t = t
        self.pursuers = pursuers
        self.evader = evader
        self.active = active
        self.offsets: Points = evader - pursuers
        self.distances = lengths(self.offsets)
        self.nearest = int(self.distances.argmin()) if len(pursuers) else -1


def lengths(vectors: Points) -> Floats:
    """Return the (k,) absolute values, exactly those that `abs` gives of each; `np.abs` rounds by processor."""
    found: Floats = np.hypot(vectors.real, vectors.imag)
    return found


def complex_points(points: Sequence[Sequence[float]] | Floats) -> Points:
    """Return (k, 2) coordinates as (k,) complex numbers."""
    return np.ascontiguousarray(points, dtype=np.float64).view(np.complex128)[:, 0]


def coordinates(points: Points) -> Floats:
    """Return (k,) complex numbers as (k, 2) coordinates."""
    return np.ascontiguousarray(points).view(np.float64).reshape(-1, 2)
