"""Kinematics: the positions of all players (pursuers and evaders), on piecewise straight paths with common breakpoints.

A piece is the straight motion of a player between two breakpoints. A position is given in closed form, origin +
velocity * (t - since), without numerical integration. The position of one player is computed without the positions of
the others.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from desim.config.arrays import Integers, Points
from desim.kernel.clock import Clock
from desim.kernel.units import SECOND


class Kinematics:
    """The positions and velocities of K players.

    Args:
        env: the clock of the simulation.
        start: (K,) initial positions, m.
        static: whether all players stand still for the whole run.

    Attributes:
        velocities: (K,) velocities of the present pieces, m/s; replaced by `set_velocities`, never changed in place.
    """

    def __init__(self, env: Clock, start: Points, *, static: bool = False):
        self._env, self._static = env, static
        self.velocities: Points = np.zeros_like(start)
        self._origins, self._since = start, env.now
        self._positions, self._cached_at = start, env.now
        self._before_change: list[Callable[[], object]] = []
        start.setflags(write=False)

    def positions(self) -> Points:
        """Return the (K,) positions now, m; read-only."""
        now = self._env.now
        if self._cached_at != now and not self._static:
            self._positions = self._origins + self.velocities * ((now - self._since) / SECOND)
            self._positions.setflags(write=False)
            self._cached_at = now
        return self._positions

    def position(self, player: int) -> complex:
        """Return the position of one player now, m."""
        now = self._env.now
        if self._cached_at == now or self._static:
            return self._positions.item(player)
        return self._origins.item(player) + self.velocities.item(player) * ((now - self._since) / SECOND)

    def distances(self, player: int, others: Iterable[int]) -> list[float]:
        """Return the present distances of other players from one player, m."""
        now, start, velocity = self._env.now, self._origins.item, self.velocities.item
        if self._cached_at == now or self._static:
            place = self._positions.item
            here = place(player)
            return [abs(here - place(other)) for other in others]
        passed = (now - self._since) / SECOND
        here = start(player) + velocity(player) * passed
        return [abs(here - (start(other) + velocity(other) * passed)) for other in others]

    def positions_of(self, players: Sequence[int] | NDArray[np.intp]) -> Points:
        """Return the (k,) positions of some players now, m."""
        if self._cached_at == self._env.now or self._static:
            return self._positions[players]
        return self._origins[players] + self.velocities[players] * ((self._env.now - self._since) / SECOND)

    def positions_at(self, players: NDArray[np.intp], times: int | Integers) -> Points:
        """Return the (k,) positions of some players, m, at times (ns) of the present piece: one for all, or (k,)."""
        if self._static:
            return self._positions[players]
        return self._origins[players] + self.velocities[players] * ((times - self._since) / SECOND)

    def before_change(self, act: Callable[[], object]) -> None:
        """Register a function to call before a new piece begins."""
        self._before_change.append(act)

    def set_velocities(self, velocities: Points) -> None:
        """Begin a new straight piece of each path, at the present position and instant, with (K,) velocities, m/s."""
        for act in self._before_change:
            act()
        self._origins, self._since = self.positions(), self._env.now
        self.velocities = velocities
