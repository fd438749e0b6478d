"""Elementary functions of arrays are those of the C library, number by number."""

import math

import numpy as np
import pytest

from desim.kernel.portable_math import exp, power

NUMBERS = np.array([0.0, 1e-300, *np.random.default_rng(1).random(1000), 1.0])


def test_exponentials_are_those_of_single_numbers():
    assert exp(-40.0 * NUMBERS).tolist() == [math.exp(-40.0 * each) for each in NUMBERS.tolist()]
    assert exp(np.array([-math.inf])).tolist() == [0.0]
    assert exp(np.zeros(0)).shape == (0,)


@pytest.mark.parametrize("exponent", [0.5, 1.7, 2.0, 3.0, math.inf])
def test_powers_are_those_of_single_numbers_and_squares_are_products(exponent):
    single = [each * each if exponent == 2.0 else each**exponent for each in NUMBERS.tolist()]
    assert power(NUMBERS, exponent).tolist() == single
    assert power(np.zeros(0), exponent).shape == (0,)
