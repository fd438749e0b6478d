"""Utilities: what they expect, by enumeration; the potentials that they have, and the Gibbs laws that follow."""

from itertools import pairwise
from math import fsum, inf

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.pursuit.game.game import logit, profiles, welfare
from desim.pursuit.game.utility import Component, EdgePenalty, LocalMean, Mean, Minimum

times = st.floats(0.0, 60.0)
rewards = st.floats(0.0, 60.0)
EXPECTING = (Mean(), Minimum(), EdgePenalty(), EdgePenalty(factor=3.0))


# By hand.


def test_the_gain_of_chasing_in_worked_examples():
    """phi_i = 2, r = 10. Others of 1 and 5, whose mean is 3: (3 - 2)/3. Of 3 and 5: 3 - 2 for the least.

    Each of two active neighbours costs 1.1 r = 11.
    """
    assert Mean()(2.0, [1.0, 5.0], 10.0) == LocalMean()(2.0, [1.0, 5.0], 10.0) == pytest.approx(1 / 3)
    assert Component()(2.0, [1.0, 5.0], 10.0) == Mean()(2.0, [1.0, 5.0], 10.0)
    assert (Minimum()(2.0, [1.0, 5.0], 10.0), Minimum()(2.0, [3.0, 5.0], 10.0)) == (0.0, 1.0)
    assert EdgePenalty()(2.0, [1.0, 5.0], 10.0) == pytest.approx(8.0 - 22.0)
    assert EdgePenalty(factor=2.0)(2.0, [1.0], 10.0) == pytest.approx(8.0 - 20.0)
    for utility in (Mean(), Minimum(), EdgePenalty(), LocalMean(), Component()):
        assert utility(2.0, [], 10.0) == 8.0
        assert utility(12.0, [], 10.0) == -2.0
        assert utility(inf, [], 10.0) == -inf


def test_the_scope_counts_all_known_teammates_the_neighbours_or_the_component():
    assert [u.scope for u in (Mean(), Minimum())] == ["heard", "heard"]
    assert [u.scope for u in (LocalMean(), EdgePenalty(), Component())] == ["neighbours", "neighbours", "component"]


# What is expected of others that are active by chance.


def by_enumeration(utility, own, others, chances, reward):
    """Return the mean gain over all 2^n sets of active others, s."""
    terms = []
    for chosen in profiles(len(others)):
        weight = np.prod([q if a else 1.0 - q for q, a in zip(chances, chosen, strict=True)])
        terms.append(weight * utility(own, [phi for phi, a in zip(others, chosen, strict=True) if a], reward))
    return fsum(terms)


@st.composite
def uncertain_games(draw, most=10):
    """phi_i, those of n others, the chance that each is active, and r."""
    others = draw(st.lists(times, max_size=most))
    chance = st.floats(0.0, 1.0) | st.sampled_from([0.0, 1.0])
    return draw(times), others, [draw(chance) for _ in others], draw(rewards)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("utility", EXPECTING, ids=repr)
@given(game=uncertain_games(most=7))
def test_the_expected_gain_is_the_mean_over_all_sets(utility, game):
    """To 1e-12 of the largest time in it."""
    own, others, chances, reward = game
    scale = max(1.0, own, reward, *others) * (1 + len(others) * getattr(utility, "factor", 0.0))
    exact = by_enumeration(utility, own, others, chances, reward)
    assert utility.expected(own, others, chances, reward) == pytest.approx(exact, rel=0.0, abs=1e-12 * scale)


@pytest.mark.slow
@pytest.mark.parametrize("utility", EXPECTING, ids=repr)
def test_the_expected_gain_is_the_mean_over_the_1024_sets_of_ten(utility):
    """Thirty games with n = 8, 9 and 10 others; the degree of the polynomial is even and odd."""
    rng = np.random.default_rng(1)
    for k in range(30):
        n = 8 + k % 3
        game = rng.uniform(0, 60), rng.uniform(0, 60, n).tolist(), rng.random(n).tolist(), rng.uniform(0, 60)
        exact = by_enumeration(utility, *game)
        assert utility.expected(*game) == pytest.approx(exact, rel=0.0, abs=1e-12 * 60 * (1 + n))


def number_active(chances):
    """Return (n + 1,) the law of how many are active: the Poisson-binomial, by dynamic programming."""
    law = np.array([1.0])
    for q in chances:
        law = np.append(law * (1.0 - q), 0.0) + np.append(0.0, law * q)
    return law


