"""Arrays of what functions of a user return and callers give: numbers of any kind, and nothing without its unit."""

from datetime import timedelta
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

from desim.config.arrays import array_of, array_text


class Quantity(np.ndarray):
    """An array with a unit, as that of astropy: `np.asarray` takes its numbers, and it has no list."""

    unit = "ms"

    def tolist(self):
        raise NotImplementedError("cannot make a list of quantities")


class Wrapped:
    """An array with a unit, as that of pint: no array, but it becomes one."""

    units = "cm"

    def __init__(self, numbers):
        self._numbers = np.array(numbers)
        self.shape = self._numbers.shape

    def __array__(self, dtype=None, copy=None):
        return self._numbers

    def __float__(self):
        return float(self._numbers)


NO_NUMBERS = {
    "unit": np.array([0.1, 0.2]).view(Quantity),
    "unit of one": np.array(0.1).view(Quantity),
    "units": Wrapped([0.1, 0.2]),
    "units of one": Wrapped(0.1),
    "masked": np.ma.array([0.1, 0.2], mask=[False, True]),
    "masked booleans": np.ma.array([True, False], mask=[False, True]),
    "masked one": np.ma.masked,
    "missing": pd.Series([0.1, None], dtype="Float64"),
    "missing boolean": pd.array([True, None], dtype="boolean"),
    "durations": np.array([1, 2], "m8[ms]"),
    "dates": np.array(["2024-05-17"], "M8[s]"),
    "duration": timedelta(seconds=1),
    "text": "0.1",
    "none": None,
    "ragged": [[1.0], [1.0, 2.0]],
    "dict": {"a": 1.0},
}


@pytest.mark.parametrize("value", NO_NUMBERS.values(), ids=NO_NUMBERS)
def test_what_is_no_number_is_none(value):
    assert array_of(value).dtype.kind not in "biufc"


@pytest.mark.parametrize(
    ("value", "numbers"),
    [
        (0.5, 0.5),
        (np.float16(0.5), 0.5),
        (np.array(0.5), 0.5),
        (Fraction(1, 2), 0.5),
        ([Decimal("0.5"), 1], [0.5, 1.0]),
        (np.array([Fraction(1, 2), 1], dtype=object), [0.5, 1.0]),
        (pd.Series([0.5, 1.0]), [0.5, 1.0]),
        (np.ma.array([0.5, 1.0]), [0.5, 1.0]),
        ((number for number in (0.5, 1.0)), [0.5, 1.0]),
        (pd.DataFrame({"y": [2.0], "x": [1.0]}), [[1.0, 2.0]]),
    ],
    ids=lambda value: type(value).__name__,
)
def test_numbers_of_any_kind_are_numbers(value, numbers):
    array = array_of(value)
    assert array.dtype.kind in "iuf"
    assert array.tolist() == numbers


def test_a_series_whose_labels_say_another_order_is_none():
    """As that of values for receivers 1, 2 and 3 that were sorted by value."""
    assert array_of(pd.Series([1.0, 2.0, 3.0], index=[1, 2, 3])).tolist() == [1.0, 2.0, 3.0]
    assert array_of(pd.Series([3.0, 1.0, 2.0], index=[3, 1, 2])).dtype == object


def test_an_array_of_numpy_is_not_copied():
    for array in (np.zeros(3), np.zeros((2, 2), bool), np.zeros(2, complex)):
        assert array_of(array) is array


def test_a_message_tells_the_item_that_is_no_number():
    assert array_text(np.zeros((2, 3))) == "shape (2, 3), dtype float64"
    assert array_text(array_of(Wrapped(0.1))).startswith("shape (), dtype object, with Wrapped, with a unit")
    assert array_text(array_of(array_text)) == "shape (), dtype object, with array_text"
    assert array_text(array_of(np.ma.array([0.1, 0.2], mask=[False, True]))) == "shape (2,), dtype object, with None"
