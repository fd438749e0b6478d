"""What must hold in every history of a network, whatever its links and faults: watchers that follow each message.

A message is a pair (flight, receiver). It is delivered if it is not lost by the end of the instant at which it arrives.
Faults come first at an instant: what arrives as a crash begins is lost, what arrives as the node recovers is delivered.
What must hold in every pursuit is in `desim.analysis.invariants`.
"""

from collections import Counter
from typing import TYPE_CHECKING, Any

from desim.kernel.events import LOST, Broadcast, Cause, Event, Lost, MessageCounts, Queued, Sent
from desim.kernel.faults import Crash, Fault, FaultEnded, FaultStarted, Partition

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

SOME = 64
"""How many transmissions are left unjudged at least; more, if more are in flight."""


class Conservation:
    """A watcher of one run that raises AssertionError if an invariant is broken, before the next tally is over.

    - What was sent is delivered, lost or in flight, as the tally says: in total, and by each cause.
    - Nothing leaves before it was created or arrives before it left; time does not run backwards.
    - A message is lost once at most: while it waits, as it leaves, or as it arrives.
    - Nobody whose radio is down says anything, and nothing is delivered to it.
    - Nothing is delivered across a partition that was open as it left or is open as it arrives.

    Deliveries are judged together, before a fault begins or ends and whenever many have been made.

    Args:
        fifo: whether no message may overtake an earlier one of its link, either.
    """

    def __init__(self, *, fifo: bool = False):
        self._fifo = fifo
        self._now = self._sent = self._delivered = 0
        self._lost: Counter[Cause] = Counter()
        self._waiting: dict[int, set[int]] = {}
        """Who is to receive each flight."""
        self._flying: dict[int, tuple[Broadcast | Sent, dict[int, int]]] = {}
        """How each flight left, and when it arrives at whom, or `LOST`."""
        self._latest: dict[tuple[int, int], int] = {}
        """The last arrival on each link, from sender to receiver."""
        self._faults: list[Fault] = []
        self._room = SOME
        self._notices: dict[type, Callable[[Any], None]] = {
            Broadcast: self._depart,
            Sent: self._depart,
            Queued: self._queue,
            Lost: self._lose,
            FaultStarted: self._begin,
            FaultEnded: self._end,
            MessageCounts: self._count,
        }

    def __call__(self, event: Event) -> None:
        """Take notice of an event."""
        _require(event.t >= self._now, "time does not run backwards", event)
        self._now = event.t
        notice = self._notices.get(type(event))
        if notice is not None:
            notice(event)

    def _depart(self, event: Broadcast | Sent) -> None:
        fates = dict(event.fates())
        _require(isinstance(event, Sent) or len(fates) == len(event.dst), "a message leaves once", event)
        _require(event.created <= event.t, "nothing leaves before it was created", event)
        if fates and min(fates.values()) < event.t:
            early = any(arrival < event.t for arrival in fates.values() if arrival != LOST)
            _require(not early, "nothing arrives before it left", event)
        if self._faults:
            _require(not self._down(event.src), "who is down says nothing", event)
            across = any(self._cut(event.src, dst) for dst, arrival in fates.items() if arrival != LOST)
            _require(not across, "nothing leaves across an open partition", event)
        if self._fifo:
            self._follow(event, fates)
        self._sent += len(fates)
        if event.flight in self._waiting:
            waiting = self._waiting[event.flight]
            self._sent -= len(waiting & fates.keys())
            waiting.difference_update(fates)
        if event.flight in self._flying:
            left, flying = self._flying[event.flight]
            _require(left.t == event.t and flying.keys().isdisjoint(fates), "a message leaves once", event)
            fates = flying | fates
        self._flying[event.flight] = event, fates
        if len(self._flying) > self._room:
            self._settle(event.t)
            self._room = SOME + 2 * len(self._flying)

    def _follow(self, event: Broadcast | Sent, fates: dict[int, int]) -> None:
        for dst, arrival in fates.items():
            if arrival != LOST:
                _require(arrival >= self._latest.get((event.src, dst), 0), "nothing overtakes on a link", event)
                self._latest[event.src, dst] = arrival

    def _queue(self, event: Queued) -> None:
        _require(not self._down(event.src), "who is down says nothing", event)
        self._sent += len(event.dst)
        self._waiting.setdefault(event.flight, set()).update(event.dst)

    def _lose(self, event: Lost) -> None:
        self._lost[event.cause] += 1
        waiting = self._waiting.get(event.flight, set())
        if event.dst in waiting:
            waiting.remove(event.dst)
        else:
            left, flying = self._flying.get(event.flight, (event, {}))
            arrival = flying.pop(event.dst, None)
            due = left.t if arrival == LOST else arrival
            _require(due is not None and due >= event.t, "only what is on its way is lost, and once", event)
            _require(due == event.t, "a message is lost as it leaves or as it arrives", event)

    def _begin(self, event: FaultStarted) -> None:
        self._settle(event.t)
        self._faults.append(event.fault)

    def _end(self, event: FaultEnded) -> None:
        self._settle(event.t)
        _require(event.fault in self._faults, "only what began is over", event)
        self._faults.remove(event.fault)

    def _count(self, event: MessageCounts) -> None:
        self._settle(event.t + 1)
        in_flight = sum(len(flying) for _, flying in self._flying.values()) + sum(map(len, self._waiting.values()))
        found = (self._sent, self._delivered, self._lost.total(), in_flight)
        same = found == event[1:5] and self._lost == Counter(event.lost_by)
        _require(same, f"sent, delivered, lost, in flight are {found}, lost are {dict(self._lost)}", event)

    def judge(self) -> None:
        """Judge what was delivered before the last event."""
        self._settle(self._now)

    def _settle(self, before: int) -> None:
        """Count as delivered what arrived before an instant; no fault has begun or ended since it arrived."""
        for flight, (event, flying) in list(self._flying.items()):
            if event.t < before:
                _require(LOST not in flying.values(), "what never arrives is lost", event)
                reached = [dst for dst, arrival in flying.items() if arrival < before]
                self._delivered += len(reached)
                for node in reached if self._faults else ():
                    _require(not self._down(node), f"nothing reaches {node}, whose radio is down", event)
                    _require(not self._cut(event.src, node), f"nothing reaches {node} across an open partition", event)
                if len(reached) == len(flying):
                    del self._flying[flight]
                else:
                    self._flying[flight] = event, {dst: arrival for dst, arrival in flying.items() if arrival >= before}

    def _down(self, node: int) -> bool:
        return any(isinstance(fault, Crash) and fault.node == node for fault in self._faults)

    def _cut(self, src: int, dst: int) -> bool:
        return any(isinstance(fault, Partition) and _group(fault, src) != _group(fault, dst) for fault in self._faults)


