"""Two sweeps side by side: pairs by seed, independent runs, and what is matched."""

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
from scipy.stats import t, ttest_ind, ttest_rel

import desim
from desim.analysis.measuring import summary
from desim.analysis.statistics import independent
from desim.scenario.players import Team
from desim.scenario.scenario import Scenario
from desim.simulation.run import run
from desim.study.results.comparison import Comparison
from desim.study.results.result import SweepResult
from desim.study.results.runs import SHOWN, Group
from desim.study.store.run_table import Row, RunTable
from desim.study.sweeps import folder as module
from desim.study.sweeps.folder import compare
from tests.command import accepted, refused, strict_json
from tests.summaries import changed

RUN = summary(run(Scenario(horizon=0.05, team=Team(count=2))))


def sweep_of(times, *, first_seed=10, settings=None, failed=(), name="relay", metric="active_time"):
    """Return a sweep whose configuration x = k has the metrics `times[k]`; its first run has `first_seed`."""
    groups = []
    for k, values in enumerate(times):
        rows = [
            Row(r, first_seed + r, "error", None, "no")
            if (k, r) in failed
            else Row(r, first_seed + r, "ok", changed(RUN, **{metric: value}))
            for r, value in enumerate(values)
        ]
        groups.append(Group({"x": float(k), **(settings or {})}, tuple(rows)))
    return SweepResult(name, tuple(groups[0].settings), tuple(groups))


RNG = np.random.default_rng(5)
BEFORE = RNG.normal(5.0, 1.0, (2, 12)).tolist()
AFTER = [[value + 0.5 + 0.1 * RNG.normal() for value in BEFORE[0]], RNG.normal(5.0, 1.0, 12).tolist()]


def test_runs_with_the_same_seed_are_paired():
    comparison = compare(sweep_of(BEFORE), sweep_of(AFTER), ["active_time"])
    for compared, old, new in zip(comparison.configurations, BEFORE, AFTER, strict=True):
        cell = compared.metrics["active_time"]
        low, high = ttest_rel(new, old).confidence_interval(0.95)
        assert compared.pairs == 12
        assert cell.difference.mean == pytest.approx(np.mean(new) - np.mean(old))
        assert cell.difference.half_width == pytest.approx((high - low) / 2.0)
        assert (cell.first.mean, cell.second.mean) == (pytest.approx(np.mean(old)), pytest.approx(np.mean(new)))


def test_no_rows_are_made_of_tables_that_are_compared(monkeypatch):
    """They took five times as long as all the rest."""
    sweeps = [
        replace(sweep, groups=tuple(Group(group.settings, RunTable(group.rows)) for group in sweep.groups))
        for sweep in (sweep_of(BEFORE), sweep_of(AFTER))
    ]
    monkeypatch.delattr(RunTable, "_run")
    assert [compared.pairs for compared in compare(*sweeps, ["active_time", "messages_sent"]).configurations] == [
        12,
        12,
    ]


def test_only_seeds_of_both_are_paired_and_a_failed_run_has_no_pair():
    later = sweep_of([row[2:] for row in AFTER], first_seed=12, failed={(0, 0)})
    comparison = compare(sweep_of(BEFORE, failed={(0, 11)}), later, ["active_time"])
    assert [compared.pairs for compared in comparison.configurations] == [8, 10]
    expected = np.mean(np.subtract(AFTER[0][3:11], BEFORE[0][3:11]))
    assert comparison.configurations[0].metrics["active_time"].difference.mean == pytest.approx(expected)


def test_without_common_seeds_the_interval_is_that_of_welch():
    comparison = compare(sweep_of(BEFORE), sweep_of(AFTER, first_seed=99), ["active_time"])
    for compared, old, new in zip(comparison.configurations, BEFORE, AFTER, strict=True):
        difference = compared.metrics["active_time"].difference
        low, high = ttest_ind(new, old, equal_var=False).confidence_interval(0.95)
        assert compared.pairs == 0
        assert difference.half_width == pytest.approx((high - low) / 2.0)
    assert "fewer than two seeds in common" in comparison.table()
    paired = compare(sweep_of(BEFORE), sweep_of(AFTER), ["active_time"])
    here, there = (each.configurations[0].metrics["active_time"].difference.half_width for each in (paired, comparison))
    assert here < 0.2 * there, "a control: pairs are worth it where runs of a seed are alike"


