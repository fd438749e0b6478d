"""The table of the paper, cell by cell, and what stamps are good for: a winner that is gone is replaced."""

from itertools import product
from math import inf

import networkx as nx
import pytest

from desim import run
from desim.kernel.core.events import Broadcast
from desim.kernel.core.records import Record
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.faults import Crash
from desim.kernel.models.graphs import Edges
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.core.events import Decided
from desim.pursuit.game.game import greedy_assignment
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Team
from protocols.cbaa import CBAA
from protocols.cbba import CBBA, StampedClaim, decision
from protocols.schedules.periodic import Poisson, Rounds, SharedSeed
from tests.many import at_rest, by_evader, chased, times
from tests.protocols.test_cbaa import SCHEDULES, chasing, frozen, puppet

I, K, M, N, NONE = 3, 1, 0, 4, -1  # the receiver, the sender, two others  # noqa: E741
OLD, SAME, NEW = 4.0, 5.0, 6.0
"""Stamps of the sender: older than the receiver's, as old, or newer."""

# Sender's winner, receiver's winner, is the sender's bid higher, its stamp of its winner and of the receiver's; action.
# Written by hand from Table I of Choi, Brunet & How 2009; where a column does not matter it is None, and all are tried.
TABLE = [
    (K, I, True, None, None, "update"),
    (K, I, False, None, None, "leave"),
    (K, K, None, None, None, "update"),
    (K, M, None, None, NEW, "update"),
    (K, M, True, None, SAME, "update"),
    (K, M, True, None, OLD, "update"),
    (K, M, False, None, SAME, "leave"),
    (K, M, False, None, OLD, "leave"),
    (K, NONE, None, None, None, "update"),
    (I, I, None, None, None, "leave"),
    (I, K, None, None, None, "reset"),
    (I, M, None, None, NEW, "reset"),
    (I, M, None, None, SAME, "leave"),
    (I, M, None, None, OLD, "leave"),
    (I, NONE, None, None, None, "leave"),
    (M, I, True, NEW, None, "update"),
    (M, I, False, NEW, None, "leave"),
    (M, I, True, SAME, None, "leave"),
    (M, I, True, OLD, None, "leave"),
    (M, I, False, SAME, None, "leave"),
    (M, I, False, OLD, None, "leave"),
    (M, K, None, NEW, None, "update"),
    (M, K, None, SAME, None, "reset"),
    (M, K, None, OLD, None, "reset"),
    (M, M, None, NEW, NEW, "update"),
    (M, M, None, SAME, SAME, "leave"),
    (M, M, None, OLD, OLD, "leave"),
    (M, N, None, NEW, NEW, "update"),
    (M, N, True, NEW, SAME, "update"),
    (M, N, True, NEW, OLD, "update"),
    (M, N, False, NEW, SAME, "leave"),
    (M, N, False, NEW, OLD, "leave"),
    (M, N, None, SAME, NEW, "leave"),
    (M, N, None, SAME, SAME, "leave"),
    (M, N, None, SAME, OLD, "leave"),
    (M, N, None, OLD, NEW, "reset"),
    (M, N, None, OLD, SAME, "leave"),
    (M, N, None, OLD, OLD, "leave"),
    (M, NONE, None, NEW, None, "update"),
    (M, NONE, None, SAME, None, "leave"),
    (M, NONE, None, OLD, None, "leave"),
    (NONE, I, None, None, None, "leave"),
    (NONE, K, None, None, None, "update"),
    (NONE, M, None, None, NEW, "update"),
    (NONE, M, None, None, SAME, "leave"),
    (NONE, M, None, None, OLD, "leave"),
    (NONE, NONE, None, None, None, "leave"),
]


def cases(z_k, z_i, higher, of_theirs, of_mine):
    """Yield the rows that a row of `TABLE` stands for."""
    for high, theirs, mine in product(
        (True, False) if higher is None else (higher,),
        (OLD, SAME, NEW) if of_theirs is None else (of_theirs,),
        (OLD, SAME, NEW) if of_mine is None else (of_mine,),
    ):
        if z_k != z_i or theirs == mine:
            yield high, theirs, mine


@pytest.mark.parametrize(("z_k", "z_i", "higher", "of_theirs", "of_mine", "verdict"), TABLE)
def test_the_receiver_follows_the_decision_table(z_k, z_i, higher, of_theirs, of_mine, verdict):
    """All stamps of the receiver are 5 s, as are those of the sender that the row does not name."""
    for high, theirs, mine in cases(z_k, z_i, higher, of_theirs, of_mine):
        s_i, s_k = [SAME] * 5, [SAME] * 5
        for winner, stamp in [(z_k, theirs), (z_i, mine)]:
            if winner != NONE:
                s_k[winner] = stamp
        amounts = (-2.0, -1.0) if high else (-2.0, -3.0)
        assert decision(I, K, z_i, amounts[0], s_i, z_k, amounts[1], s_k) == verdict


