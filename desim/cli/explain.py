"""`desim explain`: the cost of each imperfection of a scenario."""

import sys
from pathlib import Path

import click

from desim.cli.execution import Execution, executing
from desim.cli.options import COUNT, FILE, JSON, METRIC, SEED, out_to, overriding
from desim.cli.output import FAILED, echo, fail, folder_for, storing
from desim.cli.result_files import present, record_command
from desim.cli.sources import shown_metrics, source_of
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
