"""The game with several evaders: identities, enumeration, best matchings, how poor an equilibrium may be."""

from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.pursuit.game.game import (
    equilibria,
    gibbs,
    greedy_assignment,
    is_equilibrium,
    optimal_assignment,
    optimum,
    profiles,
    relay_pursuer,
    welfare,
    wonderful_life_utility,
)

REWARD = 25.0
SIZES = [(2, 2), (3, 2), (2, 3), (4, 2), (3, 3)]
"""Pursuers and evaders."""
times = st.floats(0.0, 40.0)


@st.composite
def games(draw, most=4, evaders=None):
    """(N, M) phi, a profile and a reward; some pursuers cannot capture some evaders, and do not chase them."""
    n, m = draw(st.integers(1, most)), evaders or draw(st.integers(2, 3))
    phi = draw(st.lists(st.lists(times | st.just(inf), min_size=m, max_size=m), min_size=n, max_size=n))
    able = [[0, *(j for j in range(1, m + 1) if row[j - 1] < inf)] for row in phi]
    return np.array(phi), tuple(draw(st.sampled_from(each)) for each in able), draw(times)


def drawn(size, seed):
    """Return (N, M) distinct times of capture, s, of which some are longer than `REWARD`."""
    return np.random.default_rng([seed, *size]).uniform(0.0, 30.0, size)


def profile(assignment, count):
    return tuple(assignment.get(i, 0) for i in range(count))


def best_of_all(phi, reward):
    return max(welfare(phi, actions, reward) for actions in profiles(*phi.shape))


@pytest.mark.slow
@given(games(), st.data())
def test_the_global_utility_is_an_exact_potential(drawn_game, data):
    """When one pursuer changes its action, its own utility changes by as much as Phi."""
    phi, actions, reward = drawn_game
    i = data.draw(st.integers(0, len(phi) - 1))
    other = data.draw(st.sampled_from([0, *(j for j, time in enumerate(phi[i], start=1) if time < inf)]))
    changed = (*actions[:i], other, *actions[i + 1 :])
    own = wonderful_life_utility(phi, changed, reward, i) - wonderful_life_utility(phi, actions, reward, i)
    everyones = welfare(phi, changed, reward) - welfare(phi, actions, reward)
    assert own == pytest.approx(everyones, abs=1e-9)


@given(games(), st.data())
def test_the_wonderful_life_utility_is_the_loss_of_welfare_if_a_pursuer_stays(drawn_game, data):
    phi, actions, reward = drawn_game
    i = data.draw(st.integers(0, len(phi) - 1))
    without = (*actions[:i], 0, *actions[i + 1 :])
    lost = welfare(phi, actions, reward) - welfare(phi, without, reward)
    assert wonderful_life_utility(phi, actions, reward, i) == pytest.approx(lost, abs=1e-9)


@pytest.mark.slow
@given(games(evaders=1))
def test_with_one_evader_it_is_the_game_of_the_paper(drawn_game):
    """U_E(S) = r - mean of phi over S; the capture times may then be N numbers, and the profile truth values."""
    phi, actions, reward = drawn_game
    one, active = phi[:, 0].tolist(), [bool(action) for action in actions]
    chasing = [time for time, chases in zip(one, active, strict=True) if chases]
    assert welfare(one, active, reward) == welfare(phi, actions, reward)
    assert welfare(one, active, reward) == pytest.approx(reward - sum(chasing) / len(chasing) if chasing else 0.0)
    assert equilibria(phi, reward) == equilibria(one, reward)


@pytest.mark.slow
@given(games(evaders=1))
def test_with_one_evader_the_best_assignment_is_the_relay_pursuer(drawn_game):
    """Or another that is as fast."""
    phi, _, reward = drawn_game
    relay = relay_pursuer(phi[:, 0].tolist(), reward)
    assignment = optimal_assignment(phi, reward)
    found = [phi[i, 0] for i in assignment]
    assert found == pytest.approx([] if relay is None else [phi[relay, 0]], abs=1e-9)
    assert set(assignment.values()) <= {1}


