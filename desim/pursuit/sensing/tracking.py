"""Tracking of an evader from noisy sightings: filters for a nearly constant velocity.

The state is (x, y, vx, vy), in m and m/s. Each component of the velocity diffuses, because the acceleration is white
noise in continuous time (Bar-Shalom, Li & Kirubarajan 2001, section 6.2.2). With the diffusion c, in m/s per sqrt(s),
position and velocity change by random numbers with the covariance c^2 [t^3/3 t^2/2; t^2/2 t] in a time t. So
a prediction over a time is the same in one step as in several steps.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping
from math import sqrt
from operator import attrgetter
from types import MappingProxyType
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from desim.config.choice import OneOf
from desim.config.model import Value
from desim.kernel.core.units import SECOND
from desim.pursuit.sensing.correction import StateVector, Upper, corrected_by_position
from desim.pursuit.sensing.noise import LEAST, Covariance

_new = tuple.__new__  # creates a named tuple in a third of the time
VelocityDiffusion = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False, strict=True)]
START_SPEED = 10.0
"""Standard deviation, m/s, of each component of the velocity of an evader after its first sighting.

If the speed of the evader over ground is greater, this speed takes the place of the value.
"""


class Measurement(NamedTuple):
    """A noisy sighting of an evader."""

    stamp: int
    """Time of the sighting by the clock of its observer, ns."""
    observer: int
    x: float
    """m"""
    y: float
    """m"""
    covariance: Covariance
    """At the measured position."""
    origin_x: float = 0.0
    """Position of the observer, m."""
    origin_y: float = 0.0
    """m"""


WIDE = 4.0
"""From this ratio of the variances of the predicted and the measured position on, the covariance of a sighting is
averaged around the measured position. Around so uncertain a prediction, the average would include places far from the
observer, so the error of a near sighting would count as large.
"""
CovarianceAt = Callable[[complex], Covariance]
"""Maps the true vector from an observer to an evader, m, to the covariance of the error of a sighting."""


def weighed(sighting: Measurement, predicted: "Track | None", covariance_at: CovarianceAt) -> Measurement:
    """Return a sighting with the covariance that a filter assumes for its error.

    The covariance depends on the true position. It is averaged over the positions that the evader may have: around the
    predicted position or, if that is much less certain (`WIDE`), around the measured one. With the average around the
    predicted position, a correction is the best linear one (Zhao, Li & Jilkov 2004, "Best Linear Unbiased Filtering
    with Nonlinear Measurements for Target Tracking").

    The covariance at the measured position alone would depend on the error. For example, sightings by range and bearing
    lie on an arc: their thin ellipses are tangents to the arc, which intersect beyond it (Bordonaro, Willett &
    Bar-Shalom 2014, "Decorrelated Unbiased Converted Measurement Kalman Filter").
    """
    origin = complex(sighting.origin_x, sighting.origin_y)
    place, spread = complex(sighting.x, sighting.y), sighting.covariance
    if predicted is not None:
        expected = predicted.position_covariance
        if expected.xx + expected.yy < WIDE * (spread.xx + spread.yy):
            place, spread = predicted.position, expected
    first, second, third, fourth = (covariance_at(point - origin) for point in _points(place, spread))
    mean = ((a + b + c + d) / 4.0 for a, b, c, d in zip(first, second, third, fourth, strict=True))
    return sighting._replace(covariance=Covariance(*mean))


def _points(mean: complex, covariance: Covariance) -> tuple[complex, complex, complex, complex]:
    """Return four points with a given mean and covariance; the mean of a quadratic function over them is exact.

    They are the mean plus and minus sqrt(2) times the columns of the Cholesky factor of the covariance (Julier &
    Uhlmann 1997, "A New Extension of the Kalman Filter to Nonlinear Systems").
    """
    xx, xy, yy = covariance
    width = sqrt(max(xx, 0.0))
    slope = xy / width if width else 0.0
    first = sqrt(2.0) * complex(width, slope)
    second = sqrt(2.0) * complex(0.0, sqrt(max(yy - slope * slope, 0.0)))
    return mean + first, mean - first, mean + second, mean - second


def merged(sighting: Measurement, other: Measurement) -> Measurement:
    """Return one sighting for two of the same time: their mean, weighted by the inverse covariances."""
    xx, xy, yy = sighting.covariance
    state, covariance = (sighting.x, sighting.y, 0.0, 0.0), (xx, xy, 0.0, 0.0, yy, 0.0, 0.0, 0.0, 0.0, 0.0)
    (x, y, *_), covariance = corrected_by_position(state, covariance, (other.x, other.y), other.covariance)
    xx, xy, _, _, yy, *_ = covariance
    return Measurement(sighting.stamp, sighting.observer, x, y, Covariance(xx, xy, yy))


class Track(NamedTuple):
    """The estimated state of an evader at one time."""

    stamp: int
    """ns"""
    state: StateVector
    covariance: Upper | None = None
    """None: the filter has none."""

    @property
    def position(self) -> complex:
        """The position, m."""
        return complex(*self.state[:2])

    @property
    def velocity(self) -> complex:
        """The velocity, m/s."""
        return complex(*self.state[2:])

    @property
    def position_covariance(self) -> Covariance:
        """The covariance of the position; 0 if the filter has none."""
        if self.covariance is None:
            return Covariance(0.0, 0.0, 0.0)
        xx, xy, _, _, yy, *_ = self.covariance
        return Covariance(xx, xy, yy)

    @property
    def deviation(self) -> float:
        """Root mean square of the standard deviations of both coordinates, m; 0 without a covariance."""
        xx, _, yy = self.position_covariance
        return sqrt((xx + yy) / 2.0)


class Unfiltered(Value):
    """The newest sighting is the estimate; see `sensing.estimate`."""

    kind: Literal["none"] = "none"


class _Diffusing(Value):
    """A filter for an evader whose velocity diffuses."""

    _replaced: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "acceleration": ", use velocity_diffusion instead, in m/s per sqrt(s), which does not depend on the"
            " interval between sightings; an acceleration a at an interval T has about that of a sqrt(T)"
        }
    )
    velocity_diffusion: VelocityDiffusion = 0.3
    """Diffusion of the velocity of the evader per axis, m/s per sqrt(s): after a time t the velocity has changed by
    velocity_diffusion sqrt(t) (standard deviation), however many sightings there were.

    With a small value the track lags behind the turns of the evader; with a large one it follows the noise.

    If in doubt, use the change of velocity in a usual manoeuvre divided by the square root of its duration.
    """


class AlphaBeta(_Diffusing):
    """A filter with the stationary gains of a Kalman filter for sightings at equal intervals (Kalata 1984).

    Without noise the state is the newest position, and the difference quotient of the newest two.
    """

    kind: Literal["alpha_beta"] = "alpha_beta"

    def start(self, sighting: Measurement, speed: float = 0.0) -> Track:
        """Return the track after the first sighting, whatever the speed: at rest at the measured position."""
        return Track(sighting.stamp, (sighting.x, sighting.y, 0.0, 0.0))

    def predict(self, track: Track, stamp: int) -> Track:
        """Return the track at another time, ns."""
        return Track(stamp, _moved(track.state, (stamp - track.stamp) / SECOND))

    def update(self, track: Track, sighting: Measurement) -> Track:
        """Return the track after a later sighting."""
        period = (sighting.stamp - track.stamp) / SECOND
        x, y, vx, vy = _moved(track.state, period)
        deviation = sqrt((sighting.covariance.xx + sighting.covariance.yy) / 2.0)
        is_exact = deviation < 2.0 * LEAST  # the covariance of a sighting without noise has the deviation LEAST
        alpha, beta = (1.0, 1.0) if is_exact else stationary_gains(period**1.5 * self.velocity_diffusion / deviation)
        dx, dy, rate = sighting.x - x, sighting.y - y, beta / period
        return Track(sighting.stamp, (x + alpha * dx, y + alpha * dy, vx + rate * dx, vy + rate * dy))


class Kalman(_Diffusing):
    """The Kalman filter (Kalman 1960).

    After the first sighting each component of the velocity is 0, with a standard deviation of 10 m/s or, if greater,
    the speed of the evader over ground. This speed includes the top speed of a bounded flow that carries the evader.
    """

    kind: Literal["kalman"] = "kalman"

    def start(self, sighting: Measurement, speed: float = 0.0) -> Track:
        """Return the track after the first sighting of an evader of a speed, m/s, at the measured position."""
        xx, xy, yy = sighting.covariance
        variance = max(START_SPEED, speed) ** 2
        covariance = xx, xy, 0.0, 0.0, yy, 0.0, 0.0, variance, 0.0, variance
        return Track(sighting.stamp, (sighting.x, sighting.y, 0.0, 0.0), covariance)

    def predict(self, track: Track, stamp: int) -> Track:
        """Return the track at another time, ns."""
        assert track.covariance is not None
        xx, xy, xu, xv, yy, yu, yv, uu, uv, vv = track.covariance  # (u, v): the velocity
        t = (stamp - track.stamp) / SECOND
        span = abs(t)  # t is negative if clocks differ: the track is then as uncertain as after -t
        rate = self.velocity_diffusion**2
        a, b, c = rate * (span**3 / 3.0), rate * (t * span / 2.0), rate * span
        xx, yy = xx + t * (2.0 * xu + t * uu) + a, yy + t * (2.0 * yv + t * vv) + a
        xy = xy + t * (xv + yu + t * uv)
        xu, xv, yu, yv = xu + t * uu + b, xv + t * uv, yu + t * uv, yv + t * vv + b
        uu, vv = uu + c, vv + c
        return _new(Track, (stamp, _moved(track.state, t), (xx, xy, xu, xv, yy, yu, yv, uu, uv, vv)))

    def update(self, track: Track, sighting: Measurement) -> Track:
        """Return the track after a later sighting."""
        _, state, covariance = self.predict(track, sighting.stamp)
        assert covariance is not None
        place = sighting.x, sighting.y
        return Track(sighting.stamp, *corrected_by_position(state, covariance, place, sighting.covariance))


Estimator = AlphaBeta | Kalman
ESTIMATORS = OneOf(Unfiltered, AlphaBeta, Kalman, is_closed=True)


def stationary_gains(index: float) -> tuple[float, float]:
    """Return the stationary gains (alpha, beta) for a tracking index L = c T^(3/2) / s_v > 0.

    T is the time between two sightings, s_v the standard deviation of a sighting and c the diffusion of the velocity.
    With w^2 = L^2 (1/3 + sqrt(1/12 + 4/L^2)) and s = (sqrt(w^2 + 4) - w) / 2 they are alpha = 1 - s^2 and beta = L s,
    the stationary gains for a white acceleration (Bar-Shalom, Li & Kirubarajan 2001, section 6.5.3).
    """
    w = sqrt(index * (index / 3.0 + sqrt(index * index / 12.0 + 4.0)))
    s = 2.0 / (w + sqrt(w * w + 4.0))  # a form in which nothing cancels
    return s * w, index * s


def _moved(state: StateVector, t: float) -> StateVector:
    x, y, vx, vy = state
    return x + vx * t, y + vy * t, vx, vy


class Filter:
    """The track of one evader from sightings that may arrive late and twice.

    A late sighting is inserted at its time stamp, and all later sightings are processed again, so the order of arrival
    does not change the track. Sightings of several observers at the same time are merged into one. A second sighting of
    the same observer and time is ignored.

    Args:
        model: the filter.
        window: age, ns, beyond which a sighting is ignored; the sightings within it are kept.
        covariance_at: returns the covariance of the error of a sighting; None: that in the sighting.
        speed: the greatest speed of the evader over ground, m/s.
    """

    def __init__(self, model: Estimator, window: int, covariance_at: CovarianceAt | None = None, *, speed: float = 0.0):
        self._model, self._window, self._covariance_at, self._speed = model, window, covariance_at, speed
        self._sightings: list[Measurement] = []
        self._merged: list[Measurement] = []
        """For each sighting, the merger of it and the sightings of the same time before it."""
        self._tracks: list[Track] = []

    @property
    def track(self) -> Track | None:
        """The track at the newest sighting; None without sightings."""
        return self._tracks[-1] if self._tracks else None

    def at(self, stamp: int) -> Track | None:
        """Return the track at a time, ns; None without sightings."""
        return self._model.predict(self._tracks[-1], stamp) if self._tracks else None

    def add(self, sighting: Measurement) -> None:
        """Process a sighting."""
        index = bisect_right(self._sightings, sighting[:2], key=lambda other: other[:2])  # in order of time, observer
        if index and self._sightings[index - 1][:2] == sighting[:2]:
            return
        if self._sightings and sighting.stamp < self._sightings[-1].stamp - self._window:
            return
        self._sightings.insert(index, sighting)
        del self._merged[index:], self._tracks[index:]
        for unprocessed in self._sightings[index:]:
            self._append(unprocessed)
        self._forget_old()

    def _append(self, sighting: Measurement) -> None:
        """Process a sighting that is at least as new as all before."""
        is_same_time = bool(self._merged) and self._merged[-1].stamp == sighting.stamp
        stamps = attrgetter("stamp")
        older = bisect_left(self._merged, sighting.stamp, key=stamps) if is_same_time else len(self._tracks)
        last = self._tracks[older - 1] if older else None
        if self._covariance_at is not None:
            # Without an older track, only the other sightings of the same time tell the position.
            latest = self._tracks[-1] if self._tracks else None
            predicted = self._model.predict(last, sighting.stamp) if last else latest
            sighting = weighed(sighting, predicted, self._covariance_at)
        if is_same_time:
            sighting = merged(self._merged[-1], sighting)
        self._merged.append(sighting)
        self._tracks.append(self._model.update(last, sighting) if last else self._model.start(sighting, self._speed))

    def _forget_old(self) -> None:
        """Keep the sightings of the window, and one before it."""
        old = bisect_left(self._sightings, self._sightings[-1].stamp - self._window, key=attrgetter("stamp"))
        if old > 1:
            del self._sightings[: old - 1], self._merged[: old - 1], self._tracks[: old - 1]
