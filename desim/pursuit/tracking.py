"""Tracking of an evader from noisy sightings: filters for a nearly constant velocity, and the fusion of their tracks.

The state is (x, y, vx, vy), in m and m/s. Between sightings the velocity changes by a random acceleration that is
constant for the time in between, with a standard deviation per axis (the discrete white noise acceleration of
Bar-Shalom, Li & Kirubarajan 2001, section 6.3.2).
"""

from bisect import bisect_left, bisect_right
from math import sqrt
from operator import attrgetter
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from desim.config.choice import OneOf
from desim.config.model import Value
from desim.kernel.units import SECOND
from desim.pursuit.noise import LEAST, Covariance
from desim.pursuit.small_matrices import Matrix, inverse, plus, product, scaled, times, trace, transpose

Acceleration = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False, strict=True)]
START_SPEED = 10.0
"""Standard deviation, m/s, of each component of the velocity after the first sighting."""
Fusion = Literal["by_stamp", "naive", "covariance_intersection"]


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


def merged(one: Measurement, other: Measurement) -> Measurement:
    """Return the sighting that two of the same time amount to, weighted by their inverse covariances."""
    (a, b, c), (xx, xy, yy) = one.covariance, other.covariance
    xx, xy, yy = a + xx, b + xy, c + yy
    dx, dy, determinant = other.x - one.x, other.y - one.y, xx * yy - xy * xy
    k, m = (a * yy - b * xy) / determinant, (b * xx - a * xy) / determinant  # the weight of the other, row by row
    n, w = (b * yy - c * xy) / determinant, (c * xx - b * xy) / determinant
    covariance = Covariance(a - k * a - m * b, b - k * b - m * c, c - n * b - w * c)
    return Measurement(one.stamp, one.observer, one.x + k * dx + m * dy, one.y + n * dx + w * dy, covariance)


def _matrix(covariance: Covariance) -> Matrix:
    xx, xy, yy = covariance
    return [[xx, xy], [xy, yy]]


class Track(NamedTuple):
    """The estimated state of an evader at one time."""

    stamp: int
    """ns"""
    state: list[float]
    """(x, y, vx, vy), m and m/s."""
    covariance: Matrix | None = None
    """(4, 4); None: the filter has none."""

    @property
    def position(self) -> complex:
        """The position, m."""
        return complex(*self.state[:2])

    @property
    def velocity(self) -> complex:
        """The velocity, m/s."""
        return complex(*self.state[2:])

    @property
    def deviation(self) -> float:
        """Root mean square of the standard deviations of both coordinates, m; 0 without a covariance."""
        return 0.0 if self.covariance is None else sqrt((self.covariance[0][0] + self.covariance[1][1]) / 2.0)


class Unfiltered(Value):
    """The newest sighting is the estimate; see `sensing.estimate`."""

    kind: Literal["none"] = "none"


class AlphaBeta(Value):
    """A filter with the stationary gains of a Kalman filter for sightings at equal intervals (Kalata 1984).

    Without noise the state is the newest position, and the difference quotient of the newest two.
    """

    kind: Literal["alpha_beta"] = "alpha_beta"
    acceleration: Acceleration = 1.0
    """Standard deviation of the acceleration of the evader per axis, m/s^2."""

    def start(self, seen: Measurement) -> Track:
        """Return the track after the first sighting: at rest at the measured position."""
        return Track(seen.stamp, [seen.x, seen.y, 0.0, 0.0])

    def predict(self, track: Track, stamp: int) -> Track:
        """Return the track at another time, ns."""
        return Track(stamp, _moved(track.state, (stamp - track.stamp) / SECOND))

    def update(self, track: Track, seen: Measurement) -> Track:
        """Return the track after a later sighting."""
        period = (seen.stamp - track.stamp) / SECOND
        x, y, vx, vy = _moved(track.state, period)
        deviation = sqrt((seen.covariance.xx + seen.covariance.yy) / 2.0)
        is_exact = deviation < 2.0 * LEAST
        alpha, beta = (1.0, 1.0) if is_exact else gains(period**2 * self.acceleration / deviation)
        dx, dy, rate = seen.x - x, seen.y - y, beta / period
        return Track(seen.stamp, [x + alpha * dx, y + alpha * dy, vx + rate * dx, vy + rate * dy])


