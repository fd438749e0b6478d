"""Where players are, and how soon they capture: asked for one, some or all, the answer is the same to the last bit."""

from functools import partial
from math import inf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import Scenario, run
from desim.kernel.core.clock import Clock
from desim.kernel.core.units import SECOND
from desim.kernel.models.links import Links
from desim.pursuit.core.events import Ended
from desim.pursuit.core.state import lengths
from desim.pursuit.evaders import evader
from desim.pursuit.evaders.evasion import Still
from desim.pursuit.motion.dynamics import Acceleration, Courses, TurnRate
from desim.pursuit.motion.guidance import ConstantBearing, PurePursuit
from desim.pursuit.motion.inertia import InertialKinematics
from desim.pursuit.motion.kinematics import Kinematics
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion
from desim.simulation import steering
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import SharedSeed
from tests.worlds import world_of

numbers = st.floats(-10.0, 10.0)
plane = st.builds(complex, numbers, numbers)
teams = st.lists(plane, min_size=4, max_size=4).map(np.array)


@given(st.lists(st.builds(complex, st.floats(-1e9, 1e9), st.floats(-1e9, 1e9)), max_size=20))
def test_the_lengths_of_many_are_those_of_each(vectors):
    assert lengths(np.array(vectors, dtype=complex)).tolist() == [abs(vector) for vector in vectors]


@given(teams, st.lists(st.tuples(st.integers(0, 3 * SECOND), st.none() | teams), max_size=6), st.data())
def test_one_some_and_all_are_at_the_same_places(start, moments, data):
    """At each moment some of the players are asked for first, in any way; then all; new pieces may begin."""
    env = Clock()
    players, now = Kinematics(env, start), 0
    places, since, velocities = start, 0, np.zeros(4)
    for later, heading in moments:
        now += later + 1
        env.run(until=now)
        expected = places + velocities * ((now - since) / SECOND)
        if data.draw(st.booleans()):
            assert [players.position(k) for k in range(4)] == expected.tolist()
            assert players.positions_of([2, 0]).tolist() == expected[[2, 0]].tolist()
            assert players.distances(3, [1, 0]) == [abs(expected[3] - expected[k]) for k in (1, 0)]
        assert players.positions().tolist() == expected.tolist()
        assert players.distances(3, [1, 0]) == [abs(expected[3] - expected[k]) for k in (1, 0)]
        assert [players.position(k) for k in range(4)] == players.positions_of(range(4)).tolist() == expected.tolist()
        if heading is not None:
            players.command(heading)
            places, since, velocities = expected, now, heading


