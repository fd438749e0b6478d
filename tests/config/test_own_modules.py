"""Modules beside scenario files: each folder runs its own code, whoever imports it and wherever."""

import importlib
import json
import pickle
import py_compile
import re
import sys
from functools import partial
from importlib.metadata import EntryPoint
from multiprocessing import get_context

import pytest

from desim import load, run, summary, sweep
from desim.config import named_code
from desim.config.choice import OneOf
from desim.config.named_code import load_named
from desim.config.own_modules import _Finder, find_own_modules, folder_in_name, module_beside, plain_name
from desim.kernel.core.trace_file import line_of
from desim.results import provenance
from desim.scenario.overrides import ScenarioError
from desim.scenario.toml import dump, read_source, validate
from desim.study.plan.config_hash import identify
from desim.study.plan.configurations import configurations
from desim.study.workers.serialization import called, packed
from desim.view.pages.playground import Playground

SCENARIO = """
protocol = "myrule:Rule"
network.graph = "shapes.graphs:ring"
network.latency = { kind = "myrule:Latency", value = 0.01 }
evader.strategy = "strategies.own:flee"
team.count = 3
horizon = 0.5
record.metrics = ["myrule:code", "myrule:lazy_code"]
"""
RULE = """
import helper, shapes.names
import shapes.graphs as drawn
from desim.config.model import Value
from desim.kernel.models.latency import Constant
from shapes import names
from math import pi

class Latency(Value):
    value: float

    def __call__(self, *_):
        return self.value * helper.NUMBER

class Rule(Value):
    def __call__(self, me):
        import lazy
        from shapes.names import NUMBER
        assert lazy.NUMBER == NUMBER == helper.NUMBER == shapes.names.NUMBER == names.NUMBER == drawn.NUMBER
        yield me.sleep(0.1 * lazy.NUMBER)
        me.assign(True)

def code(result):
    return helper.NUMBER

def lazy_code(result):
    from lazy import NUMBER
    return NUMBER
"""
FILES = {
    "s.toml": SCENARIO,
    "myrule.py": RULE,
    "helper.py": "NUMBER = {n}",
    "lazy.py": "from helper import NUMBER",
    "shapes/__init__.py": "",
    "shapes/names.py": "from helper import NUMBER",
    "shapes/graphs.py": "from networkx import cycle_graph as ring\nfrom .names import NUMBER",
    "strategies/own.py": "import helper\n\ndef flee(state, rng):\n    return 1j ** helper.NUMBER",
}


@pytest.fixture
def folders(tmp_path):
    """Return two folders with the same files, but for a number; a dot, a percent sign and an @ are in their names."""
    made = [tmp_path / "a.1%2E", tmp_path / "b@2"]
    for number, folder in enumerate(made, start=1):
        for name, text in FILES.items():
            file = folder / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text.replace("{n}", str(number)))
    return made


def loaded(folder):
    return load(folder / "s.toml", allow_import=True)


def codes(values):
    return values["code"], values["lazy_code"]


def lines(result):
    return "".join(map(line_of, result.trace))


@pytest.mark.slow
def test_each_folder_runs_its_own_code_in_any_order(folders):
    path, imported = [*sys.path], set(sys.modules)  # another test may have imported one of them plainly
    scenarios = [loaded(folder) for folder in folders]
    results = [run(scenario, 1) for scenario in scenarios]
    assert [codes(summary(result)) for result in results] == [(1, 1), (2, 2)]
    assert lines(results[0]) != lines(results[1])
    assert lines(run(loaded(folders[0]), 1)) == lines(results[0])
    assert sys.path == path
    assert not {"myrule", "helper", "lazy", "shapes", "strategies"} & (sys.modules.keys() - imported)


def test_identities_and_files_do_not_depend_on_the_folder(folders, tmp_path):
    scenarios = [loaded(folder) for folder in folders]
    identities = [identify(scenario) for scenario in scenarios]
    assert identities[0].key != identities[1].key
    names = {f"the code of {name}" for name in ("myrule", "helper", "lazy", "shapes", "shapes.names", "shapes.graphs")}
    assert identities[0].sources.keys() == {*names, "the code of strategies.own"} == identities[1].sources.keys()
    (folders[1] / "helper.py").write_text("NUMBER = 1")
    importlib.reload(sys.modules[module_beside("helper", folders[1])])
    assert identify(scenarios[1]) == identities[0]
    assert dump(scenarios[0]) == dump(scenarios[1])
    assert "@" not in dump(scenarios[0])
    assert 'kind = "myrule:Rule"' in dump(scenarios[0])


