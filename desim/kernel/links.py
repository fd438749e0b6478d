"""How long a message travels, and whether it arrives: frozen models, vectorised over the receivers of a broadcast.

A latency is always one way. A model answers for all hops at once: with one number if all of them fare alike, else
with one number per hop.
"""

from math import inf
from typing import Annotated, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from desim.value import Extent, OneOf, Probability, Time, Value


class Hops(NamedTuple):
    """The hops of one transmission: from `src` to each of the (k,) nodes `dst`."""

    src: int
    dst: NDArray[np.intp]


class Latency(Protocol):
    """A model of the one-way latency: `latency(hops, rng)` is a number or (k,) numbers >= 0, s."""

    def __call__(self, hops: Hops, rng: np.random.Generator) -> float | NDArray[np.float64]: ...  # noqa: D102


class Loss(Protocol):
    """A model of the loss: `loss(hops, rng)` is one truth or (k,) truths, True where the message is lost."""

    def __call__(self, hops: Hops, rng: np.random.Generator) -> bool | NDArray[np.bool_]: ...  # noqa: D102


class Constant(Value):
    """Every message travels for the same time."""

    kind: Literal["constant"] = "constant"
    value: Time = 0.0
    """One-way latency, s."""

    def __call__(self, hops: Hops, rng: np.random.Generator) -> float:
        """Return the latency, s."""
        return self.value


class Bernoulli(Value):
    """Every message is lost with the same probability, independently of all others."""

    kind: Literal["bernoulli"] = "bernoulli"
    p: Probability = 0.0
    """Probability that a message is lost, in [0, 1]."""

    def __call__(self, hops: Hops, rng: np.random.Generator) -> bool | NDArray[np.bool_]:
        """Return which of the hops lose the message."""
        return rng.random(len(hops.dst)) < self.p if self.p else False


class Links(Value):
    """What every link of a network does to a message; the default is the ideal network."""

    range: Extent = inf
    """Distance up to which two nodes hear each other when a message is sent, m; inf = any distance."""
    latency: Annotated[Latency, OneOf(Constant)] = Constant()
    """One-way latency, s."""
    loss: Annotated[Loss, OneOf(Bernoulli)] = Bernoulli()
    """Which messages are lost."""
