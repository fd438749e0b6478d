"""`desim sweep`: each configuration of a grid, many times."""

import json
import shlex
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from desim.cli.execution import Execution, executing
from desim.cli.options import AGAINST, COUNT, DESIGN, FILE, GRID, JSON, METRIC, PATH, SEED, Parsed, out_to, overriding
from desim.cli.output import FAILED, echo, fail, folder_for, storing
from desim.cli.result_files import record_command
from desim.cli.sources import protocol_of, shown_metrics, source_of
from desim.config.file_names import STORE
from desim.config.whole_files import write_whole

if TYPE_CHECKING:
    from desim.scenario.overrides import Source
    from desim.study.comparing.control import Controlled, ControlPlan
    from desim.study.results.result import SweepResult
    from desim.study.sweeps.sweep_plan import SweepPlan


PRECISION = "METRIC:HALFWIDTH, active_time:0.1 for instance"
"""The form of --until."""


def _part(text: str) -> tuple[int, int]:
    """Return the part and the number of parts of a text K/N; raise ValueError if it has another form."""
    part, _, parts = text.partition("/")
    if not (part.isdecimal() and parts.isdecimal() and 1 <= int(part) <= int(parts)):
        raise ValueError
    return int(part), int(parts)


def _precision(text: str) -> tuple[str, float]:
    """Return the metric and the half width; `sweep` checks both once the scenario is loaded."""
    metric, _, width = text.rpartition(":")
    return metric, float(width)


@click.command()
@FILE
@GRID
@DESIGN
@click.option(
    "-n",
    "--runs",
    type=COUNT,
    help="Runs of each configuration, or their maximum with --until; default: sweep.reps, or 10000 with --until.",
)
@SEED
@executing
@out_to("Folder of the store; default: out/NAME.")
@click.option(
    "--until",
    type=Parsed("METRIC:HALFWIDTH", _precision, PRECISION),
    help="Run until the 95 % interval of a metric has this half width; at least 100 runs. MODULE:FUNCTION:HALFWIDTH"
    " implies --metric MODULE:FUNCTION.",
)
@click.option(
    "--shard",
    type=Parsed("K/N", _part, "1/N to N/N, 3/20 for instance"),
    help="Do only every N-th run, starting with the K-th; see `desim merge`.",
)
@click.option(
    "--claim",
    type=PATH,
    help="Do lots of runs that are claimed in this folder, which several commands share; see `desim merge`.",
)
@click.option("--dry-run", is_flag=True, help="Print the planned runs without running them.")
@AGAINST
@click.option("--fail-fast", is_flag=True, help="Stop at the first run that fails.")
@click.option(
    "--control",
    metavar="PROTOCOL",
    help="Make the means more precise by a control variate: many runs of another protocol with equal seeds, e.g."
    " centralised.",
)
@click.option("--control-runs", type=COUNT, help="Runs of the control; default: ten times those of a configuration.")
@METRIC
@JSON
@overriding
def sweep(
    file: Path,
    grid: tuple[str, ...],
    design: str | None,
    runs: int | None,
    seed: int | None,
    execution: Execution,
    out: Path | None,
    until: tuple[str, float] | None,
    shard: tuple[int, int] | None,
    claim: Path | None,
    dry_run: bool,
    against: tuple[tuple[str, str], ...],
    fail_fast: bool,
    control: str | None,
    control_runs: int | None,
    metrics: tuple[str, ...],
    as_json: bool,
    overrides: tuple[str, ...],
) -> None:
    """Run each configuration of the grid of a scenario (`sweep.grid`, --grid) many times.

    Runs that have succeeded are skipped, so the same command continues a sweep.
    """
    from desim.config.number_texts import counted
    from desim.results import provenance
    from desim.study.results.result import SweepResult
    from desim.study.results.runs import SHOWN
    from desim.study.store.store import Store
    from desim.study.sweeps import planned
    from desim.study.sweeps.claims import carry_out_claimed
    from desim.study.sweeps.sweep import carry_out

    if until and ":" in until[0]:  # MODULE:FUNCTION, which the runs then have to measure
        function, width = until
        metrics, until = tuple(dict.fromkeys((*metrics, function))), (function.rpartition(":")[2], width)
    source, scenario = source_of(file, overrides, metrics, grid, design)
    shown = shown_metrics(scenario, metrics, SHOWN)
    _check_selection(until, shard, claim)
    reference = dict(against) or None
    plan = _plan_of(source, runs, seed, until, reference)
    control_plan = _control_plan(plan, control, control_runs, is_partial=bool(until or shard))
    folder = folder_for(scenario, out)
    path = folder / (f"sweep.{shard[0]}-of-{shard[1]}.sqlite" if shard else STORE)
    if dry_run:
        _print_plan(plan, path, shown, until=until, shard=shard, mix_versions=execution.mix_versions)
        return
    start = time.perf_counter()
    with storing(folder), Store(path) as store:
        stored_before = len(store)
        plan.register(store, mix_versions=execution.mix_versions)
        origin: dict[str, Any] = {"seed": plan.root, "runs": plan.runs, "folder": file.parent}
        keys = [configuration.key for configuration in plan.configurations]
        record = partial(
            record_command, store, folder, "sweep", scenario, **origin, **planned.entries(keys, plan.reps, until)
        )
        common: dict[str, Any] = {"fail_fast": fail_fast, "metrics": shown, "on_start": record}
        with execution.workers(store, plan.runs) as workers:
            if claim:
                result = carry_out_claimed(plan, store, workers, claim, **common)
            else:
                result = carry_out(plan, store, workers, until=until, shard=shard or (1, 1), **common)
        performed = store.added
        if until and performed:  # `record` has written the largest number of runs: write how many were needed
            needed = origin | {"runs": sum(len(group.rows) for group in result.groups)}
            provenance.write(
                folder, provenance.document("sweep", scenario, **needed, **planned.entries(keys, None, None))
            )
        all_stored = None
        if not (shard or claim):  # a part of a sweep has no summary
            has_all = len(store.configurations()) == len(result.groups)
            all_stored = result if has_all else SweepResult.of(store)
    controlled = None if control_plan is None else _controlled(control_plan, result, folder, execution, metrics)
    _print_result(result, controlled, shown, reference, as_json=as_json)
    duration = time.perf_counter() - start
    speed = f"{counted(performed, 'run')} in {duration:.1f} s ({performed / duration:.1f}/s)"
    echo(f"{speed}, {stored_before} already stored; store: {path}", err=True)
    with storing(folder):
        if controlled is not None:
            write_whole(folder / "control.txt", f"{controlled.table()}\n".encode())
        if all_stored is not None:
            _write_summary(result, all_stored, shown, reference, folder)
    _end_if_failed(result, folder)


