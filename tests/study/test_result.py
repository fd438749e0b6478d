"""What came of a sweep: tables, frames, files and documents, also of runs that failed, of one run, and of none."""

import csv
import html
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from math import inf, nan

import numpy as np
import pandas as pd
import pytest

from desim.analysis.measuring import summary
from desim.analysis.metrics import METRICS
from desim.analysis.statistics import Estimate, estimate, paired, wilson
from desim.scenario.players import Team
from desim.scenario.scenario import Scenario
from desim.simulation.run import run
from desim.study.plan.metric_code import units_and_codes
from desim.study.results.result import SweepResult
from desim.study.results.runs import SHOWN, Group, in_numeric_order, text
from desim.study.store.file import StoreError
from desim.study.store.run_table import Row
from desim.study.store.store import Store
from tests.command import strict_json
from tests.study.by_hand import row as row_of
from tests.summaries import changed

RUN = summary(run(Scenario(horizon=0.05, team=Team(count=2))))
TRACE = 'Traceback (most recent call last):\n  File "x.py", line 1\nValueError: no <b> today\n'


def ok(replication, **numbers):
    return Row(replication, 10 + replication, "ok", changed(RUN, seed=10 + replication, **numbers))


def failed(replication, status="error"):
    return Row(replication, 10 + replication, status, None, TRACE)


def group(settings, *rows):
    return Group(settings, rows)


# Two configurations of three runs: the evader gets away in the second run of the second.
PLAIN = SweepResult(
    "a <b> & c",
    ("network.range",),
    (
        group(
            {"network.range": 4.0},
            ok(0, captured=True, capture_time=1.0, active_time=1.0, messages_sent=1000),
            ok(1, captured=True, capture_time=2.0, active_time=2.0, messages_sent=1000),
            ok(2, captured=True, capture_time=3.0, active_time=3.0, messages_sent=1000),
        ),
        group(
            {"network.range": inf},
            ok(0, captured=True, capture_time=2.5, active_time=2.5, messages_sent=3000),
            ok(1, captured=False, capture_time=None, active_time=3.0, messages_sent=3000),
            ok(2, captured=True, capture_time=4.5, active_time=4.5, messages_sent=3000),
        ),
    ),
)
FAILING = SweepResult(
    "failing",
    ("protocol", "team.speeds"),
    (
        group({"protocol": "sap", "team.speeds": 1.5}, ok(0, active_time=1.0), failed(1), ok(2, active_time=3.0)),
        group({"protocol": "<lambda>", "team.speeds": "[1, 2]"}, ok(0, active_time=2.0), ok(1), failed(2, "crashed")),
    ),
)
ALL_FAILED = SweepResult("bad", ("x",), (group({"x": 1}, failed(0), failed(1)), group({"x": 2}, failed(0), failed(1))))
ONE_RUN = SweepResult("one", ("x",), (group({"x": True}, ok(0, captured=False, capture_time=None)),))
NOTHING = SweepResult("empty", ("x",), (group({"x": 1}), group({"x": 2})))
ALL = {"plain": PLAIN, "failing": FAILING, "all failed": ALL_FAILED, "one run": ONE_RUN, "nothing": NOTHING}
every = pytest.mark.parametrize("result", ALL.values(), ids=ALL)


# Means and differences.


def test_the_mean_of_a_metric_is_that_over_the_runs_in_which_it_exists():
    assert PLAIN.estimates("capture_time") == [estimate([1.0, 2.0, 3.0]), estimate([2.5, 4.5])]
    assert FAILING.estimates("active_time")[0] == estimate([1.0, 3.0])


def test_differences_are_paired_by_seed_and_leave_out_what_one_lacks():
    """2.5 - 1 and 4.5 - 3: both 1.5, so that the interval has no width."""
    assert PLAIN.differences("capture_time") == [paired([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]), Estimate(1.5, 0.0, 2)]
    assert PLAIN.differences("active_time")[1] == paired([2.5, 3.0, 4.5], [1.0, 2.0, 3.0])
    assert PLAIN.differences("capture_time", reference=1)[0].mean == -1.5


