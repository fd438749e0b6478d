"""The commands that made the results in a folder, recorded in its run.json with the runs that each requested."""

import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from desim.results import provenance
from desim.results.provenance import Document

if TYPE_CHECKING:
    from desim.study.store import Store
    from desim.study.sweep import SweepPlan


def note(
    folder: Path,
    plan: "SweepPlan",
    home: Path,
    until: tuple[str, float] | None,
    shard: tuple[int, int] | None,
) -> None:
    """Record the provenance of the results of a sweep, unless an earlier command requested all of its runs.

    Earlier commands that requested other runs are kept, as `earlier`.

    Args:
        folder: the folder of the results.
        plan: the plan of the sweep.
        home: the folder of the scenario file.
        until: the metric and the target half width, if requested.
        shard: the part and the number of parts, if the command runs a shard.
    """
    made = provenance.document(
        "sweep",
        plan.base,
        seed=plan.root,
        runs=len(plan.configurations) * plan.reps,
        folder=home,
        reps=plan.reps,
        until=until,
        shards=shard and shard[1],  # not the part: all parts may run at once
        cwd=str(Path.cwd()),
    )
    before, now = _requests(folder), _request(made)
    if any(_includes(each, now) for each in before):
        return
    if rest := [each for each in before if not _includes(now, each)]:
        made["earlier"] = rest
    provenance.write(folder, made)


def note_merged(folder: Path, store: "Store", parts: Sequence[Path]) -> None:
    """Record the stores that were merged into one, and the request of each command that made them."""
    root = store.read_property("root seed", int) if "root seed" in store.about else 0  # the store is empty
    made = provenance.document(
        "merge", seed=root, runs=len(store), stores=[str(part) for part in parts], cwd=str(Path.cwd())
    )
    if earlier := [_shard_request(each, part) for part in parts for each in _requests(part.parent)]:
        made["earlier"] = earlier
    provenance.write(folder, made)


def commands(made: Document) -> list[str]:
    """Return the shell commands that made the results, with a `cd` wherever the working folder changes."""
    lines: list[str] = []
    before = None
    for each in (*made.get("earlier", ()), made):
        place = each.get("cwd")
        if place is not None and place != before:
            lines.append(shlex.join(["cd", str(place)]))
        lines.append(_command(each["argv"]))
        before = place
    return lines


def _command(argv: Sequence[str]) -> str:
    program, *arguments = map(str, argv) if argv else ("desim",)
    path = Path(program)
    if path.name == "desim":
        return shlex.join(["desim", *arguments])
    if path.name == "__main__.py":
        return shlex.join(["python", "-m", path.parent.name, *arguments])
    return shlex.join([program, *arguments])


def wanted(made: Document) -> int | None:
    """Return the number of runs that a document requests; None if it was not fixed in advance."""
    is_until = any(str(each).startswith("--until") for each in made["argv"])
    open_ended = made["what"] != "sweep" or is_until or made.get("earlier")
    return None if open_ended else int(made["runs"])


def _requests(folder: Path) -> list[Document]:
    """Return the request of each command that made the results in a folder, oldest first; [] if not recorded."""
    try:
        made = provenance.read(folder / provenance.FILE)
    except (OSError, ValueError):
        return []
    return [*made.get("earlier", ()), _request(made)]


def _request(made: Document) -> Document:
    """Return the request of a command, given the provenance document of its results."""
    is_sweep = made["what"] == "sweep" and made["scenario"] is not None
    grid = made["scenario"]["sweep"]["grid"] if is_sweep else None
    return {"argv": made["argv"], "grid": grid} | {key: made.get(key) for key in ("reps", "until", "shards", "cwd")}


def _includes(one: Document, other: Document) -> bool:
    """Return whether a request includes all runs of another request to the same folder.

    The result is false if their keys of the grid, stopping rules or numbers of shards differ.
    """
    if one["grid"] is None or other["grid"] is None or one["grid"].keys() != other["grid"].keys():
        return False
    more = all(each in one["grid"][key] for key, values in other["grid"].items() for each in values)
    alike = all(one[key] == other[key] for key in ("until", "shards"))
    return more and alike and int(one["reps"]) >= int(other["reps"])


def _shard_request(request: Document, store: Path) -> Document:
    """Return a request with its shard number replaced by that in the file name of a store, e.g. sweep.2-of-4.sqlite.

    The shards of a sweep share one folder and so one request. The request for any other store is returned unchanged.
    """
    if not (found := re.fullmatch(r"sweep\.(\d+)-of-(\d+)\.sqlite", store.name)):
        return request
    part, parts = found.groups()
    return request | {
        "argv": [re.sub(rf"^(--shard=)?\d+/{parts}$", rf"\g<1>{part}/{parts}", each) for each in request["argv"]]
    }
