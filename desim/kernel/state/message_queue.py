"""A queue of the messages of all nodes, for a caller that reads them together."""

from bisect import bisect_left
from itertools import repeat
from operator import itemgetter

from desim.kernel.core.clock import Clock
from desim.kernel.core.message_body import is_immutable, own_copy
from desim.kernel.core.ports import ReservedPort
from desim.kernel.core.records import Arrival, per_receiver
from desim.kernel.state.inbox import Inboxes, Message

_TIME = itemgetter(0)
QueuedMessage = tuple[int, int, int, Message, str]
"""A message in the queue: arrival time (ns), number of its transmission, receiver, message, port."""


class MessageQueue(Inboxes):
    """Inboxes that put the messages of all nodes into one queue, except those at the ports of the simulator itself.

    Kept equal to messages in the inboxes of processes by
    `tests/kernel/test_stepped_network.py::test_a_stepped_network_is_the_network_of_a_process`.
    """

    def __init__(self, env: Clock, size: int):
        super().__init__(env, size)
        self._queue: list[QueuedMessage] = []
        self._newest, self._is_in_order = -1, True
        """The greatest number of a transmission so far, and whether the numbers have ascended since the last `take`."""

    def deliver(self, message: Message, port: str, receivers: list[int], arrival: Arrival, number: int) -> None:
        """Put a message into the queue once for each receiver; see `Inboxes.deliver`."""
        if isinstance(port, ReservedPort):
            super().deliver(message, port, receivers, arrival, number)
            return
        times = per_receiver(arrival, len(receivers))
        self._is_in_order &= number > self._newest
        self._newest = max(number, self._newest)
        messages: repeat[Message] | list[Message] = repeat(message)
        if self.has_mutable and not is_immutable(message.body):
            messages = [message._replace(body=own_copy(message.body)) for _ in receivers]
        self._queue += zip(times, repeat(number), receivers, messages, repeat(port))

    def can_wait(self, port: str) -> bool:
        """Return whether the messages at a port wait in the queue, which wakes no process."""
        return not isinstance(port, ReservedPort)

    def take(self) -> list[QueuedMessage]:
        """Remove and return the messages that have arrived, in the order of arrival, transmission and receiver."""
        queue = self._queue
        # Sorting is stable: if the queue is in the order of transmission, simultaneous messages keep that order, so
        # only times are compared, three times as fast. What was in flight at the last `take` is sorted already.
        queue.sort(key=_TIME if self._is_in_order else None)
        self._is_in_order = True
        end = bisect_left(queue, (self._env.now + 1,))
        arrived = queue[:end]
        del queue[:end]
        return arrived

    def in_flight(self) -> int:
        """Return the number of messages in flight, counted once per receiver."""
        now = self._env.now
        return super().in_flight() + sum(arrival > now for arrival, *_ in self._queue)
