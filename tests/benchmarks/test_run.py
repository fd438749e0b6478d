"""The cost of a run with all its messages, against a bare loop without any: one slot of Algorithm 2, N = 40."""

import gc
from functools import cache

import numpy as np
import pytest
from scipy.special import expit

import desim
from desim import Scenario
from desim.kernel.clock import seconds
from desim.pursuit.events import Ended
from scenarios.table1 import configuration, decentralised

LAPS = 5
SLOT = 0.001
"""delta = h, s."""


def bare_loop(x, x_e, v, v_e, eps, horizon, rng):
    """Run Algorithm 2 of Lee & Bakolas where everyone knows everything; return the number of slots.

    Args:
        x: (N, 2) positions of the pursuers, m.
        x_e: (2,) position of the evader, m.
        v: (N,) speeds of the pursuers, m/s.
        v_e: speed of the evader, m/s.
        eps: capture radius, m.
        horizon: t_f, s.
        rng: of the order of revisions, and of the decisions.
    """
    n = len(x)
    active = np.ones(n, dtype=bool)
    active_time = 0.0
    for k in range(round(horizon / SLOT)):
        distances = np.linalg.norm(x_e - x, axis=1)
        nearest = distances.argmin()
        if distances[nearest] <= eps:
            break
        phi = (distances - eps) / (v - v_e)
        i = rng.integers(n)
        active[i] = False
        others = phi[active]
        gain = (others.mean() - phi[i]) / (len(others) + 1) if len(others) else horizon - k * SLOT - phi[i]
        active[i] = rng.random() < expit(gain * k**2 / 10)
        away = x_e - x[nearest]
        x_e = x_e + v_e * SLOT * away / np.linalg.norm(away)
        ahead = x_e - x[active]
        x[active] += v[active, np.newaxis] * SLOT * ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
        active_time += active.sum() * SLOT
    return k


def run_desim(scenario: Scenario, seed: int) -> int:
    """Return the number of slots of a run."""
    (end,) = desim.run(scenario, seed).trace.of(Ended)
    return round(seconds(end.t) / SLOT)


def run_bare(scenario: Scenario, seed: int) -> int:
    """Return the number of slots of the same pursuit in the bare loop."""
    team, evader, rng = scenario.team, scenario.evader, np.random.default_rng(seed)
    places, v = (team.start(seed), evader.start(seed)), np.array(team.all_speeds())
    return bare_loop(*places, v, evader.speed, scenario.capture.radius, scenario.horizon, rng)


WAYS = {"desim": run_desim, "bare loop": run_bare}


@cache
def slots(lap: int) -> int:
    """Return how long the pursuit of a lap is, as found by desim."""
    return run_desim(decentralised(configuration(40), SLOT), lap)


@pytest.mark.parametrize("way", WAYS)  # changes first
@pytest.mark.parametrize("lap", range(LAPS))
def test_a_run_is_the_pursuit_of_the_bare_loop(benchmark, lap, way):
    """Capture comes in about the same slot, whatever the draws: within 3 % for each of 20 seeds."""
    benchmark.group = "a run of Table I, N = 40, delta = h = 0.001 s"
    scenario = decentralised(configuration(40), SLOT)
    gc.collect()
    benchmark.extra_info["slots"] = benchmark.pedantic(WAYS[way], args=(scenario, lap))
    assert benchmark.extra_info["slots"] == pytest.approx(slots(lap), rel=0.05)
