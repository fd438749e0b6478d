"""Radio through walls: the loss on the straight line between two nodes, and the longer distance with the same loss.

A wall of A dB has the effect of a distance that is 10^(A / (10 n)) times as long, where n is the path loss exponent. So
it shortens the range of a disk by this factor, and any model whose power falls as d^-n receives A dB less. Reflections
and diffraction are not modelled. The losses along the line add up, as in the multi-wall model of COST 231 (1999,
"Digital Mobile Radio Towards Future Generation Systems", 4.7.2). Exponents that include the walls of a building, as
those of ITU-R P.1238 do, would count the walls twice.
"""

from collections.abc import Sequence
from math import exp, inf, log, nan
from typing import NamedTuple

import numpy as np

from desim.config.arrays import Floats, Points
from desim.kernel.core.positions import Nodes
from desim.kernel.core.seeds import ROOM
from desim.kernel.walls.crossings import crossed_by
from desim.kernel.walls.wall import Wall, blocking

NOWHERE = complex(nan, nan)
"""In place of the position of a node to which no loss has been computed; nan equals no position."""
LARGEST = 600.0
"""Largest natural logarithm of a factor, so that `exp` cannot overflow; e^600 is out of every range."""


class RadioWalls:
    """The walls that block radio, and the factors by which they stretch distances between nodes.

    Factors are kept as long as neither end has moved, because most pursuers stand still most of the time.

    Kept equal to factors that are computed at each use by
    `tests/kernel/test_radio_walls.py::test_losses_are_kept_until_an_end_moves`.

    Args:
        walls: all walls.
        size: number of nodes.
        exponent: the path loss exponent n.
    """

    def __init__(self, walls: Sequence[Wall], size: int, exponent: float):
        segments = blocking(walls, "radio")
        self._walls, self._size, self._corners = walls, size, segments.corners
        self._losses = np.zeros((len(segments.corners) - 1, 1))
        """The loss from each corner to the next, dB; 0 where there is no wall between them."""
        self._losses[segments.firsts, 0] = np.array([wall.decibels for wall in walls])[segments.owners]
        self._per_decibel = log(10.0) / (10.0 * exponent)
        self._keeps = size * size <= ROOM
        """Whether there is room to keep the factors of all pairs of nodes."""
        self._kept: dict[int, _Row] = {}
        """By sender, the factors that were computed since it last moved."""

    def with_exponent(self, exponent: float) -> "RadioWalls":
        """Return the walls for another path loss exponent."""
        return RadioWalls(self._walls, self._size, exponent)

    def decibels(self, starts: Floats, ends: Floats) -> Floats:
        """Return the (k,) losses, dB, on the straight lines between (k, 2) or (1, 2) positions, m; inf if opaque."""
        crossed = crossed_by(starts, ends, self._corners)
        return np.asarray(np.add.reduce(np.where(crossed, self._losses, 0.0), axis=0))  # wall by wall

    def stretched(
        self, src: int | Nodes, dst: Nodes, starts: Floats, ends: Floats, distances: Floats, farthest: float = inf
    ) -> Floats:
        """Return the (k,) distances, m, at which nodes without walls would receive as much power; inf if opaque.

        Args:
            src: the sender, one for all or (k,).
            dst: (k,) the receivers, each once, ascending if they are all nodes.
            starts: (1, 2) or (k, 2) positions of the senders, m.
            ends: (k, 2) positions of the receivers, m.
            distances: (k,) their distances, m.
            farthest: a distance, m, beyond which results need not be exact: they are only greater than it.
        """
        if not self._keeps or not isinstance(src, int):
            return distances * self._factors(starts, ends)
        row, position = self._kept.get(src), complex(*starts[0].tolist())
        if row is None or row.position != position:
            row = self._kept[src] = _Row(position, np.full(self._size, NOWHERE), np.ones(self._size))
        positions = np.ascontiguousarray(ends).view(np.complex128)[:, 0]
        is_all = len(dst) == self._size  # then `dst` is ascending, so `row` needs no index
        row_positions = row.positions if is_all else row.positions[dst]
        moved = ((row_positions != positions) & (distances <= farthest)).nonzero()[0]
        if len(moved):
            nodes = dst[moved]
            row.factors[nodes] = self._factors(starts, ends[moved])
            row.positions[nodes] = positions[moved]
        return distances * (row.factors if is_all else row.factors[dst])

    def _factors(self, starts: Floats, ends: Floats) -> Floats:
        """Return the (k,) factors by which the walls between positions stretch their distances."""
        return np.array([self._factor(loss) for loss in self.decibels(starts, ends).tolist()])

    def _factor(self, loss: float) -> float:
        """Return the factor of a loss, dB."""
        if not loss:
            return 1.0
        return exp(min(loss * self._per_decibel, LARGEST)) if loss < inf else inf


class _Row(NamedTuple):
    """The factors between one node and the others."""

    position: complex
    """The position of the node, m."""
    positions: Points
    """(n,) the positions of the others for which the factors were computed, m; or `NOWHERE`."""
    factors: Floats
    """(n,) the factors by which walls stretch distances."""


def range_factor(decibels: float, exponent: float) -> float:
    """Return the factor by which a wall shortens a range: 10^(-A / (10 n)), A in dB, n the path loss exponent."""
    return float(10.0 ** (-decibels / (10.0 * exponent)))
