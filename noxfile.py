#!/usr/bin/env -S uv run --script
# /// script
# dependencies = ["nox>=2025.2.9", "uv"]
# ///
"""The checks of the project, each in an environment of its own: `nox -l` lists them, `nox -s lint` runs one."""

import re
import shutil
import tarfile
from pathlib import Path

import nox

nox.needs_version = ">=2025.2.9"
nox.options.default_venv_backend = "uv|virtualenv"
PYTHONS = ["3.11", "3.12", "3.13", "3.14"]


@nox.session(python=PYTHONS, default=False)
def tests(session: nox.Session) -> None:
    """Run the fast tests with the newest dependencies."""
    session.install("-e", ".[test]")
    session.run("pytest", *session.posargs)


@nox.session(python=PYTHONS[:1], venv_backend="uv", default=False)
def oldest(session: nox.Session) -> None:
    """Run the fast tests with the oldest dependencies that pyproject.toml allows."""
    session.install("--resolution=lowest-direct", "-e", ".[test]")
    session.run("pytest", *session.posargs)


@nox.session(venv_backend="uv", default=False)
def digests(session: nox.Session) -> None:
    """Compare the digests of runs under all Pythons; the packages that compute have the same versions."""
    versions = f"{session.create_tmp()}/versions.txt"
    session.run("uv", "pip", "compile", "-q", f"--python-version={PYTHONS[0]}", "pyproject.toml", "-o", versions)
    isolated = ("uv", "run", "-q", "--isolated", "--no-project", "--with=.", f"--with-requirements={versions}")
    printed = {
        python: session.run(*isolated, f"--python={python}", "python", "-m", "tests.digests", silent=True)
        for python in PYTHONS
    }
    for python, text in printed.items():
        if text != printed[PYTHONS[0]]:
            session.error(f"Python {python} and {PYTHONS[0]} differ:\n{text}\n{printed[PYTHONS[0]]}")


@nox.session(default=False)
def slow(session: nox.Session) -> None:
    """Run the slow tests with all combinations of parameters and the tests marked whole."""
    session.install("-e", ".[test]")
    session.run("pytest", "-m", "slow", "--whole-products", *session.posargs)


@nox.session
def lint(session: nox.Session) -> None:
    """Check format, style and types."""
    session.install("-e", ".[dev]")
    session.run("ruff", "format", "--check")
    session.run("ruff", "check")
    session.run("mypy")


@nox.session(default=False)
def docs(session: nox.Session) -> None:
    """Build the documentation into docs/_build, where a warning is an error, and read the built pages."""
    session.install("-e", ".[docs,test]")
    session.run("python", "-m", "sphinx", "-W", "--keep-going", "-b", "html", "docs", "docs/_build", *session.posargs)
    session.run("pytest", "-m", "", "-n", "0", "tests/test_site.py")


@nox.session(default=False)
def build(session: nox.Session) -> None:
    """Build the wheel and the source distribution into dist, and check what they say of themselves."""
    session.install("build", "twine")
    session.run("python", "-m", "build")
    session.run("twine", "check", "--strict", "dist/*")


@nox.session(python=PYTHONS, venv_backend="uv", default=False)
@nox.parametrize("resolution", ["lowest-direct", "highest"])
def wheel(session: nox.Session, resolution: str) -> None:
    """Install the built wheel in a clean environment, with the oldest or the newest dependencies, and use it there."""
    folder, here = _empty(session), Path.cwd()
    session.run("uv", "build", "-q", "--wheel", "--out-dir", str(folder))
    (file,) = folder.glob("*.whl")
    session.install(f"--resolution={resolution}", f"{file}[plot]")
    shutil.copy(here / "tests" / "wheel" / "right.py", folder)
    session.chdir(folder)
    session.run("desim", "--version")
    session.run("desim", "examples", "relay")
    session.run("desim", "run", "relay.toml", "-o", "out/run")
    session.run("desim", "replay", "out/run", "-o", "replay.html")
    session.run("desim", "sweep", "relay.toml", "-g", "network.latency.value=0,0.2", "-n", "2", "-o", "out/sweep")
    session.run("python", "right.py")


@nox.session(python=PYTHONS[:1], venv_backend="uv", default=False)
def sdist(session: nox.Session) -> None:
    """Unpack the source distribution, and run both commands of its README there; arguments go to its pytest."""
    folder = _empty(session)
    session.run("uv", "build", "-q", "--sdist", "--out-dir", str(folder))
    (file,) = folder.glob("*.tar.gz")
    for place in ("user", "developer"):
        with tarfile.open(file) as archive:
            archive.extractall(folder / place, filter="data")
    readme = next(folder.glob("user/*/README.md")).read_text(encoding="utf-8")
    first, second = re.findall("^    (python3 -m venv .venv.*)$", readme, re.MULTILINE)
    for place, command in (("user", first), ("developer", " ".join([second, *session.posargs]))):
        session.chdir(next(folder.glob(f"{place}/*")))
        session.run("bash", "-euo", "pipefail", "-c", command, external=True)


def _empty(session: nox.Session) -> Path:
    """Return an empty folder of a session."""
    folder = Path(session.create_tmp()).absolute() / "files"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return folder


if __name__ == "__main__":
    nox.main()
