"""Noise of the sight of pursuers: the measured position of an evader, and the covariance of its error."""

from cmath import rect
from math import cosh, exp, inf, nan, pi, sinh, sqrt
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field

from desim.config.answers import wrong_answer
from desim.config.choice import OneOf
from desim.config.model import MAX_COORDINATE, Value
from desim.config.python_numbers import as_real
from desim.config.traits import is_ours

Deviation = Annotated[float, Field(ge=0, le=MAX_COORDINATE, allow_inf_nan=False, strict=True)]
LEAST = 1e-6
"""Least standard deviation in the covariance of a sighting: in m or, if the greatest is above 1 m, a share of it.

With it, every covariance has an inverse.
"""


class Covariance(NamedTuple):
    """The covariance of the two coordinates of a position, m^2."""

    xx: float
    xy: float
    yy: float


class Noiseless(Value):
    """A pursuer sees the true position and velocity of an evader."""

    kind: Literal["none"] = "none"


class PositionNoise(Value):
    """Both coordinates have independent normal errors."""

    kind: Literal["position"] = "position"
    deviation: Deviation = 0.5
    """Standard deviation of each coordinate, m.

    If in doubt, use the value of the data sheet: about 3 for satellite navigation, 0.1 for ultra-wideband radio.
    """

    def __call__(self, offset: complex, first: float, second: float) -> complex:
        """Return the measured vector to an evader, m, given the true one and two standard normal draws."""
        return offset + self.deviation * complex(first, second)

    def covariance(self, offset: complex) -> Covariance:
        """Return the covariance of the error at a true vector, m."""
        variance = max(self.deviation, LEAST) ** 2
        return Covariance(variance, 0.0, variance)


class RangeBearingNoise(Value):
    """The range and the bearing have independent normal errors, as with a radar, a sonar or a camera with depth.

    A measured range and bearing are converted to a vector without bias. A bearing whose error has the deviation s
    shortens the mean vector by the factor e^(-s^2/2), so each vector is multiplied by e^(s^2/2) (Mo, Song, Zhou, Sun &
    Bar-Shalom 1998, "Unbiased Converted Measurements for Tracking").
    """

    kind: Literal["range_bearing"] = "range_bearing"
    range: Deviation = 0.2
    """Standard deviation of the range, m."""
    bearing: Annotated[float, Field(ge=0, le=1, strict=True)] = 0.05
    """Standard deviation of the bearing, rad."""

    def __call__(self, offset: complex, first: float, second: float) -> complex:
        """Return the measured vector to an evader, m, given the true one and two standard normal draws."""
        distance = abs(offset)
        direction = offset / distance if distance else 1.0 + 0j
        return rect(exp(self.bearing**2 / 2.0), self.bearing * second) * direction * (distance + self.range * first)

    def covariance(self, offset: complex) -> Covariance:
        """Return the covariance of the error at a true vector, m.

        With a range r of deviation s_r and a bearing of deviation s, the variance along the vector is
        2 r^2 sinh(s^2/2)^2 + s_r^2 cosh(s^2), and across it (r^2 + s_r^2) sinh(s^2); to first order, s_r^2 and (r s)^2.
        """
        distance = abs(offset)
        c, s = (offset.real / distance, offset.imag / distance) if distance else (1.0, 0.0)
        bearing, variance = self.bearing**2, self.range**2
        least = (LEAST * max(self.range, distance * self.bearing, 1.0)) ** 2
        along = max(2.0 * (distance * sinh(bearing / 2.0)) ** 2 + variance * cosh(bearing), least)
        across = max((distance * distance + variance) * sinh(bearing), least)
        return Covariance(along * c * c + across * s * s, (along - across) * c * s, along * s * s + across * c * c)


Noise = Noiseless | PositionNoise | RangeBearingNoise


def covariance_of(noise: Any, offset: complex) -> Covariance:
    """Return the covariance of the error of a measurement, given the true vector to the evader, m.

    Raises:
        ValueError: if the covariance of a user's noise is not positive definite.
    """
    entries: Any = noise.covariance(offset)
    if type(entries) is Covariance and is_ours(type(noise)):
        return entries
    try:
        covariance = Covariance(*map(as_real, entries))
    except TypeError:
        covariance = Covariance(nan, nan, nan)
    xx, xy, yy = covariance
    if not (0.0 < xx < inf and xy * xy < xx * yy < inf):
        expected = "the entries xx, xy and yy of a positive definite matrix, in m^2"
        raise wrong_answer(f"covariance(offset) of a noise should return {expected}", entries, noise)
    return covariance


NOISES = OneOf(
    *(Noiseless, PositionNoise, RangeBearingNoise),
    needs=("covariance(offset)",),
    takes=("offset", "first", "second"),
    number=("position", "deviation"),
)


def expected_distance(distance: float, deviation: float) -> float:
    """Return the mean distance, m, to a point whose two coordinates have independent normal errors.

    It is the mean of a Rice law, s sqrt(pi/2) L_1/2(-d^2 / (2 s^2)) with the Laguerre function L_1/2, or
    1F1(-1/2; 1; -z) with z = d^2 / (2 s^2) (Rice 1945; Abramowitz & Stegun 1964, 13.1.2, 13.1.27 and 13.5.1).

    Args:
        distance: the distance d to the mean of the point, m.
        deviation: the standard deviation s of each coordinate, m.
    """
    if deviation == 0.0:
        return distance
    z = (distance / deviation) ** 2 / 2.0
    term, total = 1.0, 0.0
    if z > 40.0:  # the asymptotic series, whose error is below the first term that is left out
        for k in range(8):
            total += term
            term *= (k - 0.5) ** 2 / ((k + 1.0) * z)
        return distance * total
    for k in range(200):  # all terms are positive, so nothing cancels
        total += term
        term *= (k + 1.5) * z / (k + 1.0) ** 2
        if term < 1e-17 * total:
            break
    return deviation * sqrt(pi / 2.0) * exp(-z) * total
