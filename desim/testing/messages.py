"""Watchers that check invariants of the trace of a network; the invariants hold for all link models and faults.

A message is identified by its receiver and the number of its transmission. It is delivered if it is not lost by the end
of its arrival instant. Faults start and end before the deliveries of an instant: a message that arrives at the instant
of a crash is lost, and one that arrives at the instant of the recovery is delivered. The invariants of a pursuit are in
`desim.testing.pursuits`.
"""

from collections import Counter
from collections.abc import Collection
from math import inf
from typing import TYPE_CHECKING, Any, Literal

from desim.kernel.core.events import CAUSES, LOST, Broadcast, Cause, Delivered, Event, Lost, MessageCounts, Queued, Sent
from desim.kernel.core.units import nanoseconds
from desim.kernel.models.access import CsmaCa
from desim.kernel.models.faults import Crash, Partition
from desim.kernel.models.interference import Collision
from desim.kernel.models.medium import Radio, airtimes
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted, TracedFault
from desim.kernel.transport.frames import carried

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

ON_AIR: Collection[Cause] = frozenset({"collision", "half_duplex", "crash"})
"""Causes of losses before the arrival where nodes contend for the channel; causes of users may be of this kind, too."""
MIN_BATCH = 64
"""Initial limit of the number of unchecked transmissions, above which deliveries are checked.

After such a check, the limit is `MIN_BATCH` plus twice the number of transmissions that are still in flight.
"""


