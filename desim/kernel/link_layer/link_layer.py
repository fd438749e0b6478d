"""The link layer: the steps of a transmission, from its sender's host to its arrival or loss.

A transmission reaches the queue of its transmitter after the processing delay of its sender
(`desim.kernel.channel.hosts`). It waits until its transmitter is free. When it starts, its losses are drawn
(`desim.kernel.link_layer.departure`) and its arrivals scheduled (`desim.kernel.link_layer.delivery`). If nodes contend,
its arrivals are scheduled when its frame ends.
"""

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from itertools import count

from desim.kernel.channel.contention import Callbacks, Contention
from desim.kernel.channel.hosts import Hosts
from desim.kernel.channel.transmitter import Transmitter
from desim.kernel.core.clock import Clock
from desim.kernel.core.events import LOST, Broadcast, Cause, Lost, MessageCounts, Queued, Sent, Trace
from desim.kernel.core.records import Arrival, Record, per_receiver
from desim.kernel.link_layer.arrival_losses import ArrivalLosses
from desim.kernel.link_layer.arrivals import Arrivals
from desim.kernel.link_layer.delivery import MessageDelivery
from desim.kernel.link_layer.departure import Departure
from desim.kernel.link_layer.propagation import LinkSampler
from desim.kernel.models.links import Links
from desim.kernel.models.medium import Unlimited, contends
from desim.kernel.state.inbox import Message
from desim.kernel.state.network_state import NetworkState
from desim.kernel.state.transmission import Lose, Transmission

TransmissionListener = Callable[[Record | Message, int], object]
"""A function called when a transmission starts, with the content and its last arrival time, ns (`LOST` if none)."""
FIRST_COPY = 1 << 40
"""The number of the first copy of a message that a fault makes. It is above the numbers of all transmissions, so that
copies do not shift these numbers, on which random draws depend."""
_new = tuple.__new__  # creates a named tuple in a third of the time