def _check_selection(until: tuple[str, float] | None, shard: tuple[int, int] | None, claim: Path | None) -> None:
    """End the program if two of the options that select the runs to perform exclude each other."""
    if until and shard:
        fail("--until needs all runs, and --shard performs a part of them only: they exclude each other")
    if claim and (shard or until):
        fail(f"--claim shares the runs with other commands: it excludes --{'shard' if shard else 'until'}")


def _plan_of(
    source: "Source",
    runs: int | None,
    seed: int | None,
    until: tuple[str, float] | None,
    reference: Mapping[str, str] | None,
) -> "SweepPlan":
    """Return the plan of a sweep, and print its warnings; end the program if an option does not fit."""
    from desim.scenario.overrides import ScenarioError
    from desim.study.sweeps.sweep import check_target
    from desim.study.sweeps.sweep_plan import MAX_RUNS, SweepPlan

    try:
        plan = SweepPlan.of(source, reps=(runs or MAX_RUNS) if until else runs, seed=seed)
    except ScenarioError as error:
        fail(str(error))
    for key, why in plan.warnings():
        echo(f"warning: {source.where(('sweep', 'grid', key))}: sweep.grid: {key}: {why}", err=True)
    if until:
        try:
            check_target(*until, plan.metrics)
        except ValueError as error:
            raise click.BadParameter(f"should be {PRECISION}: {error}", param_hint="'--until'") from error
    try:
        plan.check_reference(reference)
    except ValueError as error:
        fail(f"--against: {error}")
    return plan


def _print_result(
    result: "SweepResult",
    controlled: "Controlled | None",
    shown: tuple[str, ...],
    reference: Mapping[str, str] | None,
    *,
    as_json: bool,
) -> None:
    """Print the tables of a sweep and of its control, or both as JSON."""
    if not as_json:
        tables = [result.table(shown, against=reference), *([] if controlled is None else [controlled.table()])]
        echo("\n\n".join(tables))
        return
    document = result.document(shown, reference)
    if controlled is not None:
        document["control"] = controlled.document()
    echo(json.dumps(document, indent=2))
    for warning in result.warnings(shown):
        echo(f"warning: {warning}", err=True)


