"""The network: nodes that publish records and send messages over imperfect links.

A *record* is the state of a node: a newer record of a source supersedes an older one, and its arrival wakes no process.
`publish` therefore needs no SimPy event: it stores the arrival time of the record for each receiver, and the record is
visible to reads from then on. A *message* is an event: `send` wakes a process that waits at the inbox of the receiver,
and needs a SimPy event only if one waits. Both use the same links. A read in the decision phase of an instant, or
later, returns exactly the records and messages that have arrived up to and including that instant.

If messages can still be lost on arrival (faults, range check at delivery, half duplex), each arrival is a SimPy event.
"""

from collections import Counter
from collections.abc import Mapping
from functools import cached_property, partial
from itertools import compress, count
from typing import TYPE_CHECKING, Any, NamedTuple

from desim.kernel.clock import SECOND, Clock, Instant, Phase
from desim.kernel.events import LOST, Broadcast, Cause, Lost, MessageCounts, Queued, Sent, Trace
from desim.kernel.fault_state import FaultState
from desim.kernel.inbox import Inbox, Message, deliver
from desim.kernel.links import Links
from desim.kernel.medium import Unlimited
from desim.kernel.message_size import as_sent, size_of
from desim.kernel.positions import PositionSource
from desim.kernel.propagation import LinkSampler
from desim.kernel.records import Arrival, Predicate, Record, Records, Table, per_receiver
from desim.kernel.topology import Topology
from desim.kernel.transmitter import Transmitter

if TYPE_CHECKING:
    import networkx as nx
    import simpy


_new = tuple.__new__  # creates a named tuple in a third of the time


class Transmission(NamedTuple):
    """One transmission: a record or a message, with its receivers."""

    number: int
    src: int
    created: int
    """Time of the call of `publish` or `send`, ns."""
    size: int
    """Bytes."""
    receivers: list[int]
    content: Record | Message
    port: str
    """Port of the inbox, for a message."""
    reachable: bool
    """Whether the receiver of `send` was linked and within range; True for a broadcast."""


