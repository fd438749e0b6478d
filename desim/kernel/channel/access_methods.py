"""Access models in one run: they plan when each node senses the channel, and when it transmits.

`access_method` returns the `AccessMethod` of a model. The method plans the next action of each node in
`Contenders.due`; `desim.kernel.channel.contention` performs the actions.
"""

from collections.abc import Sequence
from math import floor
from typing import ClassVar

import numpy as np

from desim.config.arrays import Bools, Integers
from desim.config.model import MAX_TIME
from desim.kernel.core.clock import NEVER, NodeClock
from desim.kernel.core.units import SECOND, nanoseconds, seconds
from desim.kernel.models.access import Access, Csma, CsmaCa, SlottedAloha, Tdma


class Contenders:
    """The state of n nodes that contend for a channel; each array has one item per node.

    Attributes:
        due: the time at which the node acts next, ns, or `NEVER`. It then transmits or senses the channel.
        busy: number of frames that the node senses, its own included.
        idle_since: the last time at which `busy` became 0, ns.
        ready: whether the node has a frame to transmit, and is not transmitting.
    """

    def __init__(self, size: int):
        self.due: Integers = np.full(size, NEVER)
        self.busy: Integers = np.zeros(size, dtype=np.int64)
        self.idle_since: Integers = np.zeros(size, dtype=np.int64)
        self.ready: Bools = np.zeros(size, dtype=bool)


class AccessMethod:
    """An access model in one run; this base transmits each frame at once, as ALOHA does.

    Args:
        nodes: the contending nodes.
        rng: the random stream.
    """

    senses: ClassVar[bool] = False
    """Whether nodes sense the channel."""
    longest_airtime: int = NEVER
    """Longest airtime of a frame, ns."""

    def __init__(self, nodes: Contenders, rng: np.random.Generator):
        self._nodes, self._rng = nodes, rng

    def prepare(self, node: int, now: int, *, arrived: bool) -> None:
        """Plan the next action of a node that has become ready now (ns).

        Args:
            node: the node.
            now: the present, ns.
            arrived: whether its frame has just entered an empty queue; if not, it follows another frame of the node.
        """
        self._nodes.due[node] = now

    def act(self, due: Integers, now: int) -> tuple[Integers, Integers]:
        """Perform the planned actions of some nodes now (ns).

        Returns:
            the nodes that start to transmit, and those that drop their frame; all others have a new action planned.
        """
        return due, due[:0]

    def sense_busy(self, nodes: Integers, now: int) -> None:
        """Plan the actions of nodes that sense now (ns) that the channel has become busy."""

    def sense_idle(self, nodes: Integers, now: int) -> None:
        """Plan the actions of nodes that sense now (ns) that the channel has become idle."""

    def note(self, nodes: Integers, received: Bools) -> None:
        """Note at the end of a frame which of the nodes that sense it have received it."""

    def transmitted(self, node: int, *, acknowledged: bool) -> bool:
        """Note the end of a frame of a node, or of its wait for an acknowledgement.

        Return whether the frame is transmitted again, because it has not been acknowledged.
        """
        return False

    def reset(self, node: int) -> None:
        """Forget the present frame of a node, whose queue is emptied."""
        self._nodes.due[node] = NEVER


