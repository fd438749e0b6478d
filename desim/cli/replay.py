"""`desim replay`: a page that plays a run."""

from pathlib import Path

import click

from desim.cli.options import ALLOW_IMPORT, SEED, SET, echo, making, page_at, write
from desim.cli.recorded import SOURCE, result_of


@click.command()
@SOURCE
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    help="The page; default: replay.html in DIR, or here with the name of FILE and suffix .html.",
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
    size, tally = len(started(result).active), messages(result)
    echo(f"{path}: {size} pursuers, {seconds(tally.t):.2f} s, {tally.sent:,} messages, {len(page) / 1000:,.0f} kB")