def of_grid(times, **given):
    """Return a sweep over x and network.y with one run per active time, s: a list for each pair of values."""
    groups = [
        group({"x": x, "network.y": y}, *(ok(k, active_time=time, captured=True) for k, time in enumerate(each)))
        for (x, y), each in times.items()
    ]
    return SweepResult("grid", ("x", "network.y"), tuple(groups), **given)


ON_X = {(0, 0): [1.0, 2.0], (0, 1): [1.0, 2.0], (1, 0): [1.5, 2.0], (1, 1): [1.5, 2.0]}


def test_a_key_on_which_no_run_depends_is_warned_of_by_name():
    """Of four configurations with two runs each, two pairs of configurations differ in network.y only."""
    found = of_grid(ON_X)
    (said,) = found.warnings()
    assert said == (
        "nothing shown (captured, active time, capture time, messages sent) depends on network.y: equal in 4 pairs of"
        " runs that differ in it only; a protocol may need no messages if all know the initial actions"
        " (`announce.start`) and see all positions (`announce.payload`), or if few pursuers could capture the"
        " evader in time"
    )
    assert found.table().endswith(f"\n\nwarning: {said}")
    assert html.escape(said) in found._repr_html_()
    assert found.document()["warnings"] == [said]
    assert [each.split(":")[0] for each in found.warnings("messages_sent")] == [
        f"nothing shown (captured, messages sent) depends on {key}" for key in ("x", "network.y")
    ]


@pytest.mark.slow
def test_a_key_without_effect_with_one_value_of_another_is_warned_of_with_that_value():
    """As a protocol that needs no messages, beside one that does."""
    (said,) = of_grid(ON_X | {(1, 1): [1.5, 2.5]}).warnings("active_time")
    assert said.startswith(
        "with x = 0, nothing shown (captured, active time) depends on network.y: equal in 2 pairs of"
    )


@pytest.mark.parametrize(
    "times",
    [
        pytest.param(ON_X | {(k, 1): [1.0 + k / 2, 2.0000000000000004] for k in (0, 1)}, id="the last bit of one run"),
        pytest.param({(0, 0): [1.0], (1, 0): [2.0]}, id="a key with one value"),
        pytest.param({(0, 0): [1.0], (1, 1): [1.0]}, id="no two that differ in one key only"),
        pytest.param({(0, 0): [], (0, 1): []}, id="no runs"),
    ],
)
def test_a_key_on_which_a_run_depends_or_that_is_not_varied_is_not_warned_of(times):
    assert of_grid(times).warnings() == []


def test_of_independent_seeds_failed_runs_and_captures_there_is_no_such_warning():
    assert of_grid(ON_X, common=False).warnings() == []
    first, second, *others = of_grid(ON_X).groups
    for row, left in ((failed(1), []), (ok(1, active_time=2.0, captured=False), ["with x = 1"])):
        changed = replace(second, rows=(second.rows[0], row))
        found = replace(PLAIN, keys=("x", "network.y"), groups=(first, changed, *others)).warnings()
        assert [each.split(",")[0] for each in found] == left


def test_a_sweep_without_a_capture_says_that_the_horizon_may_be_too_short():
    """The longest run counts; of metrics that need no capture, and with one capture, there is no such warning."""
    rows = [ok(k, captured=False, capture_time=None, end_time=0.5 - k / 10, active_time=float(k)) for k in (0, 1)]
    late = SweepResult("late", ("x",), (group({"x": 0}, *rows), group({"x": 1}, *rows[::-1], failed(2))))
    (sentence,) = late.warnings()
    assert sentence.startswith("no run ended by a capture, the longest after 0.5 s, ")
    assert late.table().endswith(f"\nwarning: {sentence}")
    assert late.warnings(["active_time"]) == []
    caught = replace(late, groups=(late.groups[0], group({"x": 1}, ok(0, captured=True), failed(1))))
    assert caught.warnings() == []
    assert SweepResult("none", (), ()).warnings() == []


