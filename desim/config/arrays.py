"""The types of numpy's arrays, and the conversion of what users give to arrays."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from desim.config.answers import LONGEST
from desim.config.arguments import value_text
from desim.config.python_numbers import as_python

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]
Points = NDArray[np.complex128]
"""Points of the plane, x + iy."""


def array_of(value: Any) -> "NDArray[Any]":
    """Return what a function of a user has returned, or a caller has given, as an array of numbers or booleans.

    The dtype of the array is object if an item is neither, such as a masked number or one with a unit, whose mask or
    unit `np.asarray` would drop. It is object, too, if the labels of a series of pandas are not in order.
    """
    if type(value) in PLAIN or (type(value) is np.ndarray and value.dtype.kind in "biufc"):
        return np.asarray(value)
    if hasattr(value, "iloc") and hasattr(value, "index") and not value.index.is_monotonic_increasing:
        return np.array(None)  # the labels and the places of the values may mean different orders
    converted = as_python(value)
    try:
        return np.array(None) if isinstance(converted, np.ma.MaskedArray) else np.asarray(converted)
    except ValueError:  # rows of different lengths
        return np.array(None)


def array_text(array: "NDArray[Any]") -> str:
    """Return the end of an error message about an array: its shape and dtype, and the first item that is no number."""
    text = f"shape {array.shape}, dtype {array.dtype}"
    if array.dtype != object:
        return text
    other = next((item for item in array.flat if type(item) not in PLAIN), None)
    item = value_text(other)
    return f"{text}, with {item[:LONGEST]}{'...' if len(item) > LONGEST else ''}"


PLAIN = frozenset({float, int, bool, np.float64})
"""The types of most numbers."""
