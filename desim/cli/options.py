"""Shared parts of the commands: options, reading of scenarios, output, and errors."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from desim.cli import completion
from desim.cli.usage import metric_option, problem, spelled
from desim.config.extras import EXTRAS, missing
from desim.config.file_names import files, folder_name
from desim.config.trust import escaped, write_whole
from desim.simulation.watchdog import checked_limit, within

if TYPE_CHECKING:
    from desim.scenario.overrides import Source
    from desim.scenario.scenario import Scenario

COUNT = click.IntRange(1, 1_000_000)
"""The number of runs, with the bounds of `sweep.reps`, which is slow to import."""
FAILED = 3
"""Exit code if some of many runs failed."""
WRONG_INPUT = 2
"""Exit code if a file or an option is invalid."""
RAISED = 1
"""Exit code if a metric of a user raises an exception, or a metric or a model of a user returns a wrong value."""
OUT_OF_TIME = 1
"""Exit code if a run or a command exceeds its time limit."""
NO_MEMORY = 1
"""Exit code if the memory is full."""

FILE = click.argument("file", type=click.Path(path_type=Path))


def _one_word_each(ctx: click.Context, param: click.Parameter, settings: tuple[str, ...]) -> tuple[str, ...]:
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
    callback=_one_word_each,
    shell_complete=completion.keys,
    help="Override a key, e.g. network.latency.value=0.05.",
)
GRID = click.option(
    "-g",
    "--grid",
    multiple=True,
    metavar="KEY=V1,V2,...",
    callback=_one_word_each,
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


class Pair(click.ParamType[tuple[str, str]]):
    """A parameter type: two texts, KEY=VALUE.

    Args:
        example: an example, for the message about a value that has another form.
    """

    name = "KEY=VALUE"

    def __init__(self, example: str = "protocol.kind=sap"):
        self._example = example

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, str]:
        """Return the texts before and after the first equals sign."""
        first, equals, second = str(value).partition("=")
        if not (first and equals):
            form = self.name if param is None or ctx is None else param.make_metavar(ctx)
            form = form if "=" in form else self.name
            self.fail(f"{value!r} should be {form}, {self._example} for instance", param, ctx)
        return first, second


LABEL = click.option(
    "--label",
    "labels",
    multiple=True,
    type=Pair('sap="SAP (ours)"'),
    metavar="VALUE=TEXT",
    help='The text for a value of a key, e.g. sap="SAP (ours)", or for a key; can be repeated.',
)
AGAINST = click.option(
    "--against",
    multiple=True,
    type=Pair(),
    metavar="KEY=VALUE",
    help="Show paired differences from the configurations with this value, all else equal; can be repeated.",
)


def is_import_allowed() -> bool:
    """Return whether the current command was given --allow-import."""
    return bool(click.get_current_context().meta.get(ALLOWED))


def _limit(_ctx: click.Context, _param: click.Parameter, limit: float | None) -> float | None:
    try:
        return limit if limit is None else checked_limit(limit)
    except ValueError as error:
        raise click.BadParameter(str(error)) from error


MIX_VERSIONS = click.option(
    "--mix-versions", is_flag=True, help="Mix runs of different versions of Python, numpy, scipy, SimPy or networkx."
)
TIMEOUT = click.option(
    "--timeout",
    type=float,
    metavar="SECONDS",
    callback=_limit,
    help="End a run after this wall time, and print what each pursuer is waiting for.",
)


def limited(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the option --timeout, which limits it as a whole."""

    @click.option(
        "--timeout",
        type=float,
        metavar="SECONDS",
        callback=_limit,
        help="End the command after this wall time; if a run is under way, print what each pursuer is waiting for.",
    )
    @wraps(command)
    def within_limit(*args: Any, timeout: float | None, **options: Any) -> None:
        with nullcontext() if timeout is None else within(timeout):
            command(*args, **options)

    return within_limit


def source_of(
    file: Path,
    overrides: tuple[str, ...],
    metrics: tuple[str, ...] = (),
    grid: tuple[str, ...] = (),
    design: str | None = None,
    folder: Path | None = None,
) -> "tuple[Source, Scenario]":
    """Return the source of a scenario file and its scenario, with the values of --metric, --grid and --design.

    Modules and files that it names are looked up in `folder`; None: that of the file. Print warnings, and end the
    program if the scenario is invalid; see `valid`.
    """
    from desim.scenario.overrides import ScenarioError
    from desim.scenario.toml import looked_up_in, read_source

    try:
        source = read_source(file, overrides, allow_import=is_import_allowed())
        source = source if folder is None else looked_up_in(source, folder)
        for setting in grid:
            source.vary(setting)
        if design is not None:
            _set_design(source, design)
        add_metrics(source, metrics)
    except ScenarioError as error:
        fail(str(error))
    except OSError as error:
        fail(f"{file}: cannot be read: {error.strerror}{_instead_of(file)}")
    return source, valid(source)


