"""Names of result files; the suffix determines the format."""

import re
from collections.abc import Sequence
from pathlib import Path

TRACE = "trace.jsonl"
"""The events of a run."""
STORE = "sweep.sqlite"
"""The runs of a sweep."""
STORE_PARTS = "sweep.*-of-*.sqlite"
"""Matches the stores of the shards of a sweep."""
STORES = "sweep*.sqlite"
"""Matches the stores in a folder: that of a sweep and those of its shards."""
PICTURE_SUFFIXES = (".svg", ".png", ".pdf")
"""Suffixes of diagrams; by default, files with the first two are written."""
LIVE = "live.json"
"""How a live run went; only the folder of a live run has it."""
RUN_FILES = (
    *("run.json", TRACE, "summary.json", "scenario.toml", LIVE),
    *("trajectory.svg", "trajectory.png", "replay.html"),
    *("spacetime.svg", "spacetime.png", "trace.perfetto.json", "film.gif"),
)
"""All files that `desim run`, `live`, `replay` and `plot` write into a run folder by default.

They are removed in this order, run.json first, because a folder with a run.json counts as complete."""
SUFFIX = re.compile(r"\.[A-Za-z]\w*")
"""A suffix that can denote a file type; the ".2" of "v1.2" does not match."""


def folder_name(name: str) -> str:
    """Return the name of a scenario as a folder name: "-" replaces special characters; "unnamed" if nothing remains."""
    return re.sub(r"[^\w-]+", "-", name).strip("-") or "unnamed"


def files(path: Path, allowed: Sequence[str], default: Sequence[str]) -> list[Path]:
    """Return the files to write for a path that a user gives.

    Args:
        path: a path with an allowed suffix stands for that one file, a path without a suffix for one file per suffix in
            `default`.
        allowed: the allowed suffixes in lower case, such as ".svg"; the path may have them in upper case.
        default: the suffixes to append to a path without one.

    Raises:
        ValueError: if the path has another suffix.
    """
    if path.suffix.lower() in allowed:
        return [path]
    if SUFFIX.fullmatch(path.suffix):
        raise ValueError(f"{path}: should end in {' or '.join(allowed)}, or have no suffix, got {path.suffix}")
    return [path.with_name(path.name + suffix) for suffix in default]
