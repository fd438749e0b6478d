"""What a script imports from `desim` and `protocols` themselves."""

import ast
import inspect
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules, walk_packages
from types import SimpleNamespace

import pytest

import desim
import protocols
from desim.config.exports import homes_of_exports
from desim.config.model import Value
from desim.kernel.models.access import ACCESSES, Ideal
from desim.kernel.models.interference import INTERFERENCES
from desim.kernel.network import Network
from desim.pursuit.motion.dynamics import DYNAMICS, Simple
from desim.pursuit.sensing.views import GlobalState
from desim.pursuit.team.agent import Agent
from protocols.rule import SCHEDULES
from protocols.temperature import TEMPERATURES
from scenarios.studies.study import SCENARIOS
from tests.golden import golden

FACADES = pytest.mark.parametrize("facade", [desim, protocols])
LAZY = [
    package
    for part in ("desim", "protocols")
    for package in [
        import_module(part),
        *(import_module(m.name) for m in walk_packages(import_module(part).__path__, f"{part}.") if m.ispkg),
    ]
    if "__getattr__" in vars(package)
]
"""The packages that import a public name on first access."""


def test_every_name_that_a_package_imports_on_access_is_there():
    assert {"desim", "desim.live", "desim.testing", "protocols"} <= {package.__name__ for package in LAZY}
    for package in LAZY:
        for name in dir(package):
            assert getattr(package, name) is not None, (package.__name__, name)


def test_no_public_name_is_that_of_a_module_beside_it():
    # Python sets a module as an attribute of its package when it is imported, in the place of what the name denoted.
    for package in LAZY:
        modules = {module.name for module in iter_modules(package.__path__)}
        assert not modules & homes_of_exports(package.__file__).keys(), package.__name__


@FACADES
def test_dir_shows_the_public_names(facade):
    assert dir(facade) == sorted(facade._HOMES)
    assert set(facade.__all__) == set(dir(facade)) - {"open"}, "a star import keeps the built-in"
    with pytest.raises(AttributeError, match=f"module '{facade.__name__}' has no attribute 'Taem'"):
        _ = facade.Taem


@pytest.mark.parametrize(
    ("facade", "name"), [(facade, name) for facade in (desim, protocols) for name in facade.__all__]
)
def test_a_public_name_is_that_of_its_module(facade, name):
    home = import_module(facade._HOMES[name])
    assert getattr(facade, name) is getattr(home, name)
    assert getattr(facade, name).__doc__


@FACADES
def test_type_checkers_see_the_same_names(facade):
    (block,) = [node for node in ast.parse(inspect.getsource(facade)).body if isinstance(node, ast.If)]
    seen = {alias.asname: statement.module for statement in block.body for alias in statement.names}
    assert seen == facade._HOMES


def test_every_schedule_and_temperature_is_public():
    parts = {each.__name__ for models in (SCHEDULES, TEMPERATURES) for each in models.choices().values()}
    assert parts <= set(protocols.__all__)


def test_every_access_and_interference_model_is_public():
    models = {each for family in (ACCESSES, INTERFERENCES) for each in family.choices().values()}
    assert {each.__name__ for each in models - {Ideal}} <= set(desim.__all__)


def test_every_kind_of_dynamics_is_public():
    assert {each.__name__ for each in set(DYNAMICS.choices().values()) - {Simple}} <= set(desim.__all__)


@pytest.mark.whole
def test_no_other_class_has_the_name_of_a_public_one():
    """`Capture` is the condition of a capture, so the interference model is `CaptureEffect`."""
    folder = Path(desim.__file__).parent
    classes = [
        (node.name, ".".join(file.relative_to(folder.parent).with_suffix("").parts))
        for file in sorted(folder.rglob("*.py"))
        for node in ast.parse(file.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ClassDef) and node.name in desim.__all__
    ]
    assert sorted(classes) == sorted((name, desim._HOMES[name]) for name, _ in dict.fromkeys(classes))


def test_the_names_are_known_without_importing_their_modules():
    program = "import sys, desim, protocols; dir(desim), dir(protocols); sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_before_a_module_is_imported_a_package_that_hides_the_protocols_is_looked_for(monkeypatch):
    """Not before each access: that would cost time."""
    asked = []
    monkeypatch.setattr(desim, "check_visible", asked.append)
    assert desim.__getattr__("Scenario") is desim.Scenario
    assert asked == []
    monkeypatch.delitem(sys.modules, desim._HOMES["Scenario"])
    monkeypatch.setattr(desim, "import_module", lambda home: SimpleNamespace(Scenario=home))
    assert desim.__getattr__("Scenario") == desim._HOMES["Scenario"]
    assert asked == ["protocols"]


@pytest.mark.slow
def test_the_example_of_the_package_runs(monkeypatch, capsys):
    monkeypatch.chdir(SCENARIOS.parent)
    _, example, _ = (desim.__doc__ or "").split("```")
    exec(example.removeprefix("python"), {})
    assert "active time: " in capsys.readouterr().out


def signatures(name, public):
    """Yield the arguments of a public function, or of the methods of a public class, inherited ones included."""
    if inspect.isfunction(public):
        yield f"{name}({arguments(public)})"
    elif inspect.isclass(public) and not issubclass(public, Value):
        bases = [base for base in public.__mro__ if base.__module__.startswith(("desim", "protocols"))]
        members = {
            key: getattr(member, "__func__", member) for base in bases[::-1] for key, member in vars(base).items()
        }
        functions = [key for key, member in members.items() if inspect.isfunction(member) and not key.startswith("_")]
        yield from (f"{name}.{key}({arguments(members[key])})" for key in functions)


def test_the_arguments_of_public_functions_and_their_defaults_are_golden():
    """Scripts of users rely on them; those of models are keys of scenario files."""
    lines = []
    for package in LAZY:
        prefix = "" if package is desim else f"{package.__name__}."
        for name in sorted(package.__all__):
            lines += signatures(prefix + name, getattr(package, name))
    for kind in (Agent, GlobalState, Network):  # a protocol or a process gets them
        lines += signatures(kind.__name__, kind)
    golden("arguments.txt", "\n".join(lines) + "\n")


def arguments(function):
    """Return the arguments of a function with their defaults; of objects, only the class."""
    shown, before = [], None
    for argument in inspect.signature(function).parameters.values():
        if argument.kind is argument.KEYWORD_ONLY and before not in (argument.KEYWORD_ONLY, argument.VAR_POSITIONAL):
            shown.append("*")
        before, default = argument.kind, argument.default
        is_plain = isinstance(default, int | float | str | tuple | None)
        told = "" if default is argument.empty else f"={default!r}" if is_plain else f"={type(default).__name__}"
        shown.append(f"{str(argument).partition(':')[0].partition('=')[0].strip()}{told}")
    return ", ".join(shown)


def test_the_keys_of_the_documents_in_json_are_golden():
    """Scripts of users read them, and few tests ask for each."""
    folder, lines = Path(desim.__file__).parent, []
    for file in sorted(folder.rglob("*.py")):
        text = file.read_text(encoding="utf-8")
        if not re.search(r"def _?document\(", text):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef) and node.name.strip("_") == "document":
                tables = [table.keys for table in ast.walk(node) if isinstance(table, ast.Dict)]
                keys = [key.value for table in tables for key in table if isinstance(key, ast.Constant)]
                if keys:
                    lines.append(f"{file.relative_to(folder).as_posix()}: {' '.join(keys)}")
    golden("documents.txt", "\n".join(lines) + "\n")
