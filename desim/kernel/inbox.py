"""Inboxes: where messages wait to be read, and who waits for them is woken."""

from bisect import bisect_left
from math import inf
from typing import Any, NamedTuple

import simpy
from simpy.events import EventPriority

from desim.kernel.clock import Clock, Instant, Phase
from desim.kernel.records import Arrival


class Message(NamedTuple):
    """Something one node told others."""

    src: int
    sent: int
    """When it was sent, ns."""
    body: Any


Letter = tuple[int, int, Message]
"""When a message arrives, ns; its number in the order of departure; the message."""


class Inbox:
    """Where messages wait to be read. Waiting for one never consumes it, so a time-out cannot swallow it."""

    __slots__ = ("_alarm", "_bell", "_env", "_mail", "_sorted", "_turn")

    def __init__(self, env: Clock, node: int):
        self._env = env
        self._turn = int(Phase.DECISION) + node
        self._mail: list[Letter] = []
        """What has arrived or will."""
        self._sorted = 0
        """How much of it is in order, from its beginning on."""
        self._bell: simpy.Event | None = None
        self._alarm: float = inf
        """When the bell will ring for mail that has yet to arrive, ns."""

    def arrival(self, priority: int | None = None) -> simpy.Event:
        """Return an event that happens as soon as there is mail: now, if there is some already.

        Args:
            priority: of the event among those of its instant; that of a decision of the node if None.
        """
        if priority is not None:
            self._turn = priority
        bell = self._bell or self._env.event()
        self._bell = bell
        self._expect_first()
        return bell

    def drain(self) -> list[Message]:
        """Return the mail that has arrived and not been read, oldest first, and empty the box."""
        mail, now = self._in_order(), self._env.now
        end = len(mail) if mail and mail[-1][0] <= now else bisect_left(mail, (now + 1,))
        arrived = mail[:end]
        del mail[:end]
        self._sorted = len(mail)
        return [message for _, _, message in arrived]

    def in_flight(self) -> int:
        """Return how many messages have yet to arrive."""
        return sum(arrival > self._env.now for arrival, _, _ in self._mail)

    def _in_order(self) -> list[Letter]:
        """Return the mail in the order in which it arrives."""
        if self._sorted < len(self._mail):
            self._mail.sort()
            self._sorted = len(self._mail)
        return self._mail

    def _expect_first(self) -> None:
        """See to it that the bell rings when the first mail arrives."""
        if self._mail:
            self._expect(self._in_order()[0][0])

    def _expect(self, arrival: int) -> None:
        """See to it that the bell rings when mail arrives, unless it does so before."""
        if arrival <= self._env.now:
            self._ring()
        elif arrival < self._alarm:
            self._alarm = arrival
            Instant(self._env, arrival, Phase.DELIVERY).callbacks.append(self._wake)

    def _wake(self, _: simpy.Event) -> None:
        self._alarm = inf
        if self._bell is not None:
            self._expect_first()

    def _ring(self) -> None:
        """Let the event that is waited for, if any, happen in this instant's phase of decisions."""
        bell, self._bell = self._bell, None
        if bell is not None:
            bell._ok, bell._value = True, None
            self._env.schedule(bell, EventPriority(self._turn))


def deliver(message: Message, boxes: list[Inbox], receivers: list[int], arrival: Arrival, number: int) -> None:
    """Let a message arrive in the boxes of its receivers, after those of lower number, and wake who waits for one."""
    if isinstance(arrival, int):
        letter = arrival, number, message
        for node in receivers:
            box = boxes[node]
            box._mail.append(letter)
            if box._bell is not None:
                box._expect(arrival)
    else:
        for node, when in zip(receivers, arrival, strict=True):
            box = boxes[node]
            box._mail.append((when, number, message))
            if box._bell is not None:
                box._expect(when)
