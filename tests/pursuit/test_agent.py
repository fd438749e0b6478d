"""The agent: what a protocol may know and do."""

from dataclasses import dataclass
from functools import partial
from inspect import signature
from math import inf, nan
from typing import Any, NamedTuple

import networkx as nx
import numpy as np
import pandas as pd
import pytest

from desim import Scenario, run
from desim.kernel.core.clock import Phase
from desim.kernel.core.events import Broadcast, Sent
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import SECOND
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.faults import Crash
from desim.kernel.models.graphs import Edges, Ring
from desim.kernel.models.latency import Constant, Lognormal
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.transport import Reliable
from desim.kernel.network import Network
from desim.kernel.stepped_network import SteppedNetwork
from desim.pursuit.byzantine.lying import LyingTeam
from desim.pursuit.core.events import Captured, Decided
from desim.pursuit.game.utility import EdgePenalty, LocalMean, Mean
from desim.pursuit.motion.environment import Environment
from desim.pursuit.motion.flow import SteadyFlow
from desim.pursuit.sensing.views import View
from desim.pursuit.team.agent import Agent, Voice, repeat
from desim.pursuit.team.announcements import STARTS, Announcements, Assignment, own_records, relayed_records
from desim.pursuit.team.timing import StandstillError
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion, Recording
from protocols.best_response import BestResponse
from protocols.dissemination import Flooding, Gossip, OneHop
from protocols.geometric import Voronoi
from protocols.rule import argmax
from protocols.schedules.periodic import Poisson
from protocols.server import Server


def play(protocol, latency=0.0, **changes):
    """Run a protocol for three pursuers at 1, 2 and 4 m (speed 1) of an evader that stands still, r(0) = 10 s."""
    given = {
        "horizon": 10.0,
        "team": Team(positions=[(1.0, 0.0), (2.0, 0.0), (4.0, 0.0)], speeds=1.0, active_at_start=0.0),
        "evader": Evader(position=(0.0, 0.0), speed=0.0),
        "protocol": protocol,
        "network": Links(latency=Constant(value=latency)),
        "announce": Announcements(trigger="revision"),
    }
    return run(Scenario(**(given | changes)))


def test_the_gain_uses_the_records_that_have_arrived():
    """Pursuer 2 (phi = 3.9) learns of pursuer 0 (phi = 0.9, chasing since 1 s) 0.5 s late."""
    seen = {}

    def protocol(me):
        if me.id == 0:
            yield me.at(0.5)
            me.announce()
            yield me.at(0.75)
            me.assign(True)
            me.announce()
            me.assign(False)  # so that it does not capture
        if me.id == 2:
            for t in (0.0, 1.2, 1.25, 1.3):
                yield me.at(t)
                seen[t] = (me.believed_active(), round(me.gain(), 9), me.time_left())
                assert me.time_left(0.5) == pytest.approx(me.time_left() - 0.5)

    play(protocol, latency=0.5)
    assert seen[0.0] == ([], 6.1, 10.0)
    assert seen[1.2] == ([], 4.9, 8.8)
    assert seen[1.25] == (*seen[1.3][:2], 8.75) == ([0], -1.5, 8.75)


def test_a_pursuer_that_cannot_capture_stays_and_actions_of_unknown_pursuers_are_refused():
    def protocol(me):
        yield me.at(1.0)
        me.assign(True)
        actions.append(me.action)
        with pytest.raises(ValueError, match="there is no pursuer -1"):
            me.global_state.set_action(-1, True)

    actions = []
    team = Team(positions=[(1.0, 0.0), (2.0, 0.0)], speeds=[0.0, 1.0], active_at_start=1.0)
    assert [d.active for d in play(protocol, team=team, horizon=1.5).trace.of(Decided)] == actions == [False, True]


@pytest.mark.parametrize(
    ("call", "time", "allowed"),
    [("sleep", inf, "duration should be finite and at least 0 s"), ("sleep", -1.0, "duration"), ("at", nan, "time")],
)
@pytest.mark.parametrize("fault", [(), (ClockSkew(offset_walk=1e-9),)], ids=["true", "wandering"])
def test_waiting_for_a_time_that_never_comes_is_an_error(call, time, allowed, fault):
    def protocol(me):
        yield me.at(me.id * 0.25)
        if me.id == 1:
            yield getattr(me, call)(time)

    with pytest.raises(
        ValueError, match=rf"^pursuer 1: {call}\({time}\): the {allowed}.*return\)\n\(pursuer 1, at 0.25 s "
    ):
        play(protocol, fault=fault)


@pytest.mark.parametrize(("prune", "late"), [("infeasible", (0,)), ("inf", (0, 1)), ("none", (0, 1))])
def test_options_shrink_with_the_time_left_if_it_prunes(prune, late):
    """Pursuer 2 needs 3.9 s of the 10 s: from 6.1 s on it would come too late."""
    seen = []

    def protocol(me):
        for t in (0.0, 6.0, 6.2):
            yield me.at(t)
            if me.id == 2:
                seen.append(tuple(me.options()))

    play(protocol, prune=prune)
    assert seen == [(0, 1), (0, 1), late]


