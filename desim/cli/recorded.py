"""The run that a command shows: read from a folder, or simulated for the command."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from desim.cli.options import fail, is_import_allowed, source_of
from desim.config.file_names import STORE, STORE_PARTS, TRACE

if TYPE_CHECKING:
    from desim.simulation.run import Result

SOURCE = click.argument("source", metavar="DIR|FILE", type=click.Path(path_type=Path))
SAMPLES = 0.05
"""Time between samples of a run that is simulated for a command, if its scenario records none, s."""


def result_of(source: Path, seed: int | None, overrides: tuple[str, ...]) -> "Result":
    """Return the run in a folder or of a scenario file; end the program if it cannot be read."""
    if not source.is_dir():
        return _simulated(source, seed, overrides)
    check_has(source, TRACE)
    if seed is not None or overrides:
        raise click.UsageError("--seed and --set apply to a scenario FILE only: the run in a DIR is already recorded")
    return _recorded(source)


def check_has(folder: Path, name: str) -> None:
    """End the program if a folder has no file of a name, but the results of another command.

    Args:
        folder: the folder.
        name: the file that the command reads: TRACE or STORE.
    """
    if (folder / name).exists():
        return
    traces = [each for each in (folder / TRACE, *sorted(folder.glob(f"*/{TRACE}"))) if each.exists()]
    if name == STORE and traces:
        number = "a single run" if traces[0].parent == folder else "single runs"
        page = f"desim replay {shlex.quote(str(traces[0].parent))}"
        fail(f"{folder}: is the folder of {number}, not of a sweep; make a page that plays a run: {page}")
    if name == TRACE and ((folder / STORE).exists() or any(folder.glob(STORE_PARTS))):
        fail(
            f"{folder}: is the folder of a sweep or an explanation, which keeps metrics only; make a page about it:"
            f" desim report {shlex.quote(str(folder))}; to see a run of it, repeat the run: desim replay FILE -s SEED"
        )


def _recorded(folder: Path) -> "Result":
    """Return the run in a folder; end the program if it cannot be read."""
    from desim.results.run_folder import read
    from desim.scenario.overrides import ScenarioError

    try:
        return read(folder, allow_import=is_import_allowed())
    except OSError as error:
        below = sorted(each.parent.name for each in folder.glob(f"*/{TRACE}"))
        hint = f"; the folder has the runs {', '.join(below[:3])}{' ...' if len(below) > 3 else ''}" if below else ""
        fail(f"{error.filename}: cannot be read: {error.strerror}{hint}")
    except (ScenarioError, ValueError) as error:
        fail(str(error))


def _simulated(file: Path, seed: int | None, overrides: tuple[str, ...]) -> "Result":
    """Run a scenario file with messages and trajectories recorded, and return the result."""
    from desim.simulation.run import run

    scenario = source_of(file, overrides)[1]
    record = scenario.record.model_copy(update={"messages": True, "trajectory": scenario.record.trajectory or SAMPLES})
    return run(scenario.model_copy(update={"record": record}), seed)
