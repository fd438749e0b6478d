"""Announcements: payloads and the resulting beliefs, triggers, memory, warm and cold start.

Unless a test states otherwise, three pursuers at 2, 3 and 5 m (speed 1) of a stationary evader announce what they are
scripted to and nothing else. The radius of capture is 0.1 m, so they need 1.9, 2.9 and 4.9 s.
"""

from functools import partial
from math import inf
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import kstest

from desim import Scenario, run
from desim.kernel.core.events import Broadcast
from desim.kernel.core.records import Record
from desim.kernel.core.units import nanoseconds, seconds
from desim.kernel.models.access import Tdma
from desim.kernel.models.faults import Crash
from desim.kernel.models.latency import Constant, Uniform
from desim.kernel.models.links import Links
from desim.kernel.models.medium import Bitrate
from desim.pursuit.motion.dynamics import Acceleration, Simple, TurnRate
from desim.pursuit.team.announcements import (
    STARTS,
    Announcements,
    Assignment,
    Eavesdropper,
    Forwarded,
    LocatedAssignment,
    MovingAssignment,
    announced_action,
    relayed_records,
)
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion, Recording

SIMPLE = Simple()
PAYLOADS = ["action", "time", "state", "course"]


@pytest.mark.parametrize(
    ("body", "action"),
    [
        (LocatedAssignment(2, 0.0, 0.0, 1.0), 2),
        (SimpleNamespace(active=np.int64(3)), 3),
        (SimpleNamespace(active=True), 1),
        (SimpleNamespace(active=0), 0),
        (SimpleNamespace(active="yes"), None),
        (("token", 1), None),
        (None, None),
    ],
)
def test_a_body_has_the_action_of_its_attribute_active_if_that_is_a_number_of_an_evader(body, action):
    assert announced_action(body) == action


def test_a_body_relays_the_records_of_its_attribute_records_if_that_is_a_tuple():
    record = Record(1, 2, 0, None)
    assert relayed_records(Forwarded((record,))) == (record,)
    assert relayed_records(SimpleNamespace(records="gold")) is None
    assert relayed_records(7) is None


def play(protocol, announce, latency=0.0, **changes):
    """Run a protocol for three pursuers at 2, 3 and 5 m of an evader that stands still."""
    given = {
        "horizon": 10.0,
        "team": Team(positions=[(2.0, 0.0), (3.0, 0.0), (5.0, 0.0)], speeds=1.0, active_at_start=0.0),
        "evader": Evader(position=(0.0, 0.0), speed=0.0),
        "protocol": protocol,
        "network": Links(latency=Constant(value=latency) if isinstance(latency, float) else latency),
        "announce": Announcements(**({"trigger": "never", "start": "known"} | announce)),
        "record": Recording(trajectory=0.0, messages=True),
    }
    return run(Scenario(**(given | changes)))


def script(*acts, seen=None):
    """Return a protocol by (time, pursuer, act); what acts return is kept in `seen` by time."""

    def protocol(me):
        for time, pursuer, act in acts:
            if pursuer == me.id:
                yield me.at(time)
                found = act(me)
                if seen is not None:
                    seen[time] = found

    return protocol


def chase(me):
    me.assign(True)
    me.broadcast()


def stop(me):
    me.assign(False)


def withdraw(me):
    me.assign(False)
    me.broadcast()


def believed_chasers(me):
    return {j: round(phi, 9) for j, phi in me.believed_chasers().items()}


def announcement_times(result, src):
    """Return the times of the announcements of a pursuer, s."""
    return [seconds(event.t) for event in result.trace.of(Broadcast) if event.src == src]


# Payloads.


@pytest.mark.parametrize(
    ("payload", "reckoning", "phi"),
    [
        ("action", "exact", 2.4),
        ("time", "exact", 2.9),
        ("state", "exact", 1.9),
        ("state", "straight_line", 1.9),
        ("course", "exact", 1.9),
    ],
)
def test_the_payload_determines_the_beliefs_of_the_others(payload, reckoning, phi):
    """Pursuer 1 chases from 0.5 s on, announces it, and stops silently at 1 s, at 2.5 m; pursuer 2 looks at 1.5 s.

    action: it senses it at 2.5 m; time: it received 2.9 s; state: it dead reckons it at 2 m. Its own
    time is 4.9 s, so its gain is (phi - 4.9) / 2.
    """
    seen = {}
    acts = [(0.5, 1, chase), (1.0, 1, stop), (1.5, 2, lambda me: (believed_chasers(me), round(me.gain(), 9)))]
    play(script(*acts, seen=seen), {"payload": payload, "reckoning": reckoning}, latency=0.25)
    assert seen[1.5] == ({1: phi}, pytest.approx((phi - 4.9) / 2))


