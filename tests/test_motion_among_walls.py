"""Runs among walls that block motion: capture times, strategies, dead reckoning, what is refused, and the watcher."""

from cmath import phase, rect
from math import inf, pi

import numpy as np
import pytest

from desim import Scenario, run, summary
from desim.kernel.core.events import Trace
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import SECOND
from desim.pursuit.core.events import Captured, Decided, Sampled, Started
from desim.pursuit.core.state import complex_points
from desim.scenario.checks import warnings
from desim.scenario.overrides import ScenarioError
from desim.testing.paths import PathWatcher
from desim.testing.pursuits import PotentialWatcher, watched

LINE = {"line": [[0.0, -5.0], [0.0, 50.0]], "blocks": ["motion"]}
"""A wall between two places .5 m from (0, 0); the way round its lower end is the shorter one."""
SPEED, EVADER_SPEED, RADIUS = 2.0, 0.9, 0.1
DUEL = {
    "team.count": 1,
    "team.speeds": SPEED,
    "team.positions": [[-0.5, 0.0]],
    "evader.position": [0.5, 0.0],
    "evader.speed": EVADER_SPEED,
    "capture.radius": RADIUS,
    "horizon": 60.0,
    "motion.step": 0.1,
    "protocol": {"kind": "best_response"},
    "wall": [LINE],
}


def scenario(changes=None, **keys):
    return Scenario().with_(DUEL | (changes or {}) | keys)


def bound(made, seed, evader=0):
    """Return the least bound (d_geo - eps) / (v - v_e) of the pursuers, s."""
    space, one = made.space, made.evaders[evader]
    place = complex(*one.start(seed, evader, space))
    distances = space.distances(complex_points(made.team.start(seed, space)), place)
    closing = np.array(made.team.all_speeds()) - one.speed
    return float((np.maximum(distances - made.capture.radius, 0.0) / closing).min())


def erratic(state, rng):
    """Run in a new random direction at each step."""
    return rect(1.0, rng.uniform(0.0, 2.0 * pi))


def stopping(state, rng):
    """Flee along the path of the nearest pursuer, or stand still, by chance."""
    away = state.offsets[state.nearest] / max(state.distances[state.nearest], 1e-9)
    return complex(away) if rng.random() < 0.7 else 0j


STRATEGIES = [
    *({"kind": kind} for kind in ("pure_evasion", "weighted_flee", "max_geodesic", "hide", "zigzag", "diffusion")),
    {"kind": "constant_heading"},
    {"kind": "listener", "normally": {"kind": "max_geodesic"}},
    erratic,
    stopping,
]


