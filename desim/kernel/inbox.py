"""Inboxes: where messages wait to be read, and who waits for them is woken."""

from heapq import heappop, heappush
from math import inf
from typing import Any, NamedTuple

import simpy
from simpy.events import EventPriority

from desim.kernel.clock import Clock, Instant, Phase


class Message(NamedTuple):
    """Something one node told others."""

    src: int
    sent: int
    """When it was sent, ns."""
    body: Any


class Inbox:
    """Where messages wait to be read. Waiting for one never consumes it, so a time-out cannot swallow it."""

    def __init__(self, env: Clock, node: int):
        self._env = env
        self._turn = int(Phase.DECISION) + node
        self._mail: list[tuple[int, int, Message]] = []
        """A heap of what has arrived or will: arrival, order of departure, message."""
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
        self._expect()
        return bell

    def drain(self) -> list[Message]:
        """Return the mail that has arrived and not been read, oldest first, and empty the box."""
        now, mail = self._env.now, []
        while self._mail and self._mail[0][0] <= now:
            mail.append(heappop(self._mail)[2])
        return mail

    def put(self, message: Message, arrival: int, number: int) -> None:
        """Let a message arrive at an instant, after those of lower number, and wake who waits for one."""
        heappush(self._mail, (arrival, number, message))
        if self._bell is not None:
            self._expect()

    def in_flight(self) -> int:
        """Return how many messages have yet to arrive."""
        return sum(arrival > self._env.now for arrival, _, _ in self._mail)

    def _expect(self) -> None:
        """See to it that the bell rings when the first mail arrives."""
        if not self._mail:
            return
        first = self._mail[0][0]
        if first <= self._env.now:
            self._ring()
        elif first < self._alarm:
            self._alarm = first
            Instant(self._env, first, Phase.DELIVERY).callbacks.append(self._wake)

    def _wake(self, _: simpy.Event) -> None:
        self._alarm = inf
        if self._bell is not None:
            self._expect()

    def _ring(self) -> None:
        """Let the event that is waited for, if any, happen in this instant's phase of decisions."""
        bell, self._bell = self._bell, None
        if bell is not None:
            bell._ok, bell._value = True, None
            self._env.schedule(bell, EventPriority(self._turn))
