"""Tracking of an evader from noisy sightings: filters for a nearly constant velocity, and the fusion of their tracks.

The state is (x, y, vx, vy), in m and m/s. Each component of the velocity diffuses, because the acceleration is white
noise in continuous time (Bar-Shalom, Li & Kirubarajan 2001, section 6.2.2). With the diffusion c, in m/s per sqrt(s),
position and velocity change by random numbers with the covariance c^2 [t^3/3 t^2/2; t^2/2 t] in a time t. So a
prediction over a time is the same whether sightings divide this time or not.
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
from desim.pursuit.sensing.noise import LEAST, Covariance

VelocityDiffusion = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False, strict=True)]
START_SPEED = 10.0
"""Standard deviation, m/s, of each component of the velocity after the first sighting."""
ROUNDING = 1e-14
"""A difference of variances that is at most this share of them is 0 with rounding errors."""
Matrix = list[list[float]]
"""The rows of a matrix."""
NO_SPREAD: Matrix = [[0.0, 0.0], [0.0, 0.0]]
"""The covariance of a position that is taken for exact."""
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
    """At the measured position."""
    origin_x: float = 0.0
    """Position of the observer, m."""
    origin_y: float = 0.0
    """m"""


WIDE = 4.0
"""Variance of a predicted position, as a multiple of that of the sighting, beyond which the sighting tells better how
large its own error may be: with the average over so wide a prediction, a correction wastes what a near observer sees.
"""
CovarianceAt = Callable[[complex], Covariance]
"""Maps the true vector from an observer to an evader, m, to the covariance of the error of a sighting."""


def weighed(seen: Measurement, predicted: "Track | None", covariance_at: CovarianceAt) -> Measurement:
    """Return a sighting with the covariance that a filter assumes for its error.

    The covariance depends on the true position. It is averaged over where the evader may be: around the predicted
    position or, where that is much less certain (`WIDE`), around the measured one. At the measured position alone it
    would depend on the error: of range and bearing, sightings lie on an arc, their thin ellipses are tangents, and
    these meet beyond it (Bordonaro, Willett & Bar-Shalom 2014, "Decorrelated Unbiased Converted Measurement Kalman
    Filter"). With the average over the predicted position a correction is the best linear one (Zhao, Li & Jilkov 2004,
    "Best Linear Unbiased Filtering with Nonlinear Measurements for Target Tracking").
    """
    origin = complex(seen.origin_x, seen.origin_y)
    place, spread = complex(seen.x, seen.y), seen.covariance
    if predicted is not None:
        (xx, xy, *_), (_, yy, *_) = (predicted.covariance or NO_SPREAD)[:2]
        if xx + yy < WIDE * (spread.xx + spread.yy):
            place, spread = predicted.position, Covariance(xx, xy, yy)
    first, second, third, fourth = (covariance_at(point - origin) for point in _points(place, spread))
    mean = ((a + b + c + d) / 4.0 for a, b, c, d in zip(first, second, third, fourth, strict=True))
    return seen._replace(covariance=Covariance(*mean))


def _points(mean: complex, covariance: Covariance) -> tuple[complex, complex, complex, complex]:
    """Return four points with a mean and a covariance: their mean of a quadratic function is exact.

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
    """Return the sighting that two of the same time amount to, weighted by their inverse covariances."""
    first, second = _matrix(sighting.covariance), _matrix(other.covariance)
    (x, y), ((xx, xy), (_, yy)) = corrected([sighting.x, sighting.y], first, [other.x, other.y], second)
    return Measurement(sighting.stamp, sighting.observer, x, y, Covariance(xx, xy, yy))


def _matrix(covariance: Covariance) -> Matrix:
    xx, xy, yy = covariance
    return [[xx, xy], [xy, yy]]


