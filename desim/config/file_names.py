"""How files of results are called: what a name ends in says what is in them."""

import re
from collections.abc import Sequence
from pathlib import Path

TRACE = "trace.jsonl"
"""The events of a run."""
STORE = "sweep.sqlite"
"""The runs of a sweep."""
PICTURES = (".svg", ".png", ".pdf")
"""Suffixes of diagrams; the first two are made if nobody says which."""
OF_A_RUN = (
    *(TRACE, "summary.json", "scenario.toml", "run.json"),
    *("trajectory.svg", "trajectory.png", "replay.html"),
    *("spacetime.svg", "spacetime.png", "trace.perfetto.json", "pursuit.gif"),
)
"""All that `desim run`, `replay` and `draw` make in the folder of a run, if nobody names a file."""
SUFFIX = re.compile(r"\.[A-Za-z]\w*")
"""What can name a kind of file; the ".2" of "v1.2" does not."""


def files(path: Path, kinds: Sequence[str], usual: Sequence[str]) -> list[Path]:
    """Return the files that somebody who names a path wants.

    Args:
        path: with a suffix that is allowed, that one file; without, so many more with the usual ones after its name.
        kinds: suffixes that are allowed, as ".svg"; in upper case, too.
        usual: of those that are made if none is named.

    Raises:
        ValueError: if the path has another suffix.
    """
    if path.suffix.lower() in kinds:
        return [path]
    if SUFFIX.fullmatch(path.suffix):
        raise ValueError(f"{path}: should end in {' or '.join(kinds)}, or have no suffix, got {path.suffix}")
    return [path.with_name(path.name + each) for each in usual]
