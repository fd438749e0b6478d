"""Every latency model against its theory, which is written down here once more and independently."""

import tomllib
from contextlib import nullcontext
from decimal import Decimal
from fractions import Fraction
from math import exp, log, sqrt
from types import SimpleNamespace

import networkx as nx
import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError
from scipy import stats

from desim.config.model import MAX_TIME
from desim.kernel.core.link_context import LinkContext
from desim.kernel.models.latency import (
    Constant,
    Empirical,
    Gamma,
    Lognormal,
    Propagation,
    ShiftedExponential,
    Uniform,
    mean_latency,
)
from desim.kernel.models.latency_by_link import LatencyMatrix, PerPair
from desim.kernel.models.link_draws import as_nanoseconds, as_seconds
from desim.kernel.models.links import Links
from desim.kernel.models.netem import Netem
from desim.kernel.models.traits import LinkTraits
from desim.scenario.scenario import Scenario
from desim.scenario.toml import dump

SEEDS = range(3)
MANY = LinkContext(0, np.arange(1, 100_001))
LIST = (0.050, 0.010, 0.110, 0.010, 0.020)

DRAWN = {
    "uniform": (Uniform(low=0.02, high=0.08), 0.05, 0.06**2 / 12, Uniform(low=0.02, high=0.0824)),
    "shifted_exponential": (
        ShiftedExponential(offset=0.03, mean=0.05),
        0.03 + 0.05,
        0.05**2,
        ShiftedExponential(offset=0.03, mean=0.0515),
    ),
    "gamma": (
        Gamma(offset=0.02, shape=2.5, scale=0.01),
        0.02 + 2.5 * 0.01,
        2.5 * 0.01**2,
        Gamma(offset=0.02, shape=2.5, scale=0.0103),
    ),
    "lognormal": (
        Lognormal(offset=0.01, mean=0.05, cv=0.5),
        0.01 + 0.05,
        (0.5 * 0.05) ** 2,
        Lognormal(offset=0.01, mean=0.0515, cv=0.5),
    ),
    "empirical": (
        Empirical(values=LIST),
        sum(LIST) / 5,
        sum(x * x for x in LIST) / 5 - (sum(LIST) / 5) ** 2,
        Empirical(values=(0.050, 0.010, 0.116, 0.010, 0.020)),
    ),
    "netem": (
        Netem(delay=0.05, jitter=0.03, reorder=0.2),
        0.8 * 0.05,
        0.8 * (0.05**2 + 0.03**2 / 3) - 0.04**2,
        Netem(delay=0.0515, jitter=0.03, reorder=0.2),
    ),
}
"""Model, its mean (s) and variance (s^2), and the same model with something off by 3 % or so."""
DISTRIBUTIONS = {
    "uniform": stats.uniform(0.02, 0.06),
    "shifted_exponential": stats.expon(0.03, 0.05),
    "gamma": stats.gamma(2.5, loc=0.02, scale=0.01),
    "lognormal": stats.lognorm(sqrt(log(1.25)), loc=0.01, scale=0.05 * exp(-log(1.25) / 2)),
}


def errors(draws, mean, variance):
    """Return how many standard errors mean and variance of draws are off.

    The mean of n draws has standard error sqrt(var / n), their variance sqrt((m4 - var^2) / n).
    """
    about = draws - draws.mean()
    spread = (about**2).mean()
    return (
        (draws.mean() - mean) / sqrt(spread / draws.size),
        (spread - variance) / sqrt(((about**4).mean() - spread**2) / draws.size),
    )


def departure(draws, cdf):
    """Return the Kolmogorov-Smirnov statistic, times sqrt(n)."""
    law, steps = cdf(np.sort(draws)), np.arange(draws.size + 1) / draws.size
    return max((steps[1:] - law).max(), (law - steps[:-1]).max()) * sqrt(draws.size)


def drawn(model, seeds=SEEDS, context=MANY):
    return np.array([model(context, np.random.default_rng(seed)) for seed in seeds])


@pytest.mark.slow
@pytest.mark.parametrize("name", DRAWN)
def test_mean_and_variance_are_those_of_the_theory(name):
    """3 seeds x 10^5 draws, each seed and all of them within 5 standard errors; 3 % off are more than 5."""
    model, mean, variance, off = DRAWN[name]
    draws = drawn(model)
    assert np.abs([errors(each, mean, variance) for each in [*draws, draws.ravel()]]).max() < 5
    assert np.abs(errors(drawn(off).ravel(), mean, variance)).min() > 5


