"""Clocks with a random walk: the variance of their error, and that reading and waiting by them agree."""

from itertools import pairwise
from math import sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import Scenario, summary
from desim.kernel import wandering_clock
from desim.kernel.core.clock import Clock, Instant, NodeClock, Phase
from desim.kernel.core.units import SECOND
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.wandering_clock import TICK, ClockWalk, WanderingClock, node_clocks
from desim.testing.pursuits import watched

UNTIL = 100 * SECOND
NODES = 1000


def clocks(*skews, size=1, seed=1, until=UNTIL):
    return node_clocks(Clock(), skews, size, seed, until)


def errors(t, **walk):
    """Return the (n,) errors of many clocks at a time, s."""
    return np.array([clock.at(round(t * SECOND)) - t for clock in clocks(ClockSkew(**walk), size=NODES)])


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(("walk", "power"), [({"offset_walk": 1e-3}, 1), ({"drift_walk": 1e-3}, 3)])
@pytest.mark.parametrize("t", [0.01, 1.0, 2.005])
def test_the_variance_of_the_error_grows_as_that_of_the_two_state_model(walk, power, t):
    """a^2 t for a walk of the offset, and b^2 t^3 / 3 for one of the drift; of 1000 clocks, s.e. sqrt(2/n) = 4.5 %.

    Half a tick past 2 s the error is interpolated, less by a share of 1/800 of a^2 t. Control: the other power.
    """
    found, theory = errors(t, **walk).var(), 1e-6 * t**power / power
    error = sqrt(2.0 / NODES)
    assert abs(found / theory - 1.0) < 4.0 * error
    assert abs(errors(t, **walk).mean()) < 4.0 * sqrt(theory / NODES)
    if t > 2.0:
        assert abs(found / (1e-6 * t ** (4 - power) / (4 - power)) - 1.0) > 4.0 * error


@pytest.mark.slow
def test_both_walks_of_several_faults_add_up_and_covary_as_in_the_model():
    """Variance a^2 t + b^2 t^3 / 3 with a^2 of two faults; Cov(x(s), x(t)) = a^2 s + b^2 (t s^2 / 2 - s^3 / 6)."""
    skews = ClockSkew(offset_walk=3e-4), ClockSkew(offset_walk=4e-4, drift_walk=5e-4)
    made = clocks(*skews, size=NODES)
    one, other = (np.array([clock.at(t * SECOND) - t for clock in made]) for t in (1, 2))
    variance = 25e-8 * 2 + 25e-8 * 8 / 3
    covariance = 25e-8 + 25e-8 * (2 / 2 - 1 / 6)
    assert abs(other.var() / variance - 1.0) < 4.0 * sqrt(2.0 / NODES)
    assert abs(np.mean(one * other) - covariance) < 4.0 * sqrt(2.0) * variance / sqrt(NODES)
    assert covariance - 0.0 > 4.0 * sqrt(2.0) * variance / sqrt(NODES)


