"""`desim netem`: the links of a scenario as commands of `tc`, and back."""

from pathlib import Path

import click

from desim.cli.options import PATH, overriding
from desim.cli.output import echo, fail, write
from desim.cli.sources import source_of
from desim.cli.usage import problem
from desim.config.number_files import text_of_file


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
        _write(file, overrides, device, folder)
    elif text is not None:
        _read(text, "--parse", folder)
    elif commands is not None:
        try:
            text = text_of_file(commands)
        except ValueError as error:
            fail(str(error))
        _read(text, str(commands), folder)


def _write(file: Path, overrides: tuple[str, ...], device: str, folder: Path | None) -> None:
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


def _read(text: str, source: str, folder: Path | None) -> None:
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
