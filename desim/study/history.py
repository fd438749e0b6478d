"""The commands that added runs to a store, as text for a shell."""

import shlex
from collections.abc import Sequence
from pathlib import Path

from desim.config.trust import escaped
from desim.results.provenance import Document


def shell_lines(commands: Sequence[tuple[str, Sequence[str]]]) -> list[str]:
    """Return commands as lines for a shell, without the absolute folders of their author.

    If they were typed in several folders, a comment has the name of the folder wherever it changes. A path within the
    working folder is relative to it; of another absolute path, the name is left.

    Args:
        commands: the working folder and the words of each command.
    """
    lines: list[str] = []
    several = len({folder for folder, _ in commands}) > 1
    before = None
    for folder, argv in commands:
        if several and folder != before:
            lines.append(f"# in the folder {escaped(Path(folder).name)}")
        lines.append(_command(argv, Path(folder)))
        before = folder
    return lines


def _without_folder(word: str, folder: Path) -> str:
    """Return a word of a command with its path, if it has an absolute one, in the form that `shell_lines` states."""
    option, equals, last = word.rpartition("=")
    path = Path(last)
    if not path.is_absolute():
        return word
    return f"{option}{equals}{path.relative_to(folder) if path.is_relative_to(folder) else path.name}"


def _command(argv: Sequence[str], folder: Path) -> str:
    program, *words = argv or ("desim",)
    arguments = [_without_folder(word, folder) for word in words]
    path = Path(program)
    if path.name == "desim":
        return shlex.join(["desim", *arguments])
    if path.name == "__main__.py":
        return shlex.join(["python", "-m", path.parent.name, *arguments])
    return shlex.join([_without_folder(program, folder), *arguments])


def wanted(made: Document, commands: Sequence[tuple[str, Sequence[str]]]) -> int | None:
    """Return the number of runs that the only command of a sweep requests; None if it was not fixed in advance."""
    is_fixed = made["what"] == "sweep" and len(commands) == 1
    is_until = any(word.startswith("--until") for _, argv in commands for word in argv)
    return int(made["runs"]) if is_fixed and not is_until else None
