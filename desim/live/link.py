"""The link layer of a live node: a transmission leaves through a socket, and the links are drawn where it arrives.

Sender and receiver divide the work. The sender decides what is known at transmission: its receivers, the range, the
partitions. The receiver draws losses, duplicates and latency from the models of the scenario, with streams of its own,
and delivers at the time stamp of the transmission plus the latency. The clocks of processes on one machine agree, so
the time that a datagram takes is absorbed in the latency, unless the latency is shorter.
"""

from collections import defaultdict, deque
from collections.abc import Callable, Mapping
from typing import NamedTuple

from desim.kernel.core.events import LOST, Cause, Trace
from desim.kernel.core.records import Record
from desim.kernel.link_layer.link_layer import LinkLayer
from desim.kernel.link_layer.propagation import LinkSampler
from desim.kernel.models.links import Links
from desim.kernel.state.network_state import NetworkState
from desim.kernel.state.transmission import Transmission
from desim.kernel.transport.layer import PORT as FRAMES
from desim.live.layouts import WireError
from desim.live.wire import CYCLE, Parcel, Wire, datagram_number

_new = tuple.__new__  # creates a named tuple in a third of the time
MAX_KEPT = 100_000
"""Largest number of transmissions, and of outcomes, that a node keeps until it reports them."""
REMEMBERED = 4096
"""Number of datagrams of a sender whose numbers a node remembers, to recognise a replay."""
MAX_AHEAD = 5_000_000_000
"""How far in the future the time stamp of a datagram may be, ns."""


class SentDatagram(NamedTuple):
    """A transmission as its sender knows it."""

    t: int
    """ns"""
    dst: tuple[int, ...]
    causes: dict[int, Cause]
    """The causes of the losses that are known at transmission, by receiver."""
    created: int
    datagram: bytes

    @property
    def number(self) -> int:
        """The number of its datagram; see `desim.live.wire.Parcel`."""
        return datagram_number(self.datagram)


class DatagramFate(NamedTuple):
    """The outcome of a datagram, as its receiver knows it."""

    number: int
    src: int
    dst: int
    arrival: int
    """Its arrival time, ns, or `LOST`."""
    cause: Cause = ""
    is_copy: bool = False
    """Whether it is the copy of a message that is duplicated."""


class Drops(NamedTuple):
    """The numbers of datagrams that a node has dropped."""

    malformed: int = 0
    foreign: int = 0
    """From an address other than that of the node that the datagram names."""
    replayed: int = 0


