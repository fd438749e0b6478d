"""The run that a command shows: one that was recorded, or one that is made for it."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from desim.cli.options import fail, is_import_allowed, source_of
from desim.config.file_names import TRACE

if TYPE_CHECKING:
    from desim.simulation.run import Result

SOURCE = click.argument("source", metavar="DIR|FILE", type=click.Path(path_type=Path))
SAMPLES = 0.05
"""Time between samples of a run that is only made to be looked at, if its scenario wants none, s."""


def result_of(source: Path, seed: int | None, overrides: tuple[str, ...]) -> "Result":
    """Return the run in a folder, or one of a scenario file; end the program if there is none."""
    if not source.is_dir():
        return _simulated(source, seed, overrides)
    if seed is not None or overrides:
        raise click.UsageError("--seed and --set are for a scenario FILE: what is in a DIR has happened")
    return _recorded(source)


def _recorded(folder: Path) -> "Result":
    """Return the run in a folder, or end the program if there is none."""
    from desim.results.run_folder import read
    from desim.scenario.overrides import ScenarioError

    try:
        return read(folder, allow_import=is_import_allowed())
    except OSError as error:
        below = sorted(each.parent.name for each in folder.glob(f"*/{TRACE}"))
        hint = f"; it holds {', '.join(below[:3])}{' ...' if len(below) > 3 else ''}" if below else ""
        fail(f"{error.filename}: cannot be read: {error.strerror}{hint}")
    except (ScenarioError, ValueError) as error:
        fail(str(error))


def _simulated(file: Path, seed: int | None, overrides: tuple[str, ...]) -> "Result":
    """Return a run of a scenario file of which everything is recorded that can be looked at."""
    from desim.simulation.run import run

    scenario = source_of(file, overrides)[1]
    record = scenario.record.model_copy(update={"messages": True, "trajectory": scenario.record.trajectory or SAMPLES})
    return run(scenario.model_copy(update={"record": record}), seed)
