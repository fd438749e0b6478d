"""How runs depend on the motion step: what holds at any step, and what needs a short one."""

from cmath import phase, rect
from math import cos, inf, pi

import numpy as np
import pytest

from desim import Scenario, run, summary
from desim.kernel.core.units import SECOND
from desim.pursuit.core.events import Sampled
from desim.pursuit.core.state import complex_points

SPEED, EVADER_SPEED, RADIUS = 2.0, 0.9, 0.09


def erratic(state, rng):
    """Run in a new random direction at each step."""
    return rect(1.0, rng.uniform(0.0, 2.0 * pi))


def aside(state, rng):
    """Run at a right angle to the line of sight of the nearest pursuer."""
    offset = complex(state.offsets[state.nearest])
    return 1j * offset / max(abs(offset), 1e-12)


STRATEGIES = {
    **{kind: {"kind": kind} for kind in ("pure_evasion", "weighted_flee", "max_min", "max_geodesic", "hide")},
    **{kind: {"kind": kind} for kind in ("constant_heading", "still", "listener")},
    "diffusion": {"kind": "diffusion", "sigma": 3.0},
    "voronoi_vertex": {"kind": "voronoi_vertex", "arena": [0.0, 10.0]},
    "zigzag": {"kind": "zigzag", "amplitude": 1.4, "period": 1.0},
    "erratic": erratic,
    "aside": aside,
}


def chase(me):
    """Chase from the start to the end."""
    me.assign(1)
    yield me.sleep(1000.0)


def pursuit(strategy, order, step, count=2, **evader):
    """Return a pursuit at exact captures, in which pursuers aim at one place for a whole step."""
    return Scenario(
        horizon=40.0,
        team={"count": count, "speeds": SPEED, "box": [0.0, 10.0]},
        evader={"speed": EVADER_SPEED, "box": [3.0, 7.0], "strategy": strategy} | evader,
        capture={"radius": RADIUS},
        motion={"step": step, "order": order},
        protocol=chase,
        record={"trajectory": 0.0},
    )


def bound(scenario, seed):
    """Return the least (d - eps) / (v - v_e) of the pursuers at the start, s."""
    place = complex(*scenario.evaders[0].start(seed))
    distance = np.abs(complex_points(scenario.team.start(seed)) - place).min()
    return max(float(distance) - RADIUS, 0.0) / (SPEED - EVADER_SPEED)


@pytest.mark.parametrize("order", ["evader_first", "simultaneous"])
@pytest.mark.parametrize("name", STRATEGIES)
def test_an_evader_that_moves_by_the_capture_radius_in_a_step_is_captured_within_the_bound(name, order):
    """A pursuer that comes to its aim within the step is then within v_e h = eps of the evader, whatever that does."""
    for seed in range(3):
        made = pursuit(STRATEGIES[name], order, RADIUS / EVADER_SPEED, reaction_delay=0.3 * (seed % 2))
        assert summary(run(made, seed)).end_time <= bound(made, seed) + 1e-6, seed


@pytest.mark.parametrize("order", ["evader_first", "simultaneous"])
def test_in_longer_steps_a_pursuer_runs_past_a_zigzag_for_ever(order):
    made = pursuit(STRATEGIES["zigzag"], order, 8.0 * RADIUS / EVADER_SPEED, count=1)
    assert [summary(run(made, seed)).end_time for seed in range(4)].count(40.0) >= 2


@pytest.mark.parametrize("order", ["evader_first", "simultaneous"])
def test_pure_evasion_from_one_pursuer_is_exact_at_any_step(order):
    for factor in (0.5, 2.0, 8.0):
        made = pursuit("pure_evasion", order, factor * RADIUS / EVADER_SPEED, count=1)
        assert summary(run(made, 0)).end_time == pytest.approx(bound(made, 0), abs=1e-6)


