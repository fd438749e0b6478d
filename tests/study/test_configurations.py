"""The configurations of a grid: their contents, refusals with their messages, and what distinguishes them."""

import re
import subprocess
import sys
import threading
from dataclasses import FrozenInstanceError, dataclass
from functools import partial
from math import inf
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import LatencyTrace, LossTrace, SignalTrace
from desim.config.model import Value
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.scenario.overrides import ScenarioError, Source
from desim.scenario.players import Team
from desim.scenario.scenario import Scenario
from desim.scenario.sweep_table import Sweep
from desim.scenario.toml import load, read_source
from desim.study.plan import configurations as module
from desim.study.plan.config_hash import identify
from desim.study.plan.configurations import configurations, label
from protocols.best_response import BestResponse
from protocols.rule import Rule
from protocols.sap import SpatialAdaptivePlay
from protocols.temperature import ConstantTau, PaperTau

BASE = 'horizon = 1.0\nteam.count = 2\nnetwork.latency = { kind = "constant", value = 0.02 }\n'


class Warmth(Value):
    """A temperature that is not installed."""

    kind: Literal["warmth"] = "warmth"
    level: float = 0.5

    def __call__(self, eta):
        return self.level


class Own(Rule):
    """A protocol that is not installed, with a part that is not either."""

    kind: Literal["own"] = "own"
    gain: float = 1.0
    warmth: Warmth = Warmth()

    def actions(self, me):
        yield True


def chase(me, *_):
    return iter(())


def wait(me):
    return iter([])


class Plain:
    """A protocol that is no model."""

    def __init__(self, gain):
        self.gain = gain

    def __call__(self, me):
        return iter(())


def config_hash(scenario):
    return identify(scenario).key


def of(grid, scenario=None):
    """Return the configurations of a grid over a scenario of a script."""
    return configurations(Source.of(scenario or Scenario(horizon=1.0, team=Team(count=2))), grid)


@pytest.fixture
def refused(tmp_path):
    """Return a function that returns what is wrong with the grid of a file, and where, line by line."""

    def lines(text: str, base: str = BASE) -> list[str]:
        path = tmp_path / "f.toml"
        path.write_text(f"{base}[sweep.grid]\n{text}\n")
        with pytest.raises(ScenarioError) as error:
            configurations(read_source(path))
        return str(error.value).replace(str(path), "f").splitlines()

    return lines


# What a grid is.


def test_each_combination_is_a_configuration_and_the_last_key_changes_fastest():
    found = of({"horizon": [1.0, 2.0], "network.range": [3.0, 4.0, inf]})
    settings = [(cell.settings["horizon"], cell.settings["network.range"]) for cell in found]
    assert settings == [(1.0, 3.0), (1.0, 4.0), (1.0, inf), (2.0, 3.0), (2.0, 4.0), (2.0, inf)]
    assert [(cell.scenario.horizon, cell.scenario.network.range) for cell in found] == settings
    assert len({cell.key for cell in found}) == 6


@pytest.mark.slow
@given(st.lists(st.floats(0.1, 9.0), min_size=1, max_size=3, unique=True), st.booleans())
def test_a_configuration_is_the_scenario_that_one_would_write(values, frozen):
    found = of({"horizon": values, "motion.static": [frozen]})
    assert [cell.scenario for cell in found] == [
        Scenario(horizon=each, team=Team(count=2), motion={"static": frozen}) for each in values
    ]


def test_the_grid_of_a_file_is_that_of_a_script(tmp_path):
    path = tmp_path / "f.toml"
    path.write_text(f'{BASE}[sweep.grid]\n"network.latency.value" = [0.0, 0.1]\nnetwork.range = [4.0, inf]\n')
    grid = {"network.latency.value": [0.0, 0.1], "network.range": [4.0, inf]}
    scenario = Scenario(horizon=1.0, team=Team(count=2), network=Links(latency=Constant(value=0.02)))
    assert [cell.key for cell in configurations(read_source(path))] == [cell.key for cell in of(grid, scenario)]
    assert [cell.key for cell in configurations(read_source(path), {"network.range": [1.0]})] == [
        cell.key for cell in of({"network.range": [1.0]}, scenario)
    ]


