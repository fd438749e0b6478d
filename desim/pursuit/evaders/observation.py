"""The observation that an evader has of the pursuit, from which its strategy chooses a heading."""

from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desim.config.arguments import value_text
from desim.config.arrays import Floats, Points
from desim.pursuit.core.state import State, lengths
from desim.pursuit.paths.space import PLANE, Plane


class EvaderObservation(State):
    """The observation of an evader: the perceived state of the pursuit, and the evader's parameters and heading.

    Unobserved pursuers are left out of all arrays. The others keep their order, but an index is not a pursuer id.

    Attributes:
        speeds: (N,) speeds of the pursuers, m/s.
        speed: speed of the evader, m/s.
        radius: capture radius, m.
        heading: present heading of the evader, of length at most 1; 0 at the start and while it stands still.
        elapsed: time since the evader chose this heading, s; 0 at the start.
        handover: whether an announcement of a change of action is in flight; always False unless a strategy in the run
            overhears the radio (its attribute `listens`).
        space: the space in which the players move. Among walls, `distances` are the lengths of the shortest paths from
            the pursuers, and `offsets` are as long and have the directions in which these paths arrive. Pursuers
            without a path are not observed.
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
        self.__dict__.update(state.__dict__)  # shares the arrays of `state`
        for array in (self.offsets, self.distances):
            array.setflags(write=False)
        self.speeds = speeds
        self.speed = speed
        self.radius = radius
        self.heading = heading
        self.elapsed = elapsed
        self.handover = handover
        self.space: Plane = PLANE

    def within(self, space: Plane) -> "EvaderObservation":
        """Return this observation with distances and offsets along the paths in a space; see the attribute `space`.

        Raises:
            ValueError: if it is no space: for example a distance, see `only`.
        """
        if not hasattr(space, "arrivals"):
            raise ValueError(
                f"within(space) takes a space; for the pursuers within 5 m write only(state.distances <= 5.0) (got"
                f" {value_text(space)})"
            )
        offsets = space.arrivals(self.evader, self.pursuers)
        has_path = np.isfinite(offsets)
        observation = copy(self.only(has_path))
        observation._set_paths(space, offsets[has_path])
        return observation

    def _set_paths(self, space: Plane, offsets: Points) -> None:
        """Set the space and the (N,) offsets along its paths, m, and what follows from them."""
        self.space, self.offsets, self.distances = space, offsets, lengths(offsets)
        self.nearest = int(self.distances.argmin()) if len(offsets) else -1
        for array in (self.offsets, self.distances):
            array.setflags(write=False)

    def only(self, who: NDArray[np.bool_]) -> "EvaderObservation":
        """Return this observation restricted to the pursuers in an (N,) mask.

        Raises:
            ValueError: if it is no mask: for example the numbers of pursuers.
        """
        mask: Any = who
        if getattr(getattr(mask, "dtype", None), "kind", "") != "b" or mask.shape != self.speeds.shape:
            raise ValueError(f"only(who) takes an array of {len(self.speeds)} booleans (got {value_text(mask)})")
        if who.all():
            return self
        observation = copy(self)
        observation.pursuers, observation.active = self.pursuers[who], self.active[who]
        observation.speeds = self.speeds[who]
        observation._set_paths(self.space, self.offsets[who])
        return observation