class SocketLinkLayer(LinkLayer):
    """Sends the transmissions of one node as datagrams, and delivers those that arrive.

    Args:
        state: the state of the network.
        links: the models of the links.
        sampler: draws latencies and losses at this node.
        trace: receives the events of the network.
        seed: the seed of the network.
        node: the number of this node.
        wire: writes and reads datagrams.
        post: sends a datagram to some nodes.
        draws: whether losses and latencies are drawn; if not, the links are real.

    Attributes:
        departures: the transmissions since the last report, at most `MAX_KEPT`.
        outcomes: the fates of datagrams that have arrived since the last report, at most `MAX_KEPT`.
        drops: the numbers of dropped datagrams.
        errors: how late the last `MAX_KEPT` deliveries were, ns.
        trusts_stamps: whether the stamps of records, which are by the clocks of their sources, show the true time.
    """

    def __init__(
        self,
        state: NetworkState,
        links: Links,
        sampler: LinkSampler,
        trace: Trace | None,
        seed: int,
        *,
        node: int,
        wire: Wire,
        post: Callable[[bytes, list[int]], object],
        draws: bool = True,
    ):
        super().__init__(state, links, sampler, trace, seed)
        self._node, self._wire, self._post, self._draws = node, wire, post, draws
        self._me, self._draws_copies = [node], draws and sampler.duplicates_messages
        self._may_duplicate = False  # the receiver draws duplicates, not the sender
        self._log.loss_watchers = [self._note_loss]
        state.records.expect_any_order()  # between two sockets, one datagram may overtake another
        self._seen: defaultdict[int, dict[int, None]] = defaultdict(dict)
        self.departures: deque[SentDatagram] = deque(maxlen=MAX_KEPT)
        self.outcomes: deque[DatagramFate] = deque(maxlen=MAX_KEPT)
        self.errors: deque[int] = deque(maxlen=MAX_KEPT)
        self.drops = Drops()
        self.trusts_stamps = True

    # Sending.

    def _leave(self, transmission: Transmission, airtime: int = 0, *, draws: bool = True) -> None:
        """Send a transmission to each of its receivers that it can reach."""
        _, src, created, size, receivers, content, port, reachable, to_one = transmission
        self._log.start(transmission)
        for listener in self._listeners:
            listener(content, LOST)  # the sender does not know when the message arrives
        datagram = self._wire.encode(content, port, size, to_one=to_one, now=self._env.now)
        causes: dict[int, Cause] = {} if reachable else dict.fromkeys(receivers, "out_of_range")
        if self._fault_state is not None and (separated := self._fault_state.separated(src, receivers)):
            causes |= {node: cause for node, cause in zip(receivers, separated, strict=True) if cause}
        self.departures.append(SentDatagram(self._env.now, tuple(receivers), causes, created, datagram))
        self._post(datagram, [node for node in receivers if node not in causes] if causes else receivers)

    # Receiving.

    def receive(self, datagram: bytes, sender: int | None, now: int | None = None) -> None:
        """Take a datagram that has arrived; drop it if it is malformed, a replay, or from another node than it names.

        Args:
            datagram: its bytes.
            sender: the node at the address from which the datagram came; None: no node is there.
            now: when it arrived, ns, not before the present of the clock; None: now.
        """
        now, drops = self._env.now if now is None else now, self.drops
        if sender is None or sender == self._node:
            self.drops = drops._replace(foreign=drops.foreign + 1)
            return
        try:
            parcel = self._wire.decode(datagram)
        except WireError:
            self.drops = drops._replace(malformed=drops.malformed + 1)
            return
        is_record = isinstance(parcel.content, Record)
        if parcel.src != sender:
            self.drops = drops._replace(foreign=drops.foreign + 1)
        elif not is_record and parcel.start > now + MAX_AHEAD:  # the stamp of a record may be of a skewed clock
            self.drops = drops._replace(malformed=drops.malformed + 1)
        elif self._is_replay(parcel):
            self.drops = drops._replace(replayed=drops.replayed + 1)
        else:
            start = parcel.start
            if parcel.port is FRAMES:  # the start of a frame is known modulo `CYCLE`
                start += max(now + MAX_AHEAD - start, 0) // CYCLE * CYCLE
            start = min(start, now) if self.trusts_stamps or not is_record else now
            self._deliver(parcel, len(datagram), start, now)
            if self._draws_copies and self._sampler.duplicates(sender, self._me, start, len(datagram)):
                self._deliver(parcel, len(datagram), start, now, is_copy=True)

    def _is_replay(self, parcel: Parcel) -> bool:
        """Return whether a datagram has arrived before; note that it has arrived now."""
        number, src, *_ = parcel
        numbers = self._seen[src]
        if number in numbers:
            return True
        numbers[number] = None
        if len(numbers) > REMEMBERED:
            del numbers[next(iter(numbers))]
        return False

    def _deliver(self, parcel: Parcel, size: int, start: int, now: int, *, is_copy: bool = False) -> None:
        """Lose a datagram that was transmitted at a time (ns), or schedule its delivery."""
        number, src, _, content, port, to_one = parcel
        me, arrival = self._me, now
        if self._draws:
            arrival, cause = self._drawn(src, start, size)
            if cause:
                self.outcomes.append(DatagramFate(number, src, self._node, LOST, cause, is_copy))
                return
            late = now - arrival
            self.errors.append(late if late > 0 else 0)
            if late > 0:
                arrival = now
        self.outcomes.append(_new(DatagramFate, (number, src, self._node, arrival, "", is_copy)))
        transmission = _new(Transmission, (number, src, start, size, me, content, port, True, to_one))
        if self._fault_state is None:
            self.delivery.schedule(transmission, me, [arrival], {}, 0)
        else:  # a fault may have begun since the transmission: that is decided on arrival
            self.delivery.arrivals.schedule(transmission, me, [arrival], 0)

    def _drawn(self, src: int, start: int, size: int) -> tuple[int, Cause]:
        """Draw the arrival time, ns, of a datagram that was transmitted at a time, and the cause of its loss, or ""."""
        # The latency is drawn even if the message is lost, as in a simulation.
        me, sampler = self._me, self._sampler
        arrival = sampler.arrivals(src, me, start, 0, size)
        lost = sampler.losses(src, me, start, size)
        if lost is not None and lost[0]:
            return LOST, sampler.cause(src, self._node)
        if sampler.keeps_order:
            arrival = sampler.in_order(src, me, arrival)
        return arrival if isinstance(arrival, int) else arrival[0], ""

    def _note_loss(self, transmission: Transmission, causes: Mapping[int, Cause]) -> None:
        """Note a loss on arrival."""
        for cause in causes.values():
            lost = DatagramFate(transmission.number, transmission.src, self._node, self._env.now, cause)
            self.outcomes.append(lost)
