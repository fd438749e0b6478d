"""Byzantine faults: content, sender and receivers of the false announcements; the rest of a run is unchanged."""

from dataclasses import dataclass
from math import inf
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from desim import Scenario, run, summary
from desim.kernel.clock_sync import TimeRequest, TwoWay
from desim.kernel.core.events import Broadcast, MessageCounts, Sent, TransportCounts
from desim.kernel.core.units import SECOND
from desim.kernel.models.access import CsmaCa
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.faults import Crash
from desim.kernel.models.latency import Lognormal
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.medium import Bitrate
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.kernel.models.transport import Coded, Reliable
from desim.pursuit.byzantine.falsehoods import (
    ConstantPosition,
    ConstantTime,
    PlausibleTime,
    RandomPosition,
    RandomTime,
    ScaledTime,
    ShiftedPosition,
)
from desim.pursuit.byzantine.lies import (
    LIES,
    Equivocate,
    Liar,
    RandomLies,
    ReplayAttack,
    Selective,
    Silent,
    Slander,
    Spoof,
    draw_lies,
)
from desim.pursuit.byzantine.speaker import Speaker
from desim.pursuit.core.events import Decided
from desim.pursuit.motion.capture import capture_time, least_capture_time
from desim.pursuit.sensing.views import NOWHERE
from desim.pursuit.team.announcements import (
    DISSEMINATIONS,
    Announcements,
    LocatedAssignment,
    own_records,
    relayed_records,
)
from desim.pursuit.team.judges import Accusation
from desim.pursuit.team.trust import Accusations, Plausible
from desim.scenario.players import Team
from desim.scenario.scenario import PROTOCOLS, Clocks, Recording
from desim.testing.pursuits import watched
from protocols.cbaa import CBAA, Claim
from protocols.cbba import CBBA
from protocols.dissemination import Flooding, Gossip
from protocols.local_min import LocalMin
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson
from protocols.schedules.token import TokenRing
from protocols.server import Server

POISSON = Poisson(rate=5.0)
HALF = round(0.5 * SECOND)


def team(*faults, payload="time", protocol=None, **changes):
    """Return a scenario of six pursuers, with Byzantine faults."""
    given = {
        "team": Team(count=6, speeds=1.5, active_at_start=0.0),
        "protocol": protocol or LocalMin(schedule=POISSON),
        "announce": Announcements(payload=payload, start="known", heartbeat=0.1),
        "record": Recording(messages=True),
        "fault": faults,
    }
    return Scenario(**given | changes)


def go(scenario, seed, until=1.0):
    """Return the result of a run up to a time, s."""
    return run(scenario, seed, lambda event: event.t > until * SECOND)


def records_in(event):
    """Return the records that a message relays, or its own."""
    relayed = relayed_records(event.body)
    return own_records(event) if relayed is None else relayed


def said(result, src, begin=0, end=inf):
    """Return the records that a pursuer sends itself, in a window of time (ns): (source, body)."""
    sent = [event for event in result.trace if isinstance(event, Broadcast | Sent) and event.src == src]
    return [(each.src, each.body) for event in sent if begin < event.t <= end for each in records_in(event)]


def _sent(result):
    return [event for event in result.trace if isinstance(event, Broadcast | Sent)]


def positions(result):
    return [event for event in result.trace if type(event).__name__ == "Sampled"]


# What is said.


@pytest.mark.parametrize(
    ("falsehood", "told"),
    [
        (ConstantTime(value=2.0), 2.0),
        (ScaledTime(factor=0.25), 1.5),
        (PlausibleTime(), 1.0),
        (RandomTime(low=3.0, high=3.0), 3.0),
    ],
    ids=lambda each: getattr(each, "kind", ""),
)
def test_a_false_time_follows_from_the_truth_and_from_what_is_plausible(falsehood, told):
    """The truth is 6 s, and no pursuer there could need less than 1 s."""
    assert falsehood(6.0, 1.0, np.random.default_rng(0)) == told


def test_an_infinite_time_is_not_scaled():
    assert ScaledTime(factor=0.0)(inf, 1.0, np.random.default_rng(0)) == inf
    assert PlausibleTime()(0.5, 1.0, np.random.default_rng(0)) == 0.5