def boxes(seed, *blocks):
    """Return 12 random boxes, with gaps between them, that block motion and anything else."""
    rng, walls = np.random.default_rng(seed), []
    for k in range(12):
        x, y = (k % 4) * 5.0 + rng.uniform(0.3, 2.0), (k // 4) * 6.0 + rng.uniform(0.3, 2.0)
        w, h = rng.uniform(0.5, 2.8, 2)
        walls.append({"polygon": [[x, y], [x + w, y], [x + w, y + h], [x, y + h]], "blocks": ["motion", *blocks]})
    return walls


def pursuit(seed):
    """Return a random pursuit among boxes: one of the strategies, and one pursuer that sees through walls."""
    rng, strategy = np.random.default_rng(1_000 + seed), STRATEGIES[seed % len(STRATEGIES)]
    hides = isinstance(strategy, dict) and strategy["kind"] == "hide"
    return Scenario().with_(
        {
            "team.count": 1,
            "team.speeds": float(rng.uniform(1.2, 3.0)),
            "team.box": [0.0, 19.0],
            "evader.box": [0.0, 19.0],
            "evader.strategy": strategy,
            "horizon": 200.0,
            "motion.step": 0.05,
            "protocol": {"kind": "centralised"},
            "wall": boxes(seed, *(["sight"] if hides else [])),
        }
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_no_strategy_outlasts_the_bound(seed):
    made = pursuit(seed)
    assert summary(watched(made, seed)).capture_time <= bound(made, seed) + 1e-6


@pytest.mark.whole
def test_no_strategy_outlasts_the_bound_in_200_pursuits():
    shares = []
    for seed in range(200):
        made = pursuit(seed)
        limit = bound(made, seed)
        shares.append(summary(run(made, seed)).capture_time / limit if limit else 0.0)
    assert max(shares) <= 1.0 + 1e-6
    assert np.mean(np.array(shares) > 1.0 - 1e-6) > 0.1  # it is attained


def test_an_evader_that_flees_along_the_prolonged_path_is_captured_exactly_at_the_bound():
    """d_geo = 10.049876 m, phi = 9.045341 s; the straight line would give .818182 s."""
    along = phase(0.5 + 5j)
    fleeing = scenario({"evader.strategy": {"kind": "constant_heading", "angle": along}, "record.trajectory": 0.05})
    for made in (fleeing, scenario()):
        captured = summary(watched(made, 0)).capture_time
        assert captured == pytest.approx(bound(made, 0), abs=1e-7)
        assert captured == pytest.approx(9.045341 + 5e-7, abs=1e-6)
    straight = (1.0 - RADIUS) / (SPEED - EVADER_SPEED)
    assert straight == pytest.approx(0.818182, abs=5e-7)
    assert captured > 10.0 * straight
    open_plane = scenario(wall=[])
    assert summary(run(open_plane, 0)).capture_time == pytest.approx(straight, abs=1e-7)


def test_pursuers_expect_the_time_of_the_path():
    made, phi = scenario(), []

    def rule(me):
        phi.append(me.capture_time())
        me.assign(1)
        yield me.sleep(100.0)

    run(made.with_({"protocol": rule}), 0)
    assert phi[0] == pytest.approx(bound(made, 0), abs=1e-12)


FAR = {"line": [[900.0, 0.0], [900.0, 9.0]], "blocks": ["motion"]}
"""A wall that no line between players meets."""
REPORTED = {
    **{"sensing.radius": 3.5, "sensing.estimate": "constant_velocity", "sensing.relay": True},
    "evader.strategy": {"kind": "constant_heading", "angle": 1.0},
}
"""One of two pursuers does not see the evader, and goes where the reports of the other let it expect the evader."""
IN_THE_PLANE = {
    "evader reported": REPORTED,
    "as it is": {},
    "evader reported, all move at once": REPORTED | {"motion.order": "simultaneous"},
    "evader reported, and held": REPORTED | {"sensing.estimate": "hold"},
    "noise": {"sensing.noise": 0.1, "sensing.estimate": "hold"},
    "tracked": {"sensing.noise": 0.1, "sensing.estimator": {"kind": "alpha_beta"}},
    "all move at once": {"motion.order": "simultaneous"},
    "late to react": {"evader.reaction_delay": 0.2},
    "near-sighted evader": {"evader.sensing_range": 1.5},
    "dead reckoning": {"announce.payload": "state", "announce.reckoning": "straight_line"},
    **{kind: {"evader.strategy": {"kind": kind}} for kind in ("weighted_flee", "zigzag", "diffusion", "max_geodesic")},
}
"""Features of a pursuit, each with what depends on paths: what walls change must not be changed by one far away."""


@pytest.mark.slow_but_one
@pytest.mark.parametrize("name", IN_THE_PLANE)
def test_a_wall_far_away_changes_nothing(name):
    two = {"team.count": 2, "team.speeds": [4.0, 1.5], "team.positions": [[-4.0, 0.0], [0.0, 3.0]]}
    rest = {"horizon": 8.0, "motion.step": 0.1, "evader.strategy": {"kind": "pure_evasion"}, "record.trajectory": 0.1}
    plain = scenario(two | rest | IN_THE_PLANE[name] | {"wall": []})
    free, walled = run(plain).trace, run(plain.with_({"wall": [FAR]})).trace
    ends = [trace.of(Captured)[0].t for trace in (free, walled)]
    assert ends[1] == pytest.approx(ends[0], abs=2)
    samples = [[event for event in trace.of(Sampled) if event.t < min(ends)] for trace in (free, walled)]
    places = [np.array([[*event.pursuers, *event.evaders] for event in some]) for some in samples]
    assert places[1] == pytest.approx(places[0], abs=1e-9)
    assert len(places[0]) > 5


@pytest.mark.slow_but_one
@pytest.mark.parametrize("order", ["simultaneous", "evader_first"])
@pytest.mark.parametrize("strategy", ["pure_evasion", "max_geodesic", "still"])
def test_an_evader_is_captured_within_the_bound_however_long_the_motion_step(strategy, order):
    """A pursuer keeps its speed through its aim: at the end of a step, the evader may be farther than the radius."""
    changes = {"team.positions": None, "evader.position": None, "capture.radius": 0.02, "horizon": 20.0}
    changes |= {"evader.strategy": {"kind": strategy}, "motion.order": order, "team.count": 2}
    for seed in range(6):
        made = scenario(changes, **{"wall": boxes(seed), "motion.step": (0.05, 0.1, 0.2)[seed % 3]})
        captured = run(made, seed).trace.of(Captured)
        assert captured, seed
        assert captured[0].t / SECOND <= bound(made, seed) * (1.0 + 1e-6) + 1e-6, seed


@pytest.mark.parametrize("order", ["simultaneous", "evader_first"])
@pytest.mark.parametrize("behind", [0.01, 0.05, 0.5])
def test_a_wall_behind_an_evader_does_not_slow_its_pursuer(behind, order):
    """The pursuer could go .4 m in a step, and is captured after .3 m - eps, wherever the wall behind it is."""
    wall = {"line": [[0.3 + behind, -1.0], [0.3 + behind, 1.0]], "blocks": ["motion"]}
    near = {"team.positions": [[0.0, 0.0]], "evader.position": [0.3, 0.0], "wall": [wall], "motion.order": order}
    made = scenario(near | {"evader.strategy": {"kind": "still"}, "motion.step": 0.2})
    assert summary(watched(made, 0)).capture_time == pytest.approx((0.3 - RADIUS) / SPEED, abs=1e-9)


def test_nothing_is_captured_through_a_wall():
    """At a distance of .04 m, within the radius: the evader stands still, so the time is the length of the way."""
    near = {"team.positions": [[-0.02, 0.0]], "evader.position": [0.02, 0.0], "evader.strategy": {"kind": "still"}}
    near |= {"wall": [LINE | {"line": [[0.0, -1.0], [0.0, 50.0]]}]}
    made = scenario(near)
    assert summary(watched(made, 0)).capture_time == pytest.approx((2.0 - RADIUS) / SPEED, abs=1e-3)
    assert summary(run(scenario(near, wall=[]), 0)).capture_time == 0.0
    sampled = scenario(near, **{"capture.test": "sample", "motion.step": 0.01})
    assert 0.0 <= summary(run(sampled, 0)).capture_time - summary(run(made, 0)).capture_time <= 0.01


def test_an_evader_is_captured_round_a_corner_when_the_path_is_short_enough():
    """Both stand .04 m from the end of a wall, .03 m from its line: the path is .1 m, the straight line .06 m."""
    near = {"team.positions": [[-0.03, -4.96]], "evader.position": [0.03, -4.96], "evader.strategy": {"kind": "still"}}
    assert summary(run(scenario(near), 0)).capture_time == pytest.approx(0.0, abs=1e-9)
    shorter = scenario(near, **{"capture.radius": 0.08})
    assert summary(run(shorter, 0)).capture_time == pytest.approx(0.02 / SPEED, abs=1e-8)


@pytest.mark.slow
def test_an_evader_slides_along_a_wall_and_stays_on_its_side():
    made = scenario(
        {
            "evader.strategy": {"kind": "constant_heading", "angle": pi - 1.0},
            "horizon": 3.0,
            "team.speeds": 0.0,
            "record.trajectory": 0.1,
        }
    )
    places = [complex(*event.evaders[0]) for event in watched(made, 0).trace.of(Sampled)]
    assert places[-1].real == pytest.approx(0.0, abs=2e-8)
    assert all(place.real > 0.0 for place in places)
    assert places[-1].imag == pytest.approx(3.0 * EVADER_SPEED * np.sin(1.0), abs=1e-6)


def test_the_path_of_a_teammate_is_retraced_round_corners():
    """What is extrapolated from an announced start is where the teammate is, also while it turns within a step."""
    found = []

    def rule(me):
        me.assign(1)
        yield me.sleep(0.5)
        while me.now < 6.0:
            yield me.sleep(0.0617)
            state = me.global_state.state
            start = starts.setdefault(me.id, (me.now, state.motion(me.id)))
            age = round((me.now - start[0]) * 1e9)
            reckoned = me.global_state.reckoned(start[1], state.speed(me.id), age, 1, exact=True)
            found.append(abs(reckoned.position - state.position(me.id)))

    starts = {}
    made = scenario({"announce.payload": "state", "motion.step": 0.1}).with_({"protocol": rule})
    run(made, 0)
    assert len(found) > 50
    assert max(found) < 1e-7


ROOM = {"line": [[3, 3], [7, 3], [7, 7], [3, 7], [3, 3]], "blocks": ["motion"]}


def test_nobody_captures_through_a_wall_without_a_way_round():
    """At distances of .04 m, through a wall of the room, and of .06 m in it, whose pursuer captures at once."""
    near = {"team.positions": [[2.98, 5.0], [3.08, 5.0]], "evader.position": [3.02, 5.0], "wall": [ROOM]}
    made = scenario(near, **{"team.count": 2, "evader.strategy": {"kind": "still"}, "horizon": 1.0})
    assert [event.capturer for event in run(made, 0).trace.of(Captured)] == [1]
    alone = made.with_({"team.count": 1, "team.positions": [[2.98, 5.0]]})
    assert not run(alone, 0).trace.of(Captured)
    assert run(alone.with_({"wall": []}), 0).trace.of(Captured)


def test_an_evader_that_walls_enclose_is_told_and_not_chased():
    enclosed = {"evader.position": [5.0, 5.0], "team.positions": [[0.0, 0.0], [1.0, 9.0]], "wall": [ROOM]}
    made = scenario(enclosed, **{"team.count": 2, "horizon": 2.0})
    (warning,) = [text for key, text in warnings(made) if key == "wall"]
    assert warning == (
        "no pursuer can reach the evader with seed 0: walls that block motion enclose it or them, so phi is inf"
    )
    result = watched(made, 0)
    assert not any(event.active for event in result.trace.of(Decided))
    assert summary(result).active_time == 0.0
    inside = made.with_({"team.positions": [[0.0, 0.0], [6.0, 6.0]]})
    assert "1 of 2 pursuers cannot reach the evader" in dict(warnings(inside))["wall"]
    assert "wall" not in dict(warnings(made.with_({"wall.0.blocks": ["radio"]})))

    def chase(me):
        me.assign(1)
        yield me.sleep(9.0)

    chasing = made.with_({"prune": "none", "protocol": chase})
    assert len({event.pursuers for event in run(chasing, 0).trace.of(Sampled)}) == 1  # there is no way to go


BOX = {"polygon": [[3, 3], [7, 3], [7, 7], [3, 7]], "blocks": ["motion"]}
RECORD = {"kind": "recorded", "waypoints": [[0.0, 0.0, 5.0], [10.0, 9.0, 5.0]]}


@pytest.mark.parametrize(
    ("changes", "key", "sentence"),
    [
        ({"team.positions": [[5.0, 5.0]]}, "team.positions.0", "[5, 5] is inside a wall that blocks motion"),
        ({"team.positions": [[3.0, 5.0]]}, "team.positions.0", "or on one: a player should start in the open"),
        ({"evader.position": [4.0, 4.0]}, "evader.position", "[4, 4] is inside a wall"),
        ({"evader": [{"position": [4.0, 4.0]}]}, "evader.0.position", "[4, 4] is inside a wall"),
        ({"evader": {"strategy": RECORD}}, "evader.strategy.waypoints", "from [0, 5] to [9, 5] (waypoints.1)"),
        (
            {"team.relay": [{"pursuer": 0, "motion": RECORD}]},
            "team.relay.0.motion.waypoints",
            "the record crosses a wall",
        ),
        ({"team.dynamics": {"kind": "acceleration"}}, "team.dynamics", "players with inertia cannot keep off walls"),
        ({"evader.dynamics": {"kind": "turn_rate"}}, "evader.dynamics", "players with inertia cannot keep off walls"),
        ({"team.guidance": {"kind": "constant_bearing"}}, "team.guidance", "follow the shortest path"),
        (
            {"environment.flow": {"kind": "uniform", "velocity": [1.0, 0.0]}},
            "environment.flow",
            "carry players through walls",
        ),
        (
            {"sensing.radius": 5.0, "sensing.estimate": "worst_case"},
            "sensing.estimate",
            "does not allow for walls",
        ),
        ({"protocol": {"kind": "voronoi"}}, "protocol", "voronoi takes straight lines for shortest paths"),
        ({"protocol": {"kind": "argmin", "by": "intercept_time"}}, "protocol", "argmin takes straight lines"),
        ({"evader.strategy": {"kind": "max_min"}}, "evader.strategy", "max_min takes straight lines"),
        (
            {"evader.strategy": {"kind": "listener", "normally": {"kind": "voronoi_vertex", "arena": [0.0, 20.0]}}},
            "evader.strategy",
            "listener takes straight lines",
        ),
    ],
)
def test_what_assumes_the_plane_or_stands_in_a_wall_is_refused(changes, key, sentence):
    free = DUEL | {"team.positions": [[0.0, 0.0]], "evader.position": [1.0, 1.0], "wall": [BOX]}
    if "evader" in changes:
        free = {name: value for name, value in free.items() if not name.startswith("evader.")}
    with pytest.raises(ScenarioError) as refused:
        Scenario().with_(free | changes)
    assert key in str(refused.value)
    assert sentence in str(refused.value)
    Scenario().with_(free | changes | {"wall": [BOX | {"blocks": ["sight"]}]})  # only motion is refused


def test_random_starts_are_outside_of_walls():
    made = Scenario().with_({"team.count": 50, "wall": boxes(0), "evader.box": [0.0, 19.0]})
    plain = Scenario().with_({"team.count": 50, "evader.box": [0.0, 19.0]})
    inside = 0
    for seed in range(20):
        starts, before = made.team.start(seed, made.space), plain.team.start(seed)
        assert made.space.are_free(complex_points(starts)).all()
        free = made.space.are_free(complex_points(before))
        assert (starts[free] == before[free]).all()  # the others stay where they are
        inside += np.count_nonzero(~free)
        draws = stream(seed, "evader", 0).uniform(0.0, 19.0, (50, 2))
        first = draws[made.space.are_free(complex_points(draws)).argmax()]
        assert (made.evaders[0].start(seed, 0, made.space) == first).all()
    assert inside > 50
    full = {"polygon": [[-1, -1], [21, -1], [21, 21], [-1, 21]], "blocks": ["motion"]}
    with pytest.raises(ScenarioError, match=r"team\.box: the walls leave no place in the box from 0 to 20 m"):
        Scenario().with_({"wall": [full]})
    with pytest.raises(ScenarioError, match=r"evader\.0\.box: the walls leave no place in the box from 8 to 12 m"):
        Scenario().with_({"wall": [full], "team.box": [30.0, 40.0], "evader": [{"count": 2}]})


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"announce.payload": "state", "network.latency": 0.1},
        {"sensing.radius": 8.0, "evader.strategy": {"kind": "hide"}, "protocol": {"kind": "local_min"}},
        {"sensing.radius": 8.0, "sensing.noise": 0.3, "sensing.estimate": "hold"},
        {"fault": [{"kind": "crash", "node": 0, "start": 1.0, "end": 3.0}]},
        {"evader": [{"count": 2}], "protocol": {"kind": "local_min"}},
        {"motion.order": "simultaneous", "capture.test": "sample"},
    ],
    ids=["plain", "announced", "hiding", "noisy", "crash", "two evaders", "simultaneous"],
)
def test_no_path_of_a_team_crosses_a_wall(changes):
    made = Scenario().with_({"team.count": 6, "wall": boxes(5, "sight"), "horizon": 4.0, "motion.step": 0.02} | changes)
    summary(watched(made, 3))


