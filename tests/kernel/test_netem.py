"""Distribution tables of netem against the laws that they describe, and latencies against the arithmetic of Linux."""

from math import sqrt

import numpy as np
import pytest
from scipy import stats

from desim.kernel.core.link_context import LinkContext
from desim.kernel.models.correlation import CorrelatedNumbers
from desim.kernel.models.latency import Empirical, Gamma, Lognormal, ShiftedExponential, Uniform, mean_latency
from desim.kernel.models.netem import Netem
from desim.kernel.models.netem_tables import HIGHEST, LOWEST, SCALE, SIZE, TABLES, fit, read_table, table_text
from desim.kernel.models.traits import LinkTraits
from tests.kernel.test_latency import errors
from tests.kernel.test_loss import below

K = np.arange(SIZE)
NORMAL = stats.norm.ppf((K + 1 / 8) / SIZE)
PARETO = 4 / 3 * (stats.pareto(3).ppf(K / SIZE) - 3 / 2)
LAWS = {"normal": NORMAL, "pareto": PARETO, "paretonormal": NORMAL / 4 + 3 / 4 * np.minimum(PARETO, HIGHEST / SCALE)}
"""The quantiles of each law, in units of sigma, at the probabilities of iproute2's programs."""
FIRST = {
    "normal": " -32768 -28307 -26871 -25967 -25298 -24765 -24320 -23937\n -23600 -23298 -23025 -22776 -22546 -22333\n",
    "pareto": " -5461 -5460 -5460 -5459 -5458 -5457 -5456 -5455\n -5454 -5453 -5452 -5452 -5451 -5450 -5449 -5448\n",
    "paretonormal": " -12305 -11171 -10812 -10586 -10418 -10284 -10172 -10075\n",
}
"""The first lines of the tables of iproute2 6.1."""
MANY = LinkContext(0, np.arange(1, 250_001))


# Tables.


@pytest.mark.parametrize("name", LAWS)
def test_the_quantiles_of_a_table_are_within_a_unit_of_those_of_its_law(name):
    """A unit is sigma / 8192; iproute2 rounds paretonormal three times, so there are two. The law is cut off at the
    range of 16 bits, -4 to 4 sigma. The control is 1 % wider.
    """
    table, law, units = np.array(TABLES[name]()), LAWS[name], 2 if name == "paretonormal" else 1
    assert np.abs(table - np.clip(law * SCALE, LOWEST, HIGHEST)).max() <= units
    assert np.abs(table - np.clip(1.01 * law * SCALE, LOWEST, HIGHEST)).max() > 10


@pytest.mark.parametrize("name", FIRST)
def test_a_table_in_the_format_of_iproute2_is_read(tmp_path, name):
    """A line of comment, then numbers with white space around them; the first numbers are ours, too."""
    first = list(map(int, FIRST[name].split()))
    assert list(TABLES[name]()[: len(first)]) == first
    rest = " ".join(map(str, TABLES[name]()[len(first) :]))
    text = f"# This is the distribution table for the {name} distribution.\n{FIRST[name]}{rest}\n"
    (tmp_path / f"{name}.dist").write_text(text)
    assert read_table(tmp_path / f"{name}.dist") == TABLES[name]()


MODELS = [
    Uniform(low=0.01, high=0.03),
    Gamma(offset=0.01, shape=2.5),
    Lognormal(cv=2.0),
    ShiftedExponential(),
    Empirical(values=(0.02, 0.05, 0.01)),
]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.kind)
def test_a_table_fitted_to_a_model_has_its_quantiles_and_is_the_same_when_read_back(tmp_path, model):
    """Within half of jitter / 8192, also where a tail is 8 sigma long.

    The control is the table of the normal distribution with the same mean and deviation.
    """
    fitted = fit(model.quantile)
    (tmp_path / "own.dist").write_text(table_text(fitted.table, "own"))
    assert read_table(tmp_path / "own.dist") == fitted.table
    quantiles, unit = model.quantile((K + 0.5) / SIZE), fitted.jitter / SCALE
    assert np.abs(fitted.delay + unit * np.array(fitted.table) - quantiles).max() <= 0.5 * unit + 1e-15
    assert np.abs(fitted.delay + unit * np.array(TABLES["normal"]()) - quantiles).max() > 100 * unit
    assert fitted.delay == pytest.approx(mean_latency(model), rel=0.01)


