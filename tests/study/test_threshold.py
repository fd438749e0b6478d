"""From where on a metric exceeds its baseline by a share, against closed forms, t tests and scipy."""

from math import inf, isnan

import numpy as np
import pytest
from scipy.stats import ttest_rel

from tests.command import refused
from tests.study.test_crossover import KEY, X, sweep_of

SAP = {"protocol": "sap"}
BASE = np.array([[9.0], [10.0], [11.0]]) + np.zeros(4)


def threshold_of(table, over=0.1, x=X, **options):
    """Return the threshold of a (runs, values of x) table."""
    return sweep_of(table, table, x=x).threshold("active_time", KEY, over, where=SAP, **options)


def test_without_scatter_of_the_ratio_the_threshold_is_where_the_line_meets_it():
    """y = b (1 + x): 10 % over the baseline at x = 0.1 and 25 % at 0.25, for each run."""
    table = BASE * (1.0 + np.array(X))
    for over in (0.1, 0.25):
        found = threshold_of(table, over)
        assert found.at == pytest.approx(over)
        assert found.is_beyond is True
        assert (found.low, found.high) == (pytest.approx(over), pytest.approx(over))
        assert found.relative[1] == (pytest.approx(0.4), pytest.approx(0.4))
    assert str(found) == (
        "active time: more than 25 % over its mean at network.latency.value = 0 s from network.latency.value = 0.25 s"
        " on (95 % interval 0.25 to 0.25 s); at 0.4 s it is +40 % (+40 to +40 %; Fieller, 3 runs with the same seeds at"
        " each value)"
    )
    less = threshold_of(BASE * (1.0 - np.array(X)), -0.1)
    assert (less.at, less.is_beyond) == (pytest.approx(0.1), True)


def test_a_share_that_is_not_reached_has_no_threshold():
    found = threshold_of(BASE * (1.0 - np.array(X)), 0.1)
    assert (found.at, found.is_beyond) == (None, False)
    assert isnan(found.low)
    assert str(found).startswith(
        "active time: not more than 10 % over its mean at network.latency.value = 0 s up to 0.4 s; at 0.4 s it is -40 %"
    )
    assert found.document()["interval"] is None


def test_a_baseline_at_the_upper_end_is_exceeded_below():
    """y = b (1.4 - x) / 1.0 with the baseline at 0.4: 10 % over it below x = 0.3."""
    found = threshold_of(BASE * (1.4 - np.array(X)), 0.1, baseline="0.40")
    assert (found.at, found.is_beyond) == (pytest.approx(0.3), False)
    assert "from network.latency.value = 0.3 s down" in str(found)
    assert "at 0 s it is +40 %" in str(found)


def test_a_baseline_that_is_infinite_may_be_exceeded_at_all_values():
    found = threshold_of(BASE * np.array([1.5, 1.5, 1.5, 1.0]), 0.1, x=[0.0, 0.1, 0.2, inf], baseline=inf)
    assert (found.at, found.is_beyond) == (None, True)
    assert "at all of network.latency.value from 0 to 0.2 s" in str(found)


@pytest.mark.parametrize("seed", range(4))
def test_the_intervals_hold_what_a_paired_t_test_does_not_exclude(seed):
    """Of the ratio at the end of the curve, and of the value of the key, by scipy's test of y - (1 + share) b."""
    rng = np.random.default_rng(seed)
    base = rng.gamma(9.0, 1.0, (20, 1))
    table = base + np.array(X) * 6.0 + rng.normal(0.0, 0.8, (20, 4))
    found = threshold_of(table, 0.1)
    for share in found.relative[1]:
        assert ttest_rel(table[:, -1], (1.0 + share) * table[:, 0]).pvalue == pytest.approx(0.05)
    assert found.relative[1][0] < found.relative_means[1] < found.relative[1][1]
    assert found.low < found.at < found.high
    for end in (found.low, found.high):
        values = [np.interp(end, X, run) for run in table]
        assert ttest_rel(values, 1.1 * table[:, 0]).pvalue == pytest.approx(0.05)


def test_a_share_within_the_scatter_is_not_decided():
    noise = np.array([[1.0], [-1.0], [1.0], [-1.0]]) * np.array([0.0, 1.0, -1.0, 1.0])
    found = threshold_of(np.full((4, 4), 10.0) + np.array([[0.1], [0.0], [-0.1], [0.0]]) + 2.0 * noise, 0.1)
    assert found.is_beyond is None
    assert "is not decided at network.latency.value = 0.4 s" in str(found)


def test_an_undecided_value_among_those_of_the_sentence_is_told():
    """At one value of the key the runs scatter by 3 on both sides of the share; the means do not cross it there."""
    scatter = np.array([[3.0], [-3.0], [3.0], [-3.0]])
    base = np.array([[9.0], [10.0], [11.0], [10.0]])
    doubt = "though not decided at every value"
    for by_value, k, where in (
        ([1.0, 1.05, 0.8, 0.6], 1, " up to 0.4 s, "),
        ([1.0, 1.3, 1.13, 1.4], 2, " s), "),
    ):
        without = base * np.array(by_value)
        assert doubt not in str(threshold_of(without))
        found = threshold_of(without + scatter * (np.arange(4) == k))
        assert any(low <= X[k] <= high for low, high in found.undecided)
        assert f"{where}{doubt}; at 0.4 s" in str(found)


def test_what_has_no_threshold_is_refused(tmp_path):
    for over in (0.0, -1.0, inf):
        with pytest.raises(ValueError, match=r"over should be a share, 0\.1 for 10 %"):
            threshold_of(BASE, over)
    with pytest.raises(ValueError, match=r"needs a positive mean, got -10 at network\.latency\.value = 0"):
        threshold_of(-BASE)
    with pytest.raises(ValueError, match="a threshold needs two seeds"):
        threshold_of(BASE[:1])
    with pytest.raises(ValueError, match="protocol takes cbba, sap on the curve of all: choose one"):
        sweep_of(BASE, BASE).threshold("active_time", KEY, 0.1)
    with pytest.raises(ValueError, match="does not take the value 7"):
        threshold_of(BASE, baseline=7)
    assert "should be a share in percent, 10% for instance" in refused("crossover", tmp_path, KEY, "--over", "0.1")
    for words in ((), ("a=b",), ("a=b", "c=d", "--over", "10%")):
        assert "give either the two curves A and B" in refused("crossover", tmp_path, KEY, *words)
