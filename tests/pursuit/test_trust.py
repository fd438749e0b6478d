"""Trust: what is believed of the announcements of others, on what evidence, and how well it holds against liars."""

from functools import cache
from itertools import combinations, product
from math import inf
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import Scenario, run, summary
from desim.kernel.core.records import Record
from desim.kernel.core.units import SECOND
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.faults import Crash
from desim.kernel.models.latency import Lognormal
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.byzantine.evidence import Witness
from desim.pursuit.byzantine.lies import Liar, Slander
from desim.pursuit.core.events import Distrusted
from desim.pursuit.team.announcements import Announcements, Assignment, TimedAssignment
from desim.pursuit.team.judges import Accusation
from desim.pursuit.team.trust import TRUSTS, Accusations, Credulous, Plausible, Reputation, Trimmed, tolerated_liars
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import PROTOCOLS, Motion, Recording
from desim.testing.pursuits import watched
from protocols.dissemination import Gossip
from protocols.local_min import ArgminKnown, LocalMin
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson

POISSON = Poisson(rate=5.0)
THERE_AT_ONCE = {"action": "chase", "phi": 0.0, "acts": "stay", "start": 0.0}


def team(trust, *faults, rule=LocalMin, payload="time", **changes):
    """Return the scenario of 12 pursuers with which the harm of liars is measured."""
    given = {
        "team": Team(count=12, speeds=1.5, active_at_start=0.0),
        "protocol": rule(schedule=POISSON),
        "announce": Announcements(payload=payload, heartbeat=0.2, trust=trust),
        "record": Recording(trajectory=0.0),
        "fault": faults,
    }
    return Scenario(**given | changes)


def liars(count, **lie):
    return [Liar(node=node, **THERE_AT_ONCE | lie) for node in range(count)]


def observer(refuted=(), mail=()):
    """Return what a judge needs, for a pursuer that refutes some records, by source and sequence number."""
    notes, sent = [], []
    found = SimpleNamespace(now=0, notes=notes, sent=sent, letters=list(mail))
    found.refutes = lambda record, radius: (record.src, record.seq) in refuted
    found.note = lambda suspect, *, distrusted: notes.append((suspect, distrusted))
    found.send = lambda body, port: sent.append(body)

    def mail_of(port):
        letters, found.letters = found.letters, []
        return letters

    found.mail = mail_of
    return found


@pytest.mark.parametrize(
    ("stamp", "action", "refutes"), [(29, 0, False), (30, 0, True), (31, 0, True), (31, 1, False), (31, None, False)]
)
def test_an_action_is_refuted_if_another_was_taken_for_a_motion_step(stamp, action, refutes):
    """Pursuer 1 chases since 20 ns, and a step takes 10 ns."""
    state = SimpleNamespace(acting_since=[0, 20], profile=[0, 1])
    witness = Witness(0, SimpleNamespace(state=state), None, None, None, 10, None)
    body = None if action is None else Assignment(action)
    assert witness._refutes_action(Record(1, 1, stamp, body)) is refutes


def witness(now, captured, top_speed=2.0):
    """Return a witness at a time, ns, of evaders 1 and 9 m away that were captured at some times, ns, or not (None)."""
    bodies = [SimpleNamespace(number=k, captured=t, speed=0.5) for k, t in enumerate(captured, start=1)]
    state = SimpleNamespace(bodies=bodies, evader_count=2, radius=0.1, top_speed=top_speed, now=now)
    state.acting_since, state.profile, state.position = [0, 20], [0, 0], lambda pursuer: 0j
    state.body = lambda evader: bodies[evader - 1]
    view = SimpleNamespace(state=state, unlimited=True, evader=lambda evader: (1 + 0j, 9 + 0j)[evader - 1])
    return Witness(0, view, SimpleNamespace(stamp=now), None, None, 10, None)


@pytest.mark.parametrize(("sent", "refutes"), [(0.9, False), (1.0, False), (1.01, True)])
def test_a_time_may_be_that_for_an_evader_captured_since(sent, refutes):
    """An inactive pursuer 1 m from an evader that is captured after a second announces 0.6 s; the other one is far."""
    seen = witness(int(1.1 * SECOND), [SECOND, None])
    assert seen._refutes_time(Record(1, 1, int(sent * SECOND), TimedAssignment(0, 0.6))) is refutes


def test_the_chase_of_a_captured_evader_is_not_refuted():
    """A heartbeat repeats it until the next decision; that of an evader at large is refuted."""
    seen = witness(50, [20, None])
    assert [seen._refutes_action(Record(1, 1, 40, Assignment(action))) for action in (1, 2, 3)] == [False, True, True]


def test_no_time_is_refuted_if_nothing_bounds_the_speeds():
    """As in a flow that expands everywhere, for a message without latency."""
    times = Record(1, 1, 50, TimedAssignment(1, 0.0))
    assert not witness(50, [None, None], top_speed=inf)._refutes_time(times)
    assert witness(50, [None, None])._refutes_time(times)