def corrected(state: list[float], covariance: Matrix, seen: list[float], errors: Matrix) -> tuple[list[float], Matrix]:
    """Return a state and its covariance after a measurement of its first k entries.

    The errors of the measurement are decorrelated, the greatest variance first, and its entries are processed one by
    one (Bar-Shalom, Li & Kirubarajan 2001, section 7.6.1). No matrix is inverted, so a variance may be 0.

    Args:
        state: (n,) the state.
        covariance: (n, n) its covariance.
        seen: (k,) the measured entries.
        errors: (k, k) the covariance of their errors.
    """
    rows = [[float(i == j) for j in range(len(state))] for i in range(len(seen))]
    seen, errors, pending = list(seen), [list(row) for row in errors], list(range(len(seen)))
    variances = [errors[k][k] for k in pending]
    deviations = [sqrt(max(line[i], 0.0)) for i, line in enumerate(covariance)]
    while pending:
        # The greatest variance first, as in a Cholesky factorisation with pivots: no share exceeds 1, and a variance of
        # which only rounding errors are left is 0, that of an exact entry.
        k = max(pending, key=lambda i: errors[i][i])
        pending.remove(k)
        variance = errors[k][k] if errors[k][k] > ROUNDING * variances[k] else 0.0
        for i in pending if variance else ():
            share = errors[i][k] / variance
            rows[i] = [x - share * y for x, y in zip(rows[i], rows[k], strict=True)]
            seen[i] -= share * seen[k]
            for j in pending:
                errors[i][j] -= share * errors[k][j]
        most = _dot([abs(h) for h in rows[k]], deviations)
        state, covariance = _with_entry(state, covariance, rows[k], seen[k], variance, ROUNDING * most * most)
    return state, covariance


def _with_entry(
    state: list[float], covariance: Matrix, row: list[float], seen: float, variance: float, least: float
) -> tuple[list[float], Matrix]:
    """Return a state and its covariance P after one number, the product of a row h and the state with an error.

    The covariance is (1 - K h) P (1 - K h)' + r K K' with the gain K and the variance r of the error (Joseph's form).
    It is a sum of positive matrices, whereas the shorter P - K h P loses its small eigenvalues in rounding errors.
    """
    spread = [_dot(line, row) for line in covariance]
    total = _dot(spread, row) + variance
    if total <= least:  # the state is as exact as the number, up to rounding
        return state, covariance
    gain = [entry / total for entry in spread]
    off, n = seen - _dot(row, state), range(len(state))
    left = [[covariance[i][j] - gain[i] * spread[j] for j in n] for i in n]
    kept = [_dot(line, row) for line in left]
    upper = {(i, j): left[i][j] - kept[i] * gain[j] + variance * gain[i] * gain[j] for i in n for j in n[i:]}
    moved = [x + k * off for x, k in zip(state, gain, strict=True)]
    return moved, [[upper[min(i, j), max(i, j)] for j in n] for i in n]


def _dot(a: list[float], b: list[float]) -> float:
    """Return the product of two vectors, summed from the first entry on."""
    total = 0.0
    for x, y in zip(a, b, strict=True):
        total += x * y
    return total


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
        alpha, beta = (1.0, 1.0) if is_exact else stationary_gains(period**1.5 * self.velocity_diffusion / deviation)
        dx, dy, rate = seen.x - x, seen.y - y, beta / period
        return Track(seen.stamp, [x + alpha * dx, y + alpha * dy, vx + rate * dx, vy + rate * dy])


class Kalman(_Diffusing):
    """The Kalman filter (Kalman 1960)."""

    kind: Literal["kalman"] = "kalman"

    def start(self, seen: Measurement) -> Track:
        """Return the track after the first sighting: of unknown velocity at the measured position."""
        xx, xy, yy = seen.covariance
        speed = START_SPEED**2
        covariance = [[xx, xy, 0.0, 0.0], [xy, yy, 0.0, 0.0], [0.0, 0.0, speed, 0.0], [0.0, 0.0, 0.0, speed]]
        return Track(seen.stamp, [seen.x, seen.y, 0.0, 0.0], covariance)

    def predict(self, track: Track, stamp: int) -> Track:
        """Return the track at another time, ns."""
        assert track.covariance is not None
        (xx, xy, xu, xv), (_, yy, yu, yv), (_, _, uu, uv), (_, _, _, vv) = track.covariance  # (u, v): the velocity
        t = (stamp - track.stamp) / SECOND
        span = abs(t)  # a track is predicted to an earlier time where clocks differ; it is no surer there
        rate = self.velocity_diffusion**2
        a, b, c = rate * (span**3 / 3.0), rate * (t * span / 2.0), rate * span
        xx, yy = xx + t * (2.0 * xu + t * uu) + a, yy + t * (2.0 * yv + t * vv) + a
        xy = xy + t * (xv + yu + t * uv)
        xu, xv, yu, yv = xu + t * uu + b, xv + t * uv, yu + t * uv, yv + t * vv + b
        uu, vv = uu + c, vv + c
        covariance = [[xx, xy, xu, xv], [xy, yy, yu, yv], [xu, yu, uu, uv], [xv, yv, uv, vv]]
        return Track(stamp, _moved(track.state, t), covariance)

    def update(self, track: Track, seen: Measurement) -> Track:
        """Return the track after a later sighting."""
        _, state, covariance = self.predict(track, seen.stamp)
        assert covariance is not None
        return Track(seen.stamp, *corrected(state, covariance, [seen.x, seen.y], _matrix(seen.covariance)))


