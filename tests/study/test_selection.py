"""The race: the procedure against its formulas and its promise, and the runs that it performs."""

from concurrent.futures import Executor, Future
from dataclasses import replace
from functools import partial
from math import floor, sqrt

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy import stats

from desim import Scenario, controlled, race, sensitivity, sweep
from desim.study.selection.kim_nelson import ENOUGH, constants, independent_variances, kim_nelson, two_stage_runs
from desim.study.store.store import Store
from desim.study.sweeps.sweep import RunError, job_batches
from desim.study.sweeps.sweep_plan import SweepPlan
from desim.study.workers.workers import InProcess
from tests.study import by_hand

SYSTEMS = 5
LEAST_FAVOURABLE = np.array([0.0, 0.0, 0.0, 0.0, 1.0])
SPREADS = {
    "equal": np.full(5, 2.0),
    "best varies most": np.array([1.0, 2, 1, 2, 3]),
    "best least": np.array([3.0, 2, 1, 2, 1]),
}


def drawn(rng, count, means, spreads, correlation):
    """Return (count, k) normal samples whose pairs of systems have a correlation."""
    common, own = rng.standard_normal((count, 1)), rng.standard_normal((count, len(means)))
    return means + spreads * (sqrt(correlation) * common + sqrt(1.0 - correlation) * own)


def selected(samples, **options):
    """Return the result of the procedure for samples, an array (replications, k)."""
    options = {"zone": 1.0, "first": 10} | options
    return kim_nelson(lambda systems, k: samples[k, systems], samples.shape[1], **options)


def selections(repetitions, spreads, correlation, means=LEAST_FAVOURABLE, **options):
    """Yield the result of the procedure for each repetition; the last system is the best."""
    for repetition in range(repetitions):
        samples = drawn(np.random.default_rng([7, repetition]), 1500, means, spreads, correlation)
        yield selected(samples, **options)


def test_the_constants_are_those_of_the_formula():
    assert constants(5, 10, 0.95) == pytest.approx((0.63497, 11.4294), rel=1e-5)
    eta, square = constants(3, 20, 0.9)
    assert eta == pytest.approx(((2 * 0.1 / 2) ** (-2 / 19) - 1) / 2)
    assert square == pytest.approx(2 * eta * 19)


@pytest.mark.parametrize("unit", [0.01, 3.0])
def test_a_selection_does_not_depend_on_the_unit_of_the_samples(unit):
    samples = drawn(np.random.default_rng(5), 1500, np.array([0.0, 0.0, 0.5]), np.ones(3), 0.3)
    here, there = selected(samples, zone=0.5), selected(samples * unit, zone=0.5 * unit)
    assert (here.selected, here.left, here.dropped) == (there.selected, there.left, there.dropped)
    assert here.dropped


def as_in_the_paper(samples, zone, confidence, first):
    """Return the selected system and the times of elimination: section 3 of Kim & Nelson, step by step."""
    k = samples.shape[1]
    eta = ((2 * (1 - confidence) / (k - 1)) ** (-2 / (first - 1)) - 1) / 2
    h2 = 2 * eta * (first - 1)
    s2 = [[np.var(samples[:first, i] - samples[:first, j], ddof=1) for j in range(k)] for i in range(k)]
    most = max(floor(h2 * s2[i][j] / zone**2) for i in range(k) for j in range(k) if i != j)
    left, r, times = list(range(k)), first, {}
    if first > most:
        return int(samples[:first].mean(axis=0).argmax()), times
    while True:
        mean = samples[:r].mean(axis=0)

        def margin(i, j, r=r):
            return max(0.0, zone / (2 * r) * (h2 * s2[i][j] / zone**2 - r))

        kept = [i for i in left if all(mean[i] >= mean[j] - margin(i, j) for j in left if j != i)]
        times |= {i: r for i in left if i not in kept}
        left = kept
        if len(left) == 1:
            return left[0], times
        r += 1
        if r == most + 1:
            return max(left, key=lambda i: samples[:r, i].mean()), times