@pytest.mark.parametrize("action", [-1, 3])
def test_a_time_for_no_evader_counts_as_that_for_any(action):
    seen = witness(50, [None, None])
    assert seen._refutes_time(Record(1, 1, 50, TimedAssignment(action, 0.0)))
    assert not seen._refutes_time(Record(1, 1, 50, TimedAssignment(action, 0.6)))


def record(src, seq):
    return Record(src, seq, 0, Assignment(1))


def letter(src, *accused):
    return SimpleNamespace(src=src, body=Accusation(accused))


# Each rule by itself.


def test_the_extreme_claims_on_both_sides_are_ignored():
    """Own time 3 s: of those below the least, of those above the greatest; an unknown time is not ranked."""
    judge = Trimmed(liars=1).judge(observer())
    assert judge.ignored(3.0, {1: 1.0, 2: 2.0, 3: 4.0, 4: 5.0, 5: float("nan"), 6: 3.0}) == {1, 4}
    assert judge.ignored(3.0, {1: 1.0}) == {1}
    assert judge.ignored(3.0, {6: 3.0}) == set(), "neither below nor above"
    assert judge.ignored(3.0, {}) == set()
    assert Trimmed(liars=0).judge(observer()).ignored(3.0, {1: 1.0, 2: 9.0}) == set()
    assert judge.believes(record(1, 1))


@given(st.integers(0, 3), st.dictionaries(st.integers(0, 9), st.floats(0.0, 9.0), max_size=8), st.floats(0.0, 9.0))
def test_f_liars_cannot_leave_only_claims_below_all_honest_ones(f, honest, own):
    """W-MSR: with up to F false claims, what is left below the own time is at least the least honest claim, if any."""
    claims = honest | {100 + k: 0.0 for k in range(f)}
    left = claims.keys() - Trimmed(liars=f).judge(observer()).ignored(own, claims)
    below = [claims[j] for j in left if claims[j] < own]
    assert all(min(honest.values()) <= phi for phi in below) if honest else not below


def test_a_refuted_teammate_is_believed_again_after_an_announcement_that_is_not():
    seen = observer(refuted={(4, 2), (4, 3)})
    judge = Plausible().judge(seen)
    assert [judge.believes(record(4, seq)) for seq in (1, 2, 2, 3, 4)] == [True, False, False, False, True]
    assert seen.notes == [(4, True), (4, False)]


def test_evidence_blocks_for_good_and_is_told():
    seen = observer(refuted={(4, 2)})
    judge = Accusations().judge(seen)
    assert [judge.believes(record(4, seq)) for seq in (1, 2, 3)] == [True, False, False]
    judge.report()
    assert seen.sent == [Accusation((4,))]
    judge.forget()
    judge.report()
    assert judge.believes(record(4, 3))
    assert len(seen.sent) == 1


def test_accusations_block_if_enough_pursuers_make_them():
    """With a quorum of 2, one accuser is not enough, however often it accuses; nor is one that is itself blocked."""
    judge = Accusations(quorum=2).judge(seen := observer(mail=[letter(1, 5), letter(1, 5)]))
    assert judge.believes(record(5, 1))
    seen.letters.append(letter(2, 5))
    assert not judge.believes(record(5, 2))
    judge = Accusations(quorum=2).judge(observer(refuted={(1, 1)}, mail=[letter(1, 5), letter(2, 5)]))
    assert not judge.believes(record(1, 1))
    assert judge.believes(record(5, 1))


@pytest.mark.parametrize(("memory", "count"), [(True, 1), (False, 2)])
def test_a_pursuer_that_loses_its_memory_finds_a_liar_anew(memory, count):
    """A liar is blocked for good, and 11, which crashes from 1 to 1.5 s, blocks it again if it has forgotten it."""
    crash = Crash(node=11, start=1.0, end=1.5, memory=memory)
    trace = run(team(Accusations(), *liars(1), crash, horizon=4.0, evader=Evader(speed=1.4)), 1).trace
    assert [(event.suspect, event.distrusted) for event in trace.of(Distrusted) if event.pursuer == 11] == [
        (0, True)
    ] * count


def test_a_reputation_is_the_mean_of_a_beta_distribution_that_forgets():
    """After 8 good announcements and a bad one at once it is 9/11; it is rejected itself, the next one is believed.

    A threshold of 0.79 needs 3 good ones at first, and again after 20 decay times, when nearly all is forgotten.
    """
    bad = {(4, 9)}
    judge = Reputation(threshold=0.5).judge(observer(refuted=bad))
    assert [judge.believes(record(4, seq)) for seq in range(1, 11)] == [True] * 8 + [False, True]
    strict = Reputation(threshold=0.79, decay_time=1.0).judge(seen := observer(refuted=bad))
    assert [strict.believes(record(4, seq)) for seq in (1, 2, 3)] == [False, False, True]  # 2/3, 3/4, 4/5
    assert not strict.believes(record(4, 9))
    seen.now = 20 * SECOND
    assert [strict.believes(record(4, seq)) for seq in (10, 11, 12)] == [False, False, True]  # as from the start


