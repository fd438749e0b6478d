"""The pursuit game of Lee & Bakolas with one or several evaders: utilities, equilibria, assignments.

Each of N pursuers chooses one of M evaders or is inactive: an action is 0 or the number of an evader, 1 .. M. Let
phi_ij be the capture time of pursuer i for evader j, and r the time left. The global utility is

    Phi = sum over the chased evaders j of (r - mean of phi_ij over the pursuers that chase j).

With one evader Phi is U_E(S) = r - mean of phi_i over the set S of active pursuers, and U_E(empty) = 0. Each pursuer
maximises its wonderful-life utility: its marginal contribution to the term of its evader. Phi is an exact potential of
these utilities (Lee & Bakolas, "Relay Pursuit of an Evader by a Heterogeneous Group of Pursuers Using Potential
Games"). A pursuer with phi_ij = inf never counts among those that chase j.

If the capture times are distinct, every equilibrium is a matching: if several pursuers chase one evader, the one with
the greatest capture time gains by becoming inactive. There are often many equilibria; the optimal profile, a
maximum-weight matching, is one of them.

If the capture times are distinct, every equilibrium has at least a third of the optimal global utility, and this bound
is tight. Proof: let u_i be the utility of pursuer i in the equilibrium, which is a matching. For each pursuer i that
the optimal profile assigns to an evader, let w_i be its utility if it chased this evader alone. Pursuer i does not gain
by deviating to this evader. Hence w_i <= u_i if no other pursuer chases the evader in the equilibrium. If pursuer m
chases it, (w_i - u_m) / 2 <= u_i, or w_i <= 2 u_i + u_m. Each m occurs for one i only. The sum of all w_i, which is the
optimal global utility, is therefore at most 3 times the sum of all u_i.

Capture times `phi` are an (N, M) matrix or, with one evader, N numbers; then an action may also be a truth value.
Functions raise ValueError if `phi` is neither, or if `actions` are not N numbers from 0 to M.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import product
from math import exp, inf

import numpy as np
from numpy.typing import ArrayLike

from desim.config.arrays import Floats
from desim.kernel.core.portable_math import portable_sum

Profile = tuple[int, ...]
"""The action of each pursuer: 0 to be inactive, j to chase evader j."""


def welfare(phi: ArrayLike, actions: Sequence[int], reward: float) -> float:
    """Return the global utility Phi of a profile, s.

    Args:
        phi: (N, M) capture times, s; a pursuer with inf for its evader does not count.
        actions: (N,) action of each pursuer.
        reward: the time left, r, s.
    """
    columns = enumerate(_columns(phi, actions), start=1)
    teams = ([t for t, a in zip(times, actions, strict=True) if a == j] for j, times in columns)
    return portable_sum(_term(team, reward) for team in teams)


def wonderful_life_utility(phi: ArrayLike, actions: Sequence[int], reward: float, i: int) -> float:
    """Return the marginal contribution of pursuer i to the global utility, s; only the term of its evader changes."""
    columns = _columns(phi, actions)
    if not actions[i]:
        return 0.0
    times = columns[actions[i] - 1]
    team = [j for j, action in enumerate(actions) if action == actions[i]]
    return _term([times[j] for j in team], reward) - _term([times[j] for j in team if j != i], reward)


def _term(times: Sequence[float], reward: float) -> float:
    """Return the term of an evader in the global utility, s, given the capture times of those that chase it."""
    chasing = [time for time in times if time < inf]
    return reward - portable_sum(chasing) / len(chasing) if chasing else 0.0


def gain(own_time: float, other_times: Sequence[float], reward: float) -> float:
    """Return the gain of a pursuer from being active rather than inactive, U_i(active) - U_i(inactive), s.

    Args:
        own_time: its own capture time, s; inf gives -inf, because such a pursuer can only be inactive.
        other_times: the finite capture times of the other active pursuers, s.
        reward: the time left, r, s.
    """
    n = len(other_times)
    return (portable_sum(other_times) / n - own_time) / (n + 1) if n else reward - own_time


Gain = Callable[[float, Sequence[float], float], float]
"""The gain from being active, s: a function with the arguments of `gain` (own_time, other_times, reward)."""
Hearing = Sequence[Collection[int]]
"""For each pursuer the ids of the pursuers whose actions count in its utility."""


def is_equilibrium(
    phi: ArrayLike,
    actions: Sequence[int],
    reward: float,
    gain: Gain = gain,
    hearing: Hearing | None = None,
) -> bool:
    """Return whether no pursuer gains by changing its action alone (a pure Nash equilibrium).

    Args:
        phi: (N, M) capture times, s; inf: the pursuer cannot chase the evader, and does not count for other pursuers.
        actions: (N,) action of each pursuer.
        reward: the time left, r, s.
        gain: gain from being active; `desim.pursuit.game.utility` has alternatives to the paper's.
        hearing: the pursuers whose actions count for each pursuer; all if None.
    """
    columns = _columns(phi, actions)
    for i, action in enumerate(actions):
        heard = range(len(actions)) if hearing is None else hearing[i]
        gains = [0.0]
        for evader, times in enumerate(columns, start=1):
            other_times = [times[j] for j in heard if actions[j] == evader and j != i and times[j] < inf]
            gains.append(gain(times[i], other_times, reward) if times[i] < inf else -inf)
        if gains[action] < max(gains):
            return False
    return True


def equilibria(phi: ArrayLike, reward: float, gain: Gain = gain, hearing: Hearing | None = None) -> list[Profile]:
    """Return all pure Nash equilibria by enumeration of the (M + 1)^N profiles, for small N; see `is_equilibrium`."""
    times = _times(phi)
    return [profile for profile in profiles(*times.shape) if is_equilibrium(times, profile, reward, gain, hearing)]


def relay_pursuer(phi: Sequence[float], reward: float) -> int | None:
    """Return the pursuer of least capture time phi (ties: the lowest index), or None if its phi >= reward."""
    relay = min(range(len(phi)), key=phi.__getitem__, default=None)
    return relay if relay is not None and phi[relay] < reward else None


def relay_profile(phi: Sequence[float], reward: float) -> Profile:
    """Return the profile in which only the relay pursuer is active; without a relay pursuer all are inactive.

    If the phi are distinct and the least differs from r, this profile is the unique equilibrium of the game.
    """
    relay = relay_pursuer(phi, reward)
    return tuple(i == relay for i in range(len(phi)))


def profiles(pursuers: int, evaders: int = 1) -> list[Profile]:
    """Return all (M + 1)^N profiles in lexicographic order: the action of the last pursuer changes fastest."""
    return list(product(range(evaders + 1), repeat=pursuers))


def gibbs(phi: ArrayLike, reward: float, tau: float) -> Floats:
    """Return the ((M + 1)^N,) stationary distribution of log-linear learning at the temperature tau, s.

    The profiles are in the order of `profiles`. P(profile) is proportional to exp(Phi(profile) / tau): Blume 1993, "The
    Statistical Mechanics of Strategic Interaction".

    Raises:
        ValueError: if not all capture times are finite, or the temperature is not positive.
    """
    if not tau > 0.0:
        raise ValueError(f"the temperature should be positive (got {tau})")
    times = _times(phi)
    if not np.isfinite(times).all():
        raise ValueError(f"all capture times should be finite, got {np.asarray(phi).tolist()}")
    heights = [welfare(times, actions, reward) for actions in profiles(*times.shape)]
    return np.array(logit(heights, 1.0 / tau))


def logit(utilities: Sequence[float], inverse_temperature: float) -> list[float]:
    """Return the probability of each action under log-linear learning, given the utilities (s).

    The probabilities are proportional to exp(utility / tau) (Lee & Bakolas, Algorithm 1), computed without overflow;
    `inverse_temperature` is 1 / tau, 1/s. If it is 0, the probabilities are uniform, even for infinite utilities.
    """
    if inverse_temperature == 0.0:
        return [1.0 / len(utilities)] * len(utilities)
    most = max(utilities)
    weights = [exp((utility - most) * inverse_temperature) for utility in utilities]
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


def optimal_assignment(phi: ArrayLike, reward: float) -> dict[int, int]:
    """Return the assignment of pursuers to evaders with the greatest global utility.

    Args:
        phi: (N, M) capture times, s; inf or nan excludes a pair.
        reward: the time left, r, s; pairs with phi >= r are excluded.

    Returns:
        The evader, 1 .. M, of each assigned pursuer, pursuers ascending.
    """
    from scipy.optimize import linear_sum_assignment

    worth = _worth(phi, reward)
    pairs = zip(*linear_sum_assignment(worth, maximize=True), strict=True)
    return {int(i): int(j) + 1 for i, j in pairs if worth[i, j] > 0.0}


def optimum(phi: ArrayLike, reward: float) -> float:
    """Return the greatest global utility over all profiles, s; see `optimal_assignment`."""
    worth = _worth(phi, reward)
    return float(portable_sum(worth[i, j - 1] for i, j in optimal_assignment(phi, reward).items()))


def greedy_assignment(phi: Mapping[int, Mapping[int, float]], reward: float) -> dict[int, int]:
    """Return the greedy assignment: it takes each pair, in order of (phi, pursuer, evader), if both are still free.

    Args:
        phi: the capture times, s, by evader and then by pursuer; nan if unknown.
        reward: the time left, s; pairs with phi >= reward are excluded.

    Returns:
        The evader of each assigned pursuer.
    """
    pairs = sorted((t, i, j) for j, times in phi.items() for i, t in times.items() if t < reward)
    chased: dict[int, int] = {}
    for _, pursuer, evader in pairs:
        if pursuer not in chased and evader not in chased.values():
            chased[pursuer] = evader
    return chased


def _times(phi: ArrayLike) -> Floats:
    """Return the (N, M) capture times, s; ValueError if they are neither a matrix nor N numbers."""
    times = np.asarray(phi, dtype=float)
    if times.ndim not in {1, 2}:
        raise ValueError(f"capture times should be an (N, M) matrix, or N numbers, got shape {times.shape}")
    return times if times.ndim == 2 else times[:, np.newaxis]


def _columns(phi: ArrayLike, actions: Sequence[int]) -> list[list[float]]:
    """Return the capture times of all pursuers for each evader, s; ValueError if actions do not fit them."""
    times = _times(phi)
    pursuers, evaders = times.shape
    if len(actions) != pursuers or any(action not in range(evaders + 1) for action in actions):
        expected = f"{pursuers} numbers from 0 to {evaders}, one for each pursuer"
        raise ValueError(f"actions should be {expected}, got {list(actions)}")
    columns: list[list[float]] = times.T.tolist()
    return columns


def _worth(phi: ArrayLike, reward: float) -> Floats:
    """Return the (N, M) utilities, s, of each pursuer if it alone chased each evader; 0 if phi >= reward or nan."""
    times = _times(phi)
    return np.asarray(np.where(times < reward, reward - times, 0.0))
