"""The pursuit game with several evaders: the assignment of pursuers to evaders.

Each of N pursuers chooses one of M evaders or is inactive: an action is 0 or the number of an evader, 1 .. M. Let
phi_ij be the capture time of pursuer i for evader j, and r the time left. The global utility is the sum over the
evaders of the utility of the game with one evader (`desim.pursuit.game.game`),

    Phi = sum over the chased evaders j of (r - mean of phi_ij over the pursuers that chase j).

Phi is an exact potential for the wonderful-life utilities. The wonderful-life utility of a pursuer is its marginal
contribution to the term of its evader.

If the capture times are distinct, every equilibrium is a matching: if several pursuers chase one evader, the one with
the greatest capture time gains by becoming inactive. There are often many equilibria; the optimal profile, a
maximum-weight matching, is one of them.

If the capture times are distinct, every equilibrium has at least a third of the optimal global utility, and this bound
is tight. Proof: let u_i be the utility of pursuer i in the equilibrium, which is a matching. For each pursuer i that
the optimal profile assigns to an evader, let w_i be its utility if it chased this evader alone. Pursuer i does not gain
by deviating to this evader. Hence w_i <= u_i if no other pursuer chases the evader in the equilibrium. If pursuer m
chases it, (w_i - u_m) / 2 <= u_i, or w_i <= 2 u_i + u_m. Each m occurs for one i only. The sum of all w_i, which is the
optimal global utility, is therefore at most 3 times the sum of all u_i.

Functions that need an (N, M) matrix `phi` raise ValueError if it is not one.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from math import inf

import numpy as np
from numpy.typing import ArrayLike

from desim.config.arrays import Floats
from desim.kernel.core.portable_math import portable_sum
from desim.pursuit.game import game

Profile = tuple[int, ...]
"""The action of each pursuer: 0 to be inactive, j to chase evader j."""


def welfare(phi: ArrayLike, actions: Sequence[int], reward: float) -> float:
    """Return the global utility Phi of a profile, s.

    Args:
        phi: (N, M) capture times, s; a pursuer with inf for its evader does not count.
        actions: (N,) action of each pursuer.
        reward: the time left, r, s.
    """
    return portable_sum(game.potential(times, chasing, reward) for times, chasing in _games(phi, actions))


def wonderful_life_utility(phi: ArrayLike, actions: Sequence[int], reward: float, i: int) -> float:
    """Return the marginal contribution of pursuer i to the global utility, s; only the term of its evader changes."""
    if not actions[i]:
        return 0.0
    times, chasing = _games(phi, actions)[actions[i] - 1]
    return game.wonderful_life_utility(times, chasing, reward, i)


def is_equilibrium(phi: ArrayLike, actions: Sequence[int], reward: float) -> bool:
    """Return whether no pursuer gains by changing its action alone (a pure Nash equilibrium); see `welfare`."""
    games = _games(phi, actions)
    for i, action in enumerate(actions):
        worth = [0.0]
        for times, chasing in games:
            others = [t for j, t in enumerate(times) if chasing[j] and j != i and t < inf]
            worth.append(game.gain(times[i], others, reward) if times[i] < inf else -inf)
        if worth[action] < max(worth):
            return False
    return True


def equilibria(phi: ArrayLike, reward: float) -> list[Profile]:
    """Return all pure Nash equilibria by enumeration of the (M + 1)^N profiles, for small N and M; see `welfare`."""
    times = _times(phi)
    return [actions for actions in profiles(*times.shape) if is_equilibrium(times, actions, reward)]


def profiles(pursuers: int, evaders: int) -> list[Profile]:
    """Return all (M + 1)^N profiles in lexicographic order: the action of the last pursuer changes fastest."""
    return list(product(range(evaders + 1), repeat=pursuers))


def gibbs(phi: ArrayLike, reward: float, tau: float) -> Floats:
    """Return the ((M + 1)^N,) stationary distribution of log-linear learning, in the order of `profiles`.

    P(profile) is proportional to exp(Phi(profile) / tau), with temperature tau, s; see `desim.pursuit.game.game.gibbs`.

    Raises:
        ValueError: if not all capture times are finite.
    """
    times = _times(phi)
    if not np.isfinite(times).all():
        raise ValueError(f"all capture times should be finite, got {times.tolist()}")
    heights = [welfare(times, actions, reward) for actions in profiles(*times.shape)]
    return np.array(game.logit(heights, 1.0 / tau))


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


def _games(phi: ArrayLike, actions: Sequence[int]) -> list[tuple[list[float], list[bool]]]:
    """Return for each evader its single-evader game: the capture time (s) of each pursuer, and whether it chases."""
    times = _times(phi)
    return [(column.tolist(), [action == j for action in actions]) for j, column in enumerate(times.T, start=1)]


def _times(phi: ArrayLike) -> Floats:
    """Return the (N, M) capture times, s.

    Raises:
        ValueError: if they are not a matrix.
    """
    times = np.asarray(phi, dtype=float)
    if times.ndim != 2:
        raise ValueError(f"capture times should be an (N, M) matrix, got shape {times.shape}")
    return times


def _worth(phi: ArrayLike, reward: float) -> Floats:
    """Return the (N, M) utilities, s, of each pursuer if it alone chased each evader; 0 if phi >= reward or nan."""
    times = _times(phi)
    return np.asarray(np.where(times < reward, reward - times, 0.0))