def test_a_table_fitted_to_a_constant_has_no_jitter():
    assert fit(Empirical(values=(0.02,)).quantile) == (0.02, 0.0, (0,) * SIZE)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("# empty\n", r"own\.dist should contain 1 to 16384 numbers \(got 0\)"),
        ("1 " * 16385, r"should contain 1 to 16384 numbers \(got 16385\)"),
        ("1 2\n3 32768\n", r"own\.dist, line 2: should be in -32768 \.\. 32767 \(got 32768\)"),
        ("-32769", r"line 1: should be in"),
        ("1\n\n0.5", r"line 3: '0\.5' is not an integer"),
        ("1,2", r"'1,2' is not an integer"),
    ],
)
def test_a_table_with_wrong_numbers_is_refused_with_file_and_line(tmp_path, text, why):
    (tmp_path / "own.dist").write_text(text)
    with pytest.raises(ValueError, match=why):
        Netem.model_validate({"file": "own.dist"}, context={"folder": tmp_path})


# Latencies.


@pytest.mark.slow
@pytest.mark.parametrize("distribution", ["uniform", *TABLES])
def test_mean_and_deviation_are_those_of_the_table(distribution):
    """250 000 draws within 3 standard errors, for all at once and message by message with a state that has no effect.

    The controls are a delay of 0.2 % more and a jitter of 2 % more.
    """
    model = Netem(delay=0.1, jitter=0.02, distribution=distribution)
    units = np.array(model.numbers()) / SCALE if model.numbers() else 2 * (K + 0.5) / SIZE - 1
    theory = 0.1 + 0.02 * units.mean(), 0.02**2 * (units**2).mean() - (0.02 * units.mean()) ** 2
    theory = theory if model.numbers() else (0.1, 0.02**2 / 3)
    correlated = model.model_copy(update={"correlation": 0.5}).start_run(0)
    assert model.mean_latency() == pytest.approx(theory[0])
    for each in (model, correlated):
        assert np.abs(errors(each(MANY, np.random.default_rng(8)), *theory)).max() < 3
    for change in ({"delay": 0.1002}, {"jitter": 0.0204}):
        off = model.model_copy(update=change)
        assert np.abs(errors(off(MANY, np.random.default_rng(8)), *theory)).max() > 3


def tabledist(mu, sigma, random, table):
    """Return the delay, ns, that Linux computes from a random number: the C function of this name, in integers."""
    if sigma == 0:
        return mu
    if table is None:
        return random % (2 * sigma) + mu - sigma
    t = table[random % len(table)]
    x = sigma % SCALE * t
    x += SCALE // 2 if x >= 0 else -SCALE // 2
    return int(x / SCALE) + sigma // SCALE * t + mu


@pytest.mark.parametrize("distribution", ["uniform", *TABLES])
@pytest.mark.parametrize(("delay", "jitter"), [(0.1, 0.02), (0.005, 0.02), (0.1, 0.0), (3.0, 2.1)])
def test_a_delay_is_the_one_that_linux_computes_from_the_same_random_number(distribution, delay, jitter):
    """Within 1 ns, because Linux rounds; a packet whose delay is negative is sent at once. The control is 2 ns more."""
    context = LinkContext(0, np.arange(1, 501))
    model, numbers = (
        Netem(delay=delay, jitter=jitter, distribution=distribution, correlation=0.3),
        CorrelatedNumbers(0.3),
    )
    ours, theirs = np.random.default_rng(1), np.random.default_rng(1)
    run = model.start_run(0)
    for _ in range(3):
        mu, sigma = round(delay * 1e9), round(jitter * 1e9)
        plain = [tabledist(mu, sigma, each, model.numbers()) for each in numbers(context, theirs).tolist()]
        found = run(context, ours) * 1e9
        assert np.abs(found - np.maximum(plain, 0)).max() < 1.001
        assert np.abs(found + 2.0 - np.maximum(plain, 0)).max() > 1.001