def test_a_false_position_follows_from_the_truth():
    rng = np.random.default_rng(0)
    assert ConstantPosition(value=(1.0, 2.0))(5 + 5j, rng) == 1 + 2j
    assert ShiftedPosition(by=(-1.0, 2.0))(5 + 5j, rng) == 4 + 7j
    drawn = [RandomPosition(box=(3.0, 4.0))(5 + 5j, rng) for _ in range(20)]
    assert len(set(drawn)) == 20
    assert all(min(each.real, each.imag) >= 3.0 and max(each.real, each.imag) <= 4.0 for each in drawn)


def test_the_least_time_is_that_of_the_fastest_pursuer():
    """It is the capture time of a pursuer of the greatest speed at the same place; inf if none is faster."""
    distance, radius, top, evader = 5.0, 0.1, 2.0, 0.9
    (phi,) = capture_time((5.0, 0.0), [(0.0, 0.0)], [top], evader, radius)
    assert least_capture_time(distance, radius, top, evader) == phi == pytest.approx(4.45455, abs=1e-5)
    assert least_capture_time(0.1, radius, top, evader) == 0.0
    assert least_capture_time(distance, radius, 0.9, evader) == inf


@pytest.mark.parametrize("payload", ["action", "time", "state"])
def test_a_liar_replaces_all_its_announcements_while_it_lies(payload):
    """It says that it chases, and stays; before and after, it is honest. No announcement is added."""
    lie = Liar(node=2, start=0.25, end=0.55, action="chase", phi=0.0, position=ShiftedPosition(by=(1.0, 0.0)))
    result = go(team(lie, payload=payload), 1)
    before, during, after = (said(result, 2, *window) for window in ((-1, 0.25e9), (0.25e9, 0.55e9), (0.55e9, inf)))
    assert all(body.active == 1 for _, body in during)
    assert during
    assert {body.active for _, body in (*before, *after)} == {0}
    if payload == "time":
        assert {body.capture_time for _, body in during} == {0.0}
        assert min(body.capture_time for _, body in (*before, *after)) > 0.0
    if payload == "state":
        assert {body.x for _, body in during} == {before[0][1].x + 1.0}
    honest = said(go(team(payload=payload), 1), 2)
    assert len(before) + len(during) + len(after) == len(honest)


def test_opposite_and_stay_are_said_by_a_pursuer_that_chases():
    """A single pursuer that is active says that it stays; the default says the truth."""
    for action, told in (("truth", 1), ("chase", 1), ("stay", 0), ("opposite", 0)):
        lie = Liar(node=0, start=0.0, action=action)
        lone = team(lie, team=Team(positions=[(0.0, 0.0), (30.0, 0.0)], speeds=[2.0, 1.0], active_at_start=1.0))
        assert said(go(lone, 1), 0, 0.2e9)[-1][1].active == told


@pytest.mark.parametrize("places", [(3 + 0j, NOWHERE), (NOWHERE, 3 + 0j)])
def test_an_evader_of_unknown_position_does_not_hide_a_plausible_lie(places):
    """2.9 m at 2 m/s less 0.5 m/s, whichever of the two is known; of none, nothing can be said."""
    state = SimpleNamespace(at_large=(1, 2), radius=0.1, top_speed=2.0)
    state.position, state.body = lambda pursuer: 0j, lambda evader: SimpleNamespace(speed=0.5)
    view = SimpleNamespace(state=state, evader=lambda evader: places[evader - 1])
    me = Speaker(0, view, 0, np.random.default_rng(0), 0)
    assert me.least_phi(0) == pytest.approx(2.9 / 1.5)
    assert {me.least_phi(1), me.least_phi(2)} == {me.least_phi(0), inf}


def test_a_pursuer_that_is_to_stay_stops_at_once():
    """It would decide again only at 9 s."""

    def protocol(me):
        me.assign(1)
        yield me.at(9.0)

    scenario = team(Liar(node=0, start=0.5, acts="stay"), protocol=protocol, horizon=1.0)
    last = [event for event in run(scenario, 3).trace.of(Decided) if event.pursuer == 0][-1]
    assert (last.t, last.active) == (HALF, 0)


def test_a_pursuer_that_should_stay_does_not_chase():
    """Nor does it go on with a chase that it has begun."""
    lie = Liar(node=0, start=0.5, action="chase", acts="stay")
    lone = team(lie, team=Team(positions=[(0.0, 0.0)], speeds=2.0, active_at_start=1.0))
    times = [(event.t, event.active) for event in go(lone, 1).trace.of(Decided)]
    assert {active for t, active in times if t < HALF} == {1}
    assert {active for t, active in times if t >= HALF} == {0}