def added_metrics(metric: str) -> tuple[str, ...]:
    """Return the metric of -y if it is to be added to those of a scenario, which are built in or named by its file."""
    from desim.scenario.named_metrics import installed_metrics

    return (metric,) if ":" in metric or metric in installed_metrics() else ()


def _set_design(source: "Source", text: str) -> None:
    """Set the method and the size of `sweep.design`; the other keys of the design remain.

    Raises:
        ScenarioError: if the text is not METHOD:SIZE.
    """
    from desim.scenario.overrides import ScenarioError
    from desim.scenario.sweep_table import design_of

    present = source.at(["sweep", "design"])
    try:
        table = design_of(text)
    except ValueError as error:
        raise ScenarioError(f"--design {text}: {error}") from None
    source.set("sweep.design", (present if isinstance(present, dict) else {}) | table, f"--design {text}")


def _instead_of(file: Path) -> str:
    """Return what to give instead of a scenario file that cannot be read, as the end of a message; "" if unknown."""
    from desim.config.suggestion import did_you_mean
    from desim.scenario.examples import examples

    if file.is_dir():
        scenarios = sorted(file.glob("*.toml"))
        return f"; a file in it is {scenarios[0]}" if scenarios else "; a scenario is one file, NAME.toml"
    with_suffix = file.with_suffix(".toml")
    if with_suffix != file and with_suffix.is_file():
        return f", did you mean {with_suffix}?"
    if file.stem in examples() and file.parent == Path():
        return f"; an example: `desim examples {file.stem}` writes {file.stem}.toml, which then can be run"
    beside = [path.name for path in file.parent.glob("*.toml")] if file.parent.is_dir() else []
    if not file.suffix and file.parent.is_dir():
        beside += [path.name for path in file.parent.iterdir() if path.is_dir()]
    return did_you_mean(file.name, beside) or did_you_mean(file.stem, beside)


def add_metrics(source: "Source", metrics: tuple[str, ...]) -> None:
    """Add to `record.metrics` of a scenario the metrics of --metric that are not built in.

    End the program if a metric does not exist or is not numeric. A MODULE:FUNCTION is imported and checked later, when
    the scenario is validated.
    """
    if not metrics:
        return
    from desim.analysis.metrics import METRICS, check_numeric
    from desim.scenario.named_metrics import installed_metrics

    for metric in metrics:
        try:
            if ":" not in metric:
                check_numeric(metric, installed_metrics())
        except ValueError as error:
            fail(f"{metric_option()} {metric}: {error}, and MODULE:FUNCTION")
    added = [name for name in metrics if name not in METRICS]
    table = source.tables.setdefault("record", {}) if added else None
    named = table.get("metrics", []) if isinstance(table, dict) else None
    if isinstance(table, dict) and isinstance(named, list):
        table["metrics"] = [*named, *added]
        source.origins.update(
            (("record", "metrics", k), f"{metric_option()} {name}") for k, name in enumerate(added, len(named))
        )


