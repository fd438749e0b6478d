"""Where results come from: `run.json`, which says what was done with which code, and from which it can be done again.

There is no date in it: the same run gives the same bytes, except for the command line and the commit.
"""

import hashlib
import json
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, entry_points, version
from importlib.util import find_spec
from math import isfinite, isnan
from pathlib import Path
from types import FunctionType, NoneType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from desim.scenario import Scenario
    from desim.source import Source

Document = dict[str, Any]
"""What a run.json says, as JSON has it."""
FILE = "run.json"
RUN = "run"
"""What `desim run` does; everything else cannot be repeated by it."""
SHAPE: Mapping[str, tuple[type, ...]] = {
    "what": (str,),
    "seed": (int,),
    "runs": (int,),
    "scenario": (dict, NoneType),
    "folder": (str, NoneType),
    "unrecorded": (list,),
    "versions": (dict,),
    "platform": (dict,),
    "commit": (str, NoneType),
    "dirty": (bool, NoneType),
    "code": (str,),
    "argv": (list,),
}
"""The keys that every run.json has, and what they may hold."""
WORDS: Mapping[type, str] = {
    str: "a text",
    int: "an integer",
    bool: "true or false",
    dict: "a table",
    list: "a list",
    NoneType: "null",
}
NUMERICS = ("numpy", "scipy", "simpy", "networkx", "pydantic")
"""What else a result depends on: distributions, whose versions pip knows."""
COMPUTING = ("analysis", "kernel", "pursuit")
"""The packages in desim whose code decides what comes of a run."""
GIT_TIMEOUT = 2.0
"""How long git may take, s."""
ELSEWHERE = {"GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE", "GIT_COMMON_DIR", "GIT_OBJECT_DIRECTORY"}
"""Variables that make git look into another repository than that of a folder; a hook has them."""


class ProvenanceError(ValueError):
    """A file is no run.json, or of nothing that can be repeated; the text has one line per fault."""


def document(
    what: str,
    scenario: "Scenario | None" = None,
    *,
    seed: int,
    runs: int = 1,
    folder: Path | None = None,
    **more: Any,
) -> Document:
    """Return where results come from, as a JSON document.

    Args:
        what: "run", "sweep", or the name of a study.
        scenario: what was simulated, if it was one.
        seed: of the first run; the recorded scenario has it, too.
        runs: their number, with seeds s, s + 1, ...
        folder: of the scenario file, where a module that it names may lie.
        more: what else there is to say; infinity becomes the string "Infinity", as in the scenario.
    """
    return {
        "what": what,
        "seed": seed,
        "runs": runs,
        "scenario": None if scenario is None else scenario.plain() | {"seed": seed},
        "folder": None if folder is None else str(folder.absolute()),
        "unrecorded": [] if scenario is None else list(_unrecorded(scenario)),
        **environment(),
        "argv": list(sys.argv),
        **_text(more),
    }


