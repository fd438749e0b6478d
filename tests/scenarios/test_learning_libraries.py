"""The studies that train with libraries of others: all of them that runs without these libraries."""

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from desim import load, run
from desim.config.errors import KeyedError
from protocols import Policy
from scenarios.onnx_rule import OnnxRule, session
from scenarios.studies import library_runs
from scenarios.studies.learning_runs import cost
from scenarios.studies.library_runs import RIVALS, ROUNDS, Progress, exported, game, minus_cost
from scenarios.studies.study import Options


class Base:
    """Stands for any class of a library."""

    def __init__(self, count=0, *spaces):
        self.num_envs, self.observation_space, self.action_space = count, *(spaces or (None, None))

    def _get_indices(self, indices):
        return range(self.num_envs) if indices is None else indices


@pytest.fixture
def without_libraries(monkeypatch):
    """Let modules without content stand for the libraries, and import the trainings anew."""
    for name in (
        *("torch", "sb3_contrib", "stable_baselines3", "stable_baselines3.common"),
        *("stable_baselines3.common.callbacks", "stable_baselines3.common.vec_env", "torchrl", "torchrl.envs"),
        *("benchmarl", "benchmarl.algorithms", "benchmarl.environments", "benchmarl.environments.pettingzoo"),
        *("benchmarl.environments.pettingzoo.common", "benchmarl.experiment", "benchmarl.models"),
        "benchmarl.models.mlp",
    ):
        module = ModuleType(name)
        module.__getattr__ = lambda _: Base
        monkeypatch.setitem(sys.modules, name, module)
    for name in ("scenarios.studies.sb3_runs", "scenarios.studies.benchmarl_runs"):
        monkeypatch.delitem(sys.modules, name, raising=False)


@pytest.mark.usefixtures("without_libraries")
def test_the_pursuers_of_a_team_are_environments_that_begin_and_end_together():
    runs = import_module("scenarios.studies.sb3_runs")
    team = game().with_({"horizon": 0.7, "team.speeds": [0.5] + 7 * [2.0]}).parallel_env(reward=minus_cost)
    envs = runs.TeamVecEnv(team, 3, ["own.time_left", "own.speed"])
    assert envs.observation_space.shape == (2,)
    first = envs.reset()
    assert first[:, 0] == pytest.approx(0.5)
    assert envs.env_method("action_masks", indices=[0, 5])[1].tolist() == [1, 1]
    assert envs.get_attr("action_masks")[0]()[0].tolist() == [1, 0]
    for rounds in range(3):
        envs.step_async(np.ones(8, dtype=int))
        observations, rewards, dones, infos = envs.step_wait()
        assert dones.all() == dones.any() == (rounds == 2)
    assert len(rewards) == 8
    assert [*envs.costs] == [pytest.approx(7 * 0.5)]  # the fast ones chase from the first turn, at 0.2 s, to the end
    assert observations[:, 0] == pytest.approx(0.5)  # those of the next episode
    assert infos[0]["terminal_observation"][0] == 0.0
    assert not infos[0]["TimeLimit.truncated"]  # the horizon is the end of the game: the time left is observed
    assert team.result.seed == 3_000_001
    with pytest.raises(AttributeError, match="a team has no method 'render'"):
        envs.env_method("render")


@pytest.mark.usefixtures("without_libraries")
def test_a_task_names_the_group_and_the_numbers_of_the_environment():
    runs = import_module("scenarios.studies.benchmarl_runs")
    env = game().parallel_env()
    assert {agent.partition("_")[0] for agent in env.possible_agents} == {runs.GROUP}
    assert runs.OBSERVATION == (runs.GROUP, "observation")


@pytest.mark.parametrize(("study", "package"), [("learning_sb3", "stable_baselines3"), ("learning_benchmarl", "torch")])
def test_a_missing_library_is_named_with_the_command_that_installs_it(study, package, tmp_path, monkeypatch):
    monkeypatch.setattr(library_runs, "find_spec", lambda name: None)
    done = CliRunner().invoke(import_module(f"scenarios.{study}").main, ["--out", str(tmp_path)])
    assert done.exit_code == 1
    assert f"{package} is missing: pip install {package.replace('_', '-')}" in done.output