@pytest.mark.slow
def test_a_plain_import_of_the_same_file_gives_the_same_module_and_identity(folders, monkeypatch):
    """As in a script beside its scenario file."""
    own = identify(loaded(folders[0]))
    monkeypatch.syspath_prepend(folders[0])
    scenario = loaded(folders[0])
    assert type(scenario.protocol) is importlib.import_module("myrule").Rule
    assert identify(scenario) == own
    other = loaded(folders[1])
    assert other.protocol.__module__ != "myrule"
    assert codes(summary(run(other, 1))) == (2, 2)


@pytest.mark.whole
def test_workers_and_other_processes_run_the_code_of_the_folder(folders):
    for number, folder in enumerate(folders, start=1):
        scenario = loaded(folder)
        for executor in (1, 2):
            swept = sweep(scenario, {"team.count": [3]}, reps=2, executor=executor)
            assert [[cell.mean for cell in swept.estimates(name)] for name in ("code", "lazy_code")] == [[number]] * 2
        assert lines(pickle.loads(pickle.dumps(run))(scenario, 1)) == lines(run(scenario, 1))
    with get_context("spawn").Pool(1) as pool:
        results = pool.starmap(run, [(loaded(folder), 1) for folder in folders])
    assert [lines(result) for result in results] == [lines(run(loaded(folder), 1)) for folder in folders]


@pytest.mark.slow
def test_recorded_runs_and_play_use_the_folder_of_the_file(folders, tmp_path):
    for number, folder in enumerate(folders, start=1):
        scenario = loaded(folder)
        made = json.loads(json.dumps(provenance.document(provenance.RUN, scenario, seed=1, folder=folder)))
        again = validate(provenance.source(folder / "run.json", made, allow_import=True))
        assert lines(run(again, 1)) == lines(run(scenario, 1))
        ground = Playground(read_source(folder / "s.toml", allow_import=True), folder / "s.toml")
        assert codes(summary(ground.result(()))) == (number, number)


def test_a_reloaded_module_has_the_edited_code_of_its_folder(folders):
    module = sys.modules[loaded(folders[1]).record.metrics[0].of.__module__]
    (folders[1] / "myrule.py").write_text("import helper\n\ndef code(result):\n    return helper.NUMBER + 40\n")
    assert importlib.reload(module).code(None) == 42


def test_errors_have_plain_names(folders):
    (folders[0] / "s.toml").write_text('protocol = "myrule:rul"')
    with pytest.raises(ValueError, match=r"'myrule:rul' cannot be imported: module 'myrule' has no attribute 'rul'"):
        loaded(folders[0])
    (folders[0] / "s.toml").write_text('protocol = "shapes.none:rule"')
    with pytest.raises(ValueError, match=r"cannot be imported: No module named 'shapes.none'; also searched in"):
        loaded(folders[0])


@pytest.mark.parametrize("name", ["code", "random", "protocols"])
def test_a_name_of_a_module_of_python_or_of_desim_is_told_if_the_folder_has_it(name, tmp_path):
    named = f"module '{name}' has no attribute 'mine'"
    with pytest.raises(ValueError, match=named) as error:
        load_named(f"{name}:mine", tmp_path)
    assert str(tmp_path) not in str(error.value)
    (tmp_path / f"{name}.py").write_text("mine = len")
    with pytest.raises(ValueError, match=rf"{named}.*; Python and desim do not import .*{name}.py: a module of theirs"):
        load_named(f"{name}:mine", tmp_path)


def test_python_and_desim_precede_modules_beside_a_file(folders):
    for name in ("random", "protocols", "desim"):
        (folders[0] / f"{name}.py").write_text("raise AssertionError")
        assert module_beside(f"{name}.part", folders[0]) == f"{name}.part"
    assert codes(summary(run(loaded(folders[0]), 1))) == (1, 1)


