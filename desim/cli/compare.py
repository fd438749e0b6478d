"""Several results: `desim ls` lists them, `desim compare` and `desim crossover` compare configurations."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from desim.cli.options import JSON, PATH, Parsed, pair
from desim.cli.output import echo, fail, of_option, storing
from desim.cli.usage import problem

if TYPE_CHECKING:
    from desim.study.results.crossover import Crossover
    from desim.study.results.threshold import Threshold


def _share(text: str) -> float:
    """Return the share that a text states in percent, 0.1 for 10%; raise ValueError if it has another form."""
    number, sign, remainder = text.partition("%")
    if not sign or remainder:
        raise ValueError
    return float(number) / 100.0


@click.command()
@click.argument("folder", metavar="[DIR]", default="out", type=PATH)
@JSON
def ls(folder: Path, as_json: bool) -> None:
    """List the runs, sweeps and explanations in a folder and its subfolders; default: out."""
    from desim.study.sweeps.listing import ls as listing_of

    try:
        listing = listing_of(folder)
    except NotADirectoryError:
        fail(f"{folder}: is not a folder: give one that has results, such as the --out of a run or a sweep")
    echo(json.dumps([entry.document() for entry in listing], indent=2) if as_json else listing.table())


@click.command()
@click.argument("first", metavar="A", type=PATH)
@click.argument("second", metavar="B", type=PATH)
@click.option("-y", "--y", "metrics", multiple=True, metavar="METRIC", help="A metric to compare; can be repeated.")
@click.option(
    "--format",
    "table_format",
    type=click.Choice(["text", "latex", "markdown"]),
    default="text",
    show_default=True,
    help="The format of the table; latex needs the package booktabs.",
)
@JSON
def compare(first: Path, second: Path, metrics: tuple[str, ...], table_format: str, as_json: bool) -> None:
    """Compare two sweeps: B minus A for each configuration that both have.

    A and B are folders or stores. Runs with the same seed are paired. With fewer than two seeds in common, the runs
    are compared as independent ones. A sentence says where the two differ, corrected for the number of comparisons.
    """
    from desim.study.results.runs import SHOWN
    from desim.study.sweeps.folder import compare as compared

    try:
        with storing():
            comparison = compared(first, second, metrics or SHOWN)
    except ValueError as error:
        fail(problem(error))
    except (OSError, TypeError) as error:
        fail(str(error))
    if as_json:
        echo(json.dumps(comparison.document(), indent=2))
    else:
        echo(comparison.table(format=table_format))  # type: ignore[arg-type]  # one of its formats


@click.command()
@click.argument("source", metavar="DIR", type=PATH)
@click.argument("key", metavar="KEY")
@click.argument("a", metavar="[A]", type=pair(), required=False)
@click.argument("b", metavar="[B]", type=pair(), required=False)
@click.option(
    "--over",
    type=Parsed("N%", _share, "a share in percent, 10% for instance"),
    help="Without A and B: from which value of KEY on the metric is this share over its mean at the baseline, e.g. 10%"
    " (-10%: under it).",
)
@click.option("--baseline", metavar="VALUE", help="With --over: the value of KEY at the baseline; default: the least.")
@click.option("-y", "--y", "metric", metavar="METRIC", default="active_time", show_default=True, help="The metric.")
@click.option(
    "--where",
    multiple=True,
    type=pair(),
    help="The value of another key that takes several; can be repeated.",
)
@JSON
def crossover(
    source: Path,
    key: str,
    a: tuple[str, str] | None,
    b: tuple[str, str] | None,
    over: float | None,
    baseline: str | None,
    metric: str,
    where: tuple[tuple[str, str], ...],
    as_json: bool,
) -> None:
    """Find the value of KEY from which A is better than B in a sweep, with a 95 % interval.

    A and B are values of another key, for instance: desim crossover out/relay network.latency.value protocol=sap
    protocol=cbba. With --over, find the value of KEY from which the metric exceeds its baseline by a share: desim
    crossover out/relay network.latency.value --over 10%
    """
    from desim.study.results.result import SweepResult
    from desim.study.sweeps.folder import open as open_results

    is_crossover, is_threshold = b is not None and over is None, a is None and over is not None
    if not (is_crossover or is_threshold):
        raise click.UsageError("give either the two curves A and B, protocol=sap protocol=cbba, or --over 10%")
    if baseline is not None and over is None:
        raise click.UsageError("--baseline is an option of --over")
    try:
        with storing():
            result = open_results(source)
        if not isinstance(result, SweepResult):
            fail(f"{source}: is a run, and a crossover is of a sweep")
        crossing: Crossover | Threshold
        for other, value in where:
            with of_option("where", f"{other}={value}"):
                result.setting(other, value)  # raises an error unless the sweep has this value
        if baseline is not None and key in result.keys:
            with of_option("baseline", baseline):
                result.setting(key, baseline)
        if a is not None and b is not None:
            crossing = result.crossover(metric, key, dict([a]), dict([b]), where=dict(where))
        else:
            crossing = result.threshold(metric, key, over or 0.0, baseline=baseline, where=dict(where))
    except ValueError as error:
        fail(problem(error))
    except OSError as error:
        fail(str(error))
    echo(json.dumps(crossing.document(), indent=2) if as_json else str(crossing))
