"""Where two curves of a sweep cross, against a closed form and a loop over t tests, and how often intervals cover."""

from dataclasses import replace
from math import inf, isnan, sqrt

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from desim.analysis.measuring import summary
from desim.scenario.players import Team
from desim.scenario.scenario import Scenario
from desim.simulation.run import run
from desim.study.results.crossover import are_told_apart, interval_around, sign_changes, undecided_parts
from desim.study.results.result import SweepResult
from desim.study.results.runs import Group
from desim.study.store.run_table import Row
from tests.command import accepted, refused
from tests.summaries import changed

RUN = summary(run(Scenario(horizon=0.05, team=Team(count=2))))
X = [0.0, 0.1, 0.2, 0.4]
KEY = "network.latency.value"
EIGHT = np.arange(1.0, 9.0)[:, None] + np.zeros(4)
"""Eight runs that differ by a seed only: fewer, without scatter, decide nothing at four values together."""
A, B = {"protocol": "sap"}, {"protocol": "cbba"}


def sweep_of(sap, cbba, x=X, metric="active_time", **more):
    """Return a sweep with (runs, values of x) metrics of two protocols."""
    groups = []
    for k, value in enumerate(x):
        for name, table in (("sap", sap), ("cbba", cbba)):
            rows = tuple(Row(r, 7 + r, "ok", changed(RUN, **{metric: line[k]})) for r, line in enumerate(table))
            groups.append(Group({KEY: value, "protocol": name}, rows))
    return SweepResult("relay", (KEY, "protocol"), tuple(groups), **more)


def random_tables(rng, runs, x=X, slope=2.0, at=0.15, noise=0.3):
    """Return two (runs, x) tables whose mean difference is slope (x - at), with noise common to the points of a run."""
    base = 10.0 + rng.normal(0.0, 2.0, (runs, 1)) + np.zeros(len(x))
    scatter = rng.normal(0.0, noise, (runs, 1)) + rng.normal(0.0, noise, (runs, len(x)))
    return base + slope * (np.array(x) - at) + scatter, base


def test_curves_without_scatter_cross_where_their_lines_do():
    """2 (x - 0.15) is 0 at 0.15, with runs that differ by a seed only."""
    base = EIGHT
    crossing = sweep_of(base + 2.0 * (np.array(X) - 0.15), base).crossover("active_time", KEY, A, B)
    assert crossing.at == pytest.approx(0.15)
    assert (crossing.low, crossing.high) == (pytest.approx(0.15), pytest.approx(0.15))
    assert crossing.least == "protocol = cbba"
    assert crossing.more_is == "worse"
    assert "protocol = cbba beats protocol = sap from network.latency.value = 0.15 s on" in str(crossing)


def test_curves_are_chosen_by_their_values_and_not_by_their_first_six_digits():
    base = EIGHT
    swept = sweep_of(base + 2.0 * (np.array(X) - 0.15), base)
    rates = {"sap": 1000000.0, "cbba": 1000001.0}
    groups = [
        replace(one, settings={KEY: one.settings[KEY], "r": rates[one.settings["protocol"]]}) for one in swept.groups
    ]
    near = replace(swept, keys=(KEY, "r"), groups=tuple(groups))
    assert near.crossover("active_time", KEY, {"r": 1e6}, {"r": 1000001}).at == pytest.approx(0.15)
    with pytest.raises(ValueError, match=r"r takes 1000001, 1e\+06 on the curve of all"):
        near.threshold("active_time", KEY, 0.1)
    along = [
        replace(one, settings={"r": rates[one.settings["protocol"]]}) for one in swept.groups if not one.settings[KEY]
    ]
    assert replace(swept, keys=("r",), groups=tuple(along)).threshold("active_time", "r", 0.1).baseline == 1e6


def test_the_interval_of_two_points_is_fiellers_closed_form():
    """For d at 0 and e at 1, x = m / (m - n); the ends are the roots of (m + x s)^2 = q (v + 2 x c + x^2 w)."""
    rng = np.random.default_rng(2)
    differences = np.column_stack([rng.normal(-1.0, 0.5, 20), rng.normal(1.0, 0.5, 20)])
    (interval,) = undecided_parts([0.0, 1.0], differences, 0.95)
    ratio = -differences[:, 0].mean() / (differences[:, 1] - differences[:, 0]).mean()
    q = 2.093024054408263**2 / 20  # t(19), 97.5 %
    covariance = np.cov(differences[:, 0], differences[:, 1] - differences[:, 0])
    slope = (differences[:, 1] - differences[:, 0]).mean()
    g = q * covariance[1, 1] / slope**2
    middle = ratio + g / (1 - g) * (ratio + covariance[0, 1] / covariance[1, 1])
    spread = covariance[0, 0] + 2 * ratio * covariance[0, 1] + ratio**2 * covariance[1, 1]
    rest = g * (covariance[0, 0] - covariance[0, 1] ** 2 / covariance[1, 1])
    half = sqrt(q) / abs(slope) / (1 - g) * sqrt(spread - rest)
    assert interval == (pytest.approx(middle - half), pytest.approx(middle + half))
    assert sign_changes([0.0, 1.0], differences.mean(axis=0).tolist()) == (pytest.approx(ratio),)