def test_a_silent_pursuer_sends_nothing_and_receives_all():
    result = go(
        team(Silent(node=3, start=0.25, end=0.75), announce=Announcements(start="known", dissemination=Gossip())), 1
    )
    assert said(result, 3, 0.25e9, 0.75e9) == []
    assert said(result, 3, -1, 0.25e9)
    assert said(result, 3, 0.75e9)
    arrived = sum(event.dst == 3 and event.src != 3 for event in result.trace.of(Sent))
    assert arrived == pytest.approx(5 * 10, abs=8)


def test_a_replayed_announcement_is_an_old_one():
    """The evader nears the pursuer, which stays: its capture time falls, and the old ones are greater."""
    place = {"team": Team(positions=[(9.0, 0.0), (0.0, 0.0)], speeds=[1.0, 2.0], active_at_start=0.0)}
    honest = said(go(team(**place), 1), 0)
    result = go(team(ReplayAttack(node=0, start=0.5, delay=0.3), **place), 1)
    late = said(result, 0, HALF)
    assert len(late) >= 4
    assert set(late) <= set(honest)
    assert late != honest[-len(late) :]


class Turn:
    """An announcement that its sender changes in place."""

    def __init__(self):
        self.active, self.news, self.turns = 0, None, [0]


def test_a_replayed_announcement_that_has_changed_since_is_the_old_one():
    def counting(me):
        payload = Turn()
        me.set_payload(payload)
        for k in range(1, 10):
            me.broadcast()
            yield me.sleep(0.1)
            payload.turns[0] = k

    announce = Announcements(trigger="never", start="known")
    result = go(team(ReplayAttack(node=0, start=0.5, delay=0.3), protocol=counting, announce=announce), 1)
    assert [body.turns[0] for _, body in said(result, 0, -1)] == [0, 1, 2, 3, 4, 2, 3, 4, 5]


def test_a_spoofed_announcement_is_believed_to_be_of_the_victim():
    """Pursuer 5 says in the name of 1 that it chases, and nothing in its own; 1 stays."""
    result = go(team(Spoof(node=5, victim=1, start=0.0, action="chase", phi=0.0)), 1)
    assert {src for src, _ in said(result, 5, 1)} == {1}
    assert {body.active for _, body in said(result, 5, 1)} == {1}
    sequence = [each.seq for event in result.trace for each in _records(event) if each.src == 1]
    assert sequence == sorted(set(sequence))  # each next record of 1, forged or not, is newer


def test_a_spoofed_announcement_is_where_the_victim_is():
    """All stand still: of what is not falsified, 5 says what 1 would say."""
    still = {"motion": {"static": True}, "payload": "state"}
    result = go(team(Spoof(node=5, victim=1, start=0.0, action="stay"), **still), 1)
    forged = {(src, body) for src, body in said(result, 5, 1)}
    assert {body[1:] for _, body in forged} == {body[1:] for _, body in said(result, 1, 1)}
    assert {src for src, _ in forged} == {1}


def test_a_fault_of_a_pursuer_ends_without_another_one_that_lasts():
    """Silent up to 0.5 s, it then says up to 1 s that it chases."""
    chases = Liar(node=0, start=0.0, end=1.0, action="chase", acts="stay")
    result = go(team(chases, Silent(node=0, start=0.0, end=0.5)), 1, 2.0)
    assert not said(result, 0, 0, HALF - 1)
    assert {body.active for _, body in said(result, 0, HALF, 2 * HALF - 1)} == {1}


def _records(event):
    return records_in(event) if isinstance(event, Broadcast) or (isinstance(event, Sent) and event.dst == 0) else ()


def test_a_random_victim_is_any_teammate_but_the_pursuer_itself():
    names = {src for src, _ in said(go(team(Spoof(node=5, start=0.0)), 1, 4.0), 5, 1)}
    assert names == {0, 1, 2, 3, 4}


@pytest.mark.parametrize("dissemination", [None, Gossip()])
def test_an_equivocating_pursuer_tells_each_neighbour_always_the_same(dissemination):
    """Some are told that it chases, and others that it stays."""
    announce = Announcements(payload="time", **({} if dissemination is None else {"dissemination": dissemination}))
    result = go(team(Equivocate(node=0, start=0.0, phi=0.0), announce=announce), 2)
    told = {dst: set() for dst in range(1, 6)}
    for event in result.trace.of(Sent):
        if event.src == 0:
            told[event.dst] |= {each.body.active for each in records_in(event) if each.src == 0}
    assert all(len(each) == 1 for each in told.values())
    assert set.union(*told.values()) == {0, 1}


