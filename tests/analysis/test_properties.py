"""Properties of runs: margins equal to a plain monitor's, quantities equal to metrics, wrong texts refused."""

import random
from dataclasses import replace
from functools import cache
from itertools import pairwise
from math import inf, nan
from operator import eq, ge, gt, le, lt, ne

import pytest

from desim import Evader, Scenario, Team, judge, load, run, summary
from desim.analysis.properties import PropertyWatcher, worst_of
from desim.analysis.quantities import pieces_of
from desim.kernel.core.trace_file import line_of
from desim.kernel.core.units import SECOND
from desim.pursuit.core.events import Ended
from desim.scenario.checks import warnings
from desim.scenario.conditions import JUST_BELOW_0, QUANTITIES, QuantityComparison
from desim.scenario.overrides import ScenarioError
from desim.scenario.properties import PropertyPiece, property_of
from desim.scenario.toml import dump
from desim.testing import assert_holds

pytestmark = pytest.mark.own_trace
END = 30
"""Length of a random step function, ns."""
SMALL = Scenario(
    **{
        "horizon": 6.0,
        "team": {"count": 4, "box": [0.0, 4.0], "speeds": 1.5},
        "evader": {"box": [1.0, 3.0]},
        "record": {"messages": True},
    }
)
LOSSY = SMALL.with_({"network.latency.value": 0.3, "network.loss": 0.2, "announce.start": "silent"})


@cache
def lossy(seed):
    """Return a run of `LOSSY`."""
    return run(LOSSY, seed)


# The margins, against monitors that look at every nanosecond.


def stretches(margins) -> list[tuple[int, int]]:
    """Return [begin, end) of each stretch of nanoseconds with a margin of at least 0."""
    edges = [0, *(t for t in range(1, END) if (margins[t] >= 0) != (margins[t - 1] >= 0)), END]
    return [(begin, end) for begin, end in pairwise(edges) if margins[begin] >= 0]


def delay(first, then, t) -> int:
    """Return the time from an instant to the next at which the second condition holds, or to the end."""
    return next((later for later in range(t, END) if then[later] >= 0), END) - t if first[t] >= 0 else 0


PLAIN = {
    "always active <= 0": lambda first, _: -min(first),
    "eventually idle within 0": lambda first, _: next((t for t in range(END) if first[t] >= 0), END) / SECOND,
    "idle leads to crowded within 0": lambda first, then: max(delay(first, then, t) for t in range(END)) / SECOND,
    "idle never longer than 0": lambda first, _: max((b - a for a, b in stretches(first)), default=0) / SECOND,
    "idle at most 0 in total": lambda first, _: sum(b - a for a, b in stretches(first)) / SECOND,
}


def random_pieces(rng, conditions) -> tuple[list[PropertyPiece], list[list[float]]]:
    """Return a random step function as pieces, and its margins at each nanosecond."""
    edges = sorted({0, END, *(rng.randrange(1, END) for _ in range(rng.randrange(12)))})
    pieces = [
        PropertyPiece(
            begin, end, tuple(rng.choice([-2.0, -0.5, JUST_BELOW_0, 0.0, 1.0, 3.0]) for _ in range(conditions))
        )
        for begin, end in pairwise(edges)
    ]
    return pieces, [
        [piece.margins[k] for piece in pieces for _ in range(piece.begin, piece.end)] for k in range(conditions)
    ]


@pytest.mark.parametrize("text", PLAIN)
def test_a_margin_is_that_of_a_monitor_that_looks_at_every_instant(text):
    """1,000 random step functions, after each of their pieces: what a watcher sees is what a whole run gives."""
    rng, prop = random.Random(text), property_of(text)
    for _ in range(1000):
        pieces, margins = random_pieces(rng, len(prop.conditions))
        *_, last = prop.worst(pieces)
        expected = PLAIN[text](margins[0], margins[-1])
        assert last.measure == expected
        assert prop.margin(last.measure) == prop.bound - expected
    running = [worst.measure for worst in prop.worst(pieces)]
    assert running == [list(prop.worst(pieces[: k + 1]))[-1].measure for k in range(len(pieces))]


