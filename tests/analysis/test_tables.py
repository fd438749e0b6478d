"""Tables, letter by letter."""

from math import inf, nan

import pytest
from scipy import stats

from desim.analysis.measuring import summary
from desim.analysis.statistics import Estimate, estimate, share
from desim.analysis.tables import (
    aligned,
    as_json,
    batch_table,
    digits_of,
    fraction,
    from_json,
    number,
    percent,
    run_table,
    with_half_width,
)
from desim.kernel.core.units import time_text
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Capture, Scenario
from tests.golden import golden
from tests.summaries import changed
from tests.view.by_hand import history

SCENARIO = Scenario(name="relay", team=Team(count=3))
PACK = SCENARIO.model_copy(update={"evader": (Evader(), Evader(count=2))})
MANY = SCENARIO.model_copy(update={"evader": Evader(count=30)})
WITHOUT_AGES = dict.fromkeys(("age_mean", "age_peak", "age_at_decision", "belief_error", "believed_leaders"))
UNSEEN = dict.fromkeys(("misassigned_time", "time_to_relay", "potential_gap", "regret"))
CAUGHT = changed(
    summary(history()), seed=7, capture_time=3.9454, end_time=3.9454, active_time=12.7394, idle_time=0.0,
    crowded_time=1.23, excess_time=0.5, energy=16.25, decisions=1358, switches=19, handovers=3, ping_pongs=1,
    messages_sent=6802, messages_delivered=6610, messages_lost=116, messages_in_flight=76,
    messages_lost_by={"out_of_range": 16, "half_duplex": 100}, transmissions=3401, bytes_sent=81624, utilisation=0.0,
    **WITHOUT_AGES, **UNSEEN,
)  # fmt: skip
SEEN = changed(CAUGHT, misassigned_time=1.5, time_to_relay=1.25, potential_gap=40.5, regret=-0.125)
AGES = {"age_mean": 0.0519, "age_peak": 0.1021, "age_at_decision": 0.0498}
WITH_AGES = changed(CAUGHT, **AGES, utilisation=0.25, belief_error=0.03125, believed_leaders=0.75)
ESCAPED = changed(CAUGHT, seed=8, captured=False, capture_time=None, capturer=None, end_time=30.0)
LOSSLESS = changed(CAUGHT, messages_lost=0, messages_lost_by={})
TAKEN = changed(
    SEEN, captures=3, mean_capture_time=2.5, capture_times={"3": 1.5, "1": 2.0545, "2": 3.9454},
    capturers={"3": 0, "1": 0, "2": 2},
)  # fmt: skip
ONE_OF = changed(ESCAPED, captures=1, mean_capture_time=1.5, capture_times={"3": 1.5}, capturers={"3": 0})
NONE_OF = changed(ONE_OF, captures=0, mean_capture_time=None, capture_times={}, capturers={})
THREE = [
    changed(each, seed=7 + k, idle_time=3.0 * k, switches=10, capture_time=(2.0, 4.0, None)[k])
    for k, each in enumerate((CAUGHT, CAUGHT, ESCAPED))
]
RUNS = {
    "captured; 6,802 messages in 0.05 s are 136,040 in a second": (SCENARIO, CAUGHT),
    "of which word was measured": (SCENARIO, WITH_AGES),
    "of which positions are known": (SCENARIO, SEEN),
    "without losses": (SCENARIO, LOSSLESS),
    "that ended at the horizon": (SCENARIO, ESCAPED),
    "of several evaders, in order of their captures": (PACK, TAKEN),
    "of several evaders of which one was captured": (PACK, ONE_OF),
    "of several evaders of which none was captured": (PACK, NONE_OF),
    "of many evaders, of which the first are named": (MANY, TAKEN),
}
BATCHES = {
    "0, 3 and 6 s idle: s.e. sqrt(9 / 3), t(2, 0.975) = 4.3027; captured after 2 and 4 s: s.e. 1, t(1, 0.975) = 12.706":
    (SCENARIO, THREE),
    "word was measured, the peak once": (SCENARIO, [changed(WITH_AGES, age_peak=None), WITH_AGES]),
    "the third without positions": (SCENARIO, [SEEN, changed(SEEN, time_to_relay=None, misassigned_time=2.5), CAUGHT]),
    "16 and 0 losses by reach: mean 8, s.e. 8": (SCENARIO, [CAUGHT, LOSSLESS]),
    "one capture has no interval": (SCENARIO, [CAUGHT, ESCAPED]),
    "no capture has no time": (SCENARIO, [ESCAPED, ESCAPED]),
    "of several evaders": (PACK, [TAKEN, ONE_OF]),
    "two of three are needed": (PACK.model_copy(update={"capture": Capture(captures_to_end=2)}), [TAKEN, ONE_OF]),
    "all three are needed": (PACK.model_copy(update={"capture": Capture(captures_to_end=3)}), [TAKEN, ONE_OF]),
}  # fmt: skip


