"""What a pursuer observes: what it knows, within bounds, and nothing that has not arrived."""

import numpy as np
import pytest

import desim
from desim import ConstantHeading, Evader, Links, Scenario, Sensing, Still, Team
from desim.pursuit.team.observation import evader_block, observation_bounds, observation_names
from protocols import CBAA, LocalMin, Rounds

STILL = Evader(position=(10.0, 10.0), strategy=Still(), speed=0.0)
PLACES = ((0.0, 0.0), (3.0, 0.0), (100.0, 0.0))


def apart(**changes):
    """Two neighbours and a pursuer out of their range; positions are announced, and the evader stands still."""
    scenario = Scenario(
        horizon=20.0,
        team=Team(count=3, positions=PLACES, active_at_start=0.0, speeds=2.0),
        evader=STILL,
        protocol=LocalMin(schedule=Rounds(period=0.5)),
        network=Links(latency=0.1, range=20.0),
    )
    return scenario.with_({"announce.payload": "state"} | changes)


def observed(scenario, far_action, near_action=0, steps=6, **options):
    """All observations of pursuers 0 and 1, where the far pursuer takes an action in each round."""
    env = desim.parallel_env(scenario, 1, **options)
    shown, _ = env.reset()
    rows = [shown]
    for _ in range(steps):
        shown, *_ = env.step({"pursuer_0": 0, "pursuer_1": near_action, "pursuer_2": far_action})
        rows.append(shown)
    return env, np.array([[row["pursuer_0"], row["pursuer_1"]] for row in rows])


def test_nothing_is_known_of_what_has_not_arrived():
    _, inactive = observed(apart(), 0)
    env, active = observed(apart(), 1)
    assert np.array_equal(inactive, active)
    heard = env.observation_names.index("pursuer_2.heard")
    assert not active[:, :, heard].any()


def test_a_change_that_arrives_is_known():
    """The control: within range, the same change is observed, one latency later."""
    _, inactive = observed(apart(**{"network.range": float("inf")}), 0)
    env, active = observed(apart(**{"network.range": float("inf")}), 1)
    differs = (inactive != active).any(axis=(1, 2))
    assert differs.tolist() == [False] + [True] * 6
    action, age = (env.observation_names.index(f"pursuer_2.{field}") for field in ("action", "age"))
    assert active[1, 0, action] == 1.0
    assert 0.1 <= active[1, 0, age] <= 0.5  # it is repeated by heartbeats


def test_an_omniscient_observation_knows_it():
    _, inactive = observed(apart(), 0, omniscient=True)
    env, active = observed(apart(), 1, omniscient=True)
    assert not np.array_equal(inactive, active)
    rivals = env.observation_names.index("evader_1.rivals")
    assert active[1, 0, rivals] == 1.0
    assert "pursuer_2.age" in env.observation_names


def test_numbers_are_those_of_the_agent():
    env, rows = observed(apart(), 0, near_action=1)
    me, names = env.pursuer("pursuer_0"), env.observation_names
    seen = dict(zip(names, rows[-1, 0].tolist(), strict=True))
    assert (seen["own.x"], seen["own.y"], seen["own.action"], seen["own.speed"]) == (0.0, 0.0, 0.0, 2.0)
    assert seen["own.time_left"] == pytest.approx(me.time_left())
    assert (seen["evader_1.dx"], seen["evader_1.dy"]) == (10.0, 10.0)
    assert seen["evader_1.capture_time"] == pytest.approx(me.capture_time())
    (rival,) = me.believed_chasers().values()
    assert seen["evader_1.rivals"] == 1.0
    assert seen["evader_1.free"] == 0.0
    assert seen["evader_1.lead"] == pytest.approx(np.tanh(me.capture_time() - rival), abs=1e-6)
    assert seen["evader_1.late"] == pytest.approx(np.tanh((me.capture_time() - me.time_left()) / 5.0), abs=1e-6)
    body = me.latest_records()[1].body
    assert (seen["pursuer_1.dx"], seen["pursuer_1.dy"]) == pytest.approx((body.x, body.y))
    assert seen["pursuer_1.located"] == 1.0
    assert (seen["pursuer_0.age"], seen["pursuer_0.heard"], seen["pursuer_0.action"]) == (0.0, 1.0, 0.0)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("omniscient", [False, True])
@pytest.mark.parametrize("action", [1, 0, 2])
def test_the_evader_that_a_pursuer_chases_is_the_one_that_it_has_chosen(action, omniscient):
    env, rows = observed(apart(evader=(STILL, STILL)), 0, near_action=action, omniscient=omniscient)
    chosen = [env.observation_names.index(f"evader_{evader}.chosen") for evader in (1, 2)]
    assert rows[-1, 1, chosen].tolist() == [float(action == evader) for evader in (1, 2)]
    assert rows[-1, 0, chosen].tolist() == [0.0, 0.0]


def test_a_teammate_that_is_sensed_is_where_it_is_without_a_message():
    env, rows = observed(apart(**{"announce.payload": "action"}), 0, steps=1)
    seen = dict(zip(env.observation_names, rows[-1, 0].tolist(), strict=True))
    assert [seen[f"pursuer_2.{name}"] for name in ("heard", "located", "dx", "dy")] == [0.0, 1.0, 100.0, 0.0]