@pytest.mark.parametrize("sign", ["<=", ">=", "==", "!=", "<", ">"])
def test_a_comparison_holds_if_its_margin_is_at_least_0(sign):
    (comparison,) = property_of(f"always active {sign} 2").conditions[0].comparisons
    for value in (0.0, 1.0, 2.0, 3.0, inf, -inf, nan):
        assert (comparison.margin(value) >= 0.0) == comparison.holds(value)
        infinite = replace(comparison, number=inf)
        assert (infinite.margin(value) >= 0.0) == infinite.holds(value)
    assert comparison.margin(nan) == (0.0 if sign == "!=" else -inf)
    assert comparison.margin(4.0) == {"<=": -2, ">=": 2, "==": -2, "!=": 2, "<": -2, ">": 2}[sign]


def test_a_rising_quantity_is_cut_where_it_reaches_its_bound():
    """The age since the last decision rises by 1 s per second, so the time above a bound is exact."""
    result = lossy(3)
    decided = [0, *(event.t for event in result.trace if type(event).__name__ == "Decided")]
    gaps = [later - earlier for earlier, later in pairwise([*decided, result.trace.of(Ended)[0].t])]
    bound = sorted(gaps)[len(gaps) // 2] / SECOND
    above = sum(gap - round(bound * SECOND) for gap in gaps if gap > bound * SECOND) / SECOND
    assert judge(f"waiting > {bound!r} at most 1 in total", result).measure == pytest.approx(above, abs=1e-7)
    assert judge("always waiting <= 0.1", result).margin == pytest.approx(0.1 - max(gaps) / SECOND, abs=1e-9)


# The quantities, against metrics that compute the same otherwise.


@pytest.mark.parametrize(
    ("text", "metric"),
    [
        ("idle at most 1 in total", "idle_time"),
        ("crowded at most 1 in total", "crowded_time"),
        ("misassigned at most 1 in total", "misassigned_time"),
    ],
)
def test_a_time_in_total_is_that_of_the_metric(text, metric):
    for seed in range(5):
        result = lossy(seed)
        assert judge(text, result).measure == pytest.approx(summary(result)[metric], abs=1e-9)


def test_wrong_beliefs_are_those_of_the_metric_belief_error():
    for seed in range(5):
        result = lossy(seed)
        pieces = pieces_of(property_of("always wrong_beliefs <= 0").conditions, result)
        integral = sum(-margin * (end - begin) for begin, end, (margin,) in pieces)
        share = integral / (4 * 3 * result.trace.of(Ended)[0].t)
        assert share == pytest.approx(summary(result)["belief_error"], abs=1e-9)


def test_teammates_agree_on_an_ideal_network_and_not_while_an_announcement_travels():
    ideal = SMALL.with_({"network.latency.value": 0.0})
    assert judge("disagreements at most 0.0 in total", run(ideal, 1)).measure == 0.0
    assert judge("disagreements at most 0.0 in total", lossy(1)).measure > 0.0
    assert judge("always age <= 0.5", run(SMALL.with_({"network.latency.value": 0.4}), 1)).measure >= -0.1


@pytest.mark.slow
def test_a_quantity_of_one_evader_adds_up_to_that_of_all():
    result = run(LOSSY.with_({"evader.count": 3, "evader.box": [0.0, 8.0]}), 2)
    for name in ("active", "idle", "crowded", "captured"):
        texts = [f"always {quantity} <= 0" for quantity in (name, *(f"{name}[{j}]" for j in (1, 2, 3)))]
        every, *parts = [list(pieces_of(property_of(text).conditions, result)) for text in texts]
        integrals = [
            sum(-piece.margins[0] * (piece.end - piece.begin) for piece in pieces) for pieces in (every, *parts)
        ]
        assert integrals[0] == sum(integrals[1:])


# A reference, watchers, metrics.


def test_a_margin_against_a_protocol_is_that_of_two_runs():
    scenario = LOSSY.with_({"protocol": "best_response"})
    for text in ("crowded at most 0.1 in total", "always active <= 1", "idle never longer than 0.1"):
        verdict = judge(f"{text} against centralised", run(scenario, 1))
        other = worst_of(property_of(text), run(scenario.with_({"protocol": "centralised"}), 1)).measure
        own = judge(text, run(scenario, 1)).measure
        assert (verdict.measure, verdict.reference) == (own, other)
        expected = max(-own, other) if text.startswith("always") else property_of(text).bound + other - own
        assert verdict.margin == expected


def test_a_protocol_is_not_its_own_reference():
    with pytest.raises(ValueError, match="sap is its own reference"):
        judge("idle never longer than 1 against sap", run(SMALL, 0))


@pytest.mark.parametrize(
    "text", ["crowded never longer than 0.2", "always active <= 2", "crowded leads to idle within 1"]
)
def test_a_watcher_ends_a_run_as_soon_as_it_violates_the_property(text):
    """Up to there the run is the same, and a run that keeps the property is not changed."""
    whole = lossy(1)
    watcher = PropertyWatcher(text, LOSSY)
    stopped = run(LOSSY, 1, watcher)
    assert not judge(text, whole).holds
    assert watcher.violated_at is not None
    assert stopped.trace.of(Ended)[0].reason == "stopped"
    assert judge(text, stopped).margin == watcher.margin < 0.0
    unbroken = PropertyWatcher("crowded never longer than 5", LOSSY)
    assert list(map(line_of, run(LOSSY, 1, unbroken).trace)) == list(map(line_of, whole.trace))
    assert unbroken.margin == judge("crowded never longer than 5", whole).margin


def test_before_a_run_nothing_is_violated():
    watcher = PropertyWatcher("always active <= 2", LOSSY)
    assert (watcher.margin, watcher.violated_at) == (inf, None)


@pytest.mark.parametrize(
    ("text", "measure", "at"),
    [
        ("always idle", 1.0, 1),
        ("eventually idle within 0", 0.0, 0),
        ("idle leads to crowded within 0", 3e-9, 2),
        ("idle never longer than 0", 3e-9, 2),
        ("idle at most 0 in total", 7e-9, 2),
    ],
)
def test_the_worst_is_where_the_longest_stretch_or_the_largest_violation_began(text, measure, at):
    """Of equal ones it is the first."""
    pieces = [(0, 1, 1.0), (1, 2, -1.0), (2, 5, 0.0), (5, 6, -1.0), (6, 9, 1.0)]
    prop = property_of(text)
    *_, worst = prop.worst(
        PropertyPiece(begin, end, (margin, -1.0 if margin >= 0.0 else 1.0)[: len(prop.conditions)])
        for begin, end, margin in pieces
    )
    assert (worst.measure, worst.at) == (measure, at)


def test_the_worst_of_a_total_is_its_longest_piece_wherever_that_lies():
    """A piece of 4 ns from 7 on is longer than one of 3 ns before, and than one of 2 ns after it."""
    pieces = [(0, 2, 1.0), (2, 5, 1.0), (5, 7, -1.0), (7, 11, 1.0), (11, 13, 1.0)]
    prop = property_of("idle at most 0 in total")
    worst = list(prop.worst(PropertyPiece(begin, end, (margin,)) for begin, end, margin in pieces))
    assert [part.at for part in worst] == [0, 2, 2, 7, 7]


def test_a_watcher_refuses_what_is_known_after_the_run_only():
    for text in ("always age <= 1", "always active <= 1 against centralised"):
        with pytest.raises(ValueError, match="is known only after a run"):
            PropertyWatcher(text, SMALL)


def test_a_margin_is_a_metric_of_the_scenario():
    scenario = LOSSY.with_({"properties": ["few: always active <= 2"], "record.metrics": ["margin:few"]})
    result = run(scenario, 1)
    assert summary(result)["few"] == judge("always active <= 2", result).margin


def test_a_run_has_no_margin_against_its_own_protocol_and_is_measured_all_the_same():
    against = {"properties": ["a: idle never longer than 1 against sap"], "record.metrics": ["margin:a"]}
    scenario = SMALL.with_(against | {"horizon": 0.1})
    assert summary(run(scenario, 0))["a"] is None
    assert summary(run(scenario.with_({"protocol": "local_min"}), 0))["a"] is not None


def test_assert_holds_names_the_seed_and_the_margin():
    assert_holds(SMALL, "active never longer than 5.9", seeds=range(3))
    with pytest.raises(AssertionError, match=r"sap in unnamed with seed 0 violates 'always active <= 1' by"):
        assert_holds(LOSSY, "always active <= 1", seeds=range(3))
    with pytest.raises(ValueError, match="says nothing"):
        assert_holds(SMALL, "always active <= 4")
    with pytest.raises(ValueError, match="assert_holds needs a seed"):
        assert_holds(SMALL, "always active <= 1", seeds=[])


# Texts, tables and what is refused.

TEXTS = [
    "always active <= 1",
    "eventually captured within 20",
    "crowded leads to not crowded within 2",
    "idle never longer than 2 against centralised",
    "idle[1] and crowded == 0 at most 1.5 in total",
    "idle never longer than 0.123456789",
    "idle at most 1e-07 in total",
]


@pytest.mark.parametrize(
    ("bound", "text"), [("2.0", "2"), ("1000000", "1e+06"), ("12345678", "12345678.0"), ("0.1234567", "0.1234567")]
)
def test_the_text_of_a_property_stays(bound, text):
    """Stores and columns of tables are named by it."""
    assert property_of(f"idle at most {bound} in total").text == f"idle at most {text} in total"


@pytest.mark.parametrize("text", TEXTS)
def test_a_text_is_the_property_that_states_it_and_a_file_keeps_it(tmp_path, text):
    prop = property_of(text)
    assert property_of(prop.text) == prop
    scenario = SMALL.with_({"properties": [f"mine: {text}"]})
    (tmp_path / "kept.toml").write_text(dump(scenario))
    assert load(tmp_path / "kept.toml").properties == scenario.properties
    assert scenario.properties[0].label == "mine"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("idle often", "should be .*always CONDITION"),
        ("always idel <= 1", "there is no quantity 'idel', did you mean 'idle'"),
        ("always idle =< 1", "should be comparisons"),
        ("always age[1] <= 1", "only active, idle, crowded, captured may be of one evader"),
        ("always idle[2] <= 0", "there is no evader 2: they are 1 .. 1"),
        ("always idle <= 0 against central", "there is no protocol 'central', did you mean 'centralised'"),
        ("always not idle <= 1", "not belongs before a quantity alone"),
    ],
)
def test_a_wrong_property_is_refused(text, why):
    with pytest.raises(ScenarioError, match=why):
        SMALL.with_({"properties": [text]})


