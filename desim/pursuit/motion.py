"""Motion in straight pieces: everyone moves at constant velocity until its next break.

Between two breaks the position at any instant is a closed form, so reading it is exact however coarse the motion step.
"""

from math import inf

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def toward(target: Floats, origins: Floats, speeds: Floats) -> Floats:
    """Return the (N, 2) velocities that head from each origin for the target at its speed; none at distance 0.

    Args:
        target: (2,) position, m.
        origins: (N, 2) positions, m.
        speeds: (N,) m/s, 0 for who stays.
    """
    gaps = target - origins
    distances = np.hypot(gaps[:, 0], gaps[:, 1])
    rates = np.zeros(len(distances))
    np.divide(speeds, distances, out=rates, where=distances > 0.0)
    return gaps * rates[:, np.newaxis]


def first_contact(offsets: Floats, velocities: Floats, radius: float, duration: float) -> tuple[float, int] | None:
    """Return when, and for which row, a straight relative motion first comes within a radius of the origin.

    The smallest root of |p + s q| = eps over 0 <= s <= duration, 0 if it is inside already. Ties go to the lowest
    row.

    Args:
        offsets: (N, 2) relative positions p at s = 0, m.
        velocities: (N, 2) relative velocities q, m/s.
        radius: eps, m.
        duration: of the piece, s.

    Returns:
        (s, row), or None if nobody comes so near.
    """
    a = np.einsum("ij,ij->i", velocities, velocities)
    b = np.einsum("ij,ij->i", offsets, velocities)
    c = np.einsum("ij,ij->i", offsets, offsets) - radius**2
    discriminant = b**2 - a * c
    times = np.full(len(a), inf)
    # Approaching and deep enough: the smaller root, in the form that does not cancel.
    meets = (b < 0.0) & (discriminant >= 0.0)
    np.divide(c, np.sqrt(np.maximum(discriminant, 0.0)) - b, out=times, where=meets)
    times[c <= 0.0] = 0.0
    row = int(times.argmin())
    return (float(times[row]), row) if times[row] <= duration else None


def within(offsets: Floats, radius: float) -> int | None:
    """Return the row of the (N, 2) offsets (m) that is nearest to the origin if it is within a radius (m)."""
    distances = np.hypot(offsets[:, 0], offsets[:, 1])
    row = int(distances.argmin())
    return row if distances[row] <= radius else None