@pytest.mark.slow
@pytest.mark.parametrize("correlation", [0.0, 0.64])
def test_the_procedure_is_that_of_the_paper_step_by_step(correlation):
    for seed in range(20):
        samples = drawn(np.random.default_rng(seed), 1500, LEAST_FAVOURABLE, SPREADS["equal"], correlation)
        selection = selected(samples)
        best, times = as_in_the_paper(samples, 1.0, 0.95, 10)
        assert selection.selected == best
        assert {dropped.system: dropped.after for dropped in selection.dropped} == times
        mirrored = selected(-samples, maximise=False)
        assert (mirrored.selected, mirrored.dropped) == (selection.selected, selection.dropped)


@pytest.mark.slow
@pytest.mark.parametrize("correlation", [0.0, 0.64])
@pytest.mark.parametrize("spreads", SPREADS.values(), ids=SPREADS)
def test_the_best_is_selected_as_often_as_promised(spreads, correlation):
    """300 repetitions: at the promised probability the share has a standard error of 0.0126."""
    right = sum(selection.selected == 4 for selection in selections(300, spreads, correlation))
    assert right / 300 >= 0.95 - 3 * sqrt(0.95 * 0.05 / 300)


@pytest.mark.slow
def test_a_procedure_that_believes_in_a_zone_of_three_times_the_difference_breaks_the_promise():
    """The control of the test above."""
    right = sum(selection.selected == 4 for selection in selections(300, SPREADS["equal"], 0.0, zone=3.0))
    assert right / 300 < 0.95 - 3 * sqrt(0.95 * 0.05 / 300)


def ratio_of_means(some, others):
    """Return the ratio of the means of paired numbers, and its standard error (Cochran 1977, section 2.11)."""
    some, others = np.array(some), np.array(others)
    ratio = some.mean() / others.mean()
    return ratio, np.std(some - ratio * others, ddof=1) / sqrt(len(some)) / others.mean()


@pytest.mark.slow
@pytest.mark.parametrize("correlation", [0.0, 0.64])
@pytest.mark.parametrize("spreads", SPREADS.values(), ids=SPREADS)
def test_a_race_takes_at_most_half_of_the_runs_of_a_plain_design(spreads, correlation):
    """The plain design has the same samples, so it profits from their correlation, too; the ratios are 0.23 to 0.38."""
    found = list(selections(60, spreads, correlation))
    plain = [two_stage_runs(selection.variances, 10, 0.95, 1.0) for selection in found]
    ratio, error = ratio_of_means([selection.total for selection in found], plain)
    assert ratio + 3.0 * error <= 0.5


def test_a_race_saves_nothing_where_the_first_runs_are_enough():
    """The control of the test above: with a wide zone both designs end after the first runs."""
    (selection,) = selections(1, SPREADS["equal"], 0.64, zone=20.0)
    assert selection.total == two_stage_runs(selection.variances, 10, 0.95, 20.0) == 50
    assert (selection.dropped, selection.left, selection.most) == ((), (0, 1, 2, 3, 4), 10)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "share"), [("equal", 0.43), ("best varies most", 0.53), ("best least", 0.62)])
def test_common_random_numbers_save_the_more_runs_the_more_alike_variances_are(name, share):
    """At a correlation of 0.64 they leave (s - t)^2 + 0.72 s t of s^2 + t^2, the variance of a difference."""
    totals = [
        [selection.total for selection in selections(100, SPREADS[name], correlation)] for correlation in (0.64, 0.0)
    ]
    ratio, error = ratio_of_means(*totals)
    assert error < 0.03
    assert ratio == pytest.approx(share, abs=3.0 * error)
    if name == "equal":
        assert ratio + error < 0.5


def test_systems_that_are_far_behind_take_few_runs():
    far = np.array([-20.0, -20.0, -20.0, 0.0, 1.0])
    (selection,) = selections(1, SPREADS["equal"], 0.0, means=far)
    assert [len(numbers) for numbers in selection.samples[:3]] == [10, 10, 10]
    assert selection.selected == 4


def test_a_limit_of_samples_ends_the_procedure_undecided():
    (selection,) = selections(1, SPREADS["equal"], 0.0, most=12)
    assert not selection.is_decided
    assert max(map(len, selection.samples)) == 12
    assert len(selection.left) > 1


def truth_values(repetition, count=700):
    """Return (count, 3) truth values that one number decides: true with 0.9, 0.9 and 0.95."""
    numbers = np.random.default_rng([8, repetition]).random((count, 1))
    return (numbers < [0.9, 0.9, 0.95]).astype(float)


