"""Faults in a run: what becomes of a pursuer that breaks down, and of the pursuit; and of clocks that are wrong."""

from collections import Counter
from math import inf

import numpy as np
import pytest

from desim import Scenario, run, summary
from desim.analysis.metrics import activity
from desim.kernel.core.events import Broadcast, MessageCounts
from desim.kernel.core.seeds import stream
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.faults import Crash
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.pursuit.core.events import BrokeDown, Decided, Ended, Sampled
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion, Recording
from protocols.centralised import Centralised
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Periodic, Poisson, Rounds, SharedSeed
from protocols.temperature import ConstantTau


def play(protocol, *faults, **changes):
    """Run a protocol for three pursuers at 2, 3 and 5 m (speed 1) of an evader that stands still; h = 0.1 s."""
    given = {
        "horizon": 4.0,
        "team": Team(positions=[(2.0, 0.0), (3.0, 0.0), (5.0, 0.0)], speeds=1.0, active_at_start=0.0),
        "evader": Evader(position=(0.0, 0.0), speed=0.0),
        "motion": Motion(step=0.1),
        "protocol": protocol,
        "announce": Announcements(trigger="revision", start="known"),
        "record": Recording(trajectory=0.01, messages=True),
        "fault": faults,
    }
    return run(Scenario(**(given | changes)))


def chasing(me):
    """Chase from the beginning, and decide to go on with it at 0.1, 0.2, ... s."""
    for k in range(100):
        if k / 10 + 1e-6 >= me.now:
            yield me.at(k / 10 + 1e-6)
            me.assign(True)
            me.announce()


def decided(result, pursuer):
    """Return when a pursuer decided, s."""
    return [d.t / 1e9 for d in result.trace.of(Decided) if d.pursuer == pursuer]


def track(result, pursuer):
    """Return the times of the samples, s, and the distance of a pursuer on the line then, m."""
    samples = result.trace.of(Sampled)
    return np.array([s.t / 1e9 for s in samples]), np.array([s.pursuers[pursuer][0] for s in samples])


# Breakdowns.


@pytest.mark.parametrize("at", [0.75, 0.7, 0.7000001])
def test_a_robot_that_breaks_down_stands_still_and_decides_nothing_until_it_is_repaired(at):
    """Pursuer 1 chases at 1 m/s from 3 m on; broken down inside a step, or on its boundary, it stays at 3 - at.

    Repaired at 1.55 s it makes up at once for what was due meanwhile, and chases. The others chase all the while.
    """
    result = play(chasing, Crash(node=1, start=at, end=1.55), horizon=1.9)
    assert [(h.t / 1e9, h.pursuer) for h in result.trace.of(BrokeDown)] == [(at, 1)]
    assert [t for t in decided(result, 1) if t > at] == pytest.approx([1.55, 1.6, 1.7, 1.8], abs=1e-5)
    assert len([t for t in decided(result, 0) if 0.75 < t < 1.55]) == 8
    t, x = track(result, 1)
    assert x[t <= at] == pytest.approx(3.0 - t[t <= at], abs=1e-5)
    broken = (t >= at) & (t <= 1.55)
    assert x[broken] == pytest.approx(3.0 - at, abs=1e-5)
    assert np.ptp(x[broken & (t > at)]) == 0.0
    assert x[t > 1.55] == pytest.approx(3.0 - at - (t[t > 1.55] - 1.55), abs=1e-5)
    assert track(result, 2)[1][-1] == pytest.approx(5.0 - 1.9, abs=1e-5)


def test_a_pursuer_with_only_its_radio_broken_continues_without_being_received():
    result = play(chasing, Crash(node=1, start=0.75, end=1.55, scope="radio"), horizon=1.9)
    assert not result.trace.of(BrokeDown)
    assert len(decided(result, 1)) == len(decided(result, 0)) == 19
    t, x = track(result, 1)
    assert x == pytest.approx(3.0 - t, abs=1e-5)
    said = [b.t / 1e9 for b in result.trace.of(Broadcast) if b.src == 1]
    assert [round(t, 3) for t in said] == [k / 10 for k in range(19) if not 0.75 < k / 10 < 1.55]
    assert result.trace.of(MessageCounts)[0].lost_by["crash"] == 2 * 8