def test_a_grid_that_is_given_replaces_that_of_the_scenario():
    scenario = Scenario(sweep=Sweep(grid={"horizon": [1.0, 2.0]}))
    assert [dict(cell.settings) for cell in of(None, scenario)] == [{"horizon": 1.0}, {"horizon": 2.0}]
    assert [dict(cell.settings) for cell in of({"team.count": [3]}, scenario)] == [{"team.count": 3}]
    assert scenario.sweep.grid == {"horizon": (1.0, 2.0)}


def test_a_configuration_holds_no_sweep():
    """Or what is swept would travel to the workers with every run."""
    (cell,) = of({"horizon": [2.0]}, Scenario(sweep=Sweep(reps=5)))
    assert cell.scenario.sweep == Sweep()


NUMBERS = {
    "linspace": np.linspace(0.5, 1.5, 3),
    "list of numpy's": list(np.linspace(0.5, 1.5, 3)),
    "float32": np.array([0.5, 1.0, 1.5], dtype=np.float32),
    "tuple": (0.5, 1.0, 1.5),
    "generator": (each / 2.0 for each in (1, 2, 3)),
}


@pytest.mark.parametrize("values", NUMBERS.values(), ids=NUMBERS)
def test_numbers_of_numpy_and_lists_of_any_kind_are_those_of_python(values):
    found = of({"horizon": values})
    assert [cell.key for cell in found] == [cell.key for cell in of({"horizon": [0.5, 1.0, 1.5]})]
    assert [cell.columns for cell in found] == [{"horizon": 0.5}, {"horizon": 1.0}, {"horizon": 1.5}]
    assert {type(cell.columns["horizon"]) for cell in found} == {float}


@pytest.mark.parametrize("counts", [range(1, 4), np.arange(1, 4), [np.int64(1), np.int32(2), 3]], ids=str)
def test_integers_of_numpy_and_ranges_are_integers(counts):
    found = of({"team.count": counts})
    assert [cell.columns["team.count"] for cell in found] == [1, 2, 3]
    assert {type(cell.columns["team.count"]) for cell in found} == {int}
    assert [cell.key for cell in found] == [cell.key for cell in of({"team.count": [1, 2, 3]})]


def test_truths_points_and_tables_may_hold_what_numpy_makes():
    (cell,) = of({"motion.static": [np.bool_(True)], "team.positions": np.zeros((1, 2, 2))})
    assert cell.scenario.motion.static is True
    assert cell.scenario.team.positions == ((0.0, 0.0), (0.0, 0.0))
    (cell,) = of({"network.latency": [{"kind": "constant", "value": np.float64(0.5)}]})
    assert cell.scenario.network.latency == Constant(value=0.5)
    assert cell.columns == {"network.latency": "constant(value=0.5)"}
    (cell,) = of({"team": [{"count": np.int64(2), "speeds": [np.float32(1.0), np.float32(2.0)]}]})
    assert cell.scenario.team == Team(count=2, speeds=(1.0, 2.0))
    (cell,) = of({"fault": [({"kind": "crash", "node": np.int64(1), "start": 0.5},)]})
    assert cell.scenario.fault[0].node == 1


def test_kinds_and_tables_are_swept_like_numbers():
    kinds = of({"protocol.kind": ["sap", "best_response"]})
    tables = of({"protocol": [{"kind": "sap"}, {"kind": "best_response"}]})
    objects = of({"protocol": [SpatialAdaptivePlay(), BestResponse()]})
    assert [cell.key for cell in kinds] == [cell.key for cell in tables] == [cell.key for cell in objects]
    assert [cell.columns["protocol"] for cell in tables] == ["sap", "best_response"]
    assert [cell.columns["protocol"] for cell in objects] == ["sap", "best_response"]


def test_items_of_lists_are_swept():
    fault = ({"kind": "crash", "node": 0, "start": 0.5}, {"kind": "crash", "node": 1, "start": 0.6})
    scenario = Scenario(horizon=1.0, team=Team(count=2), fault=fault)
    found = of({"fault.1.start": [0.1, 0.2]}, scenario)
    assert [[each.start for each in cell.scenario.fault] for cell in found] == [[0.5, 0.1], [0.5, 0.2]]


PRESETS = {"network.preset": ["wifi", "lora_sf7"], "network.range": [4.0, inf]}