def test_the_welfare_is_that_of_a_game_worked_out_by_hand():
    """Evader 1 is chased by pursuers at 3 and 5 s, evader 2 by one at 10 s, evader 3 by none; r = 25 s."""
    phi = [[3.0, 1.0, 1.0], [5.0, 1.0, 1.0], [1.0, 10.0, 1.0], [1.0, 1.0, 1.0]]
    assert welfare(phi, (1, 1, 2, 0), 25.0) == (25 - 4) + (25 - 10)
    assert wonderful_life_utility(phi, (1, 1, 2, 0), 25.0, 0) == (25 - 4) - (25 - 5)
    assert wonderful_life_utility(phi, (1, 1, 2, 0), 25.0, 2) == 25 - 10
    assert wonderful_life_utility(phi, (1, 1, 2, 0), 25.0, 3) == 0.0


def test_a_pursuer_that_can_never_capture_does_not_count_and_is_in_no_equilibrium():
    phi = [[inf, 4.0], [2.0, inf]]
    assert welfare(phi, (1, 1), 25.0) == 23.0
    assert equilibria(phi, 25.0) == [(2, 1)]
    assert not is_equilibrium(phi, (1, 1), 25.0)
    assert equilibria([[inf], [inf]], 25.0) == [(0, 0)]


def test_no_unilateral_deviation_improves_on_an_equilibrium():
    """The control of `is_equilibrium`: the utilities of all other actions, one by one."""
    for seed in range(20):
        phi = drawn((3, 2), seed)
        for actions in profiles(3, 2):
            tried = [
                wonderful_life_utility(phi, (*actions[:i], other, *actions[i + 1 :]), REWARD, i)
                <= wonderful_life_utility(phi, actions, REWARD, i) + 1e-9
                for i in range(3)
                for other in range(3)
            ]
            assert is_equilibrium(phi, actions, REWARD) == all(tried)


@pytest.mark.parametrize("size", SIZES)
def test_an_equilibrium_has_at_most_one_pursuer_on_an_evader_and_several_are_common(size):
    """100 games with times in [0, 30] s and r = 25 s: a quarter and more have several equilibria, some have five."""
    counts = []
    for seed in range(100):
        found = equilibria(drawn(size, seed), REWARD)
        counts.append(len(found))
        for actions in found:
            engaged = [action for action in actions if action]
            assert len(engaged) == len(set(engaged))
    assert min(counts) == 1
    assert sum(count > 1 for count in counts) >= 25


@pytest.mark.parametrize("size", SIZES)
def test_the_best_assignment_is_the_best_of_all_profiles_and_an_equilibrium(size):
    """That follows from the exact potential: no pursuer can improve on the best; here counted in 50 games each."""
    for seed in range(50):
        phi = drawn(size, seed)
        best = profile(optimal_assignment(phi, REWARD), len(phi))
        assert welfare(phi, best, REWARD) == pytest.approx(best_of_all(phi, REWARD), abs=1e-9)
        assert optimum(phi, REWARD) == pytest.approx(welfare(phi, best, REWARD), abs=1e-9)
        assert is_equilibrium(phi, best, REWARD)


@pytest.mark.slow
@given(games(most=3))
def test_the_best_assignment_is_the_best_if_some_can_never_capture_some(drawn_game):
    phi, _, reward = drawn_game
    best = profile(optimal_assignment(phi, reward), len(phi))
    assert welfare(phi, best, reward) == pytest.approx(best_of_all(phi, reward), abs=1e-9)
    assert all(phi[i, j - 1] < reward for i, j in enumerate(best) if j)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("size", SIZES)
def test_no_equilibrium_is_worth_less_than_a_third_of_the_best_profile(size):
    """Of 200 games each, the poorest equilibrium has 0.35 to 0.5 of the optimum."""
    shares = []
    for seed in range(200):
        phi = drawn(size, seed)
        best = optimum(phi, REWARD)
        shares += [welfare(phi, actions, REWARD) / best for actions in equilibria(phi, REWARD) if best]
    assert 1.0 / 3.0 < min(shares) < 0.6


@pytest.mark.parametrize("spare", [1e-6, -1e-6])
def test_an_equilibrium_may_be_worth_no_more_than_a_third_of_the_best_profile(spare):
    """Each chases what it is worth 8 s on, and would be worth 24 s if they swapped: (24 - 8) / 2 is no more than 8.

    The control: where it is more, neither keeps to its evader.
    """
    near, far = 25.0 - 24.0, 25.0 - 8.0 - spare
    phi = [[far, near], [near, far]]
    assert is_equilibrium(phi, (1, 2), 25.0) == (spare > 0)
    assert optimal_assignment(phi, 25.0) == {0: 2, 1: 1}
    assert welfare(phi, (1, 2), 25.0) / optimum(phi, 25.0) == pytest.approx(1 / 3, rel=1e-6)