def test_an_announced_time_is_a_commitment_until_the_next_announcement():
    """It stays 2.9 s while the sender comes nearer, and is 1.9 s when that is announced 1 s later."""
    seen = {}
    looks = [(t, 2, believed_chasers) for t in (0.7, 0.8, 1.7, 1.8, 2.5)]
    play(script((0.5, 1, chase), (1.5, 1, chase), *looks, seen=seen), {"payload": "time"}, latency=0.25)
    assert [seen[t] for t in (0.7, 0.8, 1.7, 1.8, 2.5)] == [{}, {1: 2.9}, {1: 2.9}, {1: 1.9}, {1: 1.9}]


@pytest.mark.parametrize("reckoning", ["exact", "straight_line"])
def test_the_announced_state_of_an_idle_pursuer_stays_exact(reckoning):
    """It announced a speed of 0: while the evader flees its time grows, as with its sensed position."""

    def stand(me):
        me.publish(LocatedAssignment(active=True, x=3.0, y=0.0, speed=0.0))

    seen = {}
    looks = [
        (t, 2, lambda me: (me.believed_chasers()[1], me.global_state.capture_times(1)[1])) for t in (0.5, 1.234, 7.5)
    ]
    announce = {"payload": "state", "reckoning": reckoning}
    play(script((0.0, 1, stand), *looks, seen=seen), announce, evader=Evader(position=(0.0, 1.0), speed=0.5))
    for announced, sensed in (seen[t] for t in (0.5, 1.234, 7.5)):
        assert announced == pytest.approx(sensed, abs=1e-9)
    assert seen[7.5][1] > seen[0.5][1] + 5.0


@pytest.mark.parametrize("payload", PAYLOADS)
@pytest.mark.parametrize("reckoning", ["exact", "straight_line"])
def test_in_a_static_game_all_payloads_give_the_same_beliefs_forever(payload, reckoning):
    seen = {}
    announce = {"payload": payload, "reckoning": reckoning}
    acts = [(0.5, 0, chase), (0.5, 1, chase), (9.5, 2, believed_chasers)]
    play(script(*acts, seen=seen), announce, latency=0.25, motion=Motion(static=True))
    assert seen[9.5] == {0: 1.9, 1: 2.9}


@pytest.mark.parametrize(("payload", "size"), [("action", 24), ("time", 32), ("state", 48), ("course", 64)])
def test_an_announcement_has_the_size_of_its_payload(payload, size):
    """Bytes: 16 of header and 8 per number or truth; whether it is active or not, moving or not."""
    result = play(script((0.5, 1, chase), (1.0, 1, withdraw), (1.5, 0, chase)), {"payload": payload})
    assert [event.size for event in result.trace.of(Broadcast)] == [size] * 3


@pytest.mark.parametrize("dynamics", [Simple(), Acceleration(limit=0.5), TurnRate(limit=0.5, heading=2.0)])
def test_a_course_is_announced_as_speed_and_heading(dynamics):
    """The receiver has the motion of the sender at sending; the speed while it chases is 1 m/s whatever its pace is."""
    seen = {}

    def told(me):
        assert type(me.located()) is (LocatedAssignment if dynamics.is_simple else MovingAssignment)
        return MovingAssignment.announced_by(me.id, me.global_state), me.global_state.state.motion(me.id)

    team = Team(positions=[(2.0, 0.0), (3.0, 0.0), (5.0, 0.0)], speeds=1.0, active_at_start=0.0, dynamics=dynamics)
    play(script((0.5, 1, chase), (1.25, 1, told), seen=seen), {"payload": "course"}, team=team)
    body, (place, course) = seen[1.25]
    assert (body.active, body.speed) == (1, 1.0)
    assert body.motion.position == place
    assert body.motion.course.velocity == pytest.approx(course.velocity, abs=1e-12)
    assert body.motion.course.heading == pytest.approx(course.heading, abs=1e-12)
    assert body.pace == pytest.approx({"simple": 1.0, "acceleration": 0.375, "turn_rate": 1.0}[dynamics.kind])


