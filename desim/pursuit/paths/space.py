"""The space in which the players move: the plane, or the plane among walls.

Other modules ask the space for distances, directions and captures, and need not know of walls. Among walls, the
distance of two players is the length of the shortest path between them.
"""

from cmath import rect
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from math import ceil, floor, inf, pi
from typing import ClassVar

import numpy as np

from desim.config.arrays import Bools, Floats, Points
from desim.kernel.core.units import SECOND, seconds
from desim.kernel.walls.crossings import crossings
from desim.kernel.walls.wall import Wall, blocking
from desim.pursuit.core.geometry import SMALLEST, first_contact, moved_towards
from desim.pursuit.core.state import complex_points, coordinates, lengths
from desim.pursuit.paths.obstacles import Obstacles
from desim.pursuit.paths.shortest_paths import ShortestPaths

MAX_FREE_PLACES = 16
"""Maximum number of free places in the cache; few suffice, as pursuers ask about the same estimates at one instant."""
MAX_STEPS = 1_000
"""Maximum number of steps towards a contact around a corner."""
FEW_STEPS = 40
"""Number of these steps after which bisection finds the contact, if the players are in contact at the end."""
ROUNDING = 1e-12
"""Gap that counts as a contact, in m and as a share of the distance."""


class Plane:
    """The plane, in which no wall blocks motion.

    Args:
        sight: walls that block sight.
        starts: the walls on and inside which no player starts at random; empty: the walls that block motion.

    Attributes:
        blocks_sight: whether some walls block sight.
    """

    is_open: ClassVar[bool] = True
    """Whether no wall blocks motion."""

    def __init__(self, sight: Sequence[Wall] = (), starts: Sequence[Wall] = ()):
        self._sight = blocking(sight, "sight")
        self.blocks_sight = bool(self._sight)
        self._starts = Obstacles([wall.shapes for wall in starts]) if starts else None
        self._hiding_places: dict[float, Points] = {}

    @property
    def walled(self) -> "Walled | None":
        """The space itself if walls block motion, else None."""
        return None

    def visible(self, places: Points, watcher: complex) -> Bools:
        """Return the (k,) mask of the places that a watcher sees, or that see the watcher: no wall is between them."""
        hidden = crossings(coordinates(np.array([watcher])), coordinates(places), self._sight).any(axis=1)
        return np.asarray(~hidden)

    def distance(self, source: complex, target: complex) -> float:
        """Return the distance of two places, m; inf if there is no path between them."""
        return abs(target - source)

    def distances(self, sources: Points, target: complex) -> Floats:
        """Return the distances of (k,) places from a target, (k,) m."""
        return lengths(target - sources)

    def along(self, source: complex, target: complex, length: float) -> complex:
        """Return the place, m, after a length (m) of the path from a source to a target; the target if it is closer."""
        return moved_towards(source, target, length)

    def are_free(self, places: Points) -> Bools:
        """Return which of (k,) places a player may have, (k,)."""
        return np.ones(len(places), dtype=bool)

    def may_start(self, places: Points) -> Bools:
        """Return at which of (k,) places a player may start, (k,)."""
        return self.are_free(places) if self._starts is None else self._starts.are_free(places)

    def free_place(self, place: complex) -> complex:
        """Return a place itself if a player may have it, else a close one that it may have, m."""
        return place

    def arrivals(self, target: complex, sources: Points) -> Points:
        """Return (k,) vectors, m, as long as the paths from sources to a target, in the directions of arrival."""
        return target - sources

    def first_blocked(self, waypoints: Sequence[complex]) -> int | None:
        """Return the first waypoint that cannot be reached on a straight line from the one before it, or None."""
        return None

    def leg(self, here: complex, aim: complex, speed: float) -> tuple[complex, bool]:
        """Return the first straight piece of the shortest path, m, and whether it ends at the aim.

        Args:
            here: the position of a player, m.
            aim: the end of the path, m.
            speed: the speed of the player, m/s.
        """
        return aim - here, True

    def slide(self, place: complex, way: complex) -> complex:
        """Return the displacement, m, of a player that intends the displacement `way` (m) and slides along walls."""
        return way

    def hidden(self, places: Points, watchers: Points) -> Bools:
        """Return which of (k,) places none of (n,) watchers sees, because walls block their sight, (k,)."""
        unseen = np.ones(len(places), dtype=bool)
        for watcher in watchers.tolist():
            unseen &= ~self.visible(places, watcher)
        return unseen

    def hiding_places(self, distance: float) -> Points:
        """Return the places that a player may have at a distance (m) from the corners of walls that block sight."""
        if distance not in self._hiding_places:
            corners = np.unique(complex_points(np.vstack([self._sight.starts, self._sight.ends])))
            around = distance * np.array([rect(1.0, k * pi / 4.0) for k in range(8)])
            places = (corners[:, np.newaxis] + around).ravel()
            self._hiding_places[distance] = places[self.are_free(places)]
        return self._hiding_places[distance]


