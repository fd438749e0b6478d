"""`desim replay` and `desim report`: a page that plays a run, and a page about a sweep."""

import shlex
from pathlib import Path

import click

from desim.cli.options import ALLOW_IMPORT, SEED, SET, echo, fail, making, page_at, storing, write
from desim.cli.recorded import SOURCE, check_no_run, result_of
from desim.config.file_names import STORE, STORE_PARTS


@click.command()
@SOURCE
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    help="The page; default: DIR/replay.html for a DIR, ./NAME.html for a FILE named NAME.toml.",
)
@SEED
@ALLOW_IMPORT
@SET
def replay(source: Path, out: Path | None, seed: int | None, overrides: tuple[str, ...]) -> None:
    """Make a page that plays a run: a DIR written by `desim run -o DIR`, or a scenario FILE, which is run first."""
    from desim.analysis.trace_index import messages, started
    from desim.kernel.clock import seconds
    from desim.view.replay import missing_recordings
    from desim.view.replay import replay as page_of

    path = page_at(out, source / "replay.html" if source.is_dir() else Path(source.stem + ".html"))
    result = result_of(source, seed, overrides)
    with making("replay"):
        for each in missing_recordings(result):
            echo(f"warning: {each}", err=True)
        page = page_of(result).encode()
    write(page, path)
    size, counts = len(started(result).active), messages(result)
    echo(f"{path}: {size} pursuers, {seconds(counts.t):.2f} s, {counts.sent:,} messages, {len(page) / 1000:,.0f} kB")


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), help="The page; default: report.html in DIR.")
def report(folder: Path, out: Path | None) -> None:
    """Make a page about a sweep: a DIR written by `desim sweep -o DIR` or `desim explain -o DIR`."""
    from desim.view.report import Study
    from desim.view.report import report as page_of

    path = page_at(out, folder / "report.html")
    _check_merged(folder)
    check_no_run(folder)
    with making("report"):
        with storing(folder):
            study = Study.read(folder)
        page = page_of(study).encode()
    write(page, path)
    groups = study.result.groups
    echo(f"{path}: {len(groups)} configurations, {study.runs:,} runs, {len(page) / 1000:,.0f} kB")


def _check_merged(folder: Path) -> None:
    """End the program if a folder has stores of the shards of a sweep but no merged store."""
    parts = sorted(each.name for each in folder.glob(STORE_PARTS))
    if parts and not (folder / STORE).exists():
        names = f"{', '.join(parts[:3])}{' ...' if len(parts) > 3 else ''}"
        where = shlex.quote(str(folder))
        fail(f"{folder}: holds parts of a sweep ({names}); merge them first: desim merge {where} -o {where}")
