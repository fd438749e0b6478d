"""How often do the intervals of `--until` cover the mean? Coverage, bias and number of values of sequential studies.

Each study draws independent values of a known distribution until the half width of their 95 % interval is at most a
target, as a sweep with `--until` does. The target is the half width of 30 or of 300 values with a known deviation. A
rule of `desim.analysis.statistics` for which runs end too early covers too rarely, and a mean of skewed values is low
where they happen to vary little.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import e, exp, sqrt

import click
import numpy as np
from numpy.typing import NDArray

from desim.analysis.statistics import FIRST_LOOK, NORMAL_975, estimate, runs_needed, wilson
from desim.analysis.tables import aligned

SIZES = (30, 300)
"""The numbers of values that give the targets."""
FIRST_LOOKS = (3, 30, FIRST_LOOK)
MOST = 20
"""The largest number of values of a study, as a multiple of the number that gives its target or of the first look."""
Values = NDArray[np.float64] | NDArray[np.bool_]


@dataclass(frozen=True)
class Law:
    """A distribution with a known mean and standard deviation."""

    draw: Callable[[np.random.Generator, int], Values]
    mean: float
    deviation: float


LAWS = {
    "normal": Law(lambda rng, size: rng.normal(size=size), 0.0, 1.0),
    "exponential": Law(lambda rng, size: rng.exponential(size=size), 1.0, 1.0),
    "lognormal, sigma = 1": Law(lambda rng, size: rng.lognormal(size=size), exp(0.5), sqrt((e - 1.0) * e)),
    "true with probability 0.1": Law(lambda rng, size: rng.random(size) < 0.1, 0.1, 0.3),
}


@dataclass(frozen=True)
class Coverage:
    """How often the intervals of several studies cover the mean, and what the studies cost."""

    share: float
    """Share of the intervals that cover the mean."""
    bias: float
    """Mean error of the means, as a share of the target half width."""
    values: float
    """Mean number of values of a study."""


def covers(values: Sequence[float], mean: float) -> bool:
    """Return whether the 95 % interval of values covers a mean: Wilson's of truth values, else the t interval."""
    if isinstance(values[0], bool):
        low, high = wilson(sum(map(int, values)), len(values))
        return low <= mean <= high
    interval = estimate(values)
    return abs(interval.mean - mean) <= interval.half_width


def coverage(law: Law, size: int, first_look: int, studies: int) -> Coverage:
    """Return the coverage of studies whose target is the half width of `size` values of known deviation."""
    rng, target = np.random.default_rng(1), NORMAL_975 * law.deviation / sqrt(size)
    covered, errors, counts = 0, [], []
    for _ in range(studies):
        drawn = law.draw(rng, MOST * max(size, first_look)).tolist()
        values = drawn[: runs_needed(drawn, target, at_most=len(drawn), first_look=first_look)]
        covered += covers(values, law.mean)
        errors.append(estimate(values).mean - law.mean)
        counts.append(len(values))
    return Coverage(covered / studies, float(np.mean(errors)) / target, float(np.mean(counts)))


def table(studies: int) -> str:
    """Return the table of all distributions, targets and first looks."""
    rows: list[tuple[str, ...]] = [("distribution", "target of", "first look", "covered, %", "bias", "values")]
    for name, law in LAWS.items():
        for size in SIZES:
            for first_look in FIRST_LOOKS:
                measured = coverage(law, size, first_look, studies)
                numbers = f"{100 * measured.share:.1f}", f"{measured.bias:+.3f}", f"{measured.values:.0f}"
                rows.append((name, str(size), str(first_look), *numbers))
    return aligned(rows)


@click.command(help=__doc__)
@click.option(
    "-n", "--runs", "studies", type=click.IntRange(2), default=4000, show_default=True, help="Studies of each."
)
def main(studies: int) -> None:
    """Print the table."""
    click.echo(table(studies))


if __name__ == "__main__":
    main()
