"""Elementary functions of arrays, rounded alike on every processor.

The loops that numpy has for processors with AVX-512 give other last digits than the C library, which it calls on all
others. Here it is always the C library, one number at a time: the time of a call grows by 0.06 microseconds for each.
"""

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def exp(exponents: Floats) -> Floats:
    """Return e^x for each of (k,) exponents."""
    return np.fromiter(map(math.exp, exponents.tolist()), float, len(exponents))


def power(bases: Floats, exponent: float) -> Floats:
    """Return x^p for each of (k,) bases x in [0, 1] and p > 0; a square is a product, which is as fast as ever."""
    if exponent == 2.0:
        return bases * bases
    return np.array([base**exponent for base in bases.tolist()])
