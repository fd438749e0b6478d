"""The pursuit game: identities, enumeration, closed forms."""

from itertools import pairwise
from math import exp, inf, isclose

import networkx as nx
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from desim.pursuit.game.game import (
    equilibria,
    gain,
    gibbs,
    greedy_maximal_independent_set,
    is_equilibrium,
    logit,
    profiles,
    relay_profile,
    relay_pursuer,
    welfare,
    wonderful_life_utility,
)
from desim.pursuit.game.utility import EdgePenalty, LocalMean, Minimum

times = st.floats(0.0, 60.0, allow_nan=False)
rewards = st.floats(0.0, 60.0)


@st.composite
def games(draw, most=6):
    """phi, a profile and a reward; some pursuers cannot capture at all."""
    phi = draw(st.lists(times | st.just(inf), min_size=1, max_size=most))
    active = [draw(st.booleans()) and each < inf for each in phi]
    return phi, active, draw(rewards)


@pytest.mark.slow
@given(games(), st.data())
def test_the_global_utility_is_an_exact_potential(game, data):
    """When one pursuer changes its action, its own utility changes by as much as U_E."""
    phi, active, reward = game
    i = data.draw(st.integers(0, len(phi) - 1))
    assume(phi[i] < inf)
    other = [a if j != i else not a for j, a in enumerate(active)]
    own = wonderful_life_utility(phi, other, reward, i) - wonderful_life_utility(phi, active, reward, i)
    everyones = welfare(phi, other, reward) - welfare(phi, active, reward)
    assert isclose(own, everyones, abs_tol=1e-9)


@pytest.mark.slow
@given(games(), st.data())
def test_the_gain_is_the_difference_of_the_wonderful_life_utilities(game, data):
    phi, active, reward = game
    i = data.draw(st.integers(0, len(phi) - 1))
    assume(phi[i] < inf)
    on, off = ([a if j != i else chosen for j, a in enumerate(active)] for chosen in (True, False))
    others = [phi[j] for j in range(len(phi)) if off[j]]
    difference = wonderful_life_utility(phi, on, reward, i) - wonderful_life_utility(phi, off, reward, i)
    assert isclose(gain(phi[i], others, reward), difference, abs_tol=1e-9)
    assert wonderful_life_utility(phi, off, reward, i) == 0.0


@given(st.lists(times, min_size=1, max_size=8, unique=True), rewards)
def test_the_relay_profile_is_the_only_equilibrium(phi, reward):
    """For distinct phi the game is dominance solvable; ties in floating point are kept away by a micrometre."""
    ordered = sorted(phi)
    assume(all(b - a > 1e-6 for a, b in pairwise(ordered)))
    assume(abs(ordered[0] - reward) > 1e-6)
    assert equilibria(phi, reward) == [relay_profile(phi, reward)]


def test_with_the_time_left_as_utility_of_the_empty_set_the_game_would_differ():
    """The control of the test above: two pursuers of equal phi have two equilibria, and no chase is in vain."""
    assert equilibria([2.0, 2.0], 10.0) == [(False, True), (True, False), (True, True)]
    assert equilibria([20.0, 30.0], 10.0) == [(False, False)]


def test_the_relay_pursuer_is_the_least_and_first():
    assert relay_pursuer([3.0, 1.0, 1.0], 5.0) == 1
    assert relay_pursuer([inf, inf], 5.0) is None
    assert relay_pursuer([5.0], 5.0) is None


def test_a_pursuer_that_cannot_capture_never_gains_and_never_counts():
    assert gain(inf, [], 5.0) == gain(inf, [1.0], 5.0) == -inf
    assert welfare([inf, 2.0], [True, True], 5.0) == welfare([inf, 2.0], [False, True], 5.0) == 3.0


def test_a_lone_pursuer_chases_if_it_can_be_in_time():
    assert [gain(own, [], 5.0) for own in (4.0, 5.0, 6.0)] == [1.0, 0.0, -1.0]
    assert welfare([4.0], [False], 5.0) == 0.0


def test_gibbs_law_of_two_pursuers_by_hand():
    """phi = (1, 2), r = 4, tau = 1: U = 0, 2, 3, 2.5 for none, pursuer 1, pursuer 0, both."""
    weights = np.exp([0.0, 2.0, 3.0, 2.5])
    assert profiles(2) == [(False, False), (False, True), (True, False), (True, True)]
    assert gibbs([1.0, 2.0], 4.0, 1.0) == pytest.approx(weights / weights.sum(), rel=1e-14)


@pytest.mark.parametrize(("tau", "relay"), [(1.0, 0.3452), (0.5, 0.6041), (0.2, 0.9168)])
def test_gibbs_law_gives_the_known_probability_of_the_relay_profile(tau, relay):
    law = gibbs([1.0, 2.0, 4.0, 8.0], 25.0, tau)
    assert law[profiles(4).index((True, False, False, False))] == pytest.approx(relay, abs=5e-5)


def test_the_logit_neither_overflows_nor_divides():
    assert logit([0.0, 1e6], 1e6) == [0.0, 1.0]
    assert logit([0.0, -1e6], 1e6) == [1.0, 0.0]
    assert logit([0.0, 3.0, -inf], 0.0) == [1 / 3, 1 / 3, 1 / 3]
    assert logit([0.0, 1.0], 2.0)[1] == pytest.approx(1 / (1 + exp(-2.0)), rel=1e-15)
    assert logit([0.0, 1.0, 3.0], 0.5) == pytest.approx(np.exp([0, 0.5, 1.5]) / np.exp([0, 0.5, 1.5]).sum(), rel=1e-15)


