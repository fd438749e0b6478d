"""Flow: carried players against integration, capture times against a scan, and runs that a flow does not change."""

from math import cos, inf, nan, pi, sin

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from desim import (
    AffineFlow,
    Announcements,
    ConstantHeading,
    Environment,
    Evader,
    GyreFlow,
    HarmonicFlow,
    Links,
    Motion,
    RecordedFlow,
    Scenario,
    SteadyFlow,
    Team,
    TurnRate,
    run,
    summary,
)
from desim.config.errors import KeyedError
from desim.kernel.core.units import SECOND
from desim.pursuit.core.events import Captured, Decided, Sampled, Started
from desim.pursuit.motion.capture import RadialTime, intercept_times
from desim.pursuit.motion.flow import NoFlow
from desim.pursuit.motion.flow_capture import _drifting_capture_times, capture_times_in_flow, expanding_capture_times
from desim.study.ablation.imperfections import without_flow
from desim.testing.pursuits import watched

STEADY = SteadyFlow(velocity=(0.3, -0.2))
TIDE = HarmonicFlow(velocity=(0.1, 0.2), amplitude=(0.5, -0.4), period=3.0, phase=0.3)
GUST = RecordedFlow(velocities=((1.0, 0.4, 0.0), (3.0, 0.0, -0.5), (4.0, 0.1, 0.2)))
CALMED = RecordedFlow(velocities=((5.0, 1.0, 0.0), (5.01, 0.0, 0.0)))
SPIN = AffineFlow(velocity=(0.1, 0.0), expansion=-0.05, rotation=0.3, centre=(10.0, 9.0))
CELLS = GyreFlow(speed=0.5, size=4.0, shift=1.0, period=5.0)
UNIFORM, UNEVEN = [STEADY, TIDE, GUST], [SPIN, CELLS]


def name(value):
    return getattr(value, "kind", str(value))


def phi(environment, target=5.0 + 0j, place=0j, speed=2.0, evader_speed=0.9, radius=0.1, now=0.0):
    """Return one capture time, s; the defaults are those of the specification."""
    distance = np.array([abs(target - place)])
    found = capture_times_in_flow(
        environment, target, np.array([place]), distance, np.array([speed]), evader_speed, radius, round(now * SECOND)
    )
    return float(found[0])


@pytest.mark.parametrize("flow", UNIFORM, ids=name)
@pytest.mark.parametrize(("begin", "end"), [(0.0, 0.7), (-1.0, 6.0), (2.5, 3.5), (3.9, 40.0)])
def test_a_displacement_is_the_integral_of_the_velocity(flow, begin, end):
    corners = [t for t in (1.0, 3.0, 4.0) if begin < t < end]
    x, y = (
        quad(lambda t, part=part: getattr(flow.velocity_at(t), part), begin, end, points=corners, limit=400)[0]
        for part in ("real", "imag")
    )
    assert flow.displacement(begin, end) == pytest.approx(complex(x, y), abs=1e-6)


@pytest.mark.parametrize("flow", [*UNIFORM, CALMED], ids=name)
def test_speeds_accelerations_and_trends_are_bounds(flow):
    times = np.linspace(0.0, 12.0, 4_001)
    values = np.array([flow.velocity_at(t) for t in times.tolist()])
    assert np.abs(values).max() <= flow.top_speed + 1e-12
    assert (np.abs(np.diff(values)) / np.diff(times)).max(initial=0.0) <= flow.top_acceleration * (1.0 + 1e-6) + 1e-12
    for begin in (0.0, 1.7, 5.0):
        mean, most = flow.trend(begin)
        off = [abs(flow.displacement(begin, begin + t) - mean * t) for t in times.tolist()]
        assert max(off) <= most + 1e-9


