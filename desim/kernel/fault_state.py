"""What is broken now: nodes whose radio is down, cuts between groups of nodes, discs in which nothing can be heard."""

from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np

from desim.kernel.positions import PositionSource, as_position_source

Cut = Mapping[int, int]
"""The group of each node that is named; all others form one more."""
Disc = tuple[tuple[float, float], float]
"""Centre [x, y] and radius, m."""


class FaultState:
    """The faults that are open; each is opened and closed by the one who knows it."""

    def __init__(self, positions: PositionSource | None = None):
        self._positions = None if positions is None else as_position_source(positions)
        self._down: Counter[int] = Counter()
        self._cuts: list[Cut] = []
        self._jams: list[Disc] = []

    def down(self, node: int) -> bool:
        """Return whether the radio of a node is down."""
        return self._down[node] > 0

    def cut(self, src: int, dst: int) -> bool:
        """Return whether a partition separates two nodes."""
        return any(groups.get(src, -1) != groups.get(dst, -1) for groups in self._cuts)

    def jammed(self, node: int) -> bool:
        """Return whether a node is within a jamming disc."""
        if not self._jams or self._positions is None:
            return False
        ((x, y),) = self._positions.of(np.array([node]))
        return any((x - cx) ** 2 + (y - cy) ** 2 <= radius**2 for (cx, cy), radius in self._jams)

    def crash(self, node: int) -> None:
        """Let the radio of a node be down, once more if it is already."""
        self._down[node] += 1

    def recover(self, node: int) -> None:
        """Undo one breakdown of a node.

        Raises:
            ValueError: if it is not down.
        """
        if not self.down(node):
            raise ValueError(f"node {node} is not down")
        self._down[node] -= 1

    def partition(self, groups: Iterable[Iterable[int]]) -> Cut:
        """Separate groups of nodes from each other and from all others; return what `rejoin` takes."""
        cut = {node: number for number, group in enumerate(groups) for node in group}
        self._cuts.append(cut)
        return cut

    def rejoin(self, cut: Cut) -> None:
        """Undo a separation."""
        self._cuts = [each for each in self._cuts if each is not cut]

    def jam(self, disc: Disc) -> None:
        """Let nobody within a disc hear anything.

        Raises:
            ValueError: if the nodes have no positions.
        """
        if self._positions is None:
            raise ValueError(f"a jamming disc needs positions (got {disc})")
        self._jams.append(disc)

    def clear(self, disc: Disc) -> None:
        """Undo a jamming disc."""
        self._jams.remove(disc)
