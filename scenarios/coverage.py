"""How often do the intervals of `--until` cover the mean? Coverage, bias and number of values of sequential studies.

Each study draws independent values of a known distribution until the half width of their 95 % interval is at most a
target, as a sweep with `--until` does. The target is the half width of 30 or of 300 values with a known deviation.
Intervals of studies that end too early cover too rarely. The mean of skewed values is then too low, because a study
ends early if its values happen to vary little.

With `--control` the studies have a fixed number of values, and a control variate (`desim.analysis.control_variates`).
Values are of known distributions, and of runs of desim that are resampled from a pool. An interval that takes the mean
of the control for known covers too rarely, and an estimate with one slope for all runs is biased.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import exp, sqrt

import click
import numpy as np
from numpy.typing import NDArray

from desim import Links, Motion, Recording, Scenario, Team, sweep
from desim.analysis.control_variates import control_variate
from desim.analysis.statistics import estimate
from desim.analysis.tables import aligned
from desim.kernel.core import portable_math
from scenarios.studies.coverage_runs import FIRST_LOOKS, LAWS, SIZES, coverage


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


PAIRS = (10, 30, 100)
"""The numbers of values of a study with a control."""
TIMES = 10
"""The number of values of the control, as a multiple of those of the study."""
POOL = 500
"""The number of seeds in the pool of runs."""
POOLED = ("local_min", "sap")
"""The protocols in the pool, beside the control."""
RUNS = Scenario(
    horizon=30.0,
    team=Team(count=8, speeds=2.0),
    motion=Motion(step=0.05),
    network=Links(latency=0.2, loss=0.1),
    record=Recording(trajectory=0.0),
)
"""The scenario of the runs in the pool."""
Pair = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Values of a study, and of its control in the same runs."""
Draw = Callable[[np.random.Generator, int], Pair]
"""A function that draws a number of pairs."""


def normal_pairs(rng: np.random.Generator, size: int) -> Pair:
    """Return normal values whose control explains 81 % of their variance."""
    control = rng.normal(size=size)
    return 0.9 * control + sqrt(0.19) * rng.normal(size=size), control


def lognormal_pairs(rng: np.random.Generator, size: int) -> Pair:
    """Return the exponentials of normal pairs."""
    values, control = normal_pairs(rng, size)
    return portable_math.exp(values), portable_math.exp(control)


def curved_pairs(rng: np.random.Generator, size: int) -> Pair:
    """Return values that depend on their control by a parabola, so that no straight line fits; their mean is 1."""
    values, control = normal_pairs(rng, size)
    return values * values + control, control


def pools(seeds: int = POOL) -> dict[str, tuple[Draw, float]]:
    """Return, by name, a function that draws active times of a protocol and of `centralised` from a pool of runs.

    Beside each function is the mean of the active times of the protocol in the pool.
    """
    schedule = {"kind": "poisson", "rate": 5.0}
    kinds = [{"kind": "centralised", "slot": 0.2}, *({"kind": kind, "schedule": schedule} for kind in POOLED)]
    control, *pooled = (group.numbers("active_time") for group in sweep(RUNS, {"protocol": kinds}, seeds).groups)

    def draw(values: NDArray[np.float64], rng: np.random.Generator, size: int) -> Pair:
        drawn = rng.integers(seeds, size=size)
        return values[drawn], control[drawn]

    return {
        f"runs of {kind}": (partial(draw, values), float(np.mean(values)))
        for kind, values in zip(POOLED, pooled, strict=True)
    }


@dataclass(frozen=True)
class ControlledCoverage:
    """How often the intervals of several studies with a control cover the mean, and the errors of their estimates."""

    plain: float
    """Share of the intervals without the control that cover the mean."""
    controlled: float
    """Share of the intervals with the control that cover it."""
    ignoring: float
    """Share of the intervals that cover it if they take the mean of the control for known."""
    bias: float
    """Mean error of the corrected means, in their standard deviations."""
    bias_of_one_slope: float
    """The same with one slope for all runs."""
    worth: float
    """How many times as many values without the control have the same variance of the mean."""


def controlled_coverage(draw: Draw, mean: float, size: int, studies: int) -> ControlledCoverage:
    """Return the coverage of studies of `size` values, with `TIMES` as many values of the control."""
    from scipy.special import stdtrit

    rng = np.random.default_rng(1)
    covered = np.zeros((studies, 3), dtype=bool)
    means = np.zeros((studies, 3))
    for k in range(studies):
        (values, paired), (_, others) = draw(rng, size), draw(rng, (TIMES - 1) * size)
        corrected = control_variate(values, paired, others)
        offset = float(np.mean(paired) - np.mean(others))
        of_one_slope = corrected.plain.mean - corrected.slope * offset
        means[k] = corrected.plain.mean, corrected.mean, of_one_slope
        variance = corrected.standard_error**2 - (corrected.slope * estimate(others).standard_error) ** 2
        half_width_if_known = float(stdtrit(size - 2, 0.975)) * sqrt(max(variance, 0.0))
        widths = corrected.plain.half_width, corrected.half_width, half_width_if_known
        covered[k] = np.abs(means[k][[0, 1, 1]] - mean) <= widths
    bias = (means.mean(axis=0) - mean) / means.std(axis=0)
    plain, controlled, ignoring = covered.mean(axis=0).tolist()
    worth = float(means[:, 0].var() / means[:, 1].var())
    return ControlledCoverage(plain, controlled, ignoring, float(bias[1]), float(bias[2]), worth)


def control_table(studies: int, seeds: int = POOL) -> str:
    """Return the table of all distributions of pairs."""
    laws: dict[str, tuple[Draw, float]] = {
        "normal": (normal_pairs, 0.0),
        "lognormal": (lognormal_pairs, exp(0.5)),
        "parabola": (curved_pairs, 1.0),
    }
    laws |= pools(seeds)
    head = ("pairs", "n", "plain", "control", "mean taken for known", "bias", "with one slope", "worth")
    rows: list[tuple[str, ...]] = [head]
    for name, (draw, mean) in laws.items():
        for size in PAIRS:
            measured = controlled_coverage(draw, mean, size, studies)
            shares = (f"{100 * share:.1f}" for share in (measured.plain, measured.controlled, measured.ignoring))
            biases = f"{measured.bias:+.3f}", f"{measured.bias_of_one_slope:+.3f}"
            rows.append((name, str(size), *shares, *biases, f"{measured.worth:.1f} n"))
    return aligned(rows)


@click.command(help=__doc__)
@click.option(
    "-n", "--runs", "studies", type=click.IntRange(2), default=4000, show_default=True, help="Studies of each."
)
@click.option("--control", is_flag=True, help="Studies with a control variate.")
@click.option("--seeds", type=click.IntRange(10), default=POOL, show_default=True, help="Seeds of the pool of runs.")
def main(studies: int, *, control: bool, seeds: int) -> None:
    """Print the table."""
    click.echo(control_table(studies, seeds) if control else table(studies))


if __name__ == "__main__":
    main()
