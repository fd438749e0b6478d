"""The consensus-based bundle algorithm with bundles of one task: an auction with time stamps and a time-out of winners.

Paper: Choi, Brunet & How 2009, "Consensus-Based Decentralized Auctions for Robust Task Allocation", Table I (see
    `decision`) for each evader; the evaders are the tasks. Differences: pursuer i keeps a time stamp s_i[k] of each
    pursuer k. It is the time, by the clock of k, at which k sent the latest announcement that i knows of; in the paper
    it is a time of reception. Clocks therefore need not agree. A winner is dropped after `winner_timeout` seconds
    without a newer announcement. A pursuer selects an evader and bids anew at each turn. Ties go to the lower id. If
    positions are sensed, all bids are updated before they are compared.
Parameters: schedule (`Rounds` gives the rounds of the paper, the default does not), winner_timeout.
Assumes: a connected graph; otherwise each component has its own winner. Announcements repeated by heartbeats or at each
    revision; otherwise every winner times out, and in the end each pursuer considers itself the winner and chases.
    Sensed positions (payload "action"). With "time" or "state" bids are not updated, and two pursuers whose phi differ
    by less than the age of the bids may both chase to the end. For example, in the scenario "relay stress" of
    `scenarios.rivals` with a latency of 0.2 s, the misassigned time is 3.4 s in the mean of 20 runs and 23.3 s in the
    worst one, as with `cbaa`; with sensed positions it is 0.9 s and 2.4 s.
Messages: announcements of 24 bytes plus 16 for each evader and 8 for each pursuer. A new action or winner triggers one.
Robust to loss: yes, with heartbeats. Robust to crashes: another pursuer takes over after `winner_timeout`.
"""

from collections.abc import Iterator, Sequence
from math import inf
from typing import ClassVar, Literal, NamedTuple

from desim.config.model import Timeout
from desim.kernel.core.message_size import NUMBER
from desim.pursuit.team.agent import Agent
from protocols.auction import (
    NO_BID,
    NO_WINNER,
    Auction,
    Bid,
    action_and_bids,
    bid_updater,
    bids_of,
    lists_of,
    unread,
)
from protocols.cbaa import Claim

Verdict = Literal["update", "reset", "leave"]
"""The actions of Table I: adopt the sender's winner and bid; clear winner and bid; change nothing."""


class StampedClaim(NamedTuple):
    """The action of a pursuer and its lists: winners z, winning bids y and time stamps s."""

    active: int
    winners: tuple[int, ...]
    """(M,) winners z; `NO_WINNER` without a bid."""
    amounts: tuple[float, ...]
    """(M,) winning bids y, s."""
    stamps: tuple[float, ...]
    """(N,) s[m]: time stamp (s, clock of m) of the latest announcement of m of which the pursuer knows, either from m
    itself or from the time stamps in the claims of others."""

    news, falsified, phi = Claim.news, Claim.falsified, Claim.phi  # type: ignore[misc]  # a NamedTuple cannot inherit them