def test_the_gibbs_law_of_a_cold_team_does_not_overflow():
    """exp(3 / 0.001) would."""
    assert gibbs([1.0, 2.0], 4.0, 0.001).tolist() == [0.0, 0.0, 1.0, exp(-500.0)]


def test_the_gibbs_law_requires_finite_capture_times():
    with pytest.raises(ValueError, match=r"should be finite, got \[1.0, inf\]"):
        gibbs([1.0, inf], 4.0, 1.0)


# On a graph.


@st.composite
def games_on_graphs(draw, most=6):
    """Distinct phi, some of them late, r = 10, and the links."""
    count = draw(st.integers(1, most))
    phi = draw(st.permutations([1.0, 2.0, 4.0, 8.0, 16.0, 32.0]))[:count]
    return phi, nx.gnp_random_graph(count, draw(st.floats(0.0, 1.0)), seed=draw(st.integers(0, 1000)))


def neighbourhoods(graph):
    """Return the neighbours of each pursuer."""
    return [list(graph.adj[i]) for i in range(len(graph))]


def maximal_independent_sets(phi, reward, graph):
    """Return the maximal independent sets of the pursuers in time, as profiles, by networkx.

    They are the maximal cliques of the complement.
    """
    timely = [i for i, each in enumerate(phi) if each < reward]
    cliques = nx.find_cliques(nx.complement(graph.subgraph(timely))) if timely else [[]]
    return {tuple(i in clique for i in range(len(phi))) for clique in cliques}


@given(games_on_graphs())
def test_with_a_penalty_on_edges_the_equilibria_are_the_maximal_independent_sets(game):
    phi, graph = game
    assert set(equilibria(phi, 10.0, EdgePenalty(), neighbourhoods(graph))) == maximal_independent_sets(
        phi, 10.0, graph
    )


@pytest.mark.slow
@given(games_on_graphs())
def test_the_greedy_set_is_a_maximal_independent_one_and_the_only_fixed_point_of_local_min(game):
    """A fixed point: a pursuer is active iff it is in time and has no active neighbour of smaller phi."""
    phi, graph = game
    greedy = greedy_maximal_independent_set(phi, 10.0, neighbourhoods(graph))
    assert greedy in maximal_independent_sets(phi, 10.0, graph)

    def chases(profile, i):
        return phi[i] < 10.0 and not any(profile[j] and phi[j] < phi[i] for j in graph.adj[i])

    fixed = [p for p in profiles(len(phi)) if all(p[i] == chases(p, i) for i in range(len(phi)))]
    assert fixed == [greedy]


def test_the_greedy_set_breaks_ties_by_number():
    assert greedy_maximal_independent_set([2.0, 2.0, 1.0], 5.0, [[1], [0], []]) == (True, False, True)
    assert greedy_maximal_independent_set([5.0, 4.0], 5.0, [[1], [0]]) == (False, True)
    assert greedy_maximal_independent_set([5.0, inf], 5.0, [[], []]) == (False, False)


def test_the_greedy_set_follows_the_direction_of_links():
    assert greedy_maximal_independent_set([1.0, 2.0], 5.0, [[1], []]) == (True, True)
    assert greedy_maximal_independent_set([1.0, 2.0], 5.0, [[], [0]]) == (True, False)


def test_on_a_path_of_three_the_local_mean_has_no_equilibrium():
    """j - i - k with phi = (1, 2, 4): by enumeration. On a complete graph it has one; with a penalty on edges two."""
    hearing = neighbourhoods(nx.path_graph(3))
    assert equilibria([1.0, 2.0, 4.0], 25.0, LocalMean(), hearing) == []
    assert equilibria([1.0, 2.0, 4.0], 25.0, LocalMean(), neighbourhoods(nx.complete_graph(3))) == [
        (True, False, False)
    ]
    assert equilibria([1.0, 2.0, 4.0], 25.0, EdgePenalty(), hearing) == [(False, True, False), (True, False, True)]
    assert greedy_maximal_independent_set([1.0, 2.0, 4.0], 25.0, hearing) == (True, False, True)


def test_in_an_equilibrium_a_pursuer_that_cannot_capture_stays_and_is_ignored():
    """Also under a utility that would let it chase for nothing, and with a neighbour that chases in vain."""
    assert not is_equilibrium([1.0, inf], [True, True], 5.0, Minimum())
    assert equilibria([1.0, inf], 5.0, Minimum()) == [(True, False)]
    assert equilibria([inf, 1.0], 5.0, EdgePenalty(), [[1], [0]]) == [(False, True)]
    assert equilibria([inf], 5.0) == [(False,)]


def test_an_equilibrium_ignores_self_links():
    """phi = 1 against none; with a link to itself it would be indifferent, and stay as well."""
    assert equilibria([1.0], 5.0, hearing=[[0]]) == [(True,)]
    assert not is_equilibrium([1.0], [False], 5.0, hearing=[[0]])


def test_under_minimum_a_slower_pursuer_is_indifferent():
    """phi = (1, 2): the first chases, the second neither gains nor loses. Equally fast: one of them, or both."""
    assert equilibria([1.0, 2.0], 5.0, Minimum()) == [(True, False), (True, True)]
    assert equilibria([2.0, 2.0], 5.0, Minimum()) == [(False, True), (True, False), (True, True)]
