"""The command line: one module for each group of commands.

Modules that are slow to import are imported by the command that needs them.
"""

import io
import sys

import click

from desim.cli.about import check, keys, metrics, protocols, schema
from desim.cli.explain import explain
from desim.cli.export import export
from desim.cli.many import merge, sweep
from desim.cli.netem import netem
from desim.cli.one import run
from desim.cli.pages import replay, report
from desim.cli.play import play
from desim.cli.plot import plot
from desim.cli.program import Program
from desim.cli.start import examples, new
from desim.config.trust import no_cwd_import

RENAMED = {"draw": "plot"}
"""Names that users may try, each with the name of the command that they mean."""


class Commands(Program, click.Group):
    """The commands of `desim`."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the name of the command that the arguments begin with, the command, and the remaining arguments.

        Raises:
            click.UsageError: if there is no such command; for a name in `RENAMED` the message gives the right name.
        """
        if args[0] in RENAMED:
            ctx.fail(f"No such command {args[0]!r}. Did you mean {RENAMED[args[0]]!r}?")
        return super().resolve_command(ctx, args)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="pursuit-desim")
def main() -> None:
    """Simulate multi-robot relay pursuit that is negotiated over an imperfect network."""
    click.get_current_context().with_resource(no_cwd_import())
    if isinstance(sys.stdout, io.TextIOWrapper):  # escape characters that the encoding lacks
        sys.stdout.reconfigure(errors="backslashreplace")


for command in (
    *(examples, new, run, play, replay, plot, sweep, explain, report),
    *(merge, export, netem, check, keys, metrics, protocols, schema),
):
    main.add_command(command)
