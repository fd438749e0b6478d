"""The senders of transports: they store the messages that are not acknowledged yet, and transmit them again.

A flow is the messages of one node at one port to one receiver, or to all its neighbours. Each flow has a sender, with
one timer for all its messages.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from heapq import heappop, heappush
from math import inf
from typing import NamedTuple

from desim.config.model import MAX_TIME
from desim.kernel.core.clock import NEVER, Clock, NodeClock, Phase, Timer
from desim.kernel.core.events import GiveUp
from desim.kernel.models.transport import BestEffort, Coded, Reliable
from desim.kernel.state.inbox import Message
from desim.kernel.transport.frames import (
    FRAME,
    SKIP_SIZE,
    Acknowledgement,
    CodedPiece,
    Segment,
    Skip,
    piece_size,
)
from desim.kernel.transport.log import MessageFlow, TransportLog

_new = tuple.__new__  # creates a named tuple in a third of the time
MAX_GROWTH = 100
"""Number of attempts after which a time-out stops growing."""
MAX_TIMEOUTS = 64
"""Maximum number of computed time-outs that a sender keeps; few of them differ."""


def first_timeout(latency: float, sending_time: float, min_timeout: float) -> float:
    """Return the time-out of a first attempt, s: 5/4 of a round trip, at least `min_timeout`.

    Args:
        latency: the one-way latency, s.
        sending_time: the sum of the `Estimates.sending_time`, s, of the message, of its acknowledgements, and of the
            messages that may be queued in front of them.
        min_timeout: the least time-out, s.
    """
    return max(2.5 * latency + 1.25 * sending_time, min_timeout)


@dataclass
class Endpoint:
    """The part of a node that all its senders use."""

    env: Clock
    clock: NodeClock
    """The local clock."""
    log: TransportLog
    transmit: Callable[[int, int | None, Message, int], object]
    """Transmits a frame of the node (first argument), in a message, to one node, or to all (None), given its size,
    bytes."""
    auto_timeout: Callable[[Reliable, int, int], float]
    """Returns the first time-out, s, for `timeout = "auto"`, given the size, bytes, and the number of receivers."""
    is_up: Callable[[], bool]
    """Returns whether the radio of the node is up."""
    session: int = 0
    """The time at which the node began to number its messages, ns: 0, or when it lost its memory."""


@dataclass(slots=True)
class Owed:
    """The state of a message at one receiver that has not acknowledged it.

    The message is outstanding (the receiver may not have it), or held: the receiver has it, and waits for earlier ones.
    """

    due: int
    """When to act next, ns, or `NEVER`: repeat an outstanding message; tell the receiver of a held one not to wait."""
    attempts: int = 0
    is_held: bool = False


class Entry(NamedTuple):
    """A message that some receivers have not acknowledged."""

    seq: int
    message: Message
    size: int
    """Bytes, without the header of the transport."""
    expires: int
    """The end of its lifespan, ns, or `NEVER`."""
    owed: dict[int, Owed]
    """The state of the message at each receiver that has not acknowledged it."""


class ReliableSender:
    """A sender that repeats its messages until they are acknowledged, given up or superseded.

    Args:
        flow: the messages.
        model: the transport.
        endpoint: the node that sends them.
    """

    def __init__(self, flow: MessageFlow, model: Reliable, endpoint: Endpoint):
        self._flow, self._model, self._endpoint, self._log = flow, model, endpoint, endpoint.log
        self._capacity = model.depth if model.history == "keep_last" else inf
        self._entries: dict[int, Entry] = {}
        """The messages that some receivers have not acknowledged, by sequence number, ascending."""
        self._next = 1
        """The sequence number of the next message."""
        self._unsent = 1
        """The first sequence number that has not been transmitted."""
        self._acknowledged: dict[int, int] = {}
        """The time stamp, ns, of the newest acknowledgement of each receiver."""
        self._timer = Timer(endpoint.env, Phase.RELAY + flow.src, self.advance)
        # By a clock that wanders, the true duration of a time-out depends on when it begins, so none is cached.
        is_cached = not endpoint.clock.wanders
        self._timeout = lru_cache(MAX_TIMEOUTS)(self._timeout_after) if is_cached else self._timeout_after

    def send(self, message: Message, size: int, receivers: Iterable[int]) -> None:
        """Accept a message for some receivers, and transmit it if the window allows."""
        now, lifespan = self._endpoint.env.now, self._model.lifespan
        expires = NEVER if lifespan > MAX_TIME else now + self._endpoint.clock.span(lifespan)
        owed = {node: Owed(NEVER) for node in receivers}
        self._log.submitted += len(owed)
        self._entries[self._next] = Entry(self._next, message, size, expires, owed)
        self._next += 1
        if len(self._entries) > self._capacity:
            self._drop(next(iter(self._entries.values())), "superseded")
        self.advance()

    def acknowledge(self, node: int, stamp: int, acknowledgement: Acknowledgement) -> None:
        """Process an acknowledgement, with its time stamp, ns; ignore it if a newer one has overtaken it."""
        if stamp < self._acknowledged.get(node, 0) or acknowledgement.session != self._endpoint.session:
            return
        self._acknowledged[node] = stamp
        now, received = self._endpoint.env.now, set(acknowledgement.received)
        must_advance = False
        for entry in self._sent():
            owed = entry.owed.get(node)
            if owed is None:
                continue
            if entry.seq < acknowledgement.expected or (entry.seq in received and not self._model.ordered):
                self._finish(entry, node)
                must_advance |= not entry.owed
            elif owed.is_held != (entry.seq in received):  # a receiver that has lost its memory holds it no longer
                owed.is_held, must_advance = not owed.is_held, True
                owed.due = NEVER if owed.is_held else now
        # `_close_gap` comes first in the condition, because it must always be called.
        if self._close_gap(node) or must_advance:
            self.advance()

    def advance(self) -> None:
        """Perform all actions that are due, transmit the messages that the window allows, and set the timer."""
        if not self._endpoint.is_up():
            return
        now = self._endpoint.env.now
        while self._entries and (first := next(iter(self._entries.values()))).expires <= now:
            self._drop(first, "lifespan")
        for entry in self._sent():
            for node, owed in [(node, owed) for node, owed in entry.owed.items() if owed.due <= now]:
                self._act(entry, node, owed)
        while self._unsent < self._next and self._unsent < next(iter(self._entries), self._unsent) + self._model.window:
            unsent = self._entries.get(self._unsent)
            self._unsent += 1
            if unsent is not None:
                self._transmit(unsent)
        if (due := self._next_due()) < NEVER:
            self._timer.set(due)

    def resume(self) -> None:
        """Advance at this instant, because the radio of the node may be up again."""
        self._timer.set(self._endpoint.env.now)

    def forget(self) -> None:
        """Give up all messages, because the node has lost its memory."""
        self._timer.stop()
        for entry in list(self._entries.values()):
            self._drop(entry, "memory_loss")

    def _sent(self) -> list[Entry]:
        """Return the messages that have been transmitted and are not acknowledged by all, ascending."""
        sent: list[Entry] = []
        for entry in self._entries.values():
            if entry.seq >= self._unsent:
                break
            sent.append(entry)
        return sent

    def _next_due(self) -> int:
        """Return the time of the next action, ns, or `NEVER`."""
        first = next(iter(self._entries.values()), None)
        if first is None:
            return NEVER
        due = first.expires
        for entry in self._sent():
            for owed in entry.owed.values():
                if owed.due < due:  # takes half of the time of `min`
                    due = owed.due
        return due

    def _transmit(self, entry: Entry) -> None:
        """Transmit a message for the first time, to all its receivers at once."""
        self._send_segment(entry, self._flow.dst, next(iter(self._entries)), 1)
        self._log.attempts += len(entry.owed)
        if not entry.owed:
            del self._entries[entry.seq]
            return
        due = self._endpoint.env.now + self._timeout(entry.size, len(entry.owed), 0)
        for owed in entry.owed.values():
            owed.attempts, owed.due = 1, due

    def _act(self, entry: Entry, node: int, owed: Owed) -> None:
        """Repeat a message to a receiver, tell the receiver of a held message not to wait, or give the message up."""
        if owed.attempts > self._model.max_repeats:
            self._log.given_up(self._flow, node, entry.seq, "repeats")
            self._finish(entry, node)
            self._close_gap(node)
            return
        first = self._first(node)
        assert first is not None
        owed.due = self._endpoint.env.now + self._timeout(entry.size, len(entry.owed), owed.attempts)
        owed.attempts += 1
        if owed.is_held:
            skip = Skip(self._flow.port, self._flow.dst is None, self._endpoint.session, first.seq)
            message = Message(self._flow.src, self._endpoint.env.now, skip)
            self._endpoint.transmit(self._flow.src, node, message, SKIP_SIZE)
        else:
            self._log.retransmitted(self._flow, node, entry.seq, owed.attempts)
            self._send_segment(entry, node, first.seq, owed.attempts)

    def _send_segment(self, entry: Entry, dst: int | None, base: int, attempt: int) -> None:
        flow, message = self._flow, entry.message
        segment = _new(
            Segment, (flow.port, flow.dst is None, self._endpoint.session, entry.seq, base, attempt, message.body)
        )
        self._endpoint.transmit(flow.src, dst, _new(Message, (flow.src, message.stamp, segment)), entry.size + FRAME)

    def _timeout_after(self, size: int, receivers: int, attempts: int) -> int:
        """Return the time-out of a message to some receivers after a number of attempts, ns of true time from now."""
        model = self._model
        first = model.timeout
        if first == "auto":
            first = self._endpoint.auto_timeout(model, size + FRAME, receivers)
        # A bounded exponent: a float to a higher power raises OverflowError before `min` could bound it.
        grown = min(first * model.backoff ** min(attempts, MAX_GROWTH), model.max_timeout)
        return self._endpoint.clock.span(max(first, grown))

    def _drop(self, entry: Entry, cause: GiveUp) -> None:
        """Give up a message to all receivers that have not acknowledged it."""
        del self._entries[entry.seq]
        for node in entry.owed:
            self._log.given_up(self._flow, node, entry.seq, cause)
            self._close_gap(node)

    def _finish(self, entry: Entry, node: int) -> None:
        """End the transport of a message to one receiver: it has the message, or does not get it any more."""
        del entry.owed[node]
        if not entry.owed:
            del self._entries[entry.seq]

    def _first(self, node: int) -> Entry | None:
        """Return the first message that a receiver has not acknowledged; None if it has not been transmitted yet."""
        for entry in self._entries.values():
            if node in entry.owed:
                return entry if entry.seq < self._unsent else None
        return None

    def _close_gap(self, node: int) -> bool:
        """Plan to tell a receiver not to wait if it holds the first message that it has not acknowledged.

        The earlier messages, for which it waits, have then been given up. Return whether the plan is new.
        """
        first = self._first(node)
        if first is None or not (owed := first.owed[node]).is_held or owed.due < NEVER:
            return False
        owed.attempts, owed.due = 0, self._endpoint.env.now
        return True


class CodedSender:
    """A sender that transmits the pieces of its messages, each once; under best effort a message is a single piece.

    Args:
        flow: the messages.
        model: the transport.
        endpoint: the node that sends them.
    """

    def __init__(self, flow: MessageFlow, model: Coded | BestEffort, endpoint: Endpoint):
        self._flow, self._model, self._endpoint = flow, model, endpoint
        self._next = 1
        """The sequence number of the next message."""
        self._waiting: list[tuple[int, int, int, Message, int, int]] = []
        """A heap of the pieces to be transmitted: time, ns; numbers of the message and of the piece; the message, its
        bytes and the number of its receivers."""
        self._timer = Timer(endpoint.env, Phase.RELAY + flow.src, self.advance)

    def send(self, message: Message, size: int, receivers: Iterable[int]) -> None:
        """Accept a message, and transmit its first piece."""
        now, count = self._endpoint.env.now, len(list(receivers))
        self._endpoint.log.submitted += count
        if isinstance(self._model, Coded):
            size = piece_size(size, self._model.needed)
        spacing = self._endpoint.clock.span(self._model.spacing)
        for part in range(1, self._model.pieces + 1):
            heappush(self._waiting, (now + (part - 1) * spacing, self._next, part, message, size, count))
        self._next += 1
        self.advance()

    def advance(self) -> None:
        """Transmit the pieces that are due, and set the timer; a node whose radio is down drops them."""
        now, flow, waiting = self._endpoint.env.now, self._flow, self._waiting
        while waiting and waiting[0][0] <= now:
            _, seq, part, message, size, count = heappop(waiting)
            if self._endpoint.is_up():
                piece = CodedPiece(flow.port, flow.dst is None, self._endpoint.session, seq, part, message.body)
                self._endpoint.log.attempts += count
                self._endpoint.transmit(flow.src, flow.dst, Message(flow.src, message.stamp, piece), size)
        if waiting:
            self._timer.set(waiting[0][0])

    def resume(self) -> None:
        """Advance at this instant, because the radio of the node may be up again."""
        self._timer.set(self._endpoint.env.now)

    def forget(self) -> None:
        """Drop all pieces that wait, because the node has lost its memory."""
        self._timer.stop()
        self._waiting.clear()


Sender = ReliableSender | CodedSender