class Walled(Plane):
    """The plane among walls that block motion.

    Args:
        walls: the walls.
        sight, starts: see `Plane`.
    """

    is_open: ClassVar[bool] = False

    def __init__(self, walls: Sequence[Wall], sight: Sequence[Wall] = (), starts: Sequence[Wall] = ()):
        super().__init__(sight, starts)
        self.obstacles = Obstacles([wall.shapes for wall in walls])
        self.paths = ShortestPaths(self.obstacles)
        self._free_places = lru_cache(MAX_FREE_PLACES)(self.obstacles.free_place)

    @property
    def walled(self) -> "Walled":
        """The space itself."""
        return self

    def distance(self, source: complex, target: complex) -> float:
        """Return the length of the shortest path between two places, m: inf without a path, nan if unknown."""
        return self.paths.distance(source, target)

    def distances(self, sources: Points, target: complex) -> Floats:
        """Return the lengths of the shortest paths from (k,) places to a target, (k,) m."""
        return self.paths.distances(target, sources)

    def along(self, source: complex, target: complex, length: float) -> complex:
        """Return the place, m, after a length (m) of the shortest path to a target, at most the end of the path."""
        path = self.paths.path(source, self.free_place(target))
        for begin, end in pairwise(path):
            if abs(end - begin) >= length:
                return moved_towards(begin, end, length)
            length -= abs(end - begin)
        return path[-1] if path else source

    def are_free(self, places: Points) -> Bools:
        """Return which of (k,) places a player may have, (k,): neither on a wall nor inside one."""
        return self.obstacles.are_free(places)

    def free_place(self, place: complex) -> complex:
        """Return a place itself if a player may have it, else a close one that it may have, m."""
        return self._free_places(place)

    def arrivals(self, target: complex, sources: Points) -> Points:
        """Return (k,) vectors, m, as long as the shortest paths, in the directions of arrival; inf without a path."""
        offsets: Points = target - sources
        for k in (~self.obstacles.clear(target, sources)).nonzero()[0].tolist():
            route = self.paths.route(complex(sources[k]), target)
            last_leg = offsets[k] if route.last is None else target - self.obstacles.turns[route.last]
            offsets[k] = inf if route.length == inf else last_leg * (route.length / max(abs(last_leg), SMALLEST))
        return offsets

    def first_blocked(self, waypoints: Sequence[complex]) -> int | None:
        """Return the first waypoint that cannot be reached on a straight line from the one before it, or None."""
        for k, (begin, end) in enumerate(pairwise(waypoints), start=1):
            if not self.obstacles.clear(begin, np.array([end]))[0]:
                return k
        return None

    def leg(self, here: complex, aim: complex, speed: float) -> tuple[complex, bool]:
        """Return the first straight piece of the shortest path, m, and whether it ends at the aim; see `Plane.leg`.

        A player turns beside a corner, at the clearance from it. The piece is 0 if there is no path.
        """
        route = self.paths.route(here, aim)
        if route.first is None:
            return (aim - here if route.length < inf else 0j), True
        # A corner within reach counts as passed: the player is beside it, or gets there in two units of time, 2 ns.
        reach = max(2.0 * self.obstacles.clearance, 2.0 * speed / SECOND)
        piece = complex(self.obstacles.turns[route.first]) - here
        if abs(piece) > reach:
            return piece, False
        place = next((end for end in self.paths.path(here, aim)[2:] if abs(end - here) > reach), aim)
        return place - here, place == aim

    def course(
        self, here: complex, aim: complex, speed: float, now: int, until: int, *, stops: bool, turns: bool = True
    ) -> tuple[complex, int]:
        """Return the velocity, m/s, of a player that follows the shortest path, and the time, ns, until which it holds.

        A player that is closer to the aim than a motion step keeps its speed through the aim, as in the plane: where
        it chases an evader, the aim may be behind the evader. If a wall is in the way, it keeps its speed up to the
        aim, and stands there until the end of the step. A player that is to stop at the aim, or that keeps its velocity
        for the whole step, slows down instead and arrives at the end of the step.

        Args:
            here: its position, m.
            aim: the end of the path, m.
            speed: its speed, m/s.
            now: the present, ns.
            until: the end of the motion step, ns.
            stops: whether it is to stop at the aim.
            turns: whether it takes another velocity at the time that is returned, and not only at the end of the step.
        """
        piece, is_last = self.leg(here, aim, speed)
        length = abs(piece)
        if not length or not speed:
            return 0j, until
        if is_last:
            duration = seconds(until - now)
            velocity = piece / length * speed
            if length < speed * duration:
                arrival = now + floor(length / speed * SECOND)  # not later, so that no rounding leads into the wall
                if stops or arrival == now:
                    velocity = piece / duration
                elif not self._is_free(here, velocity * duration):
                    return (velocity, arrival) if turns else (piece / duration, until)
            return velocity, until
        return piece / length * speed, min(now + ceil(length / speed * SECOND), until)

    def advance(self, here: complex, aim: complex, speed: float, now: int, end: int, until: int) -> complex:
        """Return the position, m, at a time `end` (ns) of a pursuer that chases along the shortest path."""
        while now < end:
            velocity, turn = self.course(here, aim, speed, now, until, stops=False)
            turn = min(turn, end)
            here += velocity * seconds(turn - now)
            now = turn
        return here

    def slide(self, place: complex, way: complex) -> complex:
        """Return the displacement, m, of a player that intends the displacement `way` (m) and slides along walls."""
        return self.obstacles.slide(place, way)

    def _is_free(self, place: complex, way: complex) -> bool:
        """Return whether no wall is in the way, m, from a place."""
        return self.obstacles.slide(place, way) == way

    def contact(
        self,
        target: complex,
        target_velocity: complex,
        place: complex,
        velocity: complex,
        radius: float,
        duration: float,
    ) -> float | None:
        """Return the time, s, at which the shortest path between two players has fallen to a radius, or None.

        The straight distance is never longer than the path, so no contact is earlier than that of straight distances.
        From then on, the path shortens at most at the sum of both speeds. Each step is the time in which the gap would
        close at this rate, so no step passes the contact. If the steps approach it slowly, bisection finds it.

        Args:
            target: the position of the evader, m.
            target_velocity: the velocity of the evader, m/s.
            place: the position of the pursuer, m.
            velocity: the velocity of the pursuer, m/s.
            radius: distance of a contact, m.
            duration: length of the interval, s.
        """
        first = first_contact(np.array([target - place]), np.array([target_velocity - velocity]), radius, duration)
        if first is None:
            return None
        closing = abs(target_velocity) + abs(velocity)

        def distance_at(t: float) -> float:
            return self.paths.distance(place + velocity * t, target + target_velocity * t)

        t = first[0]
        for step in range(MAX_STEPS):
            distance = distance_at(t)
            if distance == inf:  # walls enclose one of them
                return None
            gap = distance - radius
            if gap <= ROUNDING * (1.0 + distance):
                return t
            t += gap / closing if closing else inf
            if not t <= duration:
                return None
            if step == FEW_STEPS and distance_at(duration) <= radius:  # for example, both are nearly equally fast
                return _bisected(lambda time: distance_at(time) <= radius, t, duration)
        return None