@pytest.mark.slow
@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_the_whole_distribution_is_that_of_the_theory(name):
    """Kolmogorov-Smirnov: sqrt(n) D exceeds 2.2 in 1 of 8000 samples; the control, 3 % off, is seen."""
    model, *_, off = DRAWN[name]
    law = DISTRIBUTIONS[name].cdf
    assert max(departure(each, law) for each in drawn(model)) < 2.2
    assert min(departure(each, law) for each in drawn(off)) > 2.2


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_quantiles_are_those_of_the_theory(name):
    model, *_, off = DRAWN[name]
    u = np.array([1e-12, 0.001, 0.1, 0.5, 0.9, 0.999, 1 - 1e-9])
    np.testing.assert_allclose(model.quantile(u), DISTRIBUTIONS[name].ppf(u), rtol=1e-7)
    assert np.abs(off.quantile(u) / DISTRIBUTIONS[name].ppf(u) - 1).max() > 0.01


@pytest.mark.parametrize("name", DRAWN)
def test_quantiles_are_the_inverse_of_the_distribution_of_the_draws(name):
    """At most a share u of n draws is below quantile(u), at least u not above; standard error sqrt(u (1 - u) / n)."""
    model, *_, off = DRAWN[name]
    draws = model.draw(200_000, np.random.default_rng(6))

    def excess(quantile, u):
        error = sqrt(u * (1 - u) / draws.size)
        return max((draws < quantile).mean() - u, u - (draws <= quantile).mean()) / error

    inner = np.array([0.05, 0.21, 0.39, 0.5, 0.79, 0.95])
    assert max(excess(model.quantile(np.array([u]))[0], u) for u in inner) < 5
    assert max(excess(off.quantile(np.array([u]))[0], u) for u in inner) > 5


@pytest.mark.parametrize("name", DRAWN)
def test_a_call_is_a_draw_for_every_hop_and_a_draw_ahead_is_the_same(name):
    """Draws of 3, 1 and 4096 at a time are the draws of 4100 at once: the network may draw ahead."""
    model = DRAWN[name][0]
    assert LinkTraits.of(model).draw is not None
    rng, ahead = np.random.default_rng(7), np.random.default_rng(7)
    piecemeal = [
        *model(LinkContext(0, np.arange(3)), rng),
        *model(LinkContext(1, np.arange(1)), rng),
        *model.draw(4096, rng),
    ]
    assert piecemeal == model.draw(4100, ahead).tolist()


def test_an_exponential_part_of_no_length_leaves_the_fixed_part():
    """Also where the logarithm of the mean, or the variance, is not a number or zero."""
    for model in (
        ShiftedExponential(offset=0.3, mean=0.0),
        Gamma(offset=0.3, scale=0.0),
        Lognormal(offset=0.3, mean=0.0),
        Lognormal(offset=0.2, mean=0.1, cv=0.0),
        Uniform(low=0.3, high=0.3),
    ):
        assert np.allclose(model.draw(3, np.random.default_rng(0)), 0.3, rtol=1e-12)
        assert np.allclose(model.quantile(np.array([0.01, 0.99])), 0.3, rtol=1e-12)


# Propagation.


def test_propagation_is_distance_over_speed_and_a_fixed_part():
    """A 3-4-5 triangle of sides 300, 400 and 500 m at 1500 m/s: 0.2, 0.2667 and 0.3333 s."""
    at = np.array([[0.0, 0.0], [300.0, 0.0], [300.0, 400.0]])
    sound = Propagation(fixed=0.01)
    assert sound(context_at(at, 0, [1, 2]), None).tolist() == pytest.approx([0.01 + 0.2, 0.01 + 1 / 3])
    assert sound(context_at(at, 2, [1]), None).tolist() == pytest.approx([0.01 + 4 / 15])


def test_propagation_follows_the_positions():
    at = np.array([[0.0, 0.0], [300.0, 0.0]])
    context = context_at(at, 0, [1])
    assert Propagation()(context, None) == pytest.approx(0.2)
    at[1] = 600.0, 0.0
    assert Propagation()(context, None) == pytest.approx(0.4)


