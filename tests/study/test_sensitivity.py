"""Sensitivity: the estimators against known indices, and the analysis that performs runs for them."""

from dataclasses import replace
from math import nan, pi, sqrt
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from desim import Scenario, sensitivity
from desim.scenario.value_ranges import KeyRange, setting_at
from desim.study.sensitivity.morris import (
    LEVELS,
    STEP,
    ElementaryEffects,
    among_items,
    elementary_effects,
    morris_points,
)
from desim.study.sensitivity.sensitivity_result import SensitivityResult, _with_interval
from desim.study.sensitivity.sobol_indices import (
    IndexEstimate,
    SobolIndices,
    _estimates,
    bootstrap_ends,
    saltelli_points,
    sobol_indices,
)
from desim.study.store.store import Store
from tests.golden import golden
from tests.study import by_hand

FIRST = (0.313905, 0.442411, 0.0)
"""The first-order indices of the function of Ishigami & Homma for a = 7 and b = 0.1."""
VARIANCE = 49 / 8 + 0.1 * pi**4 / 5 + 0.01 * pi**8 / 18 + 1 / 2
TOTAL = (1 - 0.442411, 0.442411, 1 - 0.313905 - 0.442411)


def ishigami(shares):
    """Return the values at points in [0, 1), an array (..., 3 or more); further inputs are dummies."""
    x = pi * (2.0 * shares - 1.0)
    return np.sin(x[..., 0]) + 7.0 * np.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * np.sin(x[..., 0])


def luck(shares, seeds):
    """Return normal numbers that depend on each point and on each of some seeds, an array (..., seeds)."""
    numbers = [np.random.default_rng(int(share * 2**40)).standard_normal(seeds) for share in shares.ravel()]
    return np.array(numbers).reshape(*shares.shape, seeds)


@pytest.mark.slow
def test_the_indices_of_a_known_function():
    indices = sobol_indices(ishigami(saltelli_points(8192, 4))[..., None], resamples=60)
    assert [index.value for index in indices.first] == pytest.approx([*FIRST, 0.0], abs=0.01)
    assert [index.value for index in indices.total] == pytest.approx([*TOTAL, 0.0], abs=0.01)
    assert indices.variance == pytest.approx(VARIANCE, rel=0.01)
    assert all(index.low <= value <= index.high for index, value in zip(indices.first, (*FIRST, 0.0), strict=True))
    dummy = indices.total[3]
    assert dummy.low <= 0.0 <= dummy.high
    assert (dummy.low, dummy.high) == (0.0, 0.0)
    assert all(index.low > 0.0 for index in indices.total[:3])


@pytest.mark.slow
def test_what_is_left_of_the_variance_is_called_interaction_if_it_is_told_apart():
    """Of the variance of the product 0.4 is interaction, of that of the sum nothing; few points cannot tell."""
    told = {}
    for size in (8, 1024):
        x, y = saltelli_points(size, 2).transpose(2, 0, 1)
        for name, values in (("product", (x - 0.25) * (y - 0.25)), ("sum", x + y)):
            alone = sobol_indices(values[..., None], resamples=200).alone
            told[name, size] = alone.high < 1.0
            if size == 1024:
                assert alone.value == pytest.approx(1.0 if name == "sum" else 0.6, abs=0.02)
                assert alone.low <= (1.0 if name == "sum" else 0.6) <= alone.high
    assert told == {("product", 8): False, ("sum", 8): False, ("product", 1024): True, ("sum", 1024): False}


def test_the_estimators_are_those_of_scipy():
    values = ishigami(saltelli_points(64, 3))
    ours = sobol_indices(values[..., None], resamples=2)
    theirs = stats.sobol_indices(
        func={"f_A": values[:1], "f_B": values[1:2], "f_AB": values[2:, None]}, n=64, method="saltelli_2010"
    )
    assert [index.value for index in ours.first] == pytest.approx(theirs.first_order, abs=1e-12)
    assert [index.value for index in ours.total] == pytest.approx(theirs.total_order, abs=1e-12)