@pytest.mark.whole
def test_systems_that_differ_in_few_samples_are_selected_as_often_as_promised(monkeypatch):
    """120 races of truth values, of which the first 20 are equal in a third: s.e. 2 %. The first two always are.

    Without the rule, the control, two systems that do not differ in the first samples are taken for equal.
    """
    options = {"zone": 0.05, "first": 20}
    right = [selected(truth_values(repetition), **options).selected == 2 for repetition in range(120)]
    assert np.mean(right) >= 0.95 - 3 * sqrt(0.95 * 0.05 / 120)
    monkeypatch.setattr("desim.study.selection.kim_nelson.ENOUGH", 0)
    right = [selected(truth_values(repetition), **options).selected == 2 for repetition in range(120)]
    assert np.mean(right) < 0.95 - 3 * sqrt(0.95 * 0.05 / 120)


def test_systems_that_differ_by_the_same_are_compared_when_few_may_differ():
    """After 73 samples, as in a sequential study; a third one that is far behind is dropped at once."""
    base = np.random.default_rng(9).normal(size=(100, 1))
    far = np.random.default_rng(10).normal(size=100)
    samples = np.hstack([base, base + 0.25, (far - 9.0)[:, None]])
    selection = selected(samples, first=10)
    assert (selection.selected, selection.is_decided) == (1, True)
    assert [len(numbers) for numbers in selection.samples] == [ENOUGH, ENOUGH, 10]
    limited = selected(samples, first=10, most=40)
    assert (limited.selected, limited.is_decided, limited.left, limited.most) == (1, False, (0, 1), ENOUGH)
    samples[29, 0] += 3.0  # a variance of 9 / 30 from the 30th on
    assert len(selected(samples, first=10).samples[0]) < ENOUGH


@pytest.mark.slow
def test_equal_systems_do_not_drop_each_other():
    """Nor once it is known that they are equal, while a third one, just behind, is still left."""
    rng = np.random.default_rng(3)
    base, third = rng.normal(size=(1000, 1)), rng.normal(-0.5, 1.0, size=(1000, 1))
    selection = selected(np.hstack([base, base, third]), first=10, zone=0.1)
    assert [(dropped.system, dropped.after > ENOUGH) for dropped in selection.dropped] == [(2, True)]
    assert (selection.left, selection.selected) == ((0, 1), 0)


def test_a_tie_counts_the_samples_that_were_taken():
    """After as many runs as they took, not after the first ones; a limit says that a variance is not known."""
    base = np.array([1.0, 2.0] * 40)
    made = by_hand.raced(2)
    tied = replace(made, selection=selected(np.column_stack([base, base]), first=4))
    assert "are equal in 73 runs" in tied.sentences()[0]
    limited = replace(made, selection=selected(np.column_stack([base, base + 1.0]), first=4, most=8))
    assert limited.sentences()[1] == (
        "not decided: 2 of 2 were left after 8 runs of each; some of them differ by the same in all runs, and at least"
        " 73 of each would decide"
    )


def test_the_mean_of_truths_is_a_share_with_its_own_interval():
    """9 of 10 captures: Wilson's interval, as a sweep has it, and not one beyond 1."""
    hits = np.array([1.0] * 9 + [0.0])
    made = by_hand.raced(2, metric="captured", unit="", maximise=True, is_of_truths=True)
    made = replace(made, selection=selected(np.column_stack([hits, 1.0 - hits]), first=4))
    interval = stats.binomtest(9, 10).proportion_ci(0.95, "wilson")
    assert made.document()["configurations"][0]["mean"]["interval"] == pytest.approx([interval.low, interval.high])
    assert f"0.900 ({interval.low:.3f} .. {interval.high:.3f})" in made.table()
    assert "t interval, in brackets a Wilson interval\n" in made.table()
    alike = replace(made, selection=selected(np.zeros((80, 2)), first=4))
    assert " in all, others < " in alike.table()
    assert "brackets" not in alike.table()