@pytest.mark.slow
def test_the_mean_and_variance_of_propagation_are_those_of_the_distances():
    """From the middle of a square of side a to anywhere in it: E d = a (sqrt 2 + ln(1 + sqrt 2)) / 6, E d^2 = a^2 / 6.

    3 seeds x 10^5 places within 5 standard errors; the control is the speed of sound 2 % off.
    """
    mean = (sqrt(2) + log(1 + sqrt(2))) / 6

    def latencies(seed, speed):
        at = np.random.default_rng(seed).uniform(-500.0, 500.0, (100_001, 2))
        at[0] = 0.0
        return Propagation(speed=speed, fixed=0.1)(context_at(at, 0, MANY.dst), None)

    theory = 0.1 + mean / 1.5, (1 / 6 - mean**2) / 1.5**2
    assert np.abs([errors(latencies(seed, 1500.0), *theory) for seed in SEEDS]).max() < 5
    assert np.abs([errors(latencies(seed, 1530.0), *theory) for seed in SEEDS]).min() > 5


def test_propagation_needs_positions():
    with pytest.raises(ValueError, match="needs the positions of the nodes"):
        Propagation()(MANY, None)


def context_at(at, src, dst):
    return LinkContext(src, np.asarray(dst), positions=lambda: at)


# A latency for every pair.

BASE = Gamma(offset=0.02, shape=2.5, scale=0.01)


def test_the_latency_of_a_pair_does_not_depend_on_query_time_or_on_the_other_pairs_queried():
    model, rng = PerPair(base=BASE), np.random.default_rng(0)
    together = model(LinkContext(3, np.array([5, 6, 7]), now=0.0, seed=11), rng)
    alone = [model(LinkContext(3, np.array([node]), now=4.5, size=99, seed=11), rng)[0] for node in (5, 6, 7)]
    assert together.tolist() == alone
    assert len(set(alone)) == 3


def test_both_ways_of_a_pair_are_alike_if_symmetric_and_only_then():
    there, back = LinkContext(3, np.array([8]), seed=1), LinkContext(8, np.array([3]), seed=1)
    for symmetric in (True, False):
        model = PerPair(base=BASE, symmetric=symmetric)
        assert bool(model(there, None) == model(back, None)) is symmetric


def test_another_seed_gives_every_pair_another_latency():
    first, second = (PerPair(base=BASE)(LinkContext(0, np.arange(1, 101), seed=seed), None) for seed in (1, 2))
    assert not (first == second).any()


@pytest.mark.slow
@pytest.mark.parametrize("symmetric", [True, False])
def test_the_latencies_of_the_pairs_are_distributed_as_their_base(symmetric):
    """Kolmogorov-Smirnov over 20 000 pairs, 3 seeds: sqrt(n) D < 2.2; the control is a base 5 % off."""
    law, others = DISTRIBUTIONS["gamma"], np.arange(1, 20_001)

    def worst(model, pick):
        return pick(departure(model(LinkContext(0, others, seed=seed), None), law.cdf) for seed in SEEDS)

    assert worst(PerPair(base=BASE, symmetric=symmetric), max) < 2.2
    assert worst(PerPair(base=BASE.model_copy(update={"scale": 0.0105}), symmetric=symmetric), min) > 2.2


