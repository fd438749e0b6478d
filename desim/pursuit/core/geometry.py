"""Geometry of straight motion: velocities towards a target, first contact, and distance.

All functions are pure functions of arrays, independent of the simulation.
"""

from math import inf

import numpy as np

from desim.config.arrays import Floats, Points
from desim.pursuit.core.state import lengths

SMALLEST = 1e-290
"""Lower bound, m, of a length that is used as a divisor; with this bound, the direction of a zero vector is 0."""


def toward(gaps: Points, speeds: Floats) -> Points:
    """Return the (N,) velocities, m/s, along the gaps at the given speeds; 0 for a gap of 0.

    Args:
        gaps: (N,) vectors from each pursuer to its target, m.
        speeds: (N,) speeds, m/s, 0 for inactive pursuers.
    """
    return gaps * (speeds / np.maximum(lengths(gaps), SMALLEST))


def first_contact(offsets: Points, velocities: Points, radius: float, duration: float) -> tuple[float, int] | None:
    """Return the time and the row of the first of N straight motions to come within a radius of the origin.

    The time is the smallest root of |p + s q| = eps in 0 <= s <= duration, or 0 if |p| <= eps. Ties go to the lowest
    row.

    Args:
        offsets: (N,) relative positions p at s = 0, m.
        velocities: (N,) relative velocities q, m/s.
        radius: eps, m.
        duration: length of the interval, s.

    Returns:
        (time, s; row of the motion), or None without a contact.
    """
    a = lengths(velocities) ** 2
    b = offsets.real * velocities.real + offsets.imag * velocities.imag
    c = lengths(offsets) ** 2 - radius**2
    discriminant = b**2 - a * c
    times = np.full(len(a), inf)
    # Motions that approach and pass within the radius: the smaller root, in the form without cancellation.
    meets = (b < -1e-200) & (discriminant >= 0.0)  # a slower approach has a time that overflows
    np.divide(c, np.sqrt(np.maximum(discriminant, 0.0)) - b, out=times, where=meets)
    times[c <= 0.0] = 0.0
    row = int(times.argmin())
    return (float(times[row]), row) if times[row] <= duration else None


def moved_towards(position: complex, evader: complex, length: float) -> complex:
    """Return the position, m, after moving a length (m) straight towards the evader, at most up to the evader."""
    gap = evader - position
    return evader - max(abs(gap) - length, 0.0) * gap / max(abs(gap), SMALLEST)
