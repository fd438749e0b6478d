"""The active faults of a network: nodes whose radio is down, partitions into groups of nodes, jammed discs."""

from bisect import insort
from collections import Counter
from collections.abc import Iterable, Mapping
from math import inf

import numpy as np

from desim.config.arrays import Bools, Integers
from desim.kernel.positions import PositionFunction, as_position_source

Cut = Mapping[int, int]
"""A partition: the group number of each listed node; all other nodes form one more group."""
Disc = tuple[tuple[float, float], float]
"""Centre (x, y) and radius, m."""


class FaultState:
    """The active faults of a network. Faults may overlap; each lasts until the caller ends it.

    Args:
        positions: returns the positions of the nodes, (n, 2) m; required for jamming only.
    """

    def __init__(self, positions: PositionFunction | None = None):
        self._positions = None if positions is None else as_position_source(positions)
        self._down: Counter[int] = Counter()
        self._planned: list[int] | None = None
        self._cuts: list[Cut] = []
        self._jams: list[Disc] = []

    def plan(self, time: int) -> None:
        """Announce the time, ns, of a change; after the first call, the caller makes no change at any other time."""
        self._planned = self._planned or []
        insort(self._planned, time)

    def changed(self) -> None:
        """Note that the next announced change has happened."""
        assert self._planned is not None
        del self._planned[0]

    @property
    def constant_until(self) -> float:
        """The time, ns, before which the faults certainly block the same receptions as now.

        It is 0 if changes are not planned, and while a disc is jammed, because nodes may move into it.
        """
        if self._planned is None or self._jams:
            return 0
        return self._planned[0] if self._planned else inf

    @property
    def looks_back(self) -> bool:
        """Whether an arrival may be decided after its time, provided that the faults have not changed in between.

        This requires that changes are planned, and that the source of positions, if any, also returns past positions.
        """
        return self._planned is not None and (self._positions is None or self._positions.looks_back)

    @property
    def down_nodes(self) -> Mapping[int, int]:
        """The nodes whose radio is down, each with the number of its crashes that have not ended."""
        return self._down

    def down(self, node: int) -> bool:
        """Return whether the radio of a node is down."""
        return self._down[node] > 0

    def separated(self, src: int | Integers, nodes: list[int] | Integers) -> Bools | None:
        """Return (k,) booleans: whether an active partition separates each of k nodes from its sender.

        None stands for k times False.

        Args:
            src: the sender, one for all nodes or (k,).
            nodes: (k,) the nodes.
        """
        found = None
        for groups in self._cuts:
            first, second = (
                np.array([groups.get(node, -1) for node in np.ravel(each).tolist()]) for each in (src, nodes)
            )
            found = first != second if found is None else found | (first != second)
        return found

    def jammed(self, nodes: Integers, times: int | Integers) -> Bools | None:
        """Return (k,) booleans: whether each of k nodes was at its given time within a disc that is jammed now.

        None stands for k times False.

        Args:
            nodes: (k,) the nodes.
            times: ns, one for all nodes or (k,); `PositionSource.at` states which times are valid.
        """
        if not self._jams or self._positions is None:
            return None
        x, y = self._positions.at(nodes, times).T
        within = [(x - cx) ** 2 + (y - cy) ** 2 <= radius**2 for (cx, cy), radius in self._jams]
        inside: Bools = np.any(within, axis=0)
        return inside

    def crash(self, node: int) -> None:
        """Take the radio of a node down; overlapping crashes of a node are counted."""
        self._down[node] += 1

    def recover(self, node: int) -> None:
        """End one crash of a node; its radio is up again once all its crashes have ended.

        Raises:
            ValueError: if the node is not down.
        """
        if not self.down(node):
            raise ValueError(f"node {node} is not down")
        self._down[node] -= 1
        if not self._down[node]:
            del self._down[node]

    def partition(self, groups: Iterable[Iterable[int]]) -> Cut:
        """Separate groups of nodes from each other and from all other nodes; return the cut, which `rejoin` ends."""
        cut = {node: number for number, group in enumerate(groups) for node in group}
        self._cuts.append(cut)
        return cut

    def rejoin(self, cut: Cut) -> None:
        """End a partition, given the cut that `partition` returned."""
        self._cuts = [each for each in self._cuts if each is not cut]

    def jam(self, disc: Disc) -> None:
        """Block reception at all nodes within a disc.

        Raises:
            ValueError: if the nodes have no positions.
        """
        if self._positions is None:
            raise ValueError(f"a jamming disc needs positions (got {disc})")
        self._jams.append(disc)

    def clear(self, disc: Disc) -> None:
        """End the jamming of a disc.

        Raises:
            ValueError: if the disc is not jammed.
        """
        self._jams.remove(disc)
