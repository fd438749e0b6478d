"""Turning: shortest paths of bounded curvature, and the capture times of pursuers that turn at a limited rate.

A pursuer of speed v and turn rate omega moves forwards along paths of radius at least rho = v / omega. Its shortest
path to a point, with a free final heading, is an arc and a line. If the point lies within the circle on which the
pursuer would turn towards it, the path is an arc away from the point, and an arc on the other side (Boissonnat & Bui
1994, "Accessibility region for a car that only moves forwards along optimal paths"). Points are complex numbers; here
the pursuer is at the origin and heads along the x axis.
"""

from cmath import phase, rect
from math import acos, asin, atan2, inf, pi, sqrt

import numpy as np

from desim.config.arrays import Floats, Points
from desim.pursuit.capture import NO_SPEED
from desim.pursuit.geometry import SMALLEST
from desim.pursuit.state import lengths

MAX_ITERATIONS = 100
"""Maximum number of iterations for a root; most roots take 5."""
ROUNDING = 1e-14
"""Relative rounding error of a length."""
JUMP = 1e-12
"""Relative distance from a discontinuity at which its sides are evaluated."""
ANGLE_ROUNDING = 1e-9
"""An angle less than a full turn by at most this value, rad, is 0."""


def shortest_paths(targets: Points, radii: Floats) -> tuple[Floats, Points]:
    """Return the (k,) lengths, m, and the (k,) final headings of the shortest paths to targets.

    For |y| beyond the turning circle, with D the distance of the target from the centre of this circle, the length is
    rho ((theta - acos(rho / D)) mod 2 pi) + sqrt(D^2 - rho^2), where theta = atan2(x, rho - |y|).

    Args:
        targets: (k,) positions relative to the pursuer, which heads along the x axis, m.
        radii: (k,) least radii rho, greater than 0, m.
    """
    x, y = targets.real, np.abs(targets.imag)
    squared = x * x + y * (y - 2.0 * radii)  # D^2 - rho^2
    line = np.sqrt(np.maximum(squared, 0.0))
    turned = (radii - y + 1j * x) * (radii - 1j * line)
    angles = np.array([atan2(z.imag, z.real) % (2.0 * pi) for z in turned.tolist()])
    angles[angles > 2.0 * pi - ANGLE_ROUNDING] = 0.0
    found: Floats = radii * angles + line
    headings = np.array([rect(1.0, angle) for angle in angles.tolist()], dtype=complex)
    for k in np.flatnonzero(squared < 0.0).tolist():
        found[k], headings[k] = _path_within(complex(x[k], y[k]), float(radii[k]))
    return found, np.where(targets.imag < 0.0, headings.conj(), headings)


def _path_within(target: complex, rho: float) -> tuple[float, complex]:
    """Return the length, m, and the final heading of the shortest path to a target within the left turning circle."""
    centre = complex(0.0, -rho)  # of the right turning circle
    there = target - centre
    half = acos(min((abs(there) ** 2 + 3.0 * rho * rho) / (4.0 * rho * abs(there)), 1.0))
    paths = []
    for angle in (phase(there) + half, phase(there) - half):
        second = centre + rect(2.0 * rho, angle)  # the centre of the second arc
        first_arc = (pi / 2.0 - angle) % (2.0 * pi)
        second_arc = phase((target - second) / rect(-1.0, angle)) % (2.0 * pi)
        paths.append((rho * (first_arc + second_arc), 1j * (target - second) / rho))
    return min(paths, key=lambda path: path[0])


def turning_capture_times(
    offsets: Points, headings: Points, speeds: Floats, evader_speed: float, radius: float, limit: float
) -> Floats:
    """Return the (k,) capture times, s, of pursuers of limited turn rate for an evader that flees straight.

    The evader flees in the direction of `offsets`; see `turning_intercept_times`.

    Args:
        offsets: (k,) vectors from each pursuer to the evader, m.
        headings: (k,) headings of the pursuers, of length 1.
        speeds: (k,) speeds of the pursuers, m/s.
        evader_speed: speed of the evader, m/s.
        radius: capture radius, m.
        limit: greatest turn rate, rad/s.
    """
    distances = lengths(offsets)
    flight = offsets * (evader_speed / np.maximum(distances, SMALLEST))
    return turning_intercept_times(offsets, flight, headings, speeds, radius, limit)