def east(state, rng):
    """The evader's strategy: along the line of the pursuers."""
    return 1.0 + 0.0j


@pytest.mark.parametrize("at", [1.0, 2.9 - 1e-6])
@pytest.mark.parametrize(("scope", "capturer"), [("robot", None), ("radio", 1)])
def test_a_broken_down_pursuer_captures_no_evader(scope, capturer, at):
    """The evader runs over pursuer 1, which stands at 3 m: with a broken radio only it captures at 2.9 s.

    It does not matter whether that was foreseen when it broke down; a motion step is 0.25 s.
    """
    changes = {
        "team": Team(positions=[(2.0, 5.0), (3.0, 0.0), (9.0, 0.0)], speeds=2.0, active_at_start=0.0),
        "evader": Evader(position=(0.0, 0.0), speed=1.0, strategy=east),
        "motion": Motion(step=0.25),
    }
    result = play(lambda me: iter(()), Crash(node=1, start=at, scope=scope), **changes)
    (end,) = result.trace.of(Ended)
    assert (end.reason, end.capturer) == (("captured", 1) if capturer else ("horizon", None))
    if capturer:
        assert end.t / 1e9 == pytest.approx(2.9)


@pytest.mark.parametrize(
    ("at", "places", "chasers", "step", "end"),
    [
        (1.9 - 1e-6, (2.0, 3.0, 5.0), 1, 0.1, (None, 4.0)),
        (1.9 + 1e-6, (2.0, 3.0, 5.0), 1, 0.1, (0, 1.9)),
        (1.895, (2.0, 2.05, 5.0), 2, 0.25, (1, 1.95)),
    ],
)
def test_a_breakdown_just_before_a_capture_prevents_it_only_for_that_pursuer(at, places, chasers, step, end):
    """A capture at 1.9 s is foreseen as pursuer 0 breaks down, 1 us before it; the control: 1 us later is too late.

    If that is within the step in which 1, which is 0.05 m behind, captures, it does so at 1.95 s.
    """

    def protocol(me):
        yield me.at(0.0)
        me.assign(me.id < chasers)

    team = Team(positions=[(x, 0.0) for x in places], speeds=1.0, active_at_start=0.0)
    (ended,) = play(protocol, Crash(node=0, start=at), team=team, motion=Motion(step=step)).trace.of(Ended)
    assert (ended.capturer, ended.t / 1e9) == (end[0], pytest.approx(end[1], abs=1e-6))


@pytest.mark.parametrize("memory", [True, False])
def test_a_robot_recovers_with_its_memory_or_restarts_with_an_empty_table(memory):
    """Pursuer 0 announces at 0.5 s that it chases, and nothing afterwards; 1 is broken down from 1 until 2 s."""
    log = []

    def protocol(me):
        begun = me.now
        if me.id == 0:
            yield me.at(0.5)
            me.assign(True)
            me.broadcast()
        if me.id == 1:
            for k in range(1, 4):
                yield me.sleep(0.75)
                log.append((me.now, begun, k, sorted(me.latest_records()), me.believed_active()))

    announce = Announcements(trigger="never")
    play(protocol, Crash(node=1, start=1.0, end=2.0, memory=memory), announce=announce, motion=Motion(static=True))
    known = (sorted({0, 2}), [0])
    if memory:  # what it slept for at 1.5 s is over when it is repaired
        assert log == [(0.75, 0.0, 1, *known), (2.0, 0.0, 2, *known), (2.75, 0.0, 3, *known)]
    else:
        assert log == [(0.75, 0.0, 1, *known), (2.75, 2.0, 1, [], []), (3.5, 2.0, 2, [], [])]