class Conservation:
    """A watcher of one run that raises AssertionError if an invariant is violated.

    - Each sent message is delivered, lost or in flight; the totals and the losses by cause agree with `MessageCounts`.
    - No message is transmitted before it was created or arrives before it was transmitted; time never decreases.
    - A message is lost at most once: while it waits, at transmission, on the air (collision or crash), or on arrival.
    - A node whose radio is down neither transmits nor receives.
    - No message crosses a partition that is active at its transmission or at its arrival.
    - A fault ends only after it has started.

    Deliveries are checked in batches: before a fault starts or ends, when many transmissions are unchecked, at each
    `MessageCounts`, and by `judge`.

    Args:
        fifo: whether to check also that no message overtakes an earlier one on its link.
    """

    def __init__(self, *, fifo: bool = False):
        self._fifo = fifo
        self._now = self._sent = self._delivered = 0
        self._lost: Counter[Cause] = Counter()
        self._waiting: dict[int, set[int]] = {}
        """The remaining receivers of each waiting transmission, by its number."""
        self._queued: set[int] = set()
        """The numbers of the transmissions that have waited; where nodes contend, all transmissions wait."""
        self._flying: dict[int, tuple[Broadcast | Sent, dict[int, int]]] = {}
        """By transmission number: its latest event, and the unchecked arrivals by receiver, ns or `LOST`."""
        self._latest: dict[tuple[int, int], int] = {}
        """The latest arrival (ns) on each link (sender, receiver)."""
        self._faults: list[TracedFault] = []
        self._max_unchecked = MIN_BATCH
        self._handlers: dict[type, Callable[[Any], None]] = {
            Broadcast: self._depart,
            Sent: self._depart,
            Queued: self._queue,
            Lost: self._lose,
            FaultStarted: self._begin,
            FaultEnded: self._end,
            MessageCounts: self._count,
        }

    def __call__(self, event: Event) -> None:
        """Check an event."""
        _require(event.t >= self._now, "time does not run backwards", event)
        self._now = event.t
        handler = self._handlers.get(type(event))
        if handler is not None:
            handler(event)

    def _depart(self, event: Broadcast | Sent) -> None:
        fates = dict(event.fates())
        # A receiver that is listed twice would have one fate.
        _require(isinstance(event, Sent) or len(fates) == len(event.dst), "a message is transmitted once", event)
        _require(event.created <= event.t, "no message is transmitted before it was created", event)
        # LOST is less than any time, so for most events a single comparison is enough.
        if fates and min(fates.values()) < event.t:
            early = any(arrival < event.t for arrival in fates.values() if arrival != LOST)
            _require(not early, "no message arrives before it was transmitted", event)
        if self._faults:
            _require(not self._down(event.src), "a node whose radio is down sends nothing", event)
            across = any(self._cut(event.src, dst) for dst, arrival in fates.items() if arrival != LOST)
            _require(not across, "no message is transmitted across an active partition", event)
        if self._fifo:
            self._check_order(event, fates)
        self._sent += len(fates)
        if event.transmission in self._waiting:  # receivers that were counted when the transmission was queued
            self._sent -= len(self._waiting[event.transmission] & fates.keys())
            self._wait_no_more(event.transmission, fates)
        if event.transmission in self._flying:  # a transmission to several nodes has an event `Sent` for each
            departure, flying = self._flying[event.transmission]
            _require(departure.t == event.t and flying.keys().isdisjoint(fates), "a message is transmitted once", event)
            fates = flying | fates
        self._flying[event.transmission] = event, fates
        if len(self._flying) > self._max_unchecked:
            self._settle(event.t)
            # The limit grows with the number of transmissions in flight, so that the cost per event stays constant.
            self._max_unchecked = MIN_BATCH + 2 * len(self._flying)

    def _check_order(self, event: Broadcast | Sent, fates: dict[int, int]) -> None:
        for dst, arrival in fates.items():
            if arrival != LOST:
                _require(arrival >= self._latest.get((event.src, dst), 0), "no message overtakes another", event)
                self._latest[event.src, dst] = arrival

    def _queue(self, event: Queued) -> None:
        _require(not self._down(event.src), "a node whose radio is down sends nothing", event)
        self._sent += len(event.dst)
        self._queued.add(event.transmission)
        self._waiting.setdefault(event.transmission, set()).update(event.dst)

    def _wait_no_more(self, transmission: int, nodes: "Iterable[int]") -> None:
        """Remove nodes from the remaining receivers of a waiting transmission."""
        self._waiting[transmission].difference_update(nodes)
        if not self._waiting[transmission]:
            del self._waiting[transmission]

    def _lose(self, event: Lost) -> None:
        self._lost[event.cause] += 1
        if event.dst in self._waiting.get(event.transmission, ()):
            self._wait_no_more(event.transmission, [event.dst])
            if event.transmission not in self._waiting and event.transmission not in self._flying:
                self._queued.discard(event.transmission)
        else:
            departure, flying = self._flying.get(event.transmission, (event, {}))
            arrival = flying.pop(event.dst, None)
            due = departure.t if arrival == LOST else arrival
            _require(due is not None and due >= event.t, "only a message in flight is lost, and only once", event)
            # Where nodes contend, a frame is lost in the noise at the end of its airtime, before its arrival.
            is_noise = event.cause == "loss" and event.transmission in self._queued
            is_early = event.cause in ON_AIR or event.cause not in CAUSES or is_noise
            is_on_air = is_early and event.t >= departure.t
            _require(is_on_air or due == event.t, "a message is lost at transmission, on the air or on arrival", event)

    def _begin(self, event: FaultStarted) -> None:
        self._settle(event.t)
        self._faults.append(event.fault)

    def _end(self, event: FaultEnded) -> None:
        self._settle(event.t)
        _require(event.fault in self._faults, "only a fault that started ends", event)
        self._faults.remove(event.fault)

    def _count(self, event: MessageCounts) -> None:
        self._settle(event.t + 1)  # the counts include the deliveries of this instant
        in_flight = sum(len(flying) for _, flying in self._flying.values()) + sum(map(len, self._waiting.values()))
        observed = (self._sent, self._delivered, self._lost.total(), in_flight)
        counted = (event.sent, event.delivered, event.lost, event.in_flight)
        same = observed == counted and self._lost == Counter(event.lost_by)
        _require(same, f"sent, delivered, lost, in flight are {observed}, lost by cause {dict(self._lost)}", event)

    def judge(self) -> None:
        """Check the deliveries before the time of the last event; call it after a run without `MessageCounts`."""
        self._settle(self._now)

    def _settle(self, before: int) -> None:
        """Check and count the unchecked deliveries before a time (ns).

        It is called before the faults change, so all these deliveries happened under the active faults.
        """
        for transmission, (event, flying) in list(self._flying.items()):
            if event.t < before:
                _require(LOST not in flying.values(), "a message that never arrives has a Lost event", event)
                reached = [dst for dst, arrival in flying.items() if arrival < before]
                self._delivered += len(reached)
                if self._faults:
                    self._check_reached(event, reached)
                if len(reached) == len(flying):
                    del self._flying[transmission]
                    if transmission not in self._waiting:
                        self._queued.discard(transmission)
                else:
                    self._flying[transmission] = (
                        event,
                        {dst: arrival for dst, arrival in flying.items() if arrival >= before},
                    )

    def _check_reached(self, event: Broadcast | Sent, nodes: "Iterable[int]") -> None:
        for node in nodes:
            _require(not self._down(node), f"no message reaches {node}, whose radio is down", event)
            _require(not self._cut(event.src, node), f"no message reaches {node} across a partition", event)

    def _down(self, node: int) -> bool:
        return any(isinstance(fault, Crash) and fault.node == node for fault in self._faults)

    def _cut(self, src: int, dst: int) -> bool:
        return any(isinstance(fault, Partition) and fault.separates(src, dst) for fault in self._faults)


