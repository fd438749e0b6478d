"""Compute the frozen costs of the benchmark (`desim bench`), or check that they are the same.

A version of the benchmark is frozen: its costs are computed once, and every desim with this version must reproduce
them. If a run differs, the scenarios, the protocols or the simulator have changed, and such a change needs a new
version. The runs are kept in a store, from which an interrupted computation resumes. With fewer runs than those of the
version, only the first ones are compared.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np

from desim import bench
from desim.config.whole_files import write_whole
from desim.study.comparing.scores import Benchmark
from desim.study.comparing.suite import COSTS, NEWEST, RUNS, Suite, frozen_text


def differences(measured: Benchmark, suite: Suite) -> Iterator[str]:
    """Yield a line for each scenario, protocol and network whose costs differ from the frozen ones."""
    for scenario, by_protocol in suite.costs.items():
        for protocol, by_network in by_protocol.items():
            for network, costs in by_network.items():
                repeated = measured.costs[scenario].get(protocol, {}).get(network)
                if repeated is None or not np.array_equal(repeated, costs[: measured.runs]):
                    yield f"{scenario}, {protocol}, {network}: differs"


@click.command(help=__doc__)
@click.option("--version", type=click.Choice([*RUNS]), default=NEWEST, show_default=True, help="The version.")
@click.option("-n", "--runs", type=click.IntRange(2), help="Runs of each; default: those of the version.")
@click.option("-j", "--jobs", type=click.IntRange(0), default=0, show_default=True, help="Workers; 0 = one per core.")
@click.option("-o", "--out", type=click.Path(path_type=Path), default=Path("out/freeze"), show_default=True)
def main(version: str, runs: int | None, jobs: int, out: Path) -> None:
    """Perform all runs; write the costs if there are none, else compare."""
    suite = Suite.of(version)
    out.mkdir(parents=True, exist_ok=True)
    measured = bench(runs=runs, executor=jobs, version=version, again=True, folder=out)
    click.echo(measured.table())
    path = suite.folder / COSTS
    if not path.exists() and measured.runs < suite.runs:
        click.echo(f"not written: {path} needs all {suite.runs} runs", err=True)
        return
    if not path.exists():
        write_whole(path, frozen_text(measured.costs).encode())
        click.echo(f"wrote {path}; its digest is {suite.digest_of_costs}", err=True)
        return
    if differing := list(differences(measured, suite)):
        click.echo("\n".join(differing), err=True)
        sys.exit(1)
    click.echo(f"all runs have the frozen costs of version {version}", err=True)


if __name__ == "__main__":
    main()
