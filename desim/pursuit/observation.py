"""What an evader knows as it chooses a heading."""

import numpy as np
from numpy.typing import NDArray

from desim.pursuit.state import Floats, State


class EvaderObservation(State):
    """The state of the pursuit as an evader sees it, what it knows of itself, and what it did before.

    Those it does not see are in no array, so that pursuers keep their order but not their numbers.

    Attributes:
        speeds: (N,) of the pursuers, m/s.
        speed: its own, m/s.
        radius: distance at which it is captured, m.
        heading: the one it has, at most 1 long; 0 if it stands still, and at first.
        elapsed: time since it chose that, s; 0 at first.
        handover: whether word of a change of action is in flight; False for whoever does not listen to the radio.
    """

    def __init__(
        self,
        state: State,
        speeds: Floats,
        speed: float,
        radius: float,
        heading: complex = 0j,
        elapsed: float = 0.0,
        handover: bool = False,
    ):
        self.__dict__.update(state.__dict__)  # the same arrays
        for array in (self.offsets, self.distances):
            array.setflags(write=False)
        self.speeds = speeds
        self.speed = speed
        self.radius = radius
        self.heading = heading
        self.elapsed = elapsed
        self.handover = handover

    def only(self, who: NDArray[np.bool_]) -> "EvaderObservation":
        """Return the outlook of an evader that sees only (N,) some of the pursuers."""
        if who.all():
            return self
        return EvaderObservation(
            State(self.t, self.pursuers[who], self.evader, self.active[who]),
            self.speeds[who],
            self.speed,
            self.radius,
            self.heading,
            self.elapsed,
            self.handover,
        )