@pytest.mark.parametrize(
    ("crash", "times", "heard"),
    [
        ({"end": 1.2, "memory": True}, [0.75, 1.5, 2.25], [[0, 2]] * 3),
        ({"end": 1.2, "memory": False}, [0.75, 1.95, 2.7], [[0, 2], [], []]),
        ({"end": 2.0, "memory": True, "scope": "radio"}, [0.75, 1.5, 2.25], [[0, 2]] * 3),
        ({"end": 2.0, "memory": False, "scope": "radio"}, [0.75, 1.5, 2.25], [[0, 2], [0, 2], []]),
    ],
)
def test_a_short_breakdown_ends_a_wait_only_if_memory_is_lost(crash, times, heard):
    """Broken down from 1 s on while it sleeps until 1.5 s; without memory a robot begins to sleep for 0.75 s anew."""
    log = []

    def protocol(me):
        while me.id == 1:
            yield me.sleep(0.75)
            log.append((me.now, sorted(me.latest_records())))

    play(protocol, Crash(node=1, start=1.0, **crash), horizon=2.8, announce=Announcements(trigger="never"))
    assert [t for t, _ in log] == pytest.approx(times, abs=1e-9)
    assert [known for _, known in log] == heard


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    "schedule", [SharedSeed(slot=0.05), Poisson(), Rounds(period=0.2), Periodic()], ids=lambda schedule: schedule.kind
)
@pytest.mark.parametrize("memory", [True, False])
def test_every_schedule_survives_a_breakdown(schedule, memory):
    """Nothing is decided from 1 s to 2 s; from 2 s to 12 s as often as by the others, within 5 standard errors."""
    protocol = SpatialAdaptivePlay(schedule=schedule)
    crash = Crash(node=1, start=1.0, end=2.0, memory=memory)
    result = play(protocol, crash, horizon=12.0, motion=Motion(static=True))
    made = decided(result, 1)
    assert not [t for t in made if 1.0 <= t < 2.0]
    after, others = (len([t for t in decided(result, j) if t >= 2.0]) for j in (1, 0))
    assert after == pytest.approx(others, abs=5 * np.sqrt(2 * others))
    assert [t for t in made if 2.0 <= t < 3.0]


# The breakdown of the pursuer that chases.

PAYLOADS = ["action", "time", "state"]


def relay_breaks_down(announce, seed=0, *faults):
    """Return a pursuit whose relay pursuer 0 (2.6 s from the capture) breaks down for ever after 1 s."""
    return run(
        Scenario(
            horizon=40.0,
            team=Team(positions=[(3.0, 0.0), (-8.0, 1.0), (0.0, 9.0)], speeds=[2.0, 1.5, 1.5]),
            evader=Evader(position=(0.0, 0.0), speed=0.9),
            motion=Motion(step=0.05),
            protocol=SpatialAdaptivePlay(tau=ConstantTau(value=1e-9), schedule=Poisson(rate=10.0)),
            announce=announce,
            network=Links(latency=Constant(value=0.02)),
            fault=faults,
            record=Recording(trajectory=0.0),
        ),
        seed,
    )


CRASH = Crash(node=0, start=1.0)


def first_chase_after(result, time):
    """Return the first pursuer to begin a chase after a time (s), and when, s; None if there is none."""
    later = [(d.pursuer, d.t / 1e9) for d in result.trace.of(Decided) if d.t > time * 1e9 and d.active]
    return later[0] if later else None


@pytest.mark.slow
@pytest.mark.parametrize("payload", PAYLOADS)
def test_when_the_active_pursuer_breaks_down_another_takes_over_after_the_belief_timeout(payload):
    """Its last heartbeat came up to 1.02 s; it is forgotten 3 T + 2 L = 0.34 s later; another revises within 1 s."""
    announce = Announcements(payload=payload)
    for seed in range(5):
        healthy = summary(relay_breaks_down(announce, seed))
        assert (healthy.capturer, healthy.captured) == (0, True)
        result = relay_breaks_down(announce, seed, CRASH)
        who, when = first_chase_after(result, 1.0)
        assert who in {1, 2}
        assert 1.2 < when < 2.4
        assert summary(result).capturer in {1, 2}


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("payload", PAYLOADS)
@pytest.mark.parametrize(
    "announce", [{"belief_timeout": inf}, {"trigger": "change"}], ids=["never forget", "on change"]
)
def test_without_a_belief_timeout_a_broken_down_pursuer_is_waited_for_forever(payload, announce):
    """The mission ends at the horizon, with no pursuer active since 1 s. The control: 2 s of memory are enough."""
    for seed in range(3):
        result = relay_breaks_down(Announcements(payload=payload, **announce), seed, CRASH)
        assert first_chase_after(result, 1.0) is None
        numbers = summary(result)
        assert not numbers.captured
        assert numbers.idle_time == pytest.approx(39.0, abs=1e-6)
    remembering = Announcements(payload=payload, **(announce | {"belief_timeout": 2.0}))
    assert summary(relay_breaks_down(remembering, 0, CRASH)).captured


