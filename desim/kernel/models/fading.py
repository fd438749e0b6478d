"""Fading: the distribution of the power of a frame about its mean, from the paths over which a wave arrives.

Nakagami (1960, "The m-Distribution"): the power divided by its mean is gamma distributed with shape m and mean 1.
Rice: one path of constant power and many others. K is the ratio of the power of that path to that of all others.
m = 1 and K = 0 are Rayleigh fading; for large m and K there is none.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Annotated

import numpy as np
from pydantic import Field

from desim.config.arrays import Floats
from desim.kernel.core.portable_math import portable_sum

Shape = Annotated[float, Field(ge=0.5, le=1000, strict=True)]
"""A parameter m of Nakagami fading."""
RiceFactor = Annotated[float, Field(ge=0, le=1000, strict=True)]
"""A factor K of Rice fading, not in dB."""


def nakagami_survival(m: float, ratios: Floats) -> Floats:
    """Return (k,) the probability that the power exceeds its mean times each of (k,) ratios: Q(m, m x).

    Q is the regularised upper incomplete gamma function.
    """
    from scipy.special import gammaincc

    return np.asarray(gammaincc(m, m * ratios))


def rice_survival(k: float, ratios: Floats) -> Floats:
    """Return (k,) the probability that the power exceeds its mean times each of (k,) ratios.

    It is Marcum's Q_1(sqrt(2 K), sqrt(2 (K + 1) x)), the tail of a Poisson mixture of chi-squared distributions. Where
    it is small, the difference from 1 would lose its digits, so the tails of the mixture are summed instead.
    """
    from scipy.special import chndtr, gammaincc

    survival: Floats = np.maximum(1.0 - chndtr(2.0 * (k + 1.0) * ratios, 2.0, 2.0 * k), 0.0)
    small = survival < 1e-3
    if small.any():
        numbers, weights = _poisson(k)
        tails = weights * gammaincc(numbers + 1.0, (k + 1.0) * ratios[small])
        survival[small] = np.add.reduce(tails, axis=0)  # row by row, so in the same order on all machines
    return survival


@lru_cache(maxsize=16)
def _poisson(mean: float) -> tuple[Floats, Floats]:
    """Return the (n, 1) integers within 9 standard deviations + 20 of the mean, and their Poisson probabilities."""
    reach = 9.0 * math.sqrt(mean) + 20.0
    numbers = range(max(math.floor(mean - reach), 0), math.ceil(mean + reach))
    weights = [math.exp(n * math.log(mean) - mean - math.lgamma(n + 1)) if mean else float(n == 0) for n in numbers]
    return np.array(numbers, dtype=float)[:, np.newaxis], np.array(weights)[:, np.newaxis]


def nakagami_quantiles(m: float, survival: Floats) -> Floats:
    """Return (k,) powers, in units of their mean, that are exceeded with (k,) probabilities."""
    from scipy.special import gammainccinv

    return np.asarray(gammainccinv(m, survival) / m)


def rice_quantiles(k: float, u: Floats) -> Floats:
    """Return the (k,) u-quantiles of the power, in units of its mean."""
    from scipy.special import chndtrix

    return np.asarray(chndtrix(u, 2.0, 2.0 * k) / (2.0 * (k + 1.0)))


MAX_NORMALS = 16
"""Maximum number of Gaussian processes of one pair of nodes."""


def nakagami_powers(m: float, normals: Callable[[int], Floats]) -> Floats:
    """Return (k,) powers of Nakagami fading, in units of their mean, from Gaussian processes.

    If 2 m is an integer of at most `MAX_NORMALS`, the power is the mean of so many squares (Nakagami 1960), and its
    crossings of levels are those of Yacoub, Bautista & Guedes 1999, "On Higher Order Statistics of the Nakagami-m
    Distribution". For another m the mean of the nearest number of squares is transformed by the distribution functions
    (Beaulieu & Cheng 2005, "Efficient Nakagami-m Fading Channel Simulation"): the distribution is exact, and each
    quantile is crossed as often as that of the nearest m.

    Args:
        m: the shape.
        normals: see `desim.kernel.models.coherence.ChannelState`.
    """
    from scipy.special import gammaincc

    count = min(max(round(2.0 * m), 1), MAX_NORMALS)
    squares: Floats = portable_sum(normals(count) ** 2)  # of the rows
    if count == 2.0 * m:
        return squares / count
    return nakagami_quantiles(m, gammaincc(count / 2.0, squares / 2.0))


def rice_powers(k: float, normals: Callable[[int], Floats]) -> Floats:
    """Return (k,) powers of Rice fading, in units of their mean, from two Gaussian processes.

    The strong path has no Doppler frequency, so its phase does not change (Rice 1948, "Statistical Properties of a Sine
    Wave Plus Random Noise").
    """
    x, y = normals(2)
    return np.asarray(((x + math.sqrt(2.0 * k)) ** 2 + y**2) / (2.0 * k + 2.0))
