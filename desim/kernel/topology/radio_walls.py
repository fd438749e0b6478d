"""Radio through walls: the loss on the straight line between two nodes, and the distance that it stands for.

A wall of A dB has the effect of a distance that is 10^(A / (10 n)) times as long, where n is the path loss exponent. So
it shortens the range of a disk by this factor, and any model whose power falls as d^-n receives A dB less. Reflections
and diffraction are not modelled. The losses along the line add up, as in the multi-wall model of COST 231 (1999,
"Digital Mobile Radio Towards Future Generation Systems", 4.7.2). Exponents that already have the walls of a building in
them, as those of ITU-R P.1238, would count them twice.
"""

from collections.abc import Sequence
from math import exp, inf, log

import numpy as np

from desim.config.arrays import Floats
from desim.kernel.core.positions import Nodes, PositionSource
from desim.kernel.core.seeds import ROOM
from desim.kernel.walls.crossings import crossed_by
from desim.kernel.walls.wall import Wall, blocking

LARGEST = 600.0
"""Largest natural logarithm of a factor: a distance that is e^600 times as long is out of every range."""


class RadioWalls:
    """The walls that block radio, and the losses between nodes.

    Args:
        walls: all walls.
        positions: the current positions of the nodes.
        size: number of nodes.
    """

    def __init__(self, walls: Sequence[Wall], positions: PositionSource, size: int):
        segments, self._positions = blocking(walls, "radio"), positions
        self._corners = segments.corners
        self._losses = np.zeros((len(segments.corners) - 1, 1))
        """The loss from each corner to the next, dB; 0 where there is no wall between them."""
        self._losses[segments.firsts, 0] = np.array([wall.decibels for wall in walls])[segments.owners]
        self._keeps = positions.max_speed == 0.0 and size * size <= ROOM
        self._kept: dict[int, Floats] = {}
        """If no node moves: by sender, the losses between it and all nodes, dB."""

    def decibels(self, starts: Floats, ends: Floats) -> Floats:
        """Return the (k,) losses, dB, on the straight lines between (k, 2) or (1, 2) positions, m; inf if opaque."""
        crossed = crossed_by(starts, ends, self._corners)
        total: Floats = np.add.reduce(np.where(crossed, self._losses, 0.0), axis=0)  # wall by wall
        return total

    def between(self, src: int | Nodes, dst: Nodes, starts: Floats, ends: Floats) -> Floats:
        """Return the (k,) losses, dB, between nodes: (1, 2) or (k, 2) and (k, 2) are their positions, m."""
        if not self._keeps or not isinstance(src, int):
            return self.decibels(starts, ends)
        row = self._kept.get(src)
        if row is None:
            places = self._positions()
            row = self._kept[src] = self.decibels(places[src : src + 1], places)
        return row[dst]


def stretched(apart: Floats, decibels: Floats, exponent: float) -> Floats:
    """Return the (k,) distances, m, at which nodes without walls would receive as much power; inf if opaque.

    Args:
        apart: (k,) their distances, m.
        decibels: (k,) the losses of the walls between them, dB.
        exponent: the path loss exponent n.
    """
    if not decibels.any():
        return apart
    per_decibel = log(10.0) / (10.0 * exponent)
    factors = [exp(min(loss * per_decibel, LARGEST)) if loss < inf else inf for loss in decibels.tolist()]
    return apart * np.array(factors)


def range_factor(decibels: float, exponent: float) -> float:
    """Return the factor by which a wall shortens a range: 10^(-A / (10 n)), A in dB, n the path loss exponent."""
    return 10.0 ** (-decibels / (10.0 * exponent))