def test_the_matrices_differ_in_one_column():
    a, b, *mixed = saltelli_points(8, 3)
    for i, matrix in enumerate(mixed):
        assert (matrix[:, i] == b[:, i]).all()
        assert (np.delete(matrix, i, axis=1) == np.delete(a, i, axis=1)).all()


@pytest.mark.slow
def test_an_input_that_only_changes_the_luck_has_no_index_and_without_seeds_it_has_one():
    """12 analyses of a model whose second input only chooses other random numbers, with as much variance as the first.

    With one seed, as the control, it has half of the variance.
    """
    of_luck = {1: [], 8: []}
    for repetition in range(12):
        points = saltelli_points(64, 2, seed=repetition)
        for seeds, indices in of_luck.items():
            values = sqrt(12.0) * points[..., :1] + luck(points[..., 1], seeds)
            indices.append(sobol_indices(values, resamples=100))
    means = {seeds: np.mean([one.total[1].value for one in indices]) for seeds, indices in of_luck.items()}
    error = np.std([one.total[1].value for one in of_luck[8]], ddof=1) / sqrt(12)
    assert abs(means[8]) <= 3.0 * error < 0.1
    assert np.mean([one.first[0].value for one in of_luck[8]]) == pytest.approx(1.0, abs=0.1)
    assert sum(one.total[1].low <= 0.0 <= one.total[1].high for one in of_luck[8]) >= 9
    assert means[1] == pytest.approx(0.5, abs=0.1)
    assert all(one.total[1].low > 0.0 for one in of_luck[1])
    chance = np.mean([one.variance_of_chance for one in of_luck[8]])
    assert chance == pytest.approx(1.0, abs=0.1)


def test_what_a_seed_does_at_all_points_alike_does_not_count():
    points = saltelli_points(64, 3)
    of_seeds = 100.0 * np.random.default_rng(1).standard_normal(4)
    with_seeds, without = (
        sobol_indices(ishigami(points)[..., None] + added, resamples=10) for added in (of_seeds, np.zeros(4))
    )
    assert [index.value for index in with_seeds.total] == pytest.approx([index.value for index in without.total])
    assert [index.value for index in with_seeds.first] == pytest.approx([index.value for index in without.first])


@pytest.mark.parametrize("values", [np.ones((4, 64, 1)), np.random.default_rng(3).standard_normal((4, 64, 8))])
def test_a_model_that_does_not_vary_has_no_indices(values):
    indices = sobol_indices(values, resamples=100)
    assert not indices.is_varied
    assert all(np.isnan(index.value) for index in (*indices.first, *indices.total))


def test_the_variance_of_chance_alone_is_not_told_apart_from_0():
    """Some of eight models without any input that matters have a variance above 0, by chance."""
    noise = np.random.default_rng(2).standard_normal((8, 4, 32, 4))
    indices = [sobol_indices(values, resamples=50) for values in noise]
    assert any(one.variance > 0.0 for one in indices)
    assert not any(one.is_varied for one in indices)


def test_a_few_resamples_without_variance_take_no_interval_away():
    """In less than 2.5 % of the resamples the variance is not above 0; one nan among them would make all ends nan."""
    points = saltelli_points(64, 2, seed=1)
    values = 1.4 * points[..., :1] + np.random.default_rng(1).standard_normal((*points.shape[:2], 4))
    made, rng = sobol_indices(values, resamples=200), np.random.default_rng(0)
    variances = [_estimates(values[:, rng.integers(64, size=64)])[2] for _ in range(200)]
    assert 0 < sum(variance <= 0.0 for variance in variances) < 5
    assert made.is_varied
    assert not any(np.isnan([index.low, index.high]).any() for index in (*made.first, *made.total, made.alone))


