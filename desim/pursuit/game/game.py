"""The pursuit game of Lee & Bakolas: utilities, equilibria and the Gibbs distribution.

Each of N pursuers chooses to chase (active) or not (inactive). With S the set of active pursuers, phi_i the capture
time of pursuer i and r the time left, the global utility is

    U_E(S) = r - mean of phi_i over S,    U_E(empty) = 0.

Each pursuer maximises its wonderful-life utility U_i = U_E(S) - U_E(S without i), for which U_E is an exact potential
(Lee & Bakolas, "Relay Pursuit of an Evader by a Heterogeneous Group of Pursuers Using Potential Games"). A pursuer
with phi_i = inf can only be inactive; it is never part of S.
"""

from collections.abc import Callable, Collection, Sequence
from itertools import product
from math import exp, inf

import numpy as np

from desim.config.arrays import Floats
from desim.kernel.core.portable_math import portable_sum

Profile = tuple[bool, ...]
"""Whether each pursuer is active."""


def potential(phi: Sequence[float], active: Sequence[bool], reward: float) -> float:
    """Return the global utility U_E of a profile, s: `reward` less the mean capture time of the active pursuers."""
    chasing = [phi_i for phi_i, a in zip(phi, active, strict=True) if a and phi_i < inf]
    return reward - portable_sum(chasing) / len(chasing) if chasing else 0.0


def wonderful_life_utility(phi: Sequence[float], active: Sequence[bool], reward: float, i: int) -> float:
    """Return the marginal contribution of pursuer i to the global utility, U_E(S) - U_E(S without i), s."""
    without = [a and j != i for j, a in enumerate(active)]
    return potential(phi, active, reward) - potential(phi, without, reward)


def gain(own: float, others: Sequence[float], reward: float) -> float:
    """Return the gain of a pursuer from being active rather than inactive, U_i(active) - U_i(inactive), s.

    Args:
        own: its own capture time, s; inf gives -inf, because such a pursuer can only be inactive.
        others: the finite capture times of the other active pursuers, s.
        reward: the time left, r, s.
    """
    n = len(others)
    return (portable_sum(others) / n - own) / (n + 1) if n else reward - own


Gain = Callable[[float, Sequence[float], float], float]
"""The gain from being active, s: a function with the arguments of `gain` (own, others, reward)."""
Hearing = Sequence[Collection[int]]
"""For each pursuer the ids of the pursuers whose actions count in its utility."""


def is_equilibrium(
    phi: Sequence[float],
    active: Sequence[bool],
    reward: float,
    gain: Gain = gain,
    hearing: Hearing | None = None,
) -> bool:
    """Return whether no pursuer gains by changing its action alone (a pure Nash equilibrium).

    Args:
        phi: (N,) capture times, s; a pursuer with inf can only be inactive and does not count for the others.
        active: (N,) profile, whether each pursuer is active.
        reward: the time left, r, s.
        gain: gain from being active; `desim.pursuit.game.utility` has alternatives to the paper's.
        hearing: the pursuers whose actions count for each pursuer; all if None.
    """
    for i, own in enumerate(phi):
        heard = range(len(phi)) if hearing is None else hearing[i]
        others = [phi[j] for j in heard if active[j] and j != i and phi[j] < inf]
        advantage = gain(own, others, reward) if own < inf else -inf
        if advantage < 0.0 if active[i] else advantage > 0.0:
            return False
    return True


def equilibria(phi: Sequence[float], reward: float, gain: Gain = gain, hearing: Hearing | None = None) -> list[Profile]:
    """Return all pure Nash equilibria, by enumeration of the 2^N profiles, for small N; see `is_equilibrium`."""
    return [profile for profile in profiles(len(phi)) if is_equilibrium(phi, profile, reward, gain, hearing)]


def relay_pursuer(phi: Sequence[float], reward: float) -> int | None:
    """Return the pursuer of least capture time phi (ties: the lowest index), or None if its phi >= reward."""
    least = min(phi)
    return phi.index(least) if least < reward else None


def relay_profile(phi: Sequence[float], reward: float) -> Profile:
    """Return the profile in which only the relay pursuer is active; without a relay pursuer all are inactive.

    If the phi are distinct and the least differs from r, this profile is the unique equilibrium of the game.
    """
    relay = relay_pursuer(phi, reward)
    return tuple(i == relay for i in range(len(phi)))


def profiles(count: int) -> list[Profile]:
    """Return all 2^count profiles in lexicographic order, pursuer 0 first."""
    return list(product((False, True), repeat=count))


def gibbs(phi: Sequence[float], reward: float, tau: float) -> Floats:
    """Return the (2^N,) stationary distribution of log-linear learning at the temperature tau, s.

    The profiles are in the order of `profiles`. P(profile) is proportional to exp(U_E(profile) / tau): Blume 1993, "The
    Statistical Mechanics of Strategic Interaction".

    Raises:
        ValueError: if not all phi are finite.
    """
    if not np.isfinite(phi).all():
        raise ValueError(f"all capture times should be finite, got {list(phi)}")
    heights = [potential(phi, profile, reward) for profile in profiles(len(phi))]
    return np.array(logit(heights, 1.0 / tau))


def logit(utilities: Sequence[float], inverse_temperature: float) -> list[float]:
    """Return the probability of each action under log-linear learning, given the utilities (s).

    The probabilities are proportional to exp(utility / tau) (Lee & Bakolas, Algorithm 1), computed without overflow;
    `inverse_temperature` is 1 / tau, 1/s. If it is 0, the probabilities are uniform, even for infinite utilities.
    """
    if inverse_temperature == 0.0:
        return [1.0 / len(utilities)] * len(utilities)
    most = max(utilities)
    weights = [exp((each - most) * inverse_temperature) for each in utilities]
    total = portable_sum(weights)
    return [weight / total for weight in weights]


def greedy_maximal_independent_set(phi: Sequence[float], reward: float, hearing: Hearing) -> Profile:
    """Return the greedy maximal independent set of the graph `hearing`, as a profile.

    The nodes are the pursuers with phi < reward. In ascending order of (phi, index), a pursuer becomes active if it
    hears no active pursuer.
    """
    active = [False] * len(phi)
    for i in sorted(range(len(phi)), key=phi.__getitem__):
        active[i] = phi[i] < reward and not any(active[j] for j in hearing[i])
    return tuple(active)
