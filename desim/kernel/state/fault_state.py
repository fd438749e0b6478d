"""The active faults of a network: nodes whose radio is down, partitions into groups, blocked links, jammed discs."""

from bisect import insort
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import compress
from math import inf
from operator import index
from typing import Any, NamedTuple, TypeVar

import numpy as np

from desim.config.answers import wrong_answer
from desim.config.arrays import Integers
from desim.config.model import MAX_TIME
from desim.config.python_numbers import real
from desim.kernel.core.events import Cause
from desim.kernel.core.positions import PositionFunction, as_position_source
from desim.kernel.core.records import Arrival, per_receiver
from desim.kernel.core.units import nanoseconds
from desim.kernel.models.faults import Delays, Undo

ActiveFault = TypeVar("ActiveFault")


class Outage(NamedTuple):
    """A crash of a node that has not ended."""

    node: int
    cause: Cause


Blocked = Callable[[list[int], list[int]], list[bool]]
"""Returns, for (k,) senders and (k,) receivers, whether messages between them are lost."""
Disc = tuple[tuple[float, float], float]
"""Centre (x, y) and radius, m."""


class FaultState:
    """The active faults of a network. Faults may overlap; each lasts until the caller ends it.

    A crash ends with `recover`. All other methods that begin a fault return the function that ends it.

    Changes can be planned: their times are announced in advance (`plan`, `desim.kernel.fault_injection`). The network
    then stores at transmission those arrivals that no planned change can prevent. Unplanned changes would come too late
    for these, so the methods that change the state then raise ValueError outside of `planned_change`.

    Args:
        positions: returns the positions of the nodes, (n, 2) m; required for jamming only.
        surprises: whether unplanned changes are allowed beside the planned ones. Every arrival is then decided when it
            is due, so announcements save no time.
    """

    def __init__(self, positions: PositionFunction | None = None, *, surprises: bool = False):
        self._positions = None if positions is None else as_position_source(positions)
        self._down: dict[int, list[Outage]] = {}
        self._planned: list[int] | None = None
        self._surprises = surprises
        self._is_changing = False
        self._cuts: list[tuple[Blocked, Cause]] = []
        self._jams: list[tuple[Disc, Cause]] = []
        self._interceptions: list[tuple[Delays, Cause]] = []
        self._intercepted: dict[int, dict[int, tuple[float, Cause]]] = {}
        """By number of a transmission whose arrivals are not scheduled yet: for each receiver at which an interception
        acts, the extra delay, s, and the cause of the loss if it is infinite."""
        self._copies: dict[int, list[tuple[int, float]]] = {}
        """By number of a transmission, as in `_intercepted`, for each copy: its receiver and extra delay, s."""
        self._before_change: list[Callable[[], object]] = []

    def plan(self, time: int) -> None:
        """Announce the time, ns, of a change. From then on, the state can only be changed within `planned_change`."""
        if self._surprises:
            return
        self._planned = self._planned or []
        insort(self._planned, time)

    @contextmanager
    def planned_change(self) -> Iterator[None]:
        """Call the functions given to `before_change`, and let the next announced change be made in this context."""
        if self._surprises:
            yield
            return
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

        It is 0, so that nothing is certain, if changes are not planned. It is also 0 while a disc is jammed, because
        nodes may move into it.
        """
        if self._planned is None or self._jams:
            return 0
        return self._planned[0] if self._planned else inf

    @property
    def looks_back(self) -> bool:
        """Whether an arrival may be decided after its time, until the faults next change.

        This requires that changes are planned, and that the source of positions, if any, also returns past positions.
        """
        return self.is_planned and (self._positions is None or self._positions.looks_back)

    @property
    def down_nodes(self) -> Mapping[int, Sequence[Outage]]:
        """The nodes whose radio is down, each with its crashes that have not ended."""
        return self._down

    def down(self, node: int) -> bool:
        """Return whether the radio of a node is down."""
        return node in self._down

    def down_cause(self, node: int) -> Cause | None:
        """Return the cause of losses at a node whose radio is down, None if it is up.

        Of several crashes that have not ended, the last counts.
        """
        outages = self._down.get(node)
        return outages[-1].cause if outages else None

    def separated(self, src: int | Integers, nodes: list[int] | Integers) -> list[Cause | None] | None:
        """Return (k,) causes: of the partition or block that separates sender and node, None where they are connected.

        None instead of a list: all are connected. Of several causes, that of the first fault counts.

        Args:
            src: the sender, one for all or (k,).
            nodes: (k,) the nodes.
        """
        if not self._cuts:
            return None
        receivers = np.asarray(nodes).tolist()
        senders = [src] * len(receivers) if isinstance(src, int) else src.tolist()
        causes: list[Cause | None] = [None] * len(receivers)
        for blocked, cause in reversed(self._cuts):  # so that the first overwrites the others
            for k in compress(range(len(receivers)), blocked(senders, receivers)):
                causes[k] = cause
        return causes

    def jammed(self, nodes: list[int] | Integers, times: int | Integers) -> list[Cause | None] | None:
        """Return (k,) causes: of a disc that is jammed now and contained the node at its time, None where no disc did.

        None instead of a list: no node is jammed. Of several discs, the first counts.

        Args:
            nodes: (k,) the nodes.
            times: ns, one for all or (k,); see `PositionSource.at`.
        """
        if not self._jams or self._positions is None:
            return None
        x, y = self._positions.at(np.asarray(nodes, dtype=np.intp), times).T
        causes: list[Cause | None] = [None] * len(x)
        for ((cx, cy), radius), cause in reversed(self._jams):
            for k in np.flatnonzero((x - cx) ** 2 + (y - cy) ** 2 <= radius**2).tolist():
                causes[k] = cause
        return causes

    def crash(self, node: int, cause: Cause = "crash") -> Outage:
        """Take the radio of a node down; return the outage, which `recover` ends. Crashes of a node may overlap."""
        self._require_change()
        outage = Outage(node, cause)
        self._down.setdefault(node, []).append(outage)
        return outage

    def recover(self, node: int, outage: Outage | None = None) -> None:
        """End one crash of a node; its radio is up again once all its crashes have ended.

        Args:
            node: the node.
            outage: what `crash` returned; None: the last crash ends.

        Raises:
            ValueError: if the node is not down.
        """
        self._require_change()
        if not self.down(node):
            raise ValueError(f"node {node} is not down")
        ended = self._down[node][-1] if outage is None else outage
        self._down[node] = [active for active in self._down[node] if active is not ended]
        if not self._down[node]:
            del self._down[node]

    def partition(self, groups: Iterable[Iterable[int]], cause: Cause = "partition") -> Undo:
        """Separate groups of nodes from each other and from all other nodes."""
        number_of = {node: number for number, group in enumerate(groups) for node in group}.get

        def blocked(senders: list[int], nodes: list[int]) -> list[bool]:
            return [number_of(sender, -1) != number_of(node, -1) for sender, node in zip(senders, nodes, strict=True)]

        return self._begin(self._cuts, (blocked, cause))

    def block(self, is_blocked: Callable[[int, int], bool], cause: Cause) -> Undo:
        """Block the links for which a function of sender and receiver returns True.

        Raises:
            ValueError: at a transmission, if the function returns no boolean.
        """

        def blocked(senders: list[int], nodes: list[int]) -> list[bool]:
            answers: list[Any] = [*map(is_blocked, senders, nodes)]
            for answer in answers:
                if answer is not True and answer is not False and not isinstance(answer, np.bool_):
                    raise wrong_answer("is_blocked(src, dst) should return True or False", answer, is_blocked)
            return [bool(answer) for answer in answers]

        return self._begin(self._cuts, (blocked, cause))

    def jam(self, disc: Disc, cause: Cause = "jamming") -> Undo:
        """Block reception at all nodes within a disc.

        Raises:
            ValueError: if the nodes have no positions.
        """
        if self._positions is None:
            raise ValueError(f"a jamming disc needs positions (got {disc})")
        return self._begin(self._jams, (disc, cause))

    def intercept(self, delays: Delays, cause: Cause) -> Undo:
        """Lose, delay or copy messages as a function says; a message delayed before the fault ends stays delayed."""
        return self._begin(self._interceptions, (delays, cause))

    def _begin(self, active: list[ActiveFault], fault: ActiveFault) -> Undo:
        """Append a fault to the active ones of its kind; return the function that removes it."""
        self._require_change()
        active.append(fault)

        def end() -> None:
            self._require_change()
            active[:] = [other for other in active if other is not fault]  # by identity: an equal fault may last longer

        return end

    def note_sent(self, number: int, src: int, receivers: list[int], body: Any) -> None:
        """Let the interceptions decide about a transmission that was given to its sender's host.

        Raises:
            ValueError: if the function of an interception returns anything else than delays by receiver.
        """
        for delays, cause in [*self._interceptions]:  # a copy, because a function may end its own interception
            answer: Any = delays(src, tuple(receivers), body)
            for node, (delay, *copies) in _checked_delays(answer, receivers, delays).items():
                earlier, first_cause = self._intercepted.setdefault(number, {}).get(node, (0.0, cause))
                self._intercepted[number][node] = earlier + delay, first_cause if earlier == inf else cause
                if copies:
                    self._copies.setdefault(number, []).extend((node, late) for late in copies if late < inf)

    def intercepted(self, number: int) -> dict[int, Cause]:
        """Return the cause at each receiver at which an interception loses a transmission, by receiver."""
        return {node: cause for node, (delay, cause) in self._intercepted.get(number, {}).items() if delay == inf}

    def delayed(self, number: int, receivers: list[int], arrival: Arrival) -> Arrival:
        """Return the arrival times of a transmission, ns, with the extra delays of interceptions."""
        if number not in self._intercepted:
            return arrival
        delays = {node: delay for node, (delay, _) in self._intercepted[number].items() if delay < inf}
        return [
            when + nanoseconds(min(delays.get(node, 0.0), MAX_TIME))
            for node, when in zip(receivers, per_receiver(arrival, len(receivers)), strict=True)
        ]

    def take_copies(self, number: int, reached: list[int], arrival: Arrival) -> list[tuple[int, int]]:
        """Return the receiver and the arrival time, ns, of each copy of a transmission; forget its interceptions.

        A message that is lost has no copies.

        Args:
            number: the number of the transmission.
            reached: the nodes that it reaches.
            arrival: its arrival times there, ns.
        """
        copies = self._copies.get(number)
        self.forget(number)
        if copies is None:
            return []
        arrivals = dict(zip(reached, per_receiver(arrival, len(reached)), strict=True))
        return [
            (node, arrivals[node] + nanoseconds(min(delay, MAX_TIME))) for node, delay in copies if node in arrivals
        ]

    def forget(self, number: int) -> None:
        """Forget what the interceptions would do to a transmission."""
        self._intercepted.pop(number, None)
        self._copies.pop(number, None)

    def _require_change(self) -> None:
        """Raise ValueError if the state may not be changed now."""
        if self.is_planned and not self._is_changing:
            raise ValueError("faults were injected, so the faults cannot be changed otherwise")


def _checked_delays(answer: Any, receivers: list[int], delays: Delays) -> dict[int, list[float]]:
    """Return the delays that a function of an interception returned, each as a list; see `FaultState.intercept`."""
    try:
        checked = {
            index(node): [
                real(delay, "an extra delay, in s,") for delay in (item if isinstance(item, list | tuple) else [item])
            ]
            for node, item in answer.items()
        }
    except (AttributeError, TypeError, ValueError) as error:
        expected = "the extra delay, s, by receiver, such as {3: 0.5}; inf: the message is lost there"
        raise wrong_answer(f"delays(src, receivers, body) should return {expected}", answer, delays) from error
    if empty := [node for node, values in checked.items() if not values]:
        raise wrong_answer("a list of extra delays, in s, should not be empty", {empty[0]: []}, delays)
    if wrong := [delay for values in checked.values() for delay in values if not delay >= 0.0]:
        raise wrong_answer("an extra delay, in s, should be at least 0", wrong[0], delays)
    if unknown := [node for node in checked if node not in receivers]:
        raise wrong_answer("delays(src, receivers, body) should name receivers of the message", unknown[0], delays)
    return checked
