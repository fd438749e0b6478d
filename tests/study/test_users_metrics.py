"""Metrics of users in many runs: what a store has of them, when runs are repeated, and where they are shown."""

import csv
import json
import os
import re
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from functools import partial
from math import inf
from pathlib import Path
from types import SimpleNamespace

import pytest

from desim import explain, sweep
from desim.analysis import captures
from desim.analysis.looks import runs_needed
from desim.analysis.measuring import summary
from desim.analysis.metrics import METRICS, Metric, Summary, active_time, end_time
from desim.cli.sources import shown_metrics
from desim.scenario import named_metrics
from desim.scenario.overrides import ScenarioError
from desim.scenario.players import Team
from desim.scenario.scenario import Recording, Scenario, without_metrics
from desim.study.plan import metric_code
from desim.study.plan.config_hash import identify
from desim.study.plan.metric_code import units_and_codes
from desim.study.results.figures import means
from desim.study.results.result import SweepResult
from desim.study.store.file import StoreError
from desim.study.store.run_table import Row
from desim.study.store.store import Store
from desim.study.sweeps import sweep as module
from desim.study.sweeps import sweep_plan
from desim.study.sweeps.sweep import RunError
from desim.study.sweeps.sweep_plan import SweepPlan
from desim.view.pages.report import Study, report
from tests.analysis import of_users
from tests.command import accepted, refused
from tests.view.elements import Elements

ROOT = Path(__file__).parents[2]
BASE = Scenario(name="coins", horizon=0.2, team=Team(count=3, box=(9.0, 11.0)), motion={"step": 0.05})
GRID = {"capture.radius": [0.05, 0.2]}
RANGES = {"network.range": [3.0, 9.0]}


@pytest.fixture
def done(monkeypatch):
    """Return the list of the seeds of all runs that sweeps perform from now on."""
    seeds, drive_batches = [], module.drive_batches

    def watched(tasks, *rest, **options):
        seeds.extend(seed for _, seed in tasks)
        return drive_batches(tasks, *rest, **options)

    monkeypatch.setattr(module, "drive_batches", watched)
    return seeds


@pytest.fixture
def looks(monkeypatch):
    """Let sweeps take their first look at 10 runs instead of 100; return that stopping rule."""
    monkeypatch.setattr(module, "runs_needed", partial(runs_needed, first_look=10))
    return module.runs_needed


def half(result):
    return active_time(result) / 2.0


def stored(path):
    """Return the metrics in each row of a store."""
    with closing(sqlite3.connect(path)) as database:
        return [json.loads(text) for (text,) in database.execute("SELECT summary FROM runs ORDER BY rowid")]


@pytest.mark.whole
def test_a_metric_is_in_the_rows_the_table_the_files_the_view_and_the_figure(tmp_path):
    store = tmp_path / "s.sqlite"
    found = sweep(BASE, GRID, 2, store=store, metrics={"half": Metric(half, "s"), "late": lambda result: True})
    for group in found.groups:
        assert group.values("half") == [time / 2.0 for time in group.values("active_time")]
        assert group.values("late") == [True, True]
    assert "half, s" in found.table(["half"])
    assert found.document(["half"])["configurations"][0]["metrics"]["half"]["runs"] == 2
    found.write(tmp_path / "x.csv")
    values = [value for group in found.groups for value in group.values("half")]
    with (tmp_path / "x.csv").open() as file:
        assert [float(row["half"]) for row in csv.DictReader(file)] == values
    frame = found.to_frame()
    assert [frame[name].dtype.name for name in ("half", "late")] == ["float64", "bool"]
    with closing(sqlite3.connect(store)) as database:
        times = database.execute("SELECT half, active_time / 2, late FROM results").fetchall()
    assert times == [(time, time, 1) for time in frame["half"]]
    assert means(found, "half").axes[0].get_ylabel() == "half (s)"
    with Store(store, read_only=True) as kept:
        assert SweepResult.of(kept) == found
        assert SweepResult.of(kept).units == {"half": "s", "late": ""}
        for row in SweepResult.of(kept).groups[0].rows:
            assert f"half: {row.summary['half']:.6g} s" in str(row.summary).splitlines()