@pytest.mark.slow
def test_a_run_among_walls_does_not_depend_on_runs_before():
    """Corners in sight of a place are kept from run to run."""
    made = pursuit(0)
    assert list(run(made, 0).trace) == list(run(pursuit(0).with_({"name": "another"}), 0).trace)


@pytest.mark.slow
def test_no_best_response_lowers_the_potential_of_paths():
    made = Scenario().with_(
        {
            "team.count": 6,
            "wall": boxes(2),
            "motion.static": True,
            "horizon": 20.0,
            "protocol": {"kind": "best_response"},
        }
    )
    watcher = PotentialWatcher(made)
    run(made, 1, watcher)
    assert watcher.judged > 10


def test_the_watcher_notices_a_path_through_a_wall():
    made = scenario()
    start = Started(0, ((0.5, 0.0),), ((-0.5, 0.0),), (SPEED,), (True,))
    through = Sampled(500_000_000, ((0.5, 0.0),), ((0.4, 0.0),))
    watcher = PathWatcher(made)
    watcher(start)
    with pytest.raises(AssertionError, match="no path crosses a wall"):
        watcher(through)
    watcher = PathWatcher(made)
    watcher(start)
    watcher(Captured(0, 1, 0))
    with pytest.raises(AssertionError, match="captured through a wall"):
        watcher(Sampled(0, ((0.04, 0.0),), ((-0.04, 0.0),)))
    slow = Sampled(6_000_000_000, ((0.5, 0.0),), ((0.5, 0.0),))
    watcher = PathWatcher(made)
    watcher(start)
    watcher(slow)  # there is time enough to go round
    assert watcher.judged == 1
    open_plane = PathWatcher(scenario(wall=[]))
    for event in (start, through):
        open_plane(event)
    assert isinstance(run(made, 0, PathWatcher(made)).trace, Trace)