class OneToken:
    """A watcher of one run that raises AssertionError if there are two tokens where there is to be one.

    - In one epoch there is one, at any time: a hop of it leads from one node to one node, and later hops come later.
    - Once everything is settled one is left: an epoch that was followed by another does not return.

    To send a token again, because no receipt came, is not to pass it on again.

    Args:
        kind: of the bodies that are tokens; each has an `epoch`, and a `hop` that grows as it is passed on.
        group: the nodes among which one is to be left; None: all.
        settled: from when on, ns; None: never.

    Attributes:
        spoilt: when there were last two in the group, ns; -1 if never.
    """

    def __init__(self, kind: type[Any], group: "Collection[int] | None" = None, *, settled: int | None = None):
        self._kind, self._group, self._settled = kind, group, settled
        self._passed: set[Any] = set()
        self._hops: dict[Any, int] = {}
        """The last hop of each epoch."""
        self._epoch: Any = None
        self.spoilt = -1

    def __call__(self, event: Event) -> None:
        """Take notice of an event."""
        if isinstance(event, Sent) and isinstance(event.body, self._kind):
            hop = event.src, event.dst, event.body.epoch, event.body.hop
            if hop not in self._passed and (self._group is None or event.src in self._group):
                self._passed.add(hop)
                self._follow(event, event.body.epoch, event.body.hop)

    def _follow(self, event: Sent, epoch: Any, hop: int) -> None:
        _require(hop > self._hops.get(epoch, -1), "an epoch has one token", event)
        if epoch in self._hops and epoch != self._epoch:
            self.spoilt = event.t
            _require(self._settled is None or event.t < self._settled, "one token is left", event)
        self._hops[epoch], self._epoch = hop, epoch


def _group(partition: Partition, node: int) -> int:
    return next((number for number, group in enumerate(partition.groups) if node in group), -1)


def _require(truth: bool, invariant: str, event: Event) -> None:
    if not truth:
        raise AssertionError(f"{invariant}: {event}")
