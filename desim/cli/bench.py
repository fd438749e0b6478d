"""`desim bench`: protocols compared in the scenarios of the benchmark."""

import json
import sys
from pathlib import Path
from typing import Any

import click

from desim.cli.options import (
    ALLOW_IMPORT,
    CLUSTER,
    FAILED,
    JOBS,
    JSON,
    MIX_VERSIONS,
    TIMEOUT,
    echo,
    fail,
    make_folder,
    protocol_of,
    storing,
    write,
)


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
@JOBS
@CLUSTER
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), help="Folder of the stores and the table; default: out/bench/vN."
)
@TIMEOUT
@MIX_VERSIONS
@JSON
@ALLOW_IMPORT
def bench(
    protocols: tuple[str, ...],
    runs: int | None,
    version: str,
    again: bool,
    jobs: int,
    cluster: str | None,
    out: Path | None,
    timeout: float | None,
    mix_versions: bool,
    as_json: bool,
) -> None:
    """Score protocols between the bounds of ten scenarios, beside all built-in ones. Resumes.

    Without --protocol and --again it prints the table of the version.
    """
    from desim.study.comparing.bench import bench as compared
    from desim.study.comparing.bench import frozen_matches
    from desim.study.comparing.suite import Suite
    from desim.study.sweeps.sweep import RunError

    try:
        suite = Suite.of(version)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--version") from error
    entered: Any = [protocol_of(text, "--protocol") for text in protocols]
    folder = Path("out") / "bench" / f"v{suite.version}" if out is None else out
    if protocols or again:
        make_folder(folder)
    if protocols and not again and not frozen_matches(suite):
        echo(
            "warning: this desim does not repeat the frozen runs of the built-in protocols, so the rows differ in more"
            " than the protocols: --again performs all runs",
            err=True,
        )
    try:
        with storing(folder):
            benchmark = compared(
                entered,
                runs,
                jobs if cluster is None else cluster,
                version=suite.version,
                again=again,
                folder=folder if protocols or again else None,
                timeout=timeout,
                mix_versions=mix_versions,
            )
    except KeyboardInterrupt as error:
        error.add_note(f"the stores are in {folder}; the same command resumes")
        raise
    except RunError as error:
        echo(str(error), err=True)
        sys.exit(FAILED)
    except ValueError as error:
        fail(str(error))
    text = json.dumps(benchmark.document(), indent=2)
    echo(text if as_json else benchmark.table())
    if protocols or again:
        _write(benchmark, text, folder)


def _write(benchmark: Any, document: str, folder: Path) -> None:
    """Write the table, the numbers and the figure to a folder."""
    from desim.results.run_folder import can_plot

    write(f"{benchmark.table()}\n".encode(), folder / "bench.txt")
    write(f"{document}\n".encode(), folder / "bench.json")
    if can_plot() and benchmark.kept:
        from desim.analysis.drawing.plots import save

        for picture in save(benchmark.plot(), folder / "bench"):
            echo(f"wrote {picture}", err=True)
