"""The network: nodes that publish records and send messages over imperfect links.

A *record* holds the state of a node. A newer record of a node supersedes an older one. The arrival of a record wakes no
process. A record whose arrival is certain is stored at once, with its arrival time; `latest_records` ignores it until
that time. A *message* stands for an event. Its arrival wakes the processes that wait at the inbox of the receiver.

`publish` sends a record, and `send` a message. Both use the same links. SimPy events are used only to wait for a host,
a transmitter or the channel, to decide losses on arrival, and to wake processes. A read in the decision phase of an
instant (`desim.kernel.core.clock.Phase`), or in a later phase, takes into account every arrival up to and including
that instant.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from desim.config.python_numbers import whole
from desim.kernel.core.clock import Clock, NodeClock
from desim.kernel.core.events import Cause, MessageCounts, Trace, TransportCounts
from desim.kernel.core.message_body import as_sent, own_copy
from desim.kernel.core.message_size import checked_size, size_of
from desim.kernel.core.ports import check_port
from desim.kernel.core.positions import PositionFunction, as_position_source
from desim.kernel.core.records import Predicate, Record, Table
from desim.kernel.core.seeds import seed_of
from desim.kernel.core.units import SECOND
from desim.kernel.link_layer.arrivals import Arrivals
from desim.kernel.link_layer.estimates import Estimates
from desim.kernel.link_layer.link_layer import LinkLayer, TransmissionListener
from desim.kernel.link_layer.propagation import LinkSampler
from desim.kernel.models.links import Links
from desim.kernel.models.transport import Transport, check_transport
from desim.kernel.state.fault_state import FaultState, Outage
from desim.kernel.state.inbox import Inbox, Inboxes, Message
from desim.kernel.state.network_state import NetworkState
from desim.kernel.state.received_records import Records
from desim.kernel.state.transmission import Lose
from desim.kernel.topology.correlated_channel import CorrelatedChannel
from desim.kernel.topology.topology import Topology
from desim.kernel.transport.layer import TransportLayer
from desim.kernel.walls.wall import Wall

if TYPE_CHECKING:
    import networkx as nx

_new = tuple.__new__  # creates a named tuple in a third of the time


class ReceivingNodes:
    """Nodes 0 .. n - 1 with the records and messages that they have received.

    `Network` adds the sending side. All methods raise ValueError for a node that does not exist.

    Args:
        state: the state of the network.
        arrivals: the arrivals whose outcome is not decided yet.
    """

    def __init__(self, state: NetworkState, arrivals: Arrivals):
        self._env, self._size = state.env, state.topology.size
        self._records, self._inboxes = state.records, state.inboxes
        self._arrivals, self._first_kept = arrivals, arrivals.kept.first
        self._has_mutable = False
        """Whether a record may have a mutable body, of which each reader gets its own copy."""

    def set_initial_belief(self, src: int, body: Any, stamp: int | None = None) -> None:
        """Give each node without a record of `src` an initial record, without a message.

        `body` and `stamp` are as in `Network.publish`.
        """
        stamp = self._env.now if stamp is None else stamp
        self._records.set_initial_belief(Record(self._node(src), 0, stamp, self._stored_body(body)))

    def insert(self, node: int, record: Record) -> None:
        """Insert a record received by other means than `Network.publish` into the table of a node.

        The record is ignored if the node is its source, or has this or a newer record of the same source.
        """
        if not (type(node) is int and 0 <= node < self._size):  # saves a call for each copy in a flood
            node = self._node(node)
        if record.src != node and self._records.is_news(node, record):  # most copies in a flood are not news
            body = self._stored_body(record.body)
            self._records.relay(node, record if body is record.body else record._replace(body=body))

    def latest_records(self, node: int) -> Table:
        """Return the newest received record of each other node, by source; cost O(new records + sources)."""
        records = self._records.latest_records(self._settled(node))
        return _with_own_bodies(records) if self._has_mutable else records

    def stamps(self, node: int) -> dict[int, int]:
        """Return the time stamp, ns, of the newest received record of each other node, by source."""
        records = self._records.latest_records(self._settled(node))
        return {src: record.stamp for src, (_, record) in records.items()}

    def settle(self) -> None:
        """Decide and count the outcomes of all arrivals up to and including this instant."""
        self._arrivals.settle_for_reader()
        self._arrivals.count_losses()

    def matching(self, node: int) -> Table:
        """Return the latest records whose body satisfies the predicate; cost O(new records + matches)."""
        records = self._records.matching(self._settled(node))
        return _with_own_bodies(records) if self._has_mutable else records

    def inbox(self, node: int, port: str = "") -> Inbox:
        """Return the inbox of a node at a port."""
        if not (type(node) is int and 0 <= node < self._size):  # saves a call for each inbox
            node = self._node(node)
        if not isinstance(port, str):
            check_port(port, f"node {node}")  # type: ignore[unreachable]
        return self._inboxes.at(port)[node]

    def _settled(self, node: int) -> int:
        """Decide all arrivals at a node up to now; return the id of the node as `_node` does."""
        if not (type(node) is int and 0 <= node < self._size):  # saves a call for each read
            node = self._node(node)
        if self._first_kept[node] <= self._env.now:
            self._arrivals.settle_for_reader(node)
        return node

    def _stored_body(self, body: Any) -> Any:
        """Return the body of a record as it is stored: a copy if its sender could change it later."""
        stored = as_sent(body)
        self._has_mutable |= stored is not body
        return stored

    def _forget(self, node: int) -> None:
        """Delete the received records and the unread messages of a node."""
        self._records.forget(node)
        self._inboxes.clear(node)

    def _node(self, node: Any) -> int:
        """Return the id of a node, an integer of any type, as an `int`.

        Raises:
            ValueError: if the id is not an integer, or there is no such node.
        """
        number = node if type(node) is int else whole(node, "a node")
        if not 0 <= number < self._size:
            raise ValueError(f"there is no node {number}: the nodes are 0 .. {self._size - 1}")
        return number


def _with_own_bodies(records: Table) -> Table:
    """Return records with copies of their mutable bodies, which the reader may change."""
    return {src: (arrival, record._replace(body=own_copy(record.body))) for src, (arrival, record) in records.items()}


class Network(ReceivingNodes):
    """Nodes 0 .. n - 1 that communicate over the edges of a graph.

    The methods that read what a node has received are those of `ReceivingNodes`. All methods raise ValueError for a
    node that does not exist.

    Args:
        env: the clock of the simulation.
        graph: the communication graph of the nodes 0 .. n - 1; see `desim.kernel.models.graphs.Edge` for edge
            attributes.
        links: the models of the links; an ideal network if None.
        seed: the seed of all random draws of the network.
        positions: returns the current (n, 2) positions, m, see `desim.kernel.core.positions`; required for a finite
            range.
        trace: receives the events of messages, if its `wants_messages` is true.
        fault_state: the active faults; None: the network has no faults.
        predicate: selects, by their bodies, the records that `matching` returns; if None, `matching` returns none.
        clocks: the clocks of the nodes, by which they find their TDMA slots; if empty, all show the true time.
        inboxes: creates the inboxes, given the clock and the number of nodes.
        walls: the walls; those that block radio weaken signals.
        link_layer: creates the link layer, which carries transmissions; its arguments are those of `LinkLayer`.

    Raises:
        ValueError: if the graph and the links do not fit together, or a finite range has no positions; see `Topology`
            and `desim.kernel.link_layer.propagation.LinkSampler`.

    Attributes:
        topology: the links of the graph, and which of them are within range.
        estimates: estimates of the delays and the density of the network, for time-outs.
        accepted: number of calls of `publish` and `send` whose arguments were valid. A call that is not accepted raises
            ValueError and changes no number and no draw. If an accepted call raises, the error is one of a watcher or a
            model: the message may then be counted and not sent, and the network should not be used any more.
    """

    def __init__(
        self,
        env: Clock,
        graph: "nx.Graph[int]",
        links: Links | None = None,
        *,
        seed: int = 0,
        positions: PositionFunction | None = None,
        trace: Trace | None = None,
        fault_state: FaultState | None = None,
        predicate: Predicate | None = None,
        clocks: Sequence[NodeClock] = (),
        inboxes: Callable[[Clock, int], Inboxes] = Inboxes,
        walls: Sequence[Wall] = (),
        link_layer: Callable[[NetworkState, Links, LinkSampler, Trace | None, int], LinkLayer] = LinkLayer,
    ):
        links, seed = Links() if links is None else links, seed_of(seed)
        self.topology = topology = Topology(
            graph,
            links.range,
            positions,
            links.reception,
            per_link=links.fading == "per_link",
            seed=seed,
            channel=CorrelatedChannel(links.coherence, seed, len(graph)) if links.fading == "correlated" else None,
            now=lambda: env.now / SECOND,
            walls=walls,
        )
        sampler = LinkSampler(links, graph, seed, positions)
        self.estimates = Estimates(topology, links.medium, sampler)
        state = NetworkState(
            env,
            topology,
            None if positions is None else as_position_source(positions),
            fault_state,
            Records(env, topology.size, predicate, repeats=sampler.duplicates_messages),
            inboxes(env, topology.size),
            clocks or [NodeClock(env)] * topology.size,
        )
        message_trace = trace if trace is not None and trace.wants_messages else None
        self._link_layer = link_layer(state, links, sampler, message_trace, seed)
        super().__init__(state, self._link_layer.delivery.arrivals)
        self._fault_state, self._transmit = fault_state, self._link_layer.transmit
        self._transport, self._is_plain = links.transport, links.transport.is_plain
        self._transport_layer = TransportLayer(state, self.estimates, trace, self._transmit)
        self._seq = [0] * topology.size
        self.accepted = 0

    # Sending.

    def publish(self, src: int, body: Any, size: int | None = None, stamp: int | None = None) -> None:
        """Broadcast the state of `src` to its neighbours as a record; unlike `send`, it wakes no process.

        The cost is O(1) in a complete graph with a constant latency, without a range, losses, active faults, a trace
        and listeners. Otherwise the cost grows with the number of nodes linked to `src`.

        Kept equal to an event per record and receiver by
        `tests/kernel/test_network.py::test_publish_is_observationally_equal_to_one_event_per_record`.

        Args:
            src: the node that publishes.
            body: its state. Each receiver gets a copy, unless the body is immutable; later changes by the sender have
                no effect, see `desim.kernel.core.message_body.as_sent`.
            size: the size of the message, bytes; computed from the body if None, see `desim.kernel.core.message_size`.
            stamp: the time stamp, by the clock of `src`, ns; the true time if None.

        Raises:
            ValueError: if the size is not an integer of at least 0, or the body has no size or cannot be copied.
        """
        src, stored = self._node(src), self._stored_body(body)
        size = size_of(stored) if size is None else checked_size(size)
        self.accepted += 1
        self._transmit(src, None, self._next_record(src, stored, stamp), size)

    def send(
        self,
        src: int,
        dst: int | None,
        body: Any,
        port: str = "",
        *,
        size: int | None = None,
        transport: Transport | None = None,
        only: Collection[int] | None = None,
    ) -> None:
        """Send a message to one node, or to all neighbours (None); its arrival wakes the processes that wait for it.

        The message goes to the inbox of the receiver at `port`; `size` is as in `publish`. `transport` carries the
        message, and may retransmit it (`desim.kernel.models.transport`); None: that of the links (`Links.transport`).
        All messages at a port should have the same transport. With `only`, a message to all neighbours is for the nodes
        in `only`: it is transmitted as any broadcast, and the other nodes ignore it. A transport that does more than
        hand messages to the links sends it to each of these nodes instead.

        Use `send` for requests, acknowledgements and tokens, where every message matters; use `publish` for state,
        where only the newest value matters. A transmission to a node that is not linked to the sender is lost, and so
        is one that fails the range check (see `Links.range_check`). Each receiver gets a copy of the body, unless it is
        immutable; later changes by the sender have no effect, see `desim.kernel.core.message_body.as_sent`.

        Raises:
            ValueError: if the receiver is the sender, the size is not an integer of at least 0, the body has no size or
                cannot be copied, the port is not a text, the transport is invalid, or not that of the port.
        """
        src = self._node(src)
        if dst is not None:
            dst = self._node(dst)
        if dst == src:
            raise ValueError(f"node {src} should not send messages to itself")
        if not isinstance(port, str):
            check_port(port, "send")  # type: ignore[unreachable]
        if transport is not None:
            check_transport(transport)
        sent = as_sent(body)
        size = size_of(sent) if size is None else checked_size(size)
        chosen = self._transport if transport is None else transport
        is_plain = self._is_plain if transport is None else chosen.is_plain
        if not is_plain:
            self._transport_layer.choose(port, chosen)
        self.accepted += 1
        self._inboxes.has_mutable |= sent is not body
        message = _new(Message, (src, self._env.now, sent))
        if is_plain:
            self._transmit(src, dst, message, size, port, only)
            return
        receivers: Sequence[int | None] = [dst]
        if only is not None:
            receivers = [node for node in self.topology.neighbours(src).tolist() if node in only]
        for receiver in receivers:
            self._transport_layer.send(src, receiver, message, port, size, chosen)

    def listen(self, by_port: Mapping[str, Transport]) -> None:
        """Let all nodes receive frames of transports before this process sends any; see `TransportLayer.listen`.

        Args:
            by_port: the transports of the ports whose transport is not that of the links.
        """
        self._transport_layer.listen(self._transport, by_port)

    def next_record(self, src: int, body: Any, stamp: int | None = None) -> Record:
        """Return a new record of a node, for a protocol that spreads records by other means than `publish`."""
        return self._next_record(self._node(src), self._stored_body(body), stamp)

    def _next_record(self, src: int, stored: Any, stamp: int | None) -> Record:
        """Return a new record of a node, given the body to store (`_stored_body`)."""
        self._seq[src] = seq = self._seq[src] + 1
        return _new(Record, (src, seq, self._env.now if stamp is None else stamp, stored))

    def overhear(self, listener: TransmissionListener) -> None:
        """Register a function to call whenever a transmission starts; see `link_layer.TransmissionListener`."""
        self._link_layer.overhear(listener)

    def watch_losses(self, watch: Lose) -> None:
        """Register a function to call when losses are counted, with the transmission and their causes by receiver.

        A loss on arrival is counted at its time or, if nothing depends on it, when a later read or `settle` decides it.
        """
        self._link_layer.watch_losses(watch)

    # Faults and counts.

    def crash(self, node: int, cause: Cause = "crash") -> Outage:
        """Take the radio of a node down: it neither sends nor receives, and its unfinished transmissions are lost.

        Messages are lost with this cause, unless a later crash of the node has another. Return the outage, which
        `recover` ends.

        Raises:
            ValueError: if the network was created without a `FaultState`, or its faults are planned (see `FaultState`).
        """
        node = self._node(node)
        outage = self.fault_state.crash(node, cause)
        self._link_layer.crash(node, cause)
        return outage

    def recover(self, node: int, outage: Outage | None = None, *, memory: bool = True) -> None:
        """End one crash of a node; if `memory` is false, delete its received records and unread messages.

        Args:
            node: the node.
            outage: what `crash` returned; None: the last crash ends.
            memory: whether the node keeps what it has received.

        Raises:
            ValueError: if the network was created without a `FaultState`, its faults are planned, or the node is not
                down.
        """
        node = self._node(node)
        self.fault_state.recover(node, outage)
        if not memory:
            self._forget(node)
        self._transport_layer.recover(node, memory=memory)

    @property
    def fault_state(self) -> FaultState:
        """The active faults.

        Raises:
            ValueError: if the network was created without a `FaultState`.
        """
        if self._fault_state is None:
            raise ValueError("a network with faults should be created with a fault_state")
        return self._fault_state

    def message_counts(self) -> MessageCounts:
        """Return the counts of messages up to now; each sent message is delivered, lost or in flight."""
        return self._link_layer.message_counts()

    def transport_counts(self) -> TransportCounts | None:
        """Return the counts of transports up to now; None if no message has needed a transport."""
        return self._transport_layer.counts()
