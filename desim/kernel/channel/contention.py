"""A channel for which nodes contend: their queues, and when each of them transmits.

Each node has a FIFO queue. The access method plans the time at which each node acts next. One SimPy event stands for
the earliest of these times, and each frame has one event at its end, regardless of the number of nodes. `CarrierSense`
holds the state of the channel at each node in arrays, and `Air` decides the losses at the end of each frame.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np

from desim.kernel.channel.access_methods import Contenders, access_method
from desim.kernel.channel.air import Air
from desim.kernel.channel.carrier_sense import CarrierSense
from desim.kernel.core.clock import NEVER, Instant, Phase
from desim.kernel.core.events import Cause
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import nanoseconds
from desim.kernel.models.access import CsmaCa
from desim.kernel.models.interference import Frame
from desim.kernel.models.medium import Radio, airtimes
from desim.kernel.state.network_state import NetworkState
from desim.kernel.state.transmission import Transmission

ACKNOWLEDGEMENT = -1
"""The number of the frames of acknowledgements, which no node receives as a message."""
FIRST_DRAW = 1 << 40
"""The first number for draws of acknowledgements and repeated frames; the draws of other frames have the number of
their transmission."""


@dataclass(frozen=True)
class Callbacks:
    """The functions that a channel calls at the steps of a transmission."""

    start: Callable[[Transmission], None]
    """Called when a frame of the transmission starts."""
    leave: Callable[[Transmission, int], None]
    """Called after `start` if the transmission needs no acknowledgement, with its airtime, ns."""
    land: Callable[[Transmission, dict[int, Cause]], None]
    """Called at the end of a frame that needs no acknowledgement, with the causes of its losses on the air, by
    receiver."""
    attempt: Callable[[Transmission, int], Cause | None]
    """Called at the end of each attempt of a transmission that needs an acknowledgement, with the number of the draws
    of the attempt; draws whether the attempt is lost, and returns the cause, or None."""
    succeed: Callable[[Transmission], None]
    """Called at the end of the first attempt that succeeds, if the transmission needs an acknowledgement."""
    acknowledge: Callable[[Transmission, int], Cause | None]
    """Called at the end of an acknowledgement that can be lost, with its transmission and the number of its draws;
    draws whether it is lost, and returns the cause, or None."""
    wait: Callable[[Transmission], None]
    """Called with each transmission, because it may have to wait."""
    lose: Callable[[Transmission, Cause], None]
    """Called with a transmission that is given up, and the cause."""


@dataclass
class _Awaited:
    """An acknowledgement for which a sender waits."""

    item: Transmission | None
    """The transmission to be acknowledged; None: its sender has crashed, so the transmission is lost already."""
    cause: Cause
    """The cause of the loss if no acknowledgement comes."""


class Contention:
    """The channel for which all nodes of a network contend.

    Args:
        state: the state of the network.
        medium: the model of the medium; its access model is not `Ideal`.
        seed: the seed of the run.
        callbacks: called at the steps of each transmission.

    Raises:
        ValueError: if there are no positions, but the model of interference or a sensing range needs them; or if the
            nodes do not fit the medium or its access model.
    """

    channels = 1

    def __init__(self, state: NetworkState, medium: Radio, seed: int, callbacks: Callbacks):
        env, topology, positions = state.env, state.topology, state.positions
        access = medium.access
        self._env, self._medium, self._callbacks = env, medium, callbacks
        self._airtime_of = airtimes(medium)
        self._air = Air(env, medium, topology, positions, seed)
        self._nodes = Contenders(topology.size)
        self._access = access_method(access, self._nodes, stream(seed, "access"), state.clocks)
        self._carrier = CarrierSense(
            env, access, self._access, self._nodes, topology, positions, self._air.hears, self._plan
        )
        csma_ca = access if isinstance(access, CsmaCa) else None
        self._acknowledges = csma_ca is not None
        self._draws = count(FIRST_DRAW)
        self._queues: list[deque[Transmission]] = [deque() for _ in range(topology.size)]
        self._sending: dict[int, Transmission | None] = {}
        """The transmission that each node has on the air; None: the node has crashed, so its transmission is lost
        already."""
        self._repeated: set[int] = set()
        """The numbers of the transmissions of which an attempt has failed."""
        timeout, eifs = (None, None) if csma_ca is None else (csma_ca.ack_timeout, csma_ca.eifs)
        self._timeout = None if timeout is None else nanoseconds(timeout)
        """Time for which a sender waits for an acknowledgement, ns; None: acknowledgements are never lost."""
        self._sifs, self._ack = (0, 0) if csma_ca is None else (nanoseconds(csma_ca.sifs), nanoseconds(csma_ca.ack))
        """The interframe space before an acknowledgement, and its airtime, ns."""
        self._notes = timeout is not None or eifs is not None
        """Whether the access method depends on which of the nodes that sense a frame receive it."""
        self._awaiting: dict[int, _Awaited] = {}
        """The acknowledgement for which each node waits."""
        self._acknowledged: dict[int, Transmission] = {}
        """The transmission of each acknowledgement on the air that can be lost, by the number of its draws."""
        self._received: set[int] = set()
        """The numbers of the transmissions that were received, but are not acknowledged yet."""
        self._silent_until = [0] * topology.size
        """The time until which each node does not transmit because of the duty cycle, ns."""
        self._wake: int = NEVER
        """The time of the scheduled event at which nodes act, ns; `NEVER`: there is none."""

    def enqueue(self, item: Transmission) -> None:
        """Let a transmission contend for the channel, after those of its node that wait."""
        queue = self._queues[item.src]
        self._callbacks.wait(item)
        if self._airtime(item) > self._access.longest_airtime:
            self._callbacks.lose(item, "access")
            return
        queue.append(item)
        if len(queue) == 1:
            self._prepare(item.src, arrived=True)
        # The oldest is dropped, but the first is protected if it contends or is to be transmitted again.
        protected = int(self._nodes.ready[item.src] or queue[0].number in self._repeated)
        if len(queue) > self._medium.queue_limit + protected:
            self._callbacks.lose(queue[protected], "queue")
            del queue[protected]

    def flush(self, src: int) -> list[Transmission]:
        """Remove and return all transmissions of a node whose radio goes down now, also that on the air.

        The frame on the air stays there until its end, as interference and as a busy channel, but its transmission is
        returned here. A transmission that has been received is not returned: it is not lost.
        """
        flushed = list(self._queues[src])
        self._queues[src].clear()
        self._nodes.ready[src] = False
        self._access.reset(src)
        item = self._sending.get(src)
        if item is not None:
            self._sending[src] = None
            flushed.append(item)
        awaited = self._awaiting.get(src)
        if awaited is not None and awaited.item is not None:
            flushed.append(awaited.item)
            awaited.item = None
        numbers = {item.number for item in flushed}
        flushed = [item for item in flushed if item.number not in self._received]
        self._repeated -= numbers
        self._received -= numbers
        return flushed

    def waiting(self) -> Iterator[Transmission]:
        """Yield the transmissions that wait, and those on the air that are to be acknowledged and not yet received."""
        items = [item for queue in self._queues for item in queue]
        items += [item for item in self._sending.values() if item is not None and self._needs_ack(item)]
        items += [awaited.item for awaited in self._awaiting.values() if awaited.item is not None]
        yield from (item for item in items if item.number not in self._received)

    def busy_time(self) -> int:
        """Return the total time, ns, for which there have been frames on the air."""
        return self._air.busy_time()

    def _airtime(self, item: Transmission) -> int:
        return nanoseconds(self._airtime_of(item.size, item.src))

    def _needs_ack(self, item: Transmission) -> bool:
        return self._acknowledges and item.to_one

    def _prepare(self, node: int, *, arrived: bool = False) -> None:
        """Let the first transmission in the queue of a node contend, if there is one and the node may transmit now."""
        # The end of a silence also calls this, when the node may contend or transmit already.
        is_idle = node not in self._sending and node not in self._awaiting and not self._nodes.ready[node]
        if is_idle and self._queues[node] and self._env.now >= self._silent_until[node]:
            self._nodes.ready[node] = True
            self._access.prepare(node, self._env.now, arrived=arrived)
            self._plan()

    def _plan(self) -> None:
        """Schedule an event at the next planned action, unless an event is scheduled for then or earlier."""
        first = int(self._nodes.due.min())
        if first < self._wake:
            self._wake = first
            Instant(self._env, first, Phase.ACCESS).callbacks.append(lambda _: self._act(first))

    def _act(self, planned: int) -> None:
        """Perform the actions that are planned for now."""
        if planned != self._wake:
            return  # an earlier event was scheduled after this one, and has planned the next
        now, self._wake = self._env.now, NEVER
        due = (self._nodes.due <= now).nonzero()[0]
        starting, dropping = self._access.act(due, now) if len(due) else (due, due)
        begun = [self._begin(node) for node in starting.tolist()]
        for node in dropping.tolist():
            self._nodes.ready[node], self._nodes.due[node] = False, NEVER
            self._callbacks.lose(self._queues[node].popleft(), "access")
            self._prepare(node)
        for frame in begun:
            self._carrier.sense(frame, 1)
        self._plan()

    def _begin(self, node: int) -> Frame:
        """Transmit the first frame in the queue of a node."""
        item = self._queues[node].popleft()
        airtime = self._airtime(item)
        self._nodes.ready[node], self._nodes.due[node] = False, NEVER
        self._sending[node] = item
        self._callbacks.start(item)
        draw = next(self._draws) if item.number in self._repeated else item.number
        frame = self._transmit(item.number, node, self._env.now, airtime, draw)
        if not self._needs_ack(item):
            self._callbacks.leave(item, airtime)
        return frame

    def _transmit(self, number: int, node: int, begin: int, airtime: int, draw: int) -> Frame:
        """Put a frame on the air that begins now or, for an acknowledgement, after SIFS."""
        frame = Frame(number, draw, node, begin, begin + airtime, self._carrier.listeners(node))
        self._air.add(frame)
        Instant(self._env, frame.end, Phase.DELIVERY).callbacks.append(lambda _: self._end(frame))
        return frame

    def _end(self, frame: Frame) -> None:
        """Remove a frame from the air, and decide at which receivers it is lost."""
        if self._notes:
            self._note(frame)
        if frame.number == ACKNOWLEDGEMENT:
            self._end_acknowledgement(frame)
            return
        item, cause = self._sending.pop(frame.src), None
        causes = self._air.remove(frame, item.receivers if item is not None else [])
        if item is not None and not self._needs_ack(item):
            self._callbacks.land(item, causes)
        elif item is not None:
            cause = causes.get(item.receivers[0]) or self._callbacks.attempt(item, frame.draw)
            self._repeated.discard(item.number)
            if cause is None and item.number not in self._received:
                self._callbacks.succeed(item)
            if self._timeout is not None:
                self._await(frame, item, cause)
                return
            if cause is None:
                self._acknowledge(item.receivers[0])
        self._conclude(frame.src, item, cause)
        self._carrier.sense(frame, -1)
        self._rest(frame)
        self._prepare(frame.src)

    def _conclude(self, src: int, item: Transmission | None, cause: Cause | None) -> None:
        """End an attempt of a node, given the cause of its failure, or None: repeat, give up or finish its item."""
        is_repeated = self._access.transmitted(src, acknowledged=item is None or cause is None)
        if item is None:
            return
        if is_repeated:
            self._queues[src].appendleft(item)
            self._repeated.add(item.number)
            return
        if cause is not None and item.number not in self._received:
            self._callbacks.lose(item, cause)
        self._received.discard(item.number)

    def _rest(self, frame: Frame) -> None:
        """If there is a duty cycle, let the sender of a frame be silent after it, or prolong the present silence."""
        if self._medium.duty_cycle is None:
            return
        airtime, node = frame.end - frame.begin, frame.src
        begin = max(frame.begin, self._silent_until[node])
        self._silent_until[node] = begin + round(airtime / self._medium.duty_cycle)
        Instant(self._env, self._silent_until[node], Phase.ACCESS).callbacks.append(lambda _: self._prepare(node))

    def _acknowledge(self, node: int) -> Frame:
        """Let a node transmit an acknowledgement after SIFS; other nodes sense a busy channel from now on."""
        frame = self._transmit(ACKNOWLEDGEMENT, node, self._env.now + self._sifs, self._ack, next(self._draws))
        self._carrier.sense(frame, 1)
        self._nodes.due[node] = NEVER
        if self._medium.duty_cycle is not None:
            self._nodes.ready[node] = False  # if the node contends, it does so again after its silence
            self._rest(frame)
        return frame

    # Acknowledgements that can be lost.

    def _note(self, frame: Frame) -> None:
        """Let the nodes that sense a frame note, at its end, whether they receive it.

        Those that receive a frame to be acknowledged by another node are silent until the end of the acknowledgement.
        """
        nodes = frame.sensed_by
        received = self._air.received(frame, nodes)
        self._access.note(nodes, received | (nodes == frame.src))
        item = self._sending.get(frame.src) if frame.number != ACKNOWLEDGEMENT else None
        if self._timeout is None or item is None or not self._needs_ack(item):
            return
        silent = nodes[received & (nodes != item.receivers[0])]
        end = self._env.now + self._sifs + self._ack
        self._carrier.count(silent, 1)
        Instant(self._env, end, Phase.DELIVERY).callbacks.append(lambda _: self._carrier.count(silent, -1))

    def _await(self, frame: Frame, item: Transmission, cause: Cause | None) -> None:
        """Let a sender wait for the acknowledgement of its frame, which ends now, given the cause of its loss, or None.

        While the sender waits, it counts the channel as busy.
        """
        assert self._timeout is not None
        src = frame.src
        self._awaiting[src] = awaited = _Awaited(item, cause or "loss")
        self._carrier.count(np.array([src]), 1)
        if cause is None:
            self._received.add(item.number)
            self._acknowledged[self._acknowledge(item.receivers[0]).draw] = item
        self._carrier.sense(frame, -1)
        self._rest(frame)

        def time_out(_: object) -> None:
            if self._awaiting.get(src) is awaited:
                self._settle(src, awaited.cause)

        Instant(self._env, self._env.now + self._timeout, Phase.DELIVERY).callbacks.append(time_out)

    def _end_acknowledgement(self, frame: Frame) -> None:
        """Remove an acknowledgement from the air, and end the wait of its receiver unless it is lost."""
        item = self._acknowledged.pop(frame.draw, None)
        causes = self._air.remove(frame, [item.src] if item is not None else [])
        self._carrier.sense(frame, -1)
        awaited = self._awaiting.get(item.src) if item is not None else None
        if item is None or awaited is None or awaited.item is not item:
            return
        cause = causes.get(item.src) or self._callbacks.acknowledge(item, frame.draw)
        if cause is None:
            self._settle(item.src, None)
        else:
            awaited.cause = cause

    def _settle(self, src: int, cause: Cause | None) -> None:
        """End the wait of a sender for an acknowledgement, given the cause of its loss; None: it has arrived."""
        self._conclude(src, self._awaiting.pop(src).item, cause)
        self._carrier.count(np.array([src]), -1)
        self._prepare(src)
