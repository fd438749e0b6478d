"""One token that circulates: how it is passed on, how its loss is noticed, and why only one is left in the end.

Paper: the new token is claimed in an epoch of its own, and whoever has seen a newer epoch drops what is older; Le Lann
    1977, "Distributed Systems - Towards a Formal Approach", for a lost token of a ring.
Parameters: hold (time at each pursuer), attempts (before a neighbour is given up); both belong to the schedule.
Assumes: nothing for safety in the end; for no token to be made in vain, that 3 N (L + hold) is longer than a round.
Messages: two per hop, the token and its receipt; a claim and what reassures who was not visited for long are heard by
    all neighbours, and passed on to those who are out of their reach.
Robust to loss: yes. The token is sent again until its receipt. A neighbour that does not answer is left out from then
    on, by everyone, for the token says who is absent; it is greeted now and then, and taken in again when it answers.
    A token that is lost is replaced, by low ids first. Crashes, cuts and late messages can leave several tokens, but
    no two in one epoch, and the older die where the newest has been.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from desim.kernel.records import Record
from desim.pursuit.agent import Agent, Process
from protocols.retransmission import RetransmissionTimer, Waiting, wait_for_mail

Epoch = tuple[int, int, float]
"""Number, claimant and the time on its clock, s: no two claims have the same, not even after a loss of memory."""
Age = tuple[Epoch, int]
"""Epoch and hop: of two tokens, or two words of one, the newer is the greater."""
UNHEARD: Epoch = (0, -1, 0.0)


class Token(NamedTuple):
    """The right to revise, and all that is known."""

    epoch: Epoch
    hop: int
    """How many revisions there were."""
    visits: tuple[int, ...]
    """The hop at which each pursuer was last visited, or tried or greeted in vain; 0 if never."""
    absent: tuple[int, ...]
    """Who did not answer."""
    records: tuple[Any, ...]
    """The newest of each pursuer, as far as the sender knows."""


class TokenReceipt(NamedTuple):
    """Answer to a token or a greeting; what was sent is of no use if the epoch is newer than its own."""

    epoch: Epoch
    hop: int


class TokenNotice(NamedTuple):
    """Word that a token of this age is in use: a claim if the epoch is new."""

    epoch: Epoch
    hop: int
    asks: bool = False
    """Whether an answer is wanted: a greeting."""


def not_absent(token: Token, pursuers: list[int]) -> list[int]:
    """Return those of some pursuers that are not known to be absent."""
    return [j for j in pursuers if j not in token.absent] if token.absent else pursuers


def visited(token: Token, pursuer: int) -> tuple[int, ...]:
    """Return the visits, with one at this hop."""
    return (*token.visits[:pursuer], token.hop, *token.visits[pursuer + 1 :])


def neglects(token: Token) -> bool:
    """Return whether somebody who is present was not visited for N hops, and may come to think that it is lost."""
    return any(last < token.hop - len(token.visits) for j, last in enumerate(token.visits) if j not in token.absent)


def longest_absent(token: Token, pursuers: list[int]) -> int | None:
    """Return who of some pursuers is absent and was not tried or greeted for longest, if that is N hops or more."""
    long_ago = token.hop - len(token.visits)
    due = [j for j in pursuers if j in token.absent and token.visits[j] <= long_ago]
    return min(due, key=token.visits.__getitem__, default=None)


PORT = "token"
"""Where all that concerns the token comes in."""

Choice = Callable[[Agent, Token], int | None]
"""To whom a token goes next; None to keep it."""


def circulate(me: Agent, revise: Callable[[], None], hold: float, attempts: int, choose: Choice) -> Process:
    """Revise whenever the token has been here for `hold` s, and pass it on; claim a new one if it is lost."""
    station = TokenNode(me, hold, attempts)
    if me.id == 0:
        station.set_payload()
    while True:
        if station.token is None:
            yield from station.watch()
        elif (yield from station.keep(station.token)):
            revise()
            me.announce()
            yield from station.forward(station.token, choose)


def full_token(me: Agent) -> Token:
    """Return a token that is as long as one that knows of everyone."""
    records = (Record(me.id, 0, 0, me.announcement()),) * me.team_size
    return Token(UNHEARD, 0, (0,) * me.team_size, (), records)


def hop_time(me: Agent) -> float:
    """Return how long a token that knows of everyone typically travels, its airtime included, s."""
    return me.latency + me.airtime(full_token(me))


class TokenNode:
    """One pursuer's part in the circulation.

    Attributes:
        token: while it is here, until the next has confirmed its receipt.
    """

    def __init__(self, me: Agent, hold: float, attempts: int):
        self._me, self._hold, self._attempts = me, hold, attempts
        self.token: Token | None = None
        self._next: int | None = None  # whose receipt is awaited
        self._newest: Age = (UNHEARD, 0)  # the last sign of a token
        self._taken: Age = (UNHEARD, 0)  # of the last token that was here
        self._seen = Token(UNHEARD, 0, (0,) * me.team_size, (), ())  # what that one said
        self._answered: set[int] = set()  # who has, since the last token left or a new epoch began
        self._forgot = me.restarts > 0  # it may have lost its memory, and with it what it has taken already
        self._hop_time = hop_time(me)
        # There and back, with what may wait in front of the token and of its receipt.
        self._time_out = RetransmissionTimer(
            me, me.airtime(full_token(me)) + 5.0 * me.airtime(TokenNotice(UNHEARD, 0)), hold
        )
        self._greeting = 0.0  # not before this time, on the own clock, is anybody greeted
        self._deadline = me.now + self.patience

    @property
    def patience(self) -> float:
        """How long there may be no sign of the token until this pursuer claims a new one, s.

        Three rounds, and as long as it takes to give a neighbour up; two hops longer for each lower id, so that the
        claim of one is heard before others make theirs.
        """
        hops = 3 * self._me.team_size + 2 * self._me.id
        return hops * (self._hop_time + self._hold) + sum(map(self._time_out, range(self._attempts)))

    # What it does while the token is elsewhere, and while it is here.

    def watch(self) -> Process:
        """Wait for mail; if there has been no sign of the token for too long, claim a new one."""
        deadline = self._deadline
        if (yield from self._wait(deadline)) and self._deadline == deadline:
            self.set_payload()

    def set_payload(self) -> None:
        """Make a token from what was known of the last."""
        self._renew(self._seen)

    def keep(self, token: Token) -> Waiting:
        """Keep the token for its time; return whether it is still here and has not been superseded."""
        until = self._me.now + self._hold
        while self.token is token:
            if (yield from self._wait(until)):
                return self.token is token
        return False

    def forward(self, token: Token, choose: Choice) -> Process:
        """Put all that is known into the token and give it to the next one that confirms its receipt."""
        token = self._updated(token)
        while (dst := choose(self._me, token)) is not None:
            yield from self._deliver(token, dst)
            if self.token is not token:
                return
            token = self._suspect(token, dst)

    def _deliver(self, token: Token, dst: int) -> Process:
        """Send the token until its receipt is confirmed, or superseded, or as often as is reasonable."""
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
        """Wait for mail, and answer it, until a time on the own clock; return whether that has come."""
        me = self._me
        due = yield from wait_for_mail(me, PORT, until)
        overslept = me.now > until + self._hold
        if overslept:  # it broke down meanwhile: others may have replaced the token
            self.token = None
            self._reassured()
        for message in me.mail(PORT):
            self._hear(message.src, message.body)
        return due and not overslept

    # What it hears.

    def _hear(self, src: int, body: Token | TokenReceipt | TokenNotice) -> None:
        """Take notice of a message; the token that is here dies of a newer epoch."""
        age = (body.epoch, body.hop)
        news = age > self._newest
        if isinstance(body, Token):
            self._me.merge_records(body.records)
        if body.epoch < self._newest[0]:
            self._answer(src, self._newest)
            return
        if news:
            self._notice(age)
        if isinstance(body, Token):
            self._receive(src, body)
        elif isinstance(body, TokenReceipt):
            self._release(src, age)
        else:
            if body.asks:
                self._answer(src, age)
            if news:
                self._pass_on(src, body._replace(asks=False))

    def _notice(self, age: Age) -> None:
        """Take note of a newer sign of the token."""
        if age[0] > self._newest[0]:
            self.token = None
            self._answered.clear()
        self._newest = age
        self._reassured()

    def _receive(self, src: int, token: Token) -> None:
        """Confirm the receipt of a token and, unless it is a duplicate, take it."""
        age = (token.epoch, token.hop)
        self._answer(src, age)
        if age > self._taken:
            self._take(token)
            if self._forgot:
                self._renew(token)

    def _release(self, src: int, age: Age) -> None:
        """Let the token go if this is its receipt."""
        self._answered.add(src)
        if self.token is not None and (src, age) == (self._next, self._taken):
            self.token = None
            self._reassured()

    def _answer(self, dst: int, age: Age) -> None:
        self._me.send(dst, TokenReceipt(*age), PORT)

    def _pass_on(self, src: int, sign: TokenNotice) -> None:
        """Tell those that the speaker did not reach."""
        heard = {src, *self._me.neighbours(src)}
        for j in self._me.neighbours():
            if j not in heard:
                self._me.send(j, sign, PORT)

    def _reassured(self) -> None:
        self._deadline = self._me.now + self.patience

    # What it does to the token.

    def _take(self, token: Token) -> None:
        """Have a token here, as it is now."""
        self.token = self._seen = token
        self._taken = (token.epoch, token.hop)
        self._newest = max(self._newest, self._taken)

    def _renew(self, token: Token) -> None:
        """Have a token here in an epoch newer than all that were heard of, and let the neighbours know."""
        self._forgot = False
        self._answered.clear()
        self._take(token._replace(epoch=self._epoch()))
        self._me.send(None, TokenNotice(*self._taken), PORT)

    def _epoch(self) -> Epoch:
        """Return an epoch of its own, newer than all that were heard of."""
        return self._newest[0][0] + 1, self._me.id, self._me.now

    def _suspect(self, token: Token, dst: int) -> Token:
        """Return the token for others than a pursuer that does not answer; the copy that it may have is worthless."""
        self._renew(token._replace(absent=(*token.absent, dst), visits=visited(token, dst)))
        assert self.token is not None
        return self.token

    def _updated(self, token: Token) -> Token:
        """Return the token after a revision, with all that is known here."""
        me = self._me
        token = token._replace(hop=token.hop + 1, absent=tuple(j for j in token.absent if j not in self._answered))
        self._answered.clear()
        token = self._greeted(token._replace(visits=visited(token, me.id)))
        known = (record for _, record in me.latest_records().values())
        token = token._replace(records=(me.record(me.announcement()), *known))
        self._take(token)
        if token.hop % me.team_size == 0 and neglects(token):
            me.send(None, TokenNotice(*self._taken), PORT)
        return token

    def _greeted(self, token: Token) -> Token:
        """Return the token after it was tried whether one of the absent answers again: each once in N hops."""
        dst = longest_absent(token, self._me.neighbours())
        if dst is None or self._me.now < self._greeting:
            return token
        self._greeting = self._me.now + self._time_out()
        self._me.send(dst, TokenNotice(token.epoch, token.hop, asks=True), PORT)
        return token._replace(visits=visited(token, dst))