@pytest.mark.slow
@pytest.mark.whole_but_one
@pytest.mark.parametrize("seed", range(8))
def test_the_interval_holds_the_points_at_which_a_t_test_does_not_decide(seed):
    """A loop over a fine grid, with scipy's t test of the differences that are interpolated run by run."""
    rng = np.random.default_rng(seed)
    sap, cbba = random_tables(rng, 12, noise=0.1 + 0.1 * seed)
    intervals = undecided_parts(X, sap - cbba, 0.9)
    for point in np.linspace(0.0, 0.4, 401):
        values = [np.interp(point, X, line) for line in sap - cbba]
        inside = any(low - 1e-12 <= point <= high + 1e-12 for low, high in intervals)
        p = ttest_1samp(values, 0.0).pvalue
        assert inside == (p >= 0.1) or abs(p - 0.1) < 1e-9


def test_an_interval_that_the_values_do_not_bound_has_no_end():
    sap, cbba = random_tables(np.random.default_rng(1), 10, slope=0.2, at=0.3, noise=0.2)
    crossing = sweep_of(sap, cbba).crossover("active_time", KEY, A, B)
    assert crossing.high == inf
    assert "beyond 0.4 s" in str(crossing)
    assert crossing.winner is None
    assert "beats" not in str(crossing)
    assert "protocol = sap and protocol = cbba are not told apart" in str(crossing)
    assert crossing.document()["interval"][1] == "Infinity" or crossing.document()["interval"][1] is None


def test_curves_that_do_not_cross_have_no_crossing():
    base = EIGHT
    crossing = sweep_of(base + 1.0, base).crossover("active_time", KEY, A, B)
    assert crossing.at is None
    assert isnan(crossing.low)
    assert str(crossing).startswith(
        "active time: no crossing for network.latency.value from 0 to 0.4 s: protocol = cbba beats protocol = sap"
    )
    assert crossing.document()["interval"] is None


@pytest.mark.parametrize("last", [0.15, 0.21, 0.34])
def test_curves_that_no_value_tells_apart_are_undecided_up_to_the_last_value(last):
    """0.05 + (0.21 - 0.05) is less than 0.21: such an end would count as one that the values bound."""
    (interval,) = undecided_parts([0.05, last], np.array([[1.0, -2.0], [-2.0, 1.0], [1.0, 2.0], [-1.0, -2.0]]), 0.95)
    assert interval == (0.05, last)


def test_a_few_runs_without_scatter_decide_nothing():
    """Three runs that all differ by 1 s: by 2^(1 - 3) as chance has it. The control are the eight of the test above."""
    crossing = sweep_of(EIGHT[:3] + 1.0, EIGHT[:3]).crossover("active_time", KEY, A, B)
    assert (crossing.winner, crossing.undecided) == (None, ((0.0, 0.4),))
    assert str(crossing) == (
        "active time: protocol = sap and protocol = cbba are not told apart for network.latency.value from 0 to 0.4 s"
        " at a level of 5 % for all 4 values together (Bonferroni, 3 pairs of runs with the same seed)"
    )
    assert undecided_parts(X, np.ones((5, 4)), 0.95) == [(0.0, 0.4)]
    assert undecided_parts(X, np.ones((6, 4)), 0.95) == []


def equal_curves(rng, values, runs=10):
    """Return (runs, values) differences of two equal curves, half of whose variance is common to a run."""
    return rng.normal(size=(runs, 1)) + rng.normal(size=(runs, values))


@pytest.mark.slow
def test_equal_curves_are_told_apart_no_more_often_than_the_level_says():
    """600 studies of 8 values: s.e. 0.9 % at 5 %. A test at the level itself at each value, the control: a fifth."""
    rng, x = np.random.default_rng(6), [float(k) for k in range(8)]
    found, uncorrected = 0, 0
    for _ in range(600):
        apart = equal_curves(rng, 8)
        crossings = sign_changes(x, apart.mean(axis=0).tolist())
        at = crossings[-1] if crossings else None
        found += are_told_apart(x, apart, at, 0.95)
        uncorrected += are_told_apart(x, apart, at, 1.0 - 8 * 0.05)
    assert found / 600 <= 0.05 + 3 * 0.009
    assert uncorrected / 600 > 0.05 + 3 * 0.009


