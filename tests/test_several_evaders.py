"""Runs with several evaders: captures, what their chasers do next, and one evader as a special case."""

import json
from itertools import product
from math import nan

import numpy as np
import pytest

import desim
from desim import Scenario
from desim.kernel.core.trace_file import events_of, line_of
from desim.kernel.core.units import SECOND, seconds
from desim.kernel.models.faults import Crash
from desim.pursuit.core.events import Captured, Decided, Ended, Sampled, Started
from desim.pursuit.evaders.evasion import ConstantHeading, Diffusion, PureEvasion, Still
from desim.pursuit.motion.dead_reckoning import MotionState
from desim.pursuit.sensing.sensing import Sensing
from desim.pursuit.team.announcements import Announcements
from desim.results.run_folder import EVENTS
from desim.scenario.overrides import ScenarioError
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Capture, Motion, Recording
from desim.scenario.toml import load
from desim.simulation import steering
from tests.worlds import world_of


def chase(*targets):
    """Return a protocol by which pursuer i chases the evader targets[i], and then those after it."""

    def behaviour(me):
        while True:
            free = [j for j in me.evaders() if j >= targets[me.id]] or me.evaders()
            if me.action != free[0]:
                me.assign(free[0])
            yield me.sleep(0.01)

    return behaviour


def standing(*places, **keys):
    """Return a scenario with evaders that stand at places on the x axis, and one pursuer at the origin, 1 m/s."""
    evaders = tuple(Evader(position=(x, 0.0), speed=0.0, strategy=Still()) for x in places)
    settings = {"team": Team(positions=((0.0, 0.0),), speeds=1.0), "evader": evaders, "protocol": chase(1)}
    return Scenario(**(settings | keys))


def test_evaders_are_captured_one_after_the_other_and_the_last_one_ends_the_run():
    """A walk of 2 m, then 5 m back: with a radius of 0.1 m the captures are at 1.9 s and 1.9 + 4.8 s."""
    result = desim.run(standing(2.0, -3.0))
    first, second = result.trace.of(Captured)
    end = result.trace.of(Ended)[0]
    assert (first.evader, first.capturer, second.evader, second.capturer) == (1, 0, 2, 0)
    assert seconds(first.t) == pytest.approx(1.9, abs=1e-9)
    # It decides anew at the next hundredth of a second.
    assert seconds(second.t) == pytest.approx(1.9 + 4.8, abs=0.0101)
    assert end == Ended(second.t, "captured", 0)


@pytest.mark.parametrize(("needed", "captures"), [(1, 1), (2, 2), (3, 3), (None, 3)])
def test_as_many_captures_as_are_needed_end_the_run(needed, captures):
    result = desim.run(standing(1.0, 2.0, 3.0, capture=Capture(captures_to_end=needed)))
    captured, (end,) = result.trace.of(Captured), result.trace.of(Ended)
    assert len(captured) == captures
    assert end == Ended(captured[-1].t, "captured", 0)
    assert seconds(end.t) == pytest.approx(captures - 0.1, abs=0.03)


@pytest.mark.parametrize(("needed", "evaders", "why"), [(2, 1, "there is only 1"), (4, 3, "there are only 3")])
def test_more_captures_than_evaders_are_an_error_with_its_key(tmp_path, needed, evaders, why):
    path = tmp_path / "many.toml"
    path.write_text(f"[evader]\ncount = {evaders}\n[capture]\ncaptures_to_end = {needed}\n")
    with pytest.raises(
        ScenarioError, match=rf"many\.toml:4: capture\.captures_to_end: {why} to capture \(got {needed}\)"
    ):
        load(path)


def test_the_horizon_ends_a_run_in_which_some_are_captured():
    result = desim.run(standing(2.0, -30.0, horizon=5.0))
    assert [each.evader for each in result.trace.of(Captured)] == [1]
    assert result.trace.of(Ended) == [Ended(5 * SECOND, "horizon", None)]


def test_a_pursuer_that_runs_into_another_evader_captures_it_too():
    """On its way to the one at 4 m it passes through the one at 2 m; what it chases stays what it is."""
    result = desim.run(standing(4.0, 2.0))
    passed, chased = result.trace.of(Captured)
    assert [(each.evader, round(seconds(each.t), 9)) for each in (passed, chased)] == [(2, 1.9), (1, 3.9)]
    assert not [each for each in result.trace.of(Decided) if passed.t < each.t < chased.t and each.active != 1]


