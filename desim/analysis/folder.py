"""The folder of a run: its trace, its numbers, its scenario, its picture, and where all that comes from."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import TypeAdapter

from desim import provenance
from desim.analysis.metrics import Summary, plain, summary
from desim.kernel.events import Broadcast, Event, Lost, Queued, Sent, Tally, Trace
from desim.kernel.faults import FAULTS, Began, Over
from desim.pursuit.events import Captured, Decided, Ended, Halted, Sampled, Started
from desim.scenario_file import dump, validate
from desim.simulation import Result

TRACE = "trace.jsonl"


def write(result: Result, folder: Path, made: provenance.Document | None = None) -> Summary:
    """Write a run to a folder and return its numbers.

    trace.jsonl, summary.json, scenario.toml and run.json; trajectory.svg and .png if positions were recorded and
    matplotlib (the extra `plot`) is installed.

    Args:
        result: of the run.
        folder: is made, with all above it.
        made: where the run comes from, or the batch that it is of; if None, from the scenario and this program.
    """
    folder.mkdir(parents=True, exist_ok=True)
    numbers = summary(result)
    result.trace.write(folder / TRACE)
    (folder / "summary.json").write_text(json.dumps(plain(numbers), indent=2) + "\n", encoding="utf-8")
    resolved = result.scenario.model_copy(update={"seed": result.seed})
    (folder / "scenario.toml").write_text(dump(resolved), encoding="utf-8")
    if made is None:
        made = provenance.document(provenance.RUN, resolved, seed=result.seed)
    provenance.write(folder, provenance.of_one(made, result.seed))
    for old in ("trajectory.svg", "trajectory.png", "replay.html"):
        (folder / old).unlink(missing_ok=True)
    if can_plot() and result.trace.of(Sampled):
        from desim.analysis.plots import save, trajectory

        save(trajectory(result), folder / "trajectory")
    return numbers


def write_below(parent: Path, result: Result, made: provenance.Document | None = None) -> Summary:
    """Write a run to the folder `seed-S` below another; see `write`."""
    return write(result, parent / f"seed-{result.seed}", made)


def read(folder: Path) -> Result:
    """Return the run that was written to a folder, from its run.json and its trace; see `Trace.read` for bodies.

    Raises:
        ValueError: if one of the two is not what `write` wrote, or names a model that nobody can import.
        OSError: if it cannot be read.
    """
    with (folder / TRACE).open(encoding="utf-8") as lines:
        try:
            trace = Trace.read(lines, kinds())
        except ValueError as error:
            raise ValueError(f"{folder / TRACE}: {error}") from error
    if not trace.events or not isinstance(trace.events[-1], Ended):
        raise ValueError(f"{folder / TRACE}: is not of a whole run: its last event should be Ended")
    made = provenance.read(folder / provenance.FILE)
    return Result(validate(provenance.source(folder / provenance.FILE, made)), made["seed"], trace)


def kinds() -> Mapping[str, Callable[..., Event]]:
    """Return what makes each kind of event of its fields, by its name."""
    fault: TypeAdapter[Any] = TypeAdapter(Annotated[Any, FAULTS])
    made: list[type[Any]] = [Started, Decided, Halted, Sampled, Captured, Ended, Queued, Broadcast, Sent, Lost, Tally]
    return {
        **{kind.__name__: kind for kind in made},
        "Began": lambda **fields: Began(**fields | {"fault": fault.validate_python(fields["fault"])}),
        "Over": lambda **fields: Over(**fields | {"fault": fault.validate_python(fields["fault"])}),
    }


def can_plot() -> bool:
    """Return whether matplotlib is installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return False
    return True
