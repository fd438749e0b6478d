"""What was asked for by the commands that made the results in a folder; its run.json keeps what each of them said."""

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
    """Write down where the results of a sweep come from, unless an earlier command asked for all of them, too.

    What earlier commands asked for beyond this one is kept, as `earlier`.

    Args:
        folder: of the results.
        plan: of the sweep.
        home: the folder of the scenario file.
        until: the metric and the half width that were asked for.
        shard: the part and their number, if it is one.
    """
    made = provenance.document(
        "sweep",
        plan.base,
        seed=plan.root,
        runs=len(plan.configurations) * plan.reps,
        folder=home,
        reps=plan.reps,
        until=until,
        shards=shard and shard[1],  # any of them: they may be done all at once
        cwd=str(Path.cwd()),
    )
    before, now = _asked(folder), _of(made)
    if any(_covers(each, now) for each in before):
        return
    if rest := [each for each in before if not _covers(now, each)]:
        made["earlier"] = rest
    provenance.write(folder, made)


def note_merged(folder: Path, store: "Store", parts: Sequence[Path]) -> None:
    """Write down of which stores the runs in a merged one are, and what each command asked for that made them."""
    root = store.said("root seed", int) if "root seed" in store.about else 0  # nothing was run
    made = provenance.document(
        "merge", seed=root, runs=len(store), stores=[str(part) for part in parts], cwd=str(Path.cwd())
    )
    if earlier := [_part(each, part) for part in parts for each in _asked(part.parent)]:
        made["earlier"] = earlier
    provenance.write(folder, made)


def commands(made: Document) -> list[str]:
    """Return what was typed to make all that is there, and where, as a shell reads it."""
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
    """Return how many runs there should be, if that was said beforehand."""
    is_until = any(str(each).startswith("--until") for each in made["argv"])
    open_ended = made["what"] != "sweep" or is_until or made.get("earlier")
    return None if open_ended else int(made["runs"])


def _asked(folder: Path) -> list[Document]:
    """Return what each command asked for that made the results in a folder, the last one last; [] if nobody knows."""
    try:
        made = provenance.read(folder / provenance.FILE)
    except (OSError, ValueError):
        return []
    return [*made.get("earlier", ()), _of(made)]


def _of(made: Document) -> Document:
    """Return what a command asked for, of the document about its results."""
    is_sweep = made["what"] == "sweep" and made["scenario"] is not None
    grid = made["scenario"]["sweep"]["grid"] if is_sweep else None
    return {"argv": made["argv"], "grid": grid} | {key: made.get(key) for key in ("reps", "until", "shards", "cwd")}


def _covers(one: Document, other: Document) -> bool:
    """Return whether a command asked for all that another did, of a sweep that is the same but for its extent."""
    if one["grid"] is None or other["grid"] is None or one["grid"].keys() != other["grid"].keys():
        return False
    more = all(each in one["grid"][key] for key, values in other["grid"].items() for each in values)
    alike = all(one[key] == other[key] for key in ("until", "shards"))
    return more and alike and int(one["reps"]) >= int(other["reps"])


def _part(asked: Document, store: Path) -> Document:
    """Return what was asked for such that it makes one store: if that is of a shard, with its number."""
    if not (found := re.fullmatch(r"sweep\.(\d+)-of-(\d+)\.sqlite", store.name)):
        return asked
    part, parts = found.groups()
    return asked | {
        "argv": [re.sub(rf"^(--shard=)?\d+/{parts}$", rf"\g<1>{part}/{parts}", each) for each in asked["argv"]]
    }
