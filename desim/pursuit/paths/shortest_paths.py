"""Shortest paths among walls by a visibility graph.

A shortest path is a chain of straight pieces that bends at corners of walls only (Lozano-Pérez & Wesley 1979). The
distances between corners are computed once; a query looks for the corners in sight of both ends.
"""

from functools import lru_cache
from math import inf
from typing import NamedTuple

import numpy as np

from desim.config.arrays import Floats, Integers, Points
from desim.pursuit.core.state import lengths
from desim.pursuit.paths.obstacles import Obstacles

MAX_SIGHTS = 4096
"""Maximum number of places in the cache of corners in sight."""
MAX_ROUTES = 64
"""Maximum number of paths in the cache: at one instant, options, utilities and beliefs ask for the same paths."""


class Sight(NamedTuple):
    """The corners in sight of a place."""

    bends: Integers
    """(c,) their indices."""
    distances: Floats
    """(c,) their distances, m."""
    path_lengths: Floats
    """(C,) the lengths of the shortest paths from the place to all corners, m."""


class Route(NamedTuple):
    """A shortest path."""

    length: float
    """Its length, m; inf if there is no path."""
    first: int | None = None
    """The corner at which it bends first; None if it is straight, or there is no path."""
    last: int | None = None
    """The corner at which it bends last."""


class ShortestPaths:
    """The shortest paths among some obstacles.

    Args:
        obstacles: the walls that block motion.
    """

    def __init__(self, obstacles: Obstacles):
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import dijkstra

        self.obstacles = obstacles
        count = len(obstacles.bends)
        rows: list[int] = []
        columns: list[int] = []
        distances: list[float] = []
        for k, bend in enumerate(obstacles.bends.tolist()):
            visible, lengths_to = obstacles.bends_in_sight(bend)
            pairs = [(j, length) for j, length in zip(visible.tolist(), lengths_to.tolist(), strict=True) if j > k]
            rows += [k] * len(pairs)
            columns += [j for j, _ in pairs]
            distances += [length for _, length in pairs]
        indices = np.array([rows, columns], dtype=np.int32)  # the dijkstra of SciPy 1.14 refuses indices of 64 bits
        graph = csr_array((distances, (indices[0], indices[1])), shape=(count, count))
        self._corner_distances: Floats = np.zeros((0, 0))
        self._predecessors: Integers = np.zeros((0, 0), dtype=np.int64)
        if count:
            self._corner_distances, self._predecessors = dijkstra(graph, directed=False, return_predecessors=True)
        """(C, C) the length of the path between two corners, m, and the last corner but one on it."""
        self._sight = lru_cache(MAX_SIGHTS)(self._sight_at)
        self.route = lru_cache(MAX_ROUTES)(self._route)

    def _route(self, source: complex, target: complex) -> Route:
        """Return the shortest path between two places, without the corners between the first and the last."""
        if self.obstacles.clear(source, np.array([target]))[0]:
            return Route(abs(target - source))
        return self._bent(source, target)

    def distance(self, source: complex, target: complex) -> float:
        """Return the length of the shortest path between two places, m; inf if there is no path."""
        return self.route(source, target).length

    def distances(self, target: complex, sources: Points) -> Floats:
        """Return the lengths of the shortest paths from (k,) sources to a target, (k,) m; inf without a path."""
        distances = lengths(target - sources)
        for k in (~self.obstacles.clear(target, sources)).nonzero()[0].tolist():
            distances[k] = self._bent(complex(sources[k]), target).length
        return distances

    def path(self, source: complex, target: complex) -> list[complex]:
        """Return the places, m, between which the shortest path is straight, from source to target; [] without one."""
        route = self.route(source, target)
        if route.length == inf:
            return []
        bends = [] if route.last is None else [route.last]
        while bends and bends[-1] != route.first:
            bends.append(int(self._predecessors[route.first, bends[-1]]))
        return [source, *(complex(self.obstacles.bends[k]) for k in reversed(bends)), target]

    def _bent(self, source: complex, target: complex) -> Route:
        """Return the shortest path over corners."""
        near, far = self._sight(source), self._sight(target)
        if not len(near.bends) or not len(far.bends):
            return Route(inf)
        total = near.distances + far.path_lengths[near.bends]
        best = int(total.argmin())
        first = int(near.bends[best])
        if total[best] == inf:
            return Route(inf)
        last = int(far.bends[(self._corner_distances[first, far.bends] + far.distances).argmin()])
        return Route(float(total[best]), first, last)

    def _sight_at(self, place: complex) -> Sight:
        bends, distances = self.obstacles.bends_in_sight(place)
        path_lengths = (self._corner_distances[:, bends] + distances).min(axis=1, initial=inf)
        return Sight(bends, distances, path_lengths)