def shown_metrics(scenario: "Scenario", metrics: tuple[str, ...], usual: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Return the names of the metrics to show, each once.

    They are the metrics of --metric or, without this option, `usual` and the metrics of the scenario.
    """
    names = tuple(dict.fromkeys(metric.rpartition(":")[2] for metric in metrics))
    return names or (*usual, *(metric.name for metric in scenario.record.metrics))


def valid(source: "Source") -> "Scenario":
    """Return the validated scenario of a source; print warnings, and end the program if it is invalid."""
    from desim.scenario.checks import warnings
    from desim.scenario.overrides import ScenarioError
    from desim.scenario.toml import validate

    try:
        scenario = validate(source)
    except ScenarioError as error:
        fail(str(error))
    if scenario.record.metrics:
        from desim.analysis.metrics import users_metrics

        for k in range(len(scenario.record.metrics)):
            try:
                users_metrics(scenario.record.metrics[: k + 1])
            except ValueError as error:
                fail(f"{source.where(('record', 'metrics', k))}: record.metrics.{k}: {error}")
    for key, why in warnings(scenario):
        place = tuple(int(part) if part.isdigit() else part for part in key.split("."))
        echo(f"warning: {source.where(place)}: {key}: {why}", err=True)
    return scenario


def protocol_of(text: str, option: str) -> Any:
    """Return the protocol that an option names as KIND, MODULE:NAME, FILE.py:NAME, or { kind = ..., ... }.

    A module is an installed one, or lies in the working folder or in that of the file. End the program if it is
    invalid, or names code without --allow-import.
    """
    from desim.scenario.overrides import ScenarioError, Source
    from desim.scenario.scenario import Scenario
    from desim.scenario.toml import validate

    folder, name = Path(), text
    file, colon, inner = text.rpartition(":")
    if colon and file.endswith(".py"):
        folder, name = Path(file).parent, f"{Path(file).stem}:{inner}"
    source = Source(option, {}, Scenario, folder=folder, allow_import=is_import_allowed())
    setting = f"protocol={name}"
    try:
        source.override(setting)
        return validate(source).protocol
    except ScenarioError as error:
        fail(str(error).replace(f"--set {setting}", f"{option} {text}"))


def make_folder(folder: Path) -> None:
    """Create the output folder; end the program if it cannot be written. Warn if matplotlib is not installed."""
    from desim.results.run_folder import can_plot

    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".writable").touch()
        (folder / ".writable").unlink()
    except FileExistsError as error:
        fail(f"--out {folder}: cannot be written: is a file, and should be a folder, made if absent ({error.filename})")
    except OSError as error:
        fail(f"--out {folder}: cannot be written: {error.strerror}; give another folder")
    if not can_plot():
        echo(f"warning: no picture: {missing('matplotlib')}", err=True)


def write(page: bytes, path: Path) -> None:
    """Write a page, and create missing folders; end the program if the page cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, page)
    except OSError as error:
        fail(f"{path}: cannot be written: {error.strerror}")


def page_at(out: Path | None, usual: Path) -> Path:
    """Return the path of a page, `usual` by default; end the program if `out` has a suffix other than .html."""
    try:
        return usual if out is None else files(out, [".html"], [".html"])[0]
    except ValueError as error:
        fail(f"--out {error}")


def folder_for(scenario: "Scenario", out: Path | None) -> Path:
    """Return the folder of the results of many runs: by default out/NAME, where "-" replaces special characters."""
    return out or Path("out") / folder_name(scenario.name)


@contextmanager
def making(page: str) -> Iterator[None]:
    """End the program if a page or picture needs a package that is not installed, or the results are invalid."""
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        fail(f"no {page}: {missing(package, EXTRAS.get(package, 'plot'))}")
    except ValueError as error:
        fail(problem(error))


@contextmanager
def of_option(name: str, value: object) -> Iterator[None]:
    """End the program on a ValueError about the value of an option, whose name then precedes the message."""
    try:
        yield
    except ValueError as error:
        fail(f"{spelled(name)} {value}: {error}")


@contextmanager
def storing(folder: Path | None = None) -> Iterator[None]:
    """End the program if a store or a folder cannot be used, or a cluster does not respond."""
    try:
        yield
    except FileExistsError as error:
        fail(f"{error.filename or folder}: {error.strerror}: a file, where --out should name a folder")
    except OSError as error:
        file = error.filename or folder
        option = "--out " if folder is not None and str(file).startswith(str(folder)) else ""
        fail(f"{option}{file}: {error.strerror}" if error.strerror else str(error))  # desim's own have no strerror


def echo(text: str, *, err: bool = False, end: str = "\n") -> None:
    """Print a text that may contain untrusted parts, with control characters escaped.

    If stderr is full, this and all later messages are dropped, so that results and the exit code remain.
    """
    try:
        click.echo(escaped(text) + end, nl=False, err=err)
    except OSError:
        if not err:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


MAX_LINE = 2000
"""Maximum length of a line of an error message, characters; a name in a file can be as long as the file."""


def fail(text: str) -> NoReturn:
    """Print an error, without the middle of very long lines, and end the program with exit code `WRONG_INPUT`."""
    half = MAX_LINE // 2
    lines = [line if len(line) <= MAX_LINE else f"{line[:half]} ... {line[-half:]}" for line in text.split("\n")]
    echo("\n".join(lines), err=True)
    sys.exit(WRONG_INPUT)
