"""Turning: shortest paths of bounded curvature, and the capture times of pursuers that turn at a limited rate.

A pursuer of speed v and turn rate omega moves forwards along paths of radius at least rho = v / omega. Its shortest
path to a point, with a free final heading, is an arc and a line. If the point lies within the circle on which the
pursuer would turn towards it, the path is an arc away from the point, and then an arc towards it (Boissonnat & Bui
1994, "Accessibility region for a car that only moves forwards along optimal paths"). Points are complex numbers; in
these paths the pursuer starts at the origin and heads along the x axis.
"""

from cmath import phase, rect
from math import acos, asin, inf, pi, sqrt

import numpy as np

from desim.config.arrays import Floats, Points
from desim.pursuit.motion.capture import NO_SPEED

MAX_ITERATIONS = 100
"""Maximum number of iterations for a root; most roots take 5."""
ROUNDING = 1e-14
"""Relative rounding error of a length."""
ANGLE_ROUNDING = 1e-9
"""An angle that is at most this value below a full turn, rad, counts as 0."""


def shortest_path(target: complex, rho: float) -> tuple[float, complex]:
    """Return the length, m, and the final heading of the shortest path to a target.

    For a target outside of the turning circle on its side, at the distance D from the centre of this circle, the length
    is rho ((theta - acos(rho / D)) mod 2 pi) + sqrt(D^2 - rho^2), where theta = atan2(x, rho - |y|).

    Args:
        target: position relative to the pursuer, which heads along the x axis, m.
        rho: the least radius, greater than 0, m.
    """
    x, y = target.real, abs(target.imag)
    squared = x * x + y * (y - 2.0 * rho)  # D^2 - rho^2
    if squared < 0.0:
        length, heading = _path_within(complex(x, y), rho)
    else:
        line = sqrt(squared)
        # The argument of this product is theta - acos(rho / D): one angle in place of two, and no arc cosine near 1.
        angle = phase(complex(rho - y, x) * complex(rho, -line)) % (2.0 * pi)
        if angle > 2.0 * pi - ANGLE_ROUNDING:
            angle = 0.0
        length, heading = rho * angle + line, rect(1.0, angle)
    return length, heading.conjugate() if target.imag < 0.0 else heading


def _path_within(target: complex, rho: float) -> tuple[float, complex]:
    """Return the length, m, and the final heading of the shortest path to a target within the left turning circle."""
    centre = complex(0.0, -rho)  # of the right turning circle
    offset = target - centre
    # The angle at `centre` in the triangle of both centres and the target, with the sides 2 rho, rho and |offset|.
    turn = acos(min((abs(offset) ** 2 + 3.0 * rho * rho) / (4.0 * rho * abs(offset)), 1.0))
    angle = phase(offset) - turn  # phase(offset) + turn gives a longer path
    second_centre = centre + rect(2.0 * rho, angle)  # of the second arc
    first_arc = (pi / 2.0 - angle) % (2.0 * pi)
    second_arc = phase((target - second_centre) / rect(-1.0, angle)) % (2.0 * pi)
    return rho * (first_arc + second_arc), 1j * (target - second_centre) / rho


def turning_capture_times(
    offsets: Points, headings: Points, speeds: Floats, evader_speed: float, radius: float, limit: float
) -> Floats:
    """Return the (k,) capture times, s, of pursuers of limited turn rate; see `turning_capture_time`.

    Args:
        offsets: (k,) vectors from each pursuer to the evader, m.
        headings: (k,) headings of the pursuers, of length 1.
        speeds: (k,) speeds v of the pursuers, m/s.
        evader_speed: speed of the evader, m/s.
        radius: capture radius eps, m.
        limit: greatest turn rate, rad/s.
    """
    pursuers = zip(offsets.tolist(), headings.tolist(), speeds.tolist(), strict=True)
    return np.array([turning_capture_time(*pursuer, evader_speed, radius, limit) for pursuer in pursuers], dtype=float)


def turning_capture_time(
    offset: complex, heading: complex, speed: float, evader_speed: float, radius: float, limit: float
) -> float:
    """Return the capture time, s, of a pursuer of limited turn rate for an evader that flees straight.

    This is the least t >= 0 with L(x_e + w t) - eps <= v t, where L is the length of the shortest path, and w the
    velocity of the evader, in the direction of `offset`. The capture time is 0 within the capture radius. Beyond this
    radius, it is inf for a pursuer no faster than the evader. As the evader moves away, L grows at most as fast as its
    distance, and jumps down where the evader leaves a turning circle. L - eps - v t therefore falls strictly, and
    changes its sign once.

    Args:
        offset: vector from the pursuer to the evader, m.
        heading: heading of the pursuer, of length 1.
        speed: speed v of the pursuer, m/s.
        evader_speed: speed of the evader, m/s.
        radius: capture radius eps, m.
        limit: greatest turn rate, rad/s.
    """
    if abs(offset) <= radius:
        return 0.0
    if speed - evader_speed <= NO_SPEED:
        return inf
    return _root(offset * heading.conjugate(), speed, speed / limit, evader_speed, radius)


def _root(target: complex, speed: float, rho: float, evader_speed: float, radius: float) -> float:
    """Return the time t, s, at which L - eps - v t changes its sign, by Newton's method within a bracket."""
    distance = abs(target)
    bearing = target * (1.0 / distance)
    low, high = 0.0, (distance + 4.0 * pi * rho) / (speed - evader_speed)  # L exceeds the distance by < 4 pi rho
    time, last_error = low, inf
    for _ in range(MAX_ITERATIONS):
        length, heading = shortest_path(target + bearing * (evader_speed * time), rho)
        missing = length - radius - speed * time  # m
        error = abs(missing)
        if error <= ROUNDING * (rho + speed * time) or high - low <= ROUNDING * high:
            break
        if missing > 0.0:
            low = time
        else:
            high = time
        growth = bearing.real * heading.real + bearing.imag * heading.imag  # of L, m per m that the evader moves
        newton_time = time + missing / (speed - evader_speed * growth)
        # Newton's method may alternate across the discontinuity, so a step that has not halved the error is followed by
        # a bisection.
        time = newton_time if error < last_error / 2.0 and low <= newton_time <= high else (low + high) / 2.0
        last_error = error
    return time


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
