"""The transmitters of a network, with their queues of waiting messages.

A node transmits one message at a time; further messages wait in a FIFO queue. On a shared channel all nodes use one
queue: ideal medium access without overhead or collisions.
"""

from bisect import bisect_left
from collections import OrderedDict, deque
from collections.abc import Callable, Collection, Iterator
from itertools import islice

from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.units import nanoseconds
from desim.kernel.models.medium import Medium, airtimes
from desim.kernel.state.transmission import Transmission


class Transmitter:
    """The transmitters of all nodes, or the shared channel of all nodes.

    A transmission waits while its channel is busy, and then occupies the channel for its airtime. If a node has more
    than `queue_limit` waiting transmissions, its oldest is dropped.

    Kept equal to a channel for which no other node contends by
    `tests/kernel/test_access.py::test_a_node_that_transmits_alone_contends_as_it_transmits`.

    Args:
        env: the clock of the simulation.
        medium: the model of the medium.
        size: number of nodes.
        leave: called with a transmission and its airtime, ns, when the transmission starts.
        wait: called when a transmission has to wait.
        drop: called when a waiting transmission is dropped.
        lag: the sum of the processing delays of sender and receiver, ns. A message arrives this long after the end of
            its reception; its outcome is decided at its arrival or later.

    Attributes:
        recent: for half duplex, start (ns), end (ns) and node of the recent transmissions, by start.
    """

    def __init__(
        self,
        env: Clock,
        medium: Medium,
        size: int,
        leave: Callable[[Transmission, int], None],
        wait: Callable[[Transmission], None],
        drop: Callable[[Transmission], None],
        lag: int = 0,
    ):
        self._env, self._medium = env, medium
        self._leave, self._wait, self._drop = leave, wait, drop
        self._airtime_of = airtimes(medium)
        self.channels = 1 if medium.shared else size
        # A shared channel serves the transmissions of all nodes in order, and a node with a full queue drops its oldest
        # one. A waiting transmission is in the queue of its channel and in that of its node, so both actions are O(1).
        self._waiting: list[OrderedDict[int, Transmission]] = [OrderedDict() for _ in range(self.channels)]
        """The waiting transmissions of each channel, by number."""
        self._node_queues: list[deque[Transmission]] = [deque() for _ in range(size)]
        """The waiting transmissions of each node."""
        self._free_at = [0] * self.channels
        self._total_airtime = 0
        self.recent: list[tuple[int, int, int]] = []
        self._lag, self._longest_airtime = lag, 0

    def enqueue(self, item: Transmission) -> None:
        """Start a transmission now, or when the channel is free."""
        channel = self._channel(item.src)
        waiting = self._waiting[channel]
        if not waiting and self._env.now >= self._free_at[channel]:
            self._begin(channel, item)
            return
        self._wait(item)
        waiting[item.number] = item
        node_queue = self._node_queues[item.src]
        node_queue.append(item)
        if len(waiting) == 1:
            self._await_turn(channel)
        if len(node_queue) > self._medium.queue_limit:
            oldest = node_queue.popleft()
            del waiting[oldest.number]
            self._drop(oldest)

    def flush(self, src: int) -> list[Transmission]:
        """Remove and return all waiting transmissions of a node."""
        flushed = list(self._node_queues[src])
        self._node_queues[src].clear()
        waiting = self._waiting[self._channel(src)]
        for item in flushed:
            del waiting[item.number]
        return flushed

    def waiting(self) -> Iterator[Transmission]:
        """Yield the waiting transmissions."""
        return (item for waiting in self._waiting for item in waiting.values())

    def busy_time(self) -> int:
        """Return the total time, ns, that the channels have been busy so far."""
        return self._total_airtime - portable_sum(max(0, free_at - self._env.now) for free_at in self._free_at)

    def during(self, nodes: Collection[int], first: int, last: int) -> dict[int, list[tuple[int, int]]]:
        """Return start and end, ns, of the recent transmissions of some nodes that may overlap receptions, by node.

        Args:
            nodes: the nodes that receive.
            first: the earliest end of a reception, ns; not before the last time given to `forget`.
            last: the latest end of a reception, ns.
        """
        by_node: dict[int, list[tuple[int, int]]] = {}
        # A reception began at most the longest airtime before its end, and a transmission that overlaps it at most the
        # longest airtime before the reception.
        since = bisect_left(self.recent, (first - 2 * self._longest_airtime,))
        for begin, end, node in islice(self.recent, since, None):
            if begin >= last:
                break
            if node in nodes:
                by_node.setdefault(node, []).append((begin, end))
        return by_node

    def forget(self, before: float) -> None:
        """Forget the transmissions that are not needed to decide arrivals from a time (ns) on."""
        del self.recent[: bisect_left(self.recent, (before - 2 * self._longest_airtime - self._lag,))]

    def _channel(self, node: int) -> int:
        """Return the number of the channel on which a node transmits."""
        return 0 if self._medium.shared else node

    def _begin(self, channel: int, item: Transmission) -> None:
        now, duration = self._env.now, nanoseconds(self._airtime_of(item.size, item.src))
        self._free_at[channel] = now + duration
        self._total_airtime += duration
        if self._medium.half_duplex and not self._medium.shared:
            self._longest_airtime = max(self._longest_airtime, duration)
            self.recent.append((now, now + duration, item.src))
        self._leave(item, duration)

    def _await_turn(self, channel: int) -> None:
        Instant(self._env, self._free_at[channel], Phase.DELIVERY).callbacks.append(lambda _: self._next(channel))

    def _next(self, channel: int) -> None:
        waiting = self._waiting[channel]
        if not waiting or self._env.now < self._free_at[channel]:
            return  # the transmission for which this event was scheduled has been removed, or has started
        _, item = waiting.popitem(last=False)
        self._node_queues[item.src].popleft()
        self._begin(channel, item)
        if waiting:
            self._await_turn(channel)