def test_a_preset_is_swept_from_a_script():
    found = of(PRESETS, Scenario(network=Links(preset="wifi")))
    assert [cell.scenario.network for cell in found] == [
        Links(preset=preset, range=reach) for preset in PRESETS["network.preset"] for reach in PRESETS["network.range"]
    ]


def test_a_preset_is_swept_from_a_file(tmp_path):
    path = tmp_path / "f.toml"
    path.write_text('[network]\npreset = "wifi"\n[sweep.grid]\nnetwork.preset = ["wifi", "lora_sf7"]\n')
    assert [cell.scenario.network for cell in configurations(read_source(path))] == [
        Links(preset="wifi"),
        Links(preset="lora_sf7"),
    ]


@pytest.mark.slow
def test_functions_and_models_that_are_not_installed_are_swept_and_set_inside():
    found = of({"protocol": [Own(), chase], "horizon": [1.0, 2.0]})
    assert [cell.scenario.protocol for cell in found] == [Own(), Own(), chase, chase]
    assert [cell.columns["protocol"] for cell in found] == ["own", "own", "chase", "chase"]
    scenario = Scenario(protocol=Own(gain=2.0))
    found = of({"protocol.gain": np.linspace(1.0, 2.0, 2), "protocol.warmth.level": [0.1, 0.2]}, scenario)
    assert [cell.scenario.protocol for cell in found] == [
        Own(gain=gain, warmth=Warmth(level=level)) for gain in (1.0, 2.0) for level in (0.1, 0.2)
    ]


# What is refused.


@pytest.mark.parametrize("grid", [{}, {"horizon": []}, {"horizon": 1.0}, {"prune": "inf"}, {"horizon": np.float64(1)}])
def test_a_grid_entry_that_is_not_a_list_is_refused_in_a_script(grid):
    with pytest.raises(ScenarioError, match=r"^the grid: sweep\.grid"):
        of(grid)


def test_a_table_that_would_replace_a_key_before_it_is_refused_and_the_other_order_is_not():
    grid = {"network.latency": [0.2, 0.3], "network.latency.value": [0.1]}
    with pytest.raises(ScenarioError, match="same configuration"):
        of(grid)  # the key replaces what the table has
    assert len(of({"protocol": ["sap", "local_min"], "protocol.schedule": ["poisson", "rounds"]})) == 4
    with pytest.raises(ScenarioError, match=r"network.latency: would replace network.latency.value: give network.lat"):
        of(dict(reversed(grid.items())))


def test_a_set_is_refused_for_it_has_no_order():
    with pytest.raises(ScenarioError, match=r"got the set .*, which has no order: give a list"):
        of({"prune": {"inf", "none"}})


def test_a_fault_that_has_no_line_comes_first(tmp_path):
    file = tmp_path / "f.toml"
    file.write_text("sweep.grid.horizon = [-1.0, 1.0]\n")
    with pytest.raises(ScenarioError) as refused:
        configurations(read_source(file, ["sweep.grid.team.count=[2, 0]"]))
    first, second = str(refused.value).splitlines()
    assert first.startswith("--set sweep.grid.team.count=[2, 0]: ")
    assert second.startswith(f"{file}:1: ")


def test_of_many_errors_the_first_are_reported(refused):
    lines = refused(f"horizon = {[-1.0 - k for k in range(30)]}")
    assert len(lines) == 21
    assert lines[-1] == "... and 10 more"


def test_values_that_conflict_with_other_keys_are_reported_with_the_settings(refused):
    base = BASE + 'fault = [{ kind = "crash", node = 1, start = 0.5 }]\n'
    (line,) = refused("horizon = [1.0, 2.0]\nteam.count = [2, 1]", base)
    assert line == "f:4: fault.0.node: there is no pursuer 1: they are 0 .. 0 (with team.count = 1)"


def test_a_default_that_is_spelt_out_is_the_same_configuration():
    with pytest.raises(
        ScenarioError, match=r"'protocol = sap\(tau=paper\)' is the same configuration as 'protocol = sap'"
    ):
        of({"protocol": [SpatialAdaptivePlay(), SpatialAdaptivePlay(tau=PaperTau())]})


def test_a_grid_of_too_many_configurations_is_refused_before_they_are_made():
    many = {f"k{k}": range(1000) for k in range(10)}
    with pytest.raises(ScenarioError, match=r"at most 100,000 configurations, has 1,000,000,000,000"):
        of(many)


