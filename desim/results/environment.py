"""What results depend on beside scenario and seed: versions, platform, and the code of desim with its commit."""

import hashlib
import os
import platform
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, entry_points, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

NUMERICS = ("numpy", "scipy", "simpy", "networkx", "pydantic")
"""What else a result depends on: distributions, whose versions pip knows."""
COMPUTING = ("analysis", "config", "kernel", "pursuit", "scenario", "simulation")
"""The packages in desim whose code decides what comes of a run."""
GIT_TIMEOUT = 2.0
"""How long git may take, s."""
ELSEWHERE = {"GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE", "GIT_COMMON_DIR", "GIT_OBJECT_DIRECTORY"}
"""Variables that make git look into another repository than that of a folder; a hook has them."""


def environment() -> dict[str, Any]:
    """Return what results depend on beside scenario and seed, as JSON has it."""
    commit, dirty = _checkout()
    return {"versions": _versions(), "platform": _platform(), "commit": commit, "dirty": dirty, "code": code()}


@cache
def code() -> str:
    """Return a hash of the source of all that a run depends on: the packages desim and protocols, installed or not.

    But for what shows and stores results: `desim/cli`, `desim/study`, `desim/view`.
    """
    here = Path(__file__).parents[1]
    files = [*here.glob("*.py"), *(file for part in COMPUTING for file in (here / part).glob("*.py"))]
    protocols = find_spec("protocols")
    folders = protocols.submodule_search_locations if protocols is not None else None
    files += [file for folder in folders or () for file in Path(folder).glob("*.py")]
    digest = hashlib.sha256()
    for file in sorted(files, key=lambda file: (file.parent.name, file.name)):
        digest.update(f"{file.parent.name}/{file.name}\n".encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def _versions() -> dict[str, str | None]:
    """Return the versions of python, of desim, of what it computes with, and of what adds models to it."""
    plugged = {
        each.dist.name
        for group in entry_points().groups
        if group.startswith("desim.")
        for each in entry_points(group=group)
        if each.dist is not None
    }
    ours = {"python": platform.python_version(), "desim": _version("pursuit-desim")}
    return ours | {name: _version(name) for name in (*NUMERICS, *sorted(plugged - {"pursuit-desim"}))}


def _version(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:  # it was put on the path, not installed
        return None


def _platform() -> dict[str, str]:
    """Return what the last digit of a number may depend on."""
    return {
        "system": platform.system(),
        "machine": platform.machine(),
        "libc": " ".join(platform.libc_ver()).strip(),
        "implementation": platform.python_implementation(),
    }


def _checkout() -> tuple[str | None, bool | None]:
    """Return the commit that desim is imported from, and whether its code was changed since; None if from no commit.

    The repository must track the package: that of a project whose .venv holds desim does not.
    """
    package = Path(__file__).parents[1]
    tracked = _git(package.parent, "ls-files", "--error-unmatch", "--", f"{package.name}/__init__.py")
    paths = (package.name, "protocols", "scenarios", "pyproject.toml")
    told = _git(package.parent, "status", "--porcelain=v2", "--branch", "--untracked-files=normal", "--", *paths)
    if tracked is None or told is None:
        return None, None
    lines = told.splitlines()
    commit = next((line.split()[-1] for line in lines if line.startswith("# branch.oid ")), None)
    if commit in (None, "(initial)"):
        return None, None
    return commit, any(not line.startswith("#") for line in lines)


def _git(folder: Path, *words: str) -> str | None:
    """Return what git says of a folder; None if it says nothing: there is no git, or no repository, or no answer."""
    found = {key: each for key, each in os.environ.items() if key not in ELSEWHERE}
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *words],
            env=found | {"GIT_OPTIONAL_LOCKS": "0"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=GIT_TIMEOUT,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.decode("utf-8", "replace")
