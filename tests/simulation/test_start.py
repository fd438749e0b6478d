"""The start: how pursuers learn the initial actions (`announce.start`), over every network and under every protocol."""

from math import sqrt

import numpy as np
import pytest

from desim import Scenario, run
from desim.kernel.core.events import Broadcast, MessageCounts
from desim.kernel.core.units import SECOND
from desim.kernel.models.access import Aloha
from desim.kernel.models.faults import Crash
from desim.kernel.models.graphs import Ring
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.medium import Bitrate
from desim.pursuit.byzantine.lies import Equivocate, Liar, Silent, Spoof
from desim.pursuit.core.events import Captured, Decided, Ended, Sampled, Started
from desim.pursuit.team.announcements import PAYLOADS, STARTS, Announcements, Assignment
from desim.scenario.players import Team
from desim.scenario.scenario import PROTOCOLS, Motion
from protocols.dissemination import CodedOneHop, Flooding, Gossip, OneHop, ReliableOneHop
from protocols.rule import SCHEDULES

WORLD = (Started, Decided, Captured, Sampled, Ended)
"""The events of the world: what happens, whoever knows of it."""


def knowing(seen, at=0.0):
    """Return a protocol that does nothing but record, by pursuer, the actions that it knows at a time, s."""

    def protocol(me):
        yield me.at(at)
        seen[me.id] = {j: record.body.active for j, record in me.latest_records().items()}

    return protocol


def knowledge(at=0.0, seed=0, **changes):
    """Return what each of six pursuers, half of them active at first, knows at a time, s, and the result."""
    seen = {}
    given = {
        "horizon": 1.0,
        "team": Team(count=6, active_at_start=0.5),
        "motion": Motion(static=True),
        "protocol": knowing(seen, at),
        "announce": Announcements(trigger="never"),
        "record": {"trajectory": 0.0, "messages": True},
    }
    return seen, run(Scenario(**(given | changes)), seed)


def others_in(result):
    """Return the initial actions of the teammates of each pursuer."""
    actions = dict(enumerate(result.trace.of(Started)[0].active))
    return {i: {j: action for j, action in actions.items() if j != i} for i in actions}


# An ideal network.


def world_of(start, **changes):
    given = {"horizon": 0.6, "team": Team(count=5, active_at_start=0.5)}
    announce = Announcements(start=start, **changes.pop("announce", {}))
    trace = run(Scenario(announce=announce, **(given | changes)), 3).trace
    return [event for event in trace if isinstance(event, WORLD)]


@pytest.mark.slow_but_one
@pytest.mark.parametrize("payload", PAYLOADS)
@pytest.mark.parametrize("kind", PROTOCOLS.choices())
def test_on_an_ideal_network_decisions_are_those_of_pursuers_that_know(kind, payload):
    """Event by event, under every protocol and payload."""
    changes = {"protocol": {"kind": kind}, "announce": {"payload": payload}}
    assert world_of("announced", **changes) == world_of("known", **changes)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("trigger", ["change", "heartbeat", "both", "revision", "never"])
@pytest.mark.parametrize("schedule", SCHEDULES.choices())
def test_so_they_are_under_every_schedule_and_trigger(schedule, trigger):
    """The control: after a silent start they are not, in at least one of two games."""
    changes = {"protocol": {"kind": "best_response", "schedule": {"kind": schedule}}, "announce": {"trigger": trigger}}
    assert world_of("announced", **changes) == world_of("known", **changes)
    if schedule == "rounds" and trigger == "never":
        assert world_of("silent", **changes) != world_of("known", **changes)


@pytest.mark.parametrize("jitter", [0.0, 0.9])
@pytest.mark.parametrize(
    "dissemination", [OneHop(), Gossip(), Flooding(jitter=0.0), ReliableOneHop(), CodedOneHop()], ids=lambda d: d.kind
)
def test_all_know_all_first_actions_before_the_first_decision(dissemination, jitter):
    """At time 0, on a complete graph: a protocol may decide then."""
    seen, result = knowledge(announce=Announcements(trigger="never", dissemination=dissemination, jitter=jitter))
    assert seen == others_in(result)


def test_without_latency_a_flood_reaches_all_before_the_first_decision_over_any_number_of_hops():
    """On a ring of six, three hops. The controls: a single hop reaches the two neighbours; two, four."""
    for hops, reached in ((1, 2), (2, 4), (3, 5)):
        flood = Announcements(trigger="never", dissemination=Flooding(hops=hops, jitter=0.0))
        seen, result = knowledge(announce=flood, network=Links(graph=Ring()))
        truth = others_in(result)
        assert {len(known) for known in seen.values()} == {reached}
        assert all(truth[i][j] == action for i, known in seen.items() for j, action in known.items())


# Each way to start, over a network.


@pytest.mark.parametrize("start", STARTS)
def test_first_actions_arrive_after_one_latency_if_they_are_announced(start):
    """L = 0.25 s: nothing is known just before, all from then on. Known: all at 0. Silent, with "never": nothing."""
    late = Links(latency=Constant(value=0.25))
    for at in (0.0, 0.249999999, 0.25):
        seen, result = knowledge(at, announce=Announcements(trigger="never", start=start), network=late)
        is_there = start == "known" or (start == "announced" and at >= 0.25)
        assert seen == (others_in(result) if is_there else {i: {} for i in range(6)})
        told = result.trace.of(Broadcast)
        assert [event.t for event in told] == [0] * 6 * (start == "announced")
        assert all(event.body == Assignment(result.trace.of(Started)[0].active[event.src]) for event in told)