def by_poisson_binomials(own, others, chances, reward):
    """Return the mean gain under the paper's utility, s.

    r P(0) - phi_i E[1/(1 + n)] + sum_j phi_j q_j E[1/((1 + n_j)(2 + n_j))]: j is one of 1 + n_j active others, and
    their mean less phi_i is divided by one more.
    """
    law = number_active(chances)
    mean = reward * law[0] - own * (law / np.arange(1, len(law) + 1)).sum()
    for j, (phi, q) in enumerate(zip(others, chances, strict=True)):
        beside = number_active(chances[:j] + chances[j + 1 :])
        n = np.arange(len(beside))
        mean += phi * q * (beside / ((1 + n) * (2 + n))).sum()
    return mean


@pytest.mark.slow_but_one
@pytest.mark.parametrize(("count", "certain"), [(40, 0.0), (200, 0.0), (200, 0.5), (199, 0.5)])
def test_the_expected_gain_of_many_is_that_of_the_poisson_binomials(count, certain):
    """To 1e-12 of 60 s; half of all probabilities 0 or 1 if requested. The control: one chance off by 1e-6 is seen."""
    rng = np.random.default_rng(count)
    others, chances = rng.uniform(0, 60, count).tolist(), rng.random(count)
    chances = np.where(rng.random(count) < certain, chances.round(), chances * 0.2).tolist()
    exact = by_poisson_binomials(7.0, others, chances, 25.0)
    assert Mean().expected(7.0, others, chances, 25.0) == pytest.approx(exact, rel=0.0, abs=60e-12)
    k = int(np.argmin(np.abs(np.array(chances) - 0.1)))
    chances[k] += 1e-6
    assert Mean().expected(7.0, others, chances, 25.0) != pytest.approx(exact, rel=0.0, abs=60e-12)


def test_the_expected_gain_under_minimum_of_many_is_a_sum_in_order():
    """200 others of phi = 1, ..., 200 and q = 1/2, phi_i = 3.5, r = 300: k is least with 2^-k.

    0 for 1 to 3, then sum of 2^-k (k - 3.5) = 2^-3 (2 - 0.5), for sum 2^-m m = 2 over m >= 1; the rest is below 2^-190.
    """
    others = [float(k) for k in range(200, 0, -1)]
    assert Minimum().expected(3.5, others, [0.5] * 200, 300.0) == pytest.approx(1.5 / 8, rel=1e-14)


@pytest.mark.parametrize("utility", EXPECTING, ids=repr)
def test_the_expected_gain_of_a_pursuer_that_cannot_capture_is_minus_infinity(utility):
    assert utility.expected(inf, [1.0, 2.0], [0.5, 1.0], 10.0) == -inf
    assert utility.expected(inf, [], [], 10.0) == -inf


# Potentials.


def of_minimum(phi, active, reward, graph):
    """Return r less the least phi of the active; 0 if none is, s."""
    return reward - min(p for p, a in zip(phi, active, strict=True) if a) if any(active) else 0.0


def of_edge_penalty(phi, active, reward, graph, factor=1.1):
    """Return the sum of r - phi over the active less C for each pair of active neighbours, s."""
    pairs = sum(active[i] and active[j] for i, j in graph.edges)
    return sum(reward - p for p, a in zip(phi, active, strict=True) if a) - factor * reward * pairs


def of_mean(phi, active, reward, graph):
    return welfare(phi, active, reward)


EXACT = {
    "mean": (Mean(), of_mean),
    "minimum": (Minimum(), of_minimum),
    "edge_penalty": (EdgePenalty(), of_edge_penalty),
}
"""Utilities, each with its potential."""


def gain_in(utility, phi, active, reward, graph, i):
    """Return what pursuer i gains by being active, if the others do as they do, s."""
    counted = graph.adj[i] if utility.scope == "neighbours" else set(graph) - {i}
    return utility(phi[i], [phi[j] for j in sorted(counted) if active[j]], reward)


@st.composite
def games_on_graphs(draw, most=7):
    """phi, a profile, r, and a graph."""
    count = draw(st.integers(1, most))
    phi, active = ([draw(each) for _ in range(count)] for each in (times, st.booleans()))
    graph = nx.gnp_random_graph(count, draw(st.floats(0.0, 1.0)), seed=draw(st.integers(0, 1000)))
    return phi, active, draw(rewards), graph, draw(st.integers(0, count - 1))


@pytest.mark.parametrize("name", EXACT)
@given(game=games_on_graphs())
def test_the_gain_is_the_difference_of_an_exact_potential(name, game):
    phi, active, reward, graph, i = game
    utility, height = EXACT[name]
    on, off = ([chosen if j == i else a for j, a in enumerate(active)] for chosen in (True, False))
    difference = height(phi, on, reward, graph) - height(phi, off, reward, graph)
    assert gain_in(utility, phi, active, reward, graph, i) == pytest.approx(difference, rel=0.0, abs=1e-9)


PATH = nx.path_graph(3)  # j - i - k
PHI = (1.0, 2.0, 4.0)
CYCLE = [(True, False, False), (True, False, True), (True, True, True), (True, True, False), (True, False, False)]