@pytest.mark.slow
def test_where_captures_are_sampled_and_all_move_at_once_both_speeds_count():
    """With (v + v_e) h <= 2 eps no evader escapes; one that runs aside does with 1.4 times this step."""
    longest, captured = 2.0 * RADIUS / (SPEED + EVADER_SPEED), {"capture.test": "sample"}
    for strategy in STRATEGIES.values():
        made = pursuit(strategy, "simultaneous", longest).with_(captured)
        assert summary(run(made, 0)).end_time < 40.0
    longer = pursuit(aside, "simultaneous", 1.4 * longest, count=1).with_(captured)
    assert [summary(run(longer, seed)).end_time for seed in range(6)].count(40.0) > 0


WIND = {"kind": "harmonic", "velocity": [0.2, 0.3], "amplitude": [0.3, -0.2], "period": 3.0}
REFINED = {
    "pure pursuit": ({}, 1),
    "constant bearing": ({"team.guidance": {"kind": "constant_bearing"}}, inf),
    "wind": ({"environment": {"flow": WIND, "on": "pursuers"}}, 1),
    "bearing in wind": (
        {"environment": {"flow": WIND, "on": "pursuers"}, "team.guidance": {"kind": "constant_bearing"}},
        2,
    ),
    "gyre": ({"environment.flow": {"kind": "gyre", "speed": 0.5, "size": 3.0}}, 1),
    "accelerations": ({"team.dynamics": {"kind": "acceleration", "limit": 2.0}}, 1),
    "turns": ({"team.dynamics": {"kind": "turn_rate", "limit": 3.0, "heading": 0.3}}, 1),
    "walls": ({"wall": [{"polygon": [[1.0, 2.0], [3.0, 2.2], [2.0, 3.3]], "blocks": ["motion"]}]}, 1),
}
"""Features of a chase, each with the order in h of its errors if the evader moves first."""


@pytest.mark.slow
@pytest.mark.parametrize("name", REFINED)
def test_capture_times_converge_to_one_limit_in_both_orders(name):
    """With errors of order h; where a pursuer that knows its evader's velocity meets it, of order h^2, or none."""
    changes, order = REFINED[name]
    steps = (0.02, 0.01, 0.005)
    plain = {"team.positions": [[0.0, 0.0]], "evader.position": [3.0, 4.0], "capture.radius": 0.1}
    times = {}
    for first in ("evader_first", "simultaneous"):
        chased = [pursuit({"kind": "constant_heading", "angle": 2.5}, first, step, count=1) for step in steps]
        times[first] = [summary(run(made.with_(plain | changes), 0)).end_time for made in chased]
    coarse, middle, fine = times["evader_first"]
    if order == inf:
        assert coarse == pytest.approx(fine, abs=1e-8)
    else:
        assert (coarse - middle) / (middle - fine) == pytest.approx(2.0**order, rel=0.1)
    limits = [2.0 * fine - middle for _, middle, fine in times.values()]
    assert limits[0] == pytest.approx(limits[1], abs=2e-5)
    assert abs(times["evader_first"][2] - times["simultaneous"][2]) > 1e-4  # the limits are much closer


def test_a_pursuit_curve_ends_when_it_should():
    """Of pure pursuit of a straight runner, d (v + v_e cos a) decreases at the rate v^2 - v_e^2 (Bouguer 1732).

    Here d is the distance, and a the angle between the velocity of the evader and the line of sight.
    """

    def invariant(gap, heading):
        return abs(gap) * (SPEED + EVADER_SPEED * cos(phase(heading / gap)))

    errors = []
    for step in (0.02, 0.01):
        heading = rect(1.0, 2.5)
        made = pursuit({"kind": "constant_heading", "angle": 2.5}, "evader_first", step, count=1)
        places = {"team.positions": [[0.0, 0.0]], "evader.position": [3.0, 4.0], "record.trajectory": 0.1}
        last = run(made.with_(places), 0).trace.of(Sampled)[-1]
        gap = complex(*last.evaders[0]) - complex(*last.pursuers[0])
        assert abs(gap) == pytest.approx(RADIUS, abs=1e-8)
        fallen = invariant(3 + 4j, heading) - invariant(gap, heading)
        errors.append(last.t / SECOND - fallen / (SPEED**2 - EVADER_SPEED**2))
    assert abs(2.0 * errors[1] - errors[0]) < 5e-5 < 1e-3 < abs(errors[1])