@pytest.mark.parametrize("payload", ["action", "time", "state", "course"])
@pytest.mark.parametrize("protocol", [LocalMin(), CBAA()])
def test_each_payload_is_observed_within_the_bounds(payload, protocol):
    changes = {"announce.payload": payload, "protocol": protocol, "evader": (Evader(), Evader(speed=0.5))}
    if payload == "course":
        changes["team.dynamics"] = {"kind": "acceleration", "limit": 5.0}
    scenario = Scenario(horizon=1.0, team=Team(count=4)).with_(changes)
    env = desim.env(scenario, 1)
    env.reset()
    for agent in env.agent_iter():
        space = env.observation_space(agent)
        assert np.isfinite(space.low).all()
        assert np.isfinite(space.high).all()
        numbers, _, terminated, truncated, _ = env.last()
        assert space.contains(numbers)
        env.step(None if terminated or truncated else 1)


def test_the_bounds_are_those_of_players_within_an_extent():
    """Two players, each at most 3 m from the centre in each coordinate, differ by at most 6 m."""
    names = observation_names(2, 1)
    bounds = observation_bounds(2, 1, horizon=7.0, extent=3.0, centre=1.0 - 2.0j, top_speed=1.5)
    of = dict(zip(names, zip(*bounds, strict=True), strict=True))
    assert (of["own.x"], of["own.y"]) == ((-2.0, 4.0), (-5.0, 1.0))
    assert {of["evader_1.dx"], of["evader_1.dy"], of["pursuer_0.dx"], of["pursuer_1.dy"]} == {(-6.0, 6.0)}
    assert of["evader_1.uncertainty"] == (0.0, 6.0)
    assert (of["evader_1.xx"], of["evader_1.xy"]) == ((0.0, 36.0), (-36.0, 36.0))
    assert (of["own.speed"], of["own.time_left"], of["pursuer_0.age"]) == ((0.0, 1.5), (0.0, 7.0), (0.0, 7.0))


def test_covariances_are_those_of_the_filter():
    scenario = Scenario(horizon=2.0, team=Team(count=3), protocol=LocalMin()).with_(
        {"sensing.radius": 100.0, "sensing.noise": 0.5, "sensing.estimator": {"kind": "kalman"}}
    )
    env = desim.env(scenario, 1)
    env.reset()
    for _ in range(12):
        env.step(0)
    seen = dict(zip(env.observation_names, env.observe("pursuer_0").tolist(), strict=True))
    assert 0.0 < seen["evader_1.xx"] < 1.0
    assert env.pursuer("pursuer_0").errors()[1] == pytest.approx(
        (seen["evader_1.xx"], seen["evader_1.xy"], seen["evader_1.yy"])
    )


def test_an_omniscient_observation_has_the_true_place_and_another_the_estimated_one():
    scenario = Scenario(horizon=2.0, team=Team(count=3), protocol=LocalMin()).with_(
        {"sensing.radius": 100.0, "sensing.noise": 0.5, "sensing.estimator": {"kind": "kalman"}}
    )
    env = desim.env(scenario, 1)
    env.reset()
    for _ in range(6):
        env.step(0)
    me = env.pursuer("pursuer_0")
    truth, estimated = me.global_state.evader(1) - me.position(), me.evader(1) - me.position()
    assert truth != estimated
    for omniscient, offset in ((True, truth), (False, estimated)):
        block = evader_block(me, 1, omniscient=omniscient)
        assert complex(block.dx, block.dy) == offset


def test_a_teammate_that_announces_no_capture_time_claims_none():
    """With positions announced, the block of a teammate has no claim; with times, it has the time."""
    for payload, claims in (("state", {0.0}), ("time", None)):
        env, rows = observed(apart(**{"announce.payload": payload}), 0, near_action=1)
        claim = env.observation_names.index("pursuer_1.claim")
        assert claims is None or set(rows[:, 0, claim].tolist()) == claims
        assert (rows[-1, 0, claim] > 0.0) == (claims is None)


@pytest.mark.parametrize(("offset", "age"), [(-100.0, 20.0), (0.0, 0.5), (100.0, 0.0)])
def test_an_age_by_clocks_that_differ_is_between_0_and_the_horizon(offset, age):
    """The clock of the sender is ahead by an offset; its last record is half a second old."""
    clocks = {"kind": "clock_skew", "node": 1, "offset": offset}
    env, rows = observed(apart(fault=[clocks], **{"announce.heartbeat": 100.0}), 0, near_action=1, steps=1)
    numbers = dict(zip(env.observation_names, rows[-1, 0].tolist(), strict=True))
    assert (numbers["pursuer_1.heard"], numbers["pursuer_1.age"]) == (1.0, pytest.approx(age, abs=1e-6))


@pytest.mark.parametrize(("estimate", "is_uncertain"), [("worst_case", True), ("hold", False)])
def test_the_uncertainty_of_an_estimate_is_that_of_the_worst_case(estimate, is_uncertain):
    """An evader at 1 m/s that has left the range of the sensors may be as far away as it can have come."""
    scenario = Scenario(
        horizon=9.0,
        team=Team(positions=((2.0, 2.0), (2.0, -2.0)), speeds=2.0),
        evader=Evader(position=(0.0, 0.0), strategy=ConstantHeading(), speed=1.0),
        sensing=Sensing(radius=3.0, estimate=estimate),
        protocol=LocalMin(schedule=Rounds(period=0.5)),
    )
    env = desim.parallel_env(scenario, 1)
    env.reset()
    for _ in range(12):
        env.step({"pursuer_0": 0, "pursuer_1": 0})
    uncertainty, covariance = env.pursuer("pursuer_0").errors()
    assert (uncertainty > 0.0, tuple(covariance)) == (is_uncertain, (0.0, 0.0, 0.0))
