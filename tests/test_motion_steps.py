"""How runs depend on the motion step: what holds at any step, and what needs a short one."""

from cmath import rect
from math import pi

import numpy as np
import pytest

from desim import Scenario, run, summary
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
