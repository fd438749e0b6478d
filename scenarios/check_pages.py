"""Measure again, with few runs and other seeds, the numbers with intervals in README and docs.

Each claim is a sentence of a page, the study that measured it, and where its numbers are in the JSON document of the
study. A published and a measured mean should differ by at most 1.5 times the root of the sum of the squares of their
half widths: a true sentence passes with a probability of 99.7 % a number. Run it after any change that may move
results; it takes minutes, and --page checks one page only.
"""

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import hypot
from tempfile import TemporaryDirectory
from typing import Any

import click

from desim.cli.program import Program
from scenarios.studies.study import SCENARIOS

MARGIN = 1.5
"""Largest difference of two means, in roots of the sum of the squares of their half widths."""
INTERVAL = re.compile(r"([+-]?\d[\d,]*\.?\d*) \+- (\d+\.?\d*)")
"""A mean and the half width of its 95 % interval."""
Document = Mapping[str, Any]
"""What a study prints with --json."""
Number = Callable[[Document], tuple[float, float]]
"""Finds a mean and its half width in a document."""


@dataclass(frozen=True)
class Claim:
    """A sentence, or part of it, with numbers that a study measures."""

    page: str
    """The path of the page in the repository."""
    sentence: str
    """The text as it is on the page; line breaks count as spaces."""
    study: tuple[str, ...]
    """The module and perhaps options, of which the page names the module."""
    numbers: tuple[Number, ...]
    """Where the document of the study has each mean with an interval in the sentence, in order."""

    def published(self) -> list[tuple[float, float]]:
        """Return the means and half widths in the sentence."""
        return [(float(mean.replace(",", "")), float(half)) for mean, half in INTERVAL.findall(self.sentence)]

    def is_on_page(self) -> bool:
        """Return whether the page has the sentence, and names the study."""
        text = " ".join((SCENARIOS.parent / self.page).read_text(encoding="utf-8").split())
        return self.sentence in text and f"python -m {self.study[0]}" in text

    def misfits(self, document: Document) -> Iterator[str]:
        """Yield a line for each number that a document contradicts."""
        for (mean, half), number in zip(self.published(), self.numbers, strict=True):
            measured, width = number(document)
            if abs(measured - mean) > MARGIN * hypot(half, width):
                yield f"{self.page}: {mean:g} +- {half:g}, measured {measured:.3g} +- {width:.2g}: {self.sentence}"


def number(table: str, value: str, index: int | None = None, *, scale: float = 1.0, **keys: Any) -> Number:
    """Return a function that finds an estimate in a table of a document, in the row with given values of some keys.

    Args:
        table: the name of the table.
        value: the key of the estimate.
        index: its index, if the key has a list of estimates.
        scale: the factor by which the page multiplies it.
        keys: values of other keys.
    """

    def find(document: Document) -> tuple[float, float]:
        (row,) = (row for row in document[table] if all(row[key] == wanted for key, wanted in keys.items()))
        estimate = row[value] if index is None else row[value][index]
        return scale * estimate["mean"], abs(scale) * estimate["half_width"]

    return find


START, WORTH = ("scenarios.start",), ("scenarios.start", "--worth")
BODIES = ("scenarios.bodies",)
FINDINGS, NEGOTIATION = "docs/explanation/findings.md", "docs/explanation/negotiation.md"
WHERE = {"few in time": "default speeds, few", "all in time": "`team.speeds = 2.5`, all"}


def cost(team: str, rule: str, latency: int, start: str = "announced") -> Number:
    """Return a function that finds what the latency of an index costs in `scenarios.start`."""
    return number("costs", "costs", latency, team=team, rule=rule, start=start)


def row_of_start(team: str, start: str, *costs: str) -> Claim:
    """Return the claim that is a row of the table of starts, of the first one, two or three rules."""
    rules = ("sap", "best_response", "local_min")[: len(costs)]
    numbers = tuple(cost(team, rule, latency, start) for rule in rules for latency in (0, 1))
    return Claim(NEGOTIATION, f"| {WHERE[team]} | {start} | {' | '.join(costs)}", START, numbers)


def of_bodies(value: str, motion: str, latency: float, rule: str = "one at a time") -> Number:
    """Return a function that finds an estimate of `scenarios.bodies`."""
    return number("cells", value, rule=rule, motion=motion, latency=latency)


def saved(rule: str, start: str) -> Number:
    """Return a function that finds what a message of a rule saves, ms."""
    return number("worth", "saved", rule=rule, start=start, scale=1000.0)


