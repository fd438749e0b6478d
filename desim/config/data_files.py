"""Data files of models; their content is part of the identity of a run.

The identity of a run is a hash by which a sweep recognises stored results of the same run; see
`desim.study.plan.config_hash`.
"""

import hashlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

from desim.config.arguments import value_text
from desim.config.traits import attributes
from desim.config.trust import regular_or_missing

OPENED = "__opened_data__"
"""The name of the global variable in which a module keeps the content hash of each file that it has opened, by path."""
_identified: ContextVar[bool] = ContextVar("identified", default=False)
"""Whether the code is part of a run whose identity is determined; see `identified_run`."""


class DataFileError(ValueError):
    """Raised when a data file cannot be part of the identity of a run."""


def open_data(path: str | Path) -> BytesIO:
    """Open a data file for reading bytes; its content becomes part of the identity of runs that use the calling module.

    Call it at the top level of the module that defines the model, so that the file is read at import:

        DELAYS = np.loadtxt(open_data(Path(__file__).with_name("delays.txt")))

    A sweep then never reuses results that were stored with another version of the file.

    If a parameter of a model names the file, declare the file in `depends_on` instead: an attribute of the model with a
    tuple of paths, or a method that returns such a tuple.

    Raises:
        TypeError: if `path` is no path.
        OSError: if the file cannot be read.
        DataFileError: if it is called during a run of a sweep, an explanation or `run_many`, because the identity of a
            run is determined before the run starts.
    """
    if _identified.get():
        raise DataFileError(
            f"{path}: is opened during a run, so its content is not part of the identity of the run: open it at the top"
            " level of the model's module, or list it in `depends_on` of the model and use open()"
        )
    if not isinstance(path, str | PathLike):
        raise TypeError(f"open_data takes the path of a file (got {value_text(path)})")
    content = regular_or_missing(Path(path)).read_bytes()
    sys._getframe(1).f_globals.setdefault(OPENED, {})[str(path)] = content_hash(content)
    return BytesIO(content)


def opened_by(module: str) -> dict[str, str]:
    """Return the content hash of each file that a module has opened with `open_data`, by its path."""
    opened: dict[str, str] = getattr(sys.modules.get(module), OPENED, {})
    return opened


def declared(model: Any) -> dict[str, str]:
    """Return the content hash of each file in `depends_on` of a model, by its path.

    Raises:
        DataFileError: if `depends_on` is not a tuple or list of paths, or a file cannot be read.
    """
    paths = attributes(model, ["depends_on"]).get("depends_on", ())
    if callable(paths):
        paths = paths()
    if not (isinstance(paths, tuple | list) and all(isinstance(path, str | PathLike) for path in paths)):
        raise DataFileError(f"depends_on: should be a tuple of paths (got {value_text(paths)})")
    try:
        return {str(path): content_hash(regular_or_missing(Path(path)).read_bytes()) for path in paths}
    except OSError as error:
        raise DataFileError(f"depends_on: {error.filename} cannot be read: {error.strerror}") from error


@contextmanager
def identified_run() -> Iterator[None]:
    """Make `open_data` raise DataFileError in this context: the identity of the run is already fixed."""
    token = _identified.set(True)
    try:
        yield
    finally:
        _identified.reset(token)


def in_short(value: Any) -> Any:
    """Return the content hash in place of a text of several lines; return any other value unchanged."""
    is_long = isinstance(value, str) and "\n" in value
    return f"a text with the hash {content_hash(value.encode())}" if is_long else value


def content_hash(content: bytes) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 hash of some bytes."""
    return hashlib.sha256(content).hexdigest()[:16]