@pytest.mark.slow
def test_the_jitter_is_drawn_independently_for_every_message():
    """Over the pairs, mean and variance are the sums of those of base and jitter; over a pair's messages, the jitter's.

    3 seeds x 10^5, within 5 standard errors; the control is a jitter 5 % off.
    """
    models = [PerPair(base=BASE, jitter=ShiftedExponential(mean=mean)) for mean in (0.03, 0.0315)]
    pairs, off = (
        np.array([model(LinkContext(0, MANY.dst, seed=seed), np.random.default_rng(seed)) for seed in SEEDS])
        for model in models
    )
    theory = 0.045 + 0.03, 0.00025 + 0.03**2
    assert np.abs([errors(each, *theory) for each in pairs]).max() < 5
    assert np.abs(errors(off.ravel(), *theory)).min() > 5
    context = LinkContext(0, np.full(100_000, 7), seed=3)  # 10^5 messages to node 7
    own = PerPair(base=BASE)(context, None)[0]
    messages, off = (model(context, np.random.default_rng(4)) - own for model in models)
    assert np.abs(errors(messages, 0.03, 0.03**2)).max() < 5
    assert np.abs(errors(off, 0.03, 0.03**2)).min() > 5
    assert messages.min() >= 0.0


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("room", [2**22, 60, 0])
def test_a_run_caches_the_latency_of_each_pair(symmetric, room, monkeypatch):
    """Draw by draw, in any order of senders and receivers and with any cache size; the control is another seed."""
    monkeypatch.setattr("desim.kernel.models.latency_by_link.ROOM", room)
    model = PerPair(base=BASE, jitter=Uniform(), symmetric=symmetric)
    run, ours, theirs = model.start_run(30), np.random.default_rng(2), np.random.default_rng(2)
    contexts = [
        LinkContext(src, np.array(dst), seed=9)
        for src, dst in ((4, [7]), (4, [0, 29, 7]), (7, [4]), (0, [1, 2]), (4, [7]))
    ]
    assert [run(each, ours).tolist() for each in contexts] == [model(each, theirs).tolist() for each in contexts]
    assert len(run._base) == min(room // 30, 3)
    assert model.start_run(30)(LinkContext(4, np.array([7]), seed=8), ours) != model(
        LinkContext(4, np.array([7]), seed=9), ours
    )


def test_a_base_without_quantiles_is_refused():
    with pytest.raises(ValueError, match=r"quantile\(u\)"):
        PerPair(base=Propagation())
    with pytest.raises(ValueError, match=r"quantile\(u\)"):
        PerPair(base=lambda context, rng: 0.1)


# Lists in files.


def read(tmp_path, text, name="measured.txt"):
    (tmp_path / name).write_text(text, encoding="utf-8")
    return Empirical.model_validate({"file": name}, context={"folder": tmp_path})


def test_a_file_holds_numbers_with_commas_and_comments(tmp_path):
    text = "# one way, s\n0.01, 0.02,0.03\t4e-2 5 ,  # morning\n\n,\n"
    assert read(tmp_path, text).values == (0.01, 0.02, 0.03, 0.04, 5.0)
    assert read(tmp_path, "# s\n0.01,\n\n4e-2 # morning\n").values == (0.01, 0.04)


def test_a_file_means_the_same_as_its_numbers(tmp_path):
    """The draws too, and as plain values it no longer needs the file."""
    model = read(tmp_path, "\n".join(map(str, LIST)))
    assert model == Empirical(values=LIST) == Empirical.model_validate(model.plain())
    assert drawn(model, [3]).tolist() == drawn(Empirical(values=LIST), [3]).tolist()


def test_a_file_is_beside_the_one_that_names_it_or_where_its_path_says(tmp_path):
    (tmp_path / "few.txt").write_text("0.5")
    table = {"latency": {"kind": "empirical", "file": "few.txt"}}
    assert Links.model_validate(table, context={"folder": tmp_path}).latency == Empirical(values=(0.5,))
    assert Empirical.model_validate({"file": tmp_path / "few.txt"}).values == (0.5,)


def test_a_constant_latency_has_no_spread_and_is_its_own_quantile():
    assert Constant(value=0.27)(MANY, np.random.default_rng(0)) == 0.27
    assert Constant(value=0.27).quantile(np.array([0.1, 0.9])).tolist() == [0.27, 0.27]
    assert LinkTraits.of(Constant()).draw is None


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "contains no numbers"),
        ("# nothing but a comment\n,,\n", "contains no numbers"),
        ("0.1\n0.2 fast\n", r"line 2: 'fast' is not a number"),
        ("0.1\n\n-0.2\n", r"line 3: a latency should be a time >= 0 s \(got -0\.2\)"),
        ("nan", r"line 1: a latency should be a time >= 0 s \(got nan\)"),
        ("inf", r"line 1: a latency should be a time >= 0 s \(got inf\)"),
        ("2e9", "less than or equal to 1000000000"),
        ("1/2", r"'1/2' is not a number"),
        ("rtt_ms\n1.0\n", r"line 1: 'rtt_ms' is not a number; a header should begin with #"),
        (
            "# seq, s\n1, 0.05\n2, 0.04\n",
            r"line 2: has 2 numbers; it should have one, because the file has several lines",
        ),
    ],
)
def test_a_file_of_other_things_is_refused_with_its_name_and_the_line(tmp_path, text, complaint):
    with pytest.raises(ValueError, match=complaint):
        read(tmp_path, text)
    if "less than" not in complaint:
        with pytest.raises(ValidationError, match=r"measured\.txt"):
            read(tmp_path, text)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("none.txt", r"none\.txt cannot be read: No such file"),
        (".", "cannot be read"),
        ("binary", "binary cannot be read"),
    ],
)
def test_an_unreadable_file_is_reported_by_its_name(tmp_path, name, why):
    (tmp_path / "binary").write_bytes(b"\xff\x00\x01")
    with pytest.raises(ValidationError, match=why):
        Empirical.model_validate({"file": name}, context={"folder": tmp_path})


