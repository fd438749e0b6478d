"""Reception models: the probability that a message is received as a function of distance and range.

The range is the only parameter with a unit of length, so any model is scaled by its range alone. Below, d is a distance
and R the range, m.
"""

from math import inf, log, sqrt
from typing import Annotated, ClassVar, Literal, Protocol

import numpy as np
from pydantic import Field

from desim.config.arrays import Bools, Floats
from desim.config.choice import OneOf
from desim.config.model import Positive, Probability, Value
from desim.kernel.models.coherence import ChannelState, Variation
from desim.kernel.models.fading import (
    RiceFactor,
    Shape,
    nakagami_powers,
    nakagami_quantiles,
    nakagami_survival,
    rice_powers,
    rice_survival,
)
from desim.kernel.models.traits import ReceptionTraits

PathLossExponent = Annotated[float, Field(gt=0, le=20, strict=True)]


class ReceptionModel(Protocol):
    """A reception model: `reception(distances, range)` returns the (k,) reception probabilities at (k,) distances, m.

    A model may have a method `bound(range)`; see `desim.kernel.models.traits.ReceptionTraits`.
    """

    def __call__(self, distances: Floats, range: float) -> Floats: ...  # noqa: A002, D102


class Disk(Value):
    """Reception is certain within the range and impossible beyond it."""

    kind: Literal["disk"] = "disk"
    exponent: PathLossExponent = 3.0
    """Path loss exponent n, by which walls shorten the range: a wall of A dB by the factor 10^(-A / (10 n)). It has no
    other effect."""

    def __call__(self, distances: Floats, range: float) -> Floats:  # noqa: A002
        """Return 1 where d <= R, else 0."""
        return (distances <= range).astype(float)

    def received(self, distances: Floats, range: float, channel: ChannelState) -> Bools:  # noqa: A002
        """Return where d <= R."""
        return distances <= range

    def bound(self, range: float) -> float:  # noqa: A002
        """Return R."""
        return range


class QuasiUnitDisk(Value):
    """Reception is certain up to a share of the range, and random from there up to the range.

    See Kuhn, Wattenhofer & Zollinger 2008, "Ad Hoc Networks Beyond Unit Disk Graphs".
    """

    kind: Literal["quasi_unit_disk"] = "quasi_unit_disk"
    certain: Probability = 0.5
    """Share q of the range within which reception is certain, in [0, 1].

    If in doubt, 0.5; 1 is a disk.
    """
    p: Probability = 0.5
    """Probability of reception between q times the range and the range, in [0, 1]."""
    exponent: PathLossExponent = 3.0
    """Path loss exponent n, by which walls shorten the range, as that of `disk`."""

    def __call__(self, distances: Floats, range: float) -> Floats:  # noqa: A002
        """Return 1 where d <= q R, p where q R < d <= R, else 0."""
        probabilities = np.where(distances <= range, self.p, 0.0)
        probabilities[distances <= self.certain * range] = 1.0
        return probabilities

    def one(self, distance: float, range: float) -> float:  # noqa: A002
        """Return the probability of reception at one distance, m, in a fiftieth of the time.

        Kept equal to that at several distances by
        `tests/kernel/test_topology.py::test_several_messages_reach_what_each_of_them_reaches`.
        """
        if distance <= self.certain * range:
            return 1.0
        return self.p if distance <= range else 0.0

    def border(self, draws: Floats, range: float) -> Floats:  # noqa: A002
        """Return the distance up to which a message is received, by its draw: R if the draw is at most p, else q R."""
        return np.where(draws <= self.p, range, self.certain * range)

    def bound(self, range: float) -> float:  # noqa: A002
        """Return R."""
        return range


class LogDistance(Value):
    """Log-distance path loss with lognormal shadowing; at the range the probability of reception is 1/2.

    P(d) = NormalCDF(10 n log10(R / d) / sigma) (Rappaport 2002, "Wireless Communications", 4.9).
    """

    varies: ClassVar[tuple[Variation, ...]] = ("shadowing",)
    kind: Literal["log_distance"] = "log_distance"
    exponent: PathLossExponent = 3.0
    """Path loss exponent n: 2 in free space, 3 to 4 over ground.

    If in doubt, 3: a smaller one blurs the edge of the range, a larger one makes it sharp.
    """
    shadowing: Positive = 6.0
    """Standard deviation sigma of the shadowing, dB.

    If in doubt, 6; about 4 in the open, 8 to 12 among buildings.
    """

    def __call__(self, distances: Floats, range: float) -> Floats:  # noqa: A002
        """Return P(d)."""
        from scipy.special import ndtr

        margin = self._margin(distances, range)
        with np.errstate(over="ignore"):
            return np.asarray(ndtr(margin / self.shadowing))

    def received(self, distances: Floats, range: float, channel: ChannelState) -> Bools:  # noqa: A002
        """Return where the shadowing takes no more than the margin 10 n log10(R / d), dB."""
        attenuation = self.shadowing * channel.shadowing()
        return attenuation <= self._margin(distances, range)

    def _margin(self, distances: Floats, range: float) -> Floats:  # noqa: A002
        """Return (k,) the margin of the mean power above the least that is received: 10 n log10(R / d), dB."""
        from scipy.special import xlogy

        with np.errstate(divide="ignore", over="ignore"):
            margin: Floats = xlogy(10.0 * self.exponent / log(10.0), range / distances)
        return margin

    def one(self, distance: float, range: float) -> float:  # noqa: A002
        """Return P(d) at one distance d, m, in a fifth of the time.

        Kept equal to that at several distances by
        `tests/kernel/test_topology.py::test_several_messages_reach_what_each_of_them_reaches`.
        """
        from scipy.special import ndtr

        if not distance:
            return 1.0
        return float(ndtr(10.0 * self.exponent / log(10.0) * log(range / distance) / self.shadowing))

    def bound(self, range: float) -> float:  # noqa: A002
        """Return a distance, m, beyond which no message is received.

        There P(d) < NormalCDF(-8.3) = 5e-17, which is less than any draw of `pair_uniform`.
        """
        ratio: float = 10.0 ** min(0.83 * self.shadowing / self.exponent, 300.0)
        return ratio * range