def test_the_table_above_has_each_cell_once():
    """Two heights and 3 x 3 stamps of each of 17 pairs of winners, and 2 x 3 where both name the same one."""
    listed = [(row[0], row[1], *case) for row in TABLE for case in cases(*row[:5])]
    pairs = [*product((K, I, M, NONE), (K, I, M, NONE)), (M, N)]
    every = [(z_k, z_i, *case) for z_k, z_i in pairs for case in cases(z_k, z_i, None, None, None)]
    assert sorted(listed) == sorted(every)
    assert len(listed) == len(set(listed)) == 13 * 18 + 4 * 6


@pytest.mark.parametrize(
    ("i", "k", "z_i", "z_k"), [(I, K, I, K), (I, K, N, K), (I, K, I, M), (I, K, N, M), (0, 1, 0, 2), (2, 4, 2, 3)]
)
def test_of_equal_bids_that_of_the_lower_id_is_higher(i, k, z_i, z_k):
    """In the four cells where bids matter; m has a newer record, n has not."""
    s_k = [NEW if j == z_k else SAME for j in range(5)]
    verdict = decision(i, k, z_i, -1.0, [SAME] * 5, z_k, -1.0, s_k)
    assert verdict == ("update" if z_k < z_i else "leave")


def test_a_verdict_is_carried_out_and_stamps_are_merged_by_the_newest():
    """Pursuer 0 (phi = 2 s) receives a claim of 1 at -1 s; then that 1 names 0 the winner: it resets, and bids."""
    heard, claims = {}, []
    me = puppet(team_size=3, trusted=lambda: heard, set_payload=claims.append, senses_others=False)
    me.capture_time, me.time_left, me.now = lambda evader: 2.0, lambda: 5.0, 9.0
    turns = CBBA().actions(me)
    heard[1] = Record(1, 0, 4_000_000_000, StampedClaim(True, (1,), (-1.0,), (2.0, 3.0, 7.0)))
    assert not next(turns)
    assert claims[-1] == (False, (1,), (-1.0,), (9.0, 4.0, 7.0))
    heard[1] = Record(1, 1, 5_000_000_000, StampedClaim(False, (0,), (-2.0,), (2.0, 3.0, 6.0)))
    assert next(turns)
    assert claims[-1] == (True, (0,), (-2.0,), (9.0, 5.0, 7.0))


# What becomes of it in a run.


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("winner_timeout", [0.5, 2.0])
@pytest.mark.parametrize("schedule", SCHEDULES)
def test_when_the_winner_breaks_down_the_next_takes_over_after_the_winner_timeout(schedule, winner_timeout):
    """Pursuer 1 breaks down at 3 s, having announced within the last 0.1 s and been read at every turn (0.08 s a ring).

    No other chases until the winner timeout ends, counted from when it was last read; its successors begin at their
    next turns and agree on 2 soon. The control: with an infinite timeout no other chases.
    """
    crash = Crash(node=1, start=3.0)
    result = frozen(
        CBBA(schedule=SCHEDULES[schedule], winner_timeout=winner_timeout), seed=1, fault=(crash,), horizon=12.0
    )
    begun = min(d.t / 1e9 for d in result.trace.of(Decided) if d.active and d.t > 3e9)
    slack = 0.2 if schedule in {"rounds", "token_ring"} else 1.0
    assert 3.0 + winner_timeout - slack - 0.1 <= begun <= 3.0 + winner_timeout + slack
    assert chasing(result, 2.9) == [1]
    assert chasing(result, begun - 0.01) == []
    assert chasing(result, begun + 2.0) == chasing(result) == [2]
    for stubborn in (CBBA(schedule=SCHEDULES[schedule], winner_timeout=inf), CBAA(schedule=SCHEDULES[schedule])):
        assert chasing(frozen(stubborn, seed=1, fault=(crash,), horizon=12.0)) == []


@pytest.mark.slow
def test_when_the_winner_of_one_of_several_evaders_breaks_down_the_others_agree_without_it():
    """A winner breaks down at 1 s; its successor may come from another evader, and so on."""
    for seed in range(3):
        protocol = CBBA(schedule=Rounds(period=0.1), winner_timeout=0.5)
        before = run(at_rest(protocol, 6, 3, seed), None, lambda event: event.t > 0.9e9)
        winner = min(chased(before))
        case = at_rest(protocol, 6, 3, seed, fault=(Crash(node=winner, start=1.0),))
        result = run(case, None, lambda event: event.t > 4e9)
        left = times(result)
        assert chased(result, 0.9) == greedy_assignment(by_evader(left), 30.0)
        left[winner] = inf
        assert chased(result) == greedy_assignment(by_evader(left), 30.0)
        assert len(chased(result)) == len(chased(before))


@pytest.mark.slow
def test_a_winner_that_comes_back_wins_again():
    """Pursuer 1 breaks down from 2 to 6 s, with its memory or without: until then 2 takes over."""
    for memory in (True, False):
        crash = Crash(node=1, start=2.0, end=6.0, memory=memory)
        result = frozen(CBBA(schedule=Rounds(period=0.1)), fault=(crash,))
        assert chasing(result, 5.9) == [2]
        assert chasing(result) == [1]


