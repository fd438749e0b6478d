"""Circulation of one token: forwarding, detection of its loss, regeneration, and removal of duplicates.

Paper: Le Lann 1977, "Distributed Systems - Towards a Formal Approach", for the loss of a token in a ring. Here each
    regenerated token has its own epoch, and a node discards any token of an older epoch than the newest it has seen.
Parameters: holding_time (time at each pursuer), attempts (transmissions of the token before a neighbour is given up);
    both belong to the schedule.
Assumes: nothing; in the end each component of the graph has a single token. A token is not regenerated needlessly if a
    round, in which it visits all N pursuers, takes less than 3 N (L + holding_time); L is the delay of a hop.
Messages: two each time the token is forwarded: the token and its receipt. A node broadcasts a notice when it gives the
    token a new epoch, and when the token has not visited some pursuer for long. Receivers forward a new notice to those
    of their neighbours that the sender of the notice does not reach. A probe is a notice to one absent neighbour, which
    answers it with a receipt.
Robust to loss: yes. The token is retransmitted until its receipt arrives. A neighbour that does not answer is recorded
    in the token as absent, and all pursuers skip it; it is probed now and then, and included again when it answers.
    A lost token is regenerated; the time-out is shorter for lower ids. Crashes, partitions and delayed messages can
    produce several tokens; each has its own epoch, and nodes that have seen the newest epoch discard the others.
"""

from collections.abc import Callable, Iterable

from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.records import Record
from desim.pursuit.team.agent import Agent, Process
from protocols.schedules.retransmission import RetransmissionTimer, Waiting, arrival_or_timeout
from protocols.schedules.token_messages import (
    PORT,
    UNHEARD,
    Age,
    Token,
    TokenMessage,
    TokenNotice,
    TokenReceipt,
    age_of,
    longest_absent,
    neglects,
    visited,
)

Choice = Callable[[Agent, Token], int | None]
"""Given the holder and the token, returns the next holder; None: the token is kept."""


def circulate(me: Agent, revise: Callable[[], None], holding_time: float, attempts: int, choose: Choice) -> Process:
    """Hold each token for the holding time, then revise, announce the action, and forward the token.

    Pursuer 0 makes the first token. A lost token is regenerated.
    """
    node = TokenNode(me, holding_time, attempts)
    if me.id == 0:
        node.regenerate()
    while True:
        if node.token is None:
            yield from node.watch()
        elif (yield from node.keep(node.token)):
            revise()
            me.announce()
            yield from node.forward(node.token, choose)


def full_token(me: Agent) -> Token:
    """Return a token of full size, with one record per pursuer; only its size matters."""
    records = (Record(me.id, 0, 0, me.announcement()),) * me.team_size
    return Token(UNHEARD, 0, (0,) * me.team_size, (), records)


def hop_time(me: Agent) -> float:
    """Return the typical delay, s, of a token with the records of all pursuers, its airtime included."""
    return me.latency + me.airtime(full_token(me))


def loss_timeout(me: Agent, holding_time: float, time_outs: Iterable[float]) -> float:
    """Return the time, s, without a sign of the token after which a pursuer regenerates it.

    It is the time of three rounds and of all attempts to reach a silent neighbour, with their `time_outs` (s), plus two
    hops for each pursuer of lower id. These two hops give the notice of a regenerated token time to reach the pursuer
    of next higher id before that pursuer regenerates the token, too.
    """
    hops = 3 * me.team_size + 2 * me.id
    longest_hop = me.latency + me.interval(full_token(me))
    return hops * (longest_hop + holding_time) + portable_sum(time_outs)


