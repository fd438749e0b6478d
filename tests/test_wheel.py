"""The wheel, as a user has it: in an environment of its own, outside the repository, under a strict type checker."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from types import SimpleNamespace
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("desim", "protocols", "scenarios")
USER = Path(__file__).parent / "wheel"
"""The scripts of a user."""

pytestmark = pytest.mark.slow


def called(*words, cwd):
    """Run a program in a folder outside of the repository, and return its output."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "MYPY"))}
    done = subprocess.run(
        words, cwd=cwd, env=environment | {"PYTHONUTF8": "1"}, capture_output=True, text=True, check=False
    )
    return SimpleNamespace(code=done.returncode, text=done.stdout + done.stderr)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Return the wheel, built without an index."""
    folder = tmp_path_factory.mktemp("dist")
    built = called(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder), cwd=ROOT)
    assert built.code == 0, built.text
    (file,) = folder.glob("*.whl")
    return file


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Return the folder of the programs of an environment with the wheel and the dependencies of this environment.

    The pip of this environment installs the wheel there.
    """
    home = tmp_path_factory.mktemp("user") / "venv"
    made = called(sys.executable, "-m", "venv", "--without-pip", str(home), cwd=home.parent)
    assert made.code == 0, made.text
    programs = home / ("Scripts" if os.name == "nt" else "bin")
    words = (
        "-m",
        "pip",
        "--python",
        str(programs / "python"),
        "install",
        "--no-index",
        "--no-deps",
        "--no-compile",
        str(wheel),
    )
    done = called(sys.executable, *words, cwd=home)
    assert done.code == 0, done.text
    told = called(str(programs / "python"), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=home)
    paths = {sysconfig.get_path(name) for name in ("purelib", "platlib")}
    (Path(told.text.strip()) / "dependencies.pth").write_text("\n".join(sorted(paths)) + "\n", encoding="utf-8")
    return programs


def test_the_wheel_has_every_file_of_its_packages_but_what_needs_the_repository(wheel):
    names = {name for name in ZipFile(wheel).namelist() if ".dist-info/" not in name}
    files = [path for package in PACKAGES for path in (ROOT / package).rglob("*") if path.is_file()]
    kept = {path.relative_to(ROOT).as_posix() for path in files if "__pycache__" not in path.parts}
    benchmarks = {name for name in kept if name.startswith("scenarios/benchmarks/")}
    of_pages = {"scenarios/check_pages.py", "scenarios/studies/claims.py", "scenarios/studies/claims_runs.py"}
    assert of_pages <= kept
    assert names == kept - benchmarks - of_pages
    assert "scenarios/benchmarks/peers/peer_ns3.cpp" in benchmarks
    assert {f"{package}/py.typed" for package in PACKAGES} <= names
    assert "scenarios/relay.toml" in names


def test_the_wheel_names_its_license_and_links(wheel):
    archive = ZipFile(wheel)
    (metadata,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
    text = archive.read(metadata).decode()
    assert "\nLicense-Expression: MIT\n" in text
    assert any(name.endswith("/licenses/LICENSE") for name in archive.namelist())
    assert re.findall("^Project-URL: (\\w+),", text, re.MULTILINE) == [
        "Homepage",
        "Documentation",
        "Changelog",
        "Issues",
    ]


@pytest.mark.whole
def test_an_installed_desim_runs_a_scenario_that_came_with_it(installed, tmp_path):
    program = "import desim, scenarios; from pathlib import Path; print(desim.__file__); print(scenarios.__file__)"
    told = called(str(installed / "python"), "-c", program, cwd=tmp_path)
    assert told.code == 0, told.text
    files = [Path(line) for line in told.text.splitlines()]
    assert all(installed.parent in file.parents for file in files)
    file = files[1].with_name("relay.toml")
    done = called(str(installed / "desim"), "run", str(file), "--set", "horizon=0.5", cwd=tmp_path)
    assert done.code == 0, done.text
    assert "20 pursuers" in done.text


@pytest.mark.whole
def test_the_script_of_a_user_runs(installed, tmp_path):
    shutil.copytree(USER, tmp_path, dirs_exist_ok=True)
    done = called(str(installed / "python"), "right.py", cwd=tmp_path)
    assert done.code == 0, done.text


@pytest.mark.whole
def test_the_script_of_a_user_passes_a_strict_type_checker(installed, tmp_path):
    """For the checker the extras `cluster` and `notebook`, most of what it would read, are as if not installed."""
    shutil.copytree(USER, tmp_path, dirs_exist_ok=True)
    unread = "[mypy]\n[mypy-dask.*,distributed.*,IPython.*,anywidget.*]\nfollow_imports = skip\n"
    (tmp_path / "mypy.ini").write_text(unread, encoding="utf-8")
    words = (*("-m", "mypy", "--strict", "--config-file", "mypy.ini"), "--python-executable", str(installed / "python"))
    checked = called(sys.executable, *words, "right.py", "wrong.py", cwd=tmp_path)
    found = re.findall(r"(right|wrong)\.py:(\d+): error: .*\[([\w-]+)\]$", checked.text, re.MULTILINE)
    lines = (tmp_path / "wrong.py").read_text(encoding="utf-8").splitlines()
    wanted = [("wrong", str(k), line.partition("  # ")[2]) for k, line in enumerate(lines, 1) if "  # " in line]
    assert found == wanted, checked.text
