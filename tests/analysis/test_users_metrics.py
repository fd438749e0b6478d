"""Metrics of users: what they may return, how they may be named, and where they are shown."""

import json
from decimal import Decimal
from fractions import Fraction
from math import inf, nan

import numpy as np
import pytest

from desim.analysis.measuring import check_numeric, summary
from desim.analysis.metrics import METRICS, Metric, active_time, plain
from desim.analysis.tables import batch_table, run_table
from desim.config.errors import MetricError
from desim.scenario.players import Team
from desim.scenario.scenario import Recording, Scenario
from desim.scenario.toml import dump
from desim.simulation.run import run
from desim.simulation.watchdog import TimedOut
from desim.study.sweeps.sweep import sweep
from tests.command import strict_json

SHORT = Scenario(name="short", horizon=0.1, team=Team(count=2))


@pytest.fixture(scope="module")
def result():
    return run(SHORT, 7)


def half(result):
    return active_time(result) / 2.0


def test_a_metric_that_is_given_is_in_the_summary_after_the_built_in_ones(result):
    numbers = summary(result, {"half": half})
    assert list(numbers) == [*METRICS, "half"]
    assert numbers["half"] == numbers["active_time"] / 2.0 == numbers.active_time / 2.0
    assert numbers.half == numbers["half"]  # an attribute, as the built-in ones are
    with pytest.raises(AttributeError, match="there is no metric 'halve', did you mean 'half'"):
        _ = numbers.halve
    assert str(numbers).splitlines()[-1] == f"half: {numbers['half']:.6g}"
    assert plain(numbers) == plain(summary(result)) | {"half": numbers["half"]}


@pytest.mark.parametrize(
    ("value", "expected"),
    [(1, 1), (2.5, 2.5), (True, True), (None, None), (nan, None), (inf, inf), (np.float32(0.5), 0.5), (np.int64(3), 3),
     (np.bool_(True), True), (np.float64("nan"), None), (np.longdouble(0.5), 0.5), (np.array(2), 2),
     (Fraction(1, 4), 0.25), (Decimal("0.25"), 0.25)],
)  # fmt: skip
def test_a_metric_is_a_number_a_truth_value_or_none(result, value, expected):
    found = summary(result, {"x": lambda result: value})["x"]
    assert (found, type(found)) == (expected, type(expected))


@pytest.mark.parametrize(
    ("values", "is_share"), [([True, False], True), ([None, True], True), ([True, 2.0], False), ([None, None], False)]
)
def test_a_table_of_runs_says_which_interval_a_share_has(result, values, is_share):
    scenario, runs = Scenario(), [summary(result, {"x": lambda _, value=value: value}) for value in values]
    assert (", of shares half a Wilson interval" in batch_table(scenario, runs, 1.0)) == is_share


def test_infinity_is_a_text_in_json(result):
    numbers = summary(result, {"x": lambda result: -inf})
    assert strict_json(json.dumps(plain(numbers)))["x"] == "-Infinity"


@pytest.mark.parametrize("value", ["3", [1.0], 1j, np.array([1.0]), {}, np.complex128(1j)])
def test_anything_else_is_an_error_that_names_the_metric_the_scenario_and_the_seed(result, value):
    said = (
        f"metric 'x' of 'short' with seed 7: should return a number, True, False or None, not a {type(value).__name__}$"
    )
    with pytest.raises(MetricError, match=said):
        summary(result, {"x": lambda result: value})


def test_an_integer_that_no_float_holds_is_refused():
    """A sweep could not give its mean."""
    for value in (10**400, -(10**400)):
        with pytest.raises(MetricError, match=r"should return a number up to 1.8e308, not an integer of 1329 bits"):
            summary(run(SHORT, 7), {"x": lambda result, value=value: value})


@pytest.mark.parametrize("error", [ValueError("oh"), SystemExit("oh")])
def test_an_exception_of_a_metric_names_the_metric_the_scenario_and_the_seed(result, error):
    def wrong(result):
        raise error

    with pytest.raises(MetricError, match=f"^metric 'x' of 'short' with seed 7: {type(error).__name__}: oh$"):
        summary(result, {"x": wrong})


def test_a_time_limit_ends_a_metric_as_it_ends_a_run(result):
    def slow(result):
        raise TimedOut

    with pytest.raises(TimedOut):
        summary(result, {"x": slow})


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("active_time", "there is a built-in metric of this name"),
        ("Active_Time", "there is a built-in metric of this name"),
        ("Status", "there is a column of tables of this name"),
        ("gr\u00f6sse", "should be a Python identifier in ASCII"),
        ("replication", "there is a column of tables of this name"),
        ("horizon", "there is a scenario key of this name"),
        ("a b", "should be a Python identifier in ASCII, got 'a b'"),
        ("class", "should be a Python identifier in ASCII, got 'class'"),
        (3, "should be a Python identifier in ASCII, got 3"),
    ],
)
def test_a_name_that_is_taken_or_no_identifier_is_refused(result, name, said):
    with pytest.raises(ValueError, match=said):
        summary(result, {name: half})


