"""The pursuit game with several evaders: who is to chase which.

N pursuers each choose one of M evaders, or to stay: an action is 0 or the number of an evader, 1 .. M. With phi_ij the
time pursuer i would need to capture evader j and r the time that is left, the global utility is the sum over the
evaders of that of the game with one (`desim.pursuit.game`),

    Phi = sum over the engaged evaders j of (r - mean of phi_ij over who chases j),

and an exact potential for the wonderful-life utilities: what a pursuer contributes to the term of its own evader.

If the times are distinct, an equilibrium is a matching, for of several on one evader the slowest had better stay.
Often there are many. The best profile, which is a best matching, is one of them. Each of the others is worth at least
a third of it, and there are games in which one is worth no more: where pursuer i is worth u_i, the best profile sends
it to an evader on which it would be worth w alone. If nobody chases that one, w <= u_i, for i does not change; if
pursuer m does, (w - u_m) / 2 <= u_i. The sum over all i is at most 3 times the sum of all u_i.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from math import inf

import numpy as np
from numpy.typing import ArrayLike

from desim.pursuit import game
from desim.pursuit.state import Floats

Actions = tuple[int, ...]
"""What each pursuer does: 0 stays, j chases evader j."""


def welfare(phi: ArrayLike, actions: Sequence[int], reward: float) -> float:
    """Return the global utility Phi of a profile, s.

    Args:
        phi: (N, M) times of capture, s; who has inf on an evader does not count on it.
        actions: what each pursuer does.
        reward: the time that is left, r, s.
    """
    return sum(game.potential(times, chasing, reward) for times, chasing in _games(phi, actions))


def wonderful_life_utility(phi: ArrayLike, actions: Sequence[int], reward: float, i: int) -> float:
    """Return what pursuer i contributes to the global utility, s: to the term of the evader that it chases."""
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


def equilibria(phi: ArrayLike, reward: float) -> list[Actions]:
    """Return all pure Nash equilibria by enumeration of the (M + 1)^N profiles, for small N and M; see `welfare`."""
    times = _times(phi)
    return [actions for actions in profiles(*times.shape) if is_equilibrium(times, actions, reward)]


def profiles(pursuers: int, evaders: int) -> list[Actions]:
    """Return all (M + 1)^N profiles in the order of numbers whose first digit is what pursuer 0 does."""
    return list(product(range(evaders + 1), repeat=pursuers))


def gibbs(phi: ArrayLike, reward: float, tau: float) -> Floats:
    """Return the ((M + 1)^N,) stationary law of log-linear learning at temperature tau (s), in order of `profiles`.

    P(profile) is proportional to exp(Phi(profile) / tau); see `desim.pursuit.game.gibbs`.

    Raises:
        ValueError: if not all times of capture are finite.
    """
    times = _times(phi)
    if not np.isfinite(times).all():
        raise ValueError(f"all times of capture should be finite, got {times.tolist()}")
    heights = [welfare(times, actions, reward) for actions in profiles(*times.shape)]
    return np.array(game.logit(heights, 1.0 / tau))


def optimal_assignment(phi: ArrayLike, reward: float) -> dict[int, int]:
    """Return which evader each pursuer chases in a profile of greatest global utility; who stays is left out.

    Args:
        phi: (N, M) times of capture, s; inf or nan for who is not to chase an evader.
        reward: the time that is left, r, s; who would not be in time chases nobody.

    Returns:
        The evader, 1 .. M, of each pursuer that has one, pursuers ascending.
    """
    from scipy.optimize import linear_sum_assignment

    worth = _worth(phi, reward)
    pairs = zip(*linear_sum_assignment(worth, maximize=True), strict=True)
    return {int(i): int(j) + 1 for i, j in pairs if worth[i, j] > 0.0}


def optimum(phi: ArrayLike, reward: float) -> float:
    """Return the greatest global utility of all profiles, s; see `optimal_assignment`."""
    worth = _worth(phi, reward)
    return float(sum(worth[i, j - 1] for i, j in optimal_assignment(phi, reward).items()))


def greedy_assignment(phi: Mapping[int, Mapping[int, float]], reward: float) -> dict[int, int]:
    """Return which evader each pursuer chases if, in order of (phi, pursuer, evader), each free pair is made.

    Args:
        phi: of each evader the times of capture of pursuers, s; nan if it is not known.
        reward: the time that is left, s; who would not be in time chases nobody.

    Returns:
        The evader of each pursuer that has one.
    """
    pairs = sorted((t, i, j) for j, times in phi.items() for i, t in times.items() if t < reward)
    chased: dict[int, int] = {}
    for _, pursuer, evader in pairs:
        if pursuer not in chased and evader not in chased.values():
            chased[pursuer] = evader
    return chased


def _games(phi: ArrayLike, actions: Sequence[int]) -> list[tuple[list[float], list[bool]]]:
    """Return of each evader the game with it alone: every pursuer's time of capture (s), and whether it chases it."""
    times = _times(phi)
    return [(column.tolist(), [action == j for action in actions]) for j, column in enumerate(times.T, start=1)]


def _times(phi: ArrayLike) -> Floats:
    """Return (N, M) times of capture, s.

    Raises:
        ValueError: if they are no matrix.
    """
    times = np.asarray(phi, dtype=float)
    if times.ndim != 2:
        raise ValueError(f"times of capture should be an (N, M) matrix, got one of shape {times.shape}")
    return times


def _worth(phi: ArrayLike, reward: float) -> Floats:
    """Return (N, M) what each pursuer is worth alone on each evader, s; 0 if it would not be in time."""
    times = _times(phi)
    return np.asarray(np.where(times < reward, reward - times, 0.0))