Estimator = AlphaBeta | Kalman
ESTIMATORS = OneOf(Unfiltered, AlphaBeta, Kalman, is_closed=True)


def stationary_gains(index: float) -> tuple[float, float]:
    """Return the stationary gains (alpha, beta) for a tracking index L = c T^(3/2) / s_v > 0.

    T is the time between two sightings, s_v the standard deviation of a sighting and c the diffusion of the velocity.
    With w^2 = L^2 (1/3 + sqrt(1/12 + 4/L^2)) and s = (sqrt(w^2 + 4) - w) / 2 they are alpha = 1 - s^2 and beta = L s,
    the stationary gains for a white acceleration (Bar-Shalom, Li & Kirubarajan 2001, section 6.5.3).
    """
    w = sqrt(index * (index / 3.0 + sqrt(index * index / 12.0 + 4.0)))
    s = 2.0 / (w + sqrt(w * w + 4.0))  # nothing cancels
    return s * w, index * s


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
        covariance_at: the covariance of the error of a sighting; None: that which each sighting has.
    """

    def __init__(self, model: Estimator, window: int, covariance_at: CovarianceAt | None = None):
        self._model, self._window, self._covariance_at = model, window, covariance_at
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
        place = bisect_right(self._seen, seen[:2], key=lambda kept: kept[:2])
        if (place and self._seen[place - 1][:2] == seen[:2]) or self._is_too_old(seen):
            return
        self._seen.insert(place, seen)
        del self._merged[place:], self._tracks[place:]
        for sighting in self._seen[place:]:
            self._append(sighting)
        self._forget_old()

    def _append(self, seen: Measurement) -> None:
        """Process a sighting that is at least as new as all before."""
        is_same_time = bool(self._merged) and self._merged[-1].stamp == seen.stamp
        stamps = attrgetter("stamp")
        before = bisect_left(self._merged, seen.stamp, key=stamps) if is_same_time else len(self._tracks)
        last = self._tracks[before - 1] if before else None
        if self._covariance_at is not None:
            # Before the first track, the sightings of the same time are all that is known of the position.
            predicted = self._model.predict(last, seen.stamp) if last else self._tracks[-1] if self._tracks else None
            seen = weighed(seen, predicted, self._covariance_at)
        if is_same_time:
            seen = merged(self._merged[-1], seen)
        self._merged.append(seen)
        self._tracks.append(self._model.update(last, seen) if last else self._model.start(seen))

    def _is_too_old(self, seen: Measurement) -> bool:
        """Return whether a sighting is older than all that are kept, and these are not all there were."""
        return bool(self._seen) and seen.stamp < self._seen[-1].stamp - self._window

    def _forget_old(self) -> None:
        """Keep the sightings of the window, and one before it."""
        old = bisect_left(self._seen, self._seen[-1].stamp - self._window, key=attrgetter("stamp"))
        if old > 1:
            del self._seen[: old - 1], self._merged[: old - 1], self._tracks[: old - 1]


def fused(track: Track, other: Track, how: Fusion) -> Track:
    """Return the fusion of two tracks of the same time, weighted by their inverse covariances.

    naive: the inverse covariances are added, as if the errors were independent; information that both tracks contain
    counts twice. covariance_intersection: they are averaged with the weight w = tr(P2) / (tr(P1) + tr(P2)) (Niehsen
    2002), which is consistent whatever the correlation of the errors (Julier & Uhlmann 1997).
    """
    assert track.covariance is not None
    assert other.covariance is not None
    first, second = track.covariance, other.covariance
    if how == "covariance_intersection":
        one_trace = first[0][0] + first[1][1] + first[2][2] + first[3][3]
        other_trace = second[0][0] + second[1][1] + second[2][2] + second[3][3]
        both = one_trace + other_trace
        first, second = _scaled(first, both / other_trace), _scaled(second, both / one_trace)
    return Track(track.stamp, *corrected_by_state(track.state, first, other.state, second))


def _scaled(covariance: Matrix, factor: float) -> Matrix:
    (xx, xy, xu, xv), (_, yy, yu, yv), (_, _, uu, uv), (_, _, _, vv) = covariance
    xy, xu, xv, yu, yv, uv = factor * xy, factor * xu, factor * xv, factor * yu, factor * yv, factor * uv
    return [[factor * xx, xy, xu, xv], [xy, factor * yy, yu, yv], [xu, yu, factor * uu, uv], [xv, yv, uv, factor * vv]]


def corrected_by_state(
    state: list[float], covariance: Matrix, seen: list[float], errors: Matrix
) -> tuple[list[float], Matrix]:
    """Return a state (x, y, vx, vy) and its covariance after a measurement of all its entries.

    The ten numbers of the covariance are variables, and no vector is a list: an entry costs a ninth of the time.

    Kept equal to a measurement of the first entries by
    `tests/pursuit/test_tracking.py::test_a_state_corrected_by_a_state_is_that_corrected_entry_by_entry`.

    Args:
        state: (4,) the state.
        covariance: (4, 4) its covariance.
        seen: (4,) the measured state.
        errors: (4, 4) the covariance of its errors.
    """
    rows = [(1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0)]
    seen, errors, pending = seen.copy(), [line.copy() for line in errors], [0, 1, 2, 3]
    variances = errors[0][0], errors[1][1], errors[2][2], errors[3][3]
    x, y, vx, vy = state
    (xx, xy, xu, xv), (_, yy, yu, yv), (_, _, uu, uv), (_, _, _, vv) = covariance  # (u, v): the velocity
    dx, dy, du, dv = sqrt(max(xx, 0.0)), sqrt(max(yy, 0.0)), sqrt(max(uu, 0.0)), sqrt(max(vv, 0.0))
    while pending:
        k = pending[0]
        for i in pending:
            if errors[i][i] > errors[k][k]:
                k = i
        pending.remove(k)
        line, (a, b, c, d), entry = errors[k], rows[k], seen[k]
        variance = line[k] if line[k] > ROUNDING * variances[k] else 0.0
        for i in pending if variance else ():
            other, (e, f, g, h) = errors[i], rows[i]
            share = other[k] / variance
            rows[i] = e - share * a, f - share * b, g - share * c, h - share * d
            seen[i] -= share * entry
            for j in pending:
                other[j] -= share * line[j]
        most = abs(a) * dx + abs(b) * dy + abs(c) * du + abs(d) * dv
        sx, sy = xx * a + xy * b + xu * c + xv * d, xy * a + yy * b + yu * c + yv * d
        su, sv = xu * a + yu * b + uu * c + uv * d, xv * a + yv * b + uv * c + vv * d
        total = sx * a + sy * b + su * c + sv * d + variance
        if total <= ROUNDING * most * most:
            continue
        gx, gy, gu, gv = sx / total, sy / total, su / total, sv / total  # the gain K
        off = entry - (a * x + b * y + c * vx + d * vy)
        x, y, vx, vy = x + gx * off, y + gy * off, vx + gu * off, vy + gv * off
        # The product of h with each row of (1 - K h) P, which has rounding errors of its own below the diagonal.
        kx = (xx - gx * sx) * a + (xy - gx * sy) * b + (xu - gx * su) * c + (xv - gx * sv) * d
        ky = (xy - gy * sx) * a + (yy - gy * sy) * b + (yu - gy * su) * c + (yv - gy * sv) * d
        ku = (xu - gu * sx) * a + (yu - gu * sy) * b + (uu - gu * su) * c + (uv - gu * sv) * d
        kv = (xv - gv * sx) * a + (yv - gv * sy) * b + (uv - gv * su) * c + (vv - gv * sv) * d
        rx, ry, ru, rv = variance * gx, variance * gy, variance * gu, variance * gv
        xx, xy = xx - gx * sx - kx * gx + rx * gx, xy - gx * sy - kx * gy + rx * gy
        xu, xv = xu - gx * su - kx * gu + rx * gu, xv - gx * sv - kx * gv + rx * gv
        yy, yu = yy - gy * sy - ky * gy + ry * gy, yu - gy * su - ky * gu + ry * gu
        yv, uu = yv - gy * sv - ky * gv + ry * gv, uu - gu * su - ku * gu + ru * gu
        uv, vv = uv - gu * sv - ku * gv + ru * gv, vv - gv * sv - kv * gv + rv * gv
    return [x, y, vx, vy], [[xx, xy, xu, xv], [xy, yy, yu, yv], [xu, yu, uu, uv], [xv, yv, uv, vv]]
