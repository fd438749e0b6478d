"""Obstacles: the walls that block motion, and the straight lines that they leave free.

A line may touch a corner and slide along a wall, but never cross one. All tests have the tolerance of
`desim.pursuit.paths.corners.TOUCH`.
"""

from collections.abc import Sequence
from math import atan2, cos, inf, sin

import numpy as np

from desim.config.arrays import Bools, Floats, Points
from desim.kernel.walls.crossings import WallShape, segments_of
from desim.pursuit.core.geometry import SMALLEST
from desim.pursuit.core.state import lengths
from desim.pursuit.paths.corners import BOTH, Arrangement, Side, mirrored

SLIDES = 3
"""Number of walls along which a player slides in one motion step before it stops."""


class Rings:
    """The edges of all polygons, wall by wall, to find the places inside walls.

    Args:
        walls: the lines and polygons of each wall.
    """

    def __init__(self, walls: Sequence[Sequence[WallShape]]):
        rings = [segments_of((0, shape) for shape in wall if shape.closed) for wall in walls]
        rings = [edges for edges in rings if edges]
        self._first = np.cumsum([0, *(len(edges.owners) for edges in rings)])[:-1]
        """The first edge of each wall."""
        starts = np.vstack([np.zeros((0, 2)), *(edges.starts for edges in rings)])
        ends = np.vstack([np.zeros((0, 2)), *(edges.ends for edges in rings)])
        (self._x, self._y), (end_x, self._end_y) = starts.T, ends.T
        rise = self._end_y - self._y
        self._slope = (end_x - self._x) / np.where(rise == 0.0, 1.0, rise)

    def cover(self, x: Floats, y: Floats) -> Bools:
        """Return which of k places (x, y), each (k, 1) m, are inside the polygons of a wall and in none of its holes.

        A ray from such a place along x crosses an odd number of edges of the wall. On an outline, either result is
        possible.
        """
        if not len(self._first):
            return np.zeros(len(x), dtype=bool)
        is_crossed = ((self._y > y) != (self._end_y > y)) & (x < self._x + (y - self._y) * self._slope)
        odd = np.add.reduceat(is_crossed.view(np.int8), self._first, axis=1) % 2
        return np.asarray(odd.any(axis=1))


