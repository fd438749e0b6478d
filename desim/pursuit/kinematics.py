"""Where players are: everyone moves in straight pieces, which all began at one instant.

The position of anyone at any instant is a closed form, origin + velocity * (t - since): it is read, not integrated, so
reading that of one player costs nothing for the others.
"""

from collections.abc import Iterable, Sequence
from math import inf

import numpy as np
from numpy.typing import NDArray

from desim.kernel.clock import SECOND, Clock
from desim.pursuit.state import Floats, Points, lengths

SMALLEST = 1e-290
"""Stands in for a distance of 0, so that 0 / 0 is 0, m."""


def toward(gaps: Points, speeds: Floats) -> Points:
    """Return the velocities that close each gap at its speed, m/s; none where there is no gap.

    Args:
        gaps: (N,) from each pursuer to its target, m.
        speeds: (N,) m/s, 0 for who stays.
    """
    return gaps * (speeds / np.maximum(lengths(gaps), SMALLEST))


def first_contact(offsets: Points, velocities: Points, radius: float, duration: float) -> tuple[float, int] | None:
    """Return when, and for which row, a straight relative motion first comes within a radius of the origin.

    The smallest root of |p + s q| = eps over 0 <= s <= duration, 0 if it is inside already. Ties go to the lowest
    row.

    Args:
        offsets: (N,) relative positions p at s = 0, m.
        velocities: (N,) relative velocities q, m/s.
        radius: eps, m.
        duration: of the piece, s.

    Returns:
        (s, row), or None if nobody comes so near.
    """
    a = lengths(velocities) ** 2
    b = offsets.real * velocities.real + offsets.imag * velocities.imag
    c = lengths(offsets) ** 2 - radius**2
    discriminant = b**2 - a * c
    times = np.full(len(a), inf)
    # Approaching, and near enough: the smaller root, in the form that does not cancel.
    meets = (b < 0.0) & (discriminant >= 0.0)
    np.divide(c, np.sqrt(np.maximum(discriminant, 0.0)) - b, out=times, where=meets)
    times[c <= 0.0] = 0.0
    row = int(times.argmin())
    return (float(times[row]), row) if times[row] <= duration else None


def within(offsets: Points, radius: float) -> int | None:
    """Return the row of the (N,) offsets (m) that is nearest to the origin, if it is within a radius (m)."""
    distances = lengths(offsets)
    row = int(distances.argmin())
    return row if distances[row] <= radius else None


class Kinematics:
    """The positions and velocities of K players.

    Args:
        env: the clock of the simulation.
        start: (K,) positions as it begins, m.
        static: whether nobody ever moves.

    Attributes:
        velocities: (K,) of the present pieces, m/s; not to be written to.
    """

    def __init__(self, env: Clock, start: Points, *, static: bool = False):
        self._env, self._static = env, static
        self.velocities: Points = np.zeros_like(start)
        self._origins, self._since = start, env.now
        self._places, self._read = start, env.now
        start.setflags(write=False)

    @property
    def are_known(self) -> bool:
        """Whether somebody has asked for all positions at this instant."""
        return self._read == self._env.now or self._static

    def places(self) -> Points:
        """Return the (K,) positions now, m; not to be written to."""
        now = self._env.now
        if self._read != now and not self._static:
            self._places = self._origins + self.velocities * ((now - self._since) / SECOND)
            self._places.setflags(write=False)
            self._read = now
        return self._places

    def place(self, player: int) -> complex:
        """Return the position of one player now, m."""
        now = self._env.now
        if self._read == now or self._static:
            return self._places.item(player)
        return self._origins.item(player) + self.velocities.item(player) * ((now - self._since) / SECOND)

    def distances(self, player: int, others: Iterable[int]) -> list[float]:
        """Return how far some players are from another now, m."""
        now, start, velocity = self._env.now, self._origins.item, self.velocities.item
        if self._read == now or self._static:
            place = self._places.item
            here = place(player)
            return [abs(here - place(other)) for other in others]
        passed = (now - self._since) / SECOND
        here = start(player) + velocity(player) * passed
        return [abs(here - (start(other) + velocity(other) * passed)) for other in others]

    def places_of(self, players: Sequence[int] | NDArray[np.intp]) -> Points:
        """Return the (k,) positions of some players now, m."""
        if self._read == self._env.now or self._static:
            return self._places[players]
        return self._origins[players] + self.velocities[players] * ((self._env.now - self._since) / SECOND)

    def go(self, velocities: Points) -> None:
        """Begin new pieces here and now, (K,) m/s."""
        self._origins, self._since = self.places(), self._env.now
        self.velocities = velocities