@pytest.mark.slow
def test_first_announcements_are_lost_as_any_message():
    """p = 0.3, 30 pairs in each of 40 runs: the share of the pairs that know is 0.7, s.e. 0.013. The control: all."""
    counts = {
        start: sum(
            len(known)
            for seed in range(40)
            for known in knowledge(
                0.1, seed, announce=Announcements(trigger="never", start=start), network=Links(loss=Bernoulli(p=0.3))
            )[0].values()
        )
        for start in ("announced", "known")
    }
    z = (counts["announced"] - 1200 * 0.7) / sqrt(1200 * 0.7 * 0.3)
    assert abs(z) < 4.0
    assert counts["known"] == 1200


def test_who_is_out_of_range_does_not_hear_of_it():
    places = [(0.0, 0.0), (1.0, 0.0), (9.0, 0.0)]
    for start, heard in (("announced", {0: {1}, 1: {0}, 2: set()}), ("known", {0: {1, 2}, 1: {0, 2}, 2: {0, 1}})):
        seen, _ = knowledge(
            team=Team(positions=places),
            network=Links(range=2.0),
            announce=Announcements(trigger="never", start=start),
        )
        assert {i: set(known) for i, known in seen.items()} == heard


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("kind", ["server", "centralised", "voronoi"])
def test_a_protocol_without_announcements_announces_nothing_at_the_start_either(kind, start):
    scenario = Scenario(
        horizon=0.5,
        protocol={"kind": kind},
        announce=Announcements(start=start),
        record={"messages": True},
    )
    assert not run(scenario).trace.of(Broadcast)


# Faults and lies.


@pytest.mark.parametrize("scope", ["radio", "robot"])
def test_a_pursuer_that_is_down_at_the_start_is_not_heard_and_hears_nothing(scope):
    seen, _ = knowledge(0.1, fault=(Crash(node=2, start=0.0, end=0.05, scope=scope),))
    assert seen[2] == {}
    assert all(set(known) == {0, 1, 3, 4, 5} - {i} for i, known in seen.items() if i != 2)


def test_after_its_repair_it_announces_its_action_at_its_next_decision_though_it_has_not_changed():
    """The crash of a radio from 0 to 0.5 s; decisions at 0.3, 0.6 and 0.9 s, all to chase as before."""

    def chases(me):
        for time in (0.3, 0.6, 0.9):
            yield me.at(time)
            me.assign(1)
            me.announce()

    announce = Announcements(trigger="change")
    fault = (Crash(node=2, start=0.0, end=0.5, scope="radio"),)
    team = Team(count=6, active_at_start=1.0)
    _, result = knowledge(protocol=chases, announce=announce, fault=fault, team=team)
    told = [(event.t / SECOND, event.src) for event in result.trace.of(Broadcast)]
    assert [time for time, src in told if src == 2] == [0.6]
    assert [time for time, src in told if src == 0] == [0.0]


def test_liars_lie_at_the_start():
    """0 says the contrary, 1 nothing; 3 speaks after 2, in its name; 4 tells two things; 5 is honest."""
    faults = (
        Liar(node=0, start=0.0, action="opposite"),
        Silent(node=1, start=0.0),
        Spoof(node=3, start=0.0, victim=2, action="chase"),
        Equivocate(node=4, start=0.0),
    )
    seen, result = knowledge(0.1, fault=faults)
    truth = result.trace.of(Started)[0].active
    of = {j: {known[j] for i, known in seen.items() if i != j and j in known} for j in range(6)}
    assert of[0] == {int(not truth[0])}
    assert (of[1], of[3]) == (set(), set())
    assert {seen[i][2] for i in (0, 1, 4, 5)} == {int(not truth[2])}
    assert seen[3][2] == truth[2]
    assert of[4] == {0, 1}
    assert of[5] == {truth[5]}
    known_start, _ = knowledge(0.1, fault=faults, announce=Announcements(trigger="never", start="known"))
    assert known_start == others_in(result)


# Channels for which nodes contend.


def starts(jitter, start="announced", **medium):
    """Return when each of six pursuers announces first, s, and the counts of messages, over ten seeds."""
    times, counts = [], []
    for seed in range(10):
        _, result = knowledge(
            announce=Announcements(trigger="never", heartbeat=0.1, jitter=jitter, start=start),
            network=Links(medium=Bitrate(bitrate=1e6, **medium)),
            seed=seed,
        )
        times += [event.created / SECOND for event in result.trace.of(Broadcast)]
        counts += result.trace.of(MessageCounts)
    return np.array(times), counts


@pytest.mark.slow
def test_on_a_contended_channel_jitter_separates_the_first_announcements():
    """Uniform up to 0.05 s: mean 0.025, s.e. 0.05 / sqrt(12 x 60). Of two frames of 0.19 ms, one pair in 130 overlaps.

    The controls: without jitter all collide, and over a channel without contention nothing waits.
    """
    times, counts = starts(0.5, access=Aloha())
    assert len(times) == 60
    assert 0.0 < times.min() < times.max() < 0.05
    assert abs(times.mean() - 0.025) < 4.0 * 0.05 / sqrt(12 * 60)
    assert sum(count.delivered for count in counts) > 0.8 * 300
    times, counts = starts(0.0, access=Aloha())
    assert set(times) == {0.0}
    assert sum(count.delivered for count in counts) == 0
    times, counts = starts(0.5)
    assert set(times) == {0.0}
    assert sum(count.delivered for count in counts) == 300
    assert len(starts(0.5, "silent", access=Aloha())[0]) == 0
