"""The optional methods of latency, loss and reception models; a user's model may have any of them."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desim.config.arrays import Floats
from desim.config.traits import Traits


class LinkTraits(Traits):
    """The optional methods of a latency or loss model, in addition to `__call__`."""

    start_run: Callable[[int], Any] | None = None
    """`start_run(size)` returns the model of one run of `size` nodes; for models with state."""
    draw: Callable[[int, np.random.Generator], NDArray[Any]] | None = None
    """`draw(count, rng)` returns (count,) draws that do not depend on the link; the network then draws in blocks."""
    quantile: Callable[[Floats], Floats] | None = None
    """`quantile(u)` returns the u-quantiles of the latency, s; the base latency of `per_pair` needs it."""


def model_of_run(model: Any, size: int) -> Any:
    """Return the model of one run: a stateful model starts with fresh state, any other is returned unchanged."""
    start_run = LinkTraits.of(model).start_run
    return start_run(size) if start_run is not None else model


class ReceptionTraits(Traits):
    """The optional method of a reception model, in addition to `__call__`."""

    bound: Callable[[float], float] | None = None
    """`bound(range)` returns the distance, m, beyond which no message is received; None: there is no such distance."""