@pytest.mark.whole
def test_the_intervals_of_ten_trajectories_cover_the_effect_as_often_as_they_say():
    """800 screenings of a product, whose effects are 2 y and 2 x: mu* is 1. S.e. 0.8 %.

    The control are the plain percentiles of the bootstrap.
    """
    covered, plain = 0, 0
    for repetition in range(800):
        points = morris_points(10, 2, np.random.default_rng([repetition, 5]))
        values = 2.0 * points[..., 0] * points[..., 1]
        effect = elementary_effects(points, values, resamples=400).mean_absolute[0]
        covered += effect.low - 1e-9 <= 1.0 <= effect.high + 1e-9
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("desim.study.sensitivity.morris.bootstrap_ends", lambda *_: [2.5, 97.5])
            effect = elementary_effects(points, values, resamples=400).mean_absolute[0]
        plain += effect.low - 1e-9 <= 1.0 <= effect.high + 1e-9
    error = sqrt(0.95 * 0.05 / 800)
    assert abs(covered / 800 - 0.95) <= 3.0 * error
    assert plain / 800 < 0.95 - 3.0 * error


def test_the_ends_of_a_bootstrap_are_expanded_to_those_of_student():
    """Of many values they are the plain percentiles; of ten, the normal ones at sqrt(10/9) t(9) = 2.3845."""
    assert bootstrap_ends(10**6) == pytest.approx([2.5, 97.5], abs=1e-3)
    assert bootstrap_ends(10)[0] == pytest.approx(100.0 * stats.norm.cdf(-sqrt(10 / 9) * stats.t.ppf(0.975, 9)))


@pytest.mark.parametrize(
    ("value", "low", "of_chance", "is_within"),
    [(1.0, 0.5, 0.5, True), (1.0, 0.5, 0.4, False), (1.0, 0.0, 0.0, True), (0.0, 0.0, 0.5, False)],
)
def test_an_effect_is_within_chance_if_its_interval_reaches_that_of_chance(value, low, of_chance, is_within):
    estimate = IndexEstimate(value, low, 2.0)
    assert ElementaryEffects((estimate,), (0.0,), (0.0,), (of_chance,)).within_chance() == [0] * is_within


@pytest.mark.slow
def test_an_effect_of_chance_alone_is_told_from_that_of_an_input():
    """300 screenings with four seeds: the first input has an effect of 3, the others change the luck of a run only.

    Each of these is listed in all but 2.5 % of the screenings or less, s.e. 0.9 %. With one seed nothing is known.
    """
    listed, sizes = [], []
    for repetition in range(300):
        rng = np.random.default_rng([repetition, 6])
        points = morris_points(10, 3, rng)
        values = 3.0 * points[..., :1] + rng.standard_normal((*points.shape[:2], 4))
        effects = elementary_effects(points, values, resamples=100)
        listed.append(effects.within_chance())
        sizes.append([effect.value for effect in effects.mean_absolute])
    assert not any(0 in keys for keys in listed)
    for key in (1, 2):
        assert np.mean([key in keys for keys in listed]) >= 0.975 - 3.0 * 0.009
    # A mean of four normal differences over a step of 2/3 has the deviation sqrt(2) / 2 / (2/3).
    assert np.mean(effects.of_chance) == pytest.approx(sqrt(2 / pi) * sqrt(2) / 2 * 1.5, rel=0.25)
    assert np.mean(sizes, axis=0)[1:] == pytest.approx(sqrt(2 / pi) * sqrt(2) / 2 * 1.5, rel=0.05)
    assert elementary_effects(points, values[..., 0]).of_chance == ()


def test_an_input_matters_if_its_effect_may_be_a_tenth_of_the_greatest():
    estimates = IndexEstimate(2.0, 1.0, 3.0), IndexEstimate(0.1, 0.0, 0.21), IndexEstimate(0.19, 0.1, 0.199)
    assert ElementaryEffects(estimates, (0.0,) * 3, (0.0,) * 3).matters(0.1) == [0, 1]


def test_a_trajectory_changes_each_input_once_and_visits_all_levels():
    points = morris_points(200, 5, np.random.default_rng(1))
    changes = np.diff(points, axis=1)
    assert (np.abs(changes).round(9) == np.eye(5)[np.abs(changes).argmax(axis=2)] * round(STEP, 9)).all()
    assert (np.sort(np.abs(changes).argmax(axis=2), axis=1) == np.arange(5)).all()
    levels, counts = np.unique((points[:, 0] * (LEVELS - 1)).round(9), return_counts=True)
    assert [*levels] == [0, 1, 2, 3]
    assert counts == pytest.approx(250, abs=3 * sqrt(1000 * 3 / 16))