class LinkLayer:
    """Carries transmissions from their senders into the records and inboxes of their receivers.

    Args:
        state: the state of the network; its records and inboxes receive what arrives.
        links: the models of the links.
        sampler: draws latencies and losses.
        trace: receives the message events; None if they are not needed.
        seed: the seed of channel access.

    Attributes:
        delivery: schedules the arrivals.
    """

    def __init__(self, state: NetworkState, links: Links, sampler: LinkSampler, trace: Trace | None, seed: int):
        env, self._sampler = state.env, sampler
        self._env, self._records, self._fault_state = env, state.records, state.fault_state
        self._log, self._is_traced = MessageLog(env, trace), trace is not None
        self._departure = Departure(state, sampler, checks_range=links.range_check != "delivery")
        medium = links.medium
        # If hosts delay transmissions, `_process` has recorded already that each of them waits.
        wait: Callable[[Transmission], None] = (lambda _: None) if links.delays_start else self._log.queue
        self._transmitter: Transmitter | Contention | None = None
        radios: Transmitter | None = None
        if contends(medium):
            callbacks = Callbacks(
                start=self._log.start,
                leave=self._leave,
                land=self._land,
                attempt=self._departure.attempt,
                succeed=lambda transmission: self._leave(transmission, draws=False),
                acknowledge=self._departure.acknowledgement,
                wait=wait,
                lose=self._give_up,
            )
            self._transmitter = Contention(state, medium, seed, callbacks)
        elif type(medium) is not Unlimited:
            self._transmitter = radios = Transmitter(
                env, medium, state.topology.size, self._leave, wait, self._give_up, sampler.processing
            )
        self._receivers = self._departure.receivers
        self._contends = isinstance(self._transmitter, Contention)
        self._on_air: dict[int, tuple[list[int], Arrival, Mapping[int, Cause]]] = {}
        """By number of each transmission that is on the air, if nodes contend: the nodes that it can still reach, its
        arrival times there, ns, and the losses drawn at its start."""
        checks_range = links.range_check != "send"
        losses = ArrivalLosses(state, radios, processing=sampler.processing, checks_range=checks_range)
        arrivals = Arrivals(
            state, losses, radios, checks_range=checks_range, at_once=self._is_traced, lose=self._log.lose
        )
        self.delivery = MessageDelivery(state, links, arrivals, contends=self._contends)
        self._is_certain = self.delivery.is_certain and not (self._contends or sampler.keeps_order) and trace is None
        """Whether the outcomes that are drawn at transmission are final, and no trace needs them."""
        may_wait = self._transmitter is not None or links.delays_start
        self._may_lose = may_wait or state.fault_state is not None or not sampler.lossless
        """Whether losses are possible at transmission, besides those of messages to nodes that are not reachable."""
        self._inboxes = state.inboxes
        self._is_plain = self.delivery.is_certain and not (may_wait or sampler.keeps_order)
        """Whether a transmission starts when it is created, and its outcome at each receiver is final at its start."""
        self._enqueue: Callable[[Transmission], None] = (
            self._leave if self._transmitter is None else self._transmitter.enqueue
        )
        """Starts a transmission, or queues it if the transmitter is busy; after a delay if its sender needs time."""
        self._hosts: Hosts | None = None
        if links.delays_start:
            self._hosts = Hosts(env, links.processing.sender, state.topology.size, seed, self._enqueue)
            self._enqueue = self._process
        self._may_duplicate = sampler.duplicates_messages
        self._listeners: list[TransmissionListener] = []
        self._numbers, self._copy_numbers = count(), count(FIRST_COPY)

    def overhear(self, listener: TransmissionListener) -> None:
        """Register a listener, which is called whenever a transmission starts."""
        self._listeners.append(listener)

    def watch_losses(self, watch: Lose) -> None:
        """Register a function to call with each transmission that is lost at some receivers; see `Network`."""
        self._log.loss_watchers.append(watch)

    def crash(self, node: int, cause: Cause) -> None:
        """Lose the queued transmissions of a node whose radio goes down now, with the cause of its losses.

        A transmission that is on the air now is lost, too: at once if nodes contend, else on arrival.
        """
        self.delivery.arrivals.crash(node, cause)
        flushed = self._transmitter.flush(node) if self._transmitter is not None else []
        flushed += self._hosts.flush(node) if self._hosts is not None else []
        for transmission in flushed:  # of a frame on the air, the losses drawn at its start are counted already
            reached, *_ = self._on_air.pop(transmission.number, (transmission.receivers,))
            self._lose_unscheduled(transmission, dict.fromkeys(reached, cause))

    def message_counts(self) -> MessageCounts:
        """Return the counts of messages up to now; each sent message is delivered, lost or in flight."""
        now, utilisation = self._env.now, 0.0
        in_flight = self.delivery.in_flight()
        if self._hosts is not None:
            in_flight += sum(len(transmission.receivers) for transmission in self._hosts.waiting())
        if self._transmitter is not None:
            in_flight += sum(len(transmission.receivers) for transmission in self._transmitter.waiting())
            in_flight += sum(len(reached) for reached, *_ in self._on_air.values())
            utilisation = self._transmitter.busy_time() / (self._transmitter.channels * now) if now else 0.0
        return self._log.counts(in_flight, utilisation)

    # The steps of a transmission.

    def transmit(
        self,
        src: int,
        dst: int | None,
        content: Record | Message,
        size: int,
        port: str = "",
        only: Collection[int] | None = None,
    ) -> None:
        """Start a new transmission, at once or after it has waited; do nothing if the sender's radio is down.

        See `Network.send`, which checks the arguments.
        """
        if self._fault_state is not None and self._fault_state.down(src):
            return
        number, reachable = next(self._numbers), True
        if dst is None:
            receivers = self._receivers(src, number)
            if only is not None:
                receivers = [node for node in receivers if node in only]
        else:
            receivers, reachable = [dst], self._departure.reachable(src, dst, number)
        transmission = _new(
            Transmission, (number, src, self._env.now, size, receivers, content, port, reachable, dst is not None)
        )
        self._log.sent += len(receivers)
        if self._fault_state is not None:
            self._fault_state.note_sent(number, src, receivers, content.body)
        self._enqueue(transmission)
        if self._may_duplicate:
            self._enqueue_copy(transmission)

    def _enqueue_copy(self, transmission: Transmission) -> None:
        """Start or queue a second transmission to the receivers that the model of duplicates selects."""
        _, src, now, size, receivers, *_ = transmission
        duplicated = self._sampler.duplicates(src, receivers, now, size)
        if duplicated:
            self._log.sent += len(duplicated)
            number = next(self._numbers)
            if self._fault_state is not None:
                self._fault_state.note_sent(number, src, duplicated, transmission.content.body)
            self._enqueue(transmission._replace(number=number, receivers=duplicated))

    def _process(self, transmission: Transmission) -> None:
        """Pass a transmission to the host of its sender; it waits until the host has processed it."""
        assert self._hosts is not None
        self._log.queue(transmission)
        self._hosts.process(transmission)

    def _give_up(self, transmission: Transmission, cause: Cause = "queue") -> None:
        """Lose a transmission that never starts, or that its sender stops repeating."""
        self._lose_unscheduled(transmission, dict.fromkeys(transmission.receivers, cause))

    def _lose_unscheduled(self, transmission: Transmission, causes: Mapping[int, Cause]) -> None:
        """Lose a transmission whose arrivals are never scheduled, and forget what interceptions would do to it."""
        if self._fault_state is not None:
            self._fault_state.forget(transmission.number)
        self._log.lose(transmission, causes)

    def _leave(self, transmission: Transmission, airtime: int = 0, *, draws: bool = True) -> None:
        """Start a transmission with an airtime (ns): schedule its arrivals, and draw its losses if `draws`.

        If nodes contend, its arrivals are scheduled when its frame ends.

        Kept equal to deliveries by events by
        `tests/kernel/test_contract.py::test_delivery_by_events_is_observationally_equal_to_delivery_without_events`.
        """
        if self._is_plain and transmission.to_one:
            self._leave_to_one(transmission)
            return
        now, receivers = self._env.now, transmission.receivers
        if not self._contends:
            self._log.start(transmission)
        arrival = self._sampler.arrivals(transmission.src, receivers, now, airtime, transmission.size)
        if self._fault_state is not None:
            arrival = self._fault_state.delayed(transmission.number, receivers, arrival)
        causes = (
            self._departure.losses(transmission) if draws and (self._may_lose or not transmission.reachable) else {}
        )
        content, reached = transmission.content, receivers
        if self._is_certain and isinstance(content, Record) and not self._listeners:
            # `share` needs only the nodes that lose the record. Not listing the others saves 10 % of the time.
            if isinstance(arrival, int) and self._records.share(content, len(receivers), arrival, causes):
                if causes:
                    self._log.lose(transmission, causes)
                return
            if not causes:
                self._records.schedule(content, receivers, arrival)
                return
        if causes:
            reached, arrival = _without(causes, receivers, arrival)
        if self._sampler.keeps_order:
            arrival = self._sampler.in_order(transmission.src, reached, arrival)
        if self._listeners:
            last = max(per_receiver(arrival, len(reached)), default=LOST)
            for listener in self._listeners:
                listener(content, last)
        if self._is_traced:
            self._log.leave(transmission, causes, arrival)
        if causes:
            self._log.lose(transmission, causes)
        if draws and self._contends:
            self._on_air[transmission.number] = reached, arrival, causes
        else:
            self._schedule(transmission, reached, arrival, causes, airtime)

    def _leave_to_one(self, transmission: Transmission) -> None:
        """Start a message to one node if `_is_plain`: it need not wait, and nothing is decided after its start.

        Kept equal to the general start of a transmission by
        `tests/kernel/test_contract.py::test_a_message_to_one_node_starts_as_any_transmission`.
        """
        number, src, now, size, receivers, message, port, reachable, _ = transmission
        assert isinstance(message, Message)
        self._log.start(transmission)
        arrival = self._sampler.arrivals(src, receivers, now, 0, size)
        when, cause = arrival if isinstance(arrival, int) else arrival[0], None if reachable else "out_of_range"
        if self._may_lose or not reachable:
            lost = self._sampler.losses(src, receivers, now, size)
            if reachable and lost is not None and lost[0]:
                cause = self._sampler.cause(src, receivers[0])
        for listener in self._listeners:
            listener(message, LOST if cause else when)
        if self._is_traced:
            self._log.leave_to_one(transmission, LOST if cause else when)
        if cause:
            self._log.lose(transmission, {receivers[0]: cause})
        else:
            self._inboxes.deliver(message, port, receivers, when, number)

    def _land(self, transmission: Transmission, causes: Mapping[int, Cause]) -> None:
        """End the frame of a transmission: lose it at the receivers in `causes`, and schedule its other arrivals."""
        reached, arrival, drawn = self._on_air.pop(transmission.number)
        if causes:
            lost = {node: causes[node] for node in reached if node in causes}
            reached, arrival = _without(lost, reached, arrival)
            self._log.lose(transmission, lost)
            drawn = {**drawn, **lost}
        self._schedule(transmission, reached, arrival, drawn, 0)

    def _schedule(
        self,
        transmission: Transmission,
        reached: list[int],
        arrival: Arrival,
        causes: Mapping[int, Cause],
        airtime: int,
    ) -> None:
        """Schedule the arrivals of a transmission, and those of its copies; see `MessageDelivery.schedule`.

        A fault makes copies inside the network, without airtime and random draws, so they change no other message.
        """
        self.delivery.schedule(transmission, reached, arrival, causes, airtime)
        if self._fault_state is None:
            return
        for node, when in self._fault_state.take_copies(transmission.number, reached, arrival):
            self._records.expect_any_order()
            copied = transmission._replace(number=next(self._copy_numbers), receivers=[node])
            self._log.sent += 1
            if self._is_traced:
                self._log.leave(copied, {}, when)
            self.delivery.schedule(copied, [node], when, {}, 0)