@pytest.mark.parametrize("given", [{"values": ()}, {"values": (0.1, "0.2")}, {"file": 7}])
def test_a_list_needs_at_least_one_time(given):
    with pytest.raises(ValidationError):
        Empirical.model_validate(given)


def test_a_user_model_may_be_a_base():
    """Anything with a call and quantiles."""
    own = type("Own", (SimpleNamespace,), {"__call__": lambda self, context, rng: 0.0, "quantile": lambda self, u: u})()
    latencies = PerPair(base=own)(LinkContext(0, np.arange(1, 5)), None)
    assert ((latencies > 0.0) & (latencies < 1.0)).all()


class Counting:
    """A user's model with state: its n-th call in a run gives a latency of n s."""

    def __init__(self):
        self.calls = 0

    def start_run(self, size):
        return Counting()

    def __call__(self, context, rng):
        self.calls += 1
        return float(self.calls)

    def quantile(self, u):
        self.calls += 1
        return np.full_like(u, 100.0 * self.calls)


def test_the_state_of_a_base_and_of_a_jitter_is_that_of_one_run():
    """The base of a sender is computed once; the jitter is 1 s, then 2 s. The second run begins anew."""
    model, context = PerPair(base=Counting(), jitter=Counting()), LinkContext(0, np.array([1]))
    for _ in range(2):
        latency = model.start_run(2)
        assert [latency(context, None).tolist() for _ in range(2)] == [[101.0], [102.0]]
    assert (model.base.calls, model.jitter.calls) == (0, 0)


def test_the_base_of_a_run_needs_quantiles_too():
    own = Counting()
    own.start_run = lambda size: lambda context, rng: 0.0
    with pytest.raises(ValueError, match=r"base should have a method quantile\(u\)"):
        PerPair(base=own).start_run(2)


@pytest.mark.parametrize("part", ["base", "jitter"])
def test_a_base_and_a_jitter_are_declared_as_the_latency_of_a_network_is(part):
    """A bare number is a constant, and an attribute one letter off has no effect."""
    assert getattr(PerPair(**{part: 0.2}), part) == Constant(value=0.2)
    own = type("Own", (Counting,), {"start_runs": Counting.start_run, "start_run": None})()
    PerPair(**{part: own})
    misspelt = type("Misspelt", (SimpleNamespace,), {"__call__": len, "quantile": len, "start_runs": len})()
    with pytest.raises(ValueError, match="'start_runs', did you mean 'start_run'"):
        PerPair(**{part: misspelt})


def test_both_directions_of_a_link_have_the_same_uniform_unless_asked_otherwise():
    there, back = LinkContext(2, np.array([5]), seed=3), LinkContext(5, np.array([2]), seed=3)
    assert there.uniform("x") == back.uniform("x") != there.uniform("y")
    assert there.uniform("x", symmetric=False) != back.uniform("x", symmetric=False)


# A matrix of latencies.

LINE = {"kind": "edges", "edges": [{"src": 0, "dst": 1}, {"src": 1, "dst": 2}]}
MATRIX = [[0.0, 0.1, None], [0.2, 0.0, 0.3], [0.4, 0.5, 0.0]]


