"""The trainer: it learns, it goes on where it was, and what it learned is in the weights."""

import numpy as np
import pytest

import desim
from desim import load, run
from desim.analysis.metrics import active_time, idle_time
from scenarios import learning
from scenarios.studies import learning_runs
from scenarios.studies.learning_runs import ALL_CHASE, SCALES, Notebook, cost, in_words, linear, scenario
from scenarios.studies.study import Options
from tests.scenarios.patching import patch_study

LEARNED = (-0.1, 1.2, -2.0, -1.0, -0.1, 0.2)
"""Weights as the study finds them."""


@pytest.fixture
def tiny(monkeypatch):
    """Let the study have two generations of three candidates, and one latency besides that of the training."""
    for name, value in {"GENERATIONS": 2, "CANDIDATES": 3, "ELITE": 2, "SEEDS": 1, "LATENCIES": (0.1, 0.3)}.items():
        patch_study(monkeypatch, (learning, learning_runs), name, value)


@pytest.mark.whole
@pytest.mark.usefixtures("tiny")
def test_the_study_trains_compares_and_draws(study, tmp_path, monkeypatch):
    document, text, picture = study(learning.main, "--runs", "1")
    assert len(document["training"]) == 2
    costs = {(cell["rule"], cell["latency"]): cell["cost"] for cell in document["costs"]}
    assert {rule for rule, _ in costs} == {"learned", "local_min", "sap", "all chase"}
    assert costs["all chase", 0.3] == pytest.approx(cost(run(scenario(ALL_CHASE, 0.3), 0)))
    assert "generation" in picture
    assert "Weights, the strongest first" in text
    (tmp_path / "a.toml").write_text('[protocol]\nkind = "policy"\nfile = "learning.weights.json"\n')
    learned = load(tmp_path / "a.toml").protocol
    assert learned.layers == linear(document["training"][-1]["mean"]).layers
    with monkeypatch.context() as patch:  # all that was measured is remembered
        patch.setattr(learning_runs, "run_many", None)
        patch.setattr(Options, "save_figures", lambda *_: None)
        assert study(learning.main, "--runs", "1")[0] == document


@pytest.mark.whole
@pytest.mark.usefixtures("tiny")
def test_the_second_study_trains_twice(study):
    document, text, _ = study(learning.main, "--runs", "1", "--delays")
    rules = {cell["rule"] for cell in document["costs"]}
    assert rules == {"trained without delay", "trained with 1 s", "local_min"}
    assert {cell["latency"] for cell in document["costs"]} == {0.0, 1.0}
    assert text.count("Weights, the strongest first") == 2


def test_what_depends_on_other_things_is_not_remembered(tmp_path):
    path = tmp_path / "notes.json"
    assert Notebook(path, "a").remember("x", lambda: float("inf")) == float("inf")
    assert Notebook(path, "a").remember("x", lambda: 2.0) == float("inf")
    assert Notebook(path, "b").remember("x", lambda: 2.0) == 2.0
    path.write_text("{")
    assert Notebook(path, "b").remember("x", lambda: 3.0) == 3.0


def test_the_cost_is_effort_and_three_times_idleness():
    result = run(scenario(ALL_CHASE, 0.1).with_({"horizon": 0.5}), 1)
    assert cost(result) == active_time(result) + 3.0 * idle_time(result)


def test_words_follow_the_sign():
    words = {name: text for name, _, text in in_words(LEARNED)}
    assert words["evader.free"] == "chases if it knows of no chaser"
    assert words["evader.rivals"] == "stays in a crowd"
    assert [name for name, *_ in in_words((0.1, 0.0, -3.0, 0.0, 0.4, 0.0))][:2] == ["evader.lead", "evader.rivals"]


def mean_costs(weights, seeds=(500, 501)):
    games = (scenario(linear(weights), 0.1).with_({"horizon": 15.0, "motion.step": 0.02}) for _ in seeds)
    return float(np.mean([cost(run(game, seed)) for game, seed in zip(games, seeds, strict=True)]))


@pytest.mark.whole
def test_shuffled_weights_are_no_better_than_random_ones():
    """The control of what was learned: it is in the places of the weights, not in their sizes."""
    rng = np.random.default_rng(3)
    learned = mean_costs(LEARNED)
    shuffled = [mean_costs(rng.permutation(LEARNED)) for _ in range(8)]
    random = [mean_costs(rng.normal(size=6) * SCALES) for _ in range(8)]
    error = np.hypot(np.std(shuffled, ddof=1), np.std(random, ddof=1)) / np.sqrt(8)
    assert np.mean(shuffled) > np.mean(random) - 3.0 * error
    assert learned < np.mean(shuffled) - 3.0 * np.std(shuffled, ddof=1) / np.sqrt(8)


@pytest.mark.slow
def test_an_omniscient_observation_beats_the_honest_one():
    """The same rule reads the same numbers: it chases if it is first and in time, at a latency of 1 s."""
    costs = {}
    for omniscient in (False, True):
        env = desim.env(scenario(ALL_CHASE, 1.0), 0, omniscient=omniscient)
        lead, late = (env.observation_names.index(f"evader_1.{name}") for name in ("lead", "late"))
        for seed in range(6):
            env.reset(seed=seed)
            for _ in env.agent_iter():
                numbers, _, terminated, truncated, _ = env.last()
                env.step(None if terminated or truncated else int(max(numbers[lead], numbers[late]) <= 0.0))
            costs.setdefault(omniscient, []).append(cost(env.result))
    saved = np.subtract(costs[False], costs[True])
    assert np.mean(saved) > 3.0 * np.std(saved, ddof=1) / np.sqrt(len(saved)) > 0.0