# Robustness of complete graphs.


def is_robust(edges, nodes, r):
    """Return whether a graph is r-robust: of two disjoint sets one has a node with r neighbours outside it."""
    near = {i: {j for j in nodes if (i, j) in edges or (j, i) in edges} for i in nodes}
    for sides in product((0, 1, 2), repeat=len(nodes)):
        sets = [{i for i, side in zip(nodes, sides, strict=True) if side == k} for k in (1, 2)]
        if all(sets) and not any(len(near[i] - each) >= r for each in sets for i in each):
            return False
    return True


@pytest.mark.parametrize("size", [2, 3, 4, 5, 6, 7])
def test_a_complete_graph_is_as_robust_as_the_number_of_tolerated_liars_says(size):
    """By enumeration of all pairs of sets: (2F + 1)-robust, and no more with F + 1."""
    nodes = range(size)
    edges = set(combinations(nodes, 2))
    f = tolerated_liars(size)
    assert is_robust(edges, nodes, 2 * f + 1)
    assert not is_robust(edges, nodes, 2 * (f + 1) + 1)


def test_the_numbers_of_tolerated_liars():
    """LeBlanc et al. 2013: F <= (ceil(n/2) - 1)/2."""
    assert [tolerated_liars(n) for n in (1, 2, 3, 5, 7, 10, 20, 40)] == [0, 0, 0, 1, 1, 2, 4, 9]


# Evidence.


def distrusted(scenario, seed, until=1.0):
    """Return (suspect, whether it begins) of all changes of trust up to a time, s."""
    result = run(scenario, seed, lambda event: event.t > until * SECOND)
    return {(event.suspect, event.distrusted) for event in result.trace.of(Distrusted)}


@pytest.mark.slow
@pytest.mark.parametrize("trust", [Plausible(), Accusations(), Reputation()], ids=lambda each: each.kind)
def test_impossible_times_and_chases_without_motion_are_found(trust):
    """Where a rule reads the records of inactive teammates, too, a time that is impossible is found without a chase."""
    for lie in ({}, {"acts": "protocol"}, {"phi": None}):
        assert distrusted(team(trust, *liars(1, **lie)), 1) == {(0, True)}
    assert distrusted(team(trust, *liars(1, action="truth"), rule=ArgminKnown), 1) == {(0, True)}


def test_a_position_that_cannot_be_is_found():
    """A lie of 5 m; one of 0 m is the truth."""
    for shift, found in ((5.0, {(3, True)}), (0.0, set())):
        lie = Liar(node=3, start=0.0, position={"kind": "shifted", "by": [shift, 0.0]})
        assert distrusted(team(Plausible(), lie, payload="state", rule=ArgminKnown), 1) == found


@pytest.mark.slow
def test_a_sender_that_the_flow_carries_can_be_farther_away():
    """States that are 0.2 s old, in a medium that is twice as fast as the pursuers; a lie of 5 m is one there, too."""
    flow = {"environment": {"flow": {"kind": "uniform", "velocity": [3.0, 0.0]}}, "network": Links(latency=0.2)}
    for shift, found in ((5.0, {(3, True)}), (0.0, set())):
        lie = Liar(node=3, start=0.0, position={"kind": "shifted", "by": [shift, 0.0]})
        assert distrusted(team(Plausible(), lie, payload="state", rule=ArgminKnown, **flow), 1) == found


def test_the_claims_of_auctions_are_compared_with_physics():
    auction = PROTOCOLS.choice("cbba")
    assert distrusted(team(Plausible(), *liars(1), rule=auction), 1) == {(0, True)}


def test_the_greatest_plausible_lie_is_not_refuted_unless_it_chases_without_moving():
    """It is the capture time of the fastest pursuer there is, which the liar is: so it is no lie."""
    assert distrusted(team(Plausible(), *liars(1, phi={"kind": "plausible"}, action="truth")), 1) == set()
    assert distrusted(team(Plausible(), *liars(1, phi={"kind": "plausible"})), 1) == {(0, True)}


def test_what_is_out_of_sight_is_not_refuted():
    assert distrusted(team(Plausible(radius=0.1), *liars(1)), 1) == set()


def test_at_rest_no_motion_is_expected():
    assert distrusted(team(Plausible(), *liars(1), motion=Motion(static=True)), 1) == set()


UNSUSPICIOUS = ("none", "trimmed")
"""The kinds of trust that look at no evidence."""


