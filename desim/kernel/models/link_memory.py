"""A number for each link of a sender, kept from message to message, for models with state."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from desim.config.arrays import Floats


class LinkMemory:
    """The numbers of the links of one sender.

    The numbers of the links to the receivers of its last message are at hand, the others are put aside. So a broadcast
    to the same receivers as the last needs no look-up, which takes a third of its time.

    Args:
        initial: the number of a link that has not been used.

    Attributes:
        dst: the (k,) receivers of the last message; None: an array that may be changed.
        value: the (k,) numbers of these links.
        since: the times (s) of the last messages of these links, if the model sets them, (k,) or one for all; -inf:
            none.
    """

    def __init__(self, initial: float) -> None:
        self._initial = initial
        # The links used so far, by node; never empty, because `take` rejects an empty array.
        self._nodes, self._value, self._since = np.array([-1]), np.array([initial]), np.array([-np.inf])
        self._selected = np.array([0])
        self.dst: NDArray[np.intp] | None = None
        self.value: Floats = self._value
        self.since: float | Floats = self._since

    def select(self, dst: "NDArray[np.intp]") -> None:
        """Put the links at hand aside, and take those to the (k,) nodes `dst`; new links are added first."""
        if dst is self.dst:
            return
        self._value[self._selected], self._since[self._selected] = self.value, self.since
        links = self._nodes.searchsorted(dst)
        if (self._nodes.take(links, mode="clip") != dst).any():
            self._add(dst)
            links = self._nodes.searchsorted(dst)
        self._selected, self.dst = links, None if dst.flags.writeable else dst
        self.value, self.since = self._value[links], self._since[links]

    def _add(self, dst: "NDArray[np.intp]") -> None:
        old, value, since = self._nodes, self._value, self._since
        self._nodes = np.union1d(old, dst)
        self._value, self._since = np.full(len(self._nodes), self._initial), np.full(len(self._nodes), -np.inf)
        kept = self._nodes.searchsorted(old)
        self._value[kept], self._since[kept] = value, since
