"""Message loss: immutable models that decide for all receivers of a transmission at once.

A model with state is immutable, too: its method `start_run(size)` returns an object that holds the state during one run
(see `desim.kernel.traits.LinkTraits`).
"""

import math
from collections import defaultdict
from functools import partial
from typing import Annotated, Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from desim.config.arrays import Bools, Floats
from desim.config.choice import OneOf
from desim.config.model import Length, Positive, Probability, Value
from desim.kernel.link_context import LinkContext
from desim.kernel.link_traces import LossTrace, SignalTrace
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

    The model of Gilbert (1960, "Capacity of a Burst-Noise Channel") has no losses in the good state. The model of
    Elliott (1963, "Estimates of Error Rates for Codes on Burst-Noise Channels") has losses in both states. With
    transition probabilities (or rates) p from good to bad and r from bad to good, the share of bad time is
    s = p / (p + r) and the mean bad period is 1 / r. A link starts in its stationary distribution. The share of lost
    messages is s `loss_bad` + (1 - s) `loss_good`; by default exactly the messages sent in the bad state are lost.
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
        recovery = 1.0 / model.burst  # r
        failure = recovery * model.share / (1.0 - model.share)  # p
        self._rate = failure + recovery
        self._loss_good, self._loss_bad = model.loss_good, model.loss_bad
        # The chance of a link that was good at its last message, and of one that was bad; see `_Row`.
        self._after_good, self._after_bad = (0.0, 1.0) if self._in_time else (failure, 1.0 - recovery)
        self._rows: defaultdict[int, _Row] = defaultdict(partial(_Row, model.share))

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Advance the state of each link and return the (k,) losses."""
        row, dst = self._rows[context.src], context.dst
        if dst is not row.dst:
            row.select(dst)
        chance = row.chance
        if self._in_time:
            # In continuous time P(bad) tends exponentially to the share of bad time, with the rate p + r.
            exponent = self._rate * (row.since - context.now)
            fading = math.exp(exponent) if isinstance(exponent, float) else exp(exponent)
            chance, row.since = self._share + (chance - self._share) * fading, context.now
        bad: Bools = rng.random(len(dst)) < chance
        row.chance.fill(self._after_good)  # half the time of `take` or `where`
        row.chance[bad] = self._after_bad
        if self._loss_good == 0.0 and self._loss_bad == 1.0:
            return bad
        lost: Bools = rng.random(len(bad)) < np.where(bad, self._loss_bad, self._loss_good)
        return lost


class _Row:
    """The links of one sender; those to the receivers of its last message are at hand, the others are put aside.

    So a broadcast to the same receivers as the last needs no look-up, which takes a third of its time.

    Attributes:
        dst: the (k,) receivers of the last message; None: an array that may be changed.
        chance: the (k,) probabilities that the next message finds a link in the bad state, or, if the state advances
            with time, found it so right after the last message. A link that has not been used has the share of the
            stationary distribution.
        since: the times (s) of the last messages of these links, (k,) or one for all; -inf: none.
    """

    def __init__(self, share: float) -> None:
        self._share = share
        # The links used so far, by node; never empty, because `take` rejects an empty array.
        self._nodes, self._chance, self._since = np.array([-1]), np.array([share]), np.array([-np.inf])
        self._selected = np.array([0])
        self.dst: NDArray[np.intp] | None = None
        self.chance: Floats = self._chance
        self.since: float | Floats = self._since

    def select(self, dst: NDArray[np.intp]) -> None:
        """Put the links at hand aside, and take those to the (k,) nodes `dst`; new links are added first."""
        self._chance[self._selected], self._since[self._selected] = self.chance, self.since
        links = self._nodes.searchsorted(dst)
        if (self._nodes.take(links, mode="clip") != dst).any():
            self._add(dst)
            links = self._nodes.searchsorted(dst)
        self._selected, self.dst = links, None if dst.flags.writeable else dst
        self.chance, self.since = self._chance[links], self._since[links]

    def _add(self, dst: NDArray[np.intp]) -> None:
        old, chance, since = self._nodes, self._chance, self._since
        self._nodes = np.union1d(old, dst)
        self._chance, self._since = np.full(len(self._nodes), self._share), np.full(len(self._nodes), -np.inf)
        kept = self._nodes.searchsorted(old)
        self._chance[kept], self._since[kept] = chance, since


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

    def probability(self, distances: Floats) -> Floats:
        """Return the (k,) probabilities of loss at (k,) distances, m."""
        return self.near + (self.far - self.near) * power(np.minimum(distances / self.distance, 1.0), self.exponent)

    def start_run(self, size: int) -> Loss:
        """Create the model of one run; it keeps the probabilities of losses between nodes that do not move."""
        return _ByKnownDistance(self)

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Draw the (k,) losses."""
        return rng.random(len(context.dst)) < self.probability(context.distances)


class _ByKnownDistance:
    """`ByDistance` in one run."""

    def __init__(self, model: ByDistance):
        self._model = model
        self._kept: dict[int, tuple[Floats, Floats]] = {}
        """By sender, the last distances that were known beforehand, and the probabilities of loss there."""

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Draw the (k,) losses."""
        known = context.known_distances
        if known is None:
            return self._model(context, rng)
        kept = self._kept.get(context.src)
        if kept is None or kept[0] is not known:
            kept = self._kept[context.src] = known, self._model.probability(known)
        return rng.random(len(known)) < kept[1]


LOSSES = OneOf(
    Bernoulli,
    GilbertElliott,
    ByDistance,
    LossTrace,
    SignalTrace,
    number=("bernoulli", "p"),
    traits=LinkTraits,
)
