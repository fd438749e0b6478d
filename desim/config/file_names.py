"""Names of result files; the suffix determines the content."""

import re
from collections.abc import Sequence
from pathlib import Path

TRACE = "trace.jsonl"
"""The events of a run."""
STORE = "sweep.sqlite"
"""The runs of a sweep."""
PICTURES = (".svg", ".png", ".pdf")
"""Suffixes of diagrams; the first two are written by default."""
OF_A_RUN = (
    *(TRACE, "summary.json", "scenario.toml", "run.json"),
    *("trajectory.svg", "trajectory.png", "replay.html"),
    *("spacetime.svg", "spacetime.png", "trace.perfetto.json", "pursuit.gif"),
)
"""All files that `desim run`, `replay` and `draw` write into a run folder by default."""
SUFFIX = re.compile(r"\.[A-Za-z]\w*")
"""A suffix that can denote a file type; the ".2" of "v1.2" does not match."""


def files(path: Path, kinds: Sequence[str], usual: Sequence[str]) -> list[Path]:
    """Return the files to write for a path that a user gives.

    Args:
        path: with an allowed suffix, that one file; without a suffix, one file per suffix in `usual`.
        kinds: the allowed suffixes, such as ".svg", in lower or upper case.
        usual: the suffixes of the default files.

    Raises:
        ValueError: if the path has another suffix.
    """
    if path.suffix.lower() in kinds:
        return [path]
    if SUFFIX.fullmatch(path.suffix):
        raise ValueError(f"{path}: should end in {' or '.join(kinds)}, or have no suffix, got {path.suffix}")
    return [path.with_name(path.name + each) for each in usual]
