"""Pages: `desim replay` plays runs, `desim report` shows a sweep, and `desim play` lets users change a scenario."""

import os
import shlex
import webbrowser
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import TYPE_CHECKING

import click

from desim.cli.options import AGAINST, PATH, SEED, TIMEOUT, is_import_allowed, limited, out_to, overriding
from desim.cli.output import echo, fail, making, of_option, page_at, storing, write
from desim.cli.recorded import SOURCES, is_recorded, result_of
from desim.cli.sources import source_of
from desim.config.file_names import STORE, STORE_PARTS, TRACE

if TYPE_CHECKING:
    from desim.simulation.run import Result


@click.command()
@SOURCES
@out_to(
    "The page; default: DIR/replay.html for a DIR, ./NAME.html for a FILE named NAME.toml, ./A-B.html for two"
    " sources named A and B."
)
@SEED
@limited
@overriding
def replay(sources: tuple[Path, ...], out: Path | None, seed: int | None, overrides: tuple[str, ...]) -> None:
    """Make a page that plays a run: a DIR written by `desim run -o DIR`, or a scenario FILE, which is run first.

    Of two runs, make a page that plays both side by side on one clock, and names the differences of their scenarios.
    """
    from desim.study.workers.progress import progress
    from desim.view.pages import pair
    from desim.view.pages import replay as single
    from desim.view.pages.headline import run_name
    from desim.view.pages.replay_data import PARTS

    path = page_at(out, _usual_page(sources))
    if path.resolve() in [source.resolve() for source in sources]:
        fail(f"{path}: is a source, and the page would replace it; give another --out")
    for source in sources:
        if not is_recorded(source) and (warning := single.size_warning(source_of(source, overrides)[1])):
            echo(f"warning: {source}: {warning}", err=True)
    # Recorded sources come first: if one is invalid, the program ends before a scenario is run.
    recorded_first = sorted(dict.fromkeys(sources), key=is_recorded, reverse=True)
    with making("replay"), progress(len(recorded_first) + PARTS * len(sources), path.name, "part") as bar:
        by_source = {}
        for source in recorded_first:
            by_source[source] = result_of(source, seed, overrides)
            bar.update()
        results = [by_source[source] for source in sources]
        for source, result in zip(sources, results, strict=True):
            for missing in single.missing_recordings(result):
                echo(f"warning: {f'{source}: ' if len(sources) > 1 else ''}{missing}", err=True)
        page = (single.replay_page if len(sources) == 1 else pair.side_by_side)(*results, on_part=bar.update).encode()
    write(page, path)
    runs = "; ".join(f"{run_name(result)}: {_size(result)}" for result in results)
    echo(f"{path}: {_size(*results) if len(results) == 1 else runs}, {len(page) / 1000:,.0f} kB")


def _usual_page(sources: tuple[Path, ...]) -> Path:
    """Return the default path of the page that plays one or two runs; DIR/trace.jsonl stands for DIR."""
    sources = tuple(source.parent if source.name == TRACE else source for source in sources)
    if len(sources) == 1 and sources[0].is_dir():
        return sources[0] / "replay.html"
    names = [source.resolve().name if source.is_dir() else source.stem for source in sources]
    return Path(f"{'-'.join(names)}.html")


def _size(result: "Result") -> str:
    """Return the number of pursuers, the duration and the number of messages of a run as text."""
    from desim.analysis.trace_index import messages, started
    from desim.config.number_texts import counted
    from desim.kernel.core.units import time_text

    counts = messages(result)
    players = counted(len(started(result).active), "pursuer")
    return f"{players}, {time_text(counts.t)} s, {counted(counts.sent, 'message')}"