def test_a_file_of_a_stranger_names_no_function(tmp_path):
    file = tmp_path / "theirs.toml"
    file.write_text('properties = ["always os:getcwd <= 1"]')
    with pytest.raises(ScenarioError, match="names code to be run"):
        load(file)


def backwards(result):
    """Return no step function."""
    return [(1.0, 0.0), (0.0, 2.0)]


def gap(result):
    """Return a step function of time: 0, then 2 from 1 s on."""
    return [(0.0, 0.0), (1.0, 2.0)]


def test_a_quantity_may_be_a_function_of_the_result():
    end = run(SMALL, 1).trace.of(Ended)[0].t / SECOND
    name = "tests.analysis.test_properties:gap"
    assert judge(f"{name} >= 2 at most 1 in total", run(SMALL, 1)).measure == pytest.approx(end - 1.0)
    with pytest.raises(ValueError, match="in order of time, the first at time 0"):
        judge("tests.analysis.test_properties:backwards > 0 never longer than 1", run(SMALL, 1))


def test_names_are_unique_and_metrics_name_properties():
    with pytest.raises(ScenarioError, match=r"properties\.0 has the name 'a', too"):
        SMALL.with_({"properties": ["a: always idle <= 0", "a: always active <= 1"]})
    with pytest.raises(ScenarioError, match="the scenario has no property 'b'"):
        SMALL.with_({"properties": ["a: always idle <= 0"], "record.metrics": ["margin:b"]})
    changes = {"properties": ["a: always age <= 1"], "record.metrics": ["margin:a"], "record.messages": False}
    with pytest.raises(ScenarioError, match=r"set record\.trajectory or \.messages"):
        SMALL.with_(changes)


