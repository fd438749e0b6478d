"""A target: one of the evaders of a run, with all that is particular to it."""

from collections.abc import Collection, Iterable
from math import inf
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from desim.kernel.clock import SECOND, seconds
from desim.pursuit.capture import RadialTime
from desim.pursuit.kinematics import Kinematics
from desim.pursuit.motion import first_contact, within
from desim.pursuit.perception import Mind
from desim.pursuit.reckoning import Path
from desim.pursuit.state import Floats, Points, State
from desim.value import FARTHEST

SINGLY = 16
"""Up to so many pursuers it is faster to ask for each by itself than for all at once."""


class Target:
    """An evader that flees, what its speed makes of the pursuers, and what is known of it at this instant.

    Args:
        number: 1 .. M, which is the action of a pursuer that chases it.
        speed: m/s.
        mind: how it chooses its heading.
        path: its path, as pursuers see it.
        players: where everyone is: the N pursuers, then the evaders in order.
        speeds: (N,) of the pursuers, m/s.
        radius: distance at which it is captured, m.

    Attributes:
        slow: (N,) who can never capture it.
        captured: when it was, ns; None if it has not been.
        player: its number among the players.
    """

    def __init__(
        self,
        number: int,
        speed: float,
        mind: Mind,
        path: Path,
        *,
        players: Kinematics,
        speeds: Floats,
        radius: float,
    ):
        self.number, self.speed, self.path = number, speed, path
        self._size, self._radius = len(speeds), radius
        self.player = self._size + number - 1
        self._mind, self._players = mind, players
        self._radial_time = RadialTime(speeds, speed, radius)
        self.slow: list[bool] = self._radial_time.slow.tolist()
        self._closing_bound = max(float(speeds.max()) + speed, 1e-9)  # at least how fast a distance to it can fall, m/s
        self.captured: int | None = None
        self._chasers: NDArray[np.bool_] = np.zeros(self._size, dtype=bool)
        self._safe_until = -1  # nobody can capture it before, ns
        self._state: State | None = None
        self._read: Points | None = None  # the positions of which that is the state
        self._times: tuple[float, ...] | None = None

    @property
    def place(self) -> complex:
        """Where it is now, m."""
        return self._players.place(self.player)

    def let_chase(self, chasers: NDArray[np.bool_]) -> None:
        """Take note of (N,) who chases it from now on."""
        chasers.setflags(write=False)
        self._chasers, self._read = chasers, None

    def state(self, now: int) -> State:
        """Return where the pursuers and it are now (ns), and who chases it."""
        places = self._players.places()
        if self._state is None or places is not self._read:
            self._state = State(now, places[: self._size], places.item(self.player), self._chasers)
            self._read, self._times = places, None
        return self._state

    def capture_times(self, now: int) -> tuple[float, ...]:
        """Return every pursuer's time of capture now (ns), s; inf once it has been captured."""
        if self.captured is not None:
            return (inf,) * self._size
        state = self.state(now)
        if self._times is None:
            self._times = tuple(self._radial_time(state.distances).tolist())
        return self._times

    def capture_times_of(self, pursuers: Collection[int], now: int) -> list[float]:
        """Return the times of capture of some pursuers now (ns), s; inf once it has been captured."""
        if len(pursuers) > SINGLY or self.captured is not None:
            times = self.capture_times(now)
            return [times[pursuer] for pursuer in pursuers]
        if self._players.are_known:
            distances: Iterable[float] = map(self.state(now).distances.item, pursuers)
        else:
            distances = self._players.distances(self.player, pursuers)
        return list(map(self._radial_time.of, pursuers, distances))

    def capture_time_over(self, pursuer: int, distance: float) -> float:
        """Return the time of capture of a pursuer over a distance (m), s."""
        return self._radial_time.of(pursuer, distance)

    def capture_times_over(self, distances: Floats) -> tuple[float, ...]:
        """Return every pursuer's time of capture over (N,) distances (m), s."""
        return tuple(self._radial_time(distances).tolist())

    def flight(self, state: State, *, handover: bool) -> complex:
        """Return the velocity it chooses in the present state, m/s; 0 once it has been captured.

        Args:
            state: as `state` returns it.
            handover: whether word of a change of action is in flight.
        """
        if self.captured is not None:
            return 0j
        return self.speed * self._mind.heading(state, handover)

    def contact(
        self, now: int, until: int, broken: NDArray[np.bool_], test: Literal["segment", "sample"]
    ) -> tuple[float, int] | None:
        """Return in how many s, and by whom, it is captured if everybody goes on until an instant; None if it is not.

        Args:
            now: ns.
            until: ns.
            broken: (N,) who captures nobody.
            test: see `desim.scenario.Capture`.
        """
        if until <= self._safe_until:
            return None
        state, duration = self.state(now), seconds(until - now)
        gap = state.distances.item(state.nearest) - self._radius
        # Whatever all do; a little less, for rounding, and nothing if there is no gap.
        self._safe_until = now - 1 + int(0.999 * gap / self._closing_bound * SECOND)
        if until <= self._safe_until:
            return None
        velocities = self._players.velocities
        approach = velocities[self.player] - velocities[: self._size]
        offsets = np.where(broken, FARTHEST, state.offsets) if broken.any() else state.offsets
        if test == "segment":
            return first_contact(offsets, approach, self._radius, duration)
        row = within(offsets + approach * duration, self._radius)
        return None if row is None else (duration, row)
