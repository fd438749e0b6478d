"""The commands that show what happened in a run."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from desim.analysis.names import files
from desim.cli.options import SEED, SET, refuse, source_of

if TYPE_CHECKING:
    from desim.simulation import Result

SAMPLES = 0.05
"""Time between samples of a run that is only made to be looked at, if its scenario wants none, s."""


@click.command()
@click.argument("source", metavar="DIR|FILE", type=click.Path(path_type=Path))
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), help="The page; default: replay.html in DIR, or FILE as .html here."
)
@SEED
@SET
def replay(source: Path, out: Path | None, seed: int | None, overrides: tuple[str, ...]) -> None:
    """Make a page that plays a run: of a DIR that `desim run -o DIR` wrote, or of a scenario FILE, which is run."""
    from desim.analysis.reading import messages, started
    from desim.kernel.clock import seconds
    from desim.view.replay import lacks
    from desim.view.replay import replay as page_of

    path = page_at(out, source / "replay.html" if source.is_dir() else Path(source.stem + ".html"))
    result = result_of(source, seed, overrides)
    try:
        for each in lacks(result):
            click.echo(f"warning: {each}", err=True)
        page = page_of(result).encode()
    except ModuleNotFoundError as error:
        refuse(f"a replay needs {error.name}: pip install 'pursuit-desim[plot]'")
    except ValueError as error:
        refuse(str(error))
    put(page, path)
    size, tally = len(started(result).active), messages(result)
    click.echo(
        f"{path}: {size} pursuers, {seconds(tally.t):.2f} s, {tally.sent:,} messages, {len(page) / 1000:,.0f} kB"
    )


def put(page: bytes, path: Path) -> None:
    """Write a page, in folders that are made if need be; end the program if it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(page)
    except OSError as error:
        refuse(f"{path}: cannot be written: {error.strerror}")


def page_at(out: Path | None, usual: Path) -> Path:
    """Return where a page goes; end the program if the name that was asked for is of something else."""
    try:
        return usual if out is None else files(out, [".html"], [".html"])[0]
    except ValueError as error:
        refuse(f"--out {error}")


def result_of(source: Path, seed: int | None, overrides: tuple[str, ...]) -> "Result":
    """Return the run in a folder, or one of a scenario file; end the program if there is none."""
    if not source.is_dir():
        return _simulated(source, seed, overrides)
    if seed is not None or overrides:
        raise click.UsageError("--seed and --set are for a scenario FILE: what is in a DIR has happened")
    return _recorded(source)


def _recorded(folder: Path) -> "Result":
    """Return the run in a folder, or end the program if there is none."""
    from desim.analysis.folder import read
    from desim.source import ScenarioError

    try:
        return read(folder)
    except OSError as error:
        below = sorted(each.parent.name for each in folder.glob("*/trace.jsonl"))
        hint = f"; it holds {', '.join(below[:3])}{' ...' if len(below) > 3 else ''}" if below else ""
        refuse(f"{error.filename}: cannot be read: {error.strerror}{hint}")
    except (ScenarioError, ValueError) as error:
        refuse(str(error))


def _simulated(file: Path, seed: int | None, overrides: tuple[str, ...]) -> "Result":
    """Return a run of a scenario file of which everything is recorded that can be looked at."""
    from desim.simulation import run

    scenario = source_of(file, overrides)[1]
    record = scenario.record.model_copy(update={"messages": True, "trajectory": scenario.record.trajectory or SAMPLES})
    return run(scenario.model_copy(update={"record": record}), seed)
