"""Which straight lines cross walls: the geometry that radio, sight and motion share.

Rays and walls are segments of the plane. A point that lies exactly on the line of a segment counts as left of it. So a
ray through the common corner of two walls, one on each side, crosses exactly one of them, and no ray slips through
where walls meet. A ray that only grazes a corner crosses both walls there, or none. Rays are ordered by their ends, so
that a ray and its reverse cross the same walls.

Players may touch walls. With a `margin`, a ray crosses a wall only if both ends of the ray are farther than this
distance from the line of the wall, on different sides, and both ends of the wall likewise from the line of the ray.
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from desim.config.arrays import Bools, Floats, Integers


class WallShape(NamedTuple):
    """One line or polygon of a wall."""

    corners: Floats
    """(k, 2) m; a polygon does not repeat its first corner."""
    closed: bool
    """Whether it is a polygon, which is solid."""


class Segments(NamedTuple):
    """The s edges of several shapes."""

    corners: Floats
    """(c, 2) the corners of all shapes, one shape after the other, m; each polygon ends with its first corner. The
    columns are contiguous."""
    firsts: Integers
    """(s,) for each edge, the index of the corner at which it starts; it ends at the next one."""
    owners: Integers
    """(s,) for each edge, the index of its owner."""

    @classmethod
    def of(cls, starts: Floats, ends: Floats) -> "Segments":
        """Return s separate edges, each of which is its own owner, from their (s, 2) ends."""
        edges = np.arange(len(starts))
        return cls(np.stack([starts, ends], axis=1).reshape(-1, 2), 2 * edges, edges)

    @property
    def starts(self) -> Floats:
        """The (s, 2) starts of the edges, m."""
        return self.corners[self.firsts]

    @property
    def ends(self) -> Floats:
        """The (s, 2) ends of the edges, m."""
        return self.corners[self.firsts + 1]

    def __bool__(self) -> bool:
        """Return whether there are any."""
        return len(self.owners) > 0


def segments_of(shapes: Iterable[tuple[int, WallShape]]) -> Segments:
    """Return the edges of some shapes, each with the index of its owner."""
    corners, count = [np.empty((0, 2))], 0
    firsts: list[int] = []
    owners: list[int] = []
    for owner, shape in shapes:
        corners += [shape.corners, shape.corners[:1]] if shape.closed else [shape.corners]
        edges = len(shape.corners) - (not shape.closed)
        firsts += range(count, count + edges)
        owners += [owner] * edges
        count += edges + 1
    return Segments(
        np.asfortranarray(np.vstack(corners)), np.array(firsts, dtype=np.intp), np.array(owners, dtype=np.intp)
    )


def crossings(starts: Floats, ends: Floats, segments: Segments, margin: float = 0.0) -> Bools:
    """Return which of m rays cross which of s walls, (m, s).

    Args:
        starts: (m, 2) or (1, 2) one end of each ray, m.
        ends: (m, 2) or (1, 2) the other ends, m.
        segments: the walls.
        margin: 0 for rays of radio and sight; for paths that may touch walls, the distance, m, up to which a path only
            touches a wall.
    """
    if not margin:
        return crossed_by(starts, ends, segments.corners)[segments.firsts].T
    wall_start, wall_end, ray_start, ray_end = _sides(starts, ends, segments)
    rays, walls = ends - starts, segments.ends - segments.starts
    # Each side is a distance times the length of a segment, so the margin is multiplied by this length, too.
    of_ray = margin * np.hypot(rays[:, 0], rays[:, 1])[:, np.newaxis]
    of_wall = margin * np.hypot(walls[:, 0], walls[:, 1])
    return _apart(wall_start, wall_end, of_ray) & _apart(ray_start, ray_end, of_wall)


def crossed_by(starts: Floats, ends: Floats, corners: Floats) -> Bools:
    """Return which lines from each of c corners to the next are crossed by which of m rays, (c - 1, m).

    The rays are as in `crossings`, without a margin. Each side is computed once for each corner, not for each edge, so
    that edges agree on which side of a ray their common corner is. The formulas are antisymmetric to the last bit in
    the ends of the ray.
    """
    (start_x, start_y), (end_x, end_y), (x, y) = starts.T, ends.T, corners.T[..., np.newaxis]
    from_start_x, from_start_y, from_end_x, from_end_y = x - start_x, y - start_y, x - end_x, y - end_y
    side = from_start_x * from_end_y
    side -= from_start_y * from_end_x
    is_left = side > 0.0
    if not side.all():  # a corner on a ray counts as left of it, seen from the end with the smaller coordinates
        is_reversed = (start_x > end_x) | ((start_x == end_x) & (start_y > end_y))
        is_left |= (side == 0.0) & ~is_reversed
    is_start_left = from_start_x[:-1] * from_start_y[1:] >= from_start_y[:-1] * from_start_x[1:]
    is_end_left = from_end_x[:-1] * from_end_y[1:] >= from_end_y[:-1] * from_end_x[1:]
    crossed: Bools = is_left[:-1] != is_left[1:]
    crossed &= is_start_left != is_end_left
    return crossed


def _sides(starts: Floats, ends: Floats, segments: Segments) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the sides of each ray on which start and end of each wall lie, and the reverse, (m, s) each.

    Each number is the distance of an end from a line times the length of the segment on the line, m^2; left of the line
    it is positive.
    """
    (ax, ay), (bx, by) = segments.starts.T, segments.ends.T
    x, y = starts[:, 0, np.newaxis], starts[:, 1, np.newaxis]
    u, v = ends[:, 0, np.newaxis], ends[:, 1, np.newaxis]
    wall_start, wall_end = _cross(ax - x, ay - y, ax - u, ay - v), _cross(bx - x, by - y, bx - u, by - v)
    return wall_start, wall_end, _cross(ax - x, ay - y, bx - x, by - y), _cross(ax - u, ay - v, bx - u, by - v)


