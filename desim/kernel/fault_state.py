"""The active faults of a network: nodes whose radio is down, partitions into groups of nodes, jammed discs."""

from bisect import insort
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from math import inf

import numpy as np

from desim.config.arrays import Integers
from desim.kernel.positions import PositionFunction, as_position_source

Cut = Mapping[int, int]
"""A partition: the group number of each listed node; all other nodes form one more group."""
Disc = tuple[tuple[float, float], float]
"""Centre (x, y) and radius, m."""


class FaultState:
    """The active faults of a network. Faults may overlap; each lasts until the caller ends it.

    Changes can be planned: their times are announced in advance (`plan`, `desim.kernel.fault_injection`). The network
    then stores at transmission those arrivals that no planned change can prevent. Once a change has been announced, the
    methods that change the state therefore raise ValueError outside of `planned_change`.

    Args:
        positions: returns the positions of the nodes, (n, 2) m; required for jamming only.
    """

    def __init__(self, positions: PositionFunction | None = None):
        self._positions = None if positions is None else as_position_source(positions)
        self._down: Counter[int] = Counter()
        self._planned: list[int] | None = None
        self._is_changing = False
        self._cuts: list[Cut] = []
        self._jams: list[Disc] = []
        self._before_change: list[Callable[[], object]] = []

    def plan(self, time: int) -> None:
        """Announce the time, ns, of a change. From then on, the state can only be changed within `planned_change`."""
        self._planned = self._planned or []
        insort(self._planned, time)

    @contextmanager
    def planned_change(self) -> Iterator[None]:
        """Make the next announced change in this context, after a call of the functions given to `before_change`."""
        assert self._planned is not None
        for act in self._before_change:
            act()
        self._is_changing = True
        try:
            yield
        finally:
            self._is_changing = False
        del self._planned[0]

    def changes_by(self, time: int) -> bool:
        """Return whether an announced change is due at a time (ns) or before, and has not been made yet."""
        return bool(self._planned and self._planned[0] <= time)

    def before_change(self, act: Callable[[], object]) -> None:
        """Register a function to call before each planned change, and before the motion of a node changes."""
        self._before_change.append(act)
        if self._positions is not None:
            self._positions.before_change(act)

    @property
    def is_planned(self) -> bool:
        """Whether changes are planned."""
        return self._planned is not None

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
        return self.is_planned and (self._positions is None or self._positions.looks_back)

    @property
    def down_nodes(self) -> Mapping[int, int]:
        """The nodes whose radio is down, each with the number of its crashes that have not ended."""
        return self._down

    def down(self, node: int) -> bool:
        """Return whether the radio of a node is down."""
        return self._down[node] > 0

    def separated(self, src: int | Integers, nodes: list[int] | Integers) -> list[bool] | None:
        """Return k booleans: whether an active partition separates each node from its sender; None: all False.

        Args:
            src: the sender, one for all or (k,).
            nodes: (k,) the nodes.
        """
        if not self._cuts:
            return None
        here = np.asarray(nodes).tolist()
        senders = [src] * len(here) if isinstance(src, int) else src.tolist()
        pairs = list(zip(senders, here, strict=True))
        return [any(cut.get(one, -1) != cut.get(other, -1) for cut in self._cuts) for one, other in pairs]

    def jammed(self, nodes: list[int] | Integers, times: int | Integers) -> list[bool] | None:
        """Return k booleans: whether each node was, at its time, within a disc that is jammed now; None: all False.

        Args:
            nodes: (k,) the nodes.
            times: ns, one for all or (k,); see `PositionSource.at`.
        """
        if not self._jams or self._positions is None:
            return None
        x, y = self._positions.at(np.asarray(nodes, dtype=np.intp), times).T
        within = [(x - cx) ** 2 + (y - cy) ** 2 <= radius**2 for (cx, cy), radius in self._jams]
        inside: list[bool] = (within[0] if len(within) == 1 else np.any(within, axis=0)).tolist()
        return inside

    def crash(self, node: int) -> None:
        """Take the radio of a node down; overlapping crashes of a node are counted."""
        self._require_change()
        self._down[node] += 1

    def recover(self, node: int) -> None:
        """End one crash of a node; its radio is up again once all its crashes have ended.

        Raises:
            ValueError: if the node is not down.
        """
        self._require_change()
        if not self.down(node):
            raise ValueError(f"node {node} is not down")
        self._down[node] -= 1
        if not self._down[node]:
            del self._down[node]

    def partition(self, groups: Iterable[Iterable[int]]) -> Cut:
        """Separate groups of nodes from each other and from all other nodes; return the cut, which `rejoin` ends."""
        self._require_change()
        cut = {node: number for number, group in enumerate(groups) for node in group}
        self._cuts.append(cut)
        return cut

    def rejoin(self, cut: Cut) -> None:
        """End a partition, given the cut that `partition` returned."""
        self._require_change()
        self._cuts = [each for each in self._cuts if each is not cut]

    def jam(self, disc: Disc) -> None:
        """Block reception at all nodes within a disc.

        Raises:
            ValueError: if the nodes have no positions.
        """
        self._require_change()
        if self._positions is None:
            raise ValueError(f"a jamming disc needs positions (got {disc})")
        self._jams.append(disc)

    def clear(self, disc: Disc) -> None:
        """End the jamming of a disc.

        Raises:
            ValueError: if the disc is not jammed.
        """
        self._require_change()
        self._jams.remove(disc)

    def _require_change(self) -> None:
        """Raise ValueError if the state may not be changed now."""
        if self.is_planned and not self._is_changing:
            raise ValueError("faults were injected, so the faults cannot be changed otherwise")
