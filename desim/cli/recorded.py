"""The results that a command shows: read from a folder, or simulated first if the source is a scenario file."""

import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from desim.cli.options import PATH, is_import_allowed
from desim.cli.output import fail
from desim.cli.sources import source_of
from desim.config.file_names import TRACE
from desim.config.suggestion import did_you_mean

if TYPE_CHECKING:
    from desim.simulation.run import Result
    from desim.study.results.result import SweepResult

SOURCE = click.argument("source", metavar="DIR|FILE", type=PATH)
MAX_REPLAYED = 2
"""Maximum number of runs that a page plays."""


def _one_or_two(_ctx: click.Context, _param: click.Parameter, sources: tuple[Path, ...]) -> tuple[Path, ...]:
    """Return the sources; end the program if there are too many."""
    if len(sources) > MAX_REPLAYED:
        names = " ".join(shlex.quote(str(source)) for source in sources)
        fail(f"{names}: a page plays one run, or two side by side, got {len(sources)}")
    return sources


SOURCES = click.argument(
    "sources",
    metavar="DIR|FILE [DIR|FILE]",
    nargs=-1,
    required=True,
    type=PATH,
    callback=_one_or_two,
)


def is_recorded(source: Path) -> bool:
    """Return whether a source is a folder or a file of recorded results; any other source is a scenario file."""
    return source.is_dir() or source.name == TRACE or source.suffix == ".sqlite"


def result_of(source: Path, seed: int | None, overrides: tuple[str, ...]) -> "Result":
    """Read the run in a folder, or run a scenario file; end the program if it is no single run."""
    from desim.simulation.run import Result

    results = results_of(source, seed, overrides)
    if not isinstance(results, Result):
        fail(
            f"{source}: is the folder of a sweep or an explanation, which keeps metrics only; make a page about it:"
            f" desim report {shlex.quote(str(source))}; to see a run of it, repeat the run: desim replay FILE -s SEED"
        )
    return results


def results_of(source: Path, seed: int | None, overrides: tuple[str, ...]) -> "Result | SweepResult":
    """Read the run or the sweep in a folder, or run a scenario file with messages and trajectories recorded.

    End the program if the source cannot be read.

    Raises:
        click.UsageError: if a seed or overrides are given for recorded results.
    """
    if not is_recorded(source):
        from desim.simulation.run import run
        from desim.view.pages.replay import with_recordings

        return run(with_recordings(source_of(source, overrides)[1]), seed)
    check_recorded_options(seed, overrides)
    from desim.study.sweeps.folder import open as open_results

    try:
        return open_results(source, allow_import=is_import_allowed())
    except OSError as error:
        beside = sorted(path.name for path in source.parent.glob("*")) if source.parent.is_dir() else []
        close = did_you_mean(source.name, beside) if isinstance(error, FileNotFoundError) else ""
        fail(f"{error.filename}: cannot be read: {error.strerror}{close}" if error.strerror else str(error))
    except ValueError as error:
        fail(str(error))


def check_recorded_options(seed: int | None, overrides: tuple[str, ...]) -> None:
    """Raise a usage error if a seed or overrides are given for recorded results."""
    if seed is not None or overrides:
        raise click.UsageError("--seed and --set apply to a scenario FILE only: the results in a DIR are recorded")


def labels_of(result: "SweepResult", labels: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return the texts of the options --label by value.

    A value may contain "=", too. So a label is split at the first "=" that follows a value of the sweep; if there is no
    such value, at its first "=", as the option has split it.
    """
    from desim.study.results.runs import text

    values, texts = {text(value) for key in result.keys for value in result.values(key)}, dict[str, str]()
    for pair in labels:
        parts = "=".join(pair).split("=")
        splits = [("=".join(parts[:k]), "=".join(parts[k:])) for k in range(1, len(parts))]
        value, label = next((split for split in splits if split[0] in values), pair)
        texts[value] = label
    return texts
