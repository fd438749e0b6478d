"""The transport layer: the senders and receivers of transports, above the link layer.

Frames of all transports arrive at one port, where the layer takes them at the instant of their arrival. What it
delivers goes to the inbox of the port to which it was sent.

The state of a node survives a crash with memory: its senders rest while its radio is down, and continue when it is up
again. After a crash without memory a node numbers its messages anew, in a new session, and remembers nothing of what
it has received. A message whose acknowledgement was lost may then be delivered a second time.
"""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import count
from math import inf
from typing import Any, Literal

from desim.config.model import MAX_TIME
from desim.kernel.clock import Clock, NodeClock, Phase
from desim.kernel.events import Trace, TransportCounts
from desim.kernel.fault_state import FaultState
from desim.kernel.inbox import Inboxes, Message, deliver
from desim.kernel.retransmission import first_timeout
from desim.kernel.topology import Topology
from desim.kernel.transport import Reliable, Transport
from desim.kernel.transport_frames import Acknowledgement, Frame, Piece, Segment, Skip, acknowledgement_size
from desim.kernel.transport_log import Flow, TransportLog
from desim.kernel.transport_receiver import CodedReceiver, Expectation, ReliableReceiver
from desim.kernel.transport_sender import CodedSender, Endpoint, ReliableSender, Sender

PORT = "transport frames"
"""The port at which frames arrive."""
FIRST_DELIVERY = 1 << 48
"""The number of the first delivery: at one instant, deliveries come after messages without a transport."""


