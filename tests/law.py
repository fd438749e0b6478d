"""In what law the profile of a static game of four stands, measured in runs and worked out exactly."""

from collections import Counter

import numpy as np

from desim import Scenario, run
from desim.kernel.models.links import Links
from desim.pursuit.core.events import Decided, Started
from desim.pursuit.game.game import gain, logit, profiles
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion, Recording

PHI = (1.0, 2.0, 4.0, 8.0)
"""s"""
HORIZON = 25.0
"""And r, s."""
RELAY = profiles(len(PHI)).index((True, False, False, False))
BATCHES = 5
"""Into so many pieces each run is cut; each is hundreds of times as long as the profile remembers."""


def static_game(protocol, network=None):
    """Four pursuers of speed 1 at distances phi + eps of an evader that stands still; no pursuer moves, r = 25 s."""
    return Scenario(
        horizon=HORIZON,
        team=Team(positions=[(phi + 0.1, 0.0) for phi in PHI], speeds=1.0),
        evader=Evader(position=(0.0, 0.0), speed=0.0),
        motion=Motion(static=True),
        protocol=protocol,
        network=network or Links(),
        record=Recording(trajectory=0.0),
    )


def laws_of(result, order):
    """Return (5, K) shares of decision instants after which each of K profiles stood, by batch; without the first s."""
    number = {profile: k for k, profile in enumerate(order)}
    active, counts, now = list(result.trace.of(Started)[0].active), Counter(), 0
    for decision in result.trace.of(Decided):
        if now != decision.t > 10**9:
            counts[int(BATCHES * now / (HORIZON * 1e9)), number[tuple(active)]] += 1
        now, active[decision.pursuer] = decision.t, decision.active
    shares = np.array([[counts[batch, k] for k in range(len(order))] for batch in range(BATCHES)], dtype=float)
    return shares / shares.sum(axis=1, keepdims=True)


def measured(scenario, seeds=4):
    """Return the (16,) law of a scenario, and its standard errors by the means of batches."""
    return by_batches(batches(scenario, seeds, profiles(len(PHI))))


def batches(scenario, seeds, order):
    """Return the (5 seeds, K) laws of a scenario over its profiles in order, by batch."""
    return np.vstack([laws_of(run(scenario, seed), order) for seed in range(seeds)])


def by_batches(found):
    """Return the mean over batches, and its standard error."""
    return found.mean(axis=0), found.std(axis=0, ddof=1) / np.sqrt(len(found))


def distance(p, q):
    """Return the total variation between two laws."""
    return np.abs(p - q).sum() / 2


def all_at_once(tau, lazy=False):
    """Return the (16, 16) transition matrix if all revise at once; if lazy, each does so with probability 1/2."""
    matrix = np.empty((16, 16))
    for k, profile in enumerate(profiles(4)):
        chase = []
        for i, own in enumerate(PHI):
            others = [PHI[j] for j in range(4) if profile[j] and j != i]
            p = logit([0.0, gain(own, others, HORIZON)], 1 / tau)[1]
            chase.append((p + profile[i]) / 2 if lazy else p)
        for m, other in enumerate(profiles(4)):
            matrix[k, m] = np.prod([p if a else 1.0 - p for p, a in zip(chase, other, strict=True)])
    return matrix


def stationary(matrix):
    """Return the law that a transition matrix leaves as it is."""
    law = np.full(len(matrix), 1.0 / len(matrix))
    for _ in range(5000):
        law = law @ matrix
    return law
