"""Auctions in which each evader is one task: the common part of `cbaa` and `cbba`.

A bid is -phi, where phi is the capture time, so the pursuer with the least phi bids highest; ties go to the lower id. A
pursuer bids for one evader at a time: among the evaders for which it outbids all others, the one that it would capture
first. Its announcement, the claim, carries its action and, for each evader, the winner and the winning bid that the
pursuer knows.

Bids change with positions. Where positions are sensed (payload "action"), each bid is updated before it is compared
(`bid_updater`), so at any instant all pursuers that see the evader rank bids for it alike. Otherwise a bid is at least
as old as the announcement that carries it. An old bid of an active pursuer is too low, because the phi of the pursuer
has fallen since. If the phi of two active pursuers differ by less than the age of the bids, each therefore outbids the
bid that it knows of the other, and both stay active.
"""

from collections.abc import Callable, Iterator, Sequence
from math import inf
from typing import Any, ClassVar, NamedTuple

from desim.kernel.core.message_size import HEADER, NUMBER
from desim.kernel.core.records import Record
from desim.pursuit.team.agent import Agent
from protocols.rule import Rule

NO_WINNER = -1
"""The winner of an evader without bids."""


class Bid(NamedTuple):
    """A bidder and its bid for one evader."""

    winner: int
    amount: float
    """-phi, s; -inf without a bid."""

    @property
    def rank(self) -> tuple[float, float]:
        """The sort key of bids, greater for a better bid.

        `NO_BID` is least, also less than the bid -inf of a pursuer whose capture time is unknown.
        """
        return self.amount, -inf if self.winner == NO_WINNER else -self.winner


NO_BID = Bid(NO_WINNER, -inf)


class Auction(Rule):
    """A rule under which the winner of the auction for an evader chases it."""

    asks_without_choice: ClassVar[bool] = True
    """The announcement of a pursuer that can only be inactive forwards the claims of others."""

    def claim_size(self, pursuers: int, evaders: int) -> int:
        """Return the size of an announcement, bytes: the action, and the winner and the bid of each evader."""
        return HEADER + NUMBER * (1 + 2 * evaders)


def offer(me: Agent, evader: int = 1) -> Bid:
    """Return the present bid of a pursuer for an evader; `NO_BID` if it may not chase, or cannot capture in time."""
    phi = me.capture_time(evader)
    return Bid(me.id, -phi) if me.may_chase(evader) and phi < me.time_left() else NO_BID


def action_and_bids(me: Agent, rival_bids: Sequence[Bid]) -> tuple[int, list[Bid]]:
    """Return the action of a pursuer, and the (M,) best bids with its own included.

    Among the evaders for which it outbids all others, the action is the one with its highest bid; 0 if there is none.

    Args:
        me: the bidder.
        rival_bids: (M,) the best bid of the other pursuers for each evader.
    """
    offers = {evader: offer(me, evader) for evader in me.evaders()}
    evaders_won = [evader for evader, bid in offers.items() if bid.rank > rival_bids[evader - 1].rank]
    action = max(evaders_won, key=lambda evader: offers[evader].rank, default=0)
    return action, [offers[action] if evader == action else bid for evader, bid in enumerate(rival_bids, start=1)]


def lists_of(bids: Sequence[Bid]) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return (M,) best bids as the lists of a claim: the winners z, and the winning bids y."""
    return tuple(bid.winner for bid in bids), tuple(bid.amount for bid in bids)


def bids_of(claim: Any) -> list[Bid]:
    """Return the (M,) bids of a claim (`cbaa.Claim` or `cbba.StampedClaim`), the inverse of `lists_of`."""
    return list(map(Bid, claim.winners, claim.amounts))


def bid_updater(me: Agent, evader: int = 1) -> Callable[[Bid], Bid]:
    """Return the function that updates a bid for an evader to the -phi of its bidder as sensed at this instant.

    The update needs no message from the bidder. While the evader is at large, it never adds or withdraws a bid: only
    the bidder's own claims do. Where positions are not sensed, the function returns bids unchanged. For a captured
    evader it returns `NO_BID`.
    """
    if evader not in me.evaders():
        return lambda _: NO_BID
    if not me.senses_others:
        return lambda bid: bid
    phi = me.team_estimate(evader).capture_times.tolist()
    return lambda bid: bid if bid.winner == NO_WINNER else Bid(bid.winner, -phi[bid.winner])


def unread(me: Agent, last_read: dict[int, int], claim: type[Any]) -> Iterator[Record]:
    """Yield the unread records of `Agent.trusted` with a claim, in order of the source ids, and mark them as read.

    `last_read` maps each source to the sequence number of the last record read. Records of initial actions
    (`announce.start`) carry no claim and are skipped.
    """
    for j, record in sorted(me.trusted().items()):
        if record.seq > last_read.get(j, -1) and isinstance(record.body, claim):
            last_read[j] = record.seq
            yield record