@pytest.mark.parametrize("flow", [*UNIFORM, *UNEVEN], ids=name)
def test_a_player_is_carried_as_by_integration(flow):
    """Steps of .05 s for a player with a velocity of its own, and without."""
    environment, own = Environment(flow=flow), 0.7 - 0.4j

    def path(command, until):
        def slope(t, state):
            velocity = command + complex(flow(np.array([complex(*state)]), t)[0])
            return [velocity.real, velocity.imag]

        return complex(*solve_ivp(slope, (0.0, until), [3.0, 4.0], rtol=1e-10, atol=1e-10, max_step=0.05).y[:, -1])

    place, step = 3.0 + 4.0j, SECOND // 20
    for k in range(60):
        place += (own + environment.drift(place, own, k * step, 0.05)) * 0.05
    assert place == pytest.approx(path(own, 3.0), abs=1e-6)
    assert environment.carried(3.0 + 4.0j, 0, 3 * SECOND) == pytest.approx(path(0j, 3.0), abs=1e-6)


def test_the_cells_of_a_gyre_keep_their_area_and_rotate():
    """u = U (-sin x cos y, cos x sin y) pi/L: no divergence, no flow through the edges, speed U at most."""
    flow = GyreFlow(speed=0.5, size=4.0)
    places = np.array([1.3 + 0.4j, 2.0 + 0j, 4.0 + 1.0j, 1.0 + 4.0j])
    x, y = pi / 4.0 * 1.3, pi / 4.0 * 0.4
    found = flow(places, 3.0)
    assert found[0] == pytest.approx(0.5 * complex(-sin(x) * cos(y), cos(x) * sin(y)))
    assert found[1:].tolist() == pytest.approx([-0.5 + 0j, -0.5j * sin(pi / 4), 0.5 * sin(pi / 4)], abs=1e-12)
    ends = flow(1.3 + 0.4j + 1e-6 * np.array([1, -1, 1j, -1j]), 0.0)
    assert (ends[0] - ends[1]).real + (ends[2] - ends[3]).imag == pytest.approx(0.0, abs=1e-12)


# Capture times.


@pytest.mark.parametrize(("towards", "expected"), [(-0.3, 3.5), (0.3, 6.125)])
def test_wind_on_the_pursuers_alone(towards, expected):
    """d = 5, eps = .1, v = 2, v_e = .9; wind of .3 m/s towards the evader, and against."""
    wind = Environment(flow=SteadyFlow(velocity=(-towards, 0.0)), on="pursuers")
    assert phi(wind) == pytest.approx(expected, abs=1e-9)
    nearly = HarmonicFlow(velocity=(-towards, 0.0), amplitude=(1e-12, 0.0), period=1.0)
    assert phi(Environment(flow=nearly, on="pursuers")) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("rate", "expected"), [(-0.05, 4.00519), (0.05, 5.06547), (0.2, 11.89773), (0.22, inf), (0.0, 4.45455)]
)
def test_an_affine_flow_on_all(rate, expected):
    assert phi(Environment(flow=AffineFlow(expansion=rate, rotation=0.7))) == pytest.approx(expected, abs=5e-6)


@given(st.floats(-0.3, 0.3), st.floats(0.2, 9.0), st.floats(0.3, 2.0))
@example(5e-324, 1.0, 1.0)
def test_an_expanding_distance_falls_as_by_integration(rate, distance, closing):
    (found,) = expanding_capture_times(np.array([distance]), np.array([closing]), 0.1, rate).tolist()
    if found == inf:
        assert closing - rate * distance <= 1e-9 or closing <= 0.1 * rate
    else:
        at = solve_ivp(lambda t, d: rate * d - closing, (0.0, max(found, 1e-9)), [distance], rtol=1e-10, atol=1e-12).y[
            0, -1
        ]
        assert at == pytest.approx(0.1, abs=1e-6)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("flow", UNIFORM, ids=name)