def test_the_difference_of_constants_has_no_width_and_says_nothing_about_others():
    difference = independent([2.0, 2.0, 2.0], [1.0, 1.0])
    assert (difference.mean, difference.half_width, difference.others) == (1.0, 0.0, None)
    assert independent([1.0, 2.0], [1.0]).half_width != independent([1.0, 2.0], [1.0]).half_width  # nan


def test_a_sentence_is_corrected_for_all_comparisons():
    """B is 1 s more in every run but one with x = 0; with 20 configurations the same difference says nothing."""
    old = [[0.0, 0.0, 0.0, 0.0]] * 20
    new = [[1.0, 1.2, 0.8, 1.4], *([[0.1, -0.1, 0.1, -0.1]] * 19)]
    few = compare(sweep_of(old[:1]), sweep_of(new[:1]), ["active_time"])
    many = compare(sweep_of(old), sweep_of(new), ["active_time"])
    width = float(t.ppf(1 - 0.025 / 20, 3)) * np.std(new[0], ddof=1) / sqrt(4)
    assert width > 1.1
    (sentence,) = few.sentences()
    assert "is greater than relay (first)" in sentence
    assert "Bonferroni" not in sentence
    (sentence,) = many.sentences()
    assert "no difference is distinguishable from 0 at a level of 5 % for all 20 comparisons together (Bonf" in sentence
    assert "the greatest is +1.100 +- 0.411 s (95 % interval of it alone, 4 pairs of runs" in sentence


def test_a_sentence_counts_the_pairs_that_both_have_a_value():
    """Of four pairs, two have a capture time on both sides; a difference of two pairs is not one of four."""
    old, new = [[1.0, 2.0, None, 4.0]], [[1.5, 3.5, 3.0, None]]
    (sentence,) = compare(
        sweep_of(old, metric="capture_time"), sweep_of(new, metric="capture_time"), ["capture_time"]
    ).sentences()
    assert "the greatest is +1.000 +- 6.353 s (95 % interval, 2 of 4 pairs of runs with the same seed)" in sentence


def test_a_mean_over_other_runs_than_the_pairs_says_over_how_many():
    """Else A = 2.333, B = 2.667 and B - A = +1.000 would contradict each other without a word."""
    old, new = [[1.0, 2.0, None, 4.0]], [[1.5, 3.5, 3.0, None]]
    ((heading, (_, row)),) = compare(
        sweep_of(old, metric="capture_time"), sweep_of(new, metric="capture_time"), ["capture_time"]
    ).tables()
    assert heading.endswith("; (n): over n runs, and so perhaps other seeds")
    assert [cell[-4:] for cell in row[2:]] == [" (3)", " (3)", " (2)"]
    ((heading, (_, row)),) = compare(sweep_of([[1.0, 2.0]]), sweep_of([[1.5, 3.5]]), ["active_time"]).tables()
    assert "(n)" not in heading
    assert "(" not in "".join(row)
    longer = sweep_of([[1.0, 2.0, 3.0, 3.5]], first_seed=9)
    ((heading, (_, row)),) = compare(sweep_of([[1.5, 2.5]], first_seed=9), longer, ["active_time"]).tables()
    assert ["(" in cell for cell in row[2:]] == [False, True, False]
    ((heading, _),) = compare(sweep_of([[1.5, 2.5]], first_seed=99), longer, ["active_time"]).tables()
    assert "(n)" not in heading, "independent runs: all that there are"


@pytest.mark.parametrize(("old", "is_told"), [([1.0, None], True), ([None, None], False), ([1.0, 2.0], False)])
def test_a_value_of_one_run_is_told_apart_from_those_of_none_and_of_all(old, is_told):
    new = sweep_of([[1.5, 3.5]], metric="capture_time")
    ((heading, _),) = compare(sweep_of([old], metric="capture_time"), new, ["capture_time"]).tables()
    assert ("(n)" in heading) == is_told


def test_a_few_equal_differences_are_not_distinguishable_from_0():
    """Three pairs that differ by 1 s each: 2^(1 - 3) = 1/4. Six pairs are enough; the control."""
    few, enough = (
        compare(sweep_of([[0.0] * count]), sweep_of([[1.0] * count]), ["active_time"]).sentences() for count in (3, 6)
    )
    assert few == [
        "active time: no difference is distinguishable from 0; the greatest is +1.000 s in all, others < 56.1% (95 %"
        " interval, 3 pairs of runs with the same seed), for x = 0"
    ]
    assert "is greater than relay (first)" in enough[0]


