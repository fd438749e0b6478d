"""The study of several evaders: it measures what the simulator does, and prints and draws what it measured."""

import numpy as np
import pytest

from desim import run
from desim.analysis.statistics import wilson
from desim.pursuit.core.events import Captured, Started
from desim.pursuit.game.game import optimal_assignment, welfare
from scenarios import many
from scenarios.studies import many_runs
from tests.scenarios.patching import patch_study

FEW = ("SAP, slow", "SAP, fast", "Selective SAP, slow", "Selective SAP, fast", "local min")


@pytest.fixture
def few(monkeypatch):
    """The study, cut down to what a test has time for."""
    patch_study(monkeypatch, (many, many_runs), "SIZES", ((2, 2), (3, 2)))
    patch_study(monkeypatch, (many, many_runs), "HARD", (2, 2))
    patch_study(monkeypatch, (many, many_runs), "BUDGETS", (10, 20))
    patch_study(monkeypatch, (many, many_runs), "BUDGET", 20)
    patch_study(monkeypatch, (many, many_runs), "TEMPERATURES", (0.1, 1.0))
    patch_study(monkeypatch, (many, many_runs), "HORIZON", 3.0)
    patch_study(monkeypatch, (many, many_runs), "SLOT", 0.05)
    patch_study(monkeypatch, (many, many_runs), "BOX", (0.0, 5.0))
    patch_study(monkeypatch, (many, many_runs), "CONTENDERS", {name: many_runs.CONTENDERS[name] for name in FEW})


@pytest.mark.whole
def test_the_study_shows_what_runs_come_to(few, study):
    document, text, picture = study(many.main, "--runs", "2")
    games = {(each["pursuers"], each["protocol"], each["slots"]): each for each in document["negotiations"]}
    game = games[3, "SAP, slow", 20]
    outcomes = [
        many_runs.outcome(run(many_runs.static_game(3, 2, "sap", 20, many_runs.slow(20)), seed)) for seed in range(2)
    ]
    assert game["share"]["mean"] == pytest.approx(np.mean([each.share for each in outcomes]))
    assert game["best"]["mean"] == pytest.approx(np.mean([each.best for each in outcomes]))
    assert game["best"]["interval"] == pytest.approx(wilson(round(2 * game["best"]["mean"]), 2))
    moved = {(each["pursuers"], each["protocol"]): each for each in document["pursuits"]}
    chases = [
        many_runs.chase(run(many_runs.moving_game(3, 2, "sap", many_runs.slow(many_runs.COOLING)), seed))
        for seed in range(2)
    ]
    assert moved[3, "SAP, slow"]["duration"]["mean"] == pytest.approx(np.mean([each.duration for each in chases]))
    assert moved[3, "SAP, slow"]["captured"]["mean"] == pytest.approx(np.mean([each.captured for each in chases]))
    assert moved[3, "SAP, slow"]["difference"]["mean"] == 0.0
    assert f"{game['share']['mean']:.3f} +- {game['share']['half_width']:.3f}" in text
    assert all(text.count(f"\n{name} ") >= 4 for name in FEW[1:])
    for label in ("slots to negotiate", "welfare / optimum", "temperature", "until all are captured"):
        assert label in picture
    assert f'width="{8.5 / 2.54 * 72:.2f}' in picture  # a column, pt


def test_an_outcome_is_the_welfare_of_the_last_profile_in_units_of_the_best():
    """Pursuers that never decide keep the profile of the start; one given the best assignment has all of it."""

    def still(me):
        yield me.sleep(1.0)

    scenario = many_runs.static_game(3, 2, "sap", 10)
    phi = many_runs.capture_times(scenario, 4)
    best = optimal_assignment(phi, scenario.horizon)

    def optimal(me):
        yield me.sleep(0.5 + 0.1 * me.id)
        me.assign(best.get(me.id, 0))

    assert many_runs.outcome(run(scenario.model_copy(update={"protocol": optimal}), 4)).best
    result = run(scenario.model_copy(update={"protocol": still}), 4)
    start = result.trace.of(Started)[0].active
    share = welfare(phi, start, scenario.horizon) / sum(scenario.horizon - phi[i, j - 1] for i, j in best.items())
    assert many_runs.outcome(result).share == pytest.approx(share) != 1.0
    assert not many_runs.outcome(result).best


def test_the_game_of_the_study_is_that_of_the_runs():
    scenario = many_runs.moving_game(3, 2, "sap")
    start = run(scenario.model_copy(update={"horizon": 0.01}), 5).trace.of(Started)[0]
    gaps = np.linalg.norm(np.array(start.pursuers)[:, None] - np.array(start.evaders)[None], axis=2)
    assert many_runs.capture_times(scenario, 5) == pytest.approx((gaps - 0.1) / (2.0 - 0.9))


@pytest.mark.slow
def test_a_chase_counts_the_evaders_captured_until_the_horizon():
    short = many_runs.moving_game(3, 6, "sap").model_copy(update={"horizon": 4.0})
    result = run(short, 2)
    caught = [event.t for event in result.trace.of(Captured)]
    assert 0 < len(caught) < 6
    assert many_runs.chase(result) == many_runs.Chase(len(caught) / 6, 4.0)


def test_the_temperature_of_slow_cooling_has_fallen_when_a_tenth_of_the_slots_is_left():
    tau = many_runs.slow(300)
    assert 1.0 / tau(0) == pytest.approx(many_runs.HOT)
    assert 1.0 / tau(135) == pytest.approx(np.sqrt(many_runs.HOT * many_runs.COLD))
    assert 1.0 / tau(269) > many_runs.COLD * 1.01
    assert 1.0 / tau(271) == pytest.approx(many_runs.COLD)
    assert 1.0 / many_runs.FAST(10) == pytest.approx(many_runs.COLD)


@pytest.mark.slow
def test_the_example_has_six_pursuers_and_captures_three_evaders(run_of):
    result = run_of("many.toml")
    assert (result.scenario.team.count, len(result.scenario.evaders)) == (6, 3)
    assert sorted(event.evader for event in result.trace.of(Captured)) == [1, 2, 3]
