"""Copies of models with other values are validated like new ones, in every class; `copy.replace` makes such a copy."""

import copy
import pickle
import sys

import pytest
from pydantic import ConfigDict

from desim.config.errors import KeyedError
from desim.config.model import Value
from desim.kernel.models.latency import Lognormal, Uniform
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.scenario.players import Team
from desim.scenario.scenario import Scenario
from desim.simulation.run import run
from tests.models import MODELS, NEEDED, made

VALUES = (True, 0, 2, 0.5, -1, "a", [1, 2], {"kind": "a"}, None)


def outcome(make) -> object:
    """Return an object, or where its arguments are refused and why."""
    try:
        return make()
    except ValueError as error:
        return str(error)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("model", MODELS, ids=lambda model: f"{model.__module__.rpartition('.')[2]}.{model.__name__}")
def test_a_copy_is_what_the_same_arguments_make_and_is_refused_where_they_are(model):
    original = made(model)
    for name in model.model_fields:
        for value in VALUES:
            copied = outcome(lambda name=name, value=value: original.model_copy(update={name: value}))
            assert copied == outcome(lambda name=name, value=value: made(model, {name: value})), (name, value)
    assert original == made(model)
    assert original.model_copy() == original.model_copy(deep=True) == original.model_copy(update={}) == original


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_a_field_that_does_not_exist_is_refused_with_what_may_be_meant(model):
    name = max(model.model_fields, key=len, default="")
    meant = f", did you mean '{name}'" if name else ""
    with pytest.raises(ValueError, match=f"unknown key{meant}"):
        made(model).model_copy(update={f"{name}x": 1})
    with pytest.raises(ValueError, match=f"unknown key{meant}"):
        model(**{f"{name}x": 1})


def test_a_model_is_validated_to_itself_and_what_is_neither_a_model_nor_a_table_is_refused():
    """Also where the model has a validator of its own for what is given."""
    models = [model for model in MODELS if len(model.__pydantic_decorators__.model_validators) > 1]
    assert len(models) > 5
    for model in models:
        original = made(model)
        assert model.model_validate(original) is original
        with pytest.raises(ValueError):
            model.model_validate(object())


def test_tables_become_models_and_fields_that_contradict_each_other_are_refused():
    scenario = Scenario(team=Team(count=3, speeds=(1.0, 2.0, 3.0)))
    assert scenario.model_copy(update={"network": {"latency": 0.5}}).network == Links(latency=0.5)
    with pytest.raises(KeyedError, match="should be one per pursuer: count is 5, there are 3"):
        scenario.team.model_copy(update={"count": 5})
    with pytest.raises(KeyedError, match=r"there is no pursuer 7: they are 0 \.\. 2"):
        scenario.model_copy(update={"fault": [{"kind": "crash", "node": 7, "start": 1.0}]})


def test_what_followed_from_a_field_follows_anew():
    """The wifi preset has an access latency; nothing of it stays, but the loss that was given."""
    wifi = Links(preset="wifi", loss=0.1)
    assert wifi.model_copy(update={"preset": "lora_sf7"}) == Links(preset="lora_sf7", loss=0.1)
    assert wifi.model_copy(update={"range": 5.0}) == Links(preset="wifi", loss=0.1, range=5.0)
    assert wifi.model_copy(update={"preset": None}) == Links(loss=0.1)
    pair = Team(positions=((0.0, 0.0), (1.0, 1.0)))
    assert pair.model_copy(update={"positions": [(0.0, 0.0)]}) == Team(positions=((0.0, 0.0),))
    assert pair.model_copy(update={"active_at_start": 0.5}).count == 2


def test_what_was_given_is_known_of_a_copy():
    copied = Scenario(horizon=2.0).model_copy(update={"seed": 0})
    assert copied.model_fields_set == {"horizon", "seed"}


def test_a_deep_copy_shares_nothing_with_the_original():
    original = Scenario(network=Links(latency=Uniform(low=0.1, high=0.2)))
    copied = original.model_copy(update={"horizon": 2.0}, deep=True)
    assert copied.network == original.network
    assert copied.network is not original.network
    assert original.model_copy(update={"horizon": 2.0}).network is original.network


class Open(Value):
    """A model of a user that takes any key."""

    model_config = ConfigDict(extra="allow")

    gain: float = 1.0


def test_a_model_that_takes_any_key_takes_any_in_a_copy():
    copied = Open(gain=2.0, colour="red").model_copy(update={"size": 3})
    assert copied == Open(gain=2.0, colour="red", size=3)


@pytest.mark.skipif(sys.version_info < (3, 13), reason="copy.replace is new in Python 3.13")
def test_copy_replace_validates_too():
    assert copy.replace(Bernoulli(p=0.1), p=0.2) == Bernoulli(p=0.2)
    with pytest.raises(ValueError, match="less than or equal to 1"):
        copy.replace(Bernoulli(p=0.1), p=2.0)


def test_the_method_on_which_copy_replace_relies_validates_too():
    with pytest.raises(KeyedError, match="less than or equal to 1"):
        Bernoulli(p=0.1).__replace__(p=2.0)


def test_needed_arguments_are_those_of_classes():
    assert NEEDED.keys() <= {model.__name__ for model in MODELS}


class InMilliseconds(Lognormal):
    def __init__(self, ms=100.0):
        super().__init__(mean=ms / 1000.0)


class Converting(Lognormal):
    """Takes the mean in another unit than that of the key."""

    def __init__(self, mean=100.0, **keys):
        super().__init__(mean=mean / 1000.0, **keys)


class Passing(Lognormal):
    def __init__(self, **keys):
        super().__init__(**{"mean": 0.2} | keys)


def test_a_class_with_an_init_of_its_own_is_copied_if_it_takes_its_keys():
    assert Passing(cv=0.3).model_copy(update={"mean": 0.5}) == Passing(cv=0.3, mean=0.5)
    other = r"InMilliseconds has its own __init__, which takes other arguments \(.*'mean'\): give another InMilli"
    changes = "mean: cannot be set: Converting has its own __init__, which changes mean: give another Converting"
    scenario = Scenario(network=Links(latency=InMilliseconds(200.0)))
    for act, why in (
        (lambda: InMilliseconds().model_copy(update={"mean": 0.3}), other),
        (lambda: scenario.with_({"network.latency.mean": 0.3}), other),
        (lambda: Converting().model_copy(update={"mean": 0.3}), changes),
        (lambda: Converting().model_copy(update={"cv": 0.3}), changes.replace("mean", "cv", 1)),
    ):
        with pytest.raises(ValueError, match=why):
            act()


class Prepared(Lognormal):
    """Sets an attribute besides its keys, as frozen classes do."""

    def model_post_init(self, _):
        object.__setattr__(self, "table", [self.mean] * 3)

    def __call__(self, context, rng):
        self.table.append(0.0)
        return self.table[0]


def test_attributes_besides_the_keys_stay_in_copies_and_in_runs():
    prepared = Prepared(mean=0.25)
    for copied in (pickle.loads(pickle.dumps(prepared)), copy.deepcopy(prepared), prepared.model_copy(deep=True)):
        assert copied.table == [0.25] * 3
        assert copied.table is not prepared.table
    scenario = Scenario(team=Team(count=2), horizon=0.5, network=Links(latency=prepared))
    assert len({str(run(scenario, seed=1).trace.events) for _ in range(2)}) == 1
    assert prepared.table == [0.25] * 3