@pytest.mark.whole
def test_metrics_of_a_script_are_computed_by_other_processes():
    metrics = {"half": Metric(half, "s"), "more": partial(lambda more, result: active_time(result) + more, 1.0)}
    assert sweep(BASE, GRID, 4, executor=2, metrics=metrics) == sweep(BASE, GRID, 4, metrics=metrics)


@pytest.mark.slow
def test_infinity_is_kept(tmp_path):
    for _ in range(2):
        found = sweep(BASE, GRID, 1, store=tmp_path / "s.sqlite", metrics={"x": lambda result: -inf})
        assert [group.values("x") for group in found.groups] == [[-inf], [-inf]]
    assert found.document(["x"])["configurations"][0]["metrics"]["x"]["mean"] == "-Infinity"


# What is stored, and what is done again.


def test_a_metric_is_no_part_of_what_identifies_a_run():
    named = BASE.model_copy(update={"record": Recording(metrics=(half,))})
    plans = [SweepPlan.of(BASE, GRID), SweepPlan.of(named, GRID), SweepPlan.of(BASE, GRID, metrics={"half": half})]
    assert plans[0].about == plans[1].about == plans[2].about
    assert plans[0].configurations == plans[1].configurations == plans[2].configurations
    assert identify(without_metrics(named)) == identify(BASE)
    assert plans[0].metrics == ()
    assert plans[1].metrics == plans[2].metrics == (("half", Metric(half)),)


@pytest.mark.parametrize("key", ["record.metrics", "record.metrics.0"])
def test_metrics_cannot_be_swept(key):
    with pytest.raises(ScenarioError, match="cannot be swept; every run has the same metrics"):
        SweepPlan.of(BASE.model_copy(update={"record": Recording(metrics=(half,))}), {key: [[], ["a:b"]]})


@pytest.mark.slow
def test_runs_are_repeated_only_for_a_metric_that_is_asked_for_and_keep_what_they_have(tmp_path, done):
    store = tmp_path / "s.sqlite"
    first = sweep(BASE, GRID, 2, store=store, metrics={"half": half})
    assert len(done) == 4
    assert sweep(BASE, GRID, 2, store=store) == first
    assert len(done) == 4
    both = sweep(BASE, GRID, 2, store=store, metrics={"end": end_time})
    assert len(done) == 8
    assert all({"half", "end"} <= numbers.keys() for numbers in stored(store))
    more = sweep(BASE, GRID, 3, store=store, metrics={"end": end_time})
    assert len(done) == 8 + 2
    assert [group.values("half")[:2] for group in more.groups] == [group.values("half") for group in first.groups]
    assert [group.values("half")[2] for group in more.groups] == [None, None]
    assert [group.values("end") for group in both.groups] == [[0.2, 0.2], [0.2, 0.2]]
    assert both.units == {"half": "", "end": ""}


@pytest.mark.slow
def test_an_older_row_without_a_metric_is_missing_and_not_0(tmp_path):
    store = tmp_path / "s.sqlite"
    sweep(BASE, GRID, 1, store=store)
    found = sweep(BASE, {"capture.radius": [0.05, 0.2, 0.3]}, 1, seed=0, store=store)
    with Store(store) as kept:
        kept.register_metrics({"half": ("s", "1")})
        row = found.groups[2].rows[0]
        key = SweepPlan.of(BASE, {"capture.radius": [0.3]}).configurations[0].key
        kept.add(key, 0, Row(0, 0, "ok", type(row.summary)({**row.summary, "half": 0.5})))
        found = SweepResult.of(kept)
    assert [group.values("half") for group in found.groups] == [[None], [None], [0.5]]
    rows = [line.split() for line in found.table(["half"]).splitlines() if line.startswith("0.")]
    assert [row[-1] for row in rows[:3]] == ["-", "-", "-"]
    assert rows[0][-1] == "-"
    assert rows[2][-3:] == ["0.500", "+-", "-"]
    assert [estimate.count for estimate in found.estimates("half")] == [0, 0, 1]
    assert [record["half"] for record in found.records()] == [None, None, 0.5]
    assert found.to_frame()["half"].isna().tolist() == [True, True, False]


