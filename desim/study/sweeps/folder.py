"""Reading the results in a folder: a run or a sweep."""

import shlex
from collections.abc import Iterable
from pathlib import Path
from types import MappingProxyType

from desim.config.arguments import Argument
from desim.config.file_names import STORE, STORE_PARTS, TRACE
from desim.results import provenance, run_folder
from desim.simulation.run import Result
from desim.study.results.result import SweepResult
from desim.study.store.store import Store

PATH = Argument("the path of a folder with results", (str, Path), MappingProxyType({}))


def open(path: str | Path, *, allow_import: bool = False) -> Result | SweepResult:  # noqa: A001 - as `desim.open`
    """Read the run or the sweep in a folder; the scenario file is not needed.

    Use it in a notebook for results that the command line made: `desim.open("out/relay").plot()`.

    Args:
        path: a folder written by `desim run -o`, `sweep -o`, `explain -o` or `merge -o`, or the file of one result:
            trace.jsonl, or a store (.sqlite). Give the file if a folder has a run and a sweep.
        allow_import: whether run.json may name code to be imported; see `desim.load`. A sweep is read without imports.

    Raises:
        TypeError: if it is not a path.
        ValueError: if the path has no run and no sweep, or both (the message says what it has), or if the trace or
            run.json is damaged or of another format.
        OSError: if a file does not exist or cannot be read, or if a store is damaged or of another format.
    """
    PATH.check(path, "open")
    path = Path(path)
    if path.is_dir():
        path = _file_in(path)
    elif path.exists() and path.name != TRACE and path.suffix != ".sqlite":
        raise ValueError(f"{path}: is not a result: give a folder, a {TRACE} or a .sqlite; desim.load reads scenarios")
    if path.name == TRACE:
        return run_folder.read(path.parent, allow_import=allow_import)
    with Store(path, read_only=True) as store:
        return SweepResult.of(store)


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
    where = shlex.quote(str(folder))
    if parts := _names(part.name for part in folder.glob(STORE_PARTS)):
        return f"has parts of a sweep ({parts}): merge them first: desim merge {where} -o {where}"
    if below := _names({file.parent.name for name in (TRACE, STORE) for file in folder.glob(f"*/{name}")}):
        return f"has no result itself, but its folders have ({below}): give one of them"
    if (folder / provenance.FILE).exists():
        kind = provenance.read(folder / provenance.FILE)["what"]
        return f"has the {provenance.FILE} of {kind!r}, but neither {TRACE} nor {STORE}"
    return f"has no result of desim: neither {TRACE} nor {STORE}"


def _names(names: Iterable[str]) -> str:
    """Return the first three names in alphabetical order, as text; "" if there are none."""
    ordered = sorted(names)
    return f"{', '.join(ordered[:3])}{' ...' if len(ordered) > 3 else ''}"