@pytest.mark.parametrize("wait", [lambda me: me.sleep(0), lambda me: me.at(-1.0), lambda me: me.sleep(1e-12)])
def test_waiting_for_the_present_without_end_is_an_error(wait, monkeypatch):
    monkeypatch.setattr("desim.pursuit.team.timing.MAX_AT_ONE_INSTANT", 50)

    def protocol(me):
        for _ in range(3):
            yield me.sleep(0.25)
            for _ in range(30 if me.now < 0.6 else 60):
                yield wait(me)

    with pytest.raises(StandstillError, match=r"pursuer 0 has waited 50 times for the same instant, 0\.75 s: time "):
        play(protocol)


def again(me):
    tick = me.sleep(0.25)
    while True:
        yield tick


def with_mail_unread(me):
    yield me.sleep(0.25)
    me.send(None, 1)
    while True:
        yield me.arrival()


def with_mail_of_another_port(me):
    yield me.sleep(0.25)
    me.send(None, 1, "bids")
    while True:
        yield me.arrival("bids")
        me.mail()


def again_or_arrival(me):
    tick = me.sleep(0.25)
    while True:
        yield tick | me.arrival()


def answering_at_once(me):
    yield me.sleep(0.25)
    me.send(1 - me.id, 1)
    while True:
        yield me.arrival()
        for message in me.mail():
            me.send(message.src, 1)


@pytest.mark.parametrize(
    "protocol", [again, with_mail_unread, with_mail_of_another_port, again_or_arrival, answering_at_once]
)
def test_going_on_without_end_at_one_instant_is_an_error(protocol, monkeypatch):
    monkeypatch.setattr("desim.pursuit.team.timing.MAX_AT_ONE_INSTANT", 50)
    scenario = Scenario(team=Team(count=2), protocol=protocol, horizon=1.0)
    with pytest.raises(
        StandstillError, match=r"has waited 50 times for the same instant, 0\.25 s: .*does it wait again"
    ):
        run(scenario, 1)


def test_going_on_often_at_many_instants_is_none(monkeypatch):
    monkeypatch.setattr("desim.pursuit.team.timing.MAX_AT_ONE_INSTANT", 50)

    def protocol(me):
        for _ in range(10):
            tick = me.sleep(0.05)
            for _ in range(45):
                yield tick

    run(Scenario(team=Team(count=2), protocol=protocol, horizon=1.0), 1)


def test_an_agent_has_its_id_and_team_data():
    def protocol(me):
        yield me.sleep(0.25)
        assert (me.now, me.team_size, me.action) == (0.25, 3, False)
        assert me.global_state.capture_times(1) == pytest.approx([0.9, 1.9, 3.9])
        assert me.capture_time() == me.global_state.capture_times(1)[me.id]
        assert [me.global_state.action(j) for j in range(3)] == me.global_state.profile() == [0, 0, 0]
        me.global_state.set_action(2, 1)
        assert [me.global_state.action(j) for j in range(3)] == me.global_state.profile() == [0, 0, 1]
        me.global_state.set_action(2, 0)
        assert me.stream("x").random() != me.shared_stream("x").random()
        done.append((me.id, me.shared_stream("x").random()))

    done = []
    play(protocol)
    assert [pursuer for pursuer, _ in done] == [0, 1, 2]
    assert len({draw for _, draw in done}) == 1


def test_agents_talk_by_message():
    heard = []

    def protocol(me):
        if me.id == 0:
            me.send(2, "to one")
            me.send(None, "to all")
        while True:
            yield me.arrival()
            heard.extend((me.id, me.now, message.body) for message in me.mail())

    play(protocol, latency=0.125)
    assert heard == [(1, 0.125, "to all"), (2, 0.125, "to one"), (2, 0.125, "to all")]


def test_a_function_takes_the_messages_of_a_port_as_they_arrive():
    heard = []

    def protocol(me):
        if me.id == 0:
            me.send(1, "first", "mail")
            me.send(1, "second", "mail")
            me.send(1, "of another port")
            yield me.sleep(0.5)
            me.send(1, "third", "mail")
        elif me.id == 1:
            yield me.sleep(0.25)  # the first two wait until there is a function for them
            yield me.listen(lambda messages: heard.append((me.now, [message.body for message in messages])), "mail")
            raise AssertionError("its event never happens")

    play(protocol, latency=0.125)
    assert heard == [(0.25, ["first", "second"]), (0.625, ["third"])]
    with pytest.raises(ValueError, match="pursuer 0: listen: act should be a function of messages"):
        play(lambda me: iter([me.listen(3)]))
    with pytest.raises(ValueError, match="node 0: a port should be a text"):
        play(lambda me: iter([me.listen(print, 3)]))
    with pytest.raises(ValueError, match="pursuer 0: listen: ignores should be a function of a message"):
        play(lambda me: iter([me.listen(print, ignores=3)]))
    with pytest.raises(ValueError, match=r"pursuer 0: listen: act should accept a call with \(messages\); <lambda>"):
        play(lambda me: iter([me.listen(lambda: None)]))
    with pytest.raises(ValueError, match=r"pursuer 0: listen: ignores should accept a call with \(message\); <lambda>"):
        play(lambda me: iter([me.listen(print, ignores=lambda one, other: True)]))
    with pytest.raises(ValueError, match=r"pursuer 0: listen: act should do its work when it is called, without yield"):
        play(lambda me: iter([me.listen(lambda messages: (yield))]))


