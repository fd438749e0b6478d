"""The state of the pursuit at one instant, as its strategies see it."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class State:
    """Where everyone is at one instant; its arrays are read-only.

    Attributes:
        t: the instant, ns.
        players: (N + 1, 2) positions of the pursuers, then of the evader, m.
        offsets: (N, 2) from each pursuer to the evader, m.
        distances: (N,) of each pursuer to the evader, m.
        active: (N,) who chases.
    """

    def __init__(self, t: int, players: Floats, active: NDArray[np.bool_]):
        self.t = t
        self.players = players
        self.offsets = players[-1] - players[:-1]
        self.distances = np.hypot(self.offsets[:, 0], self.offsets[:, 1])
        self.active = active

    @property
    def pursuers(self) -> Floats:
        """(N, 2) positions of the pursuers, m."""
        return self.players[:-1]

    @property
    def evader(self) -> Floats:
        """(2,) position of the evader, m."""
        return self.players[-1]

    @cached_property
    def nearest(self) -> int:
        """The pursuer nearest to the evader, active or not; the lowest id if several are."""
        return int(self.distances.argmin())