def test_the_effects_of_a_linear_model_are_its_slopes_and_interactions_spread():
    points = morris_points(30, 4, np.random.default_rng(2))
    x = points.transpose(2, 0, 1)
    effects = elementary_effects(points, 3.0 * x[0] - 2.0 * x[1] + 4.0 * x[1] * x[2])
    assert effects.mean[0] == pytest.approx(3.0)
    assert effects.deviation[0] == 0.0
    assert effects.deviation[2] > 1.0
    assert effects.mean_absolute[3].value == effects.mean_absolute[3].high == 0.0
    assert effects.matters(0.1) == [0, 1, 2]


@pytest.mark.slow_cases("2", "4", "5", "7")
@pytest.mark.parametrize("count", [2, 3, 4, 5, 7, 11])
def test_each_item_of_a_list_is_as_probable_and_a_step_leads_to_another_one(count):
    """Of 4,000 shares at starts and ends each. The control is a list at the levels themselves."""
    points = morris_points(2000, 2, np.random.default_rng(3))
    items = [setting_at(range(count), share) for share in among_items(points, np.random.default_rng(4)).ravel()]
    items = np.reshape(items, points.shape)
    both = items[:, [0, -1]]
    assert (both[:, 0] != both[:, 1]).all()
    error = sqrt(2.0 * 4000 / count)  # the two of a trajectory are not independent
    assert np.bincount(both.ravel(), minlength=count) == pytest.approx(8000 / count, abs=4 * error)
    steps = np.diff(items, axis=1) != 0
    assert (steps == (np.diff(points, axis=1) != 0.0)).all()
    at_levels = {setting_at(range(count), share) for share in points.ravel()}
    assert (at_levels == {*range(count)}) == (count in {2, 4})


