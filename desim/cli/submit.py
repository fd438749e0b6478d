"""`desim submit` and `desim status`: a sweep as an array job of Slurm, and how far it is."""

import json
import re
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from desim.cli.options import (
    COUNT,
    FILE,
    GRID,
    JSON,
    METRIC,
    MIX_VERSIONS,
    PATH,
    SEED,
    TIMEOUT,
    Parsed,
    as_words,
    is_import_allowed,
    out_to,
    overriding,
)
from desim.cli.output import echo, fail, folder_for, storing
from desim.cli.sources import shown_metrics, source_of
from desim.config.whole_files import write_whole

if TYPE_CHECKING:
    from desim.study.sweeps.array_job import ArrayJob, Resources
    from desim.study.sweeps.sweep_plan import SweepPlan

DESIM = (sys.executable, "-P", "-m", "desim")
"""The words that call desim on another machine, which has the same environment under the same path.

-P keeps modules of the working directory from being imported in place of installed ones.
"""


def _slurm_text(form: str, pattern: str, wanted: str) -> Parsed:
    """Return the type of an option for Slurm; a wrong text is refused here, before the sweep is prepared."""

    def parse(text: str) -> str:
        if not re.fullmatch(pattern, text, re.ASCII):
            raise ValueError
        return text

    return Parsed(form, parse, wanted)


LIMIT = _slurm_text(
    "TIME",
    r"\d+(:\d+(:\d+)?)?|\d+-\d+(:\d+){0,2}|UNLIMITED|INFINITE",
    "minutes, HOURS:MINUTES:SECONDS or DAYS-HOURS, for instance 90, 01:30:00 or 1-12",
)
SIZE = _slurm_text("SIZE", r"\d+[KMGT]?", "a whole number with K, M, G or T, 500M or 2G for instance")


@click.command()
@FILE
@click.option("--array", "parts", type=COUNT, required=True, help="The number of parts, each a task of the array.")
@GRID
@click.option("-n", "--runs", type=COUNT, help="Runs of each configuration; default: sweep.reps.")
@SEED
@out_to("Folder that all machines see; default: out/NAME.")
@click.option("--claim", is_flag=True, help="Let parts claim small lots of runs, so that a slow one delays nobody.")
@click.option("--run", "is_run", is_flag=True, help="Submit the scripts; otherwise they are only written.")
@click.option(
    "--time", type=LIMIT, default="02:00:00", help="Time limit of a part; it resumes after it.", show_default=True
)
@click.option("--cpus", type=COUNT, default=1, help="Cores and worker processes of a part.", show_default=True)
@click.option("--memory", type=SIZE, default="1G", help="Memory for each core.", show_default=True)
@click.option("--sbatch", multiple=True, help="A further option of sbatch: --sbatch=--partition=short.")
@METRIC
@MIX_VERSIONS
@TIMEOUT
@overriding
def submit(
    file: Path,
    parts: int,
    grid: tuple[str, ...],
    runs: int | None,
    seed: int | None,
    out: Path | None,
    claim: bool,
    is_run: bool,
    time: str,
    cpus: int,
    memory: str,
    sbatch: tuple[str, ...],
    metrics: tuple[str, ...],
    mix_versions: bool,
    timeout: float | None,
    overrides: tuple[str, ...],
) -> None:
    """Write the scripts of an array job of Slurm that performs a sweep, and submit them with --run.

    The same command again submits only the parts that are not done.
    """
    from desim.config.number_texts import counted
    from desim.scenario.overrides import ScenarioError
    from desim.study.results.runs import SHOWN
    from desim.study.sweeps import array_job
    from desim.study.sweeps.sweep_plan import SweepPlan

    source, scenario = source_of(file, overrides, metrics, grid)
    try:
        plan = SweepPlan.of(source, reps=runs, seed=seed)
    except ScenarioError as error:
        fail(str(error))
    if parts > plan.runs:
        fail(f"--array {parts}: there are only {counted(plan.runs, 'run')}: give a part at least one")
    folder = folder_for(scenario, out).absolute()
    with storing(folder):
        job = _job(folder, plan, parts, claim)
        _check_stores(job, plan, folder, mix_versions=mix_versions)
        unfinished = _unfinished_parts(job, plan, folder, shown_metrics(scenario, metrics, SHOWN))
        states = array_job.states(job.jobs)
        to_submit = [part for part in unfinished if part not in states]
        merge = [*DESIM, "merge", *as_words({"--mix-versions": mix_versions})]
        if not to_submit:
            where, merging = shlex.quote(str(folder)), shlex.join(merge[len(DESIM) :])
            waiting = f"all parts that are not done wait or run; `desim status {where}` says how far they are"
            finished = f"all parts are done; to merge them: desim {merging} {where}/part-* -o {where}"
            echo(waiting if unfinished else finished)
            return
        options = {
            "-n": runs,
            "--seed": seed,
            "--timeout": timeout,
            "--grid": grid,
            "--metric": metrics,
            "--set": overrides,
            "--mix-versions": mix_versions,
            "--allow-import": is_import_allowed(),
        }
        resources = array_job.Resources(time=time, cpus=cpus, memory=memory, options=sbatch)
        _write_scripts(job, folder, ["sweep", str(file), *as_words(options)], merge, to_submit, resources)
        _submit(job, folder, f"{counted(len(to_submit), 'part')} of {parts}", is_run=is_run)