def test_an_evader_hides_behind_a_wall():
    """It goes to the nearest place that the pursuer does not see, and stands there while the pursuer stands."""
    made = scenario(
        {
            "team.positions": [[5.0, 0.0]],
            "team.speeds": 0.0,
            "evader.position": [8.0, 0.5],
            "evader.strategy": {"kind": "hide"},
            "horizon": 8.0,
            "wall": [{"line": [[7.0, 1.0], [7.0, 4.0]], "blocks": ["motion", "sight"]}],
        }
    )
    places = [complex(*event.evaders[0]) for event in watched(made, 0).trace.of(Sampled)]
    hidden = made.space.hidden(np.array(places), np.array([5 + 0j]))
    assert not hidden[0]
    assert hidden[-1]
    assert places[-1] == places[-2]
    assert places[-1] != places[0]


def test_the_way_to_an_evader_that_moves_is_measured_anew():
    """Also from where a pursuer stands; its time is asked alone and as one of all."""
    times = []

    def protocol(me):
        for k in range(4):
            yield me.at(0.1 * k + 0.05)
            times.append((me.capture_time(), me.global_state.capture_times(1)[me.id]))

    run(scenario({"team.active_at_start": 0.0, "protocol": protocol, "horizon": 1.0}), 0)
    assert all(alone == pytest.approx(of_all) for alone, of_all in times)
    assert len({alone for alone, _ in times}) == 4


@pytest.mark.slow
def test_a_long_look_leads_out_of_a_dead_end():
    """In a pocket, straight flight ends at its bottom; a look ahead sees the way out, if there is time."""
    pocket = {"line": [[4.0, 2.0], [0.0, 2.0], [0.0, -2.0], [4.0, -2.0]], "blocks": ["motion"]}
    duel = {"team.positions": [[9.0, 0.0]], "evader.position": [3.5, 1.0], "team.speeds": 1.0, "wall": [pocket]}
    times = {
        kind: summary(run(scenario(duel, **{"evader.strategy": {"kind": kind}, "horizon": 100.0}), 0)).capture_time
        for kind in ("pure_evasion", "max_geodesic")
    }
    assert times["max_geodesic"] > times["pure_evasion"]
    assert max(times.values()) <= bound(scenario(duel), 0) + 1e-6 < inf
