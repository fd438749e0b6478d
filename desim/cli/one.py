"""`desim run`: one run, or the same over several seeds, of a file or of what was recorded of earlier runs."""

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from desim.cli.options import JOBS, JSON, SEED, SET, make_folder, refuse, source_of, valid

if TYPE_CHECKING:
    from desim.scenario import Scenario


@click.command()
@click.argument("file", type=click.Path(path_type=Path), required=False)
@click.option(
    "--from", "repeated", type=click.Path(path_type=Path), metavar="RUN.JSON", help="Repeat what a run.json is of."
)
@SEED
@click.option("-n", "--runs", type=click.IntRange(min=1), help="Number of runs, with seeds s, s + 1, ...; default: 1.")
@JOBS
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder for the trace and a trajectory picture.")
@JSON
@SET
def run(
    file: Path | None,
    repeated: Path | None,
    seed: int | None,
    runs: int | None,
    jobs: int,
    out: Path | None,
    as_json: bool,
    overrides: tuple[str, ...],
) -> None:
    """Run a scenario FILE, or repeat what a run.json recorded, and say what happened."""
    from functools import partial

    from desim import provenance
    from desim.analysis.folder import write, write_below
    from desim.analysis.metrics import plain, summary
    from desim.analysis.tables import batch_table, run_table
    from desim.simulation import run as simulate
    from desim.study.batch import run_many, seeds_from

    scenario, folder, recorded = _given(file, repeated, overrides)
    if seed is not None:
        scenario = scenario.model_copy(update={"seed": seed})
    seeds = seeds_from(scenario.seed, runs or recorded)
    made = None
    if out is not None:
        make_folder(out)
        made = provenance.document(provenance.RUN, scenario, seed=scenario.seed, runs=len(seeds), folder=folder)
    start = time.perf_counter()
    try:
        if len(seeds) == 1:
            result = simulate(scenario, scenario.seed)
            wall_time = time.perf_counter() - start
            results = [summary(result) if out is None else write(result, out, made)]
            table = run_table(scenario, results[0], wall_time)
        else:
            measure = summary if out is None else partial(write_below, out, made=made)
            results = run_many([(scenario, each) for each in seeds], jobs, scenario.name, measure)
            table = batch_table(scenario, results, time.perf_counter() - start)
            if out is not None and made is not None:
                provenance.write(out, made)
    except OSError as error:
        refuse(f"--out {error.filename}: cannot be written: {error.strerror}")
    if as_json:
        table = json.dumps({"scenario": scenario.plain(), "runs": [plain(each) for each in results]}, indent=2)
    click.echo(table)


def _given(file: Path | None, repeated: Path | None, overrides: tuple[str, ...]) -> "tuple[Scenario, Path, int]":
    """Return the scenario, the folder of its file, and the number of runs if no option says it."""
    if file is not None and repeated is None:
        return source_of(file, overrides)[1], file.parent, 1
    if file is None and repeated is not None:
        return _recorded(repeated, overrides)
    raise click.UsageError("needs a FILE or --from RUN.JSON" + (", not both" if file is not None else ""))


def _recorded(path: Path, overrides: tuple[str, ...]) -> "tuple[Scenario, Path, int]":
    """Return what a run.json is of, warn if it may come out differently, and end the program if it is wrong."""
    from desim import provenance
    from desim.source import ScenarioError

    try:
        made = provenance.read(path)
        source = provenance.source(path, made, overrides)
    except (provenance.ProvenanceError, ScenarioError) as error:
        refuse(str(error))
    except OSError as error:
        refuse(f"{path}: cannot be read: {error.strerror}")
    scenario = valid(source)
    if found := provenance.differences(made, provenance.environment()):
        click.echo(f"warning: {path}: results may differ: {'; '.join(found)}", err=True)
    return scenario, source.folder or path.parent, made["runs"]
