"""Algorithm 2 of Lee & Bakolas as a bare loop with complete knowledge, without messages or a simulator."""

import numpy as np
from scipy.special import expit

from desim import Scenario


def bare_loop(scenario: Scenario, seed: int, slot: float) -> int:
    """Run a pursuit and return the number of slots until capture.

    Without capture, return the number of the last slot: one less than the number of slots until the horizon.

    Args:
        scenario: scenario that gives the team, the only evader, the capture radius and the horizon.
        seed: seed of the initial positions, the order of revisions and the decisions.
        slot: slot and motion step, delta = h, s.

    Raises:
        ValueError: if the scenario has several evaders.
    """
    rng = np.random.default_rng(seed)
    (evader,) = scenario.evaders
    x, x_e = scenario.team.start(seed), evader.start(seed)
    v, v_e, eps = np.array(scenario.team.all_speeds()), evader.speed, scenario.capture.radius
    n = len(x)
    active = np.ones(n, dtype=bool)
    active_time = 0.0
    k = 0
    for k in range(round(scenario.horizon / slot)):
        distances = np.hypot(*(x_e - x).T)
        nearest = distances.argmin()
        if distances[nearest] <= eps:
            break
        phi = (distances - eps) / (v - v_e)
        i = rng.integers(n)
        active[i] = False
        active_phi = phi[active]
        gain = (
            (active_phi.mean() - phi[i]) / (len(active_phi) + 1)
            if len(active_phi)
            else scenario.horizon - k * slot - phi[i]
        )
        active[i] = rng.random() < expit(gain * k**2 / 10)
        away = x_e - x[nearest]
        x_e = x_e + v_e * slot * away / np.hypot(*away)
        ahead = x_e - x[active]
        x[active] += v[active, np.newaxis] * slot * ahead / np.hypot(*ahead.T)[:, np.newaxis]
        active_time += active.sum() * slot
    return k