@pytest.mark.slow
def test_values_of_a_metric_whose_code_has_changed_are_removed_and_computed_anew(tmp_path, done):
    """The values of other metrics stay, and no run is repeated unless the metric is asked for."""
    store = tmp_path / "s.sqlite"
    sweep(BASE, GRID, 2, store=store, metrics={"x": lambda result: 1.0, "half": half})
    again = sweep(BASE, GRID, 2, store=store, metrics={"x": lambda result: 2.0})
    assert [group.values("x") for group in again.groups] == [[2.0, 2.0]] * 2
    assert None not in again.groups[0].values("half")
    assert len(done) == 8
    with Store(store) as kept:
        codes = units_and_codes(())
        kept.register_metrics({name: (codes[name][0], "other") for name in ("energy", "capture_time")})
    assert not any({"energy", "capture_time"} & numbers.keys() for numbers in stored(store))
    found = sweep(BASE, GRID, 2, store=store)
    assert len(done) == 12, "capture_time is in every table, and so is asked for"
    assert found.groups[0].values("energy") == again.groups[0].values("energy")


def test_the_code_of_a_built_in_metric_includes_the_functions_beside_it_that_it_calls(monkeypatch):
    def other(result):
        return 0.0

    monkeypatch.setattr(metric_code, "_source_hash", metric_code._source_hash.__wrapped__)
    monkeypatch.setattr(other, "__module__", captures.__name__)
    before = units_and_codes(())
    monkeypatch.setattr(captures, "end_time", other)
    after = units_and_codes(())
    assert [name for name in METRICS if before[name] != after[name]] == ["capture_time"]


def test_a_built_in_metric_that_is_new_is_added_to_a_store_only_if_it_is_asked_for(tmp_path, done, monkeypatch):
    store, older = tmp_path / "s.sqlite", units_and_codes(())
    older.pop("energy")
    with monkeypatch.context() as patch:
        patch.setattr(sweep_plan, "units_and_codes", lambda own: older)
        patch.setattr(module, "measured", lambda own, result: older_summary(result))
        sweep(BASE, GRID, 1, store=store)
    assert not any("energy" in numbers for numbers in stored(store))
    found = sweep(BASE, GRID, 1, store=store)
    assert len(done) == 2
    assert found.groups[0].values("energy") == [None]
    with closing(sqlite3.connect(store)) as database:
        assert database.execute("SELECT energy FROM results").fetchall() == [(None,), (None,)]
    found = sweep(BASE, GRID, 1, store=store, until=("energy", 100.0))
    assert len(done) == 4
    assert None not in found.groups[0].values("energy")


def older_summary(result):
    return Summary({name: each for name, each in summary(result).items() if name != "energy"})


@pytest.mark.slow
def test_a_metric_that_fails_is_told_with_configuration_and_seed_and_the_stored_run_is_kept(tmp_path):
    store = tmp_path / "s.sqlite"
    before = sweep(BASE, GRID, 2, store=store)
    found = sweep(BASE, GRID, 2, store=store, metrics={"wrong": of_users.wrong})
    assert [[row.status for row in group.rows] for group in found.groups] == [["error", "ok"]] * 2
    told = (
        "2 runs failed; the first, with capture.radius = 0.05, seed 0: MetricError:"
        " metric 'wrong' of 'coins' with seed 0: ValueError: not today"
    )
    assert any(line.startswith(f"{told} (") for line in found.table().splitlines())
    assert found.groups[0].values("wrong") == [1.0]
    again = sweep(BASE, GRID, 2, store=store)
    assert [group.values("active_time") for group in again.groups] == [
        group.values("active_time") for group in before.groups
    ]
    assert [group.values("wrong") for group in again.groups] == [[None, 1.0]] * 2
    with pytest.raises(RunError, match=r"capture\.radius = 0\.05 with seed 0 failed(?s:.*)metric 'wrong'"):
        sweep(BASE, GRID, 2, store=store, metrics={"wrong": of_users.wrong}, fail_fast=True)


