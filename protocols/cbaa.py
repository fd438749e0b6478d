"""The consensus-based auction: who hears of no better bid than its own chases.

Paper: Choi, Brunet & How 2009, "Consensus-Based Decentralized Auctions for Robust Task Allocation", Algorithms 1 and 2;
    the evaders are the tasks. Each pursuer knows for each of them the greatest bid y it has heard of and whose it is.
    Other than there, bids follow the times of capture, so at each turn a pursuer chooses and bids anew, and its word
    about its own bid counts for more than what others say of that bid. Where positions are sensed all bids are brought
    up to date at each turn.
Parameters: schedule. With Rounds these are the rounds of the paper.
Assumes: a connected graph and constant bids; then all agree on one winner of one evader after a round of bids and one
    more for each hop of the diameter, and on those of several after at most as many rounds for each: the assignment is
    the greedy one, in order of phi. Where bids change, the greatest only rises as long as its bidder chases, for whose
    phi falls. Who leaves an evader for another tells its neighbours; farther off it is only known that nobody has two.
    Positions that are sensed (payload "action"): with "time" or "state" a bid stays as old as it is, and two whose phi
    differ by less than word is old, in s, may both chase to the end. In the relay stress of `scenarios.rivals` another
    set than the relay pursuer alone is active for 3.4 s on the mean of 20 runs and 23.3 s at worst, at L = 0.2 s;
    sensed, for 0.8 and 1.8 s.
    No crashes: claims have no stamps, so there is no telling that a winner has fallen silent, and it blocks all others
    for ever.
Messages: announcements of 24 bytes and 16 for each evader; news is a new winner, so bids that change need heartbeats or
    `revision`.
Robust to loss: yes, with heartbeats.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar, Literal, NamedTuple

from desim.pursuit.agent import Agent
from protocols.auction import NO_BID, Auction, Bid, bids_of, chosen, claim_fields, current, unread
from protocols.rule import Rule


class Claim(NamedTuple):
    """Whom a pursuer holds for the winner of each evader: plain numbers if there is one evader, else (M,) of them."""

    active: int
    winner: int | tuple[int, ...]
    amount: float | tuple[float, ...]
    """The greatest bid y, s."""

    @property
    def news(self) -> tuple[int, int | tuple[int, ...]]:
        """What is told at once if it changes: action and winner."""
        return self.active, self.winner


class CBAA(Auction):
    """Consensus on the greatest bid: a pursuer that is outbid releases its claim."""

    assumes: ClassVar[tuple[str, ...]] = (*Rule.assumes, "connected", "no_crashes")
    kind: Literal["cbaa"] = "cbaa"

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the evader of which it is the winner."""
        bids, read = [NO_BID] * me.evader_count, dict[int, int]()
        while True:
            claims = {each.src: bids_of(each.body) for each in unread(me, read, Claim)}
            for k, best in enumerate(bids):
                up_to_date = current(me, k + 1)
                said = {j: up_to_date(claim[k]) for j, claim in claims.items()}
                bids[k] = greatest(up_to_date(best), said | {me.id: NO_BID})
            action, bids = chosen(me, one_each(bids))
            me.set_payload(Claim(*claim_fields(action, bids)))
            yield action


def greatest(best: Bid, said: Mapping[int, Bid]) -> Bid:
    """Return the greatest bid, of the best until now and what each pursuer says now (the bidder itself included).

    Of who says something now no bid counts but what it says itself: it may have released its claim, or bid anew.
    """
    own_words = [bid for j, bid in said.items() if bid.winner == j]
    hearsay = [bid for bid in (best, *said.values()) if bid.winner not in said]
    return max(own_words + hearsay, key=lambda bid: bid.rank, default=NO_BID)


def one_each(bids: Sequence[Bid]) -> list[Bid]:
    """Return the (M,) bids but that of each bidder only the greatest counts, of equal ones the last.

    It bids for one evader at a time, so word of the others is old.
    """
    greatest_of = {bids[k].winner: k for k in sorted(range(len(bids)), key=lambda k: bids[k].amount)}
    return [bid if greatest_of[bid.winner] == k else NO_BID for k, bid in enumerate(bids)]