def _bisected(is_reached: Callable[[float], bool], low: float, high: float) -> float:
    """Return a time, s, at which a condition begins to hold, if it holds at `high` and not at `low`."""
    while high - low > ROUNDING * (1.0 + high):
        middle = (low + high) / 2.0
        low, high = (low, middle) if is_reached(middle) else (middle, high)
    return high


PLANE = Plane()
"""The plane without walls."""
MAX_SPACES = 32
"""Maximum number of spaces in the cache, which serves other runs among the same walls."""
_spaces: dict[tuple[bytes, ...], Plane] = {}


def space_among(walls: Sequence[Wall]) -> Plane:
    """Return the space among some walls; the distances of corners are computed once."""
    motion, sight = ([wall for wall in walls if way in wall.blocks] for way in ("motion", "sight"))
    starts = [wall for wall in walls if not {"motion", "start"}.isdisjoint(wall.blocks)]
    if not sight and not starts:
        return PLANE
    other_starts = starts if starts != motion else []
    key = tuple(text for wall in walls for text in _content(wall))
    space = _spaces.get(key)
    if space is None:
        space = _spaces[key] = Walled(motion, sight, other_starts) if motion else Plane(sight, other_starts)
        if len(_spaces) > MAX_SPACES:
            del _spaces[next(iter(_spaces))]
    return space


def _content(wall: Wall) -> Iterator[bytes]:
    """Yield the content of a wall that matters for motion, sight and starts, as a key of the cache."""
    yield ",".join(wall.blocks).encode()
    yield from (bytes([shape.closed]) + shape.corners.tobytes() for shape in wall.shapes)
