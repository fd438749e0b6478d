"""The commands that added runs to a store, as text for a shell."""

import re
import shlex
from collections.abc import Sequence
from pathlib import Path

from desim.config.escaping import escaped
from desim.results.provenance import Document

PATH = re.compile(r"""(^|^-[A-Za-z]|[="'\[, ])((?:[A-Za-z]:)?[/\\][^"',\]]+)""")
"""An absolute path in a word of a command: at its start, or after a short option, "=", ",", "[", a quote or a space."""


def shell_lines(commands: Sequence[tuple[str, Sequence[str]]]) -> list[str]:
    """Return commands as lines for a shell, without absolute paths.

    A command is its working folder and its words. If the commands were given in several folders, a comment names the
    folder wherever it changes. An absolute path within the working folder is made relative to it; any other absolute
    path is replaced by its last component.
    """
    lines: list[str] = []
    is_in_several = len({folder for folder, _ in commands}) > 1
    last_folder = None
    for folder, argv in commands:
        if is_in_several and folder != last_folder:
            lines.append(f"# in the folder {escaped(Path(folder).name)}")
        lines.append(_command(argv, Path(folder)))
        last_folder = folder
    return lines


def _without_folder(word: str, folder: Path) -> str:
    """Return a word of a command; each absolute path in it is replaced as `shell_lines` states."""

    def shortened(match: re.Match[str]) -> str:
        path = Path(match[2])
        return match[1] + str(path.relative_to(folder) if path.is_relative_to(folder) else path.name)

    return PATH.sub(shortened, word)


def _command(argv: Sequence[str], folder: Path) -> str:
    program, *words = argv or ("desim",)
    arguments = [_without_folder(word, folder) for word in words]
    path = Path(program)
    if path.name == "desim":
        return shlex.join(["desim", *arguments])
    if path.name == "__main__.py":
        return shlex.join(["python", "-m", path.parent.name, *arguments])
    return shlex.join([_without_folder(program, folder), *arguments])


def runs_requested(made: Document, commands: Sequence[tuple[str, Sequence[str]]]) -> int | None:
    """Return the number of runs that a sweep requests, given its run.json and the commands that added runs.

    Return None if the run.json is not that of a sweep. Return None, too, if the number was not fixed in advance: with
    several commands, or with the option --until.
    """
    is_fixed = made["what"] == "sweep" and len(commands) == 1
    is_until = any(word.startswith("--until") for _, argv in commands for word in argv)
    return int(made["runs"]) if is_fixed and not is_until else None