@pytest.mark.parametrize("test", ["segment", "sample"])
@pytest.mark.parametrize("places", [(2.0, 4.0), (4.0, 2.0)])
def test_several_evaders_reached_within_one_step_are_captured_at_their_own_instants(places, test):
    """One step of 5 s, in which the pursuer heads for the one at 4 m; three at one place are captured at once."""
    base = standing(*places, protocol=chase(1 + places.index(4.0)), motion=Motion(step=5.0))
    captures = desim.run(base).trace.of(Captured)
    assert [places[each.evader - 1] for each in captures] == [2.0, 4.0]
    assert [seconds(each.t) for each in captures] == [pytest.approx(1.9), pytest.approx(3.9)]
    alike = desim.run(standing(2.0, 2.0, 2.0, capture=Capture(test=test))).trace.of(Captured)
    assert [each.evader for each in alike] == [1, 2, 3]
    assert len({each.t for each in alike}) == 1


@pytest.mark.parametrize(("until", "end"), [(None, 3.8), (3.0, 3.8), (4.0, 4.0), (4.0321, 4.0321), (9.0, None)])
def test_a_broken_down_pursuer_captures_no_evader(until, end):
    """An evader comes from 2 m away at 0.5 m/s: it touches the pursuer after 3.8 s, and leaves it after 4.2 s.

    A pursuer repaired within a motion step captures at once.
    """
    comes = Evader(position=(-2.0, 0.0), speed=0.5, strategy=ConstantHeading(angle=0.0))
    fault = () if until is None else (Crash(node=0, start=0.5, end=until),)
    stays = Team(positions=((0.0, 0.0),), speeds=1.0, active_at_start=0.0)
    base = standing(evader=comes, team=stays, protocol=lambda me: iter(()), fault=fault, horizon=9.0)
    (ended,) = desim.run(base).trace.of(Ended)
    assert (ended.reason, seconds(ended.t)) == (("captured", pytest.approx(end)) if end else ("horizon", 9.0))


def test_a_pursuer_of_a_captured_evader_stays_until_its_next_decision():
    """No pursuer decides after the start: both stop at the capture, within a step, and so does what was captured."""

    def once(me):
        me.assign(1)
        yield me.at(1e6)

    team = Team(positions=((0.0, 0.0), (-1.0, 1.0)), speeds=1.0)
    evaders = (
        Evader(position=(2.0, 0.0), speed=0.5, strategy=ConstantHeading(angle=0.0)),
        Evader(position=(0.0, 50.0), speed=0.5, strategy=PureEvasion()),
    )
    keys = {"horizon": 8.0, "record": Recording(trajectory=0.1), "motion": Motion(step=0.5)}
    result = desim.run(standing(team=team, evader=evaders, protocol=once, **keys))
    (captured,) = result.trace.of(Captured)
    after = [sample for sample in result.trace.of(Sampled) if sample.t > captured.t]
    assert seconds(captured.t) == pytest.approx((2.0 - 0.1) / 0.5)
    assert len({(sample.pursuers, sample.evaders[0]) for sample in after}) == 1
    assert after[0].evaders[0] == (pytest.approx(2.0 + 0.5 * 3.8), 0.0)
    assert len({sample.evaders[1] for sample in after}) == len(after)
    assert not [each for each in result.trace.of(Decided) if each.t > 0]


def test_each_evader_flees_its_nearest_pursuer_and_its_chasers():
    """Two teams far apart; the first evader flees active pursuers, and none chases it."""
    team = Team(positions=((0.0, 0.0), (100.0, 0.0)), speeds=1.0)
    evaders = (
        Evader(position=(2.0, 0.0), speed=0.5, strategy=PureEvasion(flees_from="active")),
        Evader(position=(102.0, 0.0), speed=0.5, strategy=PureEvasion(flees_from="active")),
    )
    result = desim.run(standing(team=team, evader=evaders, protocol=chase(2, 2), horizon=1.0))
    last = result.trace.of(Sampled)[-1]
    # Both that chase the second are to its left.
    assert last.evaders == ((2.0, 0.0), (pytest.approx(102.5), 0.0))


def test_captured_and_unknown_evaders_cannot_be_chased():
    seen = []

    def protocol(me):
        if me.id == 0:
            yield from chase(1)(me)
        seen.append(me.options())
        yield me.at(3.0)
        me.assign(1)
        seen.append((me.action, me.options(), me.capture_time(1), me.evaders()))
        with pytest.raises(ValueError, match=r"an action should be 0 or an evader, 1 \.\. 2, got 3"):
            me.assign(3)

    desim.run(standing(2.0, -30.0, team=Team(positions=((0.0, 0.0), (0.0, 9.0)), speeds=1.0), protocol=protocol))
    assert seen == [(0, 1, 2), (0, (0, 2), float("inf"), (2,))]