def test_a_difference_at_the_crossing_itself_tells_no_curves_apart():
    """The curves differ at the first value, and beyond it by their scatter only."""
    apart = np.array([[5.0, -0.1, 0.01], [5.1, 0.1, -0.02], [4.9, 0.0, 0.03], [5.0, 0.05, 0.01]])
    assert are_told_apart([0.0, 1.0, 2.0], apart, None, 0.95)
    assert are_told_apart([0.0, 1.0, 2.0], apart, -1.0, 0.95)
    assert not are_told_apart([0.0, 1.0, 2.0], apart, 0.0, 0.95)
    assert not are_told_apart([0.0, 1.0, 2.0], apart, 0.5, 0.95)


def test_means_that_cross_without_being_told_apart_beyond_have_no_winner():
    """Of equal curves whose interval is bounded by chance: there is no winner."""
    rng = np.random.default_rng(12)
    for _ in range(200):
        apart = equal_curves(rng, 4)
        crossings = sign_changes(X, apart.mean(axis=0).tolist())
        parts = undecided_parts(X, apart, 0.95)
        if crossings and interval_around(crossings[-1], X, parts)[1] < inf:
            break
    crossing = sweep_of(10.0 + apart, np.full_like(apart, 10.0)).crossover("active_time", KEY, A, B)
    assert crossing.high < inf
    assert (crossing.winner, crossing.is_told_apart) == (None, False)
    assert "the means cross" in str(crossing)
    assert "but beyond protocol = sap and protocol = cbba are not told apart at a level of 5 % for all 4 " in str(
        crossing
    )
    assert crossing.document()["winner_beyond"] is None


@pytest.mark.parametrize(("shift", "crosses"), [(0.0, True), (0.2, False)])
def test_curves_that_scatter_more_than_they_differ_have_no_winner(shift, crosses):
    """Differences of -1 and 1 in turn with means of 0.1 and less: no value of the key tells the two apart."""
    base = np.array([[1.0], [2.0], [3.0], [4.0]]) + np.zeros(4)
    noise = np.array([[1.0], [-1.0], [1.0], [-1.0]]) + np.array([0.1, -0.1, 0.1, -0.1]) + shift
    crossing = sweep_of(base + noise, base).crossover("active_time", KEY, A, B)
    assert (crossing.at is not None) == crosses
    assert crossing.winner is None
    assert crossing.undecided == ((0.0, 0.4),)
    assert crossing.document()["winner_beyond"] is None
    sentence = str(crossing)
    assert "protocol = sap and protocol = cbba are not told apart" in sentence
    assert "from 0 to 0.4 s" in sentence or "network.latency.value = 0 to 0.4 s" in sentence
    assert "beats" not in sentence
    assert ("the means cross 3 times, the last time at 0.3 s" in sentence) == crosses


def test_the_last_of_several_crossings_counts_and_touching_is_none():
    assert sign_changes([0, 1, 2, 3], [1.0, -1.0, 1.0, -3.0]) == (0.5, 1.5, 2.25)
    assert sign_changes([0, 1, 2], [1.0, 0.0, 1.0]) == ()
    assert sign_changes([0, 1, 2], [0.0, 1.0, 2.0]) == ()
    assert sign_changes([0, 1, 2, 3], [1.0, 0.0, 0.0, -1.0]) == (1.5,)
    base = EIGHT
    crossing = sweep_of(base + np.array([1.0, -1.0, 1.0, -3.0]), base).crossover("active_time", KEY, A, B)
    assert crossing.least == "protocol = sap"
    assert "the means cross 3 times, and this is the last" in str(crossing)


def test_more_may_be_better_and_infinite_values_are_left_out():
    base = EIGHT
    sap = base + np.array([-1.0, 1.0, 1.0, 9.0])
    swept = sweep_of(sap, base, x=[0.0, 0.1, 0.2, inf])
    crossing = swept.crossover("active_time", KEY, A, B)
    assert crossing.span == (0.0, 0.2)
    assert crossing.least == "protocol = cbba"


def test_a_seed_without_a_value_is_left_out():
    sap, cbba = random_tables(np.random.default_rng(4), 10)
    table = sap.tolist()
    table[3][1] = None
    with_gap = sweep_of(table, cbba, metric="capture_time")
    keep = [k for k in range(10) if k != 3]
    assert with_gap.crossover("capture_time", KEY, A, B).pairs == 9
    assert with_gap.crossover("capture_time", KEY, A, B).at == pytest.approx(
        sweep_of(sap[keep], cbba[keep]).crossover("active_time", KEY, A, B).at
    )