@pytest.mark.slow
def test_values_with_equal_labels_in_tables_are_refused():
    with pytest.raises(ScenarioError, match=r"several configurations have the name 'protocol = Plain'"):
        of({"protocol": [Plain(1.0), Plain(2.0)]})


def test_objects_of_a_dataclass_have_the_names_of_their_fields():
    @dataclass
    class Late:
        seconds: float
        links: tuple[int, ...] = ()

        def __call__(self, context, rng):
            return self.seconds

    found = of({"network.latency": [Late(0.1), Late(0.2, (1, 2))]})
    assert [str(each) for each in found] == [
        "network.latency = Late(seconds=0.1, links=[])",
        "network.latency = Late(seconds=0.2, links=[1, 2])",
    ]


def test_the_label_of_a_measured_link_has_the_hash_of_its_table():
    """The texts differ in a line that a short label would leave out."""
    labels = [label(LatencyTrace(table=f"t,value\n0,0.1\n1,{value}\n", src=None, dst=None)) for value in (0.2, 0.3)]
    hashed = r"trace\(dst=none, src=none, table=a text with the hash [0-9a-f]{16}\)"
    assert all(re.fullmatch(hashed, each) for each in labels)
    assert labels[0] != labels[1]


# What distinguishes configurations.

SAME = Scenario(horizon=2.0, team=Team(count=3))
OTHERS = {
    "horizon": {"horizon": 2.5},
    "prune": {"prune": "none"},
    "team": {"team": Team(count=4)},
    "evader": {"evader": {"speed": 0.8}},
    "sensing": {"sensing": {"radius": 5.0}},
    "capture": {"capture": {"radius": 0.2}},
    "motion": {"motion": {"step": 0.02}},
    "environment": {"environment": {"flow": {"kind": "uniform", "velocity": [0.1, 0.0]}}},
    "clocks": {"clocks": {"sync": {"kind": "two_way"}}},
    "protocol": {"protocol": BestResponse()},
    "protocol's parameter": {"protocol": SpatialAdaptivePlay(tau=ConstantTau(value=0.3))},
    "announce": {"announce": {"heartbeat": 0.3}},
    "network": {"network": Links(range=3.0)},
    "fault": {"fault": ({"kind": "crash", "node": 0, "start": 1.0},)},
    "record": {"record": {"messages": True}},
    "wall": {"wall": [{"line": [[-9.0, 0.0], [-9.0, 1.0]]}]},
    "properties": {"properties": ("idle never longer than 2",)},
}


def test_the_fields_below_are_all_there_are():
    assert {next(iter(each)) for each in OTHERS.values()} | {"name", "seed", "sweep"} == set(Scenario.model_fields)


@pytest.mark.parametrize("change", OTHERS.values(), ids=OTHERS)
def test_everything_a_run_depends_on_distinguishes_configurations(change):
    given = {"horizon": 2.0, "team": Team(count=3)}
    assert config_hash(Scenario(**given | change)) != config_hash(SAME)


@pytest.mark.parametrize("change", [{"name": "x"}, {"seed": 9}, {"sweep": Sweep(reps=3, grid={"horizon": [chase]})}])
def test_name_seed_and_sweep_do_not_distinguish_configurations(change):
    assert config_hash(SAME.model_copy(update=change)) == config_hash(SAME)


def test_equal_configurations_of_a_file_and_a_script_have_equal_hashes(tmp_path):
    path = tmp_path / "f.toml"
    path.write_text("horizon = 2\nteam = { count = 3 }\n")
    assert config_hash(load(path)) == config_hash(SAME)


RULE = """
from desim.config.model import Value

class Mine(Value):
    kind: str = "mine"
    gain: float = 1.0
    def __call__(self, me):
        yield from self.turns(me)
    def turns(self, me):
        return iter(({0},))

def plain(me):
    return iter(({0},))
"""