class DeliveredOnce:
    """A watcher of one run that raises AssertionError if a transport delivers a message twice, or out of order.

    - A message is delivered at most once to each receiver, unless the receiver has lost its memory in between.
    - Messages of a sender to a receiver at a port that is `ordered` are delivered in the order in which they were sent.
      Messages to all neighbours have an order of their own.

    Args:
        ordered: the ports at which messages are delivered in order, or True for all.
    """

    def __init__(self, ordered: "Collection[str] | Literal[True]" = ()):
        self._ordered = ordered
        self._delivered: dict[tuple[int, int, str, bool], set[tuple[int, int]]] = {}
        """By sender, receiver, port, and whether to all: the time and the number of each delivered message."""
        self._last: dict[tuple[int, int, str, bool], tuple[int, int]] = {}
        """By the same keys: the time and the number of the last delivered message."""

    def __call__(self, event: Event) -> None:
        """Check an event."""
        if isinstance(event, FaultEnded) and isinstance(event.fault, Crash) and not event.fault.memory:
            for flow in [flow for flow in self._delivered if flow[1] == event.fault.node]:
                del self._delivered[flow], self._last[flow]
        elif isinstance(event, Delivered):
            flow, message = (event.src, event.dst, event.port, event.to_all), (event.created, event.seq)
            _require(event.created <= event.t, "no message is delivered before it was sent", event)
            _require(message not in self._delivered.get(flow, ()), "a message is delivered once", event)
            if self._ordered is True or event.port in self._ordered:
                _require(message > self._last.get(flow, (0, 0)), "messages are delivered in order", event)
            self._delivered.setdefault(flow, set()).add(message)
            self._last[flow] = message


