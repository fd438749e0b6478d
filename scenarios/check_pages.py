"""Measure again, with few runs and other seeds, the numbers in README and docs.

Each claim is a sentence of a page with the measurements of its numbers (`scenarios.studies.claims`). A published and a
measured mean should differ by at most twice the root of the sum of the squares of their half widths. If the means are
normal, a true number passes with a probability of 99.99 %, and all 300 together with 97 %. Run this check after any
change that may move results; it takes minutes. `--only NAME` checks the claims of one study. With the seed and the runs
of a page, the measured numbers are those that the page should have. The pages are those of the repository, so this
module is not in the wheel.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from math import hypot
from pathlib import Path
from typing import Any, NamedTuple

import click

from desim.cli.program import Program
from scenarios.studies.claims import CLAIMS, Claim
from scenarios.studies.study import Measured, Options

MARGIN = 2.0
"""Largest difference of two means, in roots of the sum of the squares of their half widths."""


@dataclass(frozen=True)
class Remembering(Options):
    """Options of a study that performs each run once, even if several claims need it."""

    values: dict[Any, Any] = field(default_factory=dict)
    """The measurements of all runs of a scenario, by scenario, number of runs and metric."""

    def measure(self, scenarios: Sequence[Any], label: str, metric: Callable[[Any], Measured]) -> list[list[Measured]]:
        """Measure the scenarios that have not been measured, and return the measurements of all."""
        keys = [(scenario, self.runs, metric) for scenario in scenarios]
        new = list(dict.fromkeys(key for key in keys if key not in self.values))
        measured = super().measure([scenario for scenario, *_ in new], label, metric) if new else []
        self.values.update(zip(new, measured, strict=True))
        return [self.values[key] for key in keys]


class Row(NamedTuple):
    """A number of a page."""

    published: str
    measured: str
    holds: bool

    def __str__(self) -> str:
        verdict = "" if self.holds else "DOES NOT HOLD"
        return f"  {self.published:>16}   measured {self.measured:16} {verdict}".rstrip()


def compared(claim: Claim, options: Options) -> Iterator[Row]:
    """Measure the numbers of a claim, one after the other."""
    runs = max(2, round(claim.share * options.runs))
    for (text, mean, half_width, rounding), number in zip(claim.published(), claim.numbers, strict=True):
        measured, width = number(replace(options, runs=runs))
        # A published number without an interval is taken to have the measured one.
        margin = MARGIN * hypot(width if half_width is None else half_width, width) + rounding
        yield Row(text, shown(measured, width, text), abs(measured - mean) <= margin)


def shown(mean: float, half_width: float, published: str) -> str:
    """Return a measured number as text, in percent if the published one is."""
    if "%" in published:
        return f"{100.0 * mean:.3g} % +- {100.0 * half_width:.2g} %"
    return f"{mean:.3g} +- {half_width:.2g}"


@click.command(name="check_pages", help=__doc__, cls=Program)
@click.option("--runs", type=click.IntRange(min=2), default=12, show_default=True, help="Runs per scenario.")
@click.option("--seed", type=click.IntRange(min=0), default=2, show_default=True, help="Root seed; pages have 0 or 1.")
@click.option("--jobs", type=click.IntRange(min=0), default=0, help="Worker processes; 0 = one per core.")
@click.option("--only", type=click.Choice(sorted({claim.study for claim in CLAIMS})), help="Check one study only.")
def main(runs: int, seed: int, jobs: int, only: str | None) -> None:
    """Measure the claims, and print all numbers, and the sentences that no longer hold."""
    claims = [claim for claim in CLAIMS if only in {None, claim.study}]
    options = Remembering("check_pages", runs, jobs, seed, Path("out"), as_json=False)
    problems = [f"{claim.page} no longer has: {claim.text}" for claim in claims if not claim.is_on_page()]
    numbers = 0
    for position, claim in enumerate(claims, start=1):
        click.echo(f"{position}/{len(claims)} {claim.study}, {claim.page}")
        for row in compared(claim, options):
            click.echo(str(row))
            numbers += 1
            problems += [] if row.holds else [f"{claim.page}: {row}: {claim.text}"]
    click.echo("\n".join([*problems, f"{len(claims)} claims with {numbers} numbers, {len(problems)} problems"]))
    sys.exit(bool(problems))


if __name__ == "__main__":
    main()