class Kalman(Value):
    """The Kalman filter (Kalman 1960)."""

    kind: Literal["kalman"] = "kalman"
    acceleration: Acceleration = 1.0
    """Standard deviation of the acceleration of the evader per axis, m/s^2."""

    def start(self, seen: Measurement) -> Track:
        """Return the track after the first sighting: of unknown velocity at the measured position."""
        xx, xy, yy = seen.covariance
        speed = START_SPEED**2
        covariance = [[xx, xy, 0.0, 0.0], [xy, yy, 0.0, 0.0], [0.0, 0.0, speed, 0.0], [0.0, 0.0, 0.0, speed]]
        return Track(seen.stamp, [seen.x, seen.y, 0.0, 0.0], covariance)

    def predict(self, track: Track, stamp: int) -> Track:
        """Return the track at another time, ns."""
        assert track.covariance is not None
        t = (stamp - track.stamp) / SECOND
        f = [[1.0, 0.0, t, 0.0], [0.0, 1.0, 0.0, t], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
        a, b, c = (self.acceleration**2 * each for each in (t**4 / 4.0, t**3 / 2.0, t**2))
        noise = [[a, 0.0, b, 0.0], [0.0, a, 0.0, b], [b, 0.0, c, 0.0], [0.0, b, 0.0, c]]
        moved = product(product(f, track.covariance), transpose(f))
        return Track(stamp, _moved(track.state, t), plus(moved, noise))

    def update(self, track: Track, seen: Measurement) -> Track:
        """Return the track after a later sighting."""
        _, state, covariance = self.predict(track, seen.stamp)
        assert covariance is not None
        of_innovation = plus([row[:2] for row in covariance[:2]], _matrix(seen.covariance))
        gain = product([row[:2] for row in covariance], inverse(of_innovation))
        off = seen.x - state[0], seen.y - state[1]
        corrected = [x + row[0] * off[0] + row[1] * off[1] for x, row in zip(state, gain, strict=True)]
        taken = product(gain, covariance[:2])
        shrunk = plus(covariance, taken, -1.0)
        return Track(seen.stamp, corrected, scaled(plus(shrunk, transpose(shrunk)), 0.5))  # exactly symmetric


Estimator = AlphaBeta | Kalman
ESTIMATORS = OneOf(Unfiltered, AlphaBeta, Kalman, is_closed=True)


def gains(index: float) -> tuple[float, float]:
    """Return the gains (alpha, beta) for a tracking index T^2 s_w / s_v > 0 (Kalata 1984, "The Tracking Index").

    T is the time between two sightings, s_w the standard deviation of the acceleration and s_v that of a sighting.
    """
    r = (4.0 + index - sqrt(8.0 * index + index * index)) / 4.0
    alpha = 1.0 - r * r
    return alpha, 2.0 * (2.0 - alpha) - 4.0 * sqrt(1.0 - alpha)


def _moved(state: list[float], t: float) -> list[float]:
    x, y, vx, vy = state
    return [x + vx * t, y + vy * t, vx, vy]


class Filter:
    """The track of one evader from sightings that may arrive late and twice.

    A late sighting is inserted at its time stamp, and the later ones are processed again, so the track is that of the
    sightings in order. Sightings of several observers at the same time are merged into one. A sighting of the same
    observer and time counts once.

    Args:
        model: the filter.
        window: age, ns, beyond which a sighting is ignored; the sightings within it are kept.
    """

    def __init__(self, model: Estimator, window: int):
        self._model, self._window = model, window
        self._seen: list[Measurement] = []
        self._merged: list[Measurement] = []
        """Each sighting, merged with those before it of the same time."""
        self._tracks: list[Track] = []

    @property
    def track(self) -> Track | None:
        """The track at the newest sighting; None without sightings."""
        return self._tracks[-1] if self._tracks else None

    def at(self, stamp: int) -> Track | None:
        """Return the track at a time, ns; None without sightings."""
        return self._model.predict(self._tracks[-1], stamp) if self._tracks else None

    def add(self, seen: Measurement) -> None:
        """Process a sighting."""
        place = bisect_right(self._seen, seen[:2], key=lambda each: each[:2])
        if (place and self._seen[place - 1][:2] == seen[:2]) or self._is_too_old(seen):
            return
        self._seen.insert(place, seen)
        del self._merged[place:], self._tracks[place:]
        for each in self._seen[place:]:
            self._append(each)
        self._forget_old()

    def _append(self, seen: Measurement) -> None:
        """Process a sighting that is at least as new as all before."""
        before = len(self._tracks)
        if self._merged and self._merged[-1].stamp == seen.stamp:
            before = bisect_left(self._merged, seen.stamp, key=attrgetter("stamp"))
            seen = merged(self._merged[-1], seen)
        self._merged.append(seen)
        track = self._model.update(self._tracks[before - 1], seen) if before else self._model.start(seen)
        self._tracks.append(track)

    def _is_too_old(self, seen: Measurement) -> bool:
        """Return whether a sighting is older than all that are kept, and these are not all there were."""
        return bool(self._seen) and seen.stamp < self._seen[-1].stamp - self._window

    def _forget_old(self) -> None:
        """Keep the sightings of the window, and one before it."""
        old = bisect_left(self._seen, self._seen[-1].stamp - self._window, key=attrgetter("stamp"))
        if old > 1:
            del self._seen[: old - 1], self._merged[: old - 1], self._tracks[: old - 1]


def fused(one: Track, other: Track, how: Fusion) -> Track:
    """Return the fusion of two tracks of the same time, weighted by their inverse covariances.

    naive: the inverse covariances are added, as if the errors were independent; information that both tracks contain
    counts twice. covariance_intersection: they are averaged with the weight w = tr(P2) / (tr(P1) + tr(P2)) (Niehsen
    2002), which is consistent whatever the correlation of the errors (Julier & Uhlmann 1997).
    """
    assert one.covariance is not None
    assert other.covariance is not None
    first, second = inverse(one.covariance), inverse(other.covariance)
    if how == "covariance_intersection":
        weight = trace(other.covariance) / (trace(one.covariance) + trace(other.covariance))
        first, second = scaled(first, weight), scaled(second, 1.0 - weight)
    covariance = inverse(plus(first, second))
    mean = [x + y for x, y in zip(times(first, one.state), times(second, other.state), strict=True)]
    return Track(one.stamp, times(covariance, mean), covariance)