def test_means_over_different_numbers_of_runs_are_not_for_comparison():
    """With a difference beside them they contradict it; configurations of equally many runs have no such note."""
    first, second = PLAIN.groups
    uneven = replace(PLAIN, groups=(first, replace(second, rows=second.rows[:2])))
    note = "the means are over 2 to 3 runs, and so over different seeds: compare configurations by their differences"
    assert note in uneven.table()
    assert note in uneven._repr_html_()
    assert "over different seeds" not in PLAIN.table() + replace(uneven, common=False).table()
    failing = replace(PLAIN, groups=(first, replace(second, rows=(*second.rows[:2], failed(2)))))
    assert note in failing.table(), "a run that failed is in no mean, and slow runs may fail"


@pytest.mark.slow
def test_the_share_of_truth_values_has_the_interval_of_wilson():
    """Two of three, and all: the t interval of the first is from -0.77 to 2.1."""
    first, second = PLAIN.estimates("captured")
    assert (first.others, second.interval) == (wilson(0, 3)[1], wilson(2, 3))
    assert "0.667 (0.208 .. 0.939)" in PLAIN.table(["captured"])
    (bars,) = PLAIN.plot("captured").axes[0].collections
    ends = [sorted(float(y) for _, y in segment) for segment in bars.get_segments()]
    assert ends == [pytest.approx(wilson(3, 3)), pytest.approx(wilson(2, 3))]


def test_means_over_runs_with_a_value_are_not_those_of_all_runs():
    """Two of three runs with a capture look as fast as three: a note, unless each configuration has as many."""
    note = (
        "capture time has a value in 66.7% to 100.0% of the runs, so its means are over different, perhaps easier ones"
    )
    assert f"{note}: end time counts the horizon" in PLAIN.table(["capture_time"])
    assert "has a value" not in PLAIN.table(["active_time"])
    assert "has a value" not in replace(PLAIN, groups=PLAIN.groups[1:]).table(["capture_time"])


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (1e6, "1e+06"),
        (1000001.0, "1000001"),
        (-1234567.0, "-1234567"),
        (0.1 + 0.2, "0.3"),
        (0.12345678, "0.123457"),
        (1e300, "1e+300"),
        (1.5e300 / 7.0, "2.14286e+299"),
        (inf, "inf"),
        (True, "true"),
        (1000001, "1000001"),
    ],
)
def test_a_setting_as_text_has_six_digits_or_all_those_of_a_whole_number(value, expected):
    assert text(value) == expected


def test_a_table_has_labels_and_leaves_out_columns():
    """Keys, values, metrics and heads may have a label; numbers of runs are no values of a key."""
    labels = {"network.range": "range (m)", "inf": "unlimited", "active_time": "chase", "pairs": "n"}
    table = PLAIN.table(["active_time"], labels=labels, without=["captured"], format="markdown")
    heads = [line for line in table.splitlines() if line.startswith("| range")]
    assert heads == ["| range (m) | runs | chase |", "| range (m) | n | chase |"]
    assert "| unlimited | 3 | 3.333 ± 2.586 |" in table
    assert "captured" not in table
    assert r"$\infty$ & 3 &" in PLAIN.table(["active_time"], without=["captured"], format="latex").replace("$3$", "3")
    assert "four  " in PLAIN.table(labels={"4.00": "four"})
    for without, columns in ((["captured"], "lrr"), (["captured", "network.range"], "rr")):  # keys are to the left
        assert f"{{{columns}}}" in PLAIN.table(["active_time"], without=without, format="latex")
    for options, message in (
        ({"labels": {"rnage": "x"}}, "no key takes the value rnage"),
        ({"without": ["capture"]}, "no table has a column capture: they have "),
    ):
        with pytest.raises(ValueError, match=message):
            PLAIN.table(**options)
    with pytest.raises(ValueError, match="are those of tables"):
        PLAIN.write("runs.csv", without=["captured"])


