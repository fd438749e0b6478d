"""Writing of files: whole or not at all, and not through a symbolic link, if the system can tell."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from errno import EEXIST
from pathlib import Path
from secrets import token_hex


def write_new(files: Mapping[Path, bytes]) -> None:
    """Write files, and create missing folders.

    Raises:
        FileExistsError: if one of the files exists already; then nothing is written.
        OSError: if a file cannot be written.
    """
    for path in files:
        if path.exists() or path.is_symlink():  # `exists` is false for a link to nothing
            raise FileExistsError(
                EEXIST, "exists already and is not overwritten: move it, or write elsewhere", str(path)
            )
    for path, content in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:
            file.write(content)


def open_no_link(path: str, flags: int) -> int:
    """Open a file that is no symbolic link, as an `opener` of `open`; Windows, which lacks the flag, follows links."""
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield the path of a part, PATH.*.part, which the block writes; at its end, the part replaces the file at `path`.

    After an error, the part is removed. The middle of its name is random, so that two programs that write the same file
    at once have different parts. The part is created here, so no file is written through a symbolic link of its name. A
    device or a pipe, such as /dev/stdout, cannot be replaced: its own path is yielded.

    Raises:
        OSError: if the file cannot be replaced.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        yield path
        return
    part = path.with_name(f"{path.name}.{token_hex(4)}.part")
    _create(part, path)
    try:
        yield part
        part.replace(path)
    except BaseException as error:
        if part.is_file():
            part.unlink()
        if isinstance(error, OSError) and error.filename in {None, str(part)}:
            error.filename = str(path)  # the file that the caller knows
        raise


def _create(part: Path, path: Path) -> None:
    """Create the empty part of a file.

    Raises:
        OSError: if the part cannot be created, or its name exists already; the error names `path`.
    """
    try:
        part.touch(exist_ok=False)
    except OSError as error:
        if isinstance(error, FileExistsError):
            error.strerror = f"{part.name} exists already, and is not followed or overwritten"
        error.filename = str(path)
        raise


def write_whole(path: Path, content: bytes) -> None:
    """Write a file; one that is there already is replaced only when the new one is complete.

    Raises:
        OSError: if the file cannot be written; an older file is then unchanged.
    """
    with replacing(path) as part:
        part.write_bytes(content)