def test_the_rewards_of_an_episode_are_minus_its_cost_from_the_first_turn_on():
    """All eight pursuers chase until the first round, at 0.2 s: 1.6 s."""
    env = game().with_({"horizon": 3.0}).parallel_env(3, reward=minus_cost)
    env.reset()
    total = 0.0
    while env.agents:
        _, rewards, *_ = env.step({agent: k % 3 == 0 for k, agent in enumerate(env.agents)})
        assert len(set(rewards.values())) == 1
        total += rewards["pursuer_0"]
    assert cost(env.result) == pytest.approx(8 * ROUNDS.period - total)


def test_a_normalised_network_is_exported_as_one_of_plain_numbers():
    rng = np.random.default_rng(1)
    weights, bias = rng.normal(size=(2, 3)), rng.normal(size=2)
    mean, deviation, x = rng.normal(size=3), rng.uniform(0.5, 2.0, size=3), rng.normal(size=3)
    (layer,) = exported(("own.x", "own.y", "own.speed"), [(weights, bias)], mean, deviation).layers
    assert np.array(layer.weights) @ x + layer.bias == pytest.approx(weights @ ((x - mean) / deviation) + bias)


@pytest.mark.slow
def test_a_learned_rule_is_written_and_compared(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(library_runs, "LATENCIES", (0.1,))
    options = Options("tiny", 2, 1, 0, tmp_path, as_json=False)
    rule = RIVALS["all chase"]
    library_runs.show(options, "learned", rule, [Progress(8, 3.0)])
    rows = [line.split("  ") for line in capsys.readouterr().out.splitlines()]
    costs = {row[0]: row[-1].strip() for row in rows if row[0] in {"learned", *RIVALS}}
    assert costs["learned"] == costs["all chase"] != costs["local_min"]
    (tmp_path / "a.toml").write_text('[protocol]\nkind = "policy"\nfile = "tiny.weights.json"\n')
    assert load(tmp_path / "a.toml").protocol.layers == rule.layers


class Session:
    """Stands for a network of onnxruntime, with two inputs and two scores."""

    def get_modelmeta(self):
        return SimpleNamespace(custom_metadata_map={"features": "evader_1.lead evader_1.late"})

    def get_inputs(self):
        return [SimpleNamespace(name="observation")]

    def run(self, _, inputs):
        (numbers,) = inputs["observation"].tolist()
        return [np.array([[0.0, 1.0 - 1e9 * sum(max(number, 0.0) for number in numbers)]])]


def test_a_network_of_onnx_reads_its_inputs_by_their_names(tmp_path, monkeypatch):
    """The same network as the one that `policy` has without weights."""
    monkeypatch.setattr("scenarios.onnx_rule.session", lambda path: Session())
    (tmp_path / "policy.onnx").write_bytes(b"")
    scenario = game().with_({"horizon": 2.0})
    rule = OnnxRule(model=str(tmp_path / "policy.onnx"), schedule=ROUNDS)
    results = [run(scenario.with_({"protocol": protocol}), 3) for protocol in (rule, Policy(schedule=ROUNDS))]
    assert list(results[0].trace) == list(results[1].trace)


def test_a_network_that_was_trained_again_is_read_again(tmp_path, monkeypatch):
    runtime = SimpleNamespace(SessionOptions=SimpleNamespace, InferenceSession=lambda path, _: [Path(path).read_text()])
    monkeypatch.setitem(sys.modules, "onnxruntime", runtime)
    monkeypatch.setattr("scenarios.onnx_rule.find_spec", lambda name: name)
    file = tmp_path / "policy.onnx"
    file.write_text("first")
    first = session(str(file))
    assert session(str(file)) is first
    file.write_text("second")
    assert (first, session(str(file))) == (["first"], ["second"])


def test_a_file_that_is_no_such_network_is_refused(tmp_path, monkeypatch):
    network = Session()
    network.get_modelmeta = lambda: SimpleNamespace(custom_metadata_map={})
    monkeypatch.setattr("scenarios.onnx_rule.session", lambda path: network)
    with pytest.raises(KeyedError, match=r"model: policy.onnx does not name its inputs"):
        OnnxRule(model="policy.onnx")
    monkeypatch.undo()
    monkeypatch.setattr("scenarios.onnx_rule.find_spec", lambda name: None)
    with pytest.raises(KeyedError, match="onnxruntime is missing: pip install onnxruntime"):
        OnnxRule(model=str(tmp_path / "absent.onnx"))