def _cross(x: Floats, y: Floats, u: Floats, v: Floats) -> Floats:
    return x * v - y * u


def _apart(first: Floats, second: Floats, least: Floats) -> Bools:
    """Return where two numbers have different signs, and the absolute values of both are larger than a bound."""
    apart: Bools = (np.signbit(first) != np.signbit(second)) & (np.minimum(abs(first), abs(second)) > least)
    return apart


def are_inside(points: Floats, shapes: Sequence[WallShape]) -> Bools:
    """Return which of (m, 2) points, m, are inside the polygons of one wall, (m,): those in a hole are not.

    The rings of the wall must not cross each other. A point on the boundary may count as inside or not.
    """
    segments = segments_of((0, shape) for shape in shapes if shape.closed)
    (ax, ay), (bx, by) = segments.starts.T, segments.ends.T
    x, y = points[:, 0, np.newaxis], points[:, 1, np.newaxis]
    # A point is inside if the ray from it to the right crosses an odd number of edges.
    spans_height = (ay > y) != (by > y)
    with np.errstate(invalid="ignore", divide="ignore"):
        is_right = x < ax + (y - ay) * (bx - ax) / (by - ay)
    is_odd: Bools = np.count_nonzero(spans_height & is_right, axis=1) % 2 == 1
    return is_odd


def gaps(points: Floats, segments: Segments) -> Floats:
    """Return the distances of (m, 2) points from the nearest of the walls, (m,) m; inf if there are none."""
    if not segments:
        return np.full(len(points), np.inf)
    walls = segments.ends - segments.starts
    offsets = points[:, np.newaxis] - segments.starts
    lengths = np.add.reduce(walls * walls, axis=1)
    shares = np.clip(np.add.reduce(offsets * walls, axis=2) / lengths, 0.0, 1.0)
    away = offsets - shares[..., np.newaxis] * walls
    nearest: Floats = np.hypot(away[..., 0], away[..., 1]).min(axis=1)
    return nearest


class Contact(NamedTuple):
    """Two edges of polygons that touch."""

    first: int
    """The index of the polygon of one edge."""
    second: int
    """The index of the polygon of the other edge."""
    ends: list[list[float]]
    """The start and the end of one edge, and those of the other, [x, y] m."""


ROWS = 256
"""Number of edges that are compared with all others at once."""


def first_contact(shapes: Iterable[tuple[int, WallShape]]) -> Contact | None:
    """Return two edges of polygons, each with an index, that touch or cross; None if there are none.

    Edges that follow each other in a polygon touch only if the second goes back on the first.
    """
    edges = segments_of(shapes)
    starts, ends, owners = edges.starts, edges.ends, edges.owners
    follows = np.zeros(len(owners), dtype=np.intp)  # the index of the edge after each edge
    for owner in np.unique(owners):
        ring = np.flatnonzero(owners == owner)
        follows[ring] = np.roll(ring, -1)
    for begin in range(0, len(owners), ROWS):
        rows = slice(begin, begin + ROWS)
        touched = _touching(Segments.of(starts[rows], ends[rows]), edges)
        # Each pair counts once, and edges that follow each other do not: they have a common corner.
        first, second = np.arange(begin, begin + len(touched))[:, np.newaxis], np.arange(len(owners))
        touched &= (follows[rows, np.newaxis] != second) & (follows != first) & (first < second)
        pairs = np.argwhere(touched)
        if len(pairs):
            return _contact(edges, begin + int(pairs[0, 0]), int(pairs[0, 1]))
    edge, following = ends - starts, (ends - starts)[follows]
    is_parallel = edge[:, 0] * following[:, 1] == edge[:, 1] * following[:, 0]
    goes_back = np.flatnonzero(is_parallel & (np.add.reduce(edge * following, axis=1) < 0.0))
    return _contact(edges, int(goes_back[0]), int(follows[goes_back[0]])) if len(goes_back) else None


def _contact(edges: Segments, first: int, second: int) -> Contact:
    ends = [end[k].tolist() for k in (first, second) for end in (edges.starts, edges.ends)]
    return Contact(int(edges.owners[first]), int(edges.owners[second]), ends)


def _touching(first: Segments, second: Segments) -> Bools:
    """Return which of k edges touch or cross which of s others, (k, s)."""
    second_start, second_end, first_start, first_end = _sides(first.starts, first.ends, second)
    separated = (second_start * second_end > 0.0) | (first_start * first_end > 0.0)
    low, high = np.minimum(first.starts, first.ends), np.maximum(first.starts, first.ends)
    lower, upper = np.minimum(second.starts, second.ends), np.maximum(second.starts, second.ends)
    # The boxes decide where both edges are on one line.
    near = ((low[:, np.newaxis] <= upper) & (lower <= high[:, np.newaxis])).all(axis=2)
    return near & ~separated


def repeated_corner(corners: Sequence[tuple[float, float]], *, closed: bool) -> int | None:
    """Return the index of a corner that equals the one before it; None if there is none."""
    ring = [*corners, corners[0]] if closed else corners
    return next((k for k, (before, after) in enumerate(pairwise(ring), 1) if before == after), None)
