"""Many runs that answer a question: `desim explain`, `desim race` and `desim sensitivity`.

They say what each imperfection costs, which configuration of a grid is best, and which keys decide a metric.
"""

import sys
from pathlib import Path

import click

from desim.cli.execution import Execution, executing
from desim.cli.options import COUNT, DESIGN, FILE, GRID, JSON, METRIC, ONE_METRIC, SEED, out_to, overriding
from desim.cli.output import FAILED, echo, fail, folder_for, storing
from desim.cli.result_files import adding_to, present, record_command
from desim.cli.sources import added_metrics, shown_metrics, source_of
from desim.cli.usage import problem
from desim.config.file_names import STORE
from desim.config.number_texts import counted


@click.command()
@FILE
@click.option("-n", "--runs", type=click.IntRange(2, COUNT.max), help="Runs of each variant; default: 100.")
@SEED
@executing
@out_to("Folder of the results; default: out/NAME/explain.")
@METRIC
@JSON
@overriding
def explain(
    file: Path,
    runs: int | None,
    seed: int | None,
    execution: Execution,
    out: Path | None,
    metrics: tuple[str, ...],
    as_json: bool,
    overrides: tuple[str, ...],
) -> None:
    """Measure what each imperfection costs: run the same seeds with and without it."""
    from desim.scenario.overrides import ScenarioError
    from desim.study.ablation.explain import RUNS, Variants
    from desim.study.plan.configurations import with_place
    from desim.study.results.explanation import EXPLAINED
    from desim.study.store.store import Store

    source, scenario = source_of(file, overrides, metrics)
    shown = shown_metrics(scenario, metrics, tuple(EXPLAINED))
    try:
        variants = Variants.of(scenario, runs or RUNS, seed)
    except ScenarioError as error:
        fail(str(with_place(error, source)))
    folder = out or folder_for(scenario, None) / "explain"
    with storing(folder), Store(folder / STORE) as store:
        variants.plan.register(store, mix_versions=execution.mix_versions)
        seed, runs = variants.plan.root, variants.plan.reps
        record_command(store, folder, "explain", scenario, seed=seed, runs=runs, folder=file.parent)
        with execution.workers(store, variants.plan.runs) as workers:
            explanation = variants.carry_out(store, workers, shown)
    present(explanation, folder, "explain", as_json=as_json)
    if explanation.failed:
        echo(f"for {counted(explanation.failed, 'seed')} a run failed; the same command retries them", err=True)
        sys.exit(FAILED)


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
        document = provenance.document("race", scenario, seed=plan.root, runs=result.runs, folder=file.parent)
        provenance.write(folder, document)
    present(result, folder, "race", as_json=as_json)


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
    Keys without effect are screened out first (Morris 1991); the others have Sobol indices. The same command resumes.
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
