"""The states of channels that are correlated in time and place against the theory, and what networks receive.

The controls have no memory: their states are new at each question, as with `fading = "message"`.
"""

from math import exp, gamma, pi, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import gammainc, i0, j0
from scipy.stats import ncx2

from desim.kernel.core.portable_math import cos_of_turns
from desim.kernel.models.coherence import LIGHT, Coherence
from desim.kernel.models.fading import nakagami_powers, rice_powers
from desim.kernel.topology import correlated_channel
from desim.kernel.topology.correlated_channel import CorrelatedChannel, Ends

DOPPLER = 10.0
FREQUENCY = 2.4e9
K = 2.0 * pi * FREQUENCY / LIGHT
"""Wave number, rad/m."""
APART = (0.0, 0.0), (7.0, 5.0)
"""Positions of the ends of a link, m."""


def states(coherence, pairs, src_at=APART[0], dst_at=APART[1], time=0.0, seed=1):
    """Return the states of the channels of some pairs, which all have the same ends; or of one pair at many times."""
    nodes = np.arange(pairs)
    channel = CorrelatedChannel(coherence, seed, 2 * pairs)
    places = [np.broadcast_to(np.asarray(at), (pairs, 2)) for at in (src_at, dst_at)]
    return channel.between(Ends(nodes, nodes + pairs, *places, time))


def course(coherence, pairs, times, seed=1, count=2):
    """Return (count, times, pairs) Gaussian processes of links whose nodes are at rest."""
    channel = CorrelatedChannel(coherence, seed, 2 * pairs)
    at = np.broadcast_to(APART[1], (len(times), 2))
    courses = [
        channel.between(Ends(node, np.full(len(times), node + pairs), np.array(APART[0]), at, times)).normals(count)
        for node in range(pairs)
    ]
    return np.stack(courses, axis=2)


def deviation(samples, expected):
    """Return how many standard errors the mean of independent samples is off."""
    return (np.mean(samples) - expected) / (np.std(samples) / sqrt(np.size(samples)))


# Autocorrelation.


@pytest.mark.slow
def test_the_gain_has_the_autocorrelation_of_clarke_in_time():
    """J0(2 pi f_d t), of 3000 pairs: s.e. 0.013. The control is new at each time."""
    model, pairs = Coherence(doppler=DOPPLER), 3000
    first = states(model, pairs).normals(2)
    for t in (0.005, 0.02, 0.0383, 0.06, 0.1):
        later, fresh = states(model, pairs, time=t).normals(2), states(model, pairs, time=t, seed=2).normals(2)
        theory = j0(2.0 * pi * DOPPLER * t)
        assert abs(deviation((first * later).sum(axis=0) / 2.0, theory)) < 3.0
        assert abs(deviation(first[0] * later[1], 0.0)) < 3.0
        if abs(theory) > 0.1:
            assert abs(deviation((first * fresh).sum(axis=0) / 2.0, theory)) > 5.0


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    ("moved", "met"), [((0.02, 0.01), (0.0, 0.03)), ((0.03, 0.0), (0.0, 0.0)), ((0.0, 0.0), (0.01, -0.02))]
)
def test_the_gain_has_the_autocorrelation_of_the_paths_of_both_nodes(moved, met):
    """J0(k |dx|) J0(k |dy|), as at the Doppler frequencies v f / c of both; the control has paths twice as long."""
    model, pairs = Coherence(frequency=FREQUENCY), 3000
    first = states(model, pairs).normals(2)
    ends = np.add(APART[0], moved), np.add(APART[1], met)
    theory = j0(K * np.hypot(*moved)) * j0(K * np.hypot(*met))
    products = (first * states(model, pairs, *ends).normals(2)).sum(axis=0) / 2.0
    assert abs(deviation(products, theory)) < 3.0
    longer = states(model, pairs, np.add(APART[0], np.multiply(moved, 2.0)), np.add(APART[1], np.multiply(met, 2.0)))
    assert abs(deviation((first * longer.normals(2)).sum(axis=0) / 2.0, theory)) > 5.0


