"""The log-linear family in the running simulator: one at a time the profile follows the Gibbs law of the potential."""

from collections import Counter

import networkx as nx
import numpy as np
import pytest

from desim import Scenario, run
from desim.kernel.graphs import Edges
from desim.kernel.links import Links
from desim.pursuit.events import Decided, Started
from desim.pursuit.game import gain, logit, profiles
from desim.pursuit.utility import EdgePenalty, Mean, Minimum
from desim.scenario import Evader, Motion, Recording, Team
from protocols.binary_log_linear import BinaryLogLinear, SelectiveSAP
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules import Poisson, Rounds
from protocols.temperature import ConstantTau

PHI = (1.0, 2.0, 4.0, 8.0)
GRAPH = nx.Graph([(0, 1), (0, 2), (1, 2), (2, 3)])


def static_game(protocol, network=None, **changes):
    """Four pursuers of speed 1 at distances phi + eps of an evader that stands still; nobody moves, r = 25 s."""
    given = {
        "horizon": 25.0,
        "team": Team(positions=[(phi + 0.1, 0.0) for phi in PHI], speeds=1.0),
        "evader": Evader(position=(0.0, 0.0), speed=0.0),
        "motion": Motion(frozen=True),
        "protocol": protocol,
        "network": network or Links(),
        "record": Recording(trajectory=0.0),
    }
    return Scenario(**(given | changes))


BATCHES = 5
"""Into so many pieces each run is cut; each is hundreds of times as long as the profile remembers."""


def laws_of(result):
    """Return (5, 16) shares of decision instants after which each profile stood, by batch; 1 s of burn-in left out."""
    number = {profile: k for k, profile in enumerate(profiles(len(PHI)))}
    active, counts, now = list(result.trace.of(Started)[0].active), Counter(), 0
    for decision in result.trace.of(Decided):
        if now != decision.t > 10**9:
            counts[int(BATCHES * now / 25e9), number[tuple(active)]] += 1
        now, active[decision.pursuer] = decision.t, decision.active
    shares = np.array([[counts[batch, k] for k in range(16)] for batch in range(BATCHES)], dtype=float)
    return shares / shares.sum(axis=1, keepdims=True)


def measured(scenario, seeds=4):
    """Return the law of a scenario, and its standard errors by the means of batches."""
    found = np.vstack([laws_of(run(scenario, seed)) for seed in range(seeds)])
    return found.mean(axis=0), found.std(axis=0, ddof=1) / np.sqrt(len(found))


def distance(p, q):
    """Return the total variation between two laws."""
    return np.abs(p - q).sum() / 2


def boltzmann(utility, graph, tau, reward=25.0):
    """Return (16,) exp(potential / tau), normed, of the utilities that have one."""

    def height(active):
        chasing = [phi for phi, a in zip(PHI, active, strict=True) if a]
        if isinstance(utility, EdgePenalty):
            pairs = sum(active[i] and active[j] for i, j in graph.edges)
            return sum(reward - phi for phi in chasing) - utility.factor * reward * pairs
        middle = min if isinstance(utility, Minimum) else np.mean
        return reward - middle(chasing) if chasing else 0.0

    u = np.array([height(profile) for profile in profiles(len(PHI))]) / tau
    weight = np.exp(u - u.max())
    return weight / weight.sum()


LAWS = {
    "sap": (SpatialAdaptivePlay, Mean(), 0.5),
    "binary": (BinaryLogLinear, Mean(), 0.5),
    "selective": (SelectiveSAP, Mean(), 0.5),
    "minimum": (BinaryLogLinear, Minimum(), 1.0),
    "edge_penalty": (SpatialAdaptivePlay, EdgePenalty(), 12.0),
}
"""Rule, utility, temperature (s): warm enough that several profiles have weight, and r C = 27.5 s is not for ever."""


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_the_log_linear_rules_follow_the_gibbs_law_of_the_potential(name):
    """200,000 decisions, one at a time, over instant links: total variation below 0.02, all 16 within 5 errors.

    The control: the laws of temperatures that are 20 % off are farther away, and more than 5 errors off somewhere.
    """
    rule, utility, tau = LAWS[name]
    protocol = rule(utility=utility, tau=ConstantTau(value=tau), schedule=Poisson(rate=500.0))
    law, error = measured(static_game(protocol, Links(graph=Edges.of(GRAPH)) if name == "edge_penalty" else None))
    assert distance(law, boltzmann(utility, GRAPH, tau)) < 0.02
    assert (np.abs(law - boltzmann(utility, GRAPH, tau)) < 5 * error + 1e-4).all()
    for off in (0.8, 1.2):
        other = boltzmann(utility, GRAPH, off * tau)
        assert distance(law, other) > 0.02
        assert (np.abs(law - other) > 5 * error + 1e-4).any()


@pytest.mark.slow
@pytest.mark.parametrize("rule", [BinaryLogLinear, SelectiveSAP])
def test_at_once_the_law_is_not_that_of_gibbs(rule):
    """Everybody every two milliseconds, hearing of it before the next: the law of an exact chain, 0.1 from Gibbs's.

    The selective rule is lazy, so that it is half way to one at a time: its chain's law is another.
    """
    protocol = rule(tau=ConstantTau(value=0.5), schedule=Rounds(period=0.002))
    law, error = measured(static_game(protocol))
    exact = stationary(all_at_once(0.5, lazy=rule is SelectiveSAP))
    assert (np.abs(law - exact) < 5 * error + 2e-3).all()
    assert distance(law, exact) < 0.02 < distance(law, boltzmann(Mean(), GRAPH, 0.5)) / 2


def all_at_once(tau, lazy):
    """Return the (16, 16) transition matrix if all revise at once; if lazy, each does so with probability 1/2."""
    matrix = np.empty((16, 16))
    for k, profile in enumerate(profiles(4)):
        chase = []
        for i, own in enumerate(PHI):
            others = [PHI[j] for j in range(4) if profile[j] and j != i]
            p = logit([0.0, gain(own, others, 25.0)], 1 / tau)[1]
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
