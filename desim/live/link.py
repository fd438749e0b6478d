"""The link layer of a live node: a transmission leaves through a socket, and the links are drawn where it arrives.

Kernel and shim divide the work. The sender decides what is known at transmission: its receivers, the range, the
partitions. The receiver draws losses, duplicates and latency from the models of the scenario, with streams of its own,
and delivers at the time stamp of the transmission plus the latency. The clocks of processes on one machine agree, so
the time that a datagram takes is absorbed in the latency, unless the latency is shorter.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from desim.kernel.core.events import LOST, Cause, Trace
from desim.kernel.core.records import Record
from desim.kernel.link_layer.link_layer import LinkLayer
from desim.kernel.link_layer.propagation import LinkSampler
from desim.kernel.models.links import Links
from desim.kernel.state.network_state import NetworkState
from desim.kernel.state.transmission import Transmission
from desim.live.layouts import WireError
from desim.live.wire import Parcel, Wire

REMEMBERED = 4096
"""Number of datagrams of a sender whose numbers a node remembers, to recognise a replay."""
MAX_AHEAD = 5_000_000_000
"""How far in the future the time stamp of a datagram may be, ns."""


class SentDatagram(NamedTuple):
    """A transmission as its sender knows it."""

    number: int
    """The number of its datagram; see `desim.live.wire.Parcel`."""
    t: int
    dst: tuple[int, ...]
    causes: dict[int, Cause]
    """The causes of the losses that are known at transmission, by receiver."""
    created: int
    size: int
    datagram: Any
    """Its bytes; in a report to the referee, their hexadecimal digits."""
    to_one: bool


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
    """From an address that is not that of the node that it names."""
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
        post: sends a datagram to a node.
        draws: whether losses and latencies are drawn; if not, the links are real.

    Attributes:
        departures: what has been sent since they were last taken.
        outcomes: what has become of what has arrived, likewise.
        drops: the numbers of dropped datagrams.
        errors: by how much each delivery was later than its time, ns.
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
        post: Callable[[bytes, int], object],
        draws: bool = True,
    ):
        super().__init__(state, links, sampler, trace, seed)
        self._node, self._wire, self._post, self._draws = node, wire, post, draws
        self._inboxes, self._copies, self._duplicates = state.inboxes, sampler.duplicates_messages, False
        self._log.loss_watchers = [self._note_loss]
        state.records.expect_any_order()  # between two sockets, one datagram may overtake another
        self._seen: dict[int, dict[int, None]] = {}
        self.departures: list[SentDatagram] = []
        self.outcomes: list[DatagramFate] = []
        self.errors: list[int] = []
        self.drops = Drops()

    # Sending.

    def _leave(self, transmission: Transmission, airtime: int = 0, *, draws: bool = True) -> None:
        """Send a transmission to each of its receivers that it can reach."""
        _, src, created, size, receivers, content, port, reachable, to_one = transmission
        self._log.start(transmission)
        for hear in self._listeners:
            hear(content, LOST)
        datagram = self._wire.encode(content, port, size, to_one=to_one, now=self._env.now)
        causes: dict[int, Cause] = {} if reachable else dict.fromkeys(receivers, "out_of_range")
        apart = None if self._fault_state is None else self._fault_state.separated(src, receivers)
        causes |= {node: cause for node, cause in zip(receivers, apart or (), strict=bool(apart)) if cause}
        number = int.from_bytes(datagram[:8], "big")
        sent = SentDatagram(number, self._env.now, tuple(receivers), causes, created, len(datagram), datagram, to_one)
        self.departures.append(sent)
        for node in receivers:
            if node not in causes:
                self._post(datagram, node)

    # Receiving.

    def receive(self, datagram: bytes, sender: int | None) -> None:
        """Take a datagram that has arrived now; drop it if it is malformed, a replay, or not from whom it names.

        Args:
            datagram: its bytes.
            sender: the node with the address from which it came; None: none has it.
        """
        drops = self.drops
        if sender is None or sender == self._node:
            self.drops = drops._replace(foreign=drops.foreign + 1)
            return
        try:
            parcel = self._wire.decode(datagram)
        except WireError:
            self.drops = drops._replace(malformed=drops.malformed + 1)
            return
        if parcel.src != sender:
            self.drops = drops._replace(foreign=drops.foreign + 1)
        elif self._is_early(parcel):
            self.drops = drops._replace(malformed=drops.malformed + 1)
        elif self._is_replay(parcel):
            self.drops = drops._replace(replayed=drops.replayed + 1)
        else:
            self._arrive(parcel, len(datagram))

    def _is_early(self, parcel: Parcel) -> bool:
        """Return whether a message, whose stamp is not of a skewed clock, was transmitted far in the future."""
        return not isinstance(parcel.content, Record) and parcel.start > self._env.now + MAX_AHEAD

    def _is_replay(self, parcel: Parcel) -> bool:
        """Return whether a datagram has arrived before; note that it has arrived now."""
        seen = self._seen.setdefault(parcel.src, {})
        if parcel.number in seen:
            return True
        seen[parcel.number] = None
        if len(seen) > REMEMBERED:
            del seen[next(iter(seen))]
        return False

    def _arrive(self, parcel: Parcel, size: int) -> None:
        """Draw the fate of a datagram, and schedule its delivery."""
        start = self._start_of(parcel)
        me, src = [self._node], parcel.src
        if self._deliver(parcel, size, start, parcel.number):
            return
        if self._copies and self._draws and self._sampler.duplicates(src, me, start, size):
            self._deliver(parcel, size, start, parcel.number, is_copy=True)

    def _start_of(self, parcel: Parcel) -> int:
        """Return when a transmission started, ns: as it says, if the clock of its sender shows the true time."""
        now = self._env.now
        return min(parcel.start, now) if self.trusts_stamps or not isinstance(parcel.content, Record) else now

    trusts_stamps = True
    """Whether the stamps of records, which are by the clocks of their sources, show the true time."""

    def _deliver(self, parcel: Parcel, size: int, start: int, number: int, *, is_copy: bool = False) -> bool:
        """Lose a datagram, and return True, or schedule its delivery."""
        me, now, src, sampler = [self._node], self._env.now, parcel.src, self._sampler
        transmission = Transmission(
            number, src, start, size, me, parcel.content, parcel.port, reachable=True, to_one=parcel.to_one
        )
        arrival: Any = start
        if self._draws:
            # Both are drawn, also if the message is lost, as where it is sent.
            arrival = sampler.arrivals(src, me, start, 0, size)
            arrival = arrival if isinstance(arrival, int) else arrival[0]
            lost = sampler.losses(src, me, start, size)
            if lost is not None and lost[0]:
                self.outcomes.append(
                    DatagramFate(number, src, self._node, LOST, sampler.cause(src, self._node), is_copy)
                )
                return not is_copy
            if sampler.keeps_order:
                (arrival,) = sampler.in_order(src, me, [arrival])  # type: ignore[misc]  # a list, as given
        self.errors.append(max(now - arrival, 0))
        arrival = max(arrival, now)
        self.outcomes.append(DatagramFate(number, src, self._node, arrival, "", is_copy))
        if self._fault_state is None:
            self.delivery.schedule(transmission, me, [arrival], {}, 0)
        else:  # a fault may have begun since the transmission: that is decided on arrival
            self.delivery.arrivals.schedule(transmission, me, [arrival], 0)
        return False

    def _note_loss(self, transmission: Transmission, causes: Mapping[int, Cause]) -> None:
        """Note a loss on arrival."""
        for cause in causes.values():
            lost = DatagramFate(transmission.number, transmission.src, self._node, self._env.now, cause)
            self.outcomes.append(lost)
