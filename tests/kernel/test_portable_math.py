"""Sums are added from left to right; elementary functions of arrays are those of the C library, number by number."""

import math

import numpy as np
import pytest

from desim.kernel.core.portable_math import exp, inner_product, portable_sum, power

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


def test_sums_are_rounded_after_each_term():
    """0.1 is a little more than 1/10. Ten of them, each sum rounded, are 1 - 2^-53; compensated, they are 1."""
    rounded = 1.0 - 2.0**-53
    assert portable_sum([0.1] * 10) == rounded
    assert portable_sum([0.1 + 0.1j] * 10) == complex(rounded, rounded)
    assert portable_sum(x for x in (1e16, 1.0, 1.0, -1e16)) == 0.0
    assert inner_product([0.1] * 10, [1.0] * 10) == rounded


def test_integers_are_added_exactly():
    total = portable_sum([2**62, 2**62, 1])
    assert (type(total), total) == (int, 2**63 + 1)
    assert portable_sum([]) == 0


def test_vectors_of_other_lengths_have_no_inner_product():
    with pytest.raises(ValueError, match="shorter"):
        inner_product([1.0, 2.0], [1.0])