def test_names_can_be_read_back(folders):
    for folder in folders:
        name = module_beside("shapes.names", folder)
        assert plain_name(name) == "shapes.names"
        assert folder_in_name(name) == folder
        assert name.count(".") == 1
    assert folder_in_name("shapes.names") is None


@pytest.mark.slow
def test_a_call_that_was_packed_runs_the_code_of_its_folder(folders):
    calls = [packed(partial(loaded(folder).record.metrics[1].of, None)) for folder in folders]
    assert [pickle.loads(called(call)) for call in calls] == [1, 2]


@pytest.mark.slow
def test_a_base_in_another_folder_runs_its_own_code(folders, tmp_path):
    for number, folder in enumerate(folders, start=1):
        file = tmp_path / f"over{number}" / "s.toml"
        file.parent.mkdir()
        for name, text in FILES.items():  # the file that uses the base has modules of the same names
            (file.parent / name).parent.mkdir(exist_ok=True)
            (file.parent / name).write_text(text.replace("{n}", "3"))
        file.write_text(f"base = '{folder / 's.toml'}'\nsweep.grid = {{}}\n")
        scenario = load(file, allow_import=True)
        assert lines(run(scenario, 1)) == lines(run(loaded(folder), 1))
        assert codes(summary(run(scenario, 1))) == (number, number)
        assert identify(scenario).key == identify(loaded(folder)).key
        assert dump(scenario) == dump(loaded(folder))
        assert codes(summary(run(scenario.with_({"seed": 2})))) == (number, number)
        own = load(file, ['protocol="myrule:Rule"', "network.latency.kind='myrule:Latency'"], allow_import=True)
        assert folder_in_name(type(own.protocol).__module__) == folder_in_name(type(own.network.latency).__module__)
        assert folder_in_name(type(own.protocol).__module__) == file.parent
        assert folder_in_name(own.evader.strategy.__module__) == folder


def test_values_of_the_grid_of_a_base_are_its_own_code(folders):
    (folders[0] / "grid.toml").write_text(
        "base = 's.toml'\n[sweep.grid]\nprotocol = ['myrule:Rule']\n'network.latency.kind' = ['myrule:Latency']\n"
    )
    (folders[1] / "over.toml").write_text(f"base = '{folders[0] / 'grid.toml'}'\n")
    (swept,) = configurations(read_source(folders[1] / "over.toml", allow_import=True))
    for model in (swept.scenario.protocol, swept.scenario.network.latency):
        assert folder_in_name(type(model).__module__) == folders[0]


BY_TEXT = {
    "import_module": "importlib.import_module('helper')",
    "its name": "import_module('helper')",
    "a keyword": "import_module(name='helper')",
    "__import__": "__import__('helper')",
    "a computed name": "[import_module(f'{part}per') for part in ['hel']][0]",
    "a package": "import_module(f'shapes.{ {1: \"names\"}[1] }')",
    "a relative name": "import_module('.names', package='shapes')",
    "a specification": "[import_module(find_spec('helper').name)][0]",
}


def test_names_that_are_unpacked_are_imported_as_they_are(tmp_path):
    (tmp_path / "unpacks.py").write_text(
        "from importlib import import_module\nmodule = import_module(*('.tool', 'json'))\n"
    )
    find_own_modules()
    assert importlib.import_module(module_beside("unpacks", tmp_path)).module.__name__ == "json.tool"


@pytest.mark.slow_but_one
@pytest.mark.parametrize("code", BY_TEXT.values(), ids=BY_TEXT)
def test_a_module_that_is_imported_by_a_text_is_that_of_the_folder(folders, code):
    scenarios = []
    for folder in folders:
        lines = ["import importlib", "from importlib import import_module", "from importlib.util import find_spec"]
        rule = "\n\ndef rule(me):\n    yield me.sleep(0.1 * module.NUMBER)\n    me.assign(True)\n"
        metric = f"\n\ndef number(result):\n    return ({code}).NUMBER\n"
        (folder / "bytext.py").write_text("\n".join([*lines, f"module = {code}", rule, metric]))
        (folder / "s.toml").write_text("protocol = 'bytext:rule'\nhorizon = 0.5\nrecord.metrics = ['bytext:number']\n")
        scenarios.append(loaded(folder))
    assert [summary(run(scenario, 1))["number"] for scenario in scenarios] == [1, 2]
    call = packed(partial(scenarios[1].record.metrics[0].of, None))
    assert pickle.loads(called(call)) == 2


