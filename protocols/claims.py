"""Claims to the one task there is, the evader: what auctions have in common.

A bid is -phi, so that who would capture first bids most; of equal bids that of the lower id counts more. What a pursuer
announces is whom it holds for the winner, so claims spread, are lost and are repeated as announcements are.
Bids change as positions do. Where positions are sensed (payload "action") each is brought up to date before it is
compared (`current`), so that at any instant all pursuers order bids alike. Else a bid is as old as its word is, and
while two chase, each phi falls: whose phi differ by less than that age outbid each other at every turn, and both chase.
"""

from collections.abc import Callable, Iterator
from math import inf
from typing import Any, NamedTuple

from desim.kernel.records import Record
from desim.pursuit.agent import Agent, Process
from protocols.rule import Rule

NOBODY = -1
"""The winner if there is none."""


class Bid(NamedTuple):
    """Who offers how much."""

    winner: int
    amount: float
    """-phi, s; -inf if nobody bids."""

    @property
    def rank(self) -> tuple[float, int]:
        """What is greater the better the bid."""
        return self.amount, -self.winner


NO_BID = Bid(NOBODY, -inf)


class Auction(Rule):
    """A rule by which the winner of an auction chases."""

    def __call__(self, me: Agent) -> Process:
        """Negotiate for one pursuer; who has no choice but to stay takes its turns all the same, to pass word on."""
        actions = self.actions(me)
        yield from self.schedule(me, lambda: me.assign(bool(next(actions))))


def offer(me: Agent) -> Bid:
    """Return what a pursuer bids now; it bids only if it may chase and would be in time."""
    phi = me.capture_time()
    return Bid(me.id, -phi) if me.may_chase() and phi < me.time_left() else NO_BID


def current(me: Agent) -> Callable[[Bid], Bid]:
    """Return what brings a bid up to date: to -phi of its bidder as sensed now, heard of or not.

    Where positions are not sensed a bid stays as it is. Whether the bidder still bids is always for itself to say.
    """
    if not me.senses_others:
        return lambda bid: bid
    phi = me.whereabouts().capture_times.tolist()
    return lambda bid: bid if bid.winner == NOBODY else Bid(bid.winner, -phi[bid.winner])


def unread(me: Agent, read: dict[int, int], claim: type[Any]) -> Iterator[Record]:
    """Yield the records with a claim that are newer than those read before, in order of ids, and note them as read.

    At first, if everyone knows who is active, records have no claim.
    """
    for j, record in sorted(me.trusted().items()):
        if record.seq > read.get(j, -1) and isinstance(record.body, claim):
            read[j] = record.seq
            yield record
