"""Whether a message is lost on its way: frozen models that answer for all receivers of a transmission at once.

A model with memory has a method `start_run(size)` that returns what answers for one run; the model itself stays frozen.
"""

from collections import defaultdict
from typing import Annotated, Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from desim.config.choice import OneOf
from desim.config.model import Length, Positive, Probability, Value
from desim.kernel.link_context import LinkContext
from desim.kernel.portable_math import exp, power

Bools = NDArray[np.bool_]


class Loss(Protocol):
    """A model of the loss: `loss(hops, rng)` is one truth or (k,) truths, True where the message is lost."""

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> bool | Bools: ...  # noqa: D102


class Bernoulli(Value):
    """Every message is lost with the same probability, independently of all others."""

    kind: Literal["bernoulli"] = "bernoulli"
    p: Probability = 0.0
    """Probability that a message is lost, in [0, 1]."""

    def draw(self, count: int, rng: np.random.Generator) -> Bools:
        """Return (count,) draws."""
        return rng.random(count) < self.p

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> bool | Bools:
        """Return which of the hops lose the message."""
        return self.draw(len(context.dst), rng) if self.p else False


class GilbertElliott(Value):
    """Losses come in bursts: each link is now good and now bad, and loses messages with a probability of either state.

    Gilbert 1960, "Capacity of a Burst-Noise Channel", has no losses in the good state; Elliott 1963, "Estimates of
    Error Rates for Codes on Burst-Noise Channels", has. With p from good to bad and r from bad to good, the share of
    bad time is s = p / (p + r) and a link is bad for 1 / r in the mean. It starts from its stationary law. Of all
    messages s `loss_bad` + (1 - s) `loss_good` are lost: just those sent while a link is bad, unless told otherwise.
    """

    kind: Literal["gilbert_elliott"] = "gilbert_elliott"
    share: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.1
    """Share of the messages, or of the time, for which a link is bad, in [0, 1)."""
    burst: Positive = 5.0
    """Mean duration of a bad period, in messages of the link, or in s if it advances in time."""
    advance: Literal["message", "time"] = "message"
    """Whether a link changes between good and bad with every message it carries, or as time goes by."""
    loss_good: Probability = 0.0
    """Probability that a message is lost while its link is good, in [0, 1]."""
    loss_bad: Probability = 1.0
    """Probability that a message is lost while its link is bad, in [0, 1]."""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        least = max(1.0, self.share / (1.0 - self.share))
        if self.advance == "message" and self.burst < least:
            raise ValueError(f"burst should be at least {least:g} messages for this share (got {self.burst:g})")
        return self

    def start_run(self, size: int) -> Loss:
        """Return the links of one run between `size` nodes; they remember how they were."""
        return _Bursts(self)

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Return which of the hops lose a message if nothing is remembered: the stationary law."""
        return rng.random(len(context.dst)) < self.share * self.loss_bad + (1.0 - self.share) * self.loss_good


class _Bursts:
    """The links of one run, one row per sender; memory for those links only that are used."""

    def __init__(self, model: GilbertElliott):
        self._share, self._in_time = model.share, model.advance == "time"
        self._recovery = 1.0 / model.burst  # r
        self._failure = self._recovery * model.share / (1.0 - model.share)  # p
        self._loss_good, self._loss_bad = model.loss_good, model.loss_bad
        self._rows: defaultdict[int, _Row] = defaultdict(lambda: _Row(model.share))

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Return which of the hops lose the message, after each link has advanced."""
        row = self._rows[context.src]
        links = row.links(context.dst)
        was_bad, since = row.was_bad[links], row.since[links]
        if self._in_time:
            # Two states in continuous time: P(bad) tends to its share at the sum of the two rates.
            memory = exp((self._failure + self._recovery) * (since - context.now))
            chance = self._share + (was_bad - self._share) * memory
        else:
            chance = np.where(was_bad > 0.0, 1.0 - self._recovery, self._failure)
        bad: Bools = rng.random(len(context.dst)) < np.where(since > -np.inf, chance, self._share)
        row.was_bad[links], row.since[links] = bad, context.now
        if self._loss_good == 0.0 and self._loss_bad == 1.0:
            return bad
        lost: Bools = rng.random(len(bad)) < np.where(bad, self._loss_bad, self._loss_good)
        return lost


class _Row:
    """How the links of a sender to those receivers that it has had were when they were last used.

    At first, and in time after an eternity, a link has forgotten how it was.
    """

    def __init__(self, share: float):
        self._share = share
        self._nodes = np.array([-1])  # nobody
        self.was_bad, self.since = np.array([share]), np.array([-np.inf])

    def links(self, dst: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return where in the row the links to (k,) nodes are."""
        links = self._nodes.searchsorted(dst)
        if (self._nodes.take(links, mode="clip") != dst).any():
            self._add(dst)
            links = self._nodes.searchsorted(dst)
        return links

    def _add(self, dst: NDArray[np.intp]) -> None:
        old, was_bad, since = self._nodes, self.was_bad, self.since
        self._nodes = np.union1d(old, dst)
        self.was_bad, self.since = np.full(len(self._nodes), self._share), np.full(len(self._nodes), -np.inf)
        kept = self._nodes.searchsorted(old)
        self.was_bad[kept], self.since[kept] = was_bad, since


class ByDistance(Value):
    """The farther away the receiver, the likelier the loss: near + (far - near) min(d / distance, 1)^exponent."""

    kind: Literal["by_distance"] = "by_distance"
    near: Probability = 0.0
    """Probability of loss at no distance, in [0, 1]."""
    far: Probability = 1.0
    """Probability of loss at `distance` and beyond, in [0, 1]."""
    distance: Length = 10.0
    """m"""
    exponent: Positive = 2.0
    """How the probability rises in between."""

    def probability(self, distances: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the probability of loss at (k,) distances, m."""
        return self.near + (self.far - self.near) * power(np.minimum(distances / self.distance, 1.0), self.exponent)

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Return which of the hops lose the message."""
        return rng.random(len(context.dst)) < self.probability(context.distances)


LOSSES = OneOf(Bernoulli, GilbertElliott, ByDistance, number=("bernoulli", "p"))