def test_a_capture_time_in_wind_is_the_first_of_a_dense_scan(flow):
    """Among the pursuers are slow ones, which the wind helps for a while, or in the end."""
    environment, rng = Environment(flow=flow, on="pursuers"), np.random.default_rng(7)
    for _ in range(25):
        place, speed = complex(*rng.uniform(-4, 4, 2)), rng.uniform(0.6, 2.0)
        found = phi(environment, 0j, place, speed, now=0.5)
        times = np.linspace(0.0, min(1.05 * found, 80.0) + 1e-3, 4_001)
        drift = np.array([flow.displacement(0.5, 0.5 + t) for t in times.tolist()])
        reach = np.abs(-place * (1.0 + 0.9 * times / abs(place)) - drift) <= speed * times + 0.1
        first = times[reach.argmax()] if reach.any() else inf
        assert first == pytest.approx(found, abs=2.0 * times[1]) or (first == inf and found > 79.0)


@pytest.mark.parametrize("flow", [NoFlow(), *UNIFORM, *UNEVEN], ids=lambda flow: flow.kind)
def test_players_move_relative_to_each_other_at_most_as_fast_as_is_said(flow):
    """Two carried players anywhere; and a carried pursuer and an evader that is not."""
    rng = np.random.default_rng(3)
    places = rng.uniform(-30.0, 30.0, 60) + 1j * rng.uniform(-30.0, 30.0, 60)
    velocities = [Environment(flow=flow).flow(places, t) for t in (0.0, 0.7, 2.3)]
    carried = max(float(abs(each[:, None] - each).max()) for each in map(np.asarray, velocities))
    alone = max(float(abs(each).max()) for each in map(np.asarray, velocities))
    assert carried <= Environment(flow=flow).relative_speed + 1e-12
    assert alone <= Environment(flow=flow, on="pursuers").relative_speed + 1e-12
    assert (Environment(flow=flow).relative_speed == 0.0) == Environment(flow=flow).keeps_distances


def test_a_medium_at_rest_moves_nothing():
    still = Environment().flow
    assert (still.kind, still.velocity_at(3.0), still.top_speed, still.top_acceleration) == ("none", 0, 0, 0)
    assert (Environment().top_speed, still.displacement(1.0, 3.0)) == (0.0, 0.0)


@pytest.mark.parametrize("flow", [*UNIFORM, *UNEVEN], ids=name)
@pytest.mark.parametrize("on", ["all", "pursuers"])
def test_an_unknown_place_has_no_time_and_gives_no_warning(flow, on):
    """An announcement of a capture time has no position; the pursuer beside it has its usual time."""
    places, distances, speeds = np.array([complex(nan, nan), 3j]), np.array([nan, 3.0]), np.array([9.0, 9.0])
    environment = Environment(flow=flow, on=on)
    unknown, known = capture_times_in_flow(environment, 0j, places, distances, speeds, 0.5, 0.1, 0)
    (alone,) = capture_times_in_flow(environment, 0j, places[1:], distances[1:], speeds[1:], 0.5, 0.1, 0)
    assert unknown == inf
    assert known == alone < inf


def test_a_flow_that_carries_all_alike_changes_no_capture_time():
    speeds, offsets = np.array([1.0, 1.5, 0.8]), np.array([3.0 + 0j, 4j, -2.0 + 0j])
    simple = RadialTime(speeds, 0.9, 0.1)(np.abs(offsets)).tolist()
    still = intercept_times(offsets, 0.9 * offsets / np.abs(offsets), speeds, 0.1).tolist()
    assert still == pytest.approx(simple)
    assert all(Environment(flow=flow).keeps_distances for flow in UNIFORM)
    assert not any(Environment(flow=flow).keeps_distances for flow in UNEVEN)
    assert not any(Environment(flow=flow, on="pursuers").keeps_distances for flow in UNIFORM)
    assert Environment(on="pursuers").keeps_distances


# Whole runs.


def decisions_of(trace):
    return [(event.t, event.pursuer, event.active) for event in trace.of(Decided)]


