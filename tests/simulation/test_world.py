"""The world: two clocks, orders that take effect at their instant, capture within a step."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desim import Scenario, load, run, summary
from desim.analysis.metrics import active_time
from desim.kernel.core.clock import Clock
from desim.kernel.core.events import MessageCounts
from desim.kernel.core.positions import PositionSource
from desim.kernel.core.units import SECOND
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.state.received_records import Records
from desim.pursuit.core.events import Captured, Decided, Ended, Sampled, Started
from desim.pursuit.core.geometry import toward
from desim.pursuit.motion.guidance import ConstantBearing, PurePursuit
from desim.pursuit.motion.kinematics import Kinematics
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Capture, Motion, Recording
from desim.simulation.wiring import PursuerPositions
from desim.testing.pursuits import watched
from scenarios.studies.study import SCENARIOS
from tests.worlds import world_of


def orders(*plan):
    """Return a protocol that lets pursuer i chase or stay at given times: (time, pursuer, active)."""

    def protocol(me):
        for time, pursuer, active in plan:
            if pursuer == me.id:
                yield me.at(time)
                me.assign(active)

    return protocol


def still(*plan, **changes):
    """Return two pursuers at (0, 0) and (9, 0) with speed 1, an evader at (3, 0) that stands still, h = 1 s."""
    given = {
        "horizon": 2.5,
        "team": Team(positions=[(0.0, 0.0), (9.0, 0.0)], speeds=1.0, active_at_start=0.0),
        "evader": Evader(position=(3.0, 0.0), speed=0.0),
        "motion": Motion(step=1.0),
        "protocol": orders(*plan),
        "announce": Announcements(trigger="revision", start="known"),
        "record": Recording(trajectory=0.25),
    }
    return Scenario(**(given | changes))


def positions(result):
    """Return {time in s: [evader, pursuers ...]}."""
    return {event.t / 1e9: [*event.evaders, *event.pursuers] for event in result.trace.of(Sampled)}


def test_an_action_within_a_step_takes_effect_at_its_instant():
    """Chasing from 0.3 s to 1.4 s at 1 m/s with h = 1 s: 1.1 m and 1.1 s of active time, not 1 or 2."""
    result = run(still((0.3, 0, True), (1.4, 0, False)))
    x = {t: at[1][0] for t, at in positions(result).items()}
    assert x[0.25] == 0.0
    assert x[0.5] == pytest.approx(0.2, abs=1e-12)
    assert x[1.25] == pytest.approx(0.95, abs=1e-12)
    assert x[1.5] == x[2.5] == pytest.approx(1.1, abs=1e-12)
    assert active_time(result) == pytest.approx(1.1, abs=1e-12)


@pytest.mark.parametrize("order", ["simultaneous", "evader_first"])
def test_an_action_changes_no_other_players_path(order):
    plain = still((0.1, 1, True), motion=Motion(step=1.0, order=order), evader=Evader(position=(3.0, 4.0)))
    extra = plain.model_copy(update={"protocol": orders((0.1, 1, True), (0.37, 0, True), (0.61, 0, False))})
    alone, both = ({t: at[2] for t, at in positions(run(each)).items() if t <= 1.0} for each in (plain, extra))
    assert np.array([*both.values()]) == pytest.approx(np.array([*alone.values()]), abs=1e-12)
    assert alone[1.0] != alone[0.0]


@pytest.mark.parametrize(("order", "aim"), [("evader_first", (3.0, 2.0)), ("simultaneous", (3.0, 0.0))])
def test_pursuers_head_for_where_the_evader_is_as_the_step_ends_or_was_as_it_began(order, aim):
    """The evader at (3, 0) flees pursuer 1 at (3, -2) upwards at 2 m/s; pursuer 0 starts at 0.5 s at 4 m/s."""
    scenario = still(
        (0.5, 0, True),
        team=Team(positions=[(0.0, 0.0), (3.0, -2.0)], speeds=4.0, active_at_start=0.0),
        evader=Evader(position=(3.0, 0.0), speed=2.0),
        motion=Motion(step=1.0, order=order),
    )
    at = np.array(positions(run(scenario))[1.0][1])
    assert at == pytest.approx(2.0 * np.array(aim) / np.hypot(*aim), abs=1e-12)


def test_the_last_step_ends_at_the_horizon():
    """h = 2 s, horizon 3 s: from 2 s on pursuers head for where the evader is at 3 s, not for where it would be at 4 s.

    The evader flees pursuer 1 upwards at 2 m/s, is at (3, 4) at 2 s, and would be at (3, 6) at 3 s; pursuer 0 starts
    at 2 s from (-3, 0), in the direction (6, 6).
    """
    scenario = still(
        (2.0, 0, True),
        horizon=3.0,
        team=Team(positions=[(-3.0, 0.0), (3.0, -2.0)], speeds=4.0, active_at_start=0.0),
        evader=Evader(position=(3.0, 0.0), speed=2.0),
        motion=Motion(step=2.0),
    )
    at = np.array(positions(run(scenario))[3.0][1])
    assert at == pytest.approx(np.array([-3.0, 0.0]) + 4.0 / np.sqrt(2.0), abs=1e-12)


def test_capture_between_two_steps_is_seen_at_its_instant_and_an_order_then_comes_too_late():
    """From 3 m at 1 m/s to eps = 0.1 m: 2.9 s, with steps of 1 s; sampled, it is 3 s."""
    result = run(still((0.0, 0, True), (2.9, 0, False), horizon=5.0))
    assert result.trace.of(Ended) == [Ended(2_900_000_000, "captured", 0)]
    assert len(result.trace.of(Decided)) == 1
    sampled = run(still((0.0, 0, True), horizon=5.0, capture=Capture(test="sample")))
    assert sampled.trace.of(Ended) == [Ended(3_000_000_000, "captured", 0)]


def test_a_foreseen_capture_that_an_order_prevents_does_not_happen():
    """Pursuer 0 would capture at 2.9 s; its action is set to stay at 2.8 s, 0.2 m away."""
    result = run(still((0.0, 0, True), (2.8, 0, False), horizon=5.0))
    assert result.trace.of(Ended)[0].reason == "horizon"
    assert positions(result)[5.0][1] == pytest.approx((2.8, 0.0))


def test_capture_at_the_horizon_still_counts_and_no_decision_follows():
    assert summary(run(still((0.0, 0, True), horizon=2.9))).captured
    assert not summary(run(still((0.0, 0, True), horizon=2.8999999))).captured
    assert [event.t for event in run(still((2.4, 0, True), (2.5, 0, False))).trace.of(Decided)] == [2_400_000_000]


def test_chasers_are_inactive_since_the_capture_of_their_evader():
    """Both chase evader 1, which pursuer 0 captures after 2.9 s; pursuer 2 stays."""
    team = Team(positions=[(0.0, 0.0), (9.0, 0.0), (9.0, 9.0)], speeds=1.0, active_at_start=0.0)
    parts = world_of(still(team=team, horizon=5.0))
    parts.world.begin()
    for pursuer in (0, 1):
        parts.view.set_action(pursuer, 1)
    parts.env.run(until=3 * SECOND)
    assert parts.state.profile == [0, 0, 0]
    assert parts.state.acting_since == [2_900_000_000, 2_900_000_000, 0]


def test_a_pursuer_within_the_radius_at_the_start_captures_before_any_decision():
    result = run(still((0.0, 0, True), evader=Evader(position=(0.05, 0.0))))
    assert result.trace.of(Ended) == [Ended(0, "captured", 0)]
    assert not result.trace.of(Decided)


def test_an_evader_that_runs_into_a_pursuer_that_stays_is_captured():
    """Nearest is pursuer 0 at distance 1; pursuer 1 stays at 4 m in the way: met after 3.9 / 1 s."""
    scenario = still(
        horizon=9.0,
        team=Team(positions=[(0.0, 0.0), (10.0, 0.0)], speeds=0.0, active_at_start=0.0),
        evader=Evader(position=(1.0, 0.0), speed=1.0, strategy=lambda state, rng: 1.0),
    )
    assert run(scenario).trace.of(Ended) == [Ended(8_900_000_000, "captured", 1)]


def test_in_a_static_game_positions_and_time_left_are_constant():
    seen = []

    def protocol(me):
        for _ in range(3):
            yield me.sleep(0.7)
            seen.append((me.time_left(), me.capture_time()))
            me.assign(True)

    scenario = still(protocol=protocol, motion=Motion(static=True))
    result = run(scenario)
    assert sorted(set(seen)) == [(2.5, 2.9), (2.5, 5.9)]
    assert all(at == positions(result)[0.0] for at in positions(result).values())


def test_a_slow_pursuer_is_not_active_at_the_start():
    scenario = Scenario(team=Team(count=3, speeds=[0.5, 0.9, 1.0]), horizon=0.1)
    assert run(scenario).trace.of(Started)[0].active == (False, False, True)


@pytest.mark.whole
@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 10**6),
    st.sampled_from([0.1, 0.03, 0.007]),
    st.sampled_from(["evader_first", "simultaneous"]),
    st.sampled_from(["segment", "sample"]),
)
def test_no_player_jumps_or_exceeds_its_maximum_speed(seed, step, order, test):
    """Between samples 5 ms apart no pursuer moves farther than its speed allows while active: `Motion` watches."""
    rng = np.random.default_rng(seed)
    plan = [(round(rng.uniform(0, 1), 4), int(rng.integers(3)), bool(rng.integers(2))) for _ in range(8)]
    scenario = Scenario(
        horizon=1.0,
        team=Team(count=3, box=(0.0, 4.0), speeds=[1.0, 1.5, 2.0], active_at_start=0.5),
        evader=Evader(box=(1.0, 3.0)),
        capture=Capture(test=test),
        motion=Motion(step=step, order=order),
        protocol=orders(*sorted(plan)),
        record=Recording(trajectory=0.005),
    )
    watched(scenario, seed)


def test_the_negotiation_may_be_much_faster_than_the_motion():
    """1,000 orders between two steps of 1 s leave an active time that is exact to the nanosecond."""
    plan = [(k / 1000, 0, k % 2 == 1) for k in range(1, 1001)]
    assert active_time(run(still(*plan, horizon=1.0))) == pytest.approx(0.5, abs=1e-9)


def test_a_watcher_sees_everything_as_it_happens_and_may_end_the_run():
    seen = []

    def watch(event):
        seen.append(event)
        return isinstance(event, Decided) and event.t >= 300_000_000

    result = run(still((0.1, 0, True), (0.3, 0, False), (0.5, 0, True)), 0, watch)
    assert result.trace.of(Ended) == [Ended(300_000_000, "stopped", None)]
    assert seen == list(result.trace)


def test_a_watcher_that_raises_fails_the_run():
    def watch(event):
        raise ArithmeticError("invariant broken")

    with pytest.raises(ArithmeticError, match="invariant broken"):
        run(still(), 0, watch)


# Guidance.


def headings(guidance, order, begin=1.5):
    """Return the direction in which pursuer 0, at (0, 0), moves from its order to the end of the step, and in the next.

    The evader runs from (3, 0) upwards at 1 m/s all the time; the pursuer does 2 m/s, the step is 1 s, and the order
    comes in the middle of one.
    """
    scenario = still(
        (begin, 0, True),
        horizon=3.0,
        team=Team(positions=[(0.0, 0.0), (50.0, 0.0)], speeds=2.0, active_at_start=0.0, guidance=guidance),
        evader=Evader(position=(3.0, 0.0), speed=1.0, strategy=lambda state, rng: 1j),
        motion=Motion(step=1.0, order=order),
    )
    at = {t: complex(*where[1]) for t, where in positions(run(scenario)).items()}
    end = begin + 0.5
    assert abs(at[end]) == pytest.approx(1.0, abs=1e-12)
    assert abs(at[end + 1.0] - at[end]) == pytest.approx(2.0, abs=1e-12)
    return at[end] / abs(at[end]), (at[end + 1.0] - at[end]) / 2.0


@pytest.mark.parametrize("order", ["evader_first", "simultaneous"])
def test_an_order_inside_a_step_and_the_next_step_lead_to_the_same_point_of_meeting(order):
    """Ordered at 1.5 s the gap is (3, 1.5), across it w = 3 / |gap|: from then on one course, to the point of meeting.

    Pure pursuit heads first for where the evader is at 2 s or was at 1 s, (3, 2) or (3, 1), and anew at 2 s.
    """
    gap = 3.0 + 1.5j
    across = 3.0 / abs(gap)
    expected = gap / abs(gap) * (np.sqrt(4.0 - across**2) + 1j * across) / 2.0
    assert headings(ConstantBearing(), order) == pytest.approx((expected, expected), abs=1e-12)
    aim = 3.0 + (2.0j if order == "evader_first" else 1.0j)
    begun, gone_on = headings(PurePursuit(), order)
    assert begun == pytest.approx(aim / abs(aim), abs=1e-12)
    rest = (3.0 + (3.0j if order == "evader_first" else 2.0j)) - begun
    assert gone_on == pytest.approx(rest / abs(rest), abs=1e-12)
    assert abs(begun - expected) > 0.01


def test_with_simultaneous_moves_a_turn_of_the_evader_is_seen_at_the_end_of_the_step():
    """Ordered at 0.5 s it sees what was to be seen at 0 s, an evader at rest at (3, 0); at 1 s one at (3, 1), rising.

    From (1, 0) the gap is (2, 1) then, and across it the evader moves at 2 / |gap|.
    """
    begun, gone_on = headings(ConstantBearing(), "simultaneous", begin=0.5)
    assert begun == pytest.approx(1.0, abs=1e-12)
    gap = 2.0 + 1.0j
    across = 2.0 / abs(gap)
    expected = gap / abs(gap) * (np.sqrt(4.0 - across**2) + 1j * across) / 2.0
    assert gone_on == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("begin", [0.1, 1.3])
@pytest.mark.parametrize("order", ["evader_first", "simultaneous"])
@pytest.mark.parametrize("law", [PurePursuit(), ConstantBearing(), lambda gaps, aims, w, v: toward(gaps + w, v)])
def test_dead_reckoning_is_exact_under_any_law_of_guidance(law, order, begin):
    """Pursuer 0 begins inside a step and announces its state then and later, with 0.33 s of latency: pursuer 1 is 1e-9
    m off.

    The evader turns at every step. Under a user guidance law it announces later on only as a step begins, for the
    course of a step is not known from a place inside it.
    """
    step, errors = 0.25, []
    known = isinstance(law, PurePursuit | ConstantBearing)
    tell = [begin, *(t if known else step * np.ceil(t / step) for t in (begin + 0.67, begin + 1.14))]
    look = np.arange(begin + 0.35, begin + 1.65, 0.11)

    def protocol(me):
        for t in tell if me.id == 0 else look:
            yield me.at(t)
            if me.id == 0:
                me.assign(True)
                me.broadcast()
            else:
                known = me.team_estimate()
                errors.append(abs(known.positions[known.ids.index(0)] - me._view.state.position(0)))

    def turning(state, rng):
        return complex(np.exp(1j * rng.uniform(-1.0, 2.0)))

    scenario = still(
        horizon=3.0,
        team=Team(positions=[(0.0, 0.0), (-9.0, 0.0)], speeds=1.0, active_at_start=0.0, guidance=law),
        evader=Evader(position=(4.0, 1.0), speed=0.9, strategy=turning),
        motion=Motion(step=step, order=order),
        protocol=protocol,
        announce=Announcements(trigger="revision", payload="state", belief_timeout=np.inf),
        network=Links(latency=Constant(value=0.33)),
    )
    result = run(scenario)
    assert result.trace.of(Ended)[0].reason == "horizon"
    assert result.trace.of(Started)[0].active == (False, False)
    assert len(errors) == len(look)
    assert max(errors) < 1e-9


@pytest.mark.parametrize(
    ("payload", "reckoning", "steps"), [("action", "exact", 0), ("state", "straight_line", 0), ("state", "exact", 3)]
)
def test_the_evader_track_is_kept_only_for_exact_dead_reckoning(payload, reckoning, steps):
    """Steps begin at 0, 1 and 2 s of 2.5 s."""
    remembered = []

    def protocol(me):
        yield me.at(2.4)
        remembered.append(len(me._view.state.body(1).path._segments))

    run(still(protocol=protocol, announce=Announcements(payload=payload, reckoning=reckoning)))
    assert remembered == [steps, steps]


def test_no_law_of_guidance_leads_faster_than_a_pursuer_can():
    for law in (lambda gaps, aims, w, v: 1.01 * toward(gaps, v), lambda gaps, aims, w, v: toward(gaps, v) * np.nan):
        scenario = still((0.5, 0, True), team=Team(positions=[(0.0, 0.0), (9.0, 0.0)], speeds=1.0, guidance=law))
        with pytest.raises(ValueError, match="velocities should be within the speeds"):
            run(scenario)


LOST_ON_ARRIVAL = {
    "relay": ['network.range_check = "delivery"', 'announce.start = "silent"', 'announce.payload = "time"'],
    "faults": ["network.range_check = 'both'"],
}


@pytest.mark.slow
@pytest.mark.own_trace
@pytest.mark.parametrize("name", LOST_ON_ARRIVAL)
def test_recording_the_messages_changes_no_decision(name, monkeypatch):
    """With messages recorded, each arrival is decided by an event; without, arrivals are decided together."""
    links = ["network.range = 6.0", "network.latency = { kind = 'lognormal', mean = 0.1, cv = 0.8 }", "horizon = 2.0"]
    scenario = load(SCENARIOS / f"{name}.toml", [each.replace(" = ", "=", 1) for each in links + LOST_ON_ARRIVAL[name]])
    one_by_one = []
    insert = Records.insert
    monkeypatch.setattr(Records, "insert", lambda *given: (one_by_one.append(len(given[1])), insert(*given)))
    runs = []
    for messages in (False, True):
        record = scenario.record.model_copy(update={"messages": messages})
        result = run(scenario.model_copy(update={"record": record}), 3)
        runs.append([list(result.trace.of(kind)) for kind in (Decided, Captured, MessageCounts)])
        assert (sum(one_by_one) > 0) == messages
    assert runs[0] == runs[1]
    assert runs[0][2][-1].lost_by["out_of_range"] > 0


def test_the_distance_of_two_pursuers_is_that_between_their_positions():
    """The network asks for it at each arrival of a message to one node, also after the positions have been read."""
    env, rng = Clock(), np.random.default_rng(4)
    players = Kinematics(env, rng.normal(size=5) + 1j * rng.normal(size=5))
    source = PursuerPositions(SimpleNamespace(players=players, static=False), 1.0)
    for until in (SECOND // 3, SECOND, 2 * SECOND):
        env.run(until=until)
        for _ in range(2):
            for node, other in ((0, 1), (3, 2), (4, 0)):
                assert source.distance(node, other) == PositionSource.distance(source, node, other)
            players.positions()
        players.command(rng.normal(size=5) + 1j * rng.normal(size=5))