def test_the_tables_of_runs_are_golden():
    runs = {f"a run {what}": run_table(*each, wall_time=0.05) for what, each in RUNS.items()}
    golden("tables.txt", runs | {f"runs: {what}": batch_table(*each, wall_time=2.0) for what, each in BATCHES.items()})


def test_columns_line_up_the_first_to_the_left_and_the_others_to_the_right():
    rows = [("", "mean", "n"), ("time, s", "3.5", "12"), ("x", "10.25", "")]
    assert aligned(rows) == "          mean   n\ntime, s    3.5  12\nx        10.25"


def test_columns_before_right_from_line_up_to_the_left():
    assert aligned([("a", "bbb"), ("aaa", "b")], right_from=2) == "a    bbb\naaa  b"


def test_rows_of_different_length_are_an_error():
    with pytest.raises(ValueError, match="argument 2"):
        aligned([("a", "b"), ("a",)])


def test_no_rows_are_an_empty_table():
    assert aligned([]) == ""


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(1234.5678, 3, "1,234.568"), (0.0, 3, "0.000"), (-2.5, 1, "-2.5"), (nan, 3, "-"), (inf, 3, "inf")],
)
def test_a_number_has_thousands_separators_and_a_dash_stands_for_none(value, digits, text):
    assert number(value, digits) == text


def test_a_mean_has_its_half_width_and_how_many_values_it_is_of_if_not_one_per_run():
    """Of 99 and 100: s.e. 0.5; of 100 and more one digit is enough."""
    assert with_half_width(estimate([99.0, 100.0]), 2, "+") == "+99.500 +- 6.353"
    assert with_half_width(estimate([99.0, 101.0]), 3) == "100.0 +- 12.7 (2)"
    assert with_half_width(Estimate(nan, nan, 0), 2) == "-"


def test_equal_values_have_a_bound_on_all_others_instead_of_a_width():
    """By Wilson's interval of 0 in 30 and in 2. One value has no width and no bound, as before."""
    assert with_half_width(estimate([0.0] * 30), 30, "+", "s") == "+0.000 s in all, others < 11.4%"
    assert with_half_width(estimate([4.6] * 2), 3) == "4.600 in all, others < 65.8% (2)"
    assert with_half_width(estimate([4.6]), 1) == "4.600 +- -"
    assert with_half_width(estimate([0.0] * 29 + [1e-9]), 30) == "0.000 +- 0.000"


def test_the_bound_on_other_values_is_that_of_as_many_values_as_are_equal():
    """Two of 30 runs have a time to relay: by Wilson's interval of 0 in 2, 65.8 % of seeds may have another."""
    runs = [changed(SEEN, seed=k, active_time=1.0 + k, time_to_relay=1.25 if k < 2 else None) for k in range(30)]
    assert "all equal: at most 65.8% of all seeds have another value (for 2 values; 11.4% for 30)" in batch_table(
        SCENARIO, runs, 1.0
    )
    assert "all equal: at most 11.4% of all seeds have another value\n" in batch_table(
        SCENARIO, [*runs[2:], *runs[2:4]], 1.0
    )


@pytest.mark.parametrize(
    ("share", "text"), [(0.25, "25%"), (0.0, "0%"), (1.0, "100%"), (0.996, "99.6%"), (0.0004, "0.04%"), (0.99, "99%")]
)
def test_whole_percents_tell_a_share_apart_from_0_and_100(share, text):
    assert percent(share, 0) == text


@pytest.mark.parametrize("mean", [0.0, 0.2, -3.0, 99.0, 512.34])
@pytest.mark.parametrize("error", [2e-8, 3e-5, 0.0002, 0.004, 0.3])
def test_a_mean_is_not_shown_as_certain_beside_large_ones(mean, error):
    """A half width that the decimals of its column would make 0 has two digits, and the mean as many decimals."""
    value, large = Estimate(mean, error, 30), Estimate(5000.0, 200.0, 30)
    for column in ([value], [value, large], [value, Estimate(1.0, 0.1, 30), large]):
        shown, width = with_half_width(value, 30, digits=digits_of(column)).split(" +- ")
        decimals = len(width.partition(".")[2])
        assert float(width) == pytest.approx(stats.t.ppf(0.975, 29) * error, abs=0.5 * 10.0**-decimals)
        assert float(width) > 0.0
        assert len(shown.partition(".")[2]) == decimals
        assert with_half_width(large, 30, digits=digits_of(column)).startswith("5,000.0")
    assert with_half_width(Estimate(0.0003, 0.0, 30), 30, digits=digits_of([large])) == "0.00030 in all, others < 11.4%"
    assert with_half_width(Estimate(0.0003, nan, 1), 1, digits=3) == "0.00030 +- -"


