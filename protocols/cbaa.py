"""The consensus-based auction algorithm: a pursuer chases an evader if it knows of no higher bid than its own.

Paper: Choi, Brunet & How 2009, "Consensus-Based Decentralized Auctions for Robust Task Allocation", Algorithms 1 and 2;
    the evaders are the tasks. Each pursuer keeps the winning-bid list y and the winner list z. There are three
    differences. Bids follow the capture times phi, so a pursuer selects an evader and bids anew at each turn. A
    pursuer's claim about its own bid overrides the claims of others about that bid. Where positions are sensed, all
    bids are updated at each turn.
Parameters: schedule. The schedule `Rounds` gives the rounds of the paper; the default, one pursuer per slot, does not.
Assumes: a connected graph and constant bids. Let D be its diameter in hops. Then all agree on the winner of one evader
    after 1 + D rounds, and on the winners of M evaders after at most M (1 + D) rounds. The assignment is the greedy
    one, in order of phi. If bids change, the highest of several reports of a chaser's bid is the newest, because the
    phi of a pursuer falls and its bid rises while it chases. When a pursuer leaves an evader for another, its claim
    informs its neighbours. Pursuers farther away infer the change, because a bidder has one evader at most
    (`one_each`).
    Sensed positions (payload "action"). With "time" or "state" bids are not updated, and two pursuers whose phi differ
    by less than the age of the bids may both chase to the end. For example, in the scenario "relay stress" of
    `scenarios.rivals` with a latency of 0.2 s, the misassigned time is 3.4 s in the mean of 20 runs and 23.3 s in the
    worst one; with sensed positions it is 0.8 s and 1.8 s.
    No crashes. Claims have no time stamps, so a crash of the winner is not noticed, and its bid blocks all others for
    ever.
Messages: announcements of 24 bytes plus 16 for each evader. A new action or winner triggers an announcement, a new bid
    of the same winner does not, so bids that change need heartbeats or the trigger `revision`.
Robust to loss: yes, with heartbeats.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import inf
from typing import ClassVar, Literal, NamedTuple, Self

from desim.pursuit.team.agent import Agent
from protocols.auction import NO_BID, Auction, Bid, action_and_bids, bid_updater, bids_of, lists_of, unread
from protocols.rule import Rule


class Claim(NamedTuple):
    """The action of a pursuer, and what it knows of each evader's auction: the winner z and the winning bid y."""

    active: int
    winners: tuple[int, ...]
    """(M,) winners z; `NO_WINNER` without a bid."""
    amounts: tuple[float, ...]
    """(M,) winning bids y, s."""

    @property
    def news(self) -> tuple[int, tuple[int, ...]]:
        """The action and the winners; a change of them triggers an announcement."""
        return self.active, self.winners

    def falsified(self, pursuer: int, action: int, phi: float) -> Self:
        """Return the claim of a pursuer that pretends to take `action`, and to bid -phi (s) for that evader only."""
        others = [NO_BID if bid.winner == pursuer else bid for bid in bids_of(self)]
        bids = [Bid(pursuer, -phi) if evader == action else bid for evader, bid in enumerate(others, start=1)]
        winners, amounts = lists_of(bids)
        return self._replace(active=action, winners=winners, amounts=amounts)

    def phi(self, pursuer: int) -> float:
        """Return the capture time, s, in the bid of a pursuer for the evader that it chases; inf if there is none."""
        return inf if not self.active or self.winners[self.active - 1] != pursuer else -self.amounts[self.active - 1]


class CBAA(Auction):
    """Consensus on the highest bid for each evader; a pursuer that is outbid releases the evader."""

    assumes: ClassVar[tuple[str, ...]] = (*Rule.assumes, "connected", "rounds", "no_crashes")
    kind: Literal["cbaa"] = "cbaa"

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the evader that the pursuer has won, or 0, at each turn."""
        bids = [NO_BID] * me.evader_count
        last_read: dict[int, int] = {}
        while True:
            claims = {record.src: bids_of(record.body) for record in unread(me, last_read, Claim)}
            for k, best in enumerate(bids):
                update = bid_updater(me, k + 1)
                claimed = {j: update(claim[k]) for j, claim in claims.items()}
                # `me` counts as claiming no bid, so reports of its bid are ignored: `action_and_bids` bids anew.
                bids[k] = greatest(update(best), claimed | {me.id: NO_BID})
            action, bids = action_and_bids(me, one_each(bids))
            me.set_payload(Claim(action, *lists_of(bids)))
            yield action


def greatest(best: Bid, claimed: Mapping[int, Bid]) -> Bid:
    """Return the highest bid among the best bid so far and the bids in new claims.

    Args:
        best: the best bid so far.
        claimed: by pursuer, the best bid in its new claim. Reports of others about a bid of such a pursuer are ignored,
            because it may have released the evader or bid anew since the others received its previous claim.
    """
    own_claims = [bid for j, bid in claimed.items() if bid.winner == j]
    reported = [bid for bid in (best, *claimed.values()) if bid.winner not in claimed]
    return max(own_claims + reported, key=lambda bid: bid.rank, default=NO_BID)


def one_each(bids: Sequence[Bid]) -> list[Bid]:
    """Return the (M,) bids with `NO_BID` in place of all but the highest bid of each bidder (the last of equal ones).

    A pursuer bids for one evader at a time, so its lower bids are outdated.
    """
    greatest_of = {bids[k].winner: k for k in sorted(range(len(bids)), key=lambda k: bids[k].amount)}
    return [bid if greatest_of[bid.winner] == k else NO_BID for k, bid in enumerate(bids)]
