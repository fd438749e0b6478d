"""What results depend on beside scenario and seed: versions, platform, commit and code."""

import os
import platform
import shutil
import stat
import subprocess
import sys
from hashlib import sha256
from importlib.metadata import EntryPoint, EntryPoints, version
from pathlib import Path
from types import SimpleNamespace

import pytest

from desim.results import environment


def test_versions_are_those_of_python_and_of_what_pip_installed():
    versions = environment.environment()["versions"]
    assert versions["python"] == platform.python_version()
    assert versions["desim"] == version("pursuit-desim")
    for name in ("numpy", "scipy", "simpy", "networkx", "pydantic"):
        assert versions[name] == version(name)
    assert len(versions) == 7


def test_distributions_that_add_protocols_are_among_the_versions(monkeypatch):
    """Of three entry points one is of another distribution, one of ours, and one of a group that is not ours."""
    points = EntryPoints(
        EntryPoint("x", "x", group)._for(distribution and SimpleNamespace(name=distribution))
        for group, distribution in (
            ("desim.protocols", "pytest"),
            ("desim.protocols", "pursuit-desim"),
            ("desim.disseminations", None),
            ("console_scripts", "ruff"),
        )
    )
    monkeypatch.setattr(environment, "entry_points", lambda: points)
    versions = environment.environment()["versions"]
    assert versions["pytest"] == pytest.__version__
    assert len(versions) == 8


def test_a_package_that_is_not_installed_has_no_version(monkeypatch):
    monkeypatch.setattr(environment, "NUMERICS", ("no-such-distribution",))
    assert environment.environment()["versions"]["no-such-distribution"] is None


def test_the_platform_is_what_the_last_digit_may_depend_on():
    assert environment.environment()["platform"] == {
        "system": platform.system(),
        "machine": platform.machine(),
        "libc": " ".join(platform.libc_ver()).strip(),
        "implementation": "CPython",
    }


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """Return a function that calls git, in a repository which holds a package `desim` and is where it is imported."""
    monkeypatch.setenv("GIT_CONFIG_GLOBAL", os.devnull)
    root = tmp_path / "checkout"

    def git(*words):
        command = ["git", "-C", str(root), "-c", "user.name=a", "-c", "user.email=a@b", *words]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    for name in ("desim", "protocols", "scenarios", "docs"):
        (root / name).mkdir(parents=True)
        (root / name / "__init__.py").touch()
    (root / "pyproject.toml").touch()
    (root / ".gitignore").write_text("*.pyc\n")
    monkeypatch.setattr(environment, "__file__", str(root / "desim" / "results" / "environment.py"))
    git("init", "-q")
    git("add", ".")
    git("commit", "-q", "-m", "x")
    git.root = root
    return git


def test_a_clean_checkout_has_its_commit(repository):
    assert environment._checkout() == (repository("rev-parse", "HEAD"), False)


@pytest.mark.parametrize(
    ("name", "change"),
    [("desim", "changed"), ("desim", "staged"), ("protocols", "new"), ("protocols", "gone"), ("scenarios", "changed")],
)
def test_code_that_is_not_as_committed_is_dirty(repository, name, change):
    path = repository.root / name / ("novel.py" if change == "new" else "__init__.py")
    path.unlink() if change == "gone" else path.write_text("x = 1\n")
    if change == "staged":
        repository("add", ".")
    commit = repository("rev-parse", "HEAD")
    assert environment._checkout() == (commit, True)


def test_a_changed_project_file_is_dirty(repository):
    (repository.root / "pyproject.toml").write_text("x = 1\n")
    assert environment._checkout()[1] is True


@pytest.mark.parametrize("path", ["docs/__init__.py", "docs/new.md", "out.json", "desim/cached.pyc"])
def test_files_that_are_not_simulator_code_do_not_make_the_checkout_dirty(repository, path):
    (repository.root / path).write_text("x = 1\n")
    assert environment._checkout() == (repository("rev-parse", "HEAD"), False)


def test_collecting_provenance_changes_nothing_in_the_repository(repository):
    """git would note in its index that a touched file is as it was, and be in the way of another git."""
    os.utime(repository.root / "desim" / "__init__.py", (1e9, 1e9))
    before = (repository.root / ".git" / "index").read_bytes()
    assert environment._checkout()[1] is False
    assert (repository.root / ".git" / "index").read_bytes() == before
    repository("status", "--porcelain")
    assert (repository.root / ".git" / "index").read_bytes() != before


def test_new_files_count_whatever_the_user_s_configuration(repository):
    repository("config", "status.showUntrackedFiles", "no")
    (repository.root / "protocols" / "novel.py").touch()
    assert environment._checkout()[1] is True


