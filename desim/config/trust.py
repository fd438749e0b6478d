"""Trust in files of strangers: which files a scenario may name, and what may be imported."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EINVAL, EISDIR
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from desim.config.arguments import value_text
from desim.config.python_numbers import why_no_text

if TYPE_CHECKING:
    from pydantic import ValidationInfo

NO_CWD_IMPORT = {"PYTHONSAFEPATH": "1"}
"""Environment variable that stops a Python process from importing from its working directory; see `no_cwd_import`."""


ALLOW_HINT = "if you trust that file, use --allow-import (in Python, allow_import=True)"
"""Hint in error messages: how to trust a file."""


def regular_or_missing(path: Path) -> Path:
    """Return a path if it is a regular file or does not exist; reading a pipe, for example, may block for ever.

    Raises:
        OSError: if the path is a pipe, a device or a folder.
    """
    if path.is_dir():
        raise IsADirectoryError(EISDIR, os.strerror(EISDIR), str(path))
    if path.exists() and not path.is_file():
        raise OSError(EINVAL, "not a regular file", str(path))
    return path


@contextmanager
def no_cwd_import() -> Iterator[None]:
    """Stop Python processes started in this context from importing from the working directory.

    This protects workers and the resource tracker, a process that `multiprocessing` starts. Workers receive the
    `sys.path` of the parent after they start, so they can import the same modules. Other threads should not start
    processes meanwhile, because these would inherit the setting, too.
    """
    before = {name: os.environ.get(name) for name in NO_CWD_IMPORT}
    os.environ.update(NO_CWD_IMPORT)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def is_trusted(info: "ValidationInfo") -> bool:
    """Return whether validated input comes from Python or a trusted file, and so may run code and read any file."""
    return info.context is None or bool(info.context.get("allow_import"))


def resolve_path(path: Any, info: "ValidationInfo") -> Path:
    """Return a path named in a file, resolved against the folder of that file; see `path_in`.

    If the folder is not known, the path is resolved against the working directory.
    """
    return path_in(Path((info.context or {}).get("folder", ".")), path, is_trusted=is_trusted(info))


def path_in(folder: Path, path: Any, *, is_trusted: bool) -> Path:
    """Return a path that is named in a file in `folder`; a relative path starts at `folder`.

    Raises:
        ValueError: if the value is not a path, the path cannot be resolved, it exists and is not a regular file, or it
            leads out of the folder and the file that names it is not trusted.
    """
    if not isinstance(path, str | PathLike):
        raise ValueError(f"file should be a path (got {value_text(path)})")
    path = Path(path)
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise ValueError(why_no_text(error)) from error
    try:
        is_within = (folder / path).resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError) as error:  # a cycle of symbolic links, a null character
        raise ValueError(f"{path} cannot be read: {error}") from error
    if not (is_within or is_trusted):
        raise ValueError(f"{path} leads out of the folder of the file that names it; {ALLOW_HINT}")
    try:
        return regular_or_missing(folder / path)
    except OSError as error:
        raise ValueError(f"{folder / path} cannot be read: {error.strerror}") from error
