"""The pursuit game: identities, enumeration, closed forms."""

from itertools import pairwise
from math import exp, inf, isclose

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from desim.pursuit.capture import capture_time, intercept_time
from desim.pursuit.game import (
    best_response,
    equilibria,
    gain,
    gibbs,
    logit,
    potential,
    profiles,
    relay_profile,
    relay_pursuer,
    wonderful_life_utility,
)

times = st.floats(0.0, 60.0, allow_nan=False)
rewards = st.floats(0.0, 60.0)


@st.composite
def games(draw, most=6):
    """phi, a profile and a reward; some pursuers cannot capture at all."""
    phi = draw(st.lists(times | st.just(inf), min_size=1, max_size=most))
    active = [draw(st.booleans()) and each < inf for each in phi]
    return phi, active, draw(rewards)


@given(games(), st.data())
def test_the_global_utility_is_an_exact_potential(game, data):
    """When one pursuer changes its action, its own utility changes by as much as U_E."""
    phi, active, reward = game
    i = data.draw(st.integers(0, len(phi) - 1))
    assume(phi[i] < inf)
    other = [a if j != i else not a for j, a in enumerate(active)]
    own = wonderful_life_utility(phi, other, reward, i) - wonderful_life_utility(phi, active, reward, i)
    everyones = potential(phi, other, reward) - potential(phi, active, reward)
    assert isclose(own, everyones, abs_tol=1e-9)


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


def test_with_the_time_left_as_utility_of_nobody_the_game_would_be_another():
    """The control of the test above: two pursuers of equal phi have two equilibria, and nobody chases in vain."""
    assert equilibria([2.0, 2.0], 10.0) == [(False, True), (True, False), (True, True)]
    assert equilibria([20.0, 30.0], 10.0) == [(False, False)]


def test_the_relay_pursuer_is_the_least_and_first():
    assert relay_pursuer([3.0, 1.0, 1.0], 5.0) == 1
    assert relay_pursuer([inf, inf], 5.0) is None
    assert relay_pursuer([5.0], 5.0) is None


def test_a_pursuer_that_cannot_capture_never_gains_and_never_counts():
    assert gain(inf, [], 5.0) == gain(inf, [1.0], 5.0) == -inf
    assert not best_response(inf, [], 5.0)
    assert potential([inf, 2.0], [True, True], 5.0) == potential([inf, 2.0], [False, True], 5.0) == 3.0


def test_a_lone_pursuer_chases_if_it_can_be_in_time():
    assert best_response(4.0, [], 5.0)
    assert not best_response(6.0, [], 5.0)
    assert potential([4.0], [False], 5.0) == 0.0


def test_gibbs_law_of_two_pursuers_by_hand():
    """phi = (1, 2), r = 4, tau = 1: U = 0, 2, 3, 2.5 for nobody, pursuer 1, pursuer 0, both."""
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


coordinates = st.floats(-20.0, 20.0)
speeds_of_players = st.floats(0.0, 3.0).map(lambda v: round(v, 6))
points = st.tuples(coordinates, coordinates)


@given(points, st.lists(st.tuples(points, speeds_of_players), min_size=1, max_size=5), st.floats(0.0, 2.0))
def test_radial_capture_time_solves_its_equation(evader, team, v_e):
    """After phi the gap |x_e - x_i| - eps has been closed at v_i - v_e."""
    at, speeds = np.array([p for p, _ in team]), np.array([v for _, v in team])
    phi = capture_time(evader, at, speeds, v_e, 0.1)
    distance = np.hypot(*(np.array(evader) - at).T)
    for d, v, time in zip(distance, speeds, phi, strict=True):
        if d <= 0.1:
            assert time == 0.0
        elif v <= v_e:
            assert time == inf
        else:
            assert time * (v - v_e) == pytest.approx(d - 0.1, rel=1e-9, abs=1e-12)


@given(points, points, points, speeds_of_players, st.floats(0.01, 1.0))
def test_intercept_time_is_the_first_time_at_which_the_evader_can_be_reached(evader, velocity, at, speed, eps):
    """|x_e + w t - x_i| <= v t + eps holds at phi and at no sampled earlier time."""
    phi = float(intercept_time(evader, velocity, [at], [speed], eps)[0])

    def slack(t):
        gap = np.array(evader) + np.array(velocity) * t - np.array(at)
        return speed * t + eps - np.hypot(*gap)

    scale = 1e-6 * (1 + np.hypot(*velocity)) * (1 + min(phi, 1e6))
    horizon = 100.0 if phi == inf else phi
    if phi < 1e6:
        assert slack(phi) >= -scale
    assert phi == 0.0 or all(slack(t) < scale for t in np.linspace(0.0, min(horizon, 100.0), 200)[:-1])


def test_a_closing_speed_that_is_nothing_but_rounding_counts_as_none():
    """0.1 / 5e-324 would overflow."""
    assert capture_time([1.0, 0.0], [[0.0, 0.0]], [5e-324], 0.0, 0.1) == inf
    assert capture_time([1.0, 0.0], [[0.0, 0.0]], [0.1 + 0.2], 0.3, 0.1) == inf


def test_intercept_of_an_evader_that_flees_straight_is_the_radial_time():
    radial = capture_time([3.0, 4.0], [[0.0, 0.0]], [2.0], 0.9, 0.1)
    assert intercept_time([3.0, 4.0], [0.54, 0.72], [[0.0, 0.0]], [2.0], 0.1) == pytest.approx(radial)
    assert radial == pytest.approx([(5.0 - 0.1) / 1.1])


@pytest.mark.parametrize(
    ("evader", "pursuers", "speeds", "radius", "text"),
    [
        ([0.0], [[1.0, 1.0]], [1.0], 0.1, "shapes"),
        ([0.0, 0.0], [1.0, 1.0], [1.0], 0.1, "shapes"),
        ([0.0, 0.0], [[1.0, 1.0]], [1.0, 2.0], 0.1, "shapes"),
        ([0.0, 0.0], [[1.0, 1.0]], [1.0], 0.0, "greater than 0 m, got 0.0"),
    ],
)
def test_shapes_and_radius_are_checked(evader, pursuers, speeds, radius, text):
    with pytest.raises(ValueError, match=text):
        capture_time(evader, pursuers, speeds, 0.9, radius)
    with pytest.raises(ValueError, match=text):
        intercept_time(evader, [0.0, 0.0], pursuers, speeds, radius)
