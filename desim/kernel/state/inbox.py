"""Inboxes: queues of received messages that wake waiting processes."""

from bisect import bisect_left, insort
from collections.abc import Callable
from math import inf
from typing import Any, NamedTuple

import simpy

from desim.kernel.core.clock import Clock, Instant, Phase, Timer
from desim.kernel.core.message_body import is_immutable, own_copy
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.records import Arrival, per_receiver
from desim.kernel.core.units import SECOND


class Message(NamedTuple):
    """A message from one node to others."""

    src: int
    stamp: int
    """True time at which the message was sent, ns."""
    body: Any

    @property
    def sent(self) -> float:
        """True time at which the message was sent, s."""
        return self.stamp / SECOND


Letter = tuple[int, int, Message]
"""A message in an inbox, as (arrival time in ns, number of its transmission, message)."""
MANY_IGNORED = 1000
"""Number of ignored messages above which those that have arrived are forgotten."""
FEW = 16
"""Ratio of all messages to new ones above which the new ones are inserted one by one, instead of sorting all."""


class Inbox:
    """The messages to one port of a node that are in flight or wait to be read.

    A node has one inbox per port; a port is any string. A message is in flight until its arrival time, and then waits
    until `drain` removes it. The event that `arrival` returns does not consume a message, so no message is lost if a
    process stops waiting at a time-out.
    """

    __slots__ = ("_env", "_ignores", "_letters", "_priority", "_sorted", "_timer", "_waited_for", "_wake_time")

    def __init__(self, env: Clock, node: int):
        self._env = env
        self._priority = Phase.DECISION + node
        self._letters: list[Letter] = []
        """All messages, waiting and in flight."""
        self._sorted = 0
        """Length of the sorted prefix of `_letters`."""
        self._waited_for: simpy.Event | None = None
        """The event that processes wait for; None if no process waits."""
        self._wake_time: float = inf
        """Time of the next scheduled wake-up for a message in flight, ns."""
        self._timer: Timer | None = None
        """Rings at the next arrival if a function takes the messages (`listen`)."""
        self._ignores: Callable[[Message], bool] | None = None
        """Returns whether the function given to `listen` does nothing with a message; None: it takes all."""

    def listen(
        self,
        priority: int,
        act: Callable[[list[Message]], object],
        ignores: Callable[[Message], bool] | None = None,
    ) -> None:
        """Call a function with the messages as they arrive, those of one instant together, until `stop`.

        It replaces the previous function, if any. No process may wait for messages meanwhile. A function takes one
        event for each instant of arrival, and a process that waits takes two.

        Kept equal to a process that waits for each arrival by
        `tests/kernel/test_inbox.py::test_a_function_that_listens_gets_what_a_process_reads`.

        Args:
            priority: the SimPy priority of the calls.
            act: the function.
            ignores: returns whether `act` would do nothing with a message, now or at any later time, for instance with
                a second copy of it: a message that is ignored once must be ignored until `stop`. An ignored message is
                dropped when it is sent, and takes no event. None: no message is dropped.
        """

        def take() -> None:
            messages = self.drain()
            if self._letters:  # in order, as `drain` leaves them; what arrives later sets the timer itself
                timer.set(self._letters[0][0])
            if messages:
                act(messages)

        self.stop()
        self._ignores = ignores
        self._timer = timer = Timer(self._env, priority, take)
        if letters := self._in_order():
            timer.set(letters[0][0])

    def stop(self) -> None:
        """End `listen`: later messages wait until they are read."""
        if self._timer is not None:
            self._timer.stop()
            self._timer = self._ignores = None

    def arrival(self, priority: int | None = None) -> simpy.Event:
        """Return an event that happens when a message arrives, or at once if one is waiting.

        Args:
            priority: the SimPy priority of the event. If None, the priority of the previous call is kept; initially it
                is the priority of the decisions of the node.
        """
        if priority is not None:
            self._priority = priority
        event = self._waited_for
        if event is None:
            event = self._waited_for = simpy.Event(self._env)
        if self._letters:
            self._trigger_or_expect()
        return event

    def drain(self) -> list[Message]:
        """Remove and return the waiting messages, in the order of arrival."""
        letters, now = self._in_order(), self._env.now
        if not letters or letters[0][0] > now:
            return []
        if len(letters) == 1 or letters[1][0] > now:  # one has arrived: the usual case if arrivals wake a process
            self._sorted -= 1
            return [letters.pop(0)[2]]
        end = len(letters) if letters[-1][0] <= now else bisect_left(letters, (now + 1,))
        arrived = letters[:end]
        del letters[:end]
        self._sorted = len(letters)
        return [message for _, _, message in arrived]

    def in_flight(self) -> int:
        """Return the number of messages in flight."""
        return sum(arrival > self._env.now for arrival, _, _ in self._letters)

    def _in_order(self) -> list[Letter]:
        """Return all messages in the order of arrival."""
        letters = self._letters
        if self._sorted < len(letters):
            if FEW * (len(letters) - self._sorted) < len(letters):
                # Sorting compares all messages with one another; inserting a new one compares it with a few.
                new_letters = letters[self._sorted :]
                del letters[self._sorted :]
                for letter in new_letters:
                    insort(letters, letter)
            else:
                letters.sort()
            self._sorted = len(letters)
        return letters

    def _trigger_or_expect(self) -> None:
        """If a message has arrived, trigger the event that processes wait for, else schedule a wake-up for the next."""
        letters = self._in_order()
        if not letters:
            return
        if (arrival := letters[0][0]) > self._env.now:
            self._expect(arrival)
            return
        event, self._waited_for = self._waited_for, None
        if event is not None:
            self._env.trigger(event, self._priority)

    def _expect(self, arrival: int) -> None:
        """Schedule a wake-up at an arrival time (ns), unless one is scheduled for that time or earlier."""
        if arrival < self._wake_time:
            self._wake_time = arrival
            Instant(self._env, arrival, Phase.DELIVERY).callbacks.append(self._wake)

    def _wake(self, _: simpy.Event) -> None:
        self._wake_time = inf
        if self._waited_for is not None:  # None: another arrival has woken the processes
            self._trigger_or_expect()