# Reckoning.


def dead_reckoning_errors(order, step, seed, reckoning="exact", dynamics=SIMPLE):
    """Return the dead-reckoning error of each look at a teammate that has chased since its announcement, m.

    Five pursuers start and stop at random times, on the boundaries of steps and inside them, and each announces at some
    of these times or between them. Latencies up to 2 s let records age by many steps. Only a teammate farther than a
    step's way from the evader is looked at.

    Returns:
        Rows of: error, age, distance to the evader, whether it announced in a step inside which it had begun, and
        whether it announced as its motion began.
    """
    rng = np.random.default_rng(seed)
    turned, rows, h = {}, [], nanoseconds(step)

    def turn(me, active):
        if active != bool(me._view.state.profile[me.id]):
            turned[me.id] = nanoseconds(me.now)
        me.assign(active)

    def look(me):
        view, state = me._view, me._view.state
        for j, record in me.latest_records().items():
            gap = abs(state.body(1).position - state.position(j))
            chased_since = record.body.active and state.profile[j] and turned[j] <= record.stamp
            if chased_since and gap > 3.0 * step + 0.5:
                age = nanoseconds(me.now) - record.stamp
                place = view.reckoned(
                    record.body.motion, record.body.speed, age, 1, exact=reckoning == "exact"
                ).position
                inside = turned[j] % h != 0 and turned[j] // h == record.stamp // h
                begins = record.stamp % h == 0 or turned[j] == record.stamp
                rows.append((abs(place - state.position(j)), seconds(age), gap, inside, begins))

    acts = []
    for pursuer in range(5):
        for k in range(5):
            t = rng.uniform(0.0, 4.0)
            t = step * round(t / step) if k % 3 == 0 else t
            acts.append((t, pursuer, partial(turn, active=bool(rng.random() < 0.6))))
            acts.append((t + rng.choice([0.0, 0.0, 0.013, 0.4]), pursuer, lambda me: me.broadcast()))
        acts += [(t, pursuer, look) for t in rng.uniform(0.0, 6.0, 40)]
        acts += [(step * round(t / step), pursuer, look) for t in rng.uniform(0.0, 6.0, 10)]
    places, speeds = rng.uniform(-15.0, 15.0, (5, 2)).tolist(), rng.uniform(1.0, 2.0, 5).tolist()
    play(
        script(*sorted(acts, key=lambda act: act[0])),
        {"payload": "state" if dynamics.is_simple else "course", "reckoning": reckoning, "start": "silent"},
        latency=Uniform(low=0.0, high=2.0),
        horizon=6.0,
        team=Team(positions=places, speeds=speeds, active_at_start=0.0, dynamics=dynamics),
        evader=Evader(position=(0.0, 0.0), speed=0.9),
        motion=Motion(step=step, order=order),
    )
    return np.array(rows)


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.01, 0.07, 0.5])
@pytest.mark.parametrize("order", ["evader_first", "simultaneous"])
def test_exact_dead_reckoning_gives_the_position_of_a_chasing_teammate(order, step):
    """Orders inside steps, ages of many steps: to 1e-9 m. The control: straight towards the evader it is not."""
    rows = np.vstack([dead_reckoning_errors(order, step, seed) for seed in range(2)])
    assert len(rows) > 100
    assert rows[:, 1].max() > 2.0
    assert rows[:, 3].sum() > 10
    assert rows[:, 0].max() < 1e-9
    assert dead_reckoning_errors(order, step, 0, "straight_line")[:, 0].max() > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("dynamics", [TurnRate(limit=1.3), Acceleration(limit=0.8)], ids=["turn rate", "acceleration"])
@pytest.mark.parametrize("step", [0.07, 0.5])
def test_exact_dead_reckoning_follows_turns_and_accelerations(dynamics, step):
    """From courses announced at the start of a step, or as an action changes: to 1e-9 m.

    Within a step, the pursuer follows the command that it was given at the start. The receiver does not know this
    command, only where it would aim now, and errs by less than a millimetre.
    """
    rows = np.vstack([dead_reckoning_errors("evader_first", step, seed, dynamics=dynamics) for seed in range(3)])
    begins = rows[:, 4] > 0.0
    assert min(begins.sum(), (~begins).sum()) > 50
    assert rows[begins, 0].max() < 1e-9
    assert 0.0 < rows[~begins, 0].max() < 2e-3
    assert dead_reckoning_errors("evader_first", step, 0, "straight_line", dynamics)[:, 0].max() > 0.1


