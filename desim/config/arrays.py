"""The types of numpy arrays."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]
Points = NDArray[np.complex128]
"""Points of the plane, x + iy."""
