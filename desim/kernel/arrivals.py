"""Arrivals whose outcome is not certain at transmission, because faults, distance or half duplex may prevent them.

All arrivals of a transmission that are due at the same instant share one SimPy event, which decides their outcomes.

A record that reaches its receivers at different times needs no event, because, unlike a message to an inbox, it wakes
no process. Its arrivals are kept, and their outcomes are decided together before the next read, the next change of the
faults, or the next change of the motion of a node. Until then, an outcome does not depend on when it is decided. With
40 nodes and lognormal latencies, a simulation with a range check at delivery runs 7.8 times as fast as with an event
per arrival, and one with half duplex 2.8 times as fast. Arrivals cannot be kept if a trace needs each loss at its time,
if there may be faults that are not planned, or if the source of the positions does not know past positions
(`PositionSource.looks_back`).
"""

from collections.abc import Callable, Mapping
from functools import partial
from itertools import compress, repeat
from math import inf
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from desim.config.arrays import Integers
from desim.kernel.clock import Clock, Instant, Phase
from desim.kernel.events import Cause
from desim.kernel.fault_state import FaultState
from desim.kernel.inbox import Inboxes, Message, deliver
from desim.kernel.received_records import Records
from desim.kernel.records import Arrival, Record, per_receiver
from desim.kernel.topology import Topology
from desim.kernel.transmitter import Transmitter

if TYPE_CHECKING:
    import simpy

MAX_FRESH = 100_000
"""Number of arrivals, kept since the last decision, above which the due ones are decided without waiting for a read."""
MANY = 1000
"""Length from which a list is searched for items that are no longer needed."""


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
    """False if `send` was called for one receiver that was then not linked to the sender or, with a range check at
    transmission, out of range; else True."""
    to_one: bool
    """Whether it is a message to one node."""


Lose = Callable[[Transmission, Mapping[int, Cause]], object]
"""A function that counts the losses of a transmission, given their causes by receiver."""


PerArrival = int | Integers
"""One integer for all arrivals, or one for each."""


class _Batch(NamedTuple):
    """k arrivals; times in ns."""

    node: Integers
    """(k,) the receivers."""
    time: PerArrival
    """The time of the arrival."""
    src: PerArrival
    """The sender."""
    number: PerArrival
    """The number of the transmission."""
    begin: PerArrival
    """The start of the airtime."""
    end: PerArrival
    """The end of the airtime."""


class KeptArrivals:
    """Arrivals that are kept until their outcomes are decided together.

    Attributes:
        first: the time of the first arrival, ns; inf if there is none.
    """

    def __init__(self) -> None:
        self.first: float = inf
        self._fresh: list[tuple[Transmission, list[int], list[int], int, int]] = []
        """The transmissions since the last decision: with receivers, arrival times, start and end of the airtime."""
        self._fresh_count = 0
        """Number of arrivals in `_fresh`."""
        self._flights: list[Transmission] = []
        self._of_flight = np.empty((4, 0), dtype=np.int64)
        """Of each transmission in `_flights`: sender, number, start and end of the airtime."""
        self._older = np.empty((3, 0), dtype=np.int64)
        """Of each arrival that is not in `_fresh`: index in `_flights`, receiver, time."""
        self._compact_at = MANY
        """Length of `_flights` at which items that are no longer needed are removed."""

    def __len__(self) -> int:
        return self._older.shape[1] + self._fresh_count

    def add(self, transmission: Transmission, nodes: list[int], times: list[int], begin: int, end: int) -> bool:
        """Keep the arrivals of a transmission at some nodes; return whether there are so many that they should land.

        Args:
            transmission: the transmission.
            nodes: the receivers; at least one.
            times: the arrival times, ns.
            begin: the start of the airtime, ns.
            end: the end of the airtime, ns.
        """
        self._fresh.append((transmission, nodes, times, begin, end))
        self._fresh_count += len(nodes)
        self.first = min(self.first, *times)
        return self._fresh_count > MAX_FRESH

    def take(self, until: int) -> tuple[list[Transmission], _Batch]:
        """Remove and return the arrivals up to and including a time (ns), with the transmission of each."""
        older = self._with_fresh()
        due = older[2] <= until
        landing, self._older = older[:, due], older[:, ~due]
        self.first = int(self._older[2].min()) if self._older.size else inf
        flights = [self._flights[flight] for flight in landing[0].tolist()]
        batch = _Batch(landing[1], landing[2], *self._of_flight[:, landing[0]])
        if len(self._flights) > self._compact_at:
            used, self._older[0] = np.unique(self._older[0], return_inverse=True)
            self._flights = [self._flights[flight] for flight in used.tolist()]
            self._of_flight = self._of_flight[:, used]
            self._compact_at = 2 * len(used) + MANY
        return flights, batch

    def _with_fresh(self) -> Integers:
        """Return all kept arrivals in the form of `_older`; transmissions in `_fresh` are moved to `_flights`."""
        if not self._fresh:
            return self._older
        columns: tuple[list[int], list[int], list[int]] = [], [], []
        of_flight = []
        for transmission, nodes, arrival, begin, end in self._fresh:
            columns[0].extend([len(self._flights)] * len(nodes))
            columns[1].extend(nodes)
            columns[2].extend(arrival)
            self._flights.append(transmission)
            of_flight.append((transmission.src, transmission.number, begin, end))
        self._fresh, self._fresh_count = [], 0
        self._of_flight = np.concatenate((self._of_flight, np.array(of_flight).T), axis=1)
        return np.concatenate((self._older, np.array(columns)), axis=1)


