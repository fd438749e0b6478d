"""Message loss: immutable models that decide for all receivers of a transmission at once.

A model with state is immutable, too: its method `start_run(size)` returns an object that holds the state during one run
(see `desim.kernel.models.traits.LinkTraits`).
"""

import math
from collections import defaultdict
from functools import partial
from typing import Annotated, Literal, Protocol, Self

import numpy as np
from pydantic import Field, model_validator

from desim.config.arrays import Bools, Floats
from desim.config.choice import OneOf
from desim.config.model import Length, Positive, Probability, Value
from desim.kernel.core.link_context import LinkContext
from desim.kernel.core.portable_math import exp, power
from desim.kernel.measured.models import LossTrace, SignalTrace
from desim.kernel.models.common_losses import Common, CommonBursts, CommonCause, max_common
from desim.kernel.models.correlation import RANGE, CorrelatedNumbers, LinkMemory
from desim.kernel.models.traits import LinkTraits

FEW = 16
"""After messages to single nodes, a broadcast to at most this many receivers is drawn link by link."""
PositiveProbability = Annotated[float, Field(gt=0, le=1, strict=True)]


class Loss(Protocol):
    """A loss model: `loss(context, rng)` returns (k,) booleans, or one for all receivers; True: the message is lost."""

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> bool | Bools: ...  # noqa: D102


class Bernoulli(Value):
    """Every message is lost with the same probability, independently of all others."""

    kind: Literal["bernoulli"] = "bernoulli"
    p: Probability = 0.0
    """Probability that a message is lost, in [0, 1].

    If in doubt, 0.1, a poor but usable radio link; 0.01 is a good one.
    """

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
    s = p / (p + r) and the mean bad period is 1 / r. A link starts in the stationary distribution of its states. The
    share of lost messages is s `loss_bad` + (1 - s) `loss_good`; by default, exactly the messages sent in the bad state
    are lost.

    If the state advances with time, a link that was bad is bad again after t s with the probability s + (1 - s)
    exp(-t / (burst (1 - s))). If it advances with messages, as in netem, an idle link keeps its state: a sender that
    waits before it repeats a message outlasts no burst. If the link carries nothing else, a message takes 1 / (1 - s)
    attempts, as without bursts. Where messages are repeated, let the state advance with time.
    """

    kind: Literal["gilbert_elliott"] = "gilbert_elliott"
    share: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.1
    """Share of the messages, or of the time, for which a link is in the bad state, in [0, 1)."""
    burst: Positive = 5.0
    """Mean duration of a bad period, in messages of the link, or in s if the state advances with time.

    If in doubt, the longest outage that the protocol should survive, such as a few heartbeats. A burst that is shorter
    than the time between two messages loses one message at most.
    """
    advance: Literal["message", "time"] = "message"
    """Whether the state of a link advances with every message on it, or with time, whether it is used or not."""
    loss_good: Probability = 0.0
    """Probability of loss in the good state, in [0, 1]."""
    loss_bad: Probability = 1.0
    """Probability of loss in the bad state, in [0, 1]."""
    common: Common = 0.0
    """Correlation of the states of two links with a node in common, such as those to two receivers of a broadcast;
    only if the state advances with time.

    A link is bad while its sender, its receiver or the link itself is bad. This limits `common` to less than 1/2: to
    0.487 for a share of 0.1, and to 0.414 for 0.5.

    If in doubt, 0.3 where robots drive into dead spots; 0: links are independent.
    """

    @model_validator(mode="after")
    def _check_common_and_burst(self) -> Self:
        if self.common and self.advance == "message":
            raise ValueError('common needs advance = "time": links have no messages in common')
        if self.common > (most := max_common(self.share)):
            raise ValueError(f"common should be at most {most:.4f} for a share of {self.share:g} (got {self.common:g})")
        min_burst = max(1.0, self.share / (1.0 - self.share))
        if self.advance == "message" and self.burst < min_burst:
            raise ValueError(f"burst should be at least {min_burst:g} messages for this share (got {self.burst:g})")
        return self

    def start_run(self, size: int) -> Loss:
        """Create the model of one run with `size` nodes; the model keeps the state of each link."""
        if self.common and self.share:
            return CommonBursts(self.share, self.burst, self.common, (self.loss_good, self.loss_bad), size)
        return Bursts(self)

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Draw (k,) losses for a model that calls this one."""
        return np.atleast_1d(context.of_run(self, GilbertElliott.start_run, rng)(context, rng))


