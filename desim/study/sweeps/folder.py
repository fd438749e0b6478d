"""Reading the results in a folder: a run or a sweep."""

import json
import shlex
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import Json

from desim.config.arguments import RESULTS, naming_arguments
from desim.config.file_names import STORE, STORE_PARTS, TRACE
from desim.results import provenance, run_folder
from desim.simulation.run import Result
from desim.study.results.comparison import Comparison
from desim.study.results.result import SweepResult
from desim.study.results.runs import SHOWN
from desim.study.store.file import adapter_of
from desim.study.store.properties import flat
from desim.study.store.store import Store

SCENARIO = 3
"""The index of the column of `configurations` that holds the scenario."""


@naming_arguments
def open(path: str | PathLike[str], *, allow_import: bool = False) -> Result | SweepResult:  # noqa: A001 - as `desim.open`
    """Read the run or the sweep in a folder; the scenario file is not needed.

    Use it in a notebook for results that the command line made: `desim.open("out/relay").plot()`.

    Args:
        path: a folder written by `desim run -o`, `sweep -o`, `explain -o` or `merge -o`, or the file of one result:
            trace.jsonl, or a store (.sqlite). Give the file if a folder has a run and a sweep.
        allow_import: whether run.json may name code to be imported; see `desim.load`. A sweep is read without imports.

    Raises:
        TypeError: if `path` is neither a text nor a path.
        ValueError: if the path has no run and no sweep, or both (the message says what it has), or if the trace or
            run.json is damaged or of another format.
        OSError: if a file does not exist or cannot be read, or if a store is damaged or of another format.
    """
    RESULTS.check(path, "open")
    path = Path(path)
    if path.is_dir():
        path = _file_in(path)
    elif path.exists() and path.name != TRACE and path.suffix != ".sqlite":
        raise ValueError(f"{path}: is not a result: give a folder, a {TRACE} or a .sqlite{_scenario_hint(path)}")
    if path.name == TRACE:
        return run_folder.read(path.parent, allow_import=allow_import)
    with Store(path, read_only=True) as store:
        return SweepResult.of(store)


def _scenario_hint(path: Path) -> str:
    """Return how to get a result from a scenario file, as the end of a message; "" for any other file."""
    hint = f"; `desim sweep {path} -o DIR` makes one of this scenario, and load({str(path)!r}) reads it"
    return hint if path.suffix == ".toml" else ""


@naming_arguments
def compare(
    first: SweepResult | str | PathLike[str],
    second: SweepResult | str | PathLike[str],
    metrics: Sequence[str] = SHOWN,
) -> Comparison:
    """Compare two sweeps: the second minus the first, for each configuration that both have.

    Use it for two versions of a protocol, or two scenarios that differ in what is not swept. Configurations are matched
    by their values of the keys of the grid. Runs with the same seed are paired; if the two sweeps share fewer than two
    seeds, their runs are compared as independent ones.

        print(desim.compare("out/before", "out/after", ["active_time"]))

    `first` and `second` are sweeps, or folders or stores of sweeps; `metrics` names what is compared.

    Raises:
        ValueError: if a sweep has no numeric metric of a name, the two have no configuration in common, one varies a
            key that the other does not have, or a path is that of no sweep.
        TypeError: if `first` or `second` is neither a sweep nor a path.
        OSError: if a store cannot be read.
    """
    sweeps = [_sweep_of(value) for value in (first, second)]
    paths = [None if isinstance(value, SweepResult) else str(value) for value in (first, second)]
    names = [path or sweep.name for path, sweep in zip(paths, sweeps, strict=True)]
    if names[0] == names[1]:
        names = [f"{name} ({order})" for name, order in zip(names, ("first", "second"), strict=True)]
    old, new = (
        None if path is None else _shared_values(Path(path), sweep, other)
        for path, sweep, other in zip(paths, sweeps, reversed(sweeps), strict=True)
    )
    changes = {} if old is None or new is None else _changes(old, new)
    return Comparison.of(sweeps[0], sweeps[1], metrics, (names[0], names[1]), changes)


def _sweep_of(value: SweepResult | str | PathLike[str]) -> SweepResult:
    """Return a sweep, read from its folder if a path is given.

    Raises:
        ValueError: if the path is that of no sweep.
        TypeError: if the value is neither a sweep nor a path.
    """
    if isinstance(value, SweepResult):
        return value
    if not isinstance(value, str | PathLike):
        raise TypeError(f"compare takes two sweeps, or the folders of two sweeps, got {type(value).__name__}")
    if not isinstance(result := open(value), SweepResult):
        raise ValueError(f"{value}: is a run, and sweeps are compared; `desim replay A B` shows two runs side by side")
    return result


def _shared_values(path: Path, sweep: SweepResult, other: SweepResult) -> dict[str, str]:
    """Return the values, as JSON text by dotted key, that all configurations of a sweep share.

    Keys in the grids of both sweeps are left out. A key that only this grid has must have one value, which is included.
    """
    with Store(_file_in(path) if path.is_dir() else path, read_only=True) as store:
        shared = store.read_property("scenario", dict[str, Any]) if "scenario" in store.about else {}
        (row,) = store.rows("configurations", "ORDER BY place LIMIT 1")
        values = flat(store.read(adapter_of(Json[dict[str, Any]]), "configurations", row, SCENARIO))
    own_keys = tuple(f"{key}." for key in sweep.keys if key not in other.keys)
    shared |= {key: value for key, value in values.items() if f"{key}.".startswith(own_keys)}
    return {key: json.dumps(value) for key, value in shared.items()}


def _changes(first: dict[str, str], second: dict[str, str]) -> dict[str, tuple[str, str]]:
    keys = dict.fromkeys([*first, *second])
    pairs = {key: (first.get(key, "not there"), second.get(key, "not there")) for key in keys}
    return {key: pair for key, pair in pairs.items() if pair[0] != pair[1]}


def _file_in(folder: Path) -> Path:
    """Return the file with the result in a folder.

    Raises:
        ValueError: if the folder has no result, or both a run and a sweep.
    """
    files = [folder / name for name in (TRACE, STORE) if (folder / name).exists()]
    if len(files) == 1:
        return files[0]
    if files:
        raise ValueError(f"{folder}: has a run and a sweep: give {files[0]} or {files[1]}")
    raise ValueError(f"{folder}: {contents(folder)}")


def contents(folder: Path) -> str:
    """Return a description of a folder that has no result of its own."""
    quoted = shlex.quote(str(folder))
    if parts := _names(part.name for part in folder.glob(STORE_PARTS)):
        return f"has parts of a sweep ({parts}): merge them first: desim merge {quoted} -o {quoted}"
    if with_results := _names({file.parent.name for name in (TRACE, STORE) for file in folder.glob(f"*/{name}")}):
        return f"has no result itself, but its folders have ({with_results}): give one of them"
    if (folder / provenance.FILE).exists():
        kind = provenance.read(folder / provenance.FILE)["what"]
        return f"has the {provenance.FILE} of {kind!r}, but neither {TRACE} nor {STORE}"
    return f"has no result of desim: neither {TRACE} nor {STORE}"


def _names(names: Iterable[str]) -> str:
    """Return the first three names in alphabetical order, as text; "" if there are none."""
    ordered = sorted(names)
    return f"{', '.join(ordered[:3])}{' ...' if len(ordered) > 3 else ''}"