@pytest.mark.slow
def test_a_failed_winner_times_out_everywhere_within_a_delay_per_hop():
    """On a path of 8 the winner, at one end, breaks down at 5 s: each hop and round is 0.1 s, the winner timeout 1 s.

    The first gives up after 6 s, the last 0.7 s later; claims for it still in flight revive nothing.
    """
    line = Team(positions=[(1.1 + k, 0.0) for k in range(8)], speeds=1.0, active_at_start=0.0)
    result = frozen(
        CBBA(schedule=Rounds(period=0.1), winner_timeout=1.0),
        team=line,
        horizon=12.0,
        network=Links(graph=Edges.of(nx.path_graph(8))),
        announce=Announcements(trigger="revision", start="silent"),
        fault=(Crash(node=0, start=5.05),),
    )
    believed = {
        (round(message.t / 1e8), message.src): message.body.winners[0]
        for message in result.trace.of(Broadcast)
        if message.t >= 5e9
    }
    last = [max(k for (k, src), winner in believed.items() if src == j and winner == 0) for j in range(1, 8)]
    assert last == [61 + j - 1 for j in range(1, 8)]
    assert {winner for (k, _), winner in believed.items() if k > 68 + 7} == {1}
    assert chasing(result) == [1]


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("schedule", [Rounds(period=0.1), Poisson(rate=5.0), SharedSeed(slot=0.01)])
def test_the_winner_timeout_tolerates_lost_messages(schedule):
    """Half of all heartbeats are lost; in 60 s the winner, once alone, is never given up. With 0.15 s it often is."""
    given_up = {}
    for winner_timeout in (2.0, 0.15):
        result = frozen(
            CBBA(schedule=schedule, winner_timeout=winner_timeout), horizon=60.0, network=Links(loss=Bernoulli(p=0.5))
        )
        late = [d for d in result.trace.of(Decided) if d.t > 5e9]
        given_up[winner_timeout] = len([d for d in late if d.active and d.pursuer != 1])
        assert all(d.active for d in late if d.pursuer == 1)
    assert given_up[2.0] == 0
    assert given_up[0.15] > 50


class Unequal:
    """A schedule: a turn every 0.1 s, but for pursuer 1 only the first three."""

    def mean_slot(self, me):
        return 0.1

    def __call__(self, me, revise):
        for k in range(1, 100):
            yield me.at(k * 0.1)
            if me.id != 1 or k <= 3:
                revise()
                me.announce()


@pytest.mark.slow
def test_a_winner_without_turns_is_kept_as_long_as_its_records_arrive():
    """Pursuer 1 wins at 0.2 s, and from 0.3 s on only repeats it.

    Without heartbeats it is given up, and then each of the others by each, as nothing is announced twice: all chase.
    """
    for trigger, winner in [("both", [1]), ("change", [0, 1, 2, 3])]:
        result = frozen(CBBA(schedule=Unequal()), announce=Announcements(trigger=trigger, start="silent"))
        assert chasing(result, 1.0) == [1]
        assert chasing(result) == winner


@pytest.mark.slow
def test_time_stamps_are_on_the_clock_of_the_pursuer_they_concern():
    """Clocks that are hours wrong, on a path of 4 with pursuer 1 at one end: no verdict changes, only stamps.

    Rounds are due by one's own clock, so pursuers have other schedules here.
    """
    graph = Edges.of(nx.path_graph(4))
    line = Team(positions=[(1.1 + k, 0.0) for k in range(4)], speeds=1.0, active_at_start=0.0)
    skews = tuple(ClockSkew(node=j, offset=offset) for j, offset in enumerate([4000.0, -5000.0, 0.0, 9000.0]))
    for wrong in ((), skews):
        for crash in ((), (Crash(node=0, start=4.0),)):
            result = frozen(
                CBBA(schedule=Poisson(rate=10.0)),
                team=line,
                network=Links(graph=graph),
                horizon=12.0 if not wrong else 20000.0,
                until=12.0,
                fault=(*wrong, *crash),
            )
            assert chasing(result, 3.9) == [0]
            assert chasing(result) == ([1] if crash else [0])
    stamps = [message.body.stamps for message in result.trace.of(Broadcast) if message.src == 3 and message.t > 11e9][
        -1
    ]
    assert stamps == pytest.approx((4004.0, -4988.0, 12.0, 9012.0), abs=1.0)


def test_pursuers_without_a_record_have_no_time_stamp():
    """The stamps of the first claims: the own one, and none of others."""
    result = frozen(CBBA(schedule=Rounds(period=0.1)), announce=Announcements(trigger="revision", start="silent"))
    first = {message.src: message.body.stamps for message in result.trace.of(Broadcast) if message.t < 0.15e9}
    assert first == {j: tuple(0.1 if m == j else -inf for m in range(4)) for j in range(4)}
    second = {message.src: message.body.stamps for message in result.trace.of(Broadcast) if 0.15e9 < message.t < 0.25e9}
    assert second == {j: tuple(0.2 if m == j else 0.1 for m in range(4)) for j in range(4)}
