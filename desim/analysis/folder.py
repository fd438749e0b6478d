"""The folder of a run: its trace, its numbers, its scenario, its picture, and where all that comes from."""

import json
from dataclasses import asdict
from pathlib import Path

from desim import provenance
from desim.analysis.metrics import Summary, summary
from desim.pursuit.events import Sampled
from desim.scenario_file import dump
from desim.simulation import Result


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
    result.trace.write(folder / "trace.jsonl")
    (folder / "summary.json").write_text(json.dumps(asdict(numbers), indent=2) + "\n", encoding="utf-8")
    resolved = result.scenario.model_copy(update={"seed": result.seed})
    (folder / "scenario.toml").write_text(dump(resolved), encoding="utf-8")
    if made is None:
        made = provenance.document(provenance.RUN, resolved, seed=result.seed)
    provenance.write(folder, provenance.of_one(made, result.seed))
    for old in ("trajectory.svg", "trajectory.png"):
        (folder / old).unlink(missing_ok=True)
    if can_plot() and result.trace.of(Sampled):
        from desim.analysis.plots import save, trajectory

        save(trajectory(result), folder / "trajectory")
    return numbers


def write_below(parent: Path, result: Result, made: provenance.Document | None = None) -> Summary:
    """Write a run to the folder `seed-S` below another; see `write`."""
    return write(result, parent / f"seed-{result.seed}", made)


def can_plot() -> bool:
    """Return whether matplotlib is installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return False
    return True