@pytest.mark.parametrize("order", ["evader_first", "simultaneous"])
def test_straight_line_reckoning_subtracts_the_path_length_from_the_distance(order):
    """d = max(|x_e - x_j| - v_j age, 0), whatever way the evader went and even if the teammate has silently stopped."""
    seen = []

    def look(me):
        for record in me.latest_records().values():
            _, x, y, speed = record.body
            ahead = abs(me._view.evader(1) - complex(x, y)) - speed * (me.now - seconds(record.stamp))
            seen.append((me.believed_chasers()[record.src], (max(ahead, 0.0) - 0.1), speed - 0.9))

    acts = [
        (0.123, 0, chase),
        (0.5, 1, chase),
        (0.6, 1, stop),
        *((t, 2, look) for t in (0.2, 0.6, 1.0, 2.345, 4.5, 6.0)),
    ]
    play(
        script(*acts),
        {"payload": "state", "reckoning": "straight_line", "start": "silent"},
        team=Team(positions=[(4.0, 0.0), (0.0, 2.0), (9.0, 9.0)], speeds=[1.0, 1.5, 1.0], active_at_start=0.0),
        evader=Evader(position=(0.0, 0.0), speed=0.9),
        motion=Motion(order=order),
    )
    assert len(seen) == 11
    for phi, gap, closing in seen:
        assert phi == pytest.approx(max(gap, 0.0) / closing, abs=1e-9)
    assert min(gap for _, gap, _ in seen) == pytest.approx(-0.1)
    assert max(gap for _, gap, _ in seen) > 1.0


# Triggers.

ACTIONS = "TTFFTTTFF"
"""What pursuer 0 decides at 0.1, 0.2, ... 0.9 s; it is inactive at first."""


def decide(me):
    """Decide as it is written."""
    for k, letter in enumerate(ACTIONS, 1):
        yield me.at(k / 10)
        if me.id == 0:
            me.assign(letter == "T")
            me.announce()


@pytest.mark.slow_cases("revision-9-0")
@pytest.mark.parametrize(
    ("trigger", "deciding", "others"),
    [("change", 4, 0), ("heartbeat", 4, 4), ("both", 8, 4), ("revision", 9, 0), ("never", 0, 0)],
)
def test_the_trigger_determines_when_announcements_are_sent(trigger, deciding, others):
    """9 decisions, 4 of them changes, in 1 s; a heartbeat of 0.25 s beats 4 times from any phase in [0, 0.25) s on.

    Changes are announced at once and in both directions.
    """
    result = play(decide, {"trigger": trigger, "heartbeat": 0.25}, horizon=1.0, motion=Motion(static=True))
    assert [len(announcement_times(result, pursuer)) for pursuer in range(3)] == [deciding, others, others]
    if trigger == "change":
        assert announcement_times(result, 0) == [0.1, 0.3, 0.5, 0.8]
        assert [event.body.active for event in result.trace.of(Broadcast)] == [True, False, True, False]


def test_after_a_silent_start_the_first_action_counts_as_a_change():
    """The first decision is to stay: after a silent start none knows it, after an announcement all."""

    def stays(me):
        for t in (0.1, 0.2):
            yield me.at(t)
            me.assign(False)
            me.announce()

    for start, times in (("known", []), ("silent", [0.1]), ("announced", [0.0])):
        result = play(stays, {"trigger": "change", "start": start}, horizon=1.0)
        assert announcement_times(result, 1) == times


def phases(count, period):
    """Return the phases of a team's heartbeats; all its waits are periods to 1 ns."""
    result = play(
        lambda me: iter(()),
        {"trigger": "heartbeat", "heartbeat": period},
        horizon=4 * period,
        team=Team(count=count),
        motion=Motion(static=True),
    )
    times = np.array([announcement_times(result, pursuer) for pursuer in range(count)])
    assert times.shape == (count, 4)
    assert np.diff(times) == pytest.approx(period, abs=1.1e-9)
    return times[:, 0]


