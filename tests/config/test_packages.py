"""A folder or module of a user that hides a package of desim is named, and what to do about it."""

import subprocess
import sys
from pathlib import Path

import pytest

from desim.config import packages
from desim.config.packages import HiddenPackageError, check_visible, package_folder

ROOT = Path(__file__).parents[2]
RULE = "from desim import Scenario\nfrom protocols.sap import SpatialAdaptivePlay\n"
NAME = "from desim import Scenario\nfrom protocols import SpatialAdaptivePlay\n"
SCENARIO = "from desim import Scenario\nScenario()\n"
STUDY = "import desim\nfrom scenarios.studies.study import study\n"
SUBPACKAGE = "import desim\nimport scenarios.benchmarks.peers\n"


def python(folder, *arguments):
    """Run Python in a folder, as the first entry of whose `sys.path` it is, and return the process."""
    command = [sys.executable, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder, env=ENVIRONMENT)


ENVIRONMENT = {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    ("program", "hidden", "file"),
    [
        (RULE, "protocols", "protocols/__init__.py"),
        (NAME, "protocols", "protocols/__init__.py"),
        (SCENARIO, "protocols", "protocols.py"),
        (STUDY, "scenarios", "scenarios/__init__.py"),
        (SUBPACKAGE, "scenarios", "scenarios/__init__.py"),
    ],
)
def test_what_hides_a_package_is_named(program, hidden, file, tmp_path):
    path = tmp_path / file
    path.parent.mkdir(exist_ok=True)
    path.write_text("")
    (tmp_path / "script.py").write_text(program)
    done = python(tmp_path, "script.py")
    named = path.parent if path.name == "__init__.py" else path
    *_, said = done.stderr.splitlines()
    told = f"HiddenPackageError: {named} hides the package '{hidden}' of desim, {ROOT / hidden}: rename it, or "
    assert told in said


@pytest.mark.whole
def test_the_command_ends_as_for_other_wrong_input_and_runs_without_the_folder(tmp_path):
    (tmp_path / "protocols").mkdir()
    (tmp_path / "protocols/__init__.py").write_text("raise SystemExit('imported')")
    words = ["-m", "desim", "check", str(ROOT / "scenarios/relay.toml")]
    done = python(tmp_path, *words)
    assert done.returncode == 2
    assert done.stderr.startswith(f"{tmp_path}/protocols hides the package 'protocols' of desim, ")
    assert len(done.stderr.splitlines()) == 1
    assert python(tmp_path, "-P", *words).returncode == 0


@pytest.mark.whole
def test_a_folder_that_is_no_package_hides_nothing(tmp_path):
    for name in ("protocols", "scenarios"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.toml").write_text("seed = 1\n")
    (tmp_path / "script.py").write_text(RULE + STUDY + SCENARIO)
    assert python(tmp_path, "script.py").returncode == 0


def test_a_package_of_desim_is_found_where_it_is_installed(monkeypatch, tmp_path):
    check_visible("protocols")
    assert package_folder("scenarios") == ROOT / "scenarios"
    (tmp_path / "protocols").mkdir()
    monkeypatch.setattr(packages, "_SITE", tmp_path)
    with pytest.raises(
        HiddenPackageError, match=f"{ROOT}/protocols hides the package 'protocols' of desim, {tmp_path}"
    ):
        check_visible("protocols")


def test_a_module_that_desim_does_not_have_is_missing_as_usual():
    with pytest.raises(ModuleNotFoundError, match=r"No module named 'protocols\.nonsense'"):
        __import__("protocols.nonsense")
    assert packages._HiddenModuleFinder().find_spec("json.nonsense") is None
    assert sum(isinstance(each, packages._HiddenModuleFinder) for each in sys.meta_path) == 1