@pytest.mark.parametrize("memory", [True, False])
def test_a_function_of_before_a_restart_takes_no_message(memory):
    """A message arrives at the instant at which the robot restarts, and waits until its protocol listens anew."""
    heard = []

    def protocol(me):
        restarts = me.restarts
        if me.id == 0:
            yield me.sleep(0.25)
            me.send(1, "at the end")
        elif me.id == 1:
            yield me.sleep(0.125)
            yield me.listen(lambda messages: heard.extend((restarts, me.now, message.body) for message in messages))

    crash = Crash(node=1, start=0.25, end=0.5, scope="robot", memory=memory)
    play(protocol, latency=0.25, fault=[crash])
    assert heard == [(0, 0.5, "at the end") if memory else (1, 0.625, "at the end")]


def test_a_later_function_replaces_the_one_before():
    heard = []

    def protocol(me):
        if me.id == 0:
            for number in range(4):
                me.send(1, number)
                yield me.sleep(0.5)
        elif me.id == 1:
            me.listen(lambda _: heard.append("first"))
            yield me.sleep(0.75)
            yield me.listen(lambda messages: heard.extend(message.body for message in messages))

    play(protocol, latency=0.125)
    assert heard == ["first", "first", 2, 3]


def test_functions_that_answer_each_other_without_latency_are_told_that_time_stands_still(monkeypatch):
    monkeypatch.setattr("desim.pursuit.team.timing.MAX_AT_ONE_INSTANT", 50)

    def protocol(me):
        if me.id == 0:
            me.send(1, "ping")
        yield me.listen(lambda messages: [me.send(message.src, "pong") for message in messages])

    with pytest.raises(StandstillError, match="answer messages that take no time"):
        play(protocol)


def test_decisions_of_one_instant_are_in_id_order_and_see_each_other_at_zero_latency():
    """All three find none active at 1 s; the first chases, and the others learn of it at once."""

    def protocol(me):
        yield me.at(1.0)
        me.assign(me.gain() > 0)
        me.announce()

    assert [d.active for d in play(protocol).trace.of(Decided)] == [True, False, False]
    assert [d.active for d in play(protocol, latency=1e-9).trace.of(Decided)] == [True, True, True]


@pytest.mark.slow
@pytest.mark.parametrize(("between", "said"), [(True, [0.1, 2.0]), (False, [0.1])])
def test_a_heartbeat_counts_as_the_last_announcement(between, said):
    """Active and so announced at 0.1 s; inactive from 0.2 to 2 s, announced only by a heartbeat; active again at 2 s.

    That is a change for receivers of the heartbeat, and none without a heartbeat between.
    """

    def protocol(me):
        for t, active in ((0.1, True), (0.2, False), (2.0, True)):
            yield me.at(t)
            me.assign(active)
            if active:
                me.announce()

    team = Team(positions=[(9.0, 0.0)] * 2, speeds=1.0, active_at_start=0.0)
    announce = Announcements(trigger="both", heartbeat=2.0) if between else Announcements(trigger="change")
    for seed in range(8):
        record = Recording(trajectory=0.0, messages=True)
        result = play(protocol, team=team, announce=announce, record=record, seed=seed)
        told = {b.t / 1e9: b.body.active for b in result.trace.of(Broadcast) if b.src == 0}
        quiet = {t: active for t, active in told.items() if 0.2 < t < 2.0}
        assert not any(quiet.values())
        assert bool(quiet) <= between
        if bool(quiet) == between:
            assert [t for t in told if t in {0.1, 2.0}] == said


def dicing(drawn):
    """Return a dissemination that draws from the generator of a pursuer's decisions, every 0.1 s."""

    def draw(me):
        while True:
            drawn.setdefault(me.id, []).append(me.rng.random())
            yield me.sleep(0.1)

    draw.broadcast = lambda me, announcement: None
    return draw


def test_dissemination_and_protocol_share_one_generator():
    """Each draws ten times in turns; together they draw what the stream gives, each number once."""
    drawn = {}

    def protocol(me):
        yield me.sleep(0.05)
        yield from dicing(drawn)(me)

    play(protocol, announce=Announcements(dissemination=dicing(drawn), trigger="never"), horizon=0.98)
    assert drawn == {pursuer: stream(0, "decisions", pursuer).random(20).tolist() for pursuer in range(3)}


def test_the_belief_timeout_is_measured_by_a_clock_as_it_is_then():
    """A second takes a true second of a clock that then goes at half its rate; the announcement is 1.5 s old."""
    seen, spans = [], [SECOND, 2 * SECOND]

    def protocol(me):
        me.broadcast()
        yield me.at(1.5)
        if me.id == 1:
            me._clock.wanders, me._clock.span = True, lambda duration: spans.pop(0)
            seen.extend([me.trusted().keys(), me.trusted().keys()])

    play(protocol, announce=Announcements(trigger="never", belief_timeout=1.0, start="silent"))
    assert seen == [set(), {0, 2}]


