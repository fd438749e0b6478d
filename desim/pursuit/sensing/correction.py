"""Corrections of a state and its covariance by a measurement, one independent number at a time.

The covariance after a number is (1 - K h) P (1 - K h)' + r K K', with the gain K, the vector h of the product that was
measured, and the variance r of its error (Joseph's form; Bar-Shalom, Li & Kirubarajan 2001, section 7.6.1). It is a sum
of positive matrices, whereas the shorter P - K h P loses its small eigenvalues in rounding errors. No matrix is
inverted, so a variance may be 0.
"""

from collections.abc import Sequence
from math import sqrt

ROUNDING = 1e-14
"""A difference of variances counts as 0, a rounding error, if it is at most this share of them."""
StateVector = tuple[float, float, float, float]
"""(x, y, vx, vy), m and m/s."""
Upper = tuple[float, float, float, float, float, float, float, float, float, float]
"""The upper triangle of the covariance of a state, row by row."""
Entry = tuple[Sequence[float], float, float]
"""A measured product with the state: (the vector h of the product, the measured value, the variance of its error)."""


def decorrelated(measured: Sequence[float], errors: Sequence[Sequence[float]]) -> list[Entry]:
    """Return numbers with independent errors that tell as much as a measurement of the first k entries of a state.

    The greatest variance comes first, as in a Cholesky factorisation with pivots, so no share exceeds 1. A variance of
    which only rounding errors are left counts as 0: the number is exact.

    Args:
        measured: (k,) the measured entries.
        errors: (k, k) the covariance of their errors.
    """
    rows = [[float(i == j) for j in range(4)] for i in range(len(measured))]
    numbers, remaining, pending = list(measured), [list(line) for line in errors], list(range(len(measured)))
    entries: list[Entry] = []
    while pending:
        k = max(pending, key=lambda i: remaining[i][i])
        pending.remove(k)
        variance = remaining[k][k] if remaining[k][k] > ROUNDING * errors[k][k] else 0.0
        for i in pending if variance else ():
            share = remaining[i][k] / variance
            rows[i] = [x - share * y for x, y in zip(rows[i], rows[k], strict=True)]
            numbers[i] -= share * numbers[k]
            for j in pending:
                remaining[i][j] -= share * remaining[k][j]
        entries.append((rows[k], numbers[k], variance))
    return entries


def _rounding_error(row: Sequence[float], variances: Sequence[float]) -> float:
    """Return the rounding error of the variance of a product with a state, given the variances of the state."""
    (a, b, c, d), (x, y, u, v) = row, (sqrt(max(variance, 0.0)) for variance in variances)
    most = abs(a) * x + abs(b) * y + abs(c) * u + abs(d) * v
    return ROUNDING * most * most


def corrected_by_position(
    state: StateVector, covariance: Upper, place: tuple[float, float], errors: Sequence[float]
) -> tuple[StateVector, Upper]:
    """Return a state and its covariance after a measurement of its position.

    Args:
        state: the state.
        covariance: its covariance.
        place: the measured position, m.
        errors: the covariance xx, xy, yy of its errors, m^2.
    """
    xx, xy, yy = errors
    return _with_entries(state, covariance, decorrelated(place, ((xx, xy), (xy, yy))))


def corrected_by_state(
    state: StateVector, covariance: Upper, measured: StateVector, errors: Upper
) -> tuple[StateVector, Upper]:
    """Return a state and its covariance after a measurement of all its entries.

    Args:
        state: the state.
        covariance: its covariance.
        measured: the measured state.
        errors: the covariance of its errors.
    """
    return _with_entries(state, covariance, decorrelated(measured, full_rows(errors)))


def full_rows(matrix: Upper) -> Sequence[Sequence[float]]:
    """Return the rows of a matrix, given its upper triangle."""
    xx, xy, xu, xv, yy, yu, yv, uu, uv, vv = matrix
    return (xx, xy, xu, xv), (xy, yy, yu, yv), (xu, yu, uu, uv), (xv, yv, uv, vv)


def _with_entries(state: StateVector, covariance: Upper, entries: Sequence[Entry]) -> tuple[StateVector, Upper]:
    """Return a state and its covariance after the measurements in `entries`, one by one.

    The ten numbers of the covariance are variables, and no vector is a list, so an entry takes a ninth of the time.

    Kept equal to a measurement of the first entries by
    `tests/pursuit/test_tracking.py::test_a_state_corrected_by_a_state_is_that_corrected_entry_by_entry`.
    """
    x, y, vx, vy = state
    xx, xy, xu, xv, yy, yu, yv, uu, uv, vv = covariance  # (u, v): the velocity
    variances = xx, yy, uu, vv
    # A rounding error is at most half of this times the square of h, by the inequality of Cauchy and Schwarz.
    least = 2.0 * ROUNDING * (abs(xx) + abs(yy) + abs(uu) + abs(vv))
    for row, number, variance in entries:
        a, b, c, d = row
        sx, sy = xx * a + xy * b + xu * c + xv * d, xy * a + yy * b + yu * c + yv * d
        su, sv = xu * a + yu * b + uu * c + uv * d, xv * a + yv * b + uv * c + vv * d
        total = sx * a + sy * b + su * c + sv * d + variance
        if total <= least * (a * a + b * b + c * c + d * d) and total <= _rounding_error(row, variances):
            continue  # the product is known exactly already
        difference = number - (a * x + b * y + c * vx + d * vy)
        gx, gy, gu, gv = sx / total, sy / total, su / total, sv / total
        x, y, vx, vy = x + gx * difference, y + gy * difference, vx + gu * difference, vy + gv * difference
        # The product of h with each row of (1 - K h) P, which rounding errors make slightly asymmetric.
        ky, ku = (xy - gy * sx) * a, (xu - gu * sx) * a + (yu - gu * sy) * b
        kv = (xv - gv * sx) * a + (yv - gv * sy) * b + (uv - gv * su) * c
        xx, xy, xu, xv = xx - gx * sx, xy - gx * sy, xu - gx * su, xv - gx * sv
        yy, yu, yv, uu, uv, vv = yy - gy * sy, yu - gy * su, yv - gy * sv, uu - gu * su, uv - gu * sv, vv - gv * sv
        kx, ky = xx * a + xy * b + xu * c + xv * d, ky + yy * b + yu * c + yv * d
        ku, kv = ku + uu * c + uv * d, kv + vv * d
        rx, ry, ru, rv = variance * gx, variance * gy, variance * gu, variance * gv
        xx, xy = xx - kx * gx + rx * gx, xy - kx * gy + rx * gy
        xu, xv = xu - kx * gu + rx * gu, xv - kx * gv + rx * gv
        yy, yu, yv = yy - ky * gy + ry * gy, yu - ky * gu + ry * gu, yv - ky * gv + ry * gv
        uu, uv, vv = uu - ku * gu + ru * gu, uv - ku * gv + ru * gv, vv - kv * gv + rv * gv
    return (x, y, vx, vy), (xx, xy, xu, xv, yy, yu, yv, uu, uv, vv)
