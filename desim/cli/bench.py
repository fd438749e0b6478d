"""`desim bench`: protocols compared in the scenarios of the benchmark."""

from pathlib import Path

import click

from desim.cli.execution import Execution, executing, failures_told
from desim.cli.options import ALLOW_IMPORT, JSON, out_to
from desim.cli.output import echo, fail, make_folder, storing
from desim.cli.result_files import present, show
from desim.cli.sources import protocol_of
from desim.cli.usage import problem


@click.command()
@click.option(
    "--protocol",
    "protocols",
    multiple=True,
    metavar="PROTOCOL",
    help="A protocol to enter: KIND, MODULE:NAME, FILE.py:NAME, or { kind = ..., ... }; can be repeated.",
)
@click.option(
    "-n", "--runs", type=click.IntRange(min=2), help="Runs of each; default and maximum: those of the version."
)
@click.option("--version", metavar="N", default="1", show_default=True, help="The version of the benchmark.")
@click.option("--again", is_flag=True, help="Perform the runs of the built-in protocols, too; minutes of computation.")
@executing
@out_to("Folder of the stores and the table; default: out/bench/vN.")
@JSON
@ALLOW_IMPORT
def bench(
    protocols: tuple[str, ...],
    runs: int | None,
    version: str,
    again: bool,
    execution: Execution,
    out: Path | None,
    as_json: bool,
) -> None:
    """Score protocols between the bounds of ten scenarios, beside all built-in ones.

    Without --protocol and --again, print the table of the version. The same command resumes.
    """
    from desim.study.comparing.bench import bench as compared
    from desim.study.comparing.bench import frozen_matches
    from desim.study.comparing.suite import Suite

    try:
        suite = Suite.of(version)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--version") from error
    entries = [protocol_of(text, "--protocol") for text in protocols]
    folder = out
    if folder is None and (entries or again):  # there are runs, which need a store
        folder = Path("out") / "bench" / f"v{suite.version}"
    if folder is not None:
        make_folder(folder)
    if entries and not again and not frozen_matches(suite):
        echo(
            "warning: this desim does not repeat the frozen runs of the built-in protocols, so the rows differ in more"
            " than the protocols: --again performs all runs",
            err=True,
        )
    with storing(folder), failures_told(lambda: f"the finished runs are in {folder}"):
        try:
            benchmark = compared(
                entries,
                runs,
                execution.executor,
                version=suite.version,
                again=again,
                folder=folder,
                timeout=execution.timeout,
                mix_versions=execution.mix_versions,
            )
        except ValueError as error:
            fail(problem(error))
    if folder is None:
        show(benchmark, as_json=as_json)
    else:
        present(benchmark, folder, "bench", as_json=as_json, is_drawn=bool(benchmark.kept))
