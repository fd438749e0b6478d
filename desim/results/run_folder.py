"""The folder of a run: its trace, summary, scenario, figure and provenance."""

import json
from collections.abc import Container, Iterator
from contextlib import contextmanager
from functools import cached_property
from itertools import chain, islice
from os import PathLike
from pathlib import Path
from typing import Self

import numpy as np

from desim.analysis.measuring import summary
from desim.analysis.metrics import Summary, plain
from desim.config.file_names import RUN_FILES, TRACE
from desim.config.trust import regular_or_missing
from desim.kernel.core.events import MESSAGES, TRANSPORT, ClockCorrected, Event, MessageCounts, Trace
from desim.kernel.core.trace_file import TraceFile, events_of
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Distrusted, Ended, Estimated, Sampled, Started
from desim.results import provenance
from desim.results.trace_checks import check_trace_format, field_limits, inconsistencies, whole_trace
from desim.scenario.scenario import Scenario
from desim.scenario.toml import dump, validate
from desim.simulation.run import Result, run

EVENTS = (
    *(Started, Decided, BrokeDown, Sampled, Estimated, Captured, Distrusted, Ended),
    *(*MESSAGES, MessageCounts, *TRANSPORT, ClockCorrected, FaultStarted, FaultEnded),
)
"""The types of events in a trace."""


class WriteError(OSError):
    """Raised when the files of a run cannot be written; an OSError in the code of a scenario stays an OSError."""


@contextmanager
def writing() -> Iterator[None]:
    """Raise a WriteError in place of an OSError."""
    try:
        yield
    except OSError as error:
        raise _write_error(error) from error


def _write_error(error: OSError) -> WriteError:
    return WriteError(error.errno, error.strerror, error.filename)


class _RunTrace(TraceFile):
    """The trace file of a run; a failure to write it, even during the run, is a WriteError."""

    @writing()
    def __enter__(self) -> Self:
        return super().__enter__()

    def __call__(self, event: Event) -> None:
        try:  # called for every event, where `writing` would be slow
            super().__call__(event)
        except OSError as error:
            raise _write_error(error) from error

    @writing()
    def __exit__(self, error: type[BaseException] | None, *more: object) -> None:
        super().__exit__(error, *more)


def simulate(folder: Path, scenario: Scenario, seed: int) -> Result:
    """Run a scenario and return the result.

    With `record.messages = "file"` the trace is written to the folder during the run. The folder is then created if
    missing, and the files of an earlier run in it are removed; see `clear`.

    Raises:
        WriteError: if a file cannot be written.
    """
    if scenario.record.messages != "file":
        return run(scenario, seed)
    with writing():
        folder.mkdir(parents=True, exist_ok=True)
    with _RunTrace(folder / TRACE) as trace:
        result = run(scenario, seed, trace)
        clear(folder)  # before `TraceFile` renames its .part, so that a new trace is never beside an old run.json
        return result


def simulate_below(parent: Path, scenario: Scenario, seed: int) -> Result:
    """Run a scenario as `simulate` does, in the subfolder `seed-S` of `parent`."""
    return simulate(parent / f"seed-{seed}", scenario, seed)


