"""The links of a scenario alone: `desim fates` sends a log over them, and `desim netem` gives them to real ones."""

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
from desim.cli.usage import problem
from desim.config.escaping import escaped
from desim.config.number_files import text_of_file

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
    nodes = f"{names[0]} .. {names[-1]}" if names else f"0 .. {count - 1}"
    raise ValueError(f"there is no node {escaped(name)}: the nodes are {nodes}")


def _csv_of(rows: "Sequence[Fate]", names: Sequence[str]) -> str:
    """Return fates as CSV with the names of nodes, if they have any; the cell of a missing arrival is empty."""
    from desim.kernel.fates import Fate

    table, name_of = StringIO(), dict(enumerate(names))
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(Fate._fields)
    for row in rows:
        arrived = "" if isnan(row.arrived) else row.arrived
        src, dst = (name_of.get(node, node) for node in (row.src, row.dst))
        writer.writerow(row._replace(src=src, dst=dst, arrived=arrived))  # type: ignore[arg-type]
    return table.getvalue()


@click.command()
@click.argument("file", type=PATH, required=False)
@click.option("--dev", "device", default="eth0", help="Network device of each node; default: eth0.")
@click.option(
    "--table",
    "folder",
    metavar="DIR",
    type=PATH,
    help="Folder of distribution tables NAME.dist: those that the commands need are written there, and those that"
    " --parse and --from name are read there; default: none is written, read from the working directory.",
)
@click.option("--parse", "text", metavar="COMMAND", help="Instead of a FILE: a command of tc to read.")
@click.option(
    "--from",
    "commands",
    metavar="FILE",
    type=PATH,
    help="Instead of a FILE: a file of commands of tc to read.",
)
@overriding
def netem(
    file: Path | None,
    device: str,
    folder: Path | None,
    text: str | None,
    commands: Path | None,
    overrides: tuple[str, ...],
) -> None:
    """Print the commands `tc qdisc add ... netem` that give real links of Linux the behaviour of a scenario FILE.

    What netem cannot express gives a warning. With --parse or --from, read such commands, and print the table [network]
    of a scenario.
    """
    if sum(option is not None for option in (file, text, commands)) != 1:
        raise click.UsageError("needs one of FILE, --parse COMMAND and --from FILE")
    if file is not None:
        _print_commands(file, overrides, device, folder)
    elif text is not None:
        _print_network(text, "--parse", folder)
    elif commands is not None:
        try:
            text = text_of_file(commands)
        except ValueError as error:
            fail(str(error))
        _print_network(text, str(commands), folder)


def _print_commands(file: Path, overrides: tuple[str, ...], device: str, folder: Path | None) -> None:
    """Print the commands for the links of a scenario; write their tables to a folder, if one is given."""
    from desim.kernel.models.netem_tables import TABLES, table_text
    from desim.kernel.tc.writer import script

    _, scenario = source_of(file, overrides)
    try:
        commands = script(scenario.network, scenario.team.count, device, scenario.wall)
    except ValueError as error:
        fail(f"{file}: {problem(error)}")
    missing = [*commands.missing, *([("fault", "netem has no faults")] if scenario.fault else [])]
    for key, why in missing:
        echo(f"warning: {file}: {key}: {why}", err=True)
    custom_tables = sorted(commands.tables.keys() - TABLES.keys())
    if custom_tables and folder is None:
        echo(f"warning: {file}: tc needs the tables {', '.join(custom_tables)}: write them with --table DIR", err=True)
    echo("\n".join(commands.lines))
    if custom_tables and folder is not None:  # tc reads all tables from one folder
        for name, table in commands.tables.items():
            write(table_text(table, name).encode(), folder / f"{name}.dist")
            echo(f"wrote {folder / f'{name}.dist'}", err=True)
        echo(f"tc reads them if TC_LIB_DIR={folder.absolute()} is in its environment", err=True)


def _print_network(text: str, source: str, folder: Path | None) -> None:
    """Print the table `[network]` that commands of tc describe."""
    import tomli_w

    from desim.kernel.tc.reader import read_script
    from desim.kernel.tc.syntax import TcError

    try:
        reading = read_script(text, source, folder)
    except TcError as error:
        fail(str(error))
    for line in reading.ignored:
        echo(f"warning: {line}", err=True)
    echo(tomli_w.dumps({"network": reading.network}), end="")