def decisions(result):
    return decisions_of(result.trace)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(
    ("guidance", "order", "payload", "flow"),
    [  # each two of guidance, order and payload together, and each flow; courses take ten times as long as actions
        ("pure_pursuit", "evader_first", "action", TIDE),
        ("constant_bearing", "simultaneous", "action", GUST),
        ("pure_pursuit", "simultaneous", "course", STEADY),
        ("constant_bearing", "evader_first", "course", GUST),
    ],
    ids=name,
)
def test_a_flow_on_all_changes_no_decision_and_shifts_the_capture(flow, guidance, order, payload):
    turns = payload == "course"
    scenario = Scenario(
        team=Team(count=6, guidance=guidance, **({"dynamics": TurnRate(limit=2.0)} if turns else {})),
        motion=Motion(order=order),
        announce=Announcements(payload=payload),
        network=Links(latency=0.1),
        horizon=40.0,
    )
    still = run(scenario, 3)
    carried = run(scenario.model_copy(update={"environment": Environment(flow=flow)}), 3)
    assert decisions(carried) == decisions(still)
    (here,), (there,) = still.trace.of(Captured), carried.trace.of(Captured)
    assert abs(there.t - here.t) <= 1
    last, shifted = still.trace.of(Sampled)[-1], carried.trace.of(Sampled)[-1]
    shift = flow.displacement(0.0, there.t / SECOND)
    within_a_step = flow.top_acceleration * scenario.motion.step**2 + 1e-8
    for before, after in zip(last.pursuers + last.evaders, shifted.pursuers + shifted.evaders, strict=True):
        assert complex(*after) - complex(*before) == pytest.approx(shift, abs=within_a_step)


@pytest.mark.parametrize("payload", ["action", "course"])
@pytest.mark.parametrize("flow", UNIFORM, ids=name)
def test_a_flow_on_all_changes_no_distance_if_actions_change_within_motion_steps(flow, payload):
    scenario = Scenario(
        team=Team(count=4, speeds=2.0, box=(0.0, 6.0)),
        evader=Evader(position=(3.0, 3.5)),
        motion=Motion(step=0.25),
        protocol={
            "kind": "sap",
            "schedule": {"kind": "poisson", "rate": 4.0},
            "tau": {"kind": "constant", "value": 9.0},
        },
        announce=Announcements(payload=payload),
        record={"trajectory": 0.25},
        horizon=1.5,
    )
    still = run(scenario, 3).trace
    carried = run(scenario.model_copy(update={"environment": Environment(flow=flow)}), 3).trace
    assert len({event.t for event in still.of(Decided) if event.t % 250_000_000}) > 10
    assert decisions_of(carried) == decisions_of(still)
    for before, after in zip(still.of(Sampled), carried.of(Sampled), strict=True):
        shift = flow.displacement(0.0, after.t / SECOND)
        for here, there in zip(before.pursuers + before.evaders, after.pursuers + after.evaders, strict=True):
            assert complex(*there) - complex(*here) == pytest.approx(shift, abs=1e-8)


@pytest.mark.parametrize("order", ["evader_first", "simultaneous"])
@pytest.mark.parametrize("guidance", ["constant_bearing", "pure_pursuit"])
def test_a_steady_flow_on_all_only_shifts_a_pursuer(guidance, order):
    scenario = Scenario(
        team=Team(positions=[(0.0, 0.0)], guidance=guidance, active_at_start=1.0),
        evader=Evader(position=(3.0, 1.0), strategy=ConstantHeading(angle=2.0)),
        motion=Motion(order=order),
        horizon=0.5,
    )
    still, carried = (
        run(each).trace.of(Sampled)[-1]
        for each in (scenario, scenario.model_copy(update={"environment": {"flow": STEADY}}))
    )
    shift = STEADY.displacement(0.0, 0.5)
    assert complex(*carried.pursuers[0]) - complex(*still.pursuers[0]) == pytest.approx(shift, abs=1e-8)


@pytest.mark.slow
def test_wind_on_the_pursuers_does_change_decisions():
    """The control of the test above."""
    scenario = Scenario(team=Team(count=6), horizon=40.0)
    wind = scenario.model_copy(update={"environment": Environment(flow=STEADY, on="pursuers")})
    assert decisions(run(wind, 3)) != decisions(run(scenario, 3))
    assert without_flow(wind) == scenario