def test_a_relay_pursuer_with_a_broken_radio_is_doubled_and_captures_all_the_same():
    """Forgotten, it is joined by another; unforgotten it is not."""
    crash = Crash(node=0, start=1.0, scope="radio")
    for announce, crowd in ((Announcements(), 2), (Announcements(belief_timeout=inf), 1)):
        result = relay_breaks_down(announce, 1, crash)
        assert summary(result).capturer == 0
        assert activity(result)[1][-1] == crowd


# Clocks.


def test_a_wrong_clock_shows_its_own_time_and_wakes_by_it():
    """c(t) = offset + (1 + drift) t: what is to happen at c happens at (c - offset) / (1 + drift), or now."""
    log = []

    def protocol(me):
        if me.id == 1:
            log.append(me.now)
            yield me.at(1.0)
            log.append(me.now)
            yield me.at(2.0)
            me.assign(False)
            yield me.sleep(1.2)
            me.assign(False)

    result = play(protocol, ClockSkew(node=1, offset=1.5, drift=0.25))
    assert log == [1.5, 1.5]
    assert decided(result, 1) == pytest.approx([0.4, 0.4 + 0.96], abs=1e-9)


@pytest.mark.slow
def test_clock_errors_of_one_node_add_up_and_those_of_all_are_drawn():
    def shown(*skews, **changes):
        """Return the time that the clock of each pursuer shows at the start."""
        times = {}

        def protocol(me):
            yield me.sleep(0.0)
            times[me.id] = me.now

        play(protocol, *skews, **changes)
        return times

    assert shown(ClockSkew(node=1, offset=0.5), ClockSkew(node=1, offset=0.25)) == {0: 0.0, 1: 0.75, 2: 0.0}
    team = {"team": Team(count=200, active_at_start=0.0), "horizon": 0.1, "record": Recording(trajectory=0.0)}
    drawn = np.array([*shown(ClockSkew(offset=2.0), **team).values()])
    assert abs(drawn.mean()) < 4 * 2.0 / np.sqrt(200)
    assert abs(drawn.std() - 2.0) < 4 * 2.0 / np.sqrt(400)
    skews = ClockSkew(offset=2.0), ClockSkew(offset=1.5)  # of chances of their own
    assert abs(np.std([*shown(*skews, **team).values()]) - 2.5) < 4 * 2.5 / np.sqrt(400)


def slots(*faults, count=4, slot=0.1, horizon=20.05):
    """Return the decisions under a shared seed as (true time in slots, pursuer)."""
    protocol = SpatialAdaptivePlay(schedule=SharedSeed(slot=slot))
    team, record = Team(count=count), Recording(trajectory=0.0)
    result = play(protocol, *faults, team=team, record=record, horizon=horizon, motion=Motion(static=True))
    return [(d.t / 1e9 / slot, d.pursuer) for d in result.trace.of(Decided)]