class OneToken:
    """A watcher of one run that raises AssertionError if there are more tokens than allowed.

    A token has an epoch and a hop number. A regenerated token has a new epoch, see `protocols.schedules.token_passing`.
    A hop passes the token to another node; a retransmission of an unacknowledged token is not a new hop.

    - An epoch has at most one token: its hop numbers increase, and each hop has one sender and one receiver.
    - From the time `settled` on, there is only one token: no epoch reappears after a hop of another epoch.

    Args:
        kind: the type of the message bodies that are tokens; it has an `epoch` and a hop number `hop`.
        group: the nodes whose sent tokens are checked; None: all nodes.
        settled: the time, ns, from which only one token may be left; None: this is not checked.

    Attributes:
        spoilt: the last time, ns, at which an epoch reappeared, so the group had two tokens; -1 if never.
    """

    def __init__(self, kind: type[Any], group: "Collection[int] | None" = None, *, settled: int | None = None):
        self._kind, self._group, self._settled = kind, group, settled
        self._passed: set[Any] = set()
        self._hops: dict[Any, int] = {}
        """The last hop of each epoch."""
        self._epoch: Any = None
        self.spoilt = -1

    def __call__(self, event: Event) -> None:
        """Check an event."""
        if isinstance(event, Sent) and isinstance(token := carried(event.body), self._kind):
            hop = event.src, event.dst, token.epoch, token.hop
            if hop not in self._passed and (self._group is None or event.src in self._group):
                self._passed.add(hop)
                self._check_hop(event, token.epoch, token.hop)

    def _check_hop(self, event: Sent, epoch: Any, hop: int) -> None:
        _require(hop > self._hops.get(epoch, -1), "an epoch has one token", event)
        if epoch in self._hops and epoch != self._epoch:
            self.spoilt = event.t
            _require(self._settled is None or event.t < self._settled, "only one token is left", event)
        self._hops[epoch], self._epoch = hop, epoch


class OneFrame:
    """A watcher of one run that raises AssertionError if a node receives a frame that overlaps another frame.

    The other frame is one that the node also receives, or one that the node transmits. The invariant holds for the
    interference model `Collision`; other models let a receiver get the stronger of two frames. Messages that are
    acknowledged are not watched, because the trace does not have the times of their attempts.

    Args:
        medium: the medium for which nodes contend.

    Raises:
        ValueError: if nodes do not contend for the medium, or its interference model allows overlaps.
    """

    def __init__(self, medium: Radio):
        if not medium.contends or type(medium.reception) is not Collision:
            raise ValueError('frames that overlap are all lost only where nodes contend and reception is "collision"')
        self._airtime, self._acknowledges = airtimes(medium), isinstance(medium.access, CsmaCa)
        self._frames: dict[int, tuple[Broadcast | Sent, int, set[int]]] = {}
        """By number of a transmission: its first event, the end of its airtime, ns, and the nodes that get it."""

    def __call__(self, event: Event) -> None:
        """Check an event."""
        if isinstance(event, Lost):
            if event.transmission in self._frames:
                self._frames[event.transmission][2].discard(event.dst)
            return
        if not isinstance(event, Broadcast) and (not isinstance(event, Sent) or self._acknowledges):
            return
        self._check(event.t)
        end = event.t + nanoseconds(self._airtime(event.size, event.src))
        nodes = set(event.dst) if isinstance(event, Broadcast) else {event.dst}
        self._frames.setdefault(event.transmission, (event, end, set()))[2].update(nodes)

    def judge(self) -> None:
        """Check the frames that end by the last event; call it after a run."""
        self._check(None)

    def _check(self, now: int | None) -> None:
        """Check the frames that have ended before a time, ns, and forget those that no later frame overlaps."""
        ended = [number for number, (_, end, _) in self._frames.items() if now is None or end < now]
        for number in ended:
            event, end, nodes = self._frames[number]
            for other, (overlapping, other_end, other_nodes) in self._frames.items():
                if other != number and max(event.t, overlapping.t) < min(end, other_end):
                    _require(overlapping.src not in nodes, "no node receives while it transmits", event)
                    both = nodes & other_nodes if other in ended else set()  # a frame on the air may still be lost
                    _require(not both, "no node receives two frames that overlap", event)
        on_air = [event.t for number, (event, *_) in self._frames.items() if number not in ended]
        for number in ended:
            if self._frames[number][1] <= min(on_air, default=inf):
                del self._frames[number]


def _require(truth: bool, invariant: str, event: Event) -> None:
    if not truth:
        raise AssertionError(f"{invariant}: {event}")
