"""The command line: one module for each group of commands.

Modules that are slow to import are imported by the command that needs them.
"""

import io
import sys

import click

from desim.cli.about import check, keys, metrics, protocols, schema
from desim.cli.analyses import explain, race, sensitivity
from desim.cli.bench import bench
from desim.cli.breaking import break_
from desim.cli.compare import compare, crossover, ls
from desim.cli.export import export
from desim.cli.links import fates, netem
from desim.cli.live import live
from desim.cli.merge import merge
from desim.cli.pages import play, replay, report
from desim.cli.plot import plot
from desim.cli.program import Program
from desim.cli.run import run
from desim.cli.start import examples, new
from desim.cli.submit import status, submit
from desim.cli.sweep import sweep
from desim.cli.usage import no_command
from desim.config.trust import no_cwd_import

GROUPS: dict[str, dict[click.Command, str]] = {
    "Start": {
        examples: "List the example scenarios, or copy one.",
        new: "Write a commented scenario, protocol, or model, ready to run.",
        check: "Validate a scenario, and print it with all defaults.",
    },
    "Run": {
        run: "Run a scenario with one or several seeds.",
        live: "Run a scenario in real time, over UDP between processes.",
        sweep: "Run each configuration of a grid with many seeds; resumes.",
        fates: "Send the messages of a log over the network of a scenario.",
        race: "Find the best configuration of a grid, in few runs.",
        sensitivity: "Find which keys decide a metric.",
        explain: "Measure what each imperfection of the network costs.",
        bench: "Score protocols in ten scenarios, beside all built-in ones.",
        break_: "Search for the smallest scenario that breaks a protocol.",
        submit: "Submit a sweep to Slurm, in parts; resumes.",
        status: "Say how far a sweep is.",
        merge: "Merge the runs of several stores of one sweep.",
    },
    "Look": {
        play: "Change a scenario on a page, and see what it does.",
        plot: "Draw a run or a sweep.",
        replay: "Make a page that plays a run.",
        report: "Make a page about a sweep.",
        compare: "Compare two sweeps, paired by seed.",
        crossover: "Say from which value on A is better than B in a sweep.",
        ls: "List the results in a folder.",
    },
    "Share": {
        export: "Write runs or events as a table, or for other programs.",
        netem: "Print the commands that give real links the latency and loss.",
        schema: "Print the JSON schema of scenario files, for editors.",
    },
    "Look up": {
        keys: "List the keys of scenario files, with defaults and units.",
        protocols: "List the protocols, their parameters and sources.",
        metrics: "List the metrics, with units.",
    },
}
"""The commands by what they are for, each with its line in the help of `desim`, of at most 65 characters."""
FIRST_STEP = "First: desim examples relay && desim run relay.toml && desim play relay.toml"


class Commands(Program, click.Group):
    """The commands of `desim`."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the name of the command that the arguments begin with, the command, and the remaining arguments.

        Raises:
            click.UsageError: if there is no such command; the message says what to type.
        """
        if args[0] not in self.commands and (message := no_command(args[0])):
            ctx.fail(message)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands in groups, and a first step."""
        for title, commands in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(f"{command.name:<9}", text) for command, text in commands.items()])
        formatter.write_paragraph()
        formatter.write_text(FIRST_STEP)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="pursuit-desim")
def main() -> None:
    """Simulate multi-robot relay pursuit that is negotiated over an imperfect network."""
    click.get_current_context().with_resource(no_cwd_import())
    if isinstance(sys.stdout, io.TextIOWrapper):  # escape characters that the encoding lacks
        sys.stdout.reconfigure(errors="backslashreplace")


for group in GROUPS.values():
    for command, line in group.items():
        command.short_help = line
        main.add_command(command)