def _without(lost: Collection[int], nodes: list[int], arrival: Arrival) -> tuple[list[int], Arrival]:
    """Return the nodes that do not lose a transmission, and its arrival times (ns) there, given those at all nodes."""
    if not isinstance(arrival, int):
        arrival = [when for node, when in zip(nodes, arrival, strict=True) if node not in lost]
    return [node for node in nodes if node not in lost], arrival


class MessageLog:
    """Counts messages, and appends their events to the trace.

    Args:
        env: the clock of the simulation.
        trace: receives the events; None if they are not needed.

    Attributes:
        sent: number of messages, one for each receiver of a transmission.
        loss_watchers: functions to call with the losses of a transmission.
    """

    def __init__(self, env: Clock, trace: Trace | None):
        self._env, self._trace = env, trace
        self.sent = self._transmissions = self._bytes_sent = 0
        self._lost: Counter[Cause] = Counter()
        self.loss_watchers: list[Lose] = [] if trace is None else [self._record_losses]

    def queue(self, transmission: Transmission) -> None:
        """Record that a transmission waits at its host, for its transmitter, or for the channel."""
        if self._trace is not None:
            number, src, _, size, receivers, *_ = transmission
            self._trace.append_message(Queued(self._env.now, number, src, tuple(receivers), size))

    def start(self, transmission: Transmission) -> None:
        """Count the start of a transmission, or of an attempt of it."""
        self._transmissions += 1
        self._bytes_sent += transmission.size

    def leave(self, transmission: Transmission, causes: Mapping[int, Cause], arrival: Arrival) -> None:
        """Append the start of a transmission: at each receiver its arrival time, ns, or `LOST`.

        `causes` holds the receivers that have lost it already, and `arrival` the arrival times at the others.
        """
        assert self._trace is not None
        now, (number, src, created, size, receivers, content, *_) = self._env.now, transmission
        times = arrival
        if causes:
            if isinstance(arrival, int):
                times = [LOST if node in causes else arrival for node in receivers]
            else:
                arrivals = iter(arrival)
                times = [LOST if node in causes else next(arrivals) for node in receivers]
        if isinstance(content, Record):
            # One time stands for all receivers; without receivers, the field is empty.
            arrivals_field = (times,) * bool(receivers) if isinstance(times, int) else tuple(times)
            broadcast = now, number, src, content.seq, tuple(receivers), arrivals_field, created, size, content.body
            self._trace.append_message(_new(Broadcast, broadcast))
            return
        for node, arrives in zip(receivers, per_receiver(times, len(receivers)), strict=True):
            self._trace.append_message(_new(Sent, (now, number, src, node, arrives, created, size, content.body)))

    def leave_to_one(self, transmission: Transmission, arrives: int) -> None:
        """Append a message to one node with the time of its arrival, ns; see `leave`."""
        assert self._trace is not None
        number, src, created, size, (node,), content, *_ = transmission
        sent = self._env.now, number, src, node, arrives, created, size, content.body
        self._trace.append_message(_new(Sent, sent))

    def lose(self, transmission: Transmission, causes: Mapping[int, Cause]) -> None:
        """Count the losses of a transmission now, given the cause of each by receiver; call the watchers with them."""
        for cause in causes.values():  # faster than `Counter.update` for up to a dozen losses
            self._lost[cause] += 1
        for watch in self.loss_watchers:
            watch(transmission, causes)

    def _record_losses(self, transmission: Transmission, causes: Mapping[int, Cause]) -> None:
        """Append losses to the trace."""
        assert self._trace is not None
        now, (number, src, *_) = self._env.now, transmission
        for node, cause in causes.items():
            self._trace.append_message(_new(Lost, (now, number, src, node, cause)))

    def counts(self, in_flight: int, utilisation: float) -> MessageCounts:
        """Return all counts up to now, given the number of messages in flight and the utilisation of the channels."""
        lost = self._lost.total()
        by_cause = {cause: self._lost[cause] for cause in sorted(+self._lost)}  # + drops causes without losses
        messages = self.sent, self.sent - lost - in_flight, lost, in_flight
        return MessageCounts(self._env.now, *messages, by_cause, self._transmissions, self._bytes_sent, utilisation)
