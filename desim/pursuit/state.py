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
    """Where everyone is at one instant; its arrays are read-only.

    Attributes:
        t: the instant, ns.
        players: (N + 1,) positions of the pursuers, then of the evader, m.
        offsets: (N,) from each pursuer to the evader, m.
        distances: (N,) of each pursuer to the evader, m.
        nearest: the pursuer nearest to the evader, active or not; the lowest id if several are.
        active: (N,) who chases.
    """

    def __init__(self, t: int, players: Points, active: NDArray[np.bool_]):
        self.t = t
        self.players = players
        self.offsets: Points = players[-1] - players[:-1]
        self.distances: Floats = np.abs(self.offsets)
        self.nearest = int(self.distances.argmin())
        self.active = active
        for array in (players, active, self.offsets, self.distances):
            array.setflags(write=False)

    @property
    def pursuers(self) -> Points:
        """(N,) positions of the pursuers, m."""
        return self.players[:-1]

    @property
    def evader(self) -> complex:
        """Position of the evader, m."""
        return complex(self.players[-1])


def complex_points(points: Sequence[Sequence[float]] | Floats) -> Points:
    """Return (k, 2) coordinates as (k,) complex numbers."""
    return np.ascontiguousarray(points, dtype=np.float64).view(np.complex128)[:, 0]


def coordinates(points: Points) -> Floats:
    """Return (k,) complex numbers as (k, 2) coordinates."""
    return np.ascontiguousarray(points).view(np.float64).reshape(-1, 2)