class Bursts:
    """`GilbertElliott` in one run: one row per sender, with the state of the links used so far."""

    def __init__(self, model: GilbertElliott):
        self._share, self._in_time = model.share, model.advance == "time"
        recovery = 1.0 / model.burst  # r
        failure = recovery * model.share / (1.0 - model.share)  # p
        self._rate = failure + recovery
        self._loss_good, self._loss_bad = model.loss_good, model.loss_bad
        self._loses_all = model.loss_good == 0.0 and model.loss_bad == 1.0
        """Whether exactly the messages in the bad state are lost, so that each message takes one random number."""
        # The probabilities in `_rows` for a link that was good at its last message, and for one that was bad.
        self._after_good, self._after_bad = (0.0, 1.0) if self._in_time else (failure, 1.0 - recovery)
        self._rows: defaultdict[int, LinkMemory] = defaultdict(partial(LinkMemory, model.share))
        """By sender, the probability that each link is in the bad state: at its next message or, if the state advances
        with time, right after its last one. For a link that has not been used, it is the share of bad time."""

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> bool | Bools:
        """Advance the state of each link and return the (k,) losses, or that of the only link.

        Kept equal to draws link by link by
        `tests/kernel/test_propagation.py::test_losses_are_those_of_a_plain_model_that_draws_link_by_link`.
        """
        dst, src, now = context.dst, context.src, context.now
        if len(dst) == 1:
            return self.to_one(src, dst.item(), now, rng)
        row = self._rows[src]
        if row.ones and len(dst) <= FEW and self._loses_all:  # spares a change between `ones` and `value`, and back
            return np.array([self.to_one(src, node, now, rng) for node in dst.tolist()], dtype=bool)
        row.select(dst)
        chance = row.value
        if self._in_time:
            # In continuous time P(bad) tends exponentially to the share of bad time, with the rate p + r.
            exponent = self._rate * (row.since - now)
            fading = math.exp(exponent) if isinstance(exponent, float) else exp(exponent)
            chance, row.since = self._share + (chance - self._share) * fading, now
        bad: Bools = rng.random(len(dst)) < chance
        row.value.fill(self._after_good)  # takes half of the time of `take` or `where`
        row.value[bad] = self._after_bad
        if self._loses_all:
            return bad
        return rng.random(len(bad)) < np.where(bad, self._loss_bad, self._loss_good)

    def to_one(self, src: int, node: int, now: float, rng: np.random.Generator) -> bool:
        """Advance the state of one link and return whether it loses a message now, s."""
        row = self._rows[src]
        chance, since = row.ones.get(node) or row.one(node)
        if self._in_time:
            chance = self._share + (chance - self._share) * math.exp(self._rate * (since - now))
        bad = rng.random() < chance
        row.ones[node] = self._after_bad if bad else self._after_good, now
        if self._loses_all:
            return bad
        return rng.random() < (self._loss_bad if bad else self._loss_good)


class Correlated(Value):
    """Losses that follow each other, as `tc netem loss random p correlation` draws them.

    The random number of a message is a moving average: (1 - correlation) times a new number, plus `correlation` times
    the last number of the link (get_crandom in Linux, net/sched/sch_netem.c). The message is lost if its number is at
    most p. The average is distributed more narrowly than a uniform number, so for p < 1/2 the share of lost messages is
    less than p: with p = 0.1 and a correlation of 0.25, it is 1.75 % instead of 10 %. For bursts with a given share of
    losses use `gilbert_elliott`.
    """

    kind: Literal["correlated"] = "correlated"
    p: Probability = 0.1
    """Nominal probability of loss, in [0, 1]; see above."""
    correlation: Probability = 0.25
    """Share of the last random number of the link in the next one, in [0, 1]."""

    def start_run(self, size: int) -> Loss:
        """Create the model of one run with `size` nodes; the model keeps the last number of each link."""
        numbers, limit = CorrelatedNumbers(self.correlation), np.uint64(round(self.p * (RANGE - 1)))
        return lambda context, rng: bool(limit) and numbers(context, rng) <= limit  # as in Linux, p = 0 draws nothing

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> bool | Bools:
        """Draw (k,) losses for a model that calls this one; return False if nothing can be lost."""
        lost: bool | Bools = context.of_run(self, Correlated.start_run, rng)(context, rng)
        return lost