def test_a_shared_seed_collides_under_skew():
    """Pursuer 0's clock is 0.6 slots slow, so it decides in the slot after its own, as does the owner of that.

    200 slots: true slots in which two decide are those of another after one of 0; with right clocks there are none.
    """
    right, skewed = slots(), slots(ClockSkew(node=0, offset=-0.06))
    assert [round(t, 6) for t, _ in right] == [*range(1, 201)]
    owner = {round(t): pursuer for t, pursuer in right}
    expected = {(round(k + 0.6, 6) if pursuer == 0 else float(k), pursuer) for k, pursuer in owner.items()}
    assert {(round(t, 6), pursuer) for t, pursuer in skewed} == {each for each in expected if each[0] < 200.5}
    crowds = Counter(int(np.ceil(t - 1e-6)) for t, _ in skewed)
    doubled = {k for k, decisions in crowds.items() if decisions == 2 and k <= 200}
    assert doubled == {k for k in range(2, 201) if owner[k - 1] == 0 and owner[k] != 0}
    assert len(doubled) > 20


def test_a_shared_seed_drifts_apart():
    """A clock that gains 1 % has its k-th slot at k / 1.01: after 100 slots it decides a whole slot too early."""
    owner = {round(t): pursuer for t, pursuer in slots()}
    drifting = [t for t, pursuer in slots(ClockSkew(node=0, drift=0.01)) if pursuer == 0]
    mine = [k for k in range(1, 250) if owner.get(k) == 0]
    assert drifting[: len(mine)] == pytest.approx([k / 1.01 for k in mine], abs=1e-6)


@pytest.mark.parametrize("schedule", [Poisson(rate=10.0), Periodic(period=0.1), Rounds(period=0.1)])
@pytest.mark.parametrize("offset", [-2.0, 2.0])
def test_a_wrong_clock_neither_bunches_nor_stops_revisions(schedule, offset):
    """The offset is at most what a schedule by common rounds is early or late; none decides twice at one instant."""
    protocol = SpatialAdaptivePlay(schedule=schedule)
    result = play(protocol, ClockSkew(node=1, offset=offset), motion=Motion(static=True), horizon=10.0)
    times = decided(result, 1)
    assert len(set(times)) == len(times)
    late = 2.0 if offset < 0 and schedule.kind == "rounds" else 0.0
    assert len(times) == pytest.approx(100 - 10 * late, abs=5 * np.sqrt(100))


# What breakdowns and clocks must not bring down.


def test_a_time_that_passed_during_a_breakdown_comes_at_once():
    def timer(me):
        for k in range(1, 10):
            yield me.at(k * 0.1)
            times[me.id].append(round(me.now, 6))

    times = {0: [], 1: [], 2: []}
    play(timer, Crash(node=0, start=0.25, end=0.55), horizon=1.0)
    assert times[0] == [0.1, 0.2, 0.55, 0.55, 0.55, 0.6, 0.7, 0.8, 0.9]
    assert times[1] == [k / 10 for k in range(1, 10)]


def test_the_centre_sends_a_substitute_until_the_relay_pursuer_is_repaired():
    """Pursuer 0 (2 m) is the relay; while it is broken pursuer 1 is, which has come nearer when 0 is repaired."""
    result = play(Centralised(slot=0.1), Crash(node=0, start=0.55, end=0.85), Crash(node=1, start=0.7), horizon=9.0)
    orders = [(round(d.t / 1e9, 6), d.pursuer, d.active) for d in result.trace.of(Decided)]
    assert orders == [(0.0, 0, True), (0.6, 1, True), (0.7, 2, True), (0.9, 0, True), (0.9, 2, False)]
    assert result.trace.of(Ended)[0].capturer == 0


@pytest.mark.parametrize("offset", [-1.0, 0.0, 10.0])
def test_heartbeats_keep_their_period_on_a_clock_that_is_wrong(offset):
    """Ten a second, from the first tenth of a second on, whatever the clock shows."""
    heard = play(
        lambda me: iter(()), ClockSkew(node=0, offset=offset), announce=Announcements(start="known"), horizon=2.0
    )
    beats = np.array([b.t / 1e9 for b in heard.trace.of(Broadcast) if b.src == 0])
    assert beats[0] < 0.1
    assert np.diff(beats) == pytest.approx(0.1, abs=1e-8)