def test_heartbeats_are_periodic_from_a_random_phase_on():
    """120 phases are uniform in [0, T): p > 0.001 (Kolmogorov and Smirnov); the control, 30 % less, is detected."""
    found = phases(120, 0.2) / 0.2
    assert kstest(found, "uniform").pvalue > 0.001
    assert kstest(0.7 * found, "uniform").pvalue < 0.001


# Memory.


def last_trusted(announce, latency=0.25, **changes):
    """Return for how long after its last record arrived pursuer 2 believes pursuer 0 active, s; None if forever.

    Pursuer 0 chases from 0.5 s on, announces it, and its radio is down from 1.05 s on.
    """
    seen = {}

    def protocol(me):
        if me.id == 0:
            yield me.at(0.5)
            chase(me)
        if me.id == 2:
            yield me.at(1.35)
            arrival = seconds(me._network.latest_records(me.id)[0][0])
            while me.believed_chasers() and me.now < 9.0:
                yield me.sleep(0.001)
            seen["until"] = me.now - 0.001 - arrival if me.now < 9.0 else None

    changes = {"motion": Motion(static=True), "fault": (Crash(node=0, start=1.05, scope="radio"),)} | changes
    play(protocol, announce, latency, **changes)
    return seen["until"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("announce", "until"),
    [
        ({"trigger": "both"}, 0.3 + 0.5),
        ({"trigger": "both", "belief_timeout": 2.0}, 2.0),
        ({"trigger": "heartbeat", "heartbeat": 0.5}, 1.5 + 0.5),
        ({"trigger": "both", "heartbeat": 0.7}, 2.1 + 0.5),
        ({"trigger": "both", "belief_timeout": inf}, inf),
        ({"trigger": "change"}, inf),
        ({"trigger": "revision"}, inf),
        ({"trigger": "never"}, inf),
        ({"trigger": "never", "belief_timeout": 3.0}, 3.0),
    ],
)
def test_a_teammate_is_forgotten_after_the_belief_timeout(announce, until):
    """A number; auto: 3 T + 2 L with T = 0.1 s, if nothing else is given, and L = 0.25 s; without heartbeats never."""
    found = last_trusted(announce)
    if until == inf:
        assert found is None
    else:
        assert found == pytest.approx(until, abs=0.0011)


def test_the_default_belief_timeout_includes_the_airtime_of_an_announcement():
    """3 T + 2 (L + A) after arrival, where 24 bytes take A = 0.04 s at 4800 bit/s."""
    slow = Links(latency=Constant(value=0.25), medium=Bitrate(bitrate=4800.0))
    announce = {"trigger": "heartbeat", "heartbeat": 0.2}
    assert last_trusted(announce, network=slow) == pytest.approx(0.6 + 2 * (0.25 + 0.04), abs=0.0011)


def test_the_default_belief_timeout_counts_the_rounds_of_a_tdma_if_they_are_longer_than_the_heartbeat():
    """3 rounds of three slots of 0.1 s, longer than a heartbeat of 0.2 s, + 2 (L + A) with A = 0.04 s."""
    radio = Bitrate(bitrate=4800.0, access=Tdma(slot=0.1))
    slow = Links(latency=Constant(value=0.25), medium=radio)
    announce = {"trigger": "heartbeat", "heartbeat": 0.2}
    assert last_trusted(announce, network=slow) == pytest.approx(3 * 0.3 + 2 * (0.25 + 0.04), abs=0.0011)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("horizon", "until"),
    [(10.0, 1.1), (5.8, 0.9), (5.3, 0.7), (4.8, 1.1)],
    ids=["time enough", "less than auto", "less than a heartbeat", "too late"],
)
def test_a_pursuer_waits_no_longer_than_it_can_afford(horizon, until):
    """It needs 4.9 s to capture in a static game; auto is 3 T + 2 L = 1.1 s, and the least T + 2 L = 0.7 s."""
    announce = {"trigger": "heartbeat", "heartbeat": 0.2, "belief_timeout": "affordable"}
    assert last_trusted(announce, horizon=horizon) == pytest.approx(until, abs=0.0011)