def test_two_stages_take_what_clark_and_yang_say():
    variances = np.array([[0.0, 2.0, 3.0], [2.0, 0.0, 4.0], [3.0, 4.0, 0.0]])
    t = stats.t.ppf(1 - 0.05 / 2, 9)
    assert two_stage_runs(variances, 10, 0.95, 0.5) == 3 * int(np.ceil(4.0 * t**2 / 0.25))
    assert two_stage_runs(variances, 10, 0.95, 50.0) == 30
    samples = [np.array([0.0, 2.0, 9.0]), np.array([0.0, 4.0])]  # a variance is that of the first samples
    assert independent_variances(samples, 2)[0, 1] == 2.0 + 8.0


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"systems": 1}, "at least two systems"),
        ({"zone": 0.0}, "zone should be positive"),
        ({"zone": float("nan")}, "zone should be positive"),
        ({"zone": float("inf")}, "zone should be positive"),
        ({"zone": 1e-300}, r"zone should be from 1e-100 to 1e\+100 \(got 1e-300\)"),
        ({"zone": 1e200}, r"zone should be from 1e-100 to 1e\+100 \(got 1e\+200\)"),
        ({"confidence": 0.5}, "between 1/2"),
        ({"confidence": 1.0}, "between 1/2"),
        ({"first": 1}, "first should be at least 2"),
        ({"most": 5}, "most should be at least `first`, 20"),
    ],
)
def test_what_is_no_selection_is_refused(options, why):
    with pytest.raises(ValueError, match=why):
        kim_nelson(lambda systems, _: [0.0 for _ in systems], **({"systems": 2, "zone": 1.0} | options))


@pytest.mark.parametrize("number", [float("inf"), float("nan")])
def test_a_sample_that_is_not_finite_is_refused(number):
    with pytest.raises(ValueError, match="the sample of system 1 in replication 0"):
        kim_nelson(lambda *_: [0.0, number], 2, zone=1.0)


SHORT = Scenario(horizon=0.01, team={"count": 2}, record={"trajectory": 0})
COUNTS = {"team.count": [2, 3, 4]}


def luck(result):
    """Return a number in [0, 1) that depends on the seed alone."""
    return float(np.random.default_rng(result.seed).random())


def size_and_luck(result):
    own = float(np.random.default_rng([result.seed, result.scenario.team.count]).random())
    return -0.5 * result.scenario.team.count + luck(result) + own


def raced(**options):
    usual = {"zone": 0.2, "first": 5, "maximise": False, "metrics": {"score": size_and_luck}}
    return race(SHORT, COUNTS, "score", **(usual | options))


@pytest.mark.slow
def test_a_race_finds_the_best_and_says_who_was_dropped_when():
    result = raced()
    assert result.best == {"team.count": 4}
    assert sorted(result.order) == [0, 1, 2]
    assert result.is_decided
    assert result.runs == sum(map(len, result.selection.samples))
    first, *_ = result.sentences()
    assert first == "team.count = 4 has the least score of 3 configurations"
    assert f"{result.runs} runs; a two-stage design" in result.table()
    assert result.plain_runs < result.independent_runs
    document = result.document()
    assert document["best"] == {"team.count": 4}
    assert [one["mean"]["mean"] for one in document["configurations"]] == [
        result.mean_of(system).mean for system in result.order
    ]
    assert [one["dropped_after"] for one in document["configurations"]] == [
        None,
        *(dropped.after for dropped in reversed(result.selection.dropped)),
    ]
    against = [dropped.against for dropped in reversed(result.selection.dropped)]
    assert [one["dropped_against"] for one in document["configurations"]] == [
        None,
        *({"team.count": COUNTS["team.count"][system]} for system in against),
    ]
    *others, best = result.selection.samples
    for system, sample in enumerate(others):
        both = min(len(sample), len(best))
        assert result.behind(system).mean == pytest.approx(np.mean(sample[:both] - best[:both]))
        assert result.behind(system).mean > 0.0
    assert raced(maximise=True).best == {"team.count": 2}


@pytest.mark.parametrize("maximise", [False, True])
def test_configurations_that_are_dropped_at_once_are_in_the_order_of_their_means(maximise):
    """The differences are far greater than the scatter, so all are dropped after the first runs."""
    sign = -1.0 if maximise else 1.0
    result = race(
        SHORT,
        {"team.count": [4, 2, 5, 3]},
        "score",
        zone=0.2,
        first=5,
        maximise=maximise,
        metrics={"score": lambda run: sign * (3.0 * run.scenario.team.count + size_and_luck(run))},
    )
    assert {dropped.after for dropped in result.selection.dropped} == {5}
    assert [result.settings[system]["team.count"] for system in result.order] == [2, 3, 4, 5]