@writing()
def write(
    result: Result,
    folder: str | PathLike[str],
    made: provenance.Document | None = None,
    *,
    simulated_there: bool = False,
    drawn: bool = True,
) -> Summary:
    """Write a run to a folder and return its summary; `read` reads it back.

    The files are trace.jsonl, summary.json, scenario.toml and run.json. If positions were recorded and matplotlib (the
    extra `plot`) is installed, trajectory.svg and trajectory.png are added. Files of another run are removed: see
    `clear`. run.json is written last, so a folder that contains it is complete, even if the program was killed.

    Args:
        result: the result of the run.
        folder: the folder; it is created, with its parents.
        made: the provenance of the run, or of several runs that include it; if None, it is made from the scenario and
            the running program.
        simulated_there: whether `simulate` was called with this folder, where it may have written the trace.
        drawn: whether pictures are added, which takes a second.

    Raises:
        WriteError: if a file cannot be written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    numbers = summary(result)
    has_trace = simulated_there and result.scenario.record.messages == "file"
    clear(folder, {TRACE} if has_trace else ())
    if not has_trace:
        with TraceFile(folder / TRACE) as file:
            for event in result.trace:
                file(event)
    (folder / "summary.json").write_text(json.dumps(plain(numbers), indent=2) + "\n", encoding="utf-8")
    resolved = result.scenario.model_copy(update={"seed": result.seed})
    (folder / "scenario.toml").write_text(dump(resolved), encoding="utf-8")
    if made is None:
        made = provenance.document(provenance.RUN, resolved, seed=result.seed)
    if drawn and can_plot() and result.trace.of(Sampled):
        from desim.analysis.drawing.plots import save
        from desim.analysis.drawing.trajectory import trajectory

        save(trajectory(result), folder / "trajectory")
    provenance.write(folder, provenance.of_one(made, result.seed))
    return numbers


@writing()
def clear(folder: Path, kept: Container[str] = ()) -> None:
    """Remove the files of a run from its folder, except those in `kept`; other files and subfolders stay.

    Raises:
        WriteError: if a file cannot be removed.
    """
    for name in RUN_FILES:
        if name not in kept:
            (folder / name).unlink(missing_ok=True)


def write_below(
    parent: Path, result: Result, made: provenance.Document | None = None, *, simulated_there: bool = False
) -> Summary:
    """Write a run as `write` does, to the subfolder `seed-S` of `parent`."""
    return write(result, parent / f"seed-{result.seed}", made, simulated_there=simulated_there)


def read(folder: str | Path, *, allow_import: bool = False) -> Result:
    """Return the result of a run from the run.json and the trace in its folder; see `events_of` for message bodies.

    Args:
        folder: the folder of the run.
        allow_import: whether run.json may name code to be imported; see `desim.load`.

    Raises:
        ValueError: if a file does not have the form that `write` gives it or names a model that cannot be imported, if
            the files are of different runs, or if run.json records several runs.
        OSError: if a file cannot be read.
    """
    folder, trace = Path(folder), Trace()
    trace.events += events(folder)
    for number, problem in inconsistencies(trace.events):
        raise ValueError(f"{folder / TRACE}: line {number} {problem}")
    path = folder / provenance.FILE
    made = provenance.read(path)
    source = provenance.source(path, made, allow_import=allow_import)
    if made["runs"] != 1:
        raise ValueError(f"{path}: records {made['runs']} runs, but the folder of a run needs the record of one")
    result = Result(validate(source), made["seed"], trace)
    if not _matches_start(result):
        raise ValueError(f"{path}: does not match {TRACE}: number, speeds or starting positions of players differ")
    return result


def _matches_start(result: Result) -> bool:
    """Return whether a trace starts with the players of its scenario and seed; positions may differ by 1e-6 m."""
    team, evaders, starts = result.scenario.team, result.scenario.evaders, result.trace.of(Started)
    if len(starts) != 1 or starts[0].speeds != tuple(team.all_speeds()):
        return False
    recorded = *starts[0].pursuers, *starts[0].evaders
    space = result.scenario.space
    evader_starts = [evader.start(result.seed, k, space) for k, evader in enumerate(evaders)]
    expected = *team.start(result.seed, space), *evader_starts
    return len(recorded) == len(expected) and np.allclose(recorded, expected, rtol=0.0, atol=1e-6)


def events(folder: str | Path) -> Iterator[Event]:
    """Yield the events of the run in a folder one by one; unlike `read`, it does not hold the trace in memory.

    Raises:
        ValueError: if a line of the trace is not a valid event, if the trace has another format, or if it is not
            complete.
        OSError: if the trace cannot be read.
    """
    file = Path(folder) / TRACE
    with regular_or_missing(file).open(encoding="utf-8") as lines:
        try:
            first = list(islice(lines, 1))  # `Started`, whose numbers of players limit the fields of all events
            check_trace_format(first)
            starts = list(events_of(first, (Started,)))
            yield from whole_trace(events_of(chain(first, lines), EVENTS, field_limits(starts[0])) if starts else ())
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from error


class StreamedResult:
    """The result of a run in a folder whose trace is not held in memory; see `streamed`.

    Args:
        folder: the folder of the run.
        allow_import: whether run.json may name code to be imported; see `desim.load`.
    """

    def __init__(self, folder: Path, allow_import: bool):
        self._folder, self._allow_import = folder, allow_import

    @property
    def trace(self) -> Iterator[Event]:
        """The events, which are read from the file each time."""
        return events(self._folder)

    @cached_property
    def scenario(self) -> Scenario | None:
        """The scenario; None without a run.json. It is read at the first access."""
        path = self._folder / provenance.FILE
        if not path.exists():
            return None
        return validate(provenance.source(path, provenance.read(path), allow_import=self._allow_import))

    @cached_property
    def seed(self) -> int | None:
        """The seed; None without a run.json."""
        path = self._folder / provenance.FILE
        return int(provenance.read(path)["seed"]) if path.exists() else None


def streamed(folder: str | Path, *, allow_import: bool = False) -> StreamedResult:
    """Return the run in a folder without reading it yet; `read` instead checks it and holds it in memory."""
    return StreamedResult(Path(folder), allow_import)


def can_plot() -> bool:
    """Return whether matplotlib is installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return False
    return True
