"""A schedule by mutual exclusion: no two neighbours decide at once, and each knows the last decision of the other.

Paper: Ricart & Agrawala 1981, "An Optimal Algorithm for Mutual Exclusion in Computer Networks", here among neighbours.
    A pursuer that wants to decide sends a request to all neighbours. A neighbour replies at once, unless it has an
    older request of its own (by the time stamps of Lamport 1978); then it replies after its own decision. Replies carry
    the replier's action.
Parameters: rate (requests per second of an idle pursuer), attempts (unanswered requests after which a neighbour is left
    out), min_timeout (least time before a request is retransmitted).
Assumes: symmetric links; a neighbour that does not answer `attempts` requests has crashed or is out of range. Mutual
    exclusion holds only between neighbours, and a pursuer has up-to-date knowledge only of its neighbours' actions.
Messages: 2 d_i per decision of a pursuer with d_i neighbours. A decision takes at least 2 L, where L is the one-way
    latency. If a reply is missing at the time-out, the request is retransmitted, and a neighbour that defers its reply
    answers with `Deferred`. The transmission queues are stable if the channel can carry the 2 d_i messages of every
    decision.
Robust to loss: yes. Requests are retransmitted until they are answered. The pursuer with the oldest request waits
    only for neighbours that do not answer. These are left out after `attempts` requests, so no pursuer waits for ever.
    A neighbour that was left out still gets requests. Once it answers one, its replies are awaited again.
"""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import Field

from desim.config.model import Duration, Rate, Value
from desim.kernel.core.message_size import HEADER, NUMBER
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.ports import ReservedPort
from desim.kernel.core.records import Record
from desim.kernel.core.units import nanoseconds
from desim.pursuit.team.agent import Agent, Process
from protocols.schedules.retransmission import RetransmissionTimer, Waiting, arrival_or_timeout

PORT = ReservedPort("mutex", __name__)
"""The port at which the messages of the mutual exclusion arrive."""

Stamp = tuple[int, int]
"""Lamport time and id of a request: unique, and smaller for an older request."""


class Request(NamedTuple):
    """Asks for permission to decide."""

    stamp: Stamp


class Reply(NamedTuple):
    """Grants a request."""

    stamp: Stamp
    """The stamp of the request."""
    records: tuple[Record, ...]
    """The announcement of the replier."""


class Deferred(NamedTuple):
    """Answers a repeated request that is not yet granted."""

    stamp: Stamp
    """The stamp of the request."""