def _job(folder: Path, plan: "SweepPlan", parts: int, claim: bool) -> "ArrayJob":
    """Return the job of a folder, new or as it was submitted; end the program if it was submitted in other parts."""
    from desim.study.sweeps.array_job import ArrayJob

    requested = ArrayJob(name=plan.base.name, runs=plan.runs, parts=parts, claim=claim)
    try:
        submitted = ArrayJob.read(folder)
    except ValueError as error:
        fail(str(error))
    if submitted is None:
        return requested
    if not claim and (submitted.parts, submitted.claim) != (parts, claim):  # parts that claim runs may be added
        how = f"--array {submitted.parts}{' --claim' if submitted.claim else ''}"
        fail(f"{folder}: was submitted with {how}, whose parts have other runs: give that, or another folder (-o)")
    return ArrayJob(
        name=requested.name, runs=requested.runs, parts=max(parts, submitted.parts), claim=claim, jobs=submitted.jobs
    )


def _check_stores(job: "ArrayJob", plan: "SweepPlan", folder: Path, *, mix_versions: bool) -> None:
    """Raise StoreError if the stores in a folder are of another sweep; parts would find out only after queueing."""
    from desim.config.file_names import STORE
    from desim.study.store.store import Store

    for path in (folder / STORE, *(job.store(folder, part) for part in range(1, job.parts + 1))):
        if path.exists():
            with Store(path, read_only=True) as store:
                plan.check(store, mix_versions=mix_versions)


def _unfinished_parts(job: "ArrayJob", plan: "SweepPlan", folder: Path, metrics: Sequence[str]) -> list[int]:
    """Return the numbers of the parts that have runs to do; if parts claim runs, as many as lots are left."""
    from desim.study.store.store import Store
    from desim.study.sweeps.array_job import CLAIMS
    from desim.study.sweeps.claims import Claims

    done: dict[int, set[tuple[str, int]]] = {}
    for part in range(1, job.parts + 1):
        if (path := job.store(folder, part)).exists():
            with Store(path, read_only=True) as store:
                done[part] = plan.done(store, {"captured", *metrics})
    if job.claim:
        claims = Claims(folder / CLAIMS, plan)
        claims.settle(set().union(*done.values()))
        return list(range(1, min(job.parts, len(claims.lots) - len(claims.done())) + 1))
    return [
        part
        for part in range(1, job.parts + 1)
        if not {(configuration.key, k) for configuration, k in plan.shard(part, job.parts)} <= done.get(part, set())
    ]


def _write_scripts(
    job: "ArrayJob",
    folder: Path,
    words: Sequence[str],
    merge: Sequence[str],
    to_submit: Sequence[int],
    resources: "Resources",
) -> None:
    """Write the scripts of some parts and of the merge, a folder for their outputs, and the record of the job.

    `words` are the arguments of desim in a part; `merge` is the whole command that merges the parts.
    """
    from desim.study.sweeps import array_job

    made_by = shlex.join(["desim", *sys.argv[1:]]).replace("\n", " ")
    scripts = {
        array_job.PART_SCRIPT: array_job.part_script(job, folder, [*DESIM, *words], made_by, to_submit, resources),
        array_job.MERGE_SCRIPT: array_job.merge_script(job, folder, merge, made_by, resources),
    }
    (folder / array_job.LOGS).mkdir(parents=True, exist_ok=True)
    for name, script in scripts.items():
        write_whole(folder / name, script.encode())
    job.write(folder)


def _submit(job: "ArrayJob", folder: Path, which: str, *, is_run: bool) -> None:
    """Submit the scripts in a folder, and record the number of the job, or print the command that submits them."""
    from desim.study.sweeps import array_job

    if is_run:
        number = array_job.submit_scripts(folder)
        array_job.record_of(job, number).write(folder)
        echo(f"submitted {which} as job {number}; `desim status {shlex.quote(str(folder))}` says how far it is")
    else:
        parts, merge = (shlex.quote(str(folder / name)) for name in (array_job.PART_SCRIPT, array_job.MERGE_SCRIPT))
        echo(f"wrote the scripts of {which}, and of the merge; --run submits them, or:")
        echo(f"sbatch --dependency=afterany:$(sbatch --parsable {parts}) {merge}")


@click.command()
@click.argument("folder", type=PATH)
@JSON
def status(folder: Path, as_json: bool) -> None:
    """Say how far a sweep is: how many runs are done or failed, and which parts wait or run in Slurm."""
    from desim.study.sweeps.status import status as status_of

    with storing(folder):
        try:
            progress = status_of(folder)
        except ValueError as error:
            fail(str(error))
    echo(json.dumps(progress.document(), indent=2) if as_json else str(progress))