@pytest.mark.whole
@pytest.mark.parametrize(
    ("payload", "kind"),
    [
        *zip(("action", "time", "state"), [kind for kind in TRUSTS.choices() if kind not in UNSUSPICIOUS], strict=True),
        *(("state", kind) for kind in UNSUSPICIOUS),
    ],
)
def test_a_late_truth_is_never_called_a_lie(kind, payload):
    """Honest teams under latencies of 0.3 s on average, losses and forwarding: nobody is ever suspected, in 2 runs.

    The control: with clocks that differ by 0.5 s, some are, in one of up to 6 runs.
    """
    trust = TRUSTS.choice(kind)()
    late = {
        "network": Links(latency=Lognormal(mean=0.3, cv=1.0), loss=Bernoulli(p=0.2)),
        "announce": Announcements(payload=payload, heartbeat=0.2, trust=trust, dissemination=Gossip()),
        "evader": (Evader(count=2),),
        "rule": SpatialAdaptivePlay,
    }
    suspected = [distrusted(team(trust, **late), seed, 10.0) for seed in range(2)]
    assert suspected == [set()] * 2
    if kind not in UNSUSPICIOUS:
        assert any(distrusted(team(trust, ClockSkew(offset=0.5), **late), seed, 10.0) for seed in range(6))


def test_false_accusations_below_the_quorum_harm_nobody():
    """Two slanderers accuse 5; a quorum of 3 believes 5, a quorum of 2 does not."""
    slander = [Slander(node=node, start=0.0, accused=(5,)) for node in (0, 1)]
    assert distrusted(team(Accusations(quorum=3), *slander, rule=ArgminKnown), 1) == set()
    assert (5, True) in distrusted(team(Accusations(quorum=2), *slander, rule=ArgminKnown), 1)


# How a team holds, in numbers.


@cache
def measured(scenario, runs=6):
    """Return the share captured, and the mean idle and active time, s."""
    summaries = [summary(run(scenario, seed)) for seed in range(runs)]
    return tuple(float(np.mean([of_run[name] for of_run in summaries])) for name in METRICS)


METRICS = "captured", "idle_time", "active_time"


def unprotected(rule, count, runs):
    return measured(team(Credulous(), *liars(count), rule=rule), runs)


@pytest.mark.whole
@pytest.mark.parametrize("f", [0, 1, 2])
def test_trimmed_local_min_captures_with_up_to_f_liars_and_fails_with_one_more(f):
    """6 runs each. With F + 1 liars, as the control, nearly all is lost: at most 1 of 4 is captured.

    Without liars the active time is at most F + 1 times that of one pursuer (1.05 for the start), 5.0 +- 0.3 s over 40
    runs: it was 5.0, 7.9 and 10.4 s. No more than the first decisions is idle.
    """
    alone = unprotected(LocalMin, 0, 6)[2]
    for count in {0, f}:
        captured, idle, active = measured(team(Trimmed(liars=f), *liars(count)))
        assert captured == 1.0
        assert idle < 0.1
        assert active <= 1.05 * (f + 1) * alone
    captured, idle, _ = measured(team(Trimmed(liars=f), *liars(f + 1)), 4)
    assert captured <= 0.25
    assert idle > 10.0


@pytest.mark.whole
@pytest.mark.parametrize("rule", [LocalMin, SpatialAdaptivePlay])
@pytest.mark.parametrize("trust", [Plausible(), Accusations(), Reputation()], ids=lambda each: each.kind)
def test_evidence_restores_the_capture(rule, trust):
    """Three liars of twelve: captured in all of 6 runs, at the active time of an honest team within 4 s.e. (0.78 s).

    The control, without trust, captures at most one of 4.
    """
    captured, idle, active = measured(team(trust, *liars(3), rule=rule))
    honest = measured(team(trust, rule=rule))
    assert captured == honest[0] == 1.0
    assert idle < 0.1
    assert active == pytest.approx(honest[2], abs=3.1)
    assert unprotected(rule, 3, 4)[0] <= 0.25


# Everywhere.


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("kind", PROTOCOLS.choices())
def test_every_protocol_runs_with_every_trust(kind):
    """The watchers hold, and an honest team that is at ease decides as without trust, but where claims are trimmed."""
    protocol = PROTOCOLS.choice(kind)()
    traces = {}
    for name, model in TRUSTS.choices().items():
        scenario = Scenario(
            horizon=1.0,
            team=Team(count=6, speeds=1.5),
            protocol=protocol,
            announce=Announcements(trust=model()),
            fault=liars(1, acts="protocol"),
            record=Recording(messages=True),
        )
        watched(scenario, 2)
        traces[name] = run(scenario.model_copy(update={"fault": ()}), 2).trace.events
    assert traces["plausible"] == traces["reputation"] == traces["none"]