@pytest.mark.slow
def test_each_pair_has_the_autocorrelation_within_a_few_wavelengths():
    """Over 40 s, 400 coherence times and more, s.e. at most 1 / 20 for a pair; the mean of 20 pairs has 0.011.

    The control has a Doppler frequency that is a fifth higher.
    """
    times = np.arange(0.0, 40.0, 0.02)
    x, y = course(Coherence(doppler=DOPPLER), 20, times)
    gain = x + 1j * y
    for lag in (1, 2, 4):
        products = (gain[:-lag].conj() * gain[lag:]).real.mean(axis=0) / 2.0
        assert abs(deviation(products, j0(2.0 * pi * DOPPLER * 0.02 * lag))) < 3.0
        assert abs(deviation(products, j0(1.2 * 2.0 * pi * DOPPLER * 0.02 * lag))) > 3.0
        assert products.std() < 0.1


@pytest.mark.slow
def test_shadowing_decorrelates_exponentially_along_the_path_of_either_node():
    """exp(-|dx| / d) and exp(-(|dx| + |dy|) / d) with d = 10 m, of 4000 pairs: s.e. 0.016; the control has d = 20 m.

    The bias if both nodes move is of the size of the standard error: see the next test.
    """
    model, pairs = Coherence(decorrelation=10.0), 4000
    first = states(model, pairs).shadowing()
    twice = states(Coherence(decorrelation=20.0), pairs).shadowing()
    for moved, met in [((1.0, 0.0), 0), ((3.0, 4.0), 0), ((0.0, 0.0), 10.0), ((0.0, -20.0), 0), ((3.0, 0.0), 4.0)]:
        ends = np.add(APART[0], moved), np.add(APART[1], (0.0, met))
        path = np.hypot(*moved) + met
        assert abs(deviation(first * states(model, pairs, *ends).shadowing(), exp(-path / 10.0))) < 3.0
        if path > 3.0:
            other = twice * states(Coherence(decorrelation=20.0), pairs, *ends).shadowing()
            assert abs(deviation(other, exp(-path / 10.0))) > 3.0


@pytest.mark.slow
@pytest.mark.parametrize(("waves", "bias", "error"), [(8, 0.090, 0.003), (64, 0.0182, 0.0005)])
def test_the_mean_autocorrelation_of_shadowing_is_exact_unless_both_nodes_move(waves, bias, error):
    """Each by 0.3 d, averaged exactly over the turns and over 300 seeds; s.e. of one node at most 0.002."""
    one, both = [], []
    for seed in range(300):
        spectrum = CorrelatedChannel(Coherence(decorrelation=1.0, waves=waves), seed, 2)._spectrum
        ends = [j0(2.0 * pi * 0.3 * np.hypot(*spectrum[rows])) for rows in (slice(0, 2), slice(2, 4))]
        one.append(ends[0].mean())
        both.append((ends[0] * ends[1]).mean())
    assert abs(deviation(np.array(one), exp(-0.3))) < 3.0
    assert abs(np.mean(both) - exp(-0.6) - bias) < 3.0 * error < bias


@pytest.mark.slow
@pytest.mark.parametrize("shared", [0.8, 0.3, 0.0])
def test_links_with_one_node_in_common_share_half_of_the_shared_variance(shared):
    """Four nodes are scattered, 1500 times: s.e. at most 0.02. Links without a node in common share nothing."""
    times, at = 1500, np.array([(0.0, 0.0), (30.0, 5.0), (-8.0, 20.0), (11.0, -40.0)])
    channel = CorrelatedChannel(Coherence(decorrelation=5.0, shared=shared), 1, 4 * times)
    src, dst = (np.tile(nodes, times) for nodes in np.triu_indices(4, 1))
    team = 4 * np.repeat(np.arange(times), 6)
    of = channel.between(Ends(src + team, dst + team, at[src], at[dst], 0.0)).shadowing().reshape(times, 6).T
    common = [of[a] * of[b] for a, b in [(0, 1), (0, 2), (1, 2), (0, 3), (0, 4), (1, 3), (3, 4), (1, 5)]]
    apart = [of[0] * of[5], of[1] * of[4], of[2] * of[3]]
    assert abs(deviation(np.mean(common, axis=0), shared / 2.0)) < 3.0
    assert abs(deviation(np.mean(apart, axis=0), 0.0)) < 3.0
    assert abs(deviation(np.mean(of**2, axis=0), 1.0)) < 3.0
    if shared:
        assert abs(deviation(np.mean(common, axis=0), shared)) > 3.0


@pytest.mark.slow
def test_what_surrounds_a_node_stays_while_the_other_moves_away():
    """(1 - s / 2) exp(-|dx| / d) + s / 2."""
    model, pairs = Coherence(decorrelation=10.0, shared=0.6), 4000
    first = states(model, pairs).shadowing()
    for dx in (5.0, 500.0):
        moved = states(model, pairs, np.add(APART[0], (dx, 0.0))).shadowing()
        assert abs(deviation(first * moved, 0.7 * exp(-dx / 10.0) + 0.3)) < 3.0