@pytest.mark.parametrize("show", ["table", "document", "estimates", "differences"])
def test_a_metric_that_the_sweep_lacks_is_refused_but_not_one_that_fails_in_every_run(show):
    found = sweep(BASE, GRID, 1, metrics={"wrong": of_users.wrong})
    listed = show in {"table", "document"}
    assert found.failed == [row for group in found.groups for row in group.rows]
    getattr(found, show)(["wrong"] if listed else "wrong")
    with pytest.raises(ValueError, match="there is no numeric metric 'wrng', did you mean 'wrong'"):
        getattr(found, show)(["wrng"] if listed else "wrng")


@pytest.mark.slow
@pytest.mark.usefixtures("looks")
def test_a_metric_that_fails_in_a_stored_run_does_not_end_a_sweep_before_its_precision(tmp_path):
    """Run 2 is stored without the metric and fails when it is repeated: as many runs as without a store."""

    def fragile(result):
        if result.seed == BASE.seed + 2:
            raise ZeroDivisionError
        return float(result.seed % 7)

    target, given = ("fragile", 1.0), {"fragile": fragile}
    (whole,) = sweep(BASE, {"capture.radius": [0.2]}, 50, until=target, metrics=given).groups
    store = tmp_path / "s.sqlite"
    sweep(BASE, {"capture.radius": [0.2]}, 4, store=store)
    (group,) = sweep(BASE, {"capture.radius": [0.2]}, 50, store=store, until=target, metrics=given).groups
    assert 10 < len(group.rows) == len(whole.rows) < 50


@pytest.mark.slow
def test_a_precision_of_a_metric_takes_as_many_runs_whether_or_not_there_are_runs_without_it(tmp_path, looks):
    grid, target = {"capture.radius": [0.2]}, ("half", 0.0145)
    (whole,) = sweep(BASE, grid, 60, until=target, metrics={"half": half}).groups
    assert 10 < len(whole.rows) < 60
    assert len(whole.rows) == looks(whole.values("half"), 0.0145, at_most=60)
    sweep(BASE, grid, 12, store=tmp_path / "s.sqlite")
    (group,) = sweep(BASE, grid, 60, store=tmp_path / "s.sqlite", until=target, metrics={"half": half}).groups
    assert [each for each in group.values("half") if each is not None] == whole.values("half")


@pytest.mark.parametrize("name", ["active_time", "a b", "status"])
def test_a_name_that_is_taken_or_no_identifier_is_refused_before_anything_is_written(tmp_path, name):
    with pytest.raises(ValueError, match=f"metric.*{name}"):
        sweep(BASE, GRID, 1, store=tmp_path / "s.sqlite", metrics={name: half})
    assert not (tmp_path / "s.sqlite").exists()


def test_of_two_commands_with_different_code_of_a_metric_only_the_later_adds_runs(tmp_path):
    plans = [SweepPlan.of(BASE, GRID, metrics={"x": of}) for of in (lambda result: 1.0, lambda result: 2.0)]
    row = Row(0, 0, "ok", Summary({"x": 1.0}))
    with Store(tmp_path / "s.sqlite") as first, Store(tmp_path / "s.sqlite") as second:
        for plan, store in zip(plans, (first, second), strict=True):
            plan.register(store)
        with pytest.raises(StoreError, match="another command computes the metric x by other code"):
            first.add(plans[0].configurations[0].key, 0, row)
        assert len(first) == 0
        second.add(plans[1].configurations[0].key, 0, row)


def test_a_merge_that_is_refused_leaves_the_versions_of_the_store_as_they_are():
    with Store() as store, Store() as other:
        for each, version, code in ((store, "3.12", "a"), (other, "3.13", "b")):
            each.record_versions([{"python": version}], "this is", mix=False)
            each.register_metrics({"half": ("s", code)})
        with pytest.raises(StoreError, match="the metric half was computed by other code"):
            store.merge(other, mix_versions=True)
        assert store.versions == [{"python": "3.12"}]


@pytest.mark.slow
def test_stores_are_merged_with_the_metrics_of_both_unless_their_code_differs(tmp_path):
    one, other, third = (tmp_path / f"{name}.sqlite" for name in ("one", "other", "third"))
    sweep(BASE, GRID, 2, store=one, metrics={"half": half})
    sweep(BASE, GRID, 2, store=other, metrics={"end": end_time})
    sweep(BASE, GRID, 2, store=third, metrics={"half": lambda result: 0.0})
    with Store(tmp_path / "all.sqlite") as merged, Store(one) as first, Store(other) as second, Store(third) as last:
        for each in (first, second, first):
            merged.merge(each)
        result = SweepResult.of(merged)
        with pytest.raises(StoreError, match=f"the metric half was computed by other code in {third}"):
            merged.merge(last)
    assert result == sweep(BASE, GRID, 2, metrics={"half": half, "end": end_time})


