"""The folder of a run: its trace, its numbers, its scenario, its picture, and where all that comes from."""

import json
from collections.abc import Container, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import TypeAdapter

from desim import provenance
from desim.analysis.metrics import Summary, plain, summary
from desim.guards import fresh, regular
from desim.kernel.events import MESSAGES, Event, Tally, Trace
from desim.kernel.faults import FAULTS, Began, Over
from desim.kernel.trace_file import Kinds, TraceFile, events_of
from desim.names import OF_A_RUN, TRACE
from desim.pursuit.events import Captured, Decided, Ended, Halted, Sampled, Started
from desim.scenario import Scenario
from desim.scenario_file import dump, validate
from desim.simulation import Result, run


def simulate(folder: Path, scenario: Scenario, seed: int) -> Result:
    """Return a run; if its messages are to go to a file, its trace is in a folder, which is made, as it happens."""
    if scenario.record.messages != "file":
        return run(scenario, seed)
    folder.mkdir(parents=True, exist_ok=True)
    fresh(folder / f"{TRACE}.part")
    with TraceFile(folder / TRACE) as trace:
        result = run(scenario, seed, trace)
        clear(folder)  # before the trace has its name, or it might be read with the run.json of another run
        return result


def simulate_below(parent: Path, scenario: Scenario, seed: int) -> Result:
    """Return a run, whose trace may be in the folder `seed-S` below another; see `simulate`."""
    return simulate(_below(parent, seed), scenario, seed)


def write(
    result: Result, folder: Path, made: provenance.Document | None = None, *, simulated_there: bool = False
) -> Summary:
    """Write a run to a folder and return its numbers.

    trace.jsonl, summary.json, scenario.toml and run.json; trajectory.svg and .png if positions were recorded and
    matplotlib (the extra `plot`) is installed. What is there of another run is removed: see `clear`. run.json comes
    last: where it is, all is, also if the program was killed.

    Args:
        result: of the run.
        folder: is made, with all above it.
        made: where the run comes from, or the batch that it is of; if None, from the scenario and this program.
        simulated_there: whether it was made by `simulate` with this folder, so that its trace may be there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    numbers = summary(result)
    is_there = simulated_there and result.scenario.record.messages == "file"
    clear(folder, {TRACE} if is_there else ())
    if not is_there:
        with TraceFile(folder / TRACE) as file:
            for event in result.trace:
                file(event)
    (folder / "summary.json").write_text(json.dumps(plain(numbers), indent=2) + "\n", encoding="utf-8")
    resolved = result.scenario.model_copy(update={"seed": result.seed})
    (folder / "scenario.toml").write_text(dump(resolved), encoding="utf-8")
    if made is None:
        made = provenance.document(provenance.RUN, resolved, seed=result.seed)
    if can_plot() and result.trace.of(Sampled):
        from desim.analysis.plots import save, trajectory

        save(trajectory(result), folder / "trajectory")
    provenance.write(folder, provenance.of_one(made, result.seed))
    return numbers


def clear(folder: Path, kept: Container[str] = ()) -> None:
    """Remove all of a run from its folder, its pictures too, but for some names; what is below stays, it is of others.

    Raises:
        OSError: if it cannot be removed.
    """
    for name in OF_A_RUN:
        if name not in kept:
            (folder / name).unlink(missing_ok=True)


def write_below(
    parent: Path, result: Result, made: provenance.Document | None = None, *, simulated_there: bool = False
) -> Summary:
    """Write a run to the folder `seed-S` below another; see `write`."""
    return write(result, _below(parent, result.seed), made, simulated_there=simulated_there)


def _below(parent: Path, seed: int) -> Path:
    return fresh(parent / f"seed-{seed}")


def read(folder: str | Path, *, allow_import: bool = False) -> Result:
    """Return the run that was written to a folder, from its run.json and its trace; see `events_of` for bodies.

    Args:
        folder: of the run.
        allow_import: whether it may name code to be run; see `desim.load`.

    Raises:
        ValueError: if one of the two is not what `write` wrote, or names a model that nobody can import, or if the two
            are of different runs.
        OSError: if it cannot be read.
    """
    folder, trace = Path(folder), Trace()
    trace.events += events(folder, allow_import=allow_import)
    if not trace.events or not isinstance(trace.events[-1], Ended):
        raise ValueError(f"{folder / TRACE}: is not of a whole run: its last event should be Ended")
    path = folder / provenance.FILE
    made = provenance.read(path)
    source = provenance.source(path, made, allow_import=allow_import)
    if made["runs"] != 1:
        raise ValueError(f"{path}: is of {made['runs']} runs, and not of that in {TRACE}")
    result = Result(validate(source), made["seed"], trace)
    if not _begins(result):
        raise ValueError(f"{path}: is not of the run in {TRACE}: pursuers or evaders begin elsewhere, or are others")
    return result


def _begins(result: Result) -> bool:
    """Return whether a trace begins as its scenario does with its seed; to 1e-6 m, for platforms may differ."""
    team, evaders, starts = result.scenario.team, result.scenario.evaders, result.trace.of(Started)
    if len(starts) != 1 or starts[0].speeds != tuple(team.all_speeds()):
        return False
    there = *starts[0].pursuers, *starts[0].evaders
    wanted = *team.start(result.seed), *(each.start(result.seed, k) for k, each in enumerate(evaders))
    return len(there) == len(wanted) and np.allclose(there, wanted, rtol=0.0, atol=1e-6)


def events(folder: str | Path, *, allow_import: bool = False) -> Iterator[Event]:
    """Yield the events of the run in a folder, one by one, so that a long trace need not fit in memory; see `read`.

    Raises:
        ValueError: if its trace is not what `write` wrote.
        OSError: if it cannot be read.
    """
    file = Path(folder) / TRACE
    with regular(file).open(encoding="utf-8") as lines:
        try:
            yield from events_of(lines, kinds(allow_import=allow_import))
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from error


def kinds(*, allow_import: bool = False) -> Kinds:
    """Return what makes each kind of event of its fields, by its name; see `read`."""
    adapter: TypeAdapter[Any] = TypeAdapter(Annotated[Any, FAULTS])
    fault = partial(adapter.validate_python, context={"allow_import": allow_import})
    made: list[type[Any]] = [Started, Decided, Halted, Sampled, Captured, Ended, *MESSAGES, Tally]
    return {
        **{kind.__name__: kind for kind in made},
        "Began": lambda **fields: Began(**fields | {"fault": fault(fields["fault"])}),
        "Over": lambda **fields: Over(**fields | {"fault": fault(fields["fault"])}),
    }


def can_plot() -> bool:
    """Return whether matplotlib is installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return False
    return True