def größe(result):
    return 1.0


@pytest.mark.parametrize("metric", [lambda result: 1.0, größe, f"{__name__}:größe", "margin:as it should"])
def test_a_metric_that_can_have_no_column_is_refused_before_a_run(metric):
    with pytest.raises(
        ValueError, match=r"metrics.0: the name of a metric should be a Python identifier in ASCII, got"
    ):
        Recording(metrics=[metric])


def test_names_that_differ_only_in_case_are_refused(result):
    """SQL would not tell them apart."""
    with pytest.raises(ValueError, match="'late' should have another name: it differs from 'Late' only in case"):
        summary(result, {"Late": half, "late": half})


@pytest.mark.parametrize("wrong", [3, Scenario, "half"])
def test_what_is_no_function_is_refused(result, wrong):
    with pytest.raises(ValueError, match="metric 'x' should be a function of a result"):
        summary(result, {"x": wrong})


def test_a_scenario_names_metrics_which_every_summary_of_it_has():
    scenario = SHORT.model_copy(update={"record": Recording(metrics=(half,))})
    result = run(scenario)
    assert summary(result)["half"] == half(result)
    assert summary(result, {"half": half})["half"] == half(result)
    with pytest.raises(ValueError, match="another metric has it"):
        summary(result, {"half": active_time})
    assert f'metrics = [\n    "{__name__}:half",\n]' in dump(scenario)


def reward(result):
    return -summary(result).active_time


def test_a_metric_that_a_scenario_names_may_take_the_summary_of_its_result():
    scenario = SHORT.model_copy(update={"record": Recording(metrics=(reward, half))})
    result = run(scenario, 7)
    assert (summary(result)["reward"], summary(result)["half"]) == (-active_time(result), half(result))
    assert summary(result, {"x": lambda result: summary(result)["end_time"]})["x"] == summary(result)["end_time"]
    swept = sweep(scenario, {"team.count": [2]}, reps=2)
    assert [row["reward"] for row in swept.records()] == [-row["active_time"] for row in swept.records()]


def test_a_metric_may_need_recordings_and_is_none_without(result):
    numbers = summary(result, {"x": Metric(half, given=lambda result: False), "y": Metric(half)})
    assert (numbers["x"], numbers["y"]) == (None, half(result))


def test_tables_have_a_row_for_it_with_its_label_unit_and_note():
    metric = Metric(half, "m/s", "fast", label="my speed")
    scenario = Scenario.model_validate(SHORT.model_dump() | {"record": {"metrics": ["tests.analysis.of_users:speed"]}})
    first, second = (summary(run(scenario, seed)) for seed in (0, 1))
    assert scenario.record.metrics[0].of == metric._replace(of=scenario.record.metrics[0].of.of)
    (row,) = [line for line in run_table(scenario, first, 1.0).splitlines() if line.startswith("my speed")]
    assert row.split() == ["my", "speed", f"{first['speed']:.3f}", "m/s", "fast"]
    (row,) = [line for line in batch_table(scenario, [first, second], 1.0).splitlines() if "speed, m/s" in line]
    assert row.split()[:2] == ["speed,", "m/s"]
    assert row.split()[-1] == "2"


def test_a_metric_that_is_no_name_is_told_how_to_give_one_of_a_users():
    for metric, name in ((len, "len"), (3, "mine")):
        with pytest.raises(
            ValueError, match=rf'metric should be a name: "{name}", with metrics=\{{"{name}": \.\.\.\}}'
        ):
            check_numeric(metric)


def two(result, other):
    return 1.0


def yielded(result):
    yield 1.0


async def awaited(result):
    return 1.0


@pytest.mark.parametrize("wrap", [lambda of: of, lambda of: Metric(of, "s")], ids=["function", "metric"])
@pytest.mark.parametrize(
    ("of", "why"),
    [
        (two, r"metric 'x' should accept a call with \(result\); two \(.*\) does not: missing a required argument"),
        (yielded, "metric 'x' should do its work when it is called, without yield: yielded"),
        (awaited, "metric 'x' should have `def` in place of `async def`"),
    ],
    ids=["two arguments", "generator", "async"],
)
def test_a_metric_that_cannot_be_called_with_a_result_is_refused_before_any_run(of, why, wrap):
    with pytest.raises(ValueError, match=why):
        sweep(SHORT, reps=10**6, metrics={"x": wrap(of)})