def test_a_selective_pursuer_forwards_nothing_but_its_own_announcements():
    """On a line 0 - 1 - 2, pursuer 1 withholds what 0 and 2 say; with drop = 0 it withholds nothing."""
    line = {"graph": {"kind": "edges", "edges": [{"src": 0, "dst": 1}, {"src": 1, "dst": 2}], "nodes": 3}}
    trio = {"team": Team(count=3, speeds=1.5), "network": line}
    for dissemination in (Flooding(), Gossip()):
        announce = Announcements(dissemination=dissemination)
        for drop, sources in ((1.0, {1}), (0.0, {0, 1, 2})):
            result = go(team(Selective(node=1, start=0.0, drop=drop), announce=announce, **trio), 1)
            assert {src for src, _ in said(result, 1)} == sources


@pytest.mark.slow
@dataclass(frozen=True)
class Relaying:
    records: Any


@pytest.mark.slow
@pytest.mark.parametrize(
    "make", [Relaying, lambda records: Relaying(list(records)), lambda records: {"records": records}]
)
def test_an_equivocating_pursuer_relays_different_records_in_a_body_of_any_type(make):
    def protocol(me):
        me.send(None, make((me.record(me.announcement()),)), size=10)
        yield me.sleep(1.0)

    result = go(team(Equivocate(node=1, start=0.0), protocol=protocol), 1, 0.5)
    bodies = [event.body for event in result.trace.of(Sent) if event.src == 1]
    actions = [relayed_records(body)[0].body.active for body in bodies]
    assert set(actions) == {0, 1}


@pytest.mark.whole
def test_a_token_that_is_swallowed_now_and_then_is_sent_again():
    """The protocol of pursuer 2 gets no receipt for it, and repeats it; a pursuer that swallows all forwards none."""
    ring = LocalMin(schedule=TokenRing(holding_time=0.01))
    shares = {}
    for drop in (0.0, 0.3, 1.0):
        case = team(Selective(node=2, start=0.0, drop=drop), protocol=ring, team=Team(count=4, speeds=0.1))
        result = go(case, 1, 8.0)
        held = sum(event.dst == 2 for event in result.trace.of(Sent) if type(event.body).__name__ == "Token")
        sent = sum(event.src == 2 for event in result.trace.of(Sent) if type(event.body).__name__ == "Token")
        shares[drop] = sent / held
    assert shares[0.0] == pytest.approx(1.0, abs=0.01)
    assert shares[1.0] == 0.0
    assert shares[0.3] > 0.9


@pytest.mark.whole
def test_a_swallowed_token_is_missed_only_if_its_holder_falls_silent():
    """A pursuer that confirms the token, says that it has it and forwards it never keeps all others from deciding."""
    ring = LocalMin(schedule=TokenRing(holding_time=0.01))
    late = {}
    for fault in (None, Selective(node=2, start=0.2), Silent(node=2, start=0.2)):
        result = go(team(*([fault] if fault else []), protocol=ring, team=Team(count=4, speeds=0.1)), 1, 6.0)
        tokens = [event for event in result.trace.of(Sent) if type(event.body).__name__ == "Token"]
        late[fault and fault.kind] = {event.body.epoch[0] for event in tokens if event.t > 5e9}
    assert late[None] == {1}
    assert late["selective"] == set()
    assert late["silent"]
    assert min(late["silent"]) > 1


@pytest.mark.parametrize("auction", [CBAA, CBBA])
def test_a_liar_in_an_auction_bids_what_it_pretends(auction):
    """Its claim names it the winner with the highest bid, and others let go of the evader."""
    lie = Liar(node=4, start=0.0, action="chase", phi=0.0, acts="stay")
    result = go(team(lie, protocol=auction(schedule=POISSON)), 1, 3.0)
    claims = [body for _, body in said(result, 4, 1)]
    assert claims
    assert {(claim.active, claim.winners, claim.amounts) for claim in claims} == {(1, (4,), (0.0,))}
    assert summary(result).idle_time > 2.0
    assert summary(go(team(protocol=auction(schedule=POISSON)), 1, 3.0)).idle_time < 0.5