def test_the_effect_of_a_few_values_is_that_of_a_change_to_another_one():
    """Only the second of three values differs, of numbers the whole range counts; the control is screened out."""

    def values(self, shares, *_):
        settings = map(self._settings, shares.tolist())
        return np.array(
            [
                [2.0 * (one["prune"] == "inf") + 3.0 * one["team.count"] + 5.0 * one["network.loss.p"]]
                for one in settings
            ]
        )

    grid = {
        "prune": ["none", "inf", "infeasible"],
        "network.loss.p": "0:1",
        "team.count": "2:4",
        "horizon": [0.01, 0.02],
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("desim.study.sensitivity.analysis.Analysis._values", values)
        result = analysed(grid=grid, points=0, trajectories=60)
    changed, *linear, nothing = (effect.value for effect in result.effects.mean_absolute)
    assert linear == pytest.approx([5.0, 6.0])
    assert changed == pytest.approx(2.0 * 2 / 3, abs=4 * 2.0 * sqrt(2 / 9 / 60))  # two of three steps are to or from it
    assert nothing == 0.0
    assert result.kept == (0, 1, 2)


def test_a_step_that_leads_to_the_same_number_has_no_effect():
    """Of the two numbers of a range of ratios, half of the shares lead to the first."""
    interval = KeyRange(1, 2, is_log=True, is_whole=True)
    assert [interval.at(share) for share in (0.1, 0.6, 0.7)] == [1, 1, 2]
    assert [interval.share_between(*pair) for pair in ((1, 1), (1, 2), (2, 1))] == [0.0, 1.0, 1.0]
    points = morris_points(2, 1, np.random.default_rng(0))
    effects = elementary_effects(points, np.array([[3.0, 3.0], [3.0, 5.0]]), np.array([[0.0], [1.0]]))
    assert effects.mean_absolute[0].value == 1.0


SHORT = Scenario(horizon=0.01, team={"count": 2}, record={"trajectory": 0}, network={"latency": 0.1, "loss": 0.1})
RANGES = {"network.latency.value": "0.0:1.0", "network.loss.p": "0:1", "team.count": "2:5", "prune": ["none", "inf"]}


def score(result):
    """Return a number in which latency decides, loss and the protocol play a part together, and the team none."""
    network, own = result.scenario.network, np.random.default_rng(result.seed).random()
    kind = 1.0 if result.scenario.prune == "inf" else -1.0
    return 4.0 * network.latency.value + kind * network.loss.p + own


def analysed(**options):
    usual = {"points": 8, "trajectories": 3, "runs": 2, "metrics": {"score": score}}
    return sensitivity(SHORT, options.pop("grid", RANGES), options.pop("metric", "score"), **(usual | options))


@pytest.mark.slow
def test_an_analysis_finds_what_decides_and_resumes(tmp_path):
    path = tmp_path / "sweep.sqlite"
    result = analysed(store=path)
    assert result.kept == (0, 1, 3)
    shares = saltelli_points(8, 3)
    of_points = 4.0 * shares[..., 0] + np.where(shares[..., 2] < 0.5, -1.0, 1.0) * shares[..., 1]
    of_seeds = np.array([np.random.default_rng(seed).random() for seed in (0, 1)])
    expected = sobol_indices(of_points[..., None] + of_seeds, resamples=2)
    for key, total, first in zip(
        [key for key in RANGES if key != "team.count"], expected.total, expected.first, strict=True
    ):
        assert result.total[key].value == pytest.approx(total.value, abs=1e-4)
        assert result.first[key].value == pytest.approx(first.value, abs=1e-4)
    sentence, *others = result.sentences()
    assert sentence.startswith("score is decided by network.latency.value (")
    assert "screened out, with an effect below a tenth of the greatest: team.count; each keeps the middle" in others[0]
    assert result.chance == pytest.approx(of_seeds.var(ddof=1) / (expected.variance + of_seeds.var(ddof=1)), rel=1e-3)
    with Store(path) as store:
        count = len(store)
    again = analysed(store=path)
    with Store(path) as store:
        assert len(store) == count
    assert again.document() == result.document()
    figure = again.plot()
    assert [text.get_text() for text in figure.axes[0].get_yticklabels()] == [*RANGES]
    assert len(figure.axes) == 2


def test_an_analysis_of_a_known_function_is_golden(monkeypatch):
    """Latency decides, loss and the protocol play a part together, the team none; two runs differ by 0.5."""
    asked = []

    def values(self, shares, *_):
        asked.append(len(shares))
        if len(asked) > 1:
            assert (shares[:, 2] == 0.5).all()  # the team was screened out
        x, y, _, z = shares.T
        together = 4.0 * x**2 + np.where(z < 0.5, -1.0, 1.0) * y * (1.0 + x)
        return together[:, None] + np.array([0.0, 0.5]) * (1.0 + x[:, None])

    monkeypatch.setattr("desim.study.sensitivity.analysis.Analysis._values", values)
    result = analysed(points=16)
    assert asked == [3 * 5, 16 * 5]
    golden("sensitivity.txt", f"{result}\n{result.runs} runs\n")


@pytest.mark.slow
def test_screening_in_two_runs_at_each_point():
    """The runs themselves are made: 2 trajectories of 2 keys have 6 points, some of them equal."""
    pair = {key: RANGES[key] for key in ("network.latency.value", "prune")}
    result = analysed(grid=pair, points=0, trajectories=2)
    assert (result.runs, result.runs_at_point, result.kept) == (12, 2, (0,))
    assert [effect.value for effect in result.effects.mean_absolute] == pytest.approx([4.0, 0.2], abs=1e-4)


def constant(_):
    return 1.0


@pytest.mark.slow
def test_screening_alone_and_a_metric_that_is_the_same_everywhere():
    pair = {key: RANGES[key] for key in ("network.latency.value", "team.count")}
    screened = analysed(grid=pair, points=0)
    assert screened.indices is None
    assert screened.sentences()[0].startswith("score changes most with network.latency.value (4 over its range)")
    flat = analysed(grid=pair, metrics={"score": constant})
    assert flat.sentences() == ["score is the same at all points: no key has an effect"]
    assert "total index" not in flat.table()
    unscreened = analysed(grid=pair, metrics={"score": constant}, trajectories=0)
    assert "varies no more than chance explains" in unscreened.sentences()[0]


def nothing(result):
    return None if result.seed == 1 else 1.0


def endless(_):
    return float("-inf")


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"grid": {}}, "should have at least one key"),
        ({"grid": {"team.count": "2:5"}}, "with one key there is nothing to divide"),
        ({"grid": {"team.count": [2], "network.loss.p": "0:1"}}, "team.count: has one value, 2: give a range"),
        ({"grid": RANGES | {"network.loss.p": "0:1.5"}}, "network.loss.p: should be less than or equal to 1"),
        ({"grid": RANGES | {"seed": "0:3"}}, "seed: cannot be swept"),
        ({"metric": "scor"}, "no numeric metric 'scor', did you mean"),
        ({"points": 12}, "points should be 0 or a power of 2 from 8 on"),
        ({"points": 4}, "points should be 0 or a power of 2 from 8 on"),
        ({"trajectories": 1}, "trajectories should be at least 2"),
        ({"points": 0, "trajectories": 0}, "trajectories should be at least 2"),
        ({"runs": 0}, "at least one run"),
        ({"metrics": {"score": nothing}}, r"with seed 1 has no value, and a mean"),
        ({"metrics": {"score": endless}}, r"with seed 0 is -inf, and a mean needs finite values"),
    ],
)
def test_what_is_no_analysis_is_refused(options, why):
    with pytest.raises(ValueError, match=why):
        analysed(**({"points": 8, "trajectories": 2} | options))