def other_process(file: Path, seed: int) -> dict[str, str]:
    """Return the identity of a scenario with each of some protocols, as another process finds it."""
    script = (
        "import sys; from desim.scenario.toml import load; from desim.study.plan.config_hash import identify\n"
        "for kind in sys.argv[2:]:\n"
        "    print(identify(load(sys.argv[1], ['protocol.kind=' + kind], allow_import=True)).key)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(file), *KINDS],
        env={"PYTHONHASHSEED": str(seed), "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": ":".join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    return dict(zip(KINDS, done.stdout.split(), strict=True))


KINDS = ("mine_of_cells:Mine", "mine_of_cells:plain", "sap")


@pytest.mark.whole
def test_the_code_of_a_rule_beside_the_file_counts_and_is_the_same_in_every_process(tmp_path):
    (tmp_path / "f.toml").write_text(BASE)
    rule = tmp_path / "mine_of_cells.py"
    rule.write_text(RULE.format("1"))
    before = {
        kind: identify(load(tmp_path / "f.toml", [f"protocol.kind={kind}"], allow_import=True)).key for kind in KINDS
    }
    assert all(re.fullmatch(r"[0-9a-f]{16}", each) for each in before.values())
    assert other_process(tmp_path / "f.toml", 2) == before
    rule.write_text(RULE.format("2"))
    after = other_process(tmp_path / "f.toml", 1)
    assert [after[kind] == before[kind] for kind in KINDS] == [False, False, True]


def typed(text: str, name: str):
    """Return an object defined by a text without a source file, as at a prompt."""
    space = {"__name__": "__main__", "Value": Value}
    exec(text, space)
    return space[name]


def test_functions_typed_at_a_prompt_count_by_their_code():
    function = "def rule(me, gain={}):\n    x = {}\n    return iter((x,))"
    keys = [config_hash(Scenario(protocol=typed(function.format(*each), "rule"))) for each in [(1, 1), (1, 2), (3, 1)]]
    assert len(set(keys)) == 3
    assert config_hash(Scenario(protocol=typed(function.format(1, 1), "rule"))) == keys[0]
    model = 'class R(Value):\n    kind: str = "r"\n    def __call__(self, me):\n        return iter(({},))'
    keys = [config_hash(Scenario(protocol=typed(model.format(each), "R")())) for each in (1, 2, 1)]
    assert keys[0] == keys[2] != keys[1]


def made(gain):
    def rule(me):
        return iter((gain,))

    return rule


HELD = {
    "closure": (made(1.0), made(2.0)),
    "object": (Plain(1.0), Plain(2.0)),
    "partial": (partial(lambda gain, me: iter(()), 1.0), partial(lambda gain, me: iter(()), 2.0)),
    "partial's function": (partial(chase), partial(wait)),
    "lambdas of a line": (lambda me: iter((1,)), lambda me: iter((2,))),
    "default": (lambda me, gain=1.0: iter(()), lambda me, gain=2.0: iter(())),
    "model": (Own(gain=1.0), Own(gain=2.0)),
    "model inside": (SpatialAdaptivePlay(tau=Warmth(level=1.0)), SpatialAdaptivePlay(tau=Warmth(level=2.0))),
    "array": (made(np.array([0.1])), made(np.array([0.1 + 1e-9]))),
    "long array": (Plain(np.arange(2000)), Plain(np.where(np.arange(2000) == 9, 0, np.arange(2000)))),
    "object in a closure": (made(Plain(1.0)), made(Plain(2.0))),
    "object in an object": (Plain(Plain(1.0)), Plain(Plain(2.0))),
    "method": (Plain(1.0).__call__, Plain(2.0).__call__),
}


@pytest.mark.parametrize(("one", "other"), HELD.values(), ids=HELD)
def test_the_attributes_of_a_rule_in_a_script_distinguish_configurations(one, other):
    assert config_hash(Scenario(protocol=one)) != config_hash(Scenario(protocol=other))


def test_the_attributes_of_a_rule_in_a_script_do_not_depend_on_its_location():
    assert config_hash(Scenario(protocol=made(1.0))) == config_hash(Scenario(protocol=made(1.0)))
    one, other = made(made(1.0)), made(made(1.0))
    assert config_hash(Scenario(protocol=one)) == config_hash(Scenario(protocol=other))
    assert config_hash(Scenario(protocol=Plain(1.0))) == config_hash(Scenario(protocol=Plain(1.0)))


def test_it_counts_which_of_several_places_holds_what():
    """Of two links and three, with the same two models between them."""

    def latency(value):
        return lambda context, rng: value

    def of(*levels):
        links = [{"src": 0, "dst": k + 1, "latency": latency(level)} for k, level in enumerate(levels)]
        return config_hash(Scenario(team=Team(count=4), network=Links(link=links)))

    assert len({of(1.0, 2.0), of(2.0, 1.0), of(1.0, 2.0, 1.0), of(1.0, 2.0, 2.0)}) == 4


def test_indistinguishable_values_are_refused_with_their_key():
    lock = threading.Lock()
    with pytest.raises(ScenarioError, match=r"^evader\.strategy: has no stable hash: .*'_thread.lock'.*__getstate__"):
        config_hash(Scenario(evader={"strategy": lambda state, rng: lock}))


class Declaring(Plain):
    """A protocol that reads files, of which the names are no part of it."""

    files: ClassVar[object]  # without a value, which would be a constant of the code

    def depends_on(self):
        return Declaring.files


HOLDERS = {
    "model": lambda each: each,
    "partial": lambda each: partial(chase, each),
    "closure": made,
    "object": lambda each: Plain({"a": [each]}),
}


@pytest.mark.parametrize("hold", HOLDERS.values(), ids=HOLDERS)
def test_files_that_a_model_declares_count_by_their_content_wherever_it_is_held(tmp_path, monkeypatch, hold):
    for name, text in {"a/a": "1", "a/b": "2", "b/a": "1", "b/b": "1", "c/a": "2", "c/b": "1"}.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)

    def key(*names):
        monkeypatch.setattr(Declaring, "files", tuple(tmp_path / name for name in names), raising=False)
        return config_hash(Scenario(protocol=hold(Declaring(1.0))))

    assert key("a/a") == key("b/a") != key("c/a")
    assert len({key(), key("a/a"), key("a/a", "a/b"), key("b/a", "b/b"), key("c/a", "c/b")}) == 5


def test_the_folders_of_the_files_that_a_model_declares_do_not_count(tmp_path, monkeypatch):
    """As on two machines: the folders of the first are in the order of the names in them, those of the second are not.

    Also of two files of the same name. The control: files that swap their contents are others.
    """

    def key(**texts):
        monkeypatch.setattr(
            Declaring, "files", tuple(tmp_path / name.replace("_", "/") for name in texts), raising=False
        )
        for path, text in zip(Declaring.files, texts.values(), strict=True):
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)
        return config_hash(Scenario(protocol=Declaring(1.0)))

    assert key(a_low="1", b_up="2") == key(d_low="1", c_up="2") != key(e_low="2", f_up="1")
    assert key(a_same="1", b_same="2") == key(d_same="1", c_same="2")


