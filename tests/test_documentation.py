"""The pages that are made of the docstrings, and the examples in them."""

import subprocess
import sys

import pytest

import desim
from scenarios.study import SCENARIOS


def built(*command):
    """Run Python in a process of its own, for pdoc changes the modules that it looks at."""
    return subprocess.run([sys.executable, *command], cwd=SCENARIOS.parent, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_every_module_has_a_page_and_all_annotations_can_be_shown(tmp_path):
    done = built("-m", "tests.documentation", tmp_path)
    assert done.returncode == 0, done.stderr
    for package in ("desim", "protocols"):
        for module in (SCENARIOS.parent / package).rglob("*.py"):
            name = module.parent if module.stem == "__init__" else module.with_suffix("")
            assert (tmp_path / name.relative_to(SCENARIOS.parent)).with_suffix(".html").is_file(), module
    assert "Return the newest record" in (tmp_path / "desim/kernel/network.html").read_text()
    assert "Simulate a scenario" in (tmp_path / "desim.html").read_text()


@pytest.mark.slow
def test_an_annotation_that_cannot_be_shown_ends_the_building(tmp_path):
    module = tmp_path / "strange_land.py"
    module.write_text('def walk(to: "Nowhere") -> None:\n    """Walk."""\n')
    done = built(
        "-c",
        "from pathlib import Path; from tests import documentation;"
        f"documentation.specifications = lambda: [{str(module)!r}]; documentation.build(Path({str(tmp_path)!r}))",
    )
    assert done.returncode == 1
    assert "UserWarning" in done.stderr
    assert "Nowhere" in done.stderr


def test_the_example_of_the_package_runs(monkeypatch, capsys):
    monkeypatch.chdir(SCENARIOS.parent)
    _, example, _ = (desim.__doc__ or "").split("```")
    exec(example.removeprefix("python"), {})
    assert "active time: " in capsys.readouterr().out
