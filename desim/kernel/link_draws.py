"""The draws of link models: their validation, their conversion to nanoseconds and booleans, and their buffers."""

from math import inf
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from desim.config.model import MAX_TIME
from desim.kernel.records import Arrival
from desim.kernel.traits import LinkTraits
from desim.kernel.units import SECOND

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Draw = Callable[[int, np.random.Generator], NDArray[Any]]

BLOCK = 4096
"""Minimum number of draws per block."""
Each = TypeVar("Each")


class Buffer(Generic[Each]):
    """A buffer of draws from a model whose draws are independent of the link."""

    def __init__(self, draw: "Draw", rng: np.random.Generator, convert: "Callable[[NDArray[Any]], list[Each]]"):
        self._draw, self._rng, self._convert = draw, rng, convert
        self._block: list[Each] = []
        self._next = 0

    def take(self, count: int) -> list[Each]:
        """Return the next `count` draws."""
        end = self._next + count
        if end > len(self._block):
            fresh = self._convert(self._draw(max(BLOCK, count), self._rng))
            self._block = self._block[self._next :] + fresh
            self._next, end = 0, count
        taken = self._block[self._next : end]
        self._next = end
        return taken


def buffered(
    model: object, rng: np.random.Generator, convert: "Callable[[NDArray[Any]], list[Each]]"
) -> "Buffer[Each] | None":
    """Return a buffer of the converted draws of a model; None if its draws may depend on the link."""
    draw = LinkTraits.of(model).draw
    return Buffer(draw, rng, convert) if draw is not None else None


def as_nanoseconds(delays: Any) -> Any:
    """Convert delays (one number or several, s) to whole ns, limited to `MAX_TIME`.

    Raises:
        ValueError: if a delay is negative, infinite or NaN.
    """
    given = np.asarray(delays, dtype=float)
    if not ((given >= 0.0) & (given < inf)).all():
        raise ValueError(f"latencies should be finite times >= 0 s, got {delays}")
    return np.rint(np.minimum(given, MAX_TIME) * SECOND).astype(np.int64).tolist()


def times_of(answer: Any, count: int) -> Arrival:
    """Convert the latencies that a model returned for `count` links to whole ns: one number, or one for each link.

    Raises:
        ValueError: if they are neither one number nor one for each link, or one of them is invalid.
    """
    shape = np.shape(answer)
    if shape not in {(), (count,)}:
        got = shape[0] if len(shape) == 1 else f"an array of shape {shape}"
        raise ValueError(f"latencies should be one number or one for each of {count} links, got {got}")
    times: Arrival = as_nanoseconds(answer)
    return times


def booleans_of(answer: Any, count: int) -> list[bool]:
    """Convert the losses that a model returned for `count` links to a list with one boolean per link.

    Raises:
        ValueError: if they are neither one boolean nor one for each link.
    """
    booleans = np.asarray(answer)
    if booleans.dtype != bool or (booleans.shape != (count,) and booleans.shape != ()):
        raise ValueError(f"losses should be one boolean or one for each of {count} links, got {answer!r}")
    lost: bool | list[bool] = booleans.tolist()  # `np.broadcast_to` takes 8 us
    return [lost] * count if isinstance(lost, bool) else lost