@pytest.mark.parametrize(
    "values",
    [
        MATRIX,
        np.array(MATRIX, dtype=float),
        np.ma.masked_invalid(np.array(MATRIX, dtype=float)),
        pd.DataFrame(MATRIX, dtype="Float64"),  # its missing numbers are pandas.NA
        [[0.0, 0.1, np.datetime64("NaT")], *MATRIX[1:]],
        tuple(map(tuple, MATRIX)),
    ],
)
def test_each_link_has_its_latency_of_a_matrix(values):
    """The diagonal does not count."""
    model = LatencyMatrix(values=values)
    assert model == LatencyMatrix(values=MATRIX) == LatencyMatrix.model_validate(model.plain())
    assert model(LinkContext(1, np.array([0, 2])), None).tolist() == [0.2, 0.3]
    assert mean_latency(model) == pytest.approx(0.3)
    assert repr(model) == "LatencyMatrix(values='3 x 3')"


def test_a_matrix_may_be_of_round_trips_in_ms_and_each_message_adds_a_jitter():
    model = LatencyMatrix(values=[[0, 40.0], [60.0, 7.0]], unit="ms", rtt=True, jitter=Uniform(low=0.1, high=0.2))
    rng = np.random.default_rng(0)
    draws = np.array([model.start_run(2)(LinkContext(0, np.array([1])), rng) for _ in range(1000)])
    assert (draws >= 0.12).all()
    assert (draws <= 0.22).all()
    assert draws.mean() == pytest.approx(0.17, abs=5 * 0.1 / sqrt(12 * 1000))
    assert mean_latency(model) == pytest.approx(0.025 + 0.15)


@pytest.mark.parametrize(
    "text", ["0 0.1 nan\n0.2 0 0.3\n0.4 0.5 0", "0,0.1,\n0.2,,0.3\n0.4,0.5,NA", "0;0,1;\n0,2;0;0,3\n0,4;0,5;0"]
)
def test_a_file_has_a_line_per_sender(tmp_path, text):
    (tmp_path / "matrix.txt").write_text(text)
    model = LatencyMatrix.model_validate({"file": "matrix.txt"}, context={"folder": tmp_path})
    assert model.base_latencies.tolist()[1:] == MATRIX[1:]
    assert model.base_latencies[0, 2] == np.inf
    written = tomllib.loads(dump(Scenario(team={"count": 3}, network={"latency": model, "graph": LINE})))
    assert LatencyMatrix.model_validate(written["network"]["latency"]) == model
    assert LatencyMatrix.model_validate(model.plain()) == model


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({}, "should have values, or a file of values"),
        ({"values": [[0.0]]}, "two or more nodes"),
        ({"values": [[0.0, 1.0], [0.0]]}, "values should be a square: row 1 has 1 of 2 numbers"),
        ({"values": [[0.0, -1.0], [0.0, 0.0]]}, r"values\.0\.1: should be greater than or equal to 0"),
        ({"values": [[0.0, 1.0], [2e9, 0.0]]}, r"a latency should be at most 1e\+09 s \(got 2e\+09 s from 1 to 0\)"),
        ({"values": MATRIX, "file": "x"}, "should have values or a file of values, not both"),
        ({"values": "0 1"}, "should be a list"),
        ({"values": np.triu(np.ones((3, 3)))}, "all values below the diagonal are 0: give the latencies of both ways"),
        ({"values": np.tril(np.ones((4, 4)))}, "all values above the diagonal are 0"),
        ({"values": [[0, 10**400], [1, 0]]}, r"values\.0\.1: should be a number"),
        ({"values": [[0, Fraction(10**400)], [1, 0]]}, r"values\.0\.1: should be a number"),
        ({"values": [[0, Decimal("sNaN")], [1, 0]]}, r"values\.0\.1: should be a number"),
    ],
)
def test_what_is_no_matrix_of_latencies_is_refused(options, why):
    with pytest.raises(ValueError, match=why):
        LatencyMatrix(**options)