def test_to_take_the_nearest_pair_first_may_be_poor():
    phi = [[1.0, 2.0], [2.0, 24.0]]
    greedy = greedy_assignment({1: {0: 1.0, 1: 2.0}, 2: {0: 2.0, 1: 24.0}}, 25.0)
    assert greedy == {0: 1, 1: 2}
    assert welfare(phi, profile(greedy, 2), 25.0) == 25.0
    assert is_equilibrium(phi, (1, 2), 25.0)
    assert optimal_assignment(phi, 25.0) == {0: 2, 1: 1}
    assert optimum(phi, 25.0) == 46.0


def test_late_and_unknown_pursuers_are_left_out_of_the_best_assignment():
    assert optimal_assignment([[25.0, nan], [inf, 24.0], [30.0, 3.0]], 25.0) == {2: 2}
    assert optimal_assignment([[inf, 26.0]], 25.0) == {}
    assert optimum([[inf, 26.0]], 25.0) == 0.0


def test_late_and_unknown_pursuers_are_left_out_of_the_greedy_assignment():
    """So is a pursuer that would arrive just as time is up."""
    assert greedy_assignment({1: {0: nan, 1: 24.0}, 2: {0: 25.0, 1: 3.0}}, 25.0) == {1: 2}
    assert greedy_assignment({1: {0: nan}, 2: {1: 25.0}}, 25.0) == {}


@pytest.mark.parametrize("size", [(2, 5), (5, 2)])
def test_surplus_pursuers_wait(size):
    assignment = optimal_assignment(drawn(size, 0) / 2, REWARD)
    assert len(assignment) == 2
    assert len(set(assignment.values())) == 2


def test_the_gibbs_law_is_that_of_the_global_utility():
    """The profiles are in order of (pursuer 0, pursuer 1), and a second of welfare is a factor of exp(1 / tau)."""
    phi = [[3.0, 5.0], [4.0, 24.5]]
    order = profiles(2, 2)
    assert order[:4] == [(0, 0), (0, 1), (0, 2), (1, 0)]
    law = dict(zip(order, gibbs(phi, 25.0, 4.0), strict=True))
    assert sum(law.values()) == pytest.approx(1.0)
    assert law[2, 1] / law[1, 2] == pytest.approx(np.exp((20 + 21 - 22 - 0.5) / 4.0))
    assert law[1, 1] / law[0, 0] == pytest.approx(np.exp((25 - 3.5) / 4.0))


def test_times_of_capture_are_a_matrix_or_numbers_and_for_the_gibbs_law_finite():
    with pytest.raises(ValueError, match="all capture times should be finite"):
        gibbs([[1.0, inf]], 25.0, 1.0)
    for tau in (0.0, -1.0, nan):
        with pytest.raises(ValueError, match=rf"the temperature should be positive \(got {tau}\)"):
            gibbs([[1.0, 2.0]], 25.0, tau)
    with pytest.raises(ValueError, match=r"\(N, M\) matrix"):
        welfare([[[1.0]], [[2.0]]], (0, 1), 25.0)


@pytest.mark.parametrize("actions", [(0,), (0, 3), (-1, 0), (0, 0, 0), (0.5, 0), ("1", 0), ([1], 0)])
def test_actions_are_those_of_the_game(actions):
    phi = [[1.0, 2.0], [3.0, 4.0]]
    for function in (welfare, is_equilibrium, lambda *game: wonderful_life_utility(*game, 0)):
        with pytest.raises(ValueError, match="actions should be 2 numbers from 0 to 2, one for each pursuer"):
            function(phi, actions, 25.0)


@pytest.mark.parametrize("phi", [[], np.zeros((0, 2))])
def test_a_game_without_pursuers_has_one_profile(phi):
    assert equilibria(phi, 25.0) == [()]
    assert gibbs(phi, 25.0, 1.0).tolist() == [1.0]
    assert welfare(phi, (), 25.0) == optimum(phi, 25.0) == 0.0
    assert relay_pursuer([], 25.0) is None