# Explanations and reports.


def test_an_explanation_is_in_any_metrics_with_their_units():
    late = BASE.model_copy(update={"network": BASE.network.model_copy(update={"range": 1.0})})
    found = explain(late, 2, metrics={"half": Metric(half, "s")}, shown=["half", "active_time", "capture_time"])
    assert list(found.costs) == ["half", "active_time", "capture_time"]
    cost, twice = found.costs["half"], found.costs["active_time"]
    assert 2.0 * cost.as_it_is.mean == pytest.approx(twice.as_it_is.mean)
    assert found.costs["capture_time"].as_it_is.count == 0
    assert found.rows()[0] == ("", "half, s", "sum of active times, s", "capture time, s")
    assert {row[3] for row in found.rows()[1:]} == {"-"}
    assert type(found).of(json.loads(json.dumps(found.document()))).rows() == found.rows()
    with pytest.raises(ValueError, match="there is no numeric metric 'haf', did you mean 'half'"):
        explain(late, 2, metrics={"half": half}, shown=["haf"])


@pytest.mark.whole
def test_a_report_shows_a_metric_in_its_tables_and_as_a_panel(tmp_path):
    sweep(BASE, RANGES, 2, store=tmp_path / "sweep.sqlite", metrics={"half": Metric(half, "furlongs")})
    elements = Elements(report(Study.read(tmp_path)))
    assert sum("half, furlongs" in row for row in elements.rows) == 4  # means, and differences from each reference
    assert any("half (furlongs)" in each for each in elements.texts)


# The commands.