class TransportLayer:
    """Carries messages under the transports of their ports.

    Args:
        env: the clock of the simulation.
        topology: the current neighbours of the nodes.
        inboxes: receive the frames, and the messages that are delivered.
        fault_state: the active faults; None: the network has no faults.
        clocks: the clocks of the nodes.
        trace: receives the events of transports; None if they are not needed.
        transmit: hands a message to the link layer, given its sender, receiver, size and port.
        latency: returns the typical latency of the network, s.
        sending_time: returns the time, s, for which a message of a size, bytes, keeps its sender from sending the next.
    """

    def __init__(
        self,
        env: Clock,
        topology: Topology,
        inboxes: Inboxes,
        fault_state: FaultState | None,
        clocks: Sequence[NodeClock],
        trace: Trace | None,
        *,
        transmit: Callable[[int, int | None, Message, int, str], object],
        latency: Callable[[], float],
        sending_time: Callable[[int], float],
    ):
        self._env, self._topology, self._inboxes, self._fault_state = env, topology, inboxes, fault_state
        self._clocks, self._transmit, self._latency, self._sending_time = clocks, transmit, latency, sending_time
        self._log = TransportLog(env, trace)
        self._transports: dict[str, Transport] = {}
        """By port."""
        self._endpoints = [self._endpoint(node) for node in range(topology.size)]
        self._senders: list[dict[Flow, Sender]] = [{} for _ in self._endpoints]
        self._receivers: list[dict[Flow, ReliableReceiver | CodedReceiver]] = [{} for _ in self._endpoints]
        self._expectations: list[dict[tuple[str, int, str], Expectation]] = [{} for _ in self._endpoints]
        """By node: its expectations, by kind (a message, "deadline", or any frame, "lease"), sender and port."""
        self._boxes = inboxes.at(PORT)
        self._numbers = count(FIRST_DELIVERY)
        for node in range(topology.size):
            self._listen(node)

    def send(self, src: int, dst: int | None, message: Message, port: str, size: int, transport: Transport) -> None:
        """Send a message of a size, bytes, to a node, or to all neighbours (None), under a transport.

        Raises:
            ValueError: if messages at this port have another transport.
        """
        known = self._transports.setdefault(port, transport)
        if known is not transport and known != transport:
            raise ValueError(f"a port has one transport: {port!r} has {known!r} (got {transport!r})")
        flow = Flow(src, dst, port)
        sender = self._senders[src].get(flow)
        if sender is None:
            kind = ReliableSender if isinstance(transport, Reliable) else CodedSender
            sender = self._senders[src][flow] = kind(flow, transport, self._endpoints[src])  # type: ignore[arg-type]
        sender.send(message, size, self._topology.neighbours(src).tolist() if dst is None else [dst])

    def resume(self, node: int) -> None:
        """Let the senders of a node continue, whose radio may be up again."""
        for sender in self._senders[node].values():
            sender.resume()

    def forget(self, node: int) -> None:
        """Let a node lose its memory."""
        self._endpoints[node].session = self._env.now
        for sender in self._senders[node].values():
            sender.forget()
        for expectation in self._expectations[node].values():
            expectation.drop()
        for table in (self._senders, self._receivers, self._expectations):
            table[node].clear()

    def counts(self) -> TransportCounts:
        """Return the counts of all transports up to now."""
        return self._log.counts()

    # Senders.

    def _endpoint(self, node: int) -> Endpoint:
        """Create the endpoint of a node."""
        is_up = partial(self._is_up, node)
        return Endpoint(self._env, self._clocks[node], self._log, self._send_frame, self._auto_timeout, is_up)

    def _is_up(self, node: int) -> bool:
        return self._fault_state is None or not self._fault_state.down(node)

    def _send_frame(self, src: int, dst: int | None, stamp: int, frame: Frame, size: int) -> None:
        self._transmit(src, dst, Message(src, stamp, frame), size, PORT)

    def _auto_timeout(self, transport: Reliable, size: int, receivers: int) -> float:
        """Return the first time-out "auto", s, of a frame of a size, bytes, that some receivers acknowledge."""
        answers = receivers * self._sending_time(acknowledgement_size(transport.window))
        return first_timeout(self._latency(), self._sending_time(size) + answers, transport.min_timeout)

    # Receivers.

    def _listen(self, node: int) -> None:
        """Take the next frames of a node as they arrive."""
        event = self._boxes[node].arrival(Phase.DELIVERY + 1 + node)
        event.callbacks.append(lambda _: self._receive(node))

    def _receive(self, node: int) -> None:
        """Process the frames that have arrived at a node."""
        for src, stamp, frame in self._boxes[node].drain():
            transport = self._transports[frame.port]
            if transport.lease < inf:
                self._expect(node, "lease", src, frame.port, transport.lease)
            if isinstance(frame, Acknowledgement):
                sender = self._senders[node].get(Flow(node, None if frame.to_all else src, frame.port))
                if isinstance(sender, ReliableSender):
                    sender.acknowledge(src, stamp, frame)
            else:
                self._take(node, src, stamp, frame, transport)
        self._listen(node)

    def _take(self, node: int, src: int, stamp: int, frame: Segment | Skip | Piece, transport: Transport) -> None:
        """Deliver what a frame makes deliverable, and acknowledge the frame under a reliable transport.

        A frame of a sender that has lost its memory since is ignored.
        """
        flow = Flow(src, None if frame.to_all else node, frame.port)
        receiver = self._receivers[node].get(flow)
        if receiver is not None and receiver.session > frame.session:
            return
        if receiver is None or receiver.session < frame.session:
            receiver = self._receivers[node][flow] = _receiver(frame, transport)
        arrived: Any = receiver.receive(src, stamp, frame)  # type: ignore[arg-type]  # a port has one transport
        for seq, message, attempt in arrived:
            self._deliver(node, flow, seq, message, attempt, transport)
        if isinstance(receiver, ReliableReceiver) and isinstance(transport, Reliable):
            answer = Acknowledgement(frame.port, frame.to_all, frame.session, receiver.expected, receiver.beyond())
            self._log.acknowledgements += 1
            self._send_frame(node, src, self._env.now, answer, acknowledgement_size(transport.window))

    def _deliver(self, node: int, flow: Flow, seq: int, message: Message, attempt: int, transport: Transport) -> None:
        """Put a message into the inbox of its port, unless its lifespan has ended by the clock of the receiver."""
        now = self._env.now
        if transport.lifespan < inf:
            age = self._clocks[node].at(now) - self._clocks[flow.src].at(message.stamp)
            if age >= transport.lifespan:
                self._log.expire(flow, node, seq)
                return
        self._log.deliver(flow, node, seq, message, attempt)
        deliver(message, self._inboxes.at(flow.port), [node], now, next(self._numbers))
        if transport.deadline < inf:
            self._expect(node, "deadline", flow.src, flow.port, transport.deadline)

    def _expect(self, node: int, what: Literal["deadline", "lease"], src: int, port: str, within: float) -> None:
        """Let a node expect a message, or any frame, of another within a time, s, by its own clock."""
        known = self._expectations[node].get((what, src, port))
        if known is None and within <= MAX_TIME:
            tell = self._log.miss_deadline if what == "deadline" else self._log.lose_liveliness

            def miss() -> None:
                if self._is_up(node):
                    tell(src, node, port)

            duration, priority = self._clocks[node].span(within), Phase.RELAY + node
            known = Expectation(self._env, priority, duration, miss, again=what == "deadline")
            self._expectations[node][what, src, port] = known
        if known is not None:
            known.meet()


def _receiver(frame: Segment | Skip | Piece, transport: Transport) -> ReliableReceiver | CodedReceiver:
    """Create the receiver of a flow, given its first frame."""
    if isinstance(frame, Piece):
        assert not isinstance(transport, Reliable)
        return CodedReceiver(frame.session, transport.needed)
    assert isinstance(transport, Reliable)
    return ReliableReceiver(frame.session, frame.base, ordered=transport.ordered)
