"""The log-linear family in the running simulator: one at a time the profile follows the Gibbs law of the potential."""

import networkx as nx
import numpy as np
import pytest

from desim.kernel.graphs import Edges
from desim.kernel.links import Links
from desim.pursuit.game import profiles
from desim.pursuit.utility import EdgePenalty, Mean, Minimum
from protocols.binary_log_linear import BinaryLogLinear, SelectiveSAP
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules import Poisson, Rounds
from protocols.temperature import ConstantTau
from tests.law import HORIZON, PHI, all_at_once, distance, measured, static_game, stationary

GRAPH = nx.Graph([(0, 1), (0, 2), (1, 2), (2, 3)])


def boltzmann(utility, graph, tau, reward=HORIZON):
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
    "binary": (BinaryLogLinear, Mean(), 0.5),
    "selective": (SelectiveSAP, Mean(), 0.5),
    "minimum": (BinaryLogLinear, Minimum(), 1.0),
    "edge_penalty": (SpatialAdaptivePlay, EdgePenalty(), 12.0),
}
"""Rule, utility, temperature (s): warm enough that several profiles have weight, and r C = 27.5 s is not for ever."""


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_the_log_linear_rules_follow_the_gibbs_law_of_the_potential(name):
    """96,000 decisions, one at a time, over instant links: total variation below 0.02, all 16 within 5 errors.

    Errors are 0.002 to 0.008, which makes about 0.01 of total variation by chance. The control: the laws of
    temperatures that are 20 % off are 0.028 to 0.094 away, and more than 5 errors off somewhere. That of
    `SpatialAdaptivePlay` with the utility of the paper is in `test_paper`.
    """
    rule, utility, tau = LAWS[name]
    protocol = rule(utility=utility, tau=ConstantTau(value=tau), schedule=Poisson(rate=250.0))
    law, error = measured(static_game(protocol, Links(graph=Edges.of(GRAPH)) if name == "edge_penalty" else None))
    assert distance(law, boltzmann(utility, GRAPH, tau)) < 0.02
    assert (np.abs(law - boltzmann(utility, GRAPH, tau)) < 5 * error + 1e-4).all()
    for off in (0.8, 1.2):
        other = boltzmann(utility, GRAPH, off * tau)
        assert distance(law, other) > 0.025
        assert (np.abs(law - other) > 5 * error + 1e-4).any()


@pytest.mark.slow
@pytest.mark.parametrize("rule", [BinaryLogLinear, SelectiveSAP])
def test_at_once_the_law_is_not_that_of_gibbs(rule):
    """All every four milliseconds, with delivery before the next: the law of an exact chain, not that of Gibbs.

    24,000 instants, errors of 0.004 and 0.007: 0.01 of total variation by chance; Gibbs is 0.16 and 0.06 away. The
    selective rule is lazy, so that it is half way to one at a time: its chain's law is another.
    """
    protocol = rule(tau=ConstantTau(value=0.5), schedule=Rounds(period=0.004))
    law, error = measured(static_game(protocol))
    exact = stationary(all_at_once(0.5, lazy=rule is SelectiveSAP))
    assert (np.abs(law - exact) < 5 * error + 2e-3).all()
    assert distance(law, exact) < 0.02 < distance(law, boltzmann(Mean(), GRAPH, 0.5)) / 2