FILE = """\
name = "mine"
horizon = 0.2
team.count = 3
network.range = 9.0
[record]
metrics = ["mine_of_commands:gap"]
[sweep]
reps = 2
[sweep.grid]
"network.latency.value" = [0.0, 0.1]
"""
MODULE = """\
from desim.analysis.metrics import Metric, active_time


def gap(result):
    return active_time(result) - 0.25


twice = Metric(lambda result: 2.0 * gap(result), "s", "twice the gap")
energy = gap
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("desim.results.run_folder.can_plot", lambda: False)
    (tmp_path / "mine_of_commands.py").write_text(MODULE)
    (tmp_path / "mine.toml").write_text(FILE)
    return tmp_path / "mine.toml"


TRUSTED = "--allow-import"
TWICE = ("--metric", "mine_of_commands:twice")


@pytest.mark.slow
def test_a_run_shows_metrics_of_its_file_and_of_the_command_line(file):
    shown = accepted("run", file, TRUSTED, *TWICE, "--metric", "excess_time").stdout
    lines = {line.split("  ")[0]: line.split() for line in shown.splitlines()}
    assert 2.0 * float(lines["gap"][1]) == pytest.approx(float(lines["twice"][1]), abs=2e-3)
    assert lines["twice"][2:] == ["s", "twice", "the", "gap"]
    assert "excess time" in lines
    (numbers,) = json.loads(accepted("run", file, TRUSTED, *TWICE, "--json").stdout)["runs"]
    assert numbers["twice"] == 2.0 * numbers["gap"] == 2.0 * (numbers["active_time"] - 0.25)
    assert "twice, s" in accepted("run", file, TRUSTED, *TWICE, "-n", 2).stdout


@pytest.mark.slow
def test_a_run_in_a_folder_has_its_metrics_and_so_has_its_repetition(file, tmp_path):
    accepted("run", file, TRUSTED, *TWICE, "-o", tmp_path / "out")
    numbers = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert numbers["twice"] == 2.0 * numbers["gap"]
    accepted("run", "--from", tmp_path / "out" / "run.json", TRUSTED, "-o", tmp_path / "again")
    assert (tmp_path / "again" / "summary.json").read_bytes() == (tmp_path / "out" / "summary.json").read_bytes()
    assert "names code to be run" in refused("run", "--from", tmp_path / "out" / "run.json")


@pytest.mark.parametrize("command", ["run", "sweep", "explain"])
def test_a_file_and_an_option_that_name_code_are_refused_without_trust(file, tmp_path, command):
    assert f"{file}:6: record.metrics.0: 'mine_of_commands:gap' names code to be run" in refused(command, file)
    (tmp_path / "plain.toml").write_text(FILE.replace('"mine_of_commands:gap"', ""))
    said = refused(command, tmp_path / "plain.toml", *TWICE)
    assert said.startswith("--metric mine_of_commands:twice: record.metrics.0: 'mine_of_commands:twice' names code")
    assert "mine_of_commands" not in sys.modules
    assert not (tmp_path / "out").exists()


def test_an_installed_metric_is_measured_without_trust_and_is_among_those_that_are_suggested(file, monkeypatch):
    point = SimpleNamespace(name="half", value="x:half", module="tests.analysis.of_users", attr="half")
    monkeypatch.setattr(named_metrics, "entry_points", lambda group: [point] if group == "desim.metrics" else [])
    file.write_text(FILE.replace('"mine_of_commands:gap"', ""))
    (numbers,) = json.loads(accepted("run", file, "--metric", "half", "--json").stdout)["runs"]
    assert numbers["half"] == numbers["active_time"] / 2.0
    assert accepted("metrics").stdout.splitlines()[-1] == "half: x:half"
    assert refused("run", file, "--metric", "haf").startswith("--metric haf: there is no numeric metric 'haf', did you")


def test_metrics_of_a_wrong_type_are_refused_also_with_metrics_of_the_command_line(file):
    file.write_text(FILE.replace('["mine_of_commands:gap"]', "3"))
    assert refused("run", file, TRUSTED, *TWICE).startswith(f"{file}:6: record.metrics: ")


@pytest.mark.parametrize("command", ["run", "sweep", "explain"])
def test_a_name_of_a_built_in_metric_is_refused_with_file_line_and_key(file, command):
    file.write_text(FILE.replace(":gap", ":energy").replace("energy", "active_time"))
    (file.parent / "mine_of_commands.py").write_text(MODULE.replace("energy", "active_time"))
    assert refused(command, file, TRUSTED).startswith(
        f"{file}:6: record.metrics.0: metric 'active_time' should have another name: there is a built-in metric"
    )


@pytest.mark.parametrize(
    ("in_file", "option", "where"),
    [("none", "twice", "FILE:6: record.metrics.0"), ("energy", "twice", "FILE:6: record.metrics.0"),
     ("gap", "none", "--metric mine_of_commands:none: record.metrics.1"),
     ("gap", "energy", "--metric mine_of_commands:energy: record.metrics.1")],
)  # fmt: skip
def test_a_fault_of_a_metric_is_told_where_the_metric_is_named(file, in_file, option, where):
    file.write_text(FILE.replace(":gap", f":{in_file}"))
    said = refused("run", file, TRUSTED, "--metric", f"mine_of_commands:{option}")
    assert said.startswith(where.replace("FILE", str(file)))


@pytest.mark.slow
def test_a_sweep_shows_measures_and_stores_them(file, tmp_path):
    shown = accepted("sweep", file, TRUSTED, "-o", "out").stdout
    assert shown.splitlines()[1].endswith("gap")
    assert "\n0 runs in " in accepted("sweep", file, TRUSTED, "-o", "out").stderr
    made = accepted("sweep", file, TRUSTED, *TWICE, "-o", "out")
    assert made.stdout.splitlines()[1].split()[-2:] == ["twice,", "s"]
    assert re.search(r"\n4 runs in .*, 4 already stored", made.stderr)
    dry = accepted("sweep", file, TRUSTED, *TWICE, "-o", "out", "--dry-run").stdout
    assert dry.startswith("mine: 2 configurations, 4 runs; 4 stored, 0 to do")
    accepted("export", "out", "x.csv")
    with Path("x.csv").open() as rows:
        assert all(float(row["twice"]) == 2.0 * float(row["gap"]) for row in csv.DictReader(rows))
    record = json.loads(Path("out/run.json").read_text())["scenario"]["record"]
    assert record["metrics"] == ["mine_of_commands:gap", "mine_of_commands:twice"]


@pytest.mark.whole
@pytest.mark.usefixtures("looks")
def test_a_sweep_ends_at_the_precision_of_a_metric_which_has_to_be_there(file):
    accepted("sweep", file, TRUSTED, "--until", "gap:100", "-o", "out")
    assert len(stored("out/sweep.sqlite")) == 20
    said = refused("sweep", file, TRUSTED, "--until", "gab:100", "-o", "out")
    assert "there is no numeric metric 'gab', did you mean 'gap'?" in said
    for name in ("gap", "twice"):
        shown = accepted("sweep", file, TRUSTED, "--until", f"mine_of_commands:{name}:100", "-o", name).stdout
        assert name in shown.splitlines()[1]
        assert len(stored(f"{name}/sweep.sqlite")) == 20
    said = refused("sweep", file, TRUSTED, "--until", "mine_of_commands:none:100")
    assert said.startswith("--metric mine_of_commands:none: record.metrics.1: ")


@pytest.mark.whole
def test_an_explanation_is_in_the_metrics_of_the_command(file):
    rows = accepted("explain", file, TRUSTED, "-n", 2, *TWICE, "--metric", "energy").stdout.splitlines()
    assert rows[1].split() == ["twice,", "s", "energy,", "(m/s)^p", "s"]
    rows = accepted("explain", file, TRUSTED, "-n", 2).stdout.splitlines()
    assert re.search("capture time, or horizon, s +gap$", rows[1])


def test_the_command_lists_all_metrics(monkeypatch):
    lines = accepted("metrics").stdout.splitlines()
    assert [line.partition(":")[0].partition(",")[0] for line in lines] == list(METRICS)
    assert "active_time, s: The active time summed over the pursuers" in lines[9]
    assert lines[9].endswith("s. More is worse.")
    assert lines[list(METRICS).index("captures")].endswith("evaders. More is better.")
    assert lines[0] == "seed: Seed of the run."
    assert all(": " in line for line in lines)


ENTRY = '''    hasty: float = entry(lambda result: 1.0 / (1.0 + end_time(result)), "1/s", "made up")
    """Made up, for a test."""
'''


SAYS = """\
import shlex, sys
from desim.cli import main