@pytest.mark.parametrize(("announce", "memory"), [({"belief_timeout": 1.0}, 1.0), ({"heartbeat": 0.2}, 0.6 + 0.5)])
def test_a_record_counts_up_to_the_belief_timeout_and_not_a_nanosecond_longer(announce, memory):
    """It was announced at 0.5 s, arrived at 0.75 s, and counts from then on; auto is 3 T + 2 L."""
    end, seen = 0.75 + memory, {}
    acts = [
        (0.75 - 1e-9, 2, believed_chasers),
        (0.75, 2, believed_chasers),
        (end, 2, believed_chasers),
        (end + 1e-9, 2, believed_chasers),
    ]
    beating = {"trigger": "heartbeat", "start": "silent"} | announce
    windows = ((0.0, 0.5 - 1e-9), (0.5 + 1e-9, inf))  # its heartbeats are silent
    mute = [Crash(node=0, start=at, end=until, scope="radio") for at, until in windows]
    play(script((0.5, 0, chase), *acts, seen=seen), beating, 0.25, fault=tuple(mute), motion=Motion(static=True))
    assert [*seen.values()][-4:] == [{}, {0: 1.9}, {0: 1.9}, {}]


# Start.


@pytest.mark.parametrize("payload", PAYLOADS)
@pytest.mark.parametrize("active", [True, False])
def test_every_pursuer_knows_the_initial_actions_unless_the_start_is_silent(payload, active):
    """Nothing is announced later; r = 10 s. Known: pursuer 2 gains (mean of 1.9 and 2.9 - 4.9) / 3; else 10 - 4.9."""
    team = Team(positions=[(2.0, 0.0), (3.0, 0.0), (5.0, 0.0)], speeds=1.0, active_at_start=float(active))

    def latest_records(me):
        return {j: record.body.active for j, record in me.latest_records().items()}

    for start in STARTS:
        others, gain = ({}, 5.1) if start == "silent" else ({0: 1.9, 1: 2.9}, (2.4 - 4.9) / 3)
        seen, known = {}, others if active else {}
        acts = [(0.0, 2, lambda me: (believed_chasers(me), me.gain(), latest_records(me))), (9.0, 2, believed_chasers)]
        announce = {"payload": payload, "start": start}
        result = play(script(*acts, seen=seen), announce, team=team, motion=Motion(static=True))
        assert seen[0.0] == (known, pytest.approx(gain if active else 5.1), dict.fromkeys(others, active))
        assert seen[9.0] == known
        assert [event.t for event in result.trace.of(Broadcast)] == [0] * (3 if start == "announced" else 0)


# Overtaking.


def late_at_first(context, rng):
    """The latency: 1 s until 0.25 s, 0.1 s from then on."""
    return 1.0 if context.now < 0.25 else 0.1


@pytest.mark.slow_but_one
@pytest.mark.parametrize("payload", PAYLOADS)
@pytest.mark.parametrize("faults", [(), (Crash(node=1, start=9.0),)], ids=["noted at sending", "settled on arrival"])
def test_an_older_record_neither_replaces_a_newer_one_nor_prolongs_its_memory(payload, faults):
    """ "I chase" of 0.1 s arrives at 1.1 s, "I stay" of 0.5 s at 0.6 s. The control: without it, it is believed.

    If the newer one is "I chase", too, it is believed for 0.7 s from 0.6 s on.
    """
    late = {"motion": Motion(static=True), "fault": faults}
    for last, memory, expected in (
        (withdraw, {}, [{}, {}, {}, {}]),
        (lambda me: None, {}, [{}, {}, {0: 1.9}, {0: 1.9}]),
        (chase, {"belief_timeout": 0.7}, [{}, {0: 1.9}, {0: 1.9}, {}]),
    ):
        seen, times = {}, (0.55, 0.65, 1.2, 1.4 if memory else 5.0)
        acts = script((0.1, 0, chase), (0.5, 0, last), *((t, 2, believed_chasers) for t in times), seen=seen)
        play(acts, {"payload": payload} | memory, late_at_first, **late)
        assert [seen[t] for t in times] == expected


def test_an_old_record_that_arrives_late_is_no_handover():
    """Pursuer 0 begins to chase with record 2; record 1 of its stay is flooded once more, and record 2 again."""
    evader = Eavesdropper([0])
    evader(Record(0, 2, 0, Assignment(1)), 10)
    assert (evader.hands_over(9), evader.hands_over(10)) == (True, False)
    evader(Record(0, 1, 0, Assignment(0)), 20)
    assert not evader.hands_over(15)
    evader(Record(0, 2, 0, Assignment(1)), 30)
    assert evader.hands_over(25)
