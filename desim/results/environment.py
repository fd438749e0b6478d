"""The environment of a run: versions, platform, and the code of desim with its commit."""

import hashlib
import os
import platform
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, entry_points, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

ARITHMETIC = ("numpy", "scipy", "simpy", "networkx")
"""The Python packages that compute the digits of results and the order of events, by distribution name."""
NUMERICS = (*ARITHMETIC, "pydantic")
"""The Python packages that results depend on, by distribution name."""
COMPUTING = ("analysis", "config", "kernel", "pursuit", "scenario", "simulation")
"""The packages in desim whose code affects the result of a run."""
NOT_COMPUTING = ("analysis/deliveries.py", "analysis/measuring.py", "analysis/metrics.py")
"""The modules in packages of `COMPUTING` that `code` leaves out.

They read the deliveries that pictures and searches show, and list and call the metrics. A new metric changes no run,
and the store of a sweep hashes the code of each metric separately."""
GIT_TIMEOUT = 2.0
"""Time limit of a git command, s."""
GIT_VARIABLES = {"GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE", "GIT_COMMON_DIR", "GIT_OBJECT_DIRECTORY"}
"""Environment variables that make git use another repository than that of its folder; git sets them in hooks."""


def environment() -> dict[str, Any]:
    """Return the environment that results depend on in addition to the scenario and the seed, as JSON values."""
    commit, dirty = _checkout()
    return {"versions": _versions(), "platform": _platform(), "commit": commit, "dirty": dirty, "code": code()}


@cache
def code() -> str:
    """Return a hash of the code that a run depends on: `desim/*.py`, the packages of `COMPUTING`, and `protocols`.

    Code that only lists or calls metrics, or stores or shows results, is left out: `NOT_COMPUTING`, `desim/cli`,
    `desim/results`, `desim/study` and `desim/view`.
    """
    package = Path(__file__).parents[1]
    files = [*package.glob("*.py"), *(file for name in COMPUTING for file in (package / name).rglob("*.py"))]
    protocols = find_spec("protocols")
    folders = [Path(folder) for folder in protocols.submodule_search_locations or ()] if protocols is not None else []
    left_out = [package / module for module in NOT_COMPUTING]
    files_by_name = {file.relative_to(package.parent).as_posix(): file for file in files if file not in left_out}
    for folder in folders:
        files_by_name |= {file.relative_to(folder.parent).as_posix(): file for file in folder.rglob("*.py")}
    digest = hashlib.sha256()
    for name, file in sorted(files_by_name.items()):
        digest.update(f"{name}\n".encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def computing_versions() -> dict[str, str]:
    """Return the versions that decide the last digits of results: of Python and of the packages of `ARITHMETIC`.

    The version of Python has no third number, because bug-fix releases of Python change no arithmetic. Bug-fix
    releases of the packages may.
    """
    python = ".".join(platform.python_version_tuple()[:2])
    return {"python": python} | {name: _version(name) or "unknown" for name in ARITHMETIC}


def _versions() -> dict[str, str | None]:
    """Return the versions of Python, desim, the packages of `NUMERICS`, and the installed plugins of desim."""
    installed = entry_points()
    plugins = [
        entry_point
        for group in installed.groups
        if group.startswith("desim.")
        for entry_point in installed.select(group=group)
    ]
    names = {plugin.dist.name for plugin in plugins if plugin.dist is not None} - {"pursuit-desim"}
    versions = {"python": platform.python_version(), "desim": _version("pursuit-desim")}
    return versions | {name: _version(name) for name in (*NUMERICS, *sorted(names))}


@cache
def _version(distribution: str) -> str | None:
    """Return the version of an installed distribution; cached, because each sweep asks twice for `ARITHMETIC`."""
    try:
        return version(distribution)
    except PackageNotFoundError:  # importable from `sys.path` without an installed distribution
        return None


def _platform() -> dict[str, str]:
    """Return the platform, on which the last digits of results may depend."""
    return {
        "system": platform.system(),
        "machine": platform.machine(),
        "libc": " ".join(platform.libc_ver()).strip(),
        "implementation": platform.python_implementation(),
    }


def _checkout() -> tuple[str | None, bool | None]:
    """Return the commit that desim is imported from, and whether its files have changed; (None, None) without a commit.

    The repository must track the package. Otherwise, for example if desim is in the .venv of another project, the
    result is (None, None), too.
    """
    package = Path(__file__).parents[1]
    tracked = _git(package.parent, "ls-files", "--error-unmatch", "--", f"{package.name}/__init__.py")
    paths = (package.name, "protocols", "scenarios", "pyproject.toml")
    status = _git(package.parent, "status", "--porcelain=v2", "--branch", "--untracked-files=normal", "--", *paths)
    if tracked is None or status is None:
        return None, None
    lines = status.splitlines()
    commit = next((line.split()[-1] for line in lines if line.startswith("# branch.oid ")), None)
    if commit in (None, "(initial)"):
        return None, None
    return commit, any(not line.startswith("#") for line in lines)


def _git(folder: Path, *arguments: str) -> str | None:
    """Return the output of a git command in a folder; None if it fails: no git, no repository, or a time-out."""
    environment = {key: value for key, value in os.environ.items() if key not in GIT_VARIABLES}
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            env=environment | {"GIT_OPTIONAL_LOCKS": "0"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=GIT_TIMEOUT,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.decode("utf-8", "replace")