@cache
def code() -> str:
    """Return a hash of the source of all that a run depends on: the packages desim and protocols, installed or not.

    But for what shows and stores results: `desim/cli`, `desim/study`, `desim/view`.
    """
    here = Path(__file__).parent
    files = [*here.glob("*.py"), *(file for part in COMPUTING for file in (here / part).glob("*.py"))]
    protocols = find_spec("protocols")
    folders = protocols.submodule_search_locations if protocols is not None else None
    files += [file for folder in folders or () for file in Path(folder).glob("*.py")]
    digest = hashlib.sha256()
    for file in sorted(files, key=lambda file: (file.parent.name, file.name)):
        digest.update(f"{file.parent.name}/{file.name}\n".encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def of_one(made: Document, seed: int) -> Document:
    """Return the document of one of several runs."""
    return made | {"seed": seed, "runs": 1, "scenario": made["scenario"] | {"seed": seed}}


def environment() -> Document:
    """Return what results depend on beside scenario and seed: versions, platform and commit."""
    commit, dirty = _checkout()
    return {"versions": _versions(), "platform": _platform(), "commit": commit, "dirty": dirty, "code": code()}


def write(folder: Path, made: Document, name: str = FILE) -> None:
    """Write a document to a folder, which is made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(made, indent=2, allow_nan=False)
    (folder / name).write_text(text + "\n", encoding="utf-8")


def read(path: Path) -> Document:
    """Return what a run.json says, of whatever it is.

    Raises:
        ProvenanceError: if it is none; with all that is missing or wrong.
        OSError: if it cannot be read.
    """
    content = path.read_bytes()
    try:
        made = json.loads(content)
    except json.JSONDecodeError as error:
        raise ProvenanceError(f"{path}:{error.lineno}: not JSON: {error.msg}") from error
    except (ValueError, RecursionError) as error:
        raise ProvenanceError(f"{path}: not JSON: {error}") from error
    if not isinstance(made, dict):
        raise ProvenanceError(f"{path}: is no {FILE}: should be a table")
    if missing := [key for key in SHAPE if key not in made]:
        raise ProvenanceError(f"{path}: is no {FILE}: lacks {', '.join(missing)}")
    if faults := list(_faults(made)):
        raise ProvenanceError("\n".join(f"{path}: {each}" for each in faults))
    return made


def source(path: Path, made: Document, overrides: Sequence[str] = ()) -> "Source":
    """Return what a run.json recorded as its scenario, with overrides, not yet validated.

    What it names lies in the folder of its scenario file; if that is gone, in the folder of the run.json.

    Raises:
        ProvenanceError: if it is not of runs, or names a model that nobody can import.
        ScenarioError: if an override is wrong.
    """
    from desim.source import Source

    if made["what"] != RUN or made["scenario"] is None:
        done = "a sweep" if made["what"] == "sweep" else f"the study {made['what']!r}"
        by = shlex.join(map(str, made["argv"]))
        raise ProvenanceError(f"{path}: is of {done}, which is not repeated by desim run; it was made by: {by}")
    folder = None if made["folder"] is None else Path(made["folder"])
    home = folder if folder is not None and folder.is_dir() else path.parent
    recorded = Source(str(path), _given(made["scenario"]), folder=home)
    for override in overrides:
        recorded.override(override)
    if homeless := list(_homeless(recorded.tables)):
        raise ProvenanceError("\n".join(f"{recorded.where(place)}: {text}" for place, text in homeless))
    return recorded


def differences(then: Document, now: Document) -> list[str]:
    """Return why results may differ from the recorded ones: which versions, platform or code did; [] if nothing."""
    found = [
        f"{name} was {then[key].get(name) or 'unknown'} and is {now[key].get(name) or 'unknown'}"
        for key in ("versions", "platform")
        for name in sorted({*then[key], *now[key]})
        if then[key].get(name) != now[key].get(name)
    ]
    if then["code"] != now["code"]:
        found.append(f"the code of desim was {_commit(then)} and is {_commit(now)}")
    return found + [f"the parameters of {key} are not recorded" for key in then["unrecorded"]]


def _commit(made: Document) -> str:
    return f"{made['commit'] or 'of no commit'}{' with changes' if made['dirty'] else ''}, {made['code']}"


def _faults(made: Document) -> Iterator[str]:
    """Yield what is wrong with the values of a document that has all keys."""
    for key, kinds in SHAPE.items():
        if type(made[key]) not in kinds:
            yield f"{key}: should be {' or '.join(WORDS[kind] for kind in kinds)} (got {json.dumps(made[key])})"
    runs, seed, scenario = made["runs"], made["seed"], made["scenario"]
    if type(runs) is int and runs < 1:
        yield f"runs: should be at least 1 (got {runs})"
    if type(seed) is int and isinstance(scenario, dict) and scenario.get("seed", seed) != seed:
        yield f"seed: should be that of the scenario: {json.dumps(scenario['seed'])} (got {seed})"


def _given(scenario: Document) -> Document:
    """Return the tables of a recorded scenario such that each key can be overridden as in a file.

    Infinity is a number again, and a network says nothing of what its preset stands for, or it would hold against
    another preset.
    """
    from desim.kernel.links import Links
    from desim.kernel.presets import PRESETS

    tables: Document = {key: each if key == "name" else _number(each) for key, each in scenario.items()}
    network = tables.get("network")
    if isinstance(network, dict) and ((preset := network.get("preset")) is None or str(preset) in PRESETS):
        usual = _number(Links(preset=preset).plain())
        tables["network"] = {key: each for key, each in network.items() if key == "preset" or each != usual.get(key)}
    return tables


def _text(value: Any) -> Any:
    """Return a value with the texts that stand for the numbers which JSON has not."""
    if isinstance(value, Mapping):
        return {key: _text(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_text(each) for each in value]
    if isinstance(value, float) and not isfinite(value):
        return "NaN" if isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def _number(value: Any) -> Any:
    """Return a value of JSON with numbers for the texts that stand for what JSON has no number for."""
    if isinstance(value, dict):
        return {key: _number(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_number(each) for each in value]
    return float(value) if value in ("Infinity", "-Infinity", "NaN") else value


def _homeless(node: Any, place: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Yield the place of each model that was made where nobody can import it from, and what is wrong with it."""
    inner = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, each in inner:
        if key == "kind" and isinstance(each, str) and (each.startswith("__main__:") or "<" in each):
            text = f"{each!r} was defined in a script or in a function and cannot be imported; move it to a module"
            yield place, f"{'.'.join(map(str, place))}: {text}"
        yield from _homeless(each, (*place, key))


def _unrecorded(node: Any, place: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield the dotted key of each model whose parameters nobody but itself knows: an object of one's own class."""
    from pydantic import BaseModel

    if isinstance(node, BaseModel):
        for name in type(node).model_fields:
            yield from _unrecorded(getattr(node, name), (*place, name))
    elif isinstance(node, tuple):
        for k, each in enumerate(node):
            yield from _unrecorded(each, (*place, str(k)))
    elif callable(node) and not isinstance(node, FunctionType) and not is_dataclass(node) and node.__getstate__():
        yield ".".join(place)


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
    package = Path(__file__).parent
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
