"""The positions of nodes that another program moves, one step at a time."""

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from desim.config.arguments import value_text
from desim.config.arrays import Floats, Integers, array_of, array_text
from desim.config.model import MAX_COORDINATE
from desim.kernel.core.clock import Clock
from desim.kernel.core.positions import Nodes, PositionSource


class SteppedPositions(PositionSource):
    """Positions that are known at the ends of steps; between two of them, every node moves in a straight line.

    Args:
        clock: the clock of the simulation.
        nodes: the labels of the nodes, in the order of the rows.
    """

    looks_back = True

    def __init__(self, clock: Clock, nodes: Sequence[Hashable]):
        self._clock, self._nodes, self._size = clock, nodes, len(nodes)
        self._array: Any = None
        """The array given last, not a copy, because the caller may change it; it is read as each step begins."""
        self._first: Floats | None = None
        """(n, 2) positions at the beginning of the step or, between two steps, now."""
        self._change: Floats | None = None
        """(n, 2) changes of the positions in this step; None between two steps."""
        self._last: Any = None
        """(n, 2) positions at the end of the step."""
        self._begin = self._end = 0
        self._before_change: list[Callable[[], object]] = []

    @property
    def array(self) -> Any:
        """The array given last; None before the first."""
        return self._array

    def place(self, positions: Any) -> None:
        """Set the positions at the start.

        Raises:
            ValueError: as in `begin_step`.
        """
        array = _rereadable(positions)
        self._first, self._array = self._read(array), array

    def begin_step(self, end: int, positions: Any) -> None:
        """Begin a step.

        Args:
            end: the end of the step, ns.
            positions: (n, 2) the positions at its end, m; None: those that the array given last contains now.

        Raises:
            ValueError: if the positions are not finite numbers, (n, 2).
        """
        array = self._array if positions is None else _rereadable(positions)
        if array is None:
            return
        last = self._read(array)
        self._array = array
        if self._first is None:
            self._first = last
        elif not np.array_equal(self._first, last):
            self._change, self._last = last - self._first, last
            self._begin, self._end = self._clock.now, end

    def end_step(self) -> None:
        """End a step: from now on, the positions are those at its end."""
        if self._change is not None:
            for act in self._before_change:
                act()
            self._first, self._change = self._last, None

    def __call__(self) -> Floats:
        """Return the positions of all nodes, (n, 2) m; read-only.

        Raises:
            ValueError: if no positions have been given.
        """
        if self._first is None:
            raise ValueError(
                "this network depends on the positions of its nodes: give them as positions=, an array of one (x, y)"
                " per node, m, when it is created"
            )
        if self._change is None:
            return self._first
        return self._at(slice(None), self._clock.now)

    def of(self, nodes: Nodes) -> Floats:
        """Return the positions of some nodes, (k, 2) m."""
        return self.at(nodes, self._clock.now)

    def at(self, nodes: Nodes, times: int | Integers) -> Floats:
        """Return the positions of some nodes, each at a time, (k, 2) m."""
        if self._change is None:
            return self().take(nodes, axis=0)
        return self._at(nodes, times)

    def before_change(self, act: Callable[[], object]) -> None:
        """Register a function to call before the motion of a node changes: at the end of each step with motion.

        The network registers a function that decides the outcomes of the step while `at` still returns its positions.
        """
        self._before_change.append(act)

    def _at(self, nodes: Any, times: int | Integers) -> Floats:
        assert self._first is not None
        assert self._change is not None
        share = np.asarray((times - self._begin) / (self._end - self._begin))[..., np.newaxis]
        interpolated = self._first[nodes] + self._change[nodes] * share
        # At the end, the positions are exactly those of the caller.
        return np.asarray(np.where(share < 1.0, interpolated, self._last[nodes]))

    def _read(self, positions: Any) -> Floats:
        """Return a read-only copy of the positions at one instant."""
        rows = getattr(positions, "index", None) if hasattr(positions, "loc") else None
        if rows is not None and len(rows) == self._size and {*rows} == {*self._nodes}:  # of pandas
            positions = positions.loc[[*self._nodes]].reset_index(drop=True)
        elif isinstance(positions, Mapping):
            if missing := [node for node in self._nodes if node not in positions]:
                raise ValueError(
                    f"positions should have a place for each node: there is none for {value_text(missing[0])}"
                )
            positions = [positions[node] for node in self._nodes]
        copy = copy_of_positions(positions, (self._size, 2))
        copy.setflags(write=False)
        return copy


def copy_of_positions(positions: Any, shape: tuple[int, ...]) -> Floats:
    """Return a copy of positions, (n, 2) or (networks, n, 2) m.

    Raises:
        ValueError: if they are not finite numbers of this shape.
    """
    array = array_of(positions)
    if array.shape != shape or array.dtype.kind not in "iuf":
        raise ValueError(
            f"positions should be an array of numbers of the shape {shape}, one row (x, y) per node, m"
            f" (got {array_text(array)})"
        )
    copy = array.astype(np.float64)
    if (beyond := ~(np.abs(copy) <= MAX_COORDINATE)).any():
        *network, row, _ = np.argwhere(beyond)[0].tolist()
        where = f"row {row}{''.join(f' of network {e}' for e in network)}"
        raise ValueError(
            f"positions should be finite, at most {MAX_COORDINATE:g} m from 0 (got {copy[*network, row].tolist()} in"
            f" {where}); a node that has left may keep its last position"
        )
    return copy


def _rereadable(positions: Any) -> Any:
    """Return positions that can be read at each step: a list in place of an iterator."""
    return [*positions] if isinstance(positions, Iterator) else positions