@pytest.mark.parametrize("payload", ["action", "time", "state"])
def test_announcements_name_the_evader(payload):
    """Teammates know which evader each pursuer chases, and its capture time."""
    seen = []

    def broadcast(me):
        me.assign(me.id + 1)
        me.broadcast()
        yield me.at(0.5)
        others = {j: (me.believed_chasers(j), me.beliefs(evader=j)) for j in me.evaders()}
        seen.append((me.id, others, [me.global_state.capture_times(j) for j in me.evaders()]))
        yield me.at(1e6)

    team = Team(positions=((0.0, 0.0), (0.0, 8.0), (9.0, 9.0)), speeds=1.0, active_at_start=0.0)
    evaders = tuple(Evader(position=(x, 20.0), speed=0.5) for x in (0.0, 10.0, 20.0))
    said = Announcements(payload=payload, trigger="never", reckoning="exact")
    base = standing(
        team=team, evader=evaders, protocol=broadcast, announce=said, motion=Motion(static=True), horizon=1.0
    )
    desim.run(base)
    assert len(seen) == 3
    for me, others, phi in seen:
        for evader, (believed, beliefs) in others.items():
            chaser = evader - 1
            if chaser == me:
                assert believed == {}
            else:
                assert believed == {chaser: pytest.approx(phi[evader - 1][chaser])}
            known = {j: belief.active for j, belief in beliefs.items()}
            assert known == {j: j + 1 for j in range(3) if j != me}
            # An announced capture time is of a known evader.
            times = {j: nan if payload == "time" and j != chaser else phi[evader - 1][j] for j in known}
            assert {j: belief.capture_time for j, belief in beliefs.items()} == pytest.approx(times, nan_ok=True)


@pytest.mark.parametrize("sensing", [Sensing(), Sensing(radius=1e6)], ids=["unlimited", "limited"])
@pytest.mark.parametrize("reckoning", ["exact", "straight_line"])
def test_a_chaser_is_dead_reckoned_towards_its_evader(reckoning, sensing):
    """At 1 m/s from the origin: after 1 s a metre up, where evader 2 stands, not to the right, where evader 1 does."""
    seen = []

    def broadcast(me):
        me.assign(2)
        me.broadcast()
        yield me.at(1.0)
        seen.append((me.id, me.team_estimate(1).positions[0]))

    team = Team(positions=((0.0, 0.0), (50.0, 0.0)), speeds=1.0, active_at_start=0.0)
    evaders = (
        Evader(position=(20.0, 0.0), speed=0.0, strategy=Still()),
        Evader(position=(0.0, 20.0), speed=0.0, strategy=Still()),
    )
    said = Announcements(payload="state", trigger="never", reckoning=reckoning)
    keys = {"team": team, "evader": evaders, "announce": said, "sensing": sensing, "horizon": 2.0}
    desim.run(standing(protocol=broadcast, **keys))
    assert seen == [(me, pytest.approx(1j, abs=1e-12)) for me in (0, 1)]


@pytest.mark.parametrize("exact", [True, False])
def test_a_chaser_is_dead_reckoned_up_to_the_capture_and_no_farther(exact):
    """Two chase an evader; seconds after the capture they are still where they were by then.

    Along the path of the evader that holds for both; straight to where it is, for the one that was right behind it.
    """
    team = Team(positions=((0.0, 0.0), (0.0, -6.0)), speeds=2.0, active_at_start=0.0)
    evaders = (
        Evader(position=(2.0, 0.0), speed=0.9, strategy=ConstantHeading(angle=0.0)),
        Evader(position=(60.0, 60.0), speed=0.9),
    )
    said = Announcements(payload="state")
    parts = world_of(Scenario(team=team, evader=evaders, announce=said))
    clock, state = parts.env, parts.state
    parts.world.begin()
    parts.world.set_action(0, 1), parts.world.set_action(1, 1)
    clock.run(until=SECOND)
    told = state.positions()
    clock.run(until=8 * SECOND)
    assert state.at_large == (2,)
    for pursuer in (0, 1) if exact else (0,):
        for place, age in ((team.positions[pursuer], 8), ((told[pursuer].real, told[pursuer].imag), 7)):
            reckoned = parts.view.reckoned(MotionState(complex(*place)), 2.0, age * SECOND, 1, exact=exact).position
            assert abs(reckoned - state.position(pursuer)) < 1e-9
        # A pursuer that announced it after the capture has not moved since.
        assert parts.view.reckoned(MotionState(3.0 + 4.0j), 2.0, SECOND, 1, exact=exact).position == 3.0 + 4.0j