def test_what_has_no_crossover_is_refused(tmp_path):
    sap, cbba = random_tables(np.random.default_rng(4), 4)
    swept = sweep_of(sap, cbba)
    three = replace(
        swept,
        keys=(*swept.keys, "network.range"),
        groups=tuple(replace(g, settings={**g.settings, "network.range": r}) for g in swept.groups for r in (6.0, 9.0)),
    )
    cases = [
        (swept, ("activetime", KEY, A, B), "did you mean 'active_time'"),
        (swept, ("active_time", "network.latncy.value", A, B), "the grid has no key"),
        (swept, ("active_time", "network", A, B), "no key network, did you mean network.latency.value"),
        (swept, ("active_time", "protocol", {KEY: 0.0}, {KEY: 0.1}), "cross along numbers, and it takes sap, cbba"),
        (swept, ("active_time", KEY, A, A), "got protocol = sap twice"),
        (swept, ("active_time", KEY, {"protocol": "cbaa"}, B), "does not take the value cbaa"),
        (swept, ("active_time", KEY, {KEY: 0.1}, B), "a and b should not fix it"),
        (three, ("active_time", KEY, A, B), r"network.range takes 6, 9 on the curve .* where=\{"),
        (sweep_of(sap, cbba, common=False), ("active_time", KEY, A, B), "independent seeds cannot be paired"),
        (sweep_of(sap[:1], cbba[:1]), ("active_time", KEY, A, B), "needs two seeds"),
        (sweep_of(sap[:, :1], cbba[:, :1], x=[0.1]), ("active_time", KEY, A, B), "needs two or more finite numbers"),
    ]
    for result, arguments, message in cases:
        with pytest.raises(ValueError, match=message):
            result.crossover(*arguments)
    for confidence in (95, 1.0, 0.0, -0.5):
        with pytest.raises(ValueError, match="confidence should be between 0 and 1"):
            swept.crossover("active_time", KEY, A, B, confidence=confidence)
    assert three.crossover("active_time", KEY, A, B, where={"network.range": 6}).pairs == 4
    assert "'sap' should be KEY=VALUE, protocol.kind=sap for instance" in refused(
        "crossover", tmp_path, KEY, "sap", "protocol=cbba"
    )


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("confidence", [0.95, 0.5])
def test_the_interval_covers_as_often_as_it_says(confidence):
    """2,000 studies of 10 seeds; s.e. 0.5 % and 1.1 %. Half of the intervals of 50 % do not cover: a control."""
    rng = np.random.default_rng(3)
    studies, covered = 2000, 0
    for _ in range(studies):
        sap, cbba = random_tables(rng, 10, noise=0.1)
        differences = sap - cbba
        at = sign_changes(X, differences.mean(axis=0).tolist())
        intervals = undecided_parts(X, differences, confidence)
        low, high = next((ends for ends in intervals if at and ends[0] <= at[-1] <= ends[1]), (inf, -inf))
        covered += (low <= X[0] or low <= 0.15) and (high >= X[-1] or high >= 0.15)
    error = sqrt(confidence * (1.0 - confidence) / studies)
    assert abs(covered / studies - confidence) < 4.0 * error


@pytest.mark.slow
def test_an_interval_for_independent_runs_would_cover_too_often():
    """A control of the pairs: runs that are paired with those of other seeds scatter by the seeds, too."""
    rng = np.random.default_rng(3)
    widths = []
    for shuffled in (False, True):
        sap, cbba = random_tables(rng, 30)
        other = cbba[rng.permutation(30)] if shuffled else cbba
        low, high = max(undecided_parts(X, sap - other, 0.95), key=lambda ends: ends[1] - ends[0])
        widths.append(high - low)
    assert widths[0] < 0.5 * widths[1]


FILE = """\
name = "relay"
horizon = 0.5
team.count = 3
sweep.reps = 3
sweep.grid."network.latency.value" = [0.0, 0.3]
sweep.grid."protocol" = [{ kind = "sap" }, { kind = "cbba" }]
"""


@pytest.mark.slow
def test_the_command_finds_the_same(tmp_path):
    file = tmp_path / "relay.toml"
    file.write_text(FILE)
    accepted("sweep", file, "-o", tmp_path / "out")
    words = "crossover", tmp_path / "out", KEY, "protocol=sap", "protocol=cbba"
    assert accepted(*words).stdout.startswith("active time: ")
    assert '"metric": "messages_sent"' in accepted(*words, "-y", "messages_sent", "--json").stdout
