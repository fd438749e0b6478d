"""`desim sensitivity`: which keys decide a metric."""

from pathlib import Path

import click

from desim.cli.execution import Execution, executing
from desim.cli.options import COUNT, FILE, GRID, JSON, ONE_METRIC, SEED, out_to, overriding
from desim.cli.output import fail, folder_for
from desim.cli.result_files import adding_to, present, record_command
from desim.cli.sources import added_metrics, source_of
from desim.cli.usage import problem


@click.command()
@FILE
@GRID
@ONE_METRIC
@click.option(
    "--points",
    type=click.IntRange(min=0),
    default=64,
    show_default=True,
    help="Rows of a Sobol matrix, a power of 2; 0 = screening only.",
)
@click.option(
    "--trajectories",
    type=click.IntRange(min=0),
    default=10,
    show_default=True,
    help="Trajectories of the screening; 0 = no screening.",
)
@click.option("-n", "--runs", type=COUNT, default=4, show_default=True, help="Runs at a point.")
@SEED
@executing
@out_to("Folder of the store; default: out/NAME/sensitivity.")
@JSON
@overriding
def sensitivity(
    file: Path,
    grid: tuple[str, ...],
    metric: str,
    points: int,
    trajectories: int,
    runs: int,
    seed: int | None,
    execution: Execution,
    out: Path | None,
    as_json: bool,
    overrides: tuple[str, ...],
) -> None:
    """Find which keys decide a metric: the share of its variance that each key with a range causes.

    The keys are those of `sweep.grid` and -g, each with a range LOW:HIGH or log:LOW:HIGH, or with a list of values.
    Keys without effect are screened out first (Morris 1991); the others have Sobol indices. Resumes.
    """
    from desim.study.sensitivity.analysis import Analysis

    source, scenario = source_of(file, overrides, added_metrics(metric), grid)
    try:
        analysis = Analysis.of(source, None, metric.rpartition(":")[2], points, trajectories, runs, seed)
    except ValueError as error:
        fail(problem(error))
    folder = out or folder_for(scenario, None) / "sensitivity"
    with adding_to(folder) as store:
        with execution.workers(store) as workers:
            result = analysis.carry_out(store, workers, mix_versions=execution.mix_versions)
        root, count = analysis.plan.root, len(store)
        record_command(store, folder, "sensitivity", scenario, seed=root, runs=count, folder=file.parent)
    present(result, folder, "sensitivity", as_json=as_json)
