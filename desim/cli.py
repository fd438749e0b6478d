"""The command line. Whatever takes time to import is imported by the command that needs it."""

import json
import re
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

if TYPE_CHECKING:
    from pydantic import BaseModel

    from desim.scenario import Scenario

WRONG_INPUT = 2
"""Exit code of a bad file or option."""

INTERRUPTED = 130
"""Exit code of Ctrl-C."""

FILE = click.argument("file", type=click.Path(path_type=Path))
SET = click.option(
    "--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Override a key, e.g. network.latency.value=0.05."
)


class Commands(click.Group):
    """Commands that end with 130 when they are interrupted, as a shell expects."""

    def invoke(self, ctx: click.Context) -> object:
        """Run the command that was asked for."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            click.echo("interrupted", err=True)
            ctx.exit(INTERRUPTED)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="pursuit-desim")
def main() -> None:
    """Simulate multi-robot relay pursuit that is negotiated over an imperfect network."""


@main.command()
@FILE
@click.option("-s", "--seed", type=click.IntRange(min=0), help="Seed of the first run; default: that of the file.")
@click.option("-n", "--runs", type=click.IntRange(min=1), default=1, help="Number of runs, with seeds s, s + 1, ...")
@click.option("-j", "--jobs", type=click.IntRange(min=0), default=1, help="Worker processes; 0 = one per core.")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder for the trace and a trajectory picture.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout, all else on stderr.")
@SET
def run(
    file: Path, seed: int | None, runs: int, jobs: int, out: Path | None, as_json: bool, overrides: tuple[str, ...]
) -> None:
    """Run a scenario and say what happened."""
    from functools import partial

    from desim.analysis.batch import run_many, seeds_from
    from desim.analysis.folder import write, write_below
    from desim.analysis.metrics import summary
    from desim.analysis.tables import batch_table, run_table
    from desim.simulation import run as simulate

    scenario = _scenario(file, overrides)
    if out is not None:
        _make_folder(out)
    seeds = seeds_from(scenario.seed if seed is None else seed, runs)
    start = time.perf_counter()
    try:
        if runs == 1:
            result = simulate(scenario, seeds[0])
            wall_time = time.perf_counter() - start
            results = [summary(result) if out is None else write(result, out)]
            table = run_table(scenario, results[0], wall_time)
        else:
            measure = summary if out is None else partial(write_below, out)
            results = run_many([(scenario, each) for each in seeds], jobs, scenario.name, measure)
            table = batch_table(scenario, results, time.perf_counter() - start)
    except OSError as error:
        _refuse(f"--out {error.filename}: cannot be written: {error.strerror}")
    if as_json:
        table = json.dumps({"scenario": scenario.plain(), "runs": [asdict(each) for each in results]}, indent=2)
    click.echo(table)


@main.command()
@FILE
@SET
def check(file: Path, overrides: tuple[str, ...]) -> None:
    """Validate a scenario and print it with every default filled in."""
    from desim.scenario_file import dump

    click.echo(dump(_scenario(file, overrides)), nl=False)


@main.command()
def schema() -> None:
    """Print the JSON schema of scenario files, for editors."""
    from desim.scenario import Scenario

    document = json.dumps(Scenario.model_json_schema())
    strict = json.loads(document, parse_constant=str)  # infinity is a string, as in results
    click.echo(json.dumps(strict, indent=2))


@main.command()
@click.argument("table", required=False)
def keys(table: str | None) -> None:
    """List the keys of scenario files with defaults, units and kinds: all, or those of a TABLE like network."""
    from desim.scenario import Scenario
    from desim.value import described

    lines = list(described(Scenario, "scenario"))
    tops = [k for k, line in enumerate(lines) if re.match(r" {4}\w", line)]
    if table is not None:
        names = [re.split(r"\W", lines[k].strip())[0] for k in tops]
        if table not in names:
            _refuse(f"there is no table {table!r}; allowed: {', '.join(names)}")
        first = tops[names.index(table)]
        lines = lines[first : next((k for k in tops if k > first), len(lines))]
    click.echo("\n".join(lines))


@main.command()
def protocols() -> None:
    """List the installed protocols and their parameters."""
    from desim.scenario import PROTOCOLS
    from desim.value import described

    known: set[type[BaseModel]] = set()  # what several may hold is described once
    for kind, protocol in PROTOCOLS.choices().items():
        click.echo("\n".join(described(protocol, kind, known=known)) + "\n")


def _scenario(file: Path, overrides: tuple[str, ...]) -> "Scenario":
    """Return the scenario of a file, warn of what is hardly meant, and end the program if it is wrong."""
    from desim.scenario_file import ScenarioError, read, validate
    from desim.warnings import warnings

    try:
        source = read(file, overrides)
        scenario = validate(source)
    except ScenarioError as error:
        _refuse(str(error))
    except OSError as error:
        _refuse(f"{file}: cannot be read: {error.strerror}")
    for key, why in warnings(scenario):
        place = tuple(int(part) if part.isdigit() else part for part in key.split("."))
        click.echo(f"warning: {source.where(place)}: {key}: {why}", err=True)
    return scenario


def _make_folder(folder: Path) -> None:
    """Make the output folder, or end the program if it cannot be written."""
    from desim.analysis.folder import can_plot

    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".writable").touch()
        (folder / ".writable").unlink()
    except OSError as error:
        _refuse(f"--out {folder}: cannot be written: {error.strerror}")
    if not can_plot():
        click.echo("warning: no picture without matplotlib: pip install 'pursuit-desim[plot]'", err=True)


def _refuse(text: str) -> NoReturn:
    click.echo(text, err=True)
    sys.exit(WRONG_INPUT)
