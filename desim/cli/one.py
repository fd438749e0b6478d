"""`desim run`: one run, or the same over several seeds."""

import json
import time
from dataclasses import asdict
from pathlib import Path

import click

from desim.cli.options import FILE, JOBS, JSON, SEED, SET, make_folder, refuse, scenario_of


@click.command()
@FILE
@SEED
@click.option("-n", "--runs", type=click.IntRange(min=1), default=1, help="Number of runs, with seeds s, s + 1, ...")
@JOBS
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder for the trace and a trajectory picture.")
@JSON
@SET
def run(
    file: Path, seed: int | None, runs: int, jobs: int, out: Path | None, as_json: bool, overrides: tuple[str, ...]
) -> None:
    """Run a scenario and say what happened."""
    from functools import partial

    from desim.analysis.batch import run_many, seeds_from
    from desim.analysis.folder import write, write_below
    from desim.analysis.metrics import summary
    from desim.analysis.tables import batch_table, run_table
    from desim.simulation import run as simulate

    scenario = scenario_of(file, overrides)
    if out is not None:
        make_folder(out)
    seeds = seeds_from(scenario.seed if seed is None else seed, runs)
    start = time.perf_counter()
    try:
        if runs == 1:
            result = simulate(scenario, seeds[0])
            wall_time = time.perf_counter() - start
            results = [summary(result) if out is None else write(result, out)]
            table = run_table(scenario, results[0], wall_time)
        else:
            measure = summary if out is None else partial(write_below, out)
            results = run_many([(scenario, each) for each in seeds], jobs, scenario.name, measure)
            table = batch_table(scenario, results, time.perf_counter() - start)
    except OSError as error:
        refuse(f"--out {error.filename}: cannot be written: {error.strerror}")
    if as_json:
        table = json.dumps({"scenario": scenario.plain(), "runs": [asdict(each) for each in results]}, indent=2)
    click.echo(table)