@click.command()
@click.argument("folder", metavar="DIR", type=PATH)
@out_to("The page; default: report.html in DIR.")
@AGAINST
@limited
def report(folder: Path, out: Path | None, against: tuple[tuple[str, str], ...]) -> None:
    """Make a page about a sweep: a DIR written by `desim sweep -o DIR` or `desim explain -o DIR`."""
    from desim.config.number_texts import counted
    from desim.view.pages.report import Study
    from desim.view.pages.report import report as page_of

    if folder.is_file() and folder.suffix == ".toml":
        file = shlex.quote(str(folder))
        fail(f"{folder}: is a scenario file; make a sweep first: desim sweep {file} -o DIR, then desim report DIR")
    path = page_at(out, folder / "report.html")
    with making("report"):
        with storing(folder):
            _check_sweep(folder)
            study = replace(Study.read(folder), against=dict(against) or None)
        for key, value in against:
            with of_option("against", f"{key}={value}"):
                study.result.setting(key, value)  # raises an error unless the sweep has this value
        page = page_of(study).encode()
    write(page, path)
    groups = study.result.groups
    echo(f"{path}: {counted(len(groups), 'configuration')}, {counted(study.runs, 'run')}, {len(page) / 1000:,.0f} kB")


def _check_sweep(folder: Path) -> None:
    """End the program if a folder has the stores of shards, or recorded runs, instead of the store of a sweep."""
    if (folder / STORE).exists():
        return
    if parts := sorted(part.name for part in folder.glob(STORE_PARTS)):
        names = f"{', '.join(parts[:3])}{' ...' if len(parts) > 3 else ''}"
        where = shlex.quote(str(folder))
        fail(f"{folder}: holds parts of a sweep ({names}); merge them first: desim merge {where} -o {where}")
    traces = [trace for trace in (folder / TRACE, *sorted(folder.glob(f"*/{TRACE}"))) if trace.exists()]
    if traces:
        number = "a single run" if traces[0].parent == folder else "single runs"
        page = f"desim replay {shlex.quote(str(traces[0].parent))}"
        fail(f"{folder}: is the folder of {number}, not of a sweep; make a page that plays a run: {page}")


@click.command()
@click.argument("file", type=PATH, required=False)
@click.option("--no-browser", is_flag=True, help="Print the address only; do not open a browser.")
@TIMEOUT
@overriding
def play(file: Path | None, no_browser: bool, timeout: float | None, overrides: tuple[str, ...]) -> None:
    """Change the keys of a scenario FILE on a page, and compare each run with a run that you have pinned.

    Without a FILE, the page shows the example `relay`. The page is served to this machine only. Ctrl-C ends the
    server, and so does closing the page. A run takes at most 30 s, unless --timeout says otherwise.
    """
    from desim.scenario.examples import example
    from desim.scenario.toml import read_source
    from desim.study.workers.workers import Processes
    from desim.view.pages.play_page import play_page
    from desim.view.pages.play_server import PlayServer
    from desim.view.pages.playground import Playground
    from desim.view.pages.session import Session

    path = example("relay") if file is None else file
    source_of(path, overrides)  # ends the program if the file or an override is invalid
    limit = {} if timeout is None else {"timeout": timeout}
    playground = Playground(read_source(path, allow_import=is_import_allowed()), path, overrides, **limit)
    with making("page to play with"):
        play_page(playground)
    workers = Processes(os.cpu_count() or 1, kept=True)
    with PlayServer(Session(playground, workers)) as server, TemporaryDirectory(prefix="desim-") as folder:
        try:
            server.session.warm_up()
            echo(f"{server.address}\nserved to this machine only, until Ctrl-C or until the page is closed")
            if not no_browser:
                Thread(target=webbrowser.open, args=(_door(Path(folder), server.address),), daemon=True).start()
            server.serve_until_closed()
        finally:
            workers.stop()


def _door(folder: Path, address: str) -> str:
    """Write a page that redirects to an address, and return the address of that page.

    The address has a secret token. Other users of the machine see the command line of the browser, so the token must
    not be there; they cannot read the folder.
    """
    path = folder / "play.html"
    path.write_text(f'<meta http-equiv="refresh" content="0; url={address}">', encoding="utf-8")
    return path.as_uri()