NEGLIGIBLE = 5e-17
"""A probability of reception that is less than any draw of `pair_uniform`, so nothing is received."""


class Nakagami(Value):
    """Log-distance path loss with Nakagami fading; at the range the mean power is just enough to receive.

    P(d) = Q(m, m (d / R)^n), with the regularised upper incomplete gamma function Q. With m = 1 it is Rayleigh fading,
    P(d) = exp(-(d / R)^n), so 37 % of the messages are received at the range.
    """

    varies: ClassVar[tuple[Variation, ...]] = ("fading",)
    kind: Literal["nakagami"] = "nakagami"
    m: Shape = 1.0
    """Shape m, at least 0.5: 1 is Rayleigh fading, and the larger m, the less the power varies.

    If in doubt, 1 without, and 3 with a line of sight.
    """
    exponent: PathLossExponent = 3.0
    """Path loss exponent n: 2 in free space, 3 to 4 over ground."""

    def __call__(self, distances: Floats, range: float) -> Floats:  # noqa: A002
        """Return P(d)."""
        return nakagami_survival(self.m, _threshold(distances, range, self.exponent))

    def received(self, distances: Floats, range: float, channel: ChannelState) -> Bools:  # noqa: A002
        """Return where the power is at least (d / R)^n times its mean."""
        return nakagami_powers(self.m, channel.normals) >= _threshold(distances, range, self.exponent)

    def bound(self, range: float) -> float:  # noqa: A002
        """Return a distance, m, beyond which no message is received: there P(d) < 5e-17."""
        ratio = float(nakagami_quantiles(self.m, np.array([NEGLIGIBLE]))[0])
        return _distance(min(ratio, 1e300), range, self.exponent)


class Rice(Value):
    """Log-distance path loss with Rice fading; at the range the mean power is just enough to receive.

    P(d) = Q_1(sqrt(2 K), sqrt(2 (K + 1) (d / R)^n)), with Marcum's function Q_1. A receiver in line of sight gets one
    strong path and many weak ones. With K = 0 it is Rayleigh fading, see `nakagami`.
    """

    varies: ClassVar[tuple[Variation, ...]] = ("fading",)
    kind: Literal["rice"] = "rice"
    k: RiceFactor = 3.0
    """Ratio K of the power of the strong path to that of all others, not in dB: 0 is Rayleigh fading.

    If in doubt, 3; about 10 between aircraft in sight of each other.
    """
    exponent: PathLossExponent = 3.0
    """Path loss exponent n: 2 in free space, 3 to 4 over ground."""

    def __call__(self, distances: Floats, range: float) -> Floats:  # noqa: A002
        """Return P(d)."""
        return rice_survival(self.k, _threshold(distances, range, self.exponent))

    def received(self, distances: Floats, range: float, channel: ChannelState) -> Bools:  # noqa: A002
        """Return where the power is at least (d / R)^n times its mean."""
        return rice_powers(self.k, channel.normals) >= _threshold(distances, range, self.exponent)

    def bound(self, range: float) -> float:  # noqa: A002
        """Return a distance, m, beyond which no message is received.

        There P(d) < 5e-17, because Q_1(a, b) <= exp(-(b - a)^2 / 2) for b > a (Simon & Alouini 2000).
        """
        b = sqrt(2.0 * self.k) + sqrt(-2.0 * log(NEGLIGIBLE))
        return _distance(b**2 / (2.0 * (self.k + 1.0)), range, self.exponent)


def _threshold(distances: Floats, range: float, exponent: float) -> Floats:  # noqa: A002
    """Return the least power that is received, in units of the mean power at (k,) distances: (d / R)^n."""
    with np.errstate(over="ignore"):
        # A power of Python is the same on all machines; with the limit, it does not overflow (n is at most 20).
        return np.array([min(ratio, 1e15) ** exponent for ratio in (distances / range).tolist()])


def _distance(threshold: float, range: float, exponent: float) -> float:  # noqa: A002
    """Return the distance, m, at which (d / R)^n is the threshold; inf if it is too large for a float."""
    return range * threshold ** (1.0 / exponent) if log(threshold) < 600.0 * exponent else inf


def bound(reception: ReceptionModel, range: float) -> float:  # noqa: A002
    """Return the distance, m, beyond which no message is ever received; inf if the model has no bound."""
    bound_of_range = ReceptionTraits.of(reception).bound
    return inf if bound_of_range is None else float(bound_of_range(range))


RECEPTION_MODELS = OneOf(
    Disk, QuasiUnitDisk, LogDistance, Nakagami, Rice, takes=("distances", "range"), traits=ReceptionTraits
)
