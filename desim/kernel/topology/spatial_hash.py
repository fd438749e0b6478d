"""Neighbour search by a cell list: nodes are hashed by the square cell of the plane that contains them.

The side of a cell is the radius of the search plus a Verlet skin. As long as no node has moved by more than half the
skin since it was hashed, all nodes within the radius of a node were hashed to its cell or to the eight cells around it.

Kept equal to distances between all nodes by
`tests/kernel/test_spatial_hash.py::test_all_near_nodes_are_found_with_arbitrary_jumps`.
"""

from collections.abc import Callable, Iterable
from math import inf

import numpy as np

from desim.config.arrays import Floats
from desim.config.model import MAX_COORDINATE
from desim.kernel.core.positions import Nodes, PositionSource

VERLET_SKIN = 0.25
"""Distance by which two nodes may approach each other before all nodes are hashed again, divided by the radius."""
MIN_SIDE = MAX_COORDINATE / 2**40
"""Minimum side of a cell, m. The rounding error of a coordinate is less than a thousandth of this length."""
ROUNDING = 1.001
"""Factor by which the side of a cell is enlarged, to allow for rounding errors."""

CellIndex = tuple[int, ...]


class CellList:
    """The nodes in each cell, updated only for nodes that have changed their cell.

    Args:
        positions: the positions of the nodes, with coordinates up to `MAX_COORDINATE`.
        radius: the radius of the search, m.
        now: returns the time, s. With it and a finite `positions.max_speed`, the movement of the nodes is bounded by
            speed x time. Otherwise each query compares the positions of all nodes with those that were hashed, unless
            `positions` returns the same read-only array as at the last query.
    """

    def __init__(self, positions: PositionSource, radius: float, now: Callable[[], float] | None = None):
        self._positions = positions
        self._now, self._max_speed = (now, positions.max_speed) if now is not None else (lambda: 0.0, inf)
        self._side = max(ROUNDING * (1.0 + VERLET_SKIN) * radius, MIN_SIDE)
        self._skin = self._side / ROUNDING - radius
        self._members: dict[CellIndex, list[int]] = {}
        self._blocks: dict[CellIndex, Nodes] = {}
        """By cell, the nodes in it and in the eight cells around it; an entry is deleted when a node enters or leaves
        one of these nine cells."""
        self._when, self._at = self._now(), positions().copy()
        """The time and the positions with which the nodes were hashed."""
        self._compared, self._drift = self._at, 0.0
        """The positions that were last compared with these, and the largest movement since."""
        self._cells = self._cells_of(self._at)
        self._enter(range(len(self._at)), self._cells)

    def around(self, node: int) -> Nodes:
        """Return the nodes that may be within the radius of a node now, itself included, ascending; read-only.

        The result contains all nodes within the radius, and possibly others.
        """
        # Two nodes that move towards each other approach by twice the drift of one.
        if 2.0 * self._drifted() > self._skin:
            self._hash()
        cell = tuple(self._cells[node].tolist())
        block = self._blocks.get(cell)
        if block is None:
            members = self._members
            nearby = [other for near in _around(cell) if near in members for other in members[near]]
            block = self._blocks[cell] = np.array(sorted(nearby), dtype=np.intp)
        return block

    def _drifted(self) -> float:
        """Return an upper bound, m, of the movement of any node along an axis since the nodes were hashed."""
        if self._max_speed < inf:
            return self._max_speed * (self._now() - self._when)
        at = self._positions()
        is_unchanged = at is self._compared and at.flags.owndata and not at.flags.writeable
        if not is_unchanged:
            self._compared, self._drift = at, float(np.abs(at - self._at).max())
        return self._drift

    def _hash(self) -> None:
        """Hash all nodes by their current positions."""
        self._when, self._at, self._drift = self._now(), self._positions().copy(), 0.0
        cells = self._cells_of(self._at)
        # Few nodes change their cell while they move by half a skin, so the dicts are updated for these nodes only.
        moved = (cells != self._cells).any(axis=1).nonzero()[0]
        self._leave(moved.tolist(), self._cells[moved])
        self._enter(moved.tolist(), cells[moved])
        self._cells = cells

    def _cells_of(self, at: Floats) -> Nodes:
        """Return the (n, 2) cell indices of (n, 2) positions."""
        return np.floor(at / self._side).astype(np.int64)

    def _enter(self, nodes: Iterable[int], cells: Nodes) -> None:
        for node, cell in zip(nodes, map(tuple, cells.tolist()), strict=True):
            self._members.setdefault(cell, []).append(node)
            self._invalidate(cell)

    def _leave(self, nodes: Iterable[int], cells: Nodes) -> None:
        for node, cell in zip(nodes, map(tuple, cells.tolist()), strict=True):
            self._members[cell].remove(node)
            if not self._members[cell]:
                del self._members[cell]
            self._invalidate(cell)

    def _invalidate(self, cell: CellIndex) -> None:
        """Delete the cached results that contain a cell."""
        for near in _around(cell):
            self._blocks.pop(near, None)


def _around(cell: CellIndex) -> list[CellIndex]:
    """Return a cell and the eight around it."""
    x, y = cell
    return [(x + dx, y + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
