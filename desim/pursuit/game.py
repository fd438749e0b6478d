"""The pursuit game of Lee & Bakolas: times of capture, utilities, equilibria and the Gibbs law.

N pursuers each choose to chase (active) or to stay. With S the set of active pursuers, phi_i the time pursuer i would
need to capture the evader and r the time that is left, the global utility is

    U_E(S) = r - mean of phi_i over S,    U_E(empty) = 0.

Each pursuer maximises its wonderful-life utility U_i = U_E(S) - U_E(S without i), for which U_E is an exact potential
(Lee & Bakolas, "Relay Pursuit of an Evader by a Heterogeneous Group of Pursuers Using Potential Games"). A pursuer
with phi_i = inf can only stay; it is never part of S.
"""

from collections.abc import Sequence
from itertools import product
from math import exp, inf

import numpy as np
from numpy.typing import ArrayLike

from desim.pursuit.state import Floats

Profile = tuple[bool, ...]
"""Who is active, one truth per pursuer."""


def capture_time(
    evader: ArrayLike, pursuers: ArrayLike, speeds: ArrayLike, evader_speed: float, radius: float
) -> Floats:
    """Return the (N,) time each pursuer needs to capture an evader that flees straight from it, s.

    phi_i = (d_i - eps) / (v_i - v_e), the radial case of Lee & Bakolas, "Time-of-Capture"; 0 inside the capture
    ball, inf for a pursuer no faster than the evader.

    Args:
        evader: (2,) position, m.
        pursuers: (N, 2) positions, m.
        speeds: (N,) speeds of the pursuers, m/s.
        evader_speed: m/s.
        radius: of capture, eps, m.

    Raises:
        ValueError: if shapes disagree or radius <= 0.
    """
    offsets, v = _checked(evader, pursuers, speeds, radius)
    return RadialTime(v, evader_speed, radius)(np.hypot(offsets[:, 0], offsets[:, 1]))


NO_SPEED = 1e-12
"""A difference of speeds up to this is rounding, m/s."""


class RadialTime:
    """The (N,) times of capture of one team as a function of its (N,) distances alone; see `capture_time`."""

    def __init__(self, speeds: Floats, evader_speed: float, radius: float):
        closing = speeds - evader_speed
        self._radius = radius
        self.slow = closing <= NO_SPEED  # (N,) who can never capture
        self._some_slow = bool(self.slow.any())
        self._closing = np.where(self.slow, 1.0, closing)

    def __call__(self, distances: Floats) -> Floats:
        """Return the times of capture, s, given distances, m."""
        gap = np.maximum(distances - self._radius, 0.0)
        time = gap / self._closing
        if self._some_slow:
            time[self.slow & (gap > 0.0)] = inf
        return time


def intercept_time(
    evader: ArrayLike, evader_velocity: ArrayLike, pursuers: ArrayLike, speeds: ArrayLike, radius: float
) -> Floats:
    """Return the (N,) shortest time in which each pursuer can capture an evader of constant velocity, s.

    The smallest t >= 0 with |x_e + w t - x_i| <= v_i t + eps (Lee & Bakolas, "Time-of-Capture", any u_e); inf if
    there is none. Written so that it is stable whatever the sign of |w| - v_i.

    Args:
        evader: (2,) position, m.
        evader_velocity: (2,) velocity w, m/s.
        pursuers: (N, 2) positions, m.
        speeds: (N,) speeds of the pursuers, m/s.
        radius: of capture, eps, m.

    Raises:
        ValueError: if shapes disagree or radius <= 0.
    """
    offsets, v = _checked(evader, pursuers, speeds, radius)
    w = np.asarray(evader_velocity, dtype=float)
    a = w @ w - v**2
    b = offsets @ w - radius * v
    c = (offsets**2).sum(axis=1) - radius**2
    discriminant = b**2 - a * c
    denominator = np.sqrt(np.maximum(discriminant, 0.0)) - b
    meets = (discriminant >= 0.0) & (denominator > 0.0)
    time = np.full(c.shape, inf)
    np.divide(c, denominator, out=time, where=meets)
    time[c <= 0.0] = 0.0
    return time


