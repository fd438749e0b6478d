"""What must hold in every history of a network, whatever its links and faults: a watcher that follows each message.

A message is a pair (flight, receiver). It is delivered if it is not lost by the end of the instant at which it arrives.
Faults come first at an instant: what arrives as a crash begins is lost, what arrives as the node recovers is delivered.
"""

from collections import Counter
from collections.abc import Iterable
from heapq import heappop, heappush

from desim.kernel.events import LOST, Broadcast, Cause, Event, Lost, Queued, Sent, Tally
from desim.kernel.faults import Began, Crash, Fault, Over, Partition

Message = tuple[int, int]
"""Flight and receiver."""


class Conservation:
    """A watcher of one run that raises AssertionError as soon as an invariant is broken.

    - What was sent is delivered, lost or in flight, as the tally says: in total, and by each cause.
    - Nothing leaves before it was created or arrives before it left; time does not run backwards.
    - A message is lost once at most: while it waits, as it leaves, or as it arrives.
    - Nobody whose radio is down says anything, and nothing is delivered to it.
    - Nothing is delivered across a partition that was open as it left or is open as it arrives.

    Args:
        fifo: whether no message may overtake an earlier one of its link, either.
    """

    def __init__(self, *, fifo: bool = False):
        self._fifo = fifo
        self._now = self._sent = self._delivered = 0
        self._lost: Counter[Cause] = Counter()
        self._waiting: set[Message] = set()
        self._flying: dict[Message, tuple[int, Broadcast | Sent]] = {}
        self._due: list[tuple[int, bool, Message]] = []
        """A heap: when each arrives or, if it never does, leaves; whether it arrives."""
        self._latest: dict[Message, int] = {}
        """The last arrival on each link, from sender to receiver."""
        self._faults: list[Fault] = []

    def __call__(self, event: Event) -> None:
        """Take notice of an event."""
        _require(event.t >= self._now, "time does not run backwards", event)
        self._settle(event.t)
        self._now = event.t
        match event:
            case Broadcast():
                arrivals = event.arrival * len(event.dst) if len(event.arrival) == 1 else event.arrival
                self._depart(event, zip(event.dst, arrivals, strict=True))
            case Sent():
                self._depart(event, [(event.dst, event.arrival)])
            case Queued():
                _require(not self._down(event.src), "who is down says nothing", event)
                self._sent += len(event.dst)
                self._waiting |= {(event.flight, dst) for dst in event.dst}
            case Lost():
                self._lose(event, (event.flight, event.dst))
            case Began():
                self._faults.append(event.fault)
            case Over():
                _require(event.fault in self._faults, "only what began is over", event)
                self._faults.remove(event.fault)
            case Tally():
                self._settle(event.t + 1)
                found = (self._sent, self._delivered, self._lost.total(), len(self._flying) + len(self._waiting))
                same = found == event[1:5] and self._lost == Counter(event.lost_by)
                _require(same, f"sent, delivered, lost, in flight are {found}, lost are {dict(self._lost)}", event)

    def _depart(self, event: Broadcast | Sent, fates: Iterable[tuple[int, int]]) -> None:
        _require(event.created <= event.t, "nothing leaves before it was created", event)
        _require(not self._down(event.src), "who is down says nothing", event)
        for dst, arrival in fates:
            message, arrives = (event.flight, dst), arrival != LOST
            _require(message not in self._flying, "a message leaves once", event)
            self._sent += message not in self._waiting
            self._waiting.discard(message)
            if arrives:
                _require(arrival >= event.t, "nothing arrives before it left", event)
            if arrives and self._faults:
                _require(not self._cut(event.src, dst), "nothing leaves across an open partition", event)
            if arrives and self._fifo:
                _require(arrival >= self._latest.get((event.src, dst), 0), "nothing overtakes on a link", event)
                self._latest[event.src, dst] = arrival
            due = arrival if arrives else event.t
            self._flying[message] = (due, event)
            heappush(self._due, (due, arrives, message))

    def _lose(self, event: Lost, message: Message) -> None:
        self._lost[event.cause] += 1
        if message in self._waiting:
            self._waiting.remove(message)
        else:
            _require(message in self._flying, "only what is on its way is lost, and once", event)
            due, _ = self._flying.pop(message)
            _require(event.t == due, "a message is lost as it leaves or as it arrives", event)

    def _settle(self, before: int) -> None:
        """Count as delivered what arrived before an instant; no fault has begun or ended since it arrived."""
        while self._due and self._due[0][0] < before:
            _, arrives, message = heappop(self._due)
            if message in self._flying:
                _, event = self._flying.pop(message)
                self._delivered += 1
                _require(arrives, "what never arrives is lost", event)
                if self._faults:
                    node = message[1]
                    _require(not self._down(node), f"nothing reaches {node}, whose radio is down", event)
                    _require(not self._cut(event.src, node), f"nothing reaches {node} across an open partition", event)

    def _down(self, node: int) -> bool:
        return any(isinstance(fault, Crash) and fault.node == node for fault in self._faults)

    def _cut(self, src: int, dst: int) -> bool:
        return any(isinstance(fault, Partition) and _group(fault, src) != _group(fault, dst) for fault in self._faults)


def _group(partition: Partition, node: int) -> int:
    return next((number for number, group in enumerate(partition.groups) if node in group), -1)


def _require(truth: bool, invariant: str, event: Event) -> None:
    if not truth:
        raise AssertionError(f"{invariant}: {event}")