@given(
    st.integers(0, 2**32),
    st.floats(-5.0, 5.0),
    st.floats(-0.5, 0.5),
    st.floats(0.0, 0.3),
    st.lists(st.integers(-SECOND, 12 * SECOND), min_size=1, max_size=5),
)
def test_a_clock_shows_at_the_time_that_it_waits_for_what_it_was_told(seed, offset, drift, walk, times):
    """In any order of questions, also before the start and after the end of the walk, and with a step in between."""
    skew = ClockSkew(node=0, offset=offset, drift=drift, offset_walk=walk, drift_walk=walk)
    (clock,) = clocks(skew, seed=seed, until=10 * SECOND)
    for true in times:
        assert clock.when(clock.at(true)) == pytest.approx(true, abs=200)
    clock.correct(SECOND // 3)
    for true in times:
        assert clock.when(clock.at(true)) == pytest.approx(true, abs=200)
    (same,) = clocks(skew, seed=seed, until=10 * SECOND)
    shown = [same.at(true) + clock.correction for true in sorted(times)]
    assert shown == pytest.approx([clock.at(true) for true in sorted(times)], abs=1e-9)
    assert all(one <= other for one, other in pairwise(shown))


def test_a_span_ends_where_the_clock_shows_that_it_has_passed():
    env = Clock()
    (clock,) = node_clocks(env, [ClockSkew(offset=1.0, offset_walk=0.01)], 1, 3, UNTIL)
    before = clock.now
    env.run(until=Instant(env, clock.span(2.5), Phase.DECISION))
    assert clock.now - before == pytest.approx(2.5, abs=1e-8)
    assert clock.stamp == pytest.approx(clock.now * SECOND, abs=1)
    assert clock.uncorrected == clock.stamp
    assert env.now != 2.5 * SECOND


@pytest.mark.parametrize("skew", [ClockSkew(node=0, drift=0.25), ClockSkew(node=0, drift=0.25, offset_walk=0.01)])
def test_a_negative_span_is_negative_and_refused_whether_or_not_a_clock_wanders(skew):
    env = Clock()
    (clock,) = node_clocks(env, [skew], 1, 3, UNTIL)
    env.run(until=Instant(env, SECOND, Phase.DECISION))
    assert clock.span(-0.5) == -0.4 * SECOND
    with pytest.raises(ValueError, match="has passed"):
        Instant(env, env.now + clock.span(-0.5), Phase.DECISION)


@pytest.mark.timeout(10)
def test_the_error_of_a_clock_stays_as_it_is_from_the_end_on():
    (clock,) = clocks(ClockSkew(offset_walk=1e-3), until=SECOND)
    before, *after = (clock.at(t) - t / SECOND for t in (SECOND - TICK, SECOND, SECOND + TICK // 2, 9 * SECOND))
    assert after == pytest.approx([after[0]] * 3, abs=1e-12)
    assert abs(before - after[0]) > 1e-6


def test_only_the_clocks_of_nodes_with_a_walk_wander():
    made = clocks(ClockSkew(node=1, drift_walk=1e-6), ClockSkew(node=2, drift=0.1), size=3)
    assert [type(clock) for clock in made] == [NodeClock, WanderingClock, NodeClock]
    assert TICK == SECOND // 100


@pytest.mark.slow
@pytest.mark.parametrize("access", ["tdma", "slotted_aloha"])
def test_a_team_on_wandering_clocks_keeps_all_invariants(access):
    """Clocks that wander by milliseconds: frames of a TDMA without guard time are lost, and with right clocks none."""
    lost = []
    for walk in (0.0, 3e-3):
        scenario = Scenario(
            team={"count": 4},
            horizon=3.0,
            protocol="local_min",
            network={"medium": {"kind": "bitrate", "bitrate": 1e5, "access": {"kind": access, "slot": 0.005}}},
            fault=[{"kind": "clock_skew", "offset_walk": walk, "drift_walk": walk}],
            record={"messages": True},
        )
        lost.append(summary(watched(scenario, 3)).messages_lost)
    assert lost[0] < lost[1] if access == "tdma" else lost[0] != lost[1]


@given(st.integers(0, 2**32), st.integers(1, 300), st.lists(st.integers(0, 5 * SECOND), min_size=1, max_size=5))
def test_a_walk_drawn_ahead_is_that_drawn_state_by_state(seed, block, times):
    """Whatever the number of states that are drawn at once, and in whatever order the clock is read."""

    def errors_by(size, moments):
        walk = ClockWalk(1e-3, 1e-3, 1.0, UNTIL, np.random.default_rng(seed))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(wandering_clock, "BLOCK", size)
            return {t: walk.error(t) for t in moments}

    assert errors_by(1, sorted(times)) == errors_by(block, times)


def test_the_first_tick_has_the_variance_of_an_integrated_brownian_motion():
    """It is b^2 t^3 / 3; later ticks hide what is drawn within one. Five standard errors are 22 %."""
    walks = [ClockWalk(0.0, 0.1, 1.0, TICK, np.random.default_rng(seed)) for seed in range(1000)]
    theory = 0.1**2 * (TICK / SECOND) ** 3 / 3.0
    assert np.mean([walk.error(TICK) ** 2 for walk in walks]) == pytest.approx(theory, rel=0.22)
