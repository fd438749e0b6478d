"""What keeps strangers' names off the terminal, links and pipes out of the way of files, and modules unimported."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EINVAL, EISDIR
from pathlib import Path

SHELTER = {"PYTHONSAFEPATH": "1"}
"""What keeps a Python that is started from importing what lies in the folder it is started in; see `sheltered`."""


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