class LocalMutex(Value):
    """After an exponentially distributed wait, a pursuer asks all neighbours for permission to revise its action."""

    spreads_to: ClassVar[Literal["neighbours"]] = "neighbours"
    """Replies carry the replier's announcement, and requests are retransmitted until the replies arrive."""
    kind: Literal["local_mutex"] = "local_mutex"
    rate: Rate = 5.0
    """Rate of new requests of an idle pursuer, 1/s.

    With a low rate the team reacts late; at a high one, requests wait for each other.

    If in doubt, use 5, and less in dense networks, where each request takes a reply from every neighbour.
    """
    attempts: Annotated[int, Field(ge=1, strict=True)] = 10
    """Number of unanswered requests to a neighbour after which the neighbour is left out.

    With few attempts, losses leave out neighbours that are up, which may then revise at the same time; many delay a
    revision after a crash.

    If in doubt, use 10, which is enough up to a loss of about 0.3.
    """
    min_timeout: Duration = 0.001
    """Least time after which a request is retransmitted, s; the first time-out is 5/4 of a round trip if longer."""

    def mean_slot(self, me: Agent) -> float:
        """Return the mean time between two decisions of the team, s: (1 / rate + 2 L + A) / N, at least (d + 1) L / N.

        The lower bound corresponds to one decision per L in each neighbourhood. N is the team size and L the latency. d
        is the mean degree of the team, so that all pursuers compute the same value; A is the airtime of requests to d
        neighbours and of their replies.
        """
        degree, latency = me.mean_degree, me.latency
        airtime = degree * portable_sum(map(me.airtime, request_and_reply(me)))
        return max(1.0 / self.rate + 2.0 * latency + airtime, (degree + 1) * latency) / me.team_size

    def message_size(self, pursuers: int, announcement: int) -> int:
        """Return the size of a reply, bytes."""
        return HEADER + 2 * NUMBER + announcement

    def without_serial_decisions(self) -> dict[str, Any]:
        """Return the table, as in a scenario file, of a Poisson schedule with the same `rate`."""
        return {"kind": "poisson", "rate": self.rate}

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise each time all neighbours have granted a request; neighbours that are left out do not count."""
        section = CriticalSection(me, self.attempts, self.min_timeout)
        rng = me.stream("mutex")
        while True:
            yield from section.idle(me.now + rng.exponential(1.0 / self.rate))
            yield from section.enter()
            revise()
            me.announce()
            section.leave()


def request_and_reply(me: Agent) -> tuple[Request, Reply]:
    """Return a request and its reply; only their sizes matter."""
    stamp, record = (0, 0), Record(me.id, 0, 0, me.announcement())
    return Request(stamp), Reply(stamp, (record,))


class CriticalSection:
    """The mutual exclusion as run by one pursuer.

    The pursuer is idle (`idle`), waiting (`enter`) or inside (from the end of `enter` to `leave`). An idle pursuer
    grants every request. A waiting pursuer grants requests older than its own and defers the others until `leave`.
    """

    def __init__(self, me: Agent, attempts: int, min_timeout: float):
        self._me, self._attempts = me, attempts
        sending_time = len(me.neighbours()) * portable_sum(map(me.interval, request_and_reply(me)))
        self._time_out = RetransmissionTimer(me, sending_time, min_timeout)
        self._highest = 0  # highest Lamport time of the requests so far
        self._own_request: Stamp | None = None  # stamp of its own request; None without one
        self._missing: dict[int, int] = {}  # by neighbour without a reply: number of unanswered requests
        self._deferred: dict[int, Stamp] = {}  # by neighbour that waits for a reply: stamp of its request
        self._silent: set[int] = set()  # neighbours that are left out

    def idle(self, until: float) -> Process:
        """Answer requests, without sending any, until a time on the local clock, s."""
        while not (yield from self._wait(until)):
            pass

    def enter(self) -> Process:
        """Send a request to all neighbours, and wait until all that are not left out have replied."""
        self._ask()
        attempt = 0
        while self._missing:
            until, attempt = self._me.now + self._time_out(attempt), attempt + 1
            while self._missing:
                if (yield from self._wait(until)):
                    self._ask_again()
                    break
            if self._me.now > until + self._time_out():  # the pursuer was down, so its beliefs may be outdated
                self._ask()

    def leave(self) -> None:
        """End the pursuer's own request, and reply to all deferred requests."""
        self._own_request = None
        for j, stamp in self._deferred.items():
            self._reply(j, stamp)
        self._deferred.clear()

    def _ask(self) -> None:
        """Send a new request to all neighbours; first reply to the deferred requests, which are older."""
        self.leave()
        me = self._me
        # The clock keeps the time stamps increasing even after a loss of memory.
        self._highest = max(self._highest + 1, nanoseconds(me.now))
        self._own_request = (self._highest, me.id)
        neighbours = me.neighbours()
        self._missing = {j: 1 for j in neighbours if j not in self._silent}
        for j in neighbours:
            me.send(j, Request(self._own_request), PORT)

    def _ask_again(self) -> None:
        """Retransmit the request to neighbours that have not replied; leave out those with no attempt left."""
        assert self._own_request is not None
        for j, requests in list(self._missing.items()):
            if requests < self._attempts:
                self._missing[j] += 1
                self._me.send(j, Request(self._own_request), PORT)
            else:
                del self._missing[j]
                self._silent.add(j)

    def _wait(self, until: float) -> Waiting:
        """Wait for a message or until a time (s, local clock), process all messages; return whether the time is up."""
        due = yield from arrival_or_timeout(self._me, PORT, until)
        for message in self._me.mail(PORT):
            self._process(message.src, message.body)
        return due

    def _process(self, src: int, body: Request | Reply | Deferred) -> None:
        """Process a message."""
        if isinstance(body, Request):
            self._process_request(src, body.stamp)
            return
        self._silent.discard(src)
        if isinstance(body, Reply):
            self._me.merge_records(body.records)
        if body.stamp == self._own_request and src in self._missing:
            if isinstance(body, Reply):
                del self._missing[src]
            else:  # the neighbour is up, so its attempts are counted anew
                self._missing[src] = 0

    def _process_request(self, src: int, stamp: Stamp) -> None:
        """Reply to a request, or defer the reply if this pursuer's own request is older.

        If a request of this neighbour has been deferred before, also answer with `Deferred`.
        """
        self._highest = max(self._highest, stamp[0])
        if self._own_request is None or stamp < self._own_request:
            self._reply(src, stamp)
            return
        if src in self._deferred:
            self._me.send(src, Deferred(stamp), PORT)
        self._deferred[src] = stamp

    def _reply(self, dst: int, stamp: Stamp) -> None:
        self._me.send(dst, Reply(stamp, (self._me.record(self._me.announcement()),)), PORT)