def test_a_false_claim_withdraws_other_bids_of_the_liar():
    claim = Claim(1, (3, 7), (-2.0, -1.0))
    assert claim.falsified(3, 2, 0.5) == Claim(2, (-1, 3), (-inf, -0.5))
    assert claim.falsified(3, 0, inf) == Claim(0, (-1, 7), (-inf, -1.0))
    assert (claim.phi(3), claim.phi(7)) == (2.0, inf)


# The way it is said.


WAYS = {
    "unlimited": Links(loss=Bernoulli(p=0.5)),
    "reliable": Links(loss=Bernoulli(p=0.5), transport=Reliable()),
    "coded": Links(loss=Bernoulli(p=0.5), transport=Coded(pieces=3)),
    "csma_ca": Links(medium=Bitrate(bitrate=1e6, access=CsmaCa()), loss=Bernoulli(p=0.5)),
}


@pytest.mark.slow
@pytest.mark.parametrize("network", WAYS.values(), ids=WAYS)
def test_every_lie_is_sent_in_the_way_of_the_honest(network):
    """Of as many bytes, as often, and never repeated: only silence is less, and equivocation two broadcasts."""
    announce = Announcements(payload="time", trigger="heartbeat", heartbeat=0.1, jitter=0.5)

    def sent(*faults):
        """Return the number of transmissions, and the sizes of the messages of pursuer 2."""
        result = go(team(*faults, network=network, announce=announce), 1)
        messages = [event for event in _sent(result) if event.src == 2]
        assert not result.trace.of(TransportCounts)
        (counts,) = result.trace.of(MessageCounts)
        return counts.transmissions, counts.sent, {event.size for event in messages}, len({m[1] for m in messages})

    transmissions, messages, sizes, own = sent()
    assert 8 <= own <= 12
    for model in LIES:
        expected = transmissions, messages, sizes, own
        if model is Silent:
            expected = transmissions - own, messages - 5 * own, set(), 0
        if model is Equivocate:
            expected = transmissions + own, messages, sizes, 2 * own
        assert sent(model(node=2, start=0.0, **_needed(model))) == expected, model


def test_a_forged_announcement_is_heard_as_often_as_an_honest_one():
    """The same draws of losses and latencies decide on it: it arrives where and when the honest one would."""
    network = Links(loss=Bernoulli(p=0.5), latency=Lognormal(mean=0.01, cv=0.5), transport=Reliable())
    announce = Announcements(payload="time", trigger="heartbeat")

    def arrivals(*faults):
        result = go(team(*faults, network=network, announce=announce), 1)
        sent = [event for event in _sent(result) if event.src == 2]
        return [(event.t, *fate) for event in sent for fate in event.fates()]

    assert arrivals(Spoof(node=2, start=0.0)) == arrivals()


def test_an_equivocating_pursuer_numbers_an_announcement_once():
    """Both versions have the number of the announcement, as a broadcast has one, and reach all neighbours."""
    result = go(team(Equivocate(node=0, start=0.0, phi=0.0)), 2)
    told = {}
    for event in result.trace.of(Sent):
        for record in records_in(event):
            if event.src == 0:
                told.setdefault(record.seq, []).append(event.dst)
    assert list(told) == list(range(1, len(told) + 1))
    assert all(sorted(receivers) == [1, 2, 3, 4, 5] for receivers in told.values())


def test_false_accusations_are_sent_as_often_as_true_ones():
    """Once per interval of the trust, and not with each announcement; nothing where nobody reads accusations."""
    slander = Slander(node=0, start=0.0, accused=(5,))
    for trust, times in ((Accusations(interval=0.25), 4), (Plausible(), 0)):
        result = go(team(slander, announce=Announcements(heartbeat=0.05, trust=trust)), 1)
        sent = {event.t for event in result.trace.of(Sent) if isinstance(event.body, Accusation)}
        assert len(sent) == times


def test_a_silent_pursuer_does_not_ask_for_the_time():
    sync = Clocks(sync=TwoWay(interval=0.05))
    result = go(team(Silent(node=3, start=0.5), ClockSkew(offset=0.1), clocks=sync), 1)
    asked = {event.src for event in result.trace.of(Sent) if event.t > HALF and isinstance(event.body, TimeRequest)}
    assert asked == {1, 2, 4, 5}


def test_a_spoofed_report_to_a_server_is_a_report():
    """It has the position of the victim, also if the payload of announcements has none."""
    result = go(team(Spoof(node=5, victim=1, start=0.0), payload="action", protocol=Server()), 1)
    reports = [(src, body) for src, body in said(result, 5)]
    assert {src for src, _ in reports} == {1}
    assert {type(body) for _, body in reports} == {LocatedAssignment}