# Distributions.

NAKAGAMI = [0.7, 0.5, 1.0, 1.5, 2.2, 4.0, 12.0]


@pytest.mark.slow
@pytest.mark.parametrize("m", NAKAGAMI)
def test_the_outage_of_nakagami_fading_is_that_of_a_gamma_distribution(m):
    """P(m, m x), of 12,000 pairs: s.e. at most 0.0046; the control has 1.3 m."""
    powers = nakagami_powers(m, states(Coherence(doppler=1.0), 12_000).normals)
    for x in (0.3, 0.7, 1.2):
        assert abs(deviation(powers < x, gammainc(m, m * x))) < 3.0
    off = [abs(deviation(powers < x, gammainc(1.3 * m, 1.3 * m * x))) for x in (0.3, 0.7, 1.2)]
    assert max(off) > 3.0


@pytest.mark.slow
@pytest.mark.parametrize("k", [3.0, 0.0, 0.5, 20.0])
def test_the_outage_of_rice_fading_is_marcums_function(k):
    """1 - Q_1(sqrt(2 K), sqrt(2 (K + 1) x)); the control has 1.5 K + 1."""
    powers = rice_powers(k, states(Coherence(doppler=1.0), 12_000).normals)
    for x in (0.3, 0.7, 1.2):
        assert abs(deviation(powers < x, ncx2.cdf(2.0 * (k + 1.0) * x, 2, 2.0 * k))) < 3.0
    other = 1.5 * k + 1.0
    off = [abs(deviation(powers < x, ncx2.cdf(2.0 * (other + 1.0) * x, 2, 2.0 * other))) for x in (0.3, 0.7, 1.2)]
    assert max(off) > 3.0


@pytest.mark.slow
def test_shadowing_is_normal():
    drawn = states(Coherence(decorrelation=3.0, shared=0.5), 12_000).shadowing()
    for moment, expected in [(1, 0.0), (2, 1.0), (3, 0.0), (4, 3.0)]:
        assert abs(deviation(drawn**moment, expected)) < 3.0


# Crossings.


def of_rice(k, level):
    """Return the rate at which Rice fading crosses an amplitude, in units of f_d (Rice 1948)."""
    inside = 2.0 * level * sqrt(k * (k + 1.0))
    return sqrt(2.0 * pi * (k + 1.0)) * level * exp(-k - (k + 1.0) * level**2) * i0(inside)


def of_nakagami(m, level):
    """Return the rate at which Nakagami fading crosses an amplitude, in units of f_d (Yacoub et al. 1999)."""
    return sqrt(2.0 * pi) * m ** (m - 0.5) / gamma(m) * level ** (2.0 * m - 1.0) * exp(-m * level**2)


CROSSED = {
    "rayleigh": (lambda normals: nakagami_powers(1.0, normals), of_nakagami(1.0, 0.5), gammainc(1.0, 0.25), 2),
    "nakagami": (lambda normals: nakagami_powers(2.0, normals), of_nakagami(2.0, 0.5), gammainc(2.0, 0.5), 4),
    "half": (lambda normals: nakagami_powers(1.5, normals), of_nakagami(1.5, 0.5), gammainc(1.5, 0.375), 3),
    "rice": (lambda normals: rice_powers(3.0, normals), of_rice(3.0, 0.5), ncx2.cdf(2.0, 2, 6.0), 2),
}


