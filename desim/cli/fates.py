"""`desim fates`: what the network of a scenario does to the messages of a log."""

import csv
from io import StringIO
from math import isnan
from pathlib import Path

import click

from desim.cli.options import ALLOW_IMPORT, FILE, SEED, SET, limited
from desim.cli.output import echo, fail, write
from desim.cli.sources import source_of
from desim.config.escaping import escaped


@click.command()
@click.argument("log", type=click.Path(path_type=Path))
@FILE
@SEED
@click.option("-o", "--out", type=click.Path(path_type=Path), help="CSV file of the fates; default: stdout.")
@ALLOW_IMPORT
@SET
@limited
def fates(log: Path, file: Path, seed: int | None, out: Path | None, overrides: tuple[str, ...]) -> None:
    """Send the messages of a LOG over the network of a scenario FILE, and write what happens to each as CSV.

    LOG is a CSV or Parquet file with the columns t (s), src, dst (a node, or empty: all neighbours) and size (bytes),
    ascending in t. Nodes are numbers from 0 on, or the names of the graph; there are team.count of them, and they stand
    where the pursuers start. The network is observed for 60 s after the last message.
    """
    from desim.kernel.fates import Fate, read_log
    from desim.kernel.fates import fates as fates_of

    if log.suffix == ".toml" and file.suffix != ".toml":
        fail(f"{log}: is a scenario file, and the log comes first: desim fates {file} {log}")
    _, scenario = source_of(file, overrides)
    if lies := [fault for fault in scenario.fault if fault not in scenario.network_faults]:
        echo(f"warning: {file}: fault: {type(lies[0]).__name__} has no effect: nobody lies in a log", err=True)
    names = scenario.network.node_names
    are_numbers = any(name.isdecimal() for name in names)  # "1" is then a name, and not the second node

    def node_of(cell: str) -> int:
        name = cell.strip()
        if name in names:
            return names.index(name)
        if not are_numbers and name.isascii() and name.isdecimal() and int(name) < scenario.team.count:
            return int(name)
        some = f"{names[0]} .. {names[-1]}" if names else f"0 .. {scenario.team.count - 1}"
        raise ValueError(f"there is no node {escaped(name)}: the nodes are {some}")

    seed = scenario.seed if seed is None else seed
    try:
        rows = fates_of(
            read_log(log, node_of),
            scenario.team.count,
            scenario.network,
            faults=scenario.network_faults,
            seed=seed,
            positions=scenario.team.start(seed, scenario.space),
            horizon=scenario.horizon,
            walls=scenario.wall,
        )
    except ValueError as error:
        fail(str(error))
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Fate._fields)
    shown = dict(enumerate(names))
    for row in rows:
        arrived = "" if isnan(row.arrived) else row.arrived
        writer.writerow(row._replace(src=shown.get(row.src, row.src), dst=shown.get(row.dst, row.dst), arrived=arrived))  # type: ignore[arg-type]
    if out is None:
        echo(text.getvalue(), end="")
    else:
        write(text.getvalue().encode(), out)
        echo(f"wrote {out}", err=True)