@pytest.mark.parametrize(("payload", "known"), [("action", [0, 1, 2]), ("time", [1, 2]), ("state", [1, 2])])
def test_the_team_estimate_is_sensed_or_from_records_within_the_belief_timeout(payload, known):
    """Pursuer 0 announces at 0 s only, pursuer 2 at 0 s and 1 s; at 1.5 s records older than 1 s are forgotten."""
    seen = []

    def protocol(me):
        me.broadcast()
        yield me.at(1.0)
        if me.id == 2:
            me.broadcast()
        yield me.at(1.5)
        if me.id == 1:
            seen.append(me.team_estimate())

    play(protocol, announce=Announcements(trigger="revision", payload=payload, belief_timeout=1.0, start="silent"))
    (found,) = seen
    assert found.ids == known
    assert found.capture_times == pytest.approx([(0.9, 1.9, 3.9)[j] for j in known])
    assert found.speeds.tolist() == [1.0] * len(known)
    if payload != "time":
        assert found.positions == pytest.approx([(1.0, 2.0, 4.0)[j] for j in known])


@pytest.mark.parametrize(
    ("payload", "neighbours", "component"),
    [("action", [0], {0, 1}), ("time", [0, 1, 2], {0, 1, 2}), ("state", [0, 1, 2], {0, 1, 2})],
)
def test_counted_teammates_are_the_audible_ones_or_without_sensing_those_with_records(payload, neighbours, component):
    """One way from 0 to 1, and from 1 to 2: 1 receives from 0, and none from 2."""
    seen = []

    def protocol(me):
        yield me.at(0.5)
        seen.append(
            (
                sorted(me.counted_teammates("neighbours")),
                set(me.counted_teammates("component")),
                list(me.counted_teammates("heard")),
            )
        )
        seen.append(me.neighbours())

    links = Links(graph=Edges.of(nx.DiGraph([(0, 1), (1, 2)])))
    play(protocol, announce=Announcements(payload=payload), network=links)
    assert seen[2] == (neighbours, component, [0, 1, 2])
    assert seen[3] == [2]


@pytest.mark.parametrize("utility", [LocalMean(), EdgePenalty(), Mean()], ids=repr)
def test_a_pursuer_leaves_the_chase_to_a_faster_one_over_a_one_way_link(utility):
    scenario = Scenario(
        horizon=5.0,
        team=Team(positions=[(1.0, 0.0), (2.0, 0.0)], speeds=1.0),
        evader=Evader(position=(0.0, 0.0), speed=0.0),
        motion=Motion(static=True),
        protocol=BestResponse(schedule=Poisson(rate=10.0), utility=utility),
        network=Links(graph=Edges.of(nx.DiGraph([(0, 1)]))),
    )
    last = {event.pursuer: event.active for event in run(scenario, 0).trace.of(Decided)}
    assert last == {0: True, 1: False}


def test_the_position_of_an_agent_is_that_of_its_pursuer_now():
    """Pursuer 1 chases at speed 1 from 1 s on, straight towards the evader at the origin."""
    seen = {}

    def protocol(me):
        yield me.at(1.0)
        me.assign(me.id == 1)
        yield me.at(1.5)
        seen[me.id] = me.position()

    play(protocol)
    assert seen == pytest.approx({0: 1.0, 1: 1.5, 2: 4.0})


class Claim(NamedTuple):
    active: bool
    news: int = 0


@pytest.mark.slow
def test_a_claim_does_not_reveal_the_position_of_its_sender():
    """Unless positions are sensed."""

    for payload in ("action", "time", "state"):
        seen = []

        def protocol(me, seen=seen):
            me.set_payload(Claim(True))
            me.broadcast()
            yield me.at(0.5)
            seen.append((me.beliefs()[(me.id + 1) % 3].capture_time, me.team_estimate().positions[(me.id + 1) % 3]))

        play(protocol, announce=Announcements(payload=payload, start="silent"))
        times, places = zip(*seen, strict=True)
        if payload == "action":
            assert times == pytest.approx([1.9, 3.9, 0.9])
            assert places == pytest.approx([2.0, 4.0, 1.0])
        else:
            assert np.isnan(times).all()
            assert np.isnan(places).all()


class Forgetful(dict):
    """A mapping that keeps nothing."""

    def __setitem__(self, key, value):
        pass


def forget_motions(monkeypatch):
    """Let pursuers that share a view share nothing that they extrapolate."""
    start = View.__init__

    def forgetting(view, *given):
        start(view, *given)
        view.reckonings, view.reckoned_teams = Forgetful(), Forgetful()

    monkeypatch.setattr(View, "__init__", forgetting)


@pytest.mark.parametrize("payload", ["state", "course"])
@pytest.mark.parametrize("protocol", [Voronoi(slot=0.1), BestResponse(schedule=Poisson(rate=5.0)), Server()])
@pytest.mark.parametrize("radius", [inf, 5.0])
def test_motions_that_are_shared_are_those_that_each_pursuer_extrapolates(monkeypatch, payload, protocol, radius):
    """The same trace if the view that pursuers share keeps no motions, where a clock is wrong, or sight is limited."""
    scenario = Scenario(
        sensing={"radius": radius},
        horizon=3.0,
        team=Team(count=6, speeds=1.0),
        protocol=protocol,
        announce=Announcements(payload=payload, heartbeat=0.2),
        network=Links(latency=Constant(value=0.05), loss=Bernoulli(p=0.2)),
        fault=[ClockSkew(offset=0.05, node=0)],
    )
    shared = list(run(scenario).trace)
    forget_motions(monkeypatch)
    assert list(run(scenario).trace) == shared


