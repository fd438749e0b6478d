"""Motion in straight pieces: everyone moves at constant velocity until its next break.

Between two breaks the position at any instant is a closed form, so reading it is exact however coarse the motion step.
Points and velocities are complex numbers, as in `desim.pursuit.state`.
"""

from math import inf

import numpy as np

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