def test_a_trace_with_several_evaders_reads_back():
    result = desim.run(standing(2.0, -3.0))
    lines = map(line_of, result.trace)
    assert list(events_of(lines, EVENTS)) == result.trace.events


def test_a_trace_with_one_evader_has_the_form_of_any_other():
    result = desim.run(Scenario(horizon=1.0))
    events = [json.loads(line) for line in map(line_of, result.trace)]
    assert {event["event"] for event in events} == {"Started", "Decided", "Sampled", "MessageCounts", "Ended"}
    assert {len(event["evaders"]) for event in events if event["event"] in {"Started", "Sampled"}} == {1}
    started, decided = (
        [event["active"] for event in events if event["event"] == kind] for kind in ("Started", "Decided")
    )
    assert {type(action) for action in (*started[0], *decided)} == {int}


def test_an_action_true_chases_the_first_evader():
    def protocol(me):
        me.assign(True)
        yield me.sleep(0.0)

    decided = desim.run(Scenario(horizon=0.1, protocol=protocol)).trace.of(Decided)
    assert {(type(decision.active), decision.active) for decision in decided} == {(int, 1)}


def test_alike_evaders_start_apart_and_the_first_is_where_one_would_be_and_do_not_move_alike():
    """From one place each wanders as chance has it."""
    one, three = (desim.run(Scenario(horizon=0.1, evader=Evader(count=count)), 4) for count in (1, 3))
    start, starts = one.trace.of(Started)[0], three.trace.of(Started)[0]
    assert (start.evaders[0], start.pursuers) == (starts.evaders[0], starts.pursuers)
    assert len(set(starts.evaders)) == 3
    wander = Evader(count=3, position=(5.0, 5.0), strategy=Diffusion())
    last = desim.run(Scenario(horizon=0.5, team=Team(count=1), evader=wander)).trace.of(Sampled)[-1]
    assert len(set(last.evaders)) == 3


@pytest.mark.slow
def test_a_list_with_one_table_is_that_table(tmp_path):
    path = tmp_path / "one.toml"
    path.write_text("horizon = 2.0\n[[evader]]\nspeed = 0.5\n")
    table = Scenario(horizon=2.0, evader=Evader(speed=0.5))
    one, other = (list(map(line_of, desim.run(each).trace)) for each in (load(path), table))
    assert one == other


@pytest.mark.slow
def test_a_start_at_random_chases_every_evader_alike():
    """Of 4,000 starts of one pursuer a third each, within 4 standard errors of 0.0075. The control has 2 of the 3."""
    base = Scenario(team=Team(count=400, speeds=1.0), evader=Evader(count=3))
    starts = [world_of(base, seed).state.profile for seed in range(10)]
    assert len(set(map(tuple, starts))) == 10
    first = np.concatenate(starts)
    shares = [(first == action).mean() for action in (1, 2, 3)]
    assert max(abs(share - 1 / 3) for share in shares) < 4 * 0.0075
    of_two = (first[first != 3] == 1).mean()
    assert abs(of_two - 1 / 3) > 4 * 0.0075
    assert (first == 0).sum() == 0


def test_a_team_that_is_active_at_the_start_chases_each_of_the_evaders():
    scenario = Scenario(team=Team(count=60), evader=Evader(count=3, speed=0.1), horizon=0.01)
    assert set(desim.run(scenario, 1).trace.of(Started)[0].active) == {1, 2, 3}


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    ("guidance", "order"), [*product(["constant_bearing", "pure_pursuit"], ["evader_first", "simultaneous"])]
)
def test_many_pursuers_go_as_each_of_them_alone(guidance, order, monkeypatch):
    """The velocities of a few pursuers are computed one by one, and those of many at once."""
    game = Scenario(
        horizon=1.0,
        protocol=chase(1, 2, 1),
        team=Team(positions=[(0.0, 0.0), (9.0, 0.0), (4.0, 9.0)], speeds=(2.0, 3.0, 2.5), guidance=guidance),
        evader=(Evader(position=(3.0, 3.0), speed=1.0), Evader(position=(6.0, 4.0), speed=0.8)),
        motion=Motion(step=0.05, order=order),
        record=Recording(trajectory=0.05),
    )
    runs = []
    for size in (0, 100):
        monkeypatch.setattr(steering, "MAX_SCALAR_SIZE", size)
        runs.append(desim.run(game).trace)
    places = [np.array([[*event.pursuers, *event.evaders] for event in trace.of(Sampled)]) for trace in runs]
    assert places[1] == pytest.approx(places[0], abs=1e-9)
    assert 2 in {event.active for event in runs[0].of(Decided)}
