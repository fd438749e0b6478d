"""The pursuit game of Lee & Bakolas: utilities, equilibria and the Gibbs law.

N pursuers each choose to chase (active) or to stay. With S the set of active pursuers, phi_i the time pursuer i would
need to capture the evader and r the time that is left, the global utility is

    U_E(S) = r - mean of phi_i over S,    U_E(empty) = 0.

Each pursuer maximises its wonderful-life utility U_i = U_E(S) - U_E(S without i), for which U_E is an exact potential
(Lee & Bakolas, "Relay Pursuit of an Evader by a Heterogeneous Group of Pursuers Using Potential Games"). A pursuer
with phi_i = inf can only stay; it is never part of S.
"""

from collections.abc import Callable, Collection, Sequence
from itertools import product
from math import exp, inf

import numpy as np

from desim.pursuit.state import Floats

Profile = tuple[bool, ...]
"""Who is active, one truth per pursuer."""


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


Gain = Callable[[float, Sequence[float], float], float]
"""What a pursuer gains by being active, as a function of its own time of capture, those of others and the reward."""
Hearing = Sequence[Collection[int]]
"""For each pursuer, whose actions count for it."""


def is_equilibrium(
    phi: Sequence[float],
    active: Sequence[bool],
    reward: float,
    gain: Gain = gain,
    hearing: Hearing | None = None,
) -> bool:
    """Return whether no pursuer gains by changing its action alone (a pure Nash equilibrium).

    Args:
        phi: the times of capture, s; who has inf can only stay, and does not count for the others.
        active: who chases.
        reward: the time that is left, r, s.
        gain: the utility of being active; `desim.pursuit.utility` has others than the paper's.
        hearing: whose actions count for whom; everyone's for everyone if None.
    """
    for i, own in enumerate(phi):
        heard = range(len(phi)) if hearing is None else hearing[i]
        others = [phi[j] for j in heard if active[j] and j != i and phi[j] < inf]
        advantage = gain(own, others, reward) if own < inf else -inf
        if advantage < 0.0 if active[i] else advantage > 0.0:
            return False
    return True


def equilibria(phi: Sequence[float], reward: float, gain: Gain = gain, hearing: Hearing | None = None) -> list[Profile]:
    """Return all pure Nash equilibria by enumeration of the 2^N profiles, for small N; see `is_equilibrium`."""
    return [profile for profile in profiles(len(phi)) if is_equilibrium(phi, profile, reward, gain, hearing)]


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
    heights = [potential(phi, profile, reward) for profile in profiles(len(phi))]
    return np.array(logit(heights, 1.0 / tau))


def logit(utilities: Sequence[float], inverse_temperature: float) -> list[float]:
    """Return the probability of each action under log-linear learning, given what the actions are worth (s).

    Proportional to exp(utility / tau) (Lee & Bakolas, Algorithm 1), written so that it cannot overflow; uniform at
    infinite temperature (0 1/s), whatever the actions are worth.
    """
    if inverse_temperature == 0.0:
        return [1.0 / len(utilities)] * len(utilities)
    most = max(utilities)
    weights = [exp((each - most) * inverse_temperature) for each in utilities]
    total = sum(weights)
    return [weight / total for weight in weights]


def greedy_maximal_independent_set(phi: Sequence[float], reward: float, hearing: Hearing) -> Profile:
    """Return who chases if, in order of (phi, index), each does that would be in time and hears nobody who does."""
    active = [False] * len(phi)
    for i in sorted(range(len(phi)), key=phi.__getitem__):
        active[i] = phi[i] < reward and not any(active[j] for j in hearing[i])
    return tuple(active)
