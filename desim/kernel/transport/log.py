"""The counts of the transports of a network, and their events in the trace."""

from collections import Counter
from typing import NamedTuple

from desim.kernel.core.clock import Clock
from desim.kernel.core.events import (
    DeadlineMissed,
    Delivered,
    Event,
    Expired,
    GivenUp,
    GiveUp,
    LivelinessLost,
    Retransmitted,
    Trace,
    TransportCounts,
)
from desim.kernel.state.inbox import Message

_new = tuple.__new__  # creates a named tuple in a third of the time


class MessageFlow(NamedTuple):
    """The messages of one node at one port that are numbered in one sequence."""

    src: int
    dst: int | None
    """The receiver; None: the messages are sent to all neighbours."""
    port: str


class TransportLog:
    """Counts what transports do, and appends their events to the trace.

    Args:
        env: the clock of the simulation.
        trace: receives the events; None if they are not needed.

    Attributes:
        submitted: number of messages given to a transport, one for each receiver.
        attempts: number of transmissions of messages or pieces, one for each receiver that should get it.
        acknowledgements: number of acknowledgements transmitted.
    """

    def __init__(self, env: Clock, trace: Trace | None):
        self._env, self._trace = env, trace
        self._wants_messages = trace is not None and trace.wants_messages
        self.submitted = self.attempts = self.acknowledgements = 0
        self._delivered = self._expired = self._retransmissions = self._deadlines_missed = self._liveliness_lost = (
            self._total_delay
        ) = 0
        self._given_up: Counter[GiveUp] = Counter()

    def delivered(self, flow: MessageFlow, node: int, seq: int, message: Message, attempt: int) -> None:
        """Record the delivery of a message to a node."""
        now = self._env.now
        self._delivered += 1
        self._total_delay += now - message.stamp
        is_to_all = flow.dst is None
        if self._wants_messages:
            fields = now, flow.src, node, str(flow.port), is_to_all, seq, message.stamp, attempt, message.body
            self._append(_new(Delivered, fields))

    def retransmitted(self, flow: MessageFlow, node: int, seq: int, attempt: int) -> None:
        """Record a repeated transmission of a message to a node."""
        self.attempts += 1
        self._retransmissions += 1
        if self._wants_messages:
            fields = self._env.now, flow.src, node, str(flow.port), flow.dst is None, seq, attempt
            self._append(_new(Retransmitted, fields))

    def given_up(self, flow: MessageFlow, node: int, seq: int, cause: GiveUp) -> None:
        """Record that a sender gave up a message to a node."""
        self._given_up[cause] += 1
        self._append(GivenUp(self._env.now, flow.src, node, str(flow.port), flow.dst is None, seq, cause))

    def expired(self, flow: MessageFlow, node: int, seq: int) -> None:
        """Record that a receiver dropped a message because of its age."""
        self._expired += 1
        self._append(Expired(self._env.now, flow.src, node, str(flow.port), flow.dst is None, seq))

    def deadline_missed(self, src: int, node: int, port: str) -> None:
        """Record that a node has waited too long for a message of the node `src`."""
        self._deadlines_missed += 1
        if self._trace is not None:
            self._trace.append(DeadlineMissed(self._env.now, src, node, str(port)))

    def liveliness_lost(self, src: int, node: int, port: str) -> None:
        """Record that a node has received nothing from the node `src` for the time of its lease."""
        self._liveliness_lost += 1
        if self._trace is not None:
            self._trace.append(LivelinessLost(self._env.now, src, node, str(port)))

    def counts(self) -> TransportCounts:
        """Return all counts up to now."""
        return TransportCounts(
            self._env.now,
            self.submitted,
            self._delivered,
            self._expired,
            {cause: self._given_up[cause] for cause in sorted(self._given_up)},
            self.attempts,
            self._retransmissions,
            self.acknowledgements,
            self._deadlines_missed,
            self._liveliness_lost,
            self._total_delay,
        )

    def _append(self, event: Event) -> None:
        """Append an event about a single message."""
        if self._trace is not None and self._wants_messages:
            self._trace.append_message(event)