@pytest.mark.parametrize("on", ["all", "pursuers"])
@pytest.mark.parametrize("flow", [TIDE, AffineFlow(expansion=0.05)], ids=name)
def test_a_flow_changes_nothing_where_nothing_moves(flow, on):
    scenario = Scenario(team=Team(count=4), motion=Motion(static=True), horizon=2.0)
    still = run(scenario, 3)
    flowing = run(scenario.model_copy(update={"environment": Environment(flow=flow, on=on)}), 3)
    assert [*flowing.trace] == [*still.trace]
    assert summary(flowing).potential_gap == summary(still).potential_gap > 0.0


@pytest.mark.slow_but_one
@pytest.mark.parametrize(("wind", "capturer", "time"), [(-0.5, 1, 1.45), (0.5, 0, 2.45), (0.0, 1, 2.9 / 1.5)])
def test_an_omniscient_assignment_in_wind_is_right_in_hindsight(wind, capturer, time):
    """The evader stands at 5 m; the control chases with the other one alone."""
    team = Team(positions=[(0.0, 0.0), (8.0, 0.0)], speeds=1.5, active_at_start=0.0)
    scenario = Scenario(
        team=team,
        evader=Evader(position=(5.0, 0.0), speed=0.0, strategy="still"),
        environment=Environment(flow=SteadyFlow(velocity=(wind, 0.0)), on="pursuers"),
        protocol="centralised",
    )
    found = summary(run(scenario))
    assert (found.capturer, found.capture_time) == (capturer, pytest.approx(time, abs=1e-6))
    assert found.misassigned_time == found.potential_gap == found.time_to_relay == 0.0
    assert found.regret == pytest.approx(0.0, abs=1e-6)

    def chase(me):
        if me.id != capturer:
            me.assign(1)
        yield me.sleep(1e6)

    other = summary(run(scenario.model_copy(update={"protocol": chase})))
    assert min(other.misassigned_time, other.potential_gap) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("environment", "tolerance"),
    [
        (Environment(flow=STEADY), 1e-8),
        (Environment(flow=TIDE), 1e-8),
        (Environment(flow=SPIN), 1e-3),
        (Environment(flow=STEADY, on="pursuers"), 2e-3),
    ],
    ids=["steady", "tide", "affine", "wind"],
)
def test_a_lone_pursuer_captures_a_fleeing_evader_after_its_capture_time(environment, tolerance):
    """On the ground, the evader flees straight; in a flow, away from where it is carried, too."""
    on_ground = environment.on == "pursuers"
    flees = {"kind": "constant_heading", "angle": float(np.arctan2(3.0, 4.0))} if on_ground else "pure_evasion"
    scenario = Scenario(
        team=Team(positions=((0.0, 0.0),), speeds=2.0, guidance="constant_bearing" if on_ground else "pure_pursuit"),
        evader=Evader(position=(4.0, 3.0), strategy=flees),
        environment=environment,
        motion=Motion(step=0.002),
        protocol="best_response",
    )
    (captured,) = run(scenario, 1).trace.of(Captured)
    assert captured.t / SECOND == pytest.approx(phi(environment, 4.0 + 3.0j), rel=tolerance)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(
    ("wind", "phi", "bearing", "pure"),
    [((0.0, 0.3), 4.5471, 4.5481, 4.7899), ((0.2, 0.5), 3.9602, 3.9628, 4.7145), ((-0.2, 0.5), 5.8539, 5.8578, 6.8872)],
)
def test_the_table_of_what_guidances_attain_in_wind(wind, phi, bearing, pure):
    """The table of the page on the game; phi is the aim of the edge of the capture disc.

    Times of pure pursuit are those of a Runge-Kutta integration without desim. Headings that are held for steps of
    1 ms, as here, make captures up to 1.2 ms early.
    """
    environment = Environment(on="pursuers", flow=SteadyFlow(velocity=wind))
    times = capture_times_in_flow(
        environment, 5 + 0j, np.zeros(1, complex), np.array([5.0]), np.array([2.0]), 0.9, 0.1, 0
    )
    assert times == pytest.approx([phi], abs=6e-5)
    for guidance, expected, error in (("constant_bearing", bearing, 6e-5), ("pure_pursuit", pure, 1.2e-3)):
        one = Scenario(
            team={"count": 1, "speeds": 2.0, "positions": [(0.0, 0.0)], "guidance": guidance},
            evader={"position": (5.0, 0.0)},
            environment=environment,
            motion={"step": 0.001},
        )
        assert summary(run(one, 1))["capture_time"] == pytest.approx(expected, abs=error)


