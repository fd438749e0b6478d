"""`desim export`: the runs of a sweep as a table; the events of a run as a table, a capture file or an MCAP file."""

import re
from pathlib import Path
from typing import Any

import click

from desim.cli.merge import store_files
from desim.cli.options import LABEL, PATH, SEED, is_import_allowed, limited, overriding
from desim.cli.output import echo, fail, storing
from desim.cli.recorded import check_recorded_options, is_recorded, labels_of, result_of
from desim.cli.usage import problem
from desim.config.file_names import STORE, TRACE

KINDS = (
    *("Started", "Decided", "BrokeDown", "Sampled", "Estimated", "Captured", "Distrusted", "Ended"),
    *("Queued", "Broadcast", "Sent", "Lost", "MessageCounts", "Delivered", "Retransmitted", "GivenUp", "Expired"),
    *("DeadlineMissed", "LivelinessLost", "TransportCounts", "ClockCorrected", "FaultStarted", "FaultEnded"),
)
"""The types of events, as in `desim.results.run_folder`, which is slow to import."""


@click.command()
@click.argument("source", metavar="STORE|DIR|FILE", type=PATH)
@click.argument("file", metavar="TO", type=PATH)
@click.option(
    "--event",
    "kinds",
    multiple=True,
    metavar="TYPE",
    type=click.Choice(KINDS),
    help="Of a run, to .csv or .parquet: only events of this type, e.g. Decided, and only their columns; can be"
    " repeated.",
)
@click.option(
    "--exporter",
    metavar="NAME",
    help="Of a run: the exporter, if the suffix of TO does not choose it: a kind, or MODULE:NAME, a function of the"
    " result and the file (needs --allow-import).",
)
@click.option(
    "--metric",
    "metrics",
    multiple=True,
    metavar="NAME",
    help="Of a sweep, to .tex or .md: a metric in the tables; can be repeated. Default: active_time, capture_time and"
    " messages_sent.",
)
@LABEL
@click.option(
    "--without",
    multiple=True,
    metavar="COLUMN",
    help="Of a sweep, to .tex or .md: the head of a column that is left out, e.g. captured; can be repeated.",
)
@SEED
@limited
@overriding
def export(
    source: Path,
    file: Path,
    kinds: tuple[str, ...],
    exporter: str | None,
    metrics: tuple[str, ...],
    labels: tuple[tuple[str, str], ...],
    without: tuple[str, ...],
    seed: int | None,
    overrides: tuple[str, ...],
) -> None:
    """Write the runs of a sweep, or the events of a run, to the file TO; its suffix sets the format.

    Of a sweep, a STORE (a file or its folder): .csv or .parquet, one row per run; .tex (booktabs) or .md, the tables of
    means and paired differences with their intervals.

    Of a run, a DIR written by `desim run -o DIR`, or a scenario FILE, which is run first: .csv or .parquet, one row per
    event and receiver or player; .pcapng, one packet per message, for Wireshark; .mcap, for Foxglove; .perfetto.json,
    a timeline for https://ui.perfetto.dev. An installed exporter (entry point of `desim.exporters`) has a suffix of its
    own.
    """
    if metrics and file.suffix not in {".tex", ".md"}:
        raise click.UsageError(
            f"--metric chooses the metrics of the tables of a sweep (.tex, .md); {file} has them all"
        )
    if (labels or without) and file.suffix not in {".tex", ".md"}:
        raise click.UsageError(f"--label and --without are of the tables of a sweep (.tex, .md), and {file} has none")
    if _is_run(source):
        _export_run(source, file, kinds, exporter, seed, overrides)
        return
    check_recorded_options(seed, overrides)
    if kinds:
        raise click.UsageError(f"--event chooses events of a run, and {source} is a sweep")
    if exporter is not None:
        raise click.UsageError(f"--exporter writes a run, and {source} is a sweep")
    _export_sweep(source, file, metrics, labels, without)


def _is_run(source: Path) -> bool:
    """Return whether a source is a run or a scenario file; end the program if it is a folder of a run and a sweep."""
    if source.is_dir():
        with storing():  # the folder may be closed to the user
            has_run, has_sweep = (source / TRACE).exists(), (source / STORE).exists()
        if has_run and has_sweep:
            fail(f"{source}: has a run and a sweep: give {source / TRACE} or {source / STORE}")
        return has_run
    if is_recorded(source):
        return source.name == TRACE
    return source.exists() or source.suffix == ".toml"  # a missing source of another name is meant as a sweep


def _export_run(
    source: Path,
    file: Path,
    kinds: tuple[str, ...],
    exporter: str | None,
    seed: int | None,
    overrides: tuple[str, ...],
) -> None:
    """Write a run to a file; end the program if that is not possible."""
    from desim.results.run_folder import streamed
    from desim.view.formats import export as formats

    try:
        parameters = {"events": kinds} if kinds else {}
        chosen_exporter = formats.exporter_for(file, exporter, allow_import=is_import_allowed(), **parameters)
        traits = formats.ExporterTraits.of(chosen_exporter)
        if is_recorded(source) and traits.streams:
            check_recorded_options(seed, overrides)
            folder = source if source.is_dir() else source.parent
            result: Any = streamed(folder, allow_import=is_import_allowed())
        else:
            result = result_of(source, seed, overrides)
        count = formats.export(result, file, chosen_exporter)
    except OSError as error:
        if error.filename is not None and Path(error.filename).name == TRACE:
            fail(f"{error.filename}: cannot be read: {error.strerror}")
        fail(f"{file}: cannot be written: {error.strerror}")
    except (ImportError, ValueError) as error:
        fail(str(error))
    scenario = vars(result).get("scenario")  # a streamed result has it if the exporter has used it
    if is_recorded(source) and scenario is not None and scenario.record.messages is False:
        echo(f"warning: {source}: messages were not recorded, and are left out: set record.messages = true", err=True)
    singular = re.sub("ies$", "y", traits.items)  # an exporter of a user may count entries, boxes, passes or batches
    singular = re.sub("(?<=x)es$|(?<=ss)es$|(?<=[cs]h)es$|s$", "", singular)
    items = singular if count == 1 else traits.items
    written = "" if count is None else f"{count:,} {items} to "
    echo(f"wrote {written}{file}", err=True)


def _export_sweep(
    source: Path,
    file: Path,
    metrics: tuple[str, ...],
    labels: tuple[tuple[str, str], ...],
    without: tuple[str, ...],
) -> None:
    """Write the runs of a sweep to a file, or the tables of metrics; end the program if that is not possible."""
    from desim.analysis.table_formats import SUFFIXES
    from desim.config.number_texts import counted
    from desim.study.results.result import SweepResult
    from desim.study.results.runs import SHOWN
    from desim.study.store.store import Store

    path, *others = store_files((source,))
    if others:
        fail(f"{source}: has {len(others) + 1} stores: merge them first, or give one of them")
    with storing(), Store(path, read_only=True) as store:
        result = SweepResult.of(store)
    try:
        result.write(file, metrics or SHOWN, labels=labels_of(result, labels), without=without)
    except OSError as error:
        fail(f"{file}: cannot be written: {error.strerror}")
    except ValueError as error:
        fail(problem(error))
    except ImportError as error:
        fail(str(error))
    runs = counted(sum(len(group.rows) for group in result.groups), "run")
    what = f"tables of {counted(len(result.groups), 'configuration')}, {runs}," if file.suffix in SUFFIXES else runs
    echo(f"wrote {what} to {file}", err=True)