@pytest.mark.parametrize(
    ("total", "decides", "is_idle"),
    [
        ((0.06, 0.01, 0.1), True, False),
        ((0.04, 0.01, 0.1), False, False),
        ((0.06, -0.01, 0.1), False, True),
        ((-0.2, -0.3, -0.1), False, True),
    ],
)
def test_a_key_decides_from_a_twentieth_of_the_variance_on(total, decides, is_idle):
    made = by_hand.sensitivity()
    indices = replace(made.indices, total=(made.indices.total[0], IndexEstimate(*total)))
    sentence = replace(made, indices=indices).sentences()[0]
    assert ("network.loss.p (" in sentence) == decides
    assert sentence.endswith("; not told apart from 0: network.loss.p") == is_idle


def test_an_effect_of_chance_is_named_unless_an_index_tells_it_apart():
    """The effect of loss, 0.25 or more, may be the 0.3 s of chance; an index whose interval excludes 0 says more."""
    made = by_hand.sensitivity()
    effects = replace(made.effects, of_chance=(0.1, 0.3, 0.0))
    sentence = "effects not told apart from what chance alone makes: network.loss.p (0.3 s)"
    assert sentence in replace(made, effects=effects).sentences()
    assert not any("chance alone" in one for one in made.sentences())
    indices = replace(made.indices, total=(made.indices.total[0], IndexEstimate(0.2, 0.1, 0.3)))
    assert sentence not in replace(made, effects=effects, indices=indices).sentences()
    screened = by_hand.sensitivity(indices=False)
    assert sentence in replace(screened, effects=effects).sentences()
    assert [key.get("effect_of_chance") for key in replace(made, effects=effects).document()["keys"]] == [0.1, 0.3, 0.0]


def test_an_index_is_told_with_its_interval_and_none_by_a_dash():
    assert _with_interval(IndexEstimate(0.25, 0.125, 0.5)) == "0.25 (0.125 .. 0.5)"
    assert _with_interval(IndexEstimate(nan, nan, nan)) == "-"


@pytest.mark.parametrize(
    ("variance", "of_chance", "share"), [(3.0, 1.0, 0.25), (-0.5, 2.0, 1.0), (3.0, nan, nan), (0.0, 0.0, nan)]
)
def test_the_share_of_chance_is_that_of_the_variance_of_a_run(variance, of_chance, share):
    """A variance that is estimated below 0 counts as 0."""
    indices = SobolIndices((), (), variance, of_chance, is_varied=True, alone=IndexEstimate(nan, nan, nan))
    assert SensitivityResult.chance.fget(SimpleNamespace(indices=indices)) == pytest.approx(share, nan_ok=True)
