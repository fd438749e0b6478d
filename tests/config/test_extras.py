"""A package that only an extra installs: where it is missing, the message has the command that installs it."""

import re
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

import desim
from desim import Scenario, run, sweep
from desim.config.extras import EXTRAS, missing, naming_extras

NEEDS = {
    "matplotlib": lambda: desim.plot(run(Scenario(horizon=0.01))),
    "jinja2": lambda: desim.replay(run(Scenario(horizon=0.01, record={"messages": True}))),
    "anywidget": lambda: desim.play(Scenario()),
    "pandas": lambda: sweep(Scenario(horizon=0.01), {"team.count": [2]}, reps=1).to_frame(),
    "pyarrow": lambda: desim.export(run(Scenario(horizon=0.01)), "x.parquet"),
    "mcap": lambda: desim.export(run(Scenario(horizon=0.01)), "x.mcap"),
    "pettingzoo": lambda: desim.wrap(None),
    "gymnasium": lambda: desim.wrap(None),
    "distributed": lambda: sweep(Scenario(), {"team.count": [2]}, reps=1, executor="tcp://127.0.0.1:1"),
}
"""By package, a call that needs it."""


@pytest.mark.parametrize("package", NEEDS)
def test_a_missing_package_is_named_with_its_extra(package, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(desim, "_HOMES", dict(desim._HOMES))
    for module in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, module)
    for module in ("desim.view.pages.widget", "desim.analysis.drawing.plots", "desim.view.pictures.paths"):
        if module in sys.modules:
            monkeypatch.delattr(module)  # its package would keep the module of this test
            monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises((ImportError, OSError), match=re.escape(missing(package))) as refused:
        NEEDS[package]()
    assert refused.value.__suppress_context__ or refused.value.__context__ is None


@pytest.mark.whole
def test_a_star_import_needs_no_extra():
    """It imports all that `desim` exports, also what is of use only with an extra."""
    hidden = f"import sys; sys.modules.update(dict.fromkeys({sorted(EXTRAS)}))"
    code = f"{hidden}\nfrom desim import *\nfrom protocols import *\nassert Scenario and play and SpatialAdaptivePlay"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_every_extra_that_a_package_needs_exists():
    extras = tomllib.loads(Path("pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert set(EXTRAS.values()) <= extras.keys()


def test_another_missing_package_is_not_renamed():
    with pytest.raises(ModuleNotFoundError, match=r"^No module named 'nowhere'$"), naming_extras():
        import_module("nowhere")