def test_the_configurations_of_several_grids_are_in_numeric_order():
    """Numbers ascend, inf last; a key with any other value keeps the order in which its values came."""
    settings = [
        {"protocol": name, "network.range": reach, "mixed": mixed}
        for name, reach, mixed in (
            ("sap", inf, 2),
            ("sap", 9, "a"),
            ("cbba", 10.5, 2),
            ("sap", 9, 2),
            ("cbba", -1.0, 2),
        )
    ]
    ordered = in_numeric_order(tuple(settings[0]), [Group(values, ()) for values in settings])
    assert [tuple(entry.settings.values()) for entry in ordered] == [
        ("sap", 9, 2),
        ("sap", 9, "a"),
        ("sap", inf, 2),
        ("cbba", -1.0, 2),
        ("cbba", 10.5, 2),
    ]


def test_runs_are_paired_by_number_not_by_place():
    """The first lacks run 1, the second run 2: only run 0 is a pair, 2 - 1."""
    found = FAILING.differences("active_time", reference=0)[1]
    assert (found.mean, found.count) == (1.0, 1)


def test_of_several_keys_all_but_one_are_equal_where_configurations_are_compared():
    """By the first key that has several values; with another team, or another range, none is compared."""
    groups = [
        group({"team.count": 5, "x": x, "y": y}, ok(0, active_time=base + gain), ok(1, active_time=2 * base + gain))
        for x, gain in ((0.0, 0.0), (1.0, 0.5))
        for y, base in ((1, 10.0), (2, 100.0))
    ]
    grid = SweepResult("grid", ("team.count", "x", "y"), tuple(groups))
    assert [found.mean for found in grid.differences("active_time")] == [0.0, 0.0, 0.5, 0.5]
    _, (title, rows) = grid.tables("active_time")
    assert title.startswith("difference from x = 0, all else equal, ")
    assert rows[1:] == [("5", "1", y, "2", "+0.500 in all, others < 65.8%") for y in ("1", "2")]


@pytest.mark.parametrize("result", [ALL_FAILED, NOTHING], ids=["all failed", "nothing"])
def test_an_unmeasured_metric_has_no_mean(result):
    for found in (*result.estimates("active_time"), *result.differences("active_time")):
        assert found.count == 0
        assert found.mean != found.mean


# The table.


def test_the_table_shows_means_intervals_and_differences():
    """Half widths: t of 2 degrees 4.303 x 1/sqrt(3) = 2.484; of 1 degree 12.706 x 1 = 12.706, of 2.5 and 4.5."""
    head, rest = PLAIN.table().split("\n", 1)
    assert head.startswith(
        "a <b> & c: 2 configurations, 6 runs; +- is half a 95 % t interval, in brackets a Wilson interval"
    )
    assert head.endswith("; (n): defined in n runs only")
    assert rest == (
        "network.range  runs                  captured  active time, s      capture time, s       "
        "            messages sent\n"
        "4                 3  100.0% (43.9% .. 100.0%)  2.000 +- 2.484       2.000 +- 2.484"
        "  1,000.0 in all, others < 56.1%\n"
        "inf               3    66.7% (20.8% .. 93.9%)  3.333 +- 2.586  3.500 +- 12.706 (2)"
        "  3,000.0 in all, others < 56.1%\n"
        "\n"
        "difference from network.range = 4, run by run with the same seed\n"
        "network.range  pairs   active time, s                    capture time, s                    messages sent\n"
        "inf                3  +1.333 +- 0.717  +1.500 in all, others < 65.8% (2)  +2,000.0 in all, others < 56.1%\n"
        "\n"
        "capture time has a value in 66.7% to 100.0% of the runs, so its means are over different, perhaps easier ones:"
        " end time counts the horizon"
    )
    assert str(PLAIN) == PLAIN.table()


def test_the_table_shows_the_metrics_that_are_named():
    head = PLAIN.table(["energy"]).splitlines()[1].split()
    assert head == ["network.range", "runs", "captured", "energy,", "(m/s)^p", "s"]
    assert "(n)" not in PLAIN.table(["energy"])


