"""`Scenario.with_`: a scenario with other values of some keys, checked as `--set` checks those of a file."""

import re
from dataclasses import InitVar, dataclass
from fractions import Fraction
from functools import partial
from typing import Any

import attrs
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from desim.kernel.models.faults import Crash
from desim.kernel.models.latency import Constant, Uniform
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli, GilbertElliott
from desim.scenario.overrides import ScenarioError, Source
from desim.scenario.players import Team
from desim.scenario.scenario import Recording, Scenario
from desim.scenario.toml import load
from desim.study.plan.configurations import configurations
from protocols.cbba import CBBA

BASE = Scenario(team=Team(count=3), horizon=2.0, fault=(Crash(node=1, start=0.5),))


def still(me):
    yield me.sleep(1.0)


def half(result):
    return 0.5


CHANGES = {
    "a number": ({"network.latency.value": 0.5}, {"network": Links(latency=0.5)}),
    "several": ({"network.latency": 0.5, "team.count": 8}, {"network": Links(latency=0.5), "team": Team(count=8)}),
    "a kind": ({"network.latency.kind": "uniform"}, {"network": Links(latency=Uniform())}),
    "a kind and its key": (
        {"network.latency.kind": "uniform", "network.latency.high": 0.2},
        {"network": Links(latency=Uniform(high=0.2))},
    ),
    "a table": ({"network.latency": {"kind": "uniform", "high": 0.2}}, {"network": Links(latency=Uniform(high=0.2))}),
    "a model": ({"network.loss": GilbertElliott(share=0.1)}, {"network": Links(loss=GilbertElliott(share=0.1))}),
    "a key of a model": (
        {"network.loss": Bernoulli(p=0.1), "network.loss.p": 0.2},
        {"network": Links(loss=Bernoulli(p=0.2))},
    ),
    "an item of a default": ({"team.box.1": 50.0}, {"team": Team(count=3, box=(0.0, 50.0))}),
    "an item": ({"fault.0.start": 1.0}, {"fault": (Crash(node=1, start=1.0),)}),
    "a protocol": ({"protocol": "cbba"}, {"protocol": CBBA()}),
    "a function": ({"protocol": still}, {"protocol": still}),
    "metrics": ({"record.metrics": [half]}, {"record": Recording(metrics=(half,))}),
    "a preset": ({"network.preset": "wifi"}, {"network": Links(preset="wifi")}),
    "positions": ({"team": Team(positions=[(0.0, 0.0)] * 3)}, {"team": Team(positions=np.zeros((3, 2)))}),
    "numpy": ({"team.speeds": np.arange(1, 4)}, {"team": Team(count=3, speeds=(1.0, 2.0, 3.0))}),
    "an integer of numpy": ({"team.count": np.int64(4)}, {"team": Team(count=4)}),
    "pandas": ({"team.speeds": pd.Series([1, 2, 3])}, {"team": Team(count=3, speeds=(1.0, 2.0, 3.0))}),
    "a fraction": ({"horizon": Fraction(1, 2)}, {"horizon": 0.5}),
    "nothing": ({}, {}),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_is_what_the_same_arguments_make(name):
    changes, fields = CHANGES[name]
    before = BASE.model_dump_json()
    assert BASE.with_(changes) == BASE.model_copy(update=fields)
    assert BASE.model_dump_json() == before


WRONG = {
    "horizn": (3.0, "horizn: unknown key, did you mean 'horizon'?"),
    "network.latenc.value": (0.5, "network.latenc: unknown key, did you mean 'latency'?"),
    "network.latency.kind": ("unifrm", "network.latency.kind: there is no 'unifrm', did you mean 'uniform'?"),
    "network.latency.high": (
        1.0,
        "network.latency.high: unknown key, it is one of the kind uniform; allowed",
    ),
    "team.count": ("many", "team.count: should be an integer"),
    "team.speeds": (np.ones(2), "team.speeds: should be one per pursuer: count is 3, there are 2"),
    "horizon": (np.True_, "horizon: should be a number"),
    "fault.1.start": (1.0, "fault.1.start is not a key of a table"),
    "fault.0.node": (7, "fault.0.node: there is no pursuer 7"),
}


@pytest.mark.parametrize("key", WRONG)
def test_a_wrong_change_is_refused_with_what_may_be_meant(key):
    value, why = WRONG[key]
    with pytest.raises(ScenarioError, match=f"^with_: {re.escape(why)}"):
        BASE.with_({key: value})


def test_all_errors_are_listed():
    with pytest.raises(ScenarioError) as refused:
        BASE.with_({"horizon": -1.0, "seed": -1, "evader.speed": "fast"})
    assert [line.split(": ")[1] for line in str(refused.value).splitlines()] == ["evader.speed", "horizon", "seed"]


@pytest.mark.parametrize("key", ["", "a..b", ".", 3, None, ("team", "count")])
def test_what_is_no_dotted_key_is_refused(key):
    with pytest.raises(ScenarioError, match=r"a dotted key is for instance network\.latency\.value"):
        BASE.with_({key: 1})


@pytest.mark.slow
@given(
    st.dictionaries(
        st.sampled_from(["horizon", "seed", "team.count", "network.latency.value", "network.loss.p", "evader.speed"]),
        st.one_of(st.integers(-1, 5), st.floats(-0.5, 2.0), st.sampled_from(["a", "inf"])),
        max_size=3,
    )
)
def test_it_agrees_with_set(tmp_path_factory, changes):
    """The same scenario as of a file with --set, or the same errors, apart from where the key was set."""
    file = tmp_path_factory.mktemp("with") / "f.toml"
    file.write_text("team.count = 3\nhorizon = 2.0\nfault = [{ kind = 'crash', node = 1, start = 0.5 }]\n")

    origin = re.compile(r"^(--set \S+|with_|the scenario|\S+f\.toml:\d+): ")

    def outcome(make):
        try:
            return make()
        except ScenarioError as error:
            return sorted(origin.sub("", line) for line in str(error).splitlines())

    texts = [f'{key}="{value}"' if isinstance(value, str) else f"{key}={value}" for key, value in changes.items()]
    assert outcome(lambda: BASE.with_(changes)) == outcome(lambda: load(file, texts))


def test_a_latency_of_a_number_can_be_varied_further():
    assert BASE.with_({"network.latency": 0.5}).with_({"network.latency.value": 0.1}).network.latency == Constant(
        value=0.1
    )


def test_a_table_and_what_is_changed_in_it_may_come_in_any_order():
    changes = {"network.loss": 0.2, "network": Links(latency=0.1), "team.count": 3}
    one, other = Scenario().with_(changes), Scenario().with_(dict(reversed(changes.items())))
    assert one == other
    assert one.network == Links(latency=0.1, loss=0.2)


@pytest.mark.parametrize("kind", [list, tuple])
def test_what_the_caller_gives_stays_as_it_is_when_a_part_of_it_is_changed(kind):
    speeds, faults = [1.0, 2.0, 3.0], kind([{"kind": "crash", "node": 1, "start": 1.0}])
    changed = BASE.with_({"team.speeds": speeds, "team.speeds.0": 9.0, "fault": faults, "fault.0.start": 1.5})
    assert changed.team.speeds == (9.0, 2.0, 3.0)
    assert changed.fault == (Crash(node=1, start=1.5),)
    assert (speeds, faults) == ([1.0, 2.0, 3.0], kind([{"kind": "crash", "node": 1, "start": 1.0}]))


def test_the_scenario_itself_stays_as_it_is_when_a_key_of_its_grid_is_added():
    scenario = BASE.with_({"sweep.grid": {"team.count": [3, 4]}})
    changed = scenario.with_({"sweep.grid.horizon": [1.0]})
    assert scenario.sweep.grid == {"team.count": (3, 4)}
    assert changed.sweep.grid == {"team.count": (3, 4), "horizon": (1.0,)}


def test_a_point_of_a_sweep_keeps_a_table_of_which_the_grid_changes_a_key_too():
    grid = {"fault": [[{"kind": "crash", "node": 1, "start": 0.0}]], "fault.0.start": [0.5, 1.0]}
    points = configurations(Source.of(BASE.with_({"sweep.grid": grid})))
    assert [point.settings["fault"] for point in points] == [*grid["fault"], *grid["fault"]]
    assert [point.scenario.fault[0].start for point in points] == grid["fault.0.start"]


def test_the_method_copy_validates_as_model_copy_does():
    with pytest.raises(ValueError, match="horizon: should be greater than 0"):
        Scenario().copy(update={"horizon": -5.0})
    assert Scenario().copy(update={"horizon": 5.0}) == Scenario(horizon=5.0)


@dataclass(frozen=True)
class Wave:
    mean: float = 0.1
    shape: Any = None

    def __call__(self, context, rng):
        return self.mean


@attrs.define
class Tide:
    mean: float = 0.1
    shape: Any = None

    def __call__(self, context, rng):
        return self.mean


class Swell(BaseModel):
    mean: float = 0.1
    shape: Any = None

    def __call__(self, context, rng):
        return self.mean


class Foam:
    def __init__(self, mean=0.1):
        self.mean = mean

    def __call__(self, context, rng):
        return self.mean


@pytest.mark.parametrize("kind", [Wave, Tide, Swell])
def test_what_an_object_of_a_user_was_made_from_are_keys(kind):
    """As in a file that names its class."""
    scenario = BASE.with_({"network.latency": kind(shape=Wave())})
    assert scenario.with_({"network.latency.mean": 0.5}).network.latency == kind(mean=0.5, shape=Wave())
    assert scenario.with_({"network.latency.shape.mean": 0.5}).network.latency.shape == Wave(0.5)
    assert scenario.network.latency.mean == 0.1
    with pytest.raises(
        ScenarioError, match=r"network.latency.maen: unknown key, did you mean 'mean'\?; allowed: mean, shape"
    ):
        scenario.with_({"network.latency.maen": 0.5})


@dataclass(frozen=True)
class Ripple(Wave):
    scale: InitVar[float] = 1.0

    def __post_init__(self, scale):
        object.__setattr__(self, "scaled", scale * self.mean)


def test_what_an_object_does_not_keep_of_how_it_was_made_is_not_reset():
    scenario = BASE.with_({"network.latency": Ripple(scale=5.0)})
    with pytest.raises(ScenarioError, match=r"network.latency.mean: cannot be set: Ripple does not keep scale"):
        scenario.with_({"network.latency.mean": 0.5})


def test_an_object_without_known_parameters_has_no_keys():
    for model in (Foam(), partial(Foam.__call__, Foam())):
        scenario = BASE.with_({"network.latency": model})
        with pytest.raises(
            ScenarioError, match=r"network.latency: \w+ has no key 'mean': give another one, or make it a"
        ):
            scenario.with_({"network.latency.mean": 0.5})


def test_an_index_of_thousands_of_digits_is_not_a_key():
    with pytest.raises(ScenarioError, match=r"is not a key of a table$"):
        BASE.with_({f"fault.{'9' * 5000}.start": 1.0})
