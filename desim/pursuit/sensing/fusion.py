"""The fusion of tracks, weighted by their inverse covariances.

The inverse of a covariance is the information of a track. Fusion adds informations, so it needs no gain (Bar-Shalom, Li
& Kirubarajan 2001, section 7.2). A covariance has 2 x 2 blocks: of position, of velocity, and
between both. So its inverse has a closed form, by the Schur complement of the velocity.
"""

from collections.abc import Sequence
from math import prod
from typing import Literal, NamedTuple, cast

from desim.pursuit.sensing.correction import StateVector, Upper, corrected_by_state, decorrelated, full_rows
from desim.pursuit.sensing.tracking import Track

_new = tuple.__new__  # creates a named tuple in a third of the time
Fusion = Literal["by_stamp", "naive", "covariance_intersection"]
LEAST_DETERMINANT = 1e-4
"""Least determinant of a matrix that is inverted in closed form, relative to the product of its diagonal.

Below it the rounding errors of an inverse grow beyond 1e-10 of its entries.
"""
TINY = 1e-300
"""Least determinant of such a matrix, so that neither it nor its inverse is 0 or infinite in floating point."""


class Information(NamedTuple):
    """What a track tells, as numbers that fusion adds."""

    matrix: Upper
    """The inverse of the covariance."""
    vector: StateVector
    """The product of the matrix and the state."""
    determinant: float
    """The determinant of the matrix."""


class InformedTrack(NamedTuple):
    """A track and its information, which is None if the covariance is nearly singular."""

    track: Track
    information: Information | None


def informed(track: Track) -> InformedTrack:
    """Return a track with a covariance, and its information."""
    assert track.covariance is not None
    inverted, information = inverse(track.covariance), None
    if inverted is not None:
        matrix, determinant = inverted
        information = _new(Information, (matrix, product(matrix, track.state), 1.0 / determinant))
    return _new(InformedTrack, (track, information))


def fused(tracks: Sequence[InformedTrack], how: Fusion) -> Track:
    """Return the fusion of tracks of the same time, one by one.

    naive: the inverse covariances are added, as if the errors were independent; information that several tracks
    contain counts several times. covariance_intersection: two inverse covariances are averaged with the weights
    w = det(P2) / (det(P1) + det(P2)) and 1 - w. The average is consistent whatever the correlation of the errors
    (Julier & Uhlmann 1997). w is the fast weight of Niehsen (2002) with determinants in place of traces: traces add m^2
    and (m/s)^2, and determinants do not depend on units and axes. The weight that minimises the determinant of the
    fused covariance would give a slightly lower one, but jumps from one track to another of equal covariance.

    Kept equal to corrections of the first track by
    `tests/pursuit/test_tracking.py::test_tracks_that_are_fused_by_information_are_those_that_are_corrected`.
    """
    first, *others = tracks
    if not others:
        return first.track
    combined, covariance = first.information, first.track.covariance
    for _, information in others:
        if combined is not None and information is not None:
            matrix, vector = _mixed(combined, information, how)
            inverted = inverse(matrix)
        if combined is None or information is None or inverted is None:
            return fused_by_corrections([track for track, _ in tracks], how)
        covariance, determinant = inverted
        combined = _new(Information, (matrix, vector, determinant))
    assert combined is not None
    assert covariance is not None
    return Track(first.track.stamp, product(covariance, combined.vector), covariance)


def _mixed(one: Information, other: Information, how: Fusion) -> tuple[Upper, StateVector]:
    """Return the weighted sums of two informations: the matrix and the vector."""
    (xx, xy, xu, xv, yy, yu, yv, uu, uv, vv), (x, y, u, v), one_determinant = one
    (xx2, xy2, xu2, xv2, yy2, yu2, yv2, uu2, uv2, vv2), (x2, y2, u2, v2), other_determinant = other
    a = b = 1.0
    if how == "covariance_intersection":
        total = one_determinant + other_determinant
        a, b = one_determinant / total, other_determinant / total
    xx, xy, xu, xv, yy = a * xx + b * xx2, a * xy + b * xy2, a * xu + b * xu2, a * xv + b * xv2, a * yy + b * yy2
    yu, yv, uu, uv, vv = a * yu + b * yu2, a * yv + b * yv2, a * uu + b * uu2, a * uv + b * uv2, a * vv + b * vv2
    vector = a * x + b * x2, a * y + b * y2, a * u + b * u2, a * v + b * v2
    return (xx, xy, xu, xv, yy, yu, yv, uu, uv, vv), vector