def test_a_setting_is_selected_by_its_value_its_text_or_its_kind_if_only_one_is_of_it():
    values = ["sap(tau=1)", "cbba", "cbba(schedule=poisson)", "cbaa(a=1)", "cbaa(a=2)", True, 0.5]
    result = SweepResult("x", ("protocol",), tuple(group({"protocol": value}, ok(0)) for value in values))
    chosen = {value: result.setting("protocol", value) for value in [*values, "sap", "true", "0.50", "5e-1"]}
    said = {"sap": "sap(tau=1)", "true": True, "0.50": 0.5, "5e-1": 0.5}
    assert chosen == {value: value for value in values} | said
    with pytest.raises(ValueError, match="protocol has several values of the kind cbaa: it takes"):
        result.setting("protocol", "cbaa")
    with pytest.raises(ValueError, match="protocol does not take the value server: it takes"):
        result.setting("protocol", "server")


def test_failed_runs_are_counted_and_the_first_is_reported():
    lines = FAILING.table().splitlines()
    assert lines[1].split()[:4] == ["protocol", "team.speeds", "runs", "failed"]
    assert [line.split("  ")[0] for line in lines[2:4]] == ["sap", "<lambda>"]
    assert re.search(r"1\.5 +3 +1 ", lines[2])
    first = "protocol = sap, team.speeds = 1.5, seed 11: ValueError: no <b> today (x.py:1)"
    assert f"2 runs failed; the first, with {first}" in lines


def test_a_single_run_has_no_interval():
    (row,) = [line for line in ONE_RUN.table().splitlines() if line.startswith("true")]
    assert re.search(r"\d \+- -", row)
    assert "difference" not in ONE_RUN.table()
    assert "1 configuration, 1 run;" in ONE_RUN.table()
    assert "(n)" not in ONE_RUN.table()


@pytest.mark.parametrize("result", [ALL_FAILED, NOTHING], ids=["all failed", "nothing"])
def test_an_unmeasured_metric_is_a_dash(result):
    rows = [line.split() for line in result.table().splitlines() if re.match(r"[12] ", line)]
    assert {row[-1] for row in rows} == {"-"}
    assert not re.search("nan", result.table())


@every
def test_the_repr_summarises_the_contents(result):
    assert re.fullmatch(rf"<SweepResult of {re.escape(result.name)}: .* runs?, over .*>", repr(result))


# The table of a notebook.