@pytest.mark.parametrize("model", [LatencyTrace, LossTrace, SignalTrace])
def test_measurements_count_by_the_columns_in_use(tmp_path, model):
    """Also by the name of their file, and not by its folder, other columns and comments below the rows."""

    def key(text, name="a.csv", folder=""):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / name).write_text(text)
        table = {"latency" if model is LatencyTrace else "loss": model(file=tmp_path / folder / name)}
        return config_hash(Scenario(network=table))

    first = key("t,value\n0,0.5\n1,0.25\n")
    assert first == key("t,value,x\n0,0.5,1\n1,0.25,2\n") == key("t,value\n0,0.5\n1,0.25\n# end\n", folder="b")
    others = [key("t,value\n0,0.5\n1,0.75\n"), key("t,value\n0,0.5\n2,0.25\n"), key("t,value\n0,0.5\n1,\n")]
    assert len({first, *others, key("t,value\n0,0.5\n1,0.25\n", "b.csv")}) == 5


def test_a_model_whose_files_cannot_be_read_is_refused_with_its_key(monkeypatch):
    monkeypatch.setattr(Declaring, "files", ("none.txt",), raising=False)
    with pytest.raises(ScenarioError, match=r"^protocol: depends_on: none\.txt cannot be read: No such file"):
        config_hash(Scenario(protocol=Declaring(1.0)))
    monkeypatch.setattr(Declaring, "files", "a.txt", raising=False)
    with pytest.raises(ScenarioError, match=r"^protocol: depends_on: should be a tuple of paths \(got 'a\.txt'\)"):
        config_hash(Scenario(protocol=Declaring(1.0)))


