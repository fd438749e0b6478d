"""`desim sensitivity`: which keys decide a metric."""

import sys
from pathlib import Path

import click

from desim.cli.options import (
    ALLOW_IMPORT,
    CLUSTER,
    FILE,
    GRID,
    JOBS,
    JSON,
    MIX_VERSIONS,
    ONE_METRIC,
    SEED,
    SET,
    TIMEOUT,
    added_metrics,
    echo,
    fail,
    folder_for,
    source_of,
    storing,
    working,
)
from desim.cli.result_files import present
from desim.config.file_names import STORE


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
@click.option("-n", "--runs", type=click.IntRange(1, 1_000_000), default=4, show_default=True, help="Runs at a point.")
@SEED
@JOBS
@CLUSTER
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), help="Folder of the store; default: out/NAME/sensitivity."
)
@TIMEOUT
@MIX_VERSIONS
@JSON
@ALLOW_IMPORT
@SET
def sensitivity(
    file: Path,
    grid: tuple[str, ...],
    metric: str,
    points: int,
    trajectories: int,
    runs: int,
    seed: int | None,
    jobs: int,
    cluster: str | None,
    out: Path | None,
    timeout: float | None,
    mix_versions: bool,
    as_json: bool,
    overrides: tuple[str, ...],
) -> None:
    """Find which keys decide a metric: the share of its variance that each key with a range causes.

    The keys are those of `sweep.grid` and -g, each with a range LOW:HIGH or log:LOW:HIGH, or with a list of values.
    Keys without effect are screened out first (Morris 1991); the others have Sobol indices. Resumes.
    """
    from desim.results import provenance
    from desim.study.sensitivity.analysis import Analysis
    from desim.study.store.store import Store

    source, scenario = source_of(file, overrides, added_metrics(metric), grid)
    try:
        analysis = Analysis.of(source, None, metric.rpartition(":")[2], points, trajectories, runs, seed)
    except ValueError as error:
        fail(str(error))
    folder = out or folder_for(scenario, None) / "sensitivity"
    with storing(folder), Store(folder / STORE) as store:
        before = len(store)
        try:
            with working(jobs, cluster, store, 1_000_000) as workers:
                result = analysis.carry_out(store, workers, timeout=timeout, mix_versions=mix_versions)
        except ValueError as error:
            fail(str(error))
        store.note_command(str(Path.cwd()), sys.argv)
        root = analysis.plan.root
        provenance.write(
            folder, provenance.document("sensitivity", scenario, seed=root, runs=len(store), folder=file.parent)
        )
        echo(f"{store.added} runs were performed, {before} were already stored; store: {folder / STORE}", err=True)
        present(result, folder, "sensitivity", as_json=as_json)
