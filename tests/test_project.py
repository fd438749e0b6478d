"""The files about the project agree with each other and with what is there."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_citation_is_of_this_version_license_and_repository():
    cited = dict(re.findall(r"^(version|license|repository-code|url): (.*)$", text("CITATION.cff"), re.MULTILINE))
    assert cited == {
        "version": PROJECT["version"],
        "license": PROJECT["license"],
        "repository-code": PROJECT["urls"]["Homepage"],
        "url": PROJECT["urls"]["Documentation"],
    }


def test_the_same_pythons_are_declared_and_tested():
    declared = [each.rpartition(" ")[2] for each in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", each)]
    assert PROJECT["requires-python"] == f">={declared[0]}"
    for name in ("noxfile.py", ".github/workflows/ci.yml"):
        (listed,) = re.findall(r"(?:PYTHONS =|python:) (\[.*\])", text(name))
        assert re.findall(r"\d\.\d+", listed) == declared


def test_the_workflows_call_sessions_that_nox_has():
    sessions = set(re.findall(r"^def (\w+)\(session", text("noxfile.py"), re.MULTILINE))
    workflows = "".join(path.read_text(encoding="utf-8") for path in (ROOT / ".github/workflows").glob("*.yml"))
    called = re.findall(r"nox -s (\w+)", workflows) + re.findall(r"session: \[?(\w+)", workflows)
    assert set(called) == {"tests", "oldest", "digests", "docs", "build"} <= sessions


def test_the_hook_of_ruff_has_the_locked_version():
    (locked,) = re.findall(r"^ruff==(.*)$", text("requirements.lock"), re.MULTILINE)
    assert f"ruff-pre-commit\n    rev: v{locked}\n" in text(".pre-commit-config.yaml")


PATHS = re.findall(r"[`(]((?:docs|desim|protocols|tests)/[\w./]*\w)[`)]", CONTRIBUTING)
COMMANDS = CONTRIBUTING + text(".github/workflows/ci.yml")
MODULES = [
    *(name.replace(".", "/") + ".py" for name in re.findall(r"python -m ((?:tests|scenarios)\.\w+)", COMMANDS)),
    *(path for words in re.findall(r"(?:pytest|only:)((?: [\w./-]+)+)", COMMANDS) for path in words.split()),
]


@pytest.mark.parametrize("path", sorted({*PATHS, *(path for path in MODULES if "/" in path)}))
def test_every_path_that_the_contribution_guide_and_the_workflow_name_is_there(path):
    assert (ROOT / path).exists() or "NAME" in path