def test_the_progress_of_a_race_counts_runs(monkeypatch):
    told = []

    def begun(*arguments):
        told.append(arguments)
        raise StopAsyncIteration

    monkeypatch.setattr("desim.study.selection.race.progress", begun)
    with pytest.raises(StopAsyncIteration):
        raced()
    assert told == [(None, "unnamed", "run")]


@pytest.mark.slow
def test_a_race_reads_the_runs_of_a_sweep_and_resumes(tmp_path):
    path = tmp_path / "sweep.sqlite"
    sweep(SHORT, COUNTS, reps=3, store=path, metrics={"score": size_and_luck})
    first = raced(store=path)
    with Store(path) as store:
        assert len(store) == first.runs
        times = [row.seed for configuration, _ in store.configurations() for row in store.runs(configuration, 0)]
    again = raced(store=path)
    assert again.document() == first.document() == raced().document()
    with Store(path) as store:
        assert [row.seed for one, _ in store.configurations() for row in store.runs(one, 0)] == times


class FourAtOnce(Executor):
    """An executor for four calls at the same time, which it makes at once."""

    _max_workers = 4

    def submit(self, call, /, *args):
        future = Future()
        future.set_result(call(*args))
        return future


@pytest.mark.slow
def test_the_result_does_not_depend_on_the_number_of_workers(tmp_path):
    paths = [tmp_path / "one.sqlite", tmp_path / "four.sqlite"]
    one, four = raced(store=paths[0]), raced(store=paths[1], executor=FourAtOnce())
    assert one.document() == four.document()
    with Store(paths[0]) as exact, Store(paths[1]) as ahead:
        assert len(ahead) > len(exact) == one.runs


def nothing(result):
    return None if result.seed == 2 else 1.0


def endless(result):
    return float("inf") if result.seed == 2 else 1.0


def failing(_):
    raise RuntimeError("no value")


@pytest.mark.parametrize(
    ("call", "why"),
    [
        (lambda: race(SHORT, {"team.count": [2]}, zone=0.1), "at least two configurations, and the grid has one, team"),
        (lambda: race(SHORT, COUNTS, "activ_time", zone=0.1), "no numeric metric 'activ_time', did you mean"),
        (lambda: race(SHORT, COUNTS, "capturers", zone=0.1), "no numeric metric 'capturers'"),
        (
            lambda: race(SHORT, COUNTS, zone=0.0),
            "zone should be positive and finite: it is the smallest difference .* s ",
        ),
        (lambda: race(SHORT, COUNTS, zone=0.1, confidence=0.3), "between 1/3"),
        (lambda: race(SHORT, COUNTS, size_and_luck, zone=0.2), 'metric should be a name: "size_and_luck", with'),
        (lambda: raced(maximise=None), "score: whether more of it is better is not known"),
        (lambda: race(SHORT, COUNTS, "capture_time", zone=0.1), "with seed 0 has no value, .*; end_time counts"),
        (lambda: raced(metrics={"score": nothing}), "the run of team.count = 2 with seed 2 has no value"),
        (lambda: raced(metrics={"score": endless}), "with seed 2 is inf, and a mean needs finite values"),
        (lambda: race(SHORT, {"team.count": [0, 2]}, zone=0.1), "should be greater than or equal to 1"),
        (lambda: race(SHORT, {"network.loss.p": "0:1"}, zone=0.1), "a range without steps"),
        (lambda: race(SHORT, COUNTS, zone=0.1, most=5), "most should be at least `first`, 20"),
        (lambda: race(SHORT, COUNTS, zone=0.1, maximise="yes"), "maximise should be True, False or None"),
        (lambda: raced(maximise=None), "is not known: give `maximise`"),
    ],
)
def test_what_is_no_race_is_refused(call, why):
    with pytest.raises(ValueError, match=why):
        call()


def test_a_race_of_a_file_says_how_to_load_it():
    for function in (partial(race, zone=0.1), controlled, sensitivity):
        name = getattr(function, "func", function).__name__
        with pytest.raises(TypeError, match=rf"^{name} takes a scenario, not a path: {name}\(load\('game.toml'\)\)"):
            function("game.toml", COUNTS)