def autocorrelation(model, messages=30, links=50_000):
    """Return the correlation of the latencies of successive messages, in standard errors, and their deviation, s."""
    context, run, rng = LinkContext(0, np.arange(1, links + 1)), model.start_run(0), np.random.default_rng(2)
    *_, before, after = (run(context, rng) for _ in range(messages))
    return np.corrcoef(before, after)[0, 1] * sqrt(links), after.std()


@pytest.mark.slow
@pytest.mark.parametrize("distribution", ["uniform", "normal"])
def test_the_correlation_of_delays_has_no_effect_as_in_linux(distribution):
    """At 25 % and 90 %, a jitter of 10 ms: the latencies are independent and have their nominal deviation.

    Of 50 000 links, within 3 standard errors. The control: with a jitter of 2.1 s, the numbers are not wrapped.
    """
    for correlation in (0.25, 0.9):
        model = Netem(jitter=0.01, distribution=distribution, correlation=correlation)
        between, deviation = autocorrelation(model)
        assert abs(between) < 3
        assert deviation == pytest.approx(0.01 if model.numbers() else 0.01 / sqrt(3), rel=0.015)
    between, deviation = autocorrelation(Netem(delay=5.0, jitter=2.1, correlation=0.25))
    assert between > 30
    assert deviation < 0.9 * 2.1 / sqrt(3)


# Reordering.


def test_without_a_gap_all_are_reordered_if_the_probability_is_1():
    model = Netem(delay=0.1, jitter=0.02, reorder=1.0)
    assert model.quantile(np.array([0.0, 0.5, 1.0])).tolist() == [0.0, 0.0, 0.0]
    assert model.mean_latency() == 0.0


def test_every_gap_th_message_is_reordered_if_the_probability_is_1():
    """The first two of three are delayed, on each link for itself, whichever receivers a message has."""
    run, rng = Netem(delay=0.1, reorder=1.0, gap=3).start_run(0), np.random.default_rng(0)
    found = [run(LinkContext(0, np.array([1, 2])), rng).tolist() for _ in range(6)]
    assert found == [[0.1, 0.1], [0.1, 0.1], [0.0, 0.0]] * 2
    found = [run(LinkContext(0, np.array(nodes)), rng).tolist() for nodes in ([1], [1, 2], [1, 2], [2])]
    assert found == [[0.1], [0.1, 0.1], [0.0, 0.1], [0.0]]
    assert run(LinkContext(5, np.array([1])), rng).tolist() == [0.1]


@pytest.mark.slow
@pytest.mark.parametrize(("gap", "correlation"), [(1, 0.0), (4, 0.0), (1, 0.3)])
def test_reordered_messages_have_their_share(gap, correlation):
    """One in gap - 1 + 1 / p without a correlation; with one, those whose number is at most p: the loss `correlated`.

    30 000 links at their 40th message, within 3 standard errors of a binomial; the control is another probability.
    """
    many, p = LinkContext(0, np.arange(1, 30_001)), 0.4
    share = 1 / (gap - 1 + 1 / p) if not correlation else below(p, correlation)

    def off(p):
        model = Netem(delay=0.1, reorder=p, gap=gap, reorder_correlation=correlation)
        run, rng = model.start_run(0), np.random.default_rng(4)
        *_, last = (run(many, rng) for _ in range(40))
        return ((last == 0.0).mean() - share) / sqrt(share * (1 - share) / 30_000)

    assert abs(off(p)) < 3
    assert abs(off(0.44)) > 3
    model = Netem(delay=0.1, reorder=p, gap=gap, reorder_correlation=correlation)
    if correlation:
        assert model.mean_latency() is None
        for certain in (0.0, 1.0):
            assert model.model_copy(update={"reorder": certain}).mean_latency() == pytest.approx(0.1 * (1 - certain))
    else:
        assert model.mean_latency() == pytest.approx(0.1 * (1 - share))
        assert model.quantile(np.array([0.9 * share, 1.1 * share])).tolist() == [0.0, 0.1]


def test_a_model_without_state_is_drawn_ahead_and_one_with_state_is_not():
    for stateless in (Netem(), Netem(jitter=0.01, distribution="pareto", reorder=0.1)):
        assert stateless.start_run(9) is stateless
    for change in ({"correlation": 0.1}, {"reorder": 0.1, "gap": 2}, {"reorder": 0.1, "reorder_correlation": 0.1}):
        assert LinkTraits.of(Netem(jitter=0.01, **change).start_run(9)).draw is None


