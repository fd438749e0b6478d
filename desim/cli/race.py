"""`desim race`: which configuration of a grid is best, with a guarantee."""

import sys
from pathlib import Path

import click

from desim.cli.execution import Execution, executing
from desim.cli.options import DESIGN, FILE, GRID, JSON, ONE_METRIC, SEED, out_to, overriding
from desim.cli.output import fail, folder_for
from desim.cli.result_files import adding_to, present
from desim.cli.sources import added_metrics, source_of
from desim.cli.usage import problem


@click.command()
@FILE
@GRID
@DESIGN
@ONE_METRIC
@click.option(
    "--zone",
    type=float,
    required=True,
    help="The smallest difference of means that matters, in the unit of the metric (the indifference zone).",
)
@click.option(
    "--confidence",
    type=float,
    default=0.95,
    show_default=True,
    help="Probability of finding the best if it is better than every other by --zone.",
)
@click.option("--maximise/--minimise", default=None, help="Whether more is better; default: as the metric says.")
@click.option("--first", type=click.IntRange(min=2), default=20, show_default=True, help="First runs of each.")
@click.option(
    "-n", "--runs", type=click.IntRange(2, 1_000_000), default=10_000, show_default=True, help="Most runs of each."
)
@SEED
@executing
@out_to("Folder of the store; default: out/NAME.")
@JSON
@overriding
def race(
    file: Path,
    grid: tuple[str, ...],
    design: str | None,
    metric: str,
    zone: float,
    confidence: float,
    maximise: bool | None,
    first: int,
    runs: int,
    seed: int | None,
    execution: Execution,
    out: Path | None,
    as_json: bool,
    overrides: tuple[str, ...],
) -> None:
    """Find the configuration of a grid with the best mean of a metric, with as few runs as that takes.

    Configurations that have lost take no further runs (Kim & Nelson 2001). Runs of a sweep in the same folder are not
    repeated, so the same command resumes.
    """
    from desim.results import provenance
    from desim.study.selection.race import RaceRules, carry_out_race
    from desim.study.sweeps.sweep_plan import SweepPlan

    source, scenario = source_of(file, overrides, added_metrics(metric), grid, design)
    try:
        plan = SweepPlan.of(source, reps=runs, seed=seed)
        rules = RaceRules.of(plan, metric.rpartition(":")[2], zone, confidence, maximise, first)
    except ValueError as error:
        fail(problem(error, most="runs"))
    folder = folder_for(scenario, out)
    with adding_to(folder) as store:
        plan.register(store, mix_versions=execution.mix_versions)
        store.note_command(str(Path.cwd()), sys.argv)
        with execution.workers(store, plan.runs) as workers:
            result = carry_out_race(plan, store, workers, rules)
        made = provenance.document("race", scenario, seed=plan.root, runs=result.runs, folder=file.parent)
        provenance.write(folder, made)
    present(result, folder, "race", as_json=as_json)
