"""What the commands share: their options, their scenario, and how they refuse what is wrong."""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

if TYPE_CHECKING:
    from desim.scenario import Scenario
    from desim.source import Source
    from desim.study.store import Store
    from desim.study.workers import Workers

FAILED = 3
"""Exit code of many runs of which some failed."""
WRONG_INPUT = 2
"""Exit code of a bad file or option."""
INTERRUPTED = 130
"""Exit code of Ctrl-C."""

STORE = "sweep.sqlite"
"""The name of a store in a folder."""

FILE = click.argument("file", type=click.Path(path_type=Path))
SET = click.option(
    "--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Override a key, e.g. network.latency.value=0.05."
)
SEED = click.option("-s", "--seed", type=click.IntRange(min=0), help="Seed of the first run; default: the file's.")
JOBS = click.option("-j", "--jobs", type=click.IntRange(min=0), default=1, help="Worker processes; 0 = one per core.")
CLUSTER = click.option(
    "--cluster", metavar="tcp://...", help="Run on the workers of a Dask scheduler (the extra `cluster`)."
)
JSON = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout, all else on stderr.")


def source_of(file: Path, overrides: tuple[str, ...]) -> "tuple[Source, Scenario]":
    """Return what a file says and its scenario; see `valid`."""
    from desim.scenario_file import read
    from desim.source import ScenarioError

    try:
        source = read(file, overrides)
    except ScenarioError as error:
        refuse(str(error))
    except OSError as error:
        refuse(f"{file}: cannot be read: {error.strerror}")
    return source, valid(source)


def valid(source: "Source") -> "Scenario":
    """Return the scenario of a source, warn of what is hardly meant, and end the program if it is wrong."""
    from desim.scenario_file import validate
    from desim.source import ScenarioError
    from desim.warnings import warnings

    try:
        scenario = validate(source)
    except ScenarioError as error:
        refuse(str(error))
    for key, why in warnings(scenario):
        place = tuple(int(part) if part.isdigit() else part for part in key.split("."))
        click.echo(f"warning: {source.where(place)}: {key}: {why}", err=True)
    return scenario


def make_folder(folder: Path) -> None:
    """Make the output folder, or end the program if it cannot be written."""
    from desim.analysis.folder import can_plot

    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".writable").touch()
        (folder / ".writable").unlink()
    except OSError as error:
        refuse(f"--out {folder}: cannot be written: {error.strerror}")
    if not can_plot():
        click.echo("warning: no picture without matplotlib: pip install 'pursuit-desim[plot]'", err=True)


def folder_for(scenario: "Scenario", out: Path | None) -> Path:
    """Return where the results of many runs go if nobody says: below `out`, whatever the scenario is called."""
    return out or Path("out") / (re.sub(r"[^\w-]+", "-", scenario.name).strip("-") or "unnamed")


@contextmanager
def storing(folder: Path | None = None) -> Iterator[None]:
    """End the program if a store or a folder cannot be used, or a cluster does not answer."""
    try:
        yield
    except OSError as error:
        refuse(f"{error.filename or folder}: {error.strerror}" if error.strerror else str(error))  # or it is ours


@contextmanager
def working(jobs: int, cluster: str | None, store: "Store") -> Iterator["Workers"]:
    """Yield workers; if that is interrupted, or a run that fails ends it, say where to go on and end the program."""
    from desim.study.sweep import RunError
    from desim.study.workers import workers_for

    try:
        with workers_for(jobs if cluster is None else cluster) as workers:
            yield workers
    except KeyboardInterrupt:
        click.echo(f"interrupted: {len(store)} runs are in {store.path}; the same command goes on", err=True)
        sys.exit(INTERRUPTED)
    except RunError as error:
        click.echo(f"{error}{len(store)} runs are in {store.path}", err=True)
        sys.exit(FAILED)


def refuse(text: str) -> NoReturn:
    """End the program: what it was given is wrong."""
    click.echo(text, err=True)
    sys.exit(WRONG_INPUT)