def _control_plan(
    plan: "SweepPlan", control: str | None, runs: int | None, *, is_partial: bool
) -> "ControlPlan | None":
    """Return the plan of the control of a sweep; None without one. End the program if it does not fit."""
    from desim.scenario.overrides import ScenarioError
    from desim.study.comparing.control import ControlPlan

    if control is None:
        if runs is not None:
            raise click.UsageError("--control-runs is an option of --control")
        return None
    if is_partial:
        fail("--control needs as many runs of each configuration: it excludes --until and --shard")
    protocol = protocol_of(control, "--control")
    try:
        return ControlPlan.of(plan, protocol, runs)
    except (ScenarioError, ValueError) as error:
        fail(f"--control {control}: {error}")


def _controlled(
    control_plan: "ControlPlan", result: "SweepResult", folder: Path, execution: Execution, metrics: tuple[str, ...]
) -> "Controlled":
    """Perform the runs of the control that its store lacks, and return the corrected means."""
    from desim.config.file_names import folder_name
    from desim.study.comparing.control import SHOWN
    from desim.study.store.store import Store

    names = tuple(dict.fromkeys(metric.rpartition(":")[2] for metric in metrics))
    with storing(folder), Store(folder / f"control-{folder_name(control_plan.name)}.sqlite") as store:
        control_plan.plan.register(store, mix_versions=execution.mix_versions)
        with execution.workers(store, control_plan.plan.runs) as workers:
            return control_plan.carry_out(result, store, workers, names or SHOWN)


def _print_plan(
    plan: "SweepPlan",
    path: Path,
    metrics: tuple[str, ...],
    *,
    until: tuple[str, float] | None,
    shard: tuple[int, int] | None,
    mix_versions: bool,
) -> None:
    """Print how many runs of each configuration are planned, and how many a store has; nothing is written."""
    from desim.analysis.looks import FIRST_LOOK
    from desim.analysis.tables import aligned
    from desim.config.number_texts import counted
    from desim.study.results.runs import text
    from desim.study.store.store import Store

    with storing(path.parent), Store(path if path.exists() else None, read_only=path.exists()) as store:
        plan.check(store, mix_versions=mix_versions)
        in_store = plan.done(store, metrics)
    planned = [(configuration.key, k) for configuration, k in plan.shard(*(shard or (1, 1)))]
    stored = [run for run in planned if run in in_store]
    planned_counts, stored_counts = (Counter(key for key, _ in runs) for runs in (planned, stored))
    rows = [("runs", "stored", *plan.configurations[0].settings)]
    for configuration in plan.configurations:
        numbers = str(planned_counts[configuration.key]), str(stored_counts[configuration.key])
        rows.append((*numbers, *map(text, configuration.columns.values())))
    rule = ""
    if until:
        metric, width = until
        least = min(FIRST_LOOK, plan.reps)
        rule = f" at most, and at least {least} of each, until the half width of {metric} is {width:g}"
    head = f"{plan.base.name}: {counted(len(plan.configurations), 'configuration')}, {counted(len(planned), 'run')}"
    progress = f"{len(stored):,} stored, {len(planned) - len(stored):,} to do"
    echo(f"{head}{rule}; {progress}\n{aligned(rows, right_from=0)}")


def _write_summary(
    result: "SweepResult",
    all_stored: "SweepResult",
    metrics: Sequence[str],
    against: Mapping[str, Any] | None,
    folder: Path,
) -> None:
    """Write the table of a store to its folder, and a figure of the first metric if matplotlib is installed.

    Both show `all_stored`, which includes configurations of earlier grids; `result` has those of this sweep.
    """
    from desim.results.run_folder import can_plot

    try:
        table = all_stored.table(metrics, against=against)
    except ValueError:  # the configurations of an earlier grid have no such reference
        table = all_stored.table(metrics)
    names = ["sweep.txt"]
    write_whole(folder / names[0], f"{table}\n".encode())
    if can_plot():
        from desim.analysis.drawing.plots import save
        from desim.study.results.figures import file_name

        paths = save(all_stored.plot(metrics[0]), folder / file_name(all_stored.usual_kind, metrics[0]))
        names += [path.name for path in paths]
    swept, stored = len(result.groups), len(all_stored.groups)
    of_all = (
        "" if swept == stored else f", of all {stored} configurations of the store; the table above has {swept} of them"
    )
    echo(f"wrote {', '.join(names)} beside it{of_all}", err=True)


def _end_if_failed(result: "SweepResult", folder: Path) -> None:
    """End the program if runs have failed, and say how to see why."""
    from desim.config.number_texts import counted

    if result.failed:
        echo(
            f"{counted(len(result.failed), 'run')} failed; the same command retries them;"
            f" `desim report {shlex.quote(str(folder))}` shows their tracebacks",
            err=True,
        )
        sys.exit(FAILED)
