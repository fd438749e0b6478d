"""A schedule by mutual exclusion: no two neighbours decide at once, and each knows what the other decided last.

Paper: Ricart & Agrawala 1981, "An Optimal Algorithm for Mutual Exclusion in Computer Networks", here among neighbours:
    who wants to decide asks them all; who is asked replies at once, unless it wants to decide itself and asked earlier
    (Lamport 1978), then it replies after its decision. Replies carry what the replier does.
Parameters: rate (wishes to decide per second), attempts (before a neighbour is left out).
Assumes: that neighbours hear each other; that a neighbour which does not answer `attempts` times has broken down or is
    out of reach. Only neighbours exclude each other and are known as they are.
Messages: 2 d_i per decision among d_i neighbours, and at least 2 L; more if it takes longer than expected, for requests
    are repeated then, and who makes others wait says so.
Stable while the channel can carry 2 d_i messages per decision.
Robust to loss: yes. Requests are repeated until they are answered; the oldest waits for nobody but the silent, whom
    it leaves out, so nobody waits for ever. Who was silent is still asked but not waited for until it replies again.
"""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import Field

from desim.config.model import Duration, Rate, Value
from desim.kernel.clock import nanoseconds
from desim.kernel.records import Record
from desim.pursuit.agent import Agent, Process
from protocols.retransmission import RetransmissionTimer, Waiting, wait_for_mail

PORT = "mutex"
"""Where all that concerns the section comes in."""

Stamp = tuple[int, int]
"""Lamport time and id: the smaller is the older, and no two requests have the same."""


class Request(NamedTuple):
    """May I decide?"""

    stamp: Stamp


class Reply(NamedTuple):
    """You may."""

    stamp: Stamp
    """Of the request."""
    records: tuple[Record, ...]
    """What the replier does."""


class Deferred(NamedTuple):
    """Not yet: answer to a request that is repeated."""

    stamp: Stamp
    """Of the request."""


class LocalMutex(Value):
    """Who wants to decide, after exponential waits, asks all neighbours first (Ricart and Agrawala)."""

    spreads_to: ClassVar[Literal["neighbours"]] = "neighbours"
    """Replies carry what the replier does, and are asked for until they come."""
    kind: Literal["local_mutex"] = "local_mutex"
    rate: Rate = 5.0
    """Wishes to decide per second of each pursuer that has none, 1/s."""
    attempts: Annotated[int, Field(ge=1, strict=True)] = 10
    """How often a neighbour that does not answer is asked before it is left out."""
    min_timeout: Duration = 0.001
    """Least time after which a request is repeated, s; it is 5/4 of a round trip if that is longer."""

    def mean_slot(self, me: Agent) -> float:
        """Return (1 / rate + 2 L + A) / N, or (d + 1) L / N if that is longer: one decision per L among neighbours, s.

        d is the mean number of neighbours in the team, so that all agree; A is the airtime of requests to so many and
        of their replies.
        """
        degree, latency = me.mean_degree, me.latency
        return max(1.0 / self.rate + 2.0 * latency + on_air(me, degree), (degree + 1) * latency) / me.team_size

    def without_turns(self) -> dict[str, Any]:
        """Return the schedule under which nobody asks."""
        return {"kind": "poisson", "rate": self.rate}

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise whenever all neighbours agree that it is one's turn."""
        section = CriticalSection(me, self.attempts, self.min_timeout)
        rng = me.stream("mutex")
        while True:
            yield from section.idle(me.now + rng.exponential(1.0 / self.rate))
            yield from section.enter()
            revise()
            me.announce()
            section.leave()


def on_air(me: Agent, neighbours: float) -> float:
    """Return how long one channel is busy with requests to so many neighbours and their replies, s."""
    stamp, record = (0, 0), Record(me.id, 0, 0, me.announcement())
    return neighbours * (me.airtime(Request(stamp)) + me.airtime(Reply(stamp, (record,))))


class CriticalSection:
    """One pursuer's part in the exclusion: it is inside from `enter` to `leave`."""

    def __init__(self, me: Agent, attempts: int, min_timeout: float):
        self._me, self._attempts = me, attempts
        self._time_out = RetransmissionTimer(me, on_air(me, len(me.neighbours())), min_timeout)
        self._highest = 0  # Lamport time of the requests so far
        self._wanted: Stamp | None = None  # its own request
        self._missing: dict[int, int] = {}  # whose replies are missing, and how often they were asked in vain
        self._deferred: dict[int, Stamp] = {}  # who waits for its reply
        self._silent: set[int] = set()  # who did not answer when last waited for

    def idle(self, until: float) -> Process:
        """Do nothing but answer until a time on the own clock, s."""
        while not (yield from self._wait(until)):
            pass

    def enter(self) -> Process:
        """Ask all neighbours, and wait until those that are not silent have replied."""
        self._ask()
        attempt = 0
        while self._missing:
            until, attempt = self._me.now + self._time_out(attempt), attempt + 1
            while self._missing:
                if (yield from self._wait(until)):
                    self._ask_again()
                    break
            if self._me.now > until + self._time_out():  # it broke down: what it knows may be old
                self._ask()

    def leave(self) -> None:
        """Reply to all who wait."""
        self._wanted = None
        for j, stamp in self._deferred.items():
            self._reply(j, stamp)
        self._deferred.clear()

    def _ask(self) -> None:
        """Send a new request to all neighbours."""
        self.leave()
        me = self._me
        self._highest = max(self._highest + 1, nanoseconds(me.now))  # the clock, for it may have lost its memory
        self._wanted = (self._highest, me.id)
        neighbours = me.neighbours()
        self._missing = {j: 1 for j in neighbours if j not in self._silent}
        for j in neighbours:
            me.send(j, Request(self._wanted), PORT)

    def _ask_again(self) -> None:
        """Send the request once more to those that have not replied, and leave out who was asked often enough."""
        assert self._wanted is not None
        for j, asked in list(self._missing.items()):
            if asked < self._attempts:
                self._missing[j] += 1
                self._me.send(j, Request(self._wanted), PORT)
            else:
                del self._missing[j]
                self._silent.add(j)

    def _wait(self, until: float) -> Waiting:
        """Wait for mail, and answer it, until a time on the own clock; return whether that has come."""
        due = yield from wait_for_mail(self._me, PORT, until)
        for message in self._me.mail(PORT):
            self._hear(message.src, message.body)
        return due

    def _hear(self, src: int, body: Request | Reply | Deferred) -> None:
        """Take notice of a message."""
        if isinstance(body, Request):
            self._consider(src, body.stamp)
            return
        self._silent.discard(src)
        if isinstance(body, Reply):
            self._me.merge_records(body.records)
        if body.stamp == self._wanted and src in self._missing:
            if isinstance(body, Reply):
                del self._missing[src]
            else:
                self._missing[src] = 0

    def _consider(self, src: int, stamp: Stamp) -> None:
        """Reply to a request, unless the own one is older."""
        self._highest = max(self._highest, stamp[0])
        if self._wanted is None or stamp < self._wanted:
            self._reply(src, stamp)
            return
        if src in self._deferred:
            self._me.send(src, Deferred(stamp), PORT)
        self._deferred[src] = stamp

    def _reply(self, dst: int, stamp: Stamp) -> None:
        self._me.send(dst, Reply(stamp, (self._me.record(self._me.announcement()),)), PORT)