def test_dead_reckoning_survives_clocks_that_are_ahead():
    """The initial announcements seem older than the pursuit; none is dead reckoned before the evader has moved."""
    ahead = {"fault": (ClockSkew(offset=0.03),), "announce": Announcements(payload="state")}
    assert summary(run(Scenario(team=Team(count=5), horizon=2.0, **ahead), 1)).decisions > 0


@pytest.mark.parametrize("offset", [0.0, 2.0])
def test_the_initial_knowledge_carries_the_time_stamp_of_its_source_clock(offset):
    """All clocks are wrong alike, so pursuer 0, active at 2 m and still at 2 m in a frozen game, is reckoned there."""

    def look(me):
        yield me.at(me.now)
        if me.id == 1:
            seen.append(me.believed_chasers())

    seen = []
    skews = [ClockSkew(node=node, offset=offset) for node in range(3)]
    team = Team(positions=[(2.0, 0.0), (3.0, 0.0), (5.0, 0.0)], speeds=1.0, active_at_start=1.0)
    play(look, *skews, team=team, announce=Announcements(payload="state", trigger="never"))
    assert seen == [pytest.approx({0: 1.9, 2: 4.9})]


def test_a_breakdown_causes_no_capture_in_a_static_game():
    near = Team(positions=[(0.0, 0.0), (5.0, 0.0), (6.0, 0.0)], speeds=1.0, active_at_start=0.0)
    still = {"team": near, "evader": Evader(position=(0.05, 0.0), speed=0.0), "motion": Motion(static=True)}
    result = play(lambda me: iter(()), Crash(node=1, start=1.0, end=2.0), **still)
    assert result.trace.of(Ended) == [Ended(4 * 10**9, "horizon", None)]


def test_a_repaired_pursuer_decides_after_the_arrivals_of_that_instant():
    """Pursuer 0 announces at 0.5 s that it chases; 1, due to look at 0.55 s, is repaired as that arrives at 0.6 s."""

    def look(me):
        yield me.at(0.5 if me.id == 0 else 0.55)
        if me.id == 0:
            me.assign(True)
            me.announce()
        seen[me.id] = (round(me.now, 6), me.believed_active())

    seen = {}
    play(look, Crash(node=1, start=0.2, end=0.6), network=Links(latency=Constant(value=0.1)))
    assert seen[1] == (0.6, [0])


# Announcements and random draws of a pursuer that broke down.


def announcing_at(*decisions):
    """Return a protocol by which pursuer 1 decides (t, active), s, and announces it if it is time to."""

    def protocol(me):
        for t, active in decisions if me.id == 1 else ():
            if t >= me.now:
                yield me.at(t)
                me.assign(active)
                me.announce()

    return protocol


def announced(result, pursuer=1):
    """Return the announcements of a pursuer, as {time in s: active}."""
    return {b.t / 1e9: b.body.active for b in result.trace.of(Broadcast) if b.src == pursuer}


@pytest.mark.slow
@pytest.mark.parametrize("memory", [True, False])
@pytest.mark.parametrize("announce", [Announcements(heartbeat=2.0), Announcements(trigger="change")])
def test_a_pursuer_stopped_by_a_breakdown_announces_that_it_chases_again(announce, memory):
    """Active from 1 s on, stopped at 1.1 s without an announcement, repaired at 1.2 s: it announces its decision at 2
    s.

    Whether a heartbeat comes between depends on the seed. The control: without the breakdown nothing changed.
    """
    changes = {"announce": announce, "motion": Motion(static=True)}
    protocol = announcing_at((1.0, True), (2.0, True))
    for seed in range(6):
        crash = Crash(node=1, start=1.1, end=1.2, memory=memory)
        result = play(protocol, crash, seed=seed, **changes)
        assert [(h.t / 1e9, h.pursuer) for h in result.trace.of(BrokeDown)] == [(1.1, 1)]
        assert announced(result)[1.0] == announced(result)[2.0] == 1
        assert 2.0 not in announced(play(protocol, seed=seed, **changes))


