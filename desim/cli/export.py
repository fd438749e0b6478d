"""`desim export`: the runs of a sweep as a table; the events of a run as a table, a capture file or an MCAP file."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from desim.cli.many import store_files
from desim.cli.options import ALLOW_IMPORT, SEED, SET, echo, fail, limited, storing
from desim.cli.recorded import check_recorded_options, is_recorded, result_of
from desim.config.file_names import STORE, TRACE

if TYPE_CHECKING:
    from collections.abc import Iterable

    from desim.analysis.knowledge import Pieces
    from desim.kernel.core.events import Event
    from desim.view.data.headings import Headings

KINDS = (
    *("Started", "Decided", "BrokeDown", "Sampled", "Estimated", "Captured", "Distrusted", "Ended"),
    *("Queued", "Broadcast", "Sent", "Lost", "MessageCounts", "Delivered", "Retransmitted", "GivenUp", "Expired"),
    *("DeadlineMissed", "LivelinessLost", "TransportCounts", "ClockCorrected", "FaultStarted", "FaultEnded"),
)
"""The types of events, as in `desim.results.run_folder`, which is slow to import."""


@click.command()
@click.argument("source", metavar="STORE|DIR|FILE", type=click.Path(path_type=Path))
@click.argument("file", metavar="TO", type=click.Path(path_type=Path))
@click.option(
    "--event",
    "kinds",
    multiple=True,
    metavar="TYPE",
    type=click.Choice(KINDS),
    help="Of a run, to .csv or .parquet: only events of this type, e.g. Decided, and only their columns; can be"
    " repeated.",
)
@SEED
@limited
@ALLOW_IMPORT
@SET
def export(source: Path, file: Path, kinds: tuple[str, ...], seed: int | None, overrides: tuple[str, ...]) -> None:
    """Write the runs of a sweep, or the events of a run, to the file TO; its suffix sets the format.

    Of a sweep, a STORE (a file or its folder): .csv or .parquet, one row per run.

    Of a run, a DIR written by `desim run -o DIR`, or a scenario FILE, which is run first: .csv or .parquet, one row per
    event and receiver or player; .pcapng, one packet per message, for Wireshark; .mcap, for Foxglove.

    In CSV, a text that a spreadsheet would take for a formula is prefixed with an apostrophe, and control characters
    are escaped.
    """
    if _is_run(source):
        _export_run(source, file, kinds, seed, overrides)
        return
    check_recorded_options(seed, overrides)
    if kinds:
        raise click.UsageError(f"--event chooses events of a run, and {source} is a sweep")
    _export_sweep(source, file)


def _is_run(source: Path) -> bool:
    """Return whether a source is a run or a scenario file; end the program if it has a run and a sweep."""
    if source.is_dir():
        if (source / TRACE).exists() and (source / STORE).exists():
            fail(f"{source}: has a run and a sweep: give {source / TRACE} or {source / STORE}")
        return (source / TRACE).exists()
    return source.name == TRACE or (not is_recorded(source) and (source.exists() or source.suffix == ".toml"))


def _export_run(source: Path, file: Path, kinds: tuple[str, ...], seed: int | None, overrides: tuple[str, ...]) -> None:
    """Write the events of a run to a file; end the program if that is not possible."""
    from desim.view.formats import export as formats

    try:
        formats.check_suffix(file)
    except ValueError as error:
        fail(str(error))
    suffix = file.suffix.lower()
    if kinds and suffix not in formats.TABLES:
        raise click.UsageError(f"--event is an option of {' and '.join(formats.TABLES)}")
    chosen: dict[str, Any] = {"kinds": kinds} if kinds else {}
    try:
        events, beliefs, headings = _run_of(source, seed, overrides, whole=suffix == ".mcap")
        count = formats.export(events, file, beliefs=beliefs, headings=headings, **chosen)
    except OSError as error:
        is_source = error.filename is not None and Path(error.filename).name == TRACE
        fail(
            f"{error.filename if is_source else file}: cannot be {'read' if is_source else 'written'}: {error.strerror}"
        )
    except (ImportError, ValueError) as error:
        fail(str(error))
    echo(f"wrote {count:,} {formats.COUNTED[suffix]} to {file}", err=True)


def _run_of(
    source: Path, seed: int | None, overrides: tuple[str, ...], *, whole: bool
) -> "tuple[Iterable[Event], Pieces | None, Headings | None]":
    """Return the events of a run and, if the `whole` is asked for, the beliefs and the headings in it.

    The events of a recorded run are read one by one, unless the whole is asked for. As elsewhere, there are no beliefs,
    and no headings either, for a run with `record.messages = "file"`, whose trace may be too long for the memory.

    Raises:
        ValueError: if the run.json of a run is not valid.
        OSError: if a file cannot be read.
    """
    from desim.analysis.knowledge import knowledge
    from desim.analysis.trace_index import lacks_messages
    from desim.results import run_folder
    from desim.view.data.headings import Headings

    if is_recorded(source):
        check_recorded_options(seed, overrides)
        folder = source if source.is_dir() else source.parent
        if not (whole and _fits_memory(folder)):
            return run_folder.events(folder), None, None
        source = folder / TRACE
    result = result_of(source, seed, overrides)
    if not whole:
        return result.trace, None, None
    beliefs = None if lacks_messages(result) else knowledge(result)
    return result.trace, beliefs, Headings(result.scenario, result.seed)


def _fits_memory(folder: Path) -> bool:
    """Return whether a run was recorded without `record.messages = "file"`; print a warning if without messages."""
    from desim.results import provenance

    path = folder / provenance.FILE
    recorded = provenance.read(path)["scenario"]["record"]["messages"] if path.exists() else "file"
    if recorded is False:
        echo(f"warning: {folder}: messages were not recorded, and are left out: set record.messages = true", err=True)
    return bool(recorded != "file")


def _export_sweep(source: Path, file: Path) -> None:
    """Write the runs of a sweep to a file, one row per run; end the program if that is not possible."""
    from desim.study.results.result import SweepResult
    from desim.study.store.store import Store

    path, *others = store_files((source,))
    if others:
        fail(f"{source}: has {len(others) + 1} stores: merge them first, or give one of them")
    with storing(), Store(path, read_only=True, verify=False) as kept:
        result = SweepResult.of(kept)
    try:
        result.write(file)
    except OSError as error:
        fail(f"{file}: cannot be written: {error.strerror}")
    except (ImportError, ValueError) as error:
        fail(str(error))
    echo(f"wrote {sum(len(group.rows) for group in result.groups)} runs to {file}", err=True)
