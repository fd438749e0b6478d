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
"""Maximum number of places of which the corners in sight are kept."""
MAX_ROUTES = 64
"""Maximum number of paths that are kept: at one instant, a path is asked for by options, utilities and beliefs."""


class Sight(NamedTuple):
    """The corners in sight of a place."""

    bends: Integers
    """(c,) their indices."""
    distances: Floats
    """(c,) their distances, m."""
    beyond: Floats
    """(C,) the length of the shortest path from the place to each corner, m."""


class Route(NamedTuple):
    """A shortest path."""

    length: float
    """Its length, m; inf if there is no path."""
    first: int | None = None
    """The corner at which it bends first; None if it is straight, or there is none."""
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
            seen, apart = obstacles.bends_in_sight(bend)
            pairs = [(j, d) for j, d in zip(seen.tolist(), apart.tolist(), strict=True) if j > k]
            rows += [k] * len(pairs)
            columns += [j for j, _ in pairs]
            distances += [d for _, d in pairs]
        places = np.array([rows, columns], dtype=np.int32)  # the dijkstra of SciPy 1.14 refuses indices of 64 bits
        graph = csr_array((distances, (places[0], places[1])), shape=(count, count))
        self._apart: Floats = np.zeros((0, 0))
        self._before: Integers = np.zeros((0, 0), dtype=np.int64)
        if count:
            self._apart, self._before = dijkstra(graph, directed=False, return_predecessors=True)
        """(C, C) the distance of each two corners, m, and the corner before the second on the path from the first."""
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
        apart = lengths(target - sources)
        for k in (~self.obstacles.clear(target, sources)).nonzero()[0].tolist():
            apart[k] = self._bent(complex(sources[k]), target).length
        return apart

    def path(self, source: complex, target: complex) -> list[complex]:
        """Return the places, m, between which the shortest path is straight, from source to target; [] without one."""
        route = self.route(source, target)
        if route.length == inf:
            return []
        bends = [] if route.last is None else [route.last]
        while bends and bends[-1] != route.first:
            bends.append(int(self._before[route.first, bends[-1]]))
        return [source, *(complex(self.obstacles.bends[k]) for k in reversed(bends)), target]

    def _bent(self, source: complex, target: complex) -> Route:
        """Return the shortest path over corners."""
        here, there = self._sight(source), self._sight(target)
        if not len(here.bends) or not len(there.bends):
            return Route(inf)
        total = here.distances + there.beyond[here.bends]
        best = int(total.argmin())
        first = int(here.bends[best])
        if total[best] == inf:
            return Route(inf)
        last = int(there.bends[(self._apart[first, there.bends] + there.distances).argmin()])
        return Route(float(total[best]), first, last)

    def _sight_at(self, place: complex) -> Sight:
        bends, distances = self.obstacles.bends_in_sight(place)
        beyond = (self._apart[:, bends] + distances).min(axis=1) if len(bends) else np.full(len(self._apart), inf)
        return Sight(bends, distances, beyond)