@pytest.mark.parametrize("scope", ["radio", "robot"])
def test_an_action_that_could_not_be_announced_is_announced_at_the_next_revision(scope):
    """Inactive from 1.2 s on while its radio is down from 1.1 to 1.5 s; announced at 2 s though unchanged, not at 3 s.

    A robot that is down decides nothing meanwhile, is inactive all the same, and announces that once.
    """
    protocol = announcing_at((1.0, True), (1.2, False), (2.0, False), (3.0, False))
    crash = Crash(node=1, start=1.1, end=1.5, scope=scope)
    changes = {"announce": Announcements(trigger="change", start="known"), "motion": Motion(static=True)}
    result = play(protocol, crash, **changes)
    late = {2.0: False} if scope == "radio" else {1.5: False}
    assert announced(result) == {1.0: True} | late
    assert announced(play(protocol, **changes)) == {1.0: True, 1.2: False}


@pytest.mark.parametrize("memory", [True, False])
def test_the_random_stream_continues_after_a_repair(memory):
    """Broken down from 1.05 to 2 s it draws on from where it was: the first numbers of its streams, each once."""
    drawn, mine = [], []

    def protocol(me):
        while me.id == 1:
            drawn.append(me.stream("dice").random())
            mine.append(me.rng.random())
            yield me.sleep(0.1)

    play(protocol, Crash(node=1, start=1.05, end=2.0, memory=memory))
    assert 25 < len(drawn) < 35
    assert drawn == stream(0, "dice", 1).random(len(drawn)).tolist()
    assert mine == stream(0, "decisions", 1).random(len(mine)).tolist()


def test_a_pursuer_restarted_without_memory_draws_new_poisson_times():
    """Waits are the draws of its stream: those before the breakdown, one that it cut short, and then the next."""
    protocol = SpatialAdaptivePlay(schedule=Poisson(rate=5.0))
    crash = Crash(node=1, start=1.0, end=2.0, memory=False)
    still = {"motion": Motion(static=True), "announce": Announcements(trigger="never")}
    made = np.array(decided(play(protocol, crash, horizon=8.0, **still), 1))
    waits = stream(0, "poisson", 1).exponential(0.2, size=200)
    before = (np.cumsum(waits) < 1.0).sum()
    after = 2.0 + np.cumsum(waits[before + 1 :])
    assert before > 1
    assert made == pytest.approx([*np.cumsum(waits)[:before], *after[after < 8.0]], abs=1e-6)


@pytest.mark.parametrize(
    ("scope", "memory", "restarts"),
    [("robot", False, [0, 1, 2]), ("robot", True, [0]), ("radio", False, [0]), ("radio", True, [0])],
)
def test_restarts_count_the_restarts_of_a_protocol(scope, memory, restarts):
    begun, last = [], []

    def protocol(me):
        if me.id == 1:
            begun.append(me.restarts)
            yield me.at(3.5)
            last.append(me.restarts)

    play(protocol, *(Crash(node=1, start=t, end=t + 0.5, scope=scope, memory=memory) for t in (1.0, 2.0)))
    assert begun == restarts
    assert last == [restarts[-1]]


def test_a_breakdown_with_memory_keeps_it_after_one_without():
    begun = []

    def protocol(me):
        if me.id == 1:
            begun.append(me.restarts)
            yield me.at(3.5)

    crashes = (Crash(node=1, start=t, end=t + 0.5, memory=memory) for t, memory in ((1.0, False), (2.0, True)))
    play(protocol, *crashes)
    assert begun == [0, 1]


def test_a_broken_pursuer_cannot_be_sent_by_a_centre():
    """Without a body of its own the protocol of pursuer 0 goes on, and orders pursuer 1, which is down, to chase."""

    class Centre:
        announces = False
        embodied = False
        omniscient = True

        def __call__(self, me):
            yield me.at(1.5)
            if me.id == 0:
                me.global_state.set_action(1, 1)
                seen.append(me.global_state.profile())
                me.global_state.broken()[:] = True  # a copy
                me.global_state.set_action(2, 1)
                seen.append(me.global_state.profile())

    seen = []
    play(Centre(), Crash(node=1, start=1.0, end=3.0))
    assert seen == [[0, 0, 0], [0, 0, 1]]
