"""Learned rules: the network, the file of weights, and the names of its features."""

import json
from math import tanh

import numpy as np
import pytest

from desim import Evader, Scenario, Team, load, run
from desim.config.errors import KeyedError
from desim.kernel.core.trace_file import line_of
from desim.scenario.overrides import ScenarioError
from desim.study.plan.config_hash import identify
from protocols import Layer, LocalMin, Policy
from protocols.policy import SHARP, network

FEATURES = ("evader.lead", "evader.free", "evader.rivals", "evader.chosen", "evader.late")


def small(protocol, evader=None, **changes):
    return Scenario(
        horizon=3.0, team=Team(count=6, active_at_start=1.0), protocol=protocol, evader=evader or Evader()
    ).with_({"network.latency": 0.05, "network.loss": 0.1, "record.messages": True} | changes)


def lines(scenario, seed=3):
    return list(map(line_of, run(scenario, seed).trace))


@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_a_network_is_its_formula(activation):
    rng = np.random.default_rng(1)
    first, second = rng.normal(size=(4, 3)), rng.normal(size=(2, 4))
    bias = rng.normal(size=4), rng.normal(size=2)
    layers = [Layer(weights=w.tolist(), bias=b.tolist()) for w, b in zip((first, second), bias, strict=True)]
    x = rng.normal(size=3)
    hidden = first @ x + bias[0]
    hidden = np.tanh(hidden) if activation == "tanh" else np.maximum(hidden, 0.0)
    assert network(layers, activation)(x.tolist()) == pytest.approx((second @ hidden + bias[1]).tolist())


@pytest.mark.parametrize("lead", [-3.0, -1e-6, 0.0, 1e-6, 0.5, 3.0])
@pytest.mark.parametrize("late", [-2.0, -1e-6, 0.0, 1e-6, 0.25, 2.0])
def test_the_score_without_weights_is_positive_for_who_is_first_and_in_time(lead, late):
    (score,) = network(Policy().layers, Policy().activation)([lead, late])
    assert score == pytest.approx(1.0 - 1e9 * max(lead, 0.0) - 1e9 * max(late, 0.0))
    assert (score > 0.0) == (lead <= 0.0 and late <= 0.0)


def test_without_weights_it_is_local_min():
    """On a complete graph and with one evader, local_min asks no more than who is first and in time."""
    assert lines(small(Policy())) == lines(small(LocalMin()))
    assert lines(small(Policy(features=("own.x",), layers=(Layer(weights=((0.0,),), bias=(1.0,)),)))) != lines(
        small(LocalMin())
    )


def test_scores_of_all_actions_and_scores_of_each_chase_agree():
    """Two evaders: the scores 0, s_1, s_2 by one network, or s_j by one that is evaluated for each evader."""
    evaders = Evader(), Evader(speed=0.5)
    each = Policy()
    names = tuple(name.replace("evader", f"evader_{j}") for j in (1, 2) for name in Policy().features)
    hidden = tuple(tuple(SHARP * (i == j) for i in range(4)) for j in range(4))
    scores = (0.0,) * 4, (-1.0, -1.0, 0.0, 0.0), (0.0, 0.0, -1.0, -1.0)
    layers = Layer(weights=hidden, bias=(0.0,) * 4), Layer(weights=scores, bias=(0.0, 1.0, 1.0))
    together = Policy(features=names, layers=layers, activation="relu")
    assert lines(small(each, evader=evaders)) == lines(small(together, evader=evaders))


def test_the_block_of_the_only_pursuer_is_its_own():
    """It chases if it is inactive, and the other way round."""
    turns = (Layer(weights=((-2.0,),), bias=(1.0,)),)
    own, named = (
        lines(small(Policy(features=(f"{block}.action",), layers=turns), **{"team.count": 1}))
        for block in ("own", "pursuer_0")
    )
    assert own == named
    assert sum('"Decided"' in line for line in named) > 5


def test_a_file_of_weights_is_the_rule(tmp_path):
    policy = Policy(features=FEATURES, layers=(Layer(weights=((-2.0, 1.0, -0.5, 0.1, -2.0),), bias=(-0.1,)),))
    policy.write(tmp_path / "weights.json")
    (tmp_path / "a.toml").write_text('[protocol]\nkind = "policy"\nfile = "weights.json"\n')
    scenario = load(tmp_path / "a.toml")
    assert scenario.protocol == policy
    assert lines(scenario.with_({"horizon": 0.3})) == lines(Scenario(horizon=0.3, protocol=policy, name="a"))


def test_weights_are_part_of_the_identity_of_a_run(tmp_path):
    """The file may change or go afterwards: a scenario has the weights."""
    hashes = []
    for bias in (1.0, 1.0, -1.0):
        Policy(features=("own.x",), layers=(Layer(weights=((0.0,),), bias=(bias,)),)).write(tmp_path / "w.json")
        scenario = Scenario(protocol=Policy(file=str(tmp_path / "w.json")))
        (tmp_path / "w.json").unlink()
        hashes.append(identify(scenario).key)
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("own_1.x", "names are own.FIELD"),
        ("pursuer.age", "names are own.FIELD"),
        ("evader_01.lead", "names are own.FIELD"),
        ("foo.x", "names are own.FIELD"),
        ("x", "names are own.FIELD"),
        ("evader.lad", "did you mean 'lead'"),
        ("pursuer_0.agee", "did you mean 'age'"),
    ],
)
def test_names_of_features_are_checked(name, why):
    with pytest.raises(KeyedError, match=f"there is no feature '{name}'.*{why}"):
        Policy(features=(name,), layers=(Layer(weights=((1.0,),), bias=(0.0,)),))