class TokenNode:
    """The part of one pursuer in the circulation of the token.

    A node has three states:

    - watching: it has no token; after `loss_timeout` without a sign of the token it regenerates the token;
    - holding: it keeps the token for `holding_time`;
    - forwarding: it has sent the token and awaits the receipt.

    A message with a newer epoch ends holding and forwarding.

    Attributes:
        token: the token while holding or forwarding, else None.
    """

    def __init__(self, me: Agent, holding_time: float, attempts: int):
        self._me, self._holding_time, self._attempts = me, holding_time, attempts
        self.token: Token | None = None
        self._next: int | None = None  # the pursuer whose receipt is awaited
        self._newest: Age = (UNHEARD, 0)  # age of the newest message about a token
        self._last_token = Token(UNHEARD, 0, (0,) * me.team_size, (), ())  # the last token held
        self._answered: set[int] = set()  # pursuers that answered since the last forwarding or new epoch
        self._memory_lost = me.restarts > 0  # a crash may have cleared the memory of tokens held
        sending_time = me.interval(full_token(me))
        # The time-out covers a round trip and the messages that are queued ahead of the token and of its receipt.
        self._time_out = RetransmissionTimer(
            me, sending_time + 5.0 * me.interval(TokenNotice(UNHEARD, 0)), holding_time
        )
        self._next_probe = 0.0  # the next probe is not sent before this local time, s
        self._loss_timeout = loss_timeout(me, holding_time, map(self._time_out, range(attempts)))
        self._deadline = me.now + self._loss_timeout  # local time, s, at which the token is considered lost

    # The states.

    def watch(self) -> Process:
        """Wait for messages; regenerate the token if there is no sign of it until the deadline."""
        deadline = self._deadline
        if (yield from self._wait(deadline)) and self._deadline == deadline:
            self.regenerate()

    def regenerate(self) -> None:
        """Make a new token from the last one that the pursuer held."""
        self._renew(self._last_token)

    def keep(self, token: Token) -> Waiting:
        """Hold the token for the holding time; return whether it is still valid then."""
        until = self._me.now + self._holding_time
        while self.token is token:
            if (yield from self._wait(until)):
                return self.token is token
        return False

    def forward(self, token: Token, choose: Choice) -> Process:
        """Update the token with all known records, and send it to neighbours in turn until one confirms it.

        `choose` selects each neighbour; if it returns None, the token is kept.
        """
        token = self._updated(token)
        while (dst := choose(self._me, token)) is not None:
            yield from self._deliver(token, dst)
            if self.token is not token:
                return
            token = self._without(token, dst)

    def _deliver(self, token: Token, dst: int) -> Process:
        """Transmit the token until it is confirmed or superseded, or no attempt is left."""
        self._next = dst
        for attempt in range(self._attempts):
            self._me.send(dst, token, PORT)
            until = self._me.now + self._time_out(attempt)
            while self.token is token and not (yield from self._wait(until)):
                pass
            if self.token is not token:
                break
        self._next = None

    def _wait(self, until: float) -> Waiting:
        """Wait for a message or until a time (s, local clock), and process all messages.

        Return whether the time is up; False after a crash.
        """
        me = self._me
        due = yield from arrival_or_timeout(me, PORT, until)
        crashed = me.now > until + self._holding_time
        if crashed:  # this pursuer was down: others may have regenerated the token
            self.token = None
            self._reset_deadline()
        for message in me.mail(PORT):
            self._process(message.src, message.body)
        return due and not crashed

    # Messages.

    def _process(self, src: int, body: TokenMessage) -> None:
        """Process a message; if its epoch is newer, discard the token held here."""
        age = age_of(body)
        newer = age > self._newest
        if isinstance(body, Token):
            self._me.merge_records(body.records)
        if body.epoch < self._newest[0]:
            self._answer(src, self._newest)
            return
        if newer:
            self._record_age(age)
        if isinstance(body, Token):
            self._receive(src, body)
        elif isinstance(body, TokenReceipt):
            self._release(src, age)
        else:
            if body.asks:
                self._answer(src, age)
            if newer:
                self._forward_notice(src, body._replace(asks=False))

    def _record_age(self, age: Age) -> None:
        """Record the age of a newer message about the token; discard the token held here if the epoch is newer."""
        if age[0] > self._newest[0]:
            self.token = None
            self._answered.clear()
        self._newest = age
        self._reset_deadline()

    def _receive(self, src: int, token: Token) -> None:
        """Confirm the receipt of a token and, unless it is a duplicate, hold it.

        A node that has lost its memory may not recognise a duplicate, so it gives the token a new epoch.
        """
        self._answer(src, age_of(token))
        if age_of(token) > age_of(self._last_token):
            self._take(token)
            if self._memory_lost:
                self._renew(token)

    def _release(self, src: int, age: Age) -> None:
        """Give up the token if the receipt from `src` confirms it."""
        self._answered.add(src)
        if self.token is not None and (src, age) == (self._next, age_of(self.token)):
            self.token = None
            self._reset_deadline()

    def _answer(self, dst: int, age: Age) -> None:
        self._me.send(dst, TokenReceipt(*age), PORT)

    def _forward_notice(self, src: int, notice: TokenNotice) -> None:
        """Forward a notice to the neighbours that its sender, `src`, does not reach."""
        reached = {src, *self._me.neighbours(src)}
        for j in self._me.neighbours():
            if j not in reached:
                self._me.send(j, notice, PORT)

    def _reset_deadline(self) -> None:
        """Set the deadline to a whole `loss_timeout` from now."""
        self._deadline = self._me.now + self._loss_timeout

    # The token.

    def _take(self, token: Token) -> None:
        """Hold a token."""
        self.token = self._last_token = token
        self._newest = max(self._newest, age_of(token))

    def _renew(self, token: Token) -> None:
        """Hold a token under a unique epoch newer than all known ones, and broadcast a notice of it."""
        self._memory_lost = False
        self._answered.clear()
        token = token._replace(epoch=(self._newest[0][0] + 1, self._me.id, self._me.now))
        self._take(token)
        self._me.send(None, TokenNotice(*age_of(token)), PORT)

    def _without(self, token: Token, dst: int) -> Token:
        """Hold the token in a new epoch, with a silent pursuer recorded as absent, and return it.

        The new epoch invalidates the old token, in case the silent pursuer has received it.
        """
        self._renew(token._replace(absent=(*token.absent, dst), visits=visited(token, dst)))
        assert self.token is not None
        return self.token

    def _updated(self, token: Token) -> Token:
        """Update the token after a revision, hold it and return it.

        The token gets one more hop and all known records. Absentees that have answered are no longer absent, and one
        absentee may be probed. Every N hops a notice is broadcast if the token has not visited some pursuer for long.
        """
        me = self._me
        token = token._replace(hop=token.hop + 1, absent=tuple(j for j in token.absent if j not in self._answered))
        self._answered.clear()
        token = self._probed(token._replace(visits=visited(token, me.id)))
        token = token._replace(records=(me.record(me.announcement()), *me.latest_records().values()))
        self._take(token)
        if token.hop % me.team_size == 0 and neglects(token):
            me.send(None, TokenNotice(*age_of(token)), PORT)
        return token

    def _probed(self, token: Token) -> Token:
        """Probe the absent neighbour that is due, if any, and return the token with a record of the probe.

        A neighbour is due at most once in N hops (`longest_absent`). This pursuer sends at most one probe per time-out.
        """
        dst = longest_absent(token, self._me.neighbours())
        if dst is None or self._me.now < self._next_probe:
            return token
        self._next_probe = self._me.now + self._time_out()
        self._me.send(dst, TokenNotice(*age_of(token), asks=True), PORT)
        return token._replace(visits=visited(token, dst))
