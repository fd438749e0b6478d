"""The corners of walls: which directions are free around each, and where a shortest path can bend.

Walls that touch or cross each other are one arrangement: corners that coincide are one corner, and a wall is divided
where the corner of another lies on it. So two rooms may share a wall, and a wall may end on another.
"""

from collections.abc import Sequence
from itertools import pairwise
from math import atan2, pi
from typing import Literal, NamedTuple

import numpy as np

from desim.config.arrays import Bools, Floats, Points
from desim.kernel.walls.crossings import WallShape, are_inside
from desim.pursuit.core.state import complex_points, coordinates, lengths

TOUCH = 1e-12
"""Distance, as a share of the extent of all walls, up to which a line touches a wall and does not cross it."""
CLEARANCE = 1e-10
"""Distance that players keep from walls, as a share of the extent of all walls: each player is on one side of a wall
without doubt. A narrower gap between two walls is closed."""
ALIGNED = 1e-9
"""Angle, rad, up to which two directions are one."""
FULL_TURN = 2.0 * pi

Side = Literal["left", "right"]
BOTH: frozenset[Side] = frozenset(("left", "right"))


class Ray(NamedTuple):
    """The beginning of a wall at a corner, as seen from this corner."""

    angle: float
    """Direction, rad."""
    end: int
    """The corner at its other end."""
    solid: frozenset[Side]
    """The sides, looking along it, on which there is the inside of an obstacle."""


class WallCorner:
    """The directions around one corner.

    Args:
        rays: the walls that begin here.
        inside: whether it is inside another obstacle.

    Attributes:
        bend: the two rays around which a shortest path can bend here. The directions strictly between the first and the
            second, counter-clockwise and less than half a turn, are not free. None if no shortest path bends here.
    """

    def __init__(self, rays: list[Ray], *, inside: bool):
        self.rays = sorted(rays)
        count = len(self.rays)
        self._is_free = [
            not (inside or "left" in ray.solid or "right" in self.rays[(k + 1) % count].solid)
            for k, ray in enumerate(self.rays)
        ]
        """Whether each sector is free: sector k is between ray k and the next one, counter-clockwise."""
        wide = [k for k in range(count) if self._is_free[k] and self._width(k) > pi + ALIGNED]
        self.bend: tuple[Ray, Ray] | None = None
        if wide:  # there is at most one sector of more than half a turn
            self.bend = self.rays[(wide[0] + 1) % count], self.rays[wide[0]]
        self._stands_in = wide or [k for k in range(count) if self._is_free[k]]
        """The free sectors in which a player that stands here may be: only the wide one, if there is one."""

    def sides_along(self, direction: float) -> frozenset[Side]:
        """Return the sides on which a player that stands here can leave in a direction (rad); none if it cannot."""
        count = len(self.rays)
        sides: set[Side] = set()
        for k in self._stands_in:
            turn = (direction - self.rays[k].angle + ALIGNED) % FULL_TURN - ALIGNED
            # Within a sector, both sides are free; along its first wall, the left side; along its last, the right side.
            if turn <= self._width(k) + ALIGNED:
                sides |= BOTH if ALIGNED < turn < self._width(k) - ALIGNED else set()
                sides |= {"left"} if turn <= ALIGNED else set()
                sides |= {"right"} if turn >= self._width(k) - ALIGNED else set()
            if count == 1 and turn <= ALIGNED:  # from the end of a single wall along it
                return BOTH
        return frozenset(sides)

    def sides_past(self, direction: float) -> frozenset[Side]:
        """Return the sides on which a straight line in a direction (rad) can pass here."""
        turns = [_wrapped(ray.angle - direction) for ray in self.rays]
        sides: set[Side] = set()
        # The line can pass on a side without walls if the sector there is free. The left sector begins at the last ray
        # before the line, counter-clockwise, and the right sector ends at the first ray after it.
        if not any(ALIGNED < turn < pi - ALIGNED for turn in turns):
            turns_before = [turn - FULL_TURN if turn > ALIGNED else turn for turn in turns]
            sides |= {"left"} if self._is_free[turns_before.index(max(turns_before))] else set()
        if not any(-pi + ALIGNED < turn < -ALIGNED for turn in turns):
            turns_after = [turn + FULL_TURN if turn < -ALIGNED else turn for turn in turns]
            sides |= {"right"} if self._is_free[turns_after.index(min(turns_after)) - 1] else set()
        return frozenset(sides)

    def outward(self) -> float | None:
        """Return the direction (rad) in the middle of the sector in which a player stands; None if none is free."""
        if not self._stands_in:
            return None
        widest = max(self._stands_in, key=self._width)
        return self.rays[widest].angle + self._width(widest) / 2.0

    def _width(self, sector: int) -> float:
        """Return the angle of a sector, rad: a full turn at the end of a single wall."""
        next_angle = self.rays[(sector + 1) % len(self.rays)].angle
        return FULL_TURN - (self.rays[sector].angle - next_angle) % FULL_TURN