def test_what_is_refused_in_a_grid_is_told_with_its_place(tmp_path):
    """Of the key that is swept, or of the key that is not."""
    (tmp_path / "declaring.py").write_text(
        "def rule(me):\n    return iter(())\nrule.depends_on = ('none.txt',)\ndef other(me):\n    return iter(())\n"
    )
    path = tmp_path / "f.toml"
    for text, where in {
        'protocol.kind = "declaring:rule"\nsweep.grid.horizon = [1.0]\n': f"{path}:2: protocol: depends_on",
        'sweep.grid.horizon = [1.0]\nsweep.grid.protocol = [{ kind = "declaring:rule" }]': (
            f"{path}:3: sweep.grid: protocol: depends_on"
        ),
    }.items():
        path.write_text(f"team.count = 2\n{text}\n")
        with pytest.raises(ScenarioError, match=f"^{re.escape(where)}"):
            configurations(read_source(path, allow_import=True))
    with pytest.raises(ScenarioError, match=r"^the grid: sweep\.grid: protocol: has no stable hash: "):
        of({"protocol": [Plain(threading.Lock())]})


def test_the_graph_in_a_file_counts(tmp_path):
    path = tmp_path / "graph.json"
    text = '{"directed": false, "multigraph": false, "graph": {}, "nodes": [{"id": 0}, {"id": 1}], "edges": %s}'
    keys = []
    for edges in ('[{"source": 0, "target": 1}]', "[]"):
        path.write_text(text % edges)
        keys.append(
            config_hash(Scenario(team=Team(count=2), network=Links(graph={"kind": "edges", "file": str(path)})))
        )
    assert keys[0] != keys[1]


def test_each_of_several_lambdas_counts():
    """They have one name, that of the pursuers and that of the evader."""
    protocol, flee, circle = lambda me: iter(()), lambda state, rng: 1.0, lambda state, rng: 2.0
    keys = [config_hash(Scenario(protocol=protocol, evader={"strategy": each})) for each in (flee, circle)]
    assert keys[0] != keys[1]
    other = lambda me: iter((1,))  # noqa: E731
    assert config_hash(Scenario(protocol=other, evader={"strategy": flee})) not in keys


def test_the_modules_of_user_code_are_named_and_those_of_desim_are_not():
    own = f"the code of {__name__}"
    assert own in identify(Scenario(protocol=Own())).sources
    assert own in identify(Scenario(protocol=partial(chase))).sources
    assert identify(SAME).sources == {}
    typed_rule = typed("def rule(me):\n    return iter(())", "rule")
    assert set(identify(Scenario(protocol=typed_rule)).sources) == {"the code of __main__:rule"}


# Labels.

LABELS = [
    (1, "1"),
    (1.0, "1"),
    (0.1, "0.1"),
    (0.123456789, "0.123456789"),
    (3 * 0.1, "0.3"),
    (0.1 + 2**-40, "0.1000000000009095"),
    (inf, "inf"),
    (True, "true"),
    (None, "none"),
    ("wifi", "wifi"),
    ([1.0, [2.0, False]], "[1, [2, false]]"),
    ({"kind": "sap"}, "sap"),
    ({"kind": "sap", "tau": {"kind": "constant", "value": 0.5}}, "sap(tau=constant(value=0.5))"),
    ({"default": 1.0, "last": 2.0}, "(default=1, last=2)"),
    (SpatialAdaptivePlay(), "sap"),
    (SpatialAdaptivePlay(tau=ConstantTau(value=0.5)), "sap(tau=constant(value=0.5))"),
    (Team(count=3), "Team(count=3)"),
    (chase, "chase"),
    (Plain(1.0), "Plain"),
    (partial(chase, 1.0, gain=2.0), "chase(1, gain=2)"),
]


@pytest.mark.parametrize(("value", "text"), LABELS, ids=[text for _, text in LABELS])
def test_a_value_has_a_short_name(value, text):
    assert label(value) == text


def test_a_configuration_is_named_by_its_settings():
    (cell,) = of({"horizon": [2.0], "protocol": [{"kind": "sap"}]})
    assert str(cell) == "horizon = 2, protocol = sap"
    assert module.in_words(cell.settings) == str(cell)
    with pytest.raises(FrozenInstanceError):
        cell.settings = {}