def test_one_run_of_each_is_not_judged():
    comparison = compare(sweep_of([[1.0]]), sweep_of([[2.0]]), ["active_time"])
    assert comparison.sentences() == ["active time: no configuration has two runs of both to compare"]
    assert "fewer than two seeds in common: the runs are compared as independent ones" in comparison.table()


def test_configurations_are_matched_by_their_settings():
    reordered = sweep_of(AFTER)
    reordered = replace(reordered, groups=reordered.groups[::-1])
    third = sweep_of([*BEFORE, BEFORE[0]])
    comparison = compare(third, reordered, "active_time")
    assert [compared.settings for compared in comparison.configurations] == [{"x": 0.0}, {"x": 1.0}]
    assert comparison.unmatched == (1, 0)
    assert "1 configuration of relay (first) left out" in comparison.table()
    assert comparison.configurations[0].metrics["active_time"].difference.mean == pytest.approx(
        np.mean(AFTER[0]) - np.mean(BEFORE[0])
    )


def test_values_are_matched_if_they_are_equal_but_for_rounding_and_not_by_their_first_six_digits():
    def swept(*values):
        made = sweep_of([[1.0, 2.0], [11.0, 12.0]])
        groups = (replace(group, settings={"x": x}) for group, x in zip(made.groups, values, strict=True))
        return replace(made, groups=tuple(groups))

    near = swept(1000000.0, 1000001.0)
    for other in (near, replace(near, groups=near.groups[::-1])):
        differences = [
            each.metrics["active_time"].difference.mean for each in compare(near, other, SHOWN[0]).configurations
        ]
        assert differences == [0.0, 0.0]
    assert len(compare(swept(0.1 + 0.2, 1.0), swept(0.3, 1), SHOWN[0]).configurations) == 2
    one, other = (replace(sweep, groups=sweep.groups[:1]) for sweep in (near, swept(1000000.5, 2.0)))
    assert compare(one, other, SHOWN[0]).changes == {"x": ("1e+06", "1000000.5")}


def test_a_key_with_one_value_in_each_is_what_differs():
    comparison = compare(
        sweep_of(BEFORE, settings={"protocol": "sap"}), sweep_of(AFTER, settings={"protocol": "cbba"}), ["active_time"]
    )
    assert comparison.keys == ("x",)
    assert comparison.changes == {"protocol": ("sap", "cbba")}
    assert "protocol: sap in relay (first), cbba in relay (second)" in comparison.table()


def test_what_cannot_be_compared_is_refused(tmp_path):
    plain, more = sweep_of(BEFORE), sweep_of(BEFORE)
    more = replace(
        more,
        keys=("x", "y"),
        groups=tuple(replace(g, settings={**g.settings, "y": k}) for k, g in enumerate(more.groups)),
    )
    with pytest.raises(ValueError, match=r"the second sweep varies y, .* within the sweep, with `plot --against`"):
        compare(plain, more)
    with pytest.raises(ValueError, match="no configuration is in both sweeps"):
        compare(plain, replace(plain, groups=(Group({"x": 9.0}, plain.groups[0].rows),)))
    with pytest.raises(ValueError, match="did you mean 'active_time'"):
        compare(plain, plain, ["activetime"])
    with pytest.raises(TypeError, match="two sweeps, or the folders of two sweeps, got int"):
        compare(plain, 3)
    with pytest.raises(ValueError, match="format should be text, latex, markdown, got 'html'"):
        compare(plain, plain).table(format="html")
    assert "there is no such store" in refused("compare", tmp_path / "a.sqlite", tmp_path / "b.sqlite")


FILE = """\
name = "relay"
horizon = 0.2
team.count = 3
sweep.reps = 3
sweep.grid."network.loss.p" = [0.0, 0.3]
network.loss = { kind = "bernoulli", p = 0.0 }
"""