class FourState(Value):
    """Bursts and isolated losses: the Markov chain of `tc netem loss state p13 p31 p32 p23 p14`.

    The states of a link are 1: between bursts, received; 2: in a burst, received; 3: in a burst, lost; 4: between
    bursts, lost. From 4 it returns to 1. Each message first advances the state, and then is received or lost (Salsano,
    Ludovici, Ordine & Giannuzzi 2012, "Definition of a general and intuitive loss model for packet networks and its
    implementation in the Netem module in the Linux kernel"). With q = p13 / p31, the share of lost messages is
    (q + p14) / (1 + q (1 + p32 / p23) + p14). A link starts in its stationary distribution; in Linux, in state 1.
    """

    kind: Literal["four_state"] = "four_state"
    p13: Probability = 0.02
    """Probability that a burst begins with the next message, in [0, 1]."""
    p31: PositiveProbability = 0.3
    """Probability that a burst ends after a lost message, in (0, 1]."""
    p32: Probability = 0.2
    """Probability that a message is received within a burst after a lost one, in [0, 1]."""
    p23: PositiveProbability = 0.5
    """Probability that a message is lost after one that was received within a burst, in (0, 1]."""
    p14: Probability = 0.01
    """Probability of an isolated loss, in [0, 1]."""

    @model_validator(mode="after")
    def _check_sums(self) -> Self:
        for first, second in (("p13", "p14"), ("p31", "p32")):
            if (total := getattr(self, first) + getattr(self, second)) > 1.0:
                raise ValueError(f"{first} + {second} should be at most 1 (got {total:g})")
        return self

    def stationary(self) -> Floats:
        """Return the (4,) stationary probabilities of the states 1 to 4."""
        lost = min(self.p13 / self.p31, 1e150)  # finite, whatever the probabilities
        weights = np.array([1.0, min(lost * self.p32 / self.p23, 1e300), lost, self.p14])
        return weights / math.fsum(weights)

    def start_run(self, size: int) -> Loss:
        """Create the model of one run with `size` nodes; the model keeps the state of each link."""
        return _FourStates(self)

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Draw (k,) losses for a model that calls this one."""
        lost: Bools = context.of_run(self, FourState.start_run, rng)(context, rng)
        return lost


class _FourStates:
    """`FourState` in one run. The states 1 to 4 are 0 to 3 here; UNUSED is that of a link that has not been used."""

    UNUSED = 4

    def __init__(self, model: FourState):
        leaves_1, leaves_3 = model.p13 + model.p14, model.p31 + model.p32
        rows = [
            [1.0 - leaves_1, 1.0 - leaves_1, 1.0 - model.p14],
            [0.0, 1.0 - model.p23, 1.0],
            [model.p31, leaves_3, 1.0],
            [1.0, 1.0, 1.0],
            np.cumsum(model.stationary())[:3],
        ]
        self._limits = np.array(rows)
        """For each state, the probabilities that the next state is at most 1, at most 2, and at most 3."""
        self._rows: defaultdict[int, LinkMemory] = defaultdict(partial(LinkMemory, float(self.UNUSED)))

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Advance the state of each link and return the (k,) losses."""
        row = self._rows[context.src]
        row.select(context.dst)
        limits = self._limits[row.value.astype(np.intp)]
        state = (rng.random(len(limits))[:, np.newaxis] >= limits).sum(axis=1)
        row.value[:] = state
        return np.asarray(state >= 2)


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
        return self.near + (self.far - self.near) * power(
            np.minimum(distances, self.distance) / self.distance, self.exponent
        )

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
        self._last: dict[int, tuple[Floats, Floats]] = {}
        """By sender, its last array of `known_distances`, and the probabilities of loss at these distances."""

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Draw the (k,) losses."""
        distances = context.known_distances
        if distances is None:
            return self._model(context, rng)
        last = self._last.get(context.src)
        if last is None or last[0] is not distances:  # equal arrays are the same object, see `LinkContext`
            last = self._last[context.src] = distances, self._model.probability(distances)
        return rng.random(len(distances)) < last[1]


LOSSES = OneOf(
    Bernoulli,
    GilbertElliott,
    ByDistance,
    Correlated,
    FourState,
    CommonCause,
    LossTrace,
    SignalTrace,
    number=("bernoulli", "p"),
    takes=("context", "rng"),
    traits=LinkTraits,
)
