"""Message loss: frozen models that decide for all receivers of a transmission at once.

A model with state is frozen, too: its method `start_run(size)` returns an object that holds the state of one run (see
`desim.kernel.traits.LinkTraits`).
"""

from collections import defaultdict
from typing import Annotated, Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from desim.config.arrays import Bools
from desim.config.choice import OneOf
from desim.config.model import Length, Positive, Probability, Value
from desim.kernel.link_context import LinkContext
from desim.kernel.portable_math import exp, power
from desim.kernel.traits import LinkTraits


class Loss(Protocol):
    """A loss model: `loss(context, rng)` returns (k,) booleans, or one for all receivers; True: the message is lost."""

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> bool | Bools: ...  # noqa: D102


class Bernoulli(Value):
    """Every message is lost with the same probability, independently of all others."""

    kind: Literal["bernoulli"] = "bernoulli"
    p: Probability = 0.0
    """Probability that a message is lost, in [0, 1]."""

    def draw(self, count: int, rng: np.random.Generator) -> Bools:
        """Draw (count,) booleans, True where a message is lost."""
        return rng.random(count) < self.p

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> bool | Bools:
        """Draw the (k,) losses; return False if nothing can be lost."""
        return self.draw(len(context.dst), rng) if self.p else False


class GilbertElliott(Value):
    """Burst losses: each link alternates between a good and a bad state, each with its own loss probability.

    The model of Gilbert (1960, "Capacity of a Burst-Noise Channel") has no losses in the good state; that of Elliott
    (1963, "Estimates of Error Rates for Codes on Burst-Noise Channels") has losses in both states. With transition
    probabilities (or rates) p from good to bad and r from bad to good, the share of bad time is s = p / (p + r) and the
    mean bad period is 1 / r. A link starts in its stationary distribution. The share of lost messages is
    s `loss_bad` + (1 - s) `loss_good`; by default exactly the messages sent in the bad state are lost.
    """

    kind: Literal["gilbert_elliott"] = "gilbert_elliott"
    share: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.1
    """Share of the messages, or of the time, for which a link is in the bad state, in [0, 1)."""
    burst: Positive = 5.0
    """Mean duration of a bad period, in messages of the link, or in s if the state advances with time."""
    advance: Literal["message", "time"] = "message"
    """Whether the state of a link advances with every message on it, or with time."""
    loss_good: Probability = 0.0
    """Probability of loss in the good state, in [0, 1]."""
    loss_bad: Probability = 1.0
    """Probability of loss in the bad state, in [0, 1]."""

    @model_validator(mode="after")
    def _check_burst(self) -> Self:
        min_burst = max(1.0, self.share / (1.0 - self.share))
        if self.advance == "message" and self.burst < min_burst:
            raise ValueError(f"burst should be at least {min_burst:g} messages for this share (got {self.burst:g})")
        return self

    def start_run(self, size: int) -> Loss:
        """Create the model of one run with `size` nodes; the model keeps the state of each link."""
        return _Bursts(self)

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Draw (k,) losses from the stationary distribution, without state."""
        return rng.random(len(context.dst)) < self.share * self.loss_bad + (1.0 - self.share) * self.loss_good


class _Bursts:
    """`GilbertElliott` in one run: one row per sender, with the state of the links used so far."""

    def __init__(self, model: GilbertElliott):
        self._share, self._in_time = model.share, model.advance == "time"
        self._recovery = 1.0 / model.burst  # r
        self._failure = self._recovery * model.share / (1.0 - model.share)  # p
        self._loss_good, self._loss_bad = model.loss_good, model.loss_bad
        self._rows: defaultdict[int, _Row] = defaultdict(_Row)

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Advance the state of each link and return the (k,) losses."""
        row = self._rows[context.src]
        links = row.links(context.dst)
        was_bad, since = row.was_bad[links], row.since[links]
        if self._in_time:
            # In continuous time P(bad) tends exponentially to the share of bad time, with the rate p + r.
            memory = exp((self._failure + self._recovery) * (since - context.now))
            chance = self._share + (was_bad - self._share) * memory
        else:
            chance = np.where(was_bad, 1.0 - self._recovery, self._failure)
        bad: Bools = rng.random(len(context.dst)) < np.where(since > -np.inf, chance, self._share)
        row.was_bad[links], row.since[links] = bad, context.now
        if self._loss_good == 0.0 and self._loss_bad == 1.0:
            return bad
        lost: Bools = rng.random(len(bad)) < np.where(bad, self._loss_bad, self._loss_good)
        return lost


class _Row:
    """The links of one sender: whether each was bad at its last use, and the time (s) of that use.

    Before its first use the time of a link is -inf and its state has no meaning: the link starts in the stationary
    distribution.
    """

    def __init__(self) -> None:
        self._nodes = np.array([-1])  # never empty, because `take` rejects an empty array
        self.was_bad, self.since = np.array([False]), np.array([-np.inf])

    def links(self, dst: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the (k,) indices, in this row, of the links to the nodes `dst`; new links are added first."""
        links = self._nodes.searchsorted(dst)
        if (self._nodes.take(links, mode="clip") != dst).any():
            self._add(dst)
            links = self._nodes.searchsorted(dst)
        return links

    def _add(self, dst: NDArray[np.intp]) -> None:
        old, was_bad, since = self._nodes, self.was_bad, self.since
        self._nodes = np.union1d(old, dst)
        self.was_bad, self.since = np.zeros(len(self._nodes), bool), np.full(len(self._nodes), -np.inf)
        kept = self._nodes.searchsorted(old)
        self.was_bad[kept], self.since[kept] = was_bad, since


class ByDistance(Value):
    """The probability of loss depends on distance d: near + (far - near) min(d / distance, 1)^exponent."""

    kind: Literal["by_distance"] = "by_distance"
    near: Probability = 0.0
    """Probability of loss at distance 0, in [0, 1]."""
    far: Probability = 1.0
    """Probability of loss at `distance` and beyond, in [0, 1]."""
    distance: Length = 10.0
    """Distance from which on the probability of loss is `far`, m."""
    exponent: Positive = 2.0
    """Exponent of the rise with distance."""

    def probability(self, distances: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (k,) probabilities of loss at (k,) distances, m."""
        return self.near + (self.far - self.near) * power(np.minimum(distances / self.distance, 1.0), self.exponent)

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Draw the (k,) losses."""
        return rng.random(len(context.dst)) < self.probability(context.distances)


LOSSES = OneOf(Bernoulli, GilbertElliott, ByDistance, number=("bernoulli", "p"), traits=LinkTraits)