CLAIMS = (
    Claim(
        "README.md",
        "half a second of latency costs `local_min` 7.5 +- 0.7 s, Spatial Adaptive Play 7.2 +- 1.2 s",
        START,
        (cost("all in time", "local_min", 1), cost("all in time", "sap", 1)),
    ),
    Claim(
        "README.md",
        "one of Spatial Adaptive Play saves 26.9 +- 2.0 ms of active time and one of `local_min` nothing; with a"
        " silent start, 3.8 +- 1.3 ms and 5.8 +- 1.2 ms",
        WORTH,
        (saved("sap", "announced"), saved("sap", "silent"), saved("local_min", "silent")),
    ),
    Claim(
        FINDINGS,
        "a message of SAP saves 26.9 +- 2.0 ms of active time, if they are known, 26.5 +- 2.0 ms, and with a silent"
        " start, 3.8 +- 1.3 ms. One of `local_min` saves nothing, nothing, and 5.8 +- 1.2 ms",
        WORTH,
        (*(saved("sap", start) for start in ("announced", "known", "silent")), saved("local_min", "silent")),
    ),
    Claim(
        FINDINGS,
        "half a second of latency then costs `local_min` 7.5 +- 0.7 s of active time, and SAP 7.2 +- 1.2 s",
        START,
        (cost("all in time", "local_min", 1), cost("all in time", "sap", 1)),
    ),
    row_of_start(
        "few in time",
        "known",
        "12.57; +1.18 +- 0.23, +5.47 +- 0.41",
        "12.42; +1.08 +- 0.21, +5.56 +- 0.38",
    ),
    row_of_start(
        "few in time",
        "silent",
        "12.44; +0.19 +- 0.32, +1.43 +- 0.44",
        "12.40; +0.18 +- 0.30, +1.48 +- 0.42",
        "9.14; +0.17 +- 0.07, +0.74 +- 0.22",
    ),
    row_of_start(
        "few in time",
        "announced",
        "12.57; +0.07 +- 0.31, +1.39 +- 0.43",
        "12.42; +0.15 +- 0.28, +1.54 +- 0.42",
        "9.10; +0.13 +- 0.05, +0.72 +- 0.21",
    ),
    row_of_start(
        "all in time",
        "known",
        "7.88; +0.57 +- 0.19, +2.51 +- 0.55",
        "7.51; +0.73 +- 0.23, +2.78 +- 0.60",
    ),
    row_of_start(
        "all in time",
        "silent",
        "7.87; +1.60 +- 0.36, +7.36 +- 1.21",
        "7.59; +1.93 +- 0.34, +7.66 +- 1.16",
        "4.75; +1.73 +- 0.16, +7.55 +- 0.73",
    ),
    row_of_start(
        "all in time",
        "announced",
        "7.88; +1.60 +- 0.37, +7.25 +- 1.20",
        "7.51; +1.90 +- 0.32, +7.66 +- 1.15",
        "4.61; +1.63 +- 0.16, +7.51 +- 0.71",
    ),
    Claim(
        NEGOTIATION,
        "4.37 +- 0.45 s of the increase of 5.56 s after a known start, and 0.50 +- 0.32 s of 1.54 s after",
        START,
        tuple(number("who", "late", utility="mean", start=start) for start in ("known", "announced")),
    ),
    Claim(
        FINDINGS,
        "and 6.0 +- 1.5 s with simple motion; at 1 s a turning radius of 2 m costs 3.5 +- 2.7 s more",
        BODIES,
        (of_bodies("of_latency", "simple", 0.5), of_bodies("of_inertia", "radius 2 m", 1.0)),
    ),
)
"""The claims that are checked."""


def document_of(study: Sequence[str], runs: int, seed: int, jobs: int) -> Document:
    """Return what a study measures.

    Raises:
        subprocess.CalledProcessError: if the study fails.
    """
    with TemporaryDirectory() as folder:
        options = ["--json", "--runs", str(runs), "--seed", str(seed), "--jobs", str(jobs), "--out", folder]
        done = subprocess.run([sys.executable, "-m", *study, *options], stdout=subprocess.PIPE, check=True)
    document: Document = json.loads(done.stdout)
    return document


def unchecked(page: str) -> int:
    """Return the number of intervals on a page that no claim has."""
    text = " ".join((SCENARIOS.parent / page).read_text(encoding="utf-8").split())
    claimed = {claim.sentence for claim in CLAIMS if claim.page == page}
    return len(INTERVAL.findall(text)) - sum(len(INTERVAL.findall(sentence)) for sentence in claimed)


@click.command(name="check_pages", help=__doc__, cls=Program)
@click.option("--runs", type=click.IntRange(min=2), default=12, show_default=True, help="Runs per cell.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Root seed; the pages have 0.")
@click.option("--jobs", type=click.IntRange(min=0), default=0, help="Worker processes; 0 = one per core.")
@click.option("--page", type=click.Choice(sorted({claim.page for claim in CLAIMS})), help="Check this page only.")
def main(runs: int, seed: int, jobs: int, page: str | None) -> None:
    """Measure the claims, and print those that no longer hold."""
    claims = sorted((claim for claim in CLAIMS if page in {None, claim.page}), key=lambda claim: claim.study)
    problems = [f"{claim.page} has no longer: {claim.sentence}" for claim in claims if not claim.is_on_page()]
    for study, group in groupby(claims, key=lambda claim: claim.study):
        document = document_of(study, runs, seed, jobs)
        problems += [line for claim in group for line in claim.misfits(document)]
    for line in problems:
        click.echo(line)
    numbers = sum(len(claim.numbers) for claim in claims)
    click.echo(f"{len(claims)} claims with {numbers} numbers checked, {len(problems)} problems")
    for name in sorted({claim.page for claim in claims}):
        click.echo(f"{name}: {unchecked(name)} intervals are not checked")
    sys.exit(bool(problems))


if __name__ == "__main__":
    main()
