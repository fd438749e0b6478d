"""Capture times: the time that a pursuer needs to capture an evader whose motion is assumed.

The evader is assumed either to flee straight from pursuer i or to keep a constant velocity (Lee & Bakolas,
section "Time-of-Capture"). The capture time phi_i is inf if pursuer i can never capture the evader.
"""

from math import inf

import numpy as np
from numpy.typing import ArrayLike

from desim.config.arrays import Floats, Points
from desim.pursuit.core.geometry import SMALLEST
from desim.pursuit.core.state import lengths


def capture_time(
    evader: ArrayLike, pursuers: ArrayLike, speeds: ArrayLike, evader_speed: float, radius: float
) -> Floats:
    """Return the (N,) capture times, s, for an evader that flees straight from each pursuer.

    At distance d_i, phi_i = (d_i - eps) / (v_i - v_e): the radial case of Lee & Bakolas, section "Time-of-Capture".
    phi_i is 0 inside the capture radius. Beyond it, phi_i is inf for a pursuer no faster than the evader.

    Args:
        evader: (2,) position, m.
        pursuers: (N, 2) positions, m.
        speeds: (N,) speeds of the pursuers, m/s.
        evader_speed: speed of the evader, m/s.
        radius: capture radius eps, m.

    Raises:
        ValueError: if shapes disagree or radius <= 0.
    """
    e, p, v = (np.asarray(values, dtype=float) for values in (evader, pursuers, speeds))
    if e.shape != (2,) or p.shape != (len(p), 2) or v.shape != (len(p),):
        raise ValueError(f"shapes should be (2,), (N, 2) and (N,), got {e.shape}, {p.shape} and {v.shape}")
    if not radius > 0.0:
        raise ValueError(f"the capture radius should be greater than 0 m, got {radius}")
    return RadialTime(v, evader_speed, radius)(np.hypot(*(e - p).T))


NO_SPEED = 1e-12
"""Speed differences up to this value count as 0, m/s."""


class RadialTime:
    """The (N,) capture times of one team as a function of its (N,) distances to the evader; see `capture_time`.

    The method `of` computes one of them alone. Kept equal to the capture times of all by
    `tests/pursuit/test_capture.py::test_the_time_of_one_is_that_of_all_to_the_last_bit`.
    """

    def __init__(self, speeds: Floats, evader_speed: float, radius: float):
        closing = speeds - evader_speed
        self._radius = radius
        self.slow = closing <= NO_SPEED  # (N,) whether each pursuer is no faster than the evader
        self._some_slow = bool(self.slow.any())
        self._closing = np.where(self.slow, 1.0, closing)  # the times of slow pursuers are replaced by inf
        self._speeds, self._evader_speed = speeds.tolist(), evader_speed

    def __call__(self, distances: Floats) -> Floats:
        """Return the (N,) capture times, s, given (N,) distances, m."""
        gap = np.maximum(distances - self._radius, 0.0)
        time = gap / self._closing
        if self._some_slow:
            time[self.slow & (gap > 0.0)] = inf
        return time

    def of(self, pursuer: int, distance: float) -> float:
        """Return the capture time of one pursuer, s, given its distance, m."""
        return least_capture_time(distance, self._radius, self._speeds[pursuer], self._evader_speed)


