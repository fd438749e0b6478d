"""The consensus-based bundle algorithm with bundles of one task: an auction in which word has stamps, and grows old.

Paper: Choi, Brunet & How 2009, "Consensus-Based Decentralized Auctions for Robust Task Allocation", Table I (see
    `decision`) for each evader, which are the tasks. Other than there, s_i[k] is when k sent its word and not when i
    received it, so a stamp is always by the clock of whom it is about, and clocks need not agree; a winner of whom no
    newer word comes is given up; at each turn a pursuer chooses and bids anew; wherever bids are compared, of equal
    ones that of the lower id is greater, and all are brought up to date if positions are sensed.
Parameters: schedule (with Rounds these are the rounds of the paper), winner_timeout.
Assumes: a connected graph, or there is a winner in each component; and word that is repeated, by heartbeats or at each
    revision. Else the winner seems to have fallen silent, and in the end everybody gives everybody up, and chases.
    Positions that are sensed (payload "action"): with "time" or "state" a bid stays as old as it is, and two whose phi
    differ by less than word is old, in s, may both chase to the end (`cbaa` has figures, which are the same here; with
    positions sensed 0.9 s on the mean and 2.4 s at worst).
Messages: announcements of 24 bytes, 16 for each evader and 8 for each pursuer; news is a new winner.
Robust to loss: yes, with heartbeats. Robust to crashes: another pursuer takes over after `winner_timeout`.
"""

from collections.abc import Iterator, Sequence
from math import inf
from typing import ClassVar, Literal, NamedTuple

from desim.config.model import Timeout
from desim.kernel.clock import seconds
from desim.kernel.message_size import NUMBER
from desim.pursuit.agent import Agent
from protocols.auction import NO_BID, NO_WINNER, Auction, Bid, bids_of, chosen, claim_fields, current, unread

Verdict = Literal["update", "reset", "leave"]
"""Take the winner over from the sender; know of no winner any more; change nothing."""


class StampedClaim(NamedTuple):
    """Whom a pursuer holds for the winner of each evader, and how old its word of each other is; see `Claim`."""

    active: int
    winner: int | tuple[int, ...]
    amount: float | tuple[float, ...]
    """The winning bid y, s."""
    stamps: tuple[float, ...]
    """s[m]: when the latest word of m was sent that it knows of, at one hop or more, by the clock of m, s."""

    @property
    def news(self) -> tuple[int, int | tuple[int, ...]]:
        """What is told at once if it changes: action and winner."""
        return self.active, self.winner


class CBBA(Auction):
    """Consensus on winner, bid and stamps; see `decision`."""

    assumes: ClassVar[tuple[str, ...]] = ("connected", "announcements_repeated")
    kind: Literal["cbba"] = "cbba"
    winner_timeout: Timeout = 2.0
    """How long a winner stays one of whom no newer word comes, s. A winner that is given up in error is rare if that is
    many heartbeats, and turns of who passes word on: by default 20, and 10 of 20 pursuers."""

    def claim_size(self, pursuers: int, evaders: int) -> int:
        """Return the bytes of an announcement: those of any auction, and a stamp of each pursuer."""
        return super().claim_size(pursuers, evaders) + NUMBER * pursuers

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the evader of which it is the winner."""
        bids, read = [NO_BID] * me.evader_count, dict[int, int]()
        stamps, since = [-inf] * me.team_size, [me.now] * me.team_size  # since: when a stamp was last found newer
        while True:
            up_to_date = [current(me, k + 1) for k in range(me.evader_count)]
            bids = [update(bid) for update, bid in zip(up_to_date, bids, strict=True)]
            for record in unread(me, read, StampedClaim):
                k, theirs = record.src, record.body.stamps
                for task, (mine, bid) in enumerate(zip(bids, bids_of(record.body), strict=True)):
                    bid = up_to_date[task](bid)
                    verdict = decision(me.id, k, *mine, stamps, *bid, theirs)
                    bids[task] = {"update": bid, "reset": NO_BID, "leave": mine}[verdict]
                heard = [*theirs[:k], seconds(record.sent), *theirs[k + 1 :]]
                since = [me.now if new > old else t for new, old, t in zip(heard, stamps, since, strict=True)]
                stamps = list(map(max, heard, stamps))
            late = [bid.winner != NO_WINNER and me.now - since[bid.winner] > self.winner_timeout for bid in bids]
            others = [NO_BID if bid.winner == me.id or gone else bid for bid, gone in zip(bids, late, strict=True)]
            action, bids = chosen(me, others)
            stamps[me.id] = me.now
            me.set_payload(StampedClaim(*claim_fields(action, bids), tuple(stamps)))
            yield action


def decision(
    i: int, k: int, z_i: int, y_i: float, s_i: Sequence[float], z_k: int, y_k: float, s_k: Sequence[float]
) -> Verdict:
    """Return what receiver i, who holds z_i for the winner, does when sender k says z_k (Choi et al. 2009, Table I).

    Each row is: k says, i says; what i does. Here m and n are neither i nor k, nor one another.
    """
    higher = Bid(z_k, y_k).rank > Bid(z_i, y_i).rank
    newer_of_theirs, newer_of_mine = (m != NO_WINNER and s_k[m] > s_i[m] for m in (z_k, z_i))
    older_of_theirs = z_k != NO_WINNER and s_k[z_k] < s_i[z_k]
    outdated: Verdict = "reset" if newer_of_mine and older_of_theirs else "leave"
    names = {i: "i", k: "k", NO_WINNER: "none"}
    k_says = names.get(z_k, "m")
    i_says = names.get(z_i, "n" if k_says == "m" and z_i != z_k else "m")
    table: dict[tuple[str, str], Verdict] = {
        ("k", "i"): "update" if higher else "leave",
        ("k", "k"): "update",
        ("k", "m"): "update" if newer_of_mine or higher else "leave",
        ("k", "none"): "update",
        ("i", "i"): "leave",
        ("i", "k"): "reset",
        ("i", "m"): "reset" if newer_of_mine else "leave",
        ("i", "none"): "leave",
        ("m", "i"): "update" if newer_of_theirs and higher else "leave",
        ("m", "k"): "update" if newer_of_theirs else "reset",
        ("m", "m"): "update" if newer_of_theirs else "leave",
        ("m", "n"): "update" if newer_of_theirs and (newer_of_mine or higher) else outdated,
        ("m", "none"): "update" if newer_of_theirs else "leave",
        ("none", "i"): "leave",
        ("none", "k"): "update",
        ("none", "m"): "update" if newer_of_mine else "leave",
        ("none", "none"): "leave",
    }
    return table[k_says, i_says]
