"""The commands that added runs to a store, as text for a shell."""

import shlex
from collections.abc import Sequence
from pathlib import Path

from desim.results.provenance import Document


def shell_lines(commands: Sequence[tuple[str, Sequence[str]]]) -> list[str]:
    """Return commands as lines for a shell, with a `cd` wherever the working folder changes.

    Args:
        commands: the working folder and the words of each command.
    """
    lines: list[str] = []
    before = None
    for folder, argv in commands:
        if folder != before:
            lines.append(shlex.join(["cd", folder]))
        lines.append(_command(argv))
        before = folder
    return lines


def _command(argv: Sequence[str]) -> str:
    program, *arguments = argv or ("desim",)
    path = Path(program)
    if path.name == "desim":
        return shlex.join(["desim", *arguments])
    if path.name == "__main__.py":
        return shlex.join(["python", "-m", path.parent.name, *arguments])
    return shlex.join([program, *arguments])


def wanted(made: Document, commands: Sequence[tuple[str, Sequence[str]]]) -> int | None:
    """Return the number of runs that the only command of a sweep requests; None if it was not fixed in advance."""
    is_fixed = made["what"] == "sweep" and len(commands) == 1
    is_until = any(word.startswith("--until") for _, argv in commands for word in argv)
    return int(made["runs"]) if is_fixed and not is_until else None
