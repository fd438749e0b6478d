"""The log-linear family in the running simulator: one at a time the profile follows the Gibbs law of the potential."""

import networkx as nx
import numpy as np
import pytest

from desim.kernel.models.graphs import Edges
from desim.kernel.models.links import Links
from desim.pursuit.game.game import profiles
from desim.pursuit.game.utility import EdgePenalty, Mean, Minimum
from protocols.binary_log_linear import BinaryLogLinear, SelectiveSAP
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson, Rounds
from protocols.temperature import ConstantTau
from tests.law import (
    HORIZON,
    PHI,
    all_at_once,
    batches,
    by_batches,
    distance,
    measured,
    static_game,
    stationary,
)

GRAPH = nx.Graph([(0, 1), (0, 2), (1, 2), (2, 3)])


def potentials(utility, graph, reward=HORIZON):
    """Return (16,) the potential of each profile, of the utilities that have one, s."""

    def height(active):
        chasing = [phi for phi, a in zip(PHI, active, strict=True) if a]
        if isinstance(utility, EdgePenalty):
            pairs = sum(active[i] and active[j] for i, j in graph.edges)
            return sum(reward - phi for phi in chasing) - utility.factor * reward * pairs
        middle = min if isinstance(utility, Minimum) else np.mean
        return reward - middle(chasing) if chasing else 0.0

    return np.array([height(profile) for profile in profiles(len(PHI))])


def boltzmann(heights, tau):
    """Return (16,) exp(potential / tau), normed."""
    weight = np.exp((heights - heights.max()) / tau)
    return weight / weight.sum()


LAWS = {
    "minimum": (BinaryLogLinear, Minimum(), 1.0),
    "edge_penalty": (SpatialAdaptivePlay, EdgePenalty(), 12.0),
}
"""Rule, utility, temperature (s): warm enough that several profiles have weight, and r C = 27.5 s is not for ever."""


@pytest.mark.whole
@pytest.mark.parametrize("name", LAWS)
def test_the_log_linear_rules_follow_the_gibbs_law_of_the_potential(name):
    """48,000 decisions, one at a time, over instant links: total variation below 0.03, all 16 within 5 errors.

    Errors are 0.004 to 0.011, which makes about 0.015 of total variation by chance. The control: at temperatures that
    are 20 % off, the mean potential would be more than 5 errors off. `test_many` has the law of both rules with the
    utility of the paper, and `test_paper` that of `SpatialAdaptivePlay`.
    """
    rule, utility, tau = LAWS[name]
    protocol = rule(utility=utility, tau=ConstantTau(value=tau), schedule=Poisson(rate=250.0))
    links = Links(graph=Edges.of(GRAPH)) if name == "edge_penalty" else None
    found, heights = batches(static_game(protocol, links), 2, profiles(len(PHI))), potentials(utility, GRAPH)
    law, error = by_batches(found)
    mean, error_of_mean = by_batches(found @ heights)
    exact = boltzmann(heights, tau)
    assert (np.abs(law - exact) < 5 * error + 1e-3).all()
    assert distance(law, exact) < 0.03
    assert abs(mean - exact @ heights) < 4 * error_of_mean
    for off in (0.8, 1.2):
        assert abs(mean - boltzmann(heights, off * tau) @ heights) > 5 * error_of_mean


@pytest.mark.whole
@pytest.mark.parametrize(("rule", "seeds"), [(BinaryLogLinear, 1), (SelectiveSAP, 2)])
def test_at_once_the_law_is_not_that_of_gibbs(rule, seeds):
    """All every four milliseconds, with delivery before the next: the law of an exact chain, not that of Gibbs.

    6,000 and 12,000 instants, errors of 0.008 and 0.012: 0.015 of total variation by chance; Gibbs is 0.16 and 0.06
    away. The selective rule is lazy, so that it is half way to one at a time: its chain's law is another.
    """
    protocol = rule(tau=ConstantTau(value=0.5), schedule=Rounds(period=0.004))
    law, error = measured(static_game(protocol), seeds=seeds)
    exact = stationary(all_at_once(0.5, lazy=rule is SelectiveSAP))
    assert (np.abs(law - exact) < 5 * error + 2e-3).all()
    assert distance(law, exact) < 0.022 < distance(law, boltzmann(potentials(Mean(), GRAPH), 0.5)) / 2