for words in sys.argv[1:]:
    print("\\f")
    assert not main(shlex.split(words), standalone_mode=False)
"""


@pytest.mark.whole
def test_a_metric_is_added_to_the_repository_in_one_place(tmp_path):
    """And a store that was made before has it as soon as it is asked for."""
    for package in ("desim", "protocols"):
        shutil.copytree(ROOT / package, tmp_path / package)  # with the bytecode
    (tmp_path / "x.toml").write_text(FILE.replace('metrics = ["mine_of_commands:gap"]', ""))

    def said(*commands):
        """Run commands in one process, and return the output of each."""
        made = subprocess.run(
            [sys.executable, "-c", SAYS, *commands],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            env=os.environ | {"PYTHONPATH": str(tmp_path)},
        )
        assert made.returncode == 0, made.stderr
        return made.stdout.split("\f\n")[1:]

    sweeping = "sweep x.toml -o out -j 1"
    (before,) = said(sweeping)
    list_of_all = tmp_path / "desim" / "analysis" / "metrics.py"
    text = list_of_all.read_text()
    list_of_all.write_text(text.replace("    energy: float = ", f"{ENTRY}    energy: float = "))
    listed, run, document, again, shown, _ = said(
        *("metrics", "run x.toml", "run x.toml --json", sweeping, f"{sweeping} --metric hasty", "export out x.csv")
    )
    assert "hasty, 1/s: Made up" in listed
    assert "hasty " in run
    assert "0.833" in document
    assert again == before
    assert "hasty, 1/s" in shown
    assert "hasty" in stored(tmp_path / "out" / "sweep.sqlite")[0]
    assert "hasty" in (tmp_path / "x.csv").read_text().splitlines()[0]


def test_a_metric_that_is_given_twice_is_shown_once():
    assert shown_metrics(Scenario(), ("active_time", "m:late", "active_time")) == ("active_time", "late")
