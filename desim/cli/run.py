"""`desim run`: runs of a scenario with one or several seeds, from a file or as recorded in a run.json."""

import json
import shlex
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from desim.cli.options import (
    COUNT,
    JOBS,
    JSON,
    METRIC,
    PATH,
    SEED,
    TIMEOUT,
    as_words,
    is_import_allowed,
    out_to,
    overriding,
)
from desim.cli.output import echo, fail, make_folder
from desim.cli.sources import add_metrics, shown_metrics, source_of, valid

if TYPE_CHECKING:
    from collections.abc import Mapping

    from desim.analysis.metrics import Summary
    from desim.results.provenance import Document
    from desim.scenario.scenario import Scenario


@click.command()
@click.argument("file", type=PATH, required=False)
@click.option("--from", "repeated", type=PATH, metavar="RUN.JSON", help="Repeat the runs of a run.json.")
@SEED
@click.option(
    "-n",
    "--runs",
    type=COUNT,
    help="Number of runs: a single one has the seed s, and run k of several has 1,000,000 s + k; default: 1, or with"
    " --from the recorded number.",
)
@JOBS
@out_to("Folder for the trace, the metrics and a picture of the trajectories.")
@METRIC
@JSON
@TIMEOUT
@overriding
def run(
    file: Path | None,
    repeated: Path | None,
    seed: int | None,
    runs: int | None,
    jobs: int,
    out: Path | None,
    metrics: tuple[str, ...],
    as_json: bool,
    timeout: float | None,
    overrides: tuple[str, ...],
) -> None:
    """Run a scenario FILE, or repeat the runs of a run.json, and print the metrics."""
    from desim.analysis.metrics import plain
    from desim.analysis.tables import batch_table, run_table
    from desim.simulation.watchdog import within

    command_limit = click.get_current_context().with_resource(ExitStack())
    if timeout is not None and runs in {None, 1}:  # the limit includes reading the file and writing results
        command_limit.enter_context(within(timeout))
    scenario, folder, default_count = _scenario_to_run(file, repeated, overrides, metrics)
    shown = shown_metrics(scenario, metrics)
    if seed is not None:
        scenario = scenario.model_copy(update={"seed": seed})
    count = runs or default_count
    if count > 1:  # each run has its own limit
        command_limit.close()
    recorded = {}
    if repeated is not None and seed is None and not overrides:  # the results should be equal to the recorded ones
        recorded = _recorded_results(repeated)
    output = None if out is None else _make_output(out, scenario, count, folder)
    start = time.perf_counter()
    try:
        if count == 1:
            numbers, wall_time = _run_once(scenario, output)
            results, table = [numbers], run_table(scenario, numbers, wall_time, shown)
        else:
            results = _run_several(scenario, count, jobs, output, timeout, file)
            table = batch_table(scenario, results, time.perf_counter() - start)
    except OSError as error:
        from desim.results.run_folder import WriteError  # slow to import

        if not isinstance(error, WriteError):
            raise
        fail(f"--out {error.filename or out}: cannot be written: {error.strerror}")
    for result in results:
        _warn_of_changes(repeated, recorded.get(result.seed, {}), plain(result))
    if as_json:
        table = json.dumps(
            {"scenario": scenario.plain(), "runs": [plain(metrics_of_run) for metrics_of_run in results]}, indent=2
        )
    echo(table)
    if out is not None:
        echo(f"wrote {out}", err=True)


def _make_output(out: Path, scenario: "Scenario", count: int, folder: Path) -> "tuple[Path, Document]":
    """Create the output folder; return it and the provenance of the results."""
    from desim.results import provenance

    make_folder(out)
    with suppress(OSError, provenance.ProvenanceError):  # the folder may be new
        recorded = provenance.read(out / provenance.FILE)["scenario"]
        if recorded != (plain := scenario.plain()):
            keys = [key for key in plain if recorded is None or recorded.get(key) != plain[key]]
            echo(
                f"warning: --out {out}: replaces the results of another scenario; it differs in {', '.join(keys)}",
                err=True,
            )
    return out, provenance.document(provenance.RUN, scenario, seed=scenario.seed, runs=count, folder=folder)


def _run_once(scenario: "Scenario", output: "tuple[Path, Document] | None") -> "tuple[Summary, float]":
    """Run a scenario, and return the metrics and the wall time, s; write the run if there is an output folder."""
    start = time.perf_counter()
    if output is None:
        from desim.analysis.measuring import summary
        from desim.simulation.run import run as simulate

        result = simulate(scenario)
        return summary(result), time.perf_counter() - start
    from desim.results import run_folder

    out, document = output
    result = run_folder.simulate(out, scenario, scenario.seed)
    wall_time = time.perf_counter() - start
    return run_folder.write(result, out, document, simulated_there=True), wall_time


