"""Utilities: the gain of a pursuer from being active, given the teammates that it believes active.

A utility is called with the pursuer's own capture time, the capture times of the other active pursuers that count, and
the time left. It returns the gain of chasing, U_i(active) - U_i(inactive). `scope` determines the pursuers that count.
A utility may have the attributes of `desim.pursuit.core.traits.UtilityTraits`.
"""

from collections.abc import Sequence
from functools import lru_cache
from math import cos, inf, pi
from typing import Annotated, ClassVar, Literal, Protocol

import numpy as np
from pydantic import Field

from desim.config.arrays import Floats
from desim.config.choice import OneOf
from desim.config.model import Value
from desim.kernel.core.portable_math import portable_sum
from desim.pursuit.core.traits import UtilityTraits
from desim.pursuit.game import game

Scope = Literal["heard", "neighbours", "component"]
"""The teammates that count, among those believed active. heard: all; neighbours: those that the pursuer receives from
directly at present; component: those whose messages can reach it at present over any number of hops. If positions are
announced and not sensed, all count; see `desim.pursuit.team.beliefs.Beliefs.counted_teammates`."""
NEWTON_STEPS = 5
"""Number of Newton steps: the initial guess of a root is within 2 %, and each step doubles the correct digits."""


class Utility(Protocol):
    """The gain from being active, s: `utility(own_time, other_times, reward)` as in `desim.pursuit.game.game.gain`."""

    @property
    def scope(self) -> Scope:
        """The teammates whose actions count; see `Scope`."""

    def __call__(self, own_time: float, other_times: Sequence[float], reward: float) -> float: ...  # noqa: D102