class Arrivals:
    """Decides which uncertain arrivals succeed, and stores what has arrived.

    Args:
        env: the clock of the simulation.
        topology: decides whether a receiver is within range.
        records: receives the records that arrive.
        inboxes: receive the messages that arrive.
        fault_state: the active faults; None: the network has no faults.
        transmitter: knows which nodes transmit, for half duplex; None: nodes transmit without airtime, or contend.
        processing: processing delay of a message at sender and receiver together, ns.
        checks_range: whether a receiver must be within range on arrival.
        at_once: whether each outcome is needed at the time of the arrival, for a trace.
        lose: counts and records losses.

    Attributes:
        kept: the arrivals that are decided together.
    """

    def __init__(
        self,
        env: Clock,
        topology: Topology,
        records: Records,
        inboxes: Inboxes,
        fault_state: FaultState | None,
        transmitter: Transmitter[Transmission] | None,
        *,
        processing: int,
        checks_range: bool,
        at_once: bool,
        lose: Lose,
    ):
        self._env, self._topology, self._records, self._inboxes = env, topology, records, inboxes
        self._fault_state, self._processing = fault_state, processing
        self._transmitter = transmitter
        self._checks_range, self._lose = checks_range, lose
        self._at_once = at_once or (checks_range and not topology.looks_back)
        if checks_range:
            topology.before_change(self.settle)
        if fault_state is not None:
            fault_state.before_change(self.settle)
        self._on_air: dict[int, tuple[int, int]] = {}
        """By sender: the number of its last transmission with an airtime, and the end of the airtime."""
        self._cut_short: set[int] = set()
        """The numbers of the transmissions whose sender crashed while it transmitted."""
        self._with_events = 0
        """Number of arrivals that have an event."""
        self.kept = KeptArrivals()
        self._at_downed: list[tuple[int, Transmission, int]] = []
        """Losses that are certain, at nodes that are down: time, transmission and receiver."""
        self._count_at = MANY
        """Length of `_at_downed` at which items that are no longer needed are removed."""

    def crash(self, node: int) -> None:
        """Note that the radio of a node goes down now: its transmission that is on the air is lost on arrival."""
        number, end = self._on_air.get(node, (0, 0))
        if self._env.now < end:
            self._cut_short.add(number)

    def in_flight(self) -> int:
        """Return the number of arrivals that are not decided yet."""
        return self._with_events + len(self.kept) + len(self._at_downed)

    def schedule(self, transmission: Transmission, nodes: list[int], arrival: Arrival, airtime: int) -> None:
        """Schedule the arrivals at some nodes of a transmission that starts now, given their times and airtime (ns)."""
        begin, end = self._env.now, self._env.now + airtime
        nodes_by_time: dict[int, list[int]] = {}
        if self._transmitter is not None:
            self._on_air[transmission.src] = transmission.number, end
            self._transmitter.forget(min(self.kept.first, begin))
        if isinstance(arrival, int):
            nodes_by_time = {arrival: nodes} if nodes else {}
        elif nodes and self._can_wait(transmission):
            if self.kept.add(transmission, nodes, arrival, begin, end):
                self.settle()
        else:
            for node, when in zip(nodes, arrival, strict=True):
                nodes_by_time.setdefault(when, []).append(node)
        for when, here in nodes_by_time.items():
            land = partial(self._land, transmission, here, begin, end, is_only=len(nodes_by_time) == 1)
            Instant(self._env, when, Phase.DELIVERY).callbacks.append(land)
            self._with_events += len(here)

    def lose_at(self, transmission: Transmission, nodes: list[int], arrival: Arrival) -> None:
        """Lose a transmission at some nodes that will still be down at its arrival times (ns); count each loss then."""
        if not nodes:
            return
        if self._at_once:
            self.schedule(transmission, nodes, arrival, 0)
            return
        times = per_receiver(arrival, len(nodes))
        self._at_downed += [(when, transmission, node) for node, when in zip(nodes, times, strict=True)]
        if len(self._at_downed) > self._count_at:
            self.count_losses()
            self._count_at = 2 * len(self._at_downed) + MANY

    def count_losses(self) -> None:
        """Count the certain losses up to now."""
        now = self._env.now
        for when, transmission, node in self._at_downed:
            if when <= now:
                self._lose(transmission, {node: "crash"})
        self._at_downed = [each for each in self._at_downed if each[0] > now]

    def settle_for_reader(self) -> None:
        """Decide the kept arrivals up to and including this instant.

        If a fault has yet to begin or end at this instant, the arrivals at this instant are not decided.
        """
        now = self._env.now
        changes = self._fault_state is not None and self._fault_state.changes_by(now)
        self.settle(now - 1 if changes else now)

    def settle(self, until: int | None = None) -> None:
        """Decide the kept arrivals up to and including a time (ns); by default, those before this instant."""
        until = self._env.now - 1 if until is None else until
        if until < self.kept.first:
            return
        flights: Any  # only records are kept
        flights, batch = self.kept.take(until)
        nodes, times = batch.node.tolist(), np.asarray(batch.time).tolist()
        causes = self._causes(batch)
        if causes is not None:
            for flight, node, cause in zip(flights, nodes, causes, strict=True):
                if cause is not None:
                    self._lose(flight, {node: cause})
            arrived = [cause is None for cause in causes]
            flights = list(compress(flights, arrived))
            nodes, times = list(compress(nodes, arrived)), list(compress(times, arrived))
        self._records.receive(nodes, times, [flight.content for flight in flights])

    def _can_wait(self, transmission: Transmission) -> bool:
        """Return whether the outcome of a transmission may be decided after its arrival."""
        faults = self._fault_state
        return not self._at_once and isinstance(transmission.content, Record) and (faults is None or faults.looks_back)

    def _land(
        self, transmission: Transmission, nodes: list[int], begin: int, end: int, _: "simpy.Event", *, is_only: bool
    ) -> None:
        """Deliver or lose a transmission at each of some nodes now; `is_only`: it arrives at no other time."""
        now, reached = self._env.now, nodes
        self._with_events -= len(nodes)
        receivers = np.array(nodes, dtype=np.int64)
        causes = self._causes(_Batch(receivers, now, transmission.src, transmission.number, begin, end))
        if causes is not None:
            fates = list(zip(nodes, causes, strict=True))
            self._lose(transmission, {node: cause for node, cause in fates if cause is not None})
            reached = [node for node, cause in fates if cause is None]
        if isinstance(transmission.content, Record):
            unreached = set(transmission.receivers).difference(reached) if is_only else ()
            self._records.insert(reached, transmission.content, unreached)
        else:
            deliver(transmission.content, self._inboxes.at(transmission.port), reached, now, transmission.number)

    def _causes(self, batch: _Batch) -> list[Cause | None] | None:
        """Return a list with the cause of the loss of each of k arrivals, or None in place of a cause if it succeeds.

        If all arrivals succeed, return None instead of a list.
        If an arrival has several causes, the last in this order counts: half duplex, range, jamming, partition, crash.
        """
        losses: list[tuple[Cause, list[bool] | None]] = []
        causes: list[Cause | None] | None = None
        if self._transmitter is not None:
            received = batch.time - self._processing
            start = received - (batch.end - batch.begin)
            losses.append(("half_duplex", self._transmitter.transmitting(batch.node, start, received)))
        if self._checks_range:
            reached = self._topology.reaches(batch.src, batch.node, batch.number, batch.time)
            losses.append(("out_of_range", [not each for each in reached]))
        if (faults := self._fault_state) is not None:
            losses.append(("jamming", faults.jammed(batch.node, batch.time)))
            losses.append(("partition", faults.separated(batch.src, batch.node)))
            losses.append(("crash", self._crashed(batch)))
        for cause, lost in losses:
            if lost is not None and True in lost:
                before = causes or [None] * len(lost)
                causes = [cause if is_lost else other for is_lost, other in zip(lost, before, strict=True)]
        return causes

    def _crashed(self, batch: _Batch) -> list[bool] | None:
        """Return k booleans: whether the receiver is down or the sender crashed while sending; None: all False."""
        assert self._fault_state is not None
        down, cut_short = self._fault_state.down_nodes, self._cut_short
        if not down and not cut_short:
            return None
        nodes = batch.node.tolist()
        numbers = repeat(batch.number) if isinstance(batch.number, int) else batch.number.tolist()
        return [node in down or number in cut_short for node, number in zip(nodes, numbers, strict=False)]