def climb(utility):
    """Return what the pursuer that changes gains at each step of the cycle, s; r = 25 s."""
    gains = []
    for before, after in pairwise(CYCLE):
        (i,) = (i for i in range(3) if before[i] != after[i])
        gain = gain_in(utility, PHI, before, 25.0, PATH, i)
        gains.append(gain if after[i] else -gain)
    return gains


def test_the_local_mean_has_no_potential_since_best_replies_cycle():
    """j chases all the time. k, without incoming links, joins (25 - 4); i, ahead of the mean of both, joins ((2.5 -
    2)/3).

    Now k receives from i and leaves ((4 - 2)/2), and so does i ((2 - 1)/2): each step is a best reply, and the circle
    gains 22.67 s. Around it the change of any potential would be 0, as it is for those that have one.
    """
    assert climb(LocalMean()) == pytest.approx([21.0, 0.5 / 3, 1.0, 0.5])
    for name in EXACT:
        assert sum(climb(EXACT[name][0])) == pytest.approx(0.0, abs=1e-12)
    assert min(climb(EdgePenalty())) < 0.0


# The Gibbs law: the stationary law of the logit, one at a time, is exp(potential / tau).


def chain(utility, phi, reward, graph, tau, at_once=False):
    """Return the (2^N, 2^N) transition matrix of log-linear learning, one of all at random or all at once."""
    everyone = profiles(len(phi))
    number = {profile: k for k, profile in enumerate(everyone)}
    matrix = np.zeros((len(everyone), len(everyone)))
    for profile, k in number.items():
        chase = [logit([0.0, gain_in(utility, phi, profile, reward, graph, i)], 1 / tau)[1] for i in range(len(phi))]
        if at_once:
            for other, m in number.items():
                matrix[k, m] = np.prod([p if a else 1.0 - p for p, a in zip(chase, other, strict=True)])
            continue
        for i, p in enumerate(chase):
            for chosen, chance in ((True, p), (False, 1.0 - p)):
                matrix[k, number[(*profile[:i], chosen, *profile[i + 1 :])]] += chance / len(phi)
    return matrix


def boltzmann(height, phi, reward, graph, tau):
    """Return (2^N,) exp(potential / tau), normed."""
    u = np.array([height(phi, profile, reward, graph) for profile in profiles(len(phi))]) / tau
    weight = np.exp(u - u.max())
    return weight / weight.sum()


@pytest.mark.slow_but_one
@pytest.mark.parametrize("name", EXACT)
@given(game=games_on_graphs(most=4), tau=st.floats(0.5, 50.0))
def test_the_gibbs_law_of_the_potential_is_stationary(name, game, tau):
    """To 1e-12, and in detailed balance: pi(s) P(s, s') = pi(s') P(s', s)."""
    phi, _, reward, graph, _ = game
    utility, height = EXACT[name]
    law, matrix = boltzmann(height, phi, reward, graph, tau), chain(utility, phi, reward, graph, tau)
    assert matrix.sum(axis=1) == pytest.approx(1.0, abs=1e-12)
    assert law @ matrix == pytest.approx(law, rel=0.0, abs=1e-12)
    flow = law[:, None] * matrix
    assert flow == pytest.approx(flow.T, rel=0.0, abs=1e-12)


@pytest.mark.parametrize("name", EXACT)
def test_no_other_law_is_stationary(name):
    """The control: not that of another temperature, not under simultaneous revision, and not for the local mean."""
    phi, reward, tau = (1.0, 2.0, 4.0, 8.0), 10.0, 2.0
    utility, height = EXACT[name]
    graph = nx.path_graph(4)
    law = boltzmann(height, phi, reward, graph, tau)
    assert law @ chain(utility, phi, reward, graph, tau) == pytest.approx(law, rel=0.0, abs=1e-12)
    for other in (
        chain(utility, phi, reward, graph, 1.05 * tau),
        chain(utility, phi, reward, graph, tau, at_once=True),
        chain(LocalMean(), phi, reward, graph, tau),
    ):
        assert np.abs(law @ other - law).max() > 1e-4


def test_under_minimum_the_slower_are_indifferent():
    """At tau -> 0 the first chases and each of the others does so with 1/2: 2^-3 for the relay profile of four.

    Under the mean the relay profile has all the weight.
    """
    phi, graph = (1.0, 2.0, 4.0, 8.0), nx.complete_graph(4)
    relay = profiles(4).index((True, False, False, False))
    assert boltzmann(of_minimum, phi, 25.0, graph, 1e-3)[relay] == pytest.approx(1 / 8)
    assert boltzmann(of_mean, phi, 25.0, graph, 1e-3)[relay] == pytest.approx(1.0)
