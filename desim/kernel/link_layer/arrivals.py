"""Arrivals whose outcome is not certain at transmission, because faults, distance or half duplex may prevent them.

All arrivals of a transmission that are due at the same instant share one SimPy event, which decides their outcomes.

A record that reaches its receivers at different times needs no event, because, unlike a message to an inbox, it wakes
no process. Its arrivals are kept, and so are those of messages to a queue that is read after each step
(`Inboxes.can_wait`). The kept arrivals at a node are decided together before the node next reads, and those at all
nodes before the next change of the faults or of the motion of a node. Until then, an outcome does not depend on when it
is decided. With 40 nodes and lognormal latencies, a simulation with a range check at delivery runs 8 times as fast as
with an event per arrival, and one with half duplex 2.8 times as fast. Arrivals cannot be kept if a trace needs each
loss at its time, if there may be faults that are not planned, or if the source of the positions does not know past
positions (`PositionSource.looks_back`).

Kept equal to one event per arrival by
`tests/kernel/test_contract.py::test_arrivals_decided_together_are_observationally_equal_to_one_event_each`.
"""

from collections import defaultdict
from collections.abc import Iterable
from math import inf
from typing import Any

from desim.kernel.channel.transmitter import Transmitter
from desim.kernel.core.clock import Instant, Phase
from desim.kernel.core.events import Cause
from desim.kernel.core.records import Arrival, Record, pairs, per_receiver
from desim.kernel.link_layer.arrival_losses import ArrivalLosses
from desim.kernel.state.network_state import NetworkState
from desim.kernel.state.transmission import Flight, Lose, Transmission

_new = tuple.__new__  # creates a named tuple in a third of the time
MAX_KEPT = 100_000
"""Number of added arrivals after which all due ones are decided, to bound the memory of nodes that do not read."""
MANY_PAST = 1000
"""Length above which the lists of certain losses and of recent transmissions are cleared of past entries."""


class KeptArrivals:
    """Arrivals that are kept until their outcomes are decided together.

    Args:
        size: number of nodes.

    Attributes:
        first: by node, the time of its first kept arrival, ns; inf if there is none.
    """

    def __init__(self, size: int) -> None:
        self.first = [inf] * size
        self._of_node: defaultdict[int, list[Any]] = defaultdict(list)
        """By node, a flat list in the order of transmission: time, flight, time, flight ..."""
        self._count = self._added = 0

    def __len__(self) -> int:
        return self._count

    def add(self, flight: Flight, nodes: list[int], times: list[int]) -> bool:
        """Keep the arrivals (times in ns) at some nodes; return whether all that are due should be decided now.

        That is the case whenever another `MAX_KEPT` arrivals have been added.
        """
        first, of_node = self.first, self._of_node
        # Two items of a flat list take less time and memory than a tuple.
        for node, when in zip(nodes, times, strict=True):
            kept = of_node[node]
            kept.append(when)
            kept.append(flight)
            if when < first[node]:
                first[node] = when
        self._count += len(nodes)
        self._added += len(nodes)
        if self._added <= MAX_KEPT:
            return False
        self._added = 0
        return True

    def take(self, nodes: Iterable[int], until: int) -> tuple[list[int], list[int], list[Flight]]:
        """Remove the arrivals at some nodes up to and including a time, ns; return receivers, times and flights."""
        receivers: list[int] = []
        times: list[int] = []
        flights: list[Flight] = []
        for node in nodes:
            if self.first[node] > until:
                continue
            later: list[Any] = []
            for when, flight in pairs(self._of_node[node]):
                if when <= until:
                    receivers.append(node)
                    times.append(when)
                    flights.append(flight)
                else:
                    later.append(when)
                    later.append(flight)
            self._of_node[node], self.first[node] = later, min(later[::2], default=inf)
        self._count -= len(flights)
        return receivers, times, flights


