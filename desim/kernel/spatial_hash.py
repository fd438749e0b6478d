"""Who may be near whom: nodes hashed by the square cells of the plane that they are in.

A cell is a little larger than the radius that is asked about. While nobody can have moved by more than half of that
skin, whoever is within the radius of a node is in the cell in which it was hashed, or in one of the eight around it.
"""

from collections.abc import Callable, Iterable
from math import inf

import numpy as np

from desim.config.model import MAX_COORDINATE
from desim.kernel.positions import Floats, Nodes, Positions

VERLET_SKIN = 0.25
"""How much nearer two nodes may come to each other before all are looked at again, in radii."""
FINEST = MAX_COORDINATE / 2**40
"""No cell is smaller, m: any coordinate is rounded by less than a thousandth of a cell, which `ROUNDING` allows for."""
ROUNDING = 1.001

CellIndex = tuple[int, ...]


class CellList:
    """The nodes in each cell; only who has changed its cell is hashed again.

    Args:
        positions: of the nodes, up to `MAX_COORDINATE` from the origin.
        radius: within which nodes are near each other, m.
        now: the time, s; where it is not known, nor how fast the nodes are, all positions are compared.
    """

    def __init__(self, positions: Positions, radius: float, now: Callable[[], float] | None = None):
        self._positions = positions
        self._now, self._fastest = (now, positions.fastest) if now is not None else (lambda: 0.0, inf)
        self._side = max(ROUNDING * (1.0 + VERLET_SKIN) * radius, FINEST)
        self._slack = self._side / ROUNDING - radius
        self._members: dict[CellIndex, list[int]] = {}
        self._blocks: dict[CellIndex, Nodes] = {}
        """Who is in a cell or around it, where somebody has asked and nobody has come or gone since."""
        self._when, self._at = self._now(), positions().copy()
        self._seen, self._drift = self._at, 0.0
        self._cells = self._cells_of(self._at)
        self._enter(range(len(self._at)), self._cells)

    def around(self, node: int) -> Nodes:
        """Return all that are within the radius of a node now, itself and some more, ascending; not to be changed."""
        if 2.0 * self._drifted() > self._slack:
            self._hash()
        cell = tuple(self._cells[node].tolist())
        block = self._blocks.get(cell)
        if block is None:
            members = self._members
            found = [other for near in _around(cell) if near in members for other in members[near]]
            block = self._blocks[cell] = np.array(sorted(found), dtype=np.intp)
        return block

    def _drifted(self) -> float:
        """Return how far anybody may have moved along an axis since the nodes were hashed, m."""
        if self._fastest < inf:
            return self._fastest * (self._now() - self._when)
        at = self._positions()
        fixed = at is self._seen and at.flags.owndata and not at.flags.writeable
        if not fixed:
            self._seen, self._drift = at, float(np.abs(at - self._at).max())
        return self._drift

    def _hash(self) -> None:
        """Let everybody be in the cell of where it is now."""
        self._when, self._at, self._drift = self._now(), self._positions().copy(), 0.0
        cells = self._cells_of(self._at)
        moved = (cells != self._cells).any(axis=1).nonzero()[0]
        self._leave(moved.tolist(), self._cells[moved])
        self._enter(moved.tolist(), cells[moved])
        self._cells = cells

    def _cells_of(self, at: Floats) -> Nodes:
        """Return the (n, 2) numbers of the cells that positions are in."""
        return np.floor(at / self._side).astype(np.int64)

    def _enter(self, nodes: Iterable[int], cells: Nodes) -> None:
        for node, cell in zip(nodes, map(tuple, cells.tolist()), strict=True):
            self._members.setdefault(cell, []).append(node)
            self._forget(cell)

    def _leave(self, nodes: Iterable[int], cells: Nodes) -> None:
        for node, cell in zip(nodes, map(tuple, cells.tolist()), strict=True):
            self._members[cell].remove(node)
            if not self._members[cell]:
                del self._members[cell]
            self._forget(cell)

    def _forget(self, cell: CellIndex) -> None:
        """Let what was found around a cell be found anew."""
        for near in _around(cell):
            self._blocks.pop(near, None)


def _around(cell: CellIndex) -> list[CellIndex]:
    """Return a cell and the eight around it."""
    x, y = cell
    return [(x + dx, y + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