def _run_several(
    scenario: "Scenario",
    count: int,
    jobs: int,
    output: "tuple[Path, Document] | None",
    timeout: float | None,
    file: Path | None,
) -> "list[Summary]":
    """Run a scenario with several seeds, and return the metrics; write the runs if there is an output folder.

    An interrupt prints the table of the runs that have ended, and receives a note about them.
    """
    from functools import partial

    from desim.analysis.measuring import summary
    from desim.analysis.metrics import Summary
    from desim.analysis.tables import batch_table
    from desim.results import provenance, run_folder
    from desim.simulation.run import run as run_scenario
    from desim.study.workers.batch import run_many, seeds_from

    tasks = [(scenario, seed) for seed in seeds_from(scenario.seed, count)]
    simulate, measure = run_scenario, summary
    if output is not None:
        out, document = output
        measure = partial(run_folder.write_below, out, made=document, simulated_there=True)
        simulate = partial(run_folder.simulate_below, out)
    start, finished = time.perf_counter(), dict[int, Summary]()
    try:
        results = run_many(tasks, jobs, scenario.name, measure, simulate, finished.__setitem__, timeout)
    except KeyboardInterrupt as error:
        if finished:
            echo(batch_table(scenario, [finished[k] for k in sorted(finished)], time.perf_counter() - start))
        where = f", in {output[0]}/seed-*" if output and finished else ""
        note = f"{len(finished)} of {count} runs have ended{where}{_how_to_keep(file, scenario, count)}"
        notes = getattr(error, "__notes__", [])
        error.__notes__ = [note, *notes]  # the note of `run` about the line of code stays the last
        raise
    if output is not None:
        run_folder.clear(out)
        with run_folder.writing():
            provenance.write(out, document)
    return results


def _how_to_keep(file: Path | None, scenario: "Scenario", count: int) -> str:
    """Return the sweep that performs the same runs and can be resumed, as the end of a message; "" without a file."""
    if file is None:
        return ""
    parameters = click.get_current_context().params
    options = {
        "-g": f"horizon={scenario.horizon}",  # a sweep needs a grid: this one changes nothing
        "-n": count,
        "-s": parameters["seed"],
        "-j": None if parameters["jobs"] == 1 else parameters["jobs"],
        "--timeout": parameters["timeout"],
        "--set": parameters["overrides"],
        "--metric": parameters["metrics"],
        "--allow-import": is_import_allowed(),
    }
    return f"; to keep each run and resume, make a sweep: desim sweep {shlex.join([str(file), *as_words(options)])}"


def _scenario_to_run(
    file: Path | None, repeated: Path | None, overrides: tuple[str, ...], metrics: tuple[str, ...]
) -> "tuple[Scenario, Path, int]":
    """Return the scenario, the folder of its file, and the default number of runs."""
    if file is not None and repeated is None:
        return source_of(file, overrides, metrics)[1], file.parent, 1
    if file is None and repeated is not None:
        return _recorded_scenario(repeated, overrides, metrics)
    if file is not None:
        raise click.UsageError("needs a FILE or --from RUN.JSON, not both")
    raise click.UsageError(
        "needs a FILE, or --from RUN.JSON; `desim examples relay` writes relay.toml, which `desim run relay.toml` runs"
    )


def _recorded_scenario(
    path: Path, overrides: tuple[str, ...], metrics: tuple[str, ...]
) -> "tuple[Scenario, Path, int]":
    """Return the scenario, the folder of its file, and the number of runs, as recorded in a run.json.

    Print a warning if the results may differ from the recorded ones. End the program if the file is invalid.
    """
    from desim.config.file_names import LIVE
    from desim.results import provenance
    from desim.results.environment import environment
    from desim.scenario.overrides import ScenarioError

    try:
        document = provenance.read(path)
        source = provenance.source(path, document, overrides, allow_import=is_import_allowed())
        add_metrics(source, metrics)
    except (provenance.ProvenanceError, ScenarioError) as error:
        fail(str(error))
    except OSError as error:
        fail(f"{path}: cannot be read: {error.strerror}")
    scenario = valid(source)
    if differing := provenance.differences(document, environment()):
        echo(f"warning: {path}: results may differ: {'; '.join(differing)}{_how_to_install(document)}", err=True)
    if path.with_name(LIVE).exists():
        echo(f"warning: {path}: was recorded live, by desim live: this repeats it in simulation", err=True)
    return scenario, provenance.home(path, document), document["runs"]


def _recorded_results(path: Path) -> dict[int, dict[str, Any]]:
    """Return the metrics that are recorded beside a run.json, by seed, without files that cannot be read."""
    from desim.config.file_names import LIVE

    if path.with_name(LIVE).exists():  # the simulation of a live run has other metrics
        return {}
    recorded = {}
    for file in (path.with_name("summary.json"), *path.parent.glob("seed-*/summary.json")):
        with suppress(OSError, ValueError, KeyError, TypeError):
            metrics = json.loads(file.read_text(encoding="utf-8"))
            recorded[int(metrics["seed"])] = metrics
    return recorded


def _warn_of_changes(path: Path | None, recorded: dict[str, Any], repeated: dict[str, Any]) -> None:
    """Print a warning if a repeated run has other metrics than the recorded one."""
    repeated = json.loads(json.dumps(repeated))  # with the types of a file, such as lists for tuples
    if changed := [name for name in recorded if name in repeated and recorded[name] != repeated[name]]:
        name = changed[0]
        text = (
            f"warning: {path}: the run with seed {repeated['seed']} has other results than recorded: {name} was"
            f" {recorded[name]} and is {repeated[name]}; code of the scenario may depend on the process, as by the"
            " order of a set, hash(), id() or a file that it changes"
        )
        echo(text, err=True)


def _how_to_install(document: "Mapping[str, Any]") -> str:
    """Return how to install the recorded versions of packages, as the end of a message; "" if they are installed."""
    from desim.results.environment import NUMERICS, environment

    present, recorded = environment()["versions"], document["versions"]
    differing = [name for name in NUMERICS if recorded.get(name) and recorded[name] != present.get(name)]
    changed = [f"{name}=={recorded[name]}" for name in differing]
    return f"; for those packages: pip install {shlex.join(changed)}" if changed else ""