# Who lies, and when.


def test_a_greater_share_contains_a_smaller_one():
    drawn = {
        share: {lie.pursuer for lie in draw_lies([Silent(share=share, start=0.0)], 20, 5.0, 7)}
        for share in (0.0, 0.1, 0.25, 1.0)
    }
    assert [len(each) for each in drawn.values()] == [0, 2, 5, 20]
    assert drawn[0.1] < drawn[0.25] < drawn[1.0]
    assert drawn[0.25] != {lie.pursuer for lie in draw_lies([Silent(share=0.25, start=0.0)], 20, 5.0, 8)}


def test_the_window_of_a_lie_is_in_the_trace():
    trace = go(team(Silent(node=3, start=0.25, end=0.75), Crash(node=1, start=0.5)), 1).trace
    begun = [(event.t, event.fault.kind, event.fault.node) for event in trace.of(FaultStarted)]
    assert begun == [(0.25e9, "misbehaviour", 3), (0.5e9, "crash", 1)]
    assert [(event.t, event.fault.model) for event in trace.of(FaultEnded)] == [(0.75e9, "silent")]


@pytest.mark.slow
def test_a_lie_changes_no_other_random_draw():
    """Up to a lie without an effect the positions are those of the honest run, and after it, too."""
    for lie in (Liar(node=2, start=0.5), Selective(node=2, start=0.3), ReplayAttack(node=2, start=0.9, delay=0.001)):
        assert positions(go(team(lie), 3)) == positions(go(team(), 3))


# Everywhere.


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("kind", PROTOCOLS.choices())
def test_every_protocol_bears_every_lie(kind):
    """Conservation, motion and token watchers hold; the same seed gives the same trace."""
    lies = [
        *(model(node=k % 6, start=0.1 * k, end=0.1 * k + 0.4, **_needed(model)) for k, model in enumerate(LIES)),
        RandomLies(rate=5.0, mean_duration=0.3),
    ]
    scenario = team(*lies, protocol=PROTOCOLS.choice(kind)(), network=Links(loss=Bernoulli(p=0.1)), horizon=2.5)
    assert watched(scenario, 5).trace.events == run(scenario, 5).trace.events


def _needed(model):
    return {"accused": (3,)} if model is Slander else {}


@pytest.mark.slow
@pytest.mark.parametrize("dissemination", DISSEMINATIONS.choices().values())
@pytest.mark.parametrize("model", LIES)
def test_every_dissemination_bears_every_lie(dissemination, model):
    announce = Announcements(payload="state", dissemination=dissemination())
    watched(team(model(node=1, start=0.0, **_needed(model)), announce=announce, horizon=2.0), 5)


def test_bodies_that_are_no_announcements_are_not_falsified():
    """A report to a server is one of a position, and is falsified; an order is not."""
    lie = Liar(node=2, start=0.0, position=ConstantPosition(value=(-7.0, -7.0)))
    result = go(team(lie, protocol=PROTOCOLS.choice("server")()), 1)
    reports = {(body.x, body.y) for _, body in said(result, 2)}
    assert reports == {(-7.0, -7.0)}


# Harm.


@pytest.mark.whole
@pytest.mark.parametrize("rule", [SpatialAdaptivePlay, LocalMin])
def test_one_liar_that_claims_to_be_there_at_once_loses_the_evader(rule):
    """6 runs of 12 pursuers: all are captured without it; and at most one of 4 with it.

    The control: a liar that says the truth about its action harms nothing.
    """
    shares = {}
    for name, runs, fault in (
        ("honest", 6, ()),
        ("liar", 4, (Liar(node=0, start=0.0, action="chase", phi=0.0, acts="stay"),)),
        ("harmless", 6, (Liar(node=0, start=0.0, acts="stay"),)),
    ):
        scenario = Scenario(
            team=Team(count=12, speeds=1.5, active_at_start=0.0),
            protocol=rule(schedule=POISSON),
            announce=Announcements(payload="time", heartbeat=0.2),
            record=Recording(trajectory=0.0),
            fault=fault,
        )
        shares[name] = np.mean([summary(run(scenario, seed)).captured for seed in range(runs)])
    assert shares["honest"] == shares["harmless"] == 1.0
    assert shares["liar"] <= 0.25