@pytest.mark.slow
def test_two_folders_differ_by_what_all_their_runs_share(tmp_path):
    """Values of the first come first, and then keys that only the second has; a swept key and the seed are none."""
    base = desim.Scenario(name="short", horizon=0.01, team={"count": 2})
    changed = {"network.latency": {"kind": "uniform", "high": 0.5}, "horizon": 0.02, "seed": 7}
    for name, scenario in (("a", base), ("b", base.with_(changed))):
        desim.sweep(scenario, {"network.loss.p": [0.0, 0.5]}, 1, store=tmp_path / name / "sweep.sqlite")
    changes = compare(tmp_path / "a", tmp_path / "b").changes
    assert changes == {
        "horizon": ("0.01", "0.02"),
        "network.latency.kind": ('"constant"', '"uniform"'),
        "network.latency.value": ("0.0", "not there"),
        "network.latency.low": ("not there", "0.0"),
        "network.latency.high": ("not there", "0.5"),
    }
    assert list(changes)[-2:] == ["network.latency.low", "network.latency.high"]
    assert compare(tmp_path / "b", tmp_path / "a").changes["horizon"] == ("0.02", "0.01")
    assert compare(tmp_path / "a", tmp_path / "a").changes == {}


@pytest.mark.slow
def test_a_value_in_one_grid_only_is_compared_with_that_of_the_other_scenario(tmp_path):
    base = desim.Scenario(horizon=0.01, team={"count": 2})
    grid = {"network.loss.p": [0.0, 0.5]}
    desim.sweep(base, grid | {"network.latency": [0.1]}, 1, store=tmp_path / "a.sqlite")
    for name, latency in (("b", 0.1), ("c", 0.2)):
        desim.sweep(base.with_({"network.latency": latency}), grid, 1, store=tmp_path / f"{name}.sqlite")
    assert compare(tmp_path / "a.sqlite", tmp_path / "b.sqlite").changes == {}
    assert compare(tmp_path / "a.sqlite", tmp_path / "c.sqlite").changes == {"network.latency.value": ("0.1", "0.2")}
    assert compare(tmp_path / "c.sqlite", tmp_path / "a.sqlite").changes == {"network.latency.value": ("0.2", "0.1")}


@pytest.mark.whole
def test_the_command_compares_two_folders_and_says_what_differs(tmp_path):
    file = tmp_path / "relay.toml"
    file.write_text(FILE)
    folders = [tmp_path / name for name in ("near", "far")]
    for folder, size in zip(folders, (2.0, 3.0), strict=True):
        accepted("sweep", file, "-o", folder, "--set", f"network.range={size}")
    made = strict_json(accepted("compare", *folders, "-y", "active_time", "--json").stdout)
    assert made["changes"] == {"network.range": ["2.0", "3.0"]}
    assert [part["pairs"] for part in made["configurations"]] == [3, 3]
    assert made == desim.compare(*folders, ["active_time"]).document()
    assert "\\toprule" in accepted("compare", *folders, "--format", "latex").stdout
    assert "network.range: 2.0 in" in accepted("compare", *folders).stdout
    accepted("run", file, "-o", tmp_path / "run")
    assert "is a run, and sweeps are compared" in refused("compare", folders[0], tmp_path / "run")


def test_the_command_compares_the_metrics_that_it_is_given_or_the_usual_ones(monkeypatch):
    asked = []

    def compared(first, second, metrics):
        asked.append(metrics)
        return compare(sweep_of(BEFORE), sweep_of(AFTER), ["active_time"])

    monkeypatch.setattr(module, "compare", compared)
    accepted("compare", "a", "b", "-y", "energy")
    accepted("compare", "a", "b")
    assert asked == [("energy",), SHOWN]


def test_the_command_writes_the_table_in_each_format(monkeypatch):
    comparison = compare(sweep_of(BEFORE), sweep_of(AFTER), ["active_time"])
    monkeypatch.setattr(module, "compare", lambda *_: comparison)
    for form in ("text", "latex", "markdown"):
        assert comparison.table(format=form) in accepted("compare", "a", "b", "--format", form).stdout


def test_a_notebook_shows_it_with_its_names_escaped():
    comparison = Comparison.of(sweep_of(BEFORE), sweep_of(AFTER), ["active_time"], ("<b>", "&"))
    assert "<b>" not in comparison._repr_html_()
    assert "&lt;b&gt;" in comparison._repr_html_()
    assert repr(comparison) == "<Comparison of <b> and &: 2 configurations>"
