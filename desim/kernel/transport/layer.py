"""The transport layer: the senders and receivers of transports, above the link layer.

Frames of all transports arrive at one port, where the layer processes them at the instant of their arrival. It delivers
each message to the inbox of the port to which the message was sent.

The state of a node survives a crash with memory: its senders pause while its radio is down, and continue when it is up
again. After a crash without memory a node numbers its messages anew, in a new session, and has forgotten what it has
received. A message whose acknowledgement was lost may then be delivered a second time.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from math import inf
from typing import Any, Literal

from desim.config.arguments import value_text
from desim.config.model import MAX_TIME
from desim.kernel.core.clock import Phase
from desim.kernel.core.events import Trace, TransportCounts
from desim.kernel.core.ports import ReservedPort
from desim.kernel.link_layer.estimates import Estimates
from desim.kernel.models.transport import Reliable, Transport
from desim.kernel.state.inbox import Message
from desim.kernel.state.network_state import NetworkState
from desim.kernel.transport.frames import (
    Acknowledgement,
    CodedPiece,
    Segment,
    Skip,
    acknowledgement_size,
)
from desim.kernel.transport.log import MessageFlow, TransportLog
from desim.kernel.transport.receiver import CodedReceiver, Expectation, ReliableReceiver
from desim.kernel.transport.sender import CodedSender, Endpoint, ReliableSender, Sender, first_timeout

PORT = ReservedPort("transport frames", __name__)
"""The port at which frames arrive."""
_new = tuple.__new__  # creates a named tuple in a third of the time
FIRST_DELIVERY = 1 << 48
"""The number of the first delivery: at one instant, deliveries come after messages without a transport."""


@dataclass
class _Node:
    """The state of a node in the transport layer."""

    endpoint: Endpoint
    senders: dict[MessageFlow, Sender] = field(default_factory=dict)
    receivers: dict[MessageFlow, ReliableReceiver | CodedReceiver] = field(default_factory=dict)
    expectations: dict[tuple[str, int, str], Expectation] = field(default_factory=dict)
    """By kind ("deadline": of a message, "lease": of any frame), sender and port."""

    def forget(self, now: int) -> None:
        """Lose the memory, and begin a new session now, ns."""
        self.endpoint.session = now
        for sender in self.senders.values():
            sender.forget()
        for expectation in self.expectations.values():
            expectation.drop()
        for table in (self.senders, self.receivers, self.expectations):
            table.clear()


class TransportLayer:
    """Carries messages under the transports of their ports.

    Most networks need no transport. The state of the nodes is therefore created when the first message is sent.

    Args:
        state: the state of the network; its inboxes receive the frames, and the messages that are delivered.
        estimates: estimates of the delays of the network, for the time-out "auto".
        trace: receives the events of transports; None if they are not needed.
        transmit: hands a message to the link layer, given its sender, receiver, content, size and port.
    """

    def __init__(
        self,
        state: NetworkState,
        estimates: Estimates,
        trace: Trace | None,
        transmit: Callable[..., object],
    ):
        self._env, self._topology, self._fault_state = state.env, state.topology, state.fault_state
        self._inboxes, self._clocks, self._estimates = state.inboxes, state.clocks, estimates
        self._transmit_frame = partial(transmit, port=PORT)
        self._log = TransportLog(state.env, trace)
        self._transports: dict[str, Transport] = {}
        """The transport of each port at which a message was sent."""
        self._default: Transport = Reliable()
        self._nodes: list[_Node] = []
        """The state of each node; empty until the first message."""
        self._numbers = count(FIRST_DELIVERY)

    def choose(self, port: str, transport: Transport) -> None:
        """Choose the transport of a port; it stays the same for all messages.

        Raises:
            ValueError: if the port has another one.
        """
        chosen = self._transports.setdefault(port, transport)
        if chosen is not transport and chosen != transport:
            raise ValueError(
                f"a port has one transport: {port!r} has {value_text(chosen)} (got {value_text(transport)})"
            )

    def send(self, src: int, dst: int | None, message: Message, port: str, size: int, transport: Transport) -> None:
        """Send a message to a node, or to all neighbours (None), under a transport.

        Args:
            src: the sender.
            dst: the receiver; None: all neighbours.
            message: the message.
            port: the port of the inbox.
            size: the size of the message, bytes.
            transport: the transport of the port (`choose`).
        """
        if not self._nodes:
            self._start()
        flow, node = MessageFlow(src, dst, port), self._nodes[src]
        sender = node.senders.get(flow)
        if sender is None:
            kind = ReliableSender if isinstance(transport, Reliable) else CodedSender
            sender = node.senders[flow] = kind(flow, transport, node.endpoint)  # type: ignore[arg-type]
        sender.send(message, size, self._topology.neighbours(src).tolist() if dst is None else [dst])

    def listen(self, default: Transport, by_port: Mapping[str, Transport]) -> None:
        """Let all nodes receive frames before this process sends any, because the senders are in other processes.

        Args:
            default: the transport of all ports but those in `by_port`, until this process sends a message at the port.
            by_port: the transports of some ports.
        """
        self._default = Reliable() if default.is_plain else default
        self._transports.update(by_port)
        if not self._nodes:
            self._start()

    def recover(self, node: int, *, memory: bool) -> None:
        """Let the senders of a node continue, because its radio may be up again; delete them first if not `memory`."""
        if not self._nodes:
            return
        if not memory:
            self._nodes[node].forget(self._env.now)
        for sender in self._nodes[node].senders.values():
            sender.resume()

    def counts(self) -> TransportCounts | None:
        """Return the counts of all transports up to now; None if no message has been sent."""
        return self._log.counts() if self._nodes else None

    def _start(self) -> None:
        """Create the state of the nodes, and let them listen for frames."""
        self._nodes = [_Node(self._endpoint(node)) for node in range(self._topology.size)]
        for node, inbox in enumerate(self._inboxes.at(PORT)):
            inbox.listen(Phase.DELIVERY + 1 + node, partial(self._receive, node))

    # Senders.

    def _endpoint(self, node: int) -> Endpoint:
        """Create the endpoint of a node."""
        is_up = partial(self._is_up, node)
        return Endpoint(self._env, self._clocks[node], self._log, self._transmit_frame, self._auto_timeout, is_up)

    def _is_up(self, node: int) -> bool:
        return self._fault_state is None or not self._fault_state.down(node)

    def _auto_timeout(self, transport: Reliable, size: int, receivers: int) -> float:
        """Return the first time-out, s, for `timeout = "auto"`, given the size of a frame, bytes, and its receivers."""
        acknowledgements = receivers * self._estimates.sending_time(acknowledgement_size(transport.window))
        sending_time = self._estimates.sending_time(size) + acknowledgements
        return first_timeout(self._estimates.latency, sending_time, transport.min_timeout)

    # Receivers.

    def _receive(self, node: int, messages: list[Message]) -> None:
        """Process the frames that have arrived at a node."""
        for src, stamp, frame in messages:
            transport = self._transports.get(frame.port, self._default)
            if transport.lease < inf:
                self._expect(node, "lease", src, frame.port, transport.lease)
            if isinstance(frame, Acknowledgement):
                flow = _new(MessageFlow, (node, None if frame.to_all else src, frame.port))
                sender = self._nodes[node].senders.get(flow)
                if isinstance(sender, ReliableSender):
                    sender.acknowledge(src, stamp, frame)
            elif isinstance(frame, CodedPiece) != isinstance(transport, Reliable):  # ignore frames of other transports
                self._take(node, src, stamp, frame, transport)

    def _take(self, node: int, src: int, stamp: int, frame: Segment | Skip | CodedPiece, transport: Transport) -> None:
        """Deliver the messages that a frame completes, and acknowledge it under a reliable transport.

        A frame of an earlier session is ignored: its sender has lost its memory since.
        """
        flow = _new(MessageFlow, (src, None if frame.to_all else node, frame.port))
        receivers = self._nodes[node].receivers
        receiver = receivers.get(flow)
        if receiver is not None and receiver.session > frame.session:
            return
        if receiver is None or receiver.session < frame.session:
            receiver = receivers[flow] = _receiver(frame, transport)
        arrived: Any = receiver.receive(src, stamp, frame)  # type: ignore[arg-type]  # a port has one transport
        for seq, message, attempt in arrived:
            self._deliver(node, flow, seq, message, attempt, transport)
        if isinstance(receiver, ReliableReceiver) and isinstance(transport, Reliable):
            fields = frame.port, frame.to_all, frame.session, receiver.expected, receiver.beyond()
            self._log.acknowledgements += 1
            message = _new(Message, (node, self._env.now, _new(Acknowledgement, fields)))
            self._transmit_frame(node, src, message, acknowledgement_size(transport.window))

    def _deliver(
        self, node: int, flow: MessageFlow, seq: int, message: Message, attempt: int, transport: Transport
    ) -> None:
        """Put a message into the inbox of its port, unless its lifespan has ended by the clock of the receiver."""
        now = self._env.now
        if transport.lifespan < inf:
            age = self._clocks[node].at(now) - self._clocks[flow.src].at(message.stamp)
            if age >= transport.lifespan:
                self._log.expired(flow, node, seq)
                return
        self._log.delivered(flow, node, seq, message, attempt)
        self._inboxes.deliver(message, flow.port, [node], now, next(self._numbers))
        if transport.deadline < inf:
            self._expect(node, "deadline", flow.src, flow.port, transport.deadline)

    def _expect(self, node: int, kind: Literal["deadline", "lease"], src: int, port: str, duration: float) -> None:
        """Let a node expect a message, or any frame, of another one within a duration, s, by its own clock."""
        expectations = self._nodes[node].expectations
        expectation = expectations.get((kind, src, port))
        if expectation is None and duration <= MAX_TIME:
            record = self._log.deadline_missed if kind == "deadline" else self._log.liveliness_lost

            def miss() -> None:
                if self._is_up(node):
                    record(src, node, port)

            span, priority = partial(self._clocks[node].span, duration), Phase.RELAY + node
            expectation = Expectation(self._env, priority, span, miss, repeats=kind == "deadline")
            expectations[kind, src, port] = expectation
        if expectation is not None:
            expectation.meet()


def _receiver(frame: Segment | Skip | CodedPiece, transport: Transport) -> ReliableReceiver | CodedReceiver:
    """Create the receiver of a flow, given its first frame."""
    if isinstance(frame, CodedPiece):
        assert not isinstance(transport, Reliable)
        return CodedReceiver(frame.session, transport.needed)
    assert isinstance(transport, Reliable)
    return ReliableReceiver(frame.session, frame.base, ordered=transport.ordered)