class CBBA(Auction):
    """Consensus on the winner and the winning bid of each evader, by time stamps of the pursuers (Choi et al. 2009)."""

    assumes: ClassVar[tuple[str, ...]] = ("connected", "rounds", "announcements_repeated")
    kind: Literal["cbba"] = "cbba"
    winner_timeout: Timeout = 2.0
    """Time, s, after which a winner without a newer announcement is dropped. It should cover many heartbeats and many
    turns of the pursuers that forward claims: the default is 20 heartbeats, and 10 turns in a team of 20.

    A short time drops winners that are alive, and a long one waits for crashed ones.

    If in doubt, use 20 heartbeats.
    """

    def claim_size(self, pursuers: int, evaders: int) -> int:
        """Return the size of an announcement, bytes: that of `Auction`, and a time stamp for each pursuer."""
        return super().claim_size(pursuers, evaders) + NUMBER * pursuers

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the evader that the pursuer has won, or 0, at each turn."""
        bids = [NO_BID] * me.evader_count
        last_read: dict[int, int] = {}
        stamps = [-inf] * me.team_size
        grown_at = [me.now] * me.team_size  # by pursuer: local time, s, at which its stamp last grew
        while True:
            updaters = [bid_updater(me, k + 1) for k in range(me.evader_count)]
            bids = [updater(bid) for updater, bid in zip(updaters, bids, strict=True)]
            for record in unread(me, last_read, StampedClaim):
                k, sender_stamps = record.src, record.body.stamps
                for task, (bid, claimed) in enumerate(zip(bids, bids_of(record.body), strict=True)):
                    claimed = updaters[task](claimed)
                    verdict = decision(me.id, k, *bid, stamps, *claimed, sender_stamps)
                    bids[task] = {"update": claimed, "reset": NO_BID, "leave": bid}[verdict]
                # Heartbeats repeat a claim with its old stamps, but each is a sign of life: the stamp of the sender
                # itself is the time of the record. Ages count from when a stamp last grew, because stamps are read from
                # other clocks.
                news = [*sender_stamps[:k], record.sent, *sender_stamps[k + 1 :]]
                grown_at = [me.now if new > old else t for new, old, t in zip(news, stamps, grown_at, strict=True)]
                stamps = list(map(max, news, stamps))
            # Bids of winners that have timed out are dropped, and so is the pursuer's own bid, which is made anew.
            rivals = {k for k, t in enumerate(grown_at) if k != me.id and me.now - t <= self.winner_timeout}
            rival_bids = [bid if bid.winner in rivals else NO_BID for bid in bids]
            action, bids = action_and_bids(me, rival_bids)
            stamps[me.id] = me.now
            me.set_payload(StampedClaim(action, *lists_of(bids), tuple(stamps)))
            yield action


def decision(
    i: int, k: int, z_i: int, y_i: float, s_i: Sequence[float], z_k: int, y_k: float, s_k: Sequence[float]
) -> Verdict:
    """Return the action of receiver i on a claim of sender k about one task (Choi et al. 2009, Table I).

    z_i, y_i and s_i are the winner, the winning bid and the time stamps that i knows; z_k, y_k and s_k are those of the
    claim. A key of the table is (winner according to k, winner according to i); m and n are two pursuers other than i
    and k. They differ: if both i and k name the same third pursuer, the key is ("m", "m").
    """
    higher = Bid(z_k, y_k).rank > Bid(z_i, y_i).rank
    # "k_newer_of_z_i": k has a newer time stamp of the pursuer z_i than i has.
    k_newer_of_z_k, k_newer_of_z_i = (m != NO_WINNER and s_k[m] > s_i[m] for m in (z_k, z_i))
    i_newer_of_z_k = z_k != NO_WINNER and s_k[z_k] < s_i[z_k]
    reset_if_outdated: Verdict = "reset" if k_newer_of_z_i and i_newer_of_z_k else "leave"
    names = {i: "i", k: "k", NO_WINNER: "none"}
    k_says = names.get(z_k, "m")
    i_says = names.get(z_i, "n" if k_says == "m" and z_i != z_k else "m")
    table: dict[tuple[str, str], Verdict] = {
        ("k", "i"): "update" if higher else "leave",
        ("k", "k"): "update",
        ("k", "m"): "update" if k_newer_of_z_i or higher else "leave",
        ("k", "none"): "update",
        ("i", "i"): "leave",
        ("i", "k"): "reset",
        ("i", "m"): "reset" if k_newer_of_z_i else "leave",
        ("i", "none"): "leave",
        ("m", "i"): "update" if k_newer_of_z_k and higher else "leave",
        ("m", "k"): "update" if k_newer_of_z_k else "reset",
        ("m", "m"): "update" if k_newer_of_z_k else "leave",
        ("m", "n"): "update" if k_newer_of_z_k and (k_newer_of_z_i or higher) else reset_if_outdated,
        ("m", "none"): "update" if k_newer_of_z_k else "leave",
        ("none", "i"): "leave",
        ("none", "k"): "update",
        ("none", "m"): "update" if k_newer_of_z_i else "leave",
        ("none", "none"): "leave",
    }
    return table[k_says, i_says]
