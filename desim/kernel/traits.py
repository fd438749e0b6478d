"""The optional methods of link models; a model of a user may have any of them."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desim.config.arrays import Floats
from desim.config.traits import Traits


class LinkTraits(Traits):
    """The optional attributes of a latency or loss model, besides its call."""

    start_run: Callable[[int], Any] | None = None
    """`start_run(size)` returns the model of one run of `size` nodes; for models with state."""
    draw: Callable[[int, np.random.Generator], NDArray[Any]] | None = None
    """`draw(count, rng)` returns (count,) draws, if these do not depend on the link; the network then draws ahead."""
    quantile: Callable[[Floats], Floats] | None = None
    """`quantile(u)` returns the u-quantiles of a latency, s, for a latency of each pair of nodes (`per_pair`)."""


class ReceptionTraits(Traits):
    """The optional attributes of a reception model, besides its call."""

    bound: Callable[[float], float] | None = None
    """`bound(range)` returns the distance beyond which no message is received, m; without it there is none."""