class Arrivals:
    """Schedules uncertain arrivals, has their losses decided, and stores what has arrived.

    Args:
        state: the state of the network; its records and inboxes receive what arrives.
        losses: decides which arrivals are lost.
        transmitter: knows which nodes transmit, for half duplex; None: nodes transmit without airtime, or contend.
        checks_range: whether a receiver must be within range on arrival.
        at_once: whether each outcome is needed at the time of the arrival, for a trace.
        lose: counts and records losses.

    Attributes:
        kept: the arrivals that are decided together.
    """

    def __init__(
        self,
        state: NetworkState,
        losses: ArrivalLosses,
        transmitter: Transmitter | None,
        *,
        checks_range: bool,
        at_once: bool,
        lose: Lose,
    ):
        topology, self._env, self._fault_state = state.topology, state.env, state.fault_state
        self._records, self._inboxes, self._transmitter, self._lose = state.records, state.inboxes, transmitter, lose
        self._losses = losses
        self._at_once = at_once or (checks_range and not topology.looks_back)
        if checks_range:
            topology.before_change(self.settle)
        if state.fault_state is not None:
            state.fault_state.before_change(self.settle)
        self._with_events = 0
        """Number of arrivals that have an event."""
        self.kept, self._all = KeptArrivals(topology.size), range(topology.size)
        self._certain_losses: list[tuple[int, Transmission, dict[int, Cause]]] = []
        """Certain losses at nodes that are down, not counted yet: time, transmission, and the cause by receiver."""
        self._count_at = self._forget_at = MANY_PAST
        """Lengths of `_certain_losses` and of `transmitter.recent` above which past entries are removed."""

    def crash(self, node: int, cause: Cause) -> None:
        """Note that the radio of a node goes down now: its transmission that is on the air is lost on arrival."""
        self._losses.crash(node, cause)

    def in_flight(self) -> int:
        """Return the number of arrivals that are not decided yet."""
        return self._with_events + len(self.kept) + len(self._certain_losses)

    def schedule(self, transmission: Transmission, nodes: list[int], arrival: Arrival, airtime: int) -> None:
        """Schedule the arrivals at some nodes of a transmission that starts now, given their times and airtime (ns)."""
        if not nodes:
            return
        now, flight = self._env.now, _new(Flight, (transmission, airtime))
        if self._transmitter is not None:
            self._losses.start(flight)
            if len(self._transmitter.recent) > self._forget_at:
                self._transmitter.forget(min(now, *self.kept.first))
                self._forget_at = 2 * len(self._transmitter.recent) + MANY_PAST
        if isinstance(arrival, int):
            self._land_at(arrival, flight, nodes, is_only=True)
        elif self._can_wait(transmission):
            if self.kept.add(flight, nodes, arrival):
                self.settle()
        else:
            nodes_by_time: dict[int, list[int]] = {}
            for node, when in zip(nodes, arrival, strict=True):
                nodes_by_time.setdefault(when, []).append(node)
            for when, simultaneous in nodes_by_time.items():
                self._land_at(when, flight, simultaneous, is_only=len(nodes_by_time) == 1)

    def _land_at(self, when: int, flight: Flight, nodes: list[int], *, is_only: bool) -> None:
        """Schedule the arrival of a transmission at some nodes at a time, ns; `is_only`: see `_land`."""
        land = Instant(self._env, when, Phase.DELIVERY)
        land.callbacks.append(lambda _: self._land(flight, nodes, is_only=is_only))
        self._with_events += len(nodes)

    def lose_at(self, transmission: Transmission, nodes: list[int], arrival: Arrival) -> None:
        """Lose a transmission at some nodes that will still be down at its arrival times (ns); count each loss then.

        Kept equal to losses at their times by
        `tests/kernel/test_faults.py::test_a_crash_on_the_air_is_the_same_with_a_trace_and_if_another_node_is_down`.
        """
        if not nodes:
            return
        if self._at_once:
            self.schedule(transmission, nodes, arrival, 0)
            return
        times = per_receiver(arrival, len(nodes))
        assert self._fault_state is not None
        losses: list[dict[int, Cause]] = [{node: self._fault_state.down_cause(node) or "crash"} for node in nodes]
        self._certain_losses += [(when, transmission, causes) for causes, when in zip(losses, times, strict=True)]
        if len(self._certain_losses) > self._count_at:
            self.count_losses()
            self._count_at = 2 * len(self._certain_losses) + MANY_PAST

    def count_losses(self) -> None:
        """Count the certain losses up to now."""
        now = self._env.now
        for when, transmission, causes in self._certain_losses:
            if when <= now:
                self._lose(transmission, causes)
        self._certain_losses = [entry for entry in self._certain_losses if entry[0] > now]

    def settle_for_reader(self, node: int | None = None) -> None:
        """Decide the kept arrivals at a node, or at all nodes (None), up to and including this instant.

        If a fault has yet to begin or end at this instant, arrivals at this instant wait for it: it may change their
        outcomes.
        """
        now = self._env.now
        changes = self._fault_state is not None and self._fault_state.changes_by(now)
        self._settle(now - 1 if changes else now, self._all if node is None else (node,))

    def settle(self) -> None:
        """Decide the kept arrivals before this instant."""
        if self.kept and min(self.kept.first) < self._env.now:
            self._settle(self._env.now - 1, self._all)

    def _settle(self, until: int, nodes: Iterable[int]) -> None:
        """Decide the kept arrivals at some nodes up to and including a time, ns."""
        receivers, times, flights = self.kept.take(nodes, until)
        if not flights:
            return
        causes = self._losses.causes(receivers, times, flights)
        if causes:
            for k, cause in causes.items():
                self._lose(flights[k].transmission, {receivers[k]: cause})
            arrived = [k for k in range(len(flights)) if k not in causes]
            receivers, times = [receivers[k] for k in arrived], [times[k] for k in arrived]
            flights = [flights[k] for k in arrived]
        contents: list[Any] = [flight.transmission.content for flight in flights]
        of_messages = [k for k, content in enumerate(contents) if not isinstance(content, Record)]
        if not of_messages:  # as a rule
            self._records.receive(receivers, times, contents)
            return
        for k in of_messages:
            transmission = flights[k].transmission
            self._inboxes.deliver(contents[k], transmission.port, [receivers[k]], times[k], transmission.number)
        of_records = sorted(set(range(len(contents))).difference(of_messages))
        records = [contents[k] for k in of_records]
        self._records.receive([receivers[k] for k in of_records], [times[k] for k in of_records], records)

    def _can_wait(self, transmission: Transmission) -> bool:
        """Return whether the outcome of a transmission may be decided after its arrival."""
        if self._at_once or (self._fault_state is not None and not self._fault_state.looks_back):
            return False
        return isinstance(transmission.content, Record) or self._inboxes.can_wait(transmission.port)

    def _land(self, flight: Flight, nodes: list[int], *, is_only: bool) -> None:
        """Deliver or lose a transmission at each of some nodes now; `is_only`: whether it has no other event."""
        now, transmission = self._env.now, flight.transmission
        content, receivers = transmission.content, transmission.receivers
        self._with_events -= len(nodes)
        causes = self._losses.causes(nodes, now, flight)
        lost = {nodes[k]: causes[k] for k in sorted(causes)} if causes else {}
        if lost:
            self._lose(transmission, lost)
        if is_only and isinstance(content, Record):  # it arrives at one instant, so all nodes may share it
            unreached = lost if len(nodes) == len(receivers) else {*set(receivers).difference(nodes), *lost}
            if self._records.share(content, len(receivers), now, unreached):
                return
        reached = [node for node in nodes if node not in lost] if lost else nodes
        if isinstance(content, Record):
            self._records.insert(reached, content)
        else:
            self._inboxes.deliver(content, transmission.port, reached, now, transmission.number)
