"""A channel for which nodes contend: queues, frames on the air, carrier sensing, and losses by interference.

Each node has a FIFO queue. The access method plans the time at which each node acts next. One SimPy event stands for
the earliest of these times, and each frame has one event at its end, regardless of the number of nodes. What the nodes
sense is kept in arrays over all nodes. At the end of a frame all frames that overlap it are known, and it is decided at
which receivers it is lost.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import count
from typing import Generic, TypeVar

import numpy as np

from desim.config.arrays import Bools, Floats, Integers
from desim.kernel.access import CarrierSensing, CsmaCa
from desim.kernel.access_methods import NEVER, Contenders, method
from desim.kernel.clock import Clock, Instant, NodeClock, Phase, nanoseconds, seconds
from desim.kernel.events import Cause
from desim.kernel.interference import CaptureEffect, Frame, Overlap, Signal
from desim.kernel.medium import LoRa, Radio
from desim.kernel.positions import PositionSource, distances
from desim.kernel.seeds import pair_uniform, stream
from desim.kernel.topology import Topology
from desim.kernel.transmitter import Transmittable

Item = TypeVar("Item", bound=Transmittable)
ACKNOWLEDGEMENT = -1
"""The number of the frames of acknowledgements, which no node receives as a message."""
FIRST_DRAW = 1 << 40
"""The number of the draws of the first acknowledgement or repeated frame; other frames use that of the transmission."""


class Contention(Generic[Item]):
    """The channel for which all nodes of a network contend.

    Args:
        env: the clock of the simulation.
        medium: the model of the medium; its access model is not `Ideal`.
        topology: the links of the graph, and which of them are within range.
        positions: the current positions of the nodes; None: unknown.
        clocks: the clocks of the nodes.
        seed: the seed of the run.
        start: called with a transmission when one of its frames starts.
        leave: called after `start` with a transmission that is not acknowledged, and its airtime, ns.
        attempt: called with an acknowledged transmission at the end of each attempt, and the number of the draws of the
            attempt; draws the losses, and returns the cause, or None.
        succeed: called with an acknowledged transmission at the end of the attempt that succeeds.
        wait: called with each transmission, because it may have to wait.
        lose: called with a transmission that is given up, and the cause.

    Raises:
        ValueError: if there are no positions, but the model of interference or a sensing range needs them; or if the
            nodes do not fit the medium or its access model.
    """

    channels = 1

    def __init__(
        self,
        env: Clock,
        medium: Radio,
        topology: Topology,
        positions: PositionSource | None,
        clocks: Sequence[NodeClock],
        seed: int,
        *,
        start: Callable[[Item], None],
        leave: Callable[[Item, int], None],
        attempt: Callable[[Item, int], Cause | None],
        succeed: Callable[[Item], None],
        wait: Callable[[Item], None],
        lose: Callable[[Item, Cause], None],
    ):
        access, interference = medium.access, medium.reception
        self._env, self._medium, self._interference = env, medium, interference
        self._topology, self._positions, self._seed = topology, positions, seed
        self._start, self._leave, self._attempt, self._succeed = start, leave, attempt, succeed
        self._wait, self._lose = wait, lose
        self._nodes, self._all = Contenders(topology.size), np.arange(topology.size)
        self._access = method(access, self._nodes, stream(seed, "access"), clocks)
        self._sensing = access if isinstance(access, CarrierSensing) else CarrierSensing()
        self._delay = nanoseconds(self._sensing.sensing_delay)
        self._ack = nanoseconds(access.sifs + access.ack) if isinstance(access, CsmaCa) else None
        self._locks = isinstance(interference, CaptureEffect) and interference.lock
        self._draws = count(FIRST_DRAW)
        self._queues: list[deque[Item]] = [deque() for _ in range(topology.size)]
        self._sending: dict[int, Item | None] = {}
        """The transmission that each node has on the air; None: its sender has crashed, so it has no outcome."""
        self._repeated: set[int] = set()
        """The numbers of the transmissions of which an attempt has failed."""
        self._on_air: list[Frame] = []
        self._lost: dict[int, tuple[dict[int, Cause], int]] = {}
        """By number of a transmission: the causes of its losses on the air, by receiver, and its last arrival, ns."""
        self._wake: int = NEVER
        self._busy = self._busy_since = 0
        needed = interference.needs_positions or self._sensing.sensing_range is not None
        medium.check(topology.size)
        if needed and positions is None:
            raise ValueError("network.medium: a sensing range, and reception by power, need positions")

    def enqueue(self, item: Item) -> None:
        """Let a transmission contend for the channel, after those of its node that wait."""
        queue, is_sending = self._queues[item.src], item.src in self._sending
        self._wait(item)
        queue.append(item)
        if len(queue) == 1 and not is_sending:
            self._prepare(item.src, arrived=True)
        elif len(queue) > self._medium.queue_limit + (not is_sending):  # the first contends, the others wait
            place = int(not is_sending)
            self._lose(queue[place], "queue")
            del queue[place]

    def flush(self, src: int) -> list[Item]:
        """Remove and return all transmissions of a node that were not given to `leave` yet."""
        taken = list(self._queues[src])
        self._queues[src].clear()
        self._nodes.ready[src] = False
        self._access.reset(src)
        item = self._sending.get(src)
        if item is not None and self._is_acknowledged(item):
            self._sending[src] = None  # the radio is off, and the frame ends without an outcome
            taken.append(item)
        return taken

    def waiting(self) -> Iterator[Item]:
        """Yield the transmissions that were not given to `leave` yet."""
        for queue in self._queues:
            yield from queue
        yield from (item for item in self._sending.values() if item is not None and self._is_acknowledged(item))

    def airtime(self) -> int:
        """Return the total time, ns, at which some node has been transmitting."""
        return self._busy + (self._env.now - self._busy_since if self._on_air else 0)

    def keep(self, number: int, until: int) -> None:
        """Keep the losses of a transmission, which is on the air, until its last arrival, ns."""
        self._lost[number] = {}, until

    def forget(self, before: float) -> None:
        """Forget the losses of the transmissions whose last arrival was before a time, ns."""
        while self._lost:
            first = next(iter(self._lost))
            if self._lost[first][1] >= before:
                return
            del self._lost[first]

    def causes(self, numbers: Iterable[int], nodes: Iterable[int]) -> list[Cause | None] | None:
        """Return why each of k receptions of a transmission failed on the air, or None; None alone: none failed."""
        nothing: tuple[dict[int, Cause], int] = {}, 0
        found = [self._lost.get(number, nothing)[0].get(node) for number, node in zip(numbers, nodes, strict=False)]
        return found if any(found) else None

    def ends_by(self, now: int) -> bool:
        """Return whether a frame ends by a time, ns, and its losses are not decided yet."""
        return any(frame.end <= now for frame in self._on_air)

    # Access.

    def _is_acknowledged(self, item: Item) -> bool:
        return self._ack is not None and item.to_one

    def _prepare(self, node: int, *, arrived: bool = False) -> None:
        """Let the first transmission in the queue of a node contend, if there is one."""
        if self._queues[node]:
            self._nodes.ready[node] = True
            self._access.prepare(node, self._env.now, arrived=arrived)
            self._plan()

    def _plan(self) -> None:
        """Schedule an event at the next planned action, unless there is one."""
        first = int(self._nodes.due.min())
        if first < self._wake:
            self._wake = first
            Instant(self._env, first, Phase.ACCESS).callbacks.append(lambda _: self._act(first))

    def _act(self, planned: int) -> None:
        """Perform the actions that are planned for now."""
        if planned != self._wake:
            return  # an earlier event has been scheduled since, and has planned anew
        now, self._wake = self._env.now, NEVER
        due = (self._nodes.due <= now).nonzero()[0]
        starting, dropping = self._access.act(due, now) if len(due) else (due, due)
        begun = [self._begin(node) for node in starting.tolist()]
        for node in dropping.tolist():
            self._nodes.ready[node], self._nodes.due[node] = False, NEVER
            self._lose(self._queues[node].popleft(), "access")
            self._prepare(node)
        for frame in begun:
            self._sense(frame, 1)
        self._plan()

    def _begin(self, node: int) -> Frame:
        """Transmit the first frame in the queue of a node."""
        item = self._queues[node].popleft()
        airtime = nanoseconds(self._medium.airtime(item.size, node))
        if airtime > self._access.longest:
            raise ValueError(
                f"network.medium.access: a message of {item.size} bytes takes {seconds(airtime):g} s on the air, but a"
                f" slot without its guard time {seconds(self._access.longest):g} s"
            )
        self._nodes.ready[node], self._nodes.due[node] = False, NEVER
        self._sending[node] = item
        self._start(item)
        is_repeated = self._is_acknowledged(item) and item.number in self._repeated
        frame = self._transmit(item.number, node, airtime, next(self._draws) if is_repeated else item.number)
        if not self._is_acknowledged(item):
            self._leave(item, airtime)
        return frame

    def _transmit(self, number: int, node: int, airtime: int, draw: int) -> Frame:
        """Put a frame on the air."""
        now = self._env.now
        frame = Frame(number, draw, node, now, now + airtime, self._sensed_by(node))
        if self._locks:
            frame.locked = np.ones(len(self._all), dtype=bool)
        for other in self._on_air:
            frame.overlapping.append(other)
            other.overlapping.append(frame)
            if frame.locked is not None and other.locked is not None:
                frame.locked[other.src] = other.locked[node] = False
                if other.begin < now:
                    frame.locked &= ~(other.locked & self._audible(other, self._all))
        if not self._on_air:
            self._busy_since = now
        self._on_air.append(frame)
        Instant(self._env, frame.end, Phase.DELIVERY).callbacks.append(lambda _: self._end(frame))
        return frame

    def _end(self, frame: Frame) -> None:
        """Take a frame from the air, and decide at which receivers it is lost."""
        self._on_air.remove(frame)
        if not self._on_air:
            self._busy += self._env.now - self._busy_since
        if frame.number == ACKNOWLEDGEMENT:
            frame.overlapping = []
            self._sense(frame, -1)
            return
        item, cause = self._sending.pop(frame.src), None
        if item is not None:
            causes = self._judge(frame, item.receivers)
            if self._is_acknowledged(item):
                cause = causes.get(item.receivers[0]) or self._attempt(item, frame.draw)
                self._repeated.discard(item.number)
                if cause is None:
                    self._succeed(item)
                    self._acknowledge(item.receivers[0])
            elif frame.number in self._lost:
                self._lost[frame.number][0].update(causes)
        frame.overlapping = []  # the frames refer to each other
        is_repeated = self._access.transmitted(frame.src, acknowledged=cause is None)
        if item is not None and cause is not None:
            if is_repeated:
                self._queues[frame.src].appendleft(item)
                self._repeated.add(item.number)
            else:
                self._lose(item, cause)
        self._sense(frame, -1)
        self._prepare(frame.src)

    def _acknowledge(self, node: int) -> None:
        """Let a node transmit an acknowledgement; its airtime includes SIFS."""
        assert self._ack is not None
        self._sense(self._transmit(ACKNOWLEDGEMENT, node, self._ack, next(self._draws)), 1)
        self._nodes.due[node] = NEVER

    # Carrier sensing.

    def _sensed_by(self, node: int) -> Integers:
        """Return the nodes that sense the frames of a node, ascending, without itself."""
        if not self._access.senses:
            return self._all[:0]
        radius = self._sensing.sensing_range
        if radius is None:
            return self._topology.neighbours(node)
        assert self._positions is not None
        near = distances(self._positions(), node) <= radius
        near[node] = False
        return near.nonzero()[0]

    def _sense(self, frame: Frame, change: int) -> None:
        """Let nodes sense the start (1) or the end (-1) of a frame: its sender now, all others after the delay."""
        if not self._access.senses:
            return
        self._count(np.array([frame.src]), change)
        if self._delay:
            instant = Instant(self._env, self._env.now + self._delay, Phase.DELIVERY)
            instant.callbacks.append(lambda _: self._count(frame.sensed_by, change))
        else:
            self._count(frame.sensed_by, change)

    def _count(self, nodes: Integers, change: int) -> None:
        """Change the number of frames that some nodes sense, by 1 or -1."""
        state, now = self._nodes, self._env.now
        before = state.busy[nodes]
        state.busy[nodes] = before + change
        changed = nodes[before == (change < 0)]
        if not len(changed):
            return
        if change > 0:
            self._access.sense_busy(changed, now)
        else:
            state.idle_since[changed] = now
            self._access.sense_idle(changed, now)
            self._plan()

    # Interference.

    def _judge(self, frame: Frame, receivers: list[int]) -> dict[int, Cause]:
        """Return the causes of the losses of a frame that ends now, by receiver."""
        if not receivers or not (frame.overlapping or self._interference.has_noise):
            return {}
        nodes = np.array(receivers)
        overlap = Overlap(
            frame,
            nodes,
            frame.overlapping,
            lambda each: self._audible(each, nodes),
            lambda each: self._distances(each, nodes),
            lambda each: pair_uniform(self._seed, "interference", each.src, nodes, each.draw, symmetric=False),
            self._signal,
        )
        received = self._interference(overlap)
        if frame.locked is not None:
            received = received & frame.locked[nodes]
        lost: dict[int, Cause] = dict.fromkeys(nodes[~received].tolist(), "collision")
        deaf = {each.src for each in frame.overlapping}
        return lost | {node: "half_duplex" for node in receivers if node in deaf}

    def _audible(self, frame: Frame, nodes: Integers) -> Bools:
        """Return (k,) whether nodes are linked to the sender of a frame, and within range."""
        found: Bools = self._topology.links_to(frame.src, nodes) & (nodes != frame.src)
        found[found] = self._topology.reaches(frame.src, nodes[found], frame.draw)
        return found

    def _signal(self, frame: Frame) -> Signal:
        assert isinstance(self._medium, LoRa)
        return self._medium.signal(frame.src)

    def _distances(self, frame: Frame, nodes: Integers) -> Floats:
        """Return the (k,) distances of nodes from the sender of a frame, m."""
        assert self._positions is not None
        return distances(self._positions.of(np.append(frame.src, nodes)), 0)[1:]
