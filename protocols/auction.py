"""Claims to the evaders, of which each is one task: what auctions have in common.

A bid is -phi, so that who would capture first bids most; of equal bids that of the lower id counts more. A pursuer bids
for one evader at a time: of those for which nobody bids more, the one it would capture first. What it announces is whom
it holds for the winner of each, so claims spread, are lost and are repeated as announcements are.
Bids change as positions do. Where positions are sensed (payload "action") each is brought up to date before it is
compared (`current`), so that at any instant all pursuers order bids alike. Else a bid is as old as its word is, and
while two chase, each phi falls: whose phi differ by less than that age outbid each other at every turn, and both chase.
"""

from collections.abc import Callable, Iterator, Sequence
from math import inf
from typing import Any, NamedTuple

from desim.kernel.message_size import HEADER, NUMBER
from desim.kernel.records import Record
from desim.pursuit.agent import Agent, Process
from protocols.rule import Rule

NO_WINNER = -1
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


NO_BID = Bid(NO_WINNER, -inf)


Fields = tuple[int, int | tuple[int, ...], float | tuple[float, ...]]
"""What a pursuer does, and the winner and the bid of each evader: plain numbers if there is but one."""


class Auction(Rule):
    """A rule by which the winner of an evader chases it."""

    def __call__(self, me: Agent) -> Process:
        """Negotiate for one pursuer; who has no choice but to stay takes its turns all the same, to pass word on."""
        actions = self.actions(me)
        yield from self.schedule(me, lambda: me.assign(next(actions)))

    def claim_size(self, pursuers: int, evaders: int) -> int:
        """Return the bytes of an announcement: the action, and the winner and the bid of each evader."""
        return HEADER + NUMBER * (1 + 2 * evaders)


def offer(me: Agent, evader: int = 1) -> Bid:
    """Return what a pursuer could bid for an evader now; it bids only if it may chase and would be in time."""
    phi = me.capture_time(evader)
    return Bid(me.id, -phi) if me.may_chase(evader) and phi < me.time_left() else NO_BID


def chosen(me: Agent, others: Sequence[Bid]) -> tuple[int, list[Bid]]:
    """Return what a pursuer does, and the bids with its own.

    Args:
        me: who bids.
        others: (M,) the best bid of another pursuer for each evader.

    Returns:
        The evader, of those for which it can bid more than others do, for which it bids most (0 if there is none); and
        the (M,) best bids.
    """
    offers = {evader: offer(me, evader) for evader in me.evaders()}
    won = [evader for evader, bid in offers.items() if bid.rank > others[evader - 1].rank]
    action = max(won, key=lambda evader: offers[evader].rank, default=0)
    return action, [offers[action] if evader == action else bid for evader, bid in enumerate(others, start=1)]


def claim_fields(action: int, bids: Sequence[Bid]) -> Fields:
    """Return an action and the (M,) best bids as the first fields of a claim."""
    if len(bids) == 1:
        return action, *bids[0]
    return action, tuple(bid.winner for bid in bids), tuple(bid.amount for bid in bids)


def bids_of(claim: Any) -> list[Bid]:
    """Return the (M,) bids of a claim, which begins with what `claim_fields` returns."""
    _, winner, amount = claim[:3]
    return [Bid(winner, amount)] if isinstance(winner, int) else list(map(Bid, winner, amount))


def current(me: Agent, evader: int = 1) -> Callable[[Bid], Bid]:
    """Return what brings a bid for an evader up to date: to -phi of its bidder as sensed now, heard of or not.

    Where positions are not sensed a bid stays as it is. Whether the bidder still bids is always for itself to say.
    Nobody bids any more for an evader that has been captured.
    """
    if evader not in me.evaders():
        return lambda _: NO_BID
    if not me.senses_others:
        return lambda bid: bid
    phi = me.team_estimate(evader).capture_times.tolist()
    return lambda bid: bid if bid.winner == NO_WINNER else Bid(bid.winner, -phi[bid.winner])


def unread(me: Agent, read: dict[int, int], claim: type[Any]) -> Iterator[Record]:
    """Yield the records with a claim that are newer than those read before, in order of ids, and note them as read.

    At first, if everyone knows who is active, records have no claim.
    """
    for j, record in sorted(me.trusted().items()):
        if record.seq > read.get(j, -1) and isinstance(record.body, claim):
            read[j] = record.seq
            yield record