@pytest.mark.slow
def test_a_race_with_independent_seeds_says_so():
    result = race(
        SHORT.with_({"sweep.seeds": "independent"}),
        COUNTS,
        "score",
        zone=0.5,
        first=5,
        maximise=False,
        metrics={"score": size_and_luck},
    )
    assert not result.common
    assert result.tables()[0][0].startswith("unnamed: a race of 3 configurations, independent seeds")
    assert "with the same seeds" not in result.sentences()[2]


def test_a_run_that_fails_ends_the_race_with_a_sentence():
    told = r"the run of team.count = 2 with seed 0 failed: MetricError: metric 'score' of 'unnamed' with seed 0: Runt"
    with pytest.raises(RunError, match=told) as raised:
        raced(metrics={"score": failing})
    assert "\n" not in str(raised.value)
    assert raised.value.__notes__[0].startswith("Traceback")


@pytest.mark.slow
def test_a_race_over_a_design_is_one_over_its_points():
    points = {"network.loss.p": "0:0.5"}
    result = race(SHORT, points, "score", zone=1.0, first=3, maximise=True, design="sobol:2", metrics={"score": luck})
    assert [dict(settings) for settings in result.settings] == [
        configuration.settings for configuration in SweepPlan.of(SHORT, points, design="sobol:2").configurations
    ]
    assert "the means of" in result.sentences()[0]
    assert "are equal" in result.sentences()[0]


def test_the_runs_of_a_race_are_counted_in_whole_numbers():
    """Also where so few are shown that there is room for ticks between them."""
    axes = Figure(figsize=(8, 3)).subplots()
    by_hand.raced().plot(ax=axes)
    axes.set_xlim(4.0, 5.0)
    assert axes.get_xticks().tolist() == [4.0, 5.0]


@pytest.mark.slow
def test_the_figure_of_a_race_has_a_line_for_each_configuration():
    figure = raced().plot()
    upper, lower = figure.axes
    marks = [line for line in upper.lines if line.get_label() in {"dropped", "end of the first runs"}]
    means = [line for line in upper.lines if not line.get_label().startswith("_") and line not in marks]
    ends = [line for line in upper.lines if line.get_marker() == "x" and line not in marks]
    assert len(means) == 3
    assert len(marks) == 2
    assert len(upper.lines) == len(marks) + len(means) + len(ends)
    assert {"dropped", "end of the first runs"} < {text.get_text() for text in figure.legends[0].get_texts()}
    assert len({line.get_color() for line in means}) == len({line.get_marker() for line in means}) == 3
    assert len({line.get_markevery()[0] for line in means}) > 1  # the marks of equal lines stand beside each other
    assert all(tick % 1 == 0 for tick in lower.get_xticks())
    assert upper.get_ylabel() == "score"
    assert next(text.get_text() for text in figure.legends[0].get_texts()) == "team.count = 4"
    assert next(iter(lower.lines[0].get_ydata())) == 3


class SeveralInProcess(InProcess):
    """Workers of which there seem to be several."""

    def __init__(self, count):
        super().__init__()
        self.count = count


@pytest.mark.slow_cases("1-1", "3-3", "5-5")
@pytest.mark.parametrize(("workers", "ahead"), [(1, 1), (2, 2), (3, 3), (5, 5)])
def test_a_race_performs_two_runs_for_each_worker_at_a_time(workers, ahead, monkeypatch):
    """After the first runs of all; with two systems, one run of both for each worker."""
    batches, original = [], job_batches

    def noting(jobs, *rest):
        batches.append([replication for _, replication in jobs])
        return original(jobs, *rest)

    monkeypatch.setattr("desim.study.selection.race.job_batches", noting)
    grid, options = {"team.count": [2, 3]}, {"first": 3, "most": 8, "metrics": {"score": size_and_luck}}
    race(SHORT, grid, "score", zone=1e-6, maximise=True, executor=SeveralInProcess(workers), **options)
    assert batches[0] == [0, 0, 1, 1, 2, 2]
    assert batches[1] == [k for k in range(3, 3 + ahead) for _ in range(2)]
    assert batches[-1][-1] == 7  # not ahead of the greatest number