def turning_intercept_times(
    offsets: Points, velocities: Points, headings: Points, speeds: Floats, radius: float, limit: float
) -> Floats:
    """Return the (k,) least times t, s, with L(x_e + w t) - eps <= v t, where L is the length of the shortest path.

    The time is 0 within the capture radius. Beyond it, it is inf for a pursuer no faster than its target. Where the
    target crosses a turning circle, L is discontinuous; between these instants, L - v t falls strictly, so the root is
    found by Newton's method within a bracket.

    Args:
        offsets: (k,) vectors from each pursuer to its target, m.
        velocities: (k,) velocities w of the targets, m/s.
        headings: (k,) headings of the pursuers, of length 1.
        speeds: (k,) speeds v of the pursuers, m/s.
        radius: capture radius eps, m.
        limit: greatest turn rate, rad/s.
    """
    times = np.where(lengths(offsets) <= radius, 0.0, inf)
    able = (times > 0.0) & (speeds - lengths(velocities) > NO_SPEED)
    if able.any():
        back = headings[able].conj()
        chase = _Chase(offsets[able] * back, velocities[able] * back, speeds[able], speeds[able] / limit, radius)
        times[able] = chase.first_times()
    return times


class _Chase:
    """Several pursuers, each at the origin of its own plane and heading along the x axis, and their targets."""

    def __init__(self, targets: Points, velocities: Points, speeds: Floats, radii: Floats, radius: float):
        self._targets, self._velocities, self._speeds = targets, velocities, speeds
        self._radii, self._radius = radii, radius

    def first_times(self) -> Floats:
        """Return the (k,) least times t with L - eps <= v t, s."""
        end = (lengths(self._targets) + 4.0 * pi * self._radii) / (self._speeds - lengths(self._velocities))
        low, high = np.zeros(len(end)), end
        found = self._missing(low)[0] <= 0.0
        for instant in self._crossings(end):
            before, after = instant * (1.0 - JUMP), instant * (1.0 + JUMP)
            falls = ~found & (self._missing(before)[0] <= 0.0)  # between `low` and the crossing
            high, found = np.where(falls, before, high), found | falls
            jumps = ~found & (self._missing(after)[0] <= 0.0)
            low = np.where(found, low, np.where(jumps, before, after))
            high = np.where(jumps, after, high)
            found |= jumps
        return np.where(self._missing(low)[0] <= 0.0, low, self._root(low, high))

    def _missing(self, times: Floats) -> tuple[Floats, Floats]:
        """Return L - eps - v t, m, and its derivative, m/s, at (k,) times, s."""
        paths, headings = shortest_paths(self._targets + self._velocities * times, self._radii)
        w = self._velocities
        slopes = w.real * headings.real + w.imag * headings.imag - self._speeds
        return paths - self._radius - self._speeds * times, slopes

    def _crossings(self, end: Floats) -> Floats:
        """Return the instants, s, at which the targets cross a turning circle, as rows in ascending order; or `end`."""
        rows = []
        a = np.maximum(lengths(self._velocities) ** 2, SMALLEST)
        for side in (1j, -1j):
            from_centre = self._targets - side * self._radii
            b = from_centre.real * self._velocities.real + from_centre.imag * self._velocities.imag
            c = lengths(from_centre) ** 2 - self._radii**2
            root = np.sqrt(np.maximum(b * b - a * c, 0.0))
            for instant in ((-b - root) / a, (-b + root) / a):
                crosses = (b * b > a * c) & (instant > 0.0) & (instant < end)
                rows += [np.where(crosses, instant, end)]
        ordered = np.sort(np.array(rows), axis=0)
        return ordered[(ordered < end).any(axis=1)]

    def _root(self, low: Floats, high: Floats) -> Floats:
        """Return the (k,) roots of `_missing`, s, each within its bracket."""
        times = low
        for _ in range(MAX_ITERATIONS):
            missing, slopes = self._missing(times)
            known = np.abs(missing) <= ROUNDING * (self._radii + self._speeds * times)
            if (known | (high - low <= 4.0 * JUMP * high)).all():
                break
            low, high = np.where(missing > 0.0, times, low), np.where(missing > 0.0, high, times)
            step = times - missing / slopes
            times = np.where((step >= low) & (step <= high), step, (low + high) / 2.0)
        return times


def least_capture_radius(turning_radius: float, speed_ratio: float) -> float:
    """Return the capture radius, m, above which a pursuer of limited turn rate captures an evader from anywhere.

    It is rho (sqrt(1 - g^2) + g asin(g) - 1), where g = v_e / v (Isaacs 1965, "Differential Games", the homicidal
    chauffeur). With a smaller capture radius, an evader that turns aside in time is never captured.

    Args:
        turning_radius: the least turning radius rho of the pursuer, m.
        speed_ratio: the speed g of the evader as a share of that of the pursuer, in [0, 1).

    Raises:
        ValueError: if the pursuer is not faster than the evader.
    """
    if not 0.0 <= speed_ratio < 1.0:
        raise ValueError(f"the evader should be slower than the pursuer, got {speed_ratio:g} of its speed")
    g = speed_ratio
    return turning_radius * (sqrt(1.0 - g * g) + g * asin(g) - 1.0)