def test_a_matrix_has_a_row_per_node_and_a_latency_for_each_link():
    matrix = LatencyMatrix(values=MATRIX)
    for graph, nodes, why in (
        ({"kind": "complete"}, 3, "network.latency: the matrix of latencies has none from 0 to 2"),
        ({"kind": "complete"}, 2, "network.latency: the matrix .* a row for each of 2 nodes, it has 3"),
        (LINE, 3, ""),
    ):
        with pytest.raises(ValueError, match=why) if why else nullcontext():
            Scenario(team={"count": nodes}, network={"latency": matrix, "graph": graph})


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("# none\n", r"m\.csv contains no numbers"),
        ("0,1\n1\n", r"line 2: has 1 number, but the file has 2 lines of numbers: one per node; with decimal commas"),
        (
            "a,b\n0,1\n",
            r"line 1: 'a' is not a number; a header should begin with #, or name the nodes, as the first column",
        ),
        ("0 1 23104\n0 2 51022\n1 2 2301\n", "line 1: each line may be two nodes and a latency"),
        ("0,1\na,0\n", r"line 2: 'a' is not a number(?!.*header)"),
    ],
)
def test_a_file_of_no_square_of_numbers_is_refused_with_the_line(tmp_path, text, why):
    (tmp_path / "m.csv").write_text(text)
    with pytest.raises(ValueError, match=why):
        LatencyMatrix(file=str(tmp_path / "m.csv"))


@pytest.mark.parametrize("header", ["0,0,1,2", "0,1,2,3"])
def test_a_matrix_with_numbers_of_nodes_beside_it_and_a_number_above_is_refused(tmp_path, header):
    first = header.split(",")
    rows = [first, *([name, "0.1", "0.2", "0.3"] for name in first[1:])]
    (tmp_path / "m.csv").write_text("\n".join(map(",".join, rows)))
    with pytest.raises(ValueError, match="line 1: numbers the nodes, and so does the first column"):
        LatencyMatrix(file=str(tmp_path / "m.csv"))


@pytest.mark.parametrize(
    ("text", "nodes"),
    [
        ("from,a,b,c\na,0,1,2\nb,3,0,4\nc,5,6,0\n", ("a", "b", "c")),
        ("-,a,b,c\na,-,1,2\nb,3,-,4\nc,5,6,-\n", ("a", "b", "c")),
        ('"";"a 1";b;c\n"a 1";0;1,0;2\nb;3;0;4\nc;5;6;0\n', ("a 1", "b", "c")),
        (",7,2670,3055\n7,0,1,2\n2670,3,0,4\n3055,5,6,0\n", ("7", "2670", "3055")),
        ("id,3055,7,2670\n3055,0,5,6\n7,2,0,1\n2670,4,3,0\n", ("7", "2670", "3055")),
        ("id,0,1,2\n0,0,1,2\n1,3,0,4\n2,5,6,0\n", None),
        (",0,1,2\n0,,1,2\n1,3,,4\n2,5,6,\n", None),
        ("id,1,0,2\n1,0,3,4\n0,1,0,2\n2,6,5,0\n", None),
    ],
)
def test_a_matrix_may_have_names_beside_it(tmp_path, text, nodes):
    (tmp_path / "m.csv").write_text(text)
    model = LatencyMatrix(file=str(tmp_path / "m.csv"), unit="ms")
    assert model.nodes == nodes
    assert (model.base_latencies * 1e3).tolist() == [[0.0, 1.0, 2.0], [3.0, 0.0, 4.0], [5.0, 6.0, 0.0]]
    assert LatencyMatrix.model_validate(model.plain()) == model


@pytest.mark.parametrize("text", [",5,9\n5,,3\n9,3,\n", ",5.0,9\n5.0,0,3\n9,3,0\n", "-,5,9\n5,-,3\n9,3,-\n"])
def test_a_matrix_that_lacks_its_diagonal_has_no_names(tmp_path, text):
    """Its first line and its first column are equal, too, as it is symmetric."""
    (tmp_path / "m.csv").write_text(text)
    model = LatencyMatrix(file=str(tmp_path / "m.csv"))
    assert model.nodes is None
    assert model.base_latencies.tolist() == [[0.0, 5.0, 9.0], [5.0, 0.0, 3.0], [9.0, 3.0, 0.0]]