class _SlottedAloha(AccessMethod):
    """Slotted ALOHA: a node transmits at the start of a slot of its own clock."""

    def __init__(self, model: SlottedAloha, nodes: Contenders, rng: np.random.Generator, clocks: Sequence[NodeClock]):
        super().__init__(nodes, rng)
        self._slot, self._p, self._clocks = nanoseconds(model.slot), model.p, clocks

    def prepare(self, node: int, now: int, *, arrived: bool) -> None:
        clock = self._clocks[node]
        # The number of slots up to the first success is geometric, so one draw and one event replace one for each slot.
        next_slot = -(-round(clock.at(now) * SECOND) // self._slot)
        local_start = (next_slot + int(self._rng.geometric(self._p)) - 1) * self._slot
        self._nodes.due[node] = min(max(clock.when(seconds(local_start)), now), NEVER)


class _Nonpersistent(AccessMethod):
    """Nonpersistent CSMA: a node that senses a busy channel senses again after a random time."""

    senses = True

    def __init__(self, model: Csma, nodes: Contenders, rng: np.random.Generator):
        super().__init__(nodes, rng)
        self._backoff, self._limit = model.backoff, model.attempts
        self._attempts = np.zeros(len(nodes.due), dtype=np.int64)

    def prepare(self, node: int, now: int, *, arrived: bool) -> None:
        self._attempts[node] = 0
        super().prepare(node, now, arrived=arrived)

    def act(self, due: Integers, now: int) -> tuple[Integers, Integers]:
        busy = due[self._nodes.busy[due] > 0]
        self._attempts[busy] += 1
        waits = self._rng.exponential(self._backoff, len(busy))
        # At least 1 ns, so that a node does not sense the channel again and again at one instant.
        self._nodes.due[busy] = now + np.maximum(np.rint(np.minimum(waits, MAX_TIME) * SECOND).astype(np.int64), 1)
        return due[self._nodes.busy[due] == 0], busy[self._attempts[busy] >= self._limit]


class _Persistent(AccessMethod):
    """p-persistent CSMA: a node with a due time of `NEVER` waits until the channel is idle."""

    senses = True

    def __init__(self, model: Csma, nodes: Contenders, rng: np.random.Generator):
        super().__init__(nodes, rng)
        self._p, self._slot = model.p, nanoseconds(model.slot)

    def act(self, due: Integers, now: int) -> tuple[Integers, Integers]:
        idle = self._nodes.busy[due] == 0
        starts = idle & (self._rng.random(len(due)) < self._p)
        self._nodes.due[due] = np.where(idle, now + self._slot, NEVER)
        return due[starts], due[:0]

    def sense_idle(self, nodes: Integers, now: int) -> None:
        waiting = nodes[self._nodes.ready[nodes] & (self._nodes.due[nodes] == NEVER)]
        self._nodes.due[waiting] = now


class _CsmaCa(AccessMethod):
    """The distributed coordination function: with k slots left, a node transmits when DIFS + k slots have been idle.

    A node without a frame counts its slots down, too. If none is left, its next frame needs no back-off: it starts once
    the channel has been idle for DIFS.
    """

    senses = True

    def __init__(self, model: CsmaCa, nodes: Contenders, rng: np.random.Generator):
        super().__init__(nodes, rng)
        self._slot, self._difs = nanoseconds(model.slot), nanoseconds(model.difs)
        self._window, self._doublings, self._retries = model.window, model.doublings, model.retries
        self._left = np.zeros(len(nodes.due), dtype=np.int64)
        """Remaining number of slots in the back-off of each node."""
        self._failed = np.zeros(len(nodes.due), dtype=np.int64)
        """Number of failed attempts to transmit the present frame of each node."""
        self._immediate = np.zeros(len(nodes.due), dtype=bool)
        """Whether each node waits for DIFS without a back-off, because its frame came while the channel was idle."""
        self._extension = 0 if model.eifs is None else nanoseconds(model.eifs) - self._difs
        self._extensions: Integers = np.zeros(len(nodes.due), dtype=np.int64)
        """By how much the present interframe space of each node exceeds DIFS, ns."""

    def prepare(self, node: int, now: int, *, arrived: bool) -> None:
        nodes = self._nodes
        if nodes.busy[node]:
            if arrived and not self._left[node]:
                self._draw(node)
            nodes.due[node] = NEVER
        else:
            nodes.due[node] = max(now, int(self._start(node)))
            self._immediate[node] = arrived and not self._left[node]

    def sense_busy(self, nodes: Integers, now: int) -> None:
        left = self._left[nodes]
        elapsed = (now - self._idle_from(nodes)) // self._slot
        self._left[nodes] = left - np.minimum(np.maximum(elapsed, 0), left)
        ready = nodes[self._nodes.ready[nodes]]
        if len(ready):
            # A node whose back-off ends now transmits nevertheless, because it cannot sense the frame in time. The
            # sender is not ready, so it is not among these nodes.
            later = ready[self._nodes.due[ready] > now]
            self._nodes.due[later] = NEVER
            for node in later[self._immediate[later]].tolist():
                self._draw(node)

    def sense_idle(self, nodes: Integers, now: int) -> None:
        ready = nodes[self._nodes.ready[nodes]]
        if len(ready):
            self._nodes.due[ready] = self._start(ready)

    def transmitted(self, node: int, *, acknowledged: bool) -> bool:
        is_repeated = not acknowledged and self._failed[node] < self._retries
        self._failed[node] = self._failed[node] + 1 if is_repeated else 0
        self._draw(node)
        return bool(is_repeated)

    def _start(self, nodes: Integers | int) -> Integers:
        return self._idle_from(nodes) + self._left[nodes] * self._slot

    def _idle_from(self, nodes: Integers | int) -> Integers:
        """Return the time from which nodes count slots, ns."""
        return self._nodes.idle_since[nodes] + self._difs + self._extensions[nodes]

    def note(self, nodes: Integers, received: Bools) -> None:
        self._extensions[nodes] = np.where(received, 0, self._extension)

    def reset(self, node: int) -> None:
        super().reset(node)
        self._failed[node], self._immediate[node] = 0, False

    def _draw(self, node: int) -> None:
        self._immediate[node] = False
        self._left[node] = self._rng.integers(self._window << min(int(self._failed[node]), self._doublings))


class _Tdma(AccessMethod):
    """TDMA: a node transmits at the start of its slots, which it reads from its own clock."""

    def __init__(self, model: Tdma, nodes: Contenders, rng: np.random.Generator, clocks: Sequence[NodeClock]):
        super().__init__(nodes, rng)
        self._slot, self._clocks = seconds(nanoseconds(model.slot)), clocks
        self.longest_airtime = nanoseconds(model.slot) - nanoseconds(model.guard)
        owners = model.owners(len(clocks))
        self._slots_per_round = len(owners)
        self._slots: list[list[int]] = [[] for _ in clocks]
        for slot, owner in enumerate(owners):
            self._slots[owner].append(slot)
        self._used: Integers = np.full(len(clocks), -1)
        """The start of the last slot that each node has used, ns: a slot holds one frame, also if its airtime is 0."""

    def prepare(self, node: int, now: int, *, arrived: bool) -> None:
        clock = self._clocks[node]
        # The slot of this round may be used or over, and rounding may shift the number of this round by one.
        round_before = floor(clock.at(now) / self._slot) // self._slots_per_round - 1  # negative if the local time is
        rounds, earliest = range(round_before, round_before + 4), max(now, int(self._used[node]) + 1)
        for k in (turn * self._slots_per_round + slot for turn in rounds for slot in self._slots[node]):
            if (start := clock.when(k * self._slot)) >= earliest:
                self._nodes.due[node] = start
                return
        raise AssertionError("a node has a slot in every round")

    def act(self, due: Integers, now: int) -> tuple[Integers, Integers]:
        self._used[due] = now
        return super().act(due, now)


def access_method(
    model: Access, nodes: Contenders, rng: np.random.Generator, clocks: Sequence[NodeClock]
) -> AccessMethod:
    """Return the state of an access model in one run.

    Args:
        model: the model; not `Ideal`.
        nodes: the contending nodes.
        rng: the random stream.
        clocks: the clocks of the nodes.

    Raises:
        ValueError: if the nodes do not fit the slots of a TDMA.
    """
    if isinstance(model, SlottedAloha):
        return _SlottedAloha(model, nodes, rng, clocks)
    if isinstance(model, Csma):
        return (_Nonpersistent if model.persistence == "nonpersistent" else _Persistent)(model, nodes, rng)
    if isinstance(model, CsmaCa):
        return _CsmaCa(model, nodes, rng)
    if isinstance(model, Tdma):
        return _Tdma(model, nodes, rng, clocks)
    return AccessMethod(nodes, rng)