class Mean(Value):
    """Marginal contribution to the global utility U_E = time left - mean capture time (Lee & Bakolas).

    U_E is an exact potential if all are heard.
    """

    assumes: ClassVar[tuple[str, ...]] = ("everyone_heard",)
    kind: Literal["mean"] = "mean"
    scope: ClassVar[Scope] = "heard"

    def __call__(self, own_time: float, other_times: Sequence[float], reward: float) -> float:
        """Return the gain, s."""
        return game.gain(own_time, other_times, reward)

    def expected(self, own_time: float, other_times: Sequence[float], chances: Sequence[float], reward: float) -> float:
        """Return the mean gain, s, if the others are active independently; the cost is O(K^2) for K others.

        With n the random number of active others, and n_j the number of active others besides j, the mean gain is

            r P(n = 0) - phi_i E[1/(1 + n)] + sum_j phi_j q_j (E[1/(1 + n_j)] - E[1/(2 + n_j)]).

        E[1/(k + n)] is the integral of s^(k-1) E[s^n] over s in [0, 1]. E[s^n] is the product of 1 - q_j + q_j s over
        all j. This is a polynomial in s, for which Gauss-Legendre quadrature is exact.

        Args:
            own_time: phi_i, s.
            other_times: (K,) capture times phi_j, finite, s.
            chances: (K,) probabilities q_j that j is active, in [0, 1].
            reward: r, s.
        """
        if own_time == inf:
            return -inf
        phi, q = np.asarray(other_times, dtype=float), np.asarray(chances, dtype=float)
        s, weight = _quadrature(len(q) // 2 + 1)
        factors = 1.0 - q[:, None] * (1.0 - s)  # (K, nodes)
        # The product without the factor of j is the product before j times the product after j. No division by the
        # factor, which may be 0. `before` also has the weights of the quadrature, and `after` the factor 1 - s of the
        # difference of both means.
        before = np.cumprod(np.vstack([weight, factors]), axis=0)
        after = np.cumprod(np.vstack([1.0 - s, factors[::-1]]), axis=0)[::-1]
        without_each = (before[:-1] * after[1:]).sum(axis=1)  # (K,)
        return float(reward * np.prod(1.0 - q) - own_time * before[-1].sum() + (phi * q * without_each).sum())


class LocalMean(Mean):
    """As `mean`, over the neighbours heard now. Not a potential game: on a path graph of 3 it may lack equilibria."""

    assumes: ClassVar[tuple[str, ...]] = ()
    kind: Literal["local_mean"] = "local_mean"  # type: ignore[assignment]
    scope: ClassVar[Scope] = "neighbours"


class Component(Mean):
    """As `mean`, over the pursuers in the same network component: the paper's game in each component."""

    assumes: ClassVar[tuple[str, ...]] = ("component_heard",)
    kind: Literal["component"] = "component"  # type: ignore[assignment]
    scope: ClassVar[Scope] = "component"


class Minimum(Value):
    """Time left minus least capture time of the active pursuers: a pursuer without the least phi has a gain of 0.

    U_E(S) = r - min phi over S is an exact potential if all are heard. A pursuer with a greater phi than an active one
    is indifferent. Log-linear learning at tau > 0 therefore lets it chase half of the time. Only greedy rules break the
    tie in favour of inactivity.
    """

    assumes: ClassVar[tuple[str, ...]] = ("everyone_heard",)
    kind: Literal["minimum"] = "minimum"
    scope: ClassVar[Scope] = "heard"

    def __call__(self, own_time: float, other_times: Sequence[float], reward: float) -> float:
        """Return the gain, s."""
        if own_time == inf:
            return -inf
        return max(min(other_times) - own_time, 0.0) if other_times else reward - own_time

    def expected(self, own_time: float, other_times: Sequence[float], chances: Sequence[float], reward: float) -> float:
        """Return the mean gain over all sets of active others, s; see `Mean.expected`."""
        if own_time == inf:
            return -inf
        total, none_active = 0.0, 1.0  # none_active: the probability that no pursuer with a lower phi is active
        for phi, q in sorted(zip(other_times, chances, strict=True)):
            total += none_active * q * max(phi - own_time, 0.0)
            none_active *= 1.0 - q
        return total + none_active * (reward - own_time)


class EdgePenalty(Value):
    """Time left r minus own capture time phi_i, minus a penalty C for each active neighbour.

    The sum of r - phi_i over the active pursuers, less C for each pair of active neighbours, is an exact potential.
    Because C > r, the equilibria are the maximal independent sets of the pursuers with phi_i < r.
    """

    kind: Literal["edge_penalty"] = "edge_penalty"
    scope: ClassVar[Scope] = "neighbours"
    factor: Annotated[float, Field(gt=1, allow_inf_nan=False, strict=True)] = 1.1
    """The penalty C in units of the time left, C / r.

    The equilibria are the same for all values; a larger penalty only makes the choices at a temperature above 0 less
    random.

    If in doubt, use 1.1.
    """

    def __call__(self, own_time: float, other_times: Sequence[float], reward: float) -> float:
        """Return the gain, s."""
        return reward - own_time - self.factor * reward * len(other_times)

    def expected(self, own_time: float, other_times: Sequence[float], chances: Sequence[float], reward: float) -> float:
        """Return the mean gain over all sets of active others, s; see `Mean.expected`."""
        return reward - own_time - self.factor * reward * portable_sum(chances)


UTILITIES = OneOf(
    *(Mean, Minimum, LocalMean, Component, EdgePenalty),
    needs=("scope",),
    takes=("own_time", "other_times", "reward"),
    traits=UtilityTraits,
)


@lru_cache(maxsize=256)
def _quadrature(count: int) -> tuple[Floats, Floats]:
    """Return the nodes and weights of Gauss-Legendre quadrature over [0, 1].

    The nodes are the roots of the Legendre polynomial, computed by Newton's method (Press et al. 2007, "Numerical
    Recipes", 4.6.1). NumPy computes the roots as eigenvalues with LAPACK instead, so their last digits depend on the
    processor.
    """
    x = np.array([cos(pi * (k + 0.75) / (count + 0.5)) for k in range(count)])
    for _ in range(NEWTON_STEPS):
        previous, value = np.zeros(count), np.ones(count)
        for degree in range(1, count + 1):
            previous, value = value, ((2 * degree - 1) * x * value - (degree - 1) * previous) / degree
        slope = count * (x * value - previous) / (x**2 - 1.0)
        x = x - value / slope
    return (x + 1.0) / 2.0, 1.0 / ((1.0 - x**2) * slope**2)