@pytest.mark.slow
@pytest.mark.whole_but_one
@pytest.mark.parametrize(
    ("flow", "on", "payload"),
    [  # each two values together
        (flow, on, ("action", "state")[(k + few) % 2])
        for k, flow in enumerate([*UNIFORM, *UNEVEN])
        for few, on in enumerate(("all", "pursuers"))
    ],
    ids=name,
)
def test_no_invariant_of_motion_is_broken_in_a_flow(flow, on, payload):
    scenario = Scenario(
        team=Team(count=5),
        evader=(Evader(strategy="diffusion"), Evader(speed=0.5)),
        environment=Environment(flow=flow, on=on),
        announce=Announcements(payload=payload),
        horizon=3.0,
    )
    (started,) = watched(scenario, 2).trace.of(Started)
    assert len(started.evaders) == 2


@pytest.mark.whole_but_one
@pytest.mark.slow_but_one
@pytest.mark.parametrize("flow", [STEADY, TIDE, SPIN, CELLS], ids=name)
@pytest.mark.parametrize("on", ["all", "pursuers"])
def test_announced_positions_are_carried_on(flow, on):
    """Announcements that arrive at once are worth as much as sight: the paths of teammates are extrapolated exactly."""
    scenario = Scenario(team=Team(count=4), environment=Environment(flow=flow, on=on), horizon=4.0)
    told = scenario.model_copy(update={"announce": Announcements(payload="state")})
    assert decisions(run(told, 4)) == decisions(run(scenario, 4))


@pytest.mark.whole
def test_results_converge_in_the_motion_step():
    scenario = Scenario(team=Team(count=5), environment=Environment(flow=CELLS), horizon=40.0)
    times = [
        summary(run(scenario.model_copy(update={"motion": Motion(step=h)}), 3)).capture_time
        for h in (0.08, 0.02, 0.005)
    ]
    assert abs(times[1] - times[2]) < abs(times[0] - times[2]) < 0.1


@pytest.mark.slow
def test_a_flow_of_a_user_is_a_function_of_places_and_time():
    def shear(places, t):
        return 0.05 * places.imag + 0j

    scenario = Scenario(team=Team(count=4), environment=Environment(flow=shear), horizon=5.0)
    assert Environment(flow=shear).top_speed == inf
    watched(scenario, 1)


# What is given wrongly.


def test_a_velocity_that_stands_for_a_missing_one_is_refused():
    with pytest.raises(ValueError, match=r"velocities\.1: -9999 m/s probably stands for a missing value"):
        RecordedFlow(velocities=((0.0, 1.0, 1.0), (1.0, -9999.0, 1.0)))


def test_a_file_of_velocities(tmp_path):
    file = tmp_path / "wind.csv"
    file.write_text("# from a mast\nt,x,y\n0,1.5,0\n2, 0.5,-1\n")
    flow = RecordedFlow(file=str(file))
    assert flow == RecordedFlow(velocities=((0.0, 1.5, 0.0), (2.0, 0.5, -1.0)))
    assert flow.velocity_at(1.0) == pytest.approx(1.0 - 0.5j)
    for text, why in {
        "t,x\n0,1\n": "no column 'y'",
        "t,x,y\n0,1,north\n": "line 2: y: 'north' is not a number",
        "t,x,y\n1,1,0\n1,2,0\n": "line 3: t should increase",
        "t,x,y\n": "has no rows",
    }.items():
        file.write_text(text)
        with pytest.raises(KeyedError, match=why):
            RecordedFlow(file=str(file))
    with pytest.raises(KeyedError, match="cannot be read"):
        RecordedFlow(file=str(tmp_path / "none.csv"))
    with pytest.raises(KeyedError, match="not both"):
        RecordedFlow(file=str(file), velocities=((0.0, 0.0, 0.0),))
    for unit in ("h", 1.0, None):
        with pytest.raises(KeyedError, match=r"time_unit: .*should be 's', 'ms', 'us' or 'ns'"):
            RecordedFlow(file=str(file), time_unit=unit)


