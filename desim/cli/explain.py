"""`desim explain`: which imperfection costs what."""

import json
import sys
from pathlib import Path

import click

from desim.cli.many import STORE, storing
from desim.cli.options import FILE, INTERRUPTED, JOBS, JSON, SEED, SET, refuse, source_of


@click.command()
@FILE
@click.option("-n", "--runs", type=click.IntRange(min=2), help="Runs of each variant; default: 100.")
@SEED
@JOBS
@click.option("--cluster", metavar="tcp://...", help="Run on the workers of a Dask scheduler (the extra `cluster`).")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder for all of it; default: out/NAME/explain.")
@JSON
@SET
def explain(
    file: Path,
    runs: int | None,
    seed: int | None,
    jobs: int,
    cluster: str | None,
    out: Path | None,
    as_json: bool,
    overrides: tuple[str, ...],
) -> None:
    """Say which imperfection costs what: the same seeds without each of them."""
    from desim import provenance
    from desim.analysis.folder import can_plot
    from desim.study.explain import RUNS, carry_out_explanation, planned
    from desim.study.store import Store
    from desim.study.workers import workers_for

    _, scenario = source_of(file, overrides)
    plan, variants = planned(scenario, runs or RUNS, scenario.seed if seed is None else seed)
    folder = out or Path("out") / scenario.name / "explain"
    path = folder / STORE
    with storing(), Store(path) as store:
        plan.enter(store)
        made = provenance.document("explain", scenario, seed=plan.root, runs=plan.reps, folder=file.parent)
        provenance.write(folder, made)
        try:
            with workers_for(cluster or jobs) as workers:
                found = carry_out_explanation(plan, variants, store, workers)
        except KeyboardInterrupt:
            click.echo(f"interrupted: {len(store)} runs are in {path}; the same command goes on", err=True)
            sys.exit(INTERRUPTED)
        except ValueError as error:
            refuse(str(error))
        text = json.dumps(found.document(), indent=2)
        (folder / "explain.json").write_text(f"{text}\n", encoding="utf-8")
        (folder / "explain.txt").write_text(f"{found.table()}\n", encoding="utf-8")
        if can_plot():
            from desim.analysis.plots import save
            from desim.study.waterfall import waterfall

            for each in save(waterfall(found), folder / "explain"):
                click.echo(f"wrote {each}", err=True)
    click.echo(text if as_json else found.table())