class Network:
    """Nodes 0 .. n - 1 that communicate over the edges of a graph.

    Args:
        env: the clock of the simulation.
        graph: the communication graph; its nodes are 0 .. n - 1, see `desim.kernel.graphs.Edge` for its edges.
        links: the models of the links; an ideal network if None.
        seed: the seed of all random draws of the network.
        positions: returns the current (n, 2) positions, m, see `desim.kernel.positions`; required for a finite range.
        trace: receives the events of messages, if its `wants_messages` is true.
        fault_state: the active faults; None: the network has no faults.
        predicate: selects the bodies of the records that `matching` returns.
    """

    def __init__(
        self,
        env: Clock,
        graph: "nx.Graph[int]",
        links: Links | None = None,
        *,
        seed: int = 0,
        positions: PositionSource | None = None,
        trace: Trace | None = None,
        fault_state: FaultState | None = None,
        predicate: Predicate | None = None,
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
        size = self.topology.size
        self._sampler = LinkSampler(links, graph, seed, positions)
        self._fault_state = fault_state
        self._checks_departure, self._checks_arrival = links.range_check != "delivery", links.range_check != "send"
        self._settles_on_arrival = self._checks_arrival or fault_state is not None or links.medium.half_duplex
        self._medium = links.medium
        self._transmitter: Transmitter[Transmission] | None = None
        if not isinstance(links.medium, Unlimited):
            self._transmitter = Transmitter(
                env, links.medium, size, self._leave, self._wait, self._overflow, self._sampler.processing
            )
        self._may_lose = fault_state is not None or not self._sampler.lossless or self._transmitter is not None
        self._records = Records(env, size, predicate)
        self._ports: dict[str, list[Inbox]] = {}
        self._trace = trace if trace is not None and trace.wants_messages else None
        self._seq = [count(1) for _ in range(size)]
        self._numbers = count()
        self._crashes: dict[int, list[int]] = {}
        self._sent = self._arriving = self._transmissions = self._bytes_sent = 0
        self._lost: Counter[Cause] = Counter()

    # Operations of nodes.

    def set_initial_belief(self, src: int, body: Any, sent: int | None = None) -> None:
        """Give all nodes an initial record of `src` without a message; `sent` as in `publish`."""
        self._records.set_initial_belief(Record(src, 0, self._env.now if sent is None else sent, as_sent(body)))

    def publish(self, src: int, body: Any, size: int | None = None, sent: int | None = None) -> None:
        """Broadcast the state of `src` to its neighbours as a record; use `send` to wake the receivers.

        The cost is O(1) if the record reaches all nodes at the same time, else O(neighbours).

        Args:
            src: the node that publishes.
            body: its state. All receivers share one object and must not change it; later changes by the sender have no
                effect, see `desim.kernel.message_size.as_sent`.
            size: the size of the message, bytes; computed from the body if None, see `desim.kernel.message_size`.
            sent: the time stamp, by the clock of `src`, ns; the true time if None.
        """
        self._transmit(src, None, self.next_record(src, body, sent), size)

    def send(self, src: int, dst: int | None, body: Any, *, port: str = "", size: int | None = None) -> None:
        """Send a message to one node, or to all neighbours (None); it wakes the processes that wait at the inbox.

        Use `send` for requests, acknowledgements and tokens, where every message matters; use `publish` for state,
        where only the newest value matters. A message to a node that is out of range at transmission is lost. All
        receivers share one body and must not change it; later changes by the sender have no effect, see
        `desim.kernel.message_size.as_sent`.

        Raises:
            ValueError: if the receiver does not exist or is the sender.
        """
        if dst is not None and not 0 <= dst < self.topology.size:
            raise ValueError(f"there is no node {dst}: the nodes are 0 .. {self.topology.size - 1}")
        if dst == src:
            raise ValueError(f"node {src} should not send messages to itself")
        self._transmit(src, dst, _new(Message, (src, self._env.now, as_sent(body))), size, port)

    def next_record(self, src: int, body: Any, sent: int | None = None) -> Record:
        """Return the next record of a node, for a protocol that disseminates it without `publish`."""
        return _new(Record, (src, next(self._seq[src]), self._env.now if sent is None else sent, as_sent(body)))

    def insert(self, node: int, record: Record) -> None:
        """Insert a record that a node received by other means than `publish`, unless it has a newer one."""
        if record.src != node:
            self._records.insert(node, record)

    def latest_records(self, node: int) -> Table:
        """Return the newest record of each other source that `node` has received; cost O(new records + sources)."""
        return self._records.latest_records(node)

    def matching(self, node: int) -> Table:
        """Return those of `latest_records` whose body satisfies the predicate; cost O(new records + matches)."""
        return self._records.matching(node)

    def inbox(self, node: int, port: str = "") -> Inbox:
        """Return the inbox of a node at a port."""
        return self._boxes(port)[node]

    def _boxes(self, port: str) -> list[Inbox]:
        """Return the inboxes of all nodes at a port."""
        if port not in self._ports:
            self._ports[port] = [Inbox(self._env, node) for node in range(self.topology.size)]
        return self._ports[port]

    def neighbours(self, node: int) -> list[int]:
        """Return the nodes that can receive from `node` now, ascending; see `Topology.neighbours`."""
        found: list[int] = self.topology.neighbours(node).tolist()
        return found

    def audible(self, node: int) -> list[int]:
        """Return the nodes that `node` can receive from now, ascending; on an undirected graph its neighbours."""
        return self.topology.audible(node)

    def component(self, node: int) -> set[int]:
        """Return the nodes that `node` can receive from now over any number of hops, and itself; O(nodes + links)."""
        reached, ahead = {node}, [node]
        while ahead and len(reached) < self.topology.size:
            new = set(self.audible(ahead.pop())) - reached
            reached |= new
            ahead += new
        return reached

    @cached_property
    def mean_degree(self) -> float:
        """The mean number of neighbours of a node, computed at the first access."""
        return self.topology.mean_degree

    def airtime(self, body: Any) -> float:
        """Return the airtime of a message with this body, s."""
        return self._medium(size_of(body))

    @cached_property
    def typical_latency(self) -> float:
        """Estimate of the mean one-way latency, with processing delays, without airtime and queueing, s."""
        return self._sampler.typical_latency()

    # Faults and counts.

    def crash(self, node: int) -> None:
        """Take the radio of a node down: it neither sends nor receives, and its unfinished transmissions are lost.

        Raises:
            ValueError: if the network was created without a `FaultState`.
        """
        self.fault_state.crash(node)
        self._crashes.setdefault(node, []).append(self._env.now)
        for transmission in self._transmitter.flush(node) if self._transmitter is not None else ():
            self._lose(transmission, transmission.receivers, "crash")

    def recover(self, node: int, *, memory: bool = True) -> None:
        """End one crash of a node; without memory its received records and waiting messages are deleted."""
        self.fault_state.recover(node)
        if not memory:
            self._records.forget(node)
            for boxes in self._ports.values():
                boxes[node].drain()

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
        now, lost = self._env.now, self._lost.total()
        in_flight = self._arriving + self._records.in_flight()
        in_flight += sum(box.in_flight() for boxes in self._ports.values() for box in boxes)
        busy = 0.0
        if self._transmitter is not None:
            in_flight += sum(len(transmission.receivers) for transmission in self._transmitter.waiting())
            busy = self._transmitter.airtime() / (self._transmitter.channels * now) if now else 0.0
        delivered = self._sent - lost - in_flight
        by_cause = {cause: self._lost[cause] for cause in sorted(+self._lost)}  # + drops causes without losses
        return MessageCounts(
            now, self._sent, delivered, lost, in_flight, by_cause, self._transmissions, self._bytes_sent, busy
        )

    # The steps of a transmission.

    def _transmit(self, src: int, dst: int | None, content: Record | Message, size: int | None, port: str = "") -> None:
        """Pass a new transmission to the transmitter of its node, unless the radio is down."""
        if self._fault_state is not None and self._fault_state.down(src):
            return
        number, reachable, topology = next(self._numbers), True, self.topology
        if dst is None:
            receivers = topology.hearers(src, number) if self._checks_departure else topology.linked(src)
        else:
            receivers = [dst]
            reachable = topology.are_linked(src, dst) and not self._is_out_of_range(src, dst, number)
        if size is None:
            size = size_of(content.body)
        transmission = _new(Transmission, (number, src, self._env.now, size, receivers, content, port, reachable))
        self._sent += len(receivers)
        if self._transmitter is None:
            self._leave(transmission, 0)
        else:
            self._transmitter.enqueue(transmission)

    def _is_out_of_range(self, src: int, dst: int, number: int) -> bool:
        """Return whether a range check at transmission fails for a receiver."""
        return self._checks_departure and not self.topology.reaches(src, dst, number)

    def _wait(self, transmission: Transmission) -> None:
        if self._trace is not None:
            dst = tuple(transmission.receivers)
            self._trace.append_message(
                Queued(self._env.now, transmission.number, transmission.src, dst, transmission.size)
            )

    def _overflow(self, transmission: Transmission) -> None:
        self._lose(transmission, transmission.receivers, "queue")

    def _leave(self, transmission: Transmission, airtime: int) -> None:
        """Start a transmission with an airtime (ns): draw its losses and schedule its arrivals."""
        now, receivers = self._env.now, transmission.receivers
        self._transmissions += 1
        self._bytes_sent += transmission.size
        arrival = self._sampler.arrivals(transmission.src, receivers, now, airtime, transmission.size)
        causes = self._losses(transmission) if self._may_lose or not transmission.reachable else {}
        reached = receivers
        if causes:
            reached = [node for node in receivers if node not in causes]
            if not isinstance(arrival, int):
                arrival = [when for node, when in zip(receivers, arrival, strict=True) if node not in causes]
        if self._sampler.keeps_order:
            arrival = self._sampler.in_order(transmission.src, reached, arrival)
        if self._trace is not None:
            self._record(transmission, causes, arrival)
        for node, cause in causes.items():
            self._lose(transmission, [node], cause)
        if self._settles_on_arrival:
            self._schedule_arrivals(transmission, reached, arrival, airtime)
        elif isinstance(transmission.content, Record):
            self._records.schedule(transmission.content, reached, arrival)
        else:
            deliver(transmission.content, self._boxes(transmission.port), reached, arrival, transmission.number)

    def _losses(self, transmission: Transmission) -> dict[int, Cause]:
        """Return the receivers for which a transmission is lost at its start, with the causes."""
        src, receivers, causes = transmission.src, transmission.receivers, dict[int, Cause]()
        lost = self._sampler.losses(src, receivers, self._env.now, transmission.size)
        if lost is not None:
            causes |= dict.fromkeys(compress(receivers, lost), "loss")
        if self._fault_state is not None:
            causes |= {node: "partition" for node in receivers if self._fault_state.cut(src, node)}
        if transmission.created < self._env.now:  # it waited, and its receivers may have moved out of range
            causes |= {
                node: "out_of_range" for node in receivers if self._is_out_of_range(src, node, transmission.number)
            }
        return causes if transmission.reachable else dict.fromkeys(receivers, "out_of_range")

    def _schedule_arrivals(
        self, transmission: Transmission, reached: list[int], arrival: Arrival, airtime: int
    ) -> None:
        """Schedule an event for each arrival time of a transmission, at which losses on arrival are decided."""
        self._arriving += len(reached)
        nodes_by_arrival: dict[int, list[int]] = {}
        if isinstance(arrival, int):
            nodes_by_arrival = {arrival: reached} if reached else {}
        else:
            for node, when in zip(reached, arrival, strict=True):
                nodes_by_arrival.setdefault(when, []).append(node)
        for when, nodes in nodes_by_arrival.items():
            Instant(self._env, when, Phase.DELIVERY).callbacks.append(
                partial(self._land, transmission, nodes, (self._env.now, self._env.now + airtime))
            )

    def _land(self, transmission: Transmission, nodes: list[int], interval: tuple[int, int], _: "simpy.Event") -> None:
        """Deliver a transmission to nodes now, or lose it there; it was transmitted in `interval` (start, end), ns."""
        self._arriving -= len(nodes)
        for node in nodes:
            cause = self._obstacle(transmission, node, interval)
            if cause is not None:
                self._lose(transmission, [node], cause)
            elif isinstance(transmission.content, Record):
                self._records.insert(node, transmission.content)
            else:
                deliver(
                    transmission.content, self._boxes(transmission.port), [node], self._env.now, transmission.number
                )

    def _obstacle(self, transmission: Transmission, node: int, interval: tuple[int, int]) -> Cause | None:
        """Return the cause for which a message that arrives now is lost, or None."""
        faults, (begin, end) = self._fault_state, interval
        if faults is not None:
            if faults.down(node) or any(begin <= t < end for t in self._crashes.get(transmission.src, ())):
                return "crash"
            if faults.cut(transmission.src, node):
                return "partition"
            if faults.jammed(node):
                return "jamming"
        if self._checks_arrival and not self.topology.reaches(transmission.src, node, transmission.number):
            return "out_of_range"
        left = self._env.now - self._sampler.processing
        transmitting = self._transmitter is not None and self._transmitter.transmitted(node, left, end - begin)
        return "half_duplex" if transmitting else None

    def _lose(self, transmission: Transmission, nodes: list[int], cause: Cause) -> None:
        self._lost[cause] += len(nodes)
        if self._trace is not None:
            for node in nodes:
                self._trace.append_message(Lost(self._env.now, transmission.number, transmission.src, node, cause))

    def _record(self, transmission: Transmission, causes: Mapping[int, Cause], arrival: Arrival) -> None:
        """Append a transmission to the trace, with its arrival times, or `LOST` where it is lost at transmission."""
        assert self._trace is not None
        number, src, created, size, receivers, content = transmission[:6]
        now, fates = self._env.now, arrival
        if causes:
            arrivals = iter(per_receiver(arrival, len(receivers)))
            fates = [LOST if node in causes else next(arrivals) for node in receivers]
        if isinstance(content, Record):
            fate = (fates,) * bool(receivers) if isinstance(fates, int) else tuple(fates)
            event = Broadcast(now, number, src, content.seq, tuple(receivers), fate, created, size, content.body)
            self._trace.append_message(event)
        else:
            for node, arrives in zip(receivers, per_receiver(fates, len(receivers)), strict=True):
                self._trace.append_message(Sent(now, number, src, node, arrives, created, size, content.body))