def test_what_a_server_believes_of_its_orders_is_not_shared_with_who_has_given_none():
    """Ordered to chase at 0.2 s, both teammates would be 0.3 m closer at 0.5 s, of which nobody else knows."""
    seen = []

    def protocol(me):
        yield me.at(0.5)
        if me.id == 0:
            given = {j: [(SECOND // 5, 1)] for j in (1, 2)}
            seen.extend(
                [each.capture_time for each in me.beliefs(orders=orders).values()] for orders in ({}, given, {})
            )

    play(protocol, announce=Announcements(payload="state", trigger="never", start="known"))
    plain, ordered, again = seen
    assert len(plain) == 2
    assert ordered == pytest.approx([time - 0.3 for time in plain])
    assert again == plain


def test_nothing_moves_before_an_announcement_whose_sender_has_a_clock_that_is_ahead():
    """In wind, 0 says at 1 s, by its clock 2 s, where it is; at 1.25 s it is estimated there, and not carried back."""
    seen = []

    def protocol(me):
        if me.id == 0:
            yield me.sleep(1.0)
            me.announce()
        if me.id == 1:
            yield me.at(1.25)
            seen.extend(me.team_estimate().positions.tolist())

    play(
        protocol,
        announce=Announcements(payload="state", trigger="revision", start="silent"),
        environment=Environment(flow=SteadyFlow(velocity=(0.5, 0.0))),
        fault=(ClockSkew(offset=1.0, node=0),),
    )
    assert seen == pytest.approx([1.5, 2.625])


@pytest.mark.parametrize("reckoning", ["exact", "straight_line"])
@pytest.mark.parametrize("offset", [0.0, 0.05, 0.02])
def test_estimates_that_are_shared_are_those_of_each_pursuer(monkeypatch, reckoning, offset):
    """Some records are lost; a clock that is ahead by a period shows times that the others show at other instants."""

    def estimates():
        seen = []

        def protocol(me):
            if me.id == 1:
                me.assign(1)
            for k in range(1, 20):
                yield me.at(0.05 * k)
                estimate = me.team_estimate()
                seen.append((me.id, estimate.ids, estimate.positions.tolist(), estimate.capture_times.tolist()))

        play(
            protocol,
            team=Team(count=4, active_at_start=0.0),
            evader=Evader(speed=0.8),
            announce=Announcements(payload="state", heartbeat=0.1, reckoning=reckoning, start="known"),
            network=Links(latency=Constant(value=0.05), loss=Bernoulli(p=0.5)),
            fault=(ClockSkew(offset=offset, node=3),),
            horizon=1.0,
        )
        return seen

    shared = estimates()
    forget_motions(monkeypatch)
    assert estimates() == shared
    assert len({positions[1] for _, _, positions, _ in shared}) > 18


def test_an_estimate_of_the_instant_of_a_capture_is_of_the_evader_before_it_or_after_it():
    """Messages are relayed before captures, and decisions are made after them."""
    seen = []

    def protocol(me):
        if me.id == 0:
            me.assign(1)
        for phase in (Phase.RELAY, Phase.DECISION):
            yield me.at(0.9, phase)
            seen.append(me.team_estimate().capture_times.tolist())

    evaders = [Evader(position=(x, 0.0), speed=0.0) for x in (0.0, -50.0)]
    announce = Announcements(payload="state", start="known")
    result = play(protocol, announce=announce, evader=evaders)
    assert result.trace.of(Captured)[0].t == 900_000_000
    assert len(seen) == 6
    assert all(max(times) < inf for times in seen[:3])
    assert seen[3:] == [[inf] * 3] * 3


@pytest.mark.parametrize("memory", [True, False])
def test_a_claim_made_before_a_restart_is_not_repeated(memory):
    """A heartbeat every 0.1 s carries the claim until 0.3 s, and from 0.5 s on that or, without memory, the payload."""

    def protocol(me):
        if me.id == 0 and not me.restarts:
            me.set_payload(Claim(False, 7))
        yield me.at(9.0)

    fault = Crash(node=0, start=0.3, end=0.5, memory=memory)
    record = Recording(trajectory=0.0, messages=True)
    result = play(
        protocol, announce=Announcements(heartbeat=0.1, start="known"), fault=(fault,), record=record, horizon=1.0
    )
    said = [(event.t > 0.4e9, event.body) for event in result.trace.of(Broadcast) if event.src == 0]
    assert set(said) == {(False, Claim(False, 7)), (True, Claim(False, 7) if memory else Assignment(False))}


@pytest.mark.slow
@pytest.mark.parametrize("payload", ["action", "state", "time"])
@pytest.mark.parametrize("dissemination", [OneHop(), Flooding(hops=2), Gossip()])
@pytest.mark.parametrize("scope", ["radio", "robot"])
@pytest.mark.parametrize("start", STARTS)
def test_the_believed_chasers_follow_from_the_latest_records(payload, dissemination, scope, start):
    """The incremental beliefs, against all received records; pursuer 1 forgets everything at 2 s."""
    checked, chased = [], set()

    def protocol(me):
        rng = me.stream("test")
        while True:
            yield me.sleep(rng.exponential(0.05))
            for evader in (1, 2):
                records = me.trusted()
                expected = sorted(j for j in records if records[j].body.active == evader)
                assert me.believed_active(evader) == list(me.believed_chasers(evader)) == expected
                chased.add((evader, tuple(expected)))
            checked.append(me.id)
            me.assign(int(rng.integers(3)))
            me.announce()

    team = Team(count=4, positions=[(k, 0.0) for k in range(4)], speeds=0.95, active_at_start=0.5)
    run(
        Scenario(
            horizon=4.0,
            team=team,
            evader=(Evader(position=(90.0, 0.0)), Evader(position=(0.0, 90.0))),
            protocol=protocol,
            network=Links(graph=Ring(), latency=Lognormal(mean=0.03, cv=1.0), loss=Bernoulli(p=0.3)),
            announce=Announcements(payload=payload, dissemination=dissemination, belief_timeout=0.2, start=start),
            fault=(Crash(node=1, start=1.0, end=2.0, memory=False, scope=scope),),
        )
    )
    assert len(checked) > 200
    assert len(chased) > 10


def test_periodic_actions_start_at_a_phase_of_the_named_stream():
    def protocol(me):
        yield me.at(0.5)
        yield from repeat(me, lambda: seen.append((me.id, me.now)), 0.3, "chores")

    seen = []
    play(protocol, horizon=2.0)
    phases = [stream(0, "chores", pursuer).uniform(0.0, 0.3) for pursuer in range(3)]
    for pursuer, phase in enumerate(phases):
        times = [time for who, time in seen if who == pursuer]
        assert times == pytest.approx([0.5 + phase + 0.3 * k for k in range(len(times))], abs=1e-9)
        assert len(times) == 5


def test_with_jitter_each_wait_differs_from_the_period_by_a_share():
    def protocol(me):
        yield from repeat(me, lambda: seen.append((me.id, me.now)), 0.3, "chores", 0.5)

    seen = []
    play(protocol, horizon=5.0)
    for pursuer in range(3):
        rng = stream(0, "chores", pursuer)
        due = [rng.uniform(0.0, 0.3)]
        times = [time for who, time in seen if who == pursuer]
        while len(due) < len(times):
            due.append(due[-1] + 0.3 * rng.uniform(0.5, 1.5))
        assert times == pytest.approx(due, abs=1e-8)
        assert len(times) > 10


@pytest.mark.parametrize("evader", [0, 2, -1])
def test_an_evader_that_does_not_exist_is_refused(evader):
    """0 is the action of a pursuer that stays, no evader; there is one evader."""

    def protocol(me):
        for read in (me.capture_time, me.evader, me.may_chase, lambda each: me.gain(evader=each)):
            with pytest.raises(ValueError, match=rf"there is no evader {evader}: they are 1 \.\. 1"):
                read(evader)
            asked.append(me.id)
        yield from ()

    asked = []
    run(Scenario(horizon=0.1, team=Team(count=2), protocol=protocol))
    assert len(asked) == 8


TIMEOUTS = (0.5, 3, None, nan)
"""What may be given in the place of a port, a phase or a name: a time-out, or nothing."""
NO_NUMBERS = ("1", None, [1], {}, 1.0)


def generating():
    yield


async def waiting():
    pass


WRONG_ARGUMENTS = {
    "a port should be a text": [
        (call, value)
        for value in (*TIMEOUTS, ["a"], b"a")
        for call in (lambda me, port: me.send(1, "x", port), Agent.mail, Agent.arrival)
    ],
    "transport should be": [
        (lambda me, transport: me.send(1, "x", transport=transport), value)
        for value in ("reliable", Reliable, {"kind": "reliable"}, 0.5, Links())
    ],
    "a phase should be one of": [
        (call, value)
        for value in (*TIMEOUTS, "decision")
        for call in (lambda me, phase: me.arrival("", phase), lambda me, phase: me.sleep(0.1, phase))
    ],
    "an evader should be an integer": [
        (call, value)
        for value in NO_NUMBERS
        for call in (Agent.capture_time, Agent.evader, Agent.may_chase, Agent.believed_chasers, Agent.team_estimate)
    ],
    "neighbours: a pursuer should be an integer": [(Agent.neighbours, value) for value in ("1", [1], {}, 1.0)],
    "there is no pursuer": [(Agent.neighbours, value) for value in (-1, 99)],
    "the time ahead should be": [(Agent.time_left, value) for value in ("1", None, [1], {}, nan, inf, 1e300)],
    "the period": [(Agent.beliefs, value) for value in ("1", [1], {}, nan, 0.0, -1.0)],
    "at: the time should be": [(Agent.at, value) for value in ("1", None, [1], {})],
    "sleep: the duration should be": [(Agent.sleep, value) for value in ("1", None, [1], {})],
    "the name of a random stream should be a text": [
        (call, value) for value in (*TIMEOUTS, ["a"], object()) for call in (Agent.stream, Agent.shared_stream)
    ],
    "there is no pursuer -1": [(lambda me, j: me.global_state.action(j), -1)],
    "a pursuer should be an integer": [
        (call, value)
        for value in ("1", None, [1], 1.0)
        for call in (lambda me, j: me.global_state.action(j), lambda me, j: me.global_state.set_action(j, 1))
    ],
    "a scope should be 'heard'": [
        (Agent.counted_teammates, value) for value in ("neighbors", "all", None, 1, ["heard"])
    ],
    r"gain\(utility\) takes a utility": [(Agent.gain, value) for value in ("mean", None, 1, {})],
    "argmax takes the utility of each action": [
        (lambda me, values: argmax(values), value) for value in ([0.1], 1, None)
    ],
    "merge_records takes": [(Agent.merge_records, value) for value in (None, 1, ["x"], "x")],
    "after: act should be a function": [(lambda me, act: me.after(0.1, act), value) for value in (None, 0.5, "x")],
    "after: act should accept a call without arguments": [
        (lambda me, act: me.after(0.1, act), value) for value in (lambda x: x, partial(pow, 2))
    ],
    "after: act should do its work when it is called": [(lambda me, act: me.after(0.1, act), generating)],
    "after: act should have `def` in place of `async def`": [(lambda me, act: me.after(0.1, act), waiting)],
    "after: the duration should be a number": [
        (lambda me, duration: me.after(duration, print), value) for value in ("1", None, [1])
    ],
    r"after\(.*\): the duration should be finite": [
        (lambda me, duration: me.after(duration, print), value) for value in (-1.0, nan, inf)
    ],
}
"""By the beginning of a sentence: calls of an agent, each with an argument that it refuses with this sentence."""


@pytest.mark.parametrize("sentence", WRONG_ARGUMENTS)
def test_what_an_agent_cannot_take_is_refused_in_a_sentence(sentence):
    def protocol(me):
        if me.id == 0:
            for call, value in WRONG_ARGUMENTS[sentence]:
                with pytest.raises((ValueError, TypeError), match=sentence):
                    call(me, value)
                refused.append(value)
        yield from ()

    refused = []
    run(Scenario(horizon=0.1, team=Team(count=2), protocol=protocol))
    assert len(refused) == len(WRONG_ARGUMENTS[sentence]) > 0


@pytest.mark.parametrize("body", [{"active": 1}, "x", 0.5, Links])
def test_a_payload_without_news_is_refused_where_news_are_announced(body):
    def protocol(me):
        me.set_payload(body)
        me.announce()
        yield from ()

    with pytest.raises(ValueError, match="pursuer 0: the payload should have an attribute news"):
        run(Scenario(horizon=0.1, team=Team(count=2), protocol=protocol))


def test_numbers_of_numpy_and_texts_of_any_class_are_taken_by_an_agent():
    def protocol(me):
        if me.id == 0:
            me.send(1, "x", np.str_("port"))
            taken.extend((me.mail(np.str_("port")), me.neighbours(np.int64(1)), me.time_left(np.float32(0.0))))
            assert me.capture_time(np.int8(1)) == me.capture_time(True) == me.capture_time()
            assert me.stream(np.str_("a")) is me.stream("a")
        yield from ()

    taken = []
    run(Scenario(horizon=0.1, team=Team(count=2), protocol=protocol))
    assert taken == [[], [0], 0.1]


def test_an_action_is_not_set_as_an_attribute():
    def protocol(me):
        me.action = 1
        yield from ()

    with pytest.raises(AttributeError, match=r"set by a call: me\.assign\(1\)"):
        run(Scenario(horizon=0.1, team=Team(count=2), protocol=protocol))


@pytest.mark.parametrize("goes_on", [False, True])
def test_a_protocol_that_changes_the_id_of_its_agent_is_refused(goes_on):
    """It would act and speak as another pursuer."""

    def protocol(me):
        me.id = 1 - me.id
        me.assign(1)
        if goes_on:
            yield me.sleep(0.05)
            raise AssertionError

    with pytest.raises(AttributeError, match=r"^pursuer 0: the protocol has set me.id to 1; the id of an agent stays"):
        run(Scenario(horizon=0.1, team=Team(count=2), protocol=protocol))


def spoilt(answer):
    """Return whether an answer could be changed in place, after it was."""
    if isinstance(answer, np.ndarray):
        if answer.flags.writeable:
            answer[...] = 7
        return answer.flags.writeable
    match answer:
        case list():
            answer.append(99)
        case set():
            answer.add(99)
        case dict():
            answer[99] = None
        case tuple():
            return sum(map(spoilt, answer)) > 0  # all parts
        case _:
            return False
    return True


QUESTIONS = (
    *("evaders", "options", "neighbours", "latest_records", "trusted", "believed_chasers", "believed_active"),
    *("beliefs", "sensed_positions", "team_estimate", "errors", "mail"),
)


@pytest.mark.parametrize(
    ("payload", "graph"),
    [
        ("action", nx.DiGraph([(0, 1), (1, 2), (2, 3), (3, 0)])),
        ("action", nx.path_graph(4)),
        ("state", nx.path_graph(4)),
    ],
    ids=["one-way links", "action", "state"],
)
def test_what_a_protocol_does_to_an_answer_changes_no_later_one(payload, graph):
    asked = []

    def protocol(me):
        questions = [getattr(me, name) for name in QUESTIONS]
        questions += [partial(me.counted_teammates, scope) for scope in ("heard", "neighbours", "component")]
        questions += [partial(me.neighbours, 1), me.global_state.profile, me.global_state.broken]
        for _ in range(3):
            yield me.sleep(0.2)
            me.broadcast()
            for ask in questions:
                answer = ask()
                before = repr(answer)
                asked.append(spoilt(answer))
                assert repr(ask()) == before

    run(
        Scenario(
            horizon=1.0,
            team=Team(count=4),
            network=Links(graph=Edges.of(graph)),
            announce=Announcements(payload=payload),
            protocol=protocol,
        )
    )
    assert sum(asked) > 60


class Path:
    """An announcement that its sender changes in place."""

    def __init__(self):
        self.active, self.news, self.stops = 0, [0], [1]


@pytest.mark.parametrize("dissemination", [OneHop(), Flooding()])
def test_an_announcement_is_what_it_was_when_it_was_sent(dissemination):
    """Over a path 0 - 1 - 2: 0 changes it on the way, and 1, which relays it, changes what it has received."""
    seen = {1: [], 2: []}

    def protocol(me):
        if me.id == 0:
            payload = Path()
            me.set_payload(payload)
            me.broadcast()
            yield me.sleep(0.1)
            payload.stops.append(99)
        while me.id:
            yield me.sleep(0.2)
            for record in me.latest_records().values():
                if isinstance(record.body, Path):
                    seen[me.id].append(list(record.body.stops))
                    record.body.stops.append(me.id)
        yield me.sleep(99.0)

    result = play(
        protocol,
        latency=0.5,
        announce=Announcements(trigger="change", start="known", dissemination=dissemination),
        network=Links(latency=0.5, graph=Edges.of(nx.path_graph(3))),
        record=Recording(messages=True),
        horizon=5.0,
    )
    assert seen[1]
    assert all(stops == [1] for stops in seen[1] + seen[2])
    assert bool(seen[2]) == (not isinstance(dissemination, OneHop))
    sent = [event for event in result.trace if isinstance(event, Broadcast | Sent)]
    records = [record for event in sent for record in relayed_records(event.body) or own_records(event)]
    stops = [record.body.stops for record in records if isinstance(record.body, Path)]
    assert stops == [[1]] * len(stops)
    assert len(stops) >= 1 + len(seen[2][:1])


def test_news_that_change_in_place_are_announced():
    def protocol(me):
        if me.id == 0:
            payload = Path()
            me.set_payload(payload)
            for k in range(3):
                yield me.sleep(0.1)
                me.announce()
                me.announce()
                payload.news.append(k)
        yield me.sleep(99.0)

    result = play(
        protocol, announce=Announcements(trigger="change", start="known"), record=Recording(messages=True), horizon=1.0
    )
    assert [event.body.news for event in result.trace if isinstance(event, Broadcast)] == [[0], [0, 0], [0, 0, 1]]


NEWS = {
    "array": lambda k: np.array([k, 1.0]),
    "array of one": lambda k: np.array([k]),
    "array without items": lambda k: np.zeros(k),
    "array of nan": lambda k: np.array([k, np.nan]),
    "series": lambda k: pd.Series([k, 2]),
    "table": lambda k: pd.DataFrame({"a": [k, 2]}),
    "array in a tuple": lambda k: (k, np.zeros(2) + k),
    "array in a dict": lambda k: {"a": np.zeros(2) + k},
    "number of numpy": np.float64,
    "list": lambda k: [k],
    "number": int,
}


@pytest.mark.parametrize("name", NEWS)
def test_news_of_any_type_are_announced_when_they_change(name):
    def protocol(me):
        for k in (0, 0, 1, 1, 0, 0):
            me.set_payload(Noted(0, NEWS[name](k)))
            me.announce()
            yield me.sleep(0.1)

    scenario = Scenario(
        team=Team(count=2),
        protocol=protocol,
        announce=Announcements(trigger="change", start="known"),
        record={"messages": True},
    )
    sent = [event for event in run(scenario, 1).trace.of(Broadcast) if event.src == 0]
    assert [event.t for event in sent] == [0, 200_000_000, 400_000_000]


@dataclass
class Noted:
    active: int
    news: Any


@pytest.mark.parametrize(
    ("send", "more"),
    [
        (Agent.send, []),
        (Voice.send, ["src"]),
        (LyingTeam.send, ["src"]),
        (SteppedNetwork.send, ["src"]),
        (Network.send, ["src", "only"]),
    ],
)
def test_all_send_with_the_same_arguments(send, more):
    def forms(function):
        arguments = signature(function).parameters.values()
        return [(argument.name, argument.kind, argument.default) for argument in arguments if argument.name not in more]

    assert forms(send) == forms(Agent.send)