class Reader(HTMLParser):
    """Reads the tables of a document, and sees that every element is closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tables, self.texts = [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in {"td", "th"}:
            self.tables[-1][-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, text):
        self.texts.append(text)
        if self.open[-1] in {"td", "th"}:
            self.tables[-1][-1][-1] += text


@every
def test_a_notebook_shows_the_cells_of_the_table_and_nothing_in_them_is_markup(result):
    read = Reader(result._repr_html_())
    configurations = [cell.replace("±", "+-") for table in read.tables for row in table for cell in row]
    text = " ".join(result.table().split())
    assert " ".join(" ".join(configurations).split()) in re.sub(r" difference .*? same seed ", " ", text)
    assert {len(row) for row in read.tables[0]} == {len(read.tables[0][0])}
    assert len(read.tables) == (1 if result is ONE_RUN else 2)


def test_markup_is_escaped_in_a_notebook():
    assert "a &lt;b&gt; &amp; c" in PLAIN._repr_html_()
    assert "&lt;lambda&gt;" in FAILING._repr_html_()
    assert "no &lt;b&gt; today" in FAILING._repr_html_()
    assert "<b>" not in PLAIN._repr_html_() + FAILING._repr_html_()
    assert html.unescape(PLAIN._repr_html_()).count("±") > 4


# JSON.


@every
def test_a_document_is_json_without_nan(result):
    made = strict_json(json.dumps(result.document(), allow_nan=False))
    assert len(made["configurations"]) == len(result.groups)


def test_a_document_has_the_contents_of_the_table():
    made = strict_json(json.dumps(PLAIN.document(), allow_nan=False))
    first, second = made["configurations"]
    assert (made["name"], made["grid"]) == ("a <b> & c", ["network.range"])
    assert second["settings"] == {"network.range": "Infinity"}
    assert (second["runs"], second["failed"]) == (3, 0)
    assert second["captured"] == {"share": 2 / 3, "interval": list(wilson(2, 3))}
    assert set(second["metrics"]) == set(SHOWN)
    assert second["metrics"]["capture_time"] == {
        "mean": 3.5,
        "half_width": estimate([2.5, 4.5]).half_width,
        "runs": 2,
    }
    assert second["difference"]["capture_time"] == {"mean": 1.5, "half_width": 0.0, "runs": 2}
    assert first["difference"]["active_time"] == {"mean": 0.0, "half_width": 0.0, "runs": 3}


def test_a_document_has_null_for_what_there_is_not():
    first = ALL_FAILED.document()["configurations"][0]
    assert first["captured"] == {"share": None, "interval": None}
    assert first["metrics"]["active_time"] == {"mean": None, "half_width": None, "runs": 0}
    assert (first["runs"], first["failed"]) == (2, 2)
    (one,) = ONE_RUN.document()["configurations"]
    assert one["metrics"]["active_time"]["half_width"] is None
    assert one["metrics"]["active_time"]["mean"] == RUN.active_time


# Frames and files.


def test_a_record_is_a_run():
    records = list(FAILING.records())
    assert list(records[0]) == [
        "protocol",
        "team.speeds",
        "replication",
        "status",
        "seed",
        *(name for name in METRICS if name != "seed"),
        "error",
    ]
    assert {tuple(each) for each in records} == {tuple(records[0])}
    assert [(each["seed"], each["status"], each["error"]) for each in records[:2]] == [
        (10, "ok", ""),
        (11, "error", "ValueError: no <b> today"),
    ]
    assert records[1]["active_time"] is None
    assert json.loads(records[0]["messages_lost_by"]) == RUN.messages_lost_by


PACK = {"captures": 2, "mean_capture_time": 1.5, "capture_times": {"2": 1.0, "1": 2.0}, "capturers": {"2": 0, "1": 0}}


@pytest.mark.slow
def test_records_have_the_captures_of_each_evader(tmp_path):
    some = SweepResult("some", ("x",), (group({"x": 1}, ok(0), failed(1)), group({"x": 2}, ok(0, **PACK), ok(1))))
    records = list(some.records())
    assert {tuple(each) for each in records} == {("x", "replication", "status", *METRICS, "error")}
    assert [each["captures"] for each in records] == [0, None, 2, 0]
    assert json.loads(records[2]["capture_times"]) == PACK["capture_times"]
    some.write(tmp_path / "x.csv")
    with (tmp_path / "x.csv").open(newline="") as file:
        assert [row["mean_capture_time"] for row in csv.DictReader(file)] == ["", "", "1.5", ""]
    assert some.to_frame()["captures"].dtype.name == "Int64"


def test_a_store_keeps_captures_per_evader(tmp_path):
    with Store(tmp_path / "x.sqlite") as store:
        store.register_metrics(units_and_codes(()))
        for row in (ok(0), ok(1, **PACK)):
            store.add("key", 0, row)
        assert store.runs("key", 0) == [ok(0), ok(1, **PACK)]
        ((one,), (two,)) = store.database.execute("SELECT summary FROM runs ORDER BY replication")
    assert tuple(json.loads(one)) == tuple(json.loads(two)) == tuple(METRICS)
    assert [json.loads(two)[name] for name in PACK] == list(PACK.values())


def types_of(frame):
    """Return the names of the types of the columns; pandas 2 has no type of texts."""
    return frame.dtypes.astype(str).replace("object", "str")


@pytest.mark.slow
def test_a_frame_has_the_types_of_what_is_measured():
    types = types_of(PLAIN.to_frame())
    assert types[["network.range", "active_time", "capture_time", "age_mean"]].tolist() == ["float64"] * 4
    assert types[["seed", "replication", "messages_sent"]].tolist() == ["int64"] * 3
    assert types[["captured", "status", "messages_lost_by"]].tolist() == ["bool", "str", "str"]


@pytest.mark.slow
def test_a_frame_with_failures_keeps_integers_and_truths():
    frame = FAILING.to_frame()
    types = types_of(frame)
    assert types[["messages_sent", "captured", "active_time"]].tolist() == ["Int64", "boolean", "float64"]
    assert types[["seed", "status", "error"]].tolist() == ["int64", "str", "str"]
    assert frame["team.speeds"].tolist() == ["1.5"] * 3 + ["[1, 2]"] * 3
    assert frame["messages_sent"].isna().tolist() == [False, True, False, False, False, True]
    assert frame.groupby("protocol").active_time.mean()["sap"] == 2.0


@pytest.mark.slow
def test_seeds_of_more_than_64_bits_are_texts_in_a_frame():
    big = SweepResult("big", ("x",), (group({"x": 1}, replace(ok(0), seed=2**70)),))
    assert big.to_frame()["seed"].tolist() == [str(2**70)]


def test_settings_that_differ_in_type_are_texts():
    values = [1, 0.5, inf, True, "a"]
    mixed = SweepResult("m", ("x",), tuple(group({"x": each}, ok(0)) for each in values))
    assert mixed.to_frame()["x"].tolist() == ["1", "0.5", "inf", "true", "a"]
    numbers = SweepResult("m", ("x",), tuple(group({"x": each}, ok(0)) for each in [4, 0.5, inf]))
    assert numbers.to_frame()["x"].tolist() == [4.0, 0.5, inf]


@every
def test_a_parquet_file_has_the_frame(result, tmp_path):
    import pandas as pd

    result.write(tmp_path / "x.parquet")
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "x.parquet"), result.to_frame())


@every
def test_a_csv_file_has_the_records(result, tmp_path):
    result.write(tmp_path / "x.csv")
    with (tmp_path / "x.csv").open(newline="") as stream:
        read = list(csv.DictReader(stream))
    assert read == [{key: "" if each is None else str(each) for key, each in row.items()} for row in result.records()]
    assert b"\r" not in (tmp_path / "x.csv").read_bytes()


def test_a_csv_file_has_all_printable_texts_as_they_are(tmp_path):
    texts = ["=1+1", "-1", "\t=1", "\n=1", "", "1", 'a "quoted", text']
    groups = [group({"=key": each}, ok(0, active_time=-2.0)) for each in [*texts, -1.5]]
    SweepResult("x", ("=key",), tuple(groups)).write(tmp_path / "x.csv")
    with (tmp_path / "x.csv").open(newline="") as stream:
        read = list(csv.DictReader(stream))
    assert [row["=key"] for row in read] == [*texts, "-1.5"]
    assert {row["active_time"] for row in read} == {"-2.0"}


def test_a_result_without_runs_has_columns(tmp_path):
    NOTHING.write(tmp_path / "x.csv")
    assert (tmp_path / "x.csv").read_text() == ",".join(NOTHING.to_frame().columns) + "\n"
    assert list(NOTHING.to_frame().columns) == ["x", *list(next(PLAIN.records()))[1:]]


@pytest.mark.parametrize("name", ["x.txt", "x", "parquet", ".csv"])
def test_another_kind_of_file_is_refused(tmp_path, name):
    with pytest.raises(ValueError, match=r"should end in \.csv, \.parquet, \.tex or \.md"):
        PLAIN.write(tmp_path / name)


# From a store.


def test_a_table_has_one_number_of_decimals_in_a_column_and_other_formats(tmp_path):
    """98 and 1000 s: with the three decimals of the smaller one."""
    rows = [ok(k, active_time=value) for k, value in enumerate([98.0, 99.0])], [ok(0, active_time=1000.0)]
    result = SweepResult("x", ("x_y",), tuple(group({"x_y": k}, *part) for k, part in enumerate(rows)))
    text = result.table("active_time")
    assert "98.500 +- 6.353" in text
    assert "1,000.000 +- -" in text
    for suffix, form, there in ((".tex", "latex", r"$98.500 \pm 6.353$"), (".md", "markdown", "98.500 ± 6.353")):
        result.write(tmp_path / f"table{suffix}", ["active_time"])
        written = (tmp_path / f"table{suffix}").read_text(encoding="utf-8")
        assert written == result.table(["active_time"], format=form) + "\n"
        assert there in written
        assert r"x\_y" in written
    with pytest.raises(ValueError, match="format should be text, latex, markdown"):
        result.table(format="html")


def test_a_store_that_was_never_used_has_no_results():
    with Store() as store:
        for about in ({}, {"grid": '["x"]'}):  # as an interrupt before the first configuration leaves it
            store.record_properties(about)
            with pytest.raises(StoreError, match="is empty"):
                SweepResult.of(store)


def test_the_failed_are_in_order():
    assert [(row.replication, row.status) for row in FAILING.failed] == [(1, "error"), (2, "crashed")]
    assert PLAIN.failed == []


def test_one_metric_may_be_given_by_its_name_alone():
    assert PLAIN.document("active_time") == PLAIN.document(["active_time"])
    assert PLAIN.table("active_time") == PLAIN.table(["active_time"])


@pytest.mark.parametrize("kind", ["scatter", "contour"])
def test_a_figure_of_another_kind_than_means_has_no_options_of_means(kind, monkeypatch):
    drawn = []
    monkeypatch.setattr(f"desim.study.results.design_figures.{kind}", lambda *given, **options: drawn.append(options))
    for name in ("x", "by", "against", "labels", "xlabel", "ylabel"):
        with pytest.raises(ValueError, match=f"a figure of {kind} has no option '{name}': it is one of means"):
            PLAIN.plot(kind=kind, **{name: {"network.range": 3} if name in {"against", "labels"} else "network.range"})
    PLAIN.plot(kind=kind, size="8.5cm")
    assert drawn == [{"size": "8.5cm", "style": None, "ax": None}]


def test_nan_is_nothing_in_a_document():
    odd = SweepResult("odd", ("x",), (group({"x": nan}, ok(0)), group({"x": -inf}, ok(0))))
    assert [each["settings"]["x"] for each in odd.document()["configurations"]] == [None, "-Infinity"]


@pytest.mark.parametrize(
    ("key", "is_of_messages"),
    [("network.latency.value", True), ("announce.heartbeat", True), ("team.count", False), ("networks.x", False)],
)
def test_why_a_key_of_messages_may_have_no_effect_is_said(key, is_of_messages):
    groups = [Group({key: value}, tuple(row_of(run, 2.0) for run in range(3))) for value in (1, 2)]
    (warning,) = SweepResult("flat", (key,), tuple(groups)).warnings()
    assert f"depends on {key}: equal in 3 pairs of runs" in warning
    assert ("a protocol may need no messages" in warning) is is_of_messages


NAMES = {
    "an array": np.array(["active_time", "capture_time"]),
    "columns of a frame": pd.DataFrame(columns=["active_time", "capture_time"]).columns,
    "a series": pd.Series(["active_time", "capture_time"]),
    "keys": {"active_time": 1, "capture_time": 2}.keys(),
    "a generator": (name for name in ("active_time", "capture_time")),
}


@pytest.mark.parametrize("names", NAMES)
def test_names_are_a_list_of_any_kind(names):
    assert PLAIN.table(NAMES[names]) == PLAIN.table(["active_time", "capture_time"])


def test_names_without_an_order_are_refused():
    with pytest.raises(ValueError, match="should be a list of texts"):
        PLAIN.table({"active_time", "capture_time"})


def test_keys_and_labels_may_be_those_of_numpy():
    key, *_ = PLAIN.keys
    value = PLAIN.values(key)[0]
    assert PLAIN.plot(by=np.array([key, key]), labels={np.float64(value): "first"}) is not None
    for number in (value, np.float64(value)):
        assert PLAIN.table(labels={number: "first"}) == PLAIN.table(labels={f"{value:g}": "first"})


def test_the_number_of_a_reference_may_be_that_of_numpy():
    assert PLAIN.differences("active_time", np.int64(1)) == PLAIN.differences("active_time", 1)


@pytest.mark.parametrize("option", ["xlabel", "ylabel"])
def test_the_label_of_an_axis_is_a_text(option):
    with pytest.raises(ValueError, match=r"the label of the (abscissa|ordinate) should be a text"):
        PLAIN.plot(**{option: 3})
