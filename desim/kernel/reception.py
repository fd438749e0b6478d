"""Reception models: the probability that a message is received as a function of distance and range.

The range is the only parameter with a unit of length, so any model is scaled by its range alone. Below, d is a distance
and R the range, m.
"""

from math import inf, log
from typing import Annotated, Literal, Protocol

import numpy as np
from pydantic import Field

from desim.config.arrays import Floats
from desim.config.choice import OneOf
from desim.config.model import Positive, Probability, Value
from desim.kernel.traits import ReceptionTraits


class ReceptionModel(Protocol):
    """A reception model: `reception(distances, range)` returns the (k,) reception probabilities at (k,) distances, m.

    A model may have a method `bound(range)`; see `desim.kernel.traits.ReceptionTraits`.
    """

    def __call__(self, distances: Floats, range: float) -> Floats: ...  # noqa: A002, D102


class Disk(Value):
    """Reception is certain within the range and impossible beyond it."""

    kind: Literal["disk"] = "disk"

    def __call__(self, distances: Floats, range: float) -> Floats:  # noqa: A002
        """Return 1 where d <= R, else 0."""
        return (distances <= range).astype(float)

    def bound(self, range: float) -> float:  # noqa: A002
        """Return R."""
        return range


class QuasiUnitDisk(Value):
    """Reception is certain up to a share of the range, and random from there up to the range.

    See Kuhn, Wattenhofer & Zollinger 2008, "Ad Hoc Networks Beyond Unit Disk Graphs".
    """

    kind: Literal["quasi_unit_disk"] = "quasi_unit_disk"
    certain: Probability = 0.5
    """Share q of the range within which reception is certain, in [0, 1]."""
    p: Probability = 0.5
    """Probability of reception between q times the range and the range, in [0, 1]."""

    def __call__(self, distances: Floats, range: float) -> Floats:  # noqa: A002
        """Return 1 where d <= q R, p where q R < d <= R, else 0."""
        return np.where(distances <= self.certain * range, 1.0, np.where(distances <= range, self.p, 0.0))

    def bound(self, range: float) -> float:  # noqa: A002
        """Return R."""
        return range


class LogDistance(Value):
    """Log-distance path loss with lognormal shadowing; at the range the probability of reception is 1/2.

    P(d) = NormalCDF(10 n log10(R / d) / sigma) (Rappaport 2002, "Wireless Communications", 4.9).
    """

    kind: Literal["log_distance"] = "log_distance"
    exponent: Annotated[float, Field(gt=0, le=20, strict=True)] = 3.0
    """Path loss exponent n: 2 in free space, 3 to 4 over ground."""
    shadowing: Positive = 6.0
    """Standard deviation sigma of the shadowing, dB."""

    def __call__(self, distances: Floats, range: float) -> Floats:  # noqa: A002
        """Return P(d)."""
        from scipy.special import ndtr, xlogy

        with np.errstate(divide="ignore", over="ignore"):
            margin = xlogy(10.0 * self.exponent / log(10.0), range / distances)
        return np.asarray(ndtr(margin / self.shadowing))

    def bound(self, range: float) -> float:  # noqa: A002
        """Return a distance, m, beyond which no message is received.

        There P(d) < NormalCDF(-8.3) = 5e-17, which is less than any draw of `pair_uniform`.
        """
        ranges: float = 10.0 ** min(0.83 * self.shadowing / self.exponent, 300.0)
        return ranges * range


def bound(reception: ReceptionModel, range: float) -> float:  # noqa: A002
    """Return the distance, m, beyond which no message is ever received; inf if the model has no bound."""
    ends = ReceptionTraits.of(reception).bound
    return inf if ends is None else float(ends(range))


RECEPTION_MODELS = OneOf(Disk, QuasiUnitDisk, LogDistance, takes=("distances", "range"), traits=ReceptionTraits)