@pytest.mark.parametrize(
    "text",
    [
        "always active <= 4",
        "idle > 1 never longer than 1",
        "idle never longer than 6",
        "always idle[1] <= 1",
    ],
)
def test_a_property_that_cannot_fail_is_a_warning(text):
    assert "says nothing" in dict(warnings(SMALL.with_({"properties": [text]})))["properties.0"]
    assert not any("properties" in key for key, _ in warnings(SMALL.with_({"properties": ["always active <= 3"]})))


def test_a_function_that_cannot_be_called_with_a_result_is_refused_before_the_run():
    def of_two(result, other):
        return [(0.0, 1.0)]

    for condition in (of_two, "tests.analysis.of_users:of_two == 0"):
        with pytest.raises(ValueError, match=r"of_two' should accept a call with \(result\)"):
            property_of({"kind": "always", "condition": condition})


def test_every_quantity_has_a_step_function():
    result = lossy(1)
    for name in QUANTITIES:
        pieces = list(pieces_of(property_of(f"always {name} <= 1").conditions, result))
        assert pieces[0].begin == 0
        assert pieces[-1].end == result.trace.of(Ended)[0].t
        assert all(first.end == second.begin for first, second in pairwise(pieces))


@pytest.mark.parametrize("text", ["always age <= 1", "age never longer than 1", "wrong_beliefs at most 1 in total"])
def test_one_pursuer_alone_has_no_old_records(text):
    """With two, the age rises from the start: nothing is announced."""
    quiet = SMALL.with_({"announce.trigger": "never", "announce.start": "known"})
    assert judge(text, run(quiet.with_({"team.count": 1}), 1)).holds
    assert not judge("always age <= 1", run(quiet, 1)).holds


