"""`desim fates`: what the network of a scenario does to the messages of a log."""

import csv
from collections.abc import Sequence
from functools import partial
from io import StringIO
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING

import click

from desim.cli.options import FILE, PATH, SEED, limited, out_to, overriding
from desim.cli.output import echo, fail, write
from desim.cli.sources import source_of
from desim.config.escaping import escaped

if TYPE_CHECKING:
    from desim.kernel.fates import Fate


@click.command()
@click.argument("log", type=PATH)
@FILE
@SEED
@out_to("CSV file of the fates; default: stdout.")
@overriding
@limited
def fates(log: Path, file: Path, seed: int | None, out: Path | None, overrides: tuple[str, ...]) -> None:
    """Send the messages of a LOG over the network of a scenario FILE, and write what happens to each as CSV.

    LOG is a CSV or Parquet file with the columns t (s, or dates, of which the earliest is time 0), src, dst (a node, or
    empty: all neighbours) and size (bytes), ascending in t. Nodes are numbers from 0 on, or the names of the graph;
    there are team.count of them, and they stand where the pursuers start. The network is observed for 60 s after the
    last message.
    """
    from desim.kernel.fates import fates as fates_of
    from desim.kernel.fates import read_log

    if log.suffix == ".toml" and file.suffix != ".toml":
        fail(f"{log}: is a scenario file, and the log comes first: desim fates {file} {log}")
    _, scenario = source_of(file, overrides)
    if lies := [fault for fault in scenario.fault if fault not in scenario.network_faults]:
        echo(f"warning: {file}: fault: {type(lies[0]).__name__} has no effect: nobody lies in a log", err=True)
    names, seed = scenario.network.node_names, scenario.seed if seed is None else seed
    try:
        rows = fates_of(
            read_log(log, partial(_node_of, names=names, count=scenario.team.count)),
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
    table = _csv_of(rows, names)
    if out is None:
        echo(table, end="")
    else:
        write(table.encode(), out)
        echo(f"wrote {out}", err=True)


def _node_of(cell: str, names: Sequence[str], count: int) -> int:
    """Return the number of a node, given the cell of a log: its number, or its name if nodes have names.

    Raises:
        ValueError: if there is no such node.
    """
    name = cell.strip()
    if name in names:
        return names.index(name)
    are_numbers = any(known_name.isdecimal() for known_name in names)  # "1" is then a name, and not the second node
    if not are_numbers and name.isascii() and name.isdecimal() and int(name) < count:
        return int(name)
    some = f"{names[0]} .. {names[-1]}" if names else f"0 .. {count - 1}"
    raise ValueError(f"there is no node {escaped(name)}: the nodes are {some}")


def _csv_of(rows: "Sequence[Fate]", names: Sequence[str]) -> str:
    """Return fates as CSV with the names of nodes, if they have any; without an arrival the cell is empty."""
    from desim.kernel.fates import Fate

    table, shown = StringIO(), dict(enumerate(names))
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(Fate._fields)
    for row in rows:
        arrived = "" if isnan(row.arrived) else row.arrived
        writer.writerow(row._replace(src=shown.get(row.src, row.src), dst=shown.get(row.dst, row.dst), arrived=arrived))  # type: ignore[arg-type]
    return table.getvalue()