def test_the_rates_of_the_literature_agree_where_models_do():
    """At f_d = 10 Hz Rayleigh fading falls below half of its root mean square 9.761 times per second."""
    for level in (0.1, 0.5, 1.0):
        rayleigh = sqrt(2.0 * pi) * level * exp(-(level**2))
        assert of_rice(0.0, level) == pytest.approx(rayleigh)
        assert of_nakagami(1.0, level) == pytest.approx(rayleigh)
    assert 10.0 * of_nakagami(1.0, 0.5) == pytest.approx(9.761, abs=5e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", CROSSED)
def test_fades_are_as_frequent_and_as_long_as_the_theory_says(name):
    """The power falls below a quarter of its mean with the rate of the theory; fades last for the outage divided by it.

    Each of 40 pairs is followed for 2 s; s.e. 3 to 5 %. The control is new at each sample.
    """
    powers_of, rate, outage, count = CROSSED[name]
    pairs, times = 40, np.arange(0.0, 2.0, 1e-3)
    normals = course(Coherence(doppler=DOPPLER), pairs, times, seed=7, count=count)
    fresh = np.random.default_rng(0).normal(size=normals.shape)

    def shares(drawn):
        below = powers_of(lambda _: drawn.reshape(count, -1)).reshape(len(times), pairs) < 0.25
        begun = (below[1:] & ~below[:-1]).sum(axis=0)
        return begun / times[-1], below.mean(axis=0)

    begun, below = shares(normals)
    assert abs(deviation(begun, DOPPLER * rate)) < 3.0
    # Of a ratio of means the residuals have the standard error.
    length = outage / (DOPPLER * rate)
    assert abs(deviation(below - length * begun, 0.0)) < 3.0
    of_fresh, _ = shares(fresh)
    assert of_fresh.mean() > 5.0 * DOPPLER * rate


# Reproducibility.


@pytest.mark.slow
@given(st.data())
@settings(max_examples=10, deadline=None)
def test_states_do_not_depend_on_who_asks_when_and_for_how_many(data):
    """Both ends see one channel, and it is the same alone, among others, in another order and in another run."""
    model = Coherence(doppler=3.0, frequency=1e8, decorrelation=4.0, shared=0.4, waves=data.draw(st.integers(8, 20)))
    seed, size = data.draw(st.integers(0, 9)), 4
    places = np.array(data.draw(st.lists(st.tuples(*[st.floats(-50.0, 50.0)] * 2), min_size=size, max_size=size)))
    channel = CorrelatedChannel(model, seed, size)
    asked = data.draw(
        st.permutations([(i, j, t) for i in range(size) for j in range(size) for t in (0.0, 7.5) if i != j])
    )
    answers = {}
    for src, dst, t in asked:
        state = channel.between(Ends(src, np.array([dst]), places[src], places[[dst]], t))
        answers[src, dst, t] = [*state.normals(3).ravel().tolist(), *state.shadowing().tolist()]
    assert all(answers[i, j, t] == answers[j, i, t] for i, j, t in asked)
    fresh = CorrelatedChannel(model, seed, size)
    src, dst, times = (np.array(column) for column in zip(*asked, strict=True))
    together = fresh.between(Ends(src, dst, places[src], places[dst], times))
    rows = np.concatenate([together.normals(3), [together.shadowing()]]).T.tolist()
    assert rows == [answers[key] for key in asked]
    assert len({tuple(row) for row in rows}) == len(rows) // 2


def test_another_seed_has_other_states():
    """400 pairs: a correlation of 0 has a standard error of 0.05; the control is the same seed again."""
    model = Coherence(doppler=3.0, decorrelation=4.0)
    first, other, again = (states(model, 400, seed=seed) for seed in (1, 2, 1))
    for pair, within in ((other, True), (again, False)):
        assert (abs(np.corrcoef(first.normals(1)[0], pair.normals(1)[0])[0, 1]) < 0.15) == within
        assert (abs(np.corrcoef(first.shadowing(), pair.shadowing())[0, 1]) < 0.15) == within


@given(st.lists(st.floats(-1e5, 1e5), min_size=1, max_size=20))
def test_the_cosine_of_turns_is_the_cosine(turns):
    np.testing.assert_allclose(cos_of_turns(np.array(turns)), np.cos(2.0 * pi * np.fmod(turns, 1.0)), atol=1e-9)


@pytest.mark.parametrize(("m", "count"), [(0.5, 1), (1.0, 2), (1.6, 3), (8.0, 16), (20.0, 16)])
def test_nakagami_fading_has_twice_m_processes_of_at_most_sixteen(m, count):
    asked = []

    def normals(number):
        asked.append(number)
        return np.ones((number, 3))

    powers = nakagami_powers(m, normals)
    assert asked == [count]
    assert (powers == 1.0).all() == (2.0 * m == count)


def test_what_surrounds_nodes_is_the_same_whether_it_is_kept_or_drawn_anew(monkeypatch):
    coherence = Coherence(decorrelation=5.0, shared=0.5, waves=8)
    kept = states(coherence, 3).shadowing()
    assert len(set(kept.tolist())) == 3
    monkeypatch.setattr(correlated_channel, "ROOM", 0)
    assert states(coherence, 3).shadowing().tolist() == kept.tolist()