@pytest.mark.parametrize("text", ["idle never longer than 0", "idle at most 0 in total", "eventually idle within 0"])
def test_in_a_run_that_ends_as_it_begins_no_time_has_passed(text):
    result = run(SMALL.with_({"capture.radius": 1e3}), 1)
    assert result.trace.of(Ended)[0].t == 0
    assert judge(text, result).margin == PropertyWatcher(text, result.scenario).margin == 0.0
    assert judge("always active <= 2", result).margin == inf


LARGEST = {
    # with 3 pursuers and 2 evaders; a duration has no bound
    "active": 3, "idle": 2, "crowded": 2, "captured": 2, "down": 3, "waiting": inf, "misassigned": 1,
    "wrong_beliefs": 6, "disagreements": 3, "age": inf, "active[2]": 3, "idle[2]": 1, "crowded[1]": 1, "captured[1]": 1,
}  # fmt: skip
SIGNS = {"<": lt, "<=": le, "==": eq, "!=": ne, ">=": ge, ">": gt}


def test_whether_a_comparison_can_hold_or_be_violated_is_that_of_the_values_of_its_quantity():
    """Quantities are integers; of times, which have no bound, halves up to 9.5 s are tried."""
    scenario = Scenario(team=Team(count=3), evader=Evader(count=2))
    assert {name.partition("[")[0] for name in LARGEST} == set(QUANTITIES)
    for name, largest in LARGEST.items():
        quantity, _, evader = name.rstrip("]").partition("[")
        values = [k / 2 for k in range(20)] if largest == inf else range(largest + 1)
        for sign, compare in SIGNS.items():
            for number in range(8):
                comparison = QuantityComparison(quantity, int(evader) if evader else None, sign, float(number))
                for hold in (True, False):
                    possible = any(compare(value, number) == hold for value in values)
                    assert comparison.can(scenario, hold=hold) == possible, (name, sign, number, hold)


def test_a_reference_that_takes_longer_leaves_more_of_the_limit():
    limited = property_of("idle never longer than 2 against centralised")
    assert (limited.margin(3.0), limited.margin(3.0, 1.5)) == (-1.0, 0.5)


def test_one_of_several_comparisons_may_fail_alone_and_all_have_to_hold_together():
    assert property_of("always idle >= 0 and active <= 1").can_fail(SMALL)
    assert not property_of("idle >= 0 and active < 0 never longer than 1").can_fail(SMALL)