def _checked(evader: ArrayLike, pursuers: ArrayLike, speeds: ArrayLike, radius: float) -> tuple[Floats, Floats]:
    e, p, v = (np.asarray(each, dtype=float) for each in (evader, pursuers, speeds))
    if e.shape != (2,) or p.shape != (len(p), 2) or v.shape != (len(p),):
        raise ValueError(f"shapes should be (2,), (N, 2) and (N,), got {e.shape}, {p.shape} and {v.shape}")
    if not radius > 0.0:
        raise ValueError(f"the capture radius should be greater than 0 m, got {radius}")
    return e - p, v


def potential(phi: Sequence[float], active: Sequence[bool], reward: float) -> float:
    """Return the global utility U_E of a profile, s: what is left of `reward` after the mean time of capture."""
    chasing = [phi_i for phi_i, a in zip(phi, active, strict=True) if a and phi_i < inf]
    return reward - sum(chasing) / len(chasing) if chasing else 0.0


def wonderful_life_utility(phi: Sequence[float], active: Sequence[bool], reward: float, i: int) -> float:
    """Return the marginal contribution of pursuer i to the global utility, U_E(S) - U_E(S without i), s."""
    without = [a and j != i for j, a in enumerate(active)]
    return potential(phi, active, reward) - potential(phi, without, reward)


def gain(own: float, others: Sequence[float], reward: float) -> float:
    """Return what a pursuer gains by being active rather than inactive, U_i(active) - U_i(inactive), s.

    Args:
        own: its own time of capture, s; inf gives -inf, for such a pursuer can only stay.
        others: the finite times of capture of the other active pursuers, s.
        reward: the time that is left, r, s.
    """
    n = len(others)
    return (sum(others) / n - own) / (n + 1) if n else reward - own


def best_response(own: float, others: Sequence[float], reward: float) -> bool:
    """Return whether being active is strictly better; see `gain`."""
    return gain(own, others, reward) > 0.0


def is_equilibrium(phi: Sequence[float], active: Sequence[bool], reward: float) -> bool:
    """Return whether no pursuer gains by changing its action alone (a pure Nash equilibrium)."""
    for i, own in enumerate(phi):
        others = [phi_j for j, phi_j in enumerate(phi) if active[j] and j != i and phi_j < inf]
        advantage = gain(own, others, reward)
        if advantage < 0.0 if active[i] else advantage > 0.0:
            return False
    return True


def equilibria(phi: Sequence[float], reward: float) -> list[Profile]:
    """Return all pure Nash equilibria by enumeration of the 2^N profiles; for small N."""
    return [profile for profile in profiles(len(phi)) if is_equilibrium(phi, profile, reward)]


def relay_pursuer(phi: Sequence[float], reward: float) -> int | None:
    """Return the pursuer of least (phi, index), or None if even that one would be late (phi >= reward)."""
    least = min(phi)
    return phi.index(least) if least < reward else None


def relay_profile(phi: Sequence[float], reward: float) -> Profile:
    """Return the profile in which the relay pursuer chases alone, or nobody if there is none.

    For distinct phi it is the only equilibrium of the game.
    """
    relay = relay_pursuer(phi, reward)
    return tuple(i == relay for i in range(len(phi)))


def profiles(count: int) -> list[Profile]:
    """Return all 2^count profiles in binary order, pursuer 0 first."""
    return list(product((False, True), repeat=count))


def gibbs(phi: Sequence[float], reward: float, tau: float) -> Floats:
    """Return the (2^N,) stationary law of log-linear learning at temperature tau (s), in the order of `profiles`.

    P(profile) is proportional to exp(U_E(profile) / tau): Blume 1993, "The Statistical Mechanics of Strategic
    Interaction".

    Raises:
        ValueError: if not all phi are finite.
    """
    if not np.isfinite(phi).all():
        raise ValueError(f"all times of capture should be finite, got {list(phi)}")
    u = np.array([potential(phi, profile, reward) for profile in profiles(len(phi))]) / tau
    weight = np.exp(u - u.max())
    return np.asarray(weight / weight.sum())


def activation_probability(advantage: float, inverse_temperature: float) -> float:
    """Return the probability with which Spatial Adaptive Play chooses to be active, given its gain (s).

    The logistic function of gain / tau (Lee & Bakolas, Algorithm 1), written so that it cannot overflow. A gain of
    -inf means that there is no choice: 0, even at infinite temperature.
    """
    if advantage == -inf:
        return 0.0
    x = advantage * inverse_temperature
    if x >= 0.0:
        return 1.0 / (1.0 + exp(-x))
    e = exp(x)
    return e / (1.0 + e)
