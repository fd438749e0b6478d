#!/usr/bin/env -S uv run --script
# /// script
# dependencies = ["nox>=2025.2.9", "uv"]
# ///
"""The checks of the project, each in an environment of its own: `nox -l` lists them, `nox -s lint` runs one."""

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


if __name__ == "__main__":
    nox.main()
