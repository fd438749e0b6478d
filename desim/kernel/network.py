"""The network: nodes that publish records and send messages over imperfect links.

A *record* holds the state of a node. A newer record of a node supersedes an older one. The arrival of a record wakes no
process. A record whose arrival is certain is stored at once, with its arrival time; `latest_records` ignores it until
that time. A *message* stands for an event. Its arrival wakes the processes that wait at the inbox of the receiver.

`publish` sends a record, and `send` a message. Both use the same links. SimPy events are used only to wait for a
busy transmitter, to decide losses on arrival, and to wake processes. A read in the decision phase of an instant
(`desim.kernel.clock.Phase`), or in a later phase, takes into account every arrival up to and including that instant.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from desim.kernel.clock import SECOND, Clock, NodeClock
from desim.kernel.events import MessageCounts, Trace
from desim.kernel.fault_state import FaultState
from desim.kernel.inbox import Inbox, Inboxes, Message
from desim.kernel.link_layer import LinkLayer, Listener
from desim.kernel.links import Links
from desim.kernel.medium import Radio
from desim.kernel.message_size import as_sent, size_of
from desim.kernel.positions import PositionFunction, as_position_source
from desim.kernel.propagation import LinkSampler
from desim.kernel.records import Predicate, Record, Records, Table
from desim.kernel.topology import Topology

if TYPE_CHECKING:
    import networkx as nx


_new = tuple.__new__  # creates a named tuple in a third of the time


class Network:
    """Nodes 0 .. n - 1 that communicate over the edges of a graph.

    Args:
        env: the clock of the simulation.
        graph: the communication graph of the nodes 0 .. n - 1; see `desim.kernel.graphs.Edge` for edge attributes.
        links: the models of the links; an ideal network if None.
        seed: the seed of all random draws of the network.
        positions: returns the current (n, 2) positions, m, see `desim.kernel.positions`; required for a finite range.
        trace: receives the events of messages, if its `wants_messages` is true.
        fault_state: the active faults; None: the network has no faults.
        predicate: selects, by their bodies, the records that `matching` returns; if None, `matching` returns none.
        clocks: the clocks of the nodes, which tell the slots of a TDMA; if empty, all show the true time.

    Raises:
        ValueError: if the graph and the links do not fit together, or a finite range has no positions; see `Topology`
            and `desim.kernel.propagation.LinkSampler`.
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
    ):
        self._env = env
        links = links or Links()
        self.topology = Topology(
            graph,
            links.range,
            positions,
            links.reception,
            per_link=links.fading == "per_link",
            seed=seed,
            now=lambda: env.now / SECOND,
        )
        self._size = self.topology.size
        self._sampler = LinkSampler(links, graph, seed, positions)
        self._medium, self._fault_state = links.medium, fault_state
        self._records, self._inboxes = Records(env, self._size, predicate), Inboxes(env, self._size)
        self._link_layer = LinkLayer(
            env,
            links,
            self.topology,
            self._sampler,
            self._records,
            self._inboxes,
            fault_state,
            trace if trace is not None and trace.wants_messages else None,
            None if positions is None else as_position_source(positions),
            clocks or [NodeClock(env)] * self._size,
            seed,
        )
        self._transmit, self._arrivals = self._link_layer.transmit, self._link_layer.arrivals
        self._first_kept = self._arrivals.kept.first
        self._seq = [0] * self._size

    # Operations of nodes.

    def set_initial_belief(self, src: int, body: Any, stamp: int | None = None) -> None:
        """Give each node without a record of `src` an initial record, but send no message; `stamp` is as in `publish`.

        Raises:
            ValueError: if the node does not exist.
        """
        if not 0 <= src < self._size:
            raise self._unknown(src)
        self._records.set_initial_belief(Record(src, 0, self._env.now if stamp is None else stamp, as_sent(body)))

    def publish(self, src: int, body: Any, size: int | None = None, stamp: int | None = None) -> None:
        """Broadcast the state of `src` to its neighbours as a record; unlike `send`, it wakes no process.

        The cost is O(1) in a complete graph with a constant latency, without a range, losses, active faults, a trace
        and listeners. Otherwise the cost grows with the number of nodes linked to `src`.

        Args:
            src: the node that publishes.
            body: its state. All receivers share one object and must not change it; later changes by the sender have no
                effect, see `desim.kernel.message_size.as_sent`.
            size: the size of the message, bytes; computed from the body if None, see `desim.kernel.message_size`.
            stamp: the time stamp, by the clock of `src`, ns; the true time if None.

        Raises:
            ValueError: if the node does not exist or the size is negative.
        """
        self._transmit(src, None, self.next_record(src, body, stamp), size)

    def send(self, src: int, dst: int | None, body: Any, *, port: str = "", size: int | None = None) -> None:
        """Send a message to one node, or to all neighbours (None); its arrival wakes the processes that wait for it.

        The message goes to the inbox of the receiver at `port`; `size` is as in `publish`.

        Use `send` for requests, acknowledgements and tokens, where every message matters; use `publish` for state,
        where only the newest value matters. A message to a node that is not linked to the sender is lost, and so is one
        that fails the range check (see `Links.range_check`). All receivers share one body and must not change it; later
        changes by the sender have no effect, see `desim.kernel.message_size.as_sent`.

        Raises:
            ValueError: if a node does not exist, if the receiver is the sender, or if the size is negative.
        """
        if not 0 <= src < self._size:
            raise self._unknown(src)
        if dst is not None and not 0 <= dst < self._size:
            raise self._unknown(dst)
        if dst == src:
            raise ValueError(f"node {src} should not send messages to itself")
        self._transmit(src, dst, _new(Message, (src, self._env.now, as_sent(body))), size, port)

    def next_record(self, src: int, body: Any, stamp: int | None = None) -> Record:
        """Return a new record of a node, for a protocol that spreads records by other means than `publish`.

        Raises:
            ValueError: if the node does not exist.
        """
        if not 0 <= src < self._size:
            raise self._unknown(src)
        self._seq[src] = seq = self._seq[src] + 1
        return _new(Record, (src, seq, self._env.now if stamp is None else stamp, as_sent(body)))

    def insert(self, node: int, record: Record) -> None:
        """Insert a record received by other means than `publish` into the table of a node.

        The record is ignored if the node is its source, or has this or a newer record of the same source.

        Raises:
            ValueError: if the node does not exist.
        """
        if not 0 <= node < self._size:
            raise self._unknown(node)
        if record.src != node:
            self._records.relay(node, record)

    def latest_records(self, node: int) -> Table:
        """Return the newest received record of each other node, by source; cost O(new records + sources).

        Raises:
            ValueError: if the node does not exist.
        """
        if not 0 <= node < self._size:
            raise self._unknown(node)
        if self._first_kept[node] <= self._env.now:
            self._arrivals.settle_for_reader(node)
        return self._records.latest_records(node)

    def matching(self, node: int) -> Table:
        """Return the latest records whose body satisfies the predicate; cost O(new records + matches).

        Raises:
            ValueError: if the node does not exist.
        """
        if not 0 <= node < self._size:
            raise self._unknown(node)
        if self._first_kept[node] <= self._env.now:
            self._arrivals.settle_for_reader(node)
        return self._records.matching(node)

    def inbox(self, node: int, port: str = "") -> Inbox:
        """Return the inbox of a node at a port.

        Raises:
            ValueError: if the node does not exist.
        """
        if not 0 <= node < self._size:
            raise self._unknown(node)
        return self._inboxes.at(port)[node]

    def overhear(self, listener: Listener) -> None:
        """Register a function to call whenever a transmission starts; see `desim.kernel.link_layer.Listener`."""
        self._link_layer.overhear(listener)

    @cached_property
    def mean_degree(self) -> float:
        """The mean number of neighbours of a node at the first access; later accesses return the same number."""
        return self.topology.mean_degree

    def airtime(self, body: Any) -> float:
        """Return the airtime, s, of a message with this body."""
        return self._medium(size_of(body))

    def interval(self, body: Any) -> float:
        """Return the time, s, for which a message with this body keeps its sender from sending the next one."""
        medium, size = self._medium, size_of(body)
        return medium.interval(size, self._size) if isinstance(medium, Radio) else medium(size)

    @cached_property
    def typical_latency(self) -> float:
        """An estimate of the mean one-way latency, s, with processing delays but without airtime and queueing."""
        return self._sampler.typical_latency()

    def _unknown(self, node: int) -> ValueError:
        """Return the error about a node that does not exist."""
        return ValueError(f"there is no node {node}: the nodes are 0 .. {self._size - 1}")

    # Faults and counts.

    def crash(self, node: int) -> None:
        """Take the radio of a node down: it neither sends nor receives, and its unfinished transmissions are lost.

        Raises:
            ValueError: if the network was created without a `FaultState`, or its faults are planned (see `FaultState`).
        """
        self.fault_state.crash(node)
        self._link_layer.crash(node)

    def recover(self, node: int, *, memory: bool = True) -> None:
        """End one crash of a node; if `memory` is false, delete its received records and unread messages.

        Raises:
            ValueError: if the network was created without a `FaultState`, its faults are planned, or the node is not
                down.
        """
        self.fault_state.recover(node)
        if not memory:
            self._records.forget(node)
            self._inboxes.drain(node)

    @property
    def fault_state(self) -> FaultState:
        """The active faults.

        Raises:
            ValueError: if the network was created without a `FaultState`.
        """
        if self._fault_state is None:
            raise ValueError("a network with faults should be created with a fault_state")
        return self._fault_state

    def settle(self) -> None:
        """Decide whether each record that was due before this instant has arrived, if this has not been decided yet.

        Call this method before a fault begins or ends.
        """
        self._arrivals.settle()

    def message_counts(self) -> MessageCounts:
        """Return the counts of messages up to now; each sent message is delivered, lost or in flight."""
        return self._link_layer.message_counts()