def inverse(matrix: Upper) -> tuple[Upper, float] | None:
    """Return the inverse of a positive matrix in closed form, and the determinant of the matrix.

    None if it is nearly singular (`LEAST_DETERMINANT`).
    """
    xx, xy, xu, xv, yy, yu, yv, uu, uv, vv = matrix
    of_velocity = uu * vv - uv * uv
    if not of_velocity > 0.0:
        return None
    iuu, iuv, ivv = vv / of_velocity, -uv / of_velocity, uu / of_velocity
    # The regression of position on velocity: the block between both times the inverse of the block of velocity.
    gxu, gxv, gyu, gyv = xu * iuu + xv * iuv, xu * iuv + xv * ivv, yu * iuu + yv * iuv, yu * iuv + yv * ivv
    # s: the Schur complement of the velocity; i: the inverse.
    sxx, sxy, syy = xx - gxu * xu - gxv * xv, xy - gxu * yu - gxv * yv, yy - gyu * yu - gyv * yv
    of_position = sxx * syy - sxy * sxy
    determinant = of_position * of_velocity
    if not (determinant > LEAST_DETERMINANT * (xx * yy * uu * vv) and TINY < determinant < 1.0 / TINY):
        return None
    ixx, ixy, iyy = syy / of_position, -sxy / of_position, sxx / of_position
    ixu, ixv = -ixx * gxu - ixy * gyu, -ixx * gxv - ixy * gyv
    iyu, iyv = -ixy * gxu - iyy * gyu, -ixy * gxv - iyy * gyv
    iuu, iuv, ivv = iuu - gxu * ixu - gyu * iyu, iuv - gxu * ixv - gyu * iyv, ivv - gxv * ixv - gyv * iyv
    return (ixx, ixy, ixu, ixv, iyy, iyu, iyv, iuu, iuv, ivv), determinant


def product(matrix: Upper, state: StateVector) -> StateVector:
    """Return the product of a symmetric matrix and a state."""
    xx, xy, xu, xv, yy, yu, yv, uu, uv, vv = matrix
    x, y, u, v = state
    position = xx * x + xy * y + xu * u + xv * v, xy * x + yy * y + yu * u + yv * v
    velocity = xu * x + yu * y + uu * u + uv * v, xv * x + yv * y + uv * u + vv * v
    return position + velocity


def fused_by_corrections(tracks: Sequence[Track], how: Fusion) -> Track:
    """Return the fusion of tracks as `fused` does, also of exact ones: the first is corrected by each of the others."""
    first, *others = tracks
    state, covariance = first.state, first.covariance
    for other in others:
        assert covariance is not None
        assert other.covariance is not None
        errors = other.covariance
        if how == "covariance_intersection":
            one_share, other_share = determinant_of(errors), determinant_of(covariance)
            total = one_share + other_share
            if total and not one_share:  # only the other track is exact
                state, covariance = other.state, errors
            if total and not (one_share and other_share):
                continue
            one_share, other_share = (one_share / total, other_share / total) if total else (0.5, 0.5)
            covariance, errors = _scaled(covariance, 1.0 / one_share), _scaled(errors, 1.0 / other_share)
        state, covariance = corrected_by_state(state, covariance, other.state, errors)
    return Track(first.stamp, state, covariance)


def determinant_of(covariance: Upper) -> float:
    """Return the determinant of a covariance, 0 if it is singular up to rounding errors."""
    return prod(variance for _, _, variance in decorrelated((0.0,) * 4, full_rows(covariance)))


def _scaled(matrix: Upper, factor: float) -> Upper:
    return cast("Upper", tuple(factor * entry for entry in matrix))