def accelerated_capture_times(
    offsets: Points, velocities: Points, speeds: Floats, evader_speed: float, radius: float, limit: float
) -> Floats:
    """Return the (k,) capture times, s, of pursuers of limited acceleration for an evader that flees straight.

    The evader flees in the direction of `offsets`. A pursuer accelerates in a constant direction from its velocity u to
    v b, with b the direction to the evader, and then keeps this velocity. Let u_b be the component of u along b. The
    distance falls by (u_b - v_e) t + a_b t^2 / 2 until T = |v b - u| / a, where a_b = a (v - u_b) / |v b - u|.
    Afterwards it falls at the rate v - v_e. Motion across the line of sight is neglected. From rest, phi is
    (v_e + sqrt(v_e^2 + 2 a (d - eps))) / a up to v / a, and (d - eps + v^2 / (2 a)) / (v - v_e) beyond it.

    Args:
        offsets: (k,) vectors from each pursuer to the evader, m.
        velocities: (k,) velocities u of the pursuers, m/s.
        speeds: (k,) greatest speeds v of the pursuers, m/s.
        evader_speed: speed v_e of the evader, m/s.
        radius: capture radius eps, m.
        limit: greatest acceleration a, m/s^2.
    """
    distances = lengths(offsets)
    bearings = offsets / np.maximum(distances, SMALLEST)
    gap = np.maximum(distances - radius, 0.0)
    along = bearings.real * velocities.real + bearings.imag * velocities.imag  # u_b
    lag, change = np.maximum(speeds - along, 0.0), lengths(speeds * bearings - velocities)
    duration = change / limit  # T
    acceleration = lag / np.maximum(duration, SMALLEST)  # a_b
    closing = along - evader_speed
    root = np.sqrt(closing**2 + 2.0 * acceleration * gap)
    with np.errstate(divide="ignore", invalid="ignore"):
        # Two forms of the same root. In the form that is taken nothing cancels; only the other one may divide by 0.
        time = np.where(closing > 0.0, 2.0 * gap / (closing + root), (root - closing) / acceleration)
        # Until T, the mean closing speed is `closing + lag / 2`.
        straight = (gap - (closing + lag / 2.0) * duration) / (speeds - evader_speed)
        time = np.where(time <= duration, time, duration + straight)
    time[speeds - evader_speed <= NO_SPEED] = inf
    time[gap == 0.0] = 0.0
    return time


def least_capture_time(distance: float, radius: float, top_speed: float, evader_speed: float) -> float:
    """Return the capture time, s, of a pursuer of the greatest speed at a distance (m) from a fleeing evader.

    This is (d - eps) / (v_max - v_e), inf if no pursuer is faster than the evader, and 0 within the capture radius. No
    pursuer can truthfully announce a lower capture time.

    Args:
        distance: the distance d, m.
        radius: the capture radius eps, m.
        top_speed: the greatest speed v_max of a pursuer, m/s.
        evader_speed: the speed v_e of the evader, m/s.
    """
    gap, closing = distance - radius, top_speed - evader_speed
    return 0.0 if gap <= 0.0 else inf if closing <= NO_SPEED else gap / closing


def intercept_times(offsets: Points, velocities: Points, speeds: Floats, radius: float) -> Floats:
    """Return the (N,) or (K, N) least times, s, in which each pursuer can capture a target of constant velocity.

    This is the smallest t >= 0 with |x_e + w t - x_i| <= v_i t + eps, or inf if there is no such t (Lee & Bakolas,
    section "Time-of-Capture", for any constant velocity of the evader). The formula is numerically stable for any sign
    of |w| - v_i.

    Args:
        offsets: (N,) vectors from each pursuer to its target, m.
        velocities: velocities w of the targets, m/s: (N,), or (K, 1) for K velocities of one target.
        speeds: (N,) speeds of the pursuers, m/s.
        radius: capture radius eps, m.
    """
    x, y, w_x, w_y, v = offsets.real, offsets.imag, velocities.real, velocities.imag, speeds
    a = w_x**2 + w_y**2 - v**2
    b = w_x * x + w_y * y - radius * v
    c = x**2 + y**2 - radius**2
    discriminant = b**2 - a * c
    # The lesser root is c / (sqrt(b^2 - a c) - b). This form also holds at a = 0, where the usual one divides by 0.
    denominator = np.sqrt(np.maximum(discriminant, 0.0)) - b
    meets = (discriminant >= 0.0) & (denominator > 0.0)
    time = np.full(b.shape, inf)
    np.divide(c, denominator, out=time, where=meets)
    time[..., c <= 0.0] = 0.0
    return time
