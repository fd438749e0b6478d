"""The draws of link models: their validation, their conversion to nanoseconds and booleans, and their buffers.

A buffer draws ahead, in blocks. Kept equal to a draw for each transmission by
`tests/kernel/test_propagation.py::test_latencies_are_exactly_the_draws_that_their_stream_gives`.
"""

from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from desim.config.answers import wrong_answer
from desim.config.arrays import array_of
from desim.config.model import MAX_TIME
from desim.kernel.core.units import SECOND
from desim.kernel.models.traits import LinkTraits

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Draw = Callable[[int, np.random.Generator], NDArray[Any]]
    Convert = Callable[[Any, object], NDArray[Any]]

BLOCK = 4096
"""Minimum number of draws per block."""


class Buffer:
    """A buffer of draws from a model whose draws are independent of the link."""

    def __init__(self, model: object, draw: "Draw", rng: np.random.Generator, convert: "Convert"):
        self._model, self._draw, self._rng, self._convert = model, draw, rng, convert
        self._block: NDArray[Any] | None = None
        self._next = self._end = 0

    def take(self, count: int) -> "NDArray[Any]":
        """Return the next `count` converted draws; the array must not be changed."""
        begin, end = self._next, self._next + count
        if self._block is None or end > self._end:
            size = max(BLOCK, count)
            answer: Any = self._draw(size, self._rng)
            if np.shape(answer) != (size,):
                raise wrong_answer(f"draw({size}, rng) should return an array of {size} draws", answer, self._model)
            draws = self._convert(answer, self._model)
            self._block = draws if self._block is None else np.concatenate((self._block[begin:], draws))
            begin, end, self._end = 0, count, len(self._block)
        self._next = end
        return self._block[begin:end]

    def one(self) -> Any:
        """Return the next converted draw, in a fifth of the time of `take`."""
        k = self._next
        if self._block is None or k == self._end:
            return self.take(1).item()
        self._next = k + 1
        return self._block.item(k)


def buffered(
    model: object, rng: np.random.Generator, convert: "Convert" = lambda drawn, _: np.asarray(drawn)
) -> Buffer | None:
    """Return a buffer of the converted draws of a model; None if its draws may depend on the link."""
    draw = LinkTraits.of(model).draw
    return Buffer(model, draw, rng, convert) if draw is not None else None


def as_seconds(delays: Any, model: object) -> "NDArray[np.float64]":
    """Return the delays that a model returned, one number or several, s, as an array.

    Raises:
        ValueError: if they are not numbers.
    """
    seconds = array_of(delays)
    if seconds.dtype.kind not in "iuf":  # booleans are refused: a loss model may have been given as the latency
        raise wrong_answer("latencies should be finite times >= 0 s", delays, model)
    return np.asarray(seconds, dtype=float)


def as_nanoseconds(delays: Any, model: object) -> "NDArray[np.int64]":
    """Convert the delays that a model returned (one number or several, s) to whole ns, limited to `MAX_TIME`.

    Raises:
        ValueError: if a delay is negative, infinite or NaN.
    """
    seconds = as_seconds(delays, model)
    if not ((seconds >= 0.0) & (seconds < inf)).all():
        raise wrong_answer("latencies should be finite times >= 0 s", delays, model)
    times: NDArray[np.int64] = np.rint(np.minimum(seconds, MAX_TIME) * SECOND).astype(np.int64)
    return times


def as_booleans(losses: Any, model: object) -> "NDArray[np.bool_]":
    """Return the losses that a model drew.

    Raises:
        ValueError: if they are not booleans.
    """
    booleans = array_of(losses)
    if booleans.dtype != bool:
        raise wrong_answer("losses should be booleans", losses, model)
    return booleans


def times_of(answer: Any, count: int, model: object) -> "NDArray[np.int64]":
    """Convert the latencies that a model returned for `count` links to whole ns: one number, or one for each link.

    Raises:
        ValueError: if they are neither one number nor one for each link, or one of them is invalid.
    """
    times = as_nanoseconds(answer, model)
    if times.shape not in {(), (count,)}:
        raise wrong_answer(f"latencies should be one number or one for each of {count} links", answer, model)
    return times


def booleans_of(answer: Any, count: int, model: object) -> list[bool]:
    """Convert the losses that a model returned for `count` links to a list with one boolean per link.

    Raises:
        ValueError: if they are neither one boolean nor one for each link.
    """
    if isinstance(answer, bool):
        return [answer] * count
    booleans = array_of(answer)
    if booleans.dtype != bool or (booleans.shape != (count,) and booleans.shape != ()):
        raise wrong_answer(f"losses should be one boolean or one for each of {count} links", answer, model)
    lost: bool | list[bool] = booleans.tolist()  # not `np.broadcast_to`, which takes 8 us
    return [lost] * count if isinstance(lost, bool) else lost