def test_the_repository_of_a_project_that_only_has_desim_in_a_folder_is_not_meant(repository, monkeypatch):
    (repository.root / "site-packages" / "desim").mkdir(parents=True)
    (repository.root / "site-packages" / "desim" / "__init__.py").touch()
    monkeypatch.setattr(
        environment, "__file__", str(repository.root / "site-packages" / "desim" / "results" / "environment.py")
    )
    assert environment._checkout() == (None, None)


def test_a_repository_below_whose_root_the_package_lies_is_meant(repository, monkeypatch):
    folder = repository.root / "vendored" / "desim"
    folder.mkdir(parents=True)
    (folder / "__init__.py").touch()
    repository("add", ".")
    repository("commit", "-q", "-m", "y")
    monkeypatch.setattr(environment, "__file__", str(folder / "results" / "environment.py"))
    assert environment._checkout() == (repository("rev-parse", "HEAD"), False)


def test_without_a_repository_there_is_no_commit(repository):
    shutil.rmtree(repository.root / ".git")
    assert environment._checkout() == (None, None)


def test_before_the_first_commit_there_is_none(repository):
    shutil.rmtree(repository.root / ".git")
    repository("init", "-q")
    repository("add", ".")
    assert environment._checkout() == (None, None)


def test_without_git_there_is_no_commit(repository, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert environment._checkout() == (None, None)


@pytest.mark.slow
def test_a_git_that_does_not_answer_is_not_waited_for(repository, monkeypatch, tmp_path):
    """It would sleep for ten minutes, and the test fails after two."""
    slow = tmp_path / "git"
    slow.write_text("#!/bin/sh\nexec sleep 600\n")
    slow.chmod(slow.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    assert environment.GIT_TIMEOUT <= 5.0
    monkeypatch.setattr(environment, "GIT_TIMEOUT", 0.05)
    assert environment._checkout() == (None, None)


@pytest.mark.parametrize(
    ("variable", "place"),
    [
        ("GIT_DIR", ".git"),
        ("GIT_WORK_TREE", "."),
        ("GIT_INDEX_FILE", ".git/index"),
        ("GIT_COMMON_DIR", ".git"),
        ("GIT_OBJECT_DIRECTORY", ".git/objects"),
    ],
)
def test_the_repository_of_a_hook_that_runs_us_is_not_meant(repository, monkeypatch, tmp_path, variable, place):
    """git tells its hooks by variables which repository is meant; here it is one without any commit."""
    commit = repository("rev-parse", "HEAD")
    subprocess.run(["git", "init", "-q", str(tmp_path / "other")], check=True)
    monkeypatch.setenv(variable, str(tmp_path / "other" / place))
    assert environment._checkout() == (commit, False)
    monkeypatch.setattr(environment, "GIT_VARIABLES", set())
    assert environment._checkout() != (commit, False)


@pytest.mark.slow
def test_the_code_is_that_of_all_that_decides_what_comes_of_a_run(tmp_path, monkeypatch):
    """A change of a protocol or of the kernel is another code, one of a command or a picture is not."""
    root = Path(environment.__file__).parents[2]
    for package in ("desim", "protocols"):
        shutil.copytree(root / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))

    def code():
        command = [sys.executable, "-c", "from desim.results.environment import code; print(code())"]
        return subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True).stdout.strip()

    before = code()
    assert before == environment.code()
    left_out = [f"desim/{module}" for module in environment.NOT_COMPUTING]
    for name in ("desim/cli/run.py", "desim/study/workers/dispatch.py", *left_out):
        (tmp_path / name).write_text("# changed\n" + (tmp_path / name).read_text())
    assert code() == before
    seen = {before}
    for name in (
        "protocols/sap.py",
        "desim/kernel/models/loss.py",
        "desim/simulation/world.py",
        "desim/analysis/timeline.py",
    ):
        (tmp_path / name).write_text("# changed\n" + (tmp_path / name).read_text())
        found = code()
        assert found not in seen
        seen.add(found)


def test_the_code_is_made_of_all_modules_that_compute_and_of_no_others(monkeypatch):
    """As above, without a copy of the project: which files are read, and that the digest is one of their bytes."""
    root, read = Path(environment.__file__).parents[2], []
    monkeypatch.setattr(Path, "read_bytes", lambda file: read.append(file.relative_to(root).as_posix()) or b"x")
    digest = environment.code.__wrapped__()
    files = [*root.glob("desim/**/*.py"), *root.glob("protocols/**/*.py")]
    names = {file.relative_to(root).as_posix(): file.relative_to(root).parts[1] for file in files}
    others = {"adapters", "cli", "learning", "live", "results", "study", "testing", "view"}
    left_out = {f"desim/{module}" for module in environment.NOT_COMPUTING}
    assert read == sorted(name for name, part in names.items() if part not in others and name not in left_out)
    assert digest == sha256("".join(f"{name}\nx" for name in read).encode()).hexdigest()[:16]