def test_the_largest_random_number_has_a_quantile():
    """Also if the division by the share of delayed messages rounds it to 1."""
    for reorder in (0.1, 0.2, 0.3, 0.7):
        largest = Netem(jitter=0.01, distribution="normal", reorder=reorder).quantile(np.array([1 - 2**-53]))
        assert largest == 0.1 + 0.01 * TABLES["normal"]()[-1] / SCALE


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"distribution": "nromal"}, "Input should be 'uniform', 'normal', 'pareto' or 'paretonormal'"),
        (
            {"distribution": "normal", "table": [0] * SIZE},
            "should have either a distribution or a table",
        ),
        ({"file": "own.dist", "table": [0] * SIZE}, "should have either a file or a table"),
        ({"table": []}, "should have at least 1 item"),
        ({"table": ["a"]}, "^1 validation error"),
        ({"table": [0] * 16385}, "should have at most 16384 items"),
        ({"table": [2**15] * SIZE}, "less than or equal to 32767"),
        ({"file": "none.dist"}, r"none\.dist cannot be read: No such file"),
        ({"jitter": 2.2}, "less than or equal to 2.147"),
        ({"delay": 0.0, "reorder": 0.1}, "need a delay > 0, as in tc"),
        ({"delay": 0.0, "jitter": 0.1, "distribution": "normal"}, "need a delay > 0, as in tc"),
        ({"gap": 0}, "greater than or equal to 1"),
    ],
)
def test_what_netem_does_not_take_is_refused(tmp_path, given, why):
    with pytest.raises(ValueError, match=why):
        Netem.model_validate(given, context={"folder": tmp_path})


def test_a_wrong_number_of_a_table_is_the_only_error():
    with pytest.raises(ValueError, match="table") as refused:
        Netem(table=[2**15])
    assert "least" not in str(refused.value)


def test_as_plain_values_a_model_no_longer_needs_its_file(tmp_path):
    (tmp_path / "own.dist").write_text(table_text(TABLES["normal"](), "own"))
    model = Netem.model_validate({"jitter": 0.01, "file": "own.dist"}, context={"folder": tmp_path})
    assert model == Netem(jitter=0.01, table=TABLES["normal"]()) == Netem.model_validate(model.plain())
    normal = Netem(jitter=0.01, distribution="normal")
    assert model.draw(99, np.random.default_rng(1)).tolist() == normal.draw(99, np.random.default_rng(1)).tolist()


@pytest.mark.parametrize("length", [1, 7, 4096, 16384])
def test_a_table_may_have_another_length(tmp_path, length):
    """Each number is as probable as the others; with state, as Linux computes it, modulo the length."""
    table = tuple(range(length))
    (tmp_path / "own.dist").write_text(" ".join(map(str, table)))
    model = Netem(delay=1.0, jitter=0.1, file=str(tmp_path / "own.dist"))
    assert model.table == table
    delays = 1.0 + 0.1 * np.array(table) / SCALE
    assert model.quantile((np.arange(length) + 0.5) / length) == pytest.approx(delays)
    assert model.mean_latency() == pytest.approx(delays.mean())
    with_state = model.model_copy(update={"correlation": 0.01}).start_run(2)
    context, rng = LinkContext(0, np.array([1])), np.random.default_rng(0)
    draws = {round(float(with_state(context, rng)[0]), 12) for _ in range(300)}
    assert draws <= {round(float(delay), 12) for delay in delays}


def test_reordered_messages_are_as_many_as_the_probability_says():
    """A quarter of those whose gap is over have no delay: with a gap of 2 one in 1 + 4 messages, in the long run."""
    links, rng = LinkContext(0, np.arange(1, 401)), np.random.default_rng(1)
    for gap, share in ((1, 0.25), (2, 0.2)):
        model = Netem(delay=0.1, reorder=0.25, gap=gap).start_run(401)
        early = [(model(links, rng) == 0.0).mean() for _ in range(40)][10:]
        assert np.mean(early) == pytest.approx(share, abs=4 * 0.004)
