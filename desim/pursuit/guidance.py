"""Guidance: how a pursuer that chases heads for the evader.

A law maps what is seen of the evader to the velocities of the whole team. Points and velocities are complex numbers, as
in `desim.pursuit.state`.
"""

from typing import Literal, Protocol

import numpy as np

from desim.config.model import Value
from desim.pursuit.capture import NO_SPEED
from desim.pursuit.kinematics import SMALLEST, toward
from desim.pursuit.state import Floats, Points, lengths

EvaderVelocity = complex | Points
"""One velocity for all, or one for each pursuer."""


class Guidance(Protocol):
    """A law of guidance: `guidance(gaps, aims, flight, speeds)` is the (N,) velocities, m/s, none above its speed.

    Args:
        gaps: (N,) from each pursuer to its evader as it is seen, m: since the motion step began it moves at `flight`.
        aims: (N,) from each pursuer to where its evader will be at the end of the motion step if it moves first, else
            to where it was at its beginning (`motion.set_action`), m.
        flight: velocity of the evader as it is seen: that of the present step if the evader moves first, else that of
            the step before, m/s; (N,) if pursuers chase different evaders.
        speeds: (N,) m/s, 0 for who stays.
    """

    def __call__(self, gaps: Points, aims: Points, flight: EvaderVelocity, speeds: Floats) -> Points: ...  # noqa: D102


class PurePursuit(Value):
    """Head straight for the evader (Lee & Bakolas): u_i = (x_e - x_i) / |x_e - x_i|."""

    kind: Literal["pure_pursuit"] = "pure_pursuit"

    def __call__(self, gaps: Points, aims: Points, flight: EvaderVelocity, speeds: Floats) -> Points:
        """Return the (N,) velocities, m/s."""
        return toward(aims, speeds)


class ConstantBearing(Value):
    """Head for where one would meet the evader if it kept its velocity; who cannot meet it heads straight for it.

    The point is x_e + w t for the least t > 0 with |x_e + w t - x_i| = v_i t. On the way there the line of sight keeps
    its direction b (parallel navigation): across it the pursuer moves as the evader does, and what is left of its speed
    it spends along it, u = b (sqrt(v^2 - w_across^2) + i w_across). It closes in at sqrt(v^2 - w_across^2) - w_along;
    if that is not positive they do not meet.
    """

    kind: Literal["constant_bearing"] = "constant_bearing"

    def __call__(self, gaps: Points, aims: Points, flight: EvaderVelocity, speeds: Floats) -> Points:
        """Return the (N,) velocities, m/s."""
        distances = lengths(gaps)
        bearings = gaps / np.maximum(distances, SMALLEST)
        x, y = bearings.real, bearings.imag
        away, across = flight.real * x + flight.imag * y, flight.imag * x - flight.real * y  # of the line of sight
        rest = speeds**2 - across**2
        along = np.sqrt(np.maximum(rest, 0.0))
        meets = (rest >= 0.0) & (along - away > NO_SPEED) & (distances > 0.0)
        return np.where(meets, bearings * along + bearings * (1j * across), toward(aims, speeds))


def guided_velocities(law: Guidance, gaps: Points, aims: Points, flight: EvaderVelocity, speeds: Floats) -> Points:
    """Return the velocities that a law gives, m/s; the arguments as in `Guidance`.

    Raises:
        ValueError: if it leads anybody faster than at its speed.
    """
    velocities = law(gaps, aims, flight, speeds)
    if not isinstance(law, PurePursuit | ConstantBearing) and not (lengths(velocities) <= speeds * (1.0 + 1e-9)).all():
        raise ValueError(f"nobody should be led faster than at {speeds} m/s, got {velocities} from {law!r}")
    return velocities


def guided_velocity(law: Guidance, gap: complex, aim: complex, flight: complex, speed: float) -> complex:
    """Return the velocity that a law gives one pursuer, m/s; as `guided_velocities`."""
    if isinstance(law, PurePursuit):  # the same, several times faster
        return aim * (speed / max(abs(aim), SMALLEST))
    return complex(guided_velocities(law, np.array([gap]), np.array([aim]), flight, np.array([speed]))[0])