def test_what_no_capture_time_is_known_for_is_refused():
    inert = Team(dynamics=TurnRate())
    for environment in (Environment(flow=SPIN), Environment(flow=STEADY, on="pursuers")):
        with pytest.raises(KeyedError, match="carries all players alike"):
            Scenario(team=inert, environment=environment)
    assert Scenario(team=inert, environment=Environment(flow=TIDE)).environment.flow == TIDE
    seen_worst = {"radius": 3.0, "estimate": "worst_case"}
    for on in ("all", "pursuers"):
        with pytest.raises(KeyedError, match="worst_case does not allow for a flow"):
            Scenario(sensing=seen_worst, environment=Environment(flow=STEADY, on=on))
    with pytest.raises(KeyedError, match="worst_case does not allow for inertia"):
        Scenario(sensing=seen_worst, team=inert)
    assert Environment().is_still
    assert Environment().flow == NoFlow()


def test_capture_times_in_a_wind_that_turns_are_the_first_roots():
    """By a fine search for the first time at which a pursuer reaches the fleeing evader in the moving air."""
    flow = HarmonicFlow(velocity=(0.3, 0.0), amplitude=(0.0, 0.8), period=3.0)
    offsets, speeds = np.array([6.0 + 0j, 4.0 - 3j, -5.0 + 1j]), np.array([1.6, 1.8, 2.0])
    flight = offsets / np.abs(offsets) * 0.5
    times = _drifting_capture_times(offsets, flight, speeds, 0.1, flow, 0.7)
    grid = np.arange(0.0, 20.0, 0.001)
    drift = np.array([flow.displacement(0.7, 0.7 + t) for t in grid.tolist()])
    for k in range(3):
        reached = np.abs(offsets[k] + flight[k] * grid - drift) <= speeds[k] * grid + 0.1
        assert times[k] == pytest.approx(grid[reached.argmax()], abs=0.0011)


@pytest.mark.parametrize("begin", [0.0, 0.3, 1.9])
def test_the_trend_of_a_harmonic_flow_bounds_its_oscillation_and_no_less_would(begin):
    flow = HarmonicFlow(velocity=(0.5, -0.2), amplitude=(0.3, 0.4), period=2.0, phase=0.7)
    mean, bound = flow.trend(begin)
    times = begin + np.linspace(0.0, 2.0, 401)
    displacements = np.array([flow.displacement(begin, time) for time in times]) - mean * (times - begin)
    assert np.abs(displacements[:, None] - displacements).max() == pytest.approx(bound, rel=1e-4)


def test_a_pursuer_hovers_against_the_wind_where_it_has_lost_the_evader():
    """It sees the evader, which is faster, no more after 0.1 s, flies to where it was seen last, and stays there."""

    def chase(me):
        me.assign(True)
        yield me.sleep(100.0)

    scenario = Scenario(
        horizon=8.0,
        prune="none",
        team=Team(positions=[(0.0, 0.0)], speeds=0.5),
        evader=Evader(position=(2.0, 0.0), speed=0.9),
        sensing={"radius": 2.04, "track_timeout": 20.0, "estimate": "hold"},
        environment=Environment(flow=SteadyFlow(velocity=(0.0, 0.3)), on="pursuers"),
        protocol=chase,
        record={"trajectory": 0.01},
    )
    samples = run(scenario).trace.of(Sampled)
    places = [complex(*sample.pursuers[0]) for sample in samples if sample.t > 7 * SECOND]
    assert max(abs(place - places[0]) for place in places) < 1e-9
    assert min(abs(complex(*sample.evaders[0]) - places[0]) for sample in samples) < 1e-9