class Arrangement:
    """The corners and the straight pieces of all walls.

    Args:
        walls: the lines and polygons of each wall; a polygon inside another one of the same wall is a hole in it.

    Attributes:
        touch: up to this distance, m, a line touches a wall.
        clearance: the distance, m, that players keep from walls.
        places: (V,) the distinct corners, m.
        pieces: the straight pieces between two corners, with the sides of each on which there is the inside of a wall.
        corners: (V,) the directions around each corner.
    """

    def __init__(self, walls: Sequence[Sequence[WallShape]]):
        extent = max((float(abs(shape.corners).max()) for wall in walls for shape in wall), default=1.0)
        self.touch, self.clearance = TOUCH * max(extent, 1.0), CLEARANCE * max(extent, 1.0)
        self.places: Points = np.zeros(0, dtype=complex)
        chains = [[self._numbers(shape) for shape in wall] for wall in walls]
        self.pieces: dict[tuple[int, int], frozenset[Side]] = {}
        enclosed = np.zeros(len(self.places), dtype=bool)
        for wall, numbers in zip(walls, chains, strict=True):
            outlines: set[int] = set()
            for shape, chain in zip(wall, numbers, strict=True):
                divided = self._divided(chain)
                self._add_pieces(divided, solid_side(shape, wall) if shape.closed else None)
                if shape.closed:
                    outlines |= set(divided)
            within = is_within(coordinates(self.places), wall)
            within[list(outlines)] = False
            enclosed |= within
        rays: list[list[Ray]] = [[] for _ in self.places]
        for (begin, end), solid in self.pieces.items():
            along = complex(self.places[end] - self.places[begin])
            rays[begin].append(Ray(atan2(along.imag, along.real), end, solid))
            rays[end].append(Ray(atan2(-along.imag, -along.real), begin, mirrored(solid)))
        self.corners = [
            WallCorner(corner_rays, inside=inside) for corner_rays, inside in zip(rays, enclosed.tolist(), strict=True)
        ]

    def sides_of_piece(self, begin: int, end: int) -> frozenset[Side] | None:
        """Return the sides on which one can go along a piece from one corner to another; None if there is no piece."""
        solid = self.pieces.get((begin, end))
        if solid is None and (solid := self.pieces.get((end, begin))) is not None:
            solid = mirrored(solid)
        return None if solid is None else BOTH - solid

    def _numbers(self, shape: WallShape) -> list[int]:
        """Return the numbers of the corners of a shape, in order and closed; corners that coincide have one number."""
        numbers: list[int] = []
        for place in complex_points(shape.corners).tolist():
            near = np.flatnonzero(lengths(self.places - place) <= self.clearance)
            if not len(near):
                self.places = np.append(self.places, place)
            number = int(near[0]) if len(near) else len(self.places) - 1
            if not numbers or numbers[-1] != number:
                numbers.append(number)
        if shape.closed and numbers[-1] != numbers[0]:
            numbers.append(numbers[0])
        return numbers

    def _divided(self, chain: list[int]) -> list[int]:
        """Return a chain of corners after inserting the corners of other walls that lie on it."""
        divided = chain[:1]
        for begin, end in pairwise(chain):
            along = complex(self.places[end] - self.places[begin])
            length = abs(along)
            relative = (self.places - self.places[begin]) * (along.conjugate() / length)
            on = (abs(relative.imag) <= self.clearance) & (relative.real > 0.0) & (relative.real < length)
            on[[begin, end]] = False
            divided += [*sorted(np.flatnonzero(on).tolist(), key=relative.real.item), end]
        return divided

    def _add_pieces(self, chain: list[int], inside: Side | None) -> None:
        """Add the pieces of a shape; where walls coincide, a side is solid if it is so in one of them."""
        for begin, end in pairwise(chain):
            solid: frozenset[Side] = frozenset(() if inside is None else (inside,))
            key = (begin, end) if begin < end else (end, begin)
            self.pieces[key] = self.pieces.get(key, frozenset()) | (solid if begin < end else mirrored(solid))


def is_within(places: Floats, wall: Sequence[WallShape]) -> Bools:
    """Return which of (k, 2) places, m, are inside the polygons of a wall, (k,); on an outline, either is possible."""
    return are_inside(places, wall) if any(shape.closed for shape in wall) else np.zeros(len(places), dtype=bool)


def mirrored(sides: frozenset[Side]) -> frozenset[Side]:
    """Return the sides of a piece as seen from its other end."""
    return frozenset({"left": "right", "right": "left"}[side] for side in sides)  # type: ignore[misc]


def solid_side(shape: WallShape, wall: Sequence[WallShape]) -> Side:
    """Return the side of a polygon, in the order of its corners, on which its wall is solid; of a hole, the outside."""
    x, y = shape.corners.T
    area = float(np.add.reduce(x * np.roll(y, -1) - y * np.roll(x, -1)))
    others = [other for other in wall if other is not shape]
    is_hole = bool(is_within(shape.corners[:1], others)[0])
    return "left" if (area > 0.0) != is_hole else "right"


def _wrapped(angle: float) -> float:
    """Return an angle in [-pi, pi)."""
    return (angle + pi) % FULL_TURN - pi