def test_a_module_that_is_there_compiled_only_is_found(tmp_path):
    (tmp_path / "compiled_rule.py").write_text("NUMBER = 7")
    py_compile.compile(str(tmp_path / "compiled_rule.py"), str(tmp_path / "compiled_rule.pyc"))
    (tmp_path / "compiled_rule.py").unlink()
    found = _Finder().find_spec(module_beside("compiled_rule", tmp_path))
    assert found is not None
    assert found.origin == str(tmp_path / "compiled_rule.pyc")


RAISES = """import helper

def table(numbers):
    return {helper.NUMBER: 1}[numbers]

RULES = table(None)
"""
NAMES_CODE = {
    "protocol": 'protocol = "{}:Rule"',
    "a model of the network": 'network.latency = {{ kind = "{}:Rule" }}',
    "a model of the evader": 'evader.strategy = "{}:Rule"',
    "a metric": 'record.metrics = ["{}:Rule"]',
    "a fault": '[[fault]]\nkind = "{}:Rule"',
    "a property": 'properties = ["always {}:Rule"]',
}


@pytest.mark.parametrize("line", NAMES_CODE.values(), ids=NAMES_CODE)
@pytest.mark.parametrize(
    ("code", "cause", "text"),
    [
        (RAISES, KeyError, "KeyError: None (FILE, line 4)"),
        ("\nassert False", AssertionError, "AssertionError (FILE, line 2)"),
        ("import math\nmath.sin('')", TypeError, "TypeError: must be real number, not str (FILE, line 2)"),
        ("import no_such_module", ImportError, "No module named 'no_such_module' (FILE, line 1)"),
        ("import math\nmath.sine", AttributeError, "module 'math' has no attribute 'sine'.* (FILE, line 2)"),
    ],
)
def test_an_exception_at_the_import_is_told_with_the_file_and_the_line_that_raised_it(folders, line, code, cause, text):
    """In any family whose kinds may be code of a user; from Python the exception itself is the cause."""
    file = folders[0] / "raises.py"
    file.write_text(code)
    (folders[0] / "s.toml").write_text(line.format("raises"))
    pattern = re.escape(f"'raises:Rule' cannot be imported: {text}").replace(r"\.\*", ".*")
    with pytest.raises(ScenarioError, match=pattern.replace("FILE", re.escape(str(file)))) as refused:
        loaded(folders[0])
    assert isinstance(refused.value.__cause__.__cause__, cause)
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize("line", NAMES_CODE.values(), ids=NAMES_CODE)
def test_an_exception_in_a_module_that_the_named_one_imports_is_told_with_its_own_line(folders, line):
    (folders[0] / "raises.py").write_text("import broken")
    file = folders[0] / "broken.py"
    file.write_text("import math\n\nmath.sqrt(-1.0)")
    (folders[0] / "s.toml").write_text(line.format("raises"))
    with pytest.raises(ScenarioError, match=rf"math domain error \({re.escape(str(file))}, line 3\)"):
        loaded(folders[0])


def test_an_exception_in_an_installed_module_is_told_with_its_line(folders, monkeypatch):
    """Installed modules are not of the user, but the one that is named is told all the same."""
    file = folders[0] / "raises.py"
    file.write_text("\n1 / 0")
    (folders[0] / "s.toml").write_text(NAMES_CODE["a metric"].format("raises"))
    monkeypatch.setattr(named_code, "is_of_user", lambda frame: False)
    with pytest.raises(ScenarioError, match=rf"division by zero \({re.escape(str(file))}, line 2\)"):
        loaded(folders[0])


def test_an_installed_kind_that_raises_at_its_import_is_refused_too(folders, monkeypatch):
    (folders[0] / "raises.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(folders[0])
    family = OneOf(group="desim.shapes")
    family.__dict__["_installed"] = {"round": EntryPoint("round", "raises:Circle", "desim.shapes")}
    for choose in family.choices, lambda: family.choice("round"):
        with pytest.raises(ValueError, match=r"'raises:Circle' cannot be imported: ZeroDivisionError: .*line 1\)"):
            choose()
