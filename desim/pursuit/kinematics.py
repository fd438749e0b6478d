"""Kinematics: the positions of all players, which move on straight pieces that begin at a common instant.

A position is a closed form, origin + velocity * (t - since). Nothing is integrated, and reading the position of one
player has no cost for the others.
"""

from collections.abc import Iterable, Sequence
from math import inf

import numpy as np
from numpy.typing import NDArray

from desim.kernel.clock import SECOND, Clock
from desim.pursuit.state import Floats, Points, lengths

SMALLEST = 1e-290
"""Lower bound of divisors, so that a gap of 0 has a direction of 0, m."""


def toward(gaps: Points, speeds: Floats) -> Points:
    """Return the (N,) velocities that close each gap at its speed, m/s; 0 for a gap of 0.

    Args:
        gaps: (N,) from each pursuer to its target, m.
        speeds: (N,) speeds, m/s, 0 for pursuers that stay.
    """
    return gaps * (speeds / np.maximum(lengths(gaps), SMALLEST))


def first_contact(offsets: Points, velocities: Points, radius: float, duration: float) -> tuple[float, int] | None:
    """Return the first time, and the row, at which a straight relative motion comes within a radius of the origin.

    The smallest root of |p + s q| = eps over 0 <= s <= duration, 0 if |p| <= eps. Ties go to the lowest row.

    Args:
        offsets: (N,) relative positions p at s = 0, m.
        velocities: (N,) relative velocities q, m/s.
        radius: eps, m.
        duration: length of the interval, s.

    Returns:
        (s, row), or None without a contact.
    """
    a = lengths(velocities) ** 2
    b = offsets.real * velocities.real + offsets.imag * velocities.imag
    c = lengths(offsets) ** 2 - radius**2
    discriminant = b**2 - a * c
    times = np.full(len(a), inf)
    # Approaching and passing within the radius: the smaller root, in the form without cancellation.
    meets = (b < 0.0) & (discriminant >= 0.0)
    np.divide(c, np.sqrt(np.maximum(discriminant, 0.0)) - b, out=times, where=meets)
    times[c <= 0.0] = 0.0
    row = int(times.argmin())
    return (float(times[row]), row) if times[row] <= duration else None


def within(offsets: Points, radius: float) -> int | None:
    """Return the row of the (N,) offsets (m) nearest to the origin, or None if it is outside a radius (m)."""
    distances = lengths(offsets)
    row = int(distances.argmin())
    return row if distances[row] <= radius else None


class Kinematics:
    """The positions and velocities of K players.

    Args:
        env: the clock of the simulation.
        start: (K,) initial positions, m.
        static: whether all players stand still for the whole run.

    Attributes:
        velocities: (K,) velocities of the present pieces, m/s; read-only.
    """

    def __init__(self, env: Clock, start: Points, *, static: bool = False):
        self._env, self._static = env, static
        self.velocities: Points = np.zeros_like(start)
        self._origins, self._since = start, env.now
        self._places, self._read = start, env.now
        start.setflags(write=False)

    @property
    def are_known(self) -> bool:
        """Whether all positions of this instant are cached."""
        return self._read == self._env.now or self._static

    def places(self) -> Points:
        """Return the (K,) positions now, m; read-only."""
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
        """Return the distances of some players from another now, m."""
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
        """Begin new straight pieces at the present positions and instant, with (K,) velocities, m/s."""
        self._origins, self._since = self.places(), self._env.now
        self.velocities = velocities
