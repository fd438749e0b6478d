"""desim in a browser: it runs without what is not there, and the versions that are there suffice."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.as_in_browser import FROM_INDEX, LIST, MISSING, is_there

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
VERSIONS = {canonicalize_name(name): version for name, (version, _) in LIST["packages"].items()}
ALWAYS = {"annotated_types", "markupsafe", "pydantic_core", "typing_extensions", "typing_inspection"}
"""What the packages below need themselves; Pyodide installs it with them."""
LOADED = {"cloudpickle", "jinja2", "networkx", "numpy", "pydantic", "tomli_w"}
"""The packages that the page asks Pyodide for; SimPy comes with the archive of desim."""


@pytest.mark.parametrize("line", [*PROJECT["dependencies"], "jinja2>=3.1"])
def test_each_requirement_is_met_in_a_browser_or_taken_from_the_index(line):
    requirement = Requirement(line)
    name = canonicalize_name(requirement.name)
    version = VERSIONS.get(name)
    assert name in FROM_INDEX or (version is not None and requirement.specifier.contains(version)), version
    if name in FROM_INDEX and version is not None:
        assert not requirement.specifier.contains(version), "it need not be taken from the index any more"


def test_the_list_is_of_a_python_that_desim_supports_and_has_what_is_known():
    assert f"Programming Language :: Python :: {LIST['python'].rpartition('.')[0]}" in PROJECT["classifiers"]
    assert {"resource", "multiprocessing.resource_tracker", "_multiprocessing"} <= MISSING
    assert not is_there("multiprocessing.resource_tracker")
    assert not is_there("pyarrow_no_such_package")
    assert is_there("threading")
    assert is_there("numpy.linalg")


@pytest.fixture(scope="module")
def done():
    """Return what `tests.as_in_browser` did."""
    words = [sys.executable, "-W", "ignore", "-m", "tests.as_in_browser"]
    ran = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


@pytest.mark.slow
def test_run_summary_replay_play_and_a_sweep_do_not_need_what_a_browser_lacks(done):
    """With the missing modules blocked, and without threads, processes and timers."""
    from desim import load, run, summary

    expected = summary(run(load(ROOT / "scenarios" / "relay.toml", ["horizon=2.0"]), seed=1))
    assert done["active_time"] == expected.active_time
    assert done["replay"] > 50_000
    assert "should be less than or equal to 1" in done["refused"]["network.loss.p"]
    assert "2 configurations, 4 runs" in done["sweep"]


@pytest.mark.slow
def test_the_page_loads_just_what_a_run_imports(done):
    """A package that is added here costs every visitor its download, and so does what it depends on in Pyodide.

    The control: networkx there depends on matplotlib.
    """
    assert set(done["needed"]) == LOADED | ALWAYS | {"simpy"}
    assert with_dependencies(listed("PACKAGES")) | listed("ALONE") == {
        canonicalize_name(name) for name in LOADED | ALWAYS
    }
    assert "matplotlib" in with_dependencies(listed("ALONE"))


def listed(name):
    """Return the packages in a list of the worker of the page."""
    worker = (ROOT / "docs" / "_static" / "try_worker.js").read_text(encoding="utf-8")
    (line,) = [line for line in worker.splitlines() if line.startswith(f"const {name} = ")]
    return set(json.loads(line.partition("= ")[2].rstrip(";")))


def with_dependencies(names):
    """Return packages and all that Pyodide loads with them."""
    return set(names).union(*(with_dependencies(LIST["depends"].get(name, ())) for name in names))


def test_a_module_that_a_browser_lacks_is_detected():
    """The control: a module of the list is imported in the restricted Python."""
    program = "from tests import as_in_browser; as_in_browser.restrict(); import multiprocessing.resource_tracker"
    ran = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert "No module named 'multiprocessing.resource_tracker'" in ran.stderr