class Inboxes:
    """The inboxes of all nodes at all ports; the inboxes of a port are created when the port is first used.

    A message that its receiver ignores (`Inbox.listen`) is not put into the inbox, even if it is still in flight: its
    arrival is certain (`desim.kernel.link_layer.delivery`), so the receiver does not lose its memory until then. Two
    thirds of the messages of a flood are copies of messages that their receivers have; without events for these copies
    a run takes an eighth less time.

    Kept equal to messages that are taken and have no effect by
    `tests/kernel/test_inbox.py::test_messages_that_are_ignored_have_no_effect`.

    Attributes:
        has_mutable: whether a message with a mutable body may have been sent.
    """

    def __init__(self, env: Clock, size: int):
        self.has_mutable = False
        self._env, self._size = env, size
        self._ports: dict[str, list[Inbox]] = {}
        self._ignored: list[int] = []
        """Arrival times, ns, of messages that were not put into inboxes; `_prune` removes those that have arrived."""
        self._prune_at = MANY_IGNORED
        """Length of `_ignored` above which `_prune` is called."""

    def at(self, port: str) -> list[Inbox]:
        """Return the inbox of each node at a port."""
        boxes = self._ports.get(port)
        if boxes is None:
            boxes = self._ports[port] = [Inbox(self._env, node) for node in range(self._size)]
        return boxes

    def can_wait(self, port: str) -> bool:
        """Return whether messages at a port may be delivered after their arrival, because they wake no process."""
        return False  # `MessageQueue` overrides it

    def clear(self, node: int) -> None:
        """Drop the waiting messages of a node at all ports."""
        for boxes in self._ports.values():
            boxes[node].drain()

    def in_flight(self) -> int:
        """Return the number of messages in flight, counted once per receiver."""
        self._prune()
        return len(self._ignored) + portable_sum(box.in_flight() for boxes in self._ports.values() for box in boxes)

    def deliver(self, message: Message, port: str, receivers: list[int], arrival: Arrival, number: int) -> None:
        """Put a message into the inboxes of its receivers; its arrival wakes the processes that wait at these inboxes.

        Simultaneous messages are ordered by `number`, the number of their transmission. Each receiver gets its own copy
        of a mutable body.
        """
        boxes, copies, now = self.at(port), self.has_mutable and not is_immutable(message.body), self._env.now
        # All receivers share one letter, if nothing in it differs between them.
        shared = None if copies or not isinstance(arrival, int) else (arrival, number, message)
        for node, when in zip(receivers, per_receiver(arrival, len(receivers)), strict=True):
            box = boxes[node]
            if box._ignores is not None and box._ignores(message):
                self._ignored.append(when)
                continue
            letter = shared or (when, number, message._replace(body=own_copy(message.body)) if copies else message)
            box._letters.append(letter)
            if box._waited_for is not None:
                box._expect(when) if when > now else box._trigger_or_expect()
            elif box._timer is not None:
                box._timer.set(when)
        if len(self._ignored) > self._prune_at:
            self._prune()

    def _prune(self) -> None:
        """Forget the ignored messages that have arrived."""
        self._ignored = [arrival for arrival in self._ignored if arrival > self._env.now]
        self._prune_at = 2 * len(self._ignored) + MANY_IGNORED
