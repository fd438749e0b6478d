"""The output of commands: results, errors and exit codes."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

from desim.cli.usage import problem, spelled
from desim.config.escaping import escaped
from desim.config.extras import EXTRAS, missing
from desim.config.file_names import files, folder_name
from desim.config.whole_files import write_whole

if TYPE_CHECKING:
    from desim.scenario.scenario import Scenario


FAILED = 3
"""Exit code if some of many runs failed."""
WRONG_INPUT = 2
"""Exit code if a file or an option is invalid."""
RAISED = 1
"""Exit code if a user's code fails or returns a wrong value, a time limit is exceeded, or the memory is full."""


def make_folder(folder: Path) -> None:
    """Create the output folder; end the program if it cannot be written. Warn if matplotlib is not installed."""
    from desim.results.run_folder import can_plot

    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".writable").touch()  # the folder may exist, and be closed to the user
        (folder / ".writable").unlink()
    except FileExistsError as error:
        fail(f"--out {folder}: cannot be written: is a file, and should be a folder, made if absent ({error.filename})")
    except OSError as error:
        fail(f"--out {folder}: cannot be written: {error.strerror}; give another folder")
    if not can_plot():
        echo(f"warning: no picture: {missing('matplotlib')}", err=True)


def write(page: bytes, path: Path) -> None:
    """Write a page, and create missing folders; end the program if the page cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, page)
    except OSError as error:
        fail(f"{path}: cannot be written: {error.strerror}")


def page_at(out: Path | None, default: Path) -> Path:
    """Return the path of a page, `default` by default; end the program if `out` has a suffix other than .html."""
    try:
        return default if out is None else files(out, [".html"], [".html"])[0]
    except ValueError as error:
        fail(f"--out {error}")


def folder_for(scenario: "Scenario", out: Path | None) -> Path:
    """Return the folder of the results of many runs: by default out/NAME, where "-" replaces special characters."""
    return out or Path("out") / folder_name(scenario.name)


@contextmanager
def making(page: str) -> Iterator[None]:
    """End the program if a page or picture needs a package that is not installed, or the results are invalid."""
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        fail(f"no {page}: {missing(package, EXTRAS.get(package, 'plot'))}")
    except ValueError as error:
        fail(problem(error))


@contextmanager
def of_option(name: str, value: object) -> Iterator[None]:
    """If the value of an option raises ValueError, end the program with the option and the value before the message."""
    try:
        yield
    except ValueError as error:
        fail(f"{spelled(name)} {value}: {error}")


@contextmanager
def storing(folder: Path | None = None) -> Iterator[None]:
    """End the program if a store or a folder cannot be used, or a cluster does not respond."""
    try:
        yield
    except FileExistsError as error:
        fail(f"{error.filename or folder}: {error.strerror}: a file, where --out should name a folder")
    except OSError as error:
        file = error.filename or folder
        option = "--out " if folder is not None and str(file).startswith(str(folder)) else ""
        fail(f"{option}{file}: {error.strerror}" if error.strerror else str(error))  # a StoreError has no strerror


def echo(text: str, *, err: bool = False, end: str = "\n") -> None:
    """Print a text that may contain untrusted parts, with control characters escaped.

    If stderr is full, this and all later messages are dropped, so that results and the exit code remain.
    """
    try:
        click.echo(escaped(text) + end, nl=False, err=err)
    except OSError:
        if not err:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


MAX_LINE = 2000
"""Maximum length of a line of an error message, characters; a name in a file can be as long as the file."""


def fail(text: str) -> NoReturn:
    """Print an error, without the middle of very long lines, and end the program with exit code `WRONG_INPUT`."""
    half = MAX_LINE // 2
    lines = [line if len(line) <= MAX_LINE else f"{line[:half]} ... {line[-half:]}" for line in text.split("\n")]
    echo("\n".join(lines), err=True)
    sys.exit(WRONG_INPUT)
