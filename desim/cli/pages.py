"""`desim replay` and `desim report`: a page that plays a run, and a page about a sweep."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from desim.cli.options import AGAINST, PATH, SEED, limited, out_to, overriding
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

    Of two, make a page that plays both side by side on one clock, and names what differs between their scenarios.
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
    """Return the default path of the page that plays one or two runs; a DIR/trace.jsonl counts as its DIR."""
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
    _check_sweep(folder)
    with making("report"):
        with storing(folder):
            study = replace(Study.read(folder), against=dict(against) or None)
        for key, value in against:
            with of_option("against", f"{key}={value}"):
                study.result.setting(key, value)
        page = page_of(study).encode()
    write(page, path)
    groups = study.result.groups
    echo(f"{path}: {counted(len(groups), 'configuration')}, {counted(study.runs, 'run')}, {len(page) / 1000:,.0f} kB")


def _check_sweep(folder: Path) -> None:
    """End the program if a folder has no store of a sweep, but stores of its shards, or recorded runs."""
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