@pytest.mark.parametrize("limit", [None, 2.0])
def test_players_that_are_observed_go_on_as_those_observed(limit):
    """Frames of a live run: motions, and curves of players with inertia, are continued from a moment ago."""
    rng = np.random.default_rng(3)
    starts, commands, drifts = (rng.normal(size=4) + 1j * rng.normal(size=4) for _ in range(3))

    def players_at(env):
        if limit is None:
            return Kinematics(env, starts.copy())
        dynamics = [Acceleration(limit=limit)] * 4
        return InertialKinematics(env, starts.copy(), dynamics, np.ones(4, dtype=complex))

    there, here = Clock(), Clock()
    players, mirror = players_at(there), players_at(here)
    there.advance(SECOND // 10)
    players.command(commands, drifts)
    there.advance(SECOND // 5)
    seen = there.now, players.positions().copy(), players.courses(range(4)), players.commands, players.drifts
    here.advance(there.now + 7)  # it learns of it later
    mirror.observe(*seen)
    for env in (there, here):
        env.advance(SECOND)
    np.testing.assert_allclose(mirror.positions(), players.positions(), rtol=0.0, atol=1e-9)
    assert mirror.position(2) == pytest.approx(players.position(2), abs=1e-9)
    assert mirror.velocity(1) == pytest.approx(players.velocity(1), abs=1e-9)


@pytest.mark.parametrize("dynamics", [None, Acceleration(limit=1.0), TurnRate(limit=0.7)])
@pytest.mark.parametrize("is_cached", [False, True])
def test_distances_within_a_step_are_those_of_the_positions(dynamics, is_cached):
    env, start = Clock(), np.array([0j, 3.0 + 1j, -2.0 + 4j])
    headings = np.ones(3, dtype=complex)
    players = Kinematics(env, start) if dynamics is None else InertialKinematics(env, start, [dynamics] * 3, headings)
    players.command(np.array([1j, -1.0 + 0j, -1j]))
    env.run(until=SECOND // 3)
    expected = [abs(players.position(0) - players.position(other)) for other in (1, 2)]
    if is_cached:
        players.positions()
    assert players.distances(0, [1, 2]) == pytest.approx(expected, rel=1e-14)
    assert expected != pytest.approx([abs(start[0] - start[1]), abs(start[0] - start[2])], rel=1e-3)


def test_players_of_a_static_game_stay_and_positions_are_read_only():
    env, places = Clock(), np.array([1j, 2j])
    players = Kinematics(env, places, static=True)
    players.command(np.array([1.0 + 0j, 1.0 + 0j]))
    env.run(until=SECOND)
    assert players.positions().tolist() == [players.position(0), players.position(1)] == [1j, 2j]
    moving = Kinematics(env, np.array([1j, 2j]))
    moving.command(np.array([1.0 + 0j, 1.0 + 0j]))
    env.run(until=2 * SECOND)
    for read_only in (players.positions(), moving.positions()):
        with pytest.raises(ValueError, match="read-only"):
            read_only[0] = 0j


@pytest.mark.parametrize("known", [True, False], ids=["state known", "state unknown"])
@pytest.mark.parametrize("count", [1, evader.MAX_SCALAR_SIZE, evader.MAX_SCALAR_SIZE + 1])
def test_times_of_capture_of_some_are_those_of_all(known, count):
    """One of the pursuers is too slow; the evader runs, so that no position is unchanged."""
    speeds = tuple([0.5] + [1.0 + k / 10 for k in range(19)])
    parts = world_of(Scenario(team=Team(count=20, speeds=speeds), horizon=3.0), 4)
    parts.world.begin()
    parts.env.run(until=1_234_567_891)
    some = list(range(count))
    if known:
        parts.view.capture_times(1)
    few = parts.view.capture_times_of(some, 1)
    assert few == list(parts.view.capture_times(1)[:count])
    assert few[0] == inf
    assert all(0.0 < each < inf for each in few[1:])


@pytest.mark.parametrize("within_step", [0, 4_567_891])
@pytest.mark.parametrize("dynamics", [TurnRate(limit=1.5), Acceleration(limit=2.0)])
def test_times_of_some_are_those_of_all_with_inertia(dynamics, within_step):
    """Some chase and turn, others have stopped, and one is too slow."""
    team = Team(count=9, speeds=(0.5, *(1.0 + k / 10 for k in range(8))), dynamics=dynamics, active_at_start=0.5)
    parts = world_of(Scenario(team=team, horizon=3.0), 4)
    parts.world.begin()
    parts.env.run(until=SECOND + within_step)
    some = [6, 0, 3]
    few = parts.view.capture_times_of(some, 1)
    every = parts.view.capture_times(1)
    assert few == [every[pursuer] for pursuer in some]
    assert few[1] == inf
    assert len(set(every)) == 9


@pytest.mark.slow_but_one
@pytest.mark.parametrize("law", [PurePursuit(), ConstantBearing()])
@pytest.mark.parametrize("evaders", [1, 3])
@pytest.mark.parametrize("order", ["evader_first", "simultaneous"])
def test_pursuers_led_one_by_one_run_as_a_team_led_at_once(monkeypatch, law, evaders, order):
    """The same trace, whatever number of pursuers counts as few."""
    team = Team(count=12, guidance=law, active_at_start=0.7)
    base = Scenario(team=team, evader=Evader(count=evaders), motion=Motion(order=order), horizon=2.0)
    schedule = SharedSeed(slot=0.003)
    play = partial(run, base.model_copy(update={"protocol": SpatialAdaptivePlay(schedule=schedule)}))
    traces = []
    for few in (0, 5, 99):
        monkeypatch.setattr(steering, "MAX_SCALAR_SIZE", few)
        monkeypatch.setattr(evader, "MAX_SCALAR_SIZE", few)
        traces.append(list(play().trace))
    assert traces[0] == traces[1] == traces[2]
    assert len(traces[0]) > 600


def test_a_clock_that_runs_past_the_horizon_comes_to_its_end():
    """No motion step begins at the horizon, so time goes on."""
    parts = world_of(Scenario(horizon=1.0, team=Team(count=3)))
    parts.world.begin()
    parts.env.run(until=2 * SECOND)
    assert parts.end.outcome is not None
    assert parts.end.outcome.t == SECOND


@pytest.mark.slow
@pytest.mark.parametrize("frozen", [False, True])
def test_the_network_links_distant_pursuers_as_they_approach(frozen):
    """600 of them, more than are all looked at, on a line 10 m apart; one runs 95 m along it, linked all the way."""
    seen, size = {}, 600
    runner = size - 1
    positions = [(10.0 * k, 0.0) for k in range(runner)] + [(0.0, 3.0)]

    def protocol(me):
        for k in range(20):
            yield me.at(0.5 * k)
            if me.id == runner:
                me.assign(True)
                seen[k] = me.neighbours()

    team = Team(positions=positions, speeds=[0.0] * runner + [10.0], active_at_start=0.0)
    run(
        Scenario(
            horizon=9.9,
            team=team,
            evader=Evader(position=(5000.0, 3.0), speed=0.0, strategy=Still()),
            protocol=protocol,
            network=Links(range=12.0),
            motion=Motion(step=0.1, static=frozen),
            announce=Announcements(trigger="never"),  # nobody listens
        )
    )
    for k, near in seen.items():
        x = 0.0 if frozen else 5.0 * k
        assert near == [j for j in range(runner) if (10.0 * j - x) ** 2 + 9.0 <= 144.0]
    assert len(seen) == 20


def test_an_immobile_pursuer_never_captures_a_stationary_evader():
    """Nor is anything divided by how fast they come nearer."""
    still = Team(positions=[(0.0, 0.0), (3.0, 0.0)], speeds=0.0)
    end = run(Scenario(team=still, evader=Evader(position=(1.0, 0.0), speed=0.0), horizon=1.0, prune="none")).trace
    assert end.of(Ended)[0].reason == "horizon"


@pytest.mark.parametrize("gap", [0.0, 1e-17, 1e-6, 0.3])
def test_a_capture_is_foreseen_whenever_it_can_come_first(gap):
    """A pursuer of 1 m/s, which has the evader in reach as it begins, or reaches it after the gap (m) exactly."""
    team = Team(positions=[(0.1 + gap, 0.0)], speeds=1.0)
    (end,) = run(Scenario(team=team, evader=Evader(position=(0.0, 0.0), speed=0.0), protocol=chase)).trace.of(Ended)
    assert end.reason == "captured"
    assert end.t == pytest.approx(gap * SECOND, abs=1.0)


def chase(me):
    """Chase from the start on."""
    yield me.at(0.0)
    me.assign(True)


def test_positions_at_times_of_the_present_piece_are_those_of_these_times():
    env, told = Clock(), []
    players = Kinematics(env, np.array([0j, 1 + 1j, 3j]))
    players.before_change(lambda: told.append((env.now, players.commands.tolist())))
    for start, velocities in ((SECOND // 3, [1 / 3, 2j, -1 + 0.1j]), (SECOND, [0.7, 1j, 1 + 0.3j])):
        env.run(until=start)
        players.command(np.array(velocities, dtype=complex))
    times = [SECOND, SECOND + 1, SECOND + 123_456_789, 2 * SECOND]
    seen = []
    for now in times:
        env.run(until=now) if now > env.now else None
        seen.append(players.positions_of([0, 1, 2]).tolist())
    for player in range(3):
        there = players.positions_at(np.full(4, player), np.array(times))
        assert there.tolist() == [positions[player] for positions in seen]
    assert told == [(SECOND // 3, [0, 0, 0]), (SECOND, [1 / 3, 2j, -1 + 0.1j])]


@pytest.mark.parametrize("drifts", [None, np.array([0.5j, 1 + 0j])])
@pytest.mark.parametrize("inertial", [False, True])
def test_what_is_observed_elsewhere_replaces_the_motions_after_a_call_that_sees_the_old_ones(inertial, drifts):
    """Half a second after the observation, players are half a second farther; those with inertia have none to lose."""
    env, told, start = Clock(), [], np.array([0j, 1 + 1j])
    kinds = [Acceleration(limit=1.0)] * 2
    players = InertialKinematics(env, start, kinds, np.ones(2, complex)) if inertial else Kinematics(env, start)
    players.before_change(lambda: told.append(players.positions().tolist()))
    env.run(until=SECOND)
    places, commands = np.array([4 + 0j, 2j]), np.array([1j, -2 + 0j])
    players.observe(SECOND // 2, places, Courses(commands, commands), commands, drifts)
    assert told == [start.tolist()]
    expected = places + (commands + (0 if drifts is None else drifts)) / 2
    assert players.positions().tolist() == pytest.approx(expected.tolist())
    assert players.positions_of([1]).tolist() == pytest.approx(expected[1:].tolist())
    assert not places.flags.writeable