def test_the_graph_numbers_the_nodes_of_a_matrix_with_names(tmp_path):
    values = [[0.0, 0.1, 0.2], [0.3, 0.0, 0.4], [0.5, 0.6, 0.0]]
    matrix = LatencyMatrix(values=values, nodes=("c", "a", "b"))
    graph = nx.DiGraph([("a", "b"), ("b", "c"), ("c", "a")])
    links = Links(graph=graph, latency=matrix)
    assert links.graph.names == links.latency.nodes == ("a", "b", "c")
    assert links.latency.values == ((0.0, 0.4, 0.3), (0.6, 0.0, 0.5), (0.1, 0.2, 0.0))
    of_link = Links(graph=graph, link=[{"src": 0, "dst": 1, "latency": matrix}]).link[0].latency
    assert of_link.values == links.latency.values
    assert Links(latency=matrix).node_names == ("c", "a", "b")
    (tmp_path / "places.csv").write_text("node,x,y\na,0,0\nb,1,0\nc,2,0\n")
    positions = {"kind": "recorded", "file": "places.csv"}
    fields = {"team": {"positions": positions}, "network": {"latency": matrix.plain()}}
    placed = Scenario.model_validate(fields, context={"folder": tmp_path})
    assert placed.network.latency.values == links.latency.values


@pytest.mark.parametrize(
    ("nodes", "why"),
    [
        (
            ("a", "b", "x"),
            "the matrix of latencies has a node 'x', which the network does not have: the nodes are a, b, c",
        ),
        (("a", "b"), "nodes should have a name for each of 3 rows, and each name once"),
        (("a", "b", "a"), "each name once"),
    ],
)
def test_wrong_names_of_a_matrix_are_refused(nodes, why):
    graph = nx.cycle_graph(["a", "b", "c"])
    with pytest.raises(ValueError, match=why):
        Scenario(
            team={"count": 3}, network={"graph": graph, "latency": LatencyMatrix(values=np.ones((3, 3)), nodes=nodes)}
        )


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("x,a,b\na,0,1\nc,1,0\n", "the names of the first line and of the first column should be equal"),
        (",10,20\n10,0,30\n20,30,0\n", "10, 20 may be the names of the nodes, or numbers of a matrix whose first cell"),
        (",2,0,1\n2,,3,4\n0,5,,6\n1,7,8,\n", "2, 0, 1 may be the names of the nodes, or numbers of a matrix whose"),
        (
            "rtt [ms],a,b\na,0,10\nb,10,0\n",
            "the first cell says 'ms', and numbers are read in s: give the unit",
        ),
        (",a,\na,0,1\n,1,0\n", "a node has no name in the first line and in the first column"),
        ("x,10,20\n10,0,1\n20,30\n", "has 1 number, but the file has 2 lines of numbers: one per node"),
    ],
)
def test_names_beside_a_matrix_should_agree(tmp_path, text, why):
    (tmp_path / "m.csv").write_text(text)
    with pytest.raises(ValueError, match=rf"m\.csv(: |, line [13]: ){why}"):
        LatencyMatrix(file=str(tmp_path / "m.csv"))


def test_a_decimal_comma_in_quotes_between_commas_is_refused(tmp_path):
    (tmp_path / "m.csv").write_text('0,"0,1"\n"0,2",0\n')
    with pytest.raises(ValueError, match=r"m\.csv, line 1: .*0,1"):
        LatencyMatrix(file=str(tmp_path / "m.csv"))


@pytest.mark.parametrize("text", ["0,041,0,052", "0,1 0,041,0,052", "12,05,7"])
def test_decimal_commas_between_commas_are_refused(tmp_path, text):
    (tmp_path / "ms.txt").write_text(text)
    with pytest.raises(ValueError, match="may be one number or several"):
        Empirical(file=str(tmp_path / "ms.txt"))


@pytest.mark.parametrize("answer", [True, np.True_, "0.1", b"0.1", np.array([True, False])], ids=repr)
def test_a_boolean_or_a_text_is_no_latency(answer):
    with pytest.raises(ValueError, match="latencies should be finite times"):
        as_seconds(answer, test_a_boolean_or_a_text_is_no_latency)


def test_a_latency_that_is_longer_than_any_run_is_as_long_as_the_longest():
    """In nanoseconds, 1e10 s is no integer of 64 bits."""
    times = as_nanoseconds(np.array([0.5, MAX_TIME, 1e10, 1e300]), None)
    assert times.tolist() == [500_000_000, *[round(MAX_TIME * 1e9)] * 3]


@pytest.mark.parametrize("model", [LatencyMatrix(values=MATRIX), PerPair()])
def test_a_call_outside_of_a_run_may_have_no_receivers(model):
    assert model(LinkContext(0, np.arange(0)), np.random.default_rng(1)).shape == (0,)