class Obstacles:
    """The walls that block motion.

    Args:
        walls: the lines and polygons of each wall; a polygon inside another one of the same wall is a hole in it.

    Attributes:
        clearance: the distance, m, that players keep from walls.
        bends: (C,) the corners at which a shortest path can bend, m.
    """

    def __init__(self, walls: Sequence[Sequence[WallShape]]):
        self._plan = Arrangement(walls)
        self._touch, self.clearance = self._plan.touch, self._plan.clearance
        self._places = self._plan.places
        self._begin, self._end = np.array(sorted(self._plan.pieces), dtype=np.intp).reshape(-1, 2).T
        begin, end = self._places[self._begin], self._places[self._end]
        self._x, self._y, self._size = begin.real, begin.imag, lengths(end - begin)
        self._along_x, self._along_y = (end - begin).real / self._size, (end - begin).imag / self._size
        solid = [self._plan.pieces[begin, end] for begin, end in sorted(self._plan.pieces)]
        self._solid = np.array([[side in sides for sides in solid] for side in ("right", "left")], dtype=bool)
        """(2, E) whether the inside of a wall is to the right, and to the left, of each piece."""
        self._rings = Rings(walls)
        bends = [k for k, corner in enumerate(self._plan.corners) if corner.bend is not None]
        self._bend_corners = np.array(bends, dtype=np.intp)
        self.bends: Points = self._places[self._bend_corners]
        blocked = [self._plan.corners[k].bend or () for k in bends]
        self._sector_begin, self._sector_end = (
            np.array([self._direction(k, rays[side].end) for k, rays in zip(bends, blocked, strict=True)], complex)
            for side in (0, 1)
        )
        """(C,) directions of length 1 where the blocked sector of each corner begins and ends, counter-clockwise."""
        outward = [self._plan.corners[k].outward() or 0.0 for k in bends]
        self.turns: Points = self.bends + self.clearance * np.array([complex(cos(a), sin(a)) for a in outward])
        """(C,) the place beside each corner, m, at which a player turns to go around the corner."""
        self._sides_of_bends = self._sides(self.bends)

    def _direction(self, begin: int, end: int) -> complex:
        """Return the direction, of length 1, from one corner to another."""
        along = complex(self._places[end] - self._places[begin])
        return along / abs(along)

    def are_free(self, places: Points) -> Bools:
        """Return which of (k,) places, m, a player may have: not inside a wall, and not closer than the clearance."""
        x, y = places.real[:, None], places.imag[:, None]
        along = (x - self._x) * self._along_x + (y - self._y) * self._along_y
        nearest = np.minimum(np.maximum(along, 0.0), self._size)  # the nearest point of each piece, m from its begin
        gaps = np.hypot(x - self._x - nearest * self._along_x, y - self._y - nearest * self._along_y)
        free = np.asarray((gaps >= self.clearance).all(axis=1))
        free &= ~self._rings.cover(x, y)
        return free

    def clear(self, source: complex, targets: Points) -> Bools:
        """Return to which of (k,) targets (m) the straight line from a source (m) is free, (k,)."""
        return self._clear(source, targets, self._sides(targets), None)

    def bends_in_sight(self, source: complex) -> tuple[np.ndarray, Floats]:
        """Return the corners to which the straight line from a source (m) is free, and their distances, m.

        Only corners at which a shortest path from the source can bend count: ((c,) indices of `bends`, (c,) distances).
        """
        x, y = source.real - self.bends.real, source.imag - self.bends.imag  # from the corner to the source
        # Both are positive in the blocked sector, and negative in the sector opposite to it.
        after = self._sector_begin.real * y - self._sector_begin.imag * x
        before = x * self._sector_end.imag - y * self._sector_end.real
        touch = self._touch
        is_outside = (after <= touch) | (before <= touch)
        # A path from the opposite sector that bends here turns away from the wall, so a shorter one does not touch it.
        is_taut = (after >= -touch) | (before >= -touch)
        bends = (is_outside & is_taut).nonzero()[0]
        if not len(bends):
            return bends, np.zeros(0)
        clear = self._clear(source, self.bends[bends], self._sides_of_bends[bends], self._bend_corners[bends])
        bends = bends[clear]
        return bends, np.hypot(x[bends], y[bends])

    def slide(self, place: complex, way: complex) -> complex:
        """Return the displacement, m, of a player that intends the displacement `way` (m) and slides along walls.

        At each wall the player loses the part across the wall. It stands still if a wall is ahead after `SLIDES` walls.
        """
        longest = abs(way)
        for _ in range(SLIDES):
            wall = self._wall_ahead(place, way)
            if wall is None:
                # The clearance that was added at walls may have made the way longer.
                return way if abs(way) <= longest else way * (longest / abs(way))
            along = complex(self._along_x[wall], self._along_y[wall])
            across = along * 1j
            offset = place - complex(self._x[wall], self._y[wall])
            distance, change = _dot(offset, across), _dot(way, across)
            on_wall, is_left = abs(distance) < self.clearance, distance >= 0.0
            if on_wall and self._solid[int(is_left), wall]:  # on the line of an edge, it goes around outside
                is_left = not is_left
            if not is_left:
                across, distance, change = -across, -distance, -change
            # It ends at twice the clearance from the wall: at once the clearance, rounding could put it too close.
            way += across * (2.0 * self.clearance - distance - change)
        return 0j if self._wall_ahead(place, way) is not None else way

    def free_place(self, place: complex) -> complex:
        """Return a place itself if a player may have it, else a close one that it may have, m."""
        if self.are_free(np.array([place]))[0]:
            return place
        x, y = place.real - self._x, place.imag - self._y
        along = np.clip(x * self._along_x + y * self._along_y, 0.0, self._size)
        nearest = self._x + along * self._along_x + 1j * (self._y + along * self._along_y)  # point of each piece
        across = 2.0 * self.clearance * (self._along_y - 1j * self._along_x)
        candidates = np.concatenate([nearest + across, nearest - across, self.turns])
        candidates = candidates[self.are_free(candidates)]
        return complex(candidates[lengths(candidates - place).argmin()]) if len(candidates) else place

    def _wall_ahead(self, place: complex, way: complex) -> int | None:
        """Return the first piece of a wall to which a way from a place does not keep the clearance, or None."""
        x, y = place.real - self._x, place.imag - self._y
        distance = self._along_x * y - self._along_y * x
        change = self._along_x * way.imag - self._along_y * way.real
        change = np.where(distance < 0.0, -change, change)
        gap = np.maximum(abs(distance) - self.clearance, 0.0)
        meets = gap + change < -self._touch
        along, advance = self._along_x * x + self._along_y * y, self._along_x * way.real + self._along_y * way.imag
        # A player that moves on the line of a wall approaches neither of its sides, but must not enter it by its end.
        low, high = -self.clearance, self._size + self.clearance
        ahead = np.where(along < low, low - along, np.where(along > high, along - high, -inf))
        head_on = (gap == 0.0) & (abs(change) < self.clearance) & (ahead >= 0.0) & (advance * (low - along) > 0.0)
        share = np.where(meets, gap / np.where(meets, -change, 1.0), 2.0)  # of the way; 2: it does not meet the piece
        share = np.where(head_on, ahead / np.maximum(abs(advance), SMALLEST), share)
        met_at = along + share * advance  # m from the begin of the piece
        share[~head_on & ((met_at < low) | (met_at > high))] = 2.0
        first = int(share.argmin())
        return first if share[first] <= 1.0 else None

    def _sides(self, places: Points) -> np.ndarray:
        """Return on which side of each piece (k,) places are, (k, E): 1 left, -1 right, 0 on its line."""
        x, y = places.real[:, None] - self._x, places.imag[:, None] - self._y
        return _signs(self._along_x * y - self._along_y * x, self._touch)

    def _clear(self, source: complex, targets: Points, sides: np.ndarray, corners: np.ndarray | None) -> Bools:
        """Return to which of (k,) targets the straight line from a source is free.

        Args:
            source: the source, m.
            targets: (k,) the targets, m.
            sides: (k, E) see `_sides`.
            corners: (k,) the corners that are the targets; None: the targets are any places.
        """
        x, y = targets.real - source.real, targets.imag - source.imag
        corner_x, corner_y = self._places.real - source.real, self._places.imag - source.imag
        length = np.hypot(x, y)
        across = x[:, None] * corner_y - y[:, None] * corner_x  # distance from the line, times its length
        corner_sides = _signs(across, self._touch * length[:, None])  # (k, V) the sides of each line, as in `_sides`
        source_sides = self._sides(np.array([source]))[0]
        # A piece is crossed if its line parts the source and the target, and their line parts the ends of the piece.
        crossed = (source_sides * sides < 0) & (corner_sides[:, self._begin] * corner_sides[:, self._end] < 0)
        clear: Bools = ~crossed.any(axis=1)
        if not source_sides.all():
            clear &= ~self._comes_from_inside(np.array([source]), source_sides, sides)
        touched = (corner_sides == 0) & (length > self._touch)[:, None]
        if corners is not None:
            touched[np.arange(len(corners)), corners] = False
        elif not sides.all():
            clear &= ~self._comes_from_inside(targets, sides, source_sides)
        if touched.any():
            along = x[:, None] * corner_x + y[:, None] * corner_y
            reach = self._touch * length[:, None]
            touched &= (along >= -reach) & (along <= (length**2)[:, None] + reach)
            for k in (touched.any(axis=1) & clear).nonzero()[0].tolist():
                passed = touched[k].nonzero()[0]
                order = passed[along[k, passed].argsort(kind="stable")].tolist()
                end = None if corners is None else int(corners[k])
                clear[k] = self._passes(source, complex(targets[k]), order, end)
        return clear

    def _comes_from_inside(self, end: Points, sides_of_end: np.ndarray, sides_of_other: np.ndarray) -> Bools:
        """Return which lines have an end on an outline, and come to it through the inside of the wall, (k,).

        Args:
            end: the place of this end, (1,) or (k,) m.
            sides_of_end: its sides, (E,) or (k, E), see `_sides`.
            sides_of_other: those of the other end.
        """
        on = (sides_of_end == 0) & self._beside(end)
        inside = (sides_of_other > 0) & self._solid[1] | (sides_of_other < 0) & self._solid[0]
        return np.asarray((on & inside).any(axis=1))

    def _beside(self, places: Points) -> Bools:
        """Return between the ends of which pieces (k,) places are, (k, E)."""
        x, y = places.real[:, None] - self._x, places.imag[:, None] - self._y
        along = x * self._along_x + y * self._along_y
        return np.asarray((along > self._touch) & (along < self._size - self._touch))

    def _passes(self, source: complex, target: complex, passed: list[int], end: int | None) -> bool:
        """Return whether a line that touches corners, and crosses no wall elsewhere, is free.

        Args:
            source: its start, m.
            target: its end, m.
            passed: the corners that it touches, in order; those at its start and at its end may be among them.
            end: the corner at its end.
        """
        way = target - source
        direction = atan2(way.imag, way.real)
        corners, previous, sides = self._plan.corners, None, BOTH
        for corner in passed if end is None else [*passed, end]:
            place = complex(self._places[corner])
            along: frozenset[Side] | None = None
            if previous is not None:
                along = self._plan.sides_of_piece(previous, corner)
            # Along a piece, the line stays on one side of the walls; where it leaves them, it may go to the other side.
            sides = BOTH if along is None else sides & along
            if abs(place - source) <= self._touch:
                sides &= corners[corner].sides_along(direction)
            elif abs(place - target) <= self._touch:
                sides &= mirrored(corners[corner].sides_along(direction + np.pi))
            else:
                sides &= corners[corner].sides_past(direction)
            if not sides:
                return False
            previous = corner
        return True


def _signs(values: Floats, touch: float | Floats) -> np.ndarray:
    """Return the sign of each number, as small integers; 0 if its magnitude is at most a tolerance."""
    return (values > touch).view(np.int8) - (values < -touch).view(np.int8)


def _dot(a: complex, b: complex) -> float:
    return a.real * b.real + a.imag * b.imag