def test_several_runs_that_hardly_differ_have_a_half_width():
    """Of 5 and 5.0002 s: s.e. 0.0001 s, and 12.706 times as much for two values."""
    runs = [changed(SEEN, seed=k, active_time=5.0 + 0.0002 * k) for k in range(2)]
    (row,) = (line for line in batch_table(SCENARIO, runs, 1.0).splitlines() if line.startswith("active time"))
    assert row.split()[-5:] == ["5.000", "0.001", "5.000", "5.000", "2"]
    runs = [changed(SEEN, seed=k, active_time=5.0 + 0.00002 * k) for k in range(2)]
    (row,) = (line for line in batch_table(SCENARIO, runs, 1.0).splitlines() if line.startswith("active time"))
    assert row.split()[-5:] == ["5.00001", "0.00013", "5.00000", "5.00002", "2"]


def test_small_numbers_keep_three_digits():
    """Of a share of 0.0004 three decimals leave nothing; what is below a nanosecond is rounding."""
    assert with_half_width(Estimate(0.0004, 0.00005, 30), 30) == "0.000400 +- 0.000102"
    assert with_half_width(Estimate(0.0099, 0.0, 1), 1) == "0.00990 +- -"
    assert with_half_width(Estimate(0.0, 0.05, 30), 30) == "0.000 +- 0.102"
    assert with_half_width(Estimate(1e-12, 1e-13, 30), 30) == "0.000 +- 0.000"
    runs = [changed(WITH_AGES, belief_error=error) for error in (0.0002, 0.0004)]
    (row,) = (line for line in batch_table(SCENARIO, runs, 1.0).splitlines() if line.startswith("belief error"))
    assert row.split()[2:] == ["0.000300", "0.001271", "0.000200", "0.000400", "2"]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(2e-4, "0.000200"), (0.0099, "0.00990"), (0.05, "0.050"), (1234.5, "1,234.500"), (0.0, "0.000")],
)
def test_the_times_of_one_run_have_digits_that_leave_them(seconds, text):
    numbers = changed(WITH_AGES, active_time=seconds, end_time=seconds, captured=False, capture_time=None)
    lines = run_table(SCENARIO, numbers, 1.0).splitlines()
    assert f"the pursuit ended after {text} s" in next(line for line in lines if line.startswith("captured"))
    (row,) = (line for line in lines if line.startswith("active time"))
    assert row.split()[2:4] == [text, "s"]


@pytest.mark.parametrize(
    ("time", "span", "text"),
    [
        *[(2_050_000_000, None, "2.05"), (50_000_000, None, "0.050"), (200_000, None, "0.00020"), (0, None, "0.00")],
        *[(0, 200_000, "0.00000"), (200_000, 2_050_000_000, "0.00"), (123_456_000_000, None, "123.46")],
    ],
)
def test_a_time_as_text_has_two_digits_of_it_or_of_its_span(time, span, text):
    assert time_text(time, span) == text


def test_a_share_is_shown_and_written_with_its_interval():
    found = share([True] * 29 + [False])
    assert with_half_width(found, 31) == "0.967 (0.833 .. 0.994) (30)"
    assert with_half_width(share([True] * 30), 30) == "1.000 in all, others < 11.4%"
    document = as_json(found)
    assert document["interval"] == [*found.interval]
    assert from_json(document) == found
    assert "interval" not in as_json(estimate([1.0, 2.0]))


@pytest.mark.parametrize(
    ("share", "as_fraction", "as_percent"),
    [
        *[(0.0, "0.000", "0.0%"), (1.0, "1.000", "100.0%"), (0.25, "0.250", "25.0%"), (0.0714, "0.071", "7.1%")],
        *[
            (3e-4, "0.0003", "0.03%"),
            (0.9997, "0.9997", "99.97%"),
            (0.999, "0.999", "99.9%"),
            (4e-5, "0.00004", "0.004%"),
        ],
    ],
)
def test_a_share_near_0_or_1_is_not_shown_as_0_or_1(share, as_fraction, as_percent):
    assert (fraction(share), percent(share)) == (as_fraction, as_percent)


def test_of_many_equal_runs_the_share_of_others_is_not_below_0():
    """Less than 0.0 % would be impossible."""
    assert with_half_width(Estimate(2.0, 0.0, 20_000), 20_000) == "2.000 in all, others < 0.02%"


def test_a_user_protocol_is_shown_by_its_name():
    def daydream(me):
        yield me.at(0.0)

    class Idler:
        def __call__(self, me):
            yield me.at(0.0)

    class Kindless(Idler):
        kind = None

    for protocol, called in ((daydream, "daydream"), (Idler(), "Idler"), (Kindless(), "Kindless")):
        scenario = SCENARIO.model_copy(update={"protocol": protocol})
        assert run_table(scenario, CAUGHT, 1.0).splitlines()[0] == f"relay: 3 pursuers, {called}, seed 7"
