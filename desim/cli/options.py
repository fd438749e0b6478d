"""The options that commands share, and their types."""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from functools import wraps
from pathlib import Path
from typing import Any

import click

from desim.cli import completion
from desim.cli.output import fail
from desim.simulation.watchdog import checked_limit, within

COUNT = click.IntRange(1, 1_000_000)
"""The type of counts, as of runs; its bounds are those of `sweep.reps`, whose module is slow to import."""


class _PathType(click.Path):
    """The type of paths, whether or not they exist.

    It refuses a path that the system does not look up, for instance in a folder without permission.
    """

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path; raise a usage error if the system refuses to look it up."""
        path = Path(value)
        try:
            path.exists()
        except OSError as error:
            self.fail(f"{value}: {error.strerror}", param, ctx)
        return path


PATH = _PathType()
FILE = click.argument("file", type=PATH)


class Parsed(click.ParamType[Any]):
    """A parameter type: a text of some form.

    Args:
        name: the form, for the help.
        parse: returns what a text stands for; raises ValueError if it has another form.
        wanted: the form with an example, for the message about a text of another form.
    """

    def __init__(self, name: str, parse: Callable[[str], Any], wanted: str):
        self.name, self._parse, self._wanted = name, parse, wanted

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the value that a text represents."""
        try:
            return self._parse(str(value))
        except ValueError:
            self.fail(f"{value!r} should be {self._wanted}", param, ctx)


def pair(form: str = "KEY=VALUE", example: str = "protocol.kind=sap") -> Parsed:
    """Return the type of two texts that are separated by the first equals sign."""

    def parse(text: str) -> tuple[str, str]:
        first, equals, second = text.partition("=")
        if not (first and equals):
            raise ValueError
        return first, second

    return Parsed(form, parse, f"{form}, {example} for instance")


def out_to(text: str, *, required: bool = False) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return the option --out with its help."""
    return click.option("-o", "--out", type=PATH, required=required, help=text)


def _check_settings(ctx: click.Context, param: click.Parameter, settings: tuple[str, ...]) -> tuple[str, ...]:
    """Return the settings; end the program if one has no "=".

    In `--set KEY = VALUE`, with spaces, only KEY is the value of --set. Without this check, the error message would be
    about superfluous arguments.
    """
    for setting in settings:
        if "=" not in setting:
            form = param.make_metavar(ctx)
            fail(f"{param.opts[-1]} {setting}: should be {form} in one word, for instance network.latency.value=0.05")
    return settings


SET = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    callback=_check_settings,
    shell_complete=completion.keys,
    help="Override a key, e.g. network.latency.value=0.05.",
)
GRID = click.option(
    "-g",
    "--grid",
    multiple=True,
    metavar="KEY=V1,V2,...",
    callback=_check_settings,
    shell_complete=completion.keys,
    help="Sweep a key over values, in addition to sweep.grid or in place of its values there; can be repeated. A"
    " range FIRST:LAST:STEP, such as 0:1:0.1, stands for its numbers, the last included, and log:FIRST:LAST:COUNT for"
    " numbers with equal ratios. LOW:HIGH and log:LOW:HIGH are ranges without steps.",
)
DESIGN = click.option(
    "--design",
    metavar="METHOD:SIZE",
    help="Choose SIZE points of the ranges LOW:HIGH of the grid: sobol:64, latin_hypercube:64 or random:64.",
)
SEED = click.option(
    "-s",
    "--seed",
    type=click.IntRange(min=0),
    help="Seed of the run, or root seed of several: run k then has the seed 1,000,000 s + k; default: the file's.",
)
JOBS = click.option(
    "-j", "--jobs", type=click.IntRange(min=0), default=1, help="Worker processes; 0 = one per core; default: 1."
)
JSON = click.option(
    "--json", "as_json", is_flag=True, help="Print the result as JSON on stdout, and messages on stderr."
)


def _allow(ctx: click.Context, _param: click.Parameter, is_allowed: bool) -> None:
    """Store in the context of a command whether its scenario file is trusted."""
    ctx.meta[ALLOWED] = is_allowed


ALLOWED = "desim.allow_import"
"""The key of --allow-import in the context of a command."""
ALLOW_IMPORT = click.option(
    "--allow-import",
    is_flag=True,
    expose_value=False,
    callback=_allow,
    help="Trust the file and --set: allow them to name code to run (module:name) and files outside the file's folder.",
)


def overriding(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command that reads a scenario file the options --allow-import and --set."""
    return ALLOW_IMPORT(SET(command))


METRIC = click.option(
    "--metric",
    "metrics",
    multiple=True,
    metavar="NAME",
    help="Measure and show a metric: a built-in or installed one (`desim metrics`), or MODULE:FUNCTION, a function of"
    " the result of a run; can be repeated.",
)


ONE_METRIC = click.option(
    "-y",
    "--metric",
    metavar="NAME",
    default="active_time",
    show_default=True,
    help="The metric: a built-in or installed one (`desim metrics`), or MODULE:FUNCTION, a function of the result of a"
    " run.",
)


LABEL = click.option(
    "--label",
    "labels",
    multiple=True,
    type=pair("VALUE=TEXT", 'sap="SAP (ours)"'),
    help='The text for a value of a key, e.g. sap="SAP (ours)", or for a key; can be repeated.',
)
AGAINST = click.option(
    "--against",
    multiple=True,
    type=pair(),
    help="Show paired differences from the configurations with this value, all else equal; can be repeated.",
)


def is_import_allowed() -> bool:
    """Return whether the current command was given --allow-import."""
    return bool(click.get_current_context().meta.get(ALLOWED))


def as_words(options: Mapping[str, Any]) -> list[str]:
    """Return options with their values as words of a command line, for a message or a script.

    If the value is None or False, the option is left out. True is the value of a flag; a tuple repeats the option.
    """
    words: list[str] = []
    for option, values in options.items():
        for value in values if isinstance(values, tuple) else (values,):
            if value is not None and value is not False:
                words += [option] if value is True else [option, str(value)]
    return words


def _checked_limit(_ctx: click.Context, _param: click.Parameter, limit: float | None) -> float | None:
    try:
        return limit if limit is None else checked_limit(limit)
    except ValueError as error:
        raise click.BadParameter(str(error)) from error


def _timeout(text: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return the option --timeout with its help."""
    return click.option("--timeout", type=float, metavar="SECONDS", callback=_checked_limit, help=text)


MIX_VERSIONS = click.option(
    "--mix-versions", is_flag=True, help="Mix runs of different versions of Python, numpy, scipy, SimPy or networkx."
)
TIMEOUT = _timeout("End a run after this wall time, and print what each pursuer is waiting for.")


def limited(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the option --timeout, which limits it as a whole."""

    @_timeout("End the command after this wall time; if a run is under way, print what each pursuer is waiting for.")
    @wraps(command)
    def within_limit(*args: Any, timeout: float | None, **options: Any) -> None:
        with nullcontext() if timeout is None else within(timeout):
            command(*args, **options)

    return within_limit
