"""The files about the project agree with each other and with what is there."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

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
    assert set(called) == {"tests", "oldest", "digests", "docs", "slow", "build", "wheel"} <= sessions


def test_the_hook_of_ruff_has_the_locked_version():
    (locked,) = re.findall(r"^ruff==(.*)$", text("requirements.lock"), re.MULTILINE)
    assert f"ruff-pre-commit\n    rev: v{locked}\n" in text(".pre-commit-config.yaml")


# The versions with which desim was last developed.

LISTS = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
DIRECT = [
    requirement
    for requirement in map(Requirement, [line for lines in LISTS for line in lines])
    if requirement.name != PROJECT["name"]
]
"""The requirements of desim and of its extras, without those of an extra for another."""
LOCKED = [Requirement(line) for line in re.findall(r"^[a-z].*$", text("requirements.lock"), re.MULTILINE)]


def locked_version(name):
    """Return the locked version of a distribution in this environment; None if it is not in the lock."""
    versions = [
        next(iter(locked.specifier)).version
        for locked in LOCKED
        if canonicalize_name(locked.name) == canonicalize_name(name)
        and (locked.marker is None or locked.marker.evaluate())
    ]
    assert len(versions) <= 1
    return versions[0] if versions else None


def unlocked(requirements):
    """Return the requirements, and those of what is installed for them, that the lock lacks or does not meet."""
    wrong, seen, pending = [], set(), [(requirement, "pyproject.toml") for requirement in requirements]
    while pending:
        requirement, origin = pending.pop()
        version, key = locked_version(requirement.name), (canonicalize_name(requirement.name), *requirement.extras)
        if version is None or not requirement.specifier.contains(version, prereleases=True):
            wrong.append(f"{requirement} of {origin}: {version}")
        if key in seen:
            continue
        seen.add(key)
        try:
            installed = distribution(requirement.name)
        except PackageNotFoundError:  # of an extra that this environment lacks
            continue
        if installed.version == version:  # another version may need other packages
            inner = [Requirement(line) for line in installed.requires or ()]
            extras = [{"extra": extra} for extra in ("", *requirement.extras)]
            applied = [each for each in inner if not each.marker or any(map(each.marker.evaluate, extras))]
            pending += [(each, requirement.name) for each in applied]
    return wrong


@pytest.mark.whole
def test_the_lock_has_all_that_desim_and_its_extras_require():
    assert unlocked(DIRECT) == []


@pytest.mark.parametrize("line", ["no-such-package", "numpy<1", "hypothesis[no]>=9999"])
def test_a_requirement_that_the_lock_lacks_would_be_detected(line):
    (wrong,) = unlocked([Requirement(line)])
    assert wrong.startswith(str(Requirement(line)))


def test_the_lock_has_nothing_that_is_required_no_more():
    """Whoever requires a package is named below it; `uv pip compile` as in the first lines makes the lock anew."""
    named = re.findall(
        r"^(\S+)==.*\n(?:    # .*\n)*?    #(?: via|  ) .*pursuit-desim", text("requirements.lock"), re.MULTILINE
    )
    assert set(named) == {canonicalize_name(requirement.name) for requirement in DIRECT}


PATHS = re.findall(r"[`(]((?:docs|desim|protocols|tests)/[\w./]*\w)[`)]", CONTRIBUTING)
COMMANDS = CONTRIBUTING + text(".github/workflows/ci.yml")
MODULES = [
    *(name.replace(".", "/") + ".py" for name in re.findall(r"python -m ((?:tests|scenarios)\.\w+)", COMMANDS)),
    *(path for words in re.findall(r"(?:pytest|only:)((?: [\w./-]+)+)", COMMANDS) for path in words.split()),
]


@pytest.mark.parametrize("path", sorted({*PATHS, *(path for path in MODULES if "/" in path)}))
def test_every_path_that_the_contribution_guide_and_the_workflow_name_is_there(path):
    package = path.removesuffix(".py") + "/__main__.py"
    assert (ROOT / path).exists() or (ROOT / package).exists() or "NAME" in path


# The container.

CONTAINER = text("docs/container/Containerfile")


def test_the_container_has_the_locked_versions_of_extras_that_exist_on_a_supported_python():
    (python,) = re.findall(r"^ARG BASE=\S+/python:(\d\.\d+)\.\d+-slim-\w+$", CONTAINER, re.MULTILINE)
    assert f"Programming Language :: Python :: {python}" in PROJECT["classifiers"]
    (extras,) = re.findall(
        r'^RUN pip install .*-c /desim/requirements\.lock "/desim\[(.*)\]"$', CONTAINER, re.MULTILINE
    )
    assert set(extras.split(",")) <= PROJECT["optional-dependencies"].keys()


def test_the_container_has_all_that_the_wheel_is_built_from():
    copied = {name for line in re.findall(r"^COPY (.*) \S+$", CONTAINER, re.MULTILINE) for name in line.split()}
    assert all((ROOT / name).exists() for name in copied)
    build = tomllib.loads(text("pyproject.toml"))["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert {*build["packages"], PROJECT["readme"], *PROJECT["license-files"], "pyproject.toml"} <= copied


# The paper about desim.

PAPER = text("docs/paper/paper.md")


def test_the_paper_has_the_sections_that_its_journal_asks_for_and_cites_what_is_in_its_bibliography():
    assert re.findall(r"^# (.*)$", PAPER, re.MULTILINE) == [
        *("Summary", "Statement of need", "State of the field", "Software design", "Research impact statement"),
        *("AI usage disclosure", "Acknowledgements", "References"),
    ]
    keys = re.findall(r"^@\w+\{(\w+),", text("docs/paper/paper.bib"), re.MULTILINE)
    assert sorted(set(re.findall(r"@(\w+\d\w*|simpy)\b", PAPER))) == sorted(keys)
    assert 750 <= len(PAPER.split()) <= 1750


def test_the_paper_and_the_citation_name_no_author_that_the_package_does_not_name():
    (authors,) = re.findall(r"^authors:\n((?:  .*\n)+)", PAPER, re.MULTILINE)
    assert re.findall("name: (.*)", authors) == [author["name"] for author in PROJECT["authors"]]


def test_the_changelog_has_a_part_for_what_comes_or_the_version_and_its_date():
    titles = re.findall(r"^## \[(.*)\](.*)$", text("CHANGELOG.md"), re.MULTILINE)
    assert titles[0] == ("Unreleased", "")
    assert all(re.fullmatch(r" - \d{4}-\d\d-\d\d", date) for _, date in titles[1:])
    assert len(titles) == 1 or titles[1][0] == PROJECT["version"]
