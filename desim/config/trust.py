"""What keeps strangers' names off the terminal, links and pipes out of the way of files, and modules unimported."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EINVAL, EISDIR
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pydantic import ValidationInfo

SHELTER = {"PYTHONSAFEPATH": "1"}
"""What keeps a Python that is started from importing what lies in the folder it is started in; see `sheltered`."""


ALLOW = "if you trust that file, say --allow-import (in Python, allow_import=True)"
"""How to let a file do what those of strangers may not."""


def visible(text: str) -> str:
    """Return a text that does nothing to a terminal: what cannot be printed is written as TOML and JSON escape it."""
    return "".join(each if each.isprintable() or each in "\n\t" else _escaped(ord(each)) for each in text)


def fresh(path: Path) -> Path:
    """Return a path to be written; a link that has its name is removed, for it leads elsewhere than was asked.

    Raises:
        OSError: if it cannot be removed.
    """
    if path.is_symlink():
        path.unlink()
    return path


def regular(path: Path) -> Path:
    """Return a path to be read, if it leads to a file of data, or to nothing: to read a pipe may wait for ever.

    Raises:
        OSError: if it leads to a pipe, a device or a folder.
    """
    if path.is_dir():
        raise IsADirectoryError(EISDIR, os.strerror(EISDIR), str(path))
    if path.exists() and not path.is_file():
        raise OSError(EINVAL, "not a regular file", str(path))
    return path


@contextmanager
def sheltered() -> Iterator[None]:
    """Let no Python that is started meanwhile import from the folder we are in: workers, and who tracks what they hold.

    Workers are told our own `sys.path` later. Not for while others start processes: they copy the environment.
    """
    before = {name: os.environ.get(name) for name in SHELTER}
    os.environ.update(SHELTER)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _escaped(number: int) -> str:
    return f"\\u{number:04x}" if number < 2**16 else f"\\U{number:08x}"


def is_trusted(info: "ValidationInfo") -> bool:
    """Return whether what is validated may run code and read any file: it is Python's, or a file that is allowed to."""
    return info.context is None or bool(info.context.get("allow_import"))


def resolve_path(path: Any, info: "ValidationInfo") -> Path:
    """Return a path that a file names: relative to the folder of that file, if it is known, and not outside of it.

    Raises:
        ValueError: if it is not a text, is no regular file, or leads out of the folder and the file is not trusted.
    """
    if not isinstance(path, str | Path):
        raise ValueError(f"file should be a path (got {path!r})")
    folder = Path((info.context or {}).get("folder", "."))
    try:
        is_within = (folder / path).resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError) as error:  # links that lead to each other
        raise ValueError(f"{path} cannot be read: {error}") from error
    if not (is_within or is_trusted(info)):
        raise ValueError(f"{path} leads out of the folder of the file that names it; {ALLOW}")
    try:
        return regular(folder / path)
    except OSError as error:
        raise ValueError(f"{folder / path} cannot be read: {error.strerror}") from error