@pytest.mark.parametrize("name", ["evader_2.lead", "evader_0.lead", "pursuer_6.age"])
def test_features_have_to_exist_in_the_game(name):
    policy = Policy(features=(name,), layers=(Layer(weights=((1.0,),), bias=(0.0,)),))
    with pytest.raises(
        KeyedError, match=f"protocol.features: there is no '{name}' in this game .pursuers: 6, evaders: 1"
    ):
        small(policy)


def test_scores_have_to_be_those_of_the_actions():
    policy = Policy(features=("evader_1.lead",), layers=(Layer(weights=((1.0,),) * 3, bias=(0.0,) * 3),))
    with pytest.raises(KeyedError, match=r"protocol.layers: the last layer should have 1 output, or 2, .* has 3"):
        small(policy)
    with pytest.raises(KeyedError, match=r"'evader.lead' has no number"):
        Policy(features=("evader.lead",), layers=(Layer(weights=((1.0,),) * 2, bias=(0.0,) * 2),))


GOOD = {"features": ["own.x"], "layers": [{"weights": [[1.0]], "bias": [0.0]}]}


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("no json", "is not JSON"),
        ('{"features": ["own.x"], "features": ["own.y"], "layers": []}', "an object has 'features' twice"),
        ("[1]", "should have an object with the keys features, layers, activation"),
        ('{"features": ["own.x"]}', "has no layers"),
        (json.dumps(GOOD | {"layer": []}), "has an unknown key 'layer', did you mean 'layers'"),
        (json.dumps(GOOD | {"activation": "sigmoid"}), "activation"),
        (json.dumps(GOOD).replace("1.0", "NaN"), "NaN is no weight"),
        (json.dumps(GOOD).replace("1.0", '"1"'), "layers.0.weights"),
        (json.dumps(GOOD).replace("[[1.0]]", "[[1.0], [1.0, 2.0]]"), "row 1 has 2 numbers, row 0 has 1"),
        (json.dumps(GOOD).replace("[[1.0]]", "[[]]"), "at least one number"),
        (json.dumps(GOOD).replace("[[1.0]]", "[[1.0, 2.0]]"), "layer 0 has 2 inputs, but there are 1 features"),
        (json.dumps(GOOD).replace("[0.0]", "[0.0, 1.0]"), "bias should have a number for each of 1 row, has 2"),
        ("[" * 100_000, "is not JSON"),
        (json.dumps(GOOD).replace("own.x", "own.y1"), "there is no feature 'own.y1', did you mean 'y'"),
        (json.dumps(GOOD).replace("1.0", "1e300"), "layers.0.weights.0.0: should be less than or equal"),
        (json.dumps(GOOD | {"layers": GOOD["layers"][0]}), "layers: should be a list of tables"),
    ],
)
def test_a_file_that_is_wrong_is_refused(content, why, tmp_path):
    (tmp_path / "w.json").write_text(content)
    (tmp_path / "a.toml").write_text('[protocol]\nkind = "policy"\nfile = "w.json"\n')
    with pytest.raises(ScenarioError, match=rf"a.toml:3: protocol.file: \S*w.json.*{why}"):
        load(tmp_path / "a.toml")
    with pytest.raises(KeyedError, match=rf"Policy: file: \S*w.json.*{why}"):
        Policy(file=str(tmp_path / "w.json"))


@pytest.mark.parametrize(
    ("table", "why"),
    [
        ("features = ['own.x']", "should have features and layers, both of them or in a file"),
        ("layers = []", "should have features and layers, both of them or in a file"),
        ('file = "no.json"', "no.json cannot be read"),
        ('file = "../w.json"', "leads out of the folder"),
        ('file = "w.json"\nfeatures = ["own.x"]', "should have a file or features, not both"),
    ],
)
def test_a_table_that_is_wrong_is_refused(table, why, tmp_path):
    (tmp_path / "w.json").write_text(json.dumps(GOOD))
    (tmp_path / "a.toml").write_text(f'[protocol]\nkind = "policy"\n{table}\n')
    with pytest.raises(ScenarioError, match=why):
        load(tmp_path / "a.toml")


def test_tanh_is_that_of_python():
    layers = [Layer(weights=((1.0,),), bias=(0.0,)), Layer(weights=((1.0,),), bias=(0.0,))]
    assert network(layers, "tanh")([0.3]) == [tanh(0.3)]


@pytest.mark.parametrize(("weight", "is_taken"), [(1e12, True), (-1e12, True), (1.1e12, False), (-1.1e12, False)])
def test_weights_are_at_most_a_million_million(weight, is_taken):
    """The sum of products of a layer stays finite."""
    if is_taken:
        Layer(weights=((weight,),), bias=(weight,))
        return
    for layer in ({"weights": ((weight,),), "bias": (0.0,)}, {"weights": ((0.0,),), "bias": (weight,)}):
        with pytest.raises(ValueError, match="1000000000000"):
            Layer(**layer)
